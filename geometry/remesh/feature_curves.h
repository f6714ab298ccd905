// feature_curves.h - lines on a scan that the sides of its base mesh follow: its borders, and long creases (edges of a
// slab, of a plinth). Every feature curve runs from one fixed vertex to another, or back to the same.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include <glm/glm.hpp>

namespace relievo {

struct TriangleMesh;  // coarse_mesh.h

struct FeatureCurve {
  std::vector<glm::dvec3> points;
  std::vector<double> at;  // of each point: the length up to it
  bool border = false;
  double length() const { return at.back(); }
  glm::dvec3 point(double along) const;
};

// How far a border side's scan lies from it where heights do not reach: how far the feature curve's points between two
// places lie from the strip that the normals sweep along the straight line from a to b.
struct CurveEnd {
  glm::dvec3 point{0}, normal{0};
  double along = 0;
};
double deviationFromSide(const FeatureCurve& curve, const CurveEnd& a, const CurveEnd& b);
// In diagonals: what borders of bases keep to where the number of patches is free and the scan's borders are no
// rougher.
inline constexpr double kBorderDeviation = 2e-3;

// How far a feature curve must be let stray where it is rougher than sides of that length: the smallest of within, 2
// within, 4 within, ... that takes no more than half as many sides again.
double deviationForSides(const FeatureCurve& curve, double side, double within);

// A border loop of the scan: its vertices (of the scan's surface) and their places.
struct BorderLine {
  std::vector<uint32_t> vertices;
  std::vector<glm::vec3> points;
};

// The vertices at which borders turn sharply at the scale of patches, whatever their roughness: the reduced surface
// must keep them. Lengths in units of the scan's diagonal, here and below.
std::vector<uint32_t> borderCorners(const std::vector<BorderLine>& scan_borders);

// The borders in full detail, as the scan has them; the creases of the reduced surface. Where a surface is rough all
// over, it has no creases. Their steps and fixed vertices are marked in `reduced`; vertex: of the scan that each of its
// vertices is.
std::vector<FeatureCurve> findFeatureCurves(const std::vector<BorderLine>& scan_borders,
                                            std::span<const uint32_t> vertex, TriangleMesh& reduced);

}  // namespace relievo
