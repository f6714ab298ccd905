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
#include "geometry/remesh/base_faces.h"
#include "geometry/remesh/base_fit.h"
#include "geometry/remesh/base_quads.h"
#include "geometry/remesh/base_reduce.h"
#include "geometry/remesh/base_sheet.h"
#include "geometry/remesh/base_simplify.h"
#include "geometry/remesh/base_topology.h"
#include "geometry/remesh/chunk_reduce.h"
#include "geometry/remesh/coarse_mesh.h"
#include "geometry/remesh/corner_placement.h"

namespace relievo {

namespace {

// Normalised coordinates: relative to the bounding box's centre, in units of its diagonal.
struct Frame {
  glm::dvec3 centre{0};
  double diagonal = 1;
};

template <class Triangles>
Frame frameOf(const std::vector<glm::vec3>& points, const Triangles& triangles) {
  glm::vec3 lo(std::numeric_limits<float>::infinity()), hi = -lo;
  for (const auto& t : triangles) {
    for (uint32_t v : t) {
      if (v >= points.size()) return {};  // makeSurface() refuses it later
      lo = glm::min(lo, points[v]);
      hi = glm::max(hi, points[v]);
    }
  }
  return {(glm::dvec3(lo) + glm::dvec3(hi)) / 2.0, glm::length(glm::dvec3(hi) - glm::dvec3(lo))};
}

// The share of the surface's area that may be lost in undercuts if the number of patches is free, and that may be when
// a bake is to tell how much it is; by what factor more patches must lower the cost; the sine of an angle that counts
// as flat; and the numbers of patches to try. More patches than the last would pin too many pages.
constexpr double kAcceptableLoss = 0.0015, kWorthTrying = 0.02;
constexpr double kMinGain = 0.75;
constexpr double kFlatSine = 0.2;
constexpr uint32_t kPatchCounts[] = {64, 160, 320, 560, 800};
// The scan's vertices along a side of a sheet's patch: half as many as the cells that a bake chooses at most
// (height_search.cpp).
constexpr double kVerticesPerSide = 512;
// Triangles of the reduced scan: at first, and at most if many patches are needed.
constexpr size_t kReducedTriangles = 24000, kMaxReducedTriangles = 160000;
// The largest weight: 16 halves a side, so that 16^4 makes sides a 16th as long.
constexpr float kMaxWeight = 65536.0f;
// Cells of a base at which it is evaluated.
constexpr size_t kEvaluationCells = 40000;

struct Candidate {
  QuadMesh quads;
  Regions regions;
  size_t folded = 0, flat = 0;  // numbers of corners; flat: at borders, with an angle of nearly 0 or 180 degrees
  double lost_area = 1;         // as in Fit
  double deviation = 0;         // as borderDeviation() returns it
  bool empty() const { return quads.n_faces() == 0; }
  // A weighted sum: a folded corner spoils a part of its quads, a flat one wastes samples.
  double cost() const {
    if (empty()) return 2;
    return lost_area +
           (0.3 * static_cast<double>(folded) + 0.015 * static_cast<double>(flat)) /
               static_cast<double>(quads.n_vertices()) +
           deviation;
  }
};

// By how much the scan's borders exceed the allowed deviation (one for each feature curve) from the base's sides.
double borderDeviation(const QuadMesh& m, std::span<const FeatureCurve> curves, std::span<const double> allowed) {
  double deviation = 0;
  auto end = [&](const SmartHalfedgeHandle& h) {
    return CurveEnd{m.point(h.from()), m.normal(h.from()), m.data(h).curve_position.arc_length};
  };
  for (const auto e : m.edges()) {
    const uint32_t curve = m.data(e.h0()).curve_position.curve;
    if (curve == kNoIndex || !curves[curve].border) continue;
    deviation = std::max(deviation, deviationFromSide(curves[curve], end(e.h0()), end(e.h1())) - allowed[curve]);
  }
  return deviation;
}

// Projects borders along the view direction of a relief, since heights restore deviations along it.
std::vector<FeatureCurve> flattened(std::vector<FeatureCurve> curves, const ViewDirection& view_direction) {
  if (!isRelief(view_direction)) return curves;
  for (FeatureCurve& curve : curves) {
    for (size_t i = 0; i < curve.points.size(); ++i) {
      curve.points[i] -= view_direction.direction * glm::dot(curve.points[i], view_direction.direction);
      curve.arc_lengths[i] = i ? curve.arc_lengths[i - 1] + glm::length(curve.points[i] - curve.points[i - 1]) : 0;
    }
  }
  return curves;
}

bool isSet(const std::atomic<bool>* interrupted) { return interrupted && interrupted->load(std::memory_order_relaxed); }

struct BaseMeshBuilder {
  TriangleMesh surface;
  RegionTables tables;  // of the surface
  size_t pieces;
  double area;
  ScanSurface scan;
  std::vector<FeatureCurve> curves;
  ViewDirection view_direction;
  size_t scan_vertices;
  std::vector<FeatureCurve> flat_curves;
  std::vector<double> allowed_deviation;  // for each border feature curve, at the largest number of patches
  // For each feature curve: it was missed, and is to be followed closely however rough it is; or empty.
  std::vector<uint8_t> follow_closely;
  double crease_length_per_node = 0;  // findFeatureCurves()
  bool follow_folds = false;          // SimplifyOptions
  const std::atomic<bool>* interrupted;
  int workers;

