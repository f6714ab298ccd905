// soft_shadows.h - the size of a light, and with it the penumbra of the shadows that it casts.
//
// A light of size_deg is a disc of directions, evenly bright, of that angular diameter (the sun: 0.53 degrees). What
// reaches a place is the share of the disc that the surface does not hide, in the place of the 0 or 1 of a light that
// is a point; Lambert's cosine, or a PTM's functions, stay those of the disc's middle. Of a disc of diameter a behind a
// straight edge at distance d the penumbra is about d a wide. The disc is taken as kLightDirections directions; each
// has a shadow map of its own, and the shares are averaged (src/render/shadow_pass.h). So a penumbra has as many steps.
//
// The directions are a golden lattice, point k of n at ((k + 1/2) / n, k / golden ratio mod 1), mapped to the cone of
// equal solid angles: Vogel 1979 (A Better Way to Construct the Sunflower Head), whose share of any half of the disc is
// within 0.045 of the area's for 64 points. They are taken in the order of the index's bits reversed, so that the first
// of them are spread over the disc, too. The same directions in every run.
//
// A near light of size_mm is a disc that faces the artwork's middle, or a ball of that diameter seen from there: as
// many places on it have a map each, or some (nearShadowViews()).
//
// Pure; double precision.
#pragma once

#include <vector>

#include <glm/glm.hpp>

namespace relievo {

inline constexpr int kLightDirections = 64;  // a power of two, as every number of directions here
inline constexpr double kMaxLightSizeDeg = 90;

// Point k of n of the lattice in the unit square, in the order stated above.
glm::dvec2 latticePoint(int k, int n);

// Towards the disc: unit vectors. light: towards its middle, of length 1.
std::vector<glm::dvec3> discDirections(const glm::dvec3& light, double size_deg, int count = kLightDirections);
// Places on the disc around `place_mm` whose axis is `towards`, of length 1.
std::vector<glm::dvec3> discPlaces(const glm::dvec3& place_mm, const glm::dvec3& towards, double size_mm,
                                   int count = kLightDirections);

}  // namespace relievo
