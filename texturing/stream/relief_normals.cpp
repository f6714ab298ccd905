#include "texturing/stream/relief_normals.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "texturing/package/package_layout.h"

namespace relievo {
namespace {

struct Slope {
  double right = 0, down = 0;
};

// The texels along one axis of a page, and their positions among the cells of the relief level, clamped to the
// artwork's last texel.
struct AxisSampling {
  int64_t first_cell = 0, cells = 0;
  std::array<int64_t, kPageFullPx> low, high;  // cells whose centres enclose the texel's, from first_cell on
  std::array<double, kPageFullPx> weight;      // weight of the higher cell

  // origin: the node's first texel in the texture level; coarser: levels between the texture's and the relief's.
  AxisSampling(int64_t origin, int64_t level_texels, int64_t level_cells, int coarser) {
    const double scale = std::ldexp(1.0, -coarser);
    for (size_t i = 0; i < kPageFullPx; ++i) {
      const int64_t texel = std::clamp<int64_t>(origin + static_cast<int64_t>(i) - kPageBorderPx, 0, level_texels - 1);
      const double position = (static_cast<double>(texel) + 0.5) * scale - 0.5, cell = std::floor(position);
      low[i] = std::clamp<int64_t>(static_cast<int64_t>(cell), 0, level_cells - 1);
      high[i] = coarser > 0 ? std::clamp<int64_t>(static_cast<int64_t>(cell) + 1, 0, level_cells - 1) : low[i];
      weight[i] = coarser > 0 ? position - cell : 0;
    }
    first_cell = low.front();
    cells = high.back() - first_cell + 1;
    for (size_t i = 0; i < kPageFullPx; ++i) low[i] -= first_cell, high[i] -= first_cell;
  }
};

// The argument of the cast is never negative, so that truncation rounds down.
uint8_t normalByte(double n) { return static_cast<uint8_t>(127.5 * (n + 1) + 0.5); }

}  // namespace

ReliefNormals::Samples ReliefNormals::samplesOf(const NodeId& node, const ReadRelief& read) const {
  {
    std::lock_guard lock(mutex_);
    if (auto found = index_.find(node); found != index_.end()) {
      cached_.splice(cached_.begin(), cached_, found->second);
      return found->second->second;
    }
  }
  auto samples = std::make_shared<std::vector<uint16_t>>(size_t{kReliefSamples} * kReliefSamples);
  if (!read(node, *samples)) return nullptr;
  std::lock_guard lock(mutex_);
  if (!index_.contains(node)) {  // another thread may have read it meanwhile
    cached_.emplace_front(node, samples);
    index_.emplace(node, cached_.begin());
    if (cached_.size() > kCachedPages) {
      index_.erase(cached_.back().first);
      cached_.pop_back();
    }
  }
  return samples;
}

bool ReliefNormals::make(const NodeId& node, const ReadRelief& read, uint8_t* texels) const {
  const FlatDomain& d = surface_.domain;
  const int level = static_cast<int>(node.level), relief = std::min(level, d.relief_depth),
            to_texels = d.texture_depth - relief;
  auto originOf = [&](uint64_t patch_origin, uint32_t n) {
    return static_cast<int64_t>(patch_origin >> (d.texture_depth - level)) + int64_t{n} * kPagePx;
  };
  const AxisSampling across(originOf(d.patchOriginX(node.patch), node.x), static_cast<int64_t>(d.levelWidth(level)),
                            static_cast<int64_t>(d.levelWidth(relief)), level - relief);
  const AxisSampling downwards(originOf(d.patchOriginY(node.patch), node.y), static_cast<int64_t>(d.levelHeight(level)),
                               static_cast<int64_t>(d.levelHeight(relief)), level - relief);

  // The cells' slopes, page by page, since a cell's four samples are in one page.
  std::vector<Slope> slopes(static_cast<size_t>(across.cells * downwards.cells));
  const double mm_per_step = d.relief_scale_mm * surface_.exaggerate;
  // The side of a cell, which the artwork's border may cut.
  auto sideMm = [&](int64_t cell, uint64_t extent_px) {
    const double end = std::min(std::ldexp(static_cast<double>(cell + 1), to_texels), static_cast<double>(extent_px));
    return (end - std::ldexp(static_cast<double>(cell), to_texels)) * d.mm_per_px;
  };
  const int64_t end_x = across.first_cell + across.cells, end_y = downwards.first_cell + downwards.cells;
  for (int64_t row = downwards.first_cell / kPagePx; row * kPagePx < end_y; ++row) {
    for (int64_t column = across.first_cell / kPagePx; column * kPagePx < end_x; ++column) {
      const Samples page = samplesOf(d.nodeAt(relief, static_cast<uint64_t>(column), static_cast<uint64_t>(row)), read);
      if (!page) return false;
      for (int64_t y = std::max(row * kPagePx, downwards.first_cell); y < std::min((row + 1) * kPagePx, end_y); ++y) {
        const double per_down = 0.5 * mm_per_step / sideMm(y, d.height_px);
        for (int64_t x = std::max(column * kPagePx, across.first_cell); x < std::min((column + 1) * kPagePx, end_x);
             ++x) {
          const uint16_t* q = page->data() + (y - row * kPagePx) * kReliefSamples + (x - column * kPagePx);
          const int q00 = q[0], q10 = q[1], q01 = q[kReliefSamples], q11 = q[kReliefSamples + 1];
          slopes[static_cast<size_t>((y - downwards.first_cell) * across.cells + x - across.first_cell)] = {
              (q10 + q11 - q00 - q01) * (0.5 * mm_per_step / sideMm(x, d.width_px)),
              (q01 + q11 - q00 - q10) * per_down};
        }
      }
    }
  }

  for (size_t j = 0; j < kPageFullPx; ++j) {
    const double fy = downwards.weight[j];
    const Slope *upper = slopes.data() + downwards.low[j] * across.cells,
                *lower = slopes.data() + downwards.high[j] * across.cells;
    for (size_t i = 0; i < kPageFullPx; ++i) {
      const double fx = across.weight[i];
      const int64_t a = across.low[i], b = across.high[i];
      auto blend = [&](double Slope::*part) {
        if (level == relief) return upper[a].*part;
        const double top = upper[a].*part * (1 - fx) + upper[b].*part * fx,
                     bottom = lower[a].*part * (1 - fx) + lower[b].*part * fx;
        return top * (1 - fy) + bottom * fy;
      };
      const double right = blend(&Slope::right), down = blend(&Slope::down),
                   inverse_length = 1 / std::sqrt(1 + right * right + down * down);
      uint8_t* texel = texels + 4 * (j * kPageFullPx + i);
      texel[0] = normalByte(-right * inverse_length);
      texel[1] = normalByte(down * inverse_length);  // rows run down, y runs up
      texel[2] = normalByte(inverse_length);
      texel[3] = 255;
    }
  }
  return true;
}

}  // namespace relievo
