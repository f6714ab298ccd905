#include "src/render/texel_table.h"

#include <algorithm>
#include <cassert>

namespace relievo {
namespace {

struct Format {
  GLenum stored, format, type;
  size_t bytes;
};
Format formatOf(TexelTable::Texel texel) {
  switch (texel) {
    case TexelTable::Texel::kUint16:
      return {GL_R16UI, GL_RED_INTEGER, GL_UNSIGNED_SHORT, 2};
    case TexelTable::Texel::kUint32:
      return {GL_R32UI, GL_RED_INTEGER, GL_UNSIGNED_INT, 4};
    case TexelTable::Texel::kUint32x2:
      return {GL_RG32UI, GL_RG_INTEGER, GL_UNSIGNED_INT, 8};
    case TexelTable::Texel::kUint32x4:
      return {GL_RGBA32UI, GL_RGBA_INTEGER, GL_UNSIGNED_INT, 16};
    case TexelTable::Texel::kFloat32x4:
      return {GL_RGBA32F, GL_RGBA, GL_FLOAT, 16};
  }
  return {};
}
constexpr GLenum kUploadUnit = GL_TEXTURE15;  // no program reads it: other units keep what was bound for a draw
size_t rowsOf(size_t texels) { return (texels + TexelTable::kRow - 1) / TexelTable::kRow; }

}  // namespace

uint64_t TexelTable::mostBufferTexels() {
  GLint most = 0;
  if (epoxy_is_desktop_gl()) glGetIntegerv(GL_MAX_TEXTURE_BUFFER_SIZE, &most);
  return static_cast<uint64_t>(std::max(most, 0));
}

uint64_t TexelTable::mostRowTexels() {
  GLint layers = 256;
  glGetIntegerv(GL_MAX_ARRAY_TEXTURE_LAYERS, &layers);
  return std::min<uint64_t>(static_cast<uint64_t>(layers) * kRow * kRows, ~uint32_t{0});
}

void TexelTable::resize(size_t texels) {
  if (texels == size_ && texture_) return;
  size_ = texels;
  const Format f = formatOf(texel_);
  if (!rows_ && epoxy_is_desktop_gl()) {
    buffer_ = gl::Buffer::create();
    glBindBuffer(GL_TEXTURE_BUFFER, buffer_.id());
    gl::label(GL_BUFFER, buffer_.id(), label_);
    glBufferData(GL_TEXTURE_BUFFER, static_cast<GLsizeiptr>(std::max<size_t>(texels, 1) * f.bytes), nullptr,
                 GL_STATIC_DRAW);
    texture_ = gl::Texture::create();
    glBindTexture(GL_TEXTURE_BUFFER, texture_.id());
    gl::label(GL_TEXTURE, texture_.id(), label_);
    glTexBuffer(GL_TEXTURE_BUFFER, f.stored, buffer_.id());
    glBindBuffer(GL_TEXTURE_BUFFER, 0);
    return;
  }
  buffer_ = {};
  texture_ = gl::createTexture(GL_TEXTURE_2D_ARRAY, label_);
  glActiveTexture(kUploadUnit);
  glBindTexture(GL_TEXTURE_2D_ARRAY, texture_.id());
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MAX_LEVEL, 0);
  const size_t rows = std::max<size_t>(rowsOf(texels), 1);
  glTexImage3D(GL_TEXTURE_2D_ARRAY, 0, static_cast<GLint>(f.stored), kRow, static_cast<GLsizei>(std::min(rows, kRows)),
               static_cast<GLsizei>((rows + kRows - 1) / kRows), 0, f.format, f.type, nullptr);
  glActiveTexture(GL_TEXTURE0);
}

void TexelTable::write(size_t first, const void* data, size_t count) {
  assert(first % kRow == 0 && first + count <= size_);
  if (count == 0) return;
  const Format f = formatOf(texel_);
  const auto* bytes = static_cast<const uint8_t*>(data);
  if (buffer_) {
    glBindBuffer(GL_TEXTURE_BUFFER, buffer_.id());
    // A whole table is a new store, so that nobody waits for a frame in flight that reads the old one.
    if (count == size_)
      glBufferData(GL_TEXTURE_BUFFER, static_cast<GLsizeiptr>(count * f.bytes), bytes, GL_STATIC_DRAW);
    else
      glBufferSubData(GL_TEXTURE_BUFFER, static_cast<GLintptr>(first * f.bytes),
                      static_cast<GLsizeiptr>(count * f.bytes), bytes);
    glBindBuffer(GL_TEXTURE_BUFFER, 0);
    return;
  }
  glActiveTexture(kUploadUnit);
  glBindTexture(GL_TEXTURE_2D_ARRAY, texture_.id());
  glPixelStorei(GL_UNPACK_ALIGNMENT, 2);
  // Whole rows, as many as the layer has; then what is left of one.
  while (count > 0) {
    const size_t row = first / kRow;
    const size_t rows = count < kRow ? 1 : std::min(count / kRow, kRows - row % kRows),
                 texels = std::min(count, rows * kRow);
    glTexSubImage3D(GL_TEXTURE_2D_ARRAY, 0, 0, static_cast<GLint>(row % kRows), static_cast<GLint>(row / kRows),
                    static_cast<GLsizei>(std::min(count, kRow)), static_cast<GLsizei>(rows), 1, f.format, f.type,
                    bytes);
    first += texels;
    count -= texels;
    bytes += texels * f.bytes;
  }
  glPixelStorei(GL_UNPACK_ALIGNMENT, 4);
  glActiveTexture(GL_TEXTURE0);
}

void* TexelTable::map(size_t count) {
  assert(count <= size_);
  if (!buffer_ || count == 0) return nullptr;
  glBindBuffer(GL_TEXTURE_BUFFER, buffer_.id());
  void* mapped = glMapBufferRange(GL_TEXTURE_BUFFER, 0, static_cast<GLsizeiptr>(count * formatOf(texel_).bytes),
                                  GL_MAP_WRITE_BIT | GL_MAP_INVALIDATE_BUFFER_BIT);
  glBindBuffer(GL_TEXTURE_BUFFER, 0);
  return mapped;
}

void TexelTable::unmap() {
  glBindBuffer(GL_TEXTURE_BUFFER, buffer_.id());
  glUnmapBuffer(GL_TEXTURE_BUFFER);
  glBindBuffer(GL_TEXTURE_BUFFER, 0);
}

void TexelTable::bind(const gl::Program& program, const char* uniform, int unit) const {
  glActiveTexture(static_cast<GLenum>(GL_TEXTURE0 + unit));
  glBindTexture(target(), texture_.id());
  glUniform1i(program.uniform(uniform), unit);
  glActiveTexture(GL_TEXTURE0);
}

}  // namespace relievo
