// mip_image.h - an image of any number of 8-bit channels with trilinear filtering.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include <glm/glm.hpp>

namespace relievo {

// Half the width and height, rounded up: the means of four texels. Rows of channels interleaved.
std::vector<uint8_t> halvedTexels(int width, int height, int channels, std::span<const uint8_t> texels);

class MipImage {
 public:
  MipImage() = default;
  MipImage(MipImage&&) = default;
  MipImage& operator=(MipImage&&) = default;
  // Rows top first, channels interleaved; used in place. levels: the largest number of mip levels below the image.
  // repeats: coordinates outside of [0, 1] repeat the image.
  MipImage(int width, int height, int channels, std::span<const uint8_t> texels, int levels, bool repeats = false);

  bool empty() const { return levels_.empty(); }
  int width() const { return levels_[0].width; }
  int height() const { return levels_[0].height; }
  int channels() const { return channels_; }
  // The filtered value at uv; (0, 0) is the lower left corner. Coordinates are clamped to the image, or wrapped if it
  // repeats and they lie more than half a texel outside (nearer ones stem from rounding, and wrapping them would blend
  // in the opposite side of an atlas). lod: log2 of the number of image texels between two samples; at most 0: the
  // image itself. out: channels() values, 0 to 255.
  void sample(const glm::vec2& uv, float lod, std::span<float> out) const;

 private:
  struct Level {
    int width = 0, height = 0;
    std::span<const uint8_t> texels;
    std::vector<uint8_t> own;
  };
  void add(const Level& level, float scale, const glm::vec2& position, float weight, std::span<float> out) const;
  std::vector<Level> levels_;
  int channels_ = 0;
  bool repeats_ = false;
};

}  // namespace relievo
