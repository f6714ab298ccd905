// depth_probe.h - reads back one texel of a depth texture, which tells how far away the surface under a pixel is. Waits
// for the draws into that texture.
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
