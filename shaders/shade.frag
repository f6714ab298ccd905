// shade.frag - the shading pass, over the pixels of the surface buffer: filtered channels from the page cache,
// evaluated under the light (CPU reference: src/artwork/basis.h). TAILS_ONLY: no page is looked up. PLANES: texture
// planes read. SHADING: of shading.h. Of a linear basis (shadingDefines() of src/render/picture_target.h) COEFFICIENTS
// is how many there are; TERMS is TERM(plane, channel, coefficient, colour) for each channel that holds one; COLOUR, of
// a luminance, is CHANNEL(plane, channel) of red, green and blue. LIGHTS, LIGHT_FILES: lights.glsl shades;
// SHADING_FILES: relief_shading.glsl does. OCCLUSION_FILES: ambient_occlusion.glsl darkens. GLOSS_FILES: gloss.glsl
// adds highlights. TWO_SIDED: of a scan that is seen from behind the other side is lit. EYE_FILES: eye.glsl, for what
// asks for the place of a pixel. NO_PAGES: there is no plane to read (PLANES is 1). NORMALS_OUT: of a scan the
// filtered normal is written.
#include "shading.h"
#include "texture_lookup.glsl"

#ifdef COEFFICIENTS
uniform vec4 u_coefficients[COEFFICIENTS];  // x: scale, y: bias of coefficient k; z: its function under the light
#endif
uniform vec3 u_light;            // the unit vector towards it, in the artwork's space
uniform vec3 u_fade;             // frame time as in PageTableEntry::birth; 1 / (fade time in 1/64 s); 1: fades are over

#ifdef SHADOWS
uniform sampler2D u_light_share;  // of each pixel (shadow.frag): one, or with LIGHTS one a component
#endif

#ifdef NORMALS_OUT
out uvec4 o_normal;  // floats as bits
#else
out vec4 o_colour;
#endif

int slotOfPlane(int plane, uvec4 entry, uvec4 extra) {
  int beyond = plane - RV_PLANES_IN_ENTRY;
  uint pair = plane < 2 ? entry.z : plane == 2 ? entry.w : extra[max(beyond, 0) % RV_PLANES_IN_EXTRA / 2];
  bool high = plane == 1 || (beyond > 0 && (beyond & 1) == 1);
  return int(high ? pair >> 16u : pair & 0xFFFFu);
}

// The pool's texel. BLOCKS: texture pages lie in that many compressed textures (src/render/block_formats.h), else in
// u_pool.
#ifdef BLOCKS
uniform sampler2DArray u_blocks0, u_blocks1, u_blocks2;
#if BLOCKS == 1
#define POOL_READ(read, at) read(u_blocks0, at).rgb
#elif BLOCKS == 2
#define POOL_READ(read, at) vec3(read(u_blocks0, at).rg, read(u_blocks1, at).r)
#else
#define POOL_READ(read, at) vec3(read(u_blocks0, at).r, read(u_blocks1, at).r, read(u_blocks2, at).r)
#endif
#else
#define POOL_READ(read, at) read(u_pool, at).rgb
#endif
#define POOL_TEXEL(pool, at) texelFetch(pool, at, 0)
#define POOL_FILTERED(pool, at) textureLod(pool, at, 0.0)
vec3 poolTexel(ivec3 at) { return POOL_READ(POOL_TEXEL, at); }

// At p, in texels of the slot, border included; channels 0..255.
vec3 filterPage(int slot, vec2 p) {
  ivec3 origin = slotOrigin(slot);
#if defined(NEAREST)
  return poolTexel(origin + ivec3(ivec2(p), 0)) * 255.0;
#elif defined(FAST_FILTER)
  float size = float(kPageFullPx * kSlotsPerSide);
  vec3 at = vec3((vec2(origin.xy) + p) / size, float(origin.z));
  return POOL_READ(POOL_FILTERED, at) * 255.0;
#else
  vec2 corner = floor(p - 0.5);
  vec2 f = p - 0.5 - corner;
  ivec3 at = origin + ivec3(ivec2(corner), 0);
  vec3 c00 = poolTexel(at);
  vec3 c10 = poolTexel(at + ivec3(1, 0, 0));
  vec3 c01 = poolTexel(at + ivec3(0, 1, 0));
  vec3 c11 = poolTexel(at + ivec3(1, 1, 0));
  vec3 top = c00 + (c10 - c00) * f.x;
  vec3 bottom = c01 + (c11 - c01) * f.x;
  return (top + (bottom - top) * f.y) * 255.0;
#endif
}

