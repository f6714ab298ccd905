// common.glsl - the page pool's addressing, shared by all stages. Constants equal those of src/base/planar_domain.h and
// src/render/page_pool.h (compared by a test).
const int kPagePx = 128;
const int kPageBorderPx = 4;
const int kPageFullPx = 136;
const int kSlotsPerSide = 8;

uniform sampler2DArray u_pool;  // RGBA8: every slot of the one page cache

// First texel of a slot, and its layer.
ivec3 slotOrigin(int slot) {
  return ivec3((slot & 7) * kPageFullPx, ((slot >> 3) & 7) * kPageFullPx, slot >> 6);
}

// 2^e, exact, for -126 <= e <= 127.
float powerOfTwo(int e) { return intBitsToFloat((127 + e) << 23); }
