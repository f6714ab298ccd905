// mesh_distance.h - how far two surfaces lie apart, both ways: samples of either against the closest point of the other.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "geometry/mesh_bake.h"
#include "geometry/tri_mesh.h"
#include "src/base/result.h"

namespace relievo {

struct DistanceStats {
  uint64_t samples = 0;
  double max_mm = 0, rms_mm = 0;
  std::array<double, 5> percentiles_mm{};  // p50, p90, p95, p99, p99.9
};
struct MeshDistance {
  DistanceStats to_baked, to_scan;    // from the scan's surface to the baked one; the other way
  double diagonal_mm = 0;             // of the scan's bounding box
  double psnr_db = 0;                 // 20 log10(diagonal / the larger RMS), at most 240
  std::vector<float> scan_vertex_mm;  // of each vertex of the scan, for pictures
};
// Samples: every vertex of the scan, and samples_per_triangle for each of its triangles, spread evenly over its area; as many as these
// together over the baked surface. At fixed places: the same mesh and bake give the same numbers.
Result<MeshDistance> measureDistance(const TriMesh& scan, const MeshBake& baked, int samples_per_triangle = 3, int workers = 0);
// The finest surface of a bake as triangles, patch by patch, not welded (for measuring and for pictures). A patch's grid is the coarsest
// that lies within 5 x 10^-6 of the base's diagonal or one step of the heights of the finest (errorOfCells()), never coarser than the samples.
TriMesh bakedTriangles(const MeshBake& baked, int workers = 0);

}  // namespace relievo