#ifdef TAILS
// The patch's tail at this pixel: what shows where no page is to be had, and where the patch is small.
vec3 g_tail[PLANES];

// beyond: the texture LOD, less the root's.
void loadTail(float beyond) {
  vec2 uv;
  uvec4 root = nodeAtLevel(0, uv);
  float lod = clamp(beyond - kTailFinest, 0.0, float(kTailLevels - 1));
  for (int g = 0; g < TAIL_GROUPS; ++g) {
    uint rank = tailRank(g, root.x);
#ifdef TRILINEAR
    float base = min(floor(lod), float(kTailLevels - 2));
    TailTexel fine = filterTail(g, rank, uv, int(base)), coarse = filterTail(g, rank, uv, int(base) + 1);
    for (int k = 0; k < TAIL_WORDS; ++k)
      g_tail[g * TAIL_WORDS + k] = fine.planes[k] + (coarse.planes[k] - fine.planes[k]) * (lod - base);
#else
    TailTexel one = filterTail(g, rank, uv, int(floor(lod + 0.5)));
    for (int k = 0; k < TAIL_WORDS; ++k) g_tail[g * TAIL_WORDS + k] = one.planes[k];
#endif
  }
}
#endif

#if defined(TAILS) && defined(ANISOTROPY)
// What shows where the patch has no page at all: the tail's finest level at each of the footprint's taps.
void sampleTailTaps(Footprint f, out vec3 channels[PLANES]) {
  const float reach = 0.48 / 16.0;  // texels of 16: the tail's border is one of them
  Place root = placeAtLevel(0);
  int count = tapCount(f.ratio);
  for (int k = 0; k < PLANES; ++k) channels[k] = vec3(0.0);
  for (int i = 0; i < count; ++i) {
    vec2 tap = tapAt(i, count, f.ratio);
    vec2 uv = clamp(localAt(root, tapPlace(tap.x, f)), -reach, 1.0 + reach);
    for (int g = 0; g < TAIL_GROUPS; ++g) {
      TailTexel one = filterTail(g, tailRank(g, root.node.x), uv, 0);
      for (int k = 0; k < TAIL_WORDS; ++k) channels[g * TAIL_WORDS + k] += one.planes[k] * (tap.y / f.ratio);
    }
  }
}
#endif

void filterNode(uvec4 entry, uint index, vec2 local, out vec3 channels[PLANES]) {
  vec2 p = local * float(kPagePx) + float(kPageBorderPx);
#ifdef NO_BORDERS
  p = clamp(p, vec2(float(kPageBorderPx) + 0.5), vec2(float(kPageBorderPx + kPagePx) - 0.5));
#endif
  uvec4 extra = uvec4(0u);
#if PLANES > RV_PLANES_IN_ENTRY
  ivec2 at = ivec2(index & ((1u << u_table_shape.y) - 1u), index >> u_table_shape.y);
  extra = texelFetch(u_table_extra, at, 0);
#endif
  for (int k = 0; k < PLANES; ++k) {
#if PLANES > RV_PLANES_IN_ENTRY + RV_PLANES_IN_EXTRA
    // The slots of further planes are in texels below, as many rows as the table has.
    if (k > RV_PLANES_IN_ENTRY && (k - RV_PLANES_IN_ENTRY) % RV_PLANES_IN_EXTRA == 0) {
      at.y += int((u_table_shape.x + 1u) >> u_table_shape.y);
      extra = texelFetch(u_table_extra, at, 0);
    }
#endif
    channels[k] = filterPage(slotOfPlane(k, entry, extra), p);
  }
}

