// texture_lookup.glsl - the virtual texture's look-up: what a pixel covers of the texture (from the surface buffer),
// which node of a level lies there, and where it is resident.
#include "common.glsl"
#include "gradient.glsl"
#include "instance.glsl"
#include "page_table.h"
#ifdef TAILS
#include "tails.glsl"
#endif

uniform usampler2D u_table;        // texturing/stream/page_table.h
uniform usampler2D u_table_extra;  // planes 3.. of artworks that have more
uniform uvec4 u_table_shape;       // entries - 1; log2 of the width; seed; -
// finest texture level; flat artworks: 1: the patches' strip runs along x; width, height in texels
uniform ivec4 u_artwork;
uniform float u_lod_bias;          // added to the texture LOD

uniform usampler2D u_surface;      // what is seen at each pixel (surface.frag)
uniform usampler2D u_gradient;     // with anisotropy: d(uv)/dx, d(uv)/dy there

// What is seen at a pixel; after loadSurface().
vec2 v_uv;         // place in the node, 0..1
uvec4 v_node;      // patch, level, x, y
uint v_grid_level;
float v_lod;       // of an isotropic footprint, without bias
vec4 v_gradient;
#ifdef TWO_SIDED
bool v_from_behind;
#endif

// Of a pixel where something is seen.
void loadSurface(ivec2 pixel) {
  uvec4 s = texelFetch(u_surface, pixel, 0);
  v_node = instanceNode((s.z & 0xFFFFFFFu) - 1u);
  v_grid_level = s.z >> 28u;
  v_uv = uintBitsToFloat(s.xy);
#ifdef TWO_SIDED
  v_from_behind = (s.w & kSignBit) != 0u;
  s.w &= ~kSignBit;
#endif
  float rho2 = uintBitsToFloat(s.w);
  v_lod = soundGradient(rho2) ? 0.5 * log2(rho2) : float(u_artwork.x);
#ifdef ANISOTROPY
  v_gradient = uintBitsToFloat(texelFetch(u_gradient, pixel, 0));
#endif
}

#ifdef ANISOTROPY
struct Footprint {
  vec2 step;       // in v_uv: one unit of `ratio` along the major axis
  float ratio;     // length of the major axis in steps, 1 .. ANISOTROPY
  vec2 low, high;  // the artwork's corners, in v_uv
};
#endif

// The coarsest texture LOD: the root's, or with tails the coarsest of theirs.
float coarsestLod() {
#ifdef TAILS
  return float(u_artwork.x + kTailLevels - 1) + kTailFinest;
#else
  return float(u_artwork.x);
#endif
}

float nodeTexels() { return float(kPagePx) * powerOfTwo(u_artwork.x - int(v_node.y)); }

#ifndef ANISOTROPY
// Texture LOD: 0 at one texel of the finest level a pixel, growing towards coarser levels.
float virtualTextureLod() { return clamp(v_lod + u_lod_bias, 0.0, coarsestLod()); }
#else
// A pixel covers an ellipse of the texture, whose axes are the singular values of (dx dy). The level follows the minor
// one, but for what more than ANISOTROPY taps would take; the taps lie along the major one. In magnification a tap is a
// texel wide whatever its level, so no more taps are taken than texels are covered.
float virtualTextureLod(out Footprint f) {
  vec2 dx = v_gradient.xy, dy = v_gradient.zw;
  float a = dx.x * dx.x + dy.x * dy.x, b = dx.x * dx.y + dy.x * dy.y, c = dx.y * dx.y + dy.y * dy.y;
  float d = 0.5 * (a - c);
  float root = sqrt(d * d + b * b);
  float major2 = 0.5 * (a + c) + root;
  bool sound = soundGradient(major2);
  float major = sqrt(major2);
  float minor = abs(dx.x * dy.y - dx.y * dy.x) / major;  // without the cancellation of 0.5 (a + c) - root
  float size = max(minor, major / float(ANISOTROPY)) * exp2(u_lod_bias);
  float unit = max(size, 1.0);
  vec2 axis = d >= 0.0 ? vec2(d + root, b) : vec2(b, root - d);  // of the two forms the one without cancellation
  f.step = sound && root > 0.0 ? normalize(axis) * (unit / nodeTexels()) : vec2(0.0);
  f.ratio = sound ? clamp(major / unit, 1.0, float(ANISOTROPY)) : 1.0;
  // Exact integers, so that the corner is where it is for nodes at the border; the other nodes' never matters.
  int level = int(v_node.y);
  ivec2 node = ivec2(v_node.zw);
  int before = int(v_node.x) << level;
  if (u_artwork.y == 1) node.x += before;
  else node.y += before;
  int e = u_artwork.x + 7 - level;  // log2 of the node's texels
  ivec2 extent = e >= 0 ? u_artwork.zw - (node << max(e, 0)) : (u_artwork.zw << max(-e, 0)) - node;
  f.low = -vec2(node);
  f.high = vec2(extent) * (e >= 0 ? powerOfTwo(-e) : 1.0);
#ifdef MESH
  // Pages know a little of the neighbouring patches; sampleTaps() keeps taps within that.
  f.low = vec2(-1e9);
  f.high = vec2(1e9);
#endif
  return sound ? clamp(log2(size), 0.0, coarsestLod()) : coarsestLod();
}

