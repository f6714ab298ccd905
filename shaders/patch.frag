// patch.frag - the shading pass: filtered channels from the page cache, evaluated under the light (C++ twin: texturing/basis.h).
// PLANES: texture planes read; BASIS: 0 colour, 1 LRGB PTM, 2 RGB PTM.
#include "texture_lookup.glsl"

uniform vec4 u_coefficients[6];  // x: scale, y: bias of coefficient k; z: basis function k under the light
uniform vec2 u_fade;             // frame time in 1/64 s; 1 / (fade time in 1/64 s)

out vec4 o_colour;

#ifdef WIREFRAME
void main() { o_colour = vec4(0.05, 0.9, 0.55, 1.0); }
#else

int slotOfPlane(int plane, uvec4 entry, uvec4 extra) {
  uint pair = plane < 2 ? entry.z : plane == 2 ? entry.w : plane < 5 ? extra.x : plane < 7 ? extra.y : extra.z;
  bool high = plane == 1 || plane == 4 || plane == 6;
  return int(high ? pair >> 16u : pair & 0xFFFFu);
}

// Bilinear at p, in texels of the slot, border included; channels 0..255.
vec3 filterPage(int slot, vec2 p) {
  ivec3 origin = slotOrigin(slot);
#ifdef FAST_FILTER
  float size = float(kPageFullPx * kSlotsPerSide);
  return textureLod(u_pool, vec3((vec2(origin.xy) + p) / size, float(origin.z)), 0.0).rgb * 255.0;
#else
  vec2 corner = floor(p - 0.5);
  vec2 f = p - 0.5 - corner;
  ivec3 at = origin + ivec3(ivec2(corner), 0);
  vec3 c00 = texelFetch(u_pool, at, 0).rgb;
  vec3 c10 = texelFetch(u_pool, at + ivec3(1, 0, 0), 0).rgb;
  vec3 c01 = texelFetch(u_pool, at + ivec3(0, 1, 0), 0).rgb;
  vec3 c11 = texelFetch(u_pool, at + ivec3(1, 1, 0), 0).rgb;
  vec3 top = c00 + (c10 - c00) * f.x;
  vec3 bottom = c01 + (c11 - c01) * f.x;
  return (top + (bottom - top) * f.y) * 255.0;
#endif
}

void filterNode(uvec4 entry, uint index, vec2 local, out vec3 channels[PLANES]) {
  vec2 p = local * float(kPagePx) + float(kPageBorderPx);
#ifdef NO_BORDERS
  p = clamp(p, vec2(float(kPageBorderPx) + 0.5), vec2(float(kPageBorderPx + kPagePx) - 0.5));
#endif
  uvec4 extra = uvec4(0u);
#if PLANES > 3
  extra = texelFetch(u_table_extra, ivec2(index & ((1u << u_table_shape.y) - 1u), index >> u_table_shape.y), 0);
#endif
  for (int k = 0; k < PLANES; ++k) channels[k] = filterPage(slotOfPlane(k, entry, extra), p);
}

// The channels at a level, or at the nearest resident ancestor; answers with the level found (-1: none, a neutral grey).
int sampleLevel(int wanted, out vec3 channels[PLANES]) {
  for (int level = wanted; level >= 0; --level) {
    vec2 local;
    uvec4 entry;
    uint index;
    uvec4 node = nodeAtLevel(level, local);
    if (!findNode(node, entry, index)) continue;
    filterNode(entry, index, local, channels);
#ifdef FADE
    float age = float((uint(u_fade.x) - (entry.w >> 16u)) & 0xFFFFu) * u_fade.y;
    if (age < 1.0 && level > 0) {
      for (int coarser = level - 1; coarser >= 0; --coarser) {
        vec3 below[PLANES];
        node = nodeAtLevel(coarser, local);
        if (!findNode(node, entry, index)) continue;
        filterNode(entry, index, local, below);
        for (int k = 0; k < PLANES; ++k) channels[k] = mix(below[k], channels[k], age);
        break;
      }
    }
#endif
    return level;
  }
  for (int k = 0; k < PLANES; ++k) channels[k] = vec3(128.0);
  return -1;
}

vec3 shade(vec3 channels[PLANES]) {
#if BASIS == 0
  return channels[0];
#elif BASIS == 1
  float luminance = 0.0;
  for (int k = 0; k < 3; ++k) {
    luminance += (channels[0][k] - u_coefficients[k].y) * u_coefficients[k].x * u_coefficients[k].z;
    luminance += (channels[1][k] - u_coefficients[k + 3].y) * u_coefficients[k + 3].x * u_coefficients[k + 3].z;
  }
  return channels[2] * (luminance / 255.0);
#else
  vec3 sum = vec3(0.0);
  for (int k = 0; k < 6; ++k) sum += (channels[k] - u_coefficients[k].y) * (u_coefficients[k].x * u_coefficients[k].z);
  return sum;
#endif
}

vec3 levelTint(int level) {
  float hue = fract(float(level) * 0.381966);
  return clamp(abs(fract(vec3(hue) + vec3(0.0, 2.0 / 3.0, 1.0 / 3.0)) * 6.0 - 3.0) - 1.0, 0.0, 1.0);
}

void main() {
  float lod = virtualTextureLod();
  vec3 channels[PLANES];
#ifdef TRILINEAR
  float base = min(floor(lod), float(u_depth.x));
  float blend = lod - base;
  int fine = u_depth.x - int(base);
  int found = sampleLevel(fine, channels);
  if (blend > 0.0 && fine > 0) {
    vec3 coarse[PLANES];
    sampleLevel(fine - 1, coarse);
    for (int k = 0; k < PLANES; ++k) channels[k] += (coarse[k] - channels[k]) * blend;
  }
#else
  int fine = u_depth.x - int(floor(lod + 0.5));
  int found = sampleLevel(fine, channels);
#endif
  vec3 colour = clamp(shade(channels) / 255.0, 0.0, 1.0);
#ifdef SHOW_PAGES
  vec2 local;
  nodeAtLevel(max(found, 0), local);
  vec2 from_edge = min(local, 1.0 - local) / max(fwidth(local), vec2(1e-6));
  colour = mix(colour, levelTint(found), 0.3);
  if (min(from_edge.x, from_edge.y) < 1.0) colour = found < fine ? vec3(1.0, 0.1, 0.1) : vec3(0.0);
#endif
#ifdef SHOW_LOD
  colour = mix(colour, levelTint(int(v_node.y)), 0.25 + 0.07 * float(v_grid_level));
  vec2 edge = min(v_uv, 1.0 - v_uv) / max(fwidth(v_uv), vec2(1e-6));
  if (min(edge.x, edge.y) < 1.0) colour = vec3(0.0);
#endif
  o_colour = vec4(colour, 1.0);
}
#endif
