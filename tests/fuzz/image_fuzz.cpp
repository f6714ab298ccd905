// An image through OpenImageIO: the first byte chooses the format by the file's name. Large claims are refused before
// pixels are allocated: beyond 64 bytes of pixels a byte (and 1 MiB), so that no time goes into memory that nothing is
// read into.
#include <array>
#include <vector>

#include "tests/fuzz/fuzz_file.h"
#include "texturing/import/image_io.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace relievo;
  if (size < 2) return 0;
  constexpr std::array kNames{"image.png", "image.tif", "image.jpg", "image.exr"};
  const std::string path = fuzz::folder().put(kNames[data[0] % kNames.size()], {data + 1, size - 1});
  const ImageReadOptions options{.cache_bytes = uint64_t{8} << 20, .max_packing = 64};
  auto edges = [](const auto& source, auto&& read) {
    const int64_t width = std::min<int64_t>(source.width(), 32), height = std::min<int64_t>(source.height(), 32);
    for (const Rect& r :
         {Rect{0, 0, width, height}, Rect{source.width() - width, source.height() - height, width, height}})
      read(r);
  };
  if (auto colour = openColourImage(path, options)) {
    edges(**colour, [&](const Rect& r) {
      std::vector<uint8_t> texels(static_cast<size_t>((*colour)->format().channels() * r.width * r.height));
      if (auto done = (*colour)->read(r, texels); !done) fuzz::requireExplained(done.error());
    });
  } else {
    fuzz::requireExplained(colour.error());
  }
  if (auto heights = openHeightImage(path, std::pair{0.0, 1.0}, options)) {
    edges(**heights, [&](const Rect& r) {
      std::vector<float> mm(static_cast<size_t>(r.width * r.height));
      if (auto done = (*heights)->read(r, mm); !done) fuzz::requireExplained(done.error());
    });
  } else {
    fuzz::requireExplained(heights.error());
  }
  return 0;
}
