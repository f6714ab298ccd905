// compare_tessellated.tesc - factors: a side's from its byte, the inner ones from the grid level. GL 4.
layout(vertices = 1) out;

in ivec4 c_origin[];
in ivec4 c_relief[];
in uvec3 c_instance[];
out ivec4 e_origin[];
out ivec4 e_relief[];
out uvec2 e_instance[];  // index + 1; patch

float factor(int side) { return float(1 << int((c_instance[0].y >> uint(8 * side)) & 15u)); }

void main() {
  e_origin[gl_InvocationID] = c_origin[0];
  e_relief[gl_InvocationID] = c_relief[0];
  e_instance[gl_InvocationID] = c_instance[0].xz;
  // Sides: left, right, top, bottom. The tessellator's: u = 0, v = 0, u = 1, v = 1.
  gl_TessLevelOuter[0] = factor(0);
  gl_TessLevelOuter[1] = factor(2);
  gl_TessLevelOuter[2] = factor(1);
  gl_TessLevelOuter[3] = factor(3);
  gl_TessLevelInner[0] = gl_TessLevelInner[1] = float(1 << c_origin[0].w);
}
