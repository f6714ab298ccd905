// range_coder.h - adaptive binary range coding (G. N. N. Martin 1979; the carry as in LZMA, I. Pavlov). All arithmetic
// is of integers: the same bits on every machine. The libraries at hand do not serve: zstd's entropy coders take no
// context, and those of liblzma and codecs of pictures are not to be called from outside.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace relievo {

// The probability of a 0, in 65536ths, learnt as it is used: the mean of what was seen at first, then an exponential
// one.
struct BitModel {
  static constexpr uint32_t kOne = 1u << 16, kLeast = 48;
  uint16_t zero = 1u << 15;
  uint8_t seen = 0;

  static constexpr uint32_t kMostSeen = 90;
  void learn(bool bit) {
    static constexpr auto kRates = [] {  // 65536 / (seen + 1.5)
      std::array<uint16_t, kMostSeen + 1> rates{};
      for (uint32_t n = 0; n < rates.size(); ++n) rates[n] = static_cast<uint16_t>(2 * kOne / (2 * n + 3));
      return rates;
    }();
    const uint32_t target = bit ? kLeast : kOne - kLeast, rate = kRates[seen];
    const int32_t step = (static_cast<int32_t>(target) - static_cast<int32_t>(zero)) * static_cast<int32_t>(rate >> 1);
    zero = static_cast<uint16_t>(zero + (step >> 15));
    seen = static_cast<uint8_t>(seen + (seen < kMostSeen));
  }
};

class RangeEncoder {
 public:
  // Bytes are appended to out.
  explicit RangeEncoder(std::vector<uint8_t>& out) : out_(out) {}
  void bit(BitModel& model, bool bit) {
    const uint32_t bound = static_cast<uint32_t>((uint64_t{range_} * model.zero) >> 16);
    model.learn(bit);
    narrow(bit, bound);
  }
  // The lowest `count` bits, the highest of them first, none of them more likely than the other.
  void plain(uint32_t value, int count) {
    while (count-- > 0) narrow(value >> count & 1, range_ >> 1);
  }
  void finish() {
    for (int i = 0; i < 5; ++i) shift();
  }

 private:
  void narrow(bool bit, uint32_t bound) {
    if (bit) low_ += bound, range_ -= bound;
    else range_ = bound;
    while (range_ < (1u << 24)) range_ <<= 8, shift();
  }
  void shift() {
    if (low_ < 0xFF000000u || low_ >> 32) {
      const auto carry = static_cast<uint8_t>(low_ >> 32);
      if (begun_) out_.push_back(static_cast<uint8_t>(cache_ + carry));
      begun_ = true;
      for (; pending_ > 0; --pending_) out_.push_back(static_cast<uint8_t>(0xFF + carry));
      cache_ = static_cast<uint8_t>(low_ >> 24);
    } else {
      ++pending_;
    }
    low_ = (low_ & 0x00FFFFFF) << 8;
  }

  std::vector<uint8_t>& out_;
  uint64_t low_ = 0;
  uint32_t range_ = ~0u;
  size_t pending_ = 0;
  uint8_t cache_ = 0;
  bool begun_ = false;
};

// Of any bytes: beyond their end it reads zeros, and whole() tells.
class RangeDecoder {
 public:
  explicit RangeDecoder(std::span<const uint8_t> bytes) : next_(bytes.data()), end_(bytes.data() + bytes.size()) {
    for (int i = 0; i < 4; ++i) code_ = code_ << 8 | take();
  }
  bool bit(BitModel& model) {
    const uint32_t bound = static_cast<uint32_t>((uint64_t{range_} * model.zero) >> 16);
    const bool bit = code_ >= bound;
    model.learn(bit);
    narrow(bit, bound);
    return bit;
  }
  uint32_t plain(int count) {
    uint32_t value = 0;
    while (count-- > 0) {
      const uint32_t bound = range_ >> 1;
      const bool bit = code_ >= bound;
      narrow(bit, bound);
      value = value << 1 | bit;
    }
    return value;
  }
  // Are there far fewer bytes than were asked for? What comes then is zeros without end.
  bool exhausted() const { return beyond_ > 4; }
  // Were there neither too few bytes nor too many?
  bool whole() const { return next_ == end_ && beyond_ == 0; }

 private:
  void narrow(bool bit, uint32_t bound) {
    if (bit) code_ -= bound, range_ -= bound;
    else range_ = bound;
    while (range_ < (1u << 24)) range_ <<= 8, code_ = code_ << 8 | take();
  }
  uint8_t take() {
    if (next_ != end_) return *next_++;
    ++beyond_;
    return 0;
  }

  const uint8_t* next_;
  const uint8_t* end_;
  size_t beyond_ = 0;
  uint32_t range_ = ~0u, code_ = 0;
};

}  // namespace relievo
