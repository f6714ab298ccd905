// strategy_surface.h - the finest relief as one indexed mesh, for strategies that simplify triangles instead of
// choosing levels of grids; and how far triangles between its vertices lie from it.
//
// Every patch has vertices of its own, so that a triangle lies in one patch and counts its places there; where patches
// meet, vertices have the same position, bit for bit, and the same weld(). A simplifier that keeps such vertices
// together leaves no crack.
//
// deviationMm() is exact, but for the rounding of positions to fp32: over a triangle both the drawn surface and the
// relief are linear in pieces over the patch's square, so their distance is largest at a sample, or where the
// triangle's edge crosses a line of the samples' grid. Units: mm; over a base mesh distances in space, on a flat
// artwork differences of height. Memory: 20 bytes a vertex.
//
// Over a base mesh the samples are those of the coarsest grid that is the finest surface everywhere, by the errors of
// coarser grids (StrategyScene::coarse): of a scan's own triangles the corners.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/strategies/lod_strategy.h"
#include "geometry/strategies/strategy_bounds.h"

namespace relievo {

// Of the finest mesh that strategies simplify: what fits memory and takes about a minute to simplify.
inline constexpr uint64_t kMostVertices = 5'000'000;

// Samples along one axis of a patch: the last one may lie nearer, at the artwork's border.
struct SampleAxis {
  int64_t last = 0;           // index of the last sample
  int64_t step = 1, end = 0;  // units
  double at(int64_t i) const { return static_cast<double>(std::min(i * step, end)); }
};

class FineSurface {
 public:
  // exaggerate: of heights over a base mesh. On a flat artwork they are not exaggerated: errors are in proportion to
  // it. vertices_at_most: above that the mesh has every second sample along both axes, or every fourth, and so on.
  FineSurface(const StrategyScene& scene, double exaggerate, uint64_t vertices_at_most);

  struct Place {
    uint32_t patch = 0;
    int64_t i = 0, j = 0;  // samples
  };
  Place place(uint32_t vertex) const;
  const std::vector<glm::vec3>& positions() const { return positions_; }
  uint32_t weld(uint32_t vertex) const { return weld_[vertex]; }
  bool whole() const { return stride_ == 1; }  // every sample is a vertex
  // Corners of patches: simplified away, a patch would lose a part of its square.
  bool isCorner(uint32_t vertex) const;
  int sidesOf(uint32_t vertex) const;  // of its patch, a bit each: 1 << Side
  // Three indices a triangle, patch after patch; within a patch in blocks of 2^block_log2 x 2^block_log2 cells.
  std::vector<uint32_t> triangles(int block_log2) const;
  // Which square of 2^log2 x 2^log2 cells of the mesh a vertex is the first corner in: patch, column, row.
  std::array<int64_t, 3> block(uint32_t vertex, int log2) const {
    const Place p = place(vertex);
    return {p.patch, p.i / stride_ >> log2, p.j / stride_ >> log2};
  }
  // The area of a triangle, three vertices, in cells of the finest samples.
  double samplesOf(const uint32_t* triangle) const {
    const Place a = place(triangle[0]), b = place(triangle[1]), c = place(triangle[2]);
    return 0.5 * finest_ * finest_ *
           std::abs(static_cast<double>((b.i - a.i) * (c.j - a.j) - (b.j - a.j) * (c.i - a.i)));
  }
  // The largest distance of these triangles from the relief above the same places.
  double deviationMm(std::span<const uint32_t> triangles) const;
  // Of the triangles, on a flat artwork with heights exaggerated so, and of a relief that lies within around_mm of
  // them.
  WorldBox box(std::span<const uint32_t> triangles, double exaggerate, double around_mm) const;
  double mmFor(double surface_mm, double exaggerate) const {  // an error of this surface at another exaggeration
    return flat_ ? surface_mm * std::abs(exaggerate) : surface_mm;
  }

  // What a simplifier asks again and again: a fan of triangles of one patch around one of its samples. The largest
  // distance over their insides and their edges to the hub, in fanUnitMm(); anything above `enough`, if it is more.
  using Sample = std::array<int64_t, 2>;
  double fanDeviation(uint32_t patch, const Sample& hub, std::span<const std::array<Sample, 2>> rims,
                      double enough) const;
  double stepMm() const { return std::abs(scene_.domain.relief_scale_mm); }  // of heights
  double fanUnitMm() const { return flat_ ? std::abs(scene_.domain.relief_scale_mm) : 1; }

  // Collects triangles into what is drawn. cell_samples: how wide the triangles are, about (a pixel that is many of
  // them wide is not measured).
  void append(std::span<const uint32_t> triangles, double cell_samples, StrategyMesh& mesh) const;

 private:
  template <class F>
  void withValues(uint32_t patch, F&& f) const;
  uint32_t vertexAt(uint32_t patch, int64_t column, int64_t row) const {
    return static_cast<uint32_t>(static_cast<int64_t>(patch) * per_patch_ + row * pitch_ + column);
  }
  void makeAxes(const StrategyScene& scene);
  void weldFlat();
  void weldPatches(const BaseMesh& base);

  StrategyScene scene_;
  ReliefBounds3d bounds_;
  bool flat_ = true;
  double exaggerate_ = 1;
  int64_t stride_ = 1;                           // samples between vertices
  double finest_ = 1;                            // finest samples between samples
  int64_t per_patch_ = 0, pitch_ = 0;            // vertices
  std::vector<std::array<SampleAxis, 2>> axes_;  // by patch, of samples
  std::vector<glm::vec3> positions_;
  std::vector<uint32_t> weld_;
};

}  // namespace relievo
