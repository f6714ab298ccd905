#include "texturing/codec/tail_code.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <memory>

#include "texturing/codec/relief_levels.h"
#include "texturing/codec/residual_code.h"
#include "texturing/codec/tail_grid.h"
#include "texturing/codec/tail_heights.h"

namespace relievo {
namespace tail_code {
namespace {

using relief_levels::DecodingCoder;
using relief_levels::EncodingCoder;

using tail_heights::kHeights;
constexpr int kSide = kTailCodeTexels, kLevels = 4;
constexpr size_t kTexels = 256 + 64 + 16 + 4;        // of a channel
constexpr size_t kLengthBytes = kTailCodeHeadBytes;  // before each stream

// ---- texels ----

// How the three channels of a plane depend on one another. An encoder tries all.
enum class Mode : uint8_t {
  kAlone,
  kAlike,   // they differ from their predictions alike: colours
  kLength,  // the largest component follows from the other two, at the neighbours' length: normals
};
constexpr int kModes = 3;

// Takes what is said, and keeps none of it: for rounding texels as an encoder would see them.
struct RoundingCoder {
  int most = 0;  // steps that a texel may change
  bool bit(BitModel&, bool b) { return b; }
  uint32_t plain(uint32_t v, int) { return v; }
};

// The three channels of a plane, patch after patch.
template <class Coder>
class PlaneCode {
  static constexpr bool kRounds = std::is_same_v<Coder, RoundingCoder>,
                        kEncodes = kRounds || std::is_same_v<Coder, EncodingCoder>;
  using Texels = std::conditional_t<kEncodes && !kRounds, const uint8_t, uint8_t>;

 public:
  PlaneCode(Coder& coder, Mode mode) : coder_(coder), mode_(mode) { first_.fill(128); }

  // levels[l]: the patch's three channels of level l, one after the other.
  void patch(const std::array<Texels*, kLevels>& levels) {
    const bool plain = coder_.bit(plain_[was_plain_], kEncodes && isPlain(levels));
    was_plain_ = plain;
    if (plain) {
      if constexpr (!kEncodes) fill(levels);
      return;
    }
    finest(levels[0]);
    for (int level = 1; level < kLevels; ++level)
      for (int c = 0; c < 3; ++c) coarser(levels, level, c);
    for (size_t c = 0; c < 3; ++c) first_[c] = levels[0][c * kSide * kSide];
  }

 private:
  static constexpr int kRow = kSide + 2;
  static constexpr size_t texelsOf(int level) { return static_cast<size_t>(kSide >> level) * (kSide >> level); }

  // All as the last patch's first texel.
  bool isPlain(const std::array<Texels*, kLevels>& levels) const {
    for (int level = 0; level < kLevels; ++level)
      for (size_t c = 0; c < 3; ++c) {
        const auto* from = levels[static_cast<size_t>(level)] + c * texelsOf(level);
        if (std::any_of(from, from + texelsOf(level), [&](uint8_t t) { return t != first_[c]; })) return false;
      }
    return true;
  }
  void fill(const std::array<Texels*, kLevels>& levels) const {
    for (int level = 0; level < kLevels; ++level)
      for (size_t c = 0; c < 3; ++c)
        std::fill_n(levels[static_cast<size_t>(level)] + c * texelsOf(level), texelsOf(level), first_[c]);
  }

  // The value next to `value` that is whole steps of 2 most + 1 from the predicted one.
  uint8_t roundedFrom(int predicted, int value) const {
    if constexpr (kRounds) {
      const int step = 2 * coder_.most + 1, off = value - predicted,
                steps = (std::abs(off) + coder_.most) / step * (off < 0 ? -1 : 1), rounded = predicted + steps * step;
      if (rounded >= 0 && rounded <= 255) return static_cast<uint8_t>(rounded);
    }
    return static_cast<uint8_t>(value);
  }

