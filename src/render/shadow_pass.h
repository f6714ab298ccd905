// shadow_pass.h - shadows that the drawn surface casts on itself: a map of its depths from the light, of the triangles
// that the picture shows, then for each pixel the share of the light that reaches it. Of several lights each has a map,
// and a component of the shares; the sky is one more caster, whose share is a texture of its own. What is no point but
// an area of directions is the mean over them: its map is drawn for some of them at a time, in its quarters, and what
// reaches a pixel is added to a pair of sums, which are integers: they are exact, and no float target is needed. Needs
// a current GL context.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "shaders/shading.h"
#include "src/gl/objects.h"
#include "src/gl/program.h"
#include "src/render/depth.h"
#include "src/render/shadow_view.h"
#include "src/render/surface_target.h"

namespace relievo {

class ShadowPass {
 public:
  explicit ShadowPass(const DepthMode& depth = depthMode()) : depth_mode_(depth) {}
  // The maps have half as many texels a side again as the picture's longer side has pixels, within 256..4096. lights:
  // at most four. Casters are the lights, by number, and with `sky` the one after them.
  void resize(int width_px, int height_px, size_t lights = 1, bool sky = false);
  // What that takes of the GPU's memory, bytes. areas: how many casters get sums, too.
  static uint64_t bytes(int width_px, int height_px, size_t lights, bool sky, size_t areas);
  // Binds the map, sets the depth test and clears it: then the surface is drawn with shadowView()'s matrix.
  void beginMap(size_t caster) const;
  // Computes the share of light of every pixel of the surface (shaders/shadow.frag), which was drawn with
  // camera_clip_from_world. Program: of that shader.
  // Pixels that the view does not count for keep theirs.
  void light(size_t light, const gl::Program& program, const SurfaceTarget& surface, const ScreenPass& screen,
             const glm::dmat4& camera_clip_from_world, const ShadowView& view) const;
  // The same, added to the caster's sums, with weight 1. Program: of that shader with SHADOW_SUMS. first: there are
  // none yet.
  void addView(size_t caster, const gl::Program& program, const SurfaceTarget& surface, const ScreenPass& screen,
               const glm::dmat4& camera_clip_from_world, const ShadowView& view, bool first);
  // How directions count: all the same; by the cosine of their angle from the surface's normal; by it, with the
  // opposite direction beside each, which is dark.
  enum class Weight { kEven, kCosine, kCosineOverDark };
  static constexpr size_t kDirectionsAPass = RV_DIRECTIONS;
  struct Direction {
    glm::dvec3 towards{0, 0, 1};
    ShadowView view;
    bool dark = false;  // no light comes from there, whatever the map holds
  };
  // After beginMap(): what is drawn goes to the map of this direction, below kDirectionsAPass.
  void beginDirection(size_t direction) const;
  // Adds so many directions, at most kDirectionsAPass, to the caster's sums (shaders/shadow_sum.frag). first: there are
  // none yet. Sums of 16 bytes a pixel are taken with the first. eye_mm: what places count from on the GPU.
  void addDirections(size_t caster, std::span<const Direction> directions, bool first, Weight weight,
                     const gl::Program& program, const SurfaceTarget& surface, const ScreenPass& screen,
                     const glm::dmat4& camera_clip_from_world, const glm::dvec3& eye_mm);
  // All of the caster's light reaches every pixel.
  void clearShare(size_t caster) const;
  // The mean of the directions so far becomes the caster's share (shaders/shadow_mean.frag).
  void takeMean(size_t caster, const gl::Program& program, const ScreenPass& screen) const;
  // For shade.frag with SHADOWS: the shares of light, to texture unit `unit`.
  void bind(const gl::Program& program, int unit) const;
  // With OCCLUSION_FILES: the share of sky.
  void bindSky(const gl::Program& program, int unit) const;
  int mapPx() const { return map_px_; }

 private:
  void bindMap(size_t caster, const gl::Program& program, const SurfaceTarget& surface) const;
  // From clip space, z within -w..w, to texels of a map of so many a side, and its depth, 0..1.
  glm::dmat4 mapFromClip(int side) const;
  double depthStep() const;                             // what depth itself is rounded by
  double bias(const ShadowView& view, int side) const;  // of the map's depth; orthographic
  void setView(size_t caster, const gl::Program& program, const SurfaceTarget& surface,
               const glm::dmat4& camera_clip_from_world, const ShadowView& view) const;
  void makeSums(size_t caster);  // where there are none
  // Binds those so far to texture unit 1, and the others to draw into.
  void beginSums(size_t caster, const gl::Program& program);
  void beginShare(size_t caster) const;

  DepthMode depth_mode_;
  struct Map {
    gl::Texture depth;
    gl::Framebuffer framebuffer;
  };
  // Of a caster that is an area. A pass reads one of them and writes the other.
  struct Sums {
    gl::Texture texture[2];
    gl::Framebuffer framebuffer[2];
    int written = 0;
  };
  std::vector<Map> maps_;   // of each caster
  std::vector<Sums> sums_;  // of each caster
  gl::Texture light_, sky_;
  gl::Framebuffer light_framebuffer_, sky_framebuffer_;
  int width_ = 0, height_ = 0, map_px_ = 0;
  size_t lights_ = 0;
};

}  // namespace relievo
