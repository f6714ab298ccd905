// lights.glsl - several, near or coloured lights in the place of a white one that is far away (CPU reference:
// litColour() of src/engine/effects/lights.h, whose head states the sum). LIGHTS: how many there are, those that are
// far away first; NEAR_LIGHTS: how many of them are near, if any. BASIS_FILES: of a linear basis the file that computes
// its functions, for near lights.
#include "srgb.glsl"

// xyz: the unit vector towards a light that is far away; w: 1. Of a near one where it is, mm from the eye; w: the
// square of the distance at which its intensity is as stated.
uniform vec4 u_lights[LIGHTS];
uniform vec4 u_light_colours[LIGHTS];  // linear, times the intensity
#ifdef COEFFICIENTS
uniform vec4 u_light_functions[COEFFICIENTS];  // of function k under the lights that are far away, a component each
#endif
#ifdef NEAR_LIGHTS
uniform sampler2D u_kept_depth;  // of the surface buffer: its own texture is the depth buffer while this is drawn
#include BASIS_FILES
const int kFarLights = LIGHTS - NEAR_LIGHTS;
#else
const int kFarLights = LIGHTS;
#endif

// Of each light at this pixel; after findLights().
vec3 g_towards[LIGHTS];
vec3 g_arriving[LIGHTS];  // linear

void findLights() {
  for (int i = 0; i < LIGHTS; ++i) {
    g_towards[i] = u_lights[i].xyz;
    g_arriving[i] = u_light_colours[i].rgb;
  }
#ifdef NEAR_LIGHTS
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec2 at = (vec2(pixel) + 0.5) / vec2(textureSize(u_kept_depth, 0));
  vec3 place = placeAtDepth(at, texelFetch(u_kept_depth, pixel, 0).r);
  for (int i = kFarLights; i < LIGHTS; ++i) {
    vec3 way = u_lights[i].xyz - place;
    float square = dot(way, way), reference = u_lights[i].w;
    g_towards[i] = square > 0.0 ? way * inversesqrt(square) : vec3(0.0, 0.0, 1.0);
    g_arriving[i] *= reference / max(square, kNearestOfReference * kNearestOfReference * reference);
  }
#endif
}

#ifdef COEFFICIENTS
void findFunctions(out vec4 functions[COEFFICIENTS]) {
  for (int k = 0; k < COEFFICIENTS; ++k) functions[k] = u_light_functions[k];
#ifdef NEAR_LIGHTS
  for (int i = kFarLights; i < LIGHTS; ++i) {
    float under[COEFFICIENTS];
    basisFunctions(g_towards[i], under);
    for (int k = 0; k < COEFFICIENTS; ++k) functions[k][i] = under[k];
  }
#endif
}
#endif

vec3 shade(vec3 channels[PLANES]) {
  findLights();
  vec4 share = vec4(1.0);  // of each light
#ifdef SHADOWS
  share = texelFetch(u_light_share, ivec2(gl_FragCoord.xy), 0);
#endif
#if SHADING == RV_SHADING_LUMINANCE
#define TERM(plane, channel, k, c) luminance += (STORED(plane, channel, k) * u_coefficients[k].x) * functions[k];
  vec4 functions[COEFFICIENTS];
  findFunctions(functions);
  vec4 luminance = vec4(0.0);
  TERMS
#elif SHADING == RV_SHADING_COLOURS
#define TERM(plane, channel, k, c) sum[c] += (STORED(plane, channel, k) * u_coefficients[k].x) * functions[k];
  vec4 functions[COEFFICIENTS];
  findFunctions(functions);
  vec4 sum[3];
  for (int c = 0; c < 3; ++c) sum[c] = vec4(0.0);
  TERMS
#endif
  vec3 light = vec3(0.0);
  for (int i = 0; i < LIGHTS; ++i) {
#if SHADING == RV_SHADING_LUMINANCE
    vec3 colour = vec3(COLOUR) * (luminance[i] / 255.0);
#elif SHADING == RV_SHADING_COLOURS
    vec3 colour = vec3(sum[0][i], sum[1][i], sum[2][i]);
#else
    vec3 colour = underLight(channels, g_towards[i], share[i]);
#endif
#if defined(SHADOWS) && SHADING != RV_SHADING_ALBEDO_NORMAL
    colour *= shadeOf(share[i]);
#endif
    light += linearFromSrgb(max(colour, 0.0) / 255.0) * g_arriving[i];
  }
  return srgbFromLinear(light) * 255.0;
}
