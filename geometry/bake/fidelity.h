// fidelity.h - does the surface drawn at full detail keep a promised distance from the scan? Distances are measured at
// samples both ways, and the samples that violate the target are returned.
// Units: mm; positions relative to the scan's TriMesh::origin_mm.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <vector>

#include "geometry/bake/mesh_bake.h"
#include "geometry/mesh/ray_scene.h"
#include "geometry/mesh/tri_mesh.h"
#include "src/base/result.h"

namespace relievo {

// Upper bounds of the distances from the scan to the drawn surface, and back: of their root mean square; of their
// 99.9th percentile; and max_mm, which at most kMaxAreaBeyond of the area may exceed, so that single vertices and
// features narrower than a cell do not count.
struct FidelityTarget {
  static constexpr double kMaxAreaBeyond = 1e-4;
  double rms_mm = 0, p99_9_mm = 0, max_mm = 0;
  // The default: 3e-5, 3e-4 and 1e-3 of the diagonal.
  static FidelityTarget of(double diagonal_mm) { return within(3e-4 * diagonal_mm); }
  // The 99.9th percentile is tolerance_mm; the others are in proportion.
  static FidelityTarget within(double tolerance_mm) { return {tolerance_mm / 10, tolerance_mm, tolerance_mm / 0.3}; }
};

// Distances in one direction.
struct OneSidedFidelity {
  uint64_t samples = 0;  // spread over the area; max_mm covers vertices of the scan, too
  double rms_mm = 0, p99_9_mm = 0, max_mm = 0;
  double area_within = 1, area_beyond = 0;  // area shares within the target's p99_9_mm, and beyond its max_mm
  glm::dvec3 max_at_mm{0};
  bool meets(const FidelityTarget& t) const {
    return rms_mm <= t.rms_mm && p99_9_mm <= t.p99_9_mm && area_beyond <= FidelityTarget::kMaxAreaBeyond;
  }
  // The largest ratio of measured value to target; for area shares, the square root of the ratio.
  double excess(const FidelityTarget& t) const;
};
struct FidelityViolation {
  glm::dvec3 position_mm{0};
  double distance_mm = 0;
};
struct Fidelity {
  double diagonal_mm = 0;
  FidelityTarget target;
  OneSidedFidelity to_drawn, to_scan;         // to_drawn shows what is missing, to_scan what is too much
  std::vector<FidelityViolation> violations;  // if these samples were closer, the target would be kept
  double psnr_db() const;                     // 20 log10(diagonal / the larger RMS), at most 240
  bool kept() const { return to_drawn.meets(target) && to_scan.meets(target); }
  double excess() const;
};

struct FidelityOptions {
  uint64_t samples = 50'000;  // in each direction
  int workers = 0;
  uint64_t memory_bytes = 0;  // as DistanceOptions has it
  const std::atomic<bool>* interrupted = nullptr;
};
double diagonalOf(const TriMesh& mesh);  // of the bounding box
// rays: of the scan. Error: kInterrupted, or out of memory.
Result<Fidelity> measureFidelity(const TriMesh& scan, const RayScene& rays, const MeshBake& baked,
                                 const FidelityTarget& target, const FidelityOptions& options = {});

}  // namespace relievo
