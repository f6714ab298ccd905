// format_coder.h - the coder of hierarchical relief as PACKAGE.md says it, for readers of single sections in its words
// that share nothing with texturing/codec/range_coder.h.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>

namespace relievo::format_coder {

struct Model {
  int64_t zero = 1 << 15, seen = 0;
};
class Coder {
 public:
  explicit Coder(std::span<const uint8_t> bytes) : bytes_(bytes) {
    for (int i = 0; i < 4; ++i) code_ = code_ << 8 | next();
  }
  int bit(Model& m) {
    const uint64_t bound = (range_ * static_cast<uint64_t>(m.zero)) >> 16;
    const int bit = take(bound);
    const int64_t rate = 131072 / (2 * m.seen + 3);
    m.zero += ((bit ? 48 : 65488) - m.zero) * (rate >> 1) >> 15;
    m.seen = std::min<int64_t>(m.seen + 1, 90);
    return bit;
  }
  uint32_t plain(int bits) {
    uint32_t value = 0;
    for (; bits > 0; --bits) value = 2 * value + static_cast<uint32_t>(take(range_ >> 1));
    return value;
  }
  bool ended() const { return at_ == bytes_.size(); }

 private:
  int take(uint64_t bound) {
    const int bit = code_ >= bound;
    if (bit) code_ -= bound, range_ -= bound;
    else range_ = bound;
    for (; range_ < (uint64_t{1} << 24); range_ <<= 8) code_ = code_ << 8 | next();
    return bit;
  }
  uint64_t next() { return at_ < bytes_.size() ? bytes_[at_++] : (++at_, 0); }
  std::span<const uint8_t> bytes_;
  size_t at_ = 0;
  uint64_t range_ = 0xFFFFFFFF, code_ = 0;
};

}  // namespace relievo::format_coder
