// mesh_read.h - a scan's file into a triangle mesh, diagnosed and, where that is safe, repaired.
// PLY (ASCII, binary of both byte orders), OBJ with materials, STL, OFF, glTF 2.0 (.gltf, .glb; meshes that Draco or
// meshoptimizer compressed, too). Safe for untrusted files: nothing is allocated that the file's length does not allow
// for. Deterministic.
//
// Of several images (materials of OBJ and glTF, numbers of faces in PLY) each triangle names its own. What has none has
// its vertices' colours, else its material's.
//
// Repaired: duplicate vertices (the same float from the origin; the first one's colour stays), degenerate and duplicate
// triangles, triangles that run against their piece, closed pieces inside out (but for small holes, too), edges of more
// than two triangles and vertices of several fans (split; the pieces stay where they are), pieces with one side only
// (cut open), T-junctions (vertices of an open border within 1e-7 of the diagonal of another open edge), vertices of no
// triangle.
//
// Dropped: triangles of vertices that are no numbers, where these are at most one in a hundred.
// Dropped, with the area that is lost: of more than 2,048 pieces the smallest, up to 1 % of the area; pieces that have
// no area.
//
// Reported only: open borders, isolated pieces.
//
// Refused (kInvalidData): more numbers that are not finite, of STL and of texture coordinates any, coordinates beyond
// 10^12 mm, indices out of range, counts that the file cannot hold.
//
// In a repaired mesh all triangles of a piece run alike, closed pieces outwards, and the triangles around a vertex form
// one fan.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "geometry/mesh/tri_mesh.h"
#include "src/base/result.h"

namespace relievo {

// A base of larger patches has some four of them a piece, or more: for more pieces than this they would be missing
// where the scan's area is. Its own triangles are no more, and show all of these pieces.
inline constexpr size_t kManyPieces = 2048;

struct MeshReadOptions {
  std::optional<double> mm_per_unit;  // nothing: as the file states (glTF: metres; comments of the others), else mm
  glm::dmat3 turn{1};                 // applied to the file's coordinates (turnOf); nothing else is turned
  // The mesh stays in the file's units: what is computed from it does not depend on them. The diagnosis is in mm.
  bool keep_units = false;
  std::function<void(double /*0..1*/)> progress;
  const std::atomic<bool>* interrupted = nullptr;
  bool allow_outside =
      false;  // material files beyond the mesh's folder are read, too; else one that is named there is kInvalidData
  // Texture coordinates are kept for one image from elsewhere, whatever images and colours the file's materials have.
  bool other_image = false;
  // Triangles: of a mesh with more of them, and with more than kManyPieces, the smallest pieces are dropped.
  size_t all_pieces_up_to = 0;
  int workers = 0;  // threads; 0: one a core. The mesh and its diagnosis are the same for any number
};

// One kind of finding: how often, where (the first few places, mm in the scan's coordinates), and what was done about
// it.
struct MeshFinding {
  std::string what;  // "non-manifold edges"
  uint64_t count = 0;
  std::vector<glm::dvec3> places_mm;  // at most 8
  std::string done;                   // "split into sheets"; empty: left as it is (open borders)
};
struct MeshDiagnosis {
  uint64_t vertices_read = 0, triangles_read = 0;  // polygons count as the triangles that they are cut into
  uint64_t vertices = 0, triangles = 0;            // after repair
  uint64_t pieces = 0, border_loops = 0;
  glm::dvec3 min_mm{0}, max_mm{0};  // of the bounding box, in the scan's coordinates
  std::vector<MeshFinding> findings;
};

struct LoadedMesh {
  TriMesh mesh;
  MeshDiagnosis diagnosis;
  std::vector<std::string> named_files;  // files that the mesh names (images, materials, buffers), used or not
  std::string unit = "mm";               // that the file states: mm, cm, m or in
  double mm_per_unit = 1;                // by which it was read
};
// The millimetres of a unit (mm, cm, m, in); 0 if it is none.
double mmPerUnit(const std::string& unit);
// The axis `up` ('x', 'y', 'z') of the file becomes y, then the mesh is turned about x, y and z, one after the other.
// Multiples of 90 degrees are exact.
glm::dmat3 turnOf(char up, const glm::dvec3& degrees);
// Paths of the result: from the mesh file's folder if they are relative.
Result<LoadedMesh> readMesh(const std::string& path, const MeshReadOptions& options = {});
// A file that a mesh names must lie in the mesh's folder or below it, wherever links lead: whoever sends a mesh shall
// not choose which of the receiver's files are opened. kInvalidData names it; `what` says what it is: "the material
// file". path: as LoadedMesh has it.
Result<void> checkBesideMesh(const std::string& mesh, const std::string& path, const char* what);
// The same for triangles from elsewhere (tests, generators): diagnosis and repair. name is what errors name.
Result<LoadedMesh> repairMesh(TriMesh mesh, const std::string& name, int workers = 0);

// Which of TriMesh's promises a mesh breaks, or nothing; also vertices that no triangle names. For tests: sorts all
// edges.
std::string triMeshProblem(const TriMesh& mesh);

}  // namespace relievo
