// ptm.h - .ptm files (Hewlett-Packard, versions 1.1 and 1.2): header, banded reading, writing.
// Formats read: RGB, LRGB, LUM, JPEG_RGB, JPEG_LRGB (inverted planes, motion vectors, side information). LUT and JPEGLS
// variants are refused by name (kUnsupported). A malformed file gets one Error with file, offset, expected and found;
// no size taken from a file reaches an allocation before it was checked against the file's length. Uncompressed files
// are read in rectangles straight from the file, whatever their size; JPEG variants (whose sides JPEG limits to 65,500)
// are decoded once, on opening, if they fit the memory budget.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <string>

#include "src/base/result.h"
#include "texturing/package/raster_source.h"

namespace relievo {

enum class PtmFormat { kRgb, kLrgb, kLum, kJpegRgb, kJpegLrgb };

struct PtmHeader {
  PtmFormat format = PtmFormat::kLrgb;
  int version_minor = 2;  // 1.1 or 1.2
  int64_t width = 0, height = 0;
  std::array<double, 6> scale{};
  std::array<int, 6> bias{};
  uint64_t data_offset = 0;
};

Result<PtmHeader> readPtmHeader(const std::string& path);

struct PtmOpenOptions {
  uint64_t memory_budget_bytes = uint64_t{512} << 20;  // for decoded JPEG variants
  bool hash = true;                                    // digest of the file for the provenance
};
// As a texture source in the engine's channel order (basis.h), rows top first. LUM becomes an RGB PTM (ptm_reader.cpp
// says how).
Result<std::unique_ptr<TextureSource>> openPtm(const std::string& path, const PtmOpenOptions& options = {});

// Streams a source (basis kPtmLrgb or kPtmRgb, to match) into an uncompressed .ptm, in bands. Interruptible.
Result<void> writePtm(const std::string& path, const TextureSource& source,
                      const std::atomic<bool>* interrupted = nullptr);

}  // namespace relievo
