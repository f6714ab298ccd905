// gloss.h - highlights of a glossy surface under the scene's lights, simulated beside what was measured: the microfacet
// lobe GGX (Walter, Marschner, Li, Torrance 2007, Microfacet Models for Refraction) with Smith's height-correlated
// shadowing (Heitz 2014, Understanding the Masking-Shadowing Function, eq. 99) and Schlick's Fresnel term (1994).
//
// For a normal n, the unit vectors l towards the light and v towards the viewer, and h halfway between them:
//   a = roughness^2
//   D = a^2 / (pi ((n.h)^2 (a^2 - 1) + 1)^2)
//   V = 1 / (2 (n.l sqrt((n.v)^2 (1 - a^2) + a^2) + n.v sqrt((n.l)^2 (1 - a^2) + a^2)))
//   F = reflectance + (1 - reflectance) (1 - h.v)^5
//   highlight = pi D V F n.l
// pi, so that a light that shows a white matt surface as 1 is of the same brightness in both. Each light's highlight,
// times its intensity, colour, falloff and the share of it that the surface does not hide, is added in linear light:
//   colour = encode(decode(C) + sum over lights of arriving_i share_i highlight_i)
// C, what the artwork shows under them, is left as it is: over a PTM, which has its own gloss already, this is more of
// it. The viewer is at the eye, in orthographic pictures far away along the line of sight.
//
// Normals are those that light scans and images with relief. PTMs have none: theirs are fitted to the drawn relief, a
// plane to the places of 5 x 5 pixels, so that nothing finer than the geometry glitters; without relief there is no
// gloss.
//
// Pure; double precision; highlight() and glossed() are the CPU references of shaders/gloss.glsl.
#pragma once

#include <vector>

#include <glm/glm.hpp>

#include "src/render/picture_target.h"

namespace relievo {

inline constexpr double kLeastRoughness = 0.05;  // smoother ones are smaller than a pixel's share of directions

struct Gloss {
  double reflectance = 0;  // of light from straight ahead, 0..1; varnish: 0.04; 0: none
  double roughness = 0.3;  // kLeastRoughness: a mirror, nearly; 1: as good as matt
  bool isOn() const { return reflectance > 0; }
  friend bool operator==(const Gloss&, const Gloss&) = default;
};

// Unit vectors. 0 where the light or the viewer is behind the surface.
double highlight(const Gloss& gloss, const glm::dvec3& normal, const glm::dvec3& light, const glm::dvec3& viewer);
// Display-encoded colour of a place with the highlights' sum, in linear light, on it; not clamped.
glm::dvec3 glossed(const glm::dvec3& colour, const glm::dvec3& highlights);

std::vector<NamedUniform> glossUniforms(const Gloss& gloss);  // of gloss.glsl

}  // namespace relievo
