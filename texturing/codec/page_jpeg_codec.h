// page_jpeg_codec.h - a texture page as a baseline JPEG of three components without subsampling, by libjpeg-turbo.
// Every DCT coefficient is rounded to multiples of one step (jpegStep): a table made for eyes gives coefficients of a
// PTM three times the largest error at the same size (texturing/ENCODINGS.md has the figures). Decoding is safe for
// untrusted bytes: what is not such a JPEG of exactly a page's size, whole and without a byte too many, is an Error;
// the work is bounded by the page's size (no progressive or arithmetic coding, one scan).
#pragma once

#include <cstdint>
#include <span>

#include "src/base/result.h"

namespace relievo {

int jpegStep(int quality);  // 1..100 -> 255..1; 90 -> 4, 80 -> 8

class JpegPageEncoder {
 public:
  JpegPageEncoder();
  ~JpegPageEncoder();
  JpegPageEncoder(const JpegPageEncoder&) = delete;
  JpegPageEncoder& operator=(const JpegPageEncoder&) = delete;
  // texels: kPageFullPx^2 RGBA8, alpha ignored. The number of bytes written, or 0 when `out` is too small.
  size_t encode(const uint8_t* texels, int quality, bool ycc, std::span<uint8_t> out);

 private:
  struct Impl;
  Impl* impl_;
};

class JpegPageDecoder {
 public:
  JpegPageDecoder();
  ~JpegPageDecoder();
  JpegPageDecoder(const JpegPageDecoder&) = delete;
  JpegPageDecoder& operator=(const JpegPageDecoder&) = delete;
  Result<void> decode(std::span<const uint8_t> jpeg, uint8_t* texels);  // alpha 255

 private:
  struct Impl;
  Impl* impl_;
};

}  // namespace relievo
