#include "texturing/stream/cache_budget.h"

#include <algorithm>

namespace relievo {
namespace {

constexpr uint64_t kSpareSlots = 16, kSpareReliefSlots = 4;
constexpr uint64_t kNodesPerReliefPage = 2;
constexpr uint64_t kLayer = 64;  // slots of a texture layer (src/render/page_pool.h), the unit of allocation

// The slots that fit into `bytes`, in whole layers if that is enough, and in no more layers than the pages need.
uint32_t slotsOf(uint64_t bytes, uint64_t slot_bytes, uint64_t pages, uint64_t min_slots, uint64_t max_slots) {
  const uint64_t useful = (std::min(std::max(pages, min_slots), max_slots) + kLayer - 1) / kLayer * kLayer;
  const uint64_t n = std::min({bytes / slot_bytes, useful, max_slots});
  const uint64_t whole = n / kLayer * kLayer;
  return static_cast<uint32_t>(whole >= std::max(min_slots, kLayer) ? whole : n);
}

uint64_t minTextureSlots(const CacheNeeds& n) {
  return uint64_t{n.roots} * static_cast<uint64_t>(n.texture_planes) + kSpareSlots;
}
uint64_t minReliefSlots(const CacheNeeds& n) { return n.relief ? n.roots + kSpareReliefSlots : 0; }

}  // namespace

uint64_t minCacheBytes(const CacheNeeds& n) {
  if (!isBlockCodec(n.upload)) return (minTextureSlots(n) + n.roots) * kSlotBytes;
  return minTextureSlots(n) * pageBlockBytes(n.upload) + minReliefSlots(n) * kSlotBytes;
}

CacheSlots cacheSlots(const CacheNeeds& n, uint64_t budget_bytes) {
  if (!isBlockCodec(n.upload)) {
    const uint64_t all = std::min<uint64_t>(budget_bytes / kSlotBytes, n.max_slots);
    return {.upload = PageCodec::kLossless, .texture = static_cast<uint32_t>(all), .relief = 0};
  }
  const uint64_t slot = pageBlockBytes(n.upload), node = slot * static_cast<uint64_t>(n.texture_planes);
  const auto textureSlots = [&](uint64_t bytes) {
    return slotsOf(bytes, slot, n.texture_pages, minTextureSlots(n), n.max_slots);
  };
  const auto reliefSlots = [&](uint64_t bytes) {
    return slotsOf(bytes, kSlotBytes, n.relief_pages, minReliefSlots(n), n.max_slots);
  };
  CacheSlots out{.upload = n.upload, .texture = 0, .relief = 0};
  if (n.relief) {
    const uint64_t min_slots = minCacheBytes(n);
    const uint64_t rest = budget_bytes > min_slots ? budget_bytes - min_slots : 0;
    out.relief = reliefSlots((minReliefSlots(n) + rest / (kNodesPerReliefPage * node + kSlotBytes)) * kSlotBytes);
    out.texture = textureSlots(budget_bytes - out.relief * kSlotBytes);
    out.relief = reliefSlots(budget_bytes - out.texture * slot);
  }
  out.texture = textureSlots(budget_bytes - out.relief * kSlotBytes);
  return out;
}

}  // namespace relievo
