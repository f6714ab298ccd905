#include "src/render/nearest_depth.h"

namespace relievo {

Result<NearestDepth> NearestDepth::create(gl::Api api) {
  auto program = gl::Program::link(api, {"screen.vert", "nearest_depth.frag", {}, {"a_corner"}, {}});
  if (!program) return program.error();
  NearestDepth nearest;
  nearest.program_ = std::move(*program);
  return nearest;
}

void NearestDepth::take(const SurfaceTarget& surface, const ScreenPass& screen, bool first) {
  if (surface.width() != width_ || surface.height() != height_) {
    width_ = surface.width(), height_ = surface.height();
    depth_ = createDepth("nearest depth", width_, height_, surface.depthMode());
    framebuffer_ = gl::Framebuffer::create();
    attachDepthAlone(framebuffer_, depth_.id());
  }
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
  glViewport(0, 0, width_, height_);
  beginDepth(surface.depthMode());
  if (first) {
    glClearDepthf(surface.depthMode().farPlane());
    glClear(GL_DEPTH_BUFFER_BIT);
  }
  glDisable(GL_BLEND);
  glDisable(GL_CULL_FACE);
  program_.use();
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, surface.depth());
  glUniform1i(program_.uniform("u_depth"), 0);
  screen.drawNearer();
}

}  // namespace relievo
