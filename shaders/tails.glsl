// tails.glsl - what of a patch is there without a page: texels of few levels (texturing/package/patch_tails.h,
// src/render/tail_textures.h). Constants are compared with those by a test. A texel has the channels of a plane in the
// lowest three bytes of a word.
#include "texel_table.glsl"

const int kTailLevels = 4;         // of 16, 8, 4 and 2 texels a side, in blocks with a border of one
const float kTailFinest = 3.0;     // texture levels between the root's texels and the tail's finest
uniform TAIL_TABLE u_tails;        // level by level, patch by patch
uniform uint u_tail_patches;
uniform float u_tail_reach;        // texture levels beyond the root's over which the root gives way to the tail

// How much of the tail shows, at a texture LOD that lies `beyond` the root's.
float tailShare(float beyond) { return clamp(beyond / u_tail_reach, 0.0, 1.0); }

// Texels of a patch before a level.
uint tailBlockAt(int level) { return level == 0 ? 0u : level == 1 ? 324u : level == 2 ? 424u : 460u; }

// Two planes are fetched at once where they come in pairs.
#if PLANES % 2 == 0
#define TAIL_WORDS 2
#else
#define TAIL_WORDS 1
#endif
struct TailTexel {
  vec3 planes[TAIL_WORDS];  // 0..255
};
TailTexel tailTexel(uint at) {
  uvec4 words = TAIL_TEXEL(u_tails, at);
  TailTexel t;
  for (int k = 0; k < TAIL_WORDS; ++k) t.planes[k] = vec3(uvec3(words[k], words[k] >> 8u, words[k] >> 16u) & 255u);
  return t;
}

// At uv of the patch.
void filterTailLevel(uint patch_index, vec2 uv, int level, out vec3 channels[PLANES]) {
  const uint kGroups = uint(PLANES / TAIL_WORDS);
  uint side = uint(16 >> level) + 2u;
  uint first = u_tail_patches * tailBlockAt(level) + patch_index * (side * side);
  vec2 p = uv * float(16 >> level) + 0.5;
#ifdef NEAREST
  // The finest level stands for all pages that a patch does not have: these show what a bilinear filter makes of it.
  if (level > 0) p = min(floor(p + 0.5), vec2(float(16 >> level)));
#endif
  vec2 corner = floor(p);
  vec2 f = p - corner;
  uint at = (first + uint(corner.y) * side + uint(corner.x)) * kGroups;
  for (uint g = 0u; g < kGroups; ++g) {
    TailTexel t00 = tailTexel(at + g), t10 = tailTexel(at + kGroups + g);
    TailTexel t01 = tailTexel(at + side * kGroups + g), t11 = tailTexel(at + (side + 1u) * kGroups + g);
    for (int k = 0; k < TAIL_WORDS; ++k) {
      vec3 top = t00.planes[k] + (t10.planes[k] - t00.planes[k]) * f.x;
      vec3 bottom = t01.planes[k] + (t11.planes[k] - t01.planes[k]) * f.x;
      channels[int(g) * TAIL_WORDS + k] = top + (bottom - top) * f.y;
    }
  }
}
