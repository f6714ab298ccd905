// normals_target.h - the normal that each pixel of the surface shows, for shaders that compare those of neighbouring
// pixels (shaders/scan_curvature.glsl). RGBA32UI that holds floats: of colours of full precision OpenGL ES 3.0 draws no
// other. Where depth is at the far plane its value is undefined. Needs a current GL context.
#pragma once

#include "src/gl/objects.h"
#include "src/gl/program.h"
#include "src/render/surface_target.h"

namespace relievo {

class NormalsTarget {
 public:
  // Binds it to be drawn into, over the pixels of the surface.
  void begin(const SurfaceTarget& surface);
  // To texture unit `unit`, as u_normals of the program in use.
  void bind(const gl::Program& program, int unit) const;

 private:
  gl::Texture normals_;
  gl::Framebuffer framebuffer_;
  int width_ = 0, height_ = 0;
};

}  // namespace relievo
