#include "texturing/codec/relief_compact.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cassert>
#include <cstring>

#include "src/artwork/patch_domain.h"
#include "texturing/codec/page_codec.h"

namespace relievo {
namespace {

constexpr uint32_t kMostPairs = 1u << 12;  // of texels, before a block's residuals

struct Block {
  int x, y, columns, rows;
};
constexpr uint32_t headerTexels(int blocks) { return static_cast<uint32_t>(blocks * blocks / 2 * 3); }
Block blockAt(int cells, int bx, int by) {
  const int last = cells / kCompactBlock - 1;
  return {bx * kCompactBlock, by * kCompactBlock, kCompactBlock + (bx == last), kCompactBlock + (by == last)};
}

struct BlockPlane {
  int base = 0, slope_x = 0, slope_y = 0;  // slopes in kSlopeStep
  int width = 0;                           // bits of what lies above it
};
constexpr int kWidestCode = 15;  // of a width: 16 bits
constexpr uint32_t codeOf(int width) { return static_cast<uint32_t>(std::min(width, kWidestCode)); }
constexpr uint32_t widthOf(uint32_t code) { return code + (code + 1) / 16; }
constexpr int kMostSamples = (kCompactBlock + 1) * (kCompactBlock + 1);

int slopeOf(int moment, int squares) {  // rounded
  const int step = squares * kSlopeStep;
  return std::clamp((2 * moment + (moment < 0 ? -step : step)) / (2 * step), -128, 127);
}

// What is left of a block's samples, in rows, when the slopes are taken away: the lowest, and in how many bits the
// others lie above it.
void levelBlock(const Block& b, BlockPlane& p, const std::array<int, kMostSamples>& q,
                std::array<int, kMostSamples>& residuals) {
  int low = 1 << 30, high = -low;
  for (int y = 0, i = 0; y < b.rows; ++y) {
    const int along_y = kSlopeStep * p.slope_y * y, step = kSlopeStep * p.slope_x;
    for (int x = 0; x < b.columns; ++x, ++i) {
      const int r = q[static_cast<size_t>(i)] - along_y - step * x;
      residuals[static_cast<size_t>(i)] = r;
      low = std::min(low, r);
      high = std::max(high, r);
    }
  }
  p.base = low;
  p.width = std::bit_width(static_cast<uint32_t>(high - low));
}

// The slopes are those of least squares; the base is as high as all samples allow.
BlockPlane fitPlane(const Block& b, const std::array<int, kMostSamples>& q, std::array<int, kMostSamples>& residuals) {
  // Places are counted from the block's middle, doubled: moments are of slopes' halves.
  int moment_x = 0, moment_y = 0, squares_x = 0, squares_y = 0;
  for (int y = 0, i = 0; y < b.rows; ++y) {
    const int v = 2 * y - (b.rows - 1);
    int sum = 0;
    for (int x = 0; x < b.columns; ++x, ++i) {
      moment_x += (2 * x - (b.columns - 1)) * q[static_cast<size_t>(i)];
      sum += q[static_cast<size_t>(i)];
    }
    moment_y += v * sum;
    squares_y += v * v;
  }
  for (int x = 0; x < b.columns; ++x) squares_x += (2 * x - (b.columns - 1)) * (2 * x - (b.columns - 1));
  BlockPlane p{.slope_x = slopeOf(2 * moment_x, squares_x * b.rows),
               .slope_y = slopeOf(2 * moment_y, squares_y * b.columns)};
  levelBlock(b, p, q, residuals);
  if (p.width >= kWidestCode) {  // heights themselves need no more than 16
    p.slope_x = p.slope_y = 0;
    levelBlock(b, p, q, residuals);
  }
  return p;
}

void readBlock(const uint8_t* texels, int step, const Block& b, std::array<int, kMostSamples>& q) {
  size_t i = 0;
  for (int y = b.y; y < b.y + b.rows; ++y) {
    const uint8_t* t = texels + 4 * (y * kPageFullPx + b.x) * step;
    for (int x = 0; x < b.columns; ++x, t += 4 * step) q[i++] = t[0] << 8 | t[1];
  }
}

uint32_t pairsOf(const Block& b, int width) {
  return (static_cast<uint32_t>(b.columns * b.rows) * widthOf(codeOf(width)) + 63) / 64;
}

// Every block in the order of the headers, with its residuals. False when `f` is.
template <class F>
bool forEachBlock(std::span<const uint8_t> texels, int cells, F&& f) {
  assert(texels.size() == kSlotBytes);
  std::array<int, kMostSamples> q, residuals;
  const int blocks = cells / kCompactBlock;
  for (int by = 0; by < blocks; ++by)
    for (int bx = 0; bx < blocks; ++bx) {
      const Block b = blockAt(cells, bx, by);
      readBlock(texels.data(), kPagePx / cells, b, q);
      const BlockPlane plane = fitPlane(b, q, residuals);
      if (!f(by * blocks + bx, b, plane, residuals)) return false;
    }
  return true;
}

uint32_t texelAt(std::span<const uint8_t> packed, uint32_t i) {
  const uint8_t* t = packed.data() + size_t{4} * i;
  return t[0] | t[1] << 8 | t[2] << 16 | static_cast<uint32_t>(t[3]) << 24;
}
void putTexel(std::span<uint8_t> packed, uint32_t i, uint32_t bits) {
  for (size_t k = 0; k < 4; ++k) packed[size_t{4} * i + k] = static_cast<uint8_t>(bits >> (8 * k));
}

constexpr uint32_t swapped(uint32_t half) { return (half >> 8 & 0xFFu) | (half & 0xFFu) << 8; }

}  // namespace

std::optional<uint32_t> compactTexels(std::span<const uint8_t> texels, int cells) {
  uint32_t pairs = headerTexels(cells / kCompactBlock) / 2;
  const bool fits = forEachBlock(texels, cells, [&](int, const Block& b, const BlockPlane& plane, const auto&) {
    if (pairs >= kMostPairs) return false;
    pairs += pairsOf(b, plane.width);
    return true;
  });
  return fits ? std::optional(2 * pairs) : std::nullopt;
}

void packCompact(std::span<const uint8_t> texels, int cells, std::span<uint8_t> out) {
  uint32_t pairs = headerTexels(cells / kCompactBlock) / 2,
           between = 0;  // between: of two headers, the first's half in the texel that they share
  forEachBlock(texels, cells,
               [&](int index, const Block& b, const BlockPlane& plane, const std::array<int, kMostSamples>& residuals) {
                 const uint32_t bits = (static_cast<uint32_t>(plane.base) & 0xFFFFu) |
                                       (static_cast<uint32_t>(plane.slope_x) & 0xFFu) << 16 |
                                       static_cast<uint32_t>(plane.slope_y) << 24;
                 const uint32_t rest = swapped(codeOf(plane.width) | pairs << 4),
                                first = static_cast<uint32_t>(index) / 2 * 3;
                 assert(plane.width <= 16 && pairs < kMostPairs);
                 if (index % 2 == 0) {
                   putTexel(out, first, bits);
                   between = rest;
                 } else {
                   putTexel(out, first + 1, between | rest << 16);
                   putTexel(out, first + 2, bits);
                 }
                 uint32_t at = 2 * pairs;
                 uint64_t waiting = 0;
                 const auto width = static_cast<int>(widthOf(codeOf(plane.width)));
                 int held = 0;
                 for (int i = 0; i < b.columns * b.rows; ++i) {
                   waiting |= static_cast<uint64_t>(residuals[static_cast<size_t>(i)] - plane.base) << held;
                   held += width;
                   if (held < 32) continue;
                   putTexel(out, at++, static_cast<uint32_t>(waiting));
                   waiting >>= 32;
                   held -= 32;
                 }
                 if (held > 0) putTexel(out, at, static_cast<uint32_t>(waiting));
                 pairs += pairsOf(b, plane.width);
                 return true;
               });
}

int compactSample(std::span<const uint8_t> packed, int cells, int x, int y) {
  const int last = cells / kCompactBlock - 1, bx = std::min(x / kCompactBlock, last),
            by = std::min(y / kCompactBlock, last);
  const Block b = blockAt(cells, bx, by);
  const auto index = static_cast<uint32_t>(by * (last + 1) + bx), odd = index & 1, first = index / 2 * 3;
  const uint32_t plane = texelAt(packed, first + 2 * odd),
                 rest = swapped(texelAt(packed, first + 1) >> (16 * odd) & 0xFFFFu), width = widthOf(rest & 15u);
  const uint32_t bit = width * static_cast<uint32_t>((y - b.y) * b.columns + x - b.x),
                 at = 2 * (rest >> 4) + (bit >> 5), shift = bit & 31u;
  // A block of no residuals has no texel of its own; the last one's would lie behind all texels.
  uint32_t residual = width > 0 ? texelAt(packed, at) >> shift : 0;
  if (shift + width > 32) residual |= texelAt(packed, at + 1) << (32 - shift);
  const int slope_x = static_cast<int8_t>(plane >> 16 & 0xFFu), slope_y = static_cast<int8_t>(plane >> 24);
  return (static_cast<int>(plane & 0xFFFFu) + kSlopeStep * (slope_x * (x - b.x) + slope_y * (y - b.y)) +
          static_cast<int>(residual & ((1u << width) - 1u))) &
         0xFFFF;
}

}  // namespace relievo
