// The tails that stay in memory: what is left out of them is shown as well by what is kept, patches still meet, and
// resolved tails have the levels of what they are made of.
#include "texturing/package/kept_tails.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>

#include "patch_fixture.h"

namespace relievo {
namespace kept_tails_test {

using namespace testing_support;

constexpr uint64_t kSeed = 20261129;
constexpr KeptTailTolerance kExact{.of_255 = 0}, kOfNormals{.normals = true};

// value(patch, channel, u, v) at the finest level's texels; coarser ones are means.
PatchTails tailsOf(uint32_t patches, const std::function<double(uint32_t, int, double, double)>& value) {
  PatchTails tails(patches, 6);
  for (uint32_t p = 0; p < patches; ++p)
    for (int c = 0; c < 6; ++c)
      for (int level = 0; level < kTailLevels; ++level) {
        const int side = PatchTails::side(level), fine = kTailTexels / side;
        for (int y = 0; y < side; ++y)
          for (int x = 0; x < side; ++x) {
            double sum = 0;
            for (int j = 0; j < fine; ++j)
              for (int i = 0; i < fine; ++i)
                sum += value(p, c, (x * fine + i + 0.5) / kTailTexels, (y * fine + j + 0.5) / kTailTexels);
            tails.level(p, level, c)[y * side + x] =
                static_cast<uint8_t>(std::lround(std::clamp(sum / (fine * fine), 0.0, 255.0)));
          }
      }
  return tails;
}

// What shaders make of a block at (u, v) of its patch.
double shownAt(const TailBlocks& blocks, uint32_t patch, int level, int plane, int channel, double u, double v) {
  std::vector<uint32_t> block(tailBlockTexels(level));
  blocks.write(patch, level, plane, block.data());
  const double x = u * PatchTails::side(level) + 0.5, y = v * PatchTails::side(level) + 0.5;
  const auto x0 = static_cast<size_t>(x), y0 = static_cast<size_t>(y);
  const double fx = x - static_cast<double>(x0), fy = y - static_cast<double>(y0);
  auto at = [&](size_t i, size_t j) -> double {
    return block[(y0 + j) * tailBlockSide(level) + x0 + i] >> (8 * channel) & 255;
  };
  return (at(0, 0) * (1 - fx) + at(1, 0) * fx) * (1 - fy) + (at(0, 1) * (1 - fx) + at(1, 1) * fx) * fy;
}

TEST(KeptTails, OfASlopeTwoByTwoTexelsAreKept) {
  const auto slope = [](uint32_t, int c, double u, double v) { return 60 + 20 * c + 80 * u - 40 * v + 10 * u * v; };
  const PatchTails whole = tailsOf(3, slope);
  const KeptTails kept(whole, kOfNormals);
  EXPECT_LT(10 * kept.bytes(), whole.texels.size());
  for (uint32_t p = 0; p < 3; ++p)
    for (int plane = 0; plane < 2; ++plane) EXPECT_EQ(kept.plane(p, plane).finest, kTailLevels - 1);
  const PatchTails back = kept.whole(0, 3);
  int furthest = 0;
  for (size_t i = 0; i < back.texels.size(); ++i)
    furthest = std::max(furthest, std::abs(back.texels[i] - whole.texels[i]));
  EXPECT_LE(furthest, kTailTolerance * kTailNormals);
  EXPECT_TRUE(kept.heightsAreEven());
}

// One texel of the finest level that nothing coarser shows: all of the plane is kept, and of no other.
TEST(KeptTails, OneTexelThatIsOffIsKept) {
  for (const int off : {kTailTolerance, kTailTolerance + 1}) {
    PatchTails whole = tailsOf(2, [](uint32_t, int, double, double) { return 100; });
    whole.level(1, 0, 2)[77] = static_cast<uint8_t>(100 + off);
    const KeptTails kept(whole, kOfNormals);
    EXPECT_EQ(kept.plane(1, 0).finest, off > kTailTolerance ? 0 : kTailLevels - 1);
    EXPECT_EQ(kept.plane(1, 1).finest, kTailLevels - 1);
    EXPECT_EQ(kept.plane(0, 0).finest, kTailLevels - 1);
    EXPECT_EQ(KeptTails(whole, kExact).plane(1, 0).finest, 0) << "nothing may be off";
    EXPECT_EQ(KeptTails(whole, kExact).whole(1, 1).level(0, 0, 2)[77], 100 + off);
  }
  // Normals may be off by more; the second plane of a PTM may not.
  PatchTails whole = tailsOf(1, [](uint32_t, int, double, double) { return 100; });
  whole.level(0, 0, 4)[77] = 100 + kTailTolerance * kTailNormals;
  EXPECT_EQ(KeptTails(whole, kOfNormals).plane(0, 1).finest, kTailLevels - 1);
  EXPECT_EQ(KeptTails(whole).plane(0, 1).finest, 0);
  whole.level(0, 0, 4)[77] = 101 + kTailTolerance * kTailNormals;
  EXPECT_EQ(KeptTails(whole, kOfNormals).plane(0, 1).finest, 0);
}

// A plane that all patches have alike is so beyond their sides and corners, too; unless one texel differs.
TEST(KeptTails, AnEvenPlaneGoesOnAsItIs) {
  const BaseMesh mesh = cubeSphere(2, 50, kSeed);
  const auto patches = static_cast<uint32_t>(mesh.patches.size());
  const auto value = [](uint32_t, int c, double u, double) { return c < 3 ? 40 + 70 * c : 90 + 60 * u; };
  constexpr uint32_t kWord = 40 | 110 << 8 | 180 << 16;
  for (const bool even : {true, false}) {
    PatchTails whole = tailsOf(patches, value);
    if (!even) whole.level(5, 0, 1)[0] = 200;
    const KeptTails kept(whole, kOfNormals);
    const TailBlocks blocks(kept, mesh);
    size_t others = 0, of_second = 0;
    std::vector<uint32_t> block(tailBlockTexels(0));
    for (uint32_t p = 0; p < patches; ++p)
      for (int level = 0; level < kTailLevels; ++level)
        for (int plane = 0; plane < 2; ++plane) {
          const std::span<uint32_t> of_level = std::span(block).first(tailBlockTexels(level));
          blocks.write(p, level, plane, of_level.data());
          for (const uint32_t word : of_level) (plane == 0 ? others : of_second) += word != kWord;
        }
    EXPECT_EQ(others > 0, !even) << others;
    if (!even) {
      EXPECT_GT(others, 4u) << "beside it, too";
    }
    EXPECT_GT(of_second, 1000u) << "control";
  }
}

// What is shown at a corner is the mean of what the patches that meet there go on to, at whatever level they end.
TEST(KeptTails, CornersAreTheMeanOfWhatPatchesGoOnTo) {
  const BaseMesh mesh = cubeSphere(2, 50, kSeed);
  const auto patches = static_cast<uint32_t>(mesh.patches.size());
  const auto value = [](uint32_t, int c, double u, double v) {
    return 120 + 20 * std::sin(1.6 * u) * std::cos(1.6 * v) + 10 * c;
  };
  const KeptTails kept(tailsOf(patches, value), kOfNormals);
  const TailBlocks blocks(kept, mesh);
  std::vector<double> sum(mesh.corners.size(), 0), count(mesh.corners.size(), 0);
  std::array<int, kTailLevels> levels{};
  double furthest = 0, control = 0;
  for (const bool compares : {false, true})
    for (uint32_t p = 0; p < patches; ++p)
      for (size_t k = 0; k < 4; ++k) {
        const KeptTails::Plane of = kept.plane(p, 0);
        const int side = PatchTails::side(of.finest), x = k % 2 ? side - 1 : 0, y = k / 2 ? side - 1 : 0,
                  in_x = k % 2 ? x - 1 : 1, in_y = k / 2 ? y - 1 : 1;
        auto at = [&](int i, int j) { return static_cast<double>(of.at(of.finest, 0, i, j)); };
        const double goes_on_to =
            (9 * at(x, y) - 3 * at(in_x, y) - 3 * at(x, in_y) + at(in_x, in_y)) / 4;  // half a texel beyond, both ways
        const uint32_t corner = mesh.patches[p][k];
        if (!compares) {
          sum[corner] += goes_on_to, ++count[corner];
          continue;
        }
        ++levels[static_cast<size_t>(of.finest)];
        const double shown =
            shownAt(blocks, p, of.finest, 0, 0, static_cast<double>(k % 2), static_cast<double>(k / 2));
        furthest = std::max(furthest, std::abs(shown - sum[corner] / count[corner]));
        control = std::max(control, std::abs(goes_on_to - sum[corner] / count[corner]));
      }
  EXPECT_GT(levels[1] + levels[2], 0) << "neither the finest nor the coarsest";
  EXPECT_LE(furthest, 2) << "of whole numbers";
  EXPECT_GT(control, 5) << "what one patch goes on to";
}

TEST(KeptTails, WhatWasNotReadIsZero) {
  const KeptTails none(300, 6);
  EXPECT_TRUE(none.whole(0, 300) == PatchTails(300, 6));
  EXPECT_TRUE(none.heightsAreEven());
}

TEST(KeptTails, NoiseIsKeptAsItIs) {
  std::mt19937 random(kSeed);
  PatchTails whole(300, 6);  // more than a chunk
  for (uint8_t& t : whole.texels) t = static_cast<uint8_t>(random());
  for (uint16_t& h : whole.heights) h = static_cast<uint16_t>(random());
  const KeptTails kept(whole, kOfNormals);
  EXPECT_FALSE(kept.heightsAreEven());
  EXPECT_TRUE(kept.whole(0, 300) == whole);
  for (size_t i = 0; i < kTailHeights; ++i) ASSERT_EQ(kept.height(299, i), whole.heights[299 * kTailHeights + i]);
}

// A function over space, sampled by patches that meet: slopes differ from patch to patch. Whatever levels are kept,
// what is shown at sides and corners is within little of what all levels show, and the same from both sides.
TEST(KeptTails, PatchesMeetAsWithAllLevels) {
  const BaseMesh mesh = cubeSphere(3, 50, kSeed);
  const auto value = [&](uint32_t p, int c, double u, double v) {
    const glm::dvec3 at = mesh.point(p, u, v) / 50.0;
    return 128 + 100 * (c % 3 == 0 ? at.x : c % 3 == 1 ? at.y : at.z);
  };
  const auto patches = static_cast<uint32_t>(mesh.patches.size());
  const PatchTails whole = tailsOf(patches, value);
  const KeptTails kept(whole, kOfNormals), all(whole, kExact);
  const TailBlocks of_kept(kept, mesh), of_all(all, mesh);
  const auto neighbours = patchNeighbours(mesh);
  double off = 0, apart = 0, as_of_mips = 0;
  int coarse = 0;
  auto placeOn = [](size_t s, double t) {
    return s == kLeft    ? std::pair{0.0, t}
           : s == kRight ? std::pair{1.0, t}
           : s == kTop   ? std::pair{t, 0.0}
                         : std::pair{t, 1.0};
  };
  for (uint32_t p = 0; p < patches; ++p)
    for (int plane = 0; plane < 2; ++plane) {
      const int finest = kept.plane(p, plane).finest;
      coarse += finest > 0;
      for (size_t s = 0; s < 4; ++s)
        for (const double t : {0.0, 0.3, 0.5, 0.9, 1.0}) {
          const auto [u, v] = placeOn(s, t);
          const double shown = shownAt(of_kept, p, finest, plane, 0, u, v);
          off = std::max(off, std::abs(shown - shownAt(of_all, p, 0, plane, 0, u, v)));
          const PatchNeighbour& n = neighbours[p][s];
          const auto [nu, nv] = placeOn(static_cast<size_t>(n.side), n.reversed ? 1 - t : t);
          apart = std::max(
              apart, std::abs(shown - shownAt(of_kept, n.patch, kept.plane(n.patch, plane).finest, plane, 0, nu, nv)));
          // The control: the border that mips have.
          if (finest > 1)
            as_of_mips = std::max(as_of_mips, std::abs(shownAt(of_all, p, finest, plane, 0, u, v) -
                                                       shownAt(of_all, p, 0, plane, 0, u, v)));
        }
    }
  EXPECT_GT(coarse, 50);
  EXPECT_LE(off, 2);
  EXPECT_LE(apart, 1);
  EXPECT_GT(as_of_mips, 4);
  std::printf("[ tails    ] off by at most %.2f, apart %.2f; with mips' borders off by %.2f\n", off, apart, as_of_mips);
}

TEST(KeptTails, OfOnePlaneTheLevelsAreThoseItIsMadeOf) {
  std::mt19937 random(kSeed);
  PatchTails whole = tailsOf(2, [](uint32_t, int, double u, double) { return 100 + 20 * u; });
  for (int c = 3; c < 6; ++c)
    for (int i = 0; i < 256; ++i) whole.level(1, 0, c)[i] = static_cast<uint8_t>(random());
  const KeptTails kept(whole, kOfNormals);
  const TextureFormat format{.basis = Basis::kAlbedoNormal};
  const KeptTails lit = resolvedTails(kept, format, {0.3, -0.2, 0.9});
  EXPECT_EQ(lit.plane(0, 0).finest, kTailLevels - 1);
  EXPECT_EQ(lit.plane(1, 0).finest, 0);
  const PatchTails of_whole = resolvedTails(kept.whole(0, 2), format, {0.3, -0.2, 0.9});
  for (int i = 0; i < 256; ++i) ASSERT_EQ(lit.plane(1, 0).level(0, 1)[i], of_whole.level(1, 0, 1)[i]);
  EXPECT_EQ(planeOfTails(kept, 1).plane(1, 0).finest, 0);
  EXPECT_EQ(planeOfTails(kept, 0).plane(1, 0).finest, kTailLevels - 1);
  EXPECT_EQ(resolvedTails(kept, TextureFormat{}, {0, 0, 1}).plane(1, 0).finest, kTailLevels - 1) << "the colour alone";
}

}  // namespace kept_tails_test
}  // namespace relievo
