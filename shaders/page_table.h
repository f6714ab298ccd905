// page_table.h - compiles as C++ and as GLSL: the hash functions of the page table (texturing/page_table.h).
// key_lo, key_hi: the 64-bit key packNode(node) + 1. mask: entries - 1 (a power of two).
#ifdef __cplusplus
#pragma once
#include <cstdint>
namespace relievo::shader {
using uint = uint32_t;
#define RV_FUNC inline
#else
#define RV_FUNC
#endif

RV_FUNC uint pageHash(uint key_lo, uint key_hi, uint seed) {
  uint h = (key_lo * 0x9E3779B1u) ^ (key_hi * 0x85EBCA77u) ^ seed;
  h = (h ^ (h >> 15u)) * 0x2C1B3C6Du;
  h = (h ^ (h >> 12u)) * 0x297A2D39u;
  return h ^ (h >> 15u);
}
RV_FUNC uint pageProbe0(uint h, uint mask) { return h & mask; }
RV_FUNC uint pageProbe1(uint h, uint mask) { return (((h >> 16u) * 0x9E3779B1u) ^ (h * 0x7FEB352Du)) >> 7u & mask; }

#ifdef __cplusplus
}  // namespace relievo::shader
#endif