// The channels at uv, from the resident node of `place`; a new page blends in.
void samplePage(Place place, uvec4 entry, uint index, vec2 uv, out vec3 channels[PLANES]) {
  filterNode(entry, index, localAt(place, uv), channels);
#ifdef FADE
  uint birth = entry.w >> 16u;
  float age = birth == 0u ? 1.0 : float((uint(u_fade.x) - birth) & 0xFFFFu) * u_fade.y + u_fade.z;
#ifdef TAILS
  if (age < 1.0) {
    vec3 below[PLANES] = g_tail;
    bool any = place.node.y > 0u;
    if (any) {
      toParent(place);
      any = findResident(place, entry, index);
    }
    if (any) filterNode(entry, index, localAt(place, uv), below);
    for (int k = 0; k < PLANES; ++k) channels[k] = mix(below[k], channels[k], age);
  }
#else
  if (age < 1.0 && place.node.y > 0u) {
    toParent(place);
    if (findResident(place, entry, index)) {
      vec3 below[PLANES];
      filterNode(entry, index, localAt(place, uv), below);
      for (int k = 0; k < PLANES; ++k) channels[k] = mix(below[k], channels[k], age);
    }
  }
#endif
#endif
}

#ifdef ANISOTROPY
// The taps along the footprint. What a page's border covers shares the fragment's look-up, other taps have their own.
void sampleTaps(Place wanted, Place place, uvec4 entry, uint index, Footprint f, out vec3 channels[PLANES]) {
  const float reach = (float(kPageBorderPx) - 0.5) / float(kPagePx);
  int count = tapCount(f.ratio);
  for (int k = 0; k < PLANES; ++k) channels[k] = vec3(0.0);
  for (int i = 0; i < count; ++i) {
    vec2 tap = tapAt(i, count, f.ratio);
    vec2 uv = tapPlace(tap.x, f);
    vec3 one[PLANES];
    vec2 local = localAt(place, uv);
#ifdef ONE_LOOKUP
    samplePage(place, entry, index, uvAt(place, clamp(local, -reach, 1.0 + reach)), one);
#else
    if (min(local.x, local.y) >= -reach && max(local.x, local.y) < 1.0 + reach) {
      samplePage(place, entry, index, uv, one);
    } else {
      Place own = wanted;
      uvec4 own_entry;
      uint own_index;
      toNodeAt(uv, own);
      if (findResident(own, own_entry, own_index)) {
#ifdef MESH
        uv = uvAt(own, clamp(localAt(own, uv), -reach, 1.0 + reach));
#endif
        samplePage(own, own_entry, own_index, uv, one);
      } else {
#ifdef TAILS
        one = g_tail;
#else
        for (int k = 0; k < PLANES; ++k) one[k] = vec3(128.0);
#endif
      }
    }
#endif
    for (int k = 0; k < PLANES; ++k) channels[k] += one[k] * (tap.y / f.ratio);
  }
}
#endif

#ifdef DENSE
// What the virtual texture is compared with: the same filters on plain mip-mapped textures, a layer a plane, of one
// whole patch.
uniform sampler2DArray u_dense;

vec3 filterDense(int plane, int level, vec2 p) {
  int mip = u_artwork.x - level, last = (kPagePx << level) - 1;
#if defined(NEAREST)
  return texelFetch(u_dense, ivec3(clamp(ivec2(p), ivec2(0), ivec2(last)), plane), mip).rgb * 255.0;
#elif defined(FAST_FILTER)
  return textureLod(u_dense, vec3(p / float(last + 1), float(plane)), float(mip)).rgb * 255.0;
#else
  vec2 corner = floor(p - 0.5);
  vec2 f = p - 0.5 - corner;
  ivec2 low = max(ivec2(corner), ivec2(0)), high = min(ivec2(corner) + 1, ivec2(last));
  vec3 c00 = texelFetch(u_dense, ivec3(low, plane), mip).rgb;
  vec3 c10 = texelFetch(u_dense, ivec3(high.x, low.y, plane), mip).rgb;
  vec3 c01 = texelFetch(u_dense, ivec3(low.x, high.y, plane), mip).rgb;
  vec3 c11 = texelFetch(u_dense, ivec3(high, plane), mip).rgb;
  vec3 top = c00 + (c10 - c00) * f.x;
  vec3 bottom = c01 + (c11 - c01) * f.x;
  return (top + (bottom - top) * f.y) * 255.0;
#endif
}

