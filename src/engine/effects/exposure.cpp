// exposure.cpp - how much light reaches the picture, and how its brightest places are brought back into range. Colours
// are taken as sRGB (IEC 61966-2-1): made linear, multiplied by 2^stops, compressed by L (1 + L / W^2) / (1 + L)
// (Reinhard, Stark, Shirley, Ferwerda 2002, Photographic Tone Reproduction for Digital Images, eq. 4, channel by
// channel; W = 1: as it is) and encoded again. GLSL: shaders/effects/exposure.glsl.
#include <cmath>

#include "src/base/srgb.h"
#include "src/engine/effects/effects.h"

namespace relievo {
namespace {

glm::dvec3 exposed(const glm::dvec3& colour, const PixelEffect::Values& values) {
  glm::dvec3 out;
  for (int c = 0; c < 3; ++c) {
    const double light = linearFromSrgb(std::max(colour[c], 0.0)) * std::exp2(values[0]);
    out[c] = srgbFromLinear(light * (1 + light / (values[1] * values[1])) / (1 + light));
  }
  return out;
}

}  // namespace

const PixelEffect kExposureEffect{
    .name = "exposure",
    .help = "exposure and tone",
    .stage = PixelEffect::Stage::kTone,
    .parameters = {{{"exposure", "Light, stops: each doubles it", -10, 10, 0},
                    {"white",
                     "The light that is shown as white, 1: that of the brightest colour a page can have; more "
                     "brings back what --exposure or a PTM makes brighter than that",
                     1, 100, 1}}},
    .reference = exposed};

}  // namespace relievo
