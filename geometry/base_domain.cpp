#include "geometry/base_domain.h"

#include <meshoptimizer.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <queue>
#include <string>

#include "geometry/base_quads.h"
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

std::vector<BorderLoop> borderLoops(const Surface& s) {
  std::vector<BorderLoop> loops;
  for (const auto& loop : s.loops) {
    BorderLoop l;
    for (size_t i = 0; i < loop.size(); ++i) {
      l.points.push_back(s.points[loop[i]]);
      l.at.push_back(l.length);
      l.length += glm::length(glm::dvec3(s.points[loop[(i + 1) % loop.size()]]) - glm::dvec3(s.points[loop[i]]));
    }
    loops.push_back(std::move(l));
  }
  return loops;
}

// Points of a border where it turns by more than 50 degrees within a fiftieth of its length.
std::vector<uint32_t> sharpPoints(const BorderLoop& l) {
  const double window = l.length / 50;
  auto turn = [&](size_t i) {
    const glm::dvec3 in = l.points[i] - l.point(l.at[i] - window), out = l.point(l.at[i] + window) - l.points[i];
    const double length = glm::length(in) * glm::length(out);
    return length > 0 ? std::acos(std::clamp(glm::dot(in, out) / length, -1.0, 1.0)) : 0.0;
  };
  std::vector<uint32_t> sharp;
  std::vector<double> turns(l.points.size());
  for (size_t i = 0; i < turns.size(); ++i) turns[i] = turn(i);
  for (size_t i = 0; i < turns.size(); ++i) {
    if (turns[i] < 50 * std::numbers::pi / 180) continue;
    bool largest = true;
    for (size_t step = 1; step < turns.size() && largest; ++step) {
      const size_t j = (i + step) % turns.size();
      if (l.ahead(l.at[i], l.at[j]) > window) break;
      largest = turns[j] < turns[i];
    }
    for (size_t step = 1; step < turns.size() && largest; ++step) {
      const size_t j = (i + turns.size() - step) % turns.size();
      if (l.ahead(l.at[j], l.at[i]) > window) break;
      largest = turns[j] <= turns[i];
    }
    if (largest) sharp.push_back(static_cast<uint32_t>(i));
  }
  return sharp;
}

struct Bulk {
  Surface surface;               // of fewer triangles; the scan's topology
  std::vector<uint32_t> vertex;  // of the scan's surface that each vertex is
};

// meshoptimizer takes a scan down to some ten thousand triangles quickly, but promises no topology: it is compared, and where it
// changed, more triangles are left, all of them in the end.
Result<Bulk> reduce(const Surface& scan, size_t wanted) {
  for (size_t triangles = wanted; triangles < scan.triangles.size(); triangles *= 8) {
    std::vector<unsigned> indices(3 * scan.triangles.size());
    const auto* all = reinterpret_cast<const unsigned*>(scan.triangles.data());
    indices.resize(meshopt_simplify(indices.data(), all, indices.size(), &scan.points[0].x, scan.points.size(), sizeof(glm::vec3), 3 * triangles, 1.0f, 0, nullptr));
    std::vector<uint32_t> renamed(scan.points.size(), kNoIndex);
    Bulk bulk;
    std::vector<glm::vec3> points;
    std::vector<Triangle> kept(indices.size() / 3);
    for (size_t i = 0; i < indices.size(); ++i) {
      uint32_t& name = renamed[indices[i]];
      if (name == kNoIndex) {
        name = static_cast<uint32_t>(points.size());
        points.push_back(scan.points[indices[i]]);
        bulk.vertex.push_back(indices[i]);
      }
      kept[i / 3][i % 3] = name;
    }
    auto surface = makeSurface(points, kept);
    if (!surface || surface->points.size() != points.size() || surface->pieces.size() != scan.pieces.size()) continue;
    bool same = true;
    for (const SurfacePiece& p : surface->pieces) {
      const uint32_t v = bulk.vertex[surface->triangles[p.first_triangle][0]];
      same = same && p.sameTopology(scan.pieces[scan.piece[v]]);
    }
    if (!same) continue;
    bulk.surface = std::move(*surface);
    return bulk;
  }
  Bulk bulk{scan, {}};
  bulk.vertex.resize(scan.points.size());
  for (uint32_t v = 0; v < bulk.vertex.size(); ++v) bulk.vertex[v] = v;
  return bulk;
}

