#include "src/render/page_pool.h"

#include <algorithm>
#include <bit>

#include "src/artwork/patch_domain.h"
#include "src/gl/context.h"
#include "src/render/block_formats.h"
#include "texturing/codec/page_codec.h"
#include "texturing/stream/relief_subslots.h"

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
                uint32_t width, uint32_t first_row = 0) {
  glBindTexture(GL_TEXTURE_2D, texture);
  for (size_t i = 0; i < dirty.size();) {
    size_t end = i + 1;
    while (end < dirty.size() && dirty[end] == dirty[end - 1] + 1 && dirty[end] % width != 0) ++end;
    glTexSubImage2D(GL_TEXTURE_2D, 0, static_cast<GLint>(dirty[i] % width),
                    static_cast<GLint>(first_row + dirty[i] / width), static_cast<GLsizei>(end - i), 1, GL_RGBA_INTEGER,
                    GL_UNSIGNED_INT, &texels[dirty[i]]);
    i = end;
  }
}

void copyLayers(GLuint from, int layers, GLsizei side) {  // to the texture that is bound
  gl::Framebuffer framebuffer = gl::Framebuffer::create();
  glBindFramebuffer(GL_READ_FRAMEBUFFER, framebuffer.id());
  for (int layer = 0; layer < layers; ++layer) {
    glFramebufferTextureLayer(GL_READ_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, from, 0, layer);
    glCopyTexSubImage3D(GL_TEXTURE_2D_ARRAY, 0, 0, 0, layer, 0, 0, side, side);
  }
  glBindFramebuffer(GL_READ_FRAMEBUFFER, 0);
}

// Clears a layer of a new texture, as a target: by that GPU drivers know whose it is, and make it in the GPU's memory.
// Else NVIDIA's makes it in the processor's, and moves all of it when it is first written or sampled: 100 ms for 256
// MiB instead of 0.4.
void makeOnGpu(GLuint texture) {
  if (gl::currentContextInfo().software) return;
  GLint before = 0;
  glGetIntegerv(GL_DRAW_FRAMEBUFFER_BINDING, &before);
  gl::Framebuffer framebuffer = gl::Framebuffer::create();
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, framebuffer.id());
  glFramebufferTextureLayer(GL_DRAW_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, texture, 0, 0);
  const float nothing[4] = {0, 0, 0, 0};
  glClearBufferfv(GL_COLOR, 0, nothing);
  glBindFramebuffer(GL_DRAW_FRAMEBUFFER, static_cast<GLuint>(before));
}

bool canCopyImages() {
  for (const char* name : {"GL_ARB_copy_image", "GL_EXT_copy_image", "GL_OES_copy_image"})
    if (epoxy_has_gl_extension(name)) return true;
  return false;
}

}  // namespace

ReliefPlace reliefPlace(SlotIndex name) {
  const SlotPart part = partOf(name);
  const PartOffset at = offsetInSlot(part);
  const uint32_t x = part.slot % kSlotsPerSide * kPageFullPx + static_cast<uint32_t>(at.x);
  const uint32_t y = part.slot / kSlotsPerSide % kSlotsPerSide * kPageFullPx + static_cast<uint32_t>(at.y);
  return {x | y << 11 | part.slot / kSlotsPerLayer << 22, std::max(reliefStepLog2(part.level), 0), isThird(part.level)};
}

uint32_t PagePool::maxSlots() {
  GLint layers = 256;
  glGetIntegerv(GL_MAX_ARRAY_TEXTURE_LAYERS, &layers);
  return std::min<uint32_t>(static_cast<uint32_t>(layers) * kSlotsPerLayer,
                            65535);  // slots are 16-bit in the page table
}

PagePool::PagePool(const CacheSlots& slots, bool staged) : ring_(staged) { reshape(slots); }

void PagePool::reshape(const CacheSlots& slots) {
  const bool blocks = isBlockCodec(slots.upload);
  const auto layersOf = [](uint32_t n) { return static_cast<int>((n + kSlotsPerLayer - 1) / kSlotsPerLayer); };
  slots_ = slots;
  texels_ = {.textures = {}, .count = 0, .max = layersOf(blocks ? slots.relief : slots.texture)};
  blocks_ = {.textures = {}, .count = 0, .max = blocks ? layersOf(slots.texture) : 0};
  if (!blocks) reserve(false, 0);
}

