// image_jpeg.h - a whole image as the JPEG that it came as, by libjpeg-turbo (ITU-T T.81). Of the many kinds those that
// are in use: sequential or progressive, Huffman-coded, 8 bits, grey or three components, in at most kMostJpegScans
// scans. Those of one scan are decoded row by row; others hold six bytes a texel meanwhile. Texels are the same on
// every machine: the inverse DCT and the upsampling are those in whole numbers (JDCT_ISLOW, "fancy").
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "src/base/result.h"

namespace relievo {

inline constexpr int kMostJpegScans = 32;  // encoders make about ten: so many bound the time

// What its decoding needs, without what only describes it (Exif, profiles, comments, thumbnails) and what follows it;
// empty: it is no JPEG of such a kind.
std::vector<uint8_t> plainJpeg(std::span<const uint8_t> file);
// Width and height in texels, as the frame of such a JPEG says; or nothing.
struct JpegSize {
  uint32_t width = 0, height = 0;
};
std::optional<JpegSize> sizeOfPlainJpeg(std::span<const uint8_t> jpeg);

// Safe for untrusted bytes.
class ImageJpegReader {
 public:
  // jpeg outlives the reader. kInvalidData: it is not such a JPEG, of exactly this size; its file is empty.
  static Result<ImageJpegReader> open(std::span<const uint8_t> jpeg, uint32_t width, uint32_t height);
  ImageJpegReader(ImageJpegReader&&) noexcept;
  ~ImageJpegReader();
  // The next rows, from the top: R, G, B. The last ones also say whether the JPEG ends there, without a byte too many.
  Result<void> read(size_t rows, std::span<uint8_t> rgb);

 private:
  ImageJpegReader();
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace relievo
