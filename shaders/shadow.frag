// shadow.frag - the share of the light that reaches each pixel of the surface (src/render/shadow_pass.h).
#include "shadow_map.glsl"

uniform mat4 u_map_from_pixel;  // from a pixel's place and depth, 0..1, to texels of the map and its depth
// Texels a side of the map; 1 where a larger depth is nearer to the light, else -1; bias, and more of it for each depth.
uniform vec4 u_shadow;
uniform vec4 u_part;  // texels, low and high, between which the map counts

#ifdef SHADOW_SUMS
uniform highp usampler2D u_sums;  // as shadow_sum.frag's
uniform float u_more;             // 0: there are none before
out uvec2 o_sums;
#else
out vec4 o_light;
#endif

bool placeAt(ivec2 pixel, out vec3 place) {
  float depth;
  if (!depthAt(pixel, depth)) return false;
  vec4 p = u_map_from_pixel * vec4((vec2(pixel) + 0.5) / vec2(textureSize(u_depth, 0)), depth, 1.0);
  place = p.xyz / p.w;
  return p.w > 0.0;  // else it lies behind the light
}

// From a pixel to its neighbour on the same surface: of the two, the one whose depth differs less.
vec3 along(ivec2 pixel, ivec2 axis, vec3 here) {
  vec3 a, b;
  bool has_a = placeAt(pixel + axis, a), has_b = placeAt(pixel - axis, b);
  if (has_a && (!has_b || abs(a.z - here.z) <= abs(b.z - here.z))) return a - here;
  return has_b ? here - b : vec3(0.0);
}

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
#ifdef SHADOW_SUMS
  o_sums = u_more > 0.0 ? texelFetch(u_sums, pixel, 0).xy : uvec2(0u);
#else
  o_light = vec4(1.0);
#endif
  vec3 here;
  bool counts = placeAt(pixel, here);
  if (!counts || any(lessThan(here.xy, u_part.xy)) || any(greaterThan(here.xy, u_part.zw))) {
#ifdef SHADOW_SUMS
    return;
#else
    discard;
#endif
  }
  vec3 dx = along(pixel, ivec2(1, 0), here), dy = along(pixel, ivec2(0, 1), here);
  float bias = u_shadow.z + u_shadow.w * here.z;
  float light = lightAt(here, dx, dy, ivec2(0), ivec2(int(u_shadow.x) - 1), u_shadow.y, bias);
#ifdef SHADOW_SUMS
  o_sums += uvec2(vec2(light, 1.0) * 65536.0 + 0.5);
#else
  o_light = vec4(light);
#endif
}
