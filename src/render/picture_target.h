// picture_target.h - the framebuffer that the picture is drawn into, and the uniforms that every shading program
// shares.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include <glm/glm.hpp>

#include "src/artwork/basis.h"
#include "src/artwork/patch_domain.h"
#include "src/gl/objects.h"
#include "src/gl/program.h"
#include "src/render/depth.h"

namespace relievo {

// What a window shows beside the artwork, sRGB.
inline constexpr std::array<uint8_t, 3> kPictureGrey{24, 24, 26};
glm::vec4 pictureGreyLight();  // in linear light, with alpha 1

class PictureTarget {
 public:
  explicit PictureTarget(const DepthMode& depth_mode = depthMode()) : depth_mode_(depth_mode) {}
  // depth: of the surface that is shaded, a texture of the same size and mode; it is not owned, and is read only.
  void resize(int width_px, int height_px, GLuint depth);
  void bind() const;
  int width() const { return width_; }
  int height() const { return height_; }
  // Binds, sets the depth test and clears the colour to kPictureGrey with alpha 0.
  void begin() const;
  // RGBA, rows top first. Waits for the picture.
  std::vector<uint8_t> readPixels() const;
  // Copies to the framebuffer that the window shows (0).
  void present(int window_width_px, int window_height_px) const;

 private:
  DepthMode depth_mode_;
  gl::Texture colour_;
  GLuint depth_ = 0;
  gl::Framebuffer framebuffer_;
  int width_ = 0, height_ = 0;
};

struct ShadingParameters {
  const TextureFormat* format = nullptr;
  const PatchDomain* domain = nullptr;
  double lod_bias = 0;
  // For a feedback pass: its pixel (i, j) is pixel (i, j) * sample[0] + (sample[1], sample[2]) of the picture.
  std::array<int, 3> sample{1, 0, 0};
  int tap_phase = 0;                     // for an anisotropic feedback pass (shaders/feedback.frag)
  std::array<double, 3> light{0, 0, 1};  // the unit vector towards it, in the artwork's space
  double now_s = 0, page_fade_s = 0;     // page_fade_s 0: no fade
  bool fades_over = false;               // every page shows whole, whatever its age: a settled picture
};
// The defines of a program that shades this basis (shaders/shade.frag). They compile into it which channel holds which
// coefficient.
gl::Defines shadingDefines(Basis basis);
// For the program in use.
void setShadingUniforms(const gl::Program& program, const ShadingParameters& p);

struct NamedUniform {
  std::string name;
  glm::vec4 value{0};
};
// An array of four: the matrix's columns.
void addColumns(const std::string& name, const glm::dmat4& matrix, std::vector<NamedUniform>& to);
void setNamedUniforms(const gl::Program& program, std::span<const NamedUniform> uniforms);  // of the program in use

void submitFrame();  // hands the frame's commands to the driver; does not wait
void finishFrame();  // waits until they are done

}  // namespace relievo
