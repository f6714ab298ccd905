#include "src/render/over_background.h"

#include <cmath>

#include "src/base/srgb.h"

namespace relievo {

namespace {

void blend(const uint8_t* rgba, const std::array<uint8_t, 3>& background, uint8_t* rgb) {
  const double share = rgba[3] / 255.0;
  for (size_t c = 0; c < 3; ++c) {
    const double light = share * linearFromSrgb(rgba[c] / 255.0) + (1 - share) * linearFromSrgb(background[c] / 255.0);
    rgb[c] = static_cast<uint8_t>(std::lround(255 * srgbFromLinear(light)));
  }
}

}  // namespace

std::vector<uint8_t> overBackground(std::span<const uint8_t> rgba, const std::array<uint8_t, 3>& background) {
  std::vector<uint8_t> rgb(rgba.size() / 4 * 3);
  const uint8_t* from = rgba.data();
  uint8_t* to = rgb.data();
  for (size_t pixels = rgba.size() / 4; pixels > 0; --pixels, from += 4, to += 3) {
    if (from[3] != 0 && from[3] != 255) {
      blend(from, background, to);
      continue;
    }
    const uint8_t* const whole = from[3] != 0 ? from : background.data();
    for (size_t c = 0; c < 3; ++c) to[c] = whole[c];
  }
  return rgb;
}

}  // namespace relievo
