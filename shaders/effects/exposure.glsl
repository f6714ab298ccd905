// exposure.glsl - exposure and tone (src/engine/effects/exposure.cpp). u_exposure.x: stops; y: the light that becomes
// white.
#include "srgb.glsl"

uniform vec4 u_exposure;

vec3 effect_exposure(vec3 colour, Shaded at) {
  vec3 light = linearFromSrgb(max(colour, 0.0)) * exp2(u_exposure.x);
  light = light * (1.0 + light / (u_exposure.y * u_exposure.y)) / (1.0 + light);
  return srgbFromLinear(light);
}
