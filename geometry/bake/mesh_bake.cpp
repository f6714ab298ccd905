#include "geometry/bake/mesh_bake.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>
#include <utility>

#include "geometry/bake/height_fit.h"
#include "geometry/bake/line_sweep.h"
#include "geometry/bake/plane_image.h"
#include "geometry/mesh/ray_scene.h"
#include "geometry/mesh/triangle_blocks.h"
#include "src/artwork/planar_domain.h"
#include "src/base/parallel_for.h"

namespace relievo {
namespace {

constexpr int kPageCellsLog2 = 7;  // of a relief page: kPagePx cells
static_assert(1 << kPageCellsLog2 == kPagePx);
constexpr int kMaxCellsLog2 = 14, kMaxAutoCellsLog2 = 10;
constexpr uint64_t kMaxTexels = uint64_t{64} << 20;
constexpr int kTexelChannels = 6;
constexpr uint8_t kGrey = 200;
constexpr size_t kProbes = 20'000;  // 20 of them may lie beyond the 99.9th percentile
constexpr uint64_t kMaxSamples = uint64_t{1} << 32;

// A place of the base surface and the line through it.
struct Frame {
  glm::dvec3 point{0}, normal{0};
};
glm::dvec3 lerp(const glm::dvec3& a, const glm::dvec3& b, double t) { return a * (1 - t) + b * t; }
Frame lerp(const Frame& a, const Frame& b, double t) {
  return {lerp(a.point, b.point, t), lerp(a.normal, b.normal, t)};
}

// Linear on the triangles of a cell, cut along (0,0)-(1,1).
template <class T>
T onCell(const T& c00, const T& c10, const T& c01, const T& c11, double fx, double fy) {
  return fx >= fy ? c00 + (c10 - c00) * fx + (c11 - c10) * fy : c00 + (c01 - c00) * fy + (c11 - c01) * fx;
}

// Lines are looked up by squares of a patch: what they meet lies together, so that few of the scan's hierarchies are
// needed at a time, or few of its triangles swept. Of [0, side)^2, some `wanted` each way.
struct Tiles {
  size_t side, parts;
  Tiles(size_t places, size_t wanted) : side(places), parts(std::max<size_t>(1, (places + wanted / 2) / wanted)) {}
  size_t first(size_t part) const { return part * side / parts; }
  size_t of(size_t place) const {
    size_t part = std::min(place * parts / side, parts - 1);
    while (part > 0 && first(part) > place) --part;
    while (part + 1 < parts && first(part + 1) <= place) ++part;
    return part;
  }
  // visit(x0, y0, x1, y1), until it answers false.
  template <class Visit>
  bool forEach(Visit visit) const {
    for (size_t y = 0; y < parts; ++y)
      for (size_t x = 0; x < parts; ++x)
        if (!visit(first(x), first(y), first(x + 1), first(y + 1))) return false;
    return true;
  }
};

// A grid of n cells a side at (u, v), its cells' triangles linear.
double onGrid(std::span<const uint16_t> grid, size_t n, double u, double v) {
  const double x = u * static_cast<double>(n), y = v * static_cast<double>(n);
  const size_t x0 = std::min(static_cast<size_t>(x), n - 1), y0 = std::min(static_cast<size_t>(y), n - 1);
  const uint16_t* c = grid.data() + y0 * (n + 1) + x0;
  return onCell<double>(c[0], c[1], c[n + 1], c[n + 2], x - static_cast<double>(x0), y - static_cast<double>(y0));
}

}  // namespace

// Samples are kept once each: corners; then the inner samples of each side, from the corner with the smaller index to
// the other; then those inside each patch, by rows. `m` below is the number of inner samples of a side, 2^cells_log2
// - 1.
struct SampleLayout {
  std::vector<std::array<uint32_t, 2>> sides;        // their corners, the smaller index first
  std::vector<std::array<uint32_t, 4>> patch_sides;  // by Side
  std::vector<uint32_t> side_patch;                  // the first patch of each side
  size_t corners = 0, patches = 0;

  explicit SampleLayout(const BaseMesh& base) : corners(base.corners.size()), patches(base.patches.size()) {
    for (const auto& p : base.patches)
      for (const auto& [a, b] : kSideCorners) sides.push_back({std::min(p[a], p[b]), std::max(p[a], p[b])});
    const auto all = sides;
    std::sort(sides.begin(), sides.end());
    sides.erase(std::unique(sides.begin(), sides.end()), sides.end());
    patch_sides.resize(patches);
    side_patch.resize(sides.size());
    for (size_t i = all.size(); i-- > 0;) {
      patch_sides[i / 4][i % 4] =
          static_cast<uint32_t>(std::lower_bound(sides.begin(), sides.end(), all[i]) - sides.begin());
      side_patch[patch_sides[i / 4][i % 4]] = static_cast<uint32_t>(i / 4);
    }
  }
  size_t sideFirst(size_t side, size_t m) const { return corners + side * m; }
  size_t insideFirst(size_t patch, size_t m) const { return corners + sides.size() * m + patch * m * m; }
  size_t count(size_t m) const { return corners + sides.size() * m + patches * m * m; }

  // Of samples with n cells a side those that are also there with fewer.
  template <class T>
  std::vector<T> everyOther(std::span<const T> fine, size_t n, size_t coarse_n) const {
    const size_t m = n - 1, coarse_m = coarse_n - 1, step = n / coarse_n;
    std::vector<T> out(count(coarse_m));
    std::copy_n(fine.begin(), corners, out.begin());
    for (size_t side = 0; side < sides.size(); ++side)
      for (size_t i = 1; i < coarse_n; ++i)
        out[sideFirst(side, coarse_m) + i - 1] = fine[sideFirst(side, m) + i * step - 1];
    for (size_t patch = 0; patch < patches; ++patch)
      for (size_t y = 1; y < coarse_n; ++y)
        for (size_t x = 1; x < coarse_n; ++x)
          out[insideFirst(patch, coarse_m) + (y - 1) * coarse_m + x - 1] =
              fine[insideFirst(patch, m) + (y * step - 1) * m + x * step - 1];
    return out;
  }

  // A side with its ends, m + 2 samples.
  template <class T>
  void gatherSide(size_t side, size_t m, std::span<const T> samples, std::span<T> out) const {
    out[0] = samples[sides[side][0]];
    std::copy_n(samples.begin() + static_cast<ptrdiff_t>(sideFirst(side, m)), m, out.begin() + 1);
    out[m + 1] = samples[sides[side][1]];
  }
  // It in its place on the border of a patch's grid of n cells a side.
  template <class T>
  void placeSide(const BaseMesh& base, uint32_t patch, size_t side, size_t n, std::span<const T> line,
                 std::span<T> grid) const {
    const auto [a, b] = kSideCorners[side];
    const size_t first = side == kRight    ? n
                         : side == kBottom ? n * (n + 1)
                                           : 0,
                 step = side == kLeft || side == kRight ? n + 1 : 1;
    const bool forward = base.patches[patch][static_cast<size_t>(a)] < base.patches[patch][static_cast<size_t>(b)];
    for (size_t i = 0; i <= n; ++i) grid[first + i * step] = line[forward ? i : n - i];
  }

