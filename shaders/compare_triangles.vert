// compare_triangles.vert - a vertex of a strategy's explicit triangles (geometry/strategies/lod_strategy.h); the same
// arithmetic as patch.vert, so that a vertex at the same place and height has the same bits. MESH: over a base mesh.
#ifdef MESH
#include "common.glsl"
#include "base_point.glsl"
in uint a_patch;
uniform ivec2 u_limit;
#endif
in ivec2 a_place;      // units from the artwork's corner (MESH: from the patch's)
in float a_height;     // steps of the relief's range
in vec2 a_uv;          // place in the instance's node
in uint a_instance;    // index in the list of instances, + 1

uniform mat4 u_clip_from_eye;
uniform vec4 u_scale;  // as in patch.vert
#ifndef MESH
uniform ivec2 u_eye_unit;  // the unit that positions count from
#endif

invariant gl_Position;
out vec2 v_uv;
flat out uvec2 v_instance;

void main() {
  float height_mm = u_scale.z;
  height_mm += a_height * u_scale.y;
#ifdef MESH
  vec3 point, normal;
  basePoint(patchCorners(a_patch), a_place, u_limit.x, u_scale.x, point, normal);
  vec3 from_eye = point + normal * height_mm;
#else
  ivec2 place = a_place - u_eye_unit;
  vec3 from_eye = vec3(float(place.x) * u_scale.x, -float(place.y) * u_scale.x, height_mm);
#endif
  gl_Position = u_clip_from_eye * vec4(from_eye, 1.0);
  v_uv = a_uv;
  v_instance = uvec2(a_instance, 0u);
}
