// Pages of normals that are made of relief pages: against planes, whose normal is one everywhere, and against one
// another where they overlap.
#include "texturing/stream/relief_normals.h"

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <numbers>
#include <set>
#include <thread>

#include "texturing/codec/page_codec.h"
#include "texturing/package/package_layout.h"

namespace relievo {
namespace relief_normals_test {

// Two patches of 512 texels a side along x, levels 0 to 2; the border cuts pages and cells.
FlatDomain domain(int relief_finer) {
  FlatDomain d;
  d.width_px = 701;
  d.height_px = 299;
  d.mm_per_px = 0.1;
  d.texture_depth = FlatDomain::depthFor(d.width_px, d.height_px);
  d.relief_depth = d.texture_depth + relief_finer;
  d.relief_scale_mm = 20.0 / 65535;
  return d;
}

// Samples as a package has them, of a height by the place in texels.
class Relief {
 public:
  Relief(const FlatDomain& d, std::function<double(double, double)> mm) : d_(d), mm_(std::move(mm)) {}
  bool read(const NodeId& node, std::span<uint16_t> out) {
    ++reads[node];
    if (missing.contains(node)) return false;
    const double spacing = std::ldexp(1.0, d_.texture_depth - static_cast<int>(node.level));
    for (size_t j = 0; j < kReliefSamples; ++j) {
      for (size_t i = 0; i < kReliefSamples; ++i) {
        const double x = std::min(
            static_cast<double>(d_.patchOriginX(node.patch)) + (node.x * 128.0 + static_cast<double>(i)) * spacing,
            static_cast<double>(d_.width_px));
        const double y = std::min(
            static_cast<double>(d_.patchOriginY(node.patch)) + (node.y * 128.0 + static_cast<double>(j)) * spacing,
            static_cast<double>(d_.height_px));
        out[j * kReliefSamples + i] = static_cast<uint16_t>(std::lround(mm_(x, y) / d_.relief_scale_mm));
      }
    }
    return true;
  }
  ReliefNormals::ReadRelief reader() {
    return [this](const NodeId& n, std::span<uint16_t> out) { return read(n, out); };
  }
  std::map<NodeId, int> reads;
  std::set<NodeId> missing;

