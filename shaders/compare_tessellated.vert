// compare_tessellated.vert - one control point a patch: hands the instance on to the tessellator
// (geometry/strategies/strategy_tessellation.cpp).
in ivec4 a_origin;
in ivec4 a_relief;
in uint a_instance;
in uint a_edges;
in uint a_patch;

out ivec4 c_origin;
out ivec4 c_relief;
out uvec3 c_instance;  // index + 1; edges; patch

void main() {
  c_origin = a_origin;
  c_relief = a_relief;
  c_instance = uvec3(a_instance, a_edges, a_patch);
}
