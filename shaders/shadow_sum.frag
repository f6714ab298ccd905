// shadow_sum.frag - some of the directions that an area of light or the sky is made of: what of them reaches each pixel
// of the surface is added to the sums of the directions before (src/render/shadow_pass.h). CPU reference of weight and
// share: seenShare() of src/engine/effects/ambient_occlusion.h.
#include "shading.h"
#include "shadow_map.glsl"

uniform highp usampler2D u_sums;  // x: weight times share, y: weight; in units of 1 / kSumOne
uniform mat4 u_eye_from_pixel;    // from a pixel's place and depth, 0..1, to mm from the eye
// 0: the first directions; 1: weights are cosines; 1: the opposite direction counts as dark; 1 where a larger depth of
// a map is nearer to the light, else -1.
uniform vec4 u_sum;
// Of each direction: towards it; bias, below 0: it is dark; and from mm from the eye to texels of the map and its
// depth.
uniform vec4 u_directions[RV_DIRECTIONS];
uniform vec4 u_map_from_eye[3 * RV_DIRECTIONS];
uniform vec4 u_count;  // how many directions; texels a side of the map of each

out uvec2 o_sums;

const float kSumOne = 65536.0;

bool placeAt(ivec2 pixel, out vec3 place, out float depth) {
  if (!depthAt(pixel, depth)) return false;
  vec4 p = u_eye_from_pixel * vec4((vec2(pixel) + 0.5) / vec2(textureSize(u_depth, 0)), depth, 1.0);
  place = p.xyz / p.w;
  return true;
}

// From a pixel to its neighbour on the same surface: of the two, the one whose depth differs less.
vec3 along(ivec2 pixel, ivec2 axis, vec3 here, float depth) {
  vec3 a, b;
  float depth_a, depth_b;
  bool has_a = placeAt(pixel + axis, a, depth_a), has_b = placeAt(pixel - axis, b, depth_b);
  if (has_a && (!has_b || abs(depth_a - depth) <= abs(depth_b - depth))) return a - here;
  return has_b ? here - b : vec3(0.0);
}

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  o_sums = u_sum.x > 0.0 ? texelFetch(u_sums, pixel, 0).xy : uvec2(0u);
  vec3 here;
  float depth;
  if (!placeAt(pixel, here, depth)) return;
  vec3 dx = along(pixel, ivec2(1, 0), here, depth), dy = along(pixel, ivec2(0, 1), here, depth);
  vec3 normal = cross(dx, dy);  // towards the eye
  float size = length(normal);
  int side = int(u_count.y);
  vec2 sum = vec2(0.0);  // of share and weight
  for (int i = 0; i < int(u_count.x); ++i) {
    vec4 direction = u_directions[i];
    float facing = 1.0, weight = 1.0;
    if (u_sum.y > 0.0) {
      facing = size > 0.0 ? dot(normal, direction.xyz) / size : 0.0;
      weight = u_sum.z > 0.0 ? abs(facing) : max(facing, 0.0);
    }
    sum.y += weight;
    if (facing <= 0.0 || direction.w < 0.0) continue;
    vec4 x = u_map_from_eye[3 * i], y = u_map_from_eye[3 * i + 1], z = u_map_from_eye[3 * i + 2];
    mat3 map = mat3(x.x, y.x, z.x, x.y, y.y, z.y, x.z, y.z, z.z);
    ivec2 low = ivec2(i & 1, i >> 1) * side;
    sum.x += weight * lightAt(map * here + vec3(x.w, y.w, z.w), map * dx, map * dy, low, low + side - 1, u_sum.w,
                              direction.w);
  }
  o_sums += uvec2(sum * kSumOne + 0.5);
}
