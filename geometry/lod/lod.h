// lod.h - which nodes of an artwork to draw, and with how many segments along each edge: the question and the answer.
// planar_lod.h answers for flat artworks, mesh_lod.h over a base mesh; quadtree_lod.h is the selection behind both.
//
// A drawn node is an instanced grid of 2^n x 2^n cells, n <= kMaxGridLevel. Levels belong to edges: the segment that
// two drawn nodes share (the finer one's whole edge) has one level, a function of that segment and of the residency on
// both sides, so both nodes agree; grid vertices on it snap to its coarser vertices (Dyken, Reimers, Seland 2009,
// section 4). Nodes form a restricted (2:1) quadtree, so a node's side is one whole edge or two half edges. Each cell
// is cut along the diagonal (i, j) - (i+1, j+1), so that finer grids refine the same triangles and snapped triangles
// keep to one side of the coarser diagonal. What draws the grids must use that diagonal. A view that is not finite gets
// the roots, flat levels, no wants. No GL. Deterministic: the same view and residency give the same list in the same
// order.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <unordered_set>
#include <vector>

#include <glm/glm.hpp>

#include "src/artwork/deviation.h"
#include "src/artwork/node_id.h"

namespace relievo {

struct HeightSlopes;  // src/artwork/base_mesh.h

inline constexpr int kMaxGridLevel = 5;     // 32 segments
inline constexpr int kErrorBlocksLog2 = 4;  // a page's error is known by 16 x 16 parts

// World: x right, y up, z towards the viewer, mm. A flat artwork's origin is its centre, on the plane of height 0; over
// a base mesh it is BaseMesh::origin_mm.
struct LodView {
  glm::dmat4 clip_from_world{1.0};
  glm::dvec3 eye_mm{0};
  double pixels_per_radian = 1.0;  // viewport height in px / (2 tan(fov / 2)); orthographic: pixels per mm
  double near_mm = 1.0;
  double error_px = 1.0;
  // No vertices closer than this on screen (half of it where the error is over 4 budgets, a quarter over 16: walls),
  // whatever the error: bounds the cost of a frame by the screen's size. What it leaves shows in max_error_px. 0: no
  // such bound.
  double min_cell_px = 0.0;
  // Geomorph: levels change by small steps as the view does, vertices slide to their places (geometry/lod/morph.h);
  // what is drawn keeps error_px, with up to a third more triangles. What still changes at once: geometry/README.md,
  // "Between levels".
  bool morph = false;
  // Of error_px. A square keeps its level until it has too large an error, or would have a coarser one with error_px /
  // (1 + hysteresis): a camera that trembles seldom changes nodes or pages, and the error stays within error_px. The
  // answer depends on the views before, as far as they had one; 0: on this view alone.
  double hysteresis = 0;
  // An error counts whichever way it points, as if it were seen from aside: for shadows, which show what the line of
  // sight hides.
  bool any_direction = false;
  double exaggerate = 1.0;  // heights are multiplied by it
  bool relief = true;       // false: flat, no relief pages asked for
  // Patches of closed bodies that the eye, outside, sees from behind alone are left out (over a base mesh); no other
  // patch changes.
  bool hide_backs = true;
  // A flat artwork's nodes, too, are divided where their quarters take fewer triangles, as those of a base mesh always
  // are. All that is drawn stays as fine as it is asked for, and max_error_px a bound; the quarters' edges are known
  // better than the whole ones, so that it may exceed 2 error_px a little where heights are large beside their
  // distance.
  bool divide_flat = false;
  // As if every relief page were resident. The list that pages lead to once all that it wants are
  // there, whatever came first: what is wanted of a list that grows with them depends on their order, since neighbours
  // that are known better want less at a shared edge.
  bool as_if_resident = false;
};

// What a relief page knows of its square (package.h has the same three numbers); never fails: unknown gives the whole
// range.
struct HeightBounds {
  float min_mm = 0, max_mm = 0, error_mm = 0;
};
class ReliefOracle {
 public:
  virtual ~ReliefOracle() = default;
  virtual HeightBounds bounds(const NodeId& relief_page) const = 0;  // thread-safe
  // error_mm of the page's parts: 2^kErrorBlocksLog2 squares of it a side, rows top first, none above that of the whole
  // but for rounding. False: not known. Thread-safe.
  virtual bool errorBlocks(const NodeId& /*relief_page*/, std::span<float> /*error_mm*/) const { return false; }
  // Which way the parts' errors lie; a share of what errorBlocks() says of the part. False: not known. Thread-safe.
  virtual bool errorShapes(const NodeId& /*relief_page*/, std::span<DeviationShape> /*shapes*/) const { return false; }
  // Over a base mesh: the same for a patch's grids of 2^cells_log2 cells a side, 4 to 6 (coarser than its root page):
  // 2^(cells_log2 - 3) squares a side, of 8 x 8 cells each. False: not known. Thread-safe.
  virtual bool coarseBlocks(uint32_t /*patch*/, int /*cells_log2*/, std::span<float> /*error_mm*/) const {
    return false;
  }
  // Of grids of 2^cells_log2 cells, 0 to 6; one part where there are no more than 8 x 8 cells.
  virtual bool coarseShapes(uint32_t /*patch*/, int /*cells_log2*/, std::span<DeviationShape> /*shapes*/) const {
    return false;
  }
  // Over a base mesh: how steep a patch's heights are. False: not known.
  virtual bool heightSlopes(uint32_t /*patch*/, HeightSlopes& /*slopes*/) const { return false; }
};

// One drawn node. Vertex (i, j), 0 <= i, j <= 2^grid_level, lies at units (x0 + (i << step_log2), y0 + (j <<
// step_log2)). What a unit is, and from where they count: planar_lod.h, mesh_lod.h.
struct PatchInstance {
  NodeId node;             // its level may exceed kMaxNodeLevel in close-ups: not for packNode()
  int32_t x0 = 0, y0 = 0;  // units
  uint8_t step_log2 = 0;
  uint8_t grid_level = 1;  // n
  // Per side {a, b}: b == kWholeEdge: one edge of 2^a segments over the side; else two half edges of 2^a and 2^b
  // segments (first half: towards smaller coordinates).
  static constexpr uint8_t kWholeEdge = 15;
  std::array<std::array<uint8_t, 2>, 4> edges{};
  // Geomorph (geometry/lod/morph.h): vertices of the finest level, of the grid's inside and of each edge, are (weight +
  // 1) / 256 of the way to their own place.
  static constexpr uint8_t kInPlace = 255;
  uint8_t morph = kInPlace;
  std::array<std::array<uint8_t, 2>, 4> edge_morph{{{255, 255}, {255, 255}, {255, 255}, {255, 255}}};  // as `edges`
  NodeId relief_page;  // the resident page to displace from; it covers the node. Unused in a flat view. Of level
                       // kTailLevel: the patch's tail, whose samples every vertex is among (src/artwork/base_mesh.h)
  friend bool operator==(const PatchInstance&, const PatchInstance&) = default;
};

struct ReliefRequest {
  NodeId page;
  float priority = 0;  // distance from the view's centre, 0..1
};

struct LodResult {
  std::vector<PatchInstance> instances;  // sorted by grid_level, then by node
  std::vector<ReliefRequest> requests;   // relief pages, resident or not: coarse before fine
  uint32_t limited_by_residency = 0;     // edges coarser than wanted because pages are missing
  double error_px = 0;                   // as asked for, or twice that, four times... where the node budget ran out
  // The largest predicted error of what is drawn: an upper bound of how far the picture of a point of the finest relief
  // lies from that of the drawn surface above the same place. Up to 2 error_px where levels meet; more only where pages
  // are missing.
  double max_error_px = 0;
  // Whatever is seen from behind lies behind something seen from the front: the eye is outside a closed body that the
  // near plane leaves whole. Triangles seen from behind need not be drawn, patches of only such ones are missing if
  // LodView::hide_backs says so.
  bool backs_are_hidden = false;
};

using ReliefSet = std::unordered_set<NodeId>;  // resident relief pages

}  // namespace relievo
