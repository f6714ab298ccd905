#include "texturing/stream/relief_normals.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

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

// The texels of a page over the cells of one level of the relief.
struct PageSampling {
  AxisSampling across, downwards;
  bool coarser;  // the relief's level is coarser than the texture's

  PageSampling(const FlatDomain& d, const NodeId& node, int relief)
      : across(originOf(d, d.patchOriginX(node.patch), node, node.x), levelSize(d.levelWidth(node.level)),
               levelSize(d.levelWidth(relief)), static_cast<int>(node.level) - relief),
        downwards(originOf(d, d.patchOriginY(node.patch), node, node.y), levelSize(d.levelHeight(node.level)),
                  levelSize(d.levelHeight(relief)), static_cast<int>(node.level) - relief),
        coarser(static_cast<int>(node.level) > relief) {}
  // Of a number of each cell, `row` a row of them, at a texel's middle. cell(i): of cell i.
  template <typename CellNumber>
  double at(size_t i, size_t j, int64_t row, const CellNumber& cell) const {
    const int64_t upper = downwards.low[j] * row, lower = downwards.high[j] * row;
    const int64_t a = across.low[i], b = across.high[i];
    if (!coarser) return cell(upper + a);
    const double fx = across.weight[i], fy = downwards.weight[j];
    const double top = cell(upper + a) * (1 - fx) + cell(upper + b) * fx,
                 bottom = cell(lower + a) * (1 - fx) + cell(lower + b) * fx;
    return top * (1 - fy) + bottom * fy;
  }

 private:
  static int64_t originOf(const FlatDomain& d, uint64_t patch_origin, const NodeId& node, uint32_t n) {
    return static_cast<int64_t>(patch_origin >> (d.texture_depth - static_cast<int>(node.level))) +
           int64_t{n} * kPagePx;
  }
  static int64_t levelSize(uint64_t texels) { return static_cast<int64_t>(texels); }
};

// The argument of the cast is never negative, so that truncation rounds down.
uint8_t normalByte(double n) { return static_cast<uint8_t>(127.5 * (n + 1) + 0.5); }

// share: 0..1 of all 16 bits.
void putNumber(double share, uint8_t* texel) {
  const auto number = static_cast<uint32_t>(std::clamp(share, 0.0, 1.0) * 65535 + 0.5);
  texel[0] = static_cast<uint8_t>(number >> 8);
  texel[1] = static_cast<uint8_t>(number);
  texel[2] = 0;
  texel[3] = 255;
}

// Cells around a place, row by row: row j reaches from -half_widths[|j|] to as many to the right.
struct CellDisc {
  std::vector<int64_t> half_widths;
  double cells = 0, mean_square = 0;  // of the distance, in cells
  explicit CellDisc(double radius) {
    const auto rows = static_cast<int64_t>(radius);
    for (int64_t j = 0; j <= rows; ++j) {
      const auto y = static_cast<double>(j);
      half_widths.push_back(static_cast<int64_t>(std::sqrt(radius * radius - y * y)));
      for (int64_t i = -half_widths.back(); i <= half_widths.back(); ++i) {
        const double times = j == 0 ? 1 : 2;
        cells += times;
        mean_square += times * (y * y + static_cast<double>(i * i));
      }
    }
    mean_square /= cells;
  }
  int64_t rows() const { return static_cast<int64_t>(half_widths.size()) - 1; }
};

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

double reliefNumber(ReliefQuantity quantity, double red, double green) {
  const double number = 256 * red + green;
  if (quantity == ReliefQuantity::kSlope) return number / 65535 * 90;
  if (quantity == ReliefQuantity::kCurvature) return (2 * number / 65535 - 1) * kMostCurvature;
  return number;
}

// A rectangle of cells of a level, within the artwork.
struct ReliefNormals::Cells {
  int level = 0;
  int64_t x = 0, y = 0, columns = 0, rows = 0;
};

// Page by page, since a cell's four samples are in one page. take(x, y, q): a cell's column and row in the artwork, and
// the first of its samples.
template <class Take>
bool ReliefNormals::readCells(const Cells& cells, const ReadRelief& read, Take take) const {
  const int64_t end_x = cells.x + cells.columns, end_y = cells.y + cells.rows;
  for (int64_t row = cells.y / kPagePx; row * kPagePx < end_y; ++row) {
    for (int64_t column = cells.x / kPagePx; column * kPagePx < end_x; ++column) {
      const NodeId node =
          surface_.domain.nodeAt(cells.level, static_cast<uint64_t>(column), static_cast<uint64_t>(row));
      const Samples page = samplesOf(node, read);
      if (!page) return false;
      for (int64_t y = std::max(row * kPagePx, cells.y); y < std::min((row + 1) * kPagePx, end_y); ++y)
        for (int64_t x = std::max(column * kPagePx, cells.x); x < std::min((column + 1) * kPagePx, end_x); ++x)
          take(x, y, page->data() + (y - row * kPagePx) * kReliefSamples + (x - column * kPagePx));
    }
  }
  return true;
}

