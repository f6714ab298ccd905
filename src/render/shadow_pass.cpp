#include "src/render/shadow_pass.h"

#include <algorithm>
#include <array>

#include <glm/gtc/matrix_transform.hpp>
#include <glm/gtc/type_ptr.hpp>

namespace relievo {
namespace {

// Of a texel of the map. Within it the surface that casts and the one that is lit are taken as one plane; what they
// differ by must not pass for a shadow.
constexpr double kBiasTexels = 0.75;

int mapSide(int width_px, int height_px) {
  return std::clamp((std::max(width_px, height_px) * 3 / 2 + 63) / 64 * 64, 256, 4096);
}

}  // namespace

void ShadowPass::resize(int width_px, int height_px, size_t lights, bool sky) {
  const size_t casters = lights + (sky ? 1 : 0);
  if (width_px == width_ && height_px == height_ && lights == lights_ && casters == maps_.size()) return;
  width_ = width_px, height_ = height_px, lights_ = lights;
  const int side = mapSide(width_, height_);
  if (side != map_px_) maps_.clear();
  map_px_ = side;
  maps_.resize(casters);
  for (Map& map : maps_) {
    if (map.depth) continue;
    map.depth = createDepth("shadow map", side, side, depth_mode_);
    map.framebuffer = gl::Framebuffer::create();
    attachDepthAlone(map.framebuffer, map.depth.id());
  }
  sums_.clear();
  sums_.resize(casters);
  const auto makeShare = [](gl::Framebuffer& framebuffer, const gl::Texture& texture) {
    framebuffer = gl::Framebuffer::create();
    glBindFramebuffer(GL_FRAMEBUFFER, framebuffer.id());
    glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, texture.id(), 0);
  };
  light_ = {};
  sky_ = {};
  if (lights > 0) {
    light_ = lights == 1 ? gl::createNearest("share of light", width_, height_, GL_R8, GL_RED, GL_UNSIGNED_BYTE)
                         : gl::createNearest("shares of lights", width_, height_, GL_RGBA8, GL_RGBA, GL_UNSIGNED_BYTE);
    makeShare(light_framebuffer_, light_);
  }
  if (sky) {
    sky_ = gl::createNearest("share of sky", width_, height_, GL_R8, GL_RED, GL_UNSIGNED_BYTE);
    makeShare(sky_framebuffer_, sky_);
  }
}

uint64_t ShadowPass::bytes(int width_px, int height_px, size_t lights, bool sky, size_t areas) {
  const auto side = static_cast<uint64_t>(mapSide(width_px, height_px));
  const uint64_t pixels = static_cast<uint64_t>(width_px) * static_cast<uint64_t>(height_px);
  return (lights + (sky ? 1 : 0)) * side * side * 4 + pixels * (16 * areas + (lights > 1 ? 4 : lights) + (sky ? 1 : 0));
}

void ShadowPass::beginMap(size_t caster) const {
  glBindFramebuffer(GL_FRAMEBUFFER, maps_[caster].framebuffer.id());
  glViewport(0, 0, map_px_, map_px_);
  beginDepth(depth_mode_);
  glDisable(GL_BLEND);
  glDisable(GL_CULL_FACE);
  const float far_plane = depth_mode_.farPlane();
  glClearBufferfv(GL_DEPTH, 0, &far_plane);
}

void ShadowPass::beginDirection(size_t direction) const {
  const int side = map_px_ / 2;
  glViewport(direction % 2 == 0 ? 0 : side, direction / 2 == 0 ? 0 : side, side, side);
}

void ShadowPass::bindMap(size_t caster, const gl::Program& program, const SurfaceTarget& surface) const {
  program.use();
  surface.bind(program, 4);
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, maps_[caster].depth.id());
  glUniform1i(program.uniform("u_shadow_map"), 0);
}

glm::dmat4 ShadowPass::mapFromClip(int side) const {
  glm::dmat4 map_from_clip(1.0);
  const double half = 0.5 * side;
  map_from_clip[0][0] = map_from_clip[1][1] = half;
  map_from_clip[2][2] = depth_mode_.reversed ? -0.5 : 0.5;
  map_from_clip[3] = glm::dvec4(half, half, 0.5, 1);
  return map_from_clip;
}

