// Which texture levels of a patch are left out of a package, and what is shown in their place.
#include "texturing/package/texture_depths.h"

#include <gtest/gtest.h>
#include <xxhash.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <set>

#include "patch_fixture.h"
#include "tests/view_share.h"
#include "texturing/codec/page_codec.h"
#include "texturing/codec/tail_code.h"
#include "texturing/package/crease_gutter.h"
#include "texturing/package/package.h"
#include "texturing/package/package_base.h"
#include "texturing/package/package_layout.h"
#include "texturing/package/patch_package_builder.h"
#include "texturing/package/patch_tails.h"
#include "texturing/package/texture_pages.h"
#include "texturing/stream/feedback.h"

namespace relievo {
namespace texture_depths_test {

using namespace testing_support;

constexpr uint64_t kSeed = 23;
constexpr double kTolerance = kTextureTolerance;

// ---- the comparison of two levels ----
struct Level {
  size_t side, border;
  std::vector<uint8_t> texels;
  size_t stride() const { return side + 2 * border; }
  uint8_t& at(size_t channel, int64_t x, int64_t y) {
    const auto b = static_cast<int64_t>(border);
    return texels[(channel * stride() + static_cast<size_t>(y + b)) * stride() + static_cast<size_t>(x + b)];
  }
  BorderedLevel view() const { return {texels, side, border}; }
};
constexpr int kChannels = 2;

Level noise(size_t side, size_t border, uint64_t seed) {
  Level level{side, border, {}};
  for (size_t i = 0; i < kChannels * level.stride() * level.stride(); ++i)
    level.texels.push_back(static_cast<uint8_t>(mixBits(seed + i)));
  return level;
}
// In real numbers, by coordinates of the patch.
double shownAt(Level& coarse, size_t channel, double u, double v) {
  const double x = u * static_cast<double>(coarse.side) - 0.5, y = v * static_cast<double>(coarse.side) - 0.5;
  const auto i = static_cast<int64_t>(std::floor(x)), j = static_cast<int64_t>(std::floor(y));
  const double f = x - static_cast<double>(i), g = y - static_cast<double>(j);
  return (coarse.at(channel, i, j) * (1 - f) + coarse.at(channel, i + 1, j) * f) * (1 - g) +
         (coarse.at(channel, i, j + 1) * (1 - f) + coarse.at(channel, i + 1, j + 1) * f) * g;
}
// `fine` made of what `coarse` shows.
Level shownBy(Level& coarse, size_t side, size_t border) {
  Level fine = noise(side, border, 1);
  const auto n = static_cast<int64_t>(side);
  for (size_t c = 0; c < kChannels; ++c)
    for (int64_t y = -1; y <= n; ++y)
      for (int64_t x = -1; x <= n; ++x)
        fine.at(c, x, y) =
            static_cast<uint8_t>(std::lround(shownAt(coarse, c, (static_cast<double>(x) + 0.5) / static_cast<double>(n),
                                                     (static_cast<double>(y) + 0.5) / static_cast<double>(n))));
  return fine;
}

bool same(const Level& fine, const Level& coarse, double tolerance) {
  return showsTheSame(fine.view(), coarse.view(),
                      std::array<ChannelTolerance, 2>{{{tolerance, tolerance}, {tolerance, tolerance}}});
}

TEST(TextureDepths, ALevelShowsWhatItsBilinearFilterGives) {
  for (auto [coarse_side, coarse_border, fine_side] :
       {std::array<size_t, 3>{16, 4, 128}, {16, 1, 256}, {128, 4, 128}, {128, 4, 256}, {128, 4, 512}}) {
    Level coarse = noise(coarse_side, coarse_border, kSeed);
    Level fine = shownBy(coarse, fine_side, 4);  // rounded to bytes
    EXPECT_TRUE(same(fine, coarse, 0.5)) << coarse_side << " " << fine_side;
    EXPECT_EQ(same(fine, coarse, 0), coarse_side == fine_side);
    // One texel off is noticed wherever it lies, next to the patch included; further out it is not looked at.
    const auto last = static_cast<int64_t>(fine_side);
    for (size_t channel = 0; channel < kChannels; ++channel)
      for (auto [x, y] : {std::array<int64_t, 2>{0, 0}, {last - 1, 3}, {-1, 5}, {7, last}, {-1, -1}, {last, last}}) {
        Level wrong = fine;
        uint8_t& texel = wrong.at(channel, x, y);
        texel = static_cast<uint8_t>(texel < 128 ? texel + 3 : texel - 3);
        EXPECT_FALSE(same(wrong, coarse, 2)) << x << " " << y;
        EXPECT_TRUE(same(wrong, coarse, 3.5)) << x << " " << y;
        // By its own channel's tolerance.
        std::array<ChannelTolerance, 2> tolerances{{{2, 2}, {2, 2}}};
        tolerances[channel] = {3.5, 3.5};
        EXPECT_TRUE(showsTheSame(wrong.view(), coarse.view(), tolerances));
        std::reverse(tolerances.begin(), tolerances.end());
        EXPECT_FALSE(showsTheSame(wrong.view(), coarse.view(), tolerances));
      }
    for (auto [x, y] : {std::array<int64_t, 2>{-2, 5}, {last + 1, last + 1}}) {
      Level beyond = fine;
      beyond.at(0, x, y) ^= 0x80;
      EXPECT_TRUE(same(beyond, coarse, 0.5));
    }
  }
}

TEST(TextureDepths, LevelsThatAreTheSameEverywhereAreCompared) {
  auto even = [](size_t side, uint8_t first, uint8_t second) {
    Level level{side, 4, {}};
    level.texels.assign(kChannels * level.stride() * level.stride(), first);
    std::fill(level.texels.begin() + static_cast<ptrdiff_t>(level.texels.size() / kChannels), level.texels.end(),
              second);
    return level;
  };
  const Level coarse = even(16, 90, 200);
  EXPECT_TRUE(same(even(128, 90, 200), coarse, 0));
  for (const Level& other : {even(128, 93, 200), even(128, 90, 197)}) {
    EXPECT_FALSE(same(other, coarse, 2));
    EXPECT_TRUE(same(other, coarse, 3));
  }
  EXPECT_TRUE(isEven(std::array<uint8_t, 3>{7, 7, 7}));
  EXPECT_TRUE(isEven(std::array<uint8_t, 1>{7}));
  for (size_t i = 0; i < 3; ++i) {
    std::array<uint8_t, 3> texels{7, 7, 7};
    texels[i] = 8;
    EXPECT_FALSE(isEven(texels)) << i;
  }
}

// What is off everywhere counts more than what is off along a line.
TEST(TextureDepths, TheRootMeanSquareCountsAsWell) {
  Level coarse = noise(16, 1, kSeed);
  for (uint8_t& texel : coarse.texels) texel = static_cast<uint8_t>(64 + texel / 2);
  const Level fine = shownBy(coarse, 128, 4);
  Level line = fine, everywhere = fine;
  for (int64_t y = 0; y < 128; ++y) {
    line.at(1, 60, y) = static_cast<uint8_t>(line.at(1, 60, y) + 7);
    for (int64_t x = 0; x < 128; ++x)
      everywhere.at(1, x, y) = static_cast<uint8_t>(everywhere.at(1, x, y) + ((x ^ y) & 1 ? 2 : -2));
  }
  const std::array<ChannelTolerance, 2> tolerances{{{2, 1}, {8, 1}}};
  EXPECT_TRUE(showsTheSame(line.view(), coarse.view(), tolerances));
  EXPECT_FALSE(showsTheSame(everywhere.view(), coarse.view(), tolerances));
  EXPECT_TRUE(same(everywhere, coarse, 3)) << "the control: by the furthest alone it would be left out";
}

TEST(TextureDepths, NormalsMayBeFurtherOffInSinglePlaces) {
  TextureFormat format;
  format.basis = Basis::kAlbedoNormal;
  const auto tolerances = channelTolerances(format, 2);
  ASSERT_EQ(tolerances.size(), 6u);
  for (size_t channel = 0; channel < tolerances.size(); ++channel) {
    EXPECT_EQ(tolerances[channel].most, channel < 3 ? 2 : 8) << channel;
    EXPECT_EQ(tolerances[channel].rms, 1) << channel;
  }
}

// ---- packages ----
using MostlySmooth = MostlySmoothPatches;
constexpr uint32_t kWeak = MostlySmooth::kWeak, kStrong = MostlySmooth::kStrong, kBent = MostlySmooth::kBent,
                   kWaves = MostlySmooth::kWaves;

BuildOptions optionsOf(const std::string& path, double tolerance) {
  BuildOptions o;
  o.output = path;
  o.workers = 2;
  o.texture_tolerance = tolerance;
  o.tool_version = "test";
  return o;
}
std::shared_ptr<Package> built(const std::string& path, const PatchSource& source, double tolerance) {
  auto done = buildPatchPackage(source, optionsOf(path, tolerance));
  EXPECT_TRUE(done.ok()) << done.error().text();
  auto package = Package::open(path);
  EXPECT_TRUE(package.ok()) << package.error().text();
  EXPECT_TRUE((*package)->warnings().empty());
  EXPECT_EQ(done->pages, (*package)->manifest().page_count);
  return *package;
}

std::set<uint32_t> around(const BaseMesh& base, uint32_t patch) {
  std::set<uint32_t> out;
  for (uint32_t p = 0; p < base.patches.size(); ++p)
    for (uint32_t corner : base.patches[p])
      for (uint32_t own : base.patches[patch])
        if (corner == own) out.insert(p);
  return out;
}

// How far the texels that a package leaves out lie from what it shows in their place: from pages of `whole`, which
// leaves none out, in real numbers; by plane.
std::array<double, 2> furthestOff(const Package& package, const Package& whole) {
  const Manifest& m = package.manifest();
  const KeptTails tails(package.wholeTails(1, nullptr), {.of_255 = 0});
  const TailBlocks blocks(tails, *m.base, {.colours = m.tail_edges, .normals = hasNormals(m.texture)});
  PageDecoder decoder;
  std::vector<uint8_t> fine(kSlotBytes), coarse(kSlotBytes);
  std::vector<uint32_t> words(tailBlockTexels(0));
  std::array<double, 2> furthest{};
  for (int level = 0; level <= m.domain.texture_depth; ++level)
    forEachNode(m.domain, level, [&](const NodeId& node) {
      if (node.level != static_cast<uint32_t>(level) || m.domain.hasTexturePage(node)) return;
      const auto shown = m.domain.texturedNode(node);
      for (int plane = 0; plane < m.texture.planes(); ++plane) {
        auto page = whole.read(PageId(texturePlane(plane), node));
        ASSERT_TRUE(page.ok());
        ASSERT_TRUE(decoder.decodeToSlot(texturePlane(plane), page->bytes, fine).ok());
        double ratio = std::ldexp(8.0, level), x0 = node.x * 128.0, y0 = node.y * 128.0;
        size_t stride = tailBlockSide(0), border = 1;
        if (shown) {
          auto above = package.read(PageId(texturePlane(plane), *shown));
          ASSERT_TRUE(above.ok());
          ASSERT_TRUE(decoder.decodeToSlot(texturePlane(plane), above->bytes, coarse).ok());
          ratio = std::ldexp(1.0, level - static_cast<int>(shown->level));
          x0 -= shown->x * 128.0 * ratio, y0 -= shown->y * 128.0 * ratio;
          stride = kPageFullPx, border = kPageBorderPx;
        } else {
          blocks.write(node.patch, 0, plane, words.data());
        }
        auto texel = [&](int64_t x, int64_t y, int c) -> double {
          const size_t at = static_cast<size_t>(y) * stride + static_cast<size_t>(x);
          if (shown) return coarse[4 * at + static_cast<size_t>(c)];
          return words[at] >> (8 * c) & 255;
        };
        for (int j = -1; j <= kPagePx; ++j)
          for (int i = -1; i <= kPagePx; ++i)
            for (int c = 0; c < 3; ++c) {
              const double x = (x0 + i + 0.5) / ratio - 0.5 + static_cast<double>(border),
                           y = (y0 + j + 0.5) / ratio - 0.5 + static_cast<double>(border);
              const double fx = x - std::floor(x), fy = y - std::floor(y);
              const auto xi = static_cast<int64_t>(std::floor(x)), yi = static_cast<int64_t>(std::floor(y));
              const double value = (texel(xi, yi, c) * (1 - fx) + texel(xi + 1, yi, c) * fx) * (1 - fy) +
                                   (texel(xi, yi + 1, c) * (1 - fx) + texel(xi + 1, yi + 1, c) * fx) * fy;
              const uint8_t own = fine[4 * static_cast<size_t>((j + kPageBorderPx) * kPageFullPx + i + kPageBorderPx) +
                                       static_cast<size_t>(c)];
              double& of_plane = furthest[static_cast<size_t>(plane)];
              of_plane = std::max(of_plane, std::abs(own - value));
            }
      }
    });
  return furthest;
}

// Are a page's texels within so many times what its channels may be off, gutters included?
bool showsThePage(std::span<const uint8_t> slot, std::span<const uint8_t> exact, int plane, double times = 1) {
  for (size_t c = 0; c < 3; ++c) {
    // Albedo, then the normal: as kTextureTolerance, kNormalTolerance and kRmsTolerance say.
    const double most = times * kTolerance * (plane == 1 ? kNormalTolerance : 1),
                 rms = times * kTolerance * kRmsTolerance;
    double furthest = 0, squares = 0;
    for (size_t i = c; i < slot.size(); i += 4) {
      const double off = std::abs(static_cast<double>(slot[i]) - exact[i]);
      furthest = std::max(furthest, off);
      squares += off * off;
    }
    if (furthest > most || std::sqrt(squares / (kPageFullPx * kPageFullPx)) > rms) return false;
  }
  return true;
}

TEST(TextureDepths, PackagesLeaveOutWhatShowsAnywayAndNothingElse) {
  ScratchFolder folder;
  const MostlySmooth source(kSeed);
  const auto whole = built(folder.file("whole.relievo"), source, -1),
             package = built(folder.file("a.relievo"), source, kTolerance);
  EXPECT_EQ(packageVersion(whole->header()), 12u);
  EXPECT_EQ(packageVersion(package->header()), 12u);
  EXPECT_FALSE(whole->header().texture_depths);
  const PatchDomain& d = package->manifest().domain;
  ASSERT_TRUE(d.textureDepths());
  std::set<uint32_t> rough;
  for (uint32_t patch : {kWeak, kStrong, kBent, kWaves}) {
    auto beside = around(source.base(), patch);
    rough.insert(beside.begin(), beside.end());
  }
  EXPECT_EQ(d.textureDepthOf(kWeak), 1);
  EXPECT_EQ(d.textureDepthOf(kStrong), 1);
  EXPECT_EQ(d.textureDepthOf(kBent), 1);
  EXPECT_EQ(d.textureDepthOf(kWaves), 0);
  uint32_t bare = 0;
  for (uint32_t p = 0; p < d.patchCount(); ++p) {
    bare += d.textureDepthOf(p) == kNoTexturePage;
    if (!rough.contains(p)) {
      EXPECT_EQ(d.textureDepthOf(p), kNoTexturePage) << p;
    }
  }
  EXPECT_GE(bare, 12u);
  EXPECT_TRUE(d.hasUntexturedPatch());
  EXPECT_EQ(nlohmann::json::parse(package->manifestJson())["version"], 12);
  EXPECT_EQ(d.texturedNodeCount(0), d.patchCount() - bare);

  if (!test::kSanitized) {
    const auto off = furthestOff(*package, *whole);
    EXPECT_LE(off[0], kTolerance);
    EXPECT_LE(off[1], kTolerance * kNormalTolerance);
    // Negative control: a builder that drops pages which matter is found out.
    const auto careless = built(folder.file("careless.relievo"), source, 20);
    EXPECT_EQ(careless->manifest().domain.textureDepthOf(kWeak), kNoTexturePage);
    EXPECT_GT(furthestOff(*careless, *whole)[0], 2 * kTolerance);
    EXPECT_GT(furthestOff(*careless, *whole)[1], 2 * kTolerance * kNormalTolerance);
  }

  // The pages that there are show the same, those that stand for finer ones bit for bit, and the others are not there.
  PageDecoder decoder;
  std::vector<uint8_t> slot(kSlotBytes), exact(kSlotBytes);
  int coarse = 0, hardly = 0;
  forEachNode(d, d.texture_depth, [&](const NodeId& node) {
    for (int plane = 0; plane < 2; ++plane) {
      const PageId id(texturePlane(plane), node);
      auto page = package->read(id);
      ASSERT_EQ(page.ok(), d.hasTexturePage(node));
      if (page.ok()) {
        auto full = whole->read(id);
        const int depth = d.textureDepthOf(node.patch);
        if (depth < d.texture_depth && static_cast<int>(node.level) == depth) {
          EXPECT_TRUE(page->bytes == full->bytes);
          continue;
        }
        EXPECT_LE(page->bytes.size(), full->bytes.size());
        ASSERT_TRUE(decoder.decodeToSlot(id.plane(), page->bytes, slot).ok());
        ASSERT_TRUE(decoder.decodeToSlot(id.plane(), full->bytes, exact).ok());
        EXPECT_TRUE(showsThePage(slot, exact, plane));
        coarse += page->bytes.size() < full->bytes.size();
        hardly += !showsThePage(slot, exact, plane, 0.25);
      } else {
        EXPECT_FALSE(page.error().offset) << "no such page is no damage";
      }
    }
    const PageId relief(Plane::kRelief, {node.patch, 0, 0, 0});
    EXPECT_EQ(package->read(relief)->bytes, whole->read(relief)->bytes);
  });
  EXPECT_GT(coarse, 10);
  EXPECT_GT(hardly, 0) << "control: a quarter of the tolerance would not be kept";
  const PatchTails tails = package->wholeTails(2, nullptr), exact_tails = whole->wholeTails(2, nullptr);
  EXPECT_TRUE(tails.heights == exact_tails.heights);
  int changed = 0;
  for (size_t i = 0; i < tails.texels.size(); ++i) {
    const int off = std::abs(tails.texels[i] - exact_tails.texels[i]);
    EXPECT_LE(off, 3);
    changed += off;
  }
  for (uint32_t p = 0; p < tails.patches; ++p)
    for (int c = 0; c < tails.channels; ++c) {
      double squares = 0;
      for (int i = 0; i < 256; ++i) squares += std::pow(tails.level(p, 0, c)[i] - exact_tails.level(p, 0, c)[i], 2);
      EXPECT_LE(std::sqrt(squares / 256), kTolerance * kRmsTolerance) << p;
    }
  EXPECT_GT(changed, 100);
  auto usage = planeUsage(*package, texturePlane(1));
  ASSERT_TRUE(usage.ok());
  EXPECT_EQ(usage->pages, d.texturedNodeCount(0) + d.texturedNodeCount(1));
  EXPECT_EQ(usage->unknown_pages, 0u);
  auto verified = verifyPackage(*package, {});
  ASSERT_TRUE(verified.ok());
  EXPECT_EQ(verified->pages, package->manifest().page_count);
  EXPECT_TRUE(verified->damaged.empty() && verified->other.empty());
  EXPECT_LT(package->fileBytes(), whole->fileBytes());
}

TEST(TextureDepths, TheSameBytesForAnyWorkersAndMemoryAndAsWithoutWhereNothingIsLeftOut) {
  if (test::kSanitized) GTEST_SKIP() << "about figures; others build packages under the sanitizer";
  ScratchFolder folder;
  const MostlySmooth source(kSeed, 0);
  std::vector<std::vector<uint8_t>> all;
  for (auto [workers, mib] : {std::pair{1, 256}, {3, 256}, {2, 1}}) {
    BuildOptions o = optionsOf(folder.file("a.relievo"), kTolerance);
    o.workers = workers;
    o.memory_budget_bytes = static_cast<uint64_t>(mib) << 20;
    if (mib == 1) o.kept_bytes = 0;  // all that waits does so in files, the index as well
    ASSERT_TRUE(buildPatchPackage(source, o).ok());
    all.push_back(readAll(o.output));
  }
  EXPECT_TRUE(all[0] == all[1]);
  EXPECT_TRUE(all[0] == all[2]);
  const NoisyPatches noise(cubeSphere(1, 100, kSeed), 1, 0, kSeed);
  std::array<std::vector<uint8_t>, 3> of_noise;
  for (size_t k = 0; k < 3; ++k) {
    BuildOptions o = optionsOf(folder.file("b.relievo"), k == 0 ? -1 : kTolerance);
    o.coded_texels = o.rounded_tails = k == 2;
    ASSERT_TRUE(buildPatchPackage(noise, o).ok());
    of_noise[k] = readAll(o.output);
  }
  EXPECT_TRUE(of_noise[0] == of_noise[1]);
  EXPECT_LT(of_noise[2].size(), of_noise[1].size()) << "texels within the tolerance take fewer bytes";
  // Of older kinds of packages nothing is left out.
  BuildOptions older = optionsOf(folder.file("d.relievo"), kTolerance);
  older.compact = false;
  ASSERT_TRUE(buildPatchPackage(source, older).ok());
  EXPECT_FALSE((*Package::open(older.output))->manifest().domain.textureDepths());
}

// Smooth patches with single texels at their sides that are off by a step more than the others. Of this seed patches
// show them beyond the tolerance only once the tail beside them is no longer rounded.
class SpeckledPatches final : public NoisyPatches {
 public:
  static constexpr uint64_t kOfTwoRounds = 139;
  SpeckledPatches() : NoisyPatches(cubeSphere(3, 100, kOfTwoRounds), 0, 0, kOfTwoRounds) {}
  uint16_t height(uint32_t /*patch*/, int /*x*/, int /*y*/) const override { return 27'306; }  // about 0 mm
  Result<void> texels(uint32_t patch, std::span<uint8_t> out) const override {
    constexpr size_t kSide = kPagePx, kLast = kSide - 1;
    for (size_t i = 0; i < out.size(); ++i) {
      const size_t x = i % kSide, y = i / kSide % kSide, c = i / (kSide * kSide);
      const glm::dvec3 at =
          base().point(patch, (static_cast<double>(x) + 0.5) / kSide, (static_cast<double>(y) + 0.5) / kSide);
      const uint64_t random = mixBits(kOfTwoRounds * 7 + i * 77 + patch * 131'071);
      const bool speck = c < 3 && (x == 0 || y == 0 || x == kLast || y == kLast) && random % 700 == 0;
      const int off = !speck ? 0 : (random >> 20) % 2 ? 1 : -1;
      out[i] = static_cast<uint8_t>(std::lround(128 + 0.4 * at[static_cast<int>(c % 3)]) + off);
    }
    return {};
  }
};
TEST(TextureDepths, TailsThatAreNotRoundedAreSeenFromTheirNeighbours) {
  ScratchFolder folder;
  const SpeckledPatches source;
  const auto whole = built(folder.file("whole.relievo"), source, -1),
             package = built(folder.file("a.relievo"), source, kTolerance);
  EXPECT_LE(furthestOff(*package, *whole)[0], kTolerance);
  EXPECT_TRUE(package->manifest().domain.hasUntexturedPatch());
  EXPECT_FALSE(package->wholeTails(1, nullptr) == whole->wholeTails(1, nullptr)) << "control: some are rounded";
}

// A ball whose colours are waves of some 50 root texels; every third patch has a pattern of 2 finest texels besides,
// which ends before its sides. of_their_own: what has no pattern, and what has no texels of that size, is told in fewer
// texels.
class PatternedPatches final : public NoisyPatches {
 public:
  static constexpr int kDepth = 2;
  explicit PatternedPatches(bool of_their_own)
      : NoisyPatches(cubeSphere(2, 100, kSeed), kDepth, 0, kSeed), of_their_own_(of_their_own) {}
  static int depthOf(uint32_t patch) { return std::array{kDepth, 0, 1}[patch % 3]; }
  int textureDepthOf(uint32_t patch) const override { return of_their_own_ ? depthOf(patch) : kDepth; }
  uint16_t height(uint32_t /*patch*/, int /*x*/, int /*y*/) const override { return 27'306; }  // about 0 mm
  Result<void> texels(uint32_t patch, std::span<uint8_t> out) const override {
    const size_t side = size_t{kPagePx} << textureDepthOf(patch), margin = side / 8;
    for (size_t i = 0; i < out.size(); ++i) {
      const size_t x = i % side, y = i / side % side, c = i / (side * side);
      const auto centre = [&](size_t k) { return (static_cast<double>(k) + 0.5) / static_cast<double>(side); };
      const glm::dvec3 at = base().point(patch, centre(x), centre(y));
      const bool inside = std::min(x, y) >= margin && std::max(x, y) < side - margin;
      const int pattern = depthOf(patch) == kDepth && inside && c < 3 ? ((x ^ y) & 2 ? 30 : -30) : 0;
      out[i] = static_cast<uint8_t>(std::lround(128 + 60 * std::sin(0.2 * at[static_cast<int>(c % 3)])) + pattern);
    }
    return {};
  }

 private:
  bool of_their_own_;
};
TEST(TextureDepths, PatchesHaveAsManyLevelsAsTheirTexelsAreTold) {
  ScratchFolder folder;
  const PatternedPatches source(true);
  const auto whole = built(folder.file("whole.relievo"), PatternedPatches(false), -1),
             package = built(folder.file("a.relievo"), source, kTolerance),
             all_levels = built(folder.file("all.relievo"), source, -1);
  const PatchDomain& d = package->manifest().domain;
  for (uint32_t p = 0; p < d.patchCount(); ++p) {
    if (p % 3 == 0) EXPECT_EQ(d.textureDepthOf(p), 2) << p;
    else EXPECT_LE(d.textureDepthOf(p), PatternedPatches::depthOf(p)) << p;
  }
  // A step more where the squares beyond corners have texels of several sizes around them.
  const auto off = furthestOff(*package, *whole);
  EXPECT_LE(off[0], kTolerance + 1);
  EXPECT_LE(off[1], kTolerance * kNormalTolerance);
  // Gutters hold what lies beside, whatever texels that is told in. Without a tolerance there are all levels,
  // interpolated where they were not told, along sides from one of them.
  EXPECT_FALSE(all_levels->header().texture_depths);
  PageDecoder decoder;
  std::vector<uint8_t> slot(kSlotBytes), exact(kSlotBytes);
  int interpolated = 0;
  for (const auto& some : {package, all_levels}) {
    int furthest = 0;
    forEachNode(d, d.texture_depth, [&](const NodeId& node) {
      if (!some->manifest().domain.hasTexturePage(node)) return;
      const PageId id(texturePlane(0), node);
      const auto page = some->read(id), full = whole->read(id);
      ASSERT_TRUE(page.ok() && decoder.decodeToSlot(id.plane(), page->bytes, slot).ok());
      ASSERT_TRUE(full.ok() && decoder.decodeToSlot(id.plane(), full->bytes, exact).ok());
      interpolated += static_cast<int>(node.level) > PatternedPatches::depthOf(node.patch);
      for (size_t i = 0; i < slot.size(); ++i) {
        auto inside = [](size_t at) { return at >= kPageBorderPx && at < kPageBorderPx + kPagePx; };
        if (i % 4 == 3 || (!inside(i / 4 % kPageFullPx) && !inside(i / 4 / kPageFullPx))) continue;
        furthest = std::max(furthest, std::abs(slot[i] - exact[i]));
      }
    });
    EXPECT_LE(furthest, some == package ? 3 : 4);
  }
  EXPECT_GT(interpolated, 20);
}

// A ball of which every third patch is told in a tail's texels alone; the others have a pattern of 2 texels, which ends
// before their sides. noise: the first are of any colour.
class ToldAsTails final : public NoisyPatches {
 public:
  explicit ToldAsTails(bool of_their_own, bool noise)
      : NoisyPatches(cubeSphere(3, 100, kSeed), 0, 0, kSeed), of_their_own_(of_their_own), noise_(noise) {}
  static bool isTail(uint32_t patch) { return patch % 3 == 1; }
  int textureDepthOf(uint32_t patch) const override { return of_their_own_ && isTail(patch) ? kNoTexturePage : 0; }
  uint16_t height(uint32_t /*patch*/, int /*x*/, int /*y*/) const override { return 27'306; }  // about 0 mm
  Result<void> texels(uint32_t patch, std::span<uint8_t> out) const override {
    const size_t side = texelsASide(textureDepthOf(patch));
    EXPECT_EQ(out.size(), 6 * side * side);
    for (size_t i = 0; i < out.size(); ++i) {
      const size_t x = i % side, y = i / side % side, c = i / (side * side);
      const auto centre = [&](size_t k) { return (static_cast<double>(k) + 0.5) / static_cast<double>(side); };
      const glm::dvec3 at = base().point(patch, centre(x), centre(y));
      const size_t margin = side / 8;
      const bool inside = std::min(x, y) >= margin && std::max(x, y) < side - margin;
      const double off = !isTail(patch) ? (inside && c < 3 ? ((x ^ y) & 2 ? 30 : -30) : 0)
                         : noise_       ? static_cast<double>(mixBits(i + 97 * patch) % 81) - 40
                                        : 0;
      out[i] = static_cast<uint8_t>(std::lround(128 + 0.4 * at[static_cast<int>(c % 3)] + off));
    }
    return {};
  }

 private:
  bool of_their_own_, noise_;
};
TEST(TextureDepths, APatchMayBeToldInItsTailsTexelsAlone) {
  ScratchFolder folder;
  const ToldAsTails source(true, true);
  BuildOptions exact = optionsOf(folder.file("a.relievo"), kTolerance);
  exact.rounded_tails = false;
  ASSERT_TRUE(buildPatchPackage(source, exact).ok());
  const auto package = *Package::open(exact.output),
             rounded = built(folder.file("rounded.relievo"), source, kTolerance),
             all_levels = built(folder.file("all.relievo"), source, -1);
  const PatchDomain& d = package->manifest().domain;
  const PatchTails tails = package->wholeTails(1, nullptr), rounded_tails = rounded->wholeTails(1, nullptr);
  std::vector<uint8_t> told(6 * kTailTexels * kTailTexels), slot(kSlotBytes);
  PageDecoder decoder;
  int changed = 0;
  for (uint32_t p = 0; p < d.patchCount(); ++p) {
    if (!ToldAsTails::isTail(p)) continue;
    EXPECT_EQ(d.textureDepthOf(p), kNoTexturePage) << p;
    ASSERT_TRUE(source.texels(p, told));
    for (size_t i = 0; i < told.size(); ++i) {
      const size_t texel = i % (kTailTexels * kTailTexels);
      const int channel = static_cast<int>(i / (kTailTexels * kTailTexels));
      ASSERT_EQ(tails.level(p, 0, channel)[texel], told[i]) << p;
      const int off = std::abs(rounded_tails.level(p, 0, channel)[texel] - told[i]);
      ASSERT_LE(off, channel < 3 ? kTolerance : kTolerance * kNormalTolerance);
      changed += off > 0;
    }
    // The next level is the mean of four.
    const int mean = (told[0] + told[1] + told[kTailTexels] + told[kTailTexels + 1] + 2) / 4;
    EXPECT_NEAR(tails.level(p, 1, 3)[0],
                (told[768] + told[769] + told[768 + kTailTexels] + told[769 + kTailTexels] + 2) / 4, 6);
    EXPECT_NEAR(tails.level(p, 1, 0)[0], mean, 8) << "in linear light";
    // Without a tolerance there is a page, of what a bilinear filter shows.
    const PageId id(texturePlane(0), {p, 0, 0, 0});
    const auto page = all_levels->read(id);
    ASSERT_TRUE(page.ok() && decoder.decodeToSlot(id.plane(), page->bytes, slot).ok());
    for (const size_t y : {size_t{0}, size_t{3}, size_t{64}, size_t{101}})
      for (size_t x = 0; x < kPagePx; ++x) {
        const auto place = [](size_t k) {
          return std::clamp((static_cast<double>(k) + 0.5) / 8 - 0.5, 0.0, kTailTexels - 1.0);
        };
        const double u = place(x), v = place(y);
        const size_t x0 = std::min<size_t>(static_cast<size_t>(u), kTailTexels - 2),
                     y0 = std::min<size_t>(static_cast<size_t>(v), kTailTexels - 2);
        const double fx = u - static_cast<double>(x0), fy = v - static_cast<double>(y0);
        const auto at = [&](size_t i, size_t j) { return static_cast<double>(told[(y0 + j) * kTailTexels + x0 + i]); };
        const double shown =
            (at(0, 0) * (1 - fx) + at(1, 0) * fx) * (1 - fy) + (at(0, 1) * (1 - fx) + at(1, 1) * fx) * fy;
        const size_t texel = (y + kPageBorderPx) * kPageFullPx + x + kPageBorderPx;
        ASSERT_NEAR(slot[4 * texel], shown, 0.51) << p << " " << x << " " << y;
      }
  }
  EXPECT_GT(changed, 100) << "control: tails are rounded";
  // Beside them pages hold what they show: of a smooth ball, what it is when all patches are told in a page's texels.
  const auto whole = built(folder.file("whole.relievo"), ToldAsTails(false, false), -1);
  std::vector<uint8_t> as_told(kSlotBytes);
  for (const double tolerance : {-1.0, kTolerance}) {
    const auto smooth = built(folder.file("smooth.relievo"), ToldAsTails(true, false), tolerance);
    int furthest = 0, pages = 0;
    for (uint32_t p = 0; p < d.patchCount(); ++p) {
      if (smooth->manifest().domain.textureDepthOf(p) == kNoTexturePage) continue;
      ++pages;
      const PageId id(texturePlane(0), {p, 0, 0, 0});
      const auto page = smooth->read(id), full = whole->read(id);
      ASSERT_TRUE(page.ok() && decoder.decodeToSlot(id.plane(), page->bytes, as_told).ok());
      ASSERT_TRUE(full.ok() && decoder.decodeToSlot(id.plane(), full->bytes, slot).ok());
      for (size_t i = 0; i < slot.size(); ++i) {
        const auto inside = [](size_t at) { return at >= kPageBorderPx && at < kPageBorderPx + kPagePx; };
        if (i % 4 == 3 || (!inside(i / 4 % kPageFullPx) && !inside(i / 4 / kPageFullPx))) continue;
        furthest = std::max(furthest, std::abs(slot[i] - as_told[i]));
      }
    }
    EXPECT_LE(furthest, 3) << tolerance;
    EXPECT_EQ(pages, tolerance < 0 ? 54 : 36);
  }
}

// Older readers know tails as differences: packages for them hold the same, in more bytes.
TEST(TextureDepths, VersionsFourAndFiveHoldTheSameTails) {
  ScratchFolder folder;
  const MostlySmooth source(kSeed, 0);
  for (const double tolerance : {-1.0, kTolerance}) {
    auto without = [&](bool BuildOptions::*coded, const std::string& name) {
      BuildOptions o = optionsOf(folder.file(name), tolerance);
      o.*coded = o.rounded_tails = false;
      o.base_by_border = coded == &BuildOptions::rounded_tails;
      EXPECT_TRUE(buildPatchPackage(source, o).ok());
      return *Package::open(o.output);
    };
    const auto older = without(&BuildOptions::coded_tails, "older.relievo"),
               six = without(&BuildOptions::coded_base, "six.relievo"),
               seven = without(&BuildOptions::coded_texels, "seven.relievo"),
               eight = without(&BuildOptions::coded_index, "eight.relievo"),
               nine = without(&BuildOptions::light_patches, "nine.relievo"),
               ten = without(&BuildOptions::base_by_border, "ten.relievo"),
               now = without(&BuildOptions::rounded_tails, "now.relievo");
    EXPECT_EQ(packageVersion(six->header()), 6u);
    EXPECT_EQ(packageVersion(seven->header()), 7u);
    EXPECT_EQ(packageVersion(eight->header()), 8u);
    EXPECT_EQ(packageVersion(nine->header()), 9u);
    EXPECT_EQ(packageVersion(ten->header()), 10u);
    EXPECT_TRUE(*ten->manifest().base == *now->manifest().base);
    EXPECT_TRUE(ten->manifest().coarse_errors == now->manifest().coarse_errors);
    EXPECT_TRUE(now->wholeTails(1, nullptr) == ten->wholeTails(1, nullptr));
    EXPECT_EQ(six->tailProblems(), now->tailProblems());
    EXPECT_TRUE(six->manifest().coarse_errors == now->manifest().coarse_errors);
    EXPECT_TRUE(six->manifest().coarse_shapes == now->manifest().coarse_shapes);
    EXPECT_TRUE(*six->manifest().base == *now->manifest().base);
    EXPECT_EQ(packageVersion(now->header()), 12u);
    EXPECT_EQ(packageVersion(older->header()), tolerance < 0 ? 4u : 5u);
    EXPECT_EQ(nlohmann::json::parse(older->manifestJson())["version"], tolerance < 0 ? 4 : 5);
    EXPECT_TRUE(now->tailProblems().empty() && older->tailProblems().empty());
    EXPECT_TRUE(now->wholeTails(1, nullptr) == older->wholeTails(1, nullptr));
    EXPECT_TRUE(now->wholeTails(1, nullptr) == nine->wholeTails(1, nullptr));
    EXPECT_LT(nine->fileBytes(), older->fileBytes());
    EXPECT_LT(now->fileBytes(), nine->fileBytes());
    for (const auto& package : {now, older}) {
      const auto tails = package->tailBytes();
      ASSERT_TRUE(tails.ok());
      const PackageHeader& h = package->header();
      EXPECT_EQ(tails->all, h.tails_offset - (h.pages_offset + h.pages_bytes) + h.tails_bytes);
      EXPECT_EQ(tails->heights.has_value(), package == now);
      if (tails->heights) {
        EXPECT_GT(*tails->heights, kTailCodeHeadBytes);
        EXPECT_LT(*tails->heights, tails->all - h.tails_bytes);
      }
    }
    const auto whole = built(folder.file("whole.relievo"), source, -1);
    int hierarchical = 0;
    forEachNode(older->manifest().domain, 1, [&](const NodeId& node) {
      for (int plane = 0; plane < 2 && older->manifest().domain.hasTexturePage(node); ++plane) {
        const PageId id(texturePlane(plane), node);
        EXPECT_TRUE(older->read(id)->bytes == whole->read(id)->bytes) << "older readers know no fewer texels";
        constexpr uint8_t kHierarchical = 12;
        EXPECT_NE(seven->read(id)->bytes[0], kHierarchical) << "nor does version 7 know their code";
        hierarchical += now->read(id)->bytes[0] == kHierarchical;
      }
    });
    EXPECT_EQ(hierarchical > 0, tolerance >= 0);
  }
}

TEST(TextureDepths, PagesForToolsAreWhatIsShown) {
  if (test::kSanitized) GTEST_SKIP() << "about figures; export_cli_test reads such packages under the sanitizer";
  ScratchFolder folder;
  const MostlySmooth source(kSeed);
  const auto whole = built(folder.file("whole.relievo"), source, -1),
             package = built(folder.file("a.relievo"), source, kTolerance);
  const TexturePages pages(package);
  PageDecoder decoder;
  std::vector<uint8_t> slot(kSlotBytes), expected(kSlotBytes);
  int furthest = 0;
  forEachNode(package->manifest().domain, 1, [&](const NodeId& node) {
    for (int plane = 0; plane < 2; ++plane) {
      const PageId id(texturePlane(plane), node);
      ASSERT_TRUE(pages.read(id, decoder, slot).ok());
      ASSERT_TRUE(decoder.decodeToSlot(id.plane(), whole->read(id)->bytes, expected).ok());
      if (package->manifest().domain.hasTexturePage(node)) {
        EXPECT_TRUE(showsThePage(slot, expected, plane));
      }
      for (int y = kPageBorderPx - 1; y <= kPagePx + kPageBorderPx; ++y)
        for (int x = kPageBorderPx - 1; x <= kPagePx + kPageBorderPx; ++x)
          for (int c = 0; c < 4; ++c) {
            const auto at = static_cast<size_t>(4 * (y * kPageFullPx + x) + c);
            furthest = std::max(furthest, std::abs(slot[at] - expected[at]));
          }
    }
  });
  EXPECT_LE(furthest, static_cast<int>(kTolerance * kNormalTolerance + 0.5));
  EXPECT_GT(furthest, 0);
  EXPECT_FALSE(pages.read(PageId(texturePlane(0), {0, 2, 0, 0}), decoder, slot).ok()) << "deeper than any patch";
  EXPECT_FALSE(pages.read(PageId(texturePlane(0), {54, 0, 0, 0}), decoder, slot).ok()) << "no such patch";
}

// One patch of a cube has waves too short for its root page, and none of the others anything.
class FineWaves final : public NoisyPatches {
 public:
  FineWaves() : NoisyPatches(cubeSphere(1, 100, kSeed), 2, 0, kSeed) {}
  uint16_t height(uint32_t /*patch*/, int /*x*/, int /*y*/) const override { return 27'306; }
  Result<void> texels(uint32_t patch, std::span<uint8_t> out) const override {
    const auto side = static_cast<size_t>(texelSide());
    for (size_t i = 0; i < out.size(); ++i) {
      const double x = (static_cast<double>(i % side) + 0.5) / static_cast<double>(side),
                   y = (static_cast<double>(i / side % side) + 0.5) / static_cast<double>(side);
      const double fading = std::sin(3.1416 * x) * std::sin(3.1416 * y);
      out[i] = static_cast<uint8_t>(std::lround(128 + (patch == 0 ? 40 * std::sin(110 * x) * fading * fading : 0)));
    }
    return {};
  }
};

TEST(TextureDepths, WhatToolsReadComesFromTheRightPartOfTheFinestPage) {
  if (test::kSanitized) GTEST_SKIP() << "about figures";
  ScratchFolder folder;
  const FineWaves source;
  const auto whole = built(folder.file("whole.relievo"), source, -1),
             package = built(folder.file("a.relievo"), source, kTolerance);
  ASSERT_EQ(package->manifest().domain.textureDepthOf(0), 1);
  const TexturePages pages(package);
  PageDecoder decoder;
  std::vector<uint8_t> slot(kSlotBytes), expected(kSlotBytes);
  int furthest = 0;
  for (uint32_t k = 0; k < 16; ++k) {
    const PageId id(texturePlane(0), {0, 2, k % 4, k / 4});
    ASSERT_TRUE(pages.read(id, decoder, slot).ok());
    ASSERT_TRUE(decoder.decodeToSlot(id.plane(), whole->read(id)->bytes, expected).ok());
    for (int y = kPageBorderPx; y < kPagePx + kPageBorderPx; ++y)
      for (int x = 4 * kPageBorderPx; x < 4 * (kPagePx + kPageBorderPx); ++x) {
        const auto at = static_cast<size_t>(4 * y * kPageFullPx + x);
        furthest = std::max(furthest, std::abs(slot[at] - expected[at]));
      }
  }
  EXPECT_LE(furthest, 2);
  EXPECT_GT(furthest, 0);
}

// ---- requests ----
TEST(TextureDepths, FeedbackNamesTheFinestNodesThatThereAre) {
  PatchMeasures measures;
  measures.texture_depth = 3;
  PatchDomain domain = PatchDomain::overMesh(3, measures);
  domain.setTextureDepths(std::make_shared<const TextureDepths>(TextureDepths{3, 1, kNoTexturePage}));
  auto pixel = [](uint32_t patch, uint32_t level, uint32_t x, uint32_t y) {
    return std::array<uint32_t, 4>{1u | level << 8, patch, x, y};
  };
  const std::vector<std::array<uint32_t, 4>> pixels{pixel(0, 3, 5, 6), pixel(1, 3, 5, 6), pixel(1, 2, 3, 0),
                                                    pixel(1, 0, 0, 0), pixel(2, 3, 1, 1), pixel(2, 0, 0, 0),
                                                    pixel(3, 0, 0, 0), pixel(0, 1, 0, 1)};
  auto nodesOf = [&](FeedbackAnalyzer analyzer) {
    std::set<NodeId> nodes;
    for (const NodeRequest& r : analyzer.analyze(pixels, static_cast<int>(pixels.size()), 1)) nodes.insert(r.node);
    return nodes;
  };
  EXPECT_EQ(nodesOf(FeedbackAnalyzer(&domain)), (std::set<NodeId>{{0, 3, 5, 6},
                                                                  {0, 2, 2, 3},
                                                                  {0, 1, 1, 1},
                                                                  {0, 1, 0, 1},
                                                                  {0, 0, 0, 0},
                                                                  {1, 1, 1, 1},
                                                                  {1, 1, 1, 0},
                                                                  {1, 0, 0, 0}}));
  // Negative control: who does not know the depths asks for pages that no package has.
  const auto unaware = nodesOf(FeedbackAnalyzer());
  EXPECT_TRUE(unaware.contains({2, 3, 1, 1}) && unaware.contains({1, 3, 5, 6}));
}

// ---- damaged and hostile files ----
class DepthsOfPackage : public ::testing::Test {
 protected:
  void SetUp() override {
    static const std::vector<uint8_t> once = [&] {
      BuildOptions o = optionsOf(path_, kTolerance);
      o.coded_base = false;
      EXPECT_TRUE(buildPatchPackage(MostlySmooth(kSeed), o).ok());
      return readAll(path_);
    }();
    writeAll(path_, once);
    good_ = bytes_ = once;
    header_ = *decodeHeader({bytes_.data(), kHeaderBytes}, path_);
  }
  template <class T>
  void setField(size_t offset, T value) {
    for (uint8_t* head : {bytes_.data(), bytes_.data() + bytes_.size() - kHeaderBytes}) {
      storeLittle(head + offset, value);
      storeLittle(head + kHeaderBytes - 8, static_cast<uint64_t>(XXH3_64bits(head, kHeaderBytes - 8)));
    }
  }
  // What opening says; empty when it opens.
  std::string refusal() {
    writeAll(damaged_, bytes_);
    auto package = Package::open(damaged_);
    bytes_ = good_;
    return package.ok() ? std::string() : package.error().text();
  }
  template <class T>
  std::string withField(size_t offset, T value) {
    setField(offset, value);
    return refusal();
  }
  // Both copies of the base mesh with other depths, in the same number of bytes or, padded behind, in fewer.
  std::string withDepths(const std::function<void(TextureDepths&)>& change) {
    const uint32_t patches = header_.domain.patchCount();
    std::span<const uint8_t> packed{bytes_.data() + header_.base_offset, header_.base_bytes};
    auto section = decodeBaseSection(*unpackBaseSection(packed, patches, BaseSectionEnd::kTextureDepths), patches);
    change(section->texture_depths);
    std::vector<uint8_t> raw = encodeBaseSection(*section), again;
    for (int level : {12, 9, 15, 19, 22}) {
      again = packBaseSection(raw, level);
      if (again.size() <= header_.base_bytes) break;
    }
    if (again.size() > header_.base_bytes) return "it does not fit";
    for (uint64_t at : {header_.base_offset, header_.base_copy_offset})
      std::copy(again.begin(), again.end(), bytes_.begin() + static_cast<std::ptrdiff_t>(at));
    setField(272, static_cast<uint64_t>(again.size()));
    setField(280, static_cast<uint64_t>(XXH3_64bits(again.data(), again.size())));
    return refusal();
  }

  ScratchFolder folder_;
  std::string path_ = folder_.file("a.relievo"), damaged_ = folder_.file("b.relievo");
  std::vector<uint8_t> bytes_, good_;
  PackageHeader header_;
};

// Of the version that has all of them.
TEST(TextureDepths, AnUnknownKindOfAnySectionIsRefused) {
  ScratchFolder folder;
  const BuildOptions o = optionsOf(folder.file("a.relievo"), kTolerance);
  ASSERT_TRUE(buildPatchPackage(MostlySmooth(kSeed, 0), o).ok());
  const std::vector<uint8_t> good = readAll(o.output);
  struct Section {
    size_t field;
    std::string what;
    uint32_t known;
  };
  for (const auto& [field, what, known] : {Section{2048, "storage", 1},
                                           {2052, "storage", 4},
                                           {2064, "tails", 2},
                                           {2068, "texture pages", 1},
                                           {2072, "an index", 2}})
    for (uint32_t kind : {0u, 1u, 2u, 3u, 4u, 5u}) {
      if (field == 2072 && kind == 0) continue;  // known, beside tails of another kind
      std::vector<uint8_t> bytes = good;
      for (uint8_t* head : {bytes.data(), bytes.data() + bytes.size() - kHeaderBytes}) {
        storeLittle(head + field, kind);
        storeLittle(head + kHeaderBytes - 8, static_cast<uint64_t>(XXH3_64bits(head, kHeaderBytes - 8)));
      }
      writeAll(o.output, bytes);
      const auto opened = Package::open(o.output);
      EXPECT_EQ(opened.ok(), kind == known);
      if (opened.ok()) continue;
      EXPECT_EQ(opened.error().kind, ErrorKind::kUnsupported);
      const std::string words = "expected " + what + " of kind " + std::to_string(known) + " in version 12, found ";
      EXPECT_NE(opened.error().text().find(words + std::to_string(kind)), std::string::npos) << opened.error().text();
    }
}

TEST_F(DepthsOfPackage, hostileFieldsAreRefusedByName) {
  auto expect = [&](const std::string& found, const std::string& words) {
    EXPECT_NE(found.find(words), std::string::npos) << found;
  };
  EXPECT_EQ(withField(2060, uint32_t{1}), "") << "control: a field set to what it is";
  expect(withField(2060, uint32_t{2}), "expected patches' texture levels of kind 1 in version 6, found 2");
  EXPECT_NE(withField(2060, uint32_t{0}), "") << "then all pages would be there";
  expect(withField(2064, uint32_t{0}), "expected tails of kind 1 in version 6, found 0");
  expect(withField(2064, uint32_t{2}), "expected tails of kind 1 in version 6, found 2");
  expect(withField(8, uint32_t{20}), "expected package version 1 to 19, found 20");
  EXPECT_NE(withField(8, uint32_t{4}), "") << "version 4 has all pages";
  expect(withField(304, uint64_t{0}), "expected the patches' tails in version 6, found none");
  // Other numbers of pages and of the index's bytes, within what any depths could make and beyond.
  for (int64_t step : {-1, 1}) {
    expect(withField(80, header_.page_count + static_cast<uint64_t>(step)), "texture levels make");
    expect(withField(56, header_.index_bytes + static_cast<uint64_t>(step)), "texture levels make");
  }
  for (uint64_t count : {uint64_t{0}, uint64_t{1} << 40}) {
    expect(withField(80, count), "pages, found");
    EXPECT_NE(withField(56, count), "");
  }
}

TEST_F(DepthsOfPackage, depthsThatDoNotFitAreRefused) {
  auto expect = [&](const std::string& found, const std::string& words) {
    EXPECT_NE(found.find(words), std::string::npos) << found;
  };
  EXPECT_EQ(withDepths([](TextureDepths&) {}), "") << "control: the depths that it has";
  expect(withDepths([](TextureDepths& d) { d[3] = 2; }), "at most 2 texture levels of patch 3, found 3");
  expect(withDepths([](TextureDepths& d) { d[5] = 100; }), "texture levels of patch 5, found 101");
  expect(withDepths([](TextureDepths& d) { d[kStrong] = 0; }), "texture levels make");
  expect(withDepths([](TextureDepths& d) { d.clear(); }), "bytes in a zstd frame");
}

TEST_F(DepthsOfPackage, damagedTailsOfPatchesWithoutPagesAreCounted) {
  auto package = *Package::open(path_);
  std::vector<std::string> problems;
  EXPECT_EQ(package->tails(1, &problems).failures().pages, 0u);
  EXPECT_TRUE(problems.empty());
  // The first chunk lies behind the pages.
  bytes_[header_.pages_offset + header_.pages_bytes + 100] ^= 1;
  writeAll(damaged_, bytes_);
  package = *Package::open(damaged_);
  const PatchDomain& d = package->manifest().domain;
  const PatchTails tails = package->wholeTails(1, &problems);
  const auto bare = d.patchCount() - d.texturedNodeCount(0);
  EXPECT_EQ(tails.failures.pages, 2 * bare) << "a plane of each patch that has nothing else";
  EXPECT_GE(problems.size(), 1 + 2 * bare);
  const TexturePages pages(package);
  PageDecoder decoder;
  std::vector<uint8_t> slot(kSlotBytes);
  for (uint32_t p = 0; p < d.patchCount(); ++p)
    EXPECT_EQ(pages.read(PageId(texturePlane(0), {p, 0, 0, 0}), decoder, slot).ok(), d.textureDepthOf(p) >= 0) << p;
  auto verified = verifyPackage(*package, {});
  ASSERT_TRUE(verified.ok());
  EXPECT_EQ(verified->other.size(), 1u);
}

TEST_F(DepthsOfPackage, everyTruncationOpensOrFailsCleanly) {
  for (size_t keep = 0; keep < bytes_.size(); keep += keep < header_.pages_offset ? 97 : 4099) {
    writeAll(damaged_, {bytes_.data(), keep});
    auto package = Package::open(damaged_);
    if (package.ok()) {
      EXPECT_FALSE((*package)->warnings().empty());
    } else {
      EXPECT_FALSE(package.error().text().empty());
    }
  }
}

}  // namespace texture_depths_test
}  // namespace relievo
