// A .ptm file of any layout.
#include <vector>

#include "tests/fuzz/fuzz_file.h"
#include "texturing/import/ptm.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace relievo;
  const std::string path = fuzz::folder().put("artwork.ptm", {data, size});
  if (auto header = readPtmHeader(path); !header) fuzz::requireExplained(header.error());
  auto source = openPtm(path, {.memory_budget_bytes = uint64_t{64} << 20});
  if (!source) {
    fuzz::requireExplained(source.error());
    return 0;
  }
  // The first and the last texels, whatever the size.
  const TextureSource& s = **source;
  const int64_t width = std::min<int64_t>(s.width(), 48), height = std::min<int64_t>(s.height(), 48);
  fuzz::require(width > 0 && height > 0, "an artwork without texels was opened");
  std::vector<uint8_t> texels(static_cast<size_t>(s.format().channels() * width * height));
  for (const Rect& r : {Rect{0, 0, width, height}, Rect{s.width() - width, s.height() - height, width, height}})
    if (auto read = s.read(r, texels); !read) fuzz::requireExplained(read.error());
  return 0;
}
