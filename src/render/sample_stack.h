// sample_stack.h - several pictures of one view, each seen through another place of its pixels, and their average:
// multisampling by drawing the view again, so that it smooths what is seen within the artwork as well as its borders.
// The pictures lie in the layers of one RGBA8 texture, which every context can draw and read: neither float targets nor
// multisampled integer ones are needed. Needs a current context.
#pragma once

#include <span>

#include <glm/glm.hpp>

#include "src/gl/objects.h"
#include "src/gl/program.h"
#include "src/render/picture_target.h"
#include "src/render/surface_target.h"

namespace relievo {

// The places of 1, 4 or 8 samples in a pixel: px from its centre, x right, y down, within half a pixel of it. Other
// numbers count as the next smaller one of these. 4 and 8 are the standard sample locations of Vulkan (1.3
// specification, "Rasterization", table "Standard sample locations") and of Direct3D 11
// (D3D11_STANDARD_MULTISAMPLE_PATTERN): no two samples share a row or a column of the pixel's 16, and their mean is the
// centre.
std::span<const glm::dvec2> samplePattern(int samples);

class SampleStack {
 public:
  // Memory (4 bytes a pixel for each sample, and for the average) is taken with the first picture.
  explicit SampleStack(int samples) : samples_(samples) {}
  int samples() const { return samples_; }
  // Copies the picture to layer `index`, from 0. Where its size differs from the last one's the other layers are lost.
  void take(const PictureTarget& picture, int index);
  // Draws the average of the first `count` layers (shaders/average.frag) into the picture: alpha is the share of
  // samples that show the artwork, and the colour is theirs. Where none does, colour and alpha are 0.
  void average(const gl::Program& program, const ScreenPass& screen, int count, const PictureTarget& into) const;
  // Draws what average() drew last into the framebuffer that the window shows (0), over kPictureGrey.
  void present(const gl::Program& program, const ScreenPass& screen, int window_width_px, int window_height_px) const;

 private:
  void copy(const PictureTarget& picture, int layer) const;
  void draw(const gl::Program& program, const ScreenPass& screen, const glm::ivec2& layers, int width_px, int height_px,
            const glm::vec4& behind) const;

  int samples_ = 1;
  gl::Texture layers_;  // the last one is the average
  int width_ = 0, height_ = 0;
};

}  // namespace relievo