  int predicted(const Texels* channel, size_t c, int x, int y) const {
    const Texels* p = channel + y * kSide + x;
    if (x == 0 && y == 0) return first_[c];
    if (y == 0) return p[-1] + ((p[-1] - p[x > 1 ? -2 : -1]) >> 1);
    if (x == 0) return p[-kSide] + ((p[-kSide] - p[y > 1 ? -2 * kSide : -kSide]) >> 1);
    const int w = p[-1], n = p[-kSide], nw = p[-kSide - 1], ne = x + 1 < kSide ? p[-kSide + 1] : n,
              ww = x > 1 ? p[-2] : w, nn = y > 1 ? p[-2 * kSide] : n;
    return (16 * w + 7 * n - 4 * nw + 4 * ne - 4 * ww - 3 * nn + 8) >> 4;
  }

  static int component(int value) { return 2 * value - 255; }
  static int squared(const Texels* plane, int at) {
    int sum = 0;
    for (int c = 0; c < 3; ++c) {
      const int n = component(plane[c * kSide * kSide + at]);
      sum += n * n;
    }
    return sum;
  }
  // Of the component that is left, where two are known.
  static int fromLength(const Texels* plane, int x, int y, const std::array<int, 3>& order, int predicted) {
    const int at = y * kSide + x;
    int length = 255 * 255;
    if (x > 0 && y > 0) length = (squared(plane, at - 1) + squared(plane, at - kSide)) >> 1;
    else if (x > 0) length = squared(plane, at - 1);
    else if (y > 0) length = squared(plane, at - kSide);
    for (size_t k = 0; k < 2; ++k) {
      const int n = component(plane[order[k] * kSide * kSide + at]);
      length -= n * n;
    }
    if (length <= 0) return predicted;
    const int root = static_cast<int>(std::sqrt(static_cast<double>(length)));  // exact: rounded as IEEE 754 says
    return std::clamp(((component(predicted) < 0 ? -root : root) + 256) >> 1, 0, 255);
  }

  void finest(Texels* plane) {
    for (auto& of_channel : residuals_) of_channel.fill(0);
    for (int y = 0; y < kSide; ++y)
      for (int x = 0; x < kSide; ++x) texel(plane, x, y);
  }
  void texel(Texels* plane, int x, int y) {
    constexpr uint32_t kUnknown = 40;  // around a patch's first texel
    std::array<int, 3> expected, order{0, 1, 2};
    for (size_t c = 0; c < 3; ++c) expected[c] = std::clamp(predicted(plane + c * kSide * kSide, c, x, y), 0, 255);
    if (mode_ == Mode::kLength) {
      auto size = [&](int c) { return std::abs(component(expected[static_cast<size_t>(c)])); };
      // The largest comes last, the first of equals first.
      if (size(order[0]) > size(order[1])) std::swap(order[0], order[1]);
      if (size(order[1]) > size(order[2])) std::swap(order[1], order[2]);
      if (size(order[0]) > size(order[1])) std::swap(order[0], order[1]);
    }
    int before = 0;
    for (size_t k = 0; k < 3; ++k) {
      const auto c = static_cast<size_t>(order[k]);
      int from = expected[c];
      if (mode_ == Mode::kAlike) from = std::clamp(from + before, 0, 255);
      if (mode_ == Mode::kLength && k == 2) from = fromLength(plane, x, y, order, from);
      int16_t* r = residuals_[c].data() + (y + 1) * kRow + x + 1;
      const int w = r[-1], n = r[-kRow];
      auto size = [](int residual) { return static_cast<uint32_t>(std::abs(residual)); };
      uint32_t around = 2 * (size(w) + size(n)) + size(r[-kRow - 1]) + size(r[-kRow + 1]);
      if (x == 0 && y == 0) around = kUnknown;
      else if (y == 0) around *= 2;
      else if (x == 0) around = around * 3 / 2;
      if (mode_ == Mode::kLength ? k == 1 : k > 0) around += 2 * size(before);
      uint8_t value = 0;
      if constexpr (kEncodes) value = roundedFrom(from, plane[c * kSide * kSide + static_cast<size_t>(y * kSide + x)]);
      const int residual = residual_code::code(coder_, finest_[k], around, w + n, static_cast<int8_t>(value - from));
      if constexpr (!kEncodes || kRounds)
        plane[c * kSide * kSide + static_cast<size_t>(y * kSide + x)] = static_cast<uint8_t>(from + residual);
      *r = static_cast<int16_t>(residual);
      before = residual;
    }
  }

