// page_pool.h - the page cache's texels and the page table, as textures. Applies what texturing/ decided; decides nothing.
// A slot is a square of kPageFullPx texels in a layer of kSlotsPerSide x kSlotsPerSide slots, RGBA8 whatever it holds.
// Uploads come before the frame's draws: on software GL an upload to a texture that a draw in flight samples stalls for that draw.
#pragma once

#include <cstdint>
#include <span>

#include "src/gl/objects.h"
#include "src/gl/program.h"
#include "texturing/page_streamer.h"

namespace relievo {

inline constexpr int kSlotsPerSide = 8;
inline constexpr int kSlotsPerLayer = kSlotsPerSide * kSlotsPerSide;

class PagePool {
 public:
  // Memory is taken as slots are filled: eight layers first, then twice as many each time, up to slot_count. (A driver in software
  // clears what it allocates: 140 ms for 256 MiB, before the first picture.)
  explicit PagePool(uint32_t slot_count);

  void upload(std::span<const PageUpload> uploads);
  // The page table's changed texels; its textures are made anew when its shape changes.
  void uploadTable(PageTable& table);
  void forgetTable() { table_width_ = table_height_ = 0; }  // the next one is another table: nothing of the old one holds
  // Binds pool and table to texture units 0..2 and sets their uniforms in the program in use.
  void bind(const gl::Program& program, const PageTable& table) const;

  static uint32_t maxSlots();  // of this context
  uint64_t bytesUploaded() const { return bytes_uploaded_; }
  uint64_t textureBytes() const;  // taken by now

 private:
  void grow(int layers);
  gl::Texture pool_, table_, table_extra_;
  int layers_ = 0, max_layers_ = 0;
  uint32_t table_width_ = 0, table_height_ = 0;
  uint64_t bytes_uploaded_ = 0;
};

}  // namespace relievo