int sampleLevel(Place wanted, out vec3 channels[PLANES]) {
  int level = int(wanted.node.y);
  vec2 p = (vec2(v_node.zw) + v_uv) * (powerOfTwo(level - int(v_node.y)) * float(kPagePx));
  for (int k = 0; k < PLANES; ++k) channels[k] = filterDense(k, level, p);
  return level;
}
#else

// The channels at a node, or at its nearest resident ancestor; answers with the level found (-1: none; the tail, or a
// neutral grey).
#ifdef ANISOTROPY
int sampleLevel(Place wanted, Footprint f, out vec3 channels[PLANES]) {
#else
int sampleLevel(Place wanted, out vec3 channels[PLANES]) {
#endif
  Place place = wanted;
  uvec4 entry;
  uint index;
  if (!findResident(place, entry, index)) {
#if defined(TAILS) && defined(ANISOTROPY)
    sampleTailTaps(f, channels);
#elif defined(TAILS)
    channels = g_tail;
#else
    for (int k = 0; k < PLANES; ++k) channels[k] = vec3(128.0);
#endif
    return -1;
  }
#ifdef ANISOTROPY
  sampleTaps(wanted, place, entry, index, f, channels);
#else
  samplePage(place, entry, index, v_uv, channels);
#endif
  return int(place.node.y);
}
#endif

#if defined(SHADOWS) && SHADING != RV_SHADING_ALBEDO_NORMAL
// What is left of a colour that the light has made, where only a share of the light arrives.
float shadeOf(float light) { return pow(kAmbientShare + (1.0 - kAmbientShare) * light, 1.0 / kDisplayGamma); }
#endif

#define CHANNEL(plane, channel) channels[plane][channel]
// As it is stored, above its offset.
#define STORED(plane, channel, k) (CHANNEL(plane, channel) - u_coefficients[k].y)

#if SHADING == RV_SHADING_ALBEDO_NORMAL
// Lambert's law, shown on a display. share: of the light.
vec3 underLight(vec3 channels[PLANES], vec3 light, float share) {
  float lit = max(dot(channels[1] / kNormalUnit - 1.0, light), 0.0) * share;
  return channels[0] * pow(min(kAmbientShare + (1.0 - kAmbientShare) * lit, 1.0), 1.0 / kDisplayGamma);
}
#endif

#include EYE_FILES
#include LIGHT_FILES
#ifndef NORMALS_OUT
#include SHADING_FILES
#include OCCLUSION_FILES
#endif
#if !defined(LIGHTS) && !defined(SHADING_FILES)
vec3 shade(vec3 channels[PLANES]) {
#if SHADING == RV_SHADING_COLOUR
  return channels[0];
#elif SHADING == RV_SHADING_LUMINANCE
#define TERM(plane, channel, k, c) luminance += STORED(plane, channel, k) * u_coefficients[k].x * u_coefficients[k].z;
  float luminance = 0.0;
  TERMS
  return vec3(COLOUR) * (luminance / 255.0);
#elif SHADING == RV_SHADING_COLOURS
#define TERM(plane, channel, k, c) sum[c] += STORED(plane, channel, k) * (u_coefficients[k].x * u_coefficients[k].z);
  vec3 sum = vec3(0.0);
  TERMS
  return sum;
#elif SHADING == RV_SHADING_ALBEDO_NORMAL
#ifdef SHADOWS
  return underLight(channels, u_light, texelFetch(u_light_share, ivec2(gl_FragCoord.xy), 0).r);
#else
  return underLight(channels, u_light, 1.0);
#endif
#endif
}
#endif
#include GLOSS_FILES

#ifdef EFFECT_FILES
// What effects know of a pixel beside its colour and the surface's v_...: texture levels, 0 the root's.
struct Shaded {
  int wanted, found;  // found: -1: none
};

vec3 levelTint(int level) {
  float hue = fract(float(level) * 0.381966);
  return clamp(abs(fract(vec3(hue) + vec3(0.0, 2.0 / 3.0, 1.0 / 3.0)) * 6.0 - 3.0) - 1.0, 0.0, 1.0);
}

// Of a pixel, in units of a node of this level: what lines over the picture are drawn by.
vec2 pixelIn(int level, float lod) { return vec2(exp2(lod) / (float(kPagePx) * powerOfTwo(u_artwork.x - level))); }

#include EFFECT_FILES
#endif

void main() {
  loadSurface(ivec2(gl_FragCoord.xy));
  vec3 channels[PLANES];
#ifdef NO_PAGES
  int fine = 0, found = -1;
  channels[0] = vec3(0.0);
#else
#ifdef ANISOTROPY
  Footprint footprint;
  float lod = virtualTextureLod(footprint);
#define SAMPLE_LEVEL(place, out_channels) sampleLevel(place, footprint, out_channels)
#else
  float lod = virtualTextureLod();
#define SAMPLE_LEVEL(place, out_channels) sampleLevel(place, out_channels)
#endif
#ifdef TAILS
  float beyond = lod - float(u_artwork.x);
#ifdef ANISOTROPY
  loadTail(max(beyond, v_lod + u_lod_bias - float(u_artwork.x)));  // one tap: as wide as the footprint is long
#else
  loadTail(beyond);
#endif
  lod = min(lod, float(u_artwork.x));
#endif
#ifdef TAILS_ONLY
  int fine = 0, found = -1;
  channels = g_tail;
#elif defined(TRILINEAR)
  float base = min(floor(lod), float(u_artwork.x));
  float blend = lod - base;
  int fine = u_artwork.x - int(base);
  Place place = placeAtLevel(fine);
  int found = SAMPLE_LEVEL(place, channels);
  if (blend > 0.0 && fine > 0) {
    toParent(place);
    vec3 coarse[PLANES];
    SAMPLE_LEVEL(place, coarse);
    for (int k = 0; k < PLANES; ++k) channels[k] += (coarse[k] - channels[k]) * blend;
  }
#else
  int fine = u_artwork.x - int(floor(lod + 0.5));
  Place place = placeAtLevel(fine);
  int found = SAMPLE_LEVEL(place, channels);
#endif
#if defined(TAILS) && !defined(TAILS_ONLY)
#ifdef TRILINEAR
  float share = tailShare(beyond);
#else
  float share = step(0.5, tailShare(beyond));
#endif
  if (share == 1.0) found = -1;
  for (int k = 0; k < PLANES; ++k) channels[k] += (g_tail[k] - channels[k]) * share;
#endif
#endif
#ifdef TWO_SIDED
  if (v_from_behind) channels[1] = 2.0 * kNormalUnit - channels[1];
#endif
#ifdef NORMALS_OUT
  o_normal = uvec4(floatBitsToUint(channels[0] / kNormalUnit - 1.0), 0u);
#else
  vec3 colour = shade(channels) / 255.0;
#if defined(SHADOWS) && SHADING != RV_SHADING_ALBEDO_NORMAL && !defined(LIGHTS)
  colour *= shadeOf(texelFetch(u_light_share, ivec2(gl_FragCoord.xy), 0).r);
#endif
#ifdef GLOSS_FILES
  colour = glossed(colour, channels);
#endif
#ifdef OCCLUSION_FILES
  colour = occluded(colour);
#endif
#ifdef EFFECT_FILES
  Shaded at = Shaded(fine, found);
#endif
#ifdef TONE_EFFECTS
  TONE_EFFECTS
#endif
  colour = clamp(colour, 0.0, 1.0);
#ifdef OVERLAY_EFFECT
  OVERLAY_EFFECT
#endif
  o_colour = vec4(colour, 1.0);
#endif
}
