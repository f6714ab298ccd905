// overlay_pass.h - 2D triangles over the finished picture, with one 8-bit alpha texture: the head-up display.
#pragma once

#include <cstdint>
#include <span>

#include "src/base/result.h"
#include "src/gl/objects.h"
#include "src/gl/program.h"

namespace relievo {

struct OverlayVertex {
  float x = 0, y = 0;  // px, origin top left
  float u = 0, v = 0;  // in the texture, 0..1
  uint32_t rgba = 0;   // R in the low byte; alpha not premultiplied
};
struct OverlayCommand {
  int32_t clip[4] = {};  // left, top, right, bottom, px
  uint32_t first_index = 0, indices = 0, first_vertex = 0;
};

class OverlayPass {
 public:
  // alpha: width * height bytes, rows top first.
  static Result<OverlayPass> create(gl::Api api, int width, int height, std::span<const uint8_t> alpha);
  // Into the framebuffer that is bound, of this size. Leaves blending, scissor and depth test off.
  void draw(std::span<const OverlayVertex> vertices, std::span<const uint16_t> indices,
            std::span<const OverlayCommand> commands, int width_px, int height_px);

 private:
  OverlayPass() = default;
  gl::Program program_;
  gl::Texture texture_;
  gl::Buffer vertices_, indices_;
  gl::VertexArray vertex_array_;
};

}  // namespace relievo
