// base_corners.h - a base mesh as the vertex shader reads it (shaders/patch.vert, MESH): the corners'
// positions relative to the eye, their normals, and the corner indices of each patch. Positions are rounded from double
// to float once a corner and frame, so that every patch at a corner gets the same bits.
#pragma once

#include <memory>
#include <optional>
#include <vector>

#include "src/artwork/base_mesh.h"
#include "src/gl/program.h"
#include "src/render/texel_table.h"

namespace relievo {

class BaseCorners {
 public:
  explicit BaseCorners(std::shared_ptr<const BaseMesh> base);
  void setEye(const glm::dvec3& eye_mm);  // uploads the positions if the eye moved
  // For the program in use; binds texture units first_unit .. first_unit + 2.
  void bind(const gl::Program& program, int first_unit) const;

 private:
  std::shared_ptr<const BaseMesh> base_;
  TexelTable positions_{"corner positions", TexelTable::Texel::kFloat32x4},
      normals_{"corner normals", TexelTable::Texel::kFloat32x4}, patches_{"patches", TexelTable::Texel::kUint32x4};
  std::optional<glm::dvec3> eye_mm_;
  std::vector<glm::vec4> texels_;
};

}  // namespace relievo