uint64_t PagePool::textureBytes() const {
  const uint64_t block_layer = kSlotsPerLayer * slotBytes(slots_.upload, texturePlane(0));
  return static_cast<uint64_t>(texels_.count) * kSlotsPerLayer * kSlotBytes +
         static_cast<uint64_t>(blocks_.count) * block_layer;
}

gl::Defines PagePool::defines(PageCodec upload) {
  if (!isBlockCodec(upload)) return {};
  return {{"BLOCKS", std::to_string(blockFormats(upload).size())}};
}

// Has room for this slot.
void PagePool::reserve(bool blocks, SlotIndex last) {
  const Layers& now = blocks ? blocks_ : texels_;
  const int needed = static_cast<int>(last / kSlotsPerLayer) + 1;
  if (needed <= now.count) return;
  const bool at_once = blocks && !canCopyImages();
  grow(blocks, at_once ? now.max : std::min(now.max, std::max({kFirstLayers, 2 * now.count, needed})));
}

void PagePool::grow(bool blocks, int layers) {
  Layers& now = blocks ? blocks_ : texels_;
  constexpr GLsizei kSide = kSlotsPerSide * kPageFullPx;
  const std::span<const BlockFormat> formats = blocks ? blockFormats(slots_.upload) : std::span<const BlockFormat>();
  for (size_t i = 0; i < (blocks ? formats.size() : 1); ++i) {
    gl::Texture larger = gl::Texture::create();
    glBindTexture(GL_TEXTURE_2D_ARRAY, larger.id());
    gl::label(GL_TEXTURE, larger.id(), blocks ? "page pool, blocks" : "page pool");
    setNearest(GL_TEXTURE_2D_ARRAY);
    // The fast filter reads through the texture unit; borders keep it inside the slot.
    glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MIN_FILTER, GL_LINEAR);
    glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MAG_FILTER, GL_LINEAR);
    if (blocks) {
      const size_t bytes = static_cast<size_t>(layers) * kSlotsPerLayer * kPageBlocks * formats[i].block_bytes;
      glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MAX_LEVEL, 0);
      glCompressedTexImage3D(GL_TEXTURE_2D_ARRAY, 0, formats[i].format, kSide, kSide, layers, 0,
                             static_cast<GLsizei>(bytes), nullptr);
    } else {
      glTexImage3D(GL_TEXTURE_2D_ARRAY, 0, GL_RGBA8, kSide, kSide, layers, 0, GL_RGBA, GL_UNSIGNED_BYTE, nullptr);
      makeOnGpu(larger.id());
    }
    if (now.count > 0 && canCopyImages())
      glCopyImageSubData(now.textures[i].id(), GL_TEXTURE_2D_ARRAY, 0, 0, 0, 0, larger.id(), GL_TEXTURE_2D_ARRAY, 0, 0,
                         0, 0, kSide, kSide, now.count);
    else if (now.count > 0)
      copyLayers(now.textures[i].id(), now.count,
                 kSide);  // after which NVIDIA's driver takes milliseconds for each upload
    now.textures[i] = std::move(larger);
  }
  now.count = layers;
}

void PagePool::upload(std::span<const PageUpload> uploads) {
  for (bool blocks : {false, true}) {
    bool any = false;
    SlotIndex last = 0;
    for (const PageUpload& u : uploads) {
      if (inBlocks(u.id) != blocks) continue;
      any = true;
      last = std::max(last, partOf(u.slot).slot);
    }
    if (!any) continue;
    reserve(blocks, last);
    ring_.bind();
    const std::span<const BlockFormat> formats = blocks ? blockFormats(slots_.upload) : std::span<const BlockFormat>();
    size_t from = 0;  // of a page's memory
    for (size_t i = 0; i < (blocks ? formats.size() : 1); ++i) {
      const size_t bytes = blocks ? kPageBlocks * formats[i].block_bytes : kSlotBytes;
      glBindTexture(GL_TEXTURE_2D_ARRAY, (blocks ? blocks_ : texels_).textures[i].id());
      for (const PageUpload& u : uploads) {
        if (inBlocks(u.id) != blocks) continue;
        if (u.id.plane() == Plane::kRelief) {
          uploadRelief(u);
          continue;
        }
        const GLint x = static_cast<GLint>(u.slot % kSlotsPerSide) * kPageFullPx;
        const GLint y = static_cast<GLint>(u.slot / kSlotsPerSide % kSlotsPerSide) * kPageFullPx;
        const GLint layer = static_cast<GLint>(u.slot / kSlotsPerLayer);
        if (blocks) {
          glCompressedTexSubImage3D(GL_TEXTURE_2D_ARRAY, 0, x, y, layer, kPageFullPx, kPageFullPx, 1, formats[i].format,
                                    static_cast<GLsizei>(bytes), ring_.stage({u.texels + from, bytes}));
        } else {
          glTexSubImage3D(GL_TEXTURE_2D_ARRAY, 0, x, y, layer, kPageFullPx, kPageFullPx, 1, GL_RGBA, GL_UNSIGNED_BYTE,
                          ring_.stage({u.texels, bytes}));
        }
        bytes_uploaded_ += bytes;
      }
      from += bytes;
    }
    ring_.unbind();
  }
}

