// texture_lookup.glsl - the virtual texture's look-up: which node of which level a fragment wants, and where it is resident.
#include "common.glsl"
#include "page_table.h"

uniform usampler2D u_table;        // texturing/page_table.h
uniform usampler2D u_table_extra;  // planes 3.. of artworks that have more
uniform uvec4 u_table_shape;       // entries - 1; log2 of the width; seed; -
uniform ivec2 u_depth;             // finest texture level; -
uniform float u_lod_bias;          // added to the texture LOD

in vec2 v_uv;
flat in uvec4 v_node;
flat in uint v_grid_level;

// Texture LOD: 0 at one texel of the finest level a pixel, growing towards coarser levels. From the exact derivatives of the
// perspective mapping: v_uv / w and 1 / w are linear on screen, so their differences do not depend on the step, and
// d(uv)/dx = (d(uv/w)/dx - uv d(1/w)/dx) / (1/w). Taken of the virtual coordinate, before any fract().
float virtualTextureLod() {
  float iw = gl_FragCoord.w;
  vec2 q = v_uv * iw;
  vec2 ux = (dFdx(q) - v_uv * dFdx(iw)) / iw;
  vec2 uy = (dFdy(q) - v_uv * dFdy(iw)) / iw;
  float texels = float(kPagePx) * powerOfTwo(u_depth.x - int(v_node.y));  // of the finest level over this node
  float rho2 = max(dot(ux, ux), dot(uy, uy)) * texels * texels;
  // A gradient of zero, infinity or NaN asks for the coarsest level, never for the finest.
  float lod = rho2 > 1e-12 && rho2 < 1e24 ? 0.5 * log2(rho2) : float(u_depth.x);
  return clamp(lod + u_lod_bias, 0.0, float(u_depth.x));
}

// The node of a level at this fragment (patch, level, x, y), and the place inside it, 0..1.
uvec4 nodeAtLevel(int level, out vec2 local) {
  int s = level - int(v_node.y);
  if (s >= 0) {
    vec2 t = v_uv * powerOfTwo(s);
    vec2 cell = clamp(floor(t), vec2(0.0), vec2(powerOfTwo(s) - 1.0));
    local = t - cell;
    return uvec4(v_node.x, uint(level), (v_node.zw << uint(s)) + uvec2(cell));
  }
  uint k = uint(-s);
  uvec2 rest = v_node.zw & uvec2((1u << k) - 1u);
  local = (vec2(rest) + v_uv) * powerOfTwo(s);
  return uvec4(v_node.x, uint(level), v_node.zw >> k);
}

bool findNode(uvec4 node, out uvec4 entry, out uint index) {
  // packNode(node) + 1 of src/base/node_id.h: level 5 | patch 20 | x 17 | y 17 bits.
  uint lo = node.w | (node.z << 17u);
  uint hi = (node.z >> 15u) | (node.x << 2u) | (node.y << 22u);
  lo += 1u;
  if (lo == 0u) hi += 1u;
  uint h = pageHash(lo, hi, u_table_shape.z);
  index = pageProbe0(h, u_table_shape.x);
  uint width_mask = (1u << u_table_shape.y) - 1u;
  entry = texelFetch(u_table, ivec2(index & width_mask, index >> u_table_shape.y), 0);
  if (entry.x == lo && entry.y == hi) return true;
  index = pageProbe1(h, u_table_shape.x);
  entry = texelFetch(u_table, ivec2(index & width_mask, index >> u_table_shape.y), 0);
  return entry.x == lo && entry.y == hi;
}
