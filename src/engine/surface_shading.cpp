#include "src/engine/surface_shading.h"

#include <glm/gtc/matrix_transform.hpp>

namespace relievo {
namespace {

constexpr int kLightShareUnit = 14;  // texture units
constexpr int kKeptDepthUnit = 6;    // shading programs have no base mesh
constexpr int kNormalsUnit = 7;
constexpr int kSkyShareUnit = 8;

// Of eye.glsl.
std::vector<NamedUniform> eyeUniforms(const ViewTransform& view, const glm::dmat4& eye_from_pixel) {
  std::vector<NamedUniform> uniforms{
      {"u_viewer", view.orthographic ? glm::vec4(glm::vec3(view.world_from_camera[2]), 0) : glm::vec4(0, 0, 0, 1)}};
  addColumns("u_eye_from_pixel", eye_from_pixel, uniforms);
  return uniforms;
}

}  // namespace

void SurfaceShading::forget(const EffectPlan& plan) {
  kept_depth_of_ = {};
  if (!plan.casts()) shares_.reset();
  else if (shares_) shares_->forget();
  if (!plan.keepsDepth()) kept_depth_.reset();
  if (!plan.drawsNormals()) normals_.reset();
}

uint32_t SurfaceShading::updateShares(const Frame& frame, LightShares::Directions directions) {
  const EffectPlan& plan = frame.plan;
  if (!plan.casts()) return 0;
  if (!shares_) shares_ = std::make_unique<LightShares>(depth_);
  LightShares::Wanted wanted{.surface = frame.surface_drawn, .view = &frame.view, .extent = &frame.extent};
  if (plan.shadows) wanted.lights = frame.lights.casting(frame.scene, plan, frame.view);
  wanted.sky = plan.ambient_occlusion;
  return shares_->update(
      wanted, directions,
      {.programs = &frame.programs, .surface = &frame.surface, .screen = &frame.screen, .draw_map = frame.draw_map});
}

// Near lights, gloss, and depth and curvature of a scan, need each pixel's place.
void SurfaceShading::keepDepth(const Frame& frame) {
  if (!frame.plan.keepsDepth() || (kept_depth_ && kept_depth_of_ == frame.surface_drawn)) return;
  if (!kept_depth_) kept_depth_ = std::make_unique<KeptDepth>();
  kept_depth_->take(frame.surface);
  kept_depth_of_ = frame.surface_drawn;
}

const ReliefShading& SurfaceShading::completedShading(const ReliefShading& shading) {
  if (!completed_shading_ || completed_shading_->first != shading)
    completed_shading_ = {shading, completed(shading, manifest_)};
  return completed_shading_->second;
}

// For the shading program in use.
void SurfaceShading::setEffects(const Frame& frame, const gl::Program& program) {
  const Scene& scene = frame.scene;
  const EffectPlan& plan = frame.plan;
  setNamedUniforms(program, effectUniforms(scene.effects));
  const bool shaded = plan.shading != ReliefShading::Kind::kNone;
  if (plan.lights > 0 || shaded || plan.gloss) {
    const glm::dvec3& eye_mm = frame.view.eye_mm;
    const glm::dmat4 eye_from_pixel =
        glm::inverse(glm::translate(frame.seen.clip_from_world, eye_mm)) * clipFromPixel(depth_);
    if (shaded)
      setNamedUniforms(program, shadingUniforms(completedShading(scene.shading), manifest_, eye_mm, eye_from_pixel,
                                                depth_.farPlane()));
    if (plan.lights > 0)
      setNamedUniforms(program,
                       lightUniforms(frame.lights.placed(scene, plan, frame.view), plan.format(manifest_), eye_mm));
    if (plan.gloss) setNamedUniforms(program, glossUniforms(scene.gloss));
    if (plan.keepsDepth()) setNamedUniforms(program, eyeUniforms(frame.view, eye_from_pixel));
    if (kept_depth_) kept_depth_->bind(program, kKeptDepthUnit);
    if (normals_) normals_->bind(program, kNormalsUnit);
  }
  if (plan.shadows) shares_->pass().bind(program, kLightShareUnit);
  if (plan.ambient_occlusion) {
    setNamedUniforms(program, occlusionUniforms(scene.ambient_occlusion));
    shares_->pass().bindSky(program, kSkyShareUnit);
  }
}

uint32_t SurfaceShading::draw(const Frame& frame, const PictureTarget& into, Lookups lookups) {
  uint32_t calls = 0;
  keepDepth(frame);
  if (frame.plan.drawsNormals()) {
    if (!normals_) normals_ = std::make_unique<NormalsTarget>();
    normals_->begin(frame.surface);
    frame.use(lookups == Lookups::kTails ? frame.programs.normals_tails : frame.programs.normals);
    frame.screen.draw(true);
    ++calls;
  }
  into.begin();
  const gl::Program& program = lookups == Lookups::kTails   ? frame.programs.tails
                               : lookups == Lookups::kRoots ? frame.programs.roots
                                                            : frame.programs.shade;
  frame.use(program);
  setEffects(frame, program);
  frame.screen.draw(true);
  return calls + 1;
}

}  // namespace relievo
