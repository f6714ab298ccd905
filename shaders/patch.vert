// patch.vert - a vertex of an instanced patch grid. Its position is a function of its global integer coordinates and
// its 16-bit height sample alone, so that neighbours compute the same bits whatever their levels, pages and slots (CPU
// reference: geometry/lod/patch_vertex.h). MESH: over a base mesh; a vertex on a patch's side is a function of that
// side's two corners, in the order of their indices, and its place between them (CPU reference:
// geometry/lod/mesh_vertex.h). ROOT_CELLS: only patches that are drawn as one cell, with heights from their tails: the
// same vertices, in a program of its own since software GL runs through every branch and, once, through every loop.
#include "common.glsl"
#include "instance.glsl"
#ifdef MESH
#include "base_point.glsl"
#include "compact_relief.glsl"
#endif

#ifdef MORPH
// weights, less 1, of 256: per side a byte, of the whole edge or first half; of the second half; of the grid's inside
in uvec3 a_morph;
#endif

uniform mat4 u_clip_from_eye;  // eye-relative mm to clip space
// units from the eye's unit to the artwork's right and bottom border (MESH: units of a patch's side)
uniform ivec2 u_limit;
// mm (MESH: patch sides) per unit; mm per height step; mm of height 0 above the eye (MESH: above the base); what z / w
// is moved by, towards the eye (wireframe)
uniform vec4 u_scale;
#ifdef TAILS
// first the four at the corners, of all patches; then 17 x 17 a patch, or once for all (src/render/tail_textures.h)
uniform UINT_TABLE u_tail_heights;
uniform uint u_tail_patches;
uniform uint u_tail_grid;  // 289, or 0
#endif

invariant gl_Position;
out vec2 v_uv;                 // place in the node, 0..1
flat out uvec2 v_instance;     // a_node.x, n << 28; a_node.y
#ifdef CAPTURE
out vec4 v_clip;
#endif

int snapToEdge(int i, int n, int m) {
  if (m >= n) return i;
  int d = n - m;
  int half_step = 1 << (d - 1);
  return i < ((1 << n) >> 1) ? ((i + half_step) >> d) << d : ((i + half_step - 1) >> d) << d;
}

int snapOnSide(int i, int n, uint side) {
#ifdef NO_SNAPPING
  return i;
#else
  int a = int(side & 15u);
  int b = int((side >> 4u) & 15u);
  if (b == 15) return snapToEdge(i, n, a);
  int middle = (1 << n) >> 1;
  return i < middle ? snapToEdge(i, n - 1, a) : middle + snapToEdge(i - middle, n - 1, b);
#endif
}

#ifdef RELIEF
int heightSample(ivec3 origin, ivec2 s) {
#ifdef TAILS
  uint in_tail = u_tail_patches * 4u + a_node.z * u_tail_grid + uint(s.y * 17 + s.x);
  if (a_relief.z == -1) return int(TABLE_TEXEL(u_tail_heights, in_tail).r);
#endif
#ifdef MESH
  return reliefSampleOf(origin, a_compact, s);
#else
  return reliefSample(origin, s);
#endif
}

// In 1/256 of a height step; between samples on the cell's two triangles, in integers. MESH: in whole steps, as they
// were in the page of which only these samples are kept (texturing/stream/relief_subslots.h).
int heightQ8(ivec3 origin, ivec2 local, int spacing_log2) {
  ivec2 s = local >> spacing_log2;
  ivec2 f = local & ((1 << spacing_log2) - 1);
  bool between = (f.x | f.y) != 0;
  int cut = max(0, spacing_log2 - 15);
  int bits = spacing_log2 - cut;
  f >>= cut;
  // From a corner of the triangle to the next: (0, 0), the one along the longer way, (1, 1). A loop: most vertices are
  // samples.
  ivec2 t = min(s + 1, ivec2(kPagePx));
  int value = 0, last = 0;
  for (int k = 0; k < (between ? 3 : 1); ++k) {
    int q = heightSample(origin, k == 0 ? s : k == 2 ? t : f.x >= f.y ? ivec2(t.x, s.y) : ivec2(s.x, t.y));
    value += k == 0 ? q << bits : (k == 1 ? max(f.x, f.y) : min(f.x, f.y)) * (q - last);
    last = q;
  }
  if (!between) return last << 8;
#ifdef MESH
  return ((value + (1 << (bits - 1))) >> bits) << 8;
#else
  return bits > 8 ? value >> (bits - 8) : value << (8 - bits);
#endif
}
#endif

