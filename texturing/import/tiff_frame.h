// tiff_frame.h - what stands before and behind the samples of an uncompressed TIFF (6.0; BigTIFF above 4 GiB).
// The samples lie between in one piece, row by row, in the machine's byte order: a file is written from its first byte
// to its last.
#pragma once

#include <cstdint>
#include <vector>

namespace relievo {

struct TiffFrame {
  int64_t width = 0, height = 0;
  int channels = 1;      // 1 grey, 2 grey and alpha, 3 RGB, 4 RGB and alpha; alpha is not premultiplied
  int sample_bytes = 1;  // 1, 2 or 4
  bool floats = false;
  double px_per_cm = 0;  // 0: no size is said
};

std::vector<uint8_t> tiffHead(const TiffFrame& frame);
std::vector<uint8_t> tiffTail(const TiffFrame& frame);

}  // namespace relievo
