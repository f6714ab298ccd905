#include "geometry/bake/measured_surface.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "geometry/bake/area_sampler.h"
#include "geometry/bake/grid_error.h"
#include "geometry/mesh/closest_search.h"
#include "geometry/mesh/triangle_point.h"
#include "src/artwork/patch_domain.h"
#include "src/base/parallel_for.h"
#include "src/base/simd_dispatch.h"

namespace relievo {

MeasuredSurface::MeasuredSurface(const MeshBake& baked, double tolerance_mm, Blocks choice, int workers,
                                 const std::atomic<bool>* interrupted)
    : baked_(baked), workers_(workers), interrupted_(interrupted) {
  // A grid that has all samples says the same as the finest where what it leaves out decides about no block. A larger
  // share may be taken off the tolerance instead.
  constexpr double kLeftOut = 0.05, kTakenOff = 0.25;
  blocks_.resize(baked.base().patches.size());
  triangles_.resize(blocks_.size());
  if (baked.isFlat()) {
    blocks_.assign(blocks_.size(), {{0, 1, 0, 0}});
    triangles_.assign(blocks_.size(), 2);
    return;
  }
  struct Scratch {
    std::vector<SurfaceGrid> grids;  // by cells_log2
    GridErrorScratch errors;
    std::vector<std::vector<uint8_t>> within, surely;
  };
  parallelForWith(
      blocks_.size(), workers, interrupted, [&] { return Scratch{}; },
      [&](Scratch& s, size_t patch) {
        const BetweenSamples between = baked_.betweenSamples(static_cast<uint32_t>(patch));
        auto grid = [&](int log2) -> const SurfaceGrid& {
          for (int k = static_cast<int>(s.grids.size()); k <= log2; ++k) s.grids.emplace_back(k);
          baked_.surface(static_cast<uint32_t>(patch), s.grids[static_cast<size_t>(log2)]);
          return s.grids[static_cast<size_t>(log2)];
        };
        const int log2 = between.coarsestWithin((choice == Blocks::kSoon ? kTakenOff : kLeftOut) * tolerance_mm);
        const SurfaceGrid& first = grid(log2);
        if (choice == Blocks::kSoon) {
          blocksWithin(first, tolerance_mm - between.mm(log2), s.errors, s.within);
        } else {
          blocksWithin(first, tolerance_mm, s.errors, s.within);
          if (log2 < between.finest_log2) {
            blocksWithin(first, tolerance_mm - between.mm(log2), s.errors, s.surely);
            if (s.within != s.surely) blocksWithin(grid(between.finest_log2), tolerance_mm, s.errors, s.within);
          }
        }
        blocks_[patch] = blocksOf(s.within);
        for (const Block& b : blocks_[patch]) triangles_[patch] += uint64_t{2} * b.cells * b.cells;
      });
}

std::vector<MeasuredSurface::Block> MeasuredSurface::blocksOf(const std::vector<std::vector<uint8_t>>& within) {
  const int finest_log2 = static_cast<int>(within.size()) - 1;
  for (int log2 = 1; log2 <= std::min(finest_log2, 3); ++log2)
    if (within[static_cast<size_t>(log2)][0])
      return {{static_cast<uint8_t>(log2), static_cast<uint8_t>(1 << log2), 0, 0}};
  std::vector<Block> out, pending{{3, 8, 0, 0}};
  while (!pending.empty()) {
    const Block b = pending.back();
    pending.pop_back();
    const auto per_side = static_cast<size_t>(errorBlocksPerSide(b.log2));
    if (b.log2 == finest_log2 || within[b.log2][b.y * per_side + b.x]) {
      out.push_back({b.log2, 8, static_cast<uint16_t>(8 * b.x), static_cast<uint16_t>(8 * b.y)});
      continue;
    }
    for (int k = 0; k < 4; ++k)
      pending.push_back({static_cast<uint8_t>(b.log2 + 1), 8, static_cast<uint16_t>(2 * b.x + k % 2),
                         static_cast<uint16_t>(2 * b.y + k / 2)});
  }
  return out;
}

namespace {

// Of cell x between the vertices `a` and those of the next row, `c`.
std::array<TriangleCorners, 2> trianglesOfCell(const glm::vec3* a, const glm::vec3* c, size_t x) {
  return {TriangleCorners{a[x], c[x + 1], a[x + 1]}, TriangleCorners{a[x], c[x], c[x + 1]}};
}

}  // namespace

// The triangles of a row of cells, in the order of the cells.
template <class Use>
void MeasuredSurface::Part::forEachTriangle(const Row& row, Use use) const {
  const glm::vec3 *a = vertices_.data() + row.first_vertex, *c = a + row.cells + 1;
  for (size_t x = 0; x < row.cells; ++x)
    for (const TriangleCorners& t : trianglesOfCell(a, c, x)) use(t);
}

MeasuredSurface::Part MeasuredSurface::part(size_t first, size_t end, double area_before) const {
  struct Begin {
    size_t vertex = 0, row = 0;
  };
  std::vector<Begin> begins(end - first + 1);
  for (size_t p = first; p < end; ++p) {
    Begin at = begins[p - first];
    for (const Block& b : blocks_[p]) {
      at.vertex += size_t{b.cells + 1u} * (b.cells + 1u);
      at.row += b.cells;
    }
    begins[p - first + 1] = at;
  }
  Part out;
  out.vertices_.resize(begins.back().vertex);
  out.rows_.resize(begins.back().row);
  std::vector<Box> boxes(begins.back().row);
  const BaseMesh& base = baked_.base();
  parallelForWith(
      end - first, workers_, interrupted_, [&] { return std::vector<uint16_t>(); },
      [&](std::vector<uint16_t>& q, size_t i) {
        const auto patch = static_cast<uint32_t>(first + i);
        int finest_log2 = 0;
        for (const Block& b : blocks_[patch]) finest_log2 = std::max<int>(finest_log2, b.log2);
        const size_t finest_row = (size_t{1} << finest_log2) + 1;
        q.resize(finest_row * finest_row);
        baked_.heightsOfGrid(patch, finest_log2, q);
        Begin at = begins[i];
        for (const Block& b : blocks_[patch]) {
          const size_t step = size_t{1} << (finest_log2 - b.log2), row = b.cells + 1u;
          const double per_cell = std::ldexp(1.0, -b.log2);
          glm::vec3* vertex = out.vertices_.data() + at.vertex;
          for (size_t y = b.y; y < b.y + row; ++y) {
            const double v = static_cast<double>(y) * per_cell;
            for (size_t x = b.x; x < b.x + row; ++x) {
              const double u = static_cast<double>(x) * per_cell;
              const double height = baked_.reliefOffsetMm() + baked_.reliefScaleMm() * q[(y * finest_row + x) * step];
              *vertex++ = glm::vec3(base.point(patch, u, v) + height * base.normal(patch, u, v));
            }
          }
          vertex = out.vertices_.data() + at.vertex;
          for (size_t y = 0; y < b.cells; ++y, ++at.row) {
            out.rows_[at.row] = {static_cast<uint32_t>(at.vertex + y * row), b.cells};
            for (size_t k = 0; k < 2 * row; ++k) boxes[at.row].add(vertex[y * row + k]);
          }
          at.vertex += row * row;
        }
      });
  // The sums are the same whoever computes the areas: in the triangles' order.
  constexpr size_t kRows = 1 << 14, kRowsPerJob = 512, kMostTriangles = 2 * kMostBlockCells;
  std::vector<double> areas(std::min(kRows, out.rows_.size()) * kMostTriangles);
  out.area_before_.reserve(out.rows_.size() + 1);
  double area = area_before;
  for (size_t from = 0; from < out.rows_.size(); from += kRows) {
    const size_t count = std::min(kRows, out.rows_.size() - from);
    parallelFor((count + kRowsPerJob - 1) / kRowsPerJob, workers_, interrupted_, [&](size_t job) {
      for (size_t i = job * kRowsPerJob; i < std::min(count, (job + 1) * kRowsPerJob); ++i) {
        double* to = areas.data() + i * kMostTriangles;
        out.forEachTriangle(out.rows_[from + i], [&](const TriangleCorners& t) { *to++ = doubleAreaOf(t); });
      }
    });
    for (size_t i = 0; i < count; ++i) {
      out.area_before_.push_back(area);
      for (size_t k = 0; k < 2 * out.rows_[from + i].cells; ++k) area += areas[i * kMostTriangles + k];
    }
  }
  out.area_before_.push_back(area);
  out.boxes_ = BoxTree(boxes);
  for (const glm::vec3& v : out.vertices_) out.box_.add(v);
  return out;
}

RELIEVO_SIMD_CLONES double MeasuredSurface::Part::distance(const glm::dvec3& place, double within, size_t& row,
                                                           double enough) const noexcept {
  static_assert(kMostBlockCells <= BoxGroup::kBoxes);
  return closestByBoxes(boxes_, place, within, enough, row, [&](size_t i, const SearchReach& reach) {
    const size_t cells = rows_[i].cells;
    const glm::vec3 *a = vertices_.data() + rows_[i].first_vertex, *c = a + cells + 1;
    BoxGroup boxes;
    for (size_t x = 0; x < cells; ++x) {
      Box box;
      for (const glm::vec3& corner : {a[x], a[x + 1], c[x], c[x + 1]}) box.add(corner);
      boxes.set(x, box);
    }
    const BoxGroup::Lanes squared = boxes.squaredDistances(reach.place());
    double least = std::numeric_limits<double>::infinity();
    for (size_t x = 0; x < cells; ++x) {
      if (squared[x] > reach.squared()) continue;
      for (const TriangleCorners& t : trianglesOfCell(a, c, x))
        least = std::min(least, closestOnTriangle(t, place).distance);
    }
    return least;
  });
}

void MeasuredSurface::addSamples(const Part& part, double whole_area, size_t count, const glm::dvec3& shift,
                                 int workers, std::vector<glm::dvec3>& out) {
  constexpr size_t kSamplesPerJob = 1024;
  const AreaSamples samples(whole_area, count);
  const size_t first = samples.firstAt(part.areaBefore()), end = samples.firstAt(part.areaAfter()), from = out.size();
  if (end <= first) return;
  const std::vector<double>& before = part.area_before_;
  out.resize(from + end - first);
  parallelFor((end - first + kSamplesPerJob - 1) / kSamplesPerJob, workers, nullptr, [&](size_t job) {
    for (size_t k = first + job * kSamplesPerJob; k < std::min(end, first + (job + 1) * kSamplesPerJob); ++k) {
      const double area = samples.areaBefore(k);
      const size_t row =
          std::min(static_cast<size_t>(std::upper_bound(before.begin(), before.end(), area) - before.begin()) - 1,
                   part.rows_.size() - 1);
      double so_far = before[row];
      TriangleCorners at{};
      bool found = false;
      part.forEachTriangle(part.rows_[row], [&](const TriangleCorners& t) {
        if (found) return;
        at = t;
        so_far += doubleAreaOf(t);
        found = area < so_far;
      });
      const glm::dvec2 w = pointInTriangle(k);
      out[from + k - first] = at.a + w.x * (at.b - at.a) + w.y * (at.c - at.a) + shift;
    }
  });
}

}  // namespace relievo
