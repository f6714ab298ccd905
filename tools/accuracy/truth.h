// truth.h - what a picture of an artwork must show: every finest triangle, every texel of each pixel's footprint, in
// double precision. Needs a current GL context.
//
// The graphics driver draws all of the relief without levels of detail and says which place each pixel shows
// (src/render/strategy_pass.h): that decides what is visible. The place itself is then solved for in double precision:
// the point of the finest surface whose picture is the pixel's centre. The footprint is that of the triangle there, as
// the oracle of "virtual equals dense" has it (tests/render/dense_reference.h), with which the colours agree; they
// follow from truth_texture.h and evaluatePixel() of src/artwork/basis.h.
//
// Left out and counted: pixels on the outline and on inner occlusion edges (there a hair's breadth decides between two
// far parts of the artwork), and those whose place was not found to 1/64 px (walls seen edge-on).
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "tools/accuracy/truth_texture.h"
#include "tools/compare/compare_measure.h"
#include "tools/compare/compare_scene.h"

namespace relievo {

struct TruthOptions {
  std::shared_ptr<const Package> package;
  Scene scene;  // light, relief, exaggeration
  int width_px = 0, height_px = 0;
  int one_of = 1;  // pixels whose colour is computed: one, drawn by lot, of each square of this side, px
  uint32_t seed = 1;
  int workers = 0;  // 0: one a core
  uint64_t memory_bytes = uint64_t{1} << 30;
  uint64_t reference_triangles = 40'000'000;  // a view; above it visibility is that of a coarser uniform grid
  const std::atomic<bool>* interrupted = nullptr;
};

// Of one view. Pixels by index, rows bottom first.
struct ViewTruth {
  ViewTransform view;
  std::vector<float> mm_per_px;      // of every pixel, across its line of sight; 0: background
  std::vector<uint32_t> pixels;      // those whose colour is known
  std::vector<glm::vec3> colours;    // theirs, 0..255, not rounded
  uint64_t covered = 0;              // pixels that show the artwork
  uint64_t edges = 0, unsolved = 0;  // of these, left out
  bool whole = true;                 // visibility from every finest triangle
};

class AccuracyTruth {
 public:
  static Result<std::unique_ptr<AccuracyTruth>> create(const TruthOptions& options, gl::Api api);
  Result<ViewTruth> of(const OrbitCamera& camera);
  // For the errors of other choices of geometry over the same relief.
  StrategyPass& pass() { return *pass_; }
  const CompareSurface& surface() const { return *surface_; }

 private:
  struct Place {  // of a pixel
    bool there = false, solved = false;
    bool from_behind = false;  // of a base mesh
    TexelFootprint footprint;
    glm::dvec3 point_mm{0}, dx_mm{0}, dy_mm{0};
  };
  struct Slope;
  explicit AccuracyTruth(const TruthOptions& options) : o_(options) {}
  Slope slopeAt(const Frame& frame, const PatchInstance& instance, double u, double v, double reach) const;
  Place solve(const Frame& frame, const PatchInstance& instance, const std::array<uint32_t, 4>& drawn, int x,
              int y) const;
  TexelFootprint footprintOf(const PatchInstance& instance, double u, double v, const glm::dmat2& uv_by_px) const;
  bool atEdge(const std::vector<Place>& places, int x, int y) const;
  void chooseAndShade(const std::vector<Place>& places, const ViewTransform& view, ViewTruth& out) const;

  TruthOptions o_;
  CompareScene scene_;
  std::unique_ptr<StrategyPass> pass_;
  std::unique_ptr<ReliefBounds3d> bounds_;
  std::unique_ptr<CompareSurface> surface_;
  std::unique_ptr<TruthTexture> texture_;
};

}  // namespace relievo
