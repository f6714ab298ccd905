// patch_levels.h - how fine each patch of an artwork over a base mesh must be for an export within a distance of full
// detail: fewer cells where the surface asks for fewer. Patches of different levels meet as they are drawn
// (geometry/lod/snap.h): a side has the same cells from both patches, and vertices of a finer grid move to the nearest
// of these.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include "src/artwork/base_mesh.h"
#include "src/base/result.h"
#include "texturing/package/package.h"

namespace relievo {

struct PatchLevels {
  uint8_t grid = 0;                // 2^grid cells a side
  std::array<uint8_t, 4> sides{};  // by Side: 2^sides cells, no more than the grid has

  uint64_t cells() const { return uint64_t{1} << grid; }
  uint64_t ownVertices() const { return (cells() - 1) * (cells() - 1); }  // that are not on its border
  // Do vertices on some side move?
  bool isSnapped() const;
  // Where the vertex (x, y) of the grid is.
  std::array<uint64_t, 2> snapped(uint64_t x, uint64_t y) const;
  // Of the cell at (x, y), cut along (0,0)-(1,1): the triangle above the cut, or below it. Some have no corners left.
  bool hasTriangle(uint64_t x, uint64_t y, bool above) const;
  uint64_t triangles() const;
  bool operator==(const PatchLevels&) const = default;
};

// Of so many patches.
std::vector<PatchLevels> uniformLevels(size_t patches, int level);

// errors[p][l]: how far patch p lies from full detail at level l, growing nowhere; the last one is 0. Pure.
// Within a patch that is at most its error at its level. Along a side of fewer cells it may be twice that of the side's
// level (geometry/lod/ERROR_BOUND.md, 4), so that such sides are finer where that is too much.
std::vector<PatchLevels> patchLevelsWithin(const std::vector<PatchNeighbours>& neighbours,
                                           const std::vector<std::vector<float>>& errors, double error_mm);
// The bound that is kept: at most error_mm.
double errorOf(const std::vector<PatchLevels>& levels, const std::vector<std::vector<float>>& errors);
// Of a package over a base mesh. Errors: as ExportGrid::errorBound().
Result<std::vector<std::vector<float>>> patchErrors(const Package& package, const std::atomic<bool>* stop = nullptr);

}  // namespace relievo
