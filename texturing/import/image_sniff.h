// image_sniff.h - what must be known of an image file before OpenImageIO opens it, and what every error about a damaged
// image says.
// Trust: files come from anywhere. Nothing is read beyond the file's size, and no size that a header claims is
// allocated. Errors: kIo where the disk does not give the bytes; kInvalidData with the offset where a header would make
// a library read or allocate beyond what is there. Pure otherwise: any thread.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "src/base/file.h"
#include "src/base/result.h"

namespace relievo {

inline constexpr const char* kDamagedHint = "the file is damaged or cut short; get a whole copy, or write it anew";

// A library's message without line breaks; "no reason given" where it is empty.
std::string oneLine(std::string text);

// Some of OpenImageIO's readers decode all of the image as they open it.
struct Sniffed {
  bool in_parts = false;     // rows or tiles are decoded as they are asked for
  uint64_t whole_bytes = 0;  // else, where the header was understood: what decoding takes
};
// By the file's first bytes: TIFF, OpenEXR, PNG and JPEG; of anything else nothing is known.
Result<Sniffed> sniffImage(const InputFile& file);

// The sample that stands for no height where a TIFF says so: the tag GDAL_NODATA of its first image, a number as text.
// Nothing where there is none, or where the directory is no sound one, which is left to the library to refuse.
Result<std::optional<double>> noDataOf(const InputFile& file);

// The pixels that a header claims; zeros where nothing is known of them.
struct ClaimedPixels {
  int64_t width = 0, height = 0;
  uint64_t pixel_bytes = 0;
  unsigned __int128 bytes() const { return static_cast<unsigned __int128>(width) * height * pixel_bytes; }
};
// Of an OpenEXR file the header (of several the one that claims most); else nothing is looked at.
Result<ClaimedPixels> checkExrHeader(const InputFile& file);
// Of a JPEG, where the markers stand of those segments of metadata that OpenImageIO would read beyond, in ascending
// order; kInvalidData where these are more than 1,024. Else nothing is looked at.
Result<std::vector<uint64_t>> unsafeJpegMarkers(const InputFile& file);

}  // namespace relievo
