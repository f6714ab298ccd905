#include "src/render/composition.h"

#include <cassert>

#include <glm/gtc/type_ptr.hpp>

namespace relievo {

glm::dvec2 nearnessOf(const ViewTransform& view) {
  if (view.orthographic) return {-view.far_mm, view.far_mm - view.near_mm};
  return {1 / view.far_mm, 1 / view.near_mm - 1 / view.far_mm};
}

Result<Composition> Composition::create(gl::Api api, const DepthMode& depth) {
  auto program = gl::Program::link(
      api, {"screen.vert", "composition.frag", {{"MOST_LAYERS", std::to_string(kMostLayers)}}, {"a_corner"}, {}});
  if (!program) return program.error();
  Composition composition(depth);
  composition.program_ = std::move(*program);
  return composition;
}

void Composition::begin(int width_px, int height_px, int layers) {
  assert(layers <= kMostLayers);
  nearness_.assign(static_cast<size_t>(layers), {});
  if (width_px == width_ && height_px == height_ && layers == layers_) return;
  width_ = width_px, height_ = height_px, layers_ = layers;
  const auto make = [&](gl::Texture& texture, const char* label, GLenum stored, GLenum format, GLenum type) {
    texture = gl::createTexture(GL_TEXTURE_2D_ARRAY, label);
    glActiveTexture(GL_TEXTURE0);
    glBindTexture(GL_TEXTURE_2D_ARRAY, texture.id());
    glTexImage3D(GL_TEXTURE_2D_ARRAY, 0, static_cast<GLint>(stored), width_, height_, layers_, 0, format, type,
                 nullptr);
    glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
    glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  };
  make(colours_, "colours of artworks", GL_RGBA8, GL_RGBA, GL_UNSIGNED_BYTE);
  make(depths_, "depths of artworks", depth_mode_.format(), GL_DEPTH_COMPONENT,
       depth_mode_.reversed ? GL_FLOAT : GL_UNSIGNED_INT);
  from_ = gl::Framebuffer::create();
  to_ = gl::Framebuffer::create();
  picture_.resize(width_, height_, 0);
}

void Composition::take(int layer, const PictureTarget& picture, GLuint depth, const ViewTransform& view) {
  assert(picture.width() == width_ && picture.height() == height_);
  nearness_[static_cast<size_t>(layer)] = nearnessOf(view);
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D_ARRAY, colours_.id());
  picture.bind();
  glCopyTexSubImage3D(GL_TEXTURE_2D_ARRAY, 0, 0, 0, layer, 0, 0, width_, height_);
  attachDepthAlone(from_, depth);
  glBindFramebuffer(GL_FRAMEBUFFER, to_.id());
  glFramebufferTextureLayer(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, depths_.id(), 0, layer);
  const GLenum none = GL_NONE;
  glDrawBuffers(1, &none);
  glReadBuffer(GL_NONE);
  glBindFramebuffer(GL_READ_FRAMEBUFFER, from_.id());
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, to_.id());
  glBlitFramebuffer(0, 0, width_, height_, 0, 0, width_, height_, GL_DEPTH_BUFFER_BIT, GL_NEAREST);
  glBindFramebuffer(GL_FRAMEBUFFER, 0);
}

void Composition::draw(const ScreenPass& screen, const glm::vec4& behind) {
  picture_.bind();
  glViewport(0, 0, width_, height_);
  glDisable(GL_BLEND);
  glDisable(GL_CULL_FACE);
  program_.use();
  glActiveTexture(GL_TEXTURE1);
  glBindTexture(GL_TEXTURE_2D_ARRAY, depths_.id());
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D_ARRAY, colours_.id());
  glUniform1i(program_.uniform("u_colours"), 0);
  glUniform1i(program_.uniform("u_depths"), 1);
  glUniform1i(program_.uniform("u_count"), layers_);
  if (layers_ > 0) glUniform2fv(program_.uniform("u_nearness"), layers_, glm::value_ptr(nearness_[0]));
  glUniform1f(program_.uniform("u_reversed"), depth_mode_.reversed ? 1.0f : 0.0f);
  glUniform4f(program_.uniform("u_behind"), behind.r, behind.g, behind.b, behind.a);
  screen.draw(false);
}

uint64_t Composition::bytes() const {
  constexpr uint64_t kColour = 4, kDepth = 4;
  return static_cast<uint64_t>(width_) * static_cast<uint64_t>(height_) *
         ((kColour + kDepth) * static_cast<uint64_t>(layers_) + kColour);
}

}  // namespace relievo
