#include "tools/bench/displacement_planes.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numeric>

#include "geometry/bake/area_sampler.h"
#include "geometry/bake/grid_error.h"
#include "geometry/bake/height_steps.h"
#include "geometry/mesh/closest_search.h"
#include "src/artwork/patch_domain.h"
#include "src/base/parallel_for.h"
#include "texturing/codec/page_codec.h"
#include "texturing/package/package.h"
#include "texturing/package/package_layout.h"
#include "texturing/package/patch_package_builder.h"
#include "texturing/package/patch_source.h"

namespace relievo {
namespace {

// A multiple of all steps that height_steps.h makes of one of up to 256.
constexpr int kZero = 33024;

// The pole that the samples' normals are furthest from, and two directions across it.
glm::dmat3 poleOf(std::span<const BasePoint> points) {
  glm::dvec3 best(0, 0, 1);
  double least = 2;
  for (int x = -2; x <= 2; ++x)
    for (int y = -2; y <= 2; ++y)
      for (int z = -2; z <= 2; ++z) {
        if (std::max({std::abs(x), std::abs(y), std::abs(z)}) != 2) continue;
        const glm::dvec3 pole = glm::normalize(glm::dvec3(x, y, z));
        double nearest = -1;
        const size_t step = std::max<size_t>(1, points.size() / 20'000);
        for (size_t i = 0; i < points.size(); i += step)
          nearest = std::max(nearest, glm::dot(pole, points[i].normal) / glm::length(points[i].normal));
        if (nearest < least) least = nearest, best = pole;
      }
  const glm::dvec3 across = std::abs(best.x) < 0.6 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 1, 0);
  const glm::dvec3 a = glm::normalize(glm::cross(across, best));
  return glm::transpose(glm::dmat3(a, glm::cross(best, a), -best));
}

// A plane as a package's relief: no texture, bounds of another surface.
class HeightPlaneSource final : public PatchSource {
 public:
  HeightPlaneSource(const BakeContext& context, const BakedHeights& plane, const MeshBake& bake, double slight_mm,
                    double base_step_mm)
      : context_(context), plane_(plane), bake_(bake), slight_mm_(slight_mm), base_step_mm_(base_step_mm) {}
  const BaseMesh& base() const override { return context_.base; }
  double baseStepMm() const override { return base_step_mm_; }
  int textureDepth() const override { return 0; }
  int reliefDepth() const override { return plane_.reliefDepth(); }
  TextureFormat format() const override { return {.basis = Basis::kAlbedoNormal}; }
  double reliefOffsetMm() const override { return plane_.offset_mm; }
  double reliefScaleMm() const override { return plane_.scale_mm; }
  double errorUnitMm() const override { return bake_.errorUnitMm(); }
  double slightErrorMm() const override { return slight_mm_; }
  std::vector<Provenance> provenance() const override { return {}; }
  Result<void> texels(uint32_t, std::span<uint8_t> out) const override {
    std::fill(out.begin(), out.end(), uint8_t{128});
    return {};
  }
  Result<void> heights(uint32_t patch, std::span<uint16_t> out) const override {
    plane_.finest(context_, patch, out);
    return {};
  }
  Result<void> errors(uint32_t patch, int level, std::span<float> out_mm) const override {
    std::ranges::copy(bake_.errorsOfGrid(patch, kPageCellsLog2 + level).mm, out_mm.begin());
    return {};
  }
  Result<CoarseErrors> coarseErrors(uint32_t patch) const override {
    CoarseErrors out;
    for (size_t k = 0; k < out.size(); ++k) out[k] = bake_.errorOfGrid(patch, static_cast<int>(k));
    return out;
  }
  Result<bool> coarseBlocks(uint32_t patch, int cells_log2, std::span<float> out_mm) const override {
    std::ranges::copy(bake_.errorsOfGrid(patch, cells_log2).mm, out_mm.begin());
    return true;
  }
  bool errorShapes(uint32_t patch, int cells_log2, std::span<DeviationShape> out) const override {
    std::ranges::copy(bake_.errorsOfGrid(patch, cells_log2).shapes, out.begin());
    return true;
  }

