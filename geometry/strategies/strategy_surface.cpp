#include "geometry/strategies/strategy_surface.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <type_traits>
#include <unordered_map>

namespace relievo {
namespace {

double squareOfLength(double v) { return v * v; }
double squareOfLength(const glm::dvec3& v) { return glm::dot(v, v); }

// One triangle against the samples. At(i, j) is a sample's value: a height, or a point in space.
template <class At>
class TriangleDeviation {
 public:
  using Sample = std::array<int64_t, 2>;
  using Value = std::invoke_result_t<At, int64_t, int64_t>;
  TriangleDeviation(const std::array<SampleAxis, 2>& axes, const At& at) : x_(axes[0]), y_(axes[1]), at_(at) {}
  double largestSquare(const std::array<Sample, 3>& corners) {
    square_ = 0;
    inside(corners);
    for (size_t k = 0; k < 3; ++k) edge(corners[k], corners[(k + 1) % 3]);
    return square_;
  }
  double insideSquare(const std::array<Sample, 3>& corners) {
    square_ = 0;
    inside(corners);
    return square_;
  }
  double edgeSquare(const Sample& from, const Sample& to) {
    square_ = 0;
    edge(from, to);
    return square_;
  }

 private:
  void meet(const Value& drawn, const Value& truth) { square_ = std::max(square_, squareOfLength(drawn - truth)); }

  void inside(const std::array<Sample, 3>& c) {
    std::array<glm::dvec2, 3> p;
    for (size_t k = 0; k < 3; ++k) p[k] = {x_.at(c[k][0]), y_.at(c[k][1])};
    const double area = (p[1].x - p[0].x) * (p[2].y - p[0].y) - (p[1].y - p[0].y) * (p[2].x - p[0].x);
    const auto [low_i, high_i] = std::minmax({c[0][0], c[1][0], c[2][0]});
    const auto [low_j, high_j] = std::minmax({c[0][1], c[1][1], c[2][1]});
    if (area == 0 || (high_i - low_i < 2 && high_j - low_j < 2)) return;
    const Value a = at_(c[0][0], c[0][1]), ab = at_(c[1][0], c[1][1]) - a, ac = at_(c[2][0], c[2][1]) - a;
    for (int64_t j = low_j; j <= high_j; ++j) {
      const double y = y_.at(j);
      double from = std::numeric_limits<double>::infinity(), to = -from;
      for (size_t k = 0; k < 3; ++k) {
        const glm::dvec2 &s = p[k], &e = p[(k + 1) % 3];
        if (std::min(s.y, e.y) > y || std::max(s.y, e.y) < y) continue;
        const bool level = s.y == e.y;
        const double x = level ? s.x : s.x + (e.x - s.x) * ((y - s.y) / (e.y - s.y));
        from = std::min({from, x, level ? e.x : x});
        to = std::max({to, x, level ? e.x : x});
      }
      int64_t i = std::max(low_i, static_cast<int64_t>(std::ceil(from / static_cast<double>(x_.step) - 1e-9)));
      for (; i <= high_i; ++i) {
        const double x = x_.at(i);
        if (x > to) break;
        const double v = ((x - p[0].x) * (p[2].y - p[0].y) - (y - p[0].y) * (p[2].x - p[0].x)) / area,
                     w = ((p[1].x - p[0].x) * (y - p[0].y) - (p[1].y - p[0].y) * (x - p[0].x)) / area;
        meet(a + v * ab + w * ac, at_(i, j));
      }
    }
  }

