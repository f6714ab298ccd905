// ambient_occlusion.glsl - less light where less of the sky is seen (CPU reference: occluded() of
// src/engine/effects/ambient_occlusion.h).
#include "srgb.glsl"

uniform sampler2D u_sky_share;  // of each pixel (shadow_mean.frag)
uniform vec4 u_occlusion;       // strength; -; -; -

vec3 occluded(vec3 colour) {
  float share = texelFetch(u_sky_share, ivec2(gl_FragCoord.xy), 0).r;
  return srgbFromLinear(linearFromSrgb(max(colour, 0.0)) * (1.0 - u_occlusion.x * (1.0 - share)));
}
