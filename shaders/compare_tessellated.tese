// compare_tessellated.tese - places are rounded to the finest vertices of the patch, so that all who share one compute
// the same bits. GL 4. MESH: over a base mesh.
#include "compare_relief.glsl"
#ifdef MESH
#include "base_point.glsl"
#endif

layout(quads, equal_spacing, ccw) in;

in ivec4 e_origin[];
in ivec4 e_relief[];
in uvec2 e_instance[];

uniform mat4 u_clip_from_eye;
uniform ivec2 u_limit;
uniform vec4 u_scale;

invariant gl_Position;
out vec2 v_uv;
flat out uvec2 v_instance;

void main() {
  ivec4 origin = e_origin[0];
  ivec2 in_node = ivec2(gl_TessCoord.xy * float(1 << origin.w) + 0.5) << origin.z;
  ivec2 at = origin.xy + in_node;
#ifdef MESH
  vec3 point, normal;
  basePoint(patchCorners(e_instance[0].y), at, u_limit.x, u_scale.x, point, normal);
  float height_mm = u_scale.z;
  height_mm += heightSteps(e_relief[0].z, e_relief[0].xy + in_node, e_relief[0].w, bvec2(false)) * u_scale.y;
  gl_Position = u_clip_from_eye * vec4(point + normal * height_mm, 1.0);
  v_uv = vec2(in_node) * powerOfTwo(-(origin.z + origin.w));
#else
  ivec2 place = min(at, u_limit);
  float height_mm = u_scale.z;
  bvec2 on_border = greaterThanEqual(at, u_limit);
  height_mm += heightSteps(e_relief[0].z, e_relief[0].xy + in_node, e_relief[0].w, on_border) * u_scale.y;
  gl_Position = u_clip_from_eye * vec4(float(place.x) * u_scale.x, -float(place.y) * u_scale.x, height_mm, 1.0);
  v_uv = vec2(place - origin.xy) * powerOfTwo(-(origin.z + origin.w));
#endif
  v_instance = uvec2(e_instance[0].x, 0u);
}