struct Vertex {
  vec3 from_eye;
  vec2 uv;  // in the node
};

// The surface at a place of the grid.
Vertex vertexAt(ivec2 g) {
  ivec2 in_node = ivec2(g.x << a_origin.z, g.y << a_origin.z);
  ivec2 at = a_origin.xy + in_node;
#ifndef MESH
  ivec2 place = min(at, u_limit);
#endif

  float height_mm = u_scale.z;
#ifdef RELIEF
  // A vertex at or beyond the border takes the next sample at or beyond it, so that all that is clamped there agrees.
  int spacing_log2 = a_relief.w;
#ifndef MESH
  int mask = (1 << spacing_log2) - 1;
#endif
  ivec2 local = a_relief.xy + in_node;
#ifndef MESH
  if (at.x >= u_limit.x) local.x = (local.x + mask) & ~mask;
  if (at.y >= u_limit.y) local.y = (local.y + mask) & ~mask;
#endif
  ivec3 relief_origin = reliefOrigin(a_relief.z == -1 ? 0 : a_relief.z);
  float height_steps = float(heightQ8(relief_origin, local, spacing_log2)) * 0.00390625;
  height_mm += height_steps * u_scale.y;
#endif

  Vertex v;
  float nodes = powerOfTwo(-(a_origin.z + a_origin.w));
#ifdef MESH
  vec3 point, normal;
  basePoint(patchCorners(a_node.z), at, u_limit.x, u_scale.x, point, normal);
  v.from_eye = point + normal * height_mm;
  v.uv = vec2(in_node) * nodes;
#else
  v.from_eye = vec3(float(place.x) * u_scale.x, -float(place.y) * u_scale.x, height_mm);
  v.uv = vec2(place - a_origin.xy) * nodes;
#endif
  return v;
}

#ifdef MORPH
// CPU reference: geometry/lod/morph.h, as is all of what follows.
struct GridVertex {
  ivec2 own, from, to;  // grid steps
  float weight;         // below 1: drawn between the middle of from and to, often one place, and own
};

float weightOf(uint bytes, int at) { return float(((bytes >> (8 * at)) & 255u) + 1u) * 0.00390625; }

int snapToNearerEnd(int i, int n, int m) {
  int d = n - m;
  return (i > (1 << n) >> 1 ? (i + (1 << d) - 1) >> d : i >> d) << d;
}

GridVertex vertexOnSide(ivec2 g, ivec2 axis, int n, int which) {
  GridVertex v = GridVertex(g, g, g, 1.0);
#ifndef NO_SNAPPING
  uint levels = (a_edges >> (8 * which)) & 255u;
  bool halves = (levels >> 4u) != 15u;
  int i = g.x * axis.x + g.y * axis.y;
  int middle = halves ? (1 << n) >> 1 : 0;
  bool second = halves && i >= middle;
  int start = second ? middle : 0;
  int level = int(second ? levels >> 4u : levels & 15u);
  int cells = halves ? n - 1 : n;
  int step = 1 << (cells - level);
  int centre = (1 << cells) >> 1;
  int own = snapToNearerEnd(i - start, cells, level);
  v.own = g + axis * (start + own - i);
  if (level > 0 && (own & step) != 0) {
    ivec2 reach = axis * step;
    v.from = own > centre ? v.own + reach : v.own - reach;
    v.to = own < centre ? v.own - reach : v.own + reach;
    v.weight = weightOf(second ? a_morph.y : a_morph.x, which);
#ifndef MESH
    // On the border, as the next coarser vertex: the coarser surface ends there, too.
    ivec2 there = a_origin.xy + (v.own << a_origin.z);
    if (own >= centre && (axis.x != 0 ? there.x >= u_limit.x : there.y >= u_limit.y)) v.weight = 1.0;
#endif
  }
#endif
  return v;
}

