// page_facts.h - what an oracle says of relief pages, kept once asked for: bounds of heights, and errors by parts.
// Both forests (quadtree_lod.h) ask here; what an oracle that knows nothing, or says what cannot be, counts for is
// theirs to say. Internal to geometry/.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "geometry/lod/lod_common.h"
#include "geometry/lod/square.h"
#include "src/base/key_index.h"

namespace relievo {

class PageFacts {
 public:
  // ask(): the page's bounds, asked for once. The reference holds until the next call.
  template <class Ask>
  const HeightBounds& bounds(uint64_t key, Ask&& ask) {
    const uint32_t index = bounds_index_.findOrAdd(key);
    return index < bounds_.size() ? bounds_[index] : bounds_.emplace_back(ask());
  }
  // Of the surface through a page's samples, within a square that the page covers. whole: of all of the page.
  Deviation within(const Square& s, const Square& page, uint64_t page_key, const ReliefOracle& oracle,
                   const Deviation& whole) {
    const int part_depth = std::min(s.level - page.level, kErrorBlocksLog2);
    if (part_depth == 0 || whole.mm == 0) return whole;
    const uint32_t index = parts_index_.findOrAdd(page_key);
    if (index == parts_.size()) parts_.emplace_back().read(oracle, page.id(), static_cast<float>(whole.mm));
    const Square part = s.ancestor(page.level + part_depth);
    return parts_[index].at(part_depth, part.x - (page.x << part_depth), part.y - (page.y << part_depth)).deviation();
  }
  // Between two views: what is kept from view to view is bounded.
  void forgetSome() {
    if (parts_.size() > kMostParts) {
      parts_.clear();
      parts_index_.clear();
    }
    if (bounds_.size() > kMostBounds) {
      bounds_.clear();
      bounds_index_.clear();
    }
  }

 private:
  static constexpr size_t kMostParts = 8192;      // pages, 2.7 KB each
  static constexpr size_t kMostBounds = 1 << 20;  // pages, some 40 bytes each with their place in the table

  std::vector<HeightBounds> bounds_;
  std::vector<PartErrors> parts_;
  KeyIndex bounds_index_, parts_index_;
};

}  // namespace relievo
