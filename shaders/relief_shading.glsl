// relief_shading.glsl - the relief's slope, curvature or depth by a scale of colours, in the place of the artwork's
// colour and light (CPU reference: shadedColour() of src/engine/effects/relief_shading.h). Of a flat artwork the page
// holds a number of 16 bits (texturing/stream/relief_normals.h). MESH: of a scan SHADING_SLOPE takes the stored normal,
// SHADING_DEPTH (without any page) the pixel's place, and SHADING_CURVATURE places and normals of pixels around it.
// x, y: the place on the scale is x value + y; z: depth of no surface; w: radius, mm
uniform vec4 u_shading;
uniform vec4 u_shading_colours[RV_SHADING_STOPS];  // sRGB
#ifdef MESH
uniform vec4 u_shading_up;  // the unit vector; w: the eye's height along it, mm
#ifndef SHADING_SLOPE
uniform sampler2D u_kept_depth;  // of the surface buffer: its own texture is the depth buffer while this is drawn

vec3 eyePlace(vec2 pixel, float depth) { return placeAtDepth(pixel / vec2(textureSize(u_kept_depth, 0)), depth); }
#include CURVATURE_FILES
#endif
#endif

float shadedValue(vec3 channels[PLANES]) {
#if !defined(MESH)
  return 256.0 * channels[0].r + channels[0].g;
#elif defined(SHADING_DEPTH)
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  vec3 place = eyePlace(vec2(pixel) + 0.5, texelFetch(u_kept_depth, pixel, 0).r);
  return dot(place, u_shading_up.xyz) + u_shading_up.w;
#elif defined(SHADING_CURVATURE)
  return scanCurvature();
#else
  vec3 normal = channels[0] / kNormalUnit - 1.0;
  // Of the cosine alone small angles would be lost in rounding.
  return degrees(atan(length(cross(normal, u_shading_up.xyz)), dot(normal, u_shading_up.xyz)));
#endif
}

vec3 shade(vec3 channels[PLANES]) {
  float at = clamp(shadedValue(channels) * u_shading.x + u_shading.y, 0.0, 1.0) * float(RV_SHADING_STOPS - 1);
  int stop = min(int(at), RV_SHADING_STOPS - 2);
  return mix(u_shading_colours[stop].rgb, u_shading_colours[stop + 1].rgb, at - float(stop)) * 255.0;
}
