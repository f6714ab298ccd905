// tail_textures.h - the tails of an artwork's patches (texturing/package/kept_tails.h) as tables: heights for
// patch.vert, blocks of texels for shade.frag. For each plane patches have ranks, those with the finest levels first: a
// level has the blocks of the first so many.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "src/gl/program.h"
#include "src/render/texel_table.h"
#include "texturing/package/kept_tails.h"

namespace relievo {

class TailTextures {
 public:
  static constexpr int kHeightUnit = 12, kTexelUnit = 13;  // texture units

  // Has a context room for them? Of so many texels in rows, and in a buffer texture; 0: it has none.
  static bool fit(const KeptTails& tails, uint64_t most_row_texels, uint64_t most_buffer_texels);
  explicit TailTextures(const KeptTails& tails);  // of all planes; uploads the heights
  // True: the texels lie in rows of an array texture, although the context has buffer textures, because they are too
  // many for one. Programs need the define TAIL_ROWS then.
  bool inRows() const { return rows_; }
  // True: where planes come in pairs, two of them share levels, and are fetched at once. Programs need TAIL_PAIRS then.
  bool inPairs() const { return pairs_; }
  // Uploads the texels of all planes. Call it again whenever other planes are shown, or the fixed light changes. ends:
  // as TailBlocks has it.
  void setTexels(const KeptTails& tails, const BaseMesh& base, GutterEnds ends, int workers);
  // reach: texture levels, at most kTailReach, coarser than the root's own over which the root gives way to the tail.
  void bind(const gl::Program& program, double reach) const;
  // On the GPU, with the texels of all planes.
  uint64_t mostBytes() const { return 2 * uint64_t{heights_.size()} + texel_bytes_; }

 private:
  TexelTable heights_{"tails: heights", TexelTable::Texel::kUint16}, texels_;
  uint32_t patches_ = 0, heights_a_patch_ = 0;  // 0: all patches share one grid
  // Of each plane, or pair: where its levels begin in texels_, and how many patches have them.
  std::vector<std::array<uint32_t, kTailLevels>> first_, held_;
  uint64_t texel_bytes_ = 0;  // of all planes
  bool pairs_ = false, rows_ = false;
};

// How many levels coarser than the root's the tail's finest level is: 128 texels >> 3 are 16.
inline constexpr double kTailReach = 3;

}  // namespace relievo
