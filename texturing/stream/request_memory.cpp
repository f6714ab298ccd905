#include "texturing/stream/request_memory.h"

#include <algorithm>
#include <bit>

namespace relievo {

std::span<const NodeRequest> RequestMemory::add(std::span<const NodeRequest> newest, uint64_t view,
                                                uint32_t still_results) {
  ++result_;
  if (view != view_ || result_ == 1) still_since_ = result_;
  view_ = view;
  bool changed = false;
  if (entries_.size() + newest.size() > kMaxRequests) {
    entries_.clear();
    changed = true;
  }
  if (changed || 2 * (entries_.size() + newest.size()) > table_.size()) rebuildTable(entries_.size() + newest.size());
  for (const NodeRequest& w : newest) {
    uint64_t key = packNode(w.node);
    uint32_t* slot = find(key);
    if (*slot == 0) {
      entries_.push_back({w, key, result_});
      *slot = static_cast<uint32_t>(entries_.size());
      changed = true;
      continue;
    }
    Entry& e = entries_[*slot - 1];
    NodeRequest before = e.request;
    e.request = w;
    if (e.result >= still_since_) {  // the same view saw it before, elsewhere
      e.request.centre_distance = std::min(before.centre_distance, w.centre_distance);
      e.request.pixels = std::max(before.pixels, w.pixels);
    }
    changed = changed || e.request.centre_distance != before.centre_distance || e.request.pixels != before.pixels;
    e.result = result_;
  }
  auto expired = [&](const Entry& e) {
    uint64_t age = result_ - e.result;
    return age >= kMovingResults && (e.result < still_since_ || age >= still_results);
  };
  if (std::erase_if(entries_, expired) > 0) {
    rebuildTable(entries_.size());
    changed = true;
  }
  if (changed) sort();
  return ordered_;
}

void RequestMemory::clear() {
  entries_.clear();
  ordered_.clear();
  std::fill(table_.begin(), table_.end(), 0u);
  result_ = 0;
}

uint32_t* RequestMemory::find(uint64_t key) {
  size_t mask = table_.size() - 1;
  size_t s = (key * 0x9E3779B97F4A7C15ull >> 32) & mask;
  while (table_[s] != 0 && entries_[table_[s] - 1].key != key) s = (s + 1) & mask;
  return &table_[s];
}

void RequestMemory::rebuildTable(size_t entries) {
  table_.assign(std::max(table_.size(), std::bit_ceil(4 * entries + 64)), 0u);
  for (uint32_t i = 0; i < entries_.size(); ++i) *find(entries_[i].key) = i + 1;
}

void RequestMemory::sort() {
  sort_keys_.clear();
  for (uint32_t i = 0; i < entries_.size(); ++i) {
    const NodeRequest& w = entries_[i].request;
    sort_keys_.emplace_back(uint64_t{w.node.level} << 32 | std::bit_cast<uint32_t>(w.centre_distance), i);
  }
  std::sort(sort_keys_.begin(), sort_keys_.end(), [&](const auto& a, const auto& b) {
    return a.first != b.first ? a.first < b.first : entries_[a.second].key < entries_[b.second].key;
  });
  ordered_.clear();
  for (const auto& [key, i] : sort_keys_) ordered_.push_back(entries_[i].request);
}

}  // namespace relievo
