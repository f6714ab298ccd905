// fidelity.h - does the surface drawn at full detail keep a promised distance from the scan? Distances are measured at
// samples both ways, and the samples that violate the target are returned.
// Units: mm; positions relative to the scan's TriMesh::origin_mm.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "geometry/bake/mesh_bake.h"
#include "geometry/mesh/closest_search.h"
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
  double mean_square_error = 0;             // the standard error of rms_mm^2 that so many samples leave
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

double diagonalOf(const TriMesh& mesh);  // of the bounding box

// Whether a measurement at few places leaves no doubt that one at many finds everything within the target, and the root
// mean square within `share` of it: three standard errors above what was found, and none beyond max_mm. For choices on
// the way; what is told of a bake is measured at many places.
bool surelyWithin(const Fidelity& few, double share);

// What several measurements of a scan share. The mesh must outlive it unchanged. samples: in each direction; 0 is
// 50,000, or for less than 1,000 triangles 50 each and 10,000 at least (of 10,000 one may lie beyond: kMaxAreaBeyond).
// workers: 0 is one for each core. runs: of the mesh, made before; or empty.
class FidelityScan {
 public:
  FidelityScan(const TriMesh& mesh, int workers, uint64_t samples = 0, std::shared_ptr<const TriangleRuns> runs = {});
  // Fewer samples of the same scan, and no vertices.
  static FidelityScan fewer(const FidelityScan& scan, int workers, uint64_t samples);
  const TriMesh& mesh() const { return *mesh_; }
  const ClosestSearch& search() const { return search_; }
  double diagonalMm() const { return diagonal_mm_; }
  uint64_t samples() const { return samples_; }
  // First areaSamples() of them, spread over the area; then vertices.
  const std::vector<glm::dvec3>& positions() const { return positions_; }
  size_t areaSamples() const { return area_samples_; }

 private:
  enum class Vertices : uint8_t { kTaken, kLeftOut };
  FidelityScan(const TriMesh& mesh, int workers, uint64_t samples, std::shared_ptr<const TriangleRuns> runs,
               Vertices vertices);
  const TriMesh* mesh_;
  ClosestSearch search_;
  double diagonal_mm_;
  uint64_t samples_;
  std::vector<glm::dvec3> positions_;
  size_t area_samples_ = 0;
};

struct FidelityOptions {
  int workers = 0;
  uint64_t memory_bytes = 0;  // as DistanceOptions has it
  const std::atomic<bool>* interrupted = nullptr;
  // The drawn surface in more blocks than are needed, which are found sooner: for bakes that are measured often.
  bool soon = false;
};
// Error: kInterrupted.
Result<Fidelity> measureFidelity(const FidelityScan& scan, const MeshBake& baked, const FidelityTarget& target,
                                 const FidelityOptions& options = {});

}  // namespace relievo
