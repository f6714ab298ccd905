// tangent_frames.h - the tangent frames that maps of normals count in: at each corner of a triangle the direction in
// which its image's columns follow one another, beside the normal. As MikkTSpace has it (Mikkelsen, "Simulation of
// Wrinkled Surfaces Revisited", 2008, section 3.3), by which most such maps are made: triangles that share a corner
// share its tangent, the mean of their own by their angles there. The same bits on all machines.
// Memory: 40 bytes a triangle, and 84 while they are made.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include <glm/glm.hpp>

namespace relievo {

struct TangentFrame {
  // At the triangle's corners: of length 1, across their normals. All 0: the image has no direction there.
  std::array<glm::vec3, 3> tangent{};
  float hand = 1;  // 1: the map's y lies across normal and tangent, in this order; -1: opposite to that
  bool isKnown() const { return tangent[0] != glm::vec3(0); }
  // The direction of y at a corner whose normal this is.
  glm::vec3 bitangent(const glm::vec3& normal, size_t corner) const {
    return hand * glm::cross(normal, tangent[corner]);
  }
};

struct MappedTriangle {
  std::array<glm::dvec3, 3> position;
  bool clockwise = false;           // seen from outside
  std::array<glm::vec3, 3> normal;  // of length 1, or nearly
  std::array<glm::dvec2, 3> place;  // in the image, to the right and upwards, in any unit
  bool downwards = false;           // the image's normals count y downwards
  // Corners with the same numbers are one: those of vertex, place, image and normal.
  std::array<std::array<uint32_t, 5>, 3> corner;
};

class TangentFrames {
 public:
  void reserve(size_t triangles);
  void add(const MappedTriangle& triangle);
  // A triangle that needs none: its frame is not known.
  void addNone() { frames_.emplace_back(); }
  // Of all triangles, in the order in which they were added.
  std::vector<TangentFrame> finish() &&;

 private:
  struct Corner {
    std::array<uint32_t, 5> is;
    uint32_t at;  // triangle * 3 + corner
  };
  std::vector<TangentFrame> frames_;  // until finish(): tangents as long as they weigh
  std::vector<Corner> corners_;
};

}  // namespace relievo
