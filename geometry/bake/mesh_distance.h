// mesh_distance.h - the distance between a scan and its baked surface, in both directions: from samples of one surface
// to the closest points of the other.
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
  DistanceStats to_baked, to_scan;    // from the scan's samples to the baked surface; and back
  double diagonal_mm = 0;             // of the scan's bounding box
  double psnr_db = 0;                 // 20 log10(diagonal / the larger RMS), at most 240
  std::vector<float> scan_vertex_mm;  // for each vertex of the scan, for pictures
};
struct DistanceOptions {
  int workers = 0;  // 0: one for each core
  // Memory beside the scan and the bake: the baked surface is triangulated and searched in parts of whole patches that
  // fit. 0: all at once. The results are the same bit for bit. The distances take another 4 bytes for each sample.
  uint64_t memory_bytes = 0;
  std::function<void(double /*0..1*/)> progress;
  const std::atomic<bool>* interrupted = nullptr;
};
// Samples of the scan: each vertex, and samples_per_triangle for each triangle, spread evenly over the area. The baked
// surface gets as many. Sample positions are deterministic. Error: kInterrupted, within a second.
Result<MeshDistance> measureDistance(const TriMesh& scan, const MeshBake& baked, int samples_per_triangle = 3,
                                     const DistanceOptions& run = {});
// The finest surface of a bake as triangles (BakedSurface).
TriMesh bakedTriangles(const MeshBake& baked, const DistanceOptions& run = {});

}  // namespace relievo
