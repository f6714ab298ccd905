#include "geometry/remesh/base_domain.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numbers>
#include <optional>
#include <string>

#include "geometry/mesh/mesh_order.h"
#include "geometry/mesh/ray_scene.h"
#include "geometry/remesh/base_fit.h"
#include "geometry/remesh/base_place.h"
#include "geometry/remesh/base_quads.h"
#include "geometry/remesh/base_reduce.h"
#include "geometry/remesh/base_sheet.h"
#include "geometry/remesh/base_simplify.h"
#include "geometry/remesh/base_topology.h"
#include "geometry/remesh/chunk_reduce.h"
#include "geometry/remesh/coarse_mesh.h"

namespace relievo {

namespace {

// The scan in units of its bounding box's diagonal, about its centre.
struct Frame {
  glm::dvec3 centre{0};
  double diagonal = 1;
};

template <class Triangles>
Frame frameOf(const std::vector<glm::vec3>& points, const Triangles& triangles) {
  glm::vec3 lo(std::numeric_limits<float>::infinity()), hi = -lo;
  for (const auto& t : triangles) {
    for (uint32_t v : t) {
      if (v >= points.size()) return {};  // refused later
      lo = glm::min(lo, points[v]);
      hi = glm::max(hi, points[v]);
    }
  }
  return {(glm::dvec3(lo) + glm::dvec3(hi)) / 2.0, glm::length(glm::dvec3(hi) - glm::dvec3(lo))};
}

// What of the surface's area may be lost in undercuts where the number of patches is free; more patches than the last
// of the numbers keep too many pages pinned.
constexpr double kLostEnough = 0.0015;
constexpr double kWorthIt = 0.75;
constexpr double kFlatSine = 0.2;
constexpr uint32_t kNumbers[] = {64, 160, 320, 560, 800};
// Of a scan along a sheet's patch: half as many as a bake of its own accord gives it cells (mesh_bake.cpp).
constexpr double kVerticesAlong = 512;
// What bases are made from at first, and at most where a scan needs many patches.
constexpr size_t kReducedTriangles = 24000, kMostReducedTriangles = 160000;
// Sides at a sixteenth of what they are elsewhere.
constexpr float kMostWeight = 65536.0f;
// Of a base, spread over its patches by their area, when it is judged.
constexpr size_t kJudgedCells = 40000;

struct Candidate {
  QuadMesh quads;
  Regions regions;
  size_t folded = 0, flat = 0;  // corners; flat: along borders, in quads with angles of nearly 0 or 180 degrees
  double lost = 1;              // Fit
  double deviation = 0;         // borderDeviation
  bool empty() const { return quads.n_faces() == 0; }
  // A folded corner spoils a part of its quads; a flat one wastes samples.
  double badness() const {
    if (empty()) return 2;
    return lost +
           (0.3 * static_cast<double>(folded) + 0.015 * static_cast<double>(flat)) /
               static_cast<double>(quads.n_vertices()) +
           deviation;
  }
};

// How much farther than it must (by feature curve) the scan's border strays from the base's sides: deviationFromSide.
double borderDeviation(const QuadMesh& m, std::span<const FeatureCurve> curves, std::span<const double> must) {
  double deviation = 0;
  auto end = [&](const SmartHalfedgeHandle& h) {
    return CurveEnd{m.point(h.from()), m.normal(h.from()), m.data(h).step.along};
  };
  for (const auto e : m.edges()) {
    const uint32_t curve = m.data(e.h0()).step.curve;
    if (curve == kNoIndex || !curves[curve].border) continue;
    deviation = std::max(deviation, deviationFromSide(curves[curve], end(e.h0()), end(e.h1())) - must[curve]);
  }
  return deviation;
}

// Borders without what heights bring back, as far as that is known: the heights of a relief over a plane.
std::vector<FeatureCurve> flattened(std::vector<FeatureCurve> curves, const ViewDirection& view_direction) {
  if (!isRelief(view_direction)) return curves;
  for (FeatureCurve& curve : curves) {
    for (size_t i = 0; i < curve.points.size(); ++i) {
      curve.points[i] -= view_direction.direction * glm::dot(curve.points[i], view_direction.direction);
      curve.at[i] = i ? curve.at[i - 1] + glm::length(curve.points[i] - curve.points[i - 1]) : 0;
    }
  }
  return curves;
}

bool isSet(const std::atomic<bool>* interrupted) { return interrupted && interrupted->load(std::memory_order_relaxed); }

struct Maker {
  TriangleMesh surface;
  size_t pieces;
  double area;
  ScanLookup scan;
  std::vector<FeatureCurve> curves;
  ViewDirection view_direction;
  size_t scan_vertices;
  std::vector<FeatureCurve> flat_curves;
  std::vector<double> allowed_deviation;  // of a border feature curve, be there ever so many patches
  std::vector<uint8_t> strict;  // by feature curve: it was missed, and is followed closely however rough; or empty
  const std::atomic<bool>* interrupted;

