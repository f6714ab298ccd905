// true_relief.h - reliefs of flat artworks held in full, and the oracle of their true errors, for tests of what LODs
// promise.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <unordered_map>
#include <vector>

#include "tests/geometry/cell_ranges.h"
#include "tests/geometry/lod_fixture.h"

namespace relievo::test {

// What the oracle tells of a page's parts; kMirrored: what is true of the part at the other side of the page.
enum class Parts { kNone, kTrue, kMirrored };

// A relief held in full, and the oracle of its true bounds.
class TrueRelief final : public ReliefOracle {
 public:
  TrueRelief(const FlatDomain& domain, const HeightFunction& height, Parts parts = Parts::kTrue)
      : domain_(domain), parts_(parts) {
    spacing_log2_ = reliefSpacingLog2(domain, static_cast<uint32_t>(domain.relief_depth));
    width_ = static_cast<int64_t>(domain.width_px) << kUnitsPerTexelLog2;
    height_ = static_cast<int64_t>(domain.height_px) << kUnitsPerTexelLog2;
    columns_ = ((static_cast<int64_t>(domain.patchColumns()) * kPagePx) << domain.relief_depth) + 1;
    rows_ = ((static_cast<int64_t>(domain.patchRows()) * kPagePx) << domain.relief_depth) + 1;
    samples_.resize(static_cast<size_t>(columns_ * rows_));
    for (int64_t j = 0; j < rows_; ++j)
      for (int64_t i = 0; i < columns_; ++i)
        samples_[static_cast<size_t>(j * columns_ + i)] = height(placeX(i), placeY(j));
    for (int level = domain.relief_depth; level >= 0; --level)
      for (uint32_t patch = 0; patch < domain.patchCount(); ++patch)
        for (uint32_t y = 0; y < 1u << level; ++y)
          for (uint32_t x = 0; x < 1u << level; ++x)
            if (NodeId n{patch, static_cast<uint32_t>(level), x, y}; domain.nodeExists(n)) bounds_[n] = measure(n);
  }
  HeightBounds bounds(const NodeId& page) const override { return bounds_.at(page); }
  bool errorBlocks(const NodeId& page, std::span<float> error_mm) const override {
    if (parts_ == Parts::kNone) return false;
    const auto& blocks = blocks_.at(page);
    for (size_t k = 0; k < blocks.size(); ++k)
      error_mm[k] = up(blocks[parts_ == Parts::kTrue ? k : blocks.size() - 1 - k].mm);
    return true;
  }
  bool errorShapes(const NodeId& page, std::span<DeviationShape> shapes) const override {
    const auto& blocks = blocks_.at(page);
    for (size_t k = 0; k < blocks.size(); ++k) {
      shapes[k] = shapes_are_empty_ ? DeviationShape{0, 0, 0, 0, 0} : shapeOf(blocks[k]);
    }
    return parts_ == Parts::kTrue;
  }
  // For a control: errors are said to have no extent.
  void tellEmptyShapes() { shapes_are_empty_ = true; }

  int64_t columns() const { return columns_; }
  int64_t rows() const { return rows_; }
  int64_t placeX(int64_t i) const { return std::min(i << spacing_log2_, width_); }
  int64_t placeY(int64_t j) const { return std::min(j << spacing_log2_, height_); }
  int spacingLog2() const { return spacing_log2_; }
  double mm(int64_t i, int64_t j) const {
    return domain_.relief_offset_mm + domain_.relief_scale_mm * samples_[static_cast<size_t>(j * columns_ + i)];
  }
  size_t pageCount() const { return bounds_.size(); }
  const FlatDomain& domain() const { return domain_; }

