// image_io.h - images through OpenImageIO (PNGs are written through libpng), behind this file alone: colour and height
// sources to read, PNG, TIFF, EXR and JPEG to write.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "src/base/result.h"
#include "texturing/package/raster_source.h"

namespace relievo {

// What reading an image may take. All of it is checked against what the file's header claims before OpenImageIO
// allocates anything for pixels.
struct ImageReadOptions {
  // Decoded rows are kept, so that reading in rectangles does not decode them again and again: at most a third of the
  // budget; half of it where the rows of one rectangle, at the image's full width, do not fit.
  uint64_t cache_bytes = uint64_t{256} << 20;
  uint64_t memory_budget_bytes = uint64_t{768} << 20;  // --memory-mib
  uint64_t max_tile_bytes =
      0;  // of one decoded tile (--max-tile-mib); 0: an eighth of the budget, as decoding holds it several times
  uint64_t max_decoded_bytes =
      0;  // of an image that only decodes as a whole (--max-image-mib); 0: a third of the budget
  // The best that formats in use pack is about 1:1000 (deflate), lossy ones some more on a blank image: a file that
  // claims more pixels than this times its own length (and 1 MiB) is damaged. --max-packing.
  uint64_t max_packing = 20000;
  bool orient = true;  // as the file's EXIF orientation says; texture coordinates mean the pixels as they are stored
  uint64_t tileLimit() const { return max_tile_bytes ? max_tile_bytes : memory_budget_bytes / 8; }
  uint64_t decodedLimit() const { return max_decoded_bytes ? max_decoded_bytes : memory_budget_bytes / 3; }
};

// What an image file says of itself beside its pixels.
struct ImageFacts {
  int64_t width_px = 0, height_px = 0;  // as it is to be shown (options.orient)
  int channels = 0;
  bool alpha = false;
  double tag_mm_per_px = 0;  // by its resolution tag (TIFF, EXIF, PNG): a scanner's is the object's size, a camera's
                             // means nothing. 0: none
  std::string tag;           // as the file has it: "300 dpi"
};
Result<ImageFacts> readImageFacts(const std::string& path, const ImageReadOptions& options = {});

// 8-bit sRGB colour (grey is spread to three channels, alpha ignored: ImageFacts tells; 16 bit rounded to 8). Read in
// bands or tiles where the format allows it; one scanline cache, thread-safe.
Result<std::unique_ptr<TextureSource>> openColourImage(const std::string& path, const ImageReadOptions& options = {});
// Any single-channel image, 8/16/32-bit unsigned or float; floats are read once on opening, for their range.
// Refused with the place of the first: heights that are not finite, and the sample that a TIFF's tag GDAL_NODATA calls
// none; and floats beyond 1e18 mm. Integer samples 0..max map to range_mm; float samples are mm, or, where range_mm is
// given, 0..1 map to it (samples beyond 0..1 are mm all the same: a usage error). Integer without range_mm is a usage
// error.
Result<std::unique_ptr<HeightSource>> openHeightImage(const std::string& path,
                                                      std::optional<std::pair<double, double>> range_mm,
                                                      const ImageReadOptions& options = {});

// The format that a file's name asks for: .png, .tif or .tiff, .exr, .jpg or .jpeg; "-" (standard output) is a PNG.
// kUsage of any other.
enum class ImageFormat { kPng, kTiff, kExr, kJpeg };
Result<ImageFormat> imageFormatOf(const std::string& path);

// Writes an sRGB picture in the format that its name asks for: pixel-interleaved, rows top first. PNG and TIFF keep the
// bytes; EXR has linear light as half floats (premultiplied by alpha, if there is alpha); JPEG, of 1 or 3 channels, has
// quality 95 and whole chroma. mm_per_px above 0: the size at which other programs print it, as exactly as the format
// can say. The file takes its place (src/base/file.h) only after it was decoded again and, but for JPEG, found to have
// the very same samples.
Result<void> writeImage(const std::string& path, int width, int height, int channels, std::span<const uint8_t> pixels,
                        double mm_per_px = 0);
// The bytes of such a PNG.
Result<std::vector<uint8_t>> encodePng(int width, int height, int channels, std::span<const uint8_t> pixels,
                                       double mm_per_px = 0);
// Decoded to 8-bit, as many channels as there are, as they are stored; no more bytes than options.decodedLimit().
struct Image8 {
  int width = 0, height = 0, channels = 0;
  std::vector<uint8_t> pixels;
};
Result<Image8> readImage8(const std::string& path, const ImageReadOptions& options = {});

// Bands of a TIFF, PNG, EXR (half floats or floats) or JPEG, by extension: appendRows until all rows are there, then
// commit, which decodes it again as writeImage does. mm_per_px: as writeImage has it.
enum class SampleType { kUint8, kUint16, kFloat, kHalf };
class ImageWriter {
 public:
  static Result<std::unique_ptr<ImageWriter>> create(const std::string& path, int64_t width, int64_t height,
                                                     int channels, SampleType type, double mm_per_px = 0);
  virtual ~ImageWriter() = default;
  virtual Result<void> appendRows(int64_t rows, const void* samples) = 0;  // interleaved
  virtual Result<void> commit() = 0;
};

}  // namespace relievo