  // Empty if the scan is no four-sided sheet, or its border is not followed by a grid.
  Candidate sheet(uint32_t patches) const {
    uint32_t times = 1;
    if (const size_t few = sheetQuads(curves, pieces, scan, 0).n_faces(); few && !patches) {
      times = static_cast<uint32_t>(
          std::ceil(std::sqrt(static_cast<double>(scan_vertices) / static_cast<double>(few)) / kVerticesAlong));
    }
    for (uint32_t tries = 0; tries < 4; ++tries, times *= 2) {
      Candidate c{.quads = sheetQuads(curves, pieces, scan, patches, times)};
      if (c.empty()) break;
      c.regions = cornerRegions(c.quads, surface, scan);
      if (isRelief(view_direction)) {
        for (const auto v : c.quads.vertices()) c.quads.set_normal(v, view_direction.direction);
      } else {
        placeNormals(c.quads, surface, c.regions, scan);
      }
      c.deviation = borderDeviation(c.quads, curves, allowed_deviation);
      if (c.deviation <= 0) return c;
      if (patches) break;
    }
    return {};
  }

  // Of each border feature curve by sides of so many squares; of creases: 1.
  std::vector<double> deviationFor(double squares, double within) const {
    std::vector<double> deviation(flat_curves.size(), 1.0);
    for (size_t r = 0; r < deviation.size(); ++r) {
      if (!flat_curves[r].border) continue;
      deviation[r] = r < strict.size() && strict[r]
                         ? 0.25 * kBorderDeviation
                         : deviationForSides(flat_curves[r], std::sqrt(area / squares), within);
    }
    return deviation;
  }

  // split: makeQuads. Empty without it where triangles find no partner.
  Candidate make(uint32_t triangles, bool split, const std::vector<float>& weight) const {
    TriangleMesh coarse = surface;
    // Halved sides of a curve stray a quarter as far.
    const std::vector<double> deviation =
        deviationFor(triangles * std::sqrt(3.0) / 4, (split ? 4 : 1) * kBorderDeviation);
    simplify(coarse, {.triangles = triangles,
                      .weight = weight,
                      .curves = curves,
                      .deviation = deviation,
                      .interrupted = interrupted});
    flipEdges(coarse);
    Candidate c{.quads = makeQuads(coarse, curves, split)};
    if (c.empty()) return c;
    updateNormals(c.quads);
    for (int round = 0; round < 4; ++round) {
      if (isSet(interrupted)) return {};
      if (round) relaxQuads(c.quads, curves, scan, 8);
      if (round == 3) settleBorders(c.quads, curves, allowed_deviation);
      c.regions = cornerRegions(c.quads, surface, scan);
      placeCorners(c.quads, surface, c.regions, scan);
    }
    placeNormals(c.quads, surface, c.regions, scan);
    untangleQuads(c.quads, curves, scan);
    return c;
  }

