// mesh_distance.h - how far two surfaces lie apart, both ways: samples of either against the closest point of the
// other.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <vector>

#include "geometry/bake/mesh_bake.h"
#include "geometry/mesh/tri_mesh.h"
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
struct DistanceRun {
  int workers = 0;  // 0: one a core
  // For what is looked up beside the scan and the bake: the baked surface is triangulated and searched in parts of
  // whole patches that fit, one after the other. The results are the same bit for bit; 0: all at once. The distances
  // themselves come on top, 4 bytes a sample.
  uint64_t memory_bytes = 0;
  std::function<void(double /*0..1*/)> progress;
  const std::atomic<bool>* interrupted = nullptr;
};
// Samples: every vertex of the scan, and samples_per_triangle for each of its triangles, spread evenly over its area;
// as many as these together over the baked surface. At fixed places: the same mesh and bake give the same numbers.
// Interrupted: ErrorKind::kInterrupted, within a second.
Result<MeshDistance> measureDistance(const TriMesh& scan, const MeshBake& baked, int samples_per_triangle = 3,
                                     const DistanceRun& run = {});
// The finest surface of a bake as triangles, patch by patch, not welded (for measuring and for pictures). A patch's
// grid is the coarsest that lies within 5 x 10^-6 of the base's diagonal or one step of the heights of the finest
// (errorOfCells()), never coarser than the samples. Interrupted: some of it.
TriMesh bakedTriangles(const MeshBake& baked, const DistanceRun& run = {});

}  // namespace relievo