bool ReliefNormals::make(const NodeId& node, const ReadRelief& read, uint8_t* texels) const {
  if (surface_.quantity == ReliefQuantity::kCurvature) return makeCurvatures(node, read, texels);
  if (surface_.quantity == ReliefQuantity::kHeight) return makeHeights(node, read, texels);
  return makeGradients(node, read, texels);
}

bool ReliefNormals::makeGradients(const NodeId& node, const ReadRelief& read, uint8_t* texels) const {
  const FlatDomain& d = surface_.domain;
  const int relief = std::min(static_cast<int>(node.level), d.relief_depth), to_texels = d.texture_depth - relief;
  const PageSampling sampling(d, node, relief);
  const AxisSampling &across = sampling.across, &downwards = sampling.downwards;
  std::vector<Slope> slopes(static_cast<size_t>(across.cells * downwards.cells));
  const double mm_per_step = d.relief_scale_mm * surface_.exaggerate;
  // The side of a cell, which the artwork's border may cut.
  auto sideMm = [&](int64_t cell, uint64_t extent_px) {
    const double end = std::min(std::ldexp(static_cast<double>(cell + 1), to_texels), static_cast<double>(extent_px));
    return (end - std::ldexp(static_cast<double>(cell), to_texels)) * d.mm_per_px;
  };
  std::vector<double> per_right, per_down;  // of the columns and rows: half a step of a sample, as a slope
  for (int64_t x = 0; x < across.cells; ++x)
    per_right.push_back(0.5 * mm_per_step / sideMm(across.first_cell + x, d.width_px));
  for (int64_t y = 0; y < downwards.cells; ++y)
    per_down.push_back(0.5 * mm_per_step / sideMm(downwards.first_cell + y, d.height_px));
  if (!readCells({relief, across.first_cell, downwards.first_cell, across.cells, downwards.cells}, read,
                 [&](int64_t x, int64_t y, const uint16_t* q) {
                   const int q00 = q[0], q10 = q[1], q01 = q[kReliefSamples], q11 = q[kReliefSamples + 1];
                   const int64_t column = x - across.first_cell, row = y - downwards.first_cell;
                   slopes[static_cast<size_t>(row * across.cells + column)] = {
                       (q10 + q11 - q00 - q01) * per_right[static_cast<size_t>(column)],
                       (q01 + q11 - q00 - q10) * per_down[static_cast<size_t>(row)]};
                 }))
    return false;

  for (size_t j = 0; j < kPageFullPx; ++j) {
    for (size_t i = 0; i < kPageFullPx; ++i) {
      auto blend = [&](double Slope::*part) {
        return sampling.at(i, j, across.cells, [&](int64_t cell) { return slopes[static_cast<size_t>(cell)].*part; });
      };
      const double right = blend(&Slope::right), down = blend(&Slope::down);
      uint8_t* texel = texels + 4 * (j * kPageFullPx + i);
      if (surface_.quantity == ReliefQuantity::kSlope) {
        putNumber(std::atan(std::hypot(right, down)) / (std::numbers::pi / 2), texel);
        continue;
      }
      const double inverse_length = 1 / std::sqrt(1 + right * right + down * down);
      texel[0] = normalByte(-right * inverse_length);
      texel[1] = normalByte(down * inverse_length);  // rows run down, y runs up
      texel[2] = normalByte(inverse_length);
      texel[3] = 255;
    }
  }
  return true;
}

bool ReliefNormals::makeHeights(const NodeId& node, const ReadRelief& read, uint8_t* texels) const {
  const FlatDomain& d = surface_.domain;
  const int relief = std::min(static_cast<int>(node.level), d.relief_depth);
  const PageSampling sampling(d, node, relief);
  const AxisSampling &across = sampling.across, &downwards = sampling.downwards;
  std::vector<int> sums(static_cast<size_t>(across.cells * downwards.cells));  // of four samples
  if (!readCells({relief, across.first_cell, downwards.first_cell, across.cells, downwards.cells}, read,
                 [&](int64_t x, int64_t y, const uint16_t* q) {
                   sums[static_cast<size_t>((y - downwards.first_cell) * across.cells + x - across.first_cell)] =
                       q[0] + q[1] + q[kReliefSamples] + q[kReliefSamples + 1];
                 }))
    return false;
  for (size_t j = 0; j < kPageFullPx; ++j)
    for (size_t i = 0; i < kPageFullPx; ++i)
      putNumber(sampling.at(i, j, across.cells, [&](int64_t cell) { return sums[static_cast<size_t>(cell)]; }) /
                    (4 * 65535.0),
                texels + 4 * (j * kPageFullPx + i));
  return true;
}

