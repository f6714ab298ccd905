// planar_lod.h - lod.h for flat artworks. Particulars:
//   places  PatchInstance::x0, y0 count from the artwork's top left corner, in units of 2^-kUnitsPerTexelLog2
//           texels; the artwork's longer side, in whole patches, is below 2^27 texels
//   heights are interpolated where a vertex lies between samples of its page (patch_vertex.h)
//   errors  differences of height
//   grids   have at least two cells a side: 1 <= PatchInstance::grid_level <= kMaxGridLevel
//   wants   any page, those of the roots too
// selectPlanarLod() is pure: any thread.
#pragma once

#include <memory>

#include "geometry/lod/lod.h"
#include "src/artwork/patch_domain.h"

namespace relievo {

inline constexpr int kUnitsPerTexelLog2 = 4;

LodResult selectPlanarLod(const FlatDomain& domain, const ReliefOracle& oracle, const LodView& view,
                          const ReliefSet& resident);

// The same, with what hysteresis remembers from view to view. Not for several threads at once.
class PlanarLod {
 public:
  PlanarLod(const FlatDomain& domain, std::shared_ptr<const ReliefOracle> oracle);
  ~PlanarLod();
  LodResult select(const LodView& view, const ReliefSet& resident);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace relievo