  // Cell by cell: where it enters one, and where it crosses the cell's diagonal.
  void edge(const Sample& s, const Sample& e) {
    const int64_t di = e[0] - s[0], dj = e[1] - s[1];
    if (std::abs(di) + std::abs(dj) < 2 || (di == dj && std::abs(di) == 1)) return;  // an edge of the grid
    const Value from = at_(s[0], s[1]), along = at_(e[0], e[1]) - from;
    const double x0 = x_.at(s[0]), y0 = y_.at(s[1]), dx = x_.at(e[0]) - x0, dy = y_.at(e[1]) - y0;
    double t = 0;
    int64_t i = s[0], j = s[1];  // of the last lines that were crossed
    const int64_t si = di > 0 ? 1 : -1, sj = dj > 0 ? 1 : -1;
    while (t < 1) {
      const double tx = di == 0 || i == e[0] ? 2 : (x_.at(i + si) - x0) / dx,
                   ty = dj == 0 || j == e[1] ? 2 : (y_.at(j + sj) - y0) / dy, next = std::min({tx, ty, 1.0});
      const int64_t ci = std::min(di < 0 ? i - 1 : i, x_.last - 1), cj = std::min(dj < 0 ? j - 1 : j, y_.last - 1);
      // How far along the cell's diagonal less how far across: it changes sign where the diagonal is crossed.
      auto aside = [&](double at) {
        return (x0 + at * dx - x_.at(ci)) / (x_.at(ci + 1) - x_.at(ci)) -
               (y0 + at * dy - y_.at(cj)) / (y_.at(cj + 1) - y_.at(cj));
      };
      const double here = aside(t), there = aside(next);
      if (here * there < 0) {
        const double at = t + (next - t) * (here / (here - there)),
                     u = (x0 + at * dx - x_.at(ci)) / (x_.at(ci + 1) - x_.at(ci));
        meet(from + at * along, at_(ci, cj) + u * (at_(ci + 1, cj + 1) - at_(ci, cj)));
      }
      if (next >= 1) break;
      t = next;
      const bool across = tx <= ty, down = ty <= tx;
      if (across) i += si;
      if (down) j += sj;
      if (across && down) meet(from + t * along, at_(i, j));
      else if (across) between(from + t * along, (y0 + t * dy), i, cj, true);
      else between(from + t * along, (x0 + t * dx), ci, j, false);
    }
  }
  // The sample's line at a place between two samples: from (i, j) on, along y or x.
  void between(const Value& drawn, double place, int64_t i, int64_t j, bool upright) {
    const SampleAxis& axis = upright ? y_ : x_;
    const int64_t k = upright ? j : i;
    const double part = (place - axis.at(k)) / (axis.at(k + 1) - axis.at(k));
    const Value a = at_(i, j), b = upright ? at_(i, j + 1) : at_(i + 1, j);
    meet(drawn, a + part * (b - a));
  }

