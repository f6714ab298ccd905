// plane_image.h - an image of any number of 8-bit channels, looked up between texels and between its levels of half the
// size.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include <glm/glm.hpp>

namespace relievo {

class PlaneImage {
 public:
  PlaneImage() = default;
  PlaneImage(PlaneImage&&) = default;
  PlaneImage& operator=(PlaneImage&&) = default;
  // Rows top first, channels interleaved; used in place. levels: how many coarser ones, at most, are wanted. repeats:
  // beyond its border.
  PlaneImage(int width, int height, int channels, std::span<const uint8_t> texels, int levels, bool repeats = false);

  bool empty() const { return levels_.empty(); }
  int width() const { return levels_[0].width; }
  int height() const { return levels_[0].height; }
  int channels() const { return channels_; }
  // At uv, (0, 0) the lower left corner, clamped to the image, or, of one that repeats, brought into it from more than
  // half a texel beyond (no nearer: an atlas would show its other side where coordinates were rounded): bilinear in a
  // level, linear between two. lod: log2 of the texels that lie between two places looked up; at most 0: the image
  // itself. out: channels() of them.
  void sample(const glm::vec2& uv, float lod, std::span<float> out) const;

 private:
  struct Level {
    int width = 0, height = 0;
    std::span<const uint8_t> texels;
    std::vector<uint8_t> own;
  };
  void add(const Level& level, float scale, const glm::vec2& place, float weight, std::span<float> out) const;
  std::vector<Level> levels_;
  int channels_ = 0;
  bool repeats_ = false;
};

}  // namespace relievo