// The footprint as taps at distances of one step, weighted by how much of a step around them lies inside it: continuous
// in the ratio, which a number of equal taps is not. As many as ANISOTROPY is even or odd, or one.
int tapCount(float ratio) {
  int odd = ANISOTROPY & 1;
  if (ratio <= 1.0) return 1;
  return odd + 2 * int(ceil(0.5 * (ratio - float(odd))));
}
// x: place along the axis, in steps; y: weight. The weights add up to the ratio.
vec2 tapAt(int i, int count, float ratio) {
  float at = float(i) - 0.5 * float(count - 1);
  float weight = clamp(0.5 * ratio + 0.5 - abs(at), 0.0, 1.0);
  return vec2(count == 2 ? at * (ratio - 1.0) : at, weight);
}
vec2 tapPlace(float at, Footprint f) { return clamp(v_uv + at * f.step, f.low, f.high); }
#endif

// A node and the coordinates in it: uv * scale + offset is 0..1 inside. scale is a power of two, so the product is
// exact.
struct Place {
  uvec4 node;  // patch, level, x, y
  vec2 offset;
  float scale;
};
vec2 localAt(Place place, vec2 uv) { return uv * place.scale + place.offset; }
vec2 uvAt(Place place, vec2 local) { return (local - place.offset) / place.scale; }

// The node of a level at this fragment: an ancestor of the drawn node, or in it. No branch, which would cost software
// GL both sides.
Place placeAtLevel(int level) {
  int s = level - int(v_node.y);
  int down = max(s, 0);
  uint up = uint(max(-s, 0));
  float cells = powerOfTwo(down);
  vec2 cell = clamp(floor(v_uv * cells), vec2(0.0), vec2(cells - 1.0));
  uvec2 node = ((v_node.zw << uint(down)) + uvec2(cell)) >> up;
  vec2 offset = vec2(v_node.zw & uvec2((1u << up) - 1u)) * powerOfTwo(-int(up)) - cell;
  return Place(uvec4(v_node.x, uint(level), node), offset, powerOfTwo(s));
}

uvec4 nodeAtLevel(int level, out vec2 local) {
  Place place = placeAtLevel(level);
  local = localAt(place, v_uv);
  return place.node;
}

void toParent(inout Place place) {
  place.offset = (place.offset + vec2(place.node.zw & uvec2(1u))) * 0.5;
  place.scale *= 0.5;
  place.node = uvec4(place.node.x, place.node.y - 1u, place.node.zw >> 1u);
}

#ifdef ANISOTROPY
// To the node of the same level in which uv lies, over the patches of the strip.
void toNodeAt(vec2 uv, inout Place place) {
  int level = int(place.node.y);
  ivec2 from = ivec2(place.node.zw);
  int before = int(place.node.x) << level;
  if (u_artwork.y == 1) from.x += before;
  else from.y += before;
#ifdef MESH
  before = 0;
  from = ivec2(place.node.zw);
  ivec2 last = ivec2((1 << level) - 1);
#else
  ivec2 last = (u_artwork.zw - 1) >> (u_artwork.x + 7 - level);
#endif
  ivec2 at = clamp(from + ivec2(floor(localAt(place, uv))), ivec2(0), last);
  place.offset -= vec2(at - from);
  int patch_mask = (1 << level) - 1;
#ifdef MESH
  uint patch_index = place.node.x;
#else
  uint patch_index = uint((u_artwork.y == 1 ? at.x : at.y) >> level);
#endif
  place.node = uvec4(patch_index, uint(level), uvec2(at & patch_mask));
}
#endif

// To the nearest resident ancestor, or the node itself; false: there is none. A probe a turn: most look-ups end after
// their first, and software GL leaves a loop when all pixels are done, but runs through both sides of every branch.
bool findResident(inout Place place, out uvec4 entry, out uint index) {
  for (bool second = false;; second = !second) {
    // packNode(node) + 1 of src/artwork/node_id.h: level 5 | patch 20 | x 17 | y 17 bits.
    uint lo = (place.node.w | (place.node.z << 17u)) + 1u;
    uint hi = ((place.node.z >> 15u) | (place.node.x << 2u) | (place.node.y << 22u)) + (lo == 0u ? 1u : 0u);
    uint h = pageHash(lo, hi, u_table_shape.z);
    index = second ? pageProbe1(h, u_table_shape.x) : pageProbe0(h, u_table_shape.x);
    entry = texelFetch(u_table, ivec2(index & ((1u << u_table_shape.y) - 1u), index >> u_table_shape.y), 0);
    if (entry.x == lo && entry.y == hi) return true;
    if (second) {
      if (place.node.y == 0u) return false;
      toParent(place);
    }
  }
  return false;
}