 private:
  const BakeContext& context_;
  const BakedHeights& plane_;
  const MeshBake& bake_;
  double slight_mm_, base_step_mm_;
};

// A block of a patch's grid of 2^log2 cells a side: `cells` a side from cell (x, y).
struct GridBlock {
  int log2 = 0;
  size_t cells = 0, x = 0, y = 0;
};
// The coarsest blocks within a tolerance (blocksWithin()), each of at most 8 cells a side.
std::vector<GridBlock> coarseBlocksOf(const std::vector<std::vector<uint8_t>>& within) {
  const int finest = static_cast<int>(within.size()) - 1;
  for (int log2 = 1; log2 <= 3; ++log2)
    if (within[static_cast<size_t>(log2)][0]) return {{log2, size_t{1} << log2, 0, 0}};
  std::vector<GridBlock> out, pending{{3, 8, 0, 0}};
  while (!pending.empty()) {
    const GridBlock b = pending.back();
    pending.pop_back();
    const auto per_side = static_cast<size_t>(errorBlocksPerSide(b.log2));
    if (b.log2 == finest || within[static_cast<size_t>(b.log2)][b.y / 8 * per_side + b.x / 8]) {
      out.push_back(b);
      continue;
    }
    for (size_t k = 0; k < 4; ++k) pending.push_back({b.log2 + 1, 8, 2 * b.x + 8 * (k % 2), 2 * b.y + 8 * (k / 2)});
  }
  return out;
}

}  // namespace

DisplacedSamples::DisplacedSamples(const TriMesh& scan, const MeshBake& bake)
    : context(scan, bake.base()), cells_log2(bake.report().cells_log2) {
  const size_t n = cells(), m = n - 1;
  const SampleLayout& l = context.layout;
  points.resize(l.count(m));
  for (size_t i = 0; i < l.corners; ++i) points[i] = context.cornerPoint(static_cast<uint32_t>(i));
  for (size_t side = 0; side < l.sides.size(); ++side)
    for (size_t i = 1; i < n; ++i)
      points[l.sideBegin(side, m) + i - 1] =
          context.sidePoint(l.sides[side], static_cast<double>(i) / static_cast<double>(n));
  for (size_t patch = 0; patch < l.patches; ++patch)
    for (size_t y = 1; y < n; ++y)
      for (size_t x = 1; x < n; ++x)
        points[l.interiorBegin(patch, m) + (y - 1) * m + x - 1] =
            context.gridPoint(static_cast<uint32_t>(patch), x, y, n);
  pole = poleOf(points);
}

glm::dmat3 DisplacedSamples::frame(const glm::dvec3& normal) const {
  // Frisvad 2012, "Building an orthonormal basis from a 3D unit vector without normalization": singular at (0, 0, -1).
  const glm::dvec3 n = pole * glm::normalize(normal);
  const double k = 1 / std::max(1 + n.z, 1e-9);
  const glm::dvec3 a(1 - n.x * n.x * k, -n.x * n.y * k, -n.x), b(-n.x * n.y * k, 1 - n.y * n.y * k, -n.y);
  return {normal, a * pole, b * pole};  // back by the transposed matrix
}

glm::dvec3 DisplacedSamples::componentsOf(size_t sample, const glm::dvec3& position) const {
  const BasePoint& p = points[sample];
  const glm::dmat3 f = frame(p.normal);
  const glm::dvec3 d = position - p.position;
  return {glm::dot(d, p.normal) / glm::dot(p.normal, p.normal), glm::dot(d, f[1]), glm::dot(d, f[2])};
}

std::vector<std::vector<uint32_t>> DisplacedSamples::samplesOfPatches() const {
  std::vector<uint32_t> all(points.size());
  std::iota(all.begin(), all.end(), 0u);
  std::vector<std::vector<uint32_t>> out(context.layout.patches);
  for (uint32_t patch = 0; patch < out.size(); ++patch) {
    out[patch].resize((cells() + 1) * (cells() + 1));
    context.layout.gather<uint32_t>(context.base, patch, cells() - 1, all, out[patch]);
  }
  return out;
}

std::vector<glm::dvec3> DisplacedSamples::heights(const MeshBake& bake) const {
  const size_t finest = size_t{1} << (kPageCellsLog2 + bake.reliefDepth()), n = cells(), step = finest / n;
  std::vector<glm::dvec3> out(points.size(), glm::dvec3(0));
  std::vector<uint16_t> q((finest + 1) * (finest + 1));
  const std::vector<std::vector<uint32_t>> grids = samplesOfPatches();
  for (uint32_t patch = 0; patch < grids.size(); ++patch) {
    (void)bake.heights(patch, q);
    for (size_t y = 0; y <= n; ++y)
      for (size_t x = 0; x <= n; ++x)
        out[grids[patch][y * (n + 1) + x]].x =
            bake.reliefOffsetMm() + bake.reliefScaleMm() * q[(y * (finest + 1) + x) * step];
  }
  return out;
}

DisplacementPlanes::DisplacementPlanes(const DisplacedSamples& samples, std::span<const glm::dvec3> components,
                                       double step_mm)
    : samples_(samples) {
  const BakeContext& context = samples.context;
  auto round = [&](BakedHeights& plane, int step) {
    plane.step = step;
    if (step > 1) plane.samples = *steppedHeights(context, plane.samples, plane.cells_log2, step);
  };
  std::vector<float> heights(components.size());
  double most = 0;
  for (size_t i = 0; i < components.size(); ++i) {
    heights[i] = static_cast<float>(components[i].x);
    most = std::max({most, std::abs(components[i].y), std::abs(components[i].z)});
  }
  planes_[0] = BakedHeights(heights, samples.cells_log2);
  constexpr double kMostSteps = 16384;
  if (const double scale = planes_[0].scale_mm; scale > 0)
    round(planes_[0], static_cast<int>(std::clamp(std::floor(step_mm / scale), 1.0, kMostSteps)));
  patch_aside_.assign(context.layout.patches, 0);
  if (most == 0) return;
  // A power of two of units is a step, so that no component is a whole number of steps.
  constexpr double kRange = 32'000;
  int log2 = 8;
  while (log2 > 0 && step_mm > 0 && most * std::ldexp(1 / step_mm, log2) > kRange) --log2;
  const double scale = step_mm > 0 ? std::max(std::ldexp(step_mm, -log2), most / kRange) : most / kRange;
  for (int k = 1; k < 3; ++k) {
    BakedHeights& plane = planes_[k];
    plane.cells_log2 = samples.cells_log2;
    plane.scale_mm = scale;
    plane.offset_mm = -kZero * scale;
    plane.samples.resize(components.size());
    for (size_t i = 0; i < components.size(); ++i)
      plane.samples[i] = static_cast<uint16_t>(kZero + std::lround(components[i][k] / scale));
    round(plane, step_mm > 0 ? 1 << log2 : 1);
  }
  parallelFor(patch_aside_.size(), 0, nullptr, [&](size_t patch) {
    std::vector<uint16_t> grid((samples.cells() + 1) * (samples.cells() + 1));
    for (int k = 1; k < 3; ++k) {
      planes_[k].gather(context, static_cast<uint32_t>(patch), grid);
      if (std::ranges::any_of(grid, [](uint16_t q) { return q != kZero; })) patch_aside_[patch] = 1;
    }
  });
}

TriMesh DisplacementPlanes::surface(double tolerance_mm, std::vector<uint32_t>& patch_of) const {
  const BakeContext& context = samples_.context;
  const int finest_log2 = kPageCellsLog2 + planes_[0].reliefDepth();
  const size_t row = (size_t{1} << finest_log2) + 1;
  struct Part {
    std::vector<glm::vec3> vertices;
    std::vector<std::array<uint32_t, 3>> triangles;
  };
  std::vector<Part> parts(context.layout.patches);
  struct Scratch {
    SurfaceGrid grid;
    GridErrorScratch errors;
    std::vector<std::vector<uint8_t>> within;
    std::array<std::vector<uint16_t>, 3> q;
  };
  parallelForWith(
      parts.size(), 0, nullptr,
      [&] {
        Scratch s{SurfaceGrid(finest_log2), {}, {}, {}};
        for (auto& q : s.q) q.resize(row * row);
        return s;
      },
      [&](Scratch& s, size_t p) {
        const auto patch = static_cast<uint32_t>(p);
        const bool moved = aside(patch);
        for (size_t k = 0; k < (moved ? 3 : 1); ++k) planes_[k].finest(context, patch, s.q[k]);
        for (size_t y = 0; y < row; ++y)
          for (size_t x = 0; x < row; ++x) {
            const size_t i = y * row + x;
            const BasePoint at = context.gridPoint(patch, x, y, row - 1);
            glm::dvec3 position = at.position + (planes_[0].offset_mm + planes_[0].scale_mm * s.q[0][i]) * at.normal;
            if (moved) {
              const glm::dmat3 frame = samples_.frame(at.normal);
              for (int k = 1; k < 3; ++k)
                position += (planes_[k].offset_mm + planes_[k].scale_mm * s.q[static_cast<size_t>(k)][i]) * frame[k];
            }
            for (int axis = 0; axis < 3; ++axis) s.grid.axes[static_cast<size_t>(axis)][i] = position[axis];
          }
        blocksWithin(s.grid, tolerance_mm, s.errors, s.within);
        for (const GridBlock& b : coarseBlocksOf(s.within)) {
          const auto first = static_cast<uint32_t>(parts[p].vertices.size()), side = static_cast<uint32_t>(b.cells) + 1;
          for (size_t y = b.y; y <= b.y + b.cells; ++y)
            for (size_t x = b.x; x <= b.x + b.cells; ++x) {
              const size_t i = (y * row + x) << (finest_log2 - b.log2);
              parts[p].vertices.emplace_back(s.grid.axes[0][i], s.grid.axes[1][i], s.grid.axes[2][i]);
            }
          for (uint32_t y = 0; y + 1 < side; ++y)
            for (uint32_t x = 0; x + 1 < side; ++x) {
              const uint32_t at = first + y * side + x;
              parts[p].triangles.push_back({at, at + side + 1, at + 1});
              parts[p].triangles.push_back({at, at + side, at + side + 1});
            }
        }
      });
  TriMesh out;
  out.origin_mm = context.mesh->origin_mm;
  patch_of.clear();
  for (size_t p = 0; p < parts.size(); ++p) {
    const auto first = static_cast<uint32_t>(out.positions_mm.size());
    out.positions_mm.insert(out.positions_mm.end(), parts[p].vertices.begin(), parts[p].vertices.end());
    for (auto t : parts[p].triangles) {
      for (uint32_t& v : t) v += first;
      out.triangles.push_back(t);
    }
    patch_of.resize(out.triangles.size(), static_cast<uint32_t>(p));
    parts[p] = {};
  }
  return out;
}

Result<uint64_t> DisplacementPlanes::bits(const MeshBake& bake, double slight_mm, double base_step_mm,
                                          const std::string& package) const {
  const BakeContext& context = samples_.context;
  uint64_t bytes = 0, flags = 0;
  {
    BuildOptions options{.output = package};
    options.manifest_extra = "{}";
    const HeightPlaneSource source(context, planes_[0], bake, slight_mm, base_step_mm);
    if (auto built = buildPatchPackage(source, options); !built) return built.error();
    auto opened = Package::open(package);
    if (!opened) return opened.error();
    auto relief = reliefBytes(**opened);
    if (!relief) return relief.error();
    bytes = *relief;
  }
  std::remove(package.c_str());
  const int depth = planes_[0].reliefDepth();
  const size_t row = (size_t{kPagePx} << depth) + 1;
  std::vector<uint16_t> grid(row * row), page(kReliefPageSamples);
  PageEncoder encoder(1);
  const bool any = std::ranges::any_of(patch_aside_, [](uint8_t a) { return a != 0; });
  for (uint32_t patch = 0; any && patch < patch_aside_.size(); ++patch) {
    ++flags;
    for (int k = 1; aside(patch) && k < 3; ++k) {
      planes_[k].finest(context, patch, grid);
      for (int level = 0; level <= depth; ++level) {
        const size_t step = size_t{1} << (depth - level);
        for (size_t node = 0; node < size_t{1} << (2 * level); ++node) {
          const size_t x0 = (node & ((size_t{1} << level) - 1)) * kPagePx, y0 = (node >> level) * kPagePx;
          for (size_t y = 0; y < kReliefSamples; ++y)
            for (size_t x = 0; x < kReliefSamples; ++x)
              page[y * kReliefSamples + x] = grid[(y0 + y) * step * row + (x0 + x) * step];
          ++flags;
          if (std::ranges::any_of(page, [](uint16_t q) { return q != kZero; }))
            bytes += encoder.encodeRelief(page, ReliefEncoding::kHierarchical).size();
        }
      }
    }
  }
  return 8 * bytes + flags;
}

Fidelity fidelityOf(const FidelityScan& scan, const TriMesh& surface, const FidelityTarget& target,
                    MeasuredPlaces* places) {
  const FidelityScan drawn(surface, 0);
  Fidelity out{.diagonal_mm = scan.diagonalMm(), .target = target, .to_drawn = {}, .to_scan = {}, .violations = {}};
  const size_t there = scan.areaSamples(), back = drawn.areaSamples();
  std::vector<float> distances(there + back);
  if (places) places->triangles.assign(there + back, 0);
  constexpr size_t kJob = 2048;
  parallelFor((distances.size() + kJob - 1) / kJob, 0, nullptr, [&](size_t job) {
    size_t part = kNoPart;
    for (size_t i = job * kJob; i < std::min(distances.size(), (job + 1) * kJob); ++i) {
      const bool to_drawn = i < there;
      if (i == there) part = kNoPart;
      const glm::dvec3 p = to_drawn ? scan.positions()[i] : drawn.positions()[i - there];
      constexpr double kAny = std::numeric_limits<double>::infinity();
      distances[i] = static_cast<float>((to_drawn ? drawn : scan).search().distance(p, kAny, part));
      if (places && to_drawn) places->triangles[i] = closestTriangle(surface, drawn.search(), part, p).first;
    }
  });
  if (places) {
    const std::vector<double> areas = cumulativeAreas(surface, 0);
    const AreaSamples spread(areas.back(), scan.samples());
    size_t triangle = 0;
    for (size_t k = 0; k < back; ++k) {
      while (triangle + 1 < surface.triangles.size() && areas[triangle + 1] <= spread.areaBefore(k)) ++triangle;
      places->triangles[there + k] = static_cast<uint32_t>(triangle);
    }
    places->distances_mm = distances;
  }
  auto summary = [&](std::span<float> d) {
    OneSidedFidelity one;
    one.samples = d.size();
    double squares = 0;
    size_t within = 0, beyond = 0;
    for (float v : d) squares += double{v} * v, within += v <= target.p99_9_mm, beyond += v > target.max_mm;
    const double count = static_cast<double>(std::max<size_t>(d.size(), 1));
    one.rms_mm = std::sqrt(squares / count);
    one.area_within = static_cast<double>(within) / count;
    one.area_beyond = static_cast<double>(beyond) / count;
    std::ranges::sort(d);
    if (!d.empty()) one.p99_9_mm = d[static_cast<size_t>((count - 1) * 0.999)], one.max_mm = d.back();
    return one;
  };
  out.to_drawn = summary(std::span(distances).first(there));
  out.to_scan = summary(std::span(distances).subspan(there));
  return out;
}

std::pair<uint32_t, TrianglePoint> closestTriangle(const TriMesh& mesh, const ClosestSearch& search, size_t part,
                                                   const glm::dvec3& place) {
  std::pair<uint32_t, TrianglePoint> best;
  best.second.distance = std::numeric_limits<double>::infinity();
  for (size_t i = 0; i < search.runs().sizeOf(part); ++i) {
    const uint32_t t = search.runs().triangle(part, i);
    const TrianglePoint at = closestOnTriangle(cornersOf(mesh, t), place);
    if (at.distance < best.second.distance) best = {t, at};
  }
  return best;
}

}  // namespace relievo
