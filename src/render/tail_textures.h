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
  // True: the texels lie in rows of an array texture, although the context has buffer textures, because they are too
  // many for one. Programs need the define TAIL_ROWS then.
  bool inRows() const { return rows_; }
  // Uploads the texels of all planes. Call it again whenever other planes are shown, or the fixed light changes.
  // ends: as TailBlocks has it.
  void setTexels(const PatchTails& tails, const BaseMesh& base, GutterEnds ends = {});
  // reach: texture levels, at most kTailReach, coarser than the root's own over which the root gives way to the tail.
  void bind(const gl::Program& program, double reach) const;

 private:
  TexelTable heights_{"tails: heights", TexelTable::Texel::kUint16}, texels_;
  uint32_t patches_ = 0;
  bool rows_ = false;
};

// How many levels coarser than the root's the tail's finest level is: 128 texels >> 3 are 16.
inline constexpr double kTailReach = 3;

}  // namespace relievo
