#include "src/render/surface_target.h"

namespace relievo {

namespace {

gl::Texture makeSurface(const char* label, int width_px, int height_px) {
  return gl::createNearest(label, width_px, height_px, GL_RGBA32UI, GL_RGBA_INTEGER, GL_UNSIGNED_INT);
}

}  // namespace

void SurfaceTarget::resize(int width_px, int height_px, bool gradient) {
  if (width_px == width_ && height_px == height_ && gradient == static_cast<bool>(gradient_)) return;
  width_ = width_px;
  height_ = height_px;
  surface_ = makeSurface("surface", width_, height_);
  gradient_ = gradient ? makeSurface("texture gradient", width_, height_) : gl::Texture();
  depth_ = createDepth("depth", width_, height_, depth_mode_);
  framebuffer_ = gl::Framebuffer::create();
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, surface_.id(), 0);
  if (gradient) glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT1, GL_TEXTURE_2D, gradient_.id(), 0);
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D, depth_.id(), 0);
  const GLenum outputs[2] = {GL_COLOR_ATTACHMENT0, GL_COLOR_ATTACHMENT1};
  glDrawBuffers(gradient ? 2 : 1, outputs);
}

void SurfaceTarget::begin() const {
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
  glViewport(0, 0, width_, height_);
  beginDepth(depth_mode_);
  glDisable(GL_BLEND);
  glDisable(GL_CULL_FACE);
  const float far_plane = depth_mode_.farPlane();
  glClearBufferfv(GL_DEPTH, 0, &far_plane);
}

void SurfaceTarget::beginCleared() const {
  begin();
  const GLuint nothing[4] = {0, 0, 0, 0};
  glClearBufferuiv(GL_COLOR, 0, nothing);
}

void SurfaceTarget::read(std::vector<std::array<uint32_t, 4>>& pixels) const {
  pixels.resize(static_cast<size_t>(width_) * static_cast<size_t>(height_));
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
  glReadBuffer(GL_COLOR_ATTACHMENT0);
  glPixelStorei(GL_PACK_ALIGNMENT, 4);
  glReadPixels(0, 0, width_, height_, GL_RGBA_INTEGER, GL_UNSIGNED_INT, pixels.data());
}

void SurfaceTarget::bind(const gl::Program& program, int unit) const {
  glActiveTexture(static_cast<GLenum>(GL_TEXTURE0 + unit));
  glBindTexture(GL_TEXTURE_2D, surface_.id());
  glUniform1i(program.uniform("u_surface"), unit);
  glActiveTexture(static_cast<GLenum>(GL_TEXTURE0 + unit + 1));
  glBindTexture(GL_TEXTURE_2D, gradient_.id());
  glUniform1i(program.uniform("u_gradient"), unit + 1);
  if (const GLint at = program.uniform("u_depth"); at >= 0) {  // not where it is the depth buffer
    glActiveTexture(static_cast<GLenum>(GL_TEXTURE0 + unit + 2));
    glBindTexture(GL_TEXTURE_2D, depth_.id());
    glUniform1i(at, unit + 2);
    // A driver may make a little less than 1 of the largest 24-bit number: the last two steps before the far plane ask
    // for nothing.
    glUniform2f(program.uniform("u_seen"), depth_mode_.reversed ? 0.0f : -1.0f,
                depth_mode_.reversed ? 2.0f : 0.9999999f);
  }
  glActiveTexture(GL_TEXTURE0);
}

ScreenPass::ScreenPass(const DepthMode& depth)
    : depth_(depth), vertex_array_(gl::VertexArray::create()), corners_(gl::Buffer::create()) {
  const float z = depth.farPlane(), corners[9] = {-1, -1, z, 3, -1, z, -1, 3, z};
  glBindVertexArray(vertex_array_.id());
  glBindBuffer(GL_ARRAY_BUFFER, corners_.id());
  glBufferData(GL_ARRAY_BUFFER, sizeof corners, corners, GL_STATIC_DRAW);
  glEnableVertexAttribArray(0);
  glVertexAttribPointer(0, 3, GL_FLOAT, GL_FALSE, 0, nullptr);
  glBindVertexArray(0);
}

void ScreenPass::drawNearer() const {
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(depth_.nearerOrEqual());
  glBindVertexArray(vertex_array_.id());
  glDrawArrays(GL_TRIANGLES, 0, 3);
  glBindVertexArray(0);
}

void ScreenPass::draw(bool where_seen) const {
  if (where_seen) {
    glDepthFunc(depth_.farther());
    glDepthMask(GL_FALSE);
  } else {
    glDisable(GL_DEPTH_TEST);
  }
  glBindVertexArray(vertex_array_.id());
  glDrawArrays(GL_TRIANGLES, 0, 3);
  glBindVertexArray(0);
  glEnable(GL_DEPTH_TEST);
  glDepthMask(GL_TRUE);
  glDepthFunc(depth_.nearerOrEqual());
}

}  // namespace relievo
