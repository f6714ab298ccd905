// cache_budget.h - what a slot of the page cache holds, and how many slots a budget gives. Two ways to keep texture
// pages on a GPU: as RGBA8, in slots that they share with relief; or as the blocks that they are stored as, in smaller
// slots of their own. Pure.
#pragma once

#include <cstddef>
#include <cstdint>

#include "texturing/codec/page_block_codec.h"
#include "texturing/codec/page_codec.h"
#include "texturing/codec/page_id.h"

namespace relievo {

// upload: a block codec, or any other for RGBA8. Relief and resolved pages are RGBA8 in any case; two relief pages
// share a slot (relief_subslots.h).
inline constexpr size_t slotBytes(PageCodec upload, Plane plane) {
  return isBlockCodec(upload) && isTexturePlane(plane) ? pageBlockBytes(upload) : kSlotBytes;
}

struct CacheSlots {
  PageCodec upload = PageCodec::kLossless;
  uint32_t texture = 0;  // with RGBA8: of all planes
  uint32_t relief = 0;   // relief's own; 0 with RGBA8
  uint32_t total() const { return texture + relief; }
  uint64_t bytes() const {
    return uint64_t{texture} * slotBytes(upload, Plane::kTexture0) + uint64_t{relief} * kSlotBytes;
  }
  friend bool operator==(const CacheSlots&, const CacheSlots&) = default;
};

struct CacheNeeds {
  PageCodec upload = PageCodec::kLossless;
  int texture_planes = 1;  // that are streamed
  bool relief = false;
  uint32_t roots = 1;                                                  // nodes whose pages stay, of each plane
  uint64_t texture_pages = ~uint64_t{0}, relief_pages = ~uint64_t{0};  // that the artwork has
  uint32_t most_slots = 65535;                                         // of a pool, by the context
};

// Roots of every plane, and a little room to look at anything beside them.
uint64_t leastCacheBytes(const CacheNeeds& needs);
// budget_bytes is at least that; what is answered takes no more. Blocks: relief gets a page for every two texture nodes
// (views of flat artworks want one for four, close ones for one), and no pool has more slots than there are pages: the
// rest is the other's. Slots come by whole layers of the textures that hold them (page_pool.h), but where the budget
// has not even one.
CacheSlots cacheSlots(const CacheNeeds& needs, uint64_t budget_bytes);

}  // namespace relievo
