// texture_select.h - page requests on the CPU: every texture node that some pixel of a view may want, without
// drawing anything. A node of level l is wanted where the shader's texture LOD (shaders/texture_lookup.glsl) asks for
// level l or a finer one; so the ancestors of a wanted node are wanted too. Perspective and orthographic views. Flat
// artworks: the image of a plane is known exactly, so the answer is exact up to kLodSlack levels and kPixelSlack px
// around each page; a page that covers no pixel's centre is left out. Relief: the surface may have any slope that its
// heights' bounds allow, and the finest level that such a slope may want is asked for. Seen from above that is nearly
// what pixels want; at a slant, up to log2(1 / cos(angle)) levels too fine. Nothing is known of what hides what: hidden
// parts are asked for too. Never misses a page (up to LodView::error_px: the drawn surface is that far off the full
// one), may name too many. Pure: no GL, any thread. Deterministic. Cost: about 0.4 us a node named, flat, 0.6 to 2 us
// with relief; at most 4 kMaxTextureRequests nodes are looked at, those just beyond the view or the wanted level
// included.
#pragma once

#include <vector>

#include <glm/glm.hpp>

#include "geometry/lod/lod.h"
#include "src/artwork/patch_domain.h"

namespace relievo {

inline constexpr size_t kMaxTextureRequests = 65536;  // as many as slots can exist; coarse levels first
inline constexpr double kLodSlack = 1.0 / 256;        // levels: the shader computes in fp32
inline constexpr double kPixelSlack = 1.0 / 128;      // px: rasterisers snap to 1/256 px or finer, vertices are fp32

struct TextureView {
  glm::dmat4 clip_from_world{1.0};
  glm::dvec3 eye_mm{0};
  double pixels_per_radian = 1;  // viewport height in px / (2 tan(fov / 2)); orthographic: pixels per mm
  double near_mm = 1;            // above 0; orthographic: any
  int width_px = 1, height_px = 1;
  double lod_bias = 0;    // levels; as the shader adds it
  bool trilinear = true;  // false: the nearest level alone
  bool relief = true;     // false: the plane of height 0
  double exaggerate = 1;
  double anisotropy = 1;  // above 1: the level follows max(minor, major / anisotropy) of a pixel's footprint
  double error_px = 1;    // of the drawn relief (LodView::error_px)
};

struct TextureRequest {
  NodeId node;
  float priority = 0;  // smallest distance from the view's centre, 0..1 (1: a corner)
};

// Coarse before fine, then near to the centre. A view that is not finite, shows all on a line or a point, or lies in a
// flat artwork's plane gets the roots only.
std::vector<TextureRequest> selectTextureNodes(const FlatDomain& domain, const ReliefOracle& oracle,
                                               const TextureView& view);

}  // namespace relievo
