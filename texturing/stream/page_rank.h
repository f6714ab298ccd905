// page_rank.h - the order of service: pages requested now, then those of a predicted view, then those of the request
// list before the newest (the tiers of Neuroglancer). Within a tier coarse before fine, then near the view's centre
// (Rudelle 2015), then node by node.
#pragma once

#include <bit>
#include <cstdint>

#include "texturing/codec/page_id.h"

namespace relievo {

enum class Tier : uint8_t { kVisible, kPrefetch, kRecent, kNone };

struct PageRank {
  uint64_t key = 0;
  PageId id;
  PageRank() = default;
  // The bits of a non-negative float are ordered as its value.
  PageRank(Tier tier, float centre, PageId page)
      : key(uint64_t(tier) << 48 | uint64_t{page.node().level} << 32 | std::bit_cast<uint32_t>(centre)), id(page) {}
  Tier tier() const { return static_cast<Tier>(key >> 48); }
  friend bool operator<(const PageRank& a, const PageRank& b) {
    if (a.key != b.key) return a.key < b.key;
    uint64_t node_a = packNode(a.id.node()), node_b = packNode(b.id.node());
    return node_a != node_b ? node_a < node_b : a.id < b.id;
  }
};

}  // namespace relievo
