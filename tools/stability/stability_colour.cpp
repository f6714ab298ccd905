#include <array>
#include <cstdint>

#include "src/base/srgb.h"
#include "src/engine/effects/effects.h"
#include "texturing/codec/mip.h"
#include "tools/stability/stability.h"

namespace relievo {
namespace {

// Every value of 16 bits to linear light and back.
StabilityErrors roundTrip() {
  StabilityErrors out;
  for (int k = 0; k <= 65535; ++k) {
    const double encoded = k / 65535.0, linear = linearFromSrgb(encoded);
    out.add(255 * (srgbFromLinear(linear) - encoded), 255 * (std::pow(linear, 1 / 2.2) - encoded));
  }
  return out;
}

// Light texels beside dark ones: their mean is that of the light, not that of the bytes.
StabilityErrors meanOfLight() {
  const MipFilter mip{TextureFormat{}};
  StabilityErrors out;
  for (int dark = 0; dark < 256; dark += 5)
    for (int light = dark; light < 256; light += 5) {
      std::array<uint8_t, 12> texels;
      for (size_t c = 0; c < 3; ++c)
        for (size_t i = 0; i < 4; ++i) texels[4 * c + i] = static_cast<uint8_t>(i % 3 ? light : dark);
      std::array<uint16_t, 3> mean;
      mip.downsample(texels.data(), 2, 2, mean.data());
      const double truth =
          255 * srgbFromLinear(0.5 * linearFromSrgb(dark / 255.0) + 0.5 * linearFromSrgb(light / 255.0));
      for (const uint16_t m : mean) out.add(m / 256.0 - truth, 0.5 * (dark + light) - truth);
    }
  return out;
}

// Ten stops up, and the tone curve that brings the brightest back to white.
StabilityErrors tenStops() {
  StabilityErrors out;
  for (const double stops : {-10.0, 0.0, 10.0})
    for (const double white : {1.0, 100.0})
      for (int k = 0; k <= 255; ++k) {
        const glm::dvec3 colour(k / 255.0);
        const long double encoded = k / 255.0L,
                          linear = encoded <= 0.04045L ? encoded / 12.92L : powl((encoded + 0.055L) / 1.055L, 2.4L),
                          light = linear * exp2l(static_cast<long double>(stops)),
                          toned = light * (1 + light / (static_cast<long double>(white) * white)) / (1 + light);
        const auto truth =
            static_cast<double>(toned <= 0.0031308L ? 12.92L * toned : 1.055L * powl(toned, 1 / 2.4L) - 0.055L);
        out.add(255 * (kExposureEffect.reference(colour, {stops, white})[0] - truth),
                255 * (std::min(1.0, colour[0] * std::exp2(stops)) - truth));
      }
  return out;
}

constexpr StabilityCase kColourCases[] = {
    {"sRGB to linear light and back, 65,536 values", "the same value", "a power of 2.2 for one of the two", "of 255",
     1e-9, roundTrip},
    {"the mean of light and dark texels", "the mean of their light", "the mean of their bytes", "of 255", 0.55,
     meanOfLight},
    {"exposure of -10 to 10 stops", "light x 2^stops, toned, in extended precision", "encoded colours multiplied",
     "of 255", 1e-6, tenStops},
};

}  // namespace

std::span<const StabilityCase> colourStability() { return kColourCases; }

}  // namespace relievo
