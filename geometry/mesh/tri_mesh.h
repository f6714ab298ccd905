// tri_mesh.h - a triangle mesh as scans bring it, after diagnosis and repair (mesh_read.h): every index in range, every
// number finite, every edge shared by at most two triangles, no degenerate triangle.
// Lengths named _mm are millimetres; of a mesh read with MeshReadOptions::keep_units they are the file's units, and so
// is all that is computed from it. `build` works so, and converts what it writes: a unit then changes no decision.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include <glm/glm.hpp>

namespace relievo {

inline constexpr size_t kPaletteColumns = 16384;  // as wide as an image may be

struct TriMesh {
  glm::dvec3 origin_mm{0};              // of the positions: near the mesh, so that floats lose nothing at 10^7 mm
  std::vector<glm::vec3> positions_mm;  // from the origin
  std::vector<std::array<uint32_t, 3>> triangles;   // counter-clockwise seen from outside
  std::vector<glm::u8vec3> colours;                 // sRGB, a vertex; or empty
  std::vector<std::array<glm::vec2, 3>> corner_uv;  // a triangle; (0, 0) is the image's lower left corner; or empty
  std::string texture_path;                         // the image that the file's material names; or empty
  std::vector<uint8_t> texture_bytes;  // instead of a path, an image's file that lies inside the mesh's own; or empty
  bool texture_repeats = false;        // beyond 0..1; otherwise its border goes on
  // sRGB; instead of a file's, an image of the colours of materials or faces: of one row, or of rows of
  // kPaletteColumns; or empty
  std::vector<glm::u8vec3> palette;
};

}  // namespace relievo
