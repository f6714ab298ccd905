// surface_shading.h - the surface buffer into the picture: the shading pass, and what a plan's effects need drawn
// before it: shares of light and sky, a copy of the depth, a scan's normals. Each is kept while the surface is the same
// and freed when the plan has no use for it. Needs a current GL context.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <utility>

#include "src/engine/drawn_surface.h"
#include "src/engine/effect_plan.h"
#include "src/engine/light_shares.h"
#include "src/engine/scene_lights.h"
#include "src/engine/shading_programs.h"
#include "src/render/kept_depth.h"
#include "src/render/normals_target.h"
#include "src/render/picture_target.h"
#include "src/render/surface_target.h"

namespace relievo {

class SurfaceShading {
 public:
  SurfaceShading(const Manifest& manifest, const DepthMode& depth) : manifest_(manifest), depth_(depth) {}

  // What is shaded, and with what. All of it outlives the call.
  struct Frame {
    const Scene& scene;
    const EffectPlan& plan;
    const ShadingPrograms& programs;
    const SurfaceTarget& surface;
    const ScreenPass& screen;
    const SceneLights& lights;
    const Extent& extent;
    const ViewTransform& view;  // through the pixels' centres
    const ViewTransform& seen;  // through the sample that the surface buffer shows
    const DrawnSurface& surface_drawn;
    // Puts a program to use and binds the surface buffer and what pages and tails it reads.
    std::function<void(const gl::Program&)> use;
    // Draws the geometry into the depth map that is bound.
    std::function<void(const ShadowView&)> draw_map;
  };

  // Programs were linked, for this plan: all is drawn anew.
  void forget(const EffectPlan& plan);
  // Brings the shares of light and sky up to date. Returns its draw calls, but for the maps'.
  uint32_t updateShares(const Frame& frame, LightShares::Directions directions);
  // What pixels look up: pages; none, so that tails show; or the roots' alone.
  enum class Lookups { kPages, kTails, kRoots };
  // After updateShares(). Returns its draw calls.
  uint32_t draw(const Frame& frame, const PictureTarget& into, Lookups lookups);

  bool whole() const { return !shares_ || shares_->whole(); }  // no direction of light is missing
  int directions() const { return shares_ ? shares_->directions() : 0; }

 private:
  void keepDepth(const Frame& frame);
  const ReliefShading& completedShading(const ReliefShading& shading);
  void setEffects(const Frame& frame, const gl::Program& program);

  const Manifest& manifest_;
  DepthMode depth_;
  std::unique_ptr<KeptDepth> kept_depth_;  // while the plan keeps depth
  DrawnSurface kept_depth_of_;
  std::unique_ptr<NormalsTarget> normals_;  // while the plan draws normals
  std::unique_ptr<LightShares> shares_;     // while the plan has shadows or ambient occlusion
  std::optional<std::pair<ReliefShading, ReliefShading>> completed_shading_;  // a scene's, and completed()
};

}  // namespace relievo
