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

// An image in a file of its own, or in one that lies inside the mesh's; or none.
struct ImageFile {
  std::string path;  // that a material names; or empty
  std::shared_ptr<const std::vector<uint8_t>> bytes;
  bool isThere() const { return !path.empty() || bytes; }
  bool operator==(const ImageFile&) const = default;
};
// A map of normals in tangent space (src/artwork/tangent_frames.h): byte b for b / 127.5 - 1, x to the right in the
// image, y upwards, as a rule, z out of the surface.
struct NormalMap {
  enum class Y : uint8_t { kUnknown, kUpwards, kDownwards };
  ImageFile file;
  float scale = 1;            // of x and y
  bool may_be_bumps = false;  // a material only says that there are bumps: it may be a map of heights instead
  Y y = Y::kUnknown;
  bool operator==(const NormalMap&) const = default;
};
// What texture coordinates belong to: an image's file, a palette, or neither: white.
struct MeshImage {
  ImageFile file;
  // sRGB; an image of the colours of materials or faces: of one row, or of rows of kPaletteColumns; or empty
  std::vector<glm::u8vec3> palette;
  bool repeats = false;  // beyond 0..1; otherwise its border goes on
  glm::vec3 tint{1};     // in linear light, by which its material multiplies it
  NormalMap normals;     // without a file there are none; it repeats as the image does
  bool operator==(const MeshImage&) const = default;
};

struct TriMesh {
  glm::dvec3 origin_mm{0};              // of the positions: near the mesh, so that floats lose nothing at 10^7 mm
  std::vector<glm::vec3> positions_mm;  // from the origin
  std::vector<std::array<uint32_t, 3>> triangles;   // counter-clockwise seen from outside
  std::vector<glm::u8vec3> colours;                 // sRGB, a vertex; or empty
  std::vector<std::array<glm::vec2, 3>> corner_uv;  // a triangle; (0, 0) is the image's lower left corner; or empty
  // A triangle, of length 1: those that a map of normals counts from, as the file has them. Or 0: it has none there, or
  // one that points inwards. Or empty.
  std::vector<std::array<glm::vec3, 3>> corner_normals;
  std::vector<MeshImage> images;  // fewer than kNoImage; none without texture coordinates
  bool texture_repeats = false;   // beyond 0..1, of an image from elsewhere in the place of these
  std::vector<uint16_t>
      image_of;  // a triangle: its image, or kNoImage: its vertices' colours; empty: all show the first
};

}  // namespace relievo
