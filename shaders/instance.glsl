// instance.glsl - the list of drawn nodes, 32 bytes each, uploaded once a list: vertices and pixels read the same
// texels (GpuPatchInstance of src/render/patch_pass.h).
#include "texel_table.glsl"

uniform UINT_TABLE u_instances;  // two texels an instance

// Patch, level, x, y.
uvec4 instanceNode(uint index) {
  uvec4 node = TABLE_TEXEL(u_instances, 2u * index);
  node.y &= 31u;
  return node;
}

#ifdef RELIEVO_VERTEX
in uvec2 a_grid;     // 0 .. 2^n
in uint a_instance;  // index in the list

// What is known of the instance, after loadInstance().
// units from the eye's unit (MESH: the patch's corner) to the node's corner: x, y; log2 of the grid step in units; n
ivec4 a_origin;
// units from the relief page's corner to the node's corner: x, y; where its samples are (TAILS: -1: the patch's tail);
// log2 of their spacing in units
ivec4 a_relief;
uvec3 a_node;    // index in the list of instances, + 1; the node's level; its patch
uint a_edges;    // per side a byte: a | b << 4 (geometry/lod/planar_lod.h)
int a_compact;   // of a relief page in compact form, 1 + how many times its cells a side are halved; else 0

void loadInstance() {
  uvec4 node = TABLE_TEXEL(u_instances, 2u * a_instance), place = TABLE_TEXEL(u_instances, 2u * a_instance + 1u);
  a_origin = ivec4(ivec2(place.xy), int((node.y >> 8u) & 31u), int((node.y >> 5u) & 7u));
  // The node's place among those of its level in the page, times its side.
  uint in_page = (1u << ((node.y >> 18u) & 31u)) - 1u;
  ivec2 corner = ivec2((node.zw & uvec2(in_page)) << uint(a_origin.z + a_origin.w));
  a_relief = ivec4(corner, int(place.z), int((node.y >> 13u) & 31u));
  a_node = uvec3(a_instance + 1u, node.y & 31u, node.x);
  a_edges = place.w;
  a_compact = int((node.y >> 23u) & 3u);
}
#endif
