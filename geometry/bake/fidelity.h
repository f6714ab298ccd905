// fidelity.h - is what is drawn at full detail the scan, within what was promised? A budget of samples both ways, and
// the places that miss it. Units: mm; places in the scan's coordinates (from TriMesh::origin_mm).
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

// Distances that are kept from the scan to what is drawn, and back: their root mean square, 99.9 % of them, and all but
// kBeyond of the area: single vertices and what is narrower than a cell.
struct FidelityTarget {
  static constexpr double kBeyond = 1e-4;
  double rms_mm = 0, most_mm = 0, largest_mm = 0;
  // By default 3e-5, 3e-4 and 1e-3 of the diagonal. tolerance_mm: of 99.9 %; the others in proportion.
  static FidelityTarget of(double diagonal_mm) { return within(3e-4 * diagonal_mm); }
  static FidelityTarget within(double tolerance_mm) { return {tolerance_mm / 10, tolerance_mm, tolerance_mm / 0.3}; }
};

// One way.
struct FidelityWay {
  uint64_t samples = 0;                            // spread over the area; the largest is of the scan's vertices, too
  double rms_mm = 0, most_mm = 0, largest_mm = 0;  // most: 99.9 % lie within
  double within = 1, beyond = 0;                   // shares of the area: within the target's most, beyond its largest
  glm::dvec3 largest_at_mm{0};
  bool keeps(const FidelityTarget& t) const {
    return rms_mm <= t.rms_mm && most_mm <= t.most_mm && beyond <= FidelityTarget::kBeyond;
  }
  // How many times the target it is, at its worst; of areas the square root counts.
  double excess(const FidelityTarget& t) const;
};
struct FidelityMiss {
  glm::dvec3 place_mm{0};
  double mm = 0;
};
struct Fidelity {
  double diagonal_mm = 0;
  FidelityTarget target;
  FidelityWay to_drawn, to_scan;     // from the scan to what is drawn: what is missing; back: what is too much
  std::vector<FidelityMiss> misses;  // without them the target were kept
  double psnr_db() const;            // 20 log10(diagonal / the larger RMS), at most 240
  bool kept() const { return to_drawn.keeps(target) && to_scan.keeps(target); }
  double excess() const;
};

struct FidelityRun {
  uint64_t samples = 50'000;  // each way
  int workers = 0;
  uint64_t memory_bytes = 0;  // as DistanceRun has it
  const std::atomic<bool>* interrupted = nullptr;
};
double diagonalOf(const TriMesh& mesh);  // of the box around its vertices
// rays: of the scan. Interrupted: kInterrupted.
Result<Fidelity> measureFidelity(const TriMesh& scan, const RayScene& rays, const MeshBake& baked,
                                 const FidelityTarget& target, const FidelityRun& run = {});

}  // namespace relievo