  const SampleAxis &x_, &y_;
  const At& at_;
  double square_ = 0;
};

// The finest samples between those of the coarsest grid with no error on any patch.
int64_t samplesApart(const StrategyScene& scene, int64_t side) {
  if (scene.coarse.size() != scene.body->base->patches.size()) return 1;
  for (size_t k = 0; k < CoarseErrors().size() && int64_t{1} << k < side; ++k)
    if (std::all_of(scene.coarse.begin(), scene.coarse.end(), [k](const CoarseErrors& e) { return e[k] == 0; }))
      return side >> k;
  return 1;
}

}  // namespace

FineSurface::FineSurface(const StrategyScene& scene, double exaggerate, uint64_t vertices_at_most)
    : scene_(scene), bounds_(scene), flat_(scene.domain.isFlat()), exaggerate_(flat_ ? 1 : exaggerate) {
  makeAxes(scene);
  auto vertices = [](const SampleAxis& axis, int64_t stride) { return (axis.last + stride - 1) / stride + 1; };
  auto count = [&] {
    int64_t columns = 0, rows = 0;
    for (const auto& a : axes_)
      columns = std::max(columns, vertices(a[0], stride_)), rows = std::max(rows, vertices(a[1], stride_));
    pitch_ = columns;
    per_patch_ = columns * rows;
    return static_cast<uint64_t>(per_patch_) * axes_.size();
  };
  while (count() > vertices_at_most && pitch_ > 2) stride_ *= 2;
  positions_.resize(count());
  weld_.resize(positions_.size());
  for (uint32_t v = 0; v < positions_.size(); ++v) {
    weld_[v] = v;
    const Place at = place(v);
    if (flat_) {
      const ReliefField& field = *scene_.field;
      const FlatDomain d = scene_.domain.flat();
      const int64_t left = static_cast<int64_t>(d.patchOriginX(at.patch)) << kUnitsPerTexelLog2,
                    top = static_cast<int64_t>(d.patchOriginY(at.patch)) << kUnitsPerTexelLog2;
      const int64_t i = (left >> field.spacing_log2) + at.i, j = (top >> field.spacing_log2) + at.j;
      positions_[v] = field.worldMm(static_cast<double>(left) + axes_[at.patch][0].at(at.i),
                                    static_cast<double>(top) + axes_[at.patch][1].at(at.j),
                                    d.relief_offset_mm + d.relief_scale_mm * field.at(i, j));
    } else {
      const int64_t step = axes_[at.patch][0].step;
      positions_[v] = scene_.body->vertexMm(at.patch, at.i * step, at.j * step, exaggerate_);
    }
  }
  if (flat_) weldFlat();
  else weldPatches(*scene_.body->base);
  for (uint32_t v = 0; v < positions_.size(); ++v) positions_[v] = positions_[weld_[v]];
}

void FineSurface::makeAxes(const StrategyScene& scene) {
  const int64_t side = int64_t{kPagePx} << std::max(0, scene.domain.relief_depth);
  if (!flat_) {
    const int64_t step = samplesApart(scene, side);
    const SampleAxis axis{side / step, step, side};
    axes_.assign(scene.body->base->patches.size(), {axis, axis});
    finest_ = static_cast<double>(step);
    return;
  }
  const ReliefField& field = *scene.field;
  const FlatDomain d = scene.domain.flat();
  const int64_t step = int64_t{1} << field.spacing_log2;
  for (uint32_t p = 0; p < d.patchCount(); ++p) {
    auto axis = [&](uint64_t origin_px, int64_t border_units) {
      const int64_t end = std::min(border_units - (static_cast<int64_t>(origin_px) << kUnitsPerTexelLog2), side * step);
      return SampleAxis{(end + step - 1) / step, step, end};
    };
    axes_.push_back({axis(d.patchOriginX(p), field.widthUnits()), axis(d.patchOriginY(p), field.heightUnits())});
  }
}

// What lies beyond the last row or column of a patch smaller than others is its corner once more.
FineSurface::Place FineSurface::place(uint32_t vertex) const {
  Place p;
  p.patch = static_cast<uint32_t>(vertex / per_patch_);
  const int64_t rest = vertex % per_patch_;
  const int64_t last_i = axes_[p.patch][0].last, last_j = axes_[p.patch][1].last;
  p.i = std::min(rest % pitch_ * stride_, last_i);
  p.j = std::min(rest / pitch_ * stride_, last_j);
  if (rest % pitch_ * stride_ >= last_i + stride_ || rest / pitch_ * stride_ >= last_j + stride_)
    p.i = last_i, p.j = last_j;
  return p;
}

bool FineSurface::isCorner(uint32_t vertex) const {
  const Place p = place(vertex);
  return (p.i == 0 || p.i == axes_[p.patch][0].last) && (p.j == 0 || p.j == axes_[p.patch][1].last);
}
int FineSurface::sidesOf(uint32_t vertex) const {
  const Place p = place(vertex);
  return (p.i == 0) << kLeft | (p.i == axes_[p.patch][0].last) << kRight | (p.j == 0) << kTop |
         (p.j == axes_[p.patch][1].last) << kBottom;
}

void FineSurface::weldFlat() {
  const bool along_x = scene_.domain.flat().alongX();
  for (uint32_t p = 1; p < axes_.size(); ++p) {
    const int64_t last = (axes_[p - 1][along_x ? 0 : 1].last + stride_ - 1) / stride_,
                  across = (axes_[p][along_x ? 1 : 0].last + stride_ - 1) / stride_;
    for (int64_t k = 0; k <= across; ++k)
      weld_[along_x ? vertexAt(p, 0, k) : vertexAt(p, k, 0)] =
          along_x ? vertexAt(p - 1, last, k) : vertexAt(p - 1, k, last);
  }
}

// Sides that patches share, however many: by the two corners' indices. Corners: by theirs.
void FineSurface::weldPatches(const BaseMesh& base) {
  std::unordered_map<uint32_t, uint32_t> corners;
  std::unordered_map<uint64_t, uint32_t> on_sides;  // two corners and how far from the smaller one
  const int64_t last = pitch_ - 1;
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    const auto& c = base.patches[p];
    for (size_t k = 0; k < 4; ++k) {
      const uint32_t v = vertexAt(p, k % 2 ? last : 0, k / 2 ? last : 0);
      weld_[v] = corners.try_emplace(c[k], v).first->second;
    }
  }
  std::unordered_map<uint64_t, std::pair<uint32_t, int>> sides;  // patch and side that was first
  auto onSide = [&](uint32_t p, int side, int64_t k) {
    return side == kLeft    ? vertexAt(p, 0, k)
           : side == kRight ? vertexAt(p, last, k)
           : side == kTop   ? vertexAt(p, k, 0)
                            : vertexAt(p, k, last);
  };
  for (uint32_t p = 0; p < base.patches.size(); ++p)
    for (int side = 0; side < 4; ++side) {
      const auto ends = kSideCorners[static_cast<size_t>(side)];
      const uint32_t a = base.patches[p][static_cast<size_t>(ends[0])],
                     b = base.patches[p][static_cast<size_t>(ends[1])];
      const uint64_t name = uint64_t{std::min(a, b)} << 32 | std::max(a, b);
      const auto [first, fresh] = sides.try_emplace(name, p, side);
      if (fresh) continue;
      const auto [q, other] = first->second;
      const bool reversed = base.patches[q][static_cast<size_t>(kSideCorners[static_cast<size_t>(other)][0])] != a;
      for (int64_t k = 1; k < last; ++k) weld_[onSide(p, side, k)] = onSide(q, other, reversed ? last - k : k);
    }
}

