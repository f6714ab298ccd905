#include "geometry/bake/fidelity.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <span>

#include "geometry/bake/area_sampler.h"
#include "geometry/bake/measured_surface.h"
#include "geometry/mesh/box_tree.h"
#include "src/base/parallel_for.h"

namespace relievo {
namespace {

// The drawn surface is measured on grids within this distance of the finest, in diagonals. It is an upper bound: they
// lie much closer.
constexpr double kGridTolerance = 4e-5;
// Of a bake that is far off, grids within this share of how far its probes are say the same: fine grids of what spikes
// at every sample take hundreds of MiB. What they find stands where it is more than so many times the target.
constexpr double kShareFarOff = 0.01, kFarOff = 32;
constexpr uint64_t kMaxVertices = 40'000;

struct Samples {
  std::vector<glm::dvec3> positions;
  std::vector<float> distances_mm;
  size_t area_samples = 0;  // so many come first, spread over the area; the others are vertices
};

// Lowers the distances of the samples [first, end) to those of a surface, which lies within the box. distance: as
// closestByBoxes() has it. Distances of at most `enough` need not be lowered.
template <class Distance>
void updateDistances(Samples& s, size_t first, size_t end, const Box* box, const glm::dvec3& shift, double enough,
                     const FidelityOptions& options, Distance distance) {
  constexpr size_t kSamplesPerJob = 1024;
  // Samples beside one another are about as far away: a search that knows how far it need go is half as long.
  constexpr double kLikely = 4, kAtLeast = 1e-6;
  constexpr double kFar = std::numeric_limits<double>::infinity();
  parallelFor(
      (end - first + kSamplesPerJob - 1) / kSamplesPerJob, options.workers, options.interrupted, [&](size_t job) {
        size_t last = kNoPart;
        double likely = kFar;
        for (size_t i = first + job * kSamplesPerJob; i < std::min(end, first + (job + 1) * kSamplesPerJob); ++i) {
          const glm::dvec3 p = s.positions[i] + shift;
          const double nearest = s.distances_mm[i];
          if (nearest <= enough) continue;
          if (box && !std::isinf(nearest) && box->squaredDistance(p) > nearest * nearest) continue;
          double found = kFar;
          if (likely < nearest) {
            size_t part = kNoPart;
            found = distance(p, likely, part);
            if (part != kNoPart) last = part;
          }
          if (found == kFar) found = distance(p, nearest, last);
          likely = std::max(kLikely * found, kAtLeast * (std::abs(p.x) + std::abs(p.y) + std::abs(p.z)));
          s.distances_mm[i] = std::min(s.distances_mm[i], static_cast<float>(found));
        }
      });
}

// Calls use(part) with consecutive patches, as many at a time as fit the memory, until it answers false. kept: the part
// where it is the only one, made before and used again.
template <class Use>
bool forEachPart(const MeasuredSurface& surface, uint64_t memory_bytes, std::optional<MeasuredSurface::Part>& kept,
                 Use use) {
  constexpr uint64_t kBytesPerTriangle = 12;
  double area = 0;
  if (kept) return use(*kept);
  for (size_t first = 0, end = 0; first < surface.patches(); first = end) {
    uint64_t triangles = 0;
    do triangles += surface.triangles(end++);
    while (end < surface.patches() &&
           (memory_bytes == 0 || (triangles + surface.triangles(end)) * kBytesPerTriangle < memory_bytes));
    MeasuredSurface::Part part = surface.part(first, end, area);
    area = part.areaAfter();
    if (!use(part)) return false;
    if (first == 0 && end == surface.patches()) kept = std::move(part);
  }
  return true;
}

// If nothing lay further away than the returned distance, the target would be kept.
double violationThreshold(std::vector<float> distances_mm, const OneSidedFidelity& result,
                          const FidelityTarget& target) {
  double from = target.max_mm;
  if (result.p99_9_mm > target.p99_9_mm) from = std::min(from, target.p99_9_mm);
  if (result.rms_mm > target.rms_mm) {
    constexpr double kRoom = 0.6;
    const double max_sum = kRoom * target.rms_mm * target.rms_mm * static_cast<double>(distances_mm.size());
    std::sort(distances_mm.begin(), distances_mm.end());
    double sum = 0;
    size_t i = 0;
    while (i < distances_mm.size() && sum + double{distances_mm[i]} * distances_mm[i] <= max_sum)
      sum += double{distances_mm[i]} * distances_mm[i], ++i;
    if (i < distances_mm.size()) from = std::min(from, std::max<double>(distances_mm[i], target.rms_mm));
  }
  return from;
}

// Of the samples that are spread over the area, but for max_mm. from: how near no sample violates the target.
OneSidedFidelity summariseArea(const Samples& s, const FidelityTarget& target, double& from) {
  OneSidedFidelity result;
  result.samples = s.area_samples;
  std::vector<float> distances(s.distances_mm.begin(), s.distances_mm.begin() + static_cast<ptrdiff_t>(s.area_samples));
  double squares = 0, fourths = 0;
  size_t within = 0, beyond = 0;
  for (float d : distances) {
    const double square = double{d} * d;
    squares += square;
    fourths += square * square;
    within += d <= target.p99_9_mm;
    beyond += d > target.max_mm;
  }
  if (!distances.empty()) {
    const double count = static_cast<double>(distances.size()), mean = squares / count;
    result.rms_mm = std::sqrt(mean);
    result.mean_square_error = std::sqrt(std::max(fourths / count - mean * mean, 0.0) / count);
    result.area_within = static_cast<double>(within) / count;
    result.area_beyond = static_cast<double>(beyond) / count;
    const auto rank = distances.begin() + static_cast<ptrdiff_t>((count - 1) * 0.999);
    std::nth_element(distances.begin(), rank, distances.end());
    result.p99_9_mm = *rank;
    result.max_mm = *std::max_element(distances.begin(), distances.end());
  }
  from = violationThreshold(std::move(distances), result, target);
  return result;
}

// The largest distance of all samples, and those of them beyond `from`.
void addExtremes(const Samples& s, double from, OneSidedFidelity& result, std::vector<FidelityViolation>& violations) {
  if (s.distances_mm.empty()) return;
  const auto largest = std::max_element(s.distances_mm.begin(), s.distances_mm.end());
  result.max_mm = *largest;
  result.max_at_mm = s.positions[static_cast<size_t>(largest - s.distances_mm.begin())];
  for (size_t i = 0; i < s.distances_mm.size(); ++i)
    if (s.distances_mm[i] > from) violations.push_back({s.positions[i], s.distances_mm[i]});
}

}  // namespace

double OneSidedFidelity::excess(const FidelityTarget& t) const {
  return std::max({rms_mm / t.rms_mm, p99_9_mm / t.p99_9_mm, std::sqrt(area_beyond / FidelityTarget::kMaxAreaBeyond)});
}

double Fidelity::psnr_db() const {
  const double rms = std::max(to_drawn.rms_mm, to_scan.rms_mm);
  return rms > 0 && diagonal_mm > 0 ? std::min(20 * std::log10(diagonal_mm / rms), 240.0) : 240.0;
}

double Fidelity::excess() const { return std::max(to_drawn.excess(target), to_scan.excess(target)); }

bool surelyWithin(const Fidelity& few, double share) {
  constexpr double kErrors = 3;
  const FidelityTarget& t = few.target;
  auto within = [&](const OneSidedFidelity& way) {
    const double count = static_cast<double>(way.samples), rms = share * t.rms_mm,
                 outside = (1 - way.area_within) * count;
    // So many of a rare kind were found: there are at most so many more, with 3 where none was (Poisson).
    const double most_outside = outside + kErrors * std::sqrt(outside) + 3;
    return way.rms_mm * way.rms_mm + kErrors * way.mean_square_error <= rms * rms && most_outside <= 1e-3 * count &&
           way.area_beyond == 0;
  };
  return within(few.to_drawn) && within(few.to_scan);
}

double diagonalOf(const TriMesh& mesh) {
  if (mesh.positions_mm.empty()) return 0;
  glm::vec3 low = mesh.positions_mm[0], high = low;
  for (const glm::vec3& p : mesh.positions_mm) {
    low = glm::min(low, p);
    high = glm::max(high, p);
  }
  return glm::length(glm::dvec3(high) - glm::dvec3(low));
}

FidelityScan::FidelityScan(const TriMesh& mesh, int workers, uint64_t samples, std::shared_ptr<const TriangleRuns> runs)
    : FidelityScan(mesh, workers, samples, std::move(runs), Vertices::kTaken) {}

FidelityScan FidelityScan::fewer(const FidelityScan& scan, int workers, uint64_t samples) {
  return FidelityScan(scan.mesh(), workers, samples, scan.search().sharedRuns(), Vertices::kLeftOut);
}

FidelityScan::FidelityScan(const TriMesh& mesh, int workers, uint64_t samples, std::shared_ptr<const TriangleRuns> runs,
                           Vertices vertices)
    : mesh_(&mesh),
      search_(runs ? std::move(runs) : std::make_shared<const TriangleRuns>(mesh, workers)),
      diagonal_mm_(diagonalOf(mesh)),
      samples_(samples > 0 ? samples : std::clamp<uint64_t>(50 * mesh.triangles.size(), 10'000, 50'000)) {
  const std::vector<double> cumulative_area = cumulativeAreas(mesh, 0);
  if (const double whole = cumulative_area.back(); whole > 0) {
    const AreaSampler sampler(mesh, cumulative_area, whole, samples_);
    const size_t end = sampler.firstSampleAt(whole);
    size_t triangle = 0;
    for (size_t k = sampler.firstSampleAt(0); k < end; ++k) positions_.push_back(sampler.position(k, triangle));
  }
  area_samples_ = positions_.size();
  if (vertices == Vertices::kLeftOut) return;
  const size_t step = (mesh.positions_mm.size() + kMaxVertices - 1) / kMaxVertices;
  for (size_t v = 0; v < mesh.positions_mm.size(); v += std::max<size_t>(step, 1))
    positions_.push_back(glm::dvec3(mesh.positions_mm[v]));
}

namespace {

Result<Fidelity> measureOnGrids(double grid_tolerance_mm, const FidelityScan& scan, const MeshBake& baked,
                                const FidelityTarget& target, const FidelityOptions& options) {
  auto stopped = [&] { return options.interrupted && options.interrupted->load(std::memory_order_relaxed); };
  const Error interrupted{ErrorKind::kInterrupted, "", "interrupted", ""};
  constexpr float kFar = std::numeric_limits<float>::infinity();
  Fidelity out{.diagonal_mm = scan.diagonalMm(), .target = target, .to_drawn = {}, .to_scan = {}, .violations = {}};
  // From the scan's coordinates to the base's.
  const glm::dvec3 shift = scan.mesh().origin_mm - baked.base().origin_mm;
  Samples scan_samples{scan.positions(), std::vector<float>(scan.positions().size(), kFar), scan.areaSamples()};
  const MeasuredSurface surface(baked, grid_tolerance_mm,
                                options.soon ? MeasuredSurface::Blocks::kSoon : MeasuredSurface::Blocks::kFewest,
                                options.workers, options.interrupted);
  if (stopped()) return interrupted;
  double area = 0;
  std::optional<MeasuredSurface::Part> kept;
  const size_t area_samples = scan.areaSamples(), all_samples = scan.positions().size();
  bool whole = forEachPart(surface, options.memory_bytes, kept, [&](const MeasuredSurface::Part& part) {
    if (stopped()) return false;
    area = part.areaAfter();
    updateDistances(scan_samples, 0, area_samples, &part.box(), shift, kNeverEnough, options,
                    [&](const glm::dvec3& p, double within, size_t& row) { return part.distance(p, within, row); });
    return !stopped();
  });
  if (!whole) return interrupted;
  double from = 0;
  out.to_drawn = summariseArea(scan_samples, target, from);
  // Each part gets the samples that lie on it, numbered over the whole surface. Vertices count where they are further
  // away than all those samples, or violate the target: how near others are does not matter.
  const double enough = std::min(from, out.to_drawn.max_mm);
  Samples drawn_samples;
  whole = forEachPart(surface, options.memory_bytes, kept, [&](const MeasuredSurface::Part& part) {
    if (stopped()) return false;
    if (area > 0)
      MeasuredSurface::addSamples(part, area, scan.samples(), -shift, options.workers, drawn_samples.positions);
    updateDistances(
        scan_samples, area_samples, all_samples, &part.box(), shift, enough, options,
        [&](const glm::dvec3& p, double within, size_t& row) { return part.distance(p, within, row, enough); });
    return !stopped();
  });
  if (!whole) return interrupted;
  addExtremes(scan_samples, from, out.to_drawn, out.violations);
  drawn_samples.area_samples = drawn_samples.positions.size();
  drawn_samples.distances_mm.assign(drawn_samples.positions.size(), kFar);
  updateDistances(
      drawn_samples, 0, drawn_samples.positions.size(), nullptr, glm::dvec3(0), kNeverEnough, options,
      [&](const glm::dvec3& p, double within, size_t& part) { return scan.search().distance(p, within, part); });
  if (stopped()) return interrupted;
  out.to_scan = summariseArea(drawn_samples, target, from);
  addExtremes(drawn_samples, from, out.to_scan, out.violations);
  return out;
}

}  // namespace

Result<Fidelity> measureFidelity(const FidelityScan& scan, const MeshBake& baked, const FidelityTarget& target,
                                 const FidelityOptions& options) {
  const double fine_mm = kGridTolerance * scan.diagonalMm(), coarse_mm = kShareFarOff * baked.report().deviation_mm;
  if (coarse_mm > 2 * fine_mm) {
    auto found = measureOnGrids(coarse_mm, scan, baked, target, options);
    if (!found || found->excess() > kFarOff) return found;
  }
  return measureOnGrids(fine_mm, scan, baked, target, options);
}

}  // namespace relievo