  // A patch's whole grid of (m + 2)^2, rows of v from 0.
  template <class T>
  void gather(const BaseMesh& base, uint32_t patch, size_t m, std::span<const T> samples, std::span<T> out) const {
    const size_t n = m + 1, row = m + 2;
    std::vector<T> line(row);
    for (size_t s = 0; s < 4; ++s) {
      gatherSide<T>(patch_sides[patch][s], m, samples, line);
      placeSide<T>(base, patch, s, n, line, out);
    }
    const T* in = samples.data() + insideFirst(patch, m);
    for (size_t y = 1; y < n; ++y) std::copy_n(in + (y - 1) * m, m, out.data() + y * row + 1);
  }
};

// What lines through the samples of a grid meet, as SampleLayout has them.
struct Traced {
  int cells_log2 = 0;
  std::vector<float> heights;
  // 0: the line meets nothing. Else what a height's error counts in space: 1 + 254 x the cosine between line and
  // surface, since its square is what is left of a height's, and its inverse the surface that a cell holds.
  std::vector<uint8_t> weights;
};

struct MeshBake::Impl {
  const TriMesh* mesh = nullptr;
  PlaneImage image;
  bool planes = false;  // the image's channels are the texture
  BaseMesh base;
  BakeReport report;
  int workers = 0;
  const std::atomic<bool>* interrupted = nullptr;
  std::unique_ptr<RayScene> scene;
  std::unique_ptr<LineSweep> sweep;
  std::unique_ptr<SampleLayout> layout;
  std::vector<uint8_t> used;                                  // by corner: has it a patch?
  std::vector<uint32_t> corner_patch;                         // the first, of those used
  glm::dvec3 shift{0};                                        // from the base's coordinates to the mesh's
  std::vector<glm::vec3> normals;                             // of the mesh's vertices
  std::vector<double> corner_reach, side_reach, patch_reach;  // mm: how far lines look
  int relief_depth = 0;
  double offset_mm = 0, scale_mm = 0, error_unit_mm = 0;
  std::vector<uint8_t> patch_log2;  // its own cells, where they are fewer
  std::vector<uint16_t> samples;    // as SampleLayout has them
  struct Probe {
    double along = 0, cosine = -1;  // of the line's hit; below 0: none
  };
  std::vector<Probe> probes;                    // lines between samples, patch after patch, once they are traced
  std::vector<std::vector<GridErrors>> errors;  // by patch, then as gridErrors() has them
  int tone_log2 = 0;                            // colours and normals: this fine a grid is looked up; or texel by texel

  // ---- places ----
  // Shared places are computed by one rule from the same numbers, whichever patch asks (as geometry/lod/mesh_vertex.h
  // does).
  Frame corner(uint32_t index) const {
    const BaseCorner& c = base.corners[index];
    return {glm::dvec3(c.position_mm) + shift, glm::dvec3(c.normal)};
  }
  Frame onSide(std::array<uint32_t, 2> ends, double t) const { return lerp(corner(ends[0]), corner(ends[1]), t); }
  Frame inside(uint32_t patch, double u, double v) const {
    const auto& c = base.patches[patch];
    return lerp(lerp(corner(c[0]), corner(c[1]), u), lerp(corner(c[2]), corner(c[3]), u), v);
  }
  // Vertex (x, y) of a grid of n cells a side.
  Frame at(uint32_t patch, size_t x, size_t y, size_t n) const {
    const double u = static_cast<double>(x) / static_cast<double>(n),
                 v = static_cast<double>(y) / static_cast<double>(n);
    const bool on_u = x == 0 || x == n, on_v = y == 0 || y == n;
    const auto& c = base.patches[patch];
    if (on_u && on_v) return corner(c[(x ? 1 : 0) + (y ? 2 : 0)]);
    if (!on_u && !on_v) return inside(patch, u, v);
    const int side = on_u ? (x ? kRight : kLeft) : (y ? kBottom : kTop);
    const auto [a, b] = kSideCorners[static_cast<size_t>(side)];
    const double t = on_u ? v : u;
    const uint32_t from = c[static_cast<size_t>(a)], to = c[static_cast<size_t>(b)];
    return from < to ? onSide({from, to}, t) : onSide({to, from}, 1 - t);
  }

  // Lines of a square of a patch that are asked for together.
  struct Lookup {
    std::vector<Line> lines;
    std::vector<SweepPlace> places;
    std::vector<SurfacePoint> hits;
    double u0 = 0, v0 = 0, u_scale = 1, v_scale = 1;
    SweepSquare square;
    // Rays for what is not swept.
    std::vector<Line> left;
    std::vector<SurfacePoint> left_hits;
    void add(const Line& line, double u, double v, double start) {
      lines.push_back(line);
      places.push_back(
          {static_cast<float>((u - u0) * u_scale), static_cast<float>((v - v0) * v_scale), static_cast<float>(start)});
    }
  };
  size_t tile() const { return sweep ? 128 : 64; }
  void begin(Lookup& look, uint32_t patch, double u0, double v0, double u1, double v1) const {
    look.lines.clear();
    look.places.clear();
    look.u0 = u0, look.v0 = v0, look.u_scale = 1 / (u1 - u0), look.v_scale = 1 / (v1 - v0);
    for (size_t k = 0; k < 4; ++k) {
      const Frame f = inside(patch, k % 2 ? u1 : u0, k / 2 ? v1 : v0);
      look.square.points[k] = f.point;
      look.square.normals[k] = f.normal;
    }
  }
  // The nearest surface that faces along each line.
  void find(Lookup& look) const;

