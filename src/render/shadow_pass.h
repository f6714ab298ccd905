// shadow_pass.h - shadows that the drawn surface casts on itself: a map of its depths from the light, of the triangles
// that the picture shows, then for each pixel the share of the light that reaches it. Of several lights each has a map,
// and a component of the shares. Needs a current GL context.
#pragma once

#include <cstdint>
#include <vector>

#include <glm/glm.hpp>

#include "src/gl/objects.h"
#include "src/gl/program.h"
#include "src/render/depth.h"
#include "src/render/shadow_view.h"
#include "src/render/surface_target.h"

namespace relievo {

class ShadowPass {
 public:
  explicit ShadowPass(const DepthMode& depth = depthMode()) : depth_mode_(depth) {}
  // The map has half as many texels a side again as the picture's longer side has pixels, within 256..4096. lights: at
  // most four.
  void resize(int width_px, int height_px, size_t lights = 1);
  // Binds the map, sets the depth test and clears it: then the surface is drawn with shadowView()'s matrix.
  void beginMap(size_t light) const;
  // Computes the share of light of every pixel of the surface (shaders/shadow.frag), which was drawn with
  // camera_clip_from_world. Program: of that shader.
  void light(size_t light, const gl::Program& program, const SurfaceTarget& surface, const ScreenPass& screen,
             const glm::dmat4& camera_clip_from_world, const ShadowView& view) const;
  // For shade.frag with SHADOWS: the shares of light, to texture unit `unit`.
  void bind(const gl::Program& program, int unit) const;
  int mapPx() const { return map_px_; }

 private:
  DepthMode depth_mode_;
  struct Map {
    gl::Texture depth;
    gl::Framebuffer framebuffer;
  };
  std::vector<Map> maps_;  // of each light
  gl::Texture light_;
  gl::Framebuffer light_framebuffer_;
  int width_ = 0, height_ = 0, map_px_ = 0;
};

}  // namespace relievo
