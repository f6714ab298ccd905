#include "src/render/normals_target.h"

namespace relievo {

void NormalsTarget::begin(const SurfaceTarget& surface) {
  if (surface.width() != width_ || surface.height() != height_) {
    width_ = surface.width(), height_ = surface.height();
    normals_ = gl::createNearest("normals", width_, height_, GL_RGBA32UI, GL_RGBA_INTEGER, GL_UNSIGNED_INT);
    framebuffer_ = gl::Framebuffer::create();
  }
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, normals_.id(), 0);
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D, surface.depth(), 0);
  glViewport(0, 0, width_, height_);
  beginDepth(surface.depthMode());
  glDisable(GL_BLEND);
  glDisable(GL_CULL_FACE);
}

void NormalsTarget::bind(const gl::Program& program, int unit) const {
  glActiveTexture(static_cast<GLenum>(GL_TEXTURE0 + unit));
  glBindTexture(GL_TEXTURE_2D, normals_.id());
  glUniform1i(program.uniform("u_normals"), unit);
  glActiveTexture(GL_TEXTURE0);
}

}  // namespace relievo
