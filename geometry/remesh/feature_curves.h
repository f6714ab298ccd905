// feature_curves.h - curves on a scan that the sides of its base mesh follow: its borders, and long creases (the edges
// of a slab or a plinth). A feature curve runs from one fixed vertex to another, or back to the same. Units: diagonals
// of the scan.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include <glm/glm.hpp>

namespace relievo {

struct TriangleMesh;  // coarse_mesh.h

struct FeatureCurve {
  std::vector<glm::dvec3> points;
  std::vector<double> arc_lengths;  // for each point, the length of the curve up to it
  bool border = false;
  double length() const { return arc_lengths.back(); }
  glm::dvec3 point(double arc_length) const;
};

// The largest distance of a feature curve from a side between two of its points, as far as heights cannot make up for
// it: the distance from the ruled surface that the normals span along the straight line from a to b.
struct CurveEnd {
  glm::dvec3 point{0}, normal{0};
  double arc_length = 0;
};
double deviationFromSide(const FeatureCurve& curve, const CurveEnd& a, const CurveEnd& b);
// The deviation that a base's borders keep if the number of patches is free and the scan's borders are no rougher.
inline constexpr double kBorderDeviation = 2e-3;

// The allowed deviation for a feature curve and sides of that length: the smallest of tolerance, 2 tolerance, 4
// tolerance, ... that takes at most half as many sides again, since a rough curve cannot be followed closely by long
// sides.
double deviationForSides(const FeatureCurve& curve, double side, double tolerance);

// A border loop of the scan: its vertices (of the scan's surface) and their positions.
struct BorderLoop {
  std::vector<uint32_t> vertices;
  std::vector<glm::vec3> points;
};

// The vertices at which borders turn sharply at the scale of patches, however rough they are. The reduced surface must
// keep them.
std::vector<uint32_t> borderCorners(const std::vector<BorderLoop>& scan_borders);

// Finds the borders, in full detail, and the creases of the reduced surface; a surface that is rough all over has none.
// Marks their half edges and fixed vertices in `reduced`. vertex: for each vertex of `reduced`, its index in the scan.
// min_length_per_node: of connected creases, for each of their ends, forks and sharp turns; shorter ones are roughness.
std::vector<FeatureCurve> findFeatureCurves(const std::vector<BorderLoop>& scan_borders,
                                            std::span<const uint32_t> vertex, double min_length_per_node,
                                            TriangleMesh& reduced);

}  // namespace relievo
