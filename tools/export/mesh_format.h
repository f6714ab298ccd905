// mesh_format.h - the formats that a mesh is exported to: bytes of vertices and faces, in the order in which a file has
// them, so that a mesh of any size is written piece by piece. Pure and const: pieces may be made by several threads.
//
// None is written by OpenMesh. Its writers take a half-edge mesh that is in memory as a whole (about 130 bytes a
// vertex), of float coordinates without an origin, in text with six digits; refuse sides of more than two patches; and
// know no glTF.
//
// A file is head(), then the vertices, then the faces (of STL, the triangles alone), and head() once more over its
// first bytes, when the bounds of what was written are known: its length does not depend on them.
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "src/base/result.h"

namespace relievo {

using ByteBuffer = std::vector<uint8_t>;
static_assert(std::endian::native == std::endian::little, "numbers are written as they lie in memory");

// Appends the value's bytes.
template <class T>
void put(ByteBuffer& out, const T& value) {
  const auto* bytes = reinterpret_cast<const uint8_t*>(&value);
  out.insert(out.end(), bytes, bytes + sizeof value);
}

struct ExportVertex {
  glm::dvec3 position{0};  // from MeshFacts::origin
  glm::vec3 normal{0};     // of length 1
  glm::u8vec3 colour{0};   // sRGB
};

// What a file's head says.
struct MeshFacts {
  uint64_t vertices = 0, faces = 0;
  int corners = 3;  // of a face: 3 or 4
  bool colours = true;
  glm::dvec3 origin{0};
  double extent = 1;          // coordinates from the origin are about as large
  bool size_known = true;     // false: lengths count pixels
  std::string about;          // where it comes from, one line
  glm::vec3 low{0}, high{0};  // bounds of the positions from the origin, in floats
};

class MeshFormat {
 public:
  virtual ~MeshFormat() = default;
  // Faces of four corners; without them quads are cut along their corners 0 and 2.
  virtual bool quads() const = 0;
  // Triangles that name no vertices: triangle() instead of vertex() and face().
  virtual bool soup() const { return false; }
  // Can Draco compress it (glb_draco.h)?
  virtual bool takesDraco() const { return false; }
  // Can it hold images (textured_glb.h)?
  virtual bool holdsMaps() const { return false; }
  // kUsage: what of it the format cannot hold.
  virtual Result<void> check(const std::string& path, const MeshFacts& facts) const;
  virtual ByteBuffer head(const MeshFacts& facts) const = 0;
  virtual void vertex(const MeshFacts&, const ExportVertex&, ByteBuffer&) const {}
  virtual void face(const std::array<uint32_t, 4>& /*corners*/, int /*count*/, ByteBuffer&) const {}
  virtual void triangle(const MeshFacts&, const std::array<glm::dvec3, 3>&, ByteBuffer&) const {}
};

// By the suffix: .ply, .obj, .stl, .off, .glb. kUsage of any other.
Result<std::unique_ptr<MeshFormat>> meshFormatOf(const std::string& path);
// Whether coordinates in floats count from the origin instead of from the scan's own zero: where that zero is so far
// away that a float would lose more than 1/16 of the digits that it has for the mesh itself.
bool countsFromOrigin(const MeshFacts& facts);

}  // namespace relievo
