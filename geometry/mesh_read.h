// mesh_read.h - a scan's file into a triangle mesh, diagnosed and, where that is safe, repaired.
// PLY (ASCII, binary of both byte orders), OBJ with materials, STL, OFF. Safe for untrusted files: nothing is allocated that the
// file's length does not allow for.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "geometry/tri_mesh.h"
#include "src/base/result.h"

namespace relievo {

struct MeshReadOptions {
  double mm_per_unit = 1.0;
  std::function<void(double /*0..1*/)> progress;
  const std::atomic<bool>* interrupted = nullptr;
};

// One kind of finding: how often, where (the first few places, mm in the scan's coordinates), and what was done about it.
struct MeshFinding {
  std::string what;                     // "non-manifold edges"
  uint64_t count = 0;
  std::vector<glm::dvec3> places_mm;    // at most 8
  std::string done;                     // "split into sheets"; empty: left as it is (open borders)
};
struct MeshDiagnosis {
  uint64_t vertices_read = 0, triangles_read = 0;  // polygons count as the triangles that they are cut into
  uint64_t vertices = 0, triangles = 0;            // after repair
  uint64_t pieces = 0, border_loops = 0;
  glm::dvec3 min_mm{0}, max_mm{0};                 // of the bounding box, in the scan's coordinates
  std::vector<MeshFinding> findings;
};

struct LoadedMesh {
  TriMesh mesh;
  MeshDiagnosis diagnosis;
};
Result<LoadedMesh> readMesh(const std::string& path, const MeshReadOptions& options = {});
// The same for triangles from elsewhere (tests, generators): diagnosis and repair. name is what errors name.
Result<LoadedMesh> repairMesh(TriMesh mesh, const std::string& name);

}  // namespace relievo
