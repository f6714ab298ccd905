// ptm_internal.h - what ptm_reader.cpp and ptm_jpeg.cpp share: the parsed header and the decoded planes of JPEG
// variants.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "src/base/file.h"
#include "texturing/import/ptm.h"

namespace relievo::ptm_detail {

// One grey JPEG of a JPEG variant, in the file's order (LRGB: a0..a5 R G B; RGB: a0..a5 of R, then of G, then of B).
struct JpegPlane {
  int transform = 0;  // bit 0: the reference is inverted; bit 1: it is shifted by the motion vector
  int64_t motion_x = 0, motion_y = 0;
  int order = 0;       // decoding step
  int reference = -1;  // plane it is predicted from, or -1
  uint64_t jpeg_bytes = 0, side_bytes = 0;
  uint64_t offset = 0;  // of the JPEG; the side information follows it
};

struct FileHeader {
  PtmHeader header;
  std::vector<JpegPlane> planes;           // JPEG variants only
  std::array<double, 16> colour_matrix{};  // LUM only
};

// Checked against the file's length: every byte the header promises is there.
Result<FileHeader> readFileHeader(const InputFile& file);

// All planes one after the other, width * height bytes each, rows in the file's order (bottom to top).
Result<std::vector<uint8_t>> decodeJpegPlanes(const InputFile& file, const FileHeader& header, uint64_t budget_bytes);

}  // namespace relievo::ptm_detail
