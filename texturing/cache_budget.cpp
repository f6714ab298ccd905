#include "texturing/cache_budget.h"

#include <algorithm>

namespace relievo {
namespace {

constexpr uint64_t kSpareSlots = 16, kSpareReliefSlots = 4;
constexpr uint64_t kNodesPerReliefPage = 2;

uint64_t leastTextureSlots(const CacheNeeds& n) { return uint64_t{n.roots} * static_cast<uint64_t>(n.texture_planes) + kSpareSlots; }
uint64_t leastReliefSlots(const CacheNeeds& n) { return n.relief ? n.roots + kSpareReliefSlots : 0; }

}  // namespace

uint64_t leastCacheBytes(const CacheNeeds& n) {
  if (!isBlockCodec(n.upload)) return (leastTextureSlots(n) + n.roots) * kSlotBytes;
  return leastTextureSlots(n) * pageBlockBytes(n.upload) + leastReliefSlots(n) * kSlotBytes;
}

CacheSlots cacheSlots(const CacheNeeds& n, uint64_t budget_bytes) {
  const auto slots = [&](uint64_t wanted) { return static_cast<uint32_t>(std::min<uint64_t>(wanted, n.most_slots)); };
  if (!isBlockCodec(n.upload)) return {.upload = PageCodec::kLossless, .texture = slots(budget_bytes / kSlotBytes), .relief = 0};
  const uint64_t slot = pageBlockBytes(n.upload), node = slot * static_cast<uint64_t>(n.texture_planes);
  const auto textureSlots = [&](uint64_t bytes) { return slots(std::min(bytes / slot, std::max(n.texture_pages, leastTextureSlots(n)))); };
  CacheSlots out{.upload = n.upload, .texture = 0, .relief = 0};
  if (n.relief) {
    const auto reliefSlots = [&](uint64_t wanted) { return slots(std::min(wanted, std::max(n.relief_pages, leastReliefSlots(n)))); };
    const uint64_t least = leastCacheBytes(n);
    const uint64_t rest = budget_bytes > least ? budget_bytes - least : 0;
    out.relief = reliefSlots(leastReliefSlots(n) + rest / (kNodesPerReliefPage * node + kSlotBytes));
    out.texture = textureSlots(budget_bytes - out.relief * kSlotBytes);
    out.relief = reliefSlots((budget_bytes - out.texture * slot) / kSlotBytes);
  }
  out.texture = textureSlots(budget_bytes - out.relief * kSlotBytes);
  return out;
}

}  // namespace relievo
