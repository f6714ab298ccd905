#include "geometry/bake/bake_context.h"

#include <algorithm>
#include <cmath>

#include "geometry/mesh/triangle_point.h"
#include "src/base/parallel_for.h"

namespace relievo {

// Where the corners' normals oppose one another, the interpolated normal gets short, and a height in units of it long:
// the search ends at twice the reach. Since the base lies near the scan, most hits are within a fifth of the reach.
Line lineThrough(const BasePoint& f, double reach) {
  const double along = reach / std::max(glm::length(f.normal), 0.5);
  return {f.position, f.normal, along, 0.2 * along};
}

BakeContext::BakeContext(const TriMesh& scan, const BaseMesh& over_scan)
    : mesh(&scan), base(over_scan), layout(base), shift(base.origin_mm - scan.origin_mm) {
  // Lines are searched about as far as a patch is wide, because what lies further away belongs to other parts of the
  // artwork.
  corner_used.assign(layout.corners, 0);
  corner_patch.assign(layout.corners, 0);
  corner_reach.assign(layout.corners, 0);
  side_reach.assign(layout.sides.size(), 0);
  patch_reach.assign(layout.patches, 0);
  for (uint32_t p = 0; p < layout.patches; ++p) {
    const auto& c = base.patches[p];
    auto length = [&](int a, int b) {
      return glm::length(cornerPoint(c[static_cast<size_t>(a)]).position -
                         cornerPoint(c[static_cast<size_t>(b)]).position);
    };
    const double reach = std::max(length(0, 3), length(1, 2));
    patch_reach[p] = reach;
    for (uint32_t s : layout.patch_sides[p]) side_reach[s] = std::max(side_reach[s], reach);
    for (uint32_t k : c) {
      corner_reach[k] = std::max(corner_reach[k], reach);
      if (!corner_used[k]) corner_patch[k] = p;
      corner_used[k] = 1;
    }
  }
}

std::array<glm::dvec3, 3> BakeContext::cornersOfHalf(uint32_t patch, size_t half) const {
  const auto& c = base.patches[patch];
  return {cornerPoint(c[0]).position, cornerPoint(c[half ? 2 : 1]).position, cornerPoint(c[3]).position};
}

Line BakeContext::lineOnHalf(uint32_t patch, size_t half, const std::array<double, 3>& weights) const {
  const std::array<glm::dvec3, 3> corners = cornersOfHalf(patch, half);
  const glm::dvec3 across = glm::cross(corners[2] - corners[0], corners[1] - corners[0]),
                   at = (weights[0] * corners[0] + weights[1] * corners[1] + weights[2] * corners[2]) /
                        (weights[0] + weights[1] + weights[2]);
  const double area = glm::length(across);
  // Where sheets touch, the one that faces as the patch does.
  return {at, area > 0 ? (half ? -1.0 : 1.0) / area * across : glm::dvec3(0), touch_mm, touch_mm};
}

bool BakeContext::holds(const SurfacePoint& found, uint32_t patch, size_t half) const {
  if (!found) return false;
  const TriangleCorners t = cornersOf(*mesh, found.triangle);
  const auto corners = cornersOfHalf(patch, half);
  return std::all_of(corners.begin(), corners.end(),
                     [&](const glm::dvec3& corner) { return closestOnTriangle(t, corner).distance <= touch_mm; });
}

// What lies on a place of the half lies within a rounding of its triangle; where others overlap with that, they seldom
// do everywhere.
uint32_t BakeContext::ownTriangleBesideMiddle(uint32_t patch, size_t half) const {
  constexpr std::array<std::array<double, 3>, 6> kPlaces{
      {{4, 1, 1}, {1, 4, 1}, {1, 1, 4}, {20, 1, 1}, {1, 20, 1}, {1, 1, 20}}};
  for (const auto& weights : kPlaces) {
    const SurfacePoint found = scene->nearestOnLine(lineOnHalf(patch, half, weights), Facing::kAlong);
    if (holds(found, patch, half)) return found.triangle;
  }
  return SurfacePoint::kNone;
}

bool BakeContext::findOwnTriangles() {
  constexpr size_t kPatchesAJob = 16;
  constexpr std::array<double, 3> kMiddle{1, 1, 1};
  std::vector<std::array<uint32_t, 2>> own(layout.patches);
  const size_t jobs = (layout.patches + kPatchesAJob - 1) / kPatchesAJob;
  std::vector<uint8_t> all(jobs, 1);
  const bool done = parallelFor(jobs, workers, interrupted, [&](size_t job) {
    const auto first = static_cast<uint32_t>(job * kPatchesAJob),
               end = static_cast<uint32_t>(std::min((job + 1) * kPatchesAJob, layout.patches));
    std::vector<Line> lines;
    for (uint32_t patch = first; patch < end; ++patch)
      for (size_t half = 0; half < 2; ++half) lines.push_back(lineOnHalf(patch, half, kMiddle));
    std::vector<SurfacePoint> hits(lines.size());
    scene->nearestOnLines(lines, Facing::kAlong, hits);
    for (uint32_t patch = first; patch < end; ++patch) {
      auto hasArea = [&](size_t half) { return lines[2 * (patch - first) + half].direction != glm::dvec3(0); };
      for (size_t half = 0; half < 2; ++half) {
        const SurfacePoint& found = hits[2 * (patch - first) + half];
        own[patch][half] = !hasArea(half)              ? SurfacePoint::kNone
                           : holds(found, patch, half) ? found.triangle
                                                       : ownTriangleBesideMiddle(patch, half);
      }
      // Of a triangle that is a patch alone, one half has no area.
      for (size_t half = 0; half < 2; ++half)
        if (own[patch][half] == SurfacePoint::kNone && !hasArea(half)) own[patch][half] = own[patch][1 - half];
      all[job] &= own[patch][0] != SurfacePoint::kNone && own[patch][1] != SurfacePoint::kNone;
    }
  });
  own_triangles = std::move(own);
  all_own = done && std::find(all.begin(), all.end(), 0) == all.end();
  return done;
}

SurfacePoint BakeContext::pointAt(uint32_t patch, double u, double v) const {
  const glm::dvec3 at = patchPoint(patch, u, v).position;
  const uint32_t own = own_triangles.empty() ? SurfacePoint::kNone : own_triangles[patch][v > u];
  if (own == SurfacePoint::kNone) return scene->closestPoint(at);
  const TrianglePoint on = closestOnTriangle(cornersOf(*mesh, own), at);
  return {own, on.b1, on.b2, on.distance};
}

void BakeContext::beginBatch(LineBatch& batch, uint32_t patch, double u0, double v0, double u1, double v1) const {
  batch.patch = patch;
  batch.lines.clear();
  batch.raster_lines.clear();
  batch.u0 = u0, batch.v0 = v0, batch.u_scale = 1 / (u1 - u0), batch.v_scale = 1 / (v1 - v0);
  for (size_t k = 0; k < 4; ++k) {
    const BasePoint f = patchPoint(patch, k % 2 ? u1 : u0, k / 2 ? v1 : v0);
    batch.square.points[k] = f.position;
    batch.square.normals[k] = f.normal;
  }
  if (!base.cut || !rasteriser) return;
  const auto& c = base.patches[patch];
  for (size_t half = 0; half < 2; ++half)
    for (size_t k = 0; k < 4; ++k) {
      const double u = k % 2 ? u1 : u0, v = k / 2 ? v1 : v0;
      const BasePoint f =
          onHalf(cornerPoint(c[0]), cornerPoint(c[half ? 2 : 1]), cornerPoint(c[3]), half ? v : u, half ? u : v);
      batch.halves[half].points[k] = f.position;
      batch.halves[half].normals[k] = f.normal;
    }
}

void BakeContext::intersect(LineBatch& batch) const {
  batch.on_own_triangles = false;
  if (!own_triangles.empty()) {
    const auto& own = own_triangles[batch.patch];
    batch.on_own_triangles = own[0] != SurfacePoint::kNone && own[1] != SurfacePoint::kNone;
  }
  if (batch.on_own_triangles) {
    batch.hits.resize(batch.lines.size());
    for (size_t i = 0; i < batch.lines.size(); ++i) {
      const uint32_t triangle = own_triangles[batch.patch][batch.halfOf(i)];
      const TrianglePoint on = closestOnTriangle(cornersOf(*mesh, triangle), batch.lines[i].at);
      batch.hits[i] = {triangle, on.b1, on.b2, 0};
    }
    return;
  }
  findHits(batch);
  if (touch_mm > 0)
    for (size_t i = 0; i < batch.hits.size(); ++i) batch.hits[i] = pointAtOrigin(batch.lines[i], batch.hits[i]);
  if (touching == Touching::kIgnored) return;
  FreeBall free;
  for (size_t i = 0; i < batch.hits.size(); ++i)
    if (batch.hits[i]) batch.hits[i] = touchingPoint(batch, i, free);
}

SurfacePoint BakeContext::pointAtOrigin(const Line& line, SurfacePoint hit) const {
  if (!hit || std::abs(hit.along) * glm::length(line.direction) > touch_mm) {
    const SurfacePoint near = scene->closestPoint(line.at, touch_mm);
    if (!near) return hit;
    hit = near;
  }
  hit.along = 0;
  return hit;
}

SurfacePoint BakeContext::touchingPoint(const LineBatch& batch, size_t i, FreeBall& free) const {
  const Line& line = batch.lines[i];
  const SurfacePoint& hit = batch.hits[i];
  // Hits nearer than this share of the reach do little harm.
  constexpr double kHarmless = 0.02;
  // Where the surface from the closest point to the hit were a plane that faces along the line as much as kFacing, the
  // closest point would be further away than kNear times the hit.
  constexpr double kNear = 0.1, kFacing = 0.2;
  // A surface whose normal is this far from the base's own is another sheet, seen from behind.
  constexpr double kOpposite = -0.5;
  if (std::abs(hit.along) < kHarmless * line.reach) return hit;
  const double length = glm::length(line.direction);
  const double within = kNear * std::abs(hit.along) * length;
  if (glm::length(line.at - free.centre) + within < free.radius) return hit;
  // What lies further away tells about the next lines, which begin close by.
  constexpr double kFurther = 2, kRounding = 1e-6;
  SurfacePoint near = scene->closestPoint(line.at, kFurther * within);
  if (!near || near.along > within) {
    free = {line.at, (near ? near.along : kFurther * within) * (1 - kRounding)};
    return hit;
  }
  const auto& t = mesh->triangles[near.triangle];
  auto interpolate = [&](const std::vector<glm::vec3>& of_vertex) {
    return glm::dvec3(of_vertex[t[0]]) * (1 - near.b1 - near.b2) + glm::dvec3(of_vertex[t[1]]) * near.b1 +
           glm::dvec3(of_vertex[t[2]]) * near.b2;
  };
  const glm::dvec3 normal = interpolate(normals->normals);
  const bool along = glm::dot(normal, line.direction) >= kFacing * glm::length(normal) * length;
  auto isOpposite = [&] { return glm::dot(normal, batch.baseNormal(i)) < kOpposite * glm::length(normal); };
  if (!along && (touching == Touching::kFacing || (touching == Touching::kSameSheet && isOpposite()))) return hit;
  near.along = glm::dot(interpolate(mesh->positions_mm) - line.at, line.direction) / (length * length);
  return near;
}

void BakeContext::findHits(LineBatch& batch) const {
  batch.hits.resize(batch.lines.size());
  if (!rasteriser) return scene->nearestOnLines(batch.lines, Facing::kAlong, batch.hits);
  LineBatch::Part& part = batch.part;
  auto take = [&](auto belongs) {
    part.of.clear(), part.lines.clear(), part.raster_lines.clear();
    for (size_t i = 0; i < batch.lines.size(); ++i) {
      if (!belongs(i)) continue;
      part.of.push_back(i);
      part.lines.push_back(batch.lines[i]);
      part.raster_lines.push_back(batch.raster_lines[i]);
    }
    part.hits.resize(part.of.size());
  };
  auto giveBack = [&] {
    for (size_t k = 0; k < part.of.size(); ++k) batch.hits[part.of[k]] = part.hits[k];
  };
  if (!base.cut) {
    rasteriser->nearest(batch.square, batch.raster_lines, batch.lines, batch.hits);
  } else {
    for (size_t half = 0; half < 2; ++half) {
      take([&](size_t i) { return batch.halfOf(i) == half; });
      if (!part.of.empty()) rasteriser->nearest(batch.halves[half], part.raster_lines, part.lines, part.hits);
      giveBack();
    }
  }
  take([&](size_t i) { return !batch.hits[i]; });
  scene->nearestOnLines(part.lines, Facing::kAlong, part.hits);
  giveBack();
}

}  // namespace relievo
