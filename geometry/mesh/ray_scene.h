// ray_scene.h - where lines meet a triangle mesh, and the mesh's point closest to a place. The one file that knows
// Embree. Embree (robust mode: no line slips between two triangles) finds the triangle in single precision; where on it
// is then computed in double precision, so that results carry the mesh's own rounding only. Places are the mesh's: from
// mesh.origin_mm. All queries are const and thread-safe.
//
// Memory: Embree's hierarchies are many, one for each run of consecutive triangles (a region), built when a line or a
// place first needs it and given back, longest unused first, when the budget is spent. Where triangles near one another
// in space are near in the list, too (mesh_order.h), and so are lines that are asked for together, few regions are
// needed at a time; a query keeps its last 16 of them, too. Results do not depend on the budget, and on the runs'
// length and the machine's instructions only as Embree's rounding does: of surfaces that are equally near the first
// triangle is taken, whatever order the hierarchies are in.
#pragma once

#include <atomic>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>

#include <glm/glm.hpp>

#include "geometry/mesh/tri_mesh.h"
#include "src/base/result.h"

namespace relievo {

struct SurfacePoint {
  static constexpr uint32_t kNone = ~uint32_t{0};
  uint32_t triangle = kNone;  // kNone: nothing within reach
  double b1 = 0, b2 = 0;      // weights of its corners 1 and 2; corner 0 has the rest
  double along = 0;           // a line's: the point is at + along * direction. A closest point's: its distance
  explicit operator bool() const { return triangle != kNone; }
};

// The points at + t direction with |t| <= reach.
struct Line {
  glm::dvec3 at{0};
  glm::dvec3 direction{0};  // of any length but 0
  double reach = 0;
  double likely = 0;  // most hits have |t| below this: looked for there first. 0: nothing is known
};
enum class Facing { kAny, kAlong };  // kAlong: only surfaces whose outside faces along the direction

struct RaySceneOptions {
  const std::atomic<bool>* interrupted =
      nullptr;  // builds that it stops leave their region without a surface: look at it after queries, too
  uint32_t region_triangles = 0;         // 0: what suits the mesh's size
  uint64_t budget_bytes = ~uint64_t{0};  // of hierarchies at a time; one for each thread is kept, be it ever so small
  bool at_once = true;           // all are built now, where the budget allows it; else each when it is first asked for
  const char* device = nullptr;  // Embree's configuration; tests ask for an older machine's instructions: "isa=sse2"
};

class RayScene {
 public:
  // The mesh's arrays are used in place: they must outlive the scene unchanged. Interrupted: ErrorKind::kInterrupted.
  static Result<std::unique_ptr<RayScene>> create(const TriMesh& mesh, const RaySceneOptions& options);
  static Result<std::unique_ptr<RayScene>> create(const TriMesh& mesh, const std::atomic<bool>* interrupted = nullptr) {
    return create(mesh, RaySceneOptions{.interrupted = interrupted});
  }
  ~RayScene();

  // Of each line the hit with the smallest |t|. Fastest for lines that lie beside one another.
  void nearestOnLines(std::span<const Line> lines, Facing facing, std::span<SurfacePoint> hits) const;
  SurfacePoint nearestOnLine(const Line& line, Facing facing) const;
  // The closest point that is not further away than `within`; of several triangles that share it, the first. Without a
  // limit there is always one: where a part could not be built (status()), a corner stands in.
  SurfacePoint closestPoint(const glm::dvec3& place, double within = std::numeric_limits<double>::infinity()) const;

  // The same, sooner, if `guess` (of an earlier query) is not far from it.
  SurfacePoint closestPoint(const glm::dvec3& place, const SurfacePoint& guess) const;

  Result<void> status()
      const;  // an error: a hierarchy could not be built (out of memory), and queries since then missed surfaces
  uint64_t bytes() const;  // that Embree holds now, beside the mesh
  size_t regions() const;
  uint64_t builds() const;  // of hierarchies so far

 private:
  struct Impl;
  explicit RayScene(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace relievo