 private:
  // The page's own samples, interpolated over the clamped triangles that the renderer draws, against all finest
  // samples.
  HeightBounds measure(const NodeId& n) {
    int64_t step = int64_t{1} << (domain_.relief_depth - static_cast<int>(n.level)), side = step * kPagePx;
    int64_t patch_side = int64_t{kPagePx} << domain_.relief_depth;
    int64_t i0 = (domain_.alongX() ? n.patch * patch_side : 0) + n.x * side,
            j0 = (domain_.alongX() ? 0 : n.patch * patch_side) + n.y * side;
    double low = 1e30, high = -1e30, error = 0;
    auto& blocks = blocks_[n];
    blocks.fill({});
    CellRanges apart(kPagePx, step);
    for (int64_t j = j0; j <= j0 + side; ++j)
      for (int64_t i = i0; i <= i0 + side; ++i) {
        double z = mm(i, j);
        low = std::min(low, z);
        high = std::max(high, z);
        int64_t a = i0 + (std::min(i, i0 + side - 1) - i0) / step * step,
                b = j0 + (std::min(j, j0 + side - 1) - j0) / step * step;
        auto part = [](int64_t v, int64_t v0, int64_t v1) {
          return v1 > v0 ? static_cast<double>(v - v0) / static_cast<double>(v1 - v0) : 0.0;
        };
        double u = part(placeX(i), placeX(a), placeX(a + step)), v = part(placeY(j), placeY(b), placeY(b + step));
        double z00 = mm(a, b), z10 = mm(a + step, b), z01 = mm(a, b + step), z11 = mm(a + step, b + step);
        double drawn = u >= v ? z00 + u * (z10 - z00) + v * (z11 - z10) : z00 + v * (z01 - z00) + u * (z11 - z01);
        double off = std::abs(drawn - z);
        error = std::max(error, off);
        apart.note(i - i0, j - j0, z - drawn);
        // Of both parts where it lies on their border.
        int64_t width = side / 16;
        for (int64_t by = std::max<int64_t>(0, j - j0 - 1) / width; by <= std::min<int64_t>(15, (j - j0) / width); ++by)
          for (int64_t bx = std::max<int64_t>(0, i - i0 - 1) / width; bx <= std::min<int64_t>(15, (i - i0) / width);
               ++bx) {
            Deviation& block = blocks[static_cast<size_t>(by * 16 + bx)];
            block = joined(block, {off, drawn - z, z - drawn, 0, 0, 0});
          }
      }
    for (int64_t k = 0; k < 256; ++k) {
      Deviation& block = blocks[static_cast<size_t>(k)];
      block.between_mm = block.apart_mm = apart.largest(k % 16 * 8, k / 16 * 8, 8);
    }
    if (static_cast<int>(n.level) < domain_.relief_depth)  // monotone
      for (uint32_t k = 0; k < 4; ++k)
        if (auto child = bounds_.find(n.child(k & 1, k >> 1)); child != bounds_.end()) {
          error = std::max<double>(error, child->second.error_mm);
          const auto& finer = blocks_.at(n.child(k & 1, k >> 1));
          for (uint32_t at = 0; at < 256; ++at) {
            Deviation& block = blocks[((k >> 1) * 8 + at / 32) * 16 + (k & 1) * 8 + at % 16 / 2];
            block = joined(block, finer[at]);
          }
        }
    return {-up(-low), up(high), up(error)};
  }
  static float up(double v) { return std::nextafter(static_cast<float>(v), 1e30f); }
  FlatDomain domain_;
  Parts parts_;
  bool shapes_are_empty_ = false;
  int spacing_log2_ = 0;
  int64_t width_ = 0, height_ = 0, columns_ = 0, rows_ = 0;
  std::vector<uint16_t> samples_;
  std::unordered_map<NodeId, HeightBounds> bounds_;
  std::unordered_map<NodeId, std::array<Deviation, 256>> blocks_;
};

// Hills, a fold along the diagonal, ridges, pits of one sample, a rough quarter.
inline uint16_t reliefHeight(int64_t x_units, int64_t y_units) {
  double x = static_cast<double>(x_units) / 16, y = static_cast<double>(y_units) / 16;
  double z = 0.45 + 0.2 * std::sin(x * 0.011 + 1) * std::cos(y * 0.017) + 0.05 * std::sin(x * 0.13 + y * 0.07);
  z += 0.1 * std::min(1.0, std::abs(x - y) * 0.01) + 0.05 * (std::fmod(x, 97.0) < 3 ? 1 : 0);
  uint64_t h = mix(static_cast<uint64_t>(x_units) * 7919 + static_cast<uint64_t>(y_units));
  if (x < 200 && y < 150) z += 0.05 * static_cast<double>(h & 1023) / 1023;
  if ((h & 4095) == 5) z += 0.15;
  return static_cast<uint16_t>(65535 * std::clamp(z, 0.0, 1.0));
}

// The largest deviation over the samples in view. Both points must lie in front of the near plane, else there is no
// picture.
inline Measured measureError(const FlatDomain& domain, const TrueRelief& relief, const LodView& view,
                             const Camera& camera, const std::vector<PatchInstance>& instances, ReliefPages& pages) {
  Measured m;
  double mm_per_unit = domain.mm_per_px / (1 << kUnitsPerTexelLog2);
  double half_w = 0.5 * static_cast<double>(domain.width_px << kUnitsPerTexelLog2),
         half_h = 0.5 * static_cast<double>(domain.height_px << kUnitsPerTexelLog2);
  const bool orthographic = glm::length(glm::dvec3(glm::transpose(view.clip_from_world)[3])) == 0;
  auto project = [&](double x, double y, double z, glm::dvec2& px) {
    glm::dvec4 p = view.clip_from_world *
                   glm::dvec4((x - half_w) * mm_per_unit, (half_h - y) * mm_per_unit, z * view.exaggerate, 1);
    if (!orthographic && p.w < camera.near_mm) return -1;
    px = {p.x / p.w * 0.5 * camera.viewport_height_px * camera.aspect, p.y / p.w * 0.5 * camera.viewport_height_px};
    return std::abs(p.x) <= p.w && std::abs(p.y) <= p.w ? 1 : 0;
  };
  std::vector<PatchVertex> grid;
  for (const PatchInstance& p : instances) {
    uint32_t size = 1u << p.grid_level;
    grid.clear();
    for (uint32_t j = 0; j <= size; ++j)
      for (uint32_t i = 0; i <= size; ++i) grid.push_back(patchVertex(domain, p, i, j, view.relief, pages));
    auto triangle = [&](const PatchVertex& a, const PatchVertex& b, const PatchVertex& c) {
      int64_t area = static_cast<int64_t>(b.x - a.x) * (c.y - a.y) - static_cast<int64_t>(b.y - a.y) * (c.x - a.x);
      if (area <= 0) return;
      int64_t x0 = std::min({a.x, b.x, c.x}), x1 = std::max({a.x, b.x, c.x}), y0 = std::min({a.y, b.y, c.y}),
              y1 = std::max({a.y, b.y, c.y});
      int s = relief.spacingLog2();
      for (int64_t j = (y0 + (1 << s) - 1) >> s; j < relief.rows() && relief.placeY(j) <= y1; ++j) {
        int64_t y = relief.placeY(j);
        for (int64_t i = (x0 + (1 << s) - 1) >> s; i < relief.columns() && relief.placeX(i) <= x1; ++i) {
          int64_t x = relief.placeX(i);
          int64_t wb = (x - a.x) * (c.y - a.y) - (y - a.y) * (c.x - a.x),
                  wc = (b.x - a.x) * (y - a.y) - (b.y - a.y) * (x - a.x);
          if (wb < 0 || wc < 0 || wb + wc > area) {
            if (x == relief.placeX(relief.columns() - 1)) break;
            continue;
          }
          double q = a.height_q8 + (static_cast<double>(wb) * (static_cast<double>(b.height_q8) - a.height_q8) +
                                    static_cast<double>(wc) * (static_cast<double>(c.height_q8) - a.height_q8)) /
                                       static_cast<double>(area);
          double drawn = domain.relief_offset_mm + domain.relief_scale_mm * q / 256;
          glm::dvec2 at_true(0), at_drawn(0);
          int in_true = project(static_cast<double>(x), static_cast<double>(y), relief.mm(i, j), at_true);
          int in_drawn = project(static_cast<double>(x), static_cast<double>(y), drawn, at_drawn);
          if (in_true >= 0 && in_drawn >= 0 && (in_true || in_drawn)) {
            m.max_px = std::max(m.max_px, glm::length(at_true - at_drawn));
            ++m.samples;
          }
          if (x == relief.placeX(relief.columns() - 1)) break;  // all further samples are clamped onto this one
        }
        if (y == relief.placeY(relief.rows() - 1)) break;
      }
    };
    for (uint32_t j = 0; j < size; ++j)
      for (uint32_t i = 0; i < size; ++i) {
        const PatchVertex &v00 = grid[j * (size + 1) + i], &v10 = grid[j * (size + 1) + i + 1],
                          &v01 = grid[(j + 1) * (size + 1) + i], &v11 = grid[(j + 1) * (size + 1) + i + 1];
        triangle(v00, v10, v11);
        triangle(v00, v11, v01);
      }
  }
  return m;
}

}  // namespace relievo::test
