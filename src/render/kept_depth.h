// kept_depth.h - a copy of the surface's depth for shaders that draw over the surface with a depth test: OpenGL leaves
// undefined what is read of a texture that is the depth buffer meanwhile. Needs a current GL context.
#pragma once

#include "src/gl/objects.h"
#include "src/gl/program.h"
#include "src/render/surface_target.h"

namespace relievo {

class KeptDepth {
 public:
  // Copies the depth as it is now.
  void take(const SurfaceTarget& surface);
  // To texture unit `unit`, as u_kept_depth of the program in use.
  void bind(const gl::Program& program, int unit) const;

 private:
  gl::Texture depth_;
  gl::Framebuffer from_, to_;
  int width_ = 0, height_ = 0;
};

}  // namespace relievo
