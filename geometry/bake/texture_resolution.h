// texture_resolution.h - how many texels a patch has, and how densely these are sampled, so that they keep the detail
// of the scan's colours.
#pragma once

#include "geometry/bake/bake_context.h"
#include "geometry/bake/bake_texels.h"

namespace relievo {

struct TextureResolutionOptions {
  int requested_depth = -1;  // of all patches
  bool tails = false;        // a patch may have kNoTexturePage
  bool show_images = false;  // images may be shown by patches themselves
};
// Sets texture.depth, texture.of_patch and BakeTexture::Image::shown. Without a requested depth each patch is as fine
// as the image is there, in the direction in which it has more texels, as far as all patches' texels are not too many;
// without an image all are as fine as the scan's vertices, but for smooth ones of one colour among few triangles, which
// their tails show. False: the bake was interrupted.
bool chooseTextureResolution(const BakeContext& context, const TextureResolutionOptions& options, BakeTexture& texture);

// Of a patch on whose halves triangles with images lie (BakeContext::own_triangles).
ImagesOnPatch imagesOnPatch(const BakeContext& context, const BakeTexture& texture, uint32_t patch);

}  // namespace relievo
