// cache_budget.h - how many slots of the page cache a memory budget gives, and what a slot holds. Texture pages are
// kept on the GPU either as RGBA8, in slots that they share with relief, or as the compressed blocks that they are
// stored as, in smaller slots of their own. Pure.
#pragma once

#include <cstddef>
#include <cstdint>

#include "texturing/codec/page_block_codec.h"
#include "texturing/codec/page_codec.h"
#include "texturing/codec/page_id.h"

namespace relievo {

// The bytes of a slot. upload: a block codec, or any other for RGBA8. Relief and resolved pages are RGBA8 in any case;
// two relief pages share a slot (relief_subslots.h).
inline constexpr size_t slotBytes(PageCodec upload, Plane plane) {
  return isBlockCodec(upload) && isTexturePlane(plane) ? pageBlockBytes(upload) : kSlotBytes;
}

struct CacheSlots {
  PageCodec upload = PageCodec::kLossless;
  uint32_t texture = 0;  // with RGBA8: slots of all planes
  uint32_t relief = 0;   // slots of relief only; 0 with RGBA8
  uint32_t total() const { return texture + relief; }
  uint64_t bytes() const {
    return uint64_t{texture} * slotBytes(upload, Plane::kTexture0) + uint64_t{relief} * kSlotBytes;
  }
  friend bool operator==(const CacheSlots&, const CacheSlots&) = default;
};

struct CacheNeeds {
  PageCodec upload = PageCodec::kLossless;
  int texture_planes = 1;  // number of streamed texture planes
  bool relief = false;
  uint32_t roots = 1;  // nodes of each plane whose pages are never evicted
  uint64_t texture_pages = ~uint64_t{0}, relief_pages = ~uint64_t{0};  // pages of the artwork
  uint32_t max_slots = 65535;  // largest number of slots of a pool, a limit of the GL context
};

// The smallest budget: the roots of every plane, and a few slots for anything beside them.
uint64_t minCacheBytes(const CacheNeeds& needs);
// Divides a budget of at least minCacheBytes(). With blocks, relief gets a page for every two texture nodes (views of
// flat artworks want one for four, close ones one for one), and no pool has more slots than there are pages: the other
// pool gets the rest. Slots come in whole layers of the textures that hold them (page_pool.h), unless the budget is
// smaller than one layer.
CacheSlots cacheSlots(const CacheNeeds& needs, uint64_t budget_bytes);

}  // namespace relievo
