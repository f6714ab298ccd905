// tails.glsl - what of a patch is there without a page: texels of few levels (texturing/patch_tails.h, src/render/tail_textures.h). Constants are
// compared with those by a test.
const int kTailLevels = 4;         // of 16, 8, 4 and 2 texels a side, in a tile of 18 x 28 texels a plane, each with a border of one
const float kTailFinest = 3.0;     // texture levels between the root's texels and the tail's finest
uniform sampler2DArray u_tails;    // 64 x 32 tiles a layer, planes one after the other
uniform int u_tail_layers;         // of a plane
uniform float u_tail_reach;        // texture levels beyond the root's over which the root gives way to the tail

// How much of the tail shows, at a texture LOD that lies `beyond` the root's.
float tailShare(float beyond) { return clamp(beyond / u_tail_reach, 0.0, 1.0); }

// A patch's tile of plane 0, and where a level begins in a tile, its border left out.
ivec3 tailTile(uint patch_index) {
  return ivec3(int(patch_index & 63u) * 18, int((patch_index >> 6u) & 31u) * 28, int(patch_index >> 11u));
}
ivec2 tailLevelAt(int level) { return level == 0 ? ivec2(1, 1) : level == 1 ? ivec2(1, 19) : level == 2 ? ivec2(11, 19) : ivec2(11, 25); }

// At p, in texels of the tile; channels 0..255.
vec3 filterTail(ivec3 tile, vec2 p) {
#if defined(NEAREST)
  return texelFetch(u_tails, tile + ivec3(ivec2(p), 0), 0).rgb * 255.0;
#elif defined(FAST_FILTER)
  return textureLod(u_tails, vec3((vec2(tile.xy) + p) / vec2(textureSize(u_tails, 0).xy), float(tile.z)), 0.0).rgb * 255.0;
#else
  vec2 corner = floor(p - 0.5);
  vec2 f = p - 0.5 - corner;
  ivec3 at = tile + ivec3(ivec2(corner), 0);
  vec3 c00 = texelFetch(u_tails, at, 0).rgb;
  vec3 c10 = texelFetch(u_tails, at + ivec3(1, 0, 0), 0).rgb;
  vec3 c01 = texelFetch(u_tails, at + ivec3(0, 1, 0), 0).rgb;
  vec3 c11 = texelFetch(u_tails, at + ivec3(1, 1, 0), 0).rgb;
  vec3 top = c00 + (c10 - c00) * f.x;
  vec3 bottom = c01 + (c11 - c01) * f.x;
  return (top + (bottom - top) * f.y) * 255.0;
#endif
}
