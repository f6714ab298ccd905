#include "src/render/page_pool.h"

#include <algorithm>
#include <bit>

#include "src/base/planar_domain.h"
#include "texturing/page_codec.h"

namespace relievo {
namespace {

constexpr int kFirstLayers = 8;  // 36 MiB: the roots and a first view

void setNearest(GLenum target) {
  glTexParameteri(target, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  glTexParameteri(target, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  glTexParameteri(target, GL_TEXTURE_WRAP_S, GL_CLAMP_TO_EDGE);
  glTexParameteri(target, GL_TEXTURE_WRAP_T, GL_CLAMP_TO_EDGE);
}

gl::Texture makeTable(const char* label, uint32_t width, uint32_t height) {
  auto texture = gl::Texture::create();
  glBindTexture(GL_TEXTURE_2D, texture.id());
  gl::label(GL_TEXTURE, texture.id(), label);
  setNearest(GL_TEXTURE_2D);
  glTexImage2D(GL_TEXTURE_2D, 0, GL_RGBA32UI, static_cast<GLsizei>(width), static_cast<GLsizei>(height), 0,
               GL_RGBA_INTEGER, GL_UNSIGNED_INT, nullptr);
  return texture;
}

// Runs of neighbouring dirty texels within a row become one upload.
void uploadRuns(GLuint texture, std::span<const uint32_t> dirty, std::span<const std::array<uint32_t, 4>> texels,
                uint32_t width) {
  glBindTexture(GL_TEXTURE_2D, texture);
  for (size_t i = 0; i < dirty.size();) {
    size_t end = i + 1;
    while (end < dirty.size() && dirty[end] == dirty[end - 1] + 1 && dirty[end] % width != 0) ++end;
    glTexSubImage2D(GL_TEXTURE_2D, 0, static_cast<GLint>(dirty[i] % width), static_cast<GLint>(dirty[i] / width),
                    static_cast<GLsizei>(end - i), 1, GL_RGBA_INTEGER, GL_UNSIGNED_INT, &texels[dirty[i]]);
    i = end;
  }
}

}  // namespace

uint32_t PagePool::maxSlots() {
  GLint layers = 256;
  glGetIntegerv(GL_MAX_ARRAY_TEXTURE_LAYERS, &layers);
  return std::min<uint32_t>(static_cast<uint32_t>(layers) * kSlotsPerLayer, 65535);  // slots are 16-bit in the page table
}

PagePool::PagePool(uint32_t slot_count)
    : max_layers_(static_cast<int>((slot_count + kSlotsPerLayer - 1) / kSlotsPerLayer)) {
  grow(std::min(max_layers_, kFirstLayers));
}

uint64_t PagePool::textureBytes() const { return static_cast<uint64_t>(layers_) * kSlotsPerLayer * kSlotBytes; }

void PagePool::grow(int layers) {
  gl::Texture larger = gl::Texture::create();
  glBindTexture(GL_TEXTURE_2D_ARRAY, larger.id());
  gl::label(GL_TEXTURE, larger.id(), "page pool");
  setNearest(GL_TEXTURE_2D_ARRAY);
  // The fast filter reads through the texture unit; borders keep it inside the slot.
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MIN_FILTER, GL_LINEAR);
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MAG_FILTER, GL_LINEAR);
  constexpr GLsizei kSide = kSlotsPerSide * kPageFullPx;
  glTexImage3D(GL_TEXTURE_2D_ARRAY, 0, GL_RGBA8, kSide, kSide, layers, 0, GL_RGBA, GL_UNSIGNED_BYTE, nullptr);
  if (layers_ > 0) {
    gl::Framebuffer from = gl::Framebuffer::create();
    glBindFramebuffer(GL_READ_FRAMEBUFFER, from.id());
    for (int layer = 0; layer < layers_; ++layer) {
      glFramebufferTextureLayer(GL_READ_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, pool_.id(), 0, layer);
      glCopyTexSubImage3D(GL_TEXTURE_2D_ARRAY, 0, 0, 0, layer, 0, 0, kSide, kSide);
    }
    glBindFramebuffer(GL_READ_FRAMEBUFFER, 0);
  }
  pool_ = std::move(larger);
  layers_ = layers;
}

void PagePool::upload(std::span<const PageUpload> uploads) {
  if (uploads.empty()) return;
  int last_layer = 0;
  for (const PageUpload& u : uploads) last_layer = std::max(last_layer, static_cast<int>(u.slot / kSlotsPerLayer));
  if (last_layer >= layers_) grow(std::min(max_layers_, std::max(2 * layers_, last_layer + 1)));
  glBindTexture(GL_TEXTURE_2D_ARRAY, pool_.id());
  for (const PageUpload& u : uploads) {
    GLint x = static_cast<GLint>(u.slot % kSlotsPerSide) * kPageFullPx;
    GLint y = static_cast<GLint>(u.slot / kSlotsPerSide % kSlotsPerSide) * kPageFullPx;
    glTexSubImage3D(GL_TEXTURE_2D_ARRAY, 0, x, y, static_cast<GLint>(u.slot / kSlotsPerLayer), kPageFullPx, kPageFullPx, 1,
                    GL_RGBA, GL_UNSIGNED_BYTE, u.texels);
    bytes_uploaded_ += kSlotBytes;
  }
}

void PagePool::uploadTable(PageTable& table) {
  auto dirty = table.takeDirty();
  bool has_extra = table_extra_.id() != 0, wants_extra = !table.extraTexels().empty();
  if (table.width() != table_width_ || table.height() != table_height_ || has_extra != wants_extra) {
    table_width_ = table.width();
    table_height_ = table.height();
    table_ = makeTable("page table", table_width_, table_height_);
    table_extra_ = {};
    if (wants_extra) table_extra_ = makeTable("page table, planes 3..", table_width_, table_height_);
    dirty.resize(table.texels().size());
    for (uint32_t i = 0; i < dirty.size(); ++i) dirty[i] = i;
  }
  if (dirty.empty()) return;
  uploadRuns(table_.id(), dirty, table.texels(), table_width_);
  if (table_extra_.id() != 0) uploadRuns(table_extra_.id(), dirty, table.extraTexels(), table_width_);
}

void PagePool::bind(const gl::Program& program, const PageTable& table) const {
  glActiveTexture(GL_TEXTURE1);
  glBindTexture(GL_TEXTURE_2D, table_.id());
  glActiveTexture(GL_TEXTURE2);
  glBindTexture(GL_TEXTURE_2D, table_extra_.id());
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D_ARRAY, pool_.id());
  glUniform1i(program.uniform("u_pool"), 0);
  glUniform1i(program.uniform("u_table"), 1);
  glUniform1i(program.uniform("u_table_extra"), 2);
  uint32_t entries = table.width() * table.height();
  glUniform4ui(program.uniform("u_table_shape"), entries - 1, static_cast<GLuint>(std::countr_zero(table.width())),
               table.seed(), 0);
}

}  // namespace relievo
