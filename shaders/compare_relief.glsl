// compare_relief.glsl - a vertex's height for the strategies' shaders, where vertices are always samples of their page.
#include "common.glsl"

// local: units from the page's corner. A vertex at or beyond the border takes the next sample at or beyond it, as in
// patch.vert.
float heightSteps(int relief_place, ivec2 local, int spacing_log2, bvec2 at_border) {
  int mask = (1 << spacing_log2) - 1;
  if (at_border.x) local.x = (local.x + mask) & ~mask;
  if (at_border.y) local.y = (local.y + mask) & ~mask;
  return float(reliefSample(reliefOrigin(relief_place), local >> spacing_log2));
}
