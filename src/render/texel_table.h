// texel_table.h - a table that shaders read by index (shaders/texel_table.glsl). Under OpenGL it is a buffer texture,
// which software drivers read in half the time of an image's texel (no levels, no rows, and neighbours are adjacent in
// memory). Under OpenGL ES 3.0, which has no buffer textures, it is rows of an array texture.
#pragma once

#include <cstddef>
#include <cstdint>

#include "src/gl/objects.h"
#include "src/gl/program.h"

namespace relievo {

class TexelTable {
 public:
  enum class Texel { kUint16, kUint32, kUint32x2, kUint32x4, kFloat32x4 };
  static constexpr size_t kRow = 2048, kRows = 2048;  // of a layer; known to shaders/texel_table.glsl
  // How long a table may be in this context. Drivers allow buffers of 2^27 texels and more; 2^16 is the least that the
  // specification asks for.
  static uint64_t mostBufferTexels();  // 0: there are no buffer textures
  static uint64_t mostRowTexels();

  TexelTable() = default;
  // rows: as rows of an array texture in any context; shaders need the define TAIL_ROWS then.
  TexelTable(const char* label, Texel texel, bool rows = false) : label_(label), texel_(texel), rows_(rows) {}
  // Makes room for so many texels; their contents are undefined.
  void resize(size_t texels);
  // Texels first .. first + count, of this many bytes; first is a multiple of kRow.
  void write(size_t first, const void* data, size_t count);
  // Memory for the first `count` texels, to be filled from the first to the last and handed over by unmap(); the
  // table's old contents are lost. nullptr where the table is rows: use write() then.
  void* map(size_t count);
  void unmap();
  void bind(const gl::Program& program, const char* uniform, int unit) const;
  size_t size() const { return size_; }

 private:
  GLenum target() const { return buffer_ ? GL_TEXTURE_BUFFER : GL_TEXTURE_2D_ARRAY; }
  const char* label_ = nullptr;
  Texel texel_ = Texel::kUint32;
  bool rows_ = false;
  size_t size_ = 0;
  gl::Texture texture_;
  gl::Buffer buffer_;  // empty: rows
};

}  // namespace relievo
