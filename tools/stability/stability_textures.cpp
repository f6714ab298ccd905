#include <array>
#include <random>
#include <vector>

#include "geometry/lod/patch_vertex.h"
#include "src/artwork/patch_domain.h"
#include "texturing/codec/mip.h"
#include "tools/stability/stability.h"

namespace relievo {
namespace {

FlatDomain domainOf(uint64_t width_px, uint64_t height_px) {
  FlatDomain d;
  d.width_px = width_px;
  d.height_px = height_px;
  d.texture_depth = FlatDomain::depthFor(width_px, height_px);
  return d;
}

// A grid of 16 cells, each a quarter of a texel wide, in the corner farthest from the origin.
StabilityErrors farCorner() {
  constexpr uint64_t kSide = uint64_t{1} << 24;
  constexpr int kGridLog2 = 4, kQuarterLog2 = kUnitsPerTexelLog2 - 2;
  const FlatDomain d = domainOf(kSide, kSide);
  PatchInstance p;
  p.grid_level = kGridLog2;
  p.step_log2 = kQuarterLog2;
  p.edges.fill({kGridLog2, PatchInstance::kWholeEdge});
  p.x0 = p.y0 = static_cast<int32_t>(kSide << kUnitsPerTexelLog2) - (1 << (kGridLog2 + kQuarterLog2));
  const auto no_page = [](const NodeId&) { return static_cast<const uint16_t*>(nullptr); };
  StabilityErrors out;
  for (uint32_t i = 0; i <= 1u << kGridLog2; ++i) {
    const double truth = static_cast<double>(kSide) - 4 + 0.25 * i;  // texels
    const PatchVertex v = patchVertex(d, p, i, i, false, no_page);
    const auto coordinate = static_cast<float>(truth / static_cast<double>(kSide));  // 0..1 over the artwork
    out.add(std::ldexp(static_cast<double>(v.x), -kUnitsPerTexelLog2) - truth,
            double{coordinate * static_cast<float>(kSide)} - truth);
  }
  return out;
}

// The node that holds a texel, at the finest level of the longest strip that there may be.
StabilityErrors nodesOfALongStrip() {
  const FlatDomain d = domainOf((uint64_t{1} << 27) - 130, 100);
  const uint64_t columns = d.nodeGrid(0).columns;
  StabilityErrors out;
  for (uint64_t column = columns - 65; column + 1 < columns; ++column) {
    const uint64_t texel = (column + 1) * kPagePx - 1;  // the last one of its node
    const NodeId node = d.nodeAt(0, texel / kPagePx, 0);
    const auto place = static_cast<float>(static_cast<double>(texel) / static_cast<double>(d.width_px));
    const double naive = std::floor(double{place * static_cast<float>(d.width_px)} / kPagePx);
    out.add(d.nodeExists(node) ? static_cast<double>(d.patchOriginX(node.patch)) / kPagePx - double(column) : NAN,
            naive - static_cast<double>(column));
  }
  return out;
}

// Every level of an artwork of one row has at least one row.
StabilityErrors levelsOfOneRow() {
  StabilityErrors out;
  for (const uint64_t rows : {1, 2, 3, 5, 127, 129})
    for (const uint64_t columns : {uint64_t{129}, (uint64_t{1} << 24) - 1}) {
      FlatDomain d = domainOf(columns, rows);
      d.texture_depth = FlatDomain::depthFor(columns, columns);  // as deep as the longer side, which halves the shorter
      for (int level = 0; level <= d.texture_depth; ++level) {
        const double truth = std::ceil(std::ldexp(static_cast<double>(rows), level - d.texture_depth));
        out.add(static_cast<double>(d.levelHeight(level)) - truth,
                static_cast<double>(rows >> (d.texture_depth - level)) - truth);
      }
    }
  return out;
}

// Eight levels over random coefficients: the coarsest is their mean.
StabilityErrors meanOfEightLevels() {
  constexpr int kLevels = 8, kSide = 1 << kLevels;
  TextureFormat format;
  format.basis = Basis::kPtmRgb;
  const auto channels = static_cast<size_t>(format.channels());
  std::mt19937 random(20261126);
  std::vector<uint8_t> bytes(channels * kSide * kSide);
  for (uint8_t& b : bytes) b = static_cast<uint8_t>(random());
  const MipFilter mip(format);
  std::vector<uint16_t> level(bytes.size() / 4), next(bytes.size() / 16);
  mip.downsample(bytes.data(), kSide, kSide, level.data());
  for (int side = kSide / 2; side > 1; side /= 2) {
    mip.downsample(level.data(), side, side, next.data());
    std::swap(level, next);
  }
  StabilityErrors out;
  for (size_t c = 0; c < channels; ++c) {
    const std::span<const uint8_t> channel(bytes.data() + c * kSide * kSide, size_t{kSide} * kSide);
    double sum = 0;
    for (const uint8_t b : channel) sum += b;
    const double mean = sum / static_cast<double>(channel.size());
    std::vector<uint8_t> truncated(channel.begin(), channel.end());
    for (size_t side = kSide; side > 1; side /= 2)
      for (size_t y = 0; y < side / 2; ++y)
        for (size_t x = 0; x < side / 2; ++x) {
          const uint8_t* q = truncated.data() + 2 * y * side + 2 * x;
          truncated[y * (side / 2) + x] = static_cast<uint8_t>((q[0] + q[1] + q[side] + q[side + 1]) / 4);
        }
    out.add(level[c] / 256.0 - mean, truncated[0] - mean);
  }
  return out;
}

constexpr StabilityCase kTextureCases[] = {
    {"quarter texels in the far corner of 2^24 texels a side", "their places are multiples of 1/4",
     "float coordinates, 0 to 1 over the artwork", "texels", 1.0 / 64, farCorner},
    {"the last nodes of a strip of 2^27 texels", "the node's column is the texel's, divided by 128",
     "float coordinates, 0 to 1 over the artwork", "nodes", 0.5, nodesOfALongStrip},
    {"levels of artworks of 1 to 129 rows", "ceil(rows / 2^k), so at least one row", "rows >> k", "rows", 0.5,
     levelsOfOneRow},
    {"eight levels of coefficients", "the coarsest texel is the mean of 65,536", "averages truncated to bytes",
     "of 255", 1.0 / 32, meanOfEightLevels},
};

}  // namespace

std::span<const StabilityCase> textureStability() { return kTextureCases; }

}  // namespace relievo
