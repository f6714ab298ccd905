#include "src/render/depth_probe.h"

#include <bit>
#include <cstdint>

namespace relievo {

Result<DepthProbe> DepthProbe::create(gl::Api api) {
  auto program = gl::Program::link(api, {"screen.vert", "depth_probe.frag", {}, {"a_corner"}, {}});
  if (!program) return program.error();
  DepthProbe probe;
  probe.program_ = std::move(*program);
  probe.bits_ = gl::Texture::create();
  glBindTexture(GL_TEXTURE_2D, probe.bits_.id());
  gl::label(GL_TEXTURE, probe.bits_.id(), "depth probe");
  glTexImage2D(GL_TEXTURE_2D, 0, GL_RGBA32UI, 1, 1, 0, GL_RGBA_INTEGER, GL_UNSIGNED_INT, nullptr);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  probe.framebuffer_ = gl::Framebuffer::create();
  glBindFramebuffer(GL_FRAMEBUFFER, probe.framebuffer_.id());
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, probe.bits_.id(), 0);
  return probe;
}

std::optional<double> DepthProbe::read(const SurfaceTarget& surface, const ScreenPass& screen, int x, int y) const {
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer_.id());
  glViewport(0, 0, 1, 1);
  program_.use();
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, surface.depth());
  glUniform1i(program_.uniform("u_depth"), 0);
  glUniform2i(program_.uniform("u_pixel"), x, y);
  screen.draw(false);
  uint32_t bits[4] = {};
  glReadPixels(0, 0, 1, 1, GL_RGBA_INTEGER, GL_UNSIGNED_INT, bits);
  const auto depth = static_cast<double>(std::bit_cast<float>(bits[0]));
  // As SurfaceTarget::bind() tells programs where something is seen.
  if (surface.depthMode().reversed) return depth > 0 ? std::optional(1 - 2 * depth) : std::nullopt;
  return depth < 0.9999999 ? std::optional(2 * depth - 1) : std::nullopt;
}

}  // namespace relievo
