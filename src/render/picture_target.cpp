#include "src/render/picture_target.h"

#include <algorithm>

#include "texturing/stream/page_table.h"

namespace relievo {

void PictureTarget::resize(int width_px, int height_px, GLuint depth) {
  if (width_px == width_ && height_px == height_ && depth == depth_) return;
  depth_ = depth;
  width_ = width_px;
  height_ = height_px;
  colour_ = gl::Texture::create();
  glBindTexture(GL_TEXTURE_2D, colour_.id());
  gl::label(GL_TEXTURE, colour_.id(), "picture");
  glTexImage2D(GL_TEXTURE_2D, 0, GL_RGBA8, width_, height_, 0, GL_RGBA, GL_UNSIGNED_BYTE, nullptr);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  framebuffer_ = gl::Framebuffer::create();
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, colour_.id(), 0);
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D, depth_, 0);
}

void PictureTarget::bind() const { glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id()); }

void PictureTarget::begin() const {
  bind();
  glViewport(0, 0, width_, height_);
  beginDepth(depth_mode_);
  glDisable(GL_BLEND);
  glDisable(GL_CULL_FACE);
  glClearColor(24 / 255.0f, 24 / 255.0f, 26 / 255.0f, 0);
  glClear(GL_COLOR_BUFFER_BIT);
}

std::vector<uint8_t> PictureTarget::readPixels() const {
  const size_t row = static_cast<size_t>(width_) * 4, rows = static_cast<size_t>(height_);
  std::vector<uint8_t> pixels(row * rows);
  bind();
  glPixelStorei(GL_PACK_ALIGNMENT, 4);
  glReadPixels(0, 0, width_, height_, GL_RGBA, GL_UNSIGNED_BYTE, pixels.data());
  for (size_t y = 0; y < rows / 2; ++y) {  // GL has the bottom row first
    uint8_t* upper = pixels.data() + row * y;
    std::swap_ranges(upper, upper + row, pixels.data() + row * (rows - 1 - y));
  }
  return pixels;
}

void PictureTarget::present(int window_width_px, int window_height_px) const {
  glBindFramebuffer(GL_READ_FRAMEBUFFER, framebuffer_.id());
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, 0);
  glBlitFramebuffer(0, 0, width_, height_, 0, 0, window_width_px, window_height_px, GL_COLOR_BUFFER_BIT, GL_NEAREST);
  glBindFramebuffer(GL_FRAMEBUFFER, 0);
}

void setShadingUniforms(const gl::Program& program, const ShadingParameters& p) {
  const PlanarDomain& d = *p.domain;
  glUniform4i(program.uniform("u_artwork"), d.texture_depth, d.alongX() ? 1 : 0, static_cast<GLint>(d.width_px),
              static_cast<GLint>(d.height_px));
  glUniform4i(program.uniform("u_sample"), p.sample[0], p.sample[1], p.sample[2], 0);
  glUniform1i(program.uniform("u_tap_phase"), p.tap_phase);
  glUniform1f(program.uniform("u_lod_bias"), static_cast<float>(p.lod_bias));
  auto basis = ptmBasis(p.light);
  if (p.format->basis == Basis::kAlbedoNormal) basis = {p.light[0], p.light[1], p.light[2], 0, 0, 0};
  float coefficients[24] = {};
  for (int k = 0; k < 6; ++k) {
    coefficients[4 * k] = static_cast<float>(p.format->scale[k]);
    coefficients[4 * k + 1] = static_cast<float>(p.format->bias[k]);
    coefficients[4 * k + 2] = static_cast<float>(basis[k]);
  }
  glUniform4fv(program.uniform("u_coefficients"), 6, coefficients);
  if (p.page_fade_s > 0) {
    glUniform3f(program.uniform("u_fade"), static_cast<float>(fadeClock(p.now_s)),
                static_cast<float>(1.0 / std::max(p.page_fade_s * 64, 1e-3)), p.fades_over ? 1.0f : 0.0f);
  }
}

void submitFrame() { glFlush(); }
void finishFrame() { glFinish(); }

}  // namespace relievo
