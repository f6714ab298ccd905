// A scan's file; RELIEVO_FUZZ_NAME ends as the format's files do. Of an OBJ what follows a line "#materials" is its
// material file.
#include <string_view>

#include "geometry/scan/mesh_read.h"
#include "tests/fuzz/fuzz_file.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace relievo;
  std::span<const uint8_t> scan(data, size), materials;
  constexpr std::string_view kBreak = "#materials\n";
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  if (const size_t at = text.find(kBreak); at != text.npos)
    materials = scan.subspan(at + kBreak.size()), scan = scan.first(at);
  fuzz::folder().put("scan.mtl", materials);
  auto read = readMesh(fuzz::folder().put(RELIEVO_FUZZ_NAME, scan), {.workers = 1});
  if (!read) {
    fuzz::requireExplained(read.error());
    return 0;
  }
  const std::string problem = triMeshProblem(read->mesh);
  fuzz::require(problem.empty(), "a mesh that was read breaks a promise: " + problem);
  return 0;
}
