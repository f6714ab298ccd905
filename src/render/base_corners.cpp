#include "src/render/base_corners.h"

#include <array>
#include <string>

namespace relievo {
namespace {

constexpr size_t kPerRow = 1024;  // known to patch.vert

size_t rowsFor(size_t count) { return (count + kPerRow - 1) / kPerRow; }

gl::Texture tableTexture(const char* name) {
  gl::Texture texture = gl::Texture::create();
  glBindTexture(GL_TEXTURE_2D, texture.id());
  gl::label(GL_TEXTURE, texture.id(), name);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAX_LEVEL, 0);
  return texture;
}

void uploadFloats(const gl::Texture& texture, const std::vector<float>& texels) {
  glBindTexture(GL_TEXTURE_2D, texture.id());
  glTexImage2D(GL_TEXTURE_2D, 0, GL_RGBA32F, kPerRow, static_cast<GLsizei>(texels.size() / 4 / kPerRow), 0, GL_RGBA, GL_FLOAT, texels.data());
}

}  // namespace

BaseCorners::BaseCorners(std::shared_ptr<const BaseMesh> base)
    : base_(std::move(base)), positions_(tableTexture("corner positions")), normals_(tableTexture("corner normals")), patches_(tableTexture("patches")) {
  texels_.resize(rowsFor(base_->corners.size()) * kPerRow * 4);
  for (size_t i = 0; i < base_->corners.size(); ++i) {
    for (int k = 0; k < 3; ++k) texels_[4 * i + static_cast<size_t>(k)] = base_->corners[i].normal[k];
  }
  uploadFloats(normals_, texels_);
  std::vector<uint32_t> indices(rowsFor(base_->patches.size()) * kPerRow * 4);
  for (size_t p = 0; p < base_->patches.size(); ++p)
    for (size_t k = 0; k < 4; ++k) indices[4 * p + k] = base_->patches[p][k];
  glBindTexture(GL_TEXTURE_2D, patches_.id());
  glTexImage2D(GL_TEXTURE_2D, 0, GL_RGBA32UI, kPerRow, static_cast<GLsizei>(indices.size() / 4 / kPerRow), 0, GL_RGBA_INTEGER, GL_UNSIGNED_INT,
               indices.data());
}

void BaseCorners::setEye(const glm::dvec3& eye_mm) {
  if (eye_mm_ == eye_mm) return;
  eye_mm_ = eye_mm;
  for (size_t i = 0; i < base_->corners.size(); ++i) {
    const glm::vec3 from_eye(glm::dvec3(base_->corners[i].position_mm) - eye_mm);
    for (int k = 0; k < 3; ++k) texels_[4 * i + static_cast<size_t>(k)] = from_eye[k];
  }
  uploadFloats(positions_, texels_);
}

void BaseCorners::bind(const gl::Program& program, int first_unit) const {
  const std::array<std::pair<const gl::Texture*, const char*>, 3> all{{{&positions_, "u_corners"}, {&normals_, "u_normals"}, {&patches_, "u_base"}}};
  for (int k = 0; k < 3; ++k) {
    glActiveTexture(static_cast<GLenum>(GL_TEXTURE0 + first_unit + k));
    glBindTexture(GL_TEXTURE_2D, all[static_cast<size_t>(k)].first->id());
    glUniform1i(program.uniform(all[static_cast<size_t>(k)].second), first_unit + k);
  }
  glActiveTexture(GL_TEXTURE0);
}

}  // namespace relievo
