// mip.h - how a coarser texture level follows from the finer one. Integer arithmetic, so that anyone can reproduce it.
//
// Level texels are kept as 8.8 fixed point (uint16, 0..65280) below the finest level, so that rounding errors do not
// accumulate; a page's byte is (v + 128) >> 8. A level's size is ceil(size / 2); at an odd border the last row or
// column is repeated.
//   coefficients  (a + b + c + d + 2) >> 2: averaged as numbers
//   normals       averaged as numbers, and not made longer again (basis.h says why)
//   colour        averaged in linear light (sRGB transfer curve by table, 16-bit linear)
//   colour that a luminance multiplies: averaged with weights, a texel's luminance under diffuse light from the upper
//                 hemisphere (BasisDescription::diffuse; of an LRGB PTM (a0 + a1) / 3 + a5), at least a small positive
//                 number, so that the product colour x luminance stays close to the average of the products
// The exact integer rules stand in mip.cpp's head and are repeated in texturing/PACKAGE.md.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "src/artwork/basis.h"

namespace relievo {

// Channel-major images: data[(c * height + y) * width + x].
struct LevelImage {
  int width = 0, height = 0, channels = 0;
  std::vector<uint16_t> data;  // 8.8 fixed point
};

// The next coarser level of the whole image given; width and height must be even (the caller repeats the border).
// const and thread-safe.
class MipFilter {
 public:
  explicit MipFilter(const TextureFormat& format);
  static MipFilter ofNumbers(int channels);  // all of which are averaged as numbers
  void downsample(const uint16_t* in, int width, int height, uint16_t* out) const;
  // The same from the finest level's bytes: a byte b counts as b << 8.
  void downsample(const uint8_t* in, int width, int height, uint16_t* out) const;

 private:
  MipFilter() = default;
  template <class T>
  void downsampleAny(const T* in, int width, int height, std::span<int32_t> weights, uint16_t* out) const noexcept;
  // The weights of two rows of texels, where some channels are averaged by them.
  std::vector<int32_t> weightRows(int width) const;
  template <class T>
  void weightsOf(const T* rows, size_t plane, int width, int32_t* out) const noexcept;

  struct Weight {
    int channel = 0;
    int32_t factor = 0;
  };
  std::vector<int> numbers_, linear_, weighted_;  // channels, by how they are averaged
  std::vector<Weight> weights_;
  int32_t weight_offset_ = 0;
};

// One texel of a page from its level's texel.
inline uint8_t byteFromLevel(uint16_t v) { return static_cast<uint8_t>((v + 128) >> 8); }

// Fills a channel-major image beyond the rectangle [x0, x1) x [y0, y1), which must not be empty, with the nearest texel
// inside.
void repeatBorder(uint8_t* data, int width, int height, int channels, int x0, int y0, int x1, int y1);
void repeatBorder(uint16_t* data, int width, int height, int channels, int x0, int y0, int x1, int y1);

}  // namespace relievo
