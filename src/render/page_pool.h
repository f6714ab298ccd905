// page_pool.h - the page cache's texels and the page table, as textures. Applies what texturing/ decided; decides
// nothing. A slot is a square of kPageFullPx texels in a layer of kSlotsPerSide x kSlotsPerSide slots, RGBA8 whatever
// it holds: a texture page, or relief pages beside one another, two samples a texel or in compact form
// (relief_subslots.h). Or texture pages have slots of their own, of blocks, in one to three compressed textures
// (block_formats.h), and RGBA8 is relief's alone. Uploads come before the frame's draws: on software GL an upload to a
// texture that a draw in flight samples stalls for that draw.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "src/gl/objects.h"
#include "src/gl/program.h"
#include "src/render/upload_ring.h"
#include "texturing/stream/cache_budget.h"
#include "texturing/stream/page_streamer.h"

namespace relievo {

inline constexpr int kSlotsPerSide = 8;
inline constexpr int kSlotsPerLayer = kSlotsPerSide * kSlotsPerSide;

// Where a relief page's samples are, for shaders: its first texel's x | y << 11 | layer << 22 (reliefSample() in
// common.glsl); how many times their spacing is twice the page's own; and whether they are in compact form
// (compact_relief.glsl).
struct ReliefPlace {
  uint32_t texel = 0;
  int coarser = 0;
  bool compact = false;
};
ReliefPlace reliefPlace(SlotIndex name);

class PagePool {
 public:
  // Memory is taken as slots are filled, in whole layers: eight first, then twice as many each time, up to the slots'
  // number. (A driver in software clears what it allocates: 140 ms for 256 MiB, before the first picture.) Contexts
  // that cannot copy compressed textures (GL_ARB_copy_image) take the memory for blocks at once. staged: uploads go
  // through a ring (upload_ring.h).
  explicit PagePool(const CacheSlots& slots, bool staged = UploadRing::pays());
  explicit PagePool(uint32_t slot_count)
      : PagePool(CacheSlots{.upload = PageCodec::kLossless, .texture = slot_count, .relief = 0}) {}

  // Replaces all slots by these, which are empty.
  void reshape(const CacheSlots& slots);
  void upload(std::span<const PageUpload> uploads);
  // Uploads the page table's changed texels; creates its textures again when its shape changes. False: nothing changed.
  bool uploadTable(PageTable& table);
  // Before another table is uploaded: all of its texels are, then.
  void forgetTable() { table_width_ = table_height_ = table_layers_ = 0; }
  // For programs that sample texture pages: how the shader finds them (shade.frag).
  static gl::Defines defines(PageCodec upload);
  // Binds the pool to texture units 0 and kBlockUnit.., the table to 1 and 2, and sets their uniforms in the program in
  // use.
  void bind(const gl::Program& program, const PageTable& table) const;

  static uint32_t maxSlots();  // of this context
  uint64_t bytesUploaded() const { return bytes_uploaded_; }
  uint64_t textureBytes() const;  // taken by now

 private:
  static constexpr int kBlockUnit = 9;
  // Layers of slots: one texture, or one for each set of blocks.
  struct Layers {
    std::array<gl::Texture, 3> textures;
    int count = 0, max = 0;
  };
  bool inBlocks(PageId id) const { return isBlockCodec(slots_.upload) && isTexturePlane(id.plane()); }
  void grow(bool blocks, int layers);
  void reserve(bool blocks, SlotIndex last);
  void uploadRelief(const PageUpload& upload);

  CacheSlots slots_;
  Layers texels_, blocks_;
  gl::Texture table_, table_extra_;
  uint32_t table_width_ = 0, table_height_ = 0, table_layers_ = 0;
  uint64_t bytes_uploaded_ = 0;
  UploadRing ring_;
  std::vector<uint8_t> packed_;  // scratch; a member so that it keeps its capacity
};

}  // namespace relievo