double ShadowPass::depthStep() const { return depth_mode_.reversed ? 1e-6 : 3e-7; }

double ShadowPass::bias(const ShadowView& view, int side) const {
  const double texel_mm = 2 * view.mm_per_unit / side, depth_mm = 2 * view.mm_per_depth;
  return kBiasTexels * texel_mm / depth_mm + depthStep();
}

// The sky's share is a texture, a light's a component of one.
void ShadowPass::beginShare(size_t caster) const {
  const bool sky = caster == lights_;
  glBindFramebuffer(GL_FRAMEBUFFER, sky ? sky_framebuffer_.id() : light_framebuffer_.id());
  glViewport(0, 0, width_, height_);
  const auto mask = [&](size_t component) -> GLboolean { return sky || component == caster ? GL_TRUE : GL_FALSE; };
  glColorMask(mask(0), mask(1), mask(2), mask(3));
}

void ShadowPass::setView(size_t caster, const gl::Program& program, const SurfaceTarget& surface,
                         const glm::dmat4& camera_clip_from_world, const ShadowView& view) const {
  bindMap(caster, program, surface);
  const glm::mat4 map_from_pixel(mapFromClip(map_px_) * view.clip_from_world * glm::inverse(camera_clip_from_world) *
                                 clipFromPixel(depth_mode_));
  glUniformMatrix4fv(program.uniform("u_map_from_pixel"), 1, GL_FALSE, glm::value_ptr(map_from_pixel));
  // In perspective a texel grows with the distance z, and a step of depth with its square: a bias of so many texels is
  // in proportion to 1 / z, and the depth is linear in that.
  double at_zero = 0, per_depth = 0;
  if (view.perspective) {
    const double texel = 2 * view.mm_per_unit / map_px_, range_mm = view.far_mm - view.near_mm;
    per_depth = (depth_mode_.reversed ? kBiasTexels : -kBiasTexels) * texel;
    at_zero = kBiasTexels * texel * (depth_mode_.reversed ? view.near_mm : view.far_mm) / range_mm + depthStep();
  } else {
    at_zero = bias(view, map_px_);
  }
  glUniform4f(program.uniform("u_shadow"), static_cast<float>(map_px_), depth_mode_.reversed ? 1.0f : -1.0f,
              static_cast<float>(at_zero), static_cast<float>(per_depth));
  const glm::vec2 low((view.low * 0.5 + 0.5) * static_cast<double>(map_px_)),
      high((view.high * 0.5 + 0.5) * static_cast<double>(map_px_));
  glUniform4f(program.uniform("u_part"), low.x, low.y, high.x, high.y);
}

void ShadowPass::light(size_t light, const gl::Program& program, const SurfaceTarget& surface, const ScreenPass& screen,
                       const glm::dmat4& camera_clip_from_world, const ShadowView& view) const {
  setView(light, program, surface, camera_clip_from_world, view);
  beginShare(light);
  screen.draw(false);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
}

// Before anything is bound to texture units.
void ShadowPass::makeSums(size_t caster) {
  Sums& sums = sums_[caster];
  for (size_t k = 0; k < 2 && !sums.texture[1]; ++k) {
    sums.texture[k] = gl::createNearest("shadow sums", width_, height_, GL_RG32UI, GL_RG_INTEGER, GL_UNSIGNED_INT);
    sums.framebuffer[k] = gl::Framebuffer::create();
    glBindFramebuffer(GL_FRAMEBUFFER, sums.framebuffer[k].id());
    glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, sums.texture[k].id(), 0);
  }
}

void ShadowPass::beginSums(size_t caster, const gl::Program& program) {
  Sums& sums = sums_[caster];
  glActiveTexture(GL_TEXTURE1);
  glBindTexture(GL_TEXTURE_2D, sums.texture[sums.written].id());
  glUniform1i(program.uniform("u_sums"), 1);
  glActiveTexture(GL_TEXTURE0);
  sums.written = 1 - sums.written;
  glBindFramebuffer(GL_FRAMEBUFFER, sums.framebuffer[sums.written].id());
  glViewport(0, 0, width_, height_);
}