  // The mean of the finer level's four texels, but for its rounding, and for what colours' halving adds.
  void coarser(const std::array<Texels*, kLevels>& levels, int level, int channel) {
    const int side = kSide >> level;
    const Texels* fine = levels[static_cast<size_t>(level - 1)] + static_cast<size_t>(channel) * texelsOf(level - 1);
    Texels* to = levels[static_cast<size_t>(level)] + static_cast<size_t>(channel) * texelsOf(level);
    for (int y = 0; y < side; ++y) {
      for (int x = 0; x < side; ++x) {
        const Texels* f = fine + 4 * y * side + 2 * x;
        const int sum = f[0] + f[1] + f[2 * side] + f[2 * side + 1] + 2, from = sum >> 2;
        const int value = kEncodes ? roundedFrom(from, to[y * side + x]) : 0;
        const int residual = residual_code::code(coder_, coarser_[sum & 3], 0, 0, static_cast<int8_t>(value - from));
        if constexpr (!kEncodes || kRounds) to[y * side + x] = static_cast<uint8_t>(from + residual);
      }
    }
  }

  Coder& coder_;
  const Mode mode_;
  std::array<uint8_t, 3> first_;
  bool was_plain_ = false;
  BitModel plain_[2];
  residual_code::Models finest_[3], coarser_[4];
  std::array<std::array<int16_t, kRow * kRow>, 3> residuals_;
};

template <class Byte>
std::array<Byte*, kLevels> levelsOf(std::span<Byte> texels, size_t patch, int channels, int plane) {
  std::array<Byte*, kLevels> out;
  Byte* at = texels.data() + patch * kTexels * static_cast<size_t>(channels);
  for (int level = 0; level < kLevels; ++level) {
    const auto of_channel = static_cast<size_t>((kSide >> level) * (kSide >> level));
    out[static_cast<size_t>(level)] = at + static_cast<size_t>(3 * plane) * of_channel;
    at += static_cast<size_t>(channels) * of_channel;
  }
  return out;
}

void encodePlane(std::span<const uint8_t> texels, size_t patches, int channels, int plane, Mode mode,
                 std::vector<uint8_t>& out) {
  out.push_back(static_cast<uint8_t>(mode));
  EncodingCoder coder{RangeEncoder(out)};
  const auto code = std::make_unique<PlaneCode<EncodingCoder>>(coder, mode);
  for (size_t p = 0; p < patches; ++p) code->patch(levelsOf(texels, p, channels, plane));
  coder.rc.finish();
}

// The mode that takes the fewest bytes for the first patches.
Mode bestMode(std::span<const uint8_t> texels, size_t patches, int channels, int plane) {
  constexpr size_t kTried = 32;
  Mode best = Mode::kAlone;
  size_t least = ~size_t{0};
  for (int mode = 0; mode < kModes; ++mode) {
    std::vector<uint8_t> tried;
    encodePlane(texels, std::min(patches, kTried), channels, plane, static_cast<Mode>(mode), tried);
    if (tried.size() >= least) continue;
    least = tried.size();
    best = static_cast<Mode>(mode);
  }
  return best;
}

bool isWithin(std::span<const uint8_t> finest, std::span<const uint8_t> before, double rms) {
  int64_t squares = 0;
  for (size_t i = 0; i < finest.size(); ++i) {
    const int off = finest[i] - before[i];
    squares += int64_t{off} * off;
  }
  return static_cast<double>(squares) <= rms * rms * static_cast<double>(finest.size());
}

void round(std::span<uint8_t> texels, int channels, int plane, int most, double rms) {
  const size_t patches = texels.size() / (kTexels * static_cast<size_t>(channels));
  RoundingCoder coder;
  const auto code = std::make_unique<PlaneCode<RoundingCoder>>(coder, bestMode(texels, patches, channels, plane));
  constexpr size_t kFinest = kSide * kSide;
  std::array<uint8_t, 3 * kTexels> before;
  for (size_t p = 0; p < patches; ++p) {
    const auto levels = levelsOf(texels, p, channels, plane);
    auto overLevels = [&](auto&& f) {
      for (int level = 0, at = 0; level < kLevels; ++level) {
        const int count = 3 * (kSide >> level) * (kSide >> level);
        f(levels[static_cast<size_t>(level)], before.data() + at, count);
        at += count;
      }
    };
    overLevels([](const uint8_t* from, uint8_t* to, int count) { std::copy_n(from, count, to); });
    for (coder.most = most;; --coder.most) {
      code->patch(levels);
      bool within = true;
      for (size_t c = 0; c < 3; ++c)
        within &= isWithin({levels[0] + c * kFinest, kFinest}, {before.data() + c * kFinest, kFinest}, rms);
      if (within || coder.most == 0) break;
      overLevels([](uint8_t* to, const uint8_t* from, int count) { std::copy_n(from, count, to); });
    }
  }
}

uint32_t lengthAt(std::span<const uint8_t> bytes) {
  uint32_t length = 0;
  for (size_t i = 0; i < kLengthBytes; ++i) length |= uint32_t{bytes[i]} << (8 * i);
  return length;
}

// Calls write(out), and puts before what it appends how much that is.
template <class Write>
void appendStream(std::vector<uint8_t>& out, Write write) {
  const size_t at = out.size();
  out.resize(at + kLengthBytes);
  write();
  const size_t length = out.size() - at - kLengthBytes;
  for (size_t i = 0; i < kLengthBytes; ++i) out[at + i] = static_cast<uint8_t>(length >> (8 * i));
}

// The next stream, which is taken from the bytes; false: they are cut off.
bool takeStream(std::span<const uint8_t>& bytes, std::span<const uint8_t>& stream) {
  if (bytes.size() < kLengthBytes) return false;
  const uint32_t length = lengthAt(bytes);
  bytes = bytes.subspan(kLengthBytes);
  if (length > bytes.size()) return false;
  stream = bytes.first(length);
  bytes = bytes.subspan(length);
  return true;
}

template <class Encode>
void appendCode(std::vector<uint8_t>& out, Encode encode) {
  EncodingCoder coder{RangeEncoder(out)};
  encode(coder);
  coder.rc.finish();
}

void encode(std::span<const uint16_t> heights, std::span<const uint8_t> texels, int channels, PatchCorners corners,
            std::vector<uint8_t>& out) {
  assert(channels % 3 == 0 && heights.size() % kHeights == 0);
  const size_t patches = heights.size() / kHeights;
  assert(texels.size() == patches * kTexels * static_cast<size_t>(channels));
  assert(corners.empty() || corners.size() == patches);
  const auto scratch = std::make_unique<ReliefCodeScratch>();
  appendStream(out, [&] {
    appendCode(out, [&](EncodingCoder& coder) {
      if (corners.empty()) tail_heights::PlainCode<EncodingCoder>(coder, *scratch).run(heights);
      else tail_heights::SharedCode<EncodingCoder>(coder, *scratch, corners).run(heights);
    });
  });
  for (int plane = 0; plane < channels / 3; ++plane)
    appendStream(out, [&] {
      if (corners.empty())
        return encodePlane(texels, patches, channels, plane, bestMode(texels, patches, channels, plane), out);
      appendCode(out, [&](EncodingCoder& coder) {
        const auto code = std::make_unique<tail_grid::PlaneCode<EncodingCoder>>(coder);
        for (size_t p = 0; p < patches; ++p) code->patch(levelsOf(texels, p, channels, plane), corners[p]);
      });
    });
}

// Takes them from the bytes.
bool decodeHeights(std::span<const uint8_t>& bytes, PatchCorners corners, std::span<uint16_t> heights) {
  assert(heights.size() % kHeights == 0 && (corners.empty() || corners.size() == heights.size() / kHeights));
  std::span<const uint8_t> stream;
  if (!takeStream(bytes, stream)) return false;
  const auto scratch = std::make_unique<ReliefCodeScratch>();
  DecodingCoder coder{RangeDecoder(stream)};
  const auto exhausted = [&] { return coder.rc.exhausted(); };
  if (corners.empty()) tail_heights::PlainCode<DecodingCoder>(coder, *scratch).run(heights, exhausted);
  else tail_heights::SharedCode<DecodingCoder>(coder, *scratch, corners).run(heights, exhausted);
  return coder.rc.whole();
}

bool decodeRows(std::span<const uint8_t> stream, int channels, int plane, std::span<uint8_t> texels) {
  if (stream.empty() || stream[0] >= kModes) return false;
  DecodingCoder coder{RangeDecoder(stream.subspan(1))};
  const auto code = std::make_unique<PlaneCode<DecodingCoder>>(coder, static_cast<Mode>(stream[0]));
  const size_t patches = texels.size() / (kTexels * static_cast<size_t>(channels));
  for (size_t p = 0; p < patches && !coder.rc.exhausted(); ++p) code->patch(levelsOf(texels, p, channels, plane));
  return coder.rc.whole();
}
bool decodeGrids(std::span<const uint8_t> stream, int channels, int plane, PatchCorners corners,
                 std::span<uint8_t> texels) {
  DecodingCoder coder{RangeDecoder(stream)};
  const auto code = std::make_unique<tail_grid::PlaneCode<DecodingCoder>>(coder);
  for (size_t p = 0; p < corners.size() && !coder.rc.exhausted(); ++p)
    code->patch(levelsOf(texels, p, channels, plane), corners[p]);
  return coder.rc.whole();
}

bool decode(std::span<const uint8_t> bytes, int channels, PatchCorners corners, std::span<uint16_t> heights,
            std::span<uint8_t> texels) {
  assert(channels % 3 == 0);
  assert(texels.size() == heights.size() / kHeights * kTexels * static_cast<size_t>(channels));
  std::span<const uint8_t> stream;
  if (!decodeHeights(bytes, corners, heights)) return false;
  for (int plane = 0; plane < channels / 3; ++plane)
    if (!takeStream(bytes, stream) || !(corners.empty() ? decodeRows(stream, channels, plane, texels)
                                                        : decodeGrids(stream, channels, plane, corners, texels)))
      return false;
  return bytes.empty();
}

void roundToGrids(std::span<uint8_t> texels, int channels, int plane, int most, double rms) {
  const size_t patches = texels.size() / (kTexels * static_cast<size_t>(channels));
  tail_grid::Plan plan;
  tail_grid::Channels from;
  for (size_t p = 0; p < patches; ++p) {
    const auto levels = levelsOf(texels, p, channels, plane);
    for (size_t c = 0; c < 3; ++c) std::copy_n(levels[0] + c * from[c].size(), from[c].size(), from[c].begin());
    tail_grid::planWithin(from, most, rms, plan);
    for (size_t c = 0; c < 3; ++c)
      std::copy(plan.texels[c].begin(), plan.texels[c].end(), levels[0] + c * from[c].size());
    for (size_t level = 1; level < kLevels; ++level) {
      const int side = kSide >> level;
      for (size_t c = 0; c < 3; ++c) {
        const size_t of_channel = static_cast<size_t>(side * side);
        uint8_t* to = levels[level] + c * of_channel;
        for (int y = 0; y < side; ++y)
          for (int x = 0; x < side; ++x, ++to) {
            const int mean = tail_grid::sumOfFour(levels[level - 1] + c * 4 * of_channel, side, x, y) >> 2;
            if (std::abs(*to - mean) <= tail_grid::kReaches[plan.reach]) *to = static_cast<uint8_t>(mean);
          }
      }
    }
  }
}

}  // namespace
}  // namespace tail_code

void encodeTailCode(std::span<const uint16_t> heights, std::span<const uint8_t> texels, int channels,
                    PatchCorners corners, std::vector<uint8_t>& out) {
  tail_code::encode(heights, texels, channels, corners, out);
}

bool decodeTailCode(std::span<const uint8_t> bytes, int channels, PatchCorners corners, std::span<uint16_t> heights,
                    std::span<uint8_t> texels) {
  return tail_code::decode(bytes, channels, corners, heights, texels);
}

bool decodeTailHeights(std::span<const uint8_t> bytes, PatchCorners corners, std::span<uint16_t> heights) {
  return tail_code::decodeHeights(bytes, corners, heights);
}

void roundTailTexels(std::span<uint8_t> texels, int channels, int plane, TailTolerance within) {
  if (within.grids) tail_code::roundToGrids(texels, channels, plane, within.most, within.rms);
  else tail_code::round(texels, channels, plane, within.most, within.rms);
}

uint64_t tailCodeHeightBytes(std::span<const uint8_t> bytes) {
  return kTailCodeHeadBytes + tail_code::lengthAt(bytes.first(kTailCodeHeadBytes));
}

}  // namespace relievo