std::vector<uint32_t> FineSurface::triangles(int block_log2) const {
  std::vector<uint32_t> out;
  out.reserve(6 * positions_.size());
  const int64_t block = int64_t{1} << block_log2;
  for (uint32_t p = 0; p < axes_.size(); ++p) {
    const int64_t columns = (axes_[p][0].last + stride_ - 1) / stride_,
                  rows = (axes_[p][1].last + stride_ - 1) / stride_;
    for (int64_t y0 = 0; y0 < rows; y0 += block)
      for (int64_t x0 = 0; x0 < columns; x0 += block)
        for (int64_t y = y0; y < std::min(y0 + block, rows); ++y)
          for (int64_t x = x0; x < std::min(x0 + block, columns); ++x)
            for (const uint32_t v : {vertexAt(p, x, y), vertexAt(p, x, y + 1), vertexAt(p, x + 1, y + 1),
                                     vertexAt(p, x, y), vertexAt(p, x + 1, y + 1), vertexAt(p, x + 1, y)})
              out.push_back(v);
  }
  return out;
}

// f(the value of a sample of the patch).
template <class F>
void FineSurface::withValues(uint32_t patch, F&& f) const {
  if (flat_) {
    const ReliefField& field = *scene_.field;
    const FlatDomain d = scene_.domain.flat();
    const uint16_t* corner =
        field.samples.data() +
        ((static_cast<int64_t>(d.patchOriginY(patch)) << kUnitsPerTexelLog2) >> field.spacing_log2) * field.columns +
        ((static_cast<int64_t>(d.patchOriginX(patch)) << kUnitsPerTexelLog2) >> field.spacing_log2);
    f([corner, columns = field.columns](int64_t i, int64_t j) { return static_cast<double>(corner[j * columns + i]); });
  } else if (stride_ == 1) {
    const glm::vec3* corner = positions_.data() + static_cast<int64_t>(patch) * per_patch_;
    f([corner, pitch = pitch_](int64_t i, int64_t j) { return glm::dvec3(corner[j * pitch + i]); });
  } else {
    f([this, patch, step = axes_[patch][0].step](int64_t i, int64_t j) {
      return scene_.body->vertexMm(patch, i * step, j * step, exaggerate_);
    });
  }
}

