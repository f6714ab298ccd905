// mesh_lod.h - the level of detail (lod.h) of artworks over a base mesh. It differs from that of flat artworks as
// follows:
// - PatchInstance::x0, y0 count from the patch's corner (0, 0), in units of its finest relief cells: 0 to
//   128 << relief_depth along u and v.
// - Every vertex is a sample of the page that displaces it. Heights are never interpolated, so that both sides of an
//   edge have the same bits.
// - Errors are distances in space from the finest surface at the same (u, v) (texturing/package/patch_source.h).
// - Grids may have a single cell: 0 <= PatchInstance::grid_level <= kMaxGridLevel.
// - With tails any page may be requested. Without them only pages below the roots are, and pages of level 0 count as
//   resident.
// - Nodes are balanced 2:1 across patch borders, too, where sides may run in either direction (base_mesh.h).
//
// Pure but for its scratch memory: one thread at a time.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "geometry/lod/lod.h"
#include "src/artwork/base_mesh.h"

namespace relievo {

class MeshLod {
 public:
  // coarse: by patch; empty, or an entry of it not finite: the diagonal of the patch's displaced bounds. tails: grids
  // of up to 2^kTailCellsLog2 cells a patch's side have their heights without a page, and instances drawn from them
  // have a relief_page of kTailLevel.
  MeshLod(std::shared_ptr<const BaseMesh> base, int relief_depth, double relief_offset_mm, double relief_scale_mm,
          std::shared_ptr<const ReliefOracle> oracle, std::vector<CoarseErrors> coarse = {}, bool tails = false);
  ~MeshLod();
  // view.exaggerate multiplies heights; view.relief false: the base mesh itself, as fine as its bilinear patches ask
  // for.
  LodResult select(const LodView& view, const ReliefSet& resident);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace relievo
