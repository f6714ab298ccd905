// surface_target.h - the surface buffer: for each pixel what is seen there (instance, place in its node, texture LOD),
// before any texture is read. RGBA32UI, shaders/surface.frag; with anisotropy a second one for the texture's gradient.
// Where depth is at the far plane nothing is seen, and what the buffer holds means nothing. One pass over the geometry
// serves the picture, which is then shaded once a pixel, and the feedback, which reads any pixels of it.
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
  // As texture `unit`, the gradient as `unit` + 1; and depth as `unit` + 2, for programs that look where something is
  // seen.
  void bind(const gl::Program& program, int unit) const;
  // Rows bottom first, as GL has them. Waits for what was drawn since beginCleared().
  void read(std::vector<std::array<uint32_t, 4>>& pixels) const;
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
  // where_seen: only where the bound depth buffer holds something.
  void draw(bool where_seen) const;

 private:
  DepthMode depth_;
  gl::VertexArray vertex_array_;
  gl::Buffer corners_;
};

}  // namespace relievo