bool ReliefNormals::makeCurvatures(const NodeId& node, const ReadRelief& read, uint8_t* texels) const {
  const FlatDomain& d = surface_.domain;
  int relief = std::min(static_cast<int>(node.level), d.relief_depth);
  const auto cellMm = [&] { return std::ldexp(d.mm_per_px, d.texture_depth - relief); };
  while (relief > 0 && surface_.radius_mm > kMostRadius * cellMm()) --relief;
  const double radius = std::clamp(surface_.radius_mm / cellMm(), kLeastRadius, kMostRadius);
  const CellDisc outer(radius), inner(radius / 2);
  const PageSampling sampling(d, node, relief);
  const AxisSampling &across = sampling.across, &downwards = sampling.downwards;

  // Sums of the cells' samples along each row, around the page's cells as far as the disc reaches. Beyond the artwork's
  // border its outermost cells go on.
  const int64_t reach = outer.rows(), width = static_cast<int64_t>(d.levelWidth(relief)),
                height = static_cast<int64_t>(d.levelHeight(relief));
  const int64_t left = across.first_cell - reach, top = downwards.first_cell - reach;
  const int64_t columns = across.cells + 2 * reach, rows = downwards.cells + 2 * reach;
  const Cells inside{relief, std::max<int64_t>(left, 0), std::max<int64_t>(top, 0),
                     std::min(left + columns, width) - std::max<int64_t>(left, 0),
                     std::min(top + rows, height) - std::max<int64_t>(top, 0)};
  std::vector<int> sums(static_cast<size_t>(inside.columns * inside.rows));
  if (!readCells(inside, read, [&](int64_t x, int64_t y, const uint16_t* q) {
        sums[static_cast<size_t>((y - inside.y) * inside.columns + x - inside.x)] =
            q[0] + q[1] + q[kReliefSamples] + q[kReliefSamples + 1];
      }))
    return false;
  std::vector<int64_t> up_to(
      static_cast<size_t>((columns + 1) * rows));  // the sum of the cells before each, in its row
  for (int64_t y = 0; y < rows; ++y) {
    const int64_t from = std::clamp<int64_t>(top + y - inside.y, 0, inside.rows - 1) * inside.columns;
    int64_t* row = up_to.data() + y * (columns + 1);
    for (int64_t x = 0; x < columns; ++x)
      row[x + 1] =
          row[x] + sums[static_cast<size_t>(from + std::clamp<int64_t>(left + x - inside.x, 0, inside.columns - 1))];
  }
  const auto meanOver = [&](const CellDisc& disc, int64_t x, int64_t y) {
    int64_t sum = 0;
    for (int64_t j = -disc.rows(); j <= disc.rows(); ++j) {
      const int64_t* row = up_to.data() + (y + j) * (columns + 1);
      const int64_t half = disc.half_widths[static_cast<size_t>(std::abs(j))];
      sum += row[x + half + 1] - row[x - half];
    }
    return static_cast<double>(sum) / (4 * disc.cells);
  };
  // From a difference of means, in the relief's units, to the curvature times the radius that was asked for.
  const double per_unit = -2 * d.relief_scale_mm * surface_.exaggerate * surface_.radius_mm /
                          ((outer.mean_square - inner.mean_square) * cellMm() * cellMm());
  std::vector<double> curvatures;
  curvatures.reserve(static_cast<size_t>(across.cells * downwards.cells));
  for (int64_t y = 0; y < downwards.cells; ++y)
    for (int64_t x = 0; x < across.cells; ++x)
      curvatures.push_back(per_unit * (meanOver(outer, x + reach, y + reach) - meanOver(inner, x + reach, y + reach)));
  for (size_t j = 0; j < kPageFullPx; ++j)
    for (size_t i = 0; i < kPageFullPx; ++i)
      putNumber(
          0.5 + sampling.at(i, j, across.cells, [&](int64_t cell) { return curvatures[static_cast<size_t>(cell)]; }) /
                    (2 * kMostCurvature),
          texels + 4 * (j * kPageFullPx + i));
  return true;
}

}  // namespace relievo
