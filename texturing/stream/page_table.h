// page_table.h - the page table that shaders read: a hash table in a texture, whose cost follows the number of resident
// nodes instead of the virtual size. Two-choice cuckoo hashing bounds a look-up to two probes, since pixels of one
// group wait for the longest one; HashIndex (src/base/hash_index.h) has no such bound.
//
// An entry is one RGBA32UI texel:
// - x, y: low and high 32 bits of packNode(node) + 1; 0: empty.
// - z: slot of plane 0 | slot of plane 1 << 16.
// - w: slot of plane 2 | birth << 16 (for the page fade).
// Artworks with more planes keep planes 3 to 10 in a second texture of the same width (x: slot 3 | slot 4 << 16, and so
// on to w: slot 9 | slot 10 << 16), and each further eight planes as many rows below as the table has.
//
// Only nodes whose streamed planes are all resident are entered. Slots have 16 bits (65,535 x 72 KiB = 4.5 GiB). Hash
// functions and constants are in shaders/page_table.h, which compiles as C++ and GLSL. CPU side only: emits the texels
// that changed; src/render uploads them.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "shaders/page_table.h"
#include "src/artwork/node_id.h"
#include "texturing/codec/page_id.h"

namespace relievo {

struct PageTableEntry {
  std::array<uint16_t, kMaxTexturePlanes> slots{};
  uint16_t birth = 0;  // frame time in 1/64 s, modulo 2^16; 0: long ago (fadeClock())
};

// PageTableEntry::birth of a new page.
inline uint16_t fadeClock(double now_s) {
  const auto ticks = static_cast<uint16_t>(static_cast<uint64_t>(std::max(0.0, now_s) * 64) & 0xFFFFu);
  return std::max<uint16_t>(ticks, 1);
}

class PageTable {
 public:
  // Has room for max_nodes resident nodes (at most 65,536) at a load of at most 0.4. The width is a power of two, at
  // most 1024 texels; width * height is a power of two, and minus 1 the mask of the probes. planes: the number of slots
  // of an entry. Up to three planes there is no second texture, and find() returns 0 for the others.
  explicit PageTable(uint32_t max_nodes, int planes = kMaxTexturePlanes);

  uint32_t width() const;  // in texels
  uint32_t height() const;
  uint32_t seed() const;  // a uniform of the look-up; changes with a rehash
  // Inserts or replaces. A new node beyond max_nodes is not entered (a caller's bug); a look-up then finds its
  // ancestor.
  void insert(const NodeId& node, const PageTableEntry& entry);
  void erase(const NodeId& node);                                // if it is absent, nothing happens
  std::optional<PageTableEntry> find(const NodeId& node) const;  // with the same probes as the shader
  uint32_t size() const;

  std::span<const std::array<uint32_t, 4>> texels() const;  // width * height
  // Planes 3 and up: extraLayers() times width * height texels, layer by layer; empty if there are none. Any layer of a
  // dirty texel may have changed.
  std::span<const std::array<uint32_t, 4>> extraTexels() const;
  uint32_t extraLayers() const { return layers_; }
  // Indices of texels that changed since the last call (each once, ascending); all of them after a rehash.
  std::vector<uint32_t> takeDirty();
  size_t metadataBytes() const;  // the memory of this object, itself included; the textures have texelBytes() more
  size_t texelBytes() const { return (texels_.size() + extra_.size()) * sizeof(texels_[0]); }

 private:
  static constexpr uint32_t kMaxLayers =
      (kMaxTexturePlanes - RV_PLANES_IN_ENTRY + RV_PLANES_IN_EXTRA - 1) / RV_PLANES_IN_EXTRA;
  struct Item {
    std::array<uint32_t, 4> texel{};
    std::array<std::array<uint32_t, 4>, kMaxLayers> extra{};
  };
  uint32_t locate(uint64_t key) const;  // kNotFound: absent
  bool place(Item& item);               // false: `item` holds the entry without a cell
  void put(uint32_t index, const Item& item);
  void rehash(const Item& unplaced);
  std::array<uint32_t, 2> probes(const std::array<uint32_t, 4>& texel) const;

  Item itemAt(uint32_t index) const;

  uint32_t width_ = 0, height_ = 0, mask_ = 0, seed_ = 1, size_ = 0, max_nodes_ = 0, layers_ = 0;
  std::vector<std::array<uint32_t, 4>> texels_, extra_;
  std::vector<uint64_t> dirty_;  // a bit for each texel
  uint32_t dirty_count_ = 0;
  bool all_dirty_ = true;
};

}  // namespace relievo
