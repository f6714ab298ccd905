// tail_textures.h - the tails of an artwork's patches (texturing/package/patch_tails.h) as tables: heights for
// patch.vert, blocks of texels for shade.frag.
#pragma once

#include <cstdint>

#include "src/artwork/base_mesh.h"
#include "src/gl/program.h"
#include "src/render/texel_table.h"
#include "texturing/package/patch_tails.h"

namespace relievo {

class TailTextures {
 public:
  static constexpr int kHeightUnit = 12, kTexelUnit = 13;  // texture units

  // How many patches this context has room for.
  static uint64_t maxPatches(int planes);
  explicit TailTextures(const PatchTails& tails);  // uploads the heights
  // The texels are in rows although the context has buffer textures: they are too many for one. Programs need TAIL_ROWS
  // then.
  bool inRows() const { return rows_; }
  // The texels of all planes; again whenever other planes are shown, or the light that they were resolved for changes.
  void setTexels(const PatchTails& tails, const BaseMesh& base);
  // reach: texture levels, at most kTailReach, coarser than the root's own over which the root gives way to the tail.
  void bind(const gl::Program& program, double reach) const;

 private:
  TexelTable heights_{"tails: heights", TexelTable::Texel::kUint16}, texels_;
  uint32_t patches_ = 0;
  bool rows_ = false;
};

// Where the tail's finest level has a texel a pixel: 128 texels are 16.
inline constexpr double kTailReach = 3;

}  // namespace relievo
