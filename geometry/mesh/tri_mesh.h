// tri_mesh.h - a triangle mesh as scans bring it, after diagnosis and repair (mesh_read.h): every index in range, every
// number finite, every edge shared by at most two triangles, no degenerate triangle.
// Lengths named _mm are millimetres; of a mesh read with MeshReadOptions::keep_units they are the file's units, and so
// is all that is computed from it. `build` works so, and converts what it writes: a unit then changes no decision.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <glm/glm.hpp>

namespace relievo {

inline constexpr size_t kPaletteColumns = 16384;  // as wide as an image may be
inline constexpr uint16_t kNoImage = 0xFFFF;

// What texture coordinates belong to: an image in a file of its own, one inside the mesh's file, or a palette.
struct MeshImage {
  std::string path;                                   // that a material names; or empty
  std::shared_ptr<const std::vector<uint8_t>> bytes;  // an image's file that lies inside the mesh's own; or none
  // sRGB; an image of the colours of materials or faces: of one row, or of rows of kPaletteColumns; or empty
  std::vector<glm::u8vec3> palette;
  bool repeats = false;  // beyond 0..1; otherwise its border goes on
  glm::vec3 tint{1};     // in linear light, by which its material multiplies it
};

struct TriMesh {
  glm::dvec3 origin_mm{0};              // of the positions: near the mesh, so that floats lose nothing at 10^7 mm
  std::vector<glm::vec3> positions_mm;  // from the origin
  std::vector<std::array<uint32_t, 3>> triangles;   // counter-clockwise seen from outside
  std::vector<glm::u8vec3> colours;                 // sRGB, a vertex; or empty
  std::vector<std::array<glm::vec2, 3>> corner_uv;  // a triangle; (0, 0) is the image's lower left corner; or empty
  std::vector<MeshImage> images;                    // fewer than kNoImage; none without texture coordinates
  bool texture_repeats = false;                     // beyond 0..1, of an image from elsewhere in the place of these
  std::vector<uint16_t>
      image_of;  // a triangle: its image, or kNoImage: its vertices' colours; empty: all show the first
};

}  // namespace relievo