  void prepare(const BakeOptions& options);
  Result<Traced> trace(int cells_log2, const BakeOptions& options);
  struct FitOptions {
    int least_log2 = 0, cells_log2 = 0;  // a patch's cells
    double tolerance_mm = 0;
  };
  bool fit(const Traced& fine, const FitOptions& how, const BakeOptions& options, std::vector<float>& heights);
  void store(std::span<const float> heights, std::span<const uint8_t> weights, int cells_log2);
  void probe(double& deviation_mm) const;
  size_t probesAPatch() const { return std::max<size_t>(kProbes / layout->patches, 4); }
  // The plastic number's sequence (Roberts 2018), another run of it for each patch.
  static glm::dvec2 probePlace(size_t k) {
    return {std::fmod(0.5 + static_cast<double>(k) * 0.75487766624669276, 1.0),
            std::fmod(0.5 + static_cast<double>(k) * 0.56984029099805327, 1.0)};
  }
  void heightsOf(uint32_t patch, std::span<uint16_t> out) const;
  void surface(uint32_t patch, SurfaceGrid& out) const;
  std::array<float, kTexelChannels> tone(const SurfacePoint& at) const;
  glm::vec2 uvAt(const SurfacePoint& at) const;
  bool planeTexels(uint32_t patch, std::span<uint8_t> out) const;
  bool stopped() const { return interrupted && interrupted->load(std::memory_order_relaxed); }
};

namespace {

// Where corners' normals oppose one another, those between them get short, and heights along them long: they end at
// twice the reach. The base is made to lie near the scan: most hits are within a fifth of the reach.
Line lineOf(const Frame& f, double reach) {
  const double along = reach / std::max(glm::length(f.normal), 0.5);
  return {f.point, f.normal, along, 0.2 * along};
}

Error interruptedError() { return {ErrorKind::kInterrupted, "", "interrupted", ""}; }

// Where a line comes closest to the mesh: from its point to the mesh's closest one, from there back to the line, and so
// on. It ends at borders that the line only just passes by, and at the nearest border from beyond it.
struct Approach {
  double along = 0, distance = 0;
};
Approach closestApproach(const RayScene& scene, const TriMesh& mesh, const Line& line) {
  constexpr int kSteps = 16;  // as many as a surface sloped by 45 degrees takes to 1e-5
  Approach out;
  const double squared = glm::dot(line.direction, line.direction);
  SurfacePoint near;
  for (int step = 0; step < kSteps; ++step) {
    const glm::dvec3 at = line.at + out.along * line.direction;
    near = scene.closestPoint(at, near);
    out.distance = near.along;
    if (!(squared > 0)) break;
    const auto& t = mesh.triangles[near.triangle];
    const glm::dvec3 a(mesh.positions_mm[t[0]]), b(mesh.positions_mm[t[1]]), c(mesh.positions_mm[t[2]]);
    const glm::dvec3 place = a + near.b1 * (b - a) + near.b2 * (c - a);
    const double along = std::clamp(glm::dot(place - line.at, line.direction) / squared, -line.reach, line.reach);
    const bool settled = std::abs(along - out.along) <= 1e-7 * line.reach;
    out.along = along;
    if (settled) break;
  }
  return out;
}

// The height along a line that meets the scan so, and its weight (Traced). 0 where it meets nothing within reach nor
// nearly does: borders that it touches are met.
void heightAlong(const RayScene& scene, const TriMesh& mesh, const Line& line, const SurfacePoint& hit, float& height,
                 uint8_t& weight) {
  constexpr double kNearly = 1e-3;  // of what a line reaches
  if (hit) {
    height = static_cast<float>(hit.along);
    const auto& t = mesh.triangles[hit.triangle];
    const glm::vec3& a = mesh.positions_mm[t[0]];
    const glm::vec3 normal = glm::cross(mesh.positions_mm[t[1]] - a, mesh.positions_mm[t[2]] - a),
                    direction(line.direction);
    const float cosine =
        glm::dot(normal, direction) / std::sqrt(glm::dot(normal, normal) * glm::dot(direction, direction));
    weight = static_cast<uint8_t>(1 + static_cast<int>(254 * std::clamp(cosine, 0.0f, 1.0f)));
  } else {
    const Approach near = closestApproach(scene, mesh, line);
    height = static_cast<float>(near.along);
    weight = near.distance <= kNearly * line.reach * glm::length(line.direction) ? 1 : 0;
  }
}

// Does the grid of `cells` cells keep the tolerance at nearly all of the data, and a fifth of it in their root mean
// square? A tolerance of 1e-4 of the diagonal is 94 dB then, with room for what no height shows; and 99.8 % of each
// patch were 99.9 % of a bust's, since most keep it with room. off: scratch.
bool keeps(const HeightData& data, size_t data_cells, std::span<const float> nodes, size_t cells, double tolerance_mm,
           std::vector<float>& off) {
  constexpr double kRms = 0.2, kShare = 0.998;
  const size_t step = data_cells / cells, row = cells + 1;
  off.clear();
  double squares = 0;
  for (size_t y = 0; y <= data_cells; ++y) {
    const size_t cy = std::min(y / step, cells - 1);
    const float fy = static_cast<float>(y - cy * step) / static_cast<float>(step);
    for (size_t x = 0; x <= data_cells; ++x) {
      const size_t i = y * (data_cells + 1) + x;
      if (data.weights[i] == 0) continue;
      const size_t cx = std::min(x / step, cells - 1);
      const float fx = static_cast<float>(x - cx * step) / static_cast<float>(step);
      const float* c = nodes.data() + cy * row + cx;
      const float d = std::abs(data.heights[i] - onCell<float>(c[0], c[1], c[row], c[row + 1], fx, fy)) *
                      static_cast<float>(data.weights[i]) / 255;
      squares += double{d} * d;
      off.push_back(d);
    }
  }
  if (off.empty()) return true;
  if (squares > kRms * kRms * tolerance_mm * tolerance_mm * static_cast<double>(off.size())) return false;
  const auto rank = off.begin() + static_cast<ptrdiff_t>(static_cast<double>(off.size() - 1) * kShare);
  std::nth_element(off.begin(), rank, off.end());
  return *rank <= tolerance_mm;
}

// What the lines do not know takes the mean of its neighbours, again and again: no spikes where the closest point
// jumps.
constexpr int kSmoothings = 8;

}  // namespace

void MeshBake::Impl::find(Lookup& look) const {
  look.hits.resize(look.lines.size());
  if (!sweep) return scene->nearestOnLines(look.lines, Facing::kAlong, look.hits);
  sweep->nearest(look.square, look.places, look.lines, look.hits);
  look.left.clear();
  for (size_t i = 0; i < look.hits.size(); ++i)
    if (!look.hits[i]) look.left.push_back(look.lines[i]);
  look.left_hits.resize(look.left.size());
  scene->nearestOnLines(look.left, Facing::kAlong, look.left_hits);
  for (size_t i = 0, k = 0; i < look.hits.size(); ++i)
    if (!look.hits[i]) look.hits[i] = look.left_hits[k++];
}

void MeshBake::Impl::prepare(const BakeOptions& options) {
  layout = std::make_unique<SampleLayout>(base);
  shift = base.origin_mm - mesh->origin_mm;
  workers = options.workers;
  interrupted = options.interrupted;
  // Lines look about as far as a patch is wide: further away lie other parts of the artwork.
  used.assign(layout->corners, 0);
  corner_patch.assign(layout->corners, 0);
  corner_reach.assign(layout->corners, 0);
  side_reach.assign(layout->sides.size(), 0);
  patch_reach.assign(layout->patches, 0);
  for (uint32_t p = 0; p < layout->patches; ++p) {
    const auto& c = base.patches[p];
    auto length = [&](int a, int b) {
      return glm::length(corner(c[static_cast<size_t>(a)]).point - corner(c[static_cast<size_t>(b)]).point);
    };
    const double reach = std::max(length(0, 3), length(1, 2));
    patch_reach[p] = reach;
    for (uint32_t s : layout->patch_sides[p]) side_reach[s] = std::max(side_reach[s], reach);
    for (uint32_t k : c) {
      corner_reach[k] = std::max(corner_reach[k], reach);
      if (!used[k]) corner_patch[k] = p;
      used[k] = 1;
    }
  }
}

namespace {

// Of the vector (x, y), y > 0, to 2e-6: a tenth of the library's time.
float angleOf(float y, float x) {
  const float wide = std::abs(x), t = std::min(wide, y) / std::max(wide, y), s = t * t;
  const float least =
      t *
      (0.99997726f + s * (-0.33262347f + s * (0.19354346f + s * (-0.11643287f + s * (0.05265332f - s * 0.01172120f)))));
  const float first = y > wide ? std::numbers::pi_v<float> / 2 - least : least;
  return x < 0 ? std::numbers::pi_v<float> - first : first;
}

// Weighted by the corners' angles: what a vertex's triangles are cut into does not matter (Thuermer and Wuethrich
// 1998). Triangles that a scan has folded over, back onto their neighbours, face away from the others at their corners:
// they would darken these, and are left out.
bool makeNormals(const TriMesh& mesh, const BakeSceneOptions& options, std::vector<glm::vec3>& normals) {
  constexpr float kFoldedCosine = -0.2f;
  normals.assign(mesh.positions_mm.size(), glm::vec3(0));
  const size_t parts = static_cast<size_t>(workerCount(options.workers));
  auto stopAt = [&](size_t i) { return i % (size_t{1} << 18) == 0 && options.interrupted && *options.interrupted; };
  auto weighted = [&](const std::array<uint32_t, 3>& t) {
    const std::array<glm::vec3, 3> p{mesh.positions_mm[t[0]], mesh.positions_mm[t[1]], mesh.positions_mm[t[2]]};
    const glm::vec3 n = glm::cross(p[1] - p[0], p[2] - p[0]);
    const float area = glm::length(n);
    std::array<glm::vec3, 3> out{};
    if (!(area > 0)) return out;
    for (size_t k = 0; k < 3; ++k) {
      const glm::vec3 a = p[(k + 1) % 3] - p[k], b = p[(k + 2) % 3] - p[k];
      out[k] = n * (angleOf(area, glm::dot(a, b)) / area);
    }
    return out;
  };
  // Every part goes through the triangles and sums up its own vertices: the same order of additions for any number of
  // workers.
  const TriangleBlocks blocks(mesh.triangles, options.workers);
  auto stopped = [&] { return options.interrupted && options.interrupted->load(std::memory_order_relaxed); };
  const bool summed = parallelFor(parts, options.workers, options.interrupted, [&](size_t part) {
    const size_t first = normals.size() * part / parts, last = normals.size() * (part + 1) / parts;
    blocks.forEach(first, last, stopped, [&](size_t i) {
      const auto& t = mesh.triangles[i];
      std::array<bool, 3> mine{};
      for (size_t k = 0; k < 3; ++k) mine[k] = t[k] >= first && t[k] < last;
      if (!mine[0] && !mine[1] && !mine[2]) return;
      const auto share = weighted(t);
      for (size_t k = 0; k < 3; ++k)
        if (mine[k]) normals[t[k]] += share[k];
    });
  });
  if (!summed) return false;
  std::vector<std::vector<size_t>> folded(parts);  // triangles, in order
  const bool looked = parallelFor(parts, options.workers, options.interrupted, [&](size_t part) {
    const size_t first = mesh.triangles.size() * part / parts, last = mesh.triangles.size() * (part + 1) / parts;
    for (size_t i = first; i < last; ++i) {
      if (stopAt(i)) return;
      const auto& t = mesh.triangles[i];
      const glm::vec3& p = mesh.positions_mm[t[0]];
      const glm::vec3 n = glm::cross(mesh.positions_mm[t[1]] - p, mesh.positions_mm[t[2]] - p);
      bool away = false;
      for (uint32_t v : t) {
        const float along = glm::dot(n, normals[v]);
        away |= along < 0 &&
                along * along > kFoldedCosine * kFoldedCosine * glm::dot(n, n) * glm::dot(normals[v], normals[v]);
      }
      if (away) folded[part].push_back(i);
    }
  });
  if (!looked) return false;
  for (const auto& list : folded) {
    for (size_t i : list) {
      const auto& t = mesh.triangles[i];
      const auto share = weighted(t);
      for (size_t k = 0; k < 3; ++k) {
        // A vertex of few others keeps what it has.
        const glm::vec3 without = normals[t[k]] - share[k];
        if (glm::dot(without, share[k]) < 0 && 4 * glm::dot(without, without) > glm::dot(share[k], share[k]))
          normals[t[k]] = without;
      }
    }
  }
  return parallelFor(parts, options.workers, options.interrupted, [&](size_t part) {
    for (size_t i = normals.size() * part / parts; i < normals.size() * (part + 1) / parts; ++i) {
      const float length = glm::length(normals[i]);
      if (length > 0) normals[i] /= length;
    }
  });
}

}  // namespace

BakeScene::BakeScene() = default;
BakeScene::BakeScene(BakeScene&&) = default;
BakeScene& BakeScene::operator=(BakeScene&&) = default;
BakeScene::~BakeScene() = default;

Result<BakeScene> makeBakeScene(const TriMesh& mesh, const BakeSceneOptions& options) {
  BakeScene out;
  const bool swept = mesh.triangles.size() >= options.sweep_from_triangles;
  auto rays = RayScene::create(mesh, {.interrupted = options.interrupted,
                                      .region_triangles = options.region_triangles,
                                      .budget_bytes = options.ray_bytes,
                                      .at_once = !swept});
  if (!rays) return rays.error();
  out.rays = std::move(*rays);
  if (swept) out.sweep = std::make_unique<LineSweep>(mesh, options.workers);
  if (!makeNormals(mesh, options, out.normals)) return interruptedError();
  return out;
}

Result<Traced> MeshBake::Impl::trace(int cells_log2, const BakeOptions& options) {
  const size_t n = size_t{1} << cells_log2, m = n - 1;
  const SampleLayout& l = *layout;
  Traced out{cells_log2, std::vector<float>(l.count(m)), std::vector<uint8_t>(l.count(m))};
  auto& [log2, heights, found] = out;
  const bool with_probes = probes.empty();
  const size_t places = probesAPatch();
  if (with_probes) probes.resize(l.patches * places);
  const Tiles tiles(n + 1, tile());
  const bool done = parallelFor(
      l.patches, workers, options.interrupted,
      [&](size_t job) {
        const auto patch = static_cast<uint32_t>(job);
        Lookup look;
        std::vector<size_t> to;  // of each line: a sample's place; then probes'
        // Probes with their neighbours.
        std::vector<std::pair<size_t, size_t>> by_tile;
        if (with_probes) {
          auto tileOf = [&](double t) { return tiles.of(static_cast<size_t>(t * static_cast<double>(n))); };
          for (size_t k = patch * places; k < (patch + 1) * places; ++k) {
            const glm::dvec2 at = probePlace(k);
            by_tile.push_back({tileOf(at.y) * tiles.parts + tileOf(at.x), k});
          }
          std::sort(by_tile.begin(), by_tile.end());
        }
        auto next_probe = by_tile.begin();
        // Samples on sides and corners are looked up with the first patch that they belong to.
        std::array<bool, 4> forward{};
        for (size_t s = 0; s < 4; ++s)
          forward[s] = base.patches[patch][static_cast<size_t>(kSideCorners[s][0])] <
                       base.patches[patch][static_cast<size_t>(kSideCorners[s][1])];
        size_t tile_number = 0;
        tiles.forEach([&](size_t x0, size_t y0, size_t x1, size_t y1) {
          auto share = [&](size_t x) { return static_cast<double>(std::min(x, n)) / static_cast<double>(n); };
          begin(look, patch, share(x0), share(y0), share(x1), share(y1));
          to.clear();
          for (size_t y = y0; y < y1; ++y) {
            for (size_t x = x0; x < x1; ++x) {
              const bool on_u = x == 0 || x == n, on_v = y == 0 || y == n;
              double reach = patch_reach[patch];
              size_t place = l.insideFirst(patch, m) + (y - 1) * m + x - 1;
              if (on_u && on_v) {
                const uint32_t c = base.patches[patch][(x ? 1 : 0) + (y ? 2 : 0)];
                if (corner_patch[c] != patch) continue;
                place = c;
                reach = corner_reach[c];
              } else if (on_u || on_v) {
                const size_t s = on_u ? (x ? kRight : kLeft) : (y ? kBottom : kTop), i = on_u ? y : x;
                const uint32_t side = l.patch_sides[patch][s];
                if (l.side_patch[side] != patch) continue;
                place = l.sideFirst(side, m) + (forward[s] ? i : n - i) - 1;
                reach = side_reach[side];
              }
              look.add(lineOf(at(patch, x, y, n), reach), share(x), share(y), 0);
              to.push_back(place);
            }
          }
          const size_t samples_here = to.size();
          for (; next_probe != by_tile.end() && next_probe->first == tile_number; ++next_probe) {
            const glm::dvec2 at = probePlace(next_probe->second);
            look.add(lineOf(inside(patch, at.x, at.y), patch_reach[patch]), at.x, at.y, 0);
            to.push_back(next_probe->second);
          }
          ++tile_number;
          find(look);
          for (size_t i = 0; i < samples_here; ++i)
            heightAlong(*scene, *mesh, look.lines[i], look.hits[i], heights[to[i]], found[to[i]]);
          for (size_t i = samples_here; i < to.size(); ++i) {
            if (!look.hits[i]) continue;
            const auto& t = mesh->triangles[look.hits[i].triangle];
            const glm::dvec3 a(mesh->positions_mm[t[0]]), b(mesh->positions_mm[t[1]]), c(mesh->positions_mm[t[2]]);
            const glm::dvec3 normal = glm::normalize(glm::cross(b - a, c - a));
            probes[to[i]] = {look.hits[i].along, std::abs(glm::dot(look.lines[i].direction, normal))};
          }
          return !stopped();
        });
      },
      [&](size_t taken) {
        if (options.progress) options.progress(0.3 + 0.6 * static_cast<double>(taken) / static_cast<double>(l.patches));
      });
  if (!done) return interruptedError();

  // Smoothing: sides between their corners, then the inside between the sides, so that shared samples stay shared.
  auto smooth = [&](size_t from, size_t count, auto&& neighbours) {
    std::vector<std::pair<size_t, float>> next;
    for (int round = 0; round < kSmoothings; ++round) {
      next.clear();
      for (size_t i = 0; i < count; ++i)
        if (!found[from + i]) next.push_back({from + i, neighbours(i)});
      if (next.empty()) return;
      for (const auto& [i, h] : next) heights[i] = h;
    }
  };
  for (size_t side = 0; side < l.sides.size(); ++side) {
    const size_t first = l.sideFirst(side, m);
    smooth(first, m, [&](size_t i) {
      const float before = i ? heights[first + i - 1] : heights[l.sides[side][0]];
      const float after = i + 1 < m ? heights[first + i + 1] : heights[l.sides[side][1]];
      return 0.5f * (before + after);
    });
  }
  std::vector<float> grid((n + 1) * (n + 1));
  for (uint32_t patch = 0; patch < l.patches; ++patch) {
    const size_t first = l.insideFirst(patch, m);
    if (std::find(found.begin() + static_cast<ptrdiff_t>(first), found.begin() + static_cast<ptrdiff_t>(first + m * m),
                  0) == found.begin() + static_cast<ptrdiff_t>(first + m * m))
      continue;
    l.gather<float>(base, patch, m, heights, grid);
    auto inner = [&](size_t x, size_t y) { return x > 0 && x < n && y > 0 && y < n; };
    auto height = [&](size_t x, size_t y) {
      return inner(x, y) ? heights[first + (y - 1) * m + x - 1] : grid[y * (n + 1) + x];
    };
    smooth(first, m * m, [&](size_t i) {
      const size_t x = i % m + 1, y = i / m + 1;
      return 0.25f * (height(x - 1, y) + height(x + 1, y) + height(x, y - 1) + height(x, y + 1));
    });
  }

  for (size_t i = 0; i < l.corners; ++i) {
    if (used[i]) continue;
    heights[i] = heights[base.patches[0][0]];
    found[i] = 1;
  }
  return out;
}

// Least squares: sides by themselves with free ends, whose means are the corners; sides again between these; then the
// inside. So every shared sample is found once, from what all of its patches share. Each patch has as few cells as keep
// the tolerance, a side as many as the finer of its patches; between its samples there are those of the triangles.
bool MeshBake::Impl::fit(const Traced& fine, const FitOptions& how, const BakeOptions& options,
                         std::vector<float>& heights) {
  const SampleLayout& l = *layout;
  const size_t fine_n = size_t{1} << fine.cells_log2, fine_m = fine_n - 1, n = size_t{1} << how.cells_log2, m = n - 1;
  heights = l.everyOther<float>(fine.heights, fine_n, n);
  constexpr size_t kSidesAJob = 64;
  // The sides with 2^log2 cells, one after the other, with both ends.
  auto fitSides = [&](int log2, Ends ends, std::vector<float>& out) {
    const size_t cells = size_t{1} << log2, step = fine_n / cells;
    out.resize(l.sides.size() * (cells + 1));
    return parallelFor((l.sides.size() + kSidesAJob - 1) / kSidesAJob, workers, options.interrupted, [&](size_t job) {
      std::vector<float> data(fine_n + 1);
      std::vector<uint8_t> weights(fine_n + 1);
      for (size_t side = job * kSidesAJob; side < std::min(l.sides.size(), (job + 1) * kSidesAJob); ++side) {
        l.gatherSide<float>(side, fine_m, fine.heights, data);
        l.gatherSide<uint8_t>(side, fine_m, fine.weights, weights);
        const auto nodes = std::span(out).subspan(side * (cells + 1), cells + 1);
        for (size_t i = 0; i <= cells; ++i) nodes[i] = data[i * step];
        if (ends == Ends::kFixed) {
          nodes.front() = heights[l.sides[side][0]];
          nodes.back() = heights[l.sides[side][1]];
        }
        if (step > 1) fitLine({data, weights}, ends, nodes);
      }
    });
  };
  std::vector<float> sides;
  if (!fitSides(how.cells_log2, Ends::kFree, sides)) return false;
  std::vector<double> sum(l.corners, 0);
  std::vector<uint32_t> meet(l.corners, 0);
  for (size_t side = 0; side < l.sides.size(); ++side) {
    for (size_t k = 0; k < 2; ++k) {
      sum[l.sides[side][k]] += sides[side * (n + 1) + k * n];
      ++meet[l.sides[side][k]];
    }
  }
  for (size_t i = 0; i < l.corners; ++i)
    if (meet[i] && fine.weights[i]) heights[i] = static_cast<float>(sum[i] / meet[i]);

  // The sides, of each number of cells.
  std::vector<std::vector<float>> by_log2(static_cast<size_t>(how.cells_log2) + 1);
  for (int log2 = how.least_log2; log2 <= how.cells_log2; ++log2)
    if (!fitSides(log2, Ends::kFixed, by_log2[static_cast<size_t>(log2)])) return false;
  auto dataOf = [&](uint32_t patch, std::vector<float>& data, std::vector<uint8_t>& weights) {
    data.resize((fine_n + 1) * (fine_n + 1));
    weights.resize(data.size());
    l.gather<float>(base, patch, fine_m, fine.heights, data);
    l.gather<uint8_t>(base, patch, fine_m, fine.weights, weights);
  };
  // A patch with its border given, (cells + 1)^2.
  auto fitInside = [&](const HeightData& data, std::vector<float>& nodes, size_t cells) {
    const size_t step = fine_n / cells;
    for (size_t y = 1; y < cells; ++y)
      for (size_t x = 1; x < cells; ++x) nodes[y * (cells + 1) + x] = data.heights[(y * (fine_n + 1) + x) * step];
    if (step > 1) fitGrid(data, fine_n + 1, nodes, cells + 1);
  };

  patch_log2.assign(l.patches, static_cast<uint8_t>(how.cells_log2));
  if (how.least_log2 < how.cells_log2) {
    const bool done = parallelFor(l.patches, workers, options.interrupted, [&](size_t patch) {
      const auto p = static_cast<uint32_t>(patch);
      std::vector<float> data, nodes, off;
      std::vector<uint8_t> weights;
      dataOf(p, data, weights);
      for (int log2 = how.least_log2; log2 < how.cells_log2; ++log2) {
        const size_t cells = size_t{1} << log2;
        nodes.resize((cells + 1) * (cells + 1));
        const std::vector<float>& border = by_log2[static_cast<size_t>(log2)];
        for (size_t s = 0; s < 4; ++s)
          l.placeSide<float>(base, p, s, cells, std::span(border).subspan(l.patch_sides[p][s] * (cells + 1), cells + 1),
                             nodes);
        fitInside({data, weights}, nodes, cells);
        if (!keeps({data, weights}, fine_n, nodes, cells, how.tolerance_mm, off)) continue;
        patch_log2[p] = static_cast<uint8_t>(log2);
        break;
      }
    });
    if (!done) return false;
  }
  std::vector<uint8_t> side_log2(l.sides.size(), 0);
  for (size_t p = 0; p < l.patches; ++p)
    for (uint32_t side : l.patch_sides[p]) side_log2[side] = std::max(side_log2[side], patch_log2[p]);
  for (size_t side = 0; side < l.sides.size(); ++side) {
    const size_t cells = size_t{1} << side_log2[side], step = n / cells;
    const float* nodes = by_log2[side_log2[side]].data() + side * (cells + 1);
    for (size_t i = 1; i < n; ++i) {
      const size_t cell = i / step;
      const float t = static_cast<float>(i - cell * step) / static_cast<float>(step);
      heights[l.sideFirst(side, m) + i - 1] = t > 0 ? nodes[cell] * (1 - t) + nodes[cell + 1] * t : nodes[cell];
    }
    report.samples += cells - 1;
  }
  for (uint8_t log2 : patch_log2) report.samples += ((size_t{1} << log2) - 1) * ((size_t{1} << log2) - 1);
  by_log2.clear();
  return parallelFor(l.patches, workers, options.interrupted, [&](size_t patch) {
    const auto p = static_cast<uint32_t>(patch);
    const size_t cells = size_t{1} << patch_log2[p], step = n / cells;
    std::vector<float> data, whole((n + 1) * (n + 1)), nodes((cells + 1) * (cells + 1));
    std::vector<uint8_t> weights;
    dataOf(p, data, weights);
    l.gather<float>(base, p, m, heights, whole);
    for (size_t y = 0; y <= cells; ++y)
      for (size_t x = 0; x <= cells; ++x) nodes[y * (cells + 1) + x] = whole[(y * (n + 1) + x) * step];
    fitInside({data, weights}, nodes, cells);
    float* out = heights.data() + l.insideFirst(patch, m);
    for (size_t y = 1; y < n; ++y) {
      for (size_t x = 1; x < n; ++x) {
        const size_t cx = x / step, cy = y / step;
        const float* c = nodes.data() + cy * (cells + 1) + cx;
        const double fx = static_cast<double>(x - cx * step) / static_cast<double>(step),
                     fy = static_cast<double>(y - cy * step) / static_cast<double>(step);
        *out++ = static_cast<float>(onCell<double>(c[0], c[1], c[cells + 1], c[cells + 2], fx, fy));
      }
    }
  });
}

void MeshBake::Impl::store(std::span<const float> heights, std::span<const uint8_t> weights, int cells_log2) {
  const auto [low, high] = std::minmax_element(heights.begin(), heights.end());
  offset_mm = *low;
  scale_mm = (static_cast<double>(*high) - *low) / 65535.0;
  const double per_mm = scale_mm > 0 ? 1.0 / scale_mm : 0.0;
  samples.resize(heights.size());
  for (size_t i = 0; i < heights.size(); ++i)
    samples[i] = static_cast<uint16_t>(std::clamp(std::floor((heights[i] - offset_mm) * per_mm + 0.5), 0.0, 65535.0));
  report.cells_log2 = cells_log2;
  report.by_closest_point = static_cast<uint64_t>(std::count(weights.begin(), weights.end(), 0));
  relief_depth = std::max(cells_log2 - kPageCellsLog2, 0);
}

// How far the baked surface lies from the scan, in its tangents' direction, at places spread over the patches:
// the 99.9th percentile.
void MeshBake::Impl::probe(double& deviation_mm) const {
  const size_t places = probesAPatch(), n = size_t{1} << report.cells_log2;
  std::vector<float> deviations(probes.size(), -1.0f);
  parallelFor(layout->patches, workers, nullptr, [&](size_t patch) {
    std::vector<uint16_t> grid((n + 1) * (n + 1));
    layout->gather<uint16_t>(base, static_cast<uint32_t>(patch), n - 1, samples, grid);
    for (size_t k = patch * places; k < (patch + 1) * places; ++k) {
      if (probes[k].cosine < 0) continue;
      const glm::dvec2 at = probePlace(k);
      const double height = offset_mm + scale_mm * onGrid(grid, n, at.x, at.y);
      deviations[k] = static_cast<float>(std::abs((probes[k].along - height) * probes[k].cosine));
    }
  });
  std::erase_if(deviations, [](float d) { return !(d >= 0); });
  deviation_mm = 0;
  if (!deviations.empty()) {
    const auto rank = deviations.begin() + static_cast<ptrdiff_t>(static_cast<double>(deviations.size() - 1) * 0.999);
    std::nth_element(deviations.begin(), rank, deviations.end());
    deviation_mm = *rank;
  }
}

void MeshBake::Impl::heightsOf(uint32_t patch, std::span<uint16_t> out) const {
  const size_t n = size_t{1} << report.cells_log2;
  if (report.cells_log2 >= kPageCellsLog2) {
    layout->gather<uint16_t>(base, patch, n - 1, samples, out);
    return;
  }
  std::vector<uint16_t> coarse((n + 1) * (n + 1));
  layout->gather<uint16_t>(base, patch, n - 1, samples, coarse);
  // In whole numbers: what a side's two samples give does not depend on which of them comes first.
  const int up = kPageCellsLog2 - report.cells_log2, cells = 1 << up;
  for (int y = 0; y <= kPagePx; ++y) {
    const int cy = std::min(y >> up, static_cast<int>(n) - 1), fy = y - (cy << up);
    for (int x = 0; x <= kPagePx; ++x) {
      const int cx = std::min(x >> up, static_cast<int>(n) - 1), fx = x - (cx << up);
      const uint16_t* c = coarse.data() + static_cast<size_t>(cy) * (n + 1) + static_cast<size_t>(cx);
      const int c00 = c[0], c10 = c[1], c01 = c[n + 1], c11 = c[n + 2];
      const int sum =
          fx >= fy ? c00 * (cells - fx) + c10 * (fx - fy) + c11 * fy : c00 * (cells - fy) + c01 * (fy - fx) + c11 * fx;
      out[static_cast<size_t>(y) * kReliefSamples + static_cast<size_t>(x)] =
          static_cast<uint16_t>((sum + cells / 2) >> up);
    }
  }
}

// The vertices of the finest grid, in the mesh's coordinates.
void MeshBake::Impl::surface(uint32_t patch, SurfaceGrid& out) const {
  const size_t row = out.row();
  std::vector<uint16_t> q(row * row);
  heightsOf(patch, q);
  const auto& c = base.patches[patch];
  const double per_cell = 1.0 / static_cast<double>(row - 1);
  for (size_t y = 0; y < row; ++y) {
    const double v = static_cast<double>(y) * per_cell;
    const Frame left = lerp(corner(c[0]), corner(c[2]), v), right = lerp(corner(c[1]), corner(c[3]), v);
    const uint16_t* height = q.data() + y * row;
    for (int axis = 0; axis < 3; ++axis) {
      const double p0 = left.point[axis], p1 = right.point[axis], n0 = left.normal[axis], n1 = right.normal[axis];
      double* place = out.axes[static_cast<size_t>(axis)].data() + y * row;
      for (size_t x = 0; x < row; ++x) {
        const double u = static_cast<double>(static_cast<int>(x)) * per_cell;
        place[x] = p0 * (1 - u) + p1 * u + (offset_mm + scale_mm * height[x]) * (n0 * (1 - u) + n1 * u);
      }
    }
  }
}

// ---- colours and normals ----

glm::vec2 MeshBake::Impl::uvAt(const SurfacePoint& at) const {
  const auto& uv = mesh->corner_uv[at.triangle];
  return uv[0] * static_cast<float>(1 - at.b1 - at.b2) + uv[1] * static_cast<float>(at.b1) +
         uv[2] * static_cast<float>(at.b2);
}

// Texel by texel. What is finer than the patch's texels is averaged: by the image's texels a millimetre of the
// triangle, since (u, v) of neighbouring texels may lie in different parts of the image.
bool MeshBake::Impl::planeTexels(uint32_t patch, std::span<uint8_t> out) const {
  const size_t side = size_t{kPagePx} << report.texture_depth, n = size_t{1} << report.cells_log2;
  const auto channels = static_cast<size_t>(image.channels());
  std::vector<uint16_t> q((n + 1) * (n + 1));
  layout->gather<uint16_t>(base, patch, n - 1, samples, q);
  const auto& c = base.patches[patch];
  double around = 0;
  for (const auto& [a, b] : kSideCorners)
    around += glm::length(corner(c[static_cast<size_t>(a)]).point - corner(c[static_cast<size_t>(b)]).point);
  const double texel_mm = around / (4.0 * static_cast<double>(side));
  Lookup look;
  std::vector<float> values(channels);
  return Tiles(side, tile()).forEach([&](size_t x0, size_t y0, size_t x1, size_t y1) {
    auto share = [&](size_t x) { return static_cast<double>(x) / static_cast<double>(side); };
    begin(look, patch, share(x0), share(y0), share(x1), share(y1));
    for (size_t i = 0; i < (x1 - x0) * (y1 - y0); ++i) {
      const size_t x = x0 + i % (x1 - x0), y = y0 + i / (x1 - x0);
      const double u = (static_cast<double>(x) + 0.5) / static_cast<double>(side),
                   v = (static_cast<double>(y) + 0.5) / static_cast<double>(side);
      const Frame f = inside(patch, u, v);
      const double height = offset_mm + scale_mm * onGrid(q, n, u, v);
      look.add(lineOf({f.point + height * f.normal, f.normal}, patch_reach[patch]), u, v, height);
    }
    find(look);
    for (size_t l = 0; l < look.lines.size(); ++l) {
      const size_t x = x0 + l % (x1 - x0), y = y0 + l / (x1 - x0);
      const SurfacePoint at = look.hits[l] ? look.hits[l] : scene->closestPoint(look.lines[l].at);
      const auto& t = mesh->triangles[at.triangle];
      const auto& uv = mesh->corner_uv[at.triangle];
      const glm::vec3 &p = mesh->positions_mm[t[0]], e = mesh->positions_mm[t[1]] - p, g = mesh->positions_mm[t[2]] - p;
      const glm::vec2 i = uv[1] - uv[0], j = uv[2] - uv[0];
      const double image_area = std::abs(double{i.x} * j.y - double{i.y} * j.x) * image.width() * image.height(),
                   area = glm::length(glm::cross(e, g));
      const double lod = area > 0 ? 0.5 * std::log2(texel_mm * texel_mm * image_area / area) : 0.0;
      image.sample(uvAt(at), static_cast<float>(lod), values);
      for (size_t k = 0; k < channels; ++k)
        out[(k * side + y) * side + x] = static_cast<uint8_t>(std::clamp(values[k] + 0.5f, 0.0f, 255.0f));
    }
    return !stopped();
  });
}

std::array<float, kTexelChannels> MeshBake::Impl::tone(const SurfacePoint& at) const {
  const auto& t = mesh->triangles[at.triangle];
  const std::array<float, 3> w{static_cast<float>(1 - at.b1 - at.b2), static_cast<float>(at.b1),
                               static_cast<float>(at.b2)};
  std::array<float, kTexelChannels> out{kGrey, kGrey, kGrey, 0, 0, 0};
  if (!image.empty()) {
    image.sample(uvAt(at), 0, out);
  } else if (!mesh->colours.empty()) {
    for (size_t c = 0; c < 3; ++c) {
      out[c] = 0;
      for (size_t k = 0; k < 3; ++k) out[c] += w[k] * static_cast<float>(mesh->colours[t[k]][static_cast<int>(c)]);
    }
  }
  glm::vec3 n(0);
  for (size_t k = 0; k < 3; ++k) n += w[k] * normals[t[k]];
  if (!(glm::length(n) > 1e-3f))
    n = glm::cross(mesh->positions_mm[t[1]] - mesh->positions_mm[t[0]],
                   mesh->positions_mm[t[2]] - mesh->positions_mm[t[0]]);
  const float length = glm::length(n);
  if (length > 0) n /= length;
  out[3] = n.x;
  out[4] = n.y;
  out[5] = n.z;
  return out;
}

// ---- MeshBake ----

MeshBake::MeshBake(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
MeshBake::~MeshBake() = default;
const BaseMesh& MeshBake::base() const { return impl_->base; }
const BakeReport& MeshBake::report() const { return impl_->report; }
int MeshBake::textureDepth() const { return impl_->report.texture_depth; }
int MeshBake::reliefDepth() const { return impl_->relief_depth; }
double MeshBake::reliefOffsetMm() const { return impl_->offset_mm; }
double MeshBake::reliefScaleMm() const { return impl_->scale_mm; }
double MeshBake::errorUnitMm() const { return impl_->error_unit_mm; }

Result<std::unique_ptr<MeshBake>> MeshBake::create(const TriMesh& mesh, const Image& image, const BaseMesh& base,
                                                   const BakeOptions& given, BakeScene scene) {
  const auto started = std::chrono::steady_clock::now();
  BakeOptions options = given;
  if (given.progress) {  // grids tried one after the other never lead backwards
    options.progress = [&given, most = 0.0](double done) mutable { given.progress(most = std::max(most, done)); };
  }
  auto usage = [](std::string what) { return Error{ErrorKind::kUsage, "", std::move(what), ""}; };
  if (options.cells_log2 != -1 && (options.cells_log2 < 1 || options.cells_log2 > kMaxCellsLog2))
    return usage("relief cells a patch: expected 2^1 to 2^" + std::to_string(kMaxCellsLog2) + ", found 2^" +
                 std::to_string(options.cells_log2));
  if (options.texture_depth < -1 || options.texture_depth > 7)
    return usage("texture depth of a patch: expected 0 to 7, found " + std::to_string(options.texture_depth));
  if (!(options.tolerance_mm >= 0) || !std::isfinite(options.tolerance_mm))
    return usage("the tolerance is not a distance in mm");
  if (mesh.triangles.empty()) return Error{ErrorKind::kInvalidData, "", "the mesh has no triangle", ""};
  if (image.planes && mesh.corner_uv.empty()) return usage("the mesh has no texture coordinates for the planes");
  if (!image.planes && !image.texels.empty() && image.channels != 3)
    return usage("an image of colours has three channels");
  if (auto problem = baseMeshProblem(base); !problem.empty())
    return Error{ErrorKind::kInvalidData, "", "base mesh: " + problem, ""};

  auto impl = std::make_unique<Impl>();
  impl->mesh = &mesh;
  const bool from_image = !image.texels.empty() && !mesh.corner_uv.empty();
  impl->planes = image.planes && from_image;
  if (from_image)
    impl->image =
        PlaneImage(image.width, image.height, image.channels, image.texels, impl->planes ? 16 : 0, image.repeats);
  impl->base = base;
  impl->prepare(options);
  if (!scene.rays) {
    auto made = makeBakeScene(mesh, {.workers = options.workers, .interrupted = options.interrupted});
    if (!made) return made.error();
    scene = std::move(*made);
  }
  impl->scene = std::move(scene.rays);
  impl->sweep = std::move(scene.sweep);
  impl->normals = std::move(scene.normals);
  if (options.progress) options.progress(0.3);

  const double vertices = static_cast<double>(mesh.positions_mm.size()),
               patches = static_cast<double>(base.patches.size());
  glm::vec3 low = mesh.positions_mm[mesh.triangles[0][0]], high = low;
  for (const glm::vec3& p : mesh.positions_mm) {
    low = glm::min(low, p);
    high = glm::max(high, p);
  }
  const bool automatic = options.cells_log2 < 0;
  const double tolerance_mm =
      options.tolerance_mm > 0 ? options.tolerance_mm : 1e-4 * glm::length(glm::dvec3(high) - glm::dvec3(low));
  // Small scans may have sharp edges that patches cross: four million samples take about a second.
  const double most = std::max(vertices * (options.tolerance_mm > 0 ? 256 : 16), 4.0 * (1 << 20));
  impl->report.tolerance_mm = tolerance_mm;
  int cells_log2 = options.cells_log2;
  auto count = [&](int log2) { return std::ldexp(patches, 2 * log2); };
  // Unless a tolerance says what does not matter, the scan's own detail does: at least a sample for two vertices.
  const double least = vertices / (options.tolerance_mm > 0 ? 256 : 2);
  if (automatic)
    for (cells_log2 = 1; cells_log2 < kMaxAutoCellsLog2 && count(cells_log2) < least;) ++cells_log2;
  if (count(cells_log2) > static_cast<double>(kMaxSamples))
    return usage("more than 2^32 relief samples: ask for fewer patches or fewer cells");
  double& deviation = impl->report.deviation_mm;
  Traced at;
  std::vector<float> fitted;
  auto look = [&](int log2) -> Result<void> {
    if (at.cells_log2 >= log2) return {};
    auto traced = impl->trace(log2, options);
    if (!traced) return traced.error();
    at = std::move(*traced);
    return {};
  };
  // Samples of at most 2^log2 cells a patch, fitted to what is known or the scan's own; and how well they do.
  auto take = [&](int least_log2, int log2, bool fit) -> Result<void> {
    const size_t n = size_t{1} << at.cells_log2, coarse_n = size_t{1} << log2;
    impl->report.samples = static_cast<uint64_t>(std::count(impl->used.begin(), impl->used.end(), 1));
    if (fit) {
      if (!impl->fit(at, {least_log2, log2, tolerance_mm}, options, fitted)) return interruptedError();
    } else {
      fitted = impl->layout->everyOther<float>(at.heights, n, coarse_n);
      impl->report.samples += impl->layout->count(coarse_n - 1) - impl->layout->corners;
    }
    impl->store(fitted, impl->layout->everyOther<uint8_t>(at.weights, n, coarse_n), log2);
    impl->report.fitted = fit;
    impl->probe(deviation);
    return {};
  };
  // Lines for a fit: four times as many as samples; sixteen times where that takes no more than some seconds (0.5 dB
  // better). None where it took minutes, or where the samples are so dense already that more would only find the scan's
  // own triangles again.
  constexpr double kManyLines = 1 << 23, kMostLines = 1 << 26;
  const double most_lines = automatic ? std::clamp(16 * vertices, kManyLines, kMostLines) : kMostLines;
  auto finer = [&](int log2) {
    return log2 + (count(log2 + 2) <= kManyLines ? 2 : count(log2 + 1) <= most_lines ? 1 : 0);
  };
  const int least_log2 = cells_log2;
  if (!automatic) {
    if (auto looked = look(options.fit ? finer(cells_log2) : cells_log2); !looked) return looked.error();
    if (auto taken = take(cells_log2, cells_log2, options.fit); !taken) return taken.error();
  } else {
    // Dense scans keep the tolerance with their own heights, and are baked sooner.
    for (double before = std::numeric_limits<double>::infinity();; before = deviation, ++cells_log2) {
      if (auto looked = look(cells_log2); !looked) return looked.error();
      if (auto taken = take(cells_log2, cells_log2, false); !taken) return taken.error();
      if (deviation <= tolerance_mm) break;
      BakeLimit& limit = impl->report.limit;
      // Finer than the scan, and hardly better: what is left is not a matter of samples.
      if (count(cells_log2) > 4 * vertices && deviation > 0.8 * before) limit = BakeLimit::kShape;
      else if (cells_log2 >= kMaxAutoCellsLog2) limit = BakeLimit::kCells;
      else if (count(cells_log2 + 1) > most) limit = BakeLimit::kSamples;
      if (limit != BakeLimit::kNone) break;
    }
    if (options.fit && (deviation > tolerance_mm || cells_log2 > least_log2)) {
      if (deviation > tolerance_mm)
        if (auto looked = look(finer(cells_log2)); !looked) return looked.error();
      if (auto taken = take(least_log2, cells_log2, true); !taken) return taken.error();
    }
  }
  at = {};
  if (deviation <= tolerance_mm) impl->report.limit = BakeLimit::kNone;
  else if (impl->report.limit == BakeLimit::kNone) impl->report.limit = BakeLimit::kCells;

  // Texels: twice as dense as what they are taken from, along u and v.
  double tones = 4 * vertices;
  if (from_image) {
    double used = 0;
    for (const auto& uv : mesh.corner_uv) {
      const glm::dvec2 a = uv[1] - uv[0], b = uv[2] - uv[0];
      used += 0.5 * std::abs(a.x * b.y - a.y * b.x);
    }
    if (used > 0) tones = used * image.width * image.height;  // else a colour a triangle: as of vertices
  }
  int& depth = impl->report.texture_depth = options.texture_depth;
  if (depth < 0) {
    depth = 0;
    auto texels = [&](int d) { return std::ldexp(patches, 2 * (kPageCellsLog2 + d)); };
    while (texels(depth) < tones && texels(depth + 1) < static_cast<double>(kMaxTexels)) ++depth;
  }
  // Vertex colours are linear over the scan's triangles: a grid somewhat finer than these knows all of them. Creases
  // show where it is not much finer; half a million places are looked up in a quarter of a second.
  const double places = std::max(2 * vertices, std::min(16 * vertices, 524'288.0));
  const int texels_log2 = kPageCellsLog2 + depth;
  impl->tone_log2 = 1;
  while (impl->tone_log2 < texels_log2 && std::ldexp(patches, 2 * impl->tone_log2) < places) ++impl->tone_log2;
  if (from_image) impl->tone_log2 = texels_log2;

  impl->errors.resize(base.patches.size());
  constexpr size_t kPatchesAJob = 16;
  const bool done = parallelFor(
      (base.patches.size() + kPatchesAJob - 1) / kPatchesAJob, options.workers, options.interrupted,
      [&](size_t job) {
        SurfaceGrid finest(kPageCellsLog2 + impl->relief_depth);
        GridErrorScratch scratch;
        for (size_t p = job * kPatchesAJob; p < std::min(base.patches.size(), (job + 1) * kPatchesAJob); ++p) {
          if (options.interrupted && *options.interrupted) return;
          impl->surface(static_cast<uint32_t>(p), finest);
          std::array<glm::dvec3, 4> normals;
          for (size_t k = 0; k < 4; ++k) normals[k] = base.corners[base.patches[p][k]].normal;
          impl->errors[p] = gridErrors(finest, normals, scratch);
        }
      },
      [&](size_t taken) {
        if (options.progress)
          options.progress(0.9 + 0.1 * std::min(1.0, static_cast<double>(taken * kPatchesAJob) /
                                                         static_cast<double>(base.patches.size())));
      });
  if (!done) return interruptedError();
  float largest = 0;
  for (const auto& by_grid : impl->errors)
    for (float e : by_grid[kPageCellsLog2].mm) largest = std::max(largest, e);
  impl->error_unit_mm = largest > 0          ? static_cast<double>(largest) / 65535.0 * (1 + 1e-9)
                        : impl->scale_mm > 0 ? impl->scale_mm
                                             : 1.0;
  if (auto sound = impl->scene->status(); !sound) return sound.error();
  impl->report.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
  if (options.progress) options.progress(1);
  return std::unique_ptr<MeshBake>(new MeshBake(std::move(impl)));
}

Result<void> MeshBake::heights(uint32_t patch, std::span<uint16_t> out) const {
  impl_->heightsOf(patch, out);
  return {};
}

const GridErrors& MeshBake::errorsOfCells(uint32_t patch, int cells_log2) const {
  return impl_->errors[patch][static_cast<size_t>(cells_log2)];
}
float MeshBake::errorOfCells(uint32_t patch, int cells_log2) const {
  const std::vector<float>& mm = errorsOfCells(patch, cells_log2).mm;
  return *std::max_element(mm.begin(), mm.end());
}

Result<void> MeshBake::texels(uint32_t patch, std::span<uint8_t> out) const {
  const Impl& b = *impl_;
  if (b.planes) return b.planeTexels(patch, out) ? Result<void>() : interruptedError();
  const size_t side = size_t{kPagePx} << b.report.texture_depth;
  const bool direct = (size_t{1} << b.tone_log2) >= side;
  // Places looked up: texel centres, or the vertices of a coarser grid.
  const size_t cells = direct ? side : size_t{1} << b.tone_log2, row = direct ? side : cells + 1;
  const size_t n = size_t{1} << b.report.cells_log2;
  std::vector<uint16_t> q((n + 1) * (n + 1));
  b.layout->gather<uint16_t>(b.base, patch, n - 1, b.samples, q);
  auto height = [&](double u, double v) { return b.offset_mm + b.scale_mm * onGrid(q, n, u, v); };
  const double likely = 4 * b.report.deviation_mm + b.scale_mm;  // how far the surface drawn is from the scan
  std::vector<std::array<float, kTexelChannels>> tones(row * row);
  Impl::Lookup look;
  std::array<Frame, 4> corners;
  for (size_t k = 0; k < 4; ++k) corners[k] = b.corner(b.base.patches[patch][k]);
  const bool done = Tiles(row, b.tile()).forEach([&](size_t x0, size_t y0, size_t x1, size_t y1) {
    auto share = [&](size_t x) { return std::min(static_cast<double>(x) / static_cast<double>(cells), 1.0); };
    b.begin(look, patch, share(x0), share(y0), share(x1), share(y1));
    const double half = direct ? 0.5 : 0;
    for (size_t y = y0; y < y1; ++y) {
      const double v = (static_cast<double>(y) + half) / static_cast<double>(cells);
      // Of texels, which no other patch has, along rows: sooner.
      const Frame left = lerp(corners[0], corners[2], v), right = lerp(corners[1], corners[3], v);
      for (size_t x = x0; x < x1; ++x) {
        const double u = (static_cast<double>(x) + half) / static_cast<double>(cells);
        const Frame f = direct ? lerp(left, right, u) : b.at(patch, x, y, cells);
        // From the surface that is drawn: what lies on it is what it shows.
        const double h = height(u, v);
        look.add(lineOf({f.point + h * f.normal, f.normal}, b.patch_reach[patch]), u, v, h);
        // Short rays are faster ones; a sweep sees all that is near at once.
        look.lines.back().likely = b.sweep ? std::max(likely, 0.02 * look.lines.back().reach) : likely;
      }
    }
    b.find(look);
    for (size_t i = 0; i < look.lines.size(); ++i) {
      const size_t x = x0 + i % (x1 - x0), y = y0 + i / (x1 - x0);
      tones[y * row + x] = b.tone(look.hits[i] ? look.hits[i] : b.scene->closestPoint(look.lines[i].at));
    }
    return !b.stopped();
  });
  if (!done) return interruptedError();
  // Row by row, each channel in an array of its own.
  const size_t plane = side * side, run = side / cells;  // texels a cell
  std::vector<float> mixed(row * kTexelChannels), values(side * kTexelChannels);
  for (size_t y = 0; y < side; ++y) {
    if (direct) {
      for (size_t k = 0; k < kTexelChannels; ++k)
        for (size_t x = 0; x < side; ++x) values[k * side + x] = tones[y * row + x][k];
    } else {
      const float fy = (static_cast<float>(y % run) + 0.5f) / static_cast<float>(run);
      const auto *above = tones.data() + y / run * row, *below = above + row;
      for (size_t k = 0; k < kTexelChannels; ++k) {
        float* m = mixed.data() + k * row;
        for (size_t x = 0; x < row; ++x) m[x] = above[x][k] * (1 - fy) + below[x][k] * fy;
        for (size_t cell = 0; cell < cells; ++cell) {
          const float start = m[cell], step = (m[cell + 1] - m[cell]) / static_cast<float>(run);
          float* v = values.data() + k * side + cell * run;
          for (size_t i = 0; i < run; ++i) v[i] = start + step * (static_cast<float>(static_cast<int>(i)) + 0.5f);
        }
      }
    }
    float *nx = values.data() + 3 * side, *ny = nx + side, *nz = ny + side;
    for (size_t x = 0; x < side; ++x) {
      // Where opposite normals meet, none is right.
      const float scale = 127.5f / std::sqrt(std::max(nx[x] * nx[x] + ny[x] * ny[x] + nz[x] * nz[x], 1e-12f));
      nx[x] = nx[x] * scale + 127.5f;
      ny[x] = ny[x] * scale + 127.5f;
      nz[x] = nz[x] * scale + 127.5f;
    }
    for (size_t k = 0; k < kTexelChannels; ++k) {
      const float* v = values.data() + k * side;
      uint8_t* to = out.data() + k * plane + y * side;
      for (size_t x = 0; x < side; ++x)
        to[x] = static_cast<uint8_t>(static_cast<int>(std::min(std::max(v[x] + 0.5f, 0.0f), 255.0f)));
    }
  }
  return {};
}

}  // namespace relievo
