// image_fill.h - the texels of an image that no patch shows, as between the parts of an atlas. Coarser levels would mix
// them into what is shown, and they take bytes: so they become what lies around them, smoothly (texturing/PACKAGE.md,
// "Images that patches show"). In whole numbers: the same on every machine.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include <glm/glm.hpp>

namespace relievo {

// The texels of an image that triangles show, or that lie beside such: filters look at these, too.
class ShownMarks {
 public:
  ShownMarks(int width, int height, bool repeats);
  // By its corners in 256ths of a texel from the image's upper left corner, within kMostShownPlace. So many large ones
  // that it would take long count as all of the image.
  void add(const std::array<glm::ivec2, 3>& triangle);
  double share() const;  // of the image's texels
  // rgb: the image, rows from the top. One of which all is shown, or nothing, stays as it is.
  void fillRest(std::span<uint8_t> rgb) &&;

 private:
  void mark(int64_t x, int64_t y);
  int width_, height_;
  bool repeats_;
  std::vector<uint8_t> shown_;
  uint64_t looked_at_ = 0;  // texels of triangles' boxes
};

}  // namespace relievo
