// depth_probe.h - how far away what a pixel shows is: one texel of a depth texture, read back. Waits for what was drawn
// into it.
#pragma once

#include <optional>

#include <glm/glm.hpp>

#include "src/base/result.h"
#include "src/gl/objects.h"
#include "src/gl/program.h"
#include "src/render/depth.h"
#include "src/render/surface_target.h"

namespace relievo {

class DepthProbe {
 public:
  static Result<DepthProbe> create(gl::Api api);
  // z / w in a camera's clip space (-1 to 1) at pixel (x, y), rows bottom first; nothing where the buffer holds the far
  // plane.
  std::optional<double> read(const SurfaceTarget& surface, const ScreenPass& screen, int x, int y) const;

 private:
  gl::Program program_;
  gl::Texture bits_;
  gl::Framebuffer framebuffer_;
};

}  // namespace relievo
