#include "geometry/remesh/base_domain.h"

#include <algorithm>
#include <cmath>
#include <limits>
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

struct Candidate {
  QuadMesh quads;
  std::vector<glm::dvec3> normals;
  std::vector<uint32_t> regions;  // cornerRegions
  size_t folded = 0, flat = 0;    // corners; flat: along borders, in quads with angles of nearly 0 or 180 degrees
  double lost = 1;                // Fit
  double deviation = 0;           // borderDeviation
  // A folded corner spoils a part of its quads; a flat one wastes samples.
  double badness() const {
    if (quads.quads.empty()) return 2;
    return lost +
           (0.3 * static_cast<double>(folded) + 0.015 * static_cast<double>(flat)) /
               static_cast<double>(quads.points.size()) +
           deviation;
  }
};

// How much farther than it must (by feature curve) the scan's border strays from the base's sides: deviationFromSide.
double borderDeviation(const QuadMesh& m, const std::vector<glm::dvec3>& normals, std::span<const FeatureCurve> curves,
                       std::span<const double> must) {
  double deviation = 0;
  auto side = [&](uint32_t curve, const CurveEnd& a, const CurveEnd& b) {
    deviation = std::max(deviation, deviationFromSide(curves[curve], a, b) - must[curve]);
  };
  std::vector<uint8_t> bare(curves.size());  // with no corner between their ends
  for (size_t r = 0; r < curves.size(); ++r) bare[r] = curves[r].border;
  for (uint32_t c = 0; c < m.points.size(); ++c) {
    const CurvePlace& at = m.place[c];
    if (m.fixed[c] || at.curve == kNoIndex || !curves[at.curve].border || at.before == kNoIndex || at.after == kNoIndex)
      continue;
    bare[at.curve] = 0;
    const CurveEnd here{m.points[c], normals[c], at.along};
    side(at.curve, {m.points[at.before], normals[at.before], m.fixed[at.before] ? 0 : m.place[at.before].along}, here);
    if (m.fixed[at.after]) side(at.curve, here, {m.points[at.after], normals[at.after], curves[at.curve].length()});
  }
  for (uint32_t r = 0; r < curves.size(); ++r) {
    if (!bare[r]) continue;
    CurveEnd ends[2];
    for (int k = 0; k < 2; ++k) {
      const glm::dvec3 p = k ? curves[r].points.back() : curves[r].points.front();
      const auto found = std::find(m.points.begin(), m.points.end(), p);
      if (found != m.points.end()) ends[k] = {p, normals[found - m.points.begin()], k ? curves[r].length() : 0};
    }
    if (ends[0].normal != glm::dvec3(0) && ends[1].normal != glm::dvec3(0)) side(r, ends[0], ends[1]);
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
  const Surface& surface;
  ScanLookup scan;
  FeatureCurves curves;
  Fans fans;
  ViewDirection view_direction;
  size_t scan_vertices;
  std::vector<FeatureCurve> flat_curves;
  std::vector<double> allowed_deviation;  // of a border feature curve, be there ever so many patches
  const std::atomic<bool>* interrupted;

  // Empty if the scan is no four-sided sheet, or its border is not followed by a grid.
  Candidate sheet(uint32_t patches) const {
    uint32_t times = 1;
    if (const size_t few = sheetQuads(curves.curves, surface.pieces.size(), scan, 0).quads.size(); few && !patches) {
      times = static_cast<uint32_t>(
          std::ceil(std::sqrt(static_cast<double>(scan_vertices) / static_cast<double>(few)) / kVerticesAlong));
    }
    for (uint32_t tries = 0; tries < 4; ++tries, times *= 2) {
      Candidate c{.quads = sheetQuads(curves.curves, surface.pieces.size(), scan, patches, times)};
      if (c.quads.quads.empty()) break;
      c.regions = cornerRegions(c.quads, surface, fans, scan);
      if (isRelief(view_direction)) {
        c.normals.assign(c.quads.points.size(), view_direction.direction);
      } else {
        c.normals = cornerNormals(c.quads, surface, c.regions, scan);
      }
      c.deviation = borderDeviation(c.quads, c.normals, curves.curves, allowed_deviation);
      if (c.deviation <= 0) return c;
      if (patches) break;
    }
    return {};
  }

  // Of each border feature curve by sides of so many squares; of creases: 1.
  std::vector<double> deviationFor(double squares, double within) const {
    double area = 0;
    for (const SurfacePiece& p : surface.pieces) area += p.area;
    std::vector<double> deviation(flat_curves.size(), 1.0);
    for (size_t r = 0; r < deviation.size(); ++r) {
      if (flat_curves[r].border) deviation[r] = deviationForSides(flat_curves[r], std::sqrt(area / squares), within);
    }
    return deviation;
  }

  // split: makeQuads. Empty without it where triangles find no partner.
  Candidate make(uint32_t triangles, bool split, const std::vector<float>& weight) const {
    EditMesh coarse(surface, curves);
    // Halved sides of a curve stray a quarter as far.
    const std::vector<double> deviation =
        deviationFor(triangles * std::sqrt(3.0) / 4, (split ? 4 : 1) * kBorderDeviation);
    simplify(coarse, {.triangles = triangles,
                      .weight = weight,
                      .curves = curves.curves,
                      .deviation = deviation,
                      .interrupted = interrupted});
    flipEdges(coarse);
    Candidate c{.quads = makeQuads(coarse, curves.curves, split)};
    if (c.quads.quads.empty()) return c;
    updateNormals(c.quads);
    for (int round = 0; round < 4; ++round) {
      if (isSet(interrupted)) return {};
      if (round) relaxQuads(c.quads, curves.curves, scan, 8);
      if (round == 3) settleBorders(c.quads, curves.curves, allowed_deviation);
      c.regions = cornerRegions(c.quads, surface, fans, scan);
      placeCorners(c.quads, surface, c.regions, scan);
    }
    c.normals = c.quads.normals = cornerNormals(c.quads, surface, c.regions, scan);
    untangleQuads(c.quads, curves.curves, scan);
    return c;
  }

  Candidate make(uint32_t patches, const std::vector<float>& weight) const {
    // Few are better had without the split: its quads are four from one.
    for (uint32_t more = 0; patches < 32 && more < 3; ++more) {
      Candidate c = make(2 * patches + 2 * more, false, weight);
      if (c.quads.quads.empty() || 10 * c.quads.quads.size() > 13 * patches) continue;
      const QuadStars stars(c.quads);
      bool fair = true;
      for (uint32_t v = 0; v < c.quads.points.size(); ++v) fair = fair && stars.leastSine(c.quads, v) > 0.2;
      if (fair) return c;
    }
    return make(std::max(4u, patches / 2), true, weight);
  }

  // How badly the candidate lies. Where it lost the surface, the next one gets smaller patches: weight.
  void judge(Candidate& c, std::vector<float>& weight) const {
    const double cells = std::sqrt(40000.0 / static_cast<double>(c.quads.quads.size()));
    const Fit fit = judgeFit(c.quads, c.normals, surface, scan, std::max(static_cast<int>(cells), 4));
    const std::vector<uint8_t> folded = foldedCorners(c.quads, c.normals);
    c.folded = static_cast<size_t>(std::count(folded.begin(), folded.end(), 1));
    const QuadStars stars(c.quads);
    for (uint32_t k = 0; k < c.quads.points.size(); ++k) {
      const uint32_t curve = c.quads.place[k].curve;
      c.flat += curve != kNoIndex && curves.curves[curve].border && stars.leastSine(c.quads, k) < kFlatSine;
    }
    c.lost = fit.lost;
    c.deviation = borderDeviation(c.quads, c.normals, curves.curves, allowed_deviation);
    raiseWeights(fit, folded, c.regions, surface, weight);
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

Result<void> checkAreas(const Surface& scan, const Frame& frame) {
  for (const SurfacePiece& p : scan.pieces) {
    if (p.area > 1e-14) continue;
    const glm::dvec3 at = glm::dvec3(scan.points[scan.triangles[p.first_triangle][0]]) * frame.diagonal + frame.centre;
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
Result<Candidate> bestOf(const Maker& maker, const BaseDomainOptions& options) {
  // A number of patches: three times, with smaller patches where the surface was lost. None: ever more, too.
  std::vector<uint32_t> numbers(3, options.patches);
  if (options.patches == 0) numbers.assign(std::begin(kNumbers), std::end(kNumbers));
  Candidate best;
  int in_vain = 0;
  std::vector<float> weight;
  for (size_t i = 0; i < numbers.size(); ++i) {
    if (isSet(options.interrupted)) return interruptedError();
    Candidate candidate = i == 0 ? maker.sheet(options.patches) : Candidate{};
    // Whatever is lost of a relief's walls is due to the fit's coarse grids.
    if (!candidate.quads.quads.empty() && isRelief(maker.view_direction)) return candidate;
    if (candidate.quads.quads.empty()) candidate = maker.make(numbers[i], weight);
    if (isSet(options.interrupted)) return interruptedError();
    report(options, 0.5 + 0.5 * static_cast<double>(i + 1) / static_cast<double>(numbers.size() + 1));
    if (candidate.quads.quads.empty()) continue;
    maker.judge(candidate, weight);
    const bool enough = candidate.badness() <= (options.patches ? kLostEnough / 10 : kLostEnough);
    // More patches must be worth it: borders of steps, say, take ever more of them and never fit.
    const double least_gain = options.patches || best.quads.quads.empty() ? 1 : kWorthIt;
    const bool gain = candidate.badness() < least_gain * best.badness();
    if (gain) best = std::move(candidate);
    in_vain = gain ? 0 : in_vain + 1;
    if (enough || (options.patches == 0 && in_vain == 2)) break;
  }
  return best;
}

BaseMesh baseMeshOf(const Candidate& best, const Frame& frame, const glm::dvec3& origin_mm) {
  BaseMesh base;
  base.origin_mm = origin_mm;
  for (size_t c = 0; c < best.quads.points.size(); ++c) {
    base.corners.push_back(
        {glm::vec3(best.quads.points[c] * frame.diagonal + frame.centre), glm::vec3(glm::normalize(best.normals[c]))});
  }
  // Against the clock from (0, 0): down, right, up (base_mesh.h, orientation).
  for (const auto& q : best.quads.quads) base.patches.push_back({q[0], q[3], q[1], q[2]});
  orderPatches(base);
  return base;
}

}  // namespace

Result<BaseMesh> makeBaseMesh(const TriMesh& mesh, const BaseDomainOptions& options) {
  auto stopped = [&] { return isSet(options.interrupted); };
  if (options.patches > kMaxPatches)
    return Error{ErrorKind::kUsage, {}, "more than 2^20 patches are asked for", "ask for fewer", {}};
  report(options, 0);
  // What is coarser than some 24 edges of a base made of these.
  const size_t wanted = std::max<size_t>(24000, 3 * size_t{options.patches});
  Frame frame;
  auto scan = surfaceOf(mesh, options, wanted, frame);
  if (!scan) return scan.error();
  if (auto sound = checkAreas(*scan, frame); !sound) return sound.error();
  // Each corner owns some of the surface's vertices: there must be enough of them.
  while (scan->triangles.size() < std::max<size_t>(4000, 8 * size_t{options.patches})) *scan = subdivided(*scan);
  if (stopped()) return interruptedError();
  report(options, 0.4);
  // Of the scan itself: the reduced one's walls lean over.
  const ViewDirection view_direction = scan->pieces.size() == 1 ? viewDirectionOf(mesh.positions_mm, mesh.triangles,
                                                                                  options.workers, options.interrupted)
                                                                : ViewDirection{};
  if (stopped()) return interruptedError();
  if (options.scan_done) options.scan_done();

  const std::vector<BorderLine> borders = bordersOf(*scan);
  const Reduced reduced = reduceSurface(std::move(*scan), wanted, borderCorners(borders), options.interrupted);
  if (stopped()) return interruptedError();
  report(options, 0.5);
  TriMesh triangle_mesh;
  triangle_mesh.positions_mm = reduced.surface.points;
  triangle_mesh.triangles = reduced.surface.triangles;
  auto scene = RayScene::create(triangle_mesh, options.interrupted);
  if (!scene) return scene.error();
  Maker maker{reduced.surface,
              {triangle_mesh, **scene},
              findFeatureCurves(borders, reduced),
              Fans(reduced.surface),
              view_direction,
              mesh.positions_mm.size(),
              {},
              {},
              options.interrupted};
  maker.flat_curves = flattened(maker.curves.curves, view_direction);
  maker.allowed_deviation = maker.deviationFor(std::max(options.patches, std::end(kNumbers)[-1]), kBorderDeviation);

  auto best = bestOf(maker, options);
  if (!best) return best.error();
  if (best->quads.quads.empty())
    return Error{ErrorKind::kInvalidData, {}, "no base mesh was found for this scan", {}, {}};
  BaseMesh base = baseMeshOf(*best, frame, mesh.origin_mm);
  if (std::string problem = baseMeshProblem(base); !problem.empty())
    return Error{ErrorKind::kInvalidData, {}, "no base mesh for this scan: " + problem, {}, {}};
  report(options, 1);
  return base;
}

}  // namespace relievo
