// kept_tails.h - the tails of an artwork's patches (patch_tails.h) as they stay in memory: of each plane of a patch the
// levels from the coarsest one on that shows the finest as well, within a tolerance. Most patches of a scan's own
// triangles need 2 x 2 texels of what has 16 x 16.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "src/artwork/base_mesh.h"
#include "texturing/package/crease_gutter.h"
#include "texturing/package/patch_tails.h"

namespace relievo {

// Of 255: by so much the finest level may differ from what a coarser one shows there, filtered bilinearly and rounded;
// normals' components by kTailNormals times as much, as of two triangles that are no bilinear patch.
inline constexpr int kTailTolerance = 1, kTailNormals = 3;
struct KeptTailTolerance {
  int of_255 = kTailTolerance;
  bool normals = false;  // hasNormals()
  int ofPlane(int plane) const;
};

class KeptTails {
 public:
  static constexpr uint32_t kChunkPatches = 256;

  KeptTails() = default;
  // Until any are kept, all texels and heights are 0.
  KeptTails(uint32_t patches, int channels, KeptTailTolerance tolerance = {});
  // Of all patches; not explicit: who has whole tails hands over these.
  KeptTails(const PatchTails& tails, KeptTailTolerance tolerance = {});

  // Tails of patches first .. first + tails.patches: of one chunk, all that it has. Chunks may be kept on several
  // threads.
  void keep(uint32_t first, const PatchTails& tails);
  // The same for three channels, of levels that are told: levels(patch), counted from the artwork's first.
  template <class Levels>
  void keepLevels(uint32_t first, const PatchTails& tails, Levels&& levels) {
    Chunk& chunk = startChunk(first, tails);
    for (uint32_t p = 0; p < tails.patches; ++p) keepPlane(chunk, tails, p, 0, levels(first + p));
  }
  void addFailures(const PageFailures& failures) { failures_.add(failures); }
  const PageFailures& failures() const { return failures_; }

  uint32_t patches() const { return patches_; }
  int planes() const { return channels_ / 3; }
  // Three channels of a patch.
  struct Plane {
    const uint8_t* texels;
    int finest;  // the finest level that is kept; 0: all are
    // At least the finest: rows of v from 0, texels in a row.
    const uint8_t* level(int level, int channel) const;
    // Of whatever level: of one that is not kept, what the finest one shows.
    uint8_t at(int level, int channel, int x, int y) const;
    std::array<uint8_t, 3> at(int level, int x, int y) const;
  };
  Plane plane(uint32_t patch, int plane) const {
    const Chunk& chunk = chunks_[patch / kChunkPatches];
    const size_t i = (patch % kChunkPatches) * planesSize() + static_cast<size_t>(plane);
    return {chunk.texels.data() + chunk.at[i], chunk.finest[i]};
  }
  uint16_t height(uint32_t patch, size_t sample /* below kTailHeights */) const {
    const std::vector<uint16_t>& heights = chunks_[patch / kChunkPatches].heights;
    return heights.size() == 1 ? heights[0] : heights[(patch % kChunkPatches) * kTailHeights + sample];
  }
  bool heightsAreEven() const;  // one height, everywhere
  template <class Change>
  void changeHeights(Change&& change) {
    for (Chunk& chunk : chunks_)
      for (uint16_t& height : chunk.heights) height = change(height);
  }
  // Patches first .. first + count with all levels.
  PatchTails whole(uint32_t first, uint32_t count) const;
  uint64_t bytes() const;

 private:
  struct Chunk {
    std::vector<uint8_t> finest;    // patch by patch, plane by plane
    std::vector<uint32_t> at;       // as many: where they begin in texels
    std::vector<uint8_t> texels;    // of a plane level by level, channel by channel
    std::vector<uint16_t> heights;  // one: all are the same
  };
  size_t planesSize() const { return static_cast<size_t>(planes()); }
  Chunk& startChunk(uint32_t first, const PatchTails& tails);
  static void keepPlane(Chunk& chunk, const PatchTails& tails, uint32_t patch, int plane, int finest);

  uint32_t patches_ = 0;
  int channels_ = 0;
  KeptTailTolerance tolerance_;
  std::vector<Chunk> chunks_;
  PageFailures failures_;  // root pages, and those whose images, some of them should have been made of
};

// For a fixed light: of each patch the levels from the finest one on that any of the planes has which it is made of.
KeptTails resolvedTails(const KeptTails& tails, const TextureFormat& format, const std::array<double, 3>& light);
KeptTails planeOfTails(const KeptTails& tails, int plane);

// Blocks of patches of a base mesh, as shaders read them; const and thread-safe. A level's border has the texels of the
// patches around. That of the finest level that is kept stands for finer ones: with it patches filter to the mean of
// what both go on to at their common side, as those do.
class TailBlocks {
 public:
  // Both outlive it.
  TailBlocks(const KeptTails& tails, const BaseMesh& base, GutterEnds ends = {});
  // Rows of a level's texels, each a word: channels 3 * plane .. 3 * plane + 2, the first in the lowest byte.
  void write(uint32_t patch, int level, int plane, uint32_t* out /* tailBlockTexels(level) */) const;

 private:
  using Texel = std::array<uint8_t, 3>;
  static constexpr int kCoarsest = kTailLevels - 1;
  // That all patches have everywhere, if they do.
  std::optional<Texel> evenTexel(int plane) const;
  Texel onSide(const KeptTails::Plane& of, int level, size_t side, int along, bool itself) const;
  Texel onCorner(const KeptTails::Plane& of, int level, size_t corner, bool itself) const;
  Texel beyond(uint32_t patch, size_t side, int along, int level, int plane, bool itself, const GutterEnds& ends) const;
  Texel beyondCorner(uint32_t patch, size_t corner, int level, int plane, bool itself) const;
  const KeptTails& tails_;
  const BaseMesh& base_;
  GutterEnds ends_;
  std::vector<PatchNeighbours> neighbours_;
  std::vector<uint32_t> first_,
      at_;  // the corners of patches that meet at corner c of the mesh: at_[first_[c]] .. as patch * 4 + corner
  std::vector<std::optional<Texel>> even_;            // by plane
  std::vector<std::vector<Texel>> coarsest_corners_;  // by plane, of its patches' corners: what that level goes on to
};

}  // namespace relievo
