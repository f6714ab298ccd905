// build_mesh.h - relievo build --mesh: a scan into a package of patches, stage by stage.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "src/base/result.h"
#include "texturing/import/image_io.h"
#include "texturing/package/package_builder.h"
#include "texturing/package/texture_depths.h"

namespace relievo {

struct MeshBuildArguments {
  std::string mesh;
  std::string texture;      // an image for the mesh's texture coordinates; empty: what the mesh names; "none"
  std::string ptm;          // a PTM for them, in place of an image
  std::string unit = "mm";  // mm, cm, m, in
  uint32_t patches = 0;     // 0: as the shape asks for
  // Within which 99.9 % of the surface is to lie, both ways (geometry/bake/fidelity.h); 0: 3e-4 of the diagonal.
  double tolerance_mm = 0;
  double tolerance_share = 0;     // the same, of the diagonal; 0: not given
  bool strict = false;            // nothing is written where the target is missed
  std::string report, json_file;  // either asks for the distance between scan and patches, too
  bool allow_outside = false;     // material files and images beyond the mesh's folder, if the mesh names them
  ImageReadOptions images;        // limits
  BuildOptions package;           // output, workers, compression, encodings, memory
  char up = 'y';                  // the file's axis that points up: x, y or z
  glm::dvec3 rotate_deg{0};       // and then about x, y and z
  double texture_tolerance = kTextureTolerance;     // BuildOptions::texture_tolerance, in the place of the package's
  bool quiet = false;                               // nothing is said on standard output
  std::vector<std::string>* named_files = nullptr;  // gets the files that the mesh names, there or not
};

// kDifference: the target is missed; the package is written all the same, unless `strict`.
Result<void> buildFromMesh(const MeshBuildArguments& arguments);

}  // namespace relievo
