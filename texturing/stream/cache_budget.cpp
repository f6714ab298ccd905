#include "texturing/stream/cache_budget.h"

#include <algorithm>

namespace relievo {
namespace {

constexpr uint64_t kSpareSlots = 16, kSpareReliefSlots = 4;
constexpr uint64_t kNodesPerReliefPage = 2;
constexpr uint64_t kLayer = 64;  // slots of a texture's layer (src/render/page_pool.h): memory comes in these

// As many slots as bytes are for, whole layers of them where that is enough; no more layers than there are pages for.
uint32_t slotsOf(uint64_t bytes, uint64_t slot_bytes, uint64_t pages, uint64_t least, uint64_t most) {
  const uint64_t useful = (std::min(std::max(pages, least), most) + kLayer - 1) / kLayer * kLayer;
  const uint64_t n = std::min({bytes / slot_bytes, useful, most});
  const uint64_t whole = n / kLayer * kLayer;
  return static_cast<uint32_t>(whole >= std::max(least, kLayer) ? whole : n);
}

uint64_t leastTextureSlots(const CacheNeeds& n) {
  return uint64_t{n.roots} * static_cast<uint64_t>(n.texture_planes) + kSpareSlots;
}
uint64_t leastReliefSlots(const CacheNeeds& n) { return n.relief ? n.roots + kSpareReliefSlots : 0; }

}  // namespace

uint64_t leastCacheBytes(const CacheNeeds& n) {
  if (!isBlockCodec(n.upload)) return (leastTextureSlots(n) + n.roots) * kSlotBytes;
  return leastTextureSlots(n) * pageBlockBytes(n.upload) + leastReliefSlots(n) * kSlotBytes;
}

CacheSlots cacheSlots(const CacheNeeds& n, uint64_t budget_bytes) {
  if (!isBlockCodec(n.upload)) {
    const uint64_t all = std::min<uint64_t>(budget_bytes / kSlotBytes, n.most_slots);
    return {.upload = PageCodec::kLossless, .texture = static_cast<uint32_t>(all), .relief = 0};
  }
  const uint64_t slot = pageBlockBytes(n.upload), node = slot * static_cast<uint64_t>(n.texture_planes);
  const auto textureSlots = [&](uint64_t bytes) {
    return slotsOf(bytes, slot, n.texture_pages, leastTextureSlots(n), n.most_slots);
  };
  const auto reliefSlots = [&](uint64_t bytes) {
    return slotsOf(bytes, kSlotBytes, n.relief_pages, leastReliefSlots(n), n.most_slots);
  };
  CacheSlots out{.upload = n.upload, .texture = 0, .relief = 0};
  if (n.relief) {
    const uint64_t least = leastCacheBytes(n);
    const uint64_t rest = budget_bytes > least ? budget_bytes - least : 0;
    out.relief = reliefSlots((leastReliefSlots(n) + rest / (kNodesPerReliefPage * node + kSlotBytes)) * kSlotBytes);
    out.texture = textureSlots(budget_bytes - out.relief * kSlotBytes);
    out.relief = reliefSlots(budget_bytes - out.texture * slot);
  }
  out.texture = textureSlots(budget_bytes - out.relief * kSlotBytes);
  return out;
}

}  // namespace relievo
