#include "geometry/base_domain.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

#include "geometry/base_place.h"
#include "geometry/base_quads.h"
#include "geometry/base_reduce.h"
#include "geometry/base_simplify.h"
#include "geometry/base_topology.h"
#include "geometry/ray_scene.h"

namespace relievo {

namespace {

// The scan in units of its bounding box's diagonal, about its centre.
struct Frame {
  glm::dvec3 centre{0};
  double diagonal = 1;
};

Error interruptedError() { return {ErrorKind::kInterrupted, {}, "interrupted", {}, {}}; }

}  // namespace

Result<BaseMesh> makeBaseMesh(const TriMesh& mesh, const BaseDomainOptions& options) {
  auto report = [&](double x) {
    if (options.progress) options.progress(x);
  };
  auto stopped = [&] { return options.interrupted && options.interrupted->load(std::memory_order_relaxed); };
  if (options.patches > kMaxPatches) return Error{ErrorKind::kUsage, {}, "more than 2^20 patches are asked for", "ask for fewer", {}};
  report(0);
  auto scan = makeSurface(mesh.positions_mm, mesh.triangles);
  if (!scan) return scan.error();
  Frame frame;
  {
    glm::dvec3 lo(1e300), hi(-1e300);
    for (size_t v = 0; v < scan->points.size(); ++v) {
      if (scan->piece[v] == kNoIndex) continue;
      lo = glm::min(lo, glm::dvec3(scan->points[v]));
      hi = glm::max(hi, glm::dvec3(scan->points[v]));
    }
    frame.centre = (lo + hi) / 2.0;
    frame.diagonal = glm::length(hi - lo);
  }
  for (const SurfacePiece& p : scan->pieces) {
    if (p.area > 1e-14 * frame.diagonal * frame.diagonal) continue;
    const glm::vec3 at = scan->points[scan->triangles[p.first_triangle][0]];
    return Error{ErrorKind::kInvalidData, {}, "a piece of " + std::to_string(p.triangles) + " triangles has no area, at (" + std::to_string(at.x) + ", " +
                 std::to_string(at.y) + ", " + std::to_string(at.z) + ") mm", "remove it from the scan", {}};
  }
  for (glm::vec3& p : scan->points) p = glm::vec3((glm::dvec3(p) - frame.centre) / frame.diagonal);
  if (stopped()) return interruptedError();
  report(0.1);

  const uint32_t patches = options.patches ? options.patches : 300;
  const uint32_t triangles = std::max(4u, patches / 2);
  const std::vector<glm::vec3> scan_points = scan->points;
  const std::vector<std::vector<uint32_t>> scan_loops = scan->loops;
  const Reduced reduced = reduceSurface(std::move(*scan), std::max<size_t>(24000, 6 * size_t{triangles}), options.interrupted);
  if (stopped()) return interruptedError();
  report(0.5);
  const Surface& surface = reduced.surface;
  const Rails rails = findRails(scan_points, scan_loops, reduced, true);
  EditMesh coarse(surface, rails);
  simplify(coarse, {.triangles = triangles, .interrupted = options.interrupted});
  if (stopped()) return interruptedError();
  flipEdges(coarse);
  report(0.7);
  TriMesh triangle_mesh;
  triangle_mesh.positions_mm = surface.points;
  triangle_mesh.triangles = surface.triangles;
  auto scene = RayScene::create(triangle_mesh, options.interrupted);
  if (!scene) return scene.error();
  const ScanLookup lookup{triangle_mesh, **scene};
  QuadMesh quads = makeQuads(coarse, rails.rails, true);
  updateNormals(quads);
  const Fans fans(surface);
  std::vector<uint32_t> regions;
  for (int round = 0; round < 4; ++round) {
    if (round) relaxQuads(quads, rails.rails, lookup, 8);
    regions = cornerRegions(quads, surface, fans, lookup);
    placeCorners(quads, surface, regions, lookup);
  }
  const std::vector<glm::dvec3> normals = cornerNormals(quads, surface, regions);

  BaseMesh base;
  base.origin_mm = mesh.origin_mm;
  for (size_t c = 0; c < quads.points.size(); ++c) {
    base.corners.push_back({glm::vec3(quads.points[c] * frame.diagonal + frame.centre), glm::vec3(glm::normalize(normals[c]))});
  }
  // Against the clock from (0, 0): down, right, up (base_mesh.h, orientation).
  for (const auto& q : quads.quads) base.patches.push_back({q[0], q[3], q[1], q[2]});
  if (std::string problem = baseMeshProblem(base); !problem.empty()) return Error{ErrorKind::kInvalidData, {}, "no base mesh for this scan: " + problem, {}, {}};
  report(1);
  return base;
}

}  // namespace relievo
