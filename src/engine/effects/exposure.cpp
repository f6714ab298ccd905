// exposure.cpp - how much light reaches the picture, and how its brightest places are brought back into range. Colours
// are taken as sRGB (IEC 61966-2-1): made linear, multiplied by 2^stops, compressed by L (1 + L / W^2) / (1 + L)
// (Reinhard, Stark, Shirley, Ferwerda 2002, Photographic Tone Reproduction for Digital Images, eq. 4, channel by
// channel; W = 1: as it is) and encoded again. GLSL: shaders/effects/exposure.glsl.
#include <cmath>

#include "src/engine/effects/effects.h"

namespace relievo {
namespace {

double linear(double encoded) {
  return encoded <= 0.04045 ? encoded / 12.92 : std::pow((encoded + 0.055) / 1.055, 2.4);
}
double encoded(double linear) {
  return linear <= 0.0031308 ? 12.92 * linear : 1.055 * std::pow(linear, 1 / 2.4) - 0.055;
}

glm::dvec3 exposed(const glm::dvec3& colour, const PixelEffect::Values& values) {
  glm::dvec3 out;
  for (int c = 0; c < 3; ++c) {
    const double light = linear(std::max(colour[c], 0.0)) * std::exp2(values[0]);
    out[c] = encoded(light * (1 + light / (values[1] * values[1])) / (1 + light));
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