// The surface's normals, weighted by area, over the part of it that lies nearest to each corner along the surface.
std::vector<glm::dvec3> cornerNormals(const QuadMesh& quads, const Surface& s, const ScanLookup& scan) {
  struct Front {
    double distance;
    uint32_t vertex, corner;
    bool operator<(const Front& o) const {
      if (distance != o.distance) return distance > o.distance;
      return vertex != o.vertex ? vertex > o.vertex : corner > o.corner;
    }
  };
  std::priority_queue<Front> queue;
  std::vector<uint32_t> owner(s.points.size(), kNoIndex);
  for (uint32_t c = 0; c < quads.points.size(); ++c) {
    SurfacePoint at = scan.project(quads.points[c], quads.normals[c], 0.1);
    if (!at) at = scan.scene.closestPoint(quads.points[c]);
    if (!at) continue;
    for (uint32_t v : s.triangles[at.triangle]) queue.push({glm::length(glm::dvec3(s.points[v]) - scan.point(at)), v, c});
  }
  std::vector<uint32_t> begin(s.points.size() + 1, 0), fan(3 * s.triangles.size());
  for (const Triangle& t : s.triangles) {
    for (uint32_t v : t) ++begin[v + 1];
  }
  for (size_t v = 1; v < begin.size(); ++v) begin[v] += begin[v - 1];
  std::vector<uint32_t> fill(begin.begin(), begin.end() - 1);
  for (uint32_t t = 0; t < s.triangles.size(); ++t) {
    for (uint32_t v : s.triangles[t]) fan[fill[v]++] = t;
  }
  while (!queue.empty()) {
    const Front f = queue.top();
    queue.pop();
    if (owner[f.vertex] != kNoIndex) continue;
    owner[f.vertex] = f.corner;
    for (uint32_t i = begin[f.vertex]; i < begin[f.vertex + 1]; ++i) {
      for (uint32_t w : s.triangles[fan[i]]) {
        if (owner[w] == kNoIndex) queue.push({f.distance + glm::length(s.points[w] - s.points[f.vertex]), w, f.corner});
      }
    }
  }
  std::vector<glm::dvec3> sums(quads.points.size(), glm::dvec3(0));
  for (const Triangle& t : s.triangles) {
    const glm::dvec3 cross = glm::cross(glm::dvec3(s.points[t[1]]) - glm::dvec3(s.points[t[0]]), glm::dvec3(s.points[t[2]]) - glm::dvec3(s.points[t[0]]));
    for (uint32_t v : t) {
      if (owner[v] != kNoIndex) sums[owner[v]] += cross / 3.0;
    }
  }
  for (size_t c = 0; c < sums.size(); ++c) {
    const double length = glm::length(sums[c]);
    sums[c] = length > 0 ? sums[c] / length : quads.normals[c];
  }
  return sums;
}

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
  auto bulk = reduce(*scan, std::max<size_t>(24000, 6 * size_t{triangles}));
  if (!bulk) return bulk.error();
  if (stopped()) return interruptedError();
  report(0.5);

  const std::vector<BorderLoop> loops = borderLoops(*scan);
  std::vector<BorderPlace> place_of_scan(scan->points.size());
  for (uint32_t l = 0; l < loops.size(); ++l) {
    for (size_t i = 0; i < scan->loops[l].size(); ++i) place_of_scan[scan->loops[l][i]] = {l, loops[l].at[i], false};
    for (uint32_t i : sharpPoints(loops[l])) place_of_scan[scan->loops[l][i]].fixed = true;
  }
  const Surface& surface = bulk->surface;
  std::vector<uint8_t> fixed(surface.points.size(), 0);
  for (uint32_t v = 0; v < fixed.size(); ++v) fixed[v] = place_of_scan[bulk->vertex[v]].fixed;
  EditMesh coarse(surface);
  simplify(coarse, {.triangles = triangles, .fixed = fixed, .interrupted = options.interrupted});
  if (stopped()) return interruptedError();
  flipEdges(coarse);
  report(0.7);
  TriMesh reduced;
  reduced.positions_mm = surface.points;
  reduced.triangles = surface.triangles;
  auto scene = RayScene::create(reduced, options.interrupted);
  if (!scene) return scene.error();
  const ScanLookup lookup{reduced, **scene};
  QuadMesh quads = makeQuads(coarse, loops, [&](uint32_t v) { return place_of_scan[bulk->vertex[v]]; }, true);
  relaxQuads(quads, loops, lookup, 30);
  const std::vector<glm::dvec3> normals = cornerNormals(quads, surface, lookup);

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
