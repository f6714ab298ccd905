// relief_subslots.h - a relief page's samples in a part of a slot (subslot_cache.h): two bytes each, high byte first,
// so that a texel of RGBA8 holds two that follow one another in a row. 129 x 129 samples fill 65 x 129 texels of the 68
// x 136 of half a slot.
//
// A page may hold no more than its every second (or fourth) sample a side and what lies between them on the cells' two
// triangles, rounded: that is how a scan of fewer than 128 cells a patch is stored. Then these alone are kept, in a
// quarter (or a 16th) of the room, and shaders/patch.vert computes the others as they were, bit for bit. And where the
// samples' compact form (relief_compact.h) fits a third of a slot (or a 12th, a 48th), it takes that. The level of its
// part says which form a page has. Over a base mesh only: elsewhere what lies between two samples is drawn unrounded.
// Pure.
#pragma once

#include <cstdint>
#include <span>

#include "src/artwork/patch_domain.h"
#include "texturing/codec/page_codec.h"
#include "texturing/stream/subslot_cache.h"

namespace relievo {

inline constexpr int kReliefPartLevel =
    kHalves;  // of a page with samples of its own everywhere; each level below halves its side
// What of a page is kept: every 2^n-th sample a side, at level kReliefPartLevel + n, in compact form at kThirds + n.
inline constexpr int reliefCoarser(int level) { return level - (isThird(level) ? kThirds : kReliefPartLevel); }
inline constexpr uint32_t reliefCells(int level) {
  return static_cast<uint32_t>(kPagePx) >> reliefCoarser(level);
}  // a side, of its samples
inline constexpr int plainLevel(int level) {
  return kReliefPartLevel + reliefCoarser(level);
}  // with as many samples, as they are
inline constexpr int compactLevel(int level) { return kThirds + reliefCoarser(level); }
// A part's texels a side, for levels from 1; and what it takes.
inline constexpr int partColumns(int level) {
  return (isThird(level) ? kPageFullPx : kPageFullPx / 2) >> reliefCoarser(level);
}
inline constexpr int partRows(int level) {
  return (isThird(level) ? kPageFullPx / 3 : kPageFullPx) >> reliefCoarser(level);
}
inline constexpr size_t partBytes(int level) {
  return size_t{4} * static_cast<size_t>(partColumns(level)) * static_cast<size_t>(partRows(level));
}
static_assert(partBytes(3) == kSlotBytes / kPartsOfSlot[3] &&
              partBytes(kThirds + 2) <= kSlotBytes / kPartsOfSlot[kThirds + 2]);
static_assert(2 * partColumns(3) > kPagePx >> 2 && partRows(3) > kPagePx >> 2, "samples fit the smallest");
// Its first texel in the slot.
struct PartPlace {
  int x = 0, y = 0;
};
constexpr PartPlace placeInSlot(const SlotPart& p) {
  PartPlace at;
  uint32_t part = p.part;
  int level = p.level;
  for (; levelAbove(level) > 0; --level, part >>= 2) {
    at.x += static_cast<int>(part & 1) * partColumns(level);
    at.y += static_cast<int>(part >> 1 & 1) * partRows(level);
  }
  (level == kThirds ? at.y : at.x) +=
      static_cast<int>(part) * (level == kThirds ? partRows(level) : partColumns(level));
  return at;
}

// The parts that pages may take: halves alone; and smaller ones; and those of the compact form.
enum class ReliefParts : uint8_t { kOnlyHalves, kSmall, kCompact };
// The level of the smallest part that holds all of a page. texels: kSlotBytes, as page_codec.h decodes relief.
int reliefPartLevel(std::span<const uint8_t> texels, ReliefParts parts);
// out: partBytes(level), rows of partColumns(level) texels. What lies beyond the samples is of no account.
void packRelief(std::span<const uint8_t> texels, int level, std::span<uint8_t> out);

}  // namespace relievo
