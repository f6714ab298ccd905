// shadow_sum.frag - one direction more of those that an area of light or the sky is made of: what of them reaches each
// pixel of the surface is added to the sums of the directions before (src/render/shadow_pass.h). CPU reference of
// weight and share: seenShare() of src/engine/effects/ambient_occlusion.h.
#include "shadow_map.glsl"

uniform highp usampler2D u_sums;  // x: weight times share, y: weight; in units of 1 / kSumOne
uniform vec4 u_sum;  // 0: the first direction; 1: weights are cosines; 1: the opposite direction counts as dark; 0: no light
uniform vec4 u_map_mm;  // mm of a texel along x and y, and of a unit of depth, towards the light; -

out uvec2 o_sums;

const float kSumOne = 65536.0;

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  o_sums = u_sum.x > 0.0 ? texelFetch(u_sums, pixel, 0).xy : uvec2(0u);
  vec3 here, dx, dy;
  if (!placesAt(pixel, here, dx, dy)) return;
  float facing = 1.0, weight = 1.0;
  if (u_sum.y > 0.0) {
    // The part of the plane's normal along the light is the cosine of the angle between them.
    vec3 normal = cross(dx * u_map_mm.xyz, dy * u_map_mm.xyz);
    float size = length(normal);
    facing = size > 0.0 ? normal.z / size : 0.0;
    weight = u_sum.z > 0.0 ? abs(facing) : max(facing, 0.0);
  }
  float share = facing > 0.0 && u_sum.w > 0.0 ? weight * lightAt(here, dx, dy) : 0.0;
  o_sums += uvec2(vec2(share, weight) * kSumOne + 0.5);
}
