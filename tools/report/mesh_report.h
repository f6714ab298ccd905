// mesh_report.h - what is told of a scan and of how it was built: the manifest's member "mesh", lines for a terminal,
// and a page of HTML.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "geometry/bake/fidelity.h"
#include "geometry/bake/mesh_bake.h"
#include "geometry/bake/mesh_distance.h"
#include "geometry/scan/mesh_read.h"
#include "src/base/result.h"

namespace relievo {

// The manifest's member "mesh". Deterministic: no times. patches_asked: 0 if no number was asked for.
nlohmann::ordered_json meshJson(const std::string& file, const std::string& unit, const MeshDiagnosis& diagnosis,
                                const BaseMesh& base, const BakeReport& bake, uint32_t patches_asked = 0);
// The same as indented lines; of any JSON, as it may come from a file that somebody else wrote. Empty if it is none of
// ours.
std::string meshText(const nlohmann::ordered_json& mesh);

// How far a build is from a target that it misses, by the worse of both ways: a sentence without its end.
std::string missedTarget(const Fidelity& fidelity);

struct StageCost {
  std::string name;
  double seconds = 0;
  uint64_t peak_bytes = 0;  // resident, while it ran; 0: not known
};
struct MeshBuildResult {
  std::string package;
  nlohmann::ordered_json mesh;  // as above
  Fidelity fidelity;            // its largest distances at places of the scan, in mm
  MeshDistance distance;
  std::vector<StageCost> stages;
  uint64_t pages = 0, package_bytes = 0, relief_bytes = 0;  // the latter: all heights, and the base mesh
  uint64_t triangles_read = 0, vertices = 0;
  // Texture nodes of full trees, and those without pages (BuildOptions::texture_tolerance).
  uint64_t texture_nodes = 0, texture_nodes_left_out = 0;
  uint64_t shown_images = 0, patches_with_images = 0;  // patches that show images, instead of having their texels
  uint64_t normal_maps = 0;                            // of images, whose normals patches have
  double texture_tolerance = 0;
};
nlohmann::ordered_json reportJson(const MeshBuildResult& result);
// One file, with its pictures: the error painted on the scan, from four sides.
Result<void> writeMeshReport(const std::string& path, const TriMesh& scan, const MeshBuildResult& result);

// The picture alone, RGB, rows top first: four views side by side, orthographic, y upwards; from violet, low_mm and
// less, by decades to yellow, high_mm and more.
struct ErrorPicture {
  int width = 0, height = 0;
  std::vector<uint8_t> rgb;
};
ErrorPicture paintError(const TriMesh& scan, const std::vector<float>& vertex_mm, double low_mm, double high_mm,
                        int view_px);

}  // namespace relievo
