// key_index.h - numbers 64-bit keys in the order in which they come: key i belongs to element i of the owner's array.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "src/base/hash_index.h"

namespace relievo {

class KeyIndex {
 public:
  static constexpr uint32_t kNone = HashIndex<uint32_t>::kNone;

  uint32_t find(uint64_t key) const {
    return index_.find(hashOfKey(key), [&](uint32_t i) { return keys_[i] == key; });
  }
  // size() as it was before: the key is new.
  uint32_t findOrAdd(uint64_t key) {
    index_.makeRoom([&](uint32_t i) { return hashOfKey(keys_[i]); });
    const auto added = static_cast<uint32_t>(keys_.size());
    const uint32_t i = index_.findOrAdd(hashOfKey(key), added, [&](uint32_t k) { return keys_[k] == key; });
    if (i == added) keys_.push_back(key);
    return i;
  }
  void clear() {
    index_.clear();
    keys_.clear();
  }
  size_t size() const { return keys_.size(); }
  uint64_t operator[](uint32_t i) const { return keys_[i]; }

 private:
  HashIndex<uint32_t> index_;
  std::vector<uint64_t> keys_;
};

}  // namespace relievo
