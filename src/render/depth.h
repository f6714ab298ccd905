// depth.h - how depth is stored: one place decides, and every pass that draws with a depth test asks here.
// Reversed: the near plane at 1, the far plane at 0, 32-bit floats, z of clip space within 0..w. A float's steps shrink
// towards 0 as those of perspective do, so that depth is told apart to about 1e-7 of the distance, wherever the near
// plane lies. Conventional: 0 to 1 in 24-bit fixed point, z within -w..w, for contexts without clip control: steps
// there grow with the square of the distance over the near plane's. Needs a current context.
#pragma once

#include <array>

#include <epoxy/gl.h>
#include <glm/glm.hpp>

#include "src/gl/objects.h"

namespace relievo {

struct DepthMode {
  bool reversed = false;
  bool clip_control = false;  // the context has it, so that other code may have changed it

  GLenum format() const { return reversed ? GL_DEPTH_COMPONENT32F : GL_DEPTH_COMPONENT24; }
  GLenum nearerOrEqual() const { return reversed ? GL_GEQUAL : GL_LEQUAL; }
  GLenum farther() const { return reversed ? GL_LESS : GL_GREATER; }
  // What the buffer is cleared to; also z / w of clip space at the far plane.
  float farPlane() const { return reversed ? 0.0f : 1.0f; }
  // What to add to z / w of clip space to draw something nearer by `bias` (of the conventional -1..1).
  float nearer(float bias) const { return reversed ? 0.5f * bias : -bias; }
};

// Reversed where it is wanted and the context has clip control (GL 4.5, GL_ARB_clip_control, GL_EXT_clip_control).
DepthMode depthMode(bool request_reversed = true);
const char* depthName(bool reversed);  // for people: "reversed, 32-bit float" or "conventional, 24-bit"

// Turns the depth test on, lets what is nearer or equal pass, and sets the mode's clip space. Passes without a depth
// test work in either clip space.
void beginDepth(const DepthMode& mode);

// A texture of depths of the mode's format, without filters.
gl::Texture createDepth(const char* label, int width_px, int height_px, const DepthMode& mode);
// Attaches a texture of depths alone, and no colour, and leaves the framebuffer bound.
void attachDepthAlone(const gl::Framebuffer& framebuffer, GLuint depth);

// From a pixel's place and depth, each 0..1 as the GL stores them, to the camera's clip space, z within -w..w.
glm::dmat4 clipFromPixel(const DepthMode& mode);

// What the GL is given to turn mm from `origin_mm` into its clip space, column by column: from the camera's matrix (z
// within -w..w), in double precision until the end.
std::array<float, 16> glClipFrom(const glm::dmat4& clip_from_world, const glm::dvec3& origin_mm, const DepthMode& mode);

}  // namespace relievo