  Candidate make(uint32_t patches, const std::vector<float>& weight) const {
    // Few are better had without the split: its quads are four from one.
    for (uint32_t more = 0; patches < 32 && more < 3; ++more) {
      Candidate c = make(2 * patches + 2 * more, false, weight);
      if (c.empty() || 10 * c.quads.n_faces() > 13 * patches) continue;
      bool fair = true;
      for (const auto v : c.quads.vertices()) fair = fair && leastSine(c.quads, v) > 0.2;
      if (fair) return c;
    }
    return make(std::max(4u, patches / 2), true, weight);
  }

  // How badly the candidate lies. Where it lost the surface, the next one gets smaller patches: weight.
  void judge(Candidate& c, std::vector<float>& weight, bool closely) const {
    const size_t cells = closely ? std::max(kJudgedCells, 40 * c.quads.n_faces()) : kJudgedCells;
    const Fit fit = judgeFit(c.quads, surface, scan, cells, closely);
    for (const auto v : c.quads.vertices()) {
      c.folded += folds(c.quads, v);
      c.flat += v.is_boundary() && !c.quads.data(v).fixed && leastSine(c.quads, v) < kFlatSine;
    }
    c.lost = fit.lost;
    c.deviation = borderDeviation(c.quads, curves, allowed_deviation);
    raiseWeights(fit, c.quads, surface, c.regions, weight);
  }
};

// Patches near one another in space near one another in the list, and corners in the order of the patches: what bakes
// and streams them finds what it needs together.
void orderPatches(BaseMesh& base) {
  glm::vec3 low(std::numeric_limits<float>::infinity()), high = -low;
  for (const BaseCorner& c : base.corners) {
    low = glm::min(low, c.position_mm);
    high = glm::max(high, c.position_mm);
  }
  std::vector<std::pair<uint32_t, std::array<uint32_t, 4>>> keyed;
  for (const auto& patch : base.patches) {
    glm::vec3 centre(0);
    for (uint32_t c : patch) centre += 0.25f * base.corners[c].position_mm;
    keyed.emplace_back(placeOnCurve(centre, low, high), patch);
  }
  std::stable_sort(keyed.begin(), keyed.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  std::vector<uint32_t> name(base.corners.size(), kNoIndex);
  std::vector<BaseCorner> corners;
  auto named = [&](uint32_t c) {
    if (name[c] == kNoIndex) {
      name[c] = static_cast<uint32_t>(corners.size());
      corners.push_back(base.corners[c]);
    }
    return name[c];
  };
  for (size_t p = 0; p < keyed.size(); ++p)
    for (size_t k = 0; k < 4; ++k) base.patches[p][k] = named(keyed[p].second[k]);
  for (uint32_t c = 0; c < name.size(); ++c) named(c);
  base.corners = std::move(corners);
}

Error interruptedError() { return {ErrorKind::kInterrupted, {}, "interrupted", {}, {}}; }

void report(const BaseDomainOptions& options, double done) {
  if (options.progress) options.progress(done);
}

// The whole scan in its frame; of a dense one what some `wanted` triangles are reduced from.
Result<Surface> surfaceOf(const TriMesh& mesh, const BaseDomainOptions& options, size_t wanted, Frame& frame) {
  if (mesh.triangles.size() >= kManyTriangles && mesh.triangles.size() >= 16 * wanted) {
    frame = frameOf(mesh.positions_mm, mesh.triangles);
    auto thinned = thinnedByRuns(mesh, {.triangles = 4 * wanted,
                                        .centre = frame.centre,
                                        .diagonal = frame.diagonal,
                                        .workers = options.workers,
                                        .progress = [&](double done) { report(options, 0.4 * done); },
                                        .interrupted = options.interrupted});
    if (isSet(options.interrupted)) return interruptedError();
    if (thinned) return std::move(*thinned);
  }
  auto whole = makeSurface(mesh.positions_mm, mesh.triangles);
  if (!whole) return whole.error();
  frame = frameOf(whole->points, whole->triangles);
  for (glm::vec3& p : whole->points) p = glm::vec3((glm::dvec3(p) - frame.centre) / frame.diagonal);
  for (SurfacePiece& p : whole->pieces) p.area /= frame.diagonal * frame.diagonal;
  return whole;
}

Result<void> checkAreas(const Surface& scan, const Frame& frame, double mm_per_unit) {
  for (const SurfacePiece& p : scan.pieces) {
    if (p.area > 1e-14) continue;
    const glm::dvec3 at =
        (glm::dvec3(scan.points[scan.triangles[p.first_triangle][0]]) * frame.diagonal + frame.centre) * mm_per_unit;
    return Error{ErrorKind::kInvalidData,
                 {},
                 "a piece of " + std::to_string(p.triangles) + " triangles has no area, at (" + std::to_string(at.x) +
                     ", " + std::to_string(at.y) + ", " + std::to_string(at.z) + ") mm",
                 "remove it from the scan",
                 {}};
  }
  return {};
}

std::vector<BorderLine> bordersOf(const Surface& scan) {
  std::vector<BorderLine> borders;
  for (const auto& loop : scan.loops) {
    borders.push_back({loop, {}});
    for (uint32_t v : loop) borders.back().points.push_back(scan.points[v]);
  }
  return borders;
}

// The least bad of several numbers of patches; empty where none was found.
Result<Candidate> bestOf(const Maker& maker, const BaseDomainOptions& options, std::vector<float>& weight) {
  // A number of patches: three times, with smaller patches where the surface was lost. None: ever more, too.
  std::vector<uint32_t> numbers(3, options.patches);
  if (options.patches == 0) numbers.assign(std::begin(kNumbers), std::end(kNumbers));
  Candidate best;
  int in_vain = 0;
  size_t last = 0;  // patches of the candidate before
  for (size_t i = 0; i < numbers.size(); ++i) {
    if (isSet(options.interrupted)) return interruptedError();
    Candidate candidate = i == 0 ? maker.sheet(options.patches) : Candidate{};
    // Whatever is lost of a relief's walls is due to the fit's coarse grids.
    if (!candidate.empty() && isRelief(maker.view_direction)) return candidate;
    // Small pieces take what their topology needs, and no less: numbers at or below that bring nothing new.
    if (options.patches == 0 && i > 0 && 5 * last > 6 * numbers[i]) continue;
    if (candidate.empty()) candidate = maker.make(numbers[i], weight);
    if (isSet(options.interrupted)) return interruptedError();
    report(options, 0.5 + 0.5 * static_cast<double>(i + 1) / static_cast<double>(numbers.size() + 1));
    if (candidate.empty()) continue;
    last = candidate.quads.n_faces();
    maker.judge(candidate, weight, false);
    const bool enough = candidate.badness() <= (options.patches ? kLostEnough / 10 : kLostEnough);
    // More patches must be worth it: borders of steps, say, take ever more of them and never fit.
    const double least_gain = options.patches || best.empty() ? 1 : kWorthIt;
    const bool gain = candidate.badness() < least_gain * best.badness();
    if (gain) best = std::move(candidate);
    in_vain = gain ? 0 : in_vain + 1;
    if (enough || (options.patches == 0 && in_vain == 2)) break;
  }
  return best;
}

BaseMesh baseMeshOf(const QuadMesh& quads, const Frame& frame, const glm::dvec3& origin_mm) {
  BaseMesh base;
  base.origin_mm = origin_mm;
  for (const auto v : quads.vertices())
    base.corners.push_back(
        {glm::vec3(quads.point(v) * frame.diagonal + frame.centre), glm::vec3(glm::normalize(quads.normal(v)))});
  // Against the clock from (0, 0): down, right, up (base_mesh.h, orientation).
  for (const auto f : quads.faces()) {
    std::array<uint32_t, 4> patch;
    size_t k = 0;
    for (const auto v : f.vertices()) patch[std::array{0, 2, 3, 1}[k++]] = static_cast<uint32_t>(v.idx());
    base.patches.push_back(patch);
  }
  orderPatches(base);
  return base;
}

// What base meshes are made from: the reduced scan in its frame.
struct Ground {
  Frame frame;
  std::vector<BorderLine> borders;
  Reduced reduced;
  TriMesh triangles;  // the reduced surface's
  std::unique_ptr<RayScene> scene;
  ViewDirection view_direction;

  glm::dvec3 placeOf(const glm::dvec3& p) const { return (p - frame.centre) / frame.diagonal; }
};

bool isWhole(const Ground& g, const TriMesh& mesh) { return g.triangles.triangles.size() >= mesh.triangles.size(); }

// Of some `wanted` triangles, each corner of `patches` patches owning several.
Result<Ground> groundOf(const TriMesh& mesh, const BaseDomainOptions& options, size_t wanted, size_t patches,
                        const ViewDirection* known) {
  Ground out;
  auto scan = surfaceOf(mesh, options, wanted, out.frame);
  if (!scan) return scan.error();
  if (auto sound = checkAreas(*scan, out.frame, options.mm_per_unit); !sound) return sound.error();
  while (scan->triangles.size() < std::max<size_t>(4000, 8 * patches)) *scan = subdivided(*scan);
  if (isSet(options.interrupted)) return interruptedError();
  report(options, 0.4);
  if (known) {
    out.view_direction = *known;
  } else if (scan->pieces.size() == 1) {
    // Of the scan itself: the reduced one's walls lean over.
    out.view_direction = viewDirectionOf(mesh.positions_mm, mesh.triangles, options.workers, options.interrupted);
  }
  if (isSet(options.interrupted)) return interruptedError();
  if (!known && options.scan_done) options.scan_done();
  out.borders = bordersOf(*scan);
  out.reduced = reduceSurface(std::move(*scan), wanted, borderCorners(out.borders), options.interrupted);
  if (isSet(options.interrupted)) return interruptedError();
  report(options, 0.5);
  out.triangles.positions_mm = out.reduced.surface.points;
  out.triangles.triangles = out.reduced.surface.triangles;
  return out;
}

// The ground must stay where it is.
Result<Maker> makerOf(Ground& ground, size_t scan_vertices, uint32_t most_patches,
                      const std::atomic<bool>* interrupted) {
  auto scene = RayScene::create(ground.triangles, interrupted);
  if (!scene) return scene.error();
  ground.scene = std::move(*scene);
  Maker maker{.surface = halfEdgesOf(ground.reduced.surface),
              .pieces = ground.reduced.surface.pieces.size(),
              .area = areaOf(ground.reduced.surface),
              .scan = {ground.triangles, *ground.scene},
              .view_direction = ground.view_direction,
              .scan_vertices = scan_vertices,
              .interrupted = interrupted};
  maker.curves = findFeatureCurves(ground.borders, ground.reduced.vertex, maker.surface);
  maker.flat_curves = flattened(maker.curves, ground.view_direction);
  maker.allowed_deviation = maker.deviationFor(most_patches, kBorderDeviation);
  return maker;
}

}  // namespace

struct BaseDomain::Impl {
  const TriMesh& mesh;
  BaseDomainOptions options;
  std::unique_ptr<Ground> ground;
  std::optional<Maker> maker;
  std::vector<float> weight;  // of the reduced surface's vertices
  Candidate last;             // the base that was made last

