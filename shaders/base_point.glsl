// base_point.glsl - the base mesh's point, from the eye, and normal, at a place of a patch: bilinear in its corners
// (src/render/base_corners.h), or linear on both sides of (0, 0)-(1, 1). On a side it is a function of that side's two
// corners, in the order of their indices, and the place between them alone (CPU reference: geometry/lod/mesh_vertex.h).
// UNORDERED_ENDS: not so, for a negative control.
#include "texel_table.glsl"

uniform FLOAT_TABLE u_corners;
uniform FLOAT_TABLE u_normals;
uniform UINT_TABLE u_base;
uniform bool u_cut;  // linear on halves

vec3 lerpOrdered(vec3 lo, vec3 hi, float t) {
#ifdef UNORDERED_ENDS
  return lo + (hi - lo) * t;
#else
  float s = 1.0 - t;
  return lo * s + hi * t;
#endif
}

// The corners' indices at (0, 0), (1, 0), (0, 1), (1, 1).
uvec4 patchCorners(uint index) { return TABLE_TEXEL(u_base, index); }

// place: units, 0 .. side, a power of two; scale: 1 / side.
void basePoint(uvec4 index, ivec2 place, int side, float scale, out vec3 point, out vec3 normal) {
  vec2 uv = vec2(place) * scale;
  uint a = index.x, b = index.y;
  float t = uv.x;
  bool on_column = place.x == 0 || place.x == side;
  if (on_column) {
    a = place.x == 0 ? index.x : index.y;
    b = place.x == 0 ? index.z : index.w;
    t = uv.y;
  } else if (place.y == side) {
    a = index.z;
    b = index.w;
  }
  uint lo = min(a, b), hi = max(a, b);
#ifdef UNORDERED_ENDS
  lo = a;
  hi = b;
#endif
  if (lo != a) t = 1.0 - t;
  point = lerpOrdered(TABLE_TEXEL(u_corners, lo).xyz, TABLE_TEXEL(u_corners, hi).xyz, t);
  normal = lerpOrdered(TABLE_TEXEL(u_normals, lo).xyz, TABLE_TEXEL(u_normals, hi).xyz, t);
  // A loop, so that vertices on sides (all of the coarsest grids) do not wait for all that they do not need (in
  // software for one row of it).
  bool inside = !(on_column || place.y == 0 || place.y == side);
  for (int row = 0; row < (inside && !u_cut ? 2 : 0); ++row) {
    uvec2 ends = row == 0 ? index.xy : index.zw;
    vec3 p = lerpOrdered(TABLE_TEXEL(u_corners, ends.x).xyz, TABLE_TEXEL(u_corners, ends.y).xyz, uv.x);
    vec3 n = lerpOrdered(TABLE_TEXEL(u_normals, ends.x).xyz, TABLE_TEXEL(u_normals, ends.y).xyz, uv.x);
    point = row == 0 ? p : lerpOrdered(point, p, uv.y);
    normal = row == 0 ? n : lerpOrdered(normal, n, uv.y);
  }
  for (int k = 0; k < (inside && u_cut ? 3 : 0); ++k) {
    float low = min(uv.x, uv.y), high = max(uv.x, uv.y);
    uint corner = k == 0 ? index.x : k == 2 ? index.w : uv.y > uv.x ? index.z : index.y;
    float share = k == 0 ? 1.0 - high : k == 2 ? low : high - low;
    point = (k == 0 ? vec3(0) : point) + TABLE_TEXEL(u_corners, corner).xyz * share;
    normal = (k == 0 ? vec3(0) : normal) + TABLE_TEXEL(u_normals, corner).xyz * share;
  }
}
