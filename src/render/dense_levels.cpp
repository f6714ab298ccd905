#include "src/render/dense_levels.h"

#include "src/artwork/patch_domain.h"

namespace relievo {

DenseLevels::DenseLevels(int depth, int planes) : depth_(depth), texture_(gl::Texture::create()) {
  glBindTexture(GL_TEXTURE_2D_ARRAY, texture_.id());
  gl::label(GL_TEXTURE, texture_.id(), "dense levels");
  for (int level = depth; level >= 0; --level) {  // the largest first: else NVIDIA's driver knows no level but that one
    glTexImage3D(GL_TEXTURE_2D_ARRAY, depth - level, GL_RGBA8, kPagePx << level, kPagePx << level, planes, 0, GL_RGBA,
                 GL_UNSIGNED_BYTE, nullptr);
  }
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MAX_LEVEL, depth);
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);
}

void DenseLevels::upload(int level, int plane, uint32_t x, uint32_t y, std::span<const uint8_t> slot_texels) {
  glBindTexture(GL_TEXTURE_2D_ARRAY, texture_.id());
  glPixelStorei(GL_UNPACK_ROW_LENGTH, kPageFullPx);
  const uint8_t* payload = slot_texels.data() + 4 * (kPageBorderPx * kPageFullPx + kPageBorderPx);
  glTexSubImage3D(GL_TEXTURE_2D_ARRAY, depth_ - level, static_cast<GLint>(x) * kPagePx, static_cast<GLint>(y) * kPagePx,
                  plane, kPagePx, kPagePx, 1, GL_RGBA, GL_UNSIGNED_BYTE, payload);
  glPixelStorei(GL_UNPACK_ROW_LENGTH, 0);
}

void DenseLevels::bind(const gl::Program& program, bool linear) const {
  glActiveTexture(GL_TEXTURE6);
  glBindTexture(GL_TEXTURE_2D_ARRAY, texture_.id());
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MIN_FILTER,
                  linear ? GL_LINEAR_MIPMAP_LINEAR : GL_NEAREST_MIPMAP_NEAREST);
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MAG_FILTER, linear ? GL_LINEAR : GL_NEAREST);
  glActiveTexture(GL_TEXTURE0);
  glUniform1i(program.uniform("u_dense"), 6);
}

}  // namespace relievo
