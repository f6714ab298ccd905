// compact_relief.glsl - a sample of a relief page of either form: plain, or compact (CPU reference: compactSample() of
// texturing/codec/relief_compact.h). origin: the part's first texel. form: 0: plain; else 1 + n of a compact page of
// 128 >> n cells a side, whose part has 136 >> n texels a row.
ivec3 compactPlace(ivec3 origin, int coarser, int i) {
  int row = ((i << coarser) * 7711) >> 20;  // i / (136 >> coarser), for all texels of a part
  return origin + ivec3(i - row * (kPageFullPx >> coarser), row, 0);
}
// The first byte the lowest. Sums of floats that differ from the number by less than 1/100.
uint sixteenBits(vec2 bytes) { return uint(bytes.x * 255.0 + bytes.y * 65280.0 + 0.5); }
uint compactTexel(ivec3 place) {
  vec4 texel = texelFetch(u_pool, place, 0);
  return sixteenBits(texel.rg) | sixteenBits(texel.ba) << 16u;
}

int reliefSampleOf(ivec3 origin, int form, ivec2 s) {
  // Of a compact page first the half header that lies as a sample does: what all need is fetched in one place.
  int coarser = max(form - 1, 0), last = (16 >> coarser) - 1;
  ivec2 block = min(s >> 3, ivec2(last)), at = s - (block << 3);
  int index = (block.y << (4 - coarser)) + block.x, odd = index & 1, halves = index + (index >> 1) + 1 - odd;
  int value = sampleAt(form == 0 ? origin + ivec3(s.x >> 1, s.y, 0) : compactPlace(origin, coarser, halves),
                       form == 0 ? s.x : odd);
  // Loops, so that only what some lane has is fetched (in software what the first turn has, too).
  for (int k = 0; k < (form == 0 ? 0 : 1); ++k) {
    int plane = int(compactTexel(compactPlace(origin, coarser, halves + 2 * odd - 1)));
    uint width = uint(value) & 15u;
    width += (width + 1u) >> 4u;
#ifdef NARROW_RESIDUALS
    width = max(width, 1u) - 1u;
#endif
    uint bit = width * uint((at.y << 3) + at.x + (block.x == last ? at.y : 0)), shift = bit & 31u;
    ivec3 place = compactPlace(origin, coarser, ((value >> 4) << 1) + int(bit >> 5u));
    uint residual = compactTexel(place) >> shift;
    for (int beyond = 0; beyond < (shift + width > 32u ? 1 : 0); ++beyond) {
      place.x += 1;
      if (place.x - origin.x == kPageFullPx >> coarser) place = ivec3(origin.x, place.y + 1, place.z);
      residual |= compactTexel(place) << (32u - shift);
    }
    ivec2 slope = ivec2(plane << 8, plane) >> 24;
#ifdef FLAT_BLOCKS
    slope = ivec2(0);
#endif
    value = (plane + ((slope.x * at.x + slope.y * at.y) << 3) + int(residual & ((1u << width) - 1u))) & 0xFFFF;
  }
  return value;
}
