// relief_subslots.h - how a relief page is stored in a part of a slot (subslot_cache.h): two bytes for each sample,
// high byte first, so that an RGBA8 texel holds two consecutive samples of a row. 129 x 129 samples fill 65 x 129 of
// the 68 x 136 texels of half a slot.
//
// A scan with fewer than 128 cells for each patch is stored as pages of which only every second (or fourth) sample
// along a side carries information; the others are interpolated on the cells' triangles and rounded. Then only these
// samples are kept, in a quarter (or a 16th) of the memory, and shaders/patch.vert computes the others bit for bit. If
// the samples' compact form (relief_compact.h) fits a third of a slot (or a 12th, a 48th), it is used. The part's level
// says which form a page has. Over a base mesh only, since elsewhere values between samples are drawn unrounded. Pure.
#pragma once

#include <cstdint>
#include <span>

#include "src/artwork/patch_domain.h"
#include "texturing/codec/page_codec.h"
#include "texturing/stream/subslot_cache.h"

namespace relievo {

inline constexpr int kReliefPartLevel = kHalves;  // of a page with all samples; each level below halves its side
// A page keeps every 2^n-th sample along a side at level kReliefPartLevel + n, and in compact form at kThirds + n.
inline constexpr int reliefStepLog2(int level) { return level - (isThird(level) ? kThirds : kReliefPartLevel); }
inline constexpr uint32_t reliefCells(int level) {
  return static_cast<uint32_t>(kPagePx) >> reliefStepLog2(level);
}  // cells along a side
inline constexpr int plainLevel(int level) {
  return kReliefPartLevel + reliefStepLog2(level);
}  // the level of the same samples in plain form
inline constexpr int compactLevel(int level) { return kThirds + reliefStepLog2(level); }
// A part's texels along a side, for levels from 1 on, and its bytes.
inline constexpr int partColumns(int level) {
  return (isThird(level) ? kPageFullPx : kPageFullPx / 2) >> reliefStepLog2(level);
}
inline constexpr int partRows(int level) {
  return (isThird(level) ? kPageFullPx / 3 : kPageFullPx) >> reliefStepLog2(level);
}
inline constexpr size_t partBytes(int level) {
  return size_t{4} * static_cast<size_t>(partColumns(level)) * static_cast<size_t>(partRows(level));
}
static_assert(partBytes(3) == kSlotBytes / kPartsOfSlot[3] &&
              partBytes(kThirds + 2) <= kSlotBytes / kPartsOfSlot[kThirds + 2]);
static_assert(2 * partColumns(3) > kPagePx >> 2 && partRows(3) > kPagePx >> 2, "samples fit the smallest");
// The first texel of a part in its slot.
struct PartOffset {
  int x = 0, y = 0;
};
constexpr PartOffset offsetInSlot(const SlotPart& p) {
  PartOffset at;
  uint32_t part = p.part;
  int level = p.level;
  for (; parentLevel(level) > 0; --level, part >>= 2) {
    at.x += static_cast<int>(part & 1) * partColumns(level);
    at.y += static_cast<int>(part >> 1 & 1) * partRows(level);
  }
  (level == kThirds ? at.y : at.x) +=
      static_cast<int>(part) * (level == kThirds ? partRows(level) : partColumns(level));
  return at;
}

// The parts that pages may take: only halves; smaller ones, too; those of the compact form, too.
enum class ReliefParts : uint8_t { kOnlyHalves, kSmall, kCompact };
// The level of the smallest part that holds all of a page. texels: kSlotBytes, as page_codec.h decodes relief.
int reliefPartLevel(std::span<const uint8_t> texels, ReliefParts parts);
// out: partBytes(level), rows of partColumns(level) texels. Bytes beyond the samples are unspecified.
void packRelief(std::span<const uint8_t> texels, int level, std::span<uint8_t> out);

}  // namespace relievo