void ShadowPass::addView(size_t caster, const gl::Program& program, const SurfaceTarget& surface,
                         const ScreenPass& screen, const glm::dmat4& camera_clip_from_world, const ShadowView& view,
                         bool first) {
  makeSums(caster);
  setView(caster, program, surface, camera_clip_from_world, view);
  glUniform1f(program.uniform("u_more"), first ? 0.0f : 1.0f);
  beginSums(caster, program);
  screen.draw(false);
}

void ShadowPass::addDirections(size_t caster, std::span<const Direction> directions, bool first, Weight weight,
                               const gl::Program& program, const SurfaceTarget& surface, const ScreenPass& screen,
                               const glm::dmat4& camera_clip_from_world, const glm::dvec3& eye_mm) {
  makeSums(caster);
  bindMap(caster, program, surface);
  const glm::mat4 eye_from_pixel(glm::inverse(glm::translate(camera_clip_from_world, eye_mm)) *
                                 clipFromPixel(depth_mode_));
  glUniformMatrix4fv(program.uniform("u_eye_from_pixel"), 1, GL_FALSE, glm::value_ptr(eye_from_pixel));
  const int side = map_px_ / 2;
  std::array<glm::vec4, kDirectionsAPass> towards{};
  std::array<glm::vec4, 3 * kDirectionsAPass> map_from_eye{};
  for (size_t i = 0; i < directions.size(); ++i) {
    const Direction& d = directions[i];
    towards[i] = glm::vec4(d.towards, d.dark ? -1 : bias(d.view, side));
    glm::dmat4 map = mapFromClip(side) * glm::translate(d.view.clip_from_world, eye_mm);
    map[3].x += i % 2 == 0 ? 0 : side, map[3].y += i / 2 == 0 ? 0 : side;
    const glm::dmat4 rows = glm::transpose(map);
    for (int row = 0; row < 3; ++row) map_from_eye[3 * i + static_cast<size_t>(row)] = glm::vec4(rows[row]);
  }
  glUniform4fv(program.uniform("u_directions"), static_cast<GLsizei>(towards.size()), glm::value_ptr(towards[0]));
  glUniform4fv(program.uniform("u_map_from_eye"), static_cast<GLsizei>(map_from_eye.size()),
               glm::value_ptr(map_from_eye[0]));
  glUniform4f(program.uniform("u_count"), static_cast<float>(directions.size()), static_cast<float>(side), 0, 0);
  glUniform4f(program.uniform("u_sum"), first ? 0.0f : 1.0f, weight == Weight::kEven ? 0.0f : 1.0f,
              weight == Weight::kCosineOverDark ? 1.0f : 0.0f, depth_mode_.reversed ? 1.0f : -1.0f);
  beginSums(caster, program);
  screen.draw(false);
}

void ShadowPass::clearShare(size_t caster) const {
  beginShare(caster);
  const std::array<float, 4> whole{1, 1, 1, 1};
  glClearBufferfv(GL_COLOR, 0, whole.data());
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
}

void ShadowPass::takeMean(size_t caster, const gl::Program& program, const ScreenPass& screen) const {
  program.use();
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, sums_[caster].texture[sums_[caster].written].id());
  glUniform1i(program.uniform("u_sums"), 0);
  beginShare(caster);
  screen.draw(false);
  glColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
}

void ShadowPass::bind(const gl::Program& program, int unit) const {
  glActiveTexture(static_cast<GLenum>(GL_TEXTURE0 + unit));
  glBindTexture(GL_TEXTURE_2D, light_.id());
  glUniform1i(program.uniform("u_light_share"), unit);
  glActiveTexture(GL_TEXTURE0);
}

void ShadowPass::bindSky(const gl::Program& program, int unit) const {
  glActiveTexture(static_cast<GLenum>(GL_TEXTURE0 + unit));
  glBindTexture(GL_TEXTURE_2D, sky_.id());
  glUniform1i(program.uniform("u_sky_share"), unit);
  glActiveTexture(GL_TEXTURE0);
}

}  // namespace relievo
