#include "src/render/overlay_pass.h"

#include <algorithm>
#include <cstddef>

namespace relievo {

Result<OverlayPass> OverlayPass::create(gl::Api api, int width, int height, std::span<const uint8_t> alpha) {
  OverlayPass pass;
  Result<gl::Program> program = gl::Program::link(
      api, {.vertex = "overlay.vert", .fragment = "overlay.frag", .attributes = {"a_px", "a_uv", "a_colour"}});
  if (!program) return program.error();
  pass.program_ = std::move(*program);

  pass.texture_ = gl::createTexture(GL_TEXTURE_2D, "overlay glyphs");
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, pass.texture_.id());
  glPixelStorei(GL_UNPACK_ALIGNMENT, 1);
  glTexImage2D(GL_TEXTURE_2D, 0, GL_R8, width, height, 0, GL_RED, GL_UNSIGNED_BYTE, alpha.data());
  glPixelStorei(GL_UNPACK_ALIGNMENT, 4);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_LINEAR);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_LINEAR);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);

  pass.vertices_ = gl::Buffer::create("overlay vertices");
  pass.indices_ = gl::Buffer::create("overlay indices");
  pass.vertex_array_ = gl::VertexArray::create("overlay");
  return pass;
}

void OverlayPass::draw(std::span<const OverlayVertex> vertices, std::span<const uint16_t> indices,
                       std::span<const OverlayCommand> commands, int width_px, int height_px) {
  if (vertices.empty() || indices.empty()) return;
  glViewport(0, 0, width_px, height_px);
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_CULL_FACE);
  glEnable(GL_BLEND);
  glBlendEquation(GL_FUNC_ADD);
  glBlendFuncSeparate(GL_SRC_ALPHA, GL_ONE_MINUS_SRC_ALPHA, GL_ONE, GL_ONE_MINUS_SRC_ALPHA);
  glEnable(GL_SCISSOR_TEST);

  program_.use();
  glUniform2f(program_.uniform("u_size_px"), static_cast<float>(width_px), static_cast<float>(height_px));
  glUniform1i(program_.uniform("u_glyphs"), 0);
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, texture_.id());

  glBindVertexArray(vertex_array_.id());
  glBindBuffer(GL_ARRAY_BUFFER, vertices_.id());
  glBufferData(GL_ARRAY_BUFFER, static_cast<GLsizeiptr>(vertices.size_bytes()), vertices.data(), GL_STREAM_DRAW);
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, indices_.id());
  glBufferData(GL_ELEMENT_ARRAY_BUFFER, static_cast<GLsizeiptr>(indices.size_bytes()), indices.data(), GL_STREAM_DRAW);
  for (GLuint i = 0; i < 3; ++i) glEnableVertexAttribArray(i);
  for (const OverlayCommand& c : commands) {
    const int left = std::max(c.clip[0], 0), top = std::max(c.clip[1], 0);
    const int right = std::min(c.clip[2], width_px), bottom = std::min(c.clip[3], height_px);
    if (right <= left || bottom <= top) continue;
    glScissor(left, height_px - bottom, right - left, bottom - top);
    // ES 3.0 has no base vertex: the attributes start at it instead.
    auto at = [&](size_t member) {
      return reinterpret_cast<const void*>(c.first_vertex * sizeof(OverlayVertex) + member);
    };
    constexpr GLsizei kStride = sizeof(OverlayVertex);
    glVertexAttribPointer(0, 2, GL_FLOAT, GL_FALSE, kStride, at(offsetof(OverlayVertex, x)));
    glVertexAttribPointer(1, 2, GL_FLOAT, GL_FALSE, kStride, at(offsetof(OverlayVertex, u)));
    glVertexAttribPointer(2, 4, GL_UNSIGNED_BYTE, GL_TRUE, kStride, at(offsetof(OverlayVertex, rgba)));
    glDrawElements(GL_TRIANGLES, static_cast<GLsizei>(c.indices), GL_UNSIGNED_SHORT,
                   reinterpret_cast<const void*>(static_cast<size_t>(c.first_index) * sizeof(uint16_t)));
  }
  glBindVertexArray(0);
  glDisable(GL_SCISSOR_TEST);
  glDisable(GL_BLEND);
}

}  // namespace relievo
