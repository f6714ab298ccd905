// compare_morph.vert - a vertex that slides onto the next coarser grid with its distance to the eye (Strugar 2010;
// geometry/strategies/strategy_cdlod.cpp). Attributes and uniforms as in patch.vert. At both ends of the morph a vertex
// has exactly the bits of the vertex it is at. MESH: over a base mesh; a vertex on a patch's side slides towards the
// side's corner with the smaller index, so that both patches agree.
#include "compare_relief.glsl"
#include "instance.glsl"
#ifdef MESH
#include "base_point.glsl"
#endif

uniform mat4 u_clip_from_eye;
uniform ivec2 u_limit;
uniform vec4 u_scale;
uniform vec3 u_morph_eye;  // from the eye, mm: where the ranges are measured from
uniform vec2 u_morph[32];  // by absolute level of the vertices: where the morph starts and ends, mm

invariant gl_Position;
out vec2 v_uv;
flat out uvec2 v_instance;
#ifdef CAPTURE
out vec4 v_clip;
#endif

#ifdef MESH
vec3 pointAt(ivec2 g, out vec2 uv) {
  ivec2 in_node = g << a_origin.z;
  uv = vec2(in_node) * powerOfTwo(-(a_origin.z + a_origin.w));
  vec3 point, normal;
  basePoint(patchCorners(a_node.z), a_origin.xy + in_node, u_limit.x, u_scale.x, point, normal);
  float height_mm = u_scale.z;
  height_mm += heightSteps(a_relief.z, a_relief.xy + in_node, a_relief.w, bvec2(false)) * u_scale.y;
  return point + normal * height_mm;
}

// The vertex of the next coarser grid that vertex g slides onto.
ivec2 coarser(ivec2 g) {
  uvec4 index = patchCorners(a_node.z);
  ivec2 at = a_origin.xy + (g << a_origin.z);
  ivec2 to = g & ~1;
  if (at.x == 0 || at.x == u_limit.x) {
    if (at.x == 0 ? index.x > index.z : index.y > index.w) to.y = (g.y + 1) & ~1;
  } else if (at.y == 0 || at.y == u_limit.x) {
    if (at.y == 0 ? index.x > index.y : index.z > index.w) to.x = (g.x + 1) & ~1;
  }
  return to;
}
#else
ivec2 coarser(ivec2 g) { return g & ~1; }
vec3 pointAt(ivec2 g, out vec2 uv) {
  ivec2 in_node = g << a_origin.z;
  ivec2 at = a_origin.xy + in_node;
  ivec2 place = min(at, u_limit);
  uv = vec2(place - a_origin.xy) * powerOfTwo(-(a_origin.z + a_origin.w));
  float height_mm = u_scale.z;
  height_mm += heightSteps(a_relief.z, a_relief.xy + in_node, a_relief.w, greaterThanEqual(at, u_limit)) * u_scale.y;
  return vec3(float(place.x) * u_scale.x, -float(place.y) * u_scale.x, height_mm);
}
#endif

void main() {
  loadInstance();
  ivec2 g = ivec2(a_grid);
  vec2 fine_uv, coarse_uv;
  vec3 fine = pointAt(g, fine_uv);
  vec3 coarse = pointAt(coarser(g), coarse_uv);
  vec2 range = u_morph[int(a_node.y) + a_origin.w];
  float t = clamp((distance(fine, u_morph_eye) - range.x) / (range.y - range.x), 0.0, 1.0);
  float s = 1.0 - t;
  gl_Position = u_clip_from_eye * vec4(fine * s + coarse * t, 1.0);
#ifdef CAPTURE
  v_clip = gl_Position;
#endif
  v_uv = fine_uv * s + coarse_uv * t;
  v_instance = uvec2(a_node.x, a_node.y);
}
