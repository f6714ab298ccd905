#include "texturing/stream/page_table.h"

#include <algorithm>
#include <bit>
#include <cassert>
#include <numeric>
#include <utility>

namespace relievo {

namespace {
constexpr uint32_t kNotFound = 0xFFFFFFFFu;
constexpr uint32_t kMaxRow = 1024;
// An insertion that displaces more entries than this counts as a loop. At a load of 0.4 it displaces 1.3 on average,
// and insertions that displace more than a few log2(n) practically always loop.
constexpr int kMaxKicks = 64;

uint64_t keyOf(const NodeId& node) { return packNode(node) + 1; }
uint64_t keyIn(const std::array<uint32_t, 4>& texel) { return uint64_t{texel[1]} << 32 | texel[0]; }
}  // namespace

PageTable::PageTable(uint32_t max_nodes, int planes) : max_nodes_(max_nodes) {
  // 2.5 entries for each node give a load of at most 0.4, below the 0.5 where two-choice cuckoo hashing with one cell a
  // bucket fails (Pagh, Rodler 2004).
  uint32_t entries = std::bit_ceil(std::max<uint32_t>(16, max_nodes * 5 / 2 + 1));
  width_ = std::min(entries, kMaxRow);
  height_ = entries / width_;
  mask_ = entries - 1;
  texels_.resize(entries);
  layers_ =
      static_cast<uint32_t>(std::max(0, planes - RV_PLANES_IN_ENTRY) + RV_PLANES_IN_EXTRA - 1) / RV_PLANES_IN_EXTRA;
  extra_.resize(size_t{layers_} * entries);
  dirty_.resize((entries + 63) / 64);
}

uint32_t PageTable::width() const { return width_; }
uint32_t PageTable::height() const { return height_; }
uint32_t PageTable::seed() const { return seed_; }
uint32_t PageTable::size() const { return size_; }
std::span<const std::array<uint32_t, 4>> PageTable::texels() const { return texels_; }
std::span<const std::array<uint32_t, 4>> PageTable::extraTexels() const { return extra_; }

void PageTable::insert(const NodeId& node, const PageTableEntry& entry) {
  auto slot = [&](size_t plane) { return uint32_t{plane < entry.slots.size() ? entry.slots[plane] : uint16_t{0}}; };
  auto pair = [&](size_t plane) { return slot(plane) | slot(plane + 1) << 16; };
  uint64_t key = keyOf(node);
  Item item;
  item.texel = {static_cast<uint32_t>(key), static_cast<uint32_t>(key >> 32), pair(0),
                slot(2) | uint32_t{entry.birth} << 16};
  for (size_t layer = 0; layer < layers_; ++layer)
    for (size_t i = 0; i < 4; ++i) item.extra[layer][i] = pair(RV_PLANES_IN_ENTRY + RV_PLANES_IN_EXTRA * layer + 2 * i);
  uint32_t index = locate(key);
  if (index != kNotFound) return put(index, item);
  assert(size_ < max_nodes_);
  if (size_ >= max_nodes_) return;
  ++size_;
  if (!place(item)) rehash(item);
}

void PageTable::erase(const NodeId& node) {
  uint32_t index = locate(keyOf(node));
  if (index == kNotFound) return;
  put(index, {});
  --size_;
}

std::optional<PageTableEntry> PageTable::find(const NodeId& node) const {
  uint32_t index = locate(keyOf(node));
  if (index == kNotFound) return std::nullopt;
  const auto [t, e] = itemAt(index);
  auto low = [](uint32_t v) { return static_cast<uint16_t>(v & 0xFFFFu); };
  auto high = [](uint32_t v) { return static_cast<uint16_t>(v >> 16); };
  PageTableEntry entry;
  entry.slots = {low(t[2]), high(t[2]), low(t[3])};
  for (size_t plane = RV_PLANES_IN_ENTRY; plane < entry.slots.size(); ++plane) {
    const size_t extra_plane = plane - RV_PLANES_IN_ENTRY;
    const uint32_t pair = e[extra_plane / RV_PLANES_IN_EXTRA][extra_plane % RV_PLANES_IN_EXTRA / 2];
    entry.slots[plane] = extra_plane % 2 == 0 ? low(pair) : high(pair);
  }
  entry.birth = high(t[3]);
  return entry;
}

std::vector<uint32_t> PageTable::takeDirty() {
  std::vector<uint32_t> dirty;
  if (all_dirty_) {
    dirty.resize(texels_.size());
    std::iota(dirty.begin(), dirty.end(), 0u);
    std::fill(dirty_.begin(), dirty_.end(), uint64_t{0});
  } else if (dirty_count_ > 0) {
    dirty.reserve(dirty_count_);
    for (size_t w = 0; w < dirty_.size(); ++w) {
      for (uint64_t bits = std::exchange(dirty_[w], 0); bits != 0; bits &= bits - 1)
        dirty.push_back(static_cast<uint32_t>(w * 64 + static_cast<size_t>(std::countr_zero(bits))));
    }
  }
  dirty_count_ = 0;
  all_dirty_ = false;
  return dirty;
}

size_t PageTable::metadataBytes() const {
  return sizeof *this + (texels_.capacity() + extra_.capacity()) * sizeof(texels_[0]) +
         dirty_.capacity() * sizeof(uint64_t);
}

PageTable::Item PageTable::itemAt(uint32_t index) const {
  Item item;
  item.texel = texels_[index];
  for (size_t layer = 0; layer < layers_; ++layer) item.extra[layer] = extra_[layer * texels_.size() + index];
  return item;
}

std::array<uint32_t, 2> PageTable::probes(const std::array<uint32_t, 4>& texel) const {
  uint32_t h = shader::pageHash(texel[0], texel[1], seed_);
  return {shader::pageProbe0(h, mask_), shader::pageProbe1(h, mask_)};
}

uint32_t PageTable::locate(uint64_t key) const {
  for (uint32_t index : probes({static_cast<uint32_t>(key), static_cast<uint32_t>(key >> 32)}))
    if (keyIn(texels_[index]) == key) return index;
  return kNotFound;
}

bool PageTable::place(Item& item) {
  uint32_t avoid = kNotFound;  // the cell that the item was just displaced from
  for (int kick = 0; kick < kMaxKicks; ++kick) {
    auto p = probes(item.texel);
    for (uint32_t index : p) {
      if (keyIn(texels_[index]) != 0) continue;
      put(index, item);
      return true;
    }
    uint32_t index = p[0] == avoid ? p[1] : p[0];
    Item displaced = itemAt(index);
    put(index, item);
    item = displaced;
    avoid = index;
  }
  return false;
}

void PageTable::put(uint32_t index, const Item& item) {
  texels_[index] = item.texel;
  for (size_t layer = 0; layer < layers_; ++layer) extra_[layer * texels_.size() + index] = item.extra[layer];
  uint64_t bit = uint64_t{1} << (index & 63);
  dirty_count_ += !(dirty_[index / 64] & bit);
  dirty_[index / 64] |= bit;
}

void PageTable::rehash(const Item& unplaced) {
  std::vector<Item> items{unplaced};
  for (uint32_t i = 0; i < texels_.size(); ++i)
    if (keyIn(texels_[i]) != 0) items.push_back(itemAt(i));
  all_dirty_ = true;
  // Each seed is an independent trial that succeeds with probability 1 - O(1/n), so that this ends.
  for (bool complete = false; !complete;) {
    seed_ = seed_ * 0x9E3779B1u + 0x7F4A7C15u;
    std::fill(texels_.begin(), texels_.end(), std::array<uint32_t, 4>{});
    std::fill(extra_.begin(), extra_.end(), std::array<uint32_t, 4>{});
    complete = true;
    for (size_t i = 0; i < items.size() && complete; ++i) {
      Item item = items[i];
      complete = place(item);
    }
  }
}

}  // namespace relievo