  // A grid over a four-sided sheet; empty if the scan is none, or its border deviates from the grid too far.
  Candidate makeSheet(uint32_t patches) const {
    uint32_t multiple = 1;
    if (const size_t fewest = sheetQuads(curves, pieces, scan, 0).n_faces(); fewest && !patches) {
      multiple = static_cast<uint32_t>(
          std::ceil(std::sqrt(static_cast<double>(scan_vertices) / static_cast<double>(fewest)) / kVerticesPerSide));
    }
    for (uint32_t tries = 0; tries < 4; ++tries, multiple *= 2) {
      Candidate c{.quads = sheetQuads(curves, pieces, scan, patches, multiple)};
      if (c.empty()) break;
      c.regions = cornerRegions(c.quads, tables, scan);
      if (isRelief(view_direction)) {
        for (const auto v : c.quads.vertices()) c.quads.set_normal(v, view_direction.direction);
      } else {
        assignNormals(c.quads, tables, c.regions, scan);
      }
      c.deviation = borderDeviation(c.quads, curves, allowed_deviation);
      if (c.deviation <= 0) return c;
      if (patches) break;
    }
    return {};
  }

  // The allowed deviation of each border feature curve if `squares` square patches cover the area; 1 for creases.
  std::vector<double> deviationFor(double squares, double tolerance) const {
    std::vector<double> deviation(flat_curves.size(), 1.0);
    for (size_t r = 0; r < deviation.size(); ++r) {
      if (!flat_curves[r].border) continue;
      deviation[r] = r < follow_closely.size() && follow_closely[r]
                         ? 0.25 * kBorderDeviation
                         : deviationForSides(flat_curves[r], std::sqrt(area / squares), tolerance);
    }
    return deviation;
  }

  // split: as makeQuads() has it; without it the result is empty if triangles find no partner.
  Candidate make(uint32_t triangles, bool split, const std::vector<float>& weight) const {
    TriangleMesh coarse = surface;
    // The split halves a curve's sides, which then deviate a quarter as far.
    const std::vector<double> deviation =
        deviationFor(triangles * std::sqrt(3.0) / 4, (split ? 4 : 1) * kBorderDeviation);
    simplify(coarse, {.triangles = triangles,
                      .weight = weight,
                      .curves = curves,
                      .allowed_deviation = deviation,
                      .follow_folds = follow_folds,
                      .interrupted = interrupted});
    flipEdges(coarse);
    Candidate c{.quads = makeQuads(coarse, curves, split)};
    if (c.empty()) return c;
    updateNormals(c.quads);
    for (int round = 0; round < 4; ++round) {
      if (isSet(interrupted)) return {};
      if (round) relaxQuads(c.quads, curves, scan, 8);
      if (round == 3) fitBorderCorners(c.quads, curves, allowed_deviation);
      c.regions = cornerRegions(c.quads, tables, scan);
      placeCorners(c.quads, tables, c.regions, scan);
    }
    assignNormals(c.quads, tables, c.regions, scan);
    untangleQuads(c.quads, curves, scan);
    return c;
  }

  Candidate make(uint32_t patches, const std::vector<float>& weight) const {
    // Few patches are made without the split, since it makes four quads of each pair.
    for (uint32_t extra = 0; patches < 32 && extra < 3; ++extra) {
      Candidate c = make(2 * patches + 2 * extra, false, weight);
      if (c.empty() || 10 * c.quads.n_faces() > 13 * patches) continue;
      bool well_shaped = true;
      for (const auto v : c.quads.vertices()) well_shaped = well_shaped && minSine(c.quads, v) > 0.2;
      if (well_shaped) return c;
    }
    return make(std::max(4u, patches / 2), true, weight);
  }