double FineSurface::deviationMm(std::span<const uint32_t> triangles) const {
  double square = 0;
  for (size_t k = 0; k + 2 < triangles.size(); k += 3) {
    std::array<Sample, 3> corners;
    const uint32_t patch = place(triangles[k]).patch;
    for (size_t c = 0; c < 3; ++c) {
      const Place at = place(triangles[k + c]);
      corners[c] = {at.i, at.j};
    }
    withValues(patch, [&](const auto& at) {
      square = std::max(square, TriangleDeviation(axes_[patch], at).largestSquare(corners));
    });
  }
  return std::sqrt(square) * fanUnitMm();
}

double FineSurface::fanDeviation(uint32_t patch, const Sample& hub, std::span<const std::array<Sample, 2>> rims,
                                 double enough) const {
  double square = 0;
  withValues(patch, [&](const auto& at) {
    TriangleDeviation one(axes_[patch], at);
    auto more = [&](double found) {
      square = std::max(square, found);
      return square > enough * enough;
    };
    for (const auto& rim : rims) {
      if (more(one.edgeSquare(hub, rim[1]))) return;
      const bool again = std::any_of(rims.begin(), rims.end(), [&](const auto& r) { return r[1] == rim[0]; });
      if (!again && more(one.edgeSquare(hub, rim[0]))) return;
    }
    for (const auto& rim : rims)
      if (more(one.insideSquare({hub, rim[0], rim[1]}))) return;
  });
  return std::sqrt(square);
}

WorldBox FineSurface::box(std::span<const uint32_t> triangles, double exaggerate, double around_mm) const {
  const float z = flat_ ? static_cast<float>(exaggerate) : 1.0f;
  glm::vec3 low(std::numeric_limits<float>::max()), high = -low;
  for (const uint32_t v : triangles) {
    const glm::vec3 p(positions_[v].x, positions_[v].y, positions_[v].z * z);
    low = glm::min(low, p);
    high = glm::max(high, p);
  }
  return {0.5 * glm::dvec3(low + high),
          0.5 * glm::dvec3(high - low) + glm::dvec3(flat_ ? 0 : around_mm, flat_ ? 0 : around_mm, around_mm), !flat_};
}

void FineSurface::append(std::span<const uint32_t> triangles, double cell_samples, StrategyMesh& mesh) const {
  std::unordered_map<uint32_t, uint32_t> known, nodes;
  const int64_t side = int64_t{kPagePx} << std::max(0, scene_.domain.relief_depth);
  const int grid_level =
      std::clamp(static_cast<int>(std::floor(std::log2(static_cast<double>(side) / std::max(1.0, cell_samples)))), 0,
                 bounds_.finestLevel());
  for (const uint32_t v : triangles) {
    const auto [index, fresh] = known.try_emplace(v, static_cast<uint32_t>(mesh.vertices.size()));
    if (fresh) {
      const Place at = place(v);
      const auto [node, new_node] = nodes.try_emplace(at.patch, static_cast<uint32_t>(mesh.instances.size()));
      if (new_node) {
        // One that is there already, mostly that of the triangles before.
        const PatchInstance p = bounds_.instance({at.patch, 0, 0, 0}, grid_level);
        const auto from =
            mesh.instances.end() - static_cast<std::ptrdiff_t>(std::min<size_t>(64, mesh.instances.size()));
        const auto there = std::find(from, mesh.instances.end(), p);
        node->second = static_cast<uint32_t>(there - mesh.instances.begin());
        if (there == mesh.instances.end()) mesh.instances.push_back(p);
      }
      const PatchInstance& p = mesh.instances[node->second];
      StrategyVertex out;
      out.x = p.x0 + static_cast<int32_t>(axes_[at.patch][0].at(at.i));
      out.y = p.y0 + static_cast<int32_t>(axes_[at.patch][1].at(at.j));
      const int64_t step = axes_[at.patch][0].step;
      out.height_steps = flat_ ? static_cast<float>(scene_.field->at((p.x0 / step) + at.i, (p.y0 / step) + at.j))
                               : static_cast<float>(scene_.body->at(at.patch, at.i * step, at.j * step));
      out.instance = node->second;
      mesh.vertices.push_back(out);
    }
    mesh.indices.push_back(index->second);
  }
}

}  // namespace relievo