// The texture is bound, and the ring.
void PagePool::uploadRelief(const PageUpload& u) {
  const int level = std::max(partOf(u.slot).level, kReliefPartLevel);
  packed_.resize(partBytes(level));
  packRelief({u.texels, kSlotBytes}, level, packed_);
  const uint32_t at = reliefPlace(u.slot).texel;
  glTexSubImage3D(GL_TEXTURE_2D_ARRAY, 0, static_cast<GLint>(at & 2047), static_cast<GLint>(at >> 11 & 2047),
                  static_cast<GLint>(at >> 22), partColumns(level), partRows(level), 1, GL_RGBA, GL_UNSIGNED_BYTE,
                  ring_.stage(packed_));
  bytes_uploaded_ += packed_.size();
}

bool PagePool::uploadTable(PageTable& table) {
  auto dirty = table.takeDirty();
  if (table.width() != table_width_ || table.height() != table_height_ || table.extraLayers() != table_layers_) {
    table_width_ = table.width();
    table_height_ = table.height();
    table_ = makeTable("page table", table_width_, table_height_);
    table_layers_ = table.extraLayers();
    table_extra_ = {};
    if (table_layers_ > 0)
      table_extra_ = makeTable("page table, planes 3..", table_width_, table_layers_ * table_height_);
    dirty.resize(table.texels().size());
    for (uint32_t i = 0; i < dirty.size(); ++i) dirty[i] = i;
  }
  if (dirty.empty()) return false;
  uploadRuns(table_.id(), dirty, table.texels(), table_width_);
  const size_t entries = table.texels().size();
  for (uint32_t layer = 0; layer < table_layers_; ++layer)
    uploadRuns(table_extra_.id(), dirty, table.extraTexels().subspan(layer * entries, entries), table_width_,
               layer * table_height_);
  return true;
}

void PagePool::bind(const gl::Program& program, const PageTable& table) const {
  glActiveTexture(GL_TEXTURE1);
  glBindTexture(GL_TEXTURE_2D, table_.id());
  glActiveTexture(GL_TEXTURE2);
  glBindTexture(GL_TEXTURE_2D, table_extra_.id());
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D_ARRAY, texels_.textures[0].id());
  glUniform1i(program.uniform("u_pool"), 0);
  if (isBlockCodec(slots_.upload)) {
    constexpr const char* kNames[] = {"u_blocks0", "u_blocks1", "u_blocks2"};
    for (int i = 0; i < 3; ++i) {
      glActiveTexture(static_cast<GLenum>(GL_TEXTURE0 + kBlockUnit + i));
      glBindTexture(GL_TEXTURE_2D_ARRAY, blocks_.textures[static_cast<size_t>(i)].id());
      glUniform1i(program.uniform(kNames[i]), kBlockUnit + i);
    }
    glActiveTexture(GL_TEXTURE0);
  }
  glUniform1i(program.uniform("u_table"), 1);
  glUniform1i(program.uniform("u_table_extra"), 2);
  uint32_t entries = table.width() * table.height();
  glUniform4ui(program.uniform("u_table_shape"), entries - 1, static_cast<GLuint>(std::countr_zero(table.width())),
               table.seed(), 0);
}

}  // namespace relievo
