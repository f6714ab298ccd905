// common.glsl - the page pool's addressing, shared by all stages. Constants equal those of src/artwork/patch_domain.h
// and src/render/page_pool.h (compared by a test).
const int kPagePx = 128;
const int kPageBorderPx = 4;
const int kPageFullPx = 136;
const int kSlotsPerSide = 8;

uniform sampler2DArray u_pool;  // RGBA8: every slot of the one page cache

// First texel of a slot, and its layer.
ivec3 slotOrigin(int slot) {
  return ivec3((slot & 7) * kPageFullPx, ((slot >> 3) & 7) * kPageFullPx, slot >> 6);
}

// Of a relief page: its first texel (ReliefPlace of src/render/page_pool.h), and a sample. A texel holds two that
// follow one another in a row, the high byte of each first.
ivec3 reliefOrigin(int place) {
  uint at = uint(place);
  return ivec3(int(at & 2047u), int((at >> 11u) & 2047u), int(at >> 22u));
}
int sampleAt(ivec3 place, int x) {
  vec4 texel = texelFetch(u_pool, place, 0);
#ifdef ONE_SAMPLE_A_TEXEL
  vec2 bytes = texel.rg;
#else
  vec2 bytes = (x & 1) == 0 ? texel.rg : texel.ba;
#endif
  return int(bytes.x * 255.0 + 0.5) * 256 + int(bytes.y * 255.0 + 0.5);
}
int reliefSample(ivec3 origin, ivec2 s) { return sampleAt(origin + ivec3(s.x >> 1, s.y, 0), s.x); }

const uint kSignBit = 0x80000000u;  // of a float's bits

// 2^e, exact, for -126 <= e <= 127.
float powerOfTwo(int e) { return intBitsToFloat((127 + e) << 23); }
