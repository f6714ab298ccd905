// lod_strategy.h - one interface for ways to choose geometry for a view, so that `relievo compare` can measure them
// side by side. A strategy is one file, strategy_NAME.cpp, which strategy_list.h declares and strategy_registry.cpp
// calls; nothing else knows its name. It takes a view (LodView in lod.h) and answers with instanced grids
// (PatchInstance there), explicit triangles, or both, and the error that it predicts. All strategies draw from the same
// relief pages, every one of them resident: what an empty cache would have to read is counted beside, as the pages of
// the nodes or the parts of a StrategyMesh. A strategy names nodes and places in them, over a base mesh as on a flat
// artwork; heights and projection are computed elsewhere. SceneLod and strategy_bounds.h know which of the two a scene
// is. Pure: no GL. A strategy is used by one thread; the same scene and views, in the same order, give the same
// results.
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "geometry/lod/mesh_lod.h"
#include "geometry/lod/planar_lod.h"
#include "geometry/strategies/strategy_body.h"
#include "geometry/strategies/strategy_field.h"

namespace relievo {

// What strategies choose from.
struct StrategyScene {
  PatchDomain domain;
  std::shared_ptr<const ReliefOracle> oracle;
  std::shared_ptr<const ReliefSet> resident;  // every relief page
  // The finest relief, for strategies that emit triangles of their own: the one or the other.
  std::shared_ptr<const ReliefField> field;  // of a flat artwork
  std::shared_ptr<const BodyField> body;     // over a base mesh
  std::vector<CoarseErrors> coarse;          // by patch, over a base mesh; or empty (mesh_lod.h)
  // What strategies compute from a scene once and share with one another, by name: the same strategy is made once a
  // budget.
  std::shared_ptr<std::map<std::string, std::shared_ptr<const void>>> prepared =
      std::make_shared<std::map<std::string, std::shared_ptr<const void>>>();
  template <class T, class Make>
  std::shared_ptr<const T> preparedOnce(const std::string& name, double exaggerate, Make make) const {
    auto& known = (*prepared)[name + std::to_string(std::bit_cast<uint64_t>(exaggerate))];
    if (!known) known = std::make_shared<const T>(make());
    return std::static_pointer_cast<const T>(known);
  }
  // At a vertex of one of the instance's grids, steps of a sample's range.
  double heightSteps(const PatchInstance& p, int64_t x, int64_t y) const {
    return body ? body->at(p.node.patch, x, y) : field->heightSteps(static_cast<double>(x), static_cast<double>(y));
  }
};

// planar_lod.h or mesh_lod.h, as the scene has it. oracle: what to believe, if not the scene's.
class SceneLod {
 public:
  explicit SceneLod(const StrategyScene& scene, std::shared_ptr<const ReliefOracle> oracle = nullptr)
      : scene_(scene), oracle_(oracle ? oracle : scene.oracle) {
    const PatchDomain& d = scene.domain;
    // Another oracle knows nothing of the errors that the scene's was given with.
    if (!d.isFlat())
      mesh_ = std::make_unique<MeshLod>(scene.body->base, d.relief_depth, d.relief_offset_mm, d.relief_scale_mm,
                                        oracle_, oracle ? std::vector<CoarseErrors>{} : scene.coarse);
  }
  LodResult select(const LodView& view) {
    return mesh_ ? mesh_->select(view, *scene_.resident)
                 : selectPlanarLod(scene_.domain.flat(), *oracle_, view, *scene_.resident);
  }

