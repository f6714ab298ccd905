// texel_table.h - a table that shaders read by index (shaders/texel_table.glsl): a buffer texture under OpenGL, which
// the present drivers in software read for half of what a texel of an image costs them (no levels, no rows, and what
// belongs together is side by side in memory); rows of an array texture where there are none (OpenGL ES 3.0).
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
  // rows: not as a buffer, however the context is: shaders need to know (TAIL_ROWS).
  TexelTable(const char* label, Texel texel, bool rows = false) : label_(label), texel_(texel), rows_(rows) {}
  // Room for so many texels, of unknown contents.
  void resize(size_t texels);
  // Texels first .. first + count, of this many bytes; first is a multiple of kRow.
  void write(size_t first, const void* data, size_t count);
  // Room for the first `count` texels, to be filled from the first to the last and handed over by unmap(); what the
  // table held is lost. nullptr where it is rows: write() then.
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
