// bake_texels.h - the texture of a patch: the scan's colours and normals, or the channels of its image.
// Shape: a patch has 128 << its depth texels a side; one plane for each channel, rows of v from 0. Const: any thread.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "geometry/bake/bake_context.h"
#include "geometry/bake/baked_heights.h"
#include "geometry/bake/mip_image.h"

namespace relievo {

struct PatchResolution {
  int depth = 0;
  int sample_grid_log2 = 0;  // colours and normals are sampled on a grid of 2^this cells and interpolated, but for
                             // cells that a crease or the border of a palette's colours crosses; at least the texels:
                             // at each texel
};
struct BakeTexture {
  MipImage image;
  bool planes = false;   // the image's channels become the texture, in place of colour and normal
  bool palette = false;  // of colours that whole triangles have
  // texture_resolution.h
  int depth = 0;                          // the largest of all patches
  std::vector<PatchResolution> of_patch;  // one for each
};

// Fills the texels of one patch. deviation_mm: the distance between baked surface and scan, which bounds the search.
// False: the bake was interrupted.
bool bakeTexels(const BakeContext& context, const BakedHeights& baked, const BakeTexture& texture, double deviation_mm,
                uint32_t patch, std::span<uint8_t> out);

}  // namespace relievo
