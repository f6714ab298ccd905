// Prints digests of what the dispatched loops make: packages of each encoding, and a scan's heights. tests/portable/run
// compares what different machines print. FOLDER is for the packages.
#include <cstdio>
#include <string>

#include "geometry/bake/mesh_bake.h"
#include "geometry/remesh/base_domain.h"
#include "src/base/file.h"
#include "tests/geometry/mesh_shapes.h"
#include "tests/texturing/package_fixture.h"
#include "texturing/package/package_builder.h"

using namespace relievo;

int main(int argc, char** argv) {
  if (argc != 2) return std::fprintf(stderr, "usage: portable_bytes FOLDER\n"), 1;
  const std::string path = std::string(argv[1]) + "/bytes.relievo";
  for (Basis basis : {Basis::kPtmLrgb, Basis::kPtmRgb, Basis::kColour}) {
    for (const char* encoding : {"lossless", "q5", "bc1", "bc7"}) {
      const testing_support::NoisyTexture texture(700, 500, basis, 7);
      const testing_support::NoisyHeights heights(700, 500, 8);
      BuildOptions options{.output = path};
      options.coefficients = options.colour = *parseEncoding(encoding, 90);
      auto built = buildPackage(texture, &heights, options);
      auto digest = hashFile(path);
      if (!built || !digest)
        return std::fprintf(stderr, "%s\n", (built ? digest.error() : built.error()).text().c_str()), 1;
      std::printf("package, basis %d, %s: %s\n", static_cast<int>(basis), encoding, digest->c_str());
    }
  }
  std::remove(path.c_str());
  const TriMesh sphere = sphereMesh(10, 60);
  auto base = makeBaseMesh(sphere, {.patches = 24});
  if (!base) return std::fprintf(stderr, "%s\n", base.error().text().c_str()), 1;
  auto baked = MeshBake::create(sphere, {}, *base, {});
  if (!baked) return std::fprintf(stderr, "%s\n", baked.error().text().c_str()), 1;
  std::vector<uint16_t> heights(((size_t{kPagePx} << (*baked)->reliefDepth()) + 1) *
                                ((size_t{kPagePx} << (*baked)->reliefDepth()) + 1));
  uint64_t digest = 0;
  for (uint32_t patch = 0; patch < base->patches.size(); ++patch) {
    if (auto done = (*baked)->heights(patch, heights); !done) return 1;
    for (uint16_t h : heights) digest = testing_support::mixBits(digest + h + 1);
  }
  std::printf("scan, %zu patches: %016llx\n", base->patches.size(), static_cast<unsigned long long>(digest));
  return 0;
}