 private:
  StrategyScene scene_;
  std::shared_ptr<const ReliefOracle> oracle_;
  std::unique_ptr<MeshLod> mesh_;
};

// What a grid's vertices do (shaders/compare_*.vert, patch.vert).
enum class GridRule : uint8_t {
  kSnapped,      // those on edges snap to the edge's level (patch.vert as the engine draws it)
  kUnsnapped,    // they stay; a negative control
  kMorphed,      // they slide to the next coarser grid with the distance to the eye (StrategyResult::morph)
  kTessellated,  // the instance is one patch of the hardware tessellator: edge levels are its outer factors, grid_level
                 // the inner one
  kGeomorph,     // as kSnapped, on the way that the instances say (PatchInstance::morph)
  kTrianglesOnly  // no grids: the instances are the nodes that the explicit triangles' vertices count in
};

// Vertices of explicit triangles; the error is taken at the place within the instance's node.
struct StrategyVertex {
  int32_t x = 0, y = 0;    // units (over a base mesh: in the instance's patch)
  float height_steps = 0;  // of the 16-bit range (mm = offset + scale x steps), not exaggerated
  uint32_t instance = 0;   // index into StrategyResult::instances
};

struct IndexRange {
  uint32_t first = 0, count = 0;  // of StrategyMesh::indices
  friend bool operator==(const IndexRange&, const IndexRange&) = default;
};
// Triangles that stay the same from view to view, so that the GPU keeps them: what is drawn for a view are some of
// them. The three vertices of a triangle name the same instance.
struct StrategyMesh {
  std::vector<PatchInstance> instances;
  std::vector<StrategyVertex> vertices;
  std::vector<uint32_t> indices;  // three a triangle
  static constexpr size_t kGpuVertexBytes = 28;
  uint64_t gpuBytes() const { return kGpuVertexBytes * vertices.size() + sizeof(uint32_t) * indices.size(); }

  // What is read at once, as encoded_parts.h encodes it.
  struct Part {
    uint32_t encoded_bytes = 0;
    float decode_ms = 0;  // by one thread
  };
  struct PartRange {
    IndexRange range;
    uint32_t part = 0;
  };
  std::vector<Part> parts;
  std::vector<PartRange> part_ranges;  // ascending
};

// Vertices of absolute level node.level + grid_level morph between these distances from the eye, mm.
struct MorphRange {
  float start_mm = 0, end_mm = 0;
};
inline constexpr int kMorphLevels = 32;

struct StrategyResult {
  std::vector<PatchInstance> instances;  // sorted by grid_level
  GridRule rule = GridRule::kSnapped;
  std::vector<StrategyVertex> triangles;  // three a triangle, drawn besides the grids
  // Or kept triangles: those of the ranges are drawn, whose rule is kTrianglesOnly; `instances` are then the mesh's.
  std::shared_ptr<const StrategyMesh> mesh;
  std::vector<IndexRange> ranges;
  std::array<MorphRange, kMorphLevels> morph{};
  glm::dvec3 morph_eye_mm{0};
  double error_px = 0;  // the budget that the choice kept to (a node budget may have doubled the one asked for)
  // An upper bound of how far the picture of a point of the finest relief lies from that of the drawn surface above the
  // same place. Negative: the strategy promises nothing.
  double predicted_px = -1;

  uint64_t triangleCount() const {  // explicit ones
    uint64_t count = triangles.size() / 3;
    for (const IndexRange& r : ranges) count += r.count / 3;
    return count;
  }
};

// What the LOD answered, with the bound that it certifies.
inline StrategyResult certifiedResult(LodResult lod) {
  StrategyResult result;
  result.instances = std::move(lod.instances);
  result.error_px = lod.error_px;
  result.predicted_px = lod.max_error_px;
  return result;
}

class LodStrategy {
 public:
  virtual ~LodStrategy() = default;
  // view.error_px: the budget. What a strategy makes of view.min_cell_px it says in its purpose.
  virtual StrategyResult select(const LodView& view) = 0;
};

struct StrategyEntry {
  std::string name, title, purpose;  // "edge-lod", "Edge LOD", one sentence for --help and the report
  bool control = false;              // a negative control: expected to fail
  bool keeps_budget = false;  // promises predicted_px <= 2 x the budget (2: where levels meet), wherever it is not
                              // `error_px` itself that grew
  bool needs_tessellation = false;  // GL 4
  bool flat_only = false;           // not over a base mesh
  std::function<std::unique_ptr<LodStrategy>(const StrategyScene&)> make;
};
// In the order of reports.
const std::vector<StrategyEntry>& lodStrategies();
const StrategyEntry* findStrategy(const std::string& name);  // null: none of that name

}  // namespace relievo
