// composition.frag - pictures of several artworks, seen through the same camera, into one (src/render/composition.h):
// at each pixel the nearest first, and what it does not cover shows the next. CPU reference: stage_gltest.cpp.
#include "srgb.glsl"

uniform sampler2DArray u_colours;  // sRGB, not multiplied by alpha, which is the share that shows the artwork
uniform sampler2DArray u_depths;
uniform int u_count;
uniform vec2 u_nearness[MOST_LAYERS];  // of the far plane, and what the near plane has more
uniform float u_reversed;              // 1: depth is 1 at the near plane; 0: at the far plane
uniform vec4 u_behind;                 // alpha 1: what shows where no artwork is, in linear light; 0: alpha is kept

out vec4 o_colour;

// Grows towards the viewer, and is the same measure for all artworks.
float nearnessOf(int layer, ivec2 pixel) {
  float depth = texelFetch(u_depths, ivec3(pixel, layer), 0).r;
  float towards = u_reversed > 0.5 ? depth : 1.0 - depth;  // to half of 2^-24, a step of the depth
  return u_nearness[layer].x + towards * u_nearness[layer].y;
}

void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  uint taken = 0u;
  vec3 light = vec3(0.0);
  float left = 1.0;
  vec4 only = vec4(0.0);  // where no more than one shows: its bytes as they are
  int shown = 0;
  for (int rank = 0; rank < u_count && left > 0.0; ++rank) {
    int best = -1;
    float nearest = 0.0;
    vec4 colour = vec4(0.0);
    for (int i = 0; i < u_count; ++i) {
      if ((taken & (1u << uint(i))) != 0u) continue;
      vec4 one = texelFetch(u_colours, ivec3(pixel, i), 0);
      if (one.a == 0.0) continue;
      float nearness = nearnessOf(i, pixel);
      if (best >= 0 && nearness <= nearest) continue;
      best = i;
      nearest = nearness;
      colour = one;
    }
    if (best < 0) break;
    only = colour;
    ++shown;
    if (rank == 0 && colour.a == 1.0) break;
    taken |= 1u << uint(best);
    light += left * colour.a * linearFromSrgb(colour.rgb);
    left *= 1.0 - colour.a;
  }
  float covered = 1.0 - left;
  if (shown == 1 && (u_behind.a == 0.0 || only.a == 1.0)) o_colour = only;
  else if (u_behind.a > 0.0) o_colour = vec4(srgbFromLinear(light + left * u_behind.rgb), 1.0);
  else o_colour = covered > 0.0 ? vec4(srgbFromLinear(light / covered), covered) : vec4(0.0);
}
