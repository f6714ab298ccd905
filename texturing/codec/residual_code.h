// residual_code.h - what texel_code.h and tail_code.h share: what a texel differs by from its prediction, range coded
// in contexts (texturing/PACKAGE.md, "Hierarchical relief", Residuals). An encoder and a decoder are the same code over
// another Coder (relief_levels.h).
#pragma once

#include <algorithm>
#include <bit>
#include <cstdint>
#include <cstdlib>

#include "texturing/codec/relief_levels.h"

namespace relievo::residual_code {

inline constexpr int kBuckets = 16, kWidths = 8;

// Residuals of one kind.
struct Models {
  BitModel zero[kBuckets], sign[3], larger[kBuckets][kWidths], mantissa[kWidths + 1][2];
};

// Models that begin as those of relief pages do, for streams too short to learn from nothing.
constexpr Models firstModels() {
  Models m;
  for (int b = 0; b < kBuckets; ++b) {
    relief_levels::begin(m.zero[b], relief_levels::kZeros[b]);
    for (int c = 1; c < kWidths; ++c) m.larger[b][c] = relief_levels::kFirstModels.larger[b][c];
  }
  return m;
}

// around: the sum of sizes around; slope: of the sum of the residuals before, the sign. residual: at most 255 in size,
// as is what any bytes decode to.
template <class Coder>
int code(Coder& coder, Models& m, uint32_t around, int slope, int residual) {
  const int bucket = std::min(relief_levels::bucketOf(around), kBuckets - 1);
  if (!coder.bit(m.zero[bucket], residual != 0)) return 0;
  const bool negative = coder.bit(m.sign[slope < 0 ? 0 : slope > 0 ? 2 : 1], residual < 0);
  const auto size = static_cast<uint32_t>(std::abs(residual));
  const int known = static_cast<int>(std::bit_width(size));
  int width = 1;
  while (width < kWidths && coder.bit(m.larger[bucket][width], known > width)) ++width;
  uint32_t value = 1;
  int left = width - 1;
  for (int k = 0; k < 2 && left > 0; ++k) {
    --left;
    value = value << 1 | static_cast<uint32_t>(coder.bit(m.mantissa[width][k], size >> left & 1));
  }
  if (left > 0) value = value << left | coder.plain(size & ((1u << left) - 1), left);
  return negative ? -static_cast<int>(value) : static_cast<int>(value);
}

}  // namespace relievo::residual_code
