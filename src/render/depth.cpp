#include "src/render/depth.h"

#include <glm/gtc/matrix_transform.hpp>

namespace relievo {

DepthMode depthMode(bool request_reversed) {
  DepthMode mode;
  mode.clip_control = epoxy_is_desktop_gl() ? epoxy_gl_version() >= 45 || epoxy_has_gl_extension("GL_ARB_clip_control")
                                            : epoxy_has_gl_extension("GL_EXT_clip_control");
  mode.reversed = request_reversed && mode.clip_control;
  return mode;
}

const char* depthName(bool reversed) { return reversed ? "reversed, 32-bit float" : "conventional, 24-bit"; }

void beginDepth(const DepthMode& mode) {
  if (mode.clip_control) {
    const GLenum range = mode.reversed ? GL_ZERO_TO_ONE : GL_NEGATIVE_ONE_TO_ONE;
    if (epoxy_is_desktop_gl()) glClipControl(GL_LOWER_LEFT, range);
    else glClipControlEXT(GL_LOWER_LEFT, range);
  }
  glEnable(GL_DEPTH_TEST);
  glDepthFunc(mode.nearerOrEqual());
}

gl::Texture createDepth(const char* label, int width_px, int height_px, const DepthMode& mode) {
  return gl::createNearest(label, width_px, height_px, mode.format(), GL_DEPTH_COMPONENT,
                           mode.reversed ? GL_FLOAT : GL_UNSIGNED_INT);
}

void attachDepthAlone(const gl::Framebuffer& framebuffer, GLuint depth) {
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer.id());
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_TEXTURE_2D, depth, 0);
  const GLenum none = GL_NONE;
  glDrawBuffers(1, &none);
  glReadBuffer(GL_NONE);
}

glm::dmat4 clipFromPixel(const DepthMode& mode) {
  const double sign = mode.reversed ? -1 : 1;  // reversed, depth is 1 where z is -1
  glm::dmat4 clip(1.0);
  clip[0][0] = clip[1][1] = 2;
  clip[2][2] = 2 * sign;
  clip[3] = glm::dvec4(-1, -1, -sign, 1);
  return clip;
}

std::array<float, 16> glClipFrom(const glm::dmat4& clip_from_world, const glm::dvec3& origin_mm,
                                 const DepthMode& mode) {
  const glm::dmat4 clip = glm::translate(clip_from_world, origin_mm);
  std::array<float, 16> out;
  for (int c = 0; c < 4; ++c) {
    for (int r = 0; r < 4; ++r) out[static_cast<size_t>(4 * c + r)] = static_cast<float>(clip[c][r]);
    if (mode.reversed) out[static_cast<size_t>(4 * c + 2)] = static_cast<float>(0.5 * (clip[c][3] - clip[c][2]));
  }
  return out;
}

}  // namespace relievo
