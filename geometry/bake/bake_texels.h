// bake_texels.h - what of a scan lies on the patches: colours and normals, or the planes of an image.
// Shape: a patch's side has 128 << depth texels; planes one after the other, rows of v from 0. Const: any thread.
#pragma once

#include <cstdint>
#include <span>

#include "geometry/bake/bake_ground.h"
#include "geometry/bake/baked_heights.h"
#include "geometry/bake/plane_image.h"

namespace relievo {

struct BakeTexture {
  PlaneImage image;
  bool planes = false;  // the image's channels are the texture
  int depth = 0;
  int tone_log2 = 0;  // colours and normals: this fine a grid is looked up; or texel by texel
};
// Depth and tone_log2. wanted_depth: -1 is as fine as the colours.
void chooseTexelSize(const BakeGround& ground, int wanted_depth, BakeTexture& texture);

// deviation_mm: how far the baked surface is from the scan. False: interrupted.
bool bakeTexels(const BakeGround& ground, const BakedHeights& baked, const BakeTexture& texture, double deviation_mm,
                uint32_t patch, std::span<uint8_t> out);

}  // namespace relievo
