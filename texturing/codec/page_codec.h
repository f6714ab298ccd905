// page_codec.h - one page <-> its encoded bytes. Encoded pages say themselves how (page_encoding.h): a decoder needs no
// more.
//
// Shapes. A texture page is 3 channels x kPageFullPx^2 bytes, channel-major, rows top first, border included.
// A relief page is kReliefSamples^2 uint16, rows top first, no border (its last row and column are its neighbour's
// first). Decoding writes *slot texels*: kPageFullPx^2 RGBA8, what the page pool uploads. Texture: R G B 255. Relief:
// sample (i, j) at texel (i, j): R = high byte, G = low byte, B = A = 0; texels beyond 128 are 0. Safe for untrusted
// bytes: any input decodes or fails with an Error, and never reads or writes out of bounds. The same bytes decode to
// the same texels on every machine. Where neighbouring pages overlap they decode to the same texels, lossy or not:
// blocks of 4 or 8 texels begin at the same places in both. Pages in fewer texels (coarse_page.h) and hierarchical ones
// (texel_code.h) do so within their tolerance.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "src/artwork/patch_domain.h"
#include "src/base/result.h"
#include "texturing/codec/coarse_page.h"
#include "texturing/codec/page_encoding.h"
#include "texturing/codec/page_id.h"

namespace relievo {

inline constexpr size_t kTexturePageBytes = size_t{3} * kPageFullPx * kPageFullPx;
inline constexpr size_t kReliefPageSamples = size_t{kReliefSamples} * kReliefSamples;
inline constexpr size_t kMaxEncodedPageBytes = kTexturePageBytes + 16;       // no encoding makes a page larger
inline constexpr size_t kSlotBytes = size_t{4} * kPageFullPx * kPageFullPx;  // 73,984

// The samples of a relief page's slot texels.
void reliefSamples(std::span<const uint8_t> texels /* kSlotBytes */,
                   std::span<uint16_t> samples /* kReliefPageSamples */);

// A page of ReliefEncoding::kOverTail is encoded without the heights of its tail, and decoded with them: 17 x 17, rows
// of v from 0.
inline constexpr size_t kTailHeightsBytes = size_t{2} * 17 * 17;
bool needsTailHeights(std::span<const uint8_t> stored);
std::vector<uint8_t> emptyReliefPage();  // needs them, and nothing else
void addTailHeights(std::span<const uint16_t> heights, std::vector<uint8_t>& stored);

// A texture page that is not compressed at all: for pages that are made when they are read.
std::vector<uint8_t> plainTexturePage(std::span<const uint8_t> channels /* kTexturePageBytes */);

// One per thread: holds the compressor's context and scratch memory.
class PageEncoder {
 public:
  explicit PageEncoder(int zstd_level);
  ~PageEncoder();
  PageEncoder(const PageEncoder&) = delete;
  PageEncoder& operator=(const PageEncoder&) = delete;
  // Valid until the next call. A page whose JPEG would be larger than its channels is stored losslessly.
  std::span<const uint8_t> encodeTexture(std::span<const uint8_t> channels /* kTexturePageBytes */,
                                         PageEncoding encoding = {});
  // Losslessly, or in fewer texels or, if `hierarchical`, as texel_code.h says, where these take fewer bytes and show
  // the page within the tolerances.
  std::span<const uint8_t> encodeTextureWithin(std::span<const uint8_t> channels /* kTexturePageBytes */,
                                               std::span<const ChannelTolerance> tolerances /* 3 */, bool hierarchical);
  std::span<const uint8_t> encodeRelief(std::span<const uint16_t> samples /* kReliefPageSamples */,
                                        ReliefEncoding encoding = ReliefEncoding::kRows);

 private:
  struct Impl;
  Impl* impl_;
};

// One per thread.
class PageDecoder {
 public:
  PageDecoder();
  ~PageDecoder();
  PageDecoder(const PageDecoder&) = delete;
  PageDecoder& operator=(const PageDecoder&) = delete;
  Result<void> decodeTexture(std::span<const uint8_t> encoded, std::span<uint8_t> channels /* kTexturePageBytes */);
  Result<void> decodeRelief(std::span<const uint8_t> encoded, std::span<uint16_t> samples /* kReliefPageSamples */);
  // To slot texels, by the plane's kind (not for kResolved).
  Result<void> decodeToSlot(Plane plane, std::span<const uint8_t> encoded, std::span<uint8_t> texels /* kSlotBytes */);
  // A page of blocks as a GPU takes them (page_block_codec.h); pages of any other codec are an Error.
  Result<void> decodeToBlocks(PageCodec codec, std::span<const uint8_t> encoded,
                              std::span<uint8_t> blocks /* pageBlockBytes(codec) */);

 private:
  struct Impl;
  Impl* impl_;
};

}  // namespace relievo
