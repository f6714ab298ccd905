// tails.glsl - what of a patch is there without a page: texels of few levels (texturing/package/patch_tails.h,
// src/render/tail_textures.h). Constants are compared with those by a test. A texel has the channels of a plane in the
// lowest three bytes of a word.
#include "texel_table.glsl"

const int kTailLevels = 4;      // of 16, 8, 4 and 2 texels a side, in blocks with a border of one
const float kTailFinest = 3.0;  // texture levels between the root's texels and the tail's finest
// Two planes are fetched at once, and share levels, where they come in pairs.
#if defined(TAIL_PAIRS) && PLANES % 2 == 0
#define TAIL_WORDS 2
#else
#define TAIL_WORDS 1
#endif
#define TAIL_GROUPS (PLANES / TAIL_WORDS)
// First each patch's ranks, by group; then by group and level the blocks of the first so many by rank.
uniform TAIL_TABLE u_tails;
uniform uvec4 u_tail_first[TAIL_GROUPS];  // where a group's levels begin
uniform uvec4 u_tail_held[TAIL_GROUPS];   // how many patches have them
uniform float u_tail_reach;               // texture levels beyond the root's over which the root gives way to the tail

// How much of the tail shows, at a texture LOD that lies `beyond` the root's.
float tailShare(float beyond) { return clamp(beyond / u_tail_reach, 0.0, 1.0); }

struct TailTexel {
  vec3 planes[TAIL_WORDS];  // 0..255
};
TailTexel tailTexel(uint at) {
  uvec4 words = TAIL_TEXEL(u_tails, at);
  TailTexel t;
  for (int k = 0; k < TAIL_WORDS; ++k) t.planes[k] = vec3(uvec3(words[k], words[k] >> 8u, words[k] >> 16u) & 255u);
  return t;
}

uint tailRank(int group, uint patch_index) {
  return TAIL_TEXEL(u_tails, patch_index * uint(TAIL_GROUPS) + uint(group)).r;
}

// At uv of the patch. Where it has no such level, the finest that it has shows as much.
TailTexel filterTail(int group, uint rank, vec2 uv, int level) {
  uvec4 held = u_tail_held[group];
  int finest = int(rank >= held.x) + int(rank >= held.y) + int(rank >= held.z);
  int shown = max(level, finest);
  uint side = uint(16 >> shown) + 2u;
  vec2 p = uv * float(16 >> shown) + 0.5;
#ifdef NEAREST
  // The finest level stands for all pages that a patch does not have: these show what a bilinear filter makes of it.
  if (level > 0 && level == shown) p = min(floor(p + 0.5), vec2(float(16 >> shown)));
#endif
  vec2 corner = floor(p);
  vec2 f = p - corner;
  uint at = u_tail_first[group][shown] + (rank * side + uint(corner.y)) * side + uint(corner.x);
  TailTexel t00 = tailTexel(at), t10 = tailTexel(at + 1u), t01 = tailTexel(at + side), t11 = tailTexel(at + side + 1u);
  TailTexel out_texel;
  for (int k = 0; k < TAIL_WORDS; ++k) {
    vec3 top = t00.planes[k] + (t10.planes[k] - t00.planes[k]) * f.x;
    vec3 bottom = t01.planes[k] + (t11.planes[k] - t01.planes[k]) * f.x;
    out_texel.planes[k] = top + (bottom - top) * f.y;
  }
  return out_texel;
}