 private:
  FlatDomain d_;
  std::function<double(double, double)> mm_;
};

std::vector<NodeId> nodesOf(const FlatDomain& d, int level) {
  std::vector<NodeId> nodes;
  const NodeGrid grid = d.nodeGrid(level);
  for (uint64_t row = 0; row < grid.rows; ++row)
    for (uint64_t column = 0; column < grid.columns; ++column) nodes.push_back(d.nodeAt(level, column, row));
  return nodes;
}

TEST(ReliefNormals, ofAPlaneAreThePlanesAtEveryLevelUpToTheBorder) {
  for (int finer : {-2, -1, 0, 1}) {
    const FlatDomain d = domain(finer);
    // 0.02 mm a texel to the right and 0.015 downwards, by 0.1 mm a texel; twice that exaggerated.
    Relief relief(d, [](double x, double y) { return 0.02 * x + 0.015 * y + 0.1; });
    const double right = 0.4, down = 0.3, length = std::sqrt(1 + right * right + down * down);
    const ReliefNormals normals({d, 2});
    std::vector<uint8_t> page(kSlotBytes);
    const std::array<double, 3> expected{-right / length, down / length, 1 / length};
    double worst = 0;
    for (int level = 0; level <= d.texture_depth; ++level) {
      for (const NodeId& node : nodesOf(d, level)) {
        ASSERT_TRUE(normals.make(node, relief.reader(), page.data()));
        for (size_t i = 0; i < kSlotBytes; i += 4) {
          for (size_t c = 0; c < 3; ++c) worst = std::max(worst, std::abs(page[i + c] / 127.5 - 1 - expected[c]));
          ASSERT_EQ(page[i + 3], 255);
        }
      }
    }
    EXPECT_LT(worst, 1.6 / 255 + 0.006) << finer;  // a byte's half step, and heights of 16 bits
  }
}

// The slope of a parabola over a cell is that at its middle, and between middles it is linear: normals are exact, also
// where the relief is coarser.
TEST(ReliefNormals, ofAParabolaAreThoseAtTheTexelsMiddles) {
  constexpr double kCentreX = 192, kCentreY = 64;  // of the page
  for (int finer : {-2, -1, 0}) {
    const FlatDomain d = domain(finer);
    Relief relief(d, [](double x, double y) {
      return std::min(20.0, 1e-3 * ((x - kCentreX) * (x - kCentreX) + 2 * (y - kCentreY) * (y - kCentreY)));
    });
    const ReliefNormals normals({d, 1});
    std::vector<uint8_t> page(kSlotBytes);
    ASSERT_TRUE(normals.make({0, 2, 1, 0}, relief.reader(), page.data()));
    double worst = 0;
    for (int j = 8; j < kPageFullPx; ++j) {  // beyond the middles of the artwork's outer cells slopes stay as they are
      for (int i = 0; i < kPageFullPx; ++i) {
        const double right = 2e-3 * (128 + i - 3.5 - kCentreX) / d.mm_per_px,
                     down = 4e-3 * (j - 3.5 - kCentreY) / d.mm_per_px,
                     length = std::sqrt(1 + right * right + down * down);
        const uint8_t* n = &page[static_cast<size_t>((j * kPageFullPx + i) * 4)];
        worst =
            std::max({worst, std::abs(n[0] / 127.5 - 1 + right / length), std::abs(n[1] / 127.5 - 1 - down / length)});
      }
    }
    EXPECT_LT(worst, 0.5 / 127.5 + 0.004) << finer;  // a byte's half step, and heights of 16 bits
  }
}

// Slopes and heights of a plane are the same everywhere or linear, and the curvature of a paraboloid is one, at every
// level, whether the relief is coarser than the texture, or than the radius asks for.
TEST(ReliefNormals, numbersOfPlanesAndParaboloidsAreKnown) {
  for (int finer : {-2, 1}) {
    const FlatDomain d = domain(finer);
    Relief plane(d, [](double x, double y) { return 0.02 * x + 0.015 * y + 0.1; });
    Relief bowl(d, [](double x, double y) { return 1e-4 * ((x - 350) * (x - 350) + (y - 150) * (y - 150)); });
    std::vector<uint8_t> page(kSlotBytes);
    double slope_off = 0, height_off = 0, curvature_off = 0;
    for (int level = 0; level <= d.texture_depth; ++level) {
      const double texel = std::ldexp(1.0, d.texture_depth - level);
      for (const NodeId& node : nodesOf(d, level)) {
        const auto worst = [&](const ReliefSurface& surface, Relief& relief, double inset, auto&& expected) {
          EXPECT_TRUE(ReliefNormals(surface).make(node, relief.reader(), page.data()));
          double off = 0;
          for (int j = 0; j < kPageFullPx; ++j)
            for (int i = 0; i < kPageFullPx; ++i) {
              const double x = static_cast<double>(d.patchOriginX(node.patch)) + (node.x * 128.0 + i - 3.5) * texel,
                           y = (node.y * 128.0 + j - 3.5) * texel;
              if (x < inset || y < inset || x > 701 - inset || y > 299 - inset) continue;
              const uint8_t* t = &page[static_cast<size_t>((j * kPageFullPx + i) * 4)];
              off = std::max(off, std::abs(reliefNumber(surface.quantity, t[0], t[1]) - expected(x, y)));
            }
          return off;
        };
        slope_off = std::max(slope_off, worst({d, 1, ReliefQuantity::kSlope}, plane, 0, [](double, double) {
                               return std::atan(std::hypot(0.2, 0.15)) * 180 / std::numbers::pi;
                             }));
        // A cell at the border is cut, so that its middle is elsewhere.
        height_off = std::max(height_off, worst({d, 1, ReliefQuantity::kHeight}, plane, 8, [&](double x, double y) {
                                return (0.02 * x + 0.015 * y + 0.1) / d.relief_scale_mm;
                              }));
        // h = 1e-4 (x^2 + y^2) of texels of 0.1 mm bends by 0.02 a mm both ways: valleys count below 0.
        for (const double radius_mm : {0.3, 4.0, 7.0}) {
          if (level < d.texture_depth - 1) continue;  // coarser levels have too little inside of the border
          curvature_off = std::max(curvature_off, worst({d, 1, ReliefQuantity::kCurvature, radius_mm}, bowl, 90,
                                                        [&](double, double) { return -0.02 * radius_mm; }) /
                                                      radius_mm);
        }
      }
    }
    EXPECT_LT(slope_off, 0.2) << finer << ": heights of 16 bits";
    EXPECT_LT(height_off, 1.1) << finer;
    EXPECT_LT(curvature_off, 0.004) << finer << ": a fifth, at the smallest radius";
  }
}

TEST(ReliefNormals, bordersAreTheNeighboursTexels) {
  const std::pair<int, ReliefQuantity> cases[] = {{-1, ReliefQuantity::kNormal},
                                                  {0, ReliefQuantity::kNormal},
                                                  {0, ReliefQuantity::kCurvature},
                                                  {-1, ReliefQuantity::kHeight}};
  for (const auto& [finer, quantity] : cases) {
    const FlatDomain d = domain(finer);
    Relief relief(d, [](double x, double y) { return 5 + 2 * std::sin(x / 9) + 2 * std::cos(y / 7 + x / 31); });
    const ReliefNormals normals({d, 1, quantity, 0.8});
    // Every texel of the level, as each page has it.
    for (int level = 1; level <= d.texture_depth; ++level) {
      std::map<std::pair<int64_t, int64_t>, uint32_t> texels;
      uint64_t twice = 0, different = 0;
      const NodeGrid grid = d.nodeGrid(level);
      std::vector<uint8_t> page(kSlotBytes);
      for (uint64_t row = 0; row < grid.rows; ++row) {
        for (uint64_t column = 0; column < grid.columns; ++column) {
          ASSERT_TRUE(normals.make(d.nodeAt(level, column, row), relief.reader(), page.data()));
          for (int64_t j = 0; j < kPageFullPx; ++j) {
            for (int64_t i = 0; i < kPageFullPx; ++i) {
              const int64_t x = static_cast<int64_t>(column) * kPagePx + i - kPageBorderPx,
                            y = static_cast<int64_t>(row) * kPagePx + j - kPageBorderPx;
              if (x < 0 || y < 0 || x >= static_cast<int64_t>(d.levelWidth(level)) ||
                  y >= static_cast<int64_t>(d.levelHeight(level)))
                continue;
              uint32_t texel = 0;
              std::memcpy(&texel, &page[static_cast<size_t>((j * kPageFullPx + i) * 4)], 4);
              auto [at, is_new] = texels.try_emplace({x, y}, texel);
              twice += !is_new;
              different += at->second != texel;
            }
          }
        }
      }
      EXPECT_GT(twice, 1000u);
      EXPECT_EQ(different, 0u) << "level " << level;
    }
  }
}

TEST(ReliefNormals, keepWhatTheyReadAndSayWhatIsMissing) {
  const FlatDomain d = domain(0);
  Relief relief(d, [](double x, double) { return 0.01 * x; });
  const ReliefNormals normals({d, 1});
  std::vector<uint8_t> page(kSlotBytes);
  for (const NodeId& node : nodesOf(d, 2)) ASSERT_TRUE(normals.make(node, relief.reader(), page.data()));
  EXPECT_EQ(relief.reads.size(), nodesOf(d, 2).size());
  for (const auto& [node, count] : relief.reads) EXPECT_EQ(count, 1);

  const ReliefNormals fresh({d, 1});
  relief.missing.insert(NodeId{0, 2, 1, 1});
  EXPECT_FALSE(fresh.make({0, 2, 0, 0}, relief.reader(), page.data())) << "a corner of its border";
  EXPECT_TRUE(fresh.make({1, 2, 0, 0}, relief.reader(), page.data()));
}

TEST(ReliefNormals, areTheSameFromManyThreads) {
  const FlatDomain d = domain(0);
  const ReliefNormals normals({d, 1});
  std::vector<std::thread> threads;
  std::vector<std::vector<uint8_t>> found(4);
  for (auto& bytes : found) {
    threads.emplace_back([&] {
      Relief relief(d, [](double x, double y) { return 5 + 2 * std::sin(x / 9) + 2 * std::cos(y / 7); });
      std::vector<uint8_t> page(kSlotBytes);
      for (int repeat = 0; repeat < 3; ++repeat) {
        for (const NodeId& node : nodesOf(d, 2)) {
          EXPECT_TRUE(normals.make(node, relief.reader(), page.data()));
          if (repeat == 2) bytes.insert(bytes.end(), page.begin(), page.end());
        }
      }
    });
  }
  for (std::thread& t : threads) t.join();
  for (const auto& bytes : found) EXPECT_EQ(bytes, found[0]);
}

}  // namespace relief_normals_test
}  // namespace relievo
