// ambient_occlusion.h - places of the relief that see little of the sky are shown darker: joints, letters and folds
// stand out, as under light from everywhere (Zhukov, Iones, Kronin 1998, An Ambient Light Illumination Model;
// CloudCompare's and MeshLab's "portion of visible sky", PCV and ambient occlusion).
//
// The share of sky of a place with the normal n is the share of the directions of the hemisphere over n from which it
// is seen, each weighted by the cosine of its angle from n: 1 where nothing stands above the place's own plane. Of a
// flat artwork the sky is what is before its plane (z > 0), so that an endless slope of angle a sees (1 + cos a) / 2 of
// it. Of a scan it is all around. The picture's colour C, of whichever lights or none, becomes
//   encode((1 - strength (1 - share)) decode(C))
// before other effects. It is computed from the drawn surface, as it is exaggerated, and no texture is read: over a PTM
// it comes beside the shade that was photographed.
//
// The sky is taken as so many directions, evenly spread, the same in every run; each has a shadow map, and the pixels'
// normals are those of the drawn triangles (src/render/shadow_pass.h).
//
// Pure; double precision; seenShare() and occluded() are the CPU references of shaders/shadow_sum.frag and
// ambient_occlusion.glsl.
#pragma once

#include <functional>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "src/render/picture_target.h"

namespace relievo {

// Of a settled picture. Of a scan half of them lie behind a place.
inline constexpr int kSkyDirectionsOfFlat = 64, kSkyDirectionsOfScan = 128;

inline constexpr double kUsualOcclusion = 0.8;  // strength, where it is only switched on

struct AmbientOcclusion {
  double strength = 0;  // 0..1; 0: none
  bool isOn() const { return strength > 0; }
  friend bool operator==(const AmbientOcclusion&, const AmbientOcclusion&) = default;
};

// Unit vectors, evenly over the hemisphere of z > 0 of a flat artwork, else over the sphere.
std::vector<glm::dvec3> skyDirections(bool flat, int count);

// The share of sky of a place with this normal, of length 1. seen: from direction k. flat: a direction of `directions`
// stands for its opposite, too, which is dark.
double seenShare(const glm::dvec3& normal, std::span<const glm::dvec3> directions,
                 const std::function<bool(size_t)>& seen, bool flat);
// Display-encoded (sRGB), 1 is white.
glm::dvec3 occluded(const glm::dvec3& colour, double share, double strength);

// Of ambient_occlusion.glsl.
std::vector<NamedUniform> occlusionUniforms(const AmbientOcclusion& occlusion);

}  // namespace relievo
