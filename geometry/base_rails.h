// base_rails.h - lines on a scan that the sides of its base mesh follow: its borders, and long creases (edges of a slab, of a plinth).
// Every rail runs from one fixed vertex to another, or back to the same.
#pragma once

#include <cstdint>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/base_reduce.h"
#include "geometry/base_topology.h"

namespace relievo {

struct Rail {
  std::vector<glm::dvec3> points;
  std::vector<double> at;  // of each point: the length up to it
  bool border = false;
  double length() const { return at.back(); }
  glm::dvec3 point(double along) const;
};

// A border loop of the scan: its vertices (of the scan's surface) and their places.
struct BorderLine {
  std::vector<uint32_t> vertices;
  std::vector<glm::vec3> points;
};

// A step along a rail from a vertex to the next.
struct RailStep {
  uint32_t to = kNoIndex;  // vertex
  uint32_t rail = kNoIndex;
  double along = 0;        // of the vertex that the step leaves
};

struct Rails {
  std::vector<Rail> rails;
  std::vector<std::vector<RailStep>> steps;  // of a vertex of the reduced surface; two, but at fixed vertices
  std::vector<uint8_t> fixed;                // where rails meet, end, or turn sharply
};

// The borders in full detail, as the scan has them; the creases of the reduced surface. Lengths in units of the scan's diagonal.
// Where a surface is rough all over, it has no creases.
Rails findRails(const std::vector<BorderLine>& scan_borders, const Reduced& reduced);

}  // namespace relievo
