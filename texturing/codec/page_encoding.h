// page_encoding.h - how a texture plane's pages are stored: losslessly, or smaller and lossy. texturing/ENCODINGS.md
// states accuracy, size and time of each. The relief plane is always exact. Byte layout: texturing/PACKAGE.md.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "src/artwork/basis.h"
#include "src/base/result.h"
#include "texturing/codec/page_id.h"

namespace relievo {

// The numbers stand in packages.
enum class PageCodec : uint8_t {
  kLossless = 0,   // a predictor per channel, then zstd; pages may have fewer texels (coarse_page.h)
  kQuantised = 1,  // the same after rounding each value to the nearest of 2^parameter levels over 0..255
  kJpeg = 2,       // baseline JPEG of quality `parameter`, the three channels as they are
  kJpegYcc = 3,    // the same with the channels as R G B turned into Y Cb Cr, none of them subsampled
  kBc1 = 17,       // S3TC: 4 x 4 texels in 8 bytes
  kBc4 = 20,       // RGTC, each of the three channels by itself: 24 bytes
  kBc5 = 21,  // RGTC, channels 0 and 1 as BC5, channel 2 as BC4: the texels of kBc4 in two textures instead of three
  kBc7 = 23   // BPTC: 16 bytes
};

struct PageEncoding {
  PageCodec codec = PageCodec::kLossless;
  uint8_t parameter = 0;  // quantised: bits, 4..7; JPEG: quality, 1..100; else 0
  friend bool operator==(const PageEncoding&, const PageEncoding&) = default;
};
using PlaneEncodings = std::array<PageEncoding, kMaxTexturePlanes>;

// How relief pages are stored, always exactly.
enum class ReliefEncoding : uint8_t {
  kRows,          // a predictor a page, row by row, then zstd: decodes in a tenth of the time
  kHierarchical,  // level by level, then range coded (relief_code.h): smaller
  kOverTail,      // the same of a patch's root page, without what its tail has
  kBeyondTail     // the same, in no bytes where nothing is left: emptyReliefPage() stands for it
};

inline constexpr int kMinQuantisedBits = 4, kMaxQuantisedBits = 7;

inline constexpr bool isBlockCodec(PageCodec c) { return c >= PageCodec::kBc1; }
// Bytes of a block of 4 x 4 texels; 0 for codecs without blocks.
inline constexpr int blockBytes(PageCodec c) {
  return c == PageCodec::kBc1 ? 8 : c == PageCodec::kBc7 ? 16 : c == PageCodec::kBc4 || c == PageCodec::kBc5 ? 24 : 0;
}

// "lossless", "q6", "jpeg90", "jpeg90-ycc", "bc7".
std::string encodingName(PageEncoding encoding);
// The names above, "q8" for lossless, and "jpeg" for the quality given. A usage error lists what there is.
Result<PageEncoding> parseEncoding(const std::string& name, int jpeg_quality);
// Of a header's bytes: an Error of kind kUnsupported when the codec or its parameter is unknown.
Result<PageEncoding> encodingFromBytes(uint8_t codec, uint8_t parameter);

// Do the plane's three channels hold a colour? (No coefficients, and no normals, which are encoded as coefficients
// are.)
bool isColourPlane(const TextureFormat& format, int plane);
// A build's choice, plane by plane. JPEG of planes whose channels belong to R, G and B goes through Y Cb Cr, which
// decorrelates them; three different coefficients stay as they are.
PlaneEncodings planeEncodings(const TextureFormat& format, PageEncoding coefficients, PageEncoding colour);

}  // namespace relievo
