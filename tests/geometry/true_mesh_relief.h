// true_mesh_relief.h - reliefs over base meshes held in full, and the oracle of their true errors, for tests of what
// LODs promise.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <map>
#include <vector>

#include "tests/geometry/mesh_fixture.h"

namespace relievo::test {

// Heights of an artwork held in full, the oracle of its true errors, and its surface in double precision.
class TrueMeshRelief final : public ReliefOracle {
 public:
  // height: a value 0..1 at a place of the base and its name; shared places get one value.
  TrueMeshRelief(const BaseMesh& mesh, const MeshRelief& relief,
                 const std::function<double(const glm::dvec3&, const Place&)>& height)
      : mesh_(mesh),
        relief_(relief),
        side_(int64_t{1} << relief.unitLog2()),
        patches_(mesh.patches.size()),
        coarse_(mesh.patches.size()),
        coarse_blocks_(mesh.patches.size()),
        coarse_shapes_(mesh.patches.size()) {
    std::map<Place, uint16_t> shared;
    for (uint32_t p = 0; p < mesh.patches.size(); ++p) {
      auto& samples = patches_[p];
      samples.resize(static_cast<size_t>((side_ + 1) * (side_ + 1)));
      for (int64_t y = 0; y <= side_; ++y)
        for (int64_t x = 0; x <= side_; ++x) {
          Place place = placeOf(mesh, relief.unitLog2(), p, static_cast<uint32_t>(x), static_cast<uint32_t>(y));
          auto compute = [&] {
            double z = height(mesh.point(p, double(x) / double(side_), double(y) / double(side_)), place);
            return static_cast<uint16_t>(std::lround(65535 * std::clamp(z, 0.0, 1.0)));
          };
          uint16_t& q = samples[static_cast<size_t>(y * (side_ + 1) + x)];
          if (place.kind == 0) {
            q = compute();
          } else if (auto found = shared.find(place); found != shared.end()) {
            q = found->second;
          } else {
            q = shared[place] = compute();
          }
        }
    }
    for (uint32_t p = 0; p < mesh.patches.size(); ++p) measure(p);
  }
  HeightBounds bounds(const NodeId& page) const override { return pages_.at(page).bounds; }
  bool errorBlocks(const NodeId& page, std::span<float> error_mm) const override {
    const auto& blocks = pages_.at(page).blocks;
    std::copy(blocks.begin(), blocks.end(), error_mm.begin());
    return true;
  }
  bool coarseBlocks(uint32_t patch, int cells_log2, std::span<float> error_mm) const override {
    const auto& blocks = coarse_blocks_[patch][static_cast<size_t>(cells_log2 - 4)];
    if (parts_ == Parts::kTrue) std::copy(blocks.begin(), blocks.end(), error_mm.begin());
    if (parts_ == Parts::kMirrored) std::copy(blocks.rbegin(), blocks.rend(), error_mm.begin());
    return parts_ != Parts::kNone;
  }
  bool errorShapes(const NodeId& page, std::span<DeviationShape> shapes) const override {
    return tellShapes(pages_.at(page).shapes, shapes);
  }
  bool coarseShapes(uint32_t patch, int cells_log2, std::span<DeviationShape> shapes) const override {
    return parts_ == Parts::kTrue && tellShapes(coarse_shapes_[patch][static_cast<size_t>(cells_log2)], shapes);
  }
  // Of the errors' directions; kAcrossAlone: what lies along the normal is left out.
  enum class Shapes { kNone, kTrue, kAcrossAlone };
  void tell(Shapes shapes) { shapes_ = shapes; }
  // What is told of the parts of coarse grids; kMirrored: what is true at the other end of the patch.
  enum class Parts { kNone, kTrue, kMirrored };
  void tell(Parts parts) { parts_ = parts; }
  const std::vector<CoarseErrors>& coarse() const { return coarse_; }
  int64_t side() const { return side_; }
  uint16_t sample(uint32_t patch, int64_t x, int64_t y) const {
    return patches_[patch][static_cast<size_t>(y * (side_ + 1) + x)];
  }
  glm::dvec3 point(uint32_t patch, int64_t x, int64_t y, double exaggerate) const {
    double u = double(x) / double(side_), v = double(y) / double(side_);
    double mm = relief_.offset_mm + relief_.scale_mm * patches_[patch][static_cast<size_t>(y * (side_ + 1) + x)];
    return mesh_.point(patch, u, v) + exaggerate * mm * mesh_.normal(patch, u, v);
  }

