#include "src/render/picture_target.h"

#include <algorithm>

#include "src/base/srgb.h"

#include "texturing/stream/page_table.h"

namespace relievo {

glm::vec4 pictureGreyLight() {
  glm::vec4 grey(1);
  for (int c = 0; c < 3; ++c)
    grey[c] = static_cast<float>(linearFromSrgb(kPictureGrey[static_cast<size_t>(c)] / 255.0));
  return grey;
}

void PictureTarget::resize(int width_px, int height_px, GLuint depth) {
  if (width_px == width_ && height_px == height_ && depth == depth_) return;
  depth_ = depth;
  width_ = width_px;
  height_ = height_px;
  colour_ = gl::createNearest("picture", width_, height_, GL_RGBA8, GL_RGBA, GL_UNSIGNED_BYTE);
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
  glClearColor(kPictureGrey[0] / 255.0f, kPictureGrey[1] / 255.0f, kPictureGrey[2] / 255.0f, 0);
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
  glBlitFramebuffer(0, 0, width_, height_, 0, 0, window_width_px, window_height_px, GL_COLOR_BUFFER_BIT,
                    width_ == window_width_px && height_ == window_height_px ? GL_NEAREST : GL_LINEAR);
  glBindFramebuffer(GL_FRAMEBUFFER, 0);
}

gl::Defines shadingDefines(Basis basis) {
  const BasisDescription& d = describe(basis);
  gl::Defines defines{{"SHADING", std::to_string(static_cast<int>(d.shading))}};
  if (d.coefficients == 0) return defines;
  // Terms are added up channel by channel, plane by plane. The order decides the sums' last bits.
  std::string terms;
  std::array<std::string, 3> colour;
  for (int c = 0; c < 3; ++c)
    for (int plane = 0; plane < d.planes; ++plane) {
      const BasisChannel& channel = d.channels[static_cast<size_t>(3 * plane + c)];
      const std::string place = std::to_string(plane) + ", " + std::to_string(c);
      if (channel.holds == BasisChannel::Holds::kCoefficient)
        terms +=
            " TERM(" + place + ", " + std::to_string(channel.coefficient) + ", " + std::to_string(channel.of) + ")";
      else if (channel.holds == BasisChannel::Holds::kColour) colour[channel.of] = "CHANNEL(" + place + ")";
    }
  defines.emplace_back("COEFFICIENTS", std::to_string(d.coefficients));
  defines.emplace_back("TERMS", terms);
  if (d.shading == Shading::kLuminance) defines.emplace_back("COLOUR", colour[0] + ", " + colour[1] + ", " + colour[2]);
  return defines;
}

namespace {

void setCoefficients(const gl::Program& program, const TextureFormat& format, const std::array<double, 3>& light) {
  const size_t n = static_cast<size_t>(format.coefficients());
  if (n == 0) return;
  std::array<double, kMaxCoefficients> functions;
  describe(format.basis).functions(light, std::span(functions).first(n));
  std::array<float, 4 * kMaxCoefficients> coefficients{};
  for (size_t k = 0; k < n; ++k) {
    coefficients[4 * k] = static_cast<float>(format.scale[k]);
    coefficients[4 * k + 1] = static_cast<float>(format.bias[k]);
    coefficients[4 * k + 2] = static_cast<float>(functions[k]);
  }
  glUniform4fv(program.uniform("u_coefficients"), static_cast<GLsizei>(n), coefficients.data());
}

}  // namespace

void setShadingUniforms(const gl::Program& program, const ShadingParameters& p) {
  glm::ivec4 artwork(p.domain->texture_depth, 0, 0, 0);
  if (p.domain->isFlat()) {
    const FlatDomain d = p.domain->flat();
    artwork = {d.texture_depth, d.alongX() ? 1 : 0, static_cast<int>(d.width_px), static_cast<int>(d.height_px)};
  }
  glUniform4i(program.uniform("u_artwork"), artwork.x, artwork.y, artwork.z, artwork.w);
  glUniform4i(program.uniform("u_sample"), p.sample[0], p.sample[1], p.sample[2], 0);
  glUniform1i(program.uniform("u_tap_phase"), p.tap_phase);
  glUniform1f(program.uniform("u_lod_bias"), static_cast<float>(p.lod_bias));
  glUniform3f(program.uniform("u_light"), static_cast<float>(p.light[0]), static_cast<float>(p.light[1]),
              static_cast<float>(p.light[2]));
  setCoefficients(program, *p.format, p.light);
  if (p.page_fade_s > 0) {
    glUniform3f(program.uniform("u_fade"), static_cast<float>(fadeClock(p.now_s)),
                static_cast<float>(1.0 / std::max(p.page_fade_s * 64, 1e-3)), p.fades_over ? 1.0f : 0.0f);
  }
}

void addColumns(const std::string& name, const glm::dmat4& matrix, std::vector<NamedUniform>& to) {
  for (int column = 0; column < 4; ++column)
    to.push_back({name + "[" + std::to_string(column) + "]", glm::vec4(matrix[column])});
}

void setNamedUniforms(const gl::Program& program, std::span<const NamedUniform> uniforms) {
  for (const NamedUniform& u : uniforms)
    glUniform4f(program.uniform(u.name.c_str()), u.value.x, u.value.y, u.value.z, u.value.w);
}

void submitFrame() { glFlush(); }
void finishFrame() { glFinish(); }

}  // namespace relievo
