// surface_target.h - the surface buffer (a visibility buffer): for each pixel the visible instance, the place in its
// node and the texture LOD, before any texture is read. RGBA32UI, written by shaders/surface.frag; with anisotropy a
// second texture holds the texture's gradient. Where depth is at the far plane nothing is visible, and the buffer's
// value is undefined. One pass over the geometry serves the picture, which is then shaded once a pixel, and the
// feedback, which reads some of the pixels.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "src/gl/objects.h"
#include "src/gl/program.h"
#include "src/render/depth.h"

namespace relievo {

class SurfaceTarget {
 public:
  explicit SurfaceTarget(const DepthMode& depth = relievo::depthMode()) : depth_mode_(depth) {}
  void resize(int width_px, int height_px, bool gradient);
  // Binds, sets the depth test and clears depth: nothing is seen anywhere. (The buffer's 16 bytes a pixel are not
  // cleared, which llvmpipe does texel by texel, for a tenth of a frame.)
  void begin() const;
  // Clears the buffer to zeros, too: for read().
  void beginCleared() const;
  // Binds the buffer to texture unit `unit`, the gradient to `unit` + 1 and depth to `unit` + 2.
  void bind(const gl::Program& program, int unit) const;
  // Rows bottom first, as GL has them. Waits for what was drawn since beginCleared().
  void read(std::vector<std::array<uint32_t, 4>>& pixels) const;
  int width() const { return width_; }
  int height() const { return height_; }
  GLuint depth() const { return depth_.id(); }  // a texture; the far plane where nothing is seen
  const DepthMode& depthMode() const { return depth_mode_; }

 private:
  DepthMode depth_mode_;
  gl::Texture surface_, gradient_, depth_;
  gl::Framebuffer framebuffer_;
  int width_ = 0, height_ = 0;
};

// A triangle over the whole screen (shaders/screen.vert).
class ScreenPass {
 public:
  explicit ScreenPass(const DepthMode& depth = depthMode());
  // where_seen: draws only where the bound depth buffer holds a surface.
  void draw(bool where_seen) const;
  // Writes depth where what the program makes is nearer than, or as near as, what is there.
  void drawNearer() const;

 private:
  DepthMode depth_;
  gl::VertexArray vertex_array_;
  gl::Buffer corners_;
};

}  // namespace relievo