 private:
  template <class Known>
  bool tellShapes(const Known& known, std::span<DeviationShape> out) const {
    std::copy(known.begin(), known.end(), out.begin());
    if (shapes_ == Shapes::kAcrossAlone)
      for (DeviationShape& s : out) s = {0, 0, s.aside, 0, 255};
    return shapes_ != Shapes::kNone;
  }
  struct Page {
    HeightBounds bounds;
    std::array<float, 256> blocks{};
    std::array<DeviationShape, 256> shapes{};
  };
  void measure(uint32_t p) {
    const int unit = relief_.unitLog2();
    std::vector<glm::dvec3> s;
    for (int64_t y = 0; y <= side_; ++y)
      for (int64_t x = 0; x <= side_; ++x) s.push_back(point(p, x, y, 1));
    auto at = [&](int64_t x, int64_t y) -> const glm::dvec3& { return s[static_cast<size_t>(y * (side_ + 1) + x)]; };
    // By cells of level L: the largest deviation in it, or of finer levels.
    std::vector<Deviation> finer;
    for (int level = unit - 1; level >= 0; --level) {
      const int64_t cells = int64_t{1} << level, step = side_ >> level;
      std::vector<Deviation> cell(static_cast<size_t>(cells * cells));
      for (int64_t cy = 0; cy < cells; ++cy)
        for (int64_t cx = 0; cx < cells; ++cx) {
          const glm::dvec3 &c00 = at(cx * step, cy * step), &c10 = at((cx + 1) * step, cy * step),
                           &c01 = at(cx * step, (cy + 1) * step), &c11 = at((cx + 1) * step, (cy + 1) * step);
          Deviation most;
          double low = 0, high = 0;
          glm::dvec3 box_low(0), box_high(0);
          for (int64_t j = 0; j <= step; ++j)
            for (int64_t i = 0; i <= step; ++i) {
              double u = double(i) / double(step), v = double(j) / double(step);
              glm::dvec3 drawn =
                  u >= v ? c00 + u * (c10 - c00) + v * (c11 - c10) : c00 + v * (c01 - c00) + u * (c11 - c01);
              const glm::dvec3 d = at(cx * step + i, cy * step + j) - drawn;
              const glm::dvec3 n =
                  mesh_.normal(p, double(cx * step + i) / double(side_), double(cy * step + j) / double(side_));
              const double length = glm::length(n), along = length > 1e-6 ? glm::dot(d, n / length) : 0,
                           across = length > 1e-6 ? glm::length(d - along * (n / length)) : glm::length(d);
              most = joined(most, {glm::length(d), -along, along, across, 0, 0});
              low = std::min(low, along), high = std::max(high, along);
              box_low = glm::min(box_low, d), box_high = glm::max(box_high, d);
            }
          auto& e = cell[static_cast<size_t>(cy * cells + cx)];
          e = most;
          e.between_mm = high - low;
          e.apart_mm = glm::length(box_high - box_low);
          if (!finer.empty())
            for (int k = 0; k < 4; ++k)
              e = joined(e, finer[static_cast<size_t>((2 * cy + (k >> 1)) * 2 * cells + 2 * cx + (k & 1))]);
        }
      auto up = [](double mm) { return mm > 0 ? std::nextafter(static_cast<float>(mm), 1e30f) : 0.0f; };
      // By blocks of so many cells a side.
      auto blocks = [&](int64_t size, auto&& mm, auto&& shapes) {
        const int64_t count = std::max<int64_t>(1, cells / size);
        std::vector<Deviation> all(static_cast<size_t>(count * count));
        for (int64_t j = 0; j < cells; ++j)
          for (int64_t i = 0; i < cells; ++i) {
            Deviation& block = all[static_cast<size_t>(j / size * count + i / size)];
            block = joined(block, cell[static_cast<size_t>(j * cells + i)]);
          }
        for (const Deviation& block : all) mm.push_back(up(block.mm)), shapes.push_back(shapeOf(block));
      };
      if (level < 7) {
        std::vector<float> mm;
        blocks(level < 4 ? cells : 8, mm, coarse_shapes_[p][static_cast<size_t>(level)]);
        coarse_[p][static_cast<size_t>(level)] = *std::max_element(mm.begin(), mm.end());
        if (level >= 4) coarse_blocks_[p][static_cast<size_t>(level - 4)] = mm;
      }
      if (level >= 7) {
        std::vector<float> mm;
        std::vector<DeviationShape> shapes;
        blocks(8, mm, shapes);
        addPages(p, level - 7, mm, shapes);
      }
      finer = std::move(cell);
    }
    addPages(p, unit - 7, {}, {});
  }
  // Of this level's blocks; empty: no errors.
  void addPages(uint32_t p, int level, const std::vector<float>& mm, const std::vector<DeviationShape>& shapes) {
    const int64_t pages = int64_t{1} << level, size = side_ >> level;
    for (int64_t y = 0; y < pages; ++y)
      for (int64_t x = 0; x < pages; ++x) {
        Page& page = pages_[{p, static_cast<uint32_t>(level), static_cast<uint32_t>(x), static_cast<uint32_t>(y)}];
        uint16_t low = 65535, high = 0;
        for (int64_t j = y * size; j <= (y + 1) * size; ++j)
          for (int64_t i = x * size; i <= (x + 1) * size; ++i) {
            uint16_t q = patches_[p][static_cast<size_t>(j * (side_ + 1) + i)];
            low = std::min(low, q), high = std::max(high, q);
          }
        page.bounds.min_mm = std::nextafter(static_cast<float>(relief_.offset_mm + relief_.scale_mm * low), -1e30f);
        page.bounds.max_mm = std::nextafter(static_cast<float>(relief_.offset_mm + relief_.scale_mm * high), 1e30f);
        if (mm.empty()) continue;
        for (int64_t k = 0; k < 256; ++k) {
          const auto at = static_cast<size_t>((y * 16 + k / 16) * pages * 16 + x * 16 + k % 16);
          page.blocks[static_cast<size_t>(k)] = mm[at];
          page.shapes[static_cast<size_t>(k)] = shapes[at];
        }
        page.bounds.error_mm = *std::max_element(page.blocks.begin(), page.blocks.end());
      }
  }

