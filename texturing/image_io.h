// image_io.h - images through OpenImageIO, behind this file alone: colour and height sources to read, TIFF and PNG to write.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "src/base/result.h"
#include "texturing/raster_source.h"

namespace relievo {

// Decoded rows are kept, so that reading in rectangles does not decode them again and again. The limit grows (to 1 GiB) if
// the rows of one rectangle, at the image's full width, do not fit.
struct ImageReadOptions {
  uint64_t cache_bytes = uint64_t{256} << 20;
};

// 8-bit sRGB colour (grey is spread to three channels, alpha dropped, 16 bit rounded to 8). Read in bands or tiles where the
// format allows it; one scanline cache, thread-safe.
Result<std::unique_ptr<TextureSource>> openColourImage(const std::string& path, const ImageReadOptions& options = {});
// Any single-channel image, 8/16/32-bit unsigned or float; floats are read once on opening, for their range; heights that are
// not finite are refused. Integer samples 0..max map to range_mm; float samples are mm, or map
// 0..1 to range_mm where it is given. Integer without range_mm is a usage error.
Result<std::unique_ptr<HeightSource>> openHeightImage(const std::string& path, std::optional<std::pair<double, double>> range_mm,
                                                      const ImageReadOptions& options = {});

// Pixel-interleaved, rows top first; written beside and renamed. mm_per_px above 0: the size at which other programs print it (in whole pixels
// a metre).
Result<void> writePng(const std::string& path, int width, int height, int channels, std::span<const uint8_t> pixels, double mm_per_px = 0);
// Decoded to 8-bit, as many channels as there are.
struct Image8 { int width = 0, height = 0, channels = 0; std::vector<uint8_t> pixels; };
Result<Image8> readImage8(const std::string& path);

// Bands of a TIFF (or JPEG by extension): appendRows until all rows are there, then commit.
enum class SampleType { kUint8, kUint16, kFloat };
class ImageWriter {
 public:
  static Result<std::unique_ptr<ImageWriter>> create(const std::string& path, int64_t width, int64_t height, int channels, SampleType type);
  virtual ~ImageWriter() = default;
  virtual Result<void> appendRows(int64_t rows, const void* samples) = 0;  // interleaved
  virtual Result<void> commit() = 0;
};

}  // namespace relievo
