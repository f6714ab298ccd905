#include "src/render/kept_depth.h"

namespace relievo {

void KeptDepth::take(const SurfaceTarget& surface) {
  if (surface.width() != width_ || surface.height() != height_) {
    width_ = surface.width(), height_ = surface.height();
    depth_ = createDepth("kept depth", width_, height_, surface.depthMode());
    from_ = gl::Framebuffer::create();
    to_ = gl::Framebuffer::create();
    attachDepthAlone(to_, depth_.id());
  }
  attachDepthAlone(from_, surface.depth());  // the surface makes another texture where its size changes
  glBindFramebuffer(GL_READ_FRAMEBUFFER, from_.id());
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, to_.id());
  glBlitFramebuffer(0, 0, width_, height_, 0, 0, width_, height_, GL_DEPTH_BUFFER_BIT, GL_NEAREST);
  glBindFramebuffer(GL_FRAMEBUFFER, 0);
}

void KeptDepth::bind(const gl::Program& program, int unit) const {
  glActiveTexture(static_cast<GLenum>(GL_TEXTURE0 + unit));
  glBindTexture(GL_TEXTURE_2D, depth_.id());
  glUniform1i(program.uniform("u_kept_depth"), unit);
  glActiveTexture(GL_TEXTURE0);
}

}  // namespace relievo