  const BaseMesh& mesh_;
  MeshRelief relief_;
  int64_t side_;
  std::vector<std::vector<uint16_t>> patches_;
  std::vector<CoarseErrors> coarse_;
  std::vector<std::array<std::vector<float>, 3>> coarse_blocks_;
  std::vector<std::array<std::vector<DeviationShape>, 7>> coarse_shapes_;
  std::map<NodeId, Page> pages_;
  Shapes shapes_ = Shapes::kTrue;
  Parts parts_ = Parts::kTrue;
};

// The drawn triangles against every finest vertex: both are projected in double precision, the drawn point at the same
// (u, v). Both points must lie in front of the near plane, else there is no picture, and one of them in the picture.
inline Measured measureError(const TrueMeshRelief& relief, int unit_log2, const LodView& view, const Camera& camera,
                             const std::vector<PatchInstance>& instances) {
  Measured m;
  const double exaggerate = view.relief ? view.exaggerate : 0;
  const bool orthographic = glm::length(glm::dvec3(glm::transpose(view.clip_from_world)[3])) == 0;
  auto project = [&](const glm::dvec3& at, glm::dvec2& px) {
    glm::dvec4 p = view.clip_from_world * glm::dvec4(at, 1);
    if (!orthographic && p.w < camera.near_mm) return -1;
    px = glm::dvec2(p.x * camera.aspect, p.y) / p.w * 0.5 * camera.viewport_height_px;
    return std::abs(p.x) <= p.w && std::abs(p.y) <= p.w ? 1 : 0;
  };
  struct Vertex {
    int64_t x, y;
    glm::dvec3 at;
  };
  std::vector<Vertex> grid;
  std::vector<glm::dvec2> fine_px;
  std::vector<int> fine_in;
  for (const PatchInstance& p : instances) {
    const uint32_t size = 1u << p.grid_level;
    const int64_t width = int64_t{1} << (unit_log2 - static_cast<int>(p.node.level));
    grid.clear(), fine_px.clear(), fine_in.clear();
    for (uint32_t j = 0; j <= size; ++j)
      for (uint32_t i = 0; i <= size; ++i) {
        auto g = snapVertex(i, j, p);
        int64_t x = p.x0 + (int64_t{g[0]} << p.step_log2), y = p.y0 + (int64_t{g[1]} << p.step_log2);
        grid.push_back({x, y, relief.point(p.node.patch, x, y, exaggerate)});
      }
    for (int64_t y = 0; y <= width; ++y)
      for (int64_t x = 0; x <= width; ++x) {
        glm::dvec2 px(0);
        fine_in.push_back(project(relief.point(p.node.patch, p.x0 + x, p.y0 + y, exaggerate), px));
        fine_px.push_back(px);
      }
    auto triangle = [&](const Vertex& a, const Vertex& b, const Vertex& c) {
      int64_t area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
      if (area == 0) return;
      ASSERT_GT(area, 0);
      for (int64_t y = std::min({a.y, b.y, c.y}); y <= std::max({a.y, b.y, c.y}); ++y)
        for (int64_t x = std::min({a.x, b.x, c.x}); x <= std::max({a.x, b.x, c.x}); ++x) {
          int64_t wb = (x - a.x) * (c.y - a.y) - (y - a.y) * (c.x - a.x),
                  wc = (b.x - a.x) * (y - a.y) - (b.y - a.y) * (x - a.x);
          if (wb < 0 || wc < 0 || wb + wc > area) continue;
          auto k = static_cast<size_t>((y - p.y0) * (width + 1) + x - p.x0);
          if (fine_in[k] < 0) continue;
          glm::dvec3 drawn =
              a.at + (double(wb) / double(area)) * (b.at - a.at) + (double(wc) / double(area)) * (c.at - a.at);
          glm::dvec2 px(0);
          int in = project(drawn, px);
          if (in < 0 || (!in && !fine_in[k])) continue;
          m.max_px = std::max(m.max_px, glm::length(px - fine_px[k]));
          ++m.samples;
        }
    };
    for (uint32_t j = 0; j < size; ++j)
      for (uint32_t i = 0; i < size; ++i) {
        const Vertex *top = &grid[j * (size + 1) + i], *bottom = top + size + 1;
        triangle(top[0], top[1], bottom[1]);
        triangle(top[0], bottom[1], bottom[0]);
      }
  }
  return m;
}

}  // namespace relievo::test
