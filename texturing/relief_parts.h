// relief_parts.h - a relief page's samples in a part of a slot (divided_cache.h): two bytes each, high byte first, so that a texel of RGBA8 holds two
// that follow one another in a row. 129 x 129 samples fill 65 x 129 texels of the 68 x 136 of half a slot.
//
// A page may hold no more than its every second (or fourth) sample a side and what lies between them on the cells' two triangles, rounded:
// that is how a scan of fewer than 128 cells a patch is stored. Then these alone are kept, in a quarter (or a 16th) of the room, and
// shaders/patch.vert computes the others as they were, bit for bit. Over a base mesh only: elsewhere what lies between two samples is
// drawn unrounded. Pure.
#pragma once

#include <cstdint>
#include <span>

#include "src/base/planar_domain.h"
#include "texturing/divided_cache.h"
#include "texturing/page_codec.h"

namespace relievo {

inline constexpr int kReliefPartLevel = 1;  // of a page with samples of its own everywhere; each level below halves its side
inline constexpr uint32_t reliefCells(int level) { return static_cast<uint32_t>(kPagePx) >> (level - kReliefPartLevel); }  // a side, of its samples
// A part's texels a side, for levels 1 to 3; and what it takes.
inline constexpr int partColumns(int level) { return (kPageFullPx / 2) >> (level - 1); }
inline constexpr int partRows(int level) { return kPageFullPx >> (level - 1); }
inline constexpr size_t partBytes(int level) { return kSlotBytes / kPartsOfSlot[static_cast<size_t>(level)]; }
static_assert(partBytes(3) == size_t{4} * partColumns(3) * partRows(3));
static_assert(2 * partColumns(3) > kPagePx >> 2 && partRows(3) > kPagePx >> 2, "samples fit the smallest");
// Its first texel in the slot.
struct PartPlace {
  int x = 0, y = 0;
};
constexpr PartPlace placeInSlot(const SlotPart& p) {
  PartPlace at;
  uint32_t part = p.part;
  for (int level = p.level; level > 1; --level, part >>= 2) {
    at.x += static_cast<int>(part & 1) * partColumns(level);
    at.y += static_cast<int>(part >> 1 & 1) * partRows(level);
  }
  at.x += static_cast<int>(part) * partColumns(1);
  return at;
}

// The level of the smallest part that holds all of a page, 1 to 3. texels: kSlotBytes, as page_codec.h decodes relief.
int reliefPartLevel(std::span<const uint8_t> texels);
// out: partBytes(level), rows of partColumns(level) texels. What lies beyond the samples is of no account.
void packRelief(std::span<const uint8_t> texels, int level, std::span<uint8_t> out);

}  // namespace relievo
