// shading.h - compiles as C++ and as GLSL: how the channels of an artwork's texture planes become a pixel
// (src/artwork/basis.h), by number, and the constants of those formulas.
#ifdef __cplusplus
#pragma once
namespace relievo::shader {
#define RV_REAL inline constexpr double
#else
#define RV_REAL const float
#endif

#define RV_SHADING_COLOUR 0         // the colour as it is
#define RV_SHADING_LUMINANCE 1      // one sum of coefficients times functions of the light, times a colour
#define RV_SHADING_COLOURS 2        // such a sum for each of red, green and blue
#define RV_SHADING_ALBEDO_NORMAL 3  // Lambert's law on a display

#define RV_DIRECTIONS 4     // of light, whose shadow maps lie in the quarters of one texture
#define RV_SHADING_STOPS 9  // colours of a scale of the relief's slope, curvature or depth

RV_REAL kAmbientShare = 0.04;  // of the light that falls on a scan
RV_REAL kDisplayGamma = 2.2;
RV_REAL kNormalUnit = 127.5;  // a byte b of a normal stands for b / kNormalUnit - 1
// A near light's distance counts as no less than this share of the one at which its intensity is as stated.
RV_REAL kNearestOfReference = 1e-3;
// The sine of the angle between a light and straight behind a PTM, below which light from behind has no side: 1.1
// degrees.
RV_REAL kBehind = 0.02;

#undef RV_REAL
#ifdef __cplusplus
}  // namespace relievo::shader
#endif
