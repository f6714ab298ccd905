// hash_index.h - from a key's hash to an element's index, for owners that keep elements and keys in arrays of their
// own: open addressing, whose cells hold nothing but indices. Whether an element is the one that is looked for is asked
// of its owner. Linear probing from a home cell that the hash's upper half gives by multiplication; what is erased is
// closed up (Knuth, The Art of Computer Programming 3, 6.4), so probes do not lengthen as elements come and go.
// Entry: uint16_t or uint32_t holds an index alone; uint64_t also the hash's upper half, so that other elements are
// passed over without a look at them, and nobody has to tell hashes again. kFullPercent: of the cells at most in use.
// Not for untrusted keys that somebody chooses so that their hashes are equal: each look-up would walk through all.
#pragma once

#include <algorithm>
#include <cassert>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace relievo {

// The product's upper bits depend on all bits of the key. Of names of places, whose parts count up, these hashes lie
// more evenly than random ones (Knuth, 6.4: multiplication by the golden ratio).
constexpr uint64_t hashOfKey(uint64_t key) { return key * 0x9E3779B97F4A7C15ull; }
// Different keys have different upper halves: where entries keep those, they need not be compared again.
constexpr uint64_t exactHash(uint32_t key) { return uint64_t{key * 0x9E3779B9u} << 32; }

template <std::unsigned_integral Entry, size_t kFullPercent = 50>
class HashIndex {
  static constexpr bool kKeepsHash = sizeof(Entry) == 8;
  static_assert(sizeof(Entry) >= 2 && kFullPercent > 0 && kFullPercent <= 100);
  // hash_of(index) where entries do not keep hashes.
  struct HashIsKept {};

 public:
  static constexpr uint32_t kNone = 0xFFFFFFFFu;
  static constexpr uint32_t kMaxIndex = sizeof(Entry) == 2 ? 0xFFFEu : 0xFFFFFFFEu;

  // Room for so many elements.
  explicit HashIndex(size_t capacity = 0) { reset(capacity); }

  size_t size() const { return size_; }
  size_t capacity() const { return capacity_; }
  size_t bytes() const { return cells_.capacity() * sizeof(Entry); }

  // The index for which is_same(index) among those of this hash; kNone: there is none.
  template <class IsSame>
  uint32_t find(uint64_t hash, IsSame&& is_same) const {
    const Entry entry = cells_[locate(hash, is_same)];
    return entry == kFree ? kNone : indexIn(entry);
  }
  // The same; where there is none, `index` is in the table from now on, and the answer. kNone: it is full.
  template <class IsSame>
  uint32_t findOrAdd(uint64_t hash, uint32_t index, IsSame&& is_same) {
    assert(index <= kMaxIndex);
    Entry& cell = cells_[locate(hash, is_same)];
    if (cell != kFree) return indexIn(cell);
    if (size_ == capacity_) return kNone;
    ++size_;
    cell = entryOf(hash, index);
    return index;
  }
  // hash: of that element, which is in the table.
  template <class HashOf = HashIsKept>
  void erase(uint64_t hash, uint32_t index, const HashOf& hash_of = {}) {
    size_t gap = locate(hash, [index](uint32_t other) { return other == index; });
    assert(cells_[gap] != kFree);
    // Into the gap moves what a probe from its home would otherwise no longer reach (algorithm R).
    for (size_t at = next(gap); cells_[at] != kFree; at = next(at)) {
      const size_t from = home(hashIn(cells_[at], hash_of));
      const bool stays = gap < at ? gap < from && from <= at : gap < from || from <= at;
      if (stays) continue;
      cells_[gap] = cells_[at];
      gap = at;
    }
    cells_[gap] = kFree;
    --size_;
  }

  // Keeps its room; costs a write of all cells.
  void clear() {
    if (size_ > 0) std::fill(cells_.begin(), cells_.end(), kFree);
    size_ = 0;
  }
  // Empty, with room for so many, no more and no less.
  void reset(size_t capacity) {
    capacity_ = capacity;
    cell_count_ = capacity * 100 / kFullPercent + 1;  // one is free at least, where probes end
    cells_.assign(cell_count_, kFree);
    size_ = 0;
  }
  // Room for one more, in twice as many cells if need be.
  template <class HashOf = HashIsKept>
  void makeRoom(const HashOf& hash_of = {}) {
    if (size_ < capacity_) return;
    const std::vector<Entry> old = std::move(cells_);
    cells_ = {};
    const size_t size = size_;
    reset(std::max<size_t>(2 * capacity_, 32));
    for (const Entry entry : old) {
      if (entry == kFree) continue;
      size_t at = home(hashIn(entry, hash_of));
      while (cells_[at] != kFree) at = next(at);
      cells_[at] = entry;
    }
    size_ = size;
  }
  // For a hash that will be asked for soon: the table may be larger than caches.
  void prefetch(uint64_t hash) const { __builtin_prefetch(&cells_[home(hash)]); }

 private:
  static constexpr Entry kFree = static_cast<Entry>(~Entry{0});  // no index

  size_t home(uint64_t hash) const { return static_cast<size_t>((hash >> 32) * cell_count_ >> 32); }
  size_t next(size_t at) const { return at + 1 == cell_count_ ? 0 : at + 1; }
  static uint32_t indexIn(Entry entry) { return static_cast<uint32_t>(entry); }
  static Entry entryOf(uint64_t hash, uint32_t index) {
    if constexpr (kKeepsHash) return (hash & ~uint64_t{0xFFFFFFFF}) | index;
    else return static_cast<Entry>(index);
  }
  template <class HashOf>
  static uint64_t hashIn(Entry entry, const HashOf& hash_of) {
    if constexpr (kKeepsHash) return entry;
    else return hash_of(indexIn(entry));
  }
  // The cell of the element, or the free one where it belongs.
  template <class IsSame>
  size_t locate(uint64_t hash, IsSame&& is_same) const {
    for (size_t at = home(hash);; at = next(at)) {
      const Entry entry = cells_[at];
      if (entry == kFree) return at;
      if constexpr (kKeepsHash)
        if ((entry ^ hash) >> 32 != 0) continue;
      if (is_same(indexIn(entry))) return at;
    }
  }

  std::vector<Entry> cells_;
  size_t cell_count_ = 0, capacity_ = 0, size_ = 0;
};

}  // namespace relievo
