// compare_relief.glsl - a vertex's height for the strategies' shaders, where vertices are always samples of their page.
#include "common.glsl"

// local: units from the page's corner. A vertex at or beyond the border takes the next sample at or beyond it, as in patch.vert.
float heightSteps(int slot, ivec2 local, int spacing_log2, bvec2 at_border) {
  int mask = (1 << spacing_log2) - 1;
  if (at_border.x) local.x = (local.x + mask) & ~mask;
  if (at_border.y) local.y = (local.y + mask) & ~mask;
  vec4 texel = texelFetch(u_pool, slotOrigin(slot) + ivec3(local >> spacing_log2, 0), 0);
  return float(int(texel.r * 255.0 + 0.5) * 256 + int(texel.g * 255.0 + 0.5));
}
