// dense_levels.h - a plain mip-mapped texture of one whole patch, a layer a plane: what `relievo bench` compares the
// virtual texture with (define DENSE of shaders/shade.frag). No more than that: an artwork's size is bounded by the
// GPU's here.
#pragma once

#include <cstdint>
#include <span>

#include "src/gl/objects.h"
#include "src/gl/program.h"

namespace relievo {

class DenseLevels {
 public:
  // Levels 0 .. depth, kPagePx << level texels a side.
  DenseLevels(int depth, int planes);
  // The payload of a page's slot texels (page_codec.h).
  void upload(int level, int plane, uint32_t x, uint32_t y, std::span<const uint8_t> slot_texels);
  // To texture unit 6, in the program in use. linear: for the filters of the texture unit, all levels together.
  void bind(const gl::Program& program, bool linear) const;

 private:
  int depth_;
  gl::Texture texture_;
};

}  // namespace relievo
