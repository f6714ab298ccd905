#include "src/render/shadow_pass.h"

#include <algorithm>

#include <glm/gtc/type_ptr.hpp>

namespace relievo {
namespace {

// Of a texel of the map. Within it the surface that casts and the one that is lit are taken as one plane; what they
// differ by must not pass for a shadow.
constexpr double kBiasTexels = 0.75;

}  // namespace

void ShadowPass::resize(int width_px, int height_px, size_t lights) {
  if (width_px == width_ && height_px == height_ && lights == maps_.size()) return;
  width_ = width_px, height_ = height_px;
  const int side = std::clamp((std::max(width_, height_) * 3 / 2 + 63) / 64 * 64, 256, 4096);
  if (side != map_px_) maps_.clear();
  map_px_ = side;
  maps_.resize(lights);
  for (Map& map : maps_) {
    if (map.depth) continue;
    map.depth = createDepth("shadow map", side, side, depth_mode_);
    map.framebuffer = gl::Framebuffer::create();
    attachDepthAlone(map.framebuffer, map.depth.id());
  }
  light_ = lights == 1 ? gl::createNearest("share of light", width_, height_, GL_R8, GL_RED, GL_UNSIGNED_BYTE)
                       : gl::createNearest("shares of lights", width_, height_, GL_RGBA8, GL_RGBA, GL_UNSIGNED_BYTE);
  light_framebuffer_ = gl::Framebuffer::create();
  glBindFramebuffer(GL_FRAMEBUFFER, light_framebuffer_.id());
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, light_.id(), 0);
}

void ShadowPass::beginMap(size_t light) const {
  glBindFramebuffer(GL_FRAMEBUFFER, maps_[light].framebuffer.id());
  glViewport(0, 0, map_px_, map_px_);
  beginDepth(depth_mode_);
  glDisable(GL_BLEND);
  glDisable(GL_CULL_FACE);
  const float far_plane = depth_mode_.farPlane();
  glClearBufferfv(GL_DEPTH, 0, &far_plane);
}

void ShadowPass::light(size_t light, const gl::Program& program, const SurfaceTarget& surface, const ScreenPass& screen,
                       const glm::dmat4& camera_clip_from_world, const ShadowView& view) const {
  glBindFramebuffer(GL_FRAMEBUFFER, light_framebuffer_.id());
  glViewport(0, 0, width_, height_);
  program.use();
  surface.bind(program, 4);
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, maps_[light].depth.id());
  glUniform1i(program.uniform("u_shadow_map"), 0);
  // From a pixel's place and depth, each 0..1, to the map's texels and its depth, which is 0..1, too.
  const double sign = depth_mode_.reversed ? -1 : 1;
  glm::dmat4 map_from_clip(1.0);
  const double half = 0.5 * map_px_;
  map_from_clip[0][0] = map_from_clip[1][1] = half;
  map_from_clip[2][2] = 0.5 * sign;
  map_from_clip[3] = glm::dvec4(half, half, 0.5, 1);
  const glm::mat4 map_from_pixel(map_from_clip * view.clip_from_world * glm::inverse(camera_clip_from_world) *
                                 clipFromPixel(depth_mode_));
  glUniformMatrix4fv(program.uniform("u_map_from_pixel"), 1, GL_FALSE, glm::value_ptr(map_from_pixel));
  const double texel_mm = 2 * view.mm_per_unit / map_px_, depth_mm = 2 * view.mm_per_depth;
  const double step = depth_mode_.reversed ? 1e-6 : 3e-7;  // of depth itself
  glUniform4f(program.uniform("u_shadow"), static_cast<float>(map_px_), static_cast<float>(-sign),
              static_cast<float>(kBiasTexels * texel_mm / depth_mm + step), 0);
  const auto mask = [light](size_t component) -> GLboolean { return component == light ? GL_TRUE : GL_FALSE; };
  glColorMask(mask(0), mask(1), mask(2), mask(3));
  screen.draw(false);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
}

void ShadowPass::bind(const gl::Program& program, int unit) const {
  glActiveTexture(static_cast<GLenum>(GL_TEXTURE0 + unit));
  glBindTexture(GL_TEXTURE_2D, light_.id());
  glUniform1i(program.uniform("u_light_share"), unit);
  glActiveTexture(GL_TEXTURE0);
}

}  // namespace relievo
