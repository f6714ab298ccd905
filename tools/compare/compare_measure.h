// compare_measure.h - the error of a strategy's picture: each pixel says which place of the artwork it shows
// (src/render/strategy_pass.h), and that place on the finest relief is projected in double precision. No GL.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/strategies/lod_strategy.h"
#include "src/render/camera.h"

namespace relievo {

using PlacePixels = std::vector<std::array<uint32_t, 4>>;  // rows bottom first

// The full-resolution surface, by instance and place in its node: all that measuring knows of an artwork.
class CompareSurface {
 public:
  virtual ~CompareSurface() = default;
  virtual glm::dvec3 finestPointMm(const PatchInstance& instance, double u, double v) const = 0;
  virtual double mmPerUnit(const PatchInstance& instance) const = 0;  // about
};

class PlanarSurface final : public CompareSurface {
 public:
  PlanarSurface(const ReliefField& field, double exaggerate) : field_(field), exaggerate_(exaggerate) {}
  glm::dvec3 finestPointMm(const PatchInstance& instance, double u, double v) const override;
  double mmPerUnit(const PatchInstance&) const override { return field_.mmPerUnit(); }

 private:
  const ReliefField& field_;
  double exaggerate_;
};

// Over a base mesh.
class BodySurface final : public CompareSurface {
 public:
  BodySurface(const BodyField& field, double exaggerate) : field_(field), exaggerate_(exaggerate) {}
  glm::dvec3 finestPointMm(const PatchInstance& instance, double u, double v) const override;
  double mmPerUnit(const PatchInstance& instance) const override;

 private:
  const BodyField& field_;
  double exaggerate_;
};

struct Frame {
  ViewTransform view;
  int width_px = 0, height_px = 0;
  glm::dvec2 pixelOf(const glm::dvec3& point_mm, bool* in_front) const;
};

// A pixel more cells wide than that, seen edge-on, is not measured: rasterisers snap corners to 1/256 px or so, which
// moves its place by a quarter of a cell, and beyond that what is interpolated lies outside its triangle.
inline constexpr double kMostCellsAPixel = 64;

// By pixel; not a number where nothing is drawn, where the true point has no picture, or edge-on. Returns the number of
// pixels edge-on.
using ErrorVectors = std::vector<glm::vec2>;
uint64_t errorVectors(const CompareSurface& surface, const std::vector<PatchInstance>& instances, const Frame& frame,
                      const PlacePixels& pixels, ErrorVectors& errors_px);

struct ErrorFigures {
  double max_px = 0, p99_px = 0, rms_px = 0;
  uint64_t pixels = 0;
};
ErrorFigures figuresOf(const ErrorVectors& errors_px);
// The largest change of the error vector of a pixel that both show. before and after are of one camera.
double largestChangePx(const ErrorVectors& before, const ErrorVectors& after);

// 1 where something is drawn.
std::vector<uint8_t> coverage(const PlacePixels& pixels);
struct CoverageFigures {
  uint64_t silhouette_pixels = 0;  // covered by one of both
  uint64_t crack_pixels =
      0;  // background at least margin_px inside the reference's silhouette (the picture's border is no silhouette)
};
CoverageFigures compareCoverage(const std::vector<uint8_t>& drawn, const std::vector<uint8_t>& reference, int width_px,
                                int height_px, int margin_px);

// Vertices that two instances share, bit for bit. captured: clip positions, 4 floats a vertex, instance by instance
// (StrategyPass::capture). Along every stretch of a side that two drawn nodes share, both must have the same sequence
// of distinct vertices.
struct SeamFigures {
  uint64_t compared = 0, mismatched = 0;
};
SeamFigures compareSeams(const FlatDomain& domain, const std::vector<PatchInstance>& instances,
                         std::span<const float> captured);
// Over a base mesh: also along sides that two patches share, whichever way they run. unit_log2: of a patch's side in
// units.
SeamFigures compareSeams(const BaseMesh& mesh, int unit_log2, const std::vector<PatchInstance>& instances,
                         std::span<const float> captured);

}  // namespace relievo
