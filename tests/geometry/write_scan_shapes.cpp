// write_scan_shapes FOLDER [FINER] - writes the shapes of scan_shapes.h as FOLDER/NAME.ply, for tools/bench/scan_bytes.
// FINER: how many times as many cells a side as the tests have [2].
#include <cstdio>
#include <cstdlib>
#include <string>

#include "src/base/file.h"
#include "tests/geometry/mesh_files.h"
#include "tests/geometry/scan_shapes.h"

using namespace relievo;

int main(int argc, char** argv) {
  const int finer = argc > 2 ? std::atoi(argv[2]) : 2;
  if (argc < 2 || argc > 3 || finer < 1 || finer > 16)
    return std::fprintf(stderr, "usage: write_scan_shapes FOLDER [FINER, 1 to 16]\n"), 1;
  for (const ScanShape& shape : kScanShapes) {
    const TriMesh mesh = shape.make(finer);
    test::Sample sample;
    for (const glm::vec3& p : mesh.positions_mm) sample.positions.emplace_back(p);
    sample.triangles = mesh.triangles;
    const std::string path = std::string(argv[1]) + "/" + shape.name + ".ply", bytes = test::plyFile(sample, {});
    if (auto written = writeFile(path, {reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()}); !written)
      return std::fprintf(stderr, "%s\n", written.error().text().c_str()), 2;
    std::printf("%s\n", path.c_str());
  }
  return 0;
}
