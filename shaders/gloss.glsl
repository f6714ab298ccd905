// gloss.glsl - highlights of a glossy surface (CPU reference: highlight() and glossed() of src/engine/effects/gloss.h,
// whose head states the formula and where normals come from). After shade(), whose lights these are.
#include "srgb.glsl"

uniform vec4 u_gloss;  // reflectance; the fourth power of the roughness; -; -
#ifndef NEAR_LIGHTS
uniform sampler2D u_kept_depth;  // of the surface buffer: its own texture is the depth buffer while this is drawn
#endif

bool glossPlace(ivec2 pixel, out vec3 place) {
  ivec2 size = textureSize(u_kept_depth, 0);
  pixel = clamp(pixel, ivec2(0), size - 1);
  float depth = texelFetch(u_kept_depth, pixel, 0).r;
  place = placeAtDepth((vec2(pixel) + 0.5) / vec2(size), depth);
  return depth > 0.0 && depth < 1.0;
}

#if SHADING != RV_SHADING_ALBEDO_NORMAL
// By least squares from the differences of places on opposite sides of the pixel. One side alone that is seen counts
// for nothing.
vec3 fittedNormal(ivec2 pixel) {
  vec3 right = vec3(0.0), up = vec3(0.0);
  float xx = 0.0, xy = 0.0, yy = 0.0;
  for (int k = 0; k < 12; ++k) {  // half of 5 x 5 without the middle
    ivec2 step = ivec2(k % 5 - 2, 2 - k / 5);
    vec3 there, opposite;
    bool both = glossPlace(pixel + step, there);
    both = glossPlace(pixel - step, opposite) && both;
    if (!both) continue;
    vec2 s = vec2(step);
    right += s.x * (there - opposite);
    up += s.y * (there - opposite);
    xx += s.x * s.x;
    xy += s.x * s.y;
    yy += s.y * s.y;
  }
  vec3 normal = cross(right * yy - up * xy, up * xx - right * xy);
  float size = dot(normal, normal);
  return size > 0.0 ? normal * inversesqrt(size) : vec3(0.0);
}
#endif

float highlight(vec3 normal, vec3 light, vec3 viewer) {
  float nl = dot(normal, light), nv = dot(normal, viewer);
  if (nl <= 0.0 || nv <= 0.0) return 0.0;
  vec3 way = light + viewer;
  vec3 between = way * inversesqrt(max(dot(way, way), 1e-12));
  // Of 1 - (n.h)^2, the square of the sine, directly: near the highlight's middle nothing of it is lost in rounding.
  vec3 aside = cross(normal, between);
  float hv = max(dot(between, viewer), 0.0), a2 = u_gloss.y;
  float spread = a2 + (1.0 - a2) * dot(aside, aside);
  float visible = 0.5 / (nl * sqrt(nv * nv * (1.0 - a2) + a2) + nv * sqrt(nl * nl * (1.0 - a2) + a2));
  float fresnel = u_gloss.x + (1.0 - u_gloss.x) * pow(1.0 - min(hv, 1.0), 5.0);
  return dot(normal, between) > 0.0 ? a2 / (spread * spread) * visible * fresnel * nl : 0.0;
}

vec3 glossed(vec3 colour, vec3 channels[PLANES]) {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec3 place;
  glossPlace(pixel, place);
  vec3 viewer = normalize(wayToViewer(place));
#if SHADING == RV_SHADING_ALBEDO_NORMAL
  vec3 normal = normalize(channels[1] / kNormalUnit - 1.0);
#else
  vec3 normal = fittedNormal(pixel);
#endif
  vec4 share = vec4(1.0);
#ifdef SHADOWS
  share = texelFetch(u_light_share, pixel, 0);
#endif
#ifdef LIGHTS
  vec3 light = vec3(0.0);
  for (int i = 0; i < LIGHTS; ++i)
    light += g_arriving[i] * (highlight(normal, g_towards[i], viewer) * share[i]);
#else
  vec3 light = vec3(highlight(normal, u_light, viewer) * share.r);
#endif
  return srgbFromLinear(linearFromSrgb(max(colour, 0.0)) + light);
}
