#include "geometry/bake/fidelity.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <span>

#include "geometry/bake/baked_surface.h"
#include "geometry/bake/spread_places.h"
#include "geometry/mesh/box_tree.h"
#include "src/base/parallel_for.h"

namespace relievo {
namespace {

// The drawn surface is measured on grids that lie within this (a bound: they lie much closer) of the finest, in
// diagonals.
constexpr double kClose = 4e-5;
constexpr uint64_t kMostVertices = 40'000;

struct Samples {
  std::vector<glm::dvec3> at;
  std::vector<float> mm;
  size_t spread = 0;  // the first are spread over the area, the others are vertices
};

void lowerTo(Samples& s, const RayScene& scene, const glm::dvec3& shift, const Box* box, const FidelityRun& run) {
  constexpr size_t kAJob = 2048;
  parallelFor((s.at.size() + kAJob - 1) / kAJob, run.workers, run.interrupted, [&](size_t job) {
    SurfacePoint last;
    for (size_t i = job * kAJob; i < std::min(s.at.size(), (job + 1) * kAJob); ++i) {
      const glm::dvec3 p = s.at[i] + shift;
      const double nearest = s.mm[i];
      const bool bounded = !std::isinf(nearest);
      if (bounded && box && box->squaredDistance(p) > nearest * nearest) continue;
      const SurfacePoint found = bounded ? scene.closestPoint(p, nearest) : scene.closestPoint(p, last);
      if (!found) continue;
      last = found;
      s.mm[i] = std::min(s.mm[i], static_cast<float>(found.along));
    }
  });
}

// Calls use(part) with runs of whole patches that fit the memory, one after the other, until it answers false.
template <class Use>
bool byParts(const CoarseBakedSurface& surface, uint64_t memory_bytes, Use use) {
  constexpr uint64_t kBytesATriangle = 90;  // with its hierarchy
  TriMesh part;
  for (uint32_t p = 0; p < surface.patches(); ++p) {
    surface.add(p, part);
    if (p + 1 < surface.patches() && (memory_bytes == 0 || part.triangles.size() * kBytesATriangle < memory_bytes))
      continue;
    if (!use(part)) return false;
    part = {};
  }
  return true;
}

// Without what lies further than this, the target is kept.
double missesFrom(std::vector<float> mm, const FidelityWay& way, const FidelityTarget& target) {
  double from = target.largest_mm;
  if (way.most_mm > target.most_mm) from = std::min(from, target.most_mm);
  if (way.rms_mm > target.rms_mm) {
    constexpr double kRoom = 0.6;
    const double most = kRoom * target.rms_mm * target.rms_mm * static_cast<double>(mm.size());
    std::sort(mm.begin(), mm.end());
    double sum = 0;
    size_t i = 0;
    while (i < mm.size() && sum + double{mm[i]} * mm[i] <= most) sum += double{mm[i]} * mm[i], ++i;
    if (i < mm.size()) from = std::min(from, std::max<double>(mm[i], target.rms_mm));
  }
  return from;
}

FidelityWay wayOf(const Samples& s, const FidelityTarget& target, std::vector<FidelityMiss>& misses) {
  FidelityWay way;
  way.samples = s.spread;
  if (s.mm.empty()) return way;
  std::vector<float> spread(s.mm.begin(), s.mm.begin() + static_cast<ptrdiff_t>(s.spread));
  double squares = 0;
  size_t within = 0, beyond = 0;
  for (float d : spread) {
    squares += double{d} * d;
    within += d <= target.most_mm;
    beyond += d > target.largest_mm;
  }
  if (!spread.empty()) {
    const double count = static_cast<double>(spread.size());
    way.rms_mm = std::sqrt(squares / count);
    way.within = static_cast<double>(within) / count;
    way.beyond = static_cast<double>(beyond) / count;
    const auto rank = spread.begin() + static_cast<ptrdiff_t>((count - 1) * 0.999);
    std::nth_element(spread.begin(), rank, spread.end());
    way.most_mm = *rank;
  }
  const auto largest = std::max_element(s.mm.begin(), s.mm.end());
  way.largest_mm = *largest;
  way.largest_at_mm = s.at[static_cast<size_t>(largest - s.mm.begin())];
  const double from = missesFrom(std::move(spread), way, target);
  for (size_t i = 0; i < s.mm.size(); ++i)
    if (s.mm[i] > from) misses.push_back({s.at[i], s.mm[i]});
  return way;
}

void spreadOver(const TriMesh& mesh, const std::vector<double>& area_before, double whole, size_t count,
                const glm::dvec3& shift, Samples& out) {
  const SpreadPlaces places(mesh, area_before, whole, count);
  const size_t first = places.firstAt(area_before.front()), end = places.firstAt(area_before.back());
  size_t triangle = 0;
  for (size_t k = first; k < end; ++k) out.at.push_back(places.place(k, triangle) + shift);
}

}  // namespace

double FidelityWay::excess(const FidelityTarget& t) const {
  return std::max({rms_mm / t.rms_mm, most_mm / t.most_mm, std::sqrt(beyond / FidelityTarget::kBeyond)});
}

double Fidelity::psnr_db() const {
  const double rms = std::max(to_drawn.rms_mm, to_scan.rms_mm);
  return rms > 0 && diagonal_mm > 0 ? std::min(20 * std::log10(diagonal_mm / rms), 240.0) : 240.0;
}

double Fidelity::excess() const { return std::max(to_drawn.excess(target), to_scan.excess(target)); }

double diagonalOf(const TriMesh& mesh) {
  if (mesh.positions_mm.empty()) return 0;
  glm::vec3 low = mesh.positions_mm[0], high = low;
  for (const glm::vec3& p : mesh.positions_mm) {
    low = glm::min(low, p);
    high = glm::max(high, p);
  }
  return glm::length(glm::dvec3(high) - glm::dvec3(low));
}

Result<Fidelity> measureFidelity(const TriMesh& scan, const RayScene& rays, const MeshBake& baked,
                                 const FidelityTarget& target, const FidelityRun& run) {
  auto stopped = [&] { return run.interrupted && run.interrupted->load(std::memory_order_relaxed); };
  const Error interrupted{ErrorKind::kInterrupted, "", "interrupted", ""};
  Fidelity out{.diagonal_mm = diagonalOf(scan), .target = target, .to_drawn = {}, .to_scan = {}, .misses = {}};
  const glm::dvec3 shift = scan.origin_mm - baked.base().origin_mm;  // from the scan's places to the base's

  Samples there;
  {
    const std::vector<double> area_before = areasBefore(scan, 0);
    if (area_before.back() > 0) spreadOver(scan, area_before, area_before.back(), run.samples, glm::dvec3(0), there);
    there.spread = there.at.size();
    const size_t step = (scan.positions_mm.size() + kMostVertices - 1) / kMostVertices;
    for (size_t v = 0; v < scan.positions_mm.size(); v += std::max<size_t>(step, 1))
      there.at.push_back(glm::dvec3(scan.positions_mm[v]));
    there.mm.assign(there.at.size(), std::numeric_limits<float>::infinity());
  }
  const CoarseBakedSurface surface(baked, kClose * out.diagonal_mm);
  double area = 0;
  std::optional<Error> failed;
  bool whole = byParts(surface, run.memory_bytes, [&](const TriMesh& part) {
    area = areasBefore(part, area).back();
    auto scene = RayScene::create(part, run.interrupted);
    if (!scene) return failed = scene.error(), false;
    Box box;
    for (const glm::vec3& p : part.positions_mm) box.add(p);
    lowerTo(there, **scene, shift, &box, run);
    return !stopped();
  });
  if (failed) return *failed;
  if (!whole) return interrupted;
  // The places that lie on each part, in turn.
  Samples back;
  double so_far = 0;
  whole = area <= 0 || byParts(surface, run.memory_bytes, [&](const TriMesh& part) {
            const std::vector<double> area_before = areasBefore(part, so_far);
            so_far = area_before.back();
            spreadOver(part, area_before, area, run.samples, -shift, back);
            return !stopped();
          });
  if (!whole) return interrupted;
  back.spread = back.at.size();
  back.mm.assign(back.at.size(), std::numeric_limits<float>::infinity());
  lowerTo(back, rays, glm::dvec3(0), nullptr, run);
  if (stopped()) return interrupted;
  out.to_drawn = wayOf(there, target, out.misses);
  out.to_scan = wayOf(back, target, out.misses);
  return out;
}

}  // namespace relievo