GridVertex vertexOnBorder(ivec2 g, int n) {
  int last = 1 << n;
  bool column = g.x == 0 || g.x == last, row = g.y == 0 || g.y == last;
  if (column == row) return GridVertex(g, g, g, 1.0);
  return vertexOnSide(g, column ? ivec2(0, 1) : ivec2(1, 0), n, column ? (g.x == 0 ? 0 : 1) : (g.y == 0 ? 2 : 3));
}

// Of the way from the middle of two (their sum) to a vertex's own place.
Vertex between(Vertex sum, Vertex own, float weight) {
  float s = 1.0 - weight;
  return Vertex(0.5 * sum.from_eye * s + own.from_eye * weight, 0.5 * sum.uv * s + own.uv * weight);
}

// Loops, so that what most vertices do not need is not computed where all lanes agree on it, and vertexAt() is there
// once.
Vertex drawnVertex(ivec2 g, int n) {
  int last = 1 << n;
  ivec2 odd = g & 1;
  float weight = weightOf(a_morph.z, 0);
  bool moves = (odd.x | odd.y) != 0 && weight < 1.0 && g.x > 0 && g.y > 0 && g.x < last && g.y < last;
  Vertex own, sum;
  for (int k = 0; k < (moves ? 3 : 1); ++k) {
    GridVertex v = vertexOnBorder(k == 0 ? g : k == 1 ? g - odd : g + odd, n);
    Vertex there, sum_there;
    for (int e = 0; e < (v.weight < 1.0 ? 3 : 1); ++e) {
      Vertex at = vertexAt(e == 0 ? v.own : e == 1 ? v.from : v.to);
      if (e == 0) there = at;
      else if (e == 1) sum_there = at;
      else sum_there = Vertex(sum_there.from_eye + at.from_eye, sum_there.uv + at.uv);
    }
    if (v.weight < 1.0) there = between(sum_there, there, v.weight);
    if (k == 0) own = there;
    else if (k == 1) sum = there;
    else sum = Vertex(sum.from_eye + there.from_eye, sum.uv + there.uv);
  }
  if (moves) own = between(sum, own, weight);
  return own;
}
#endif

#ifdef ROOT_CELLS
// As vertexAt() has it at a corner of the patch.
Vertex vertexAtCorner(uint patch_index, uvec2 g) {
  uvec4 corners = patchCorners(patch_index);
  uint corner = g.y == 0u ? (g.x == 0u ? corners.x : corners.y) : (g.x == 0u ? corners.z : corners.w);
  float height_mm = u_scale.z;
#if defined(RELIEF) && !defined(CELLS_WITHOUT_HEIGHTS)
  float height_steps = float(TABLE_TEXEL(u_tail_heights, patch_index * 4u + g.y * 2u + g.x).r);
  height_mm += height_steps * u_scale.y;
#endif
  vec3 point = TABLE_TEXEL(u_corners, corner).xyz, normal = TABLE_TEXEL(u_normals, corner).xyz;
  return Vertex(point + normal * height_mm, vec2(g));
}
#endif

void main() {
#ifdef ROOT_CELLS
  const int n = 0;
  a_node = uvec3(a_instance + 1u, 0u, TABLE_TEXEL(u_instances, 2u * a_instance).x);
  Vertex v = vertexAtCorner(a_node.z, a_grid);
#else
  loadInstance();
  int n = a_origin.w;
#ifdef MORPH
  Vertex v = drawnVertex(ivec2(a_grid), n);
#else
  int last = 1 << n;
  ivec2 g = ivec2(a_grid);
  ivec2 snapped = g;
  if (g.x == 0) snapped.y = snapOnSide(g.y, n, a_edges & 255u);
  if (g.x == last) snapped.y = snapOnSide(g.y, n, (a_edges >> 8u) & 255u);
  if (g.y == 0) snapped.x = snapOnSide(g.x, n, (a_edges >> 16u) & 255u);
  if (g.y == last) snapped.x = snapOnSide(g.x, n, (a_edges >> 24u) & 255u);
  Vertex v = vertexAt(snapped);
#endif
#endif
  gl_Position = u_clip_from_eye * vec4(v.from_eye, 1.0);
#ifdef CAPTURE
  v_clip = gl_Position;
#endif
#ifdef WIREFRAME
  gl_Position.z += u_scale.w * gl_Position.w;
#endif
  v_uv = v.uv;
  v_instance = uvec2(a_node.x | (uint(n) << 28u), a_node.y);
}
