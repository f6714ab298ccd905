// first_base.h - how many patches a base mesh of a scan may have, and what takes the place of a first base whose
// topology alone takes far more. Pure.
#pragma once

#include <cstddef>
#include <cstdint>

#include "src/base/result.h"

namespace relievo {

// More patches take ever more: three pages and some 4 to 20 KiB each, and as many root pages that stay resident. A
// scan's own triangles show what nothing else does, and are worth more of them.
inline constexpr uint32_t kMostPatches = 4096, kMostFaces = 65'536;

// Of a first base (BaseDomain::make()): that many holes or pieces take more than twice the patches there may be. Its
// patches are large where the shape needs small ones; a bake takes minutes and misses.
constexpr bool isHopeless(size_t first_patches) { return first_patches > 2 * size_t{kMostPatches}; }

// Tries the bases that may take its place, those of the fewest patches first, until there is one: false if there is
// none. faces(max_patches): of the scan's own triangles (BaseDomain::faces()); simplified(): of simplified ones
// (simplifiedFaces()). Each answers whether there is such a base, or with an error, which is handed on.
template <class Faces, class Simplified>
Result<bool> replaceFirstBase(Faces faces, Simplified simplified) {
  Result<bool> replaced = faces(kMostPatches);
  if (replaced && !*replaced) replaced = simplified();
  if (replaced && !*replaced) replaced = faces(kMostFaces);
  return replaced;
}

}  // namespace relievo
