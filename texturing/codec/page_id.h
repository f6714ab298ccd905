// page_id.h - the one key of store, requests, cache and page table: (plane, patch, level, x, y) in 64 bits.
#pragma once

#include <compare>
#include <cstddef>
#include <cstdint>
#include <functional>

#include "src/artwork/node_id.h"

namespace relievo {

// Texture planes hold three 8-bit channels each. What the channels mean depends on the artwork's basis (basis.h):
// colour: plane 0 = R G B. Albedo and normal: 0 = R G B, 1 = x y z of the normal. LRGB PTM: 0 = a0 a1 a2, 1 = a3 a4 a5,
// 2 = R G B. RGB PTM: plane k = a_k of R, G and B.
enum class Plane : uint8_t {
  kTexture0 = 0,  // ... kTexture0 + 7
  kRelief = 8,    // 16-bit displacement, vertex-centred
  kResolved = 9   // R G B under a fixed light, computed once per page from the texture planes; never stored
};
inline constexpr int kMaxTexturePlanes = 8;
inline constexpr Plane kNormalPlane = static_cast<Plane>(
    1);  // of albedo and normal; of colour that is lit by its relief it is made, not stored (relief_normals.h)
inline constexpr Plane texturePlane(int k) { return static_cast<Plane>(k); }
inline constexpr bool isTexturePlane(Plane p) { return static_cast<uint8_t>(p) < kMaxTexturePlanes; }

struct PageId {
  uint64_t bits = 0;  // plane << 59 | packNode(node)

  PageId() = default;
  constexpr PageId(Plane plane, const NodeId& node) : bits((uint64_t(plane) << 59) | packNode(node)) {}
  constexpr Plane plane() const { return static_cast<Plane>(bits >> 59); }
  constexpr NodeId node() const { return unpackNode(bits & ((uint64_t{1} << 59) - 1)); }
  friend auto operator<=>(const PageId&, const PageId&) = default;
};

}  // namespace relievo

template <>
struct std::hash<relievo::PageId> {
  size_t operator()(const relievo::PageId& p) const noexcept {
    uint64_t h = p.bits * 0x9E3779B97F4A7C15ull;
    return static_cast<size_t>(h ^ (h >> 32));
  }
};
