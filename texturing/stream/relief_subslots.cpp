#include "texturing/stream/relief_subslots.h"

#include <cassert>
#include <cstring>

#include "texturing/codec/relief_compact.h"

namespace relievo {
namespace {

int sampleAt(const uint8_t* texels, int x, int y) {
  const uint8_t* t = texels + 4 * (y * kPageFullPx + x);
  return t[0] << 8 | t[1];
}

// Are all samples interpolated from every (1 << up)-th? Uses the same sums as heightQ8() in shaders/patch.vert.
bool isInterpolatedFrom(const uint8_t* texels, int up) {
  const int step = 1 << up, half = step >> 1;
  for (int y = 0; y <= kPagePx; ++y) {
    const int y0 = y & ~(step - 1), fy = y - y0, y1 = y0 + step <= kPagePx ? y0 + step : y0;
    for (int x0 = 0; x0 <= kPagePx; x0 += step) {
      const int x1 = x0 + step <= kPagePx ? x0 + step : x0;
      const int q00 = sampleAt(texels, x0, y0), q10 = sampleAt(texels, x1, y0), q01 = sampleAt(texels, x0, y1),
                q11 = sampleAt(texels, x1, y1);
      for (int fx = 0; fx < step && x0 + fx <= kPagePx; ++fx) {
        const int more = fx >= fy ? fx * (q10 - q00) + fy * (q11 - q10) : fy * (q01 - q00) + fx * (q11 - q01);
        if (sampleAt(texels, x0 + fx, y) != ((q00 << up) + more + half) >> up) return false;
      }
    }
  }
  return true;
}

}  // namespace

int reliefPartLevel(std::span<const uint8_t> texels, ReliefParts parts) {
  assert(texels.size() == kSlotBytes);
  if (parts == ReliefParts::kOnlyHalves) return kReliefPartLevel;
  // The smallest part is tried first, since rounding in two steps would change some samples.
  int level = kThirds - 1;
  while (level > kReliefPartLevel && !isInterpolatedFrom(texels.data(), reliefStepLog2(level))) --level;
  if (parts == ReliefParts::kSmall) return level;
  const int third = compactLevel(level);
  const std::optional<uint32_t> needed = compactTexels(texels, static_cast<int>(reliefCells(level)));
  return needed && size_t{4} * *needed <= partBytes(third) ? third : level;
}

void packRelief(std::span<const uint8_t> texels, int level, std::span<uint8_t> out) {
  assert(texels.size() == kSlotBytes && out.size() == partBytes(level));
  if (isThird(level)) {
    packCompact(texels, static_cast<int>(reliefCells(level)), out);
    return;
  }
  const int step = 1 << reliefStepLog2(level), columns = 2 * partColumns(level), rows = partRows(level);
  uint8_t* to = out.data();
  for (int y = 0; y < rows; ++y) {
    const uint8_t* from = texels.data() + size_t{4} * kPageFullPx * static_cast<size_t>(y * step);
    for (int x = 0; x < columns; ++x, from += 4 * step, to += 2) std::memcpy(to, from, 2);
  }
}

}  // namespace relievo
