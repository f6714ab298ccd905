// page_of.h - texture pages from a function of channel and place.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "texturing/codec/page_codec.h"

namespace relievo::testing_support {

// Calls value(channel, x, y) for each texel, border included; rounded and clamped to bytes.
template <class Value>
std::vector<uint8_t> pageOf(Value value) {
  std::vector<uint8_t> out(kTexturePageBytes);
  size_t i = 0;
  for (int c = 0; c < 3; ++c)
    for (int y = 0; y < kPageFullPx; ++y)
      for (int x = 0; x < kPageFullPx; ++x)
        out[i++] = static_cast<uint8_t>(std::clamp(std::lround(value(c, x, y)), 0l, 255l));
  return out;
}

}  // namespace relievo::testing_support
