// shared_vertices.h - the vertices that the patches of a base mesh share, numbered by what they are: corners of the
// base mesh, and places on its sides. Each is there once. x and y count in a patch's own grid.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "src/artwork/base_mesh.h"
#include "tools/export/patch_levels.h"

namespace relievo {

class SharedVertices {
 public:
  // levels: of the patches; those that share a side have the same for it.
  SharedVertices(const BaseMesh& base, std::vector<PatchLevels> levels);
  static uint64_t count(const BaseMesh& base, std::span<const PatchLevels> levels);

  struct Vertex {
    glm::vec3 normal{0};  // the sum over the triangles around it, each twice its area long
    uint16_t height = 0;
    glm::u8vec3 colour{0};
    bool seen = false;
  };
  uint64_t size() const { return vertices_.size(); }
  // Of the vertex (x, y) of a patch, on its border, which is one of its side's.
  uint64_t index(uint32_t patch, uint64_t x, uint64_t y) const;
  const Vertex& operator[](uint64_t i) const { return vertices_[i]; }
  // What one patch has of a vertex: its share of the normal; height and colour are the first patch's. False: another
  // patch has another height there.
  bool add(uint64_t i, const glm::vec3& normal, uint16_t height, const glm::u8vec3& colour);
  // One patch's name for a vertex.
  struct Place {
    uint32_t patch;
    uint64_t x, y;
  };
  Place place(uint64_t i) const;

 private:
  struct SideOf {
    uint32_t patch;
    Side side;
  };
  const BaseMesh& base_;
  const std::vector<PatchLevels> levels_;
  std::vector<uint32_t> corner_index_;               // by corner; kNone: no patch has it
  std::vector<SideOf> corner_of_;                    // by index: a patch and, as its side, the slot
  std::vector<std::array<uint32_t, 4>> side_index_;  // by patch and side
  std::vector<SideOf> side_of_;                      // by index
  std::vector<uint64_t> side_first_;                 // by index, its first vertex; then how many there are
  std::vector<Vertex> vertices_;                     // corners, then side after side from its smaller corner's end
};

}  // namespace relievo
