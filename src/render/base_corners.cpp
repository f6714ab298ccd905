#include "src/render/base_corners.h"

namespace relievo {

BaseCorners::BaseCorners(std::shared_ptr<const BaseMesh> base) : base_(std::move(base)) {
  const size_t corners = base_->corners.size(), patches = base_->patches.size();
  texels_.resize(corners);
  for (size_t i = 0; i < corners; ++i) texels_[i] = glm::vec4(base_->corners[i].normal, 0);
  normals_.resize(corners);
  normals_.write(0, texels_.data(), corners);
  positions_.resize(corners);
  patches_.resize(patches);
  static_assert(sizeof(base_->patches[0]) == 16);
  patches_.write(0, base_->patches.data(), patches);
}

void BaseCorners::setEye(const glm::dvec3& eye_mm) {
  if (eye_mm_ == eye_mm) return;
  eye_mm_ = eye_mm;
  for (size_t i = 0; i < texels_.size(); ++i)
    texels_[i] = glm::vec4(glm::vec3(glm::dvec3(base_->corners[i].position_mm) - eye_mm), 0);
  positions_.write(0, texels_.data(), texels_.size());
}

void BaseCorners::bind(const gl::Program& program, int first_unit) const {
  positions_.bind(program, "u_corners", first_unit);
  normals_.bind(program, "u_normals", first_unit + 1);
  patches_.bind(program, "u_base", first_unit + 2);
  glUniform1i(program.uniform("u_cut"), base_->cut);
}

}  // namespace relievo
