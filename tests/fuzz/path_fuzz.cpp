// A camera path as `compare --path` reads it.
#include "tests/fuzz/fuzz_file.h"
#include "tools/compare/compare_path.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace relievo;
  FlatDomain domain;
  domain.width_px = 400, domain.height_px = 300, domain.mm_per_px = 0.1;
  domain.texture_depth = FlatDomain::depthFor(400, 300);
  auto cameras = compareCameras(fuzz::folder().put("path.json", {data, size}), 0, domain, 640, 480);
  if (!cameras) {
    fuzz::requireExplained(cameras.error());
    return 0;
  }
  fuzz::require(!cameras->empty(), "a path without cameras");
  for (const CompareCamera& c : *cameras) fuzz::require(c.now.distance_mm > 0, "a camera at no distance");
  return 0;
}
