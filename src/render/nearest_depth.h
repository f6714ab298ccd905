// nearest_depth.h - of the samples of a picture, the depth of what is nearest at each pixel: several artworks are put
// together by it (composition.h), at borders too, where not every sample shows one. Needs a current GL context.
#pragma once

#include "src/base/result.h"
#include "src/gl/context.h"
#include "src/gl/program.h"
#include "src/render/surface_target.h"

namespace relievo {

class NearestDepth {
 public:
  static Result<NearestDepth> create(gl::Api api);
  // Takes the depth of one more sample. first: of a new picture, or of another size.
  void take(const SurfaceTarget& surface, const ScreenPass& screen, bool first);
  GLuint depth() const { return depth_.id(); }

 private:
  gl::Program program_;
  gl::Texture depth_;
  gl::Framebuffer framebuffer_;
  int width_ = 0, height_ = 0;
};

}  // namespace relievo
