// texture_resolution.h - how many texels a patch has, and how densely these are sampled, so that they keep the detail
// of the scan's colours.
#pragma once

#include "geometry/bake/bake_context.h"
#include "geometry/bake/bake_texels.h"

namespace relievo {

// Sets texture.depth and texture.of_patch. tails: a patch may have kNoTexturePage. requested_depth: of all patches; -1:
// each patch is as fine as the image is there, in the direction in which it has more texels, as far as all patches'
// texels are not too many; without an image all are as fine as the scan's vertices, but for smooth ones of one colour
// among few triangles, which their tails show. False: the bake was interrupted.
bool chooseTextureResolution(const BakeContext& context, int requested_depth, bool tails, BakeTexture& texture);

}  // namespace relievo
