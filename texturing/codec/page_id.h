// page_id.h - the one key of store, requests, cache and page table: (plane, patch, level, x, y) in 64 bits.
#pragma once

#include <compare>
#include <cstddef>
#include <cstdint>
#include <functional>

#include "src/artwork/basis.h"
#include "src/artwork/node_id.h"

namespace relievo {

// Texture planes hold three 8-bit channels each. What the channels mean depends on the artwork's basis (basis.h).
// Numbers stand in traces and reports, and two of them among the texture planes': 0..7 are texture planes 0..7, and
// 10..30 are texture planes 8..28.
enum class Plane : uint8_t {
  kTexture0 = 0,
  kRelief = 8,    // 16-bit displacement, vertex-centred
  kResolved = 9,  // R G B under a fixed light, computed once per page from the texture planes; never stored
  kShared = 31    // a slot that relief pages share (subslot_cache.h); no page's plane
};
inline constexpr int kPlaneNumbers = 32;  // five bits of a PageId
inline constexpr Plane texturePlane(int k) {
  return static_cast<Plane>(k < static_cast<int>(Plane::kRelief) ? k : k + 2);
}
static_assert(texturePlane(kMaxTexturePlanes) == Plane::kShared);
inline constexpr bool isTexturePlane(Plane p) {
  return p < Plane::kRelief || (p > Plane::kResolved && p < Plane::kShared);
}
// The k of texturePlane(k).
inline constexpr int texturePlaneIndex(Plane p) { return static_cast<int>(p) - (p < Plane::kRelief ? 0 : 2); }
// Of albedo and normal; of colour that is lit by its relief it is made, not stored (relief_normals.h).
inline constexpr Plane kNormalPlane = texturePlane(1);

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
