#include "src/render/sample_stack.h"

#include <array>
#include <cassert>

namespace relievo {
namespace {

constexpr std::array<glm::dvec2, 1> kCentre{glm::dvec2(0, 0)};
// In sixteenths of a pixel, exact as binary fractions.
constexpr std::array<glm::dvec2, 4> kFour{glm::dvec2(-2 / 16.0, -6 / 16.0), glm::dvec2(6 / 16.0, -2 / 16.0),
                                          glm::dvec2(-6 / 16.0, 2 / 16.0), glm::dvec2(2 / 16.0, 6 / 16.0)};
constexpr std::array<glm::dvec2, 8> kEight{glm::dvec2(1 / 16.0, -3 / 16.0), glm::dvec2(-1 / 16.0, 3 / 16.0),
                                           glm::dvec2(5 / 16.0, 1 / 16.0),  glm::dvec2(-3 / 16.0, -5 / 16.0),
                                           glm::dvec2(-5 / 16.0, 5 / 16.0), glm::dvec2(-7 / 16.0, -1 / 16.0),
                                           glm::dvec2(3 / 16.0, 7 / 16.0),  glm::dvec2(7 / 16.0, -7 / 16.0)};

}  // namespace

std::span<const glm::dvec2> samplePattern(int samples) {
  if (samples >= 8) return kEight;
  if (samples >= 4) return kFour;
  return kCentre;
}

void SampleStack::copy(const PictureTarget& picture, int layer) const {
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D_ARRAY, layers_.id());
  picture.bind();
  glCopyTexSubImage3D(GL_TEXTURE_2D_ARRAY, 0, 0, 0, layer, 0, 0, width_, height_);
}

void SampleStack::take(const PictureTarget& picture, int index) {
  assert(index >= 0 && index < samples_);
  if (!layers_) layers_ = gl::createTexture(GL_TEXTURE_2D_ARRAY, "samples");
  if (picture.width() != width_ || picture.height() != height_) {
    width_ = picture.width();
    height_ = picture.height();
    glActiveTexture(GL_TEXTURE0);
    glBindTexture(GL_TEXTURE_2D_ARRAY, layers_.id());
    glTexImage3D(GL_TEXTURE_2D_ARRAY, 0, GL_RGBA8, width_, height_, samples_ + 1, 0, GL_RGBA, GL_UNSIGNED_BYTE,
                 nullptr);
    glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
    glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  }
  copy(picture, index);
}

void SampleStack::draw(const gl::Program& program, const ScreenPass& screen, const glm::ivec2& layers, int width_px,
                       int height_px, const glm::vec4& behind) const {
  glViewport(0, 0, width_px, height_px);
  glDisable(GL_BLEND);
  glDisable(GL_CULL_FACE);
  program.use();
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D_ARRAY, layers_.id());
  glUniform1i(program.uniform("u_samples"), 0);
  glUniform2i(program.uniform("u_layers"), layers.x, layers.y);
  glUniform2f(program.uniform("u_scale"), static_cast<float>(width_) / static_cast<float>(width_px),
              static_cast<float>(height_) / static_cast<float>(height_px));
  glUniform4f(program.uniform("u_behind"), behind.r, behind.g, behind.b, behind.a);
  screen.draw(false);
}

void SampleStack::average(const gl::Program& program, const ScreenPass& screen, int count,
                          const PictureTarget& into) const {
  into.bind();
  draw(program, screen, {0, count}, width_, height_, glm::vec4(0));
  copy(into, samples_);
}

void SampleStack::present(const gl::Program& program, const ScreenPass& screen, int window_width_px,
                          int window_height_px) const {
  glBindFramebuffer(GL_FRAMEBUFFER, 0);
  draw(program, screen, {samples_, samples_ + 1}, window_width_px, window_height_px, pictureGreyLight());
}

}  // namespace relievo
