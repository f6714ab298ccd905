// strategy_body.h - the finest relief of an artwork over a base mesh held in full: the truth that strategies are
// measured against there. The surface is that of base_mesh.h: triangles between the vertices P + h N of the finest
// grid, cells cut along (i, j) - (i + 1, j + 1). Places are units of a patch's finest cells, 0 .. side (mesh_lod.h).
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <numeric>
#include <utility>
#include <vector>

#include <glm/glm.hpp>

#include "src/artwork/base_mesh.h"
#include "src/artwork/patch_domain.h"

namespace relievo {

struct BodyField {
  std::shared_ptr<const BaseMesh> base;
  double offset_mm = 0, scale_mm = 0;
  int64_t side = kPagePx;
  std::vector<uint32_t> grid_of;  // by patch: patches that are alike share one
  std::vector<uint16_t> samples;  // grid after grid, (side + 1)^2 each, rows of v from 0

  // grids: grid_of, numbered from 0 on; none: a grid a patch.
  BodyField(std::shared_ptr<const BaseMesh> mesh, const PatchMeasures& domain, std::vector<uint32_t> grids = {})
      : base(std::move(mesh)),
        offset_mm(domain.relief_offset_mm),
        scale_mm(domain.relief_scale_mm),
        side(int64_t{kPagePx} << std::max(0, domain.relief_depth)),
        grid_of(std::move(grids)) {
    if (grid_of.empty()) {
      grid_of.resize(base->patches.size());
      std::iota(grid_of.begin(), grid_of.end(), 0u);
    }
    const size_t count = size_t{*std::max_element(grid_of.begin(), grid_of.end())} + 1;
    samples.resize(count * static_cast<size_t>((side + 1) * (side + 1)));
  }
  uint16_t& at(uint32_t patch, int64_t x, int64_t y) {
    return samples[(size_t{grid_of[patch]} * static_cast<size_t>(side + 1) + static_cast<size_t>(y)) *
                       static_cast<size_t>(side + 1) +
                   static_cast<size_t>(x)];
  }
  uint16_t at(uint32_t patch, int64_t x, int64_t y) const { return const_cast<BodyField*>(this)->at(patch, x, y); }
  // What a page of the finest level says of its square.
  template <class Samples>
  void setPage(const NodeId& page, const Samples& page_samples) {
    for (int64_t y = 0; y < kReliefSamples; ++y)
      for (int64_t x = 0; x < kReliefSamples; ++x)
        at(page.patch, int64_t{page.x} * kPagePx + x, int64_t{page.y} * kPagePx + y) =
            page_samples[static_cast<size_t>(y * kReliefSamples + x)];
  }
  glm::dvec3 vertexMm(uint32_t patch, int64_t x, int64_t y, double exaggerate) const {
    const double u = static_cast<double>(x) / static_cast<double>(side),
                 v = static_cast<double>(y) / static_cast<double>(side);
    return base->point(patch, u, v) + exaggerate * (offset_mm + scale_mm * at(patch, x, y)) * base->normal(patch, u, v);
  }
  glm::dvec3 pointMm(uint32_t patch, double x, double y, double exaggerate) const {
    auto cell = [this](double place) { return std::clamp<int64_t>(static_cast<int64_t>(place), 0, side - 1); };
    const int64_t i = cell(x), j = cell(y);
    const double u = std::clamp(x - static_cast<double>(i), 0.0, 1.0),
                 v = std::clamp(y - static_cast<double>(j), 0.0, 1.0);
    const glm::dvec3 p00 = vertexMm(patch, i, j, exaggerate), p11 = vertexMm(patch, i + 1, j + 1, exaggerate);
    if (u >= v) {
      const glm::dvec3 p10 = vertexMm(patch, i + 1, j, exaggerate);
      return p00 + u * (p10 - p00) + v * (p11 - p10);
    }
    const glm::dvec3 p01 = vertexMm(patch, i, j + 1, exaggerate);
    return p00 + v * (p01 - p00) + u * (p11 - p01);
  }
};

}  // namespace relievo
