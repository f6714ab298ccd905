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
  const size_t max_entries = entries_.size() + newest.size();
  if (changed || max_entries > index_.capacity()) rebuildIndex(max_entries);
  for (const NodeRequest& w : newest) {
    uint64_t key = packNode(w.node);
    const uint32_t index = findOrAdd(key, entries_.size());
    if (index == entries_.size()) {
      entries_.push_back({w, key, result_});
      changed = true;
      continue;
    }
    Entry& e = entries_[index];
    NodeRequest before = e.request;
    e.request = w;
    if (e.result >= still_since_) {  // the same view saw it before at another position
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
    rebuildIndex(entries_.size());
    changed = true;
  }
  if (changed) sort();
  return ordered_;
}

void RequestMemory::clear() {
  entries_.clear();
  ordered_.clear();
  index_.clear();
  result_ = 0;
}

uint32_t RequestMemory::findOrAdd(uint64_t key, size_t index) {
  return index_.findOrAdd(hashOfKey(key), static_cast<uint32_t>(index),
                          [&](uint32_t i) { return entries_[i].key == key; });
}

void RequestMemory::rebuildIndex(size_t entries) {
  index_.reset(std::max(index_.capacity(), 2 * entries + 32));
  for (size_t i = 0; i < entries_.size(); ++i) findOrAdd(entries_[i].key, i);
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
