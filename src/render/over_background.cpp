#include "src/render/over_background.h"

#include <cmath>

#include "src/base/srgb.h"

namespace relievo {

std::vector<uint8_t> overBackground(std::span<const uint8_t> rgba, const std::array<uint8_t, 3>& background) {
  std::vector<uint8_t> rgb(rgba.size() / 4 * 3);
  for (size_t i = 0; i < rgb.size() / 3; ++i) {
    const uint8_t alpha = rgba[4 * i + 3];
    for (size_t c = 0; c < 3; ++c) {
      const uint8_t colour = rgba[4 * i + c];
      if (alpha == 0 || alpha == 255) {
        rgb[3 * i + c] = alpha ? colour : background[c];
        continue;
      }
      const double share = alpha / 255.0;
      const double light = share * linearFromSrgb(colour / 255.0) + (1 - share) * linearFromSrgb(background[c] / 255.0);
      rgb[3 * i + c] = static_cast<uint8_t>(std::lround(255 * srgbFromLinear(light)));
    }
  }
  return rgb;
}

}  // namespace relievo
