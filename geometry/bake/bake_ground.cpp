#include "geometry/bake/bake_ground.h"

#include <cmath>

namespace relievo {

// Where corners' normals oppose one another, those between them get short, and heights along them long: they end at
// twice the reach. The base is made to lie near the scan: most hits are within a fifth of the reach.
Line lineOf(const LineFrame& f, double reach) {
  const double along = reach / std::max(glm::length(f.normal), 0.5);
  return {f.point, f.normal, along, 0.2 * along};
}

BakeGround::BakeGround(const TriMesh& scan, const BaseMesh& over_scan)
    : mesh(&scan), base(over_scan), layout(base), shift(base.origin_mm - scan.origin_mm) {
  // Lines look about as far as a patch is wide: further away lie other parts of the artwork.
  used.assign(layout.corners, 0);
  corner_patch.assign(layout.corners, 0);
  corner_reach.assign(layout.corners, 0);
  side_reach.assign(layout.sides.size(), 0);
  patch_reach.assign(layout.patches, 0);
  for (uint32_t p = 0; p < layout.patches; ++p) {
    const auto& c = base.patches[p];
    auto length = [&](int a, int b) {
      return glm::length(corner(c[static_cast<size_t>(a)]).point - corner(c[static_cast<size_t>(b)]).point);
    };
    const double reach = std::max(length(0, 3), length(1, 2));
    patch_reach[p] = reach;
    for (uint32_t s : layout.patch_sides[p]) side_reach[s] = std::max(side_reach[s], reach);
    for (uint32_t k : c) {
      corner_reach[k] = std::max(corner_reach[k], reach);
      if (!used[k]) corner_patch[k] = p;
      used[k] = 1;
    }
  }
}

void BakeGround::begin(LineLookup& look, uint32_t patch, double u0, double v0, double u1, double v1) const {
  look.lines.clear();
  look.places.clear();
  look.u0 = u0, look.v0 = v0, look.u_scale = 1 / (u1 - u0), look.v_scale = 1 / (v1 - v0);
  for (size_t k = 0; k < 4; ++k) {
    const LineFrame f = inside(patch, k % 2 ? u1 : u0, k / 2 ? v1 : v0);
    look.square.points[k] = f.point;
    look.square.normals[k] = f.normal;
  }
}

void BakeGround::find(LineLookup& look) const {
  look.hits.resize(look.lines.size());
  if (!sweep) return scene->nearestOnLines(look.lines, Facing::kAlong, look.hits);
  sweep->nearest(look.square, look.places, look.lines, look.hits);
  look.left.clear();
  for (size_t i = 0; i < look.hits.size(); ++i)
    if (!look.hits[i]) look.left.push_back(look.lines[i]);
  look.left_hits.resize(look.left.size());
  scene->nearestOnLines(look.left, Facing::kAlong, look.left_hits);
  for (size_t i = 0, k = 0; i < look.hits.size(); ++i)
    if (!look.hits[i]) look.hits[i] = look.left_hits[k++];
}

}  // namespace relievo
