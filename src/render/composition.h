// composition.h - pictures of several artworks that are seen through the same camera, each drawn with its own near and
// far plane, put together: at each pixel the nearest is seen, and where it covers a part of the pixel (several samples)
// what is behind it shows in the rest. Each picture's depth becomes a nearness that is the same measure for all:
//   perspective   1 / z, z the distance from the eye along the line of sight: 1/f + t (1/n - 1/f)
//   orthographic  -z, from the target: -f + t (f - n)
// with near n and far f, and t from 0 at the far plane to 1 at the near one: reversed depth itself, or 1 less depth.
// Both are linear in what the depth buffer holds and lose none of its digits: n and f are in double precision, and the
// sum of two terms of a sign (perspective) is good to a float's 1e-7. Needs a current GL context.
#pragma once

#include <cstdint>
#include <vector>

#include <glm/glm.hpp>

#include "src/base/result.h"
#include "src/gl/context.h"
#include "src/gl/program.h"
#include "src/render/camera.h"
#include "src/render/picture_target.h"
#include "src/render/surface_target.h"

namespace relievo {

// Of the far plane, and what the near plane has more.
glm::dvec2 nearnessOf(const ViewTransform& view);

class Composition {
 public:
  static constexpr int kMostLayers = 16;
  static Result<Composition> create(gl::Api api, const DepthMode& depth);

  // Then take() for each layer. Memory follows the number of layers and the size.
  void begin(int width_px, int height_px, int layers);
  // Copies a picture, alpha 0 where its artwork is not, and its depth, a texture of the mode that create() was given.
  // The order of layers decides between equal depths alone.
  void take(int layer, const PictureTarget& picture, GLuint depth, const ViewTransform& view);
  // Puts them together. behind.a 1: over this colour (linear light), opaque; 0: alpha stays the share of a pixel that
  // is covered.
  void draw(const ScreenPass& screen, const glm::vec4& behind);
  const PictureTarget& picture() const { return picture_; }
  uint64_t bytes() const;  // on the GPU

 private:
  explicit Composition(const DepthMode& depth) : depth_mode_(depth), picture_(depth) {}

  DepthMode depth_mode_;
  gl::Program program_;
  gl::Texture colours_, depths_;
  gl::Framebuffer from_, to_;
  PictureTarget picture_;
  std::vector<glm::vec2> nearness_;
  int width_ = 0, height_ = 0, layers_ = 0;
};

}  // namespace relievo