  // Evaluates a candidate, and raises the weights where it lost the surface, so that the next one gets smaller patches
  // there.
  void evaluate(Candidate& c, std::vector<float>& weight, bool detailed) const {
    const size_t cells = detailed ? std::max(kEvaluationCells, 40 * c.quads.n_faces()) : kEvaluationCells;
    const Fit fit = measureFit(c.quads, surface, scan, cells, detailed, workers);
    for (const auto v : c.quads.vertices()) {
      c.folded += isFolded(c.quads, v);
      c.flat += v.is_boundary() && !c.quads.data(v).fixed && minSine(c.quads, v) < kFlatSine;
    }
    c.lost_area = fit.lost_area;
    c.deviation = borderDeviation(c.quads, curves, allowed_deviation);
    raiseWeights(fit, c.quads, surface, c.regions, weight);
  }
};

// Sorts patches along a space-filling curve, and corners by the patches, so that bakes and streaming find neighbours
// together.
void orderPatches(BaseMesh& base) {
  glm::vec3 low(std::numeric_limits<float>::infinity()), high = -low;
  for (const BaseCorner& c : base.corners) {
    low = glm::min(low, c.position_mm);
    high = glm::max(high, c.position_mm);
  }
  std::vector<std::pair<uint32_t, std::array<uint32_t, 4>>> sorted_patches;
  for (const auto& patch : base.patches) {
    glm::vec3 centre(0);
    for (uint32_t c : patch) centre += 0.25f * base.corners[c].position_mm;
    sorted_patches.emplace_back(placeOnCurve(centre, low, high), patch);
  }
  std::stable_sort(sorted_patches.begin(), sorted_patches.end(),
                   [](const auto& a, const auto& b) { return a.first < b.first; });
  std::vector<uint32_t> new_index(base.corners.size(), kNoIndex);
  std::vector<BaseCorner> corners;
  auto indexOf = [&](uint32_t c) {
    if (new_index[c] == kNoIndex) {
      new_index[c] = static_cast<uint32_t>(corners.size());
      corners.push_back(base.corners[c]);
    }
    return new_index[c];
  };
  for (size_t p = 0; p < sorted_patches.size(); ++p)
    for (size_t k = 0; k < 4; ++k) base.patches[p][k] = indexOf(sorted_patches[p].second[k]);
  for (uint32_t c = 0; c < new_index.size(); ++c) indexOf(c);
  base.corners = std::move(corners);
}

Error interruptedError() { return {ErrorKind::kInterrupted, {}, "interrupted", {}, {}}; }

void report(const BaseDomainOptions& options, double done) {
  if (options.progress) options.progress(done);
}

// The scan's surface in normalised coordinates. A dense scan is reduced to four times `target_triangles` first.
Result<Surface> normalisedSurface(const TriMesh& mesh, const BaseDomainOptions& options, size_t target_triangles,
                                  Frame& frame) {
  if (mesh.triangles.size() >= kManyTriangles && mesh.triangles.size() >= 16 * target_triangles) {
    frame = frameOf(mesh.positions_mm, mesh.triangles);
    auto reduced = reduceByChunks(mesh, {.triangles = 4 * target_triangles,
                                         .centre = frame.centre,
                                         .diagonal = frame.diagonal,
                                         .workers = options.workers,
                                         .progress = [&](double done) { report(options, 0.4 * done); },
                                         .interrupted = options.interrupted});
    if (isSet(options.interrupted)) return interruptedError();
    if (reduced) return std::move(*reduced);
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

std::vector<BorderLoop> bordersOf(const Surface& scan) {
  std::vector<BorderLoop> borders;
  for (const auto& loop : scan.loops) {
    borders.push_back({loop, {}});
    for (uint32_t v : loop) borders.back().points.push_back(scan.points[v]);
  }
  return borders;
}

// Candidates of several numbers of patches. A given number is tried three times, with smaller patches where the surface
// was lost. A free one grows, too.
class CandidateSeries {
 public:
  CandidateSeries() = default;
  explicit CandidateSeries(uint32_t patches) : free_(patches == 0), counts_(3, patches) {
    if (free_) counts_.assign(std::begin(kPatchCounts), std::end(kPatchCounts));
  }
  // The best of the next candidates, until one of a free number is worth trying; empty if none is clearly better than
  // those before.
  Result<Candidate> next(const BaseMeshBuilder& builder, const BaseDomainOptions& options, std::vector<float>& weight);
  // The next candidate, which is to lose nothing to speak of; empty if there is none, or it does.
  Result<Candidate> finer(const BaseMeshBuilder& builder, const BaseDomainOptions& options, std::vector<float>& weight);
  bool over() const { return over_ || next_ == counts_.size(); }

 private:
  bool free_ = true;
  std::vector<uint32_t> counts_;
  size_t next_ = 0;
  bool over_ = false;  // nothing of what is left would lose less
  int rounds_without_gain_ = 0;
  size_t last_ = 0;  // patches of the previous candidate; 0: there is none, or a relief's grid
  double least_cost_ = std::numeric_limits<double>::infinity();  // of all candidates
};

Result<Candidate> CandidateSeries::next(const BaseMeshBuilder& builder, const BaseDomainOptions& options,
                                        std::vector<float>& weight) {
  Candidate best;
  while (!over()) {
    if (isSet(options.interrupted)) return interruptedError();
    const size_t i = next_++;
    Candidate candidate = i == 0 ? builder.makeSheet(options.patches) : Candidate{};
    // A relief loses nothing: what the evaluation would report stems from its coarse cells.
    if (!candidate.empty() && isRelief(builder.view_direction)) {
      candidate.lost_area = 0;
      over_ = true;
      return candidate;
    }
    // Small pieces need a minimum of patches: numbers below what the last candidate had bring nothing new.
    if (free_ && i > 0 && 5 * last_ > 6 * counts_[i]) continue;
    if (candidate.empty()) candidate = builder.make(counts_[i], weight);
    if (isSet(options.interrupted)) return interruptedError();
    report(options, 0.5 + 0.5 * static_cast<double>(i + 1) / static_cast<double>(counts_.size() + 1));
    if (candidate.empty()) continue;
    last_ = candidate.quads.n_faces();
    builder.evaluate(candidate, weight, false);
    const double cost = candidate.cost();
    // More patches must lower the cost clearly: borders with steps, say, take ever more of them and never fit.
    const bool gain = cost < (free_ ? kMinGain : 1) * least_cost_;
    if (gain) best = std::move(candidate), least_cost_ = cost;
    rounds_without_gain_ = gain ? 0 : rounds_without_gain_ + 1;
    over_ = cost <= (free_ ? kAcceptableLoss : kAcceptableLoss / 10) || (free_ && rounds_without_gain_ == 2);
    if (free_ && gain && cost <= kWorthTrying) break;
  }
  return best;
}

Result<Candidate> CandidateSeries::finer(const BaseMeshBuilder& builder, const BaseDomainOptions& options,
                                         std::vector<float>& weight) {
  if (!free_ || next_ == counts_.size() || last_ == 0 || 5 * last_ > 6 * counts_[next_]) return Candidate{};
  Candidate candidate = builder.make(counts_[next_++], weight);
  if (isSet(options.interrupted)) return interruptedError();
  if (candidate.empty()) return candidate;
  last_ = candidate.quads.n_faces();
  builder.evaluate(candidate, weight, false);
  return candidate.cost() <= kAcceptableLoss ? std::move(candidate) : Candidate{};
}

BaseMesh baseMeshOf(const QuadMesh& quads, const Frame& frame) {
  BaseMesh base;
  for (const auto v : quads.vertices())
    base.corners.push_back(
        {glm::vec3(quads.point(v) * frame.diagonal + frame.centre), glm::vec3(glm::normalize(quads.normal(v)))});
  // Counter-clockwise from (0, 0): down, right, up (base_mesh.h, orientation).
  for (const auto f : quads.faces()) {
    std::array<uint32_t, 4> patch;
    size_t k = 0;
    for (const auto v : f.vertices()) patch[std::array{0, 2, 3, 1}[k++]] = static_cast<uint32_t>(v.idx());
    base.patches.push_back(patch);
  }
  return base;
}

// Positions become multiples of a power of two: heights are measured from wherever corners are, and a package keeps
// fewer bits of round numbers. For bases that do not lie on the scan anyway.
void roundPositions(BaseMesh& base, double diagonal) {
  constexpr double kOfDiagonal = 1.0 / 65536, kOfSide = 1.0 / 32;
  double most = kOfDiagonal * diagonal;
  for (const auto& patch : base.patches)
    for (const auto& side : kSideCorners)
      most = std::min(most,
                      kOfSide * glm::length(glm::dvec3(base.corners[patch[static_cast<size_t>(side[0])]].position_mm) -
                                            glm::dvec3(base.corners[patch[static_cast<size_t>(side[1])]].position_mm)));
  if (!(most > 0)) return;
  const double step = std::exp2(std::floor(std::log2(most)));
  for (BaseCorner& c : base.corners) c.position_mm = glm::vec3(glm::round(glm::dvec3(c.position_mm) / step) * step);
}
// The same of normals, towards 0, so that none is longer than 1.
void roundNormals(BaseMesh& base) {
  constexpr float kSteps = 4096;
  for (BaseCorner& c : base.corners) c.normal = glm::trunc(c.normal * kSteps) / kSteps;
}

// With its origin, and its patches in their order; or what is wrong with it.
Result<BaseMesh> completed(BaseMesh base, const glm::dvec3& origin_mm) {
  base.origin_mm = origin_mm;
  orderPatches(base);
  if (std::string problem = baseMeshProblem(base); !problem.empty())
    return Error{ErrorKind::kInvalidData, {}, "no base mesh for this scan: " + problem, {}, {}};
  return base;
}

// The reduced scan, from which base meshes are made, in normalised coordinates.
struct ReducedScan {
  Frame frame;
  std::vector<BorderLoop> borders;
  Reduced reduced;
  TriMesh triangles;  // of the reduced surface
  std::unique_ptr<RayScene> scene;
  ViewDirection view_direction;

  glm::dvec3 toFrame(const glm::dvec3& p) const { return (p - frame.centre) / frame.diagonal; }
};

bool isUnreduced(const ReducedScan& g, const TriMesh& mesh) {
  return g.triangles.triangles.size() >= mesh.triangles.size();
}

void beginSerialPhase(BaseDomainOptions& options) {
  if (const auto begin = std::exchange(options.on_serial_phase, nullptr)) begin();
}

// The scan in normalised coordinates, checked.
struct NormalisedScan {
  Surface surface;
  Frame frame;
};
Result<NormalisedScan> normalisedScan(const TriMesh& mesh, const BaseDomainOptions& options, size_t target_triangles) {
  NormalisedScan out;
  auto surface = normalisedSurface(mesh, options, target_triangles, out.frame);
  if (!surface) return surface.error();
  if (auto sound = checkAreas(*surface, out.frame, options.mm_per_unit); !sound) return sound.error();
  out.surface = std::move(*surface);
  return out;
}

// Reduces the scan to about target_triangles, but so that each corner of `patches` patches owns several of them.
Result<ReducedScan> reduceScan(const TriMesh& mesh, NormalisedScan normalised, BaseDomainOptions& options,
                               size_t target_triangles, size_t patches, const ViewDirection* known) {
  ReducedScan out;
  out.frame = normalised.frame;
  Surface* scan = &normalised.surface;
  while (scan->triangles.size() < std::max<size_t>(4000, 8 * patches)) *scan = subdivided(*scan);
  if (isSet(options.interrupted)) return interruptedError();
  report(options, 0.4);
  if (known) {
    out.view_direction = *known;
  } else if (scan->pieces.size() == 1) {
    // Computed from the scan itself, since reduction tilts steep walls.
    out.view_direction = viewDirectionOf(mesh.positions_mm, mesh.triangles, options.workers, options.interrupted);
  }
  if (isSet(options.interrupted)) return interruptedError();
  beginSerialPhase(options);
  out.borders = bordersOf(*scan);
  out.reduced = reduceSurface(std::move(*scan), target_triangles, borderCorners(out.borders), options.interrupted);
  if (isSet(options.interrupted)) return interruptedError();
  report(options, 0.5);
  out.triangles.positions_mm = out.reduced.surface.points;
  out.triangles.triangles = out.reduced.surface.triangles;
  return out;
}

// Ends and forks of creases become corners of patches, so that a crease must be long compared with their sides.
double creaseLengthPerNode(double area, uint32_t patches) {
  constexpr double kMostDiagonals = 0.25, kSides = 6;
  return std::min(kMostDiagonals, kSides * std::sqrt(area / patches));
}

// reduced_scan must outlive the result and not move.
Result<BaseMeshBuilder> builderOf(ReducedScan& reduced_scan, size_t scan_vertices, uint32_t max_patches,
                                  const std::atomic<bool>* interrupted, int workers) {
  auto scene = RayScene::create(reduced_scan.triangles, interrupted);
  if (!scene) return scene.error();
  reduced_scan.scene = std::move(*scene);
  TriangleMesh half_edges = halfEdgeMeshOf(reduced_scan.reduced.surface);
  RegionTables tables(half_edges);
  BaseMeshBuilder builder{.surface = std::move(half_edges),
                          .tables = std::move(tables),
                          .pieces = reduced_scan.reduced.surface.pieces.size(),
                          .area = areaOf(reduced_scan.reduced.surface),
                          .scan = {reduced_scan.triangles, *reduced_scan.scene},
                          .view_direction = reduced_scan.view_direction,
                          .scan_vertices = scan_vertices,
                          .interrupted = interrupted,
                          .workers = workers};
  builder.crease_length_per_node = creaseLengthPerNode(builder.area, max_patches);
  builder.curves = findFeatureCurves(reduced_scan.borders, reduced_scan.reduced.vertex, builder.crease_length_per_node,
                                     builder.surface);
  builder.flat_curves = flattened(builder.curves, reduced_scan.view_direction);
  builder.allowed_deviation = builder.deviationFor(max_patches, kBorderDeviation);
  return builder;
}

// Of each triangle: the image that it shows, or which of a few plain colours; none: all look alike.
std::vector<uint32_t> looksOf(const TriMesh& mesh) {
  constexpr size_t kFew = 64;  // of more colours pairs would be rare
  auto isFew = [](const MeshImage& image) { return image.palette.size() > 1 && image.palette.size() <= kFew; };
  if (mesh.images.size() < 2 && std::none_of(mesh.images.begin(), mesh.images.end(), isFew)) return {};
  std::vector<uint32_t> looks;
  looks.reserve(mesh.triangles.size());
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    const uint16_t image = mesh.image_of.empty() ? uint16_t{0} : mesh.image_of[t];
    uint32_t colour = 0;
    if (image < mesh.images.size() && isFew(mesh.images[image])) {
      const double colours = static_cast<double>(mesh.images[image].palette.size()), u = mesh.corner_uv[t][0].x;
      colour = static_cast<uint32_t>(std::clamp(u, 0.0, 1.0) * colours);
    }
    looks.push_back(uint32_t{image} << 16 | colour);
  }
  return looks;
}

}  // namespace

struct BaseDomain::Impl {
  const TriMesh& mesh;
  BaseDomainOptions options;           // without on_serial_phase once it was called
  std::optional<NormalisedScan> scan;  // until it is reduced, or seems not to be needed
  std::unique_ptr<ReducedScan> reduced_scan;
  std::optional<BaseMeshBuilder> builder;
  std::vector<float> weight;        // for each vertex of the reduced surface
  std::vector<float> faces_weight;  // the same, of simplifiedFaces(); empty before its first call
  Candidate last;                   // the last base mesh
  CandidateSeries series;           // of make() and grow()

