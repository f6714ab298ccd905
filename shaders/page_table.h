// page_table.h - compiles as C++ and as GLSL: the hash functions of the page table (texturing/stream/page_table.h).
// key_lo, key_hi: the 64-bit key packNode(node) + 1. mask: entries - 1 (a power of two, at least 2 entries).
//
// Only uint arithmetic, so that GLSL 3.30, GLSL ES 3.00 and C++ give the same bits.
// The finaliser is lowbias32 (Chris Wellons, hash-prospector: bias 0.17 of the ideal 0). The seed enters before a
// multiplication of its own and the two halves of the key one after the other, so that keys which collide under one
// seed do not under the next: a rehash always helps. (With the halves merged by xor first, they would collide under
// every seed.) Every pixel computes this for each level that it reads: four multiplications in all, where three
// finalisers had six.
#ifdef __cplusplus
#pragma once
#include <cstdint>
namespace relievo::shader {
using uint = uint32_t;
#define RV_FUNC inline
#else
#define RV_FUNC
#endif

// An entry has the slots of three planes (texturing/stream/page_table.h); each texel of the second texture has those of
// eight more, two in each component, the first in the lower half.
#define RV_PLANES_IN_ENTRY 3
#define RV_PLANES_IN_EXTRA 8

RV_FUNC uint pageMix(uint h) {
  h = (h ^ (h >> 16u)) * 0x7FEB352Du;
  h = (h ^ (h >> 15u)) * 0x846CA68Bu;
  return h ^ (h >> 16u);
}
RV_FUNC uint pageHash(uint key_lo, uint key_hi, uint seed) {
  uint h = (key_lo ^ seed) * 0x9E3779B1u;
  return pageMix((h ^ (h >> 15u)) + key_hi);
}
RV_FUNC uint pageProbe0(uint h, uint mask) { return h & mask; }
// From the upper bits of a product, which depend on all of h. Differs from the first probe in its lowest bit, always:
// the two cells of a key are never the same one.
RV_FUNC uint pageProbe1(uint h, uint mask) { return (h ^ ((h * 0x9E3779B9u) >> 14u | 1u)) & mask; }

#ifdef __cplusplus
}  // namespace relievo::shader
#endif
