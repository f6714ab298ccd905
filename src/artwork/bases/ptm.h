// ptm.h - polynomial texture maps (Malzbender, Gelb, Wolters 2001, eq. 4): with (u, v) = (x, y) of the unit vector
// towards the light, L = a0 u^2 + a1 v^2 + a2 u v + a3 u + a4 v + a5.
// LRGB: planes (a0 a1 a2) (a3 a4 a5) (R G B). RGB: plane k holds a_k of red, green and blue.
#pragma once

#include <array>

#include "src/artwork/basis.h"

namespace relievo {

inline constexpr bool isPtm(Basis b) { return b == Basis::kPtmLrgb || b == Basis::kPtmRgb; }

// (u, v) of a light anywhere around a PTM's object, by the unit vector towards it in the frame of its photographs: x
// right, y up, z to the camera. They were lit from the front only: light from behind counts as grazing light from the
// same side.
std::array<double, 2> ptmDirection(double x, double y, double z);

// The six basis functions, in .ptm's order.
inline std::array<double, 6> ptmBasis(double u, double v) { return {u * u, v * v, u * v, u, v, 1.0}; }

// The basis functions under the unit vector towards a light anywhere around the object. A light straight from behind
// has no side. There the functions take their mean over all grazing lights, and they go over to it within
// shader::kBehind of straight behind, so that a rounding error of the direction cannot choose a side.
std::array<double, 6> ptmBasis(const std::array<double, 3>& light);

}  // namespace relievo