  Result<BaseMesh> finish(Candidate candidate) {
    last = std::move(candidate);
    if (last.empty()) return Error{ErrorKind::kInvalidData, {}, "no base mesh was found for this scan", {}, {}};
    BaseMesh base = baseMeshOf(last.quads, reduced_scan->frame);
    roundPositions(base, reduced_scan->frame.diagonal);
    roundNormals(base);
    return completed(std::move(base), mesh.origin_mm);
  }
  // Of a base's patch there are then about 24 triangles.
  size_t firstTarget() const { return std::max<size_t>(kReducedTriangles, 3 * size_t{options.patches}); }
  // What all bases but faces() are made from.
  Result<void> prepareOnce() { return builder ? Result<void>() : prepare(firstTarget(), options.patches, nullptr); }
  Result<void> prepare(size_t target_triangles, uint32_t patches, const ViewDirection* known) {
    if (!scan) {
      auto normalised = normalisedScan(mesh, options, target_triangles);
      if (!normalised) return normalised.error();
      scan = std::move(*normalised);
    }
    auto made = reduceScan(mesh, std::move(*scan), options, target_triangles, patches, known);
    scan.reset();
    if (!made) return made.error();
    auto next = std::make_unique<ReducedScan>(std::move(*made));
    auto made_builder = builderOf(*next, mesh.positions_mm.size(), std::max(patches, std::end(kPatchCounts)[-1]),
                                  options.interrupted, options.workers);
    if (!made_builder) return made_builder.error();
    // Transfer the weights found so far to the new surface.
    std::vector<float> moved(next->triangles.positions_mm.size(), 1.0f);
    if (!weight.empty()) {
      for (size_t v = 0; v < moved.size(); ++v) {
        const SurfacePoint at = reduced_scan->scene->closestPoint(glm::dvec3(next->triangles.positions_mm[v]));
        if (!at) continue;
        for (uint32_t w : reduced_scan->triangles.triangles[at.triangle]) moved[v] = std::max(moved[v], weight[w]);
      }
    }
    weight = std::move(moved);
    builder.reset();
    last.regions.clear();
    reduced_scan = std::move(next);
    builder.emplace(std::move(*made_builder));
    return {};
  }
  // Finds the creases that smaller patches can follow.
  Result<void> findMoreCreases(uint32_t patches) {
    auto made = builderOf(*reduced_scan, mesh.positions_mm.size(), patches, options.interrupted, options.workers);
    if (!made) return made.error();
    builder.emplace(std::move(*made));
    return {};
  }
  std::vector<float> refinementFactors(std::span<const RefineRequest> requests) const;
  void followBordersClosely(std::span<const RefineRequest> requests);
  Result<Candidate> bestOfTries(uint32_t patches, uint32_t max_patches);
  uint32_t patchCountFor(const std::vector<float>& factor) const;
  uint32_t refinedCountFor(const std::vector<float>& factor) const;
};

BaseDomain::BaseDomain(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
BaseDomain::~BaseDomain() = default;
size_t BaseDomain::patches() const { return impl_->last.quads.n_faces(); }
double BaseDomain::lostArea() const { return impl_->last.lost_area; }

Result<std::unique_ptr<BaseDomain>> BaseDomain::create(const TriMesh& mesh, const BaseDomainOptions& options) {
  if (options.patches > kMaxPatches)
    return Error{ErrorKind::kUsage, {}, "more than 2^20 patches are asked for", "ask for fewer", {}};
  report(options, 0);
  auto impl = std::unique_ptr<Impl>(new Impl{.mesh = mesh, .options = options});
  auto scan = normalisedScan(mesh, options, impl->firstTarget());
  if (!scan) return scan.error();
  impl->scan = std::move(*scan);
  return std::unique_ptr<BaseDomain>(new BaseDomain(std::move(impl)));
}

Result<BaseMesh> BaseDomain::make() {
  Impl& d = *impl_;
  if (auto done = d.prepareOnce(); !done) return done.error();
  d.weight.clear();
  d.series = CandidateSeries(d.options.patches);
  auto best = d.series.next(*d.builder, d.options, d.weight);
  if (!best) return best.error();
  auto base = d.finish(std::move(*best));
  if (base) report(d.options, 1);
  return base;
}

bool BaseDomain::mayGrow() const { return !impl_->series.over(); }

Result<BaseMesh> BaseDomain::grow(Growth growth) {
  Impl& d = *impl_;
  auto next = growth == Growth::kToLoseLess ? d.series.next(*d.builder, d.options, d.weight)
                                            : d.series.finer(*d.builder, d.options, d.weight);
  if (!next) return next.error();
  if (next->empty())
    return Error{ErrorKind::kUsage, {}, "more patches would not lose less", "refine the last base", {}};
  return d.finish(std::move(*next));
}

// For each vertex, the increase of the patch density around it: 16 halves the patches' sides.
std::vector<float> BaseDomain::Impl::refinementFactors(std::span<const RefineRequest> requests) const {
  const TriangleMesh& s = builder->surface;
  std::vector<float> factor(s.n_vertices(), 1.0f), next;
  for (const RefineRequest& request : requests) {
    const SurfacePoint at = reduced_scan->scene->closestPoint(reduced_scan->toFrame(request.position_mm));
    if (!at) continue;
    for (uint32_t v : reduced_scan->triangles.triangles[at.triangle]) factor[v] = std::max(factor[v], request.factor);
  }
  for (int ring = 0; ring < 3; ++ring) {
    next = factor;
    for (const auto v : s.vertices())
      for (const auto w : v.vertices()) next[v.idx()] = std::max(next[v.idx()], 0.75f * factor[w.idx()]);
    factor.swap(next);
  }
  return factor;
}

// Marks the feature curves of borders that were missed.
void BaseDomain::Impl::followBordersClosely(std::span<const RefineRequest> requests) {
  const TriangleMesh& s = builder->surface;
  std::vector<uint8_t> follow_closely(builder->curves.size(), 0);
  for (const RefineRequest& request : requests) {
    const SurfacePoint at = reduced_scan->scene->closestPoint(reduced_scan->toFrame(request.position_mm));
    if (!at) continue;
    for (const auto v : s.fv_range(FaceHandle(static_cast<int>(at.triangle))))
      for (const auto h : OpenMesh::make_smart(v, s).outgoing_halfedges())
        if (h.edge().is_boundary() && s.data(h).curve_position) follow_closely[s.data(h).curve_position.curve] = 1;
  }
  for (size_t r = 0; r < std::min(follow_closely.size(), builder->follow_closely.size()); ++r)
    follow_closely[r] |= builder->follow_closely[r];
  builder->follow_closely = std::move(follow_closely);
}

// The best of a few candidates, each with smaller patches where the one before lost the surface, since one folded patch
// spoils much.
Result<Candidate> BaseDomain::Impl::bestOfTries(uint32_t patches, uint32_t max_patches) {
  constexpr int kTries = 3;
  constexpr double kNegligibleLoss = 1e-4;
  Candidate best;
  std::vector<float> tried_weight = weight, best_weight = weight;
  for (int tries = 0; tries < kTries; ++tries) {
    Candidate c = builder->make(std::min(patches, max_patches), tried_weight);
    if (isSet(options.interrupted)) return interruptedError();
    if (c.empty()) continue;
    const std::vector<float> used_weight = tried_weight;
    builder->evaluate(c, tried_weight, true);
    for (float& w : tried_weight) w = std::min(w, kMaxWeight);
    const bool enough = c.lost_area <= kNegligibleLoss;
    if (best.empty() || c.cost() < best.cost()) {
      best = std::move(c);
      best_weight = used_weight;
    }
    if (enough) break;
    patches += patches / 12;
  }
  weight = std::move(best_weight);
  return best;
}

// The number of patches at which those where the factor is 1 keep their size.
uint32_t BaseDomain::Impl::patchCountFor(const std::vector<float>& factor) const {
  const auto& quads = last.quads;
  const Regions regions = last.regions.empty() ? cornerRegions(quads, builder->tables, builder->scan) : last.regions;
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

// The same, at least an eighth more than the last base has, and about three times as many at most.
uint32_t BaseDomain::Impl::refinedCountFor(const std::vector<float>& factor) const {
  const auto before = static_cast<uint32_t>(last.quads.n_faces());
  return std::clamp<uint32_t>(patchCountFor(factor), before + before / 8 + 8, 3 * before + 64);
}

uint32_t BaseDomain::patchesToRefine(std::span<const RefineRequest> requests) const {
  return impl_->refinedCountFor(impl_->refinementFactors(requests));
}

Result<BaseMesh> BaseDomain::refine(std::span<const RefineRequest> requests, uint32_t max_patches,
                                    uint32_t least_patches) {
  Impl& d = *impl_;
  std::vector<float> factor = d.refinementFactors(requests);
  const uint32_t patches = std::min(std::max(d.refinedCountFor(factor), least_patches), max_patches);
  d.weight.resize(factor.size(), 1.0f);
  for (size_t v = 0; v < factor.size(); ++v) d.weight[v] = std::min(d.weight[v] * factor[v], kMaxWeight);
  // Smaller patches need a surface of smaller triangles.
  const size_t triangles = d.reduced_scan->triangles.triangles.size(),
               target_triangles = std::clamp<size_t>(24 * size_t{patches}, kReducedTriangles, kMaxReducedTriangles);
  if (8 * size_t{patches} > triangles ||
      (!isUnreduced(*d.reduced_scan, d.mesh) && 2 * target_triangles > 3 * triangles)) {
    const ViewDirection known = d.reduced_scan->view_direction;
    if (auto done = d.prepare(target_triangles, patches, &known); !done) return done.error();
  } else if (creaseLengthPerNode(d.builder->area, patches) < d.builder->crease_length_per_node) {
    if (auto done = d.findMoreCreases(patches); !done) return done.error();
  }
  d.builder->follow_folds = true;
  d.followBordersClosely(requests);
  auto candidate = d.bestOfTries(patches, max_patches);
  if (!candidate) return candidate.error();
  return d.finish(std::move(*candidate));
}

Result<BaseMesh> BaseDomain::faces(uint32_t max_patches) {
  Impl& d = *impl_;
  const Error too_many{ErrorKind::kUsage, {}, "the scan has too many triangles to be patches", "allow for more", {}};
  if (d.mesh.triangles.size() > 2 * size_t{max_patches}) return too_many;
  d.scan.reset();
  beginSerialPhase(d.options);
  auto surface = makeSurface(d.mesh.positions_mm, d.mesh.triangles);
  if (!surface) return surface.error();
  BaseMesh base = facesBase(*surface, max_patches, FaceNormals::kMean, looksOf(d.mesh), d.options.workers);
  if (base.patches.empty()) return too_many;
  return completed(std::move(base), d.mesh.origin_mm);
}

Result<BaseMesh> BaseDomain::simplifiedFaces(std::span<const RefineRequest> requests, uint32_t max_patches) {
  Impl& d = *impl_;
  if (auto done = d.prepareOnce(); !done) return done.error();
  constexpr size_t kOfPatch = 6;  // at least so many, three times as many as a patch has in the end
  const size_t target = std::max(std::min(24 * size_t{max_patches}, kMaxReducedTriangles), kOfPatch * max_patches);
  if (!isUnreduced(*d.reduced_scan, d.mesh) && target > d.reduced_scan->triangles.triangles.size()) {
    const ViewDirection known = d.reduced_scan->view_direction;
    if (auto done = d.prepare(target, max_patches, &known); !done) return done.error();
  }
  const BaseMeshBuilder& b = *d.builder;
  if (d.faces_weight.size() != b.surface.n_vertices()) {
    d.faces_weight.assign(b.surface.n_vertices(), 1.0f);
  } else {
    const std::vector<float> factor = d.refinementFactors(requests);
    for (size_t v = 0; v < factor.size(); ++v) d.faces_weight[v] = std::min(d.faces_weight[v] * factor[v], kMaxWeight);
  }
  const std::vector<double> deviation = b.deviationFor(max_patches, kBorderDeviation);
  constexpr double kUncertainty = 0.05;  // where the surface is flat, triangles may be long
  // Pairs that would fold too much make two patches.
  for (double share : {0.85, 0.7, 0.55}) {
    TriangleMesh coarse = b.surface;
    simplify(coarse, {.triangles = static_cast<uint32_t>(2 * share * max_patches),
                      .uncertainty = kUncertainty,
                      .weight = d.faces_weight,
                      .curves = b.curves,
                      .allowed_deviation = deviation,
                      .follow_folds = true,
                      .interrupted = d.options.interrupted});
    if (isSet(d.options.interrupted)) return interruptedError();
    std::vector<glm::vec3> points;
    std::vector<Triangle> triangles;
    for (const auto v : coarse.vertices()) points.push_back(glm::vec3(coarse.point(v)));
    for (const auto f : coarse.faces()) {
      Triangle& t = triangles.emplace_back();
      size_t k = 0;
      for (const auto v : f.vertices()) t[k++] = static_cast<uint32_t>(v.idx());
    }
    auto surface = makeSurface(points, triangles);
    if (!surface) return surface.error();
    BaseMesh base = facesBase(*surface, max_patches, FaceNormals::kFaced, {}, d.options.workers);
    if (base.patches.empty()) continue;
    for (BaseCorner& c : base.corners)
      c.position_mm =
          glm::vec3(glm::dvec3(c.position_mm) * d.reduced_scan->frame.diagonal + d.reduced_scan->frame.centre);
    return completed(std::move(base), d.mesh.origin_mm);
  }
  return Error{ErrorKind::kUsage, {}, "the scan's simplified triangles are too many patches", "allow for more", {}};
}

Result<BaseMesh> makeBaseMesh(const TriMesh& mesh, const BaseDomainOptions& options) {
  auto domain = BaseDomain::create(mesh, options);
  if (!domain) return domain.error();
  auto base = (*domain)->make();
  while (base && (*domain)->mayGrow()) {
    auto larger = (*domain)->grow();
    if (!larger && larger.error().kind == ErrorKind::kUsage) break;
    base = std::move(larger);
  }
  return base;
}

}  // namespace relievo
