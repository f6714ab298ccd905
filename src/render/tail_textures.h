// tail_textures.h - the tails of an artwork's patches (texturing/patch_tails.h) as textures: heights for patch.vert, tiles of texels for shade.frag.
#pragma once

#include <cstdint>

#include "src/base/base_mesh.h"
#include "src/gl/objects.h"
#include "src/gl/program.h"
#include "texturing/patch_tails.h"

namespace relievo {

class TailTextures {
 public:
  static constexpr int kHeightUnit = 12, kTexelUnit = 13;  // texture units

  // How many patches this context has room for: an array texture's layers.
  static uint64_t maxPatches(int planes);
  explicit TailTextures(const PatchTails& tails);  // uploads the heights
  // The texels of all planes; again whenever other planes are shown, or the light that they were resolved for changes.
  void setTexels(const PatchTails& tails, const BaseMesh& base);
  // reach: texture levels, at most kTailReach, coarser than the root's own over which the root gives way to the tail.
  void bind(const gl::Program& program, double reach) const;

 private:
  gl::Texture heights_, texels_;
  uint32_t patches_ = 0;
};

// Where the tail's finest level has a texel a pixel: 128 texels are 16.
inline constexpr double kTailReach = 3;

}  // namespace relievo