  Result<BaseMesh> finish(Candidate candidate) {
    last = std::move(candidate);
    if (last.empty()) return Error{ErrorKind::kInvalidData, {}, "no base mesh was found for this scan", {}, {}};
    BaseMesh base = baseMeshOf(last.quads, ground->frame, mesh.origin_mm);
    if (std::string problem = baseMeshProblem(base); !problem.empty())
      return Error{ErrorKind::kInvalidData, {}, "no base mesh for this scan: " + problem, {}, {}};
    return base;
  }
  Result<void> prepare(size_t wanted, uint32_t patches, const ViewDirection* known) {
    auto made = groundOf(mesh, options, wanted, patches, known);
    if (!made) return made.error();
    auto next = std::make_unique<Ground>(std::move(*made));
    auto made_maker =
        makerOf(*next, mesh.positions_mm.size(), std::max(patches, std::end(kNumbers)[-1]), options.interrupted);
    if (!made_maker) return made_maker.error();
    // What is known of the surface so far.
    std::vector<float> moved(next->triangles.positions_mm.size(), 1.0f);
    if (!weight.empty()) {
      for (size_t v = 0; v < moved.size(); ++v) {
        const SurfacePoint at = ground->scene->closestPoint(glm::dvec3(next->triangles.positions_mm[v]));
        if (!at) continue;
        for (uint32_t w : ground->triangles.triangles[at.triangle]) moved[v] = std::max(moved[v], weight[w]);
      }
    }
    weight = std::move(moved);
    maker.reset();
    last.regions.clear();
    ground = std::move(next);
    maker.emplace(std::move(*made_maker));
    return {};
  }
  std::vector<float> factorsOf(std::span<const BaseMiss> misses) const;
  void followBorders(std::span<const BaseMiss> misses);
  Result<Candidate> leastBad(uint32_t patches, uint32_t most_patches);
  uint32_t patchesFor(const std::vector<float>& factor) const;
};

BaseDomain::BaseDomain(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
BaseDomain::~BaseDomain() = default;
size_t BaseDomain::patches() const { return impl_->last.quads.n_faces(); }

Result<std::unique_ptr<BaseDomain>> BaseDomain::create(const TriMesh& mesh, const BaseDomainOptions& options) {
  if (options.patches > kMaxPatches)
    return Error{ErrorKind::kUsage, {}, "more than 2^20 patches are asked for", "ask for fewer", {}};
  report(options, 0);
  auto impl = std::unique_ptr<Impl>(new Impl{.mesh = mesh, .options = options});
  // What is coarser than some 24 edges of a base made of these.
  const size_t wanted = std::max<size_t>(kReducedTriangles, 3 * size_t{options.patches});
  if (auto done = impl->prepare(wanted, options.patches, nullptr); !done) return done.error();
  return std::unique_ptr<BaseDomain>(new BaseDomain(std::move(impl)));
}

Result<BaseMesh> BaseDomain::make() {
  Impl& d = *impl_;
  d.weight.clear();
  auto best = bestOf(*d.maker, d.options, d.weight);
  if (!best) return best.error();
  auto base = d.finish(std::move(*best));
  if (base) report(d.options, 1);
  return base;
}

// How much finer the surface around its vertices is to be: 16 halves the patches' sides.
std::vector<float> BaseDomain::Impl::factorsOf(std::span<const BaseMiss> misses) const {
  const TriangleMesh& s = maker->surface;
  std::vector<float> factor(s.n_vertices(), 1.0f), next;
  for (const BaseMiss& miss : misses) {
    const SurfacePoint at = ground->scene->closestPoint(ground->placeOf(miss.place_mm));
    if (!at) continue;
    for (uint32_t v : ground->triangles.triangles[at.triangle]) factor[v] = std::max(factor[v], miss.factor);
  }
  for (int ring = 0; ring < 3; ++ring) {
    next = factor;
    for (const auto v : s.vertices())
      for (const auto w : v.vertices()) next[v.idx()] = std::max(next[v.idx()], 0.75f * factor[w.idx()]);
    factor.swap(next);
  }
  return factor;
}

// Borders that were missed are followed closely.
void BaseDomain::Impl::followBorders(std::span<const BaseMiss> misses) {
  const TriangleMesh& s = maker->surface;
  std::vector<uint8_t> strict(maker->curves.size(), 0);
  for (const BaseMiss& miss : misses) {
    const SurfacePoint at = ground->scene->closestPoint(ground->placeOf(miss.place_mm));
    if (!at) continue;
    for (const auto v : s.fv_range(FaceHandle(static_cast<int>(at.triangle))))
      for (const auto h : OpenMesh::make_smart(v, s).outgoing_halfedges())
        if (h.edge().is_boundary() && s.data(h).step) strict[s.data(h).step.curve] = 1;
  }
  for (size_t r = 0; r < std::min(strict.size(), maker->strict.size()); ++r) strict[r] |= maker->strict[r];
  maker->strict = std::move(strict);
}

// Of a few, each with smaller patches where the one before lost the surface: one patch that folds over spoils much.
Result<Candidate> BaseDomain::Impl::leastBad(uint32_t patches, uint32_t most_patches) {
  constexpr int kTries = 3;
  constexpr double kLittle = 1e-4;
  Candidate best;
  std::vector<float> tried = weight, best_weight = weight;
  for (int tries = 0; tries < kTries; ++tries) {
    Candidate c = maker->make(std::min(patches, most_patches), tried);
    if (isSet(options.interrupted)) return interruptedError();
    if (c.empty()) continue;
    const std::vector<float> used = tried;
    maker->judge(c, tried, true);
    for (float& w : tried) w = std::min(w, kMostWeight);
    const bool enough = c.lost <= kLittle;
    if (best.empty() || c.badness() < best.badness()) {
      best = std::move(c);
      best_weight = used;
    }
    if (enough) break;
    patches += patches / 12;
  }
  weight = std::move(best_weight);
  return best;
}

// So many that those where the factor is 1 stay as large as they are.
uint32_t BaseDomain::Impl::patchesFor(const std::vector<float>& factor) const {
  const auto& quads = last.quads;
  const Regions regions = last.regions.empty() ? cornerRegions(quads, maker->surface, maker->scan) : last.regions;
  std::vector<double> finer(quads.n_vertices(), 0), count(quads.n_vertices(), 0);
  for (size_t v = 0; v < factor.size(); ++v) {
    if (!regions[v].is_valid()) continue;
    finer[regions[v].idx()] += std::sqrt(factor[v]);
    ++count[regions[v].idx()];
  }
  double sum = 0;
  for (size_t c = 0; c < count.size(); ++c) sum += count[c] > 0 ? finer[c] / count[c] : 1;
  return static_cast<uint32_t>(static_cast<double>(quads.n_faces()) * sum / static_cast<double>(count.size()));
}

Result<BaseMesh> BaseDomain::refine(std::span<const BaseMiss> misses, uint32_t most_patches) {
  Impl& d = *impl_;
  std::vector<float> factor = d.factorsOf(misses);
  const size_t before = d.last.quads.n_faces();
  const uint32_t patches =
      std::min<uint32_t>(std::clamp<uint32_t>(d.patchesFor(factor), static_cast<uint32_t>(before + before / 8 + 8),
                                              static_cast<uint32_t>(3 * before + 64)),
                         most_patches);
  d.weight.resize(factor.size(), 1.0f);
  for (size_t v = 0; v < factor.size(); ++v) d.weight[v] = std::min(d.weight[v] * factor[v], kMostWeight);
  // Small patches lie on small triangles.
  const size_t triangles = d.ground->triangles.triangles.size(),
               wanted = std::clamp<size_t>(24 * size_t{patches}, kReducedTriangles, kMostReducedTriangles);
  if (8 * size_t{patches} > triangles || (!isWhole(*d.ground, d.mesh) && 2 * wanted > 3 * triangles)) {
    const ViewDirection known = d.ground->view_direction;
    if (auto done = d.prepare(wanted, patches, &known); !done) return done.error();
  }
  d.followBorders(misses);
  auto candidate = d.leastBad(patches, most_patches);
  if (!candidate) return candidate.error();
  return d.finish(std::move(*candidate));
}

Result<BaseMesh> makeBaseMesh(const TriMesh& mesh, const BaseDomainOptions& options) {
  auto domain = BaseDomain::create(mesh, options);
  if (!domain) return domain.error();
  return (*domain)->make();
}

}  // namespace relievo
