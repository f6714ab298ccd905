// mesh_export.h - an artwork's surface as one welded mesh in a file (mesh_format.h). All patches have 2^level cells a
// side; within an error, over a base mesh, each has as many as it needs, and they meet as they are drawn
// (patch_levels.h). Cells are cut along (0,0)-(1,1): at the finest level these are the triangles that a package states
// (texturing/PACKAGE.md). Vertices on sides and corners that patches share are one vertex, known by the base mesh's
// corners and sides, not by their coordinates: what is closed stays closed, and there are no T-junctions.
//
// Normals are those of the exported triangles around a vertex, weighted by their areas; colours are the albedo, or the
// pixel under light from the front.
//
// Memory: rows of pages for each worker, and of a base mesh 20 bytes for each vertex on a side; refused (kUsage) beyond
// memory_bytes, and for Draco the mesh as a whole. The file is written piece by piece and appears when it is whole. The
// same bytes for any number of workers.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "src/base/result.h"
#include "texturing/package/package.h"

namespace relievo {

struct MeshExportOptions {
  std::string output;        // its suffix decides on the format
  std::optional<int> level;  // nothing: full detail, or the coarsest levels within error_mm
  std::optional<double> error_mm;
  bool base = false;   // the base mesh alone, with the normals of its corners
  int draco_bits = 0;  // of a .glb: compressed by Draco, positions of so many bits a coordinate (glb_draco.h); 0: not
  int maps_px = 0;     // of a scan's .glb: colours and normals in images of at most so many px a side (textured_glb.h)
  uint64_t memory_bytes = uint64_t{768} << 20;
  int workers = 0;  // 0: one per core
  std::function<void(double /*0..1*/)> progress;
  const std::atomic<bool>* interrupted = nullptr;
};
struct MeshExportReport {
  int least_level = 0, level = 0;  // of the patches with the fewest and the most cells
  uint64_t vertices = 0, faces = 0, file_bytes = 0;
  bool quads = false;
  std::optional<double> error_mm;          // upper bound of the distance from full detail; nothing: not known
  std::optional<double> coarser_error_mm;  // the same of the next coarser level of all patches
  bool from_origin = false;                // positions in the file count from origin_mm
  glm::dvec3 origin_mm{0};
  std::optional<std::array<int, 2>> maps_px;  // the images' width and height
  std::optional<double> draco_step;  // positions are rounded to multiples of it, mm (px where no size is known)
};
Result<MeshExportReport> exportMesh(std::shared_ptr<const Package> package, const MeshExportOptions& options);

}  // namespace relievo
