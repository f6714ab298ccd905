// Tails of patches: what they hold, what a package says of them, and what happens to damaged ones. The oracle of texels
// and borders is written from patch_tails.h and PACKAGE.md alone.
#include <gtest/gtest.h>
#include <xxhash.h>
#include <zstd.h>

#include <cstring>
#include <fstream>
#include <functional>
#include <map>
#include <numbers>

#include "patch_fixture.h"
#include "src/artwork/bases/ptm.h"
#include "tests/view_share.h"
#include "texturing/package/kept_tails.h"
#include "texturing/package/package.h"
#include "texturing/package/package_layout.h"
#include "texturing/package/package_tails.h"
#include "texturing/package/patch_package_builder.h"

namespace relievo {
namespace patch_tails_test {

using namespace testing_support;

constexpr uint64_t kSeed = 20261121;

// Cheaper texels, for many patches.
class ManyPatches final : public NoisyPatches {
 public:
  using NoisyPatches::NoisyPatches;
  Result<void> texels(uint32_t patch, std::span<uint8_t> out) const override {
    for (size_t i = 0; i < out.size(); ++i) out[i] = static_cast<uint8_t>(patch * 7 + i / 16 * 13 + (i >> 14) * 50);
    return {};
  }
};

PatchTails noise(uint32_t patches, int channels) {
  PatchTails tails(patches, channels);
  std::mt19937 random(static_cast<uint32_t>(kSeed));
  for (uint16_t& h : tails.heights) h = static_cast<uint16_t>(random());
  for (uint8_t& t : tails.texels) t = static_cast<uint8_t>(random());
  return tails;
}

// A patch's block of a level, both planes' words side by side.
std::vector<uint32_t> twoPlanes(const TailBlocks& blocks, uint32_t patch, int level) {
  std::vector<uint32_t> one(tailBlockTexels(level)), out(2 * one.size());
  for (size_t plane = 0; plane < 2; ++plane) {
    blocks.write(patch, level, static_cast<int>(plane), one.data());
    for (size_t i = 0; i < one.size(); ++i) out[2 * i + plane] = one[i];
  }
  return out;
}

TEST(PatchTails, heightsAreThePagesSamples) {
  std::vector<uint16_t> samples(kReliefPageSamples), tail(kTailHeights);
  for (size_t i = 0; i < samples.size(); ++i) samples[i] = static_cast<uint16_t>(i * 7919);
  tailHeights(samples, tail);
  for (size_t y = 0; y < 17; ++y)
    for (size_t x = 0; x < 17; ++x) ASSERT_EQ(tail[y * 17 + x], samples[8 * y * 129 + 8 * x]) << x << ", " << y;
}

TEST(PatchTails, texelsAreMeansOfTheRoot) {
  TextureFormat format = sampleFormat(Basis::kPtmRgb);  // coefficients: plain means
  const size_t channels = static_cast<size_t>(format.channels());
  std::vector<uint8_t> root(channels * 128 * 128), tail(channels * kTailPatchTexels);
  std::mt19937 random(static_cast<uint32_t>(kSeed));
  for (uint8_t& t : root) t = static_cast<uint8_t>(random());
  tailTexels(MipFilter(format), root, tail);
  PatchTails one(1, format.channels());
  one.texels = tail;
  double worst = 0;
  for (int level = 0; level < kTailLevels; ++level) {
    const size_t side = static_cast<size_t>(16 >> level), block = 128 / side;
    for (size_t c = 0; c < channels; ++c)
      for (size_t i = 0; i < side * side; ++i) {
        double sum = 0;
        for (size_t k = 0; k < block * block; ++k)
          sum += root[(c * 128 + i / side * block + k / block) * 128 + i % side * block + k % block];
        worst = std::max(
            worst, std::abs(one.level(0, level, static_cast<int>(c))[i] - sum / static_cast<double>(block * block)));
      }
  }
  EXPECT_LE(worst, 0.5 + 1.0 / 64);  // rounded to a byte, after at most six roundings to 1/256
}

// Two patches side by side, colours 10 and 200, whose normals differ by an angle: up to 40 degrees a filter blends
// them.
TEST(PatchTails, normalsEndAtCreases) {
  BaseMesh mesh;
  for (int y = 0; y < 2; ++y)
    for (int x = 0; x < 3; ++x) mesh.corners.push_back({{static_cast<float>(x), static_cast<float>(-y), 0}, {0, 0, 1}});
  mesh.patches = {{0, 1, 3, 4}, {1, 2, 4, 5}};
  for (const double degrees : {30.0, 38.0, 42.0, 90.0, 180.0}) {
    const double turn = degrees * std::numbers::pi / 180;
    const std::array<std::array<double, 3>, 2> normals{{{0, 0, 1}, {std::sin(turn), 0, std::cos(turn)}}};
    PatchTails tails(2, 6);
    std::array<std::array<uint8_t, 6>, 2> texel{};
    for (uint32_t p = 0; p < 2; ++p)
      for (int level = 0; level < kTailLevels; ++level)
        for (int c = 0; c < 6; ++c) {
          texel[p][static_cast<size_t>(c)] = static_cast<uint8_t>(
              c < 3 ? (p ? 200 : 10) : std::lround(127.5 * (normals[p][static_cast<size_t>(c - 3)] + 1)));
          const auto side = static_cast<size_t>(PatchTails::side(level));
          std::fill_n(const_cast<uint8_t*>(tails.level(p, level, c)), side * side, texel[p][static_cast<size_t>(c)]);
        }
    for (const bool has_normals : {true, false}) {
      const KeptTails kept(tails);
      const TailBlocks blocks(kept, mesh, {.normals = has_normals});
      for (int level = 0; level < kTailLevels; ++level)
        for (uint32_t p = 0; p < 2; ++p) {
          const std::vector<uint32_t> words = twoPlanes(blocks, p, level);
          // Beyond the common side, its ends and the corners there.
          const size_t row = tailBlockSide(level), x = p == 0 ? row - 1 : 0;
          for (size_t y = 0; y < row; ++y)
            for (size_t c = 0; c < 6; ++c) {
              const bool own = c >= 3 && has_normals && degrees > 40;
              const auto shown = static_cast<uint8_t>(words[2 * (y * row + x) + c / 3] >> (8 * (c % 3)));
              ASSERT_NEAR(shown, texel[own ? p : 1 - p][c], own ? 0 : 1)
                  << degrees << " " << level << " " << y << " " << c;
            }
        }
    }
  }
}

// Three patches around a corner, two of which meet along a side: plain colours that differ in one channel, normals that
// do not. By up to 32 of 255 a filter blends them.
TEST(PatchTails, coloursEndAtEdges) {
  BaseMesh mesh;
  for (int y = 0; y < 3; ++y)
    for (int x = 0; x < 3; ++x) mesh.corners.push_back({{static_cast<float>(x), static_cast<float>(-y), 0}, {0, 0, 1}});
  mesh.patches = {{0, 1, 3, 4}, {1, 2, 4, 5}, {4, 5, 7, 8}};
  for (const int apart : {-90, -33, -32, 0, 32, 33, 90})
    for (const int differs : {0, 1, 2}) {
      PatchTails tails(3, 6);
      auto texel = [&](uint32_t p, int c) { return static_cast<uint8_t>(100 + (p > 0 && c == differs ? apart : 0)); };
      for (uint32_t p = 0; p < 3; ++p)
        for (int level = 0; level < kTailLevels; ++level)
          for (int c = 0; c < 6; ++c) {
            const auto side = static_cast<size_t>(PatchTails::side(level));
            std::fill_n(tails.level(p, level, c), side * side, texel(p, c));
          }
      for (const GutterEnds ends : {GutterEnds{.colours = true}, GutterEnds{.normals = true}}) {
        const KeptTails kept(tails);
        const TailBlocks blocks(kept, mesh, ends);
        const bool ended = ends.colours && std::abs(apart) > 32;
        for (int level = 0; level < kTailLevels; ++level) {
          const std::vector<uint32_t> words = twoPlanes(blocks, 0, level);
          const size_t row = tailBlockSide(level), last = row - 1;
          auto shown = [&](size_t x, size_t y, int c) {
            return static_cast<uint8_t>(words[2 * (y * row + x) + static_cast<size_t>(c / 3)] >> (8 * (c % 3)));
          };
          for (int c = 0; c < 6; ++c) {
            for (size_t y = 1; y < last; ++y)
              ASSERT_EQ(shown(last, y, c), texel(ended ? 0 : 1, c)) << apart << " " << differs << " " << c;
            // Beyond the corner: what makes the mean of four texels that of the three patches.
            const int mean = 100 + (c == differs ? (2 * apart) / 3 : 0);
            const int beyond = std::max(0, 4 * mean - texel(0, c) - texel(1, c) - texel(0, c));
            ASSERT_NEAR(shown(last, last, c), ended ? texel(0, c) : beyond, ended ? 0 : 4) << apart << " " << c;
          }
          EXPECT_EQ(shown(0, 1, 0), texel(0, 0)) << "an open side";
        }
      }
    }
}

// From its own tile alone, a patch shows along a side what its neighbour shows there; around a corner all patches show
// one mean.
TEST(PatchTails, tilesAgreeOnSidesAndCorners) {
  for (bool open : {false, true}) {
    const BaseMesh mesh = cubeSphere(3, 50, kSeed, open);
    const PatchTails tails = noise(static_cast<uint32_t>(mesh.patches.size()), 6);
    const KeptTails kept(tails);
    const TailBlocks blocks(kept, mesh);
    const auto neighbours = patchNeighbours(mesh);
    std::vector<std::vector<uint32_t>> words(kTailLevels * mesh.patches.size());
    for (uint32_t p = 0; p < mesh.patches.size(); ++p)
      for (int level = 0; level < kTailLevels; ++level) {
        words[kTailLevels * p + static_cast<size_t>(level)] = twoPlanes(blocks, p, level);
      }
    // From -1 to side.
    auto at = [&](uint32_t p, int plane, int level, int x, int y, int c) {
      const size_t texel = static_cast<size_t>(y + 1) * tailBlockSide(level) + static_cast<size_t>(x + 1);
      return static_cast<uint8_t>(
          words[kTailLevels * p + static_cast<size_t>(level)][2 * texel + static_cast<size_t>(plane)] >> (8 * c));
    };
    uint64_t compared = 0, differ = 0, control = 0;
    std::map<std::array<int, 4>, std::vector<double>>
        around;  // corner, plane, level, channel: mean of four texels from each patch
    for (uint32_t p = 0; p < mesh.patches.size(); ++p) {
      for (int plane = 0; plane < 2; ++plane) {
        for (int level = 0; level < kTailLevels; ++level) {
          const int side = 16 >> level, last = side - 1;
          auto on = [&](uint32_t patch, int s, int i, int depth,
                        int c) {  // the i-th texel along side s, `depth` inwards
            const int across = s == kLeft || s == kTop ? depth : last - depth;
            return s == kLeft || s == kRight ? at(patch, plane, level, across, i, c)
                                             : at(patch, plane, level, i, across, c);
          };
          for (int s = 0; s < 4; ++s) {
            const PatchNeighbour& n = neighbours[p][static_cast<size_t>(s)];
            for (int i = 0; i < side; ++i)
              for (int c = 0; c < 3; ++c) {
                const bool border = n.patch == PatchNeighbour::kNone;
                const uint8_t expected =
                    border ? on(p, s, i, 0, c) : on(n.patch, n.side, n.reversed ? last - i : i, 0, c);
                ++compared;
                differ += on(p, s, i, -1, c) != expected;
                if (!border) control += on(p, s, i, -1, c) != on(n.patch, n.side, n.reversed ? i : last - i, 0, c);
              }
          }
          for (int k = 0; k < 4; ++k)
            for (int c = 0; c < 3; ++c) {
              const int x = k % 2 ? last : 0, y = k / 2 ? last : 0, dx = k % 2 ? 1 : -1, dy = k / 2 ? 1 : -1;
              const uint8_t beyond = at(p, plane, level, x + dx, y + dy, c);
              if (beyond == 0 || beyond == 255) continue;  // the mean may be out of reach
              around[{static_cast<int>(mesh.patches[p][static_cast<size_t>(k)]), plane, level, c}].push_back(
                  (at(p, plane, level, x, y, c) + at(p, plane, level, x + dx, y, c) +
                   at(p, plane, level, x, y + dy, c) + beyond) /
                  4.0);
            }
        }
      }
    }
    EXPECT_EQ(differ, 0u) << "of " << compared;
    EXPECT_GT(control, compared / 2) << "sides taken the wrong way round would not be seen";
    for (const auto& [corner, means] : around)
      for (double mean : means) ASSERT_EQ(mean, means[0]) << "corner " << corner[0] << " level " << corner[2];
  }
}

class NoPages final : public PageSource {
 public:
  Result<EncodedPage> read(PageId) const override { return Error{ErrorKind::kIo, "", "unreadable", "", {}}; }
};
TEST(PatchTails, pagesThatCannotBeHadAreNeutralOfWhateverBasis) {
  for (Basis basis : {Basis::kPtmLrgb, Basis::kPtmRgb, Basis::kAlbedoNormal}) {
    const TextureFormat format = sampleFormat(basis);
    PatchTails tails(2, format.channels());
    std::vector<std::string> problems;
    tailsFromPages(NoPages(), format, true, 0, 1, tails, &problems);
    EXPECT_EQ(problems.size(), 2 * static_cast<size_t>(format.planes() + 1));
    EXPECT_EQ(tails.failures.pages, problems.size());
    EXPECT_EQ(tails.failures.unreadable, problems.size());
    EXPECT_NE(tails.failures.first.find("unreadable"), std::string::npos);
    const std::atomic<bool> stop{true};
    PatchTails stopped(2, format.channels());
    tailsFromPages(NoPages(), format, true, 0, 2, stopped, nullptr, &stop);
    EXPECT_EQ(stopped.failures.pages, 0u) << "nothing is read any more";
    std::vector<double> raw;
    for (int c = 0; c < format.channels(); ++c) raw.push_back(tails.level(1, 0, c)[0]);
    for (const std::array<double, 3>& light : {std::array<double, 3>{0, 0, 1}, std::array<double, 3>{0.6, 0, 0.8}}) {
      const auto rgb = evaluatePixel(format, raw.data(), light);
      if (basis == Basis::kAlbedoNormal) continue;  // which turns away from the light
      for (double grey : rgb) EXPECT_NEAR(grey, 128, 8) << basisName(basis);
    }
    for (uint16_t height : tails.heightsOf(1)) ASSERT_EQ(height, 0);
  }
}

TEST(PatchTails, resolvedTailsAreResolvedTexelByTexel) {
  const TextureFormat format = sampleFormat(Basis::kPtmLrgb);
  const PatchTails tails = noise(70, format.channels());  // more than one page of them
  const PatchTails resolved = resolvedTails(tails, format, {0.3, -0.2, 0.9});
  const auto basis = ptmBasis(0.3, -0.2);
  double worst = 0;
  for (uint32_t p : {0u, 53u, 54u, 69u})
    for (int level = 0; level < kTailLevels; ++level)
      for (int i = 0; i < PatchTails::side(level) * PatchTails::side(level); ++i) {
        double luminance = 0;
        for (int k = 0; k < 6; ++k)
          luminance += (tails.level(p, level, k)[i] - format.bias[static_cast<size_t>(k)]) *
                       format.scale[static_cast<size_t>(k)] * basis[static_cast<size_t>(k)];
        for (int c = 0; c < 3; ++c) {
          const double value = std::clamp(tails.level(p, level, 6 + c)[i] * luminance / 255, 0.0, 255.0);
          worst = std::max(worst, std::abs(value - resolved.level(p, level, c)[i]));
        }
      }
  EXPECT_LE(worst, 0.51);
}

TEST(PatchTails, chunksDecodeToWhatWasEncodedAndNothingElse) {
  const PatchTails tails = noise(9, 6);
  const std::vector<std::array<uint32_t, 4>> base{{0, 1, 2, 3}, {1, 4, 3, 5},  {2, 3, 6, 7},
                                                  {9, 8, 4, 1}, {3, 5, 7, 10}, {11, 12, 13, 14}};
  for (TailsStorage storage : {TailsStorage::kZstd, TailsStorage::kCoded, TailsStorage::kGrids}) {
    const PatchCorners corners(base.data(), 5), four(base.data(), 4), six(base.data(), 6);
    const std::vector<uint8_t> bytes = encodeTailsChunk(tails, 2, 5, storage, corners, 3);
    PatchTails back(9, 6);
    ASSERT_TRUE(decodeTailsChunk(bytes, 2, 5, storage, corners, back).ok());
    for (uint32_t p = 2; p < 7; ++p) {
      EXPECT_TRUE(std::ranges::equal(back.heightsOf(p), const_cast<PatchTails&>(tails).heightsOf(p)));
      EXPECT_TRUE(std::ranges::equal(back.texelsOf(p), const_cast<PatchTails&>(tails).texelsOf(p)));
    }
    for (uint32_t p : {0u, 1u, 7u, 8u})
      EXPECT_EQ(std::ranges::count(back.heightsOf(p), 0), std::ssize(back.heightsOf(p)));
    for (size_t length = 0; length < bytes.size(); length += 1 + length / 64)
      EXPECT_FALSE(decodeTailsChunk({bytes.data(), length}, 2, 5, storage, corners, back).ok()) << length;
    EXPECT_FALSE(decodeTailsChunk(bytes, 2, 4, storage, four, back).ok());
    EXPECT_FALSE(decodeTailsChunk(bytes, 2, 6, storage, six, back).ok());
    // The same chunk whatever patches it stands for.
    PatchTails moved(20, 6);
    ASSERT_TRUE(decodeTailsChunk(bytes, 13, 5, storage, corners, moved).ok());
    EXPECT_TRUE(std::ranges::equal(moved.heightsOf(13), back.heightsOf(2)));
  }
}

// The bytes of a chunk, by what PACKAGE.md says of them: the differences of the heights, low bytes before high bytes,
// then those of the texels. Writer and reader could agree on anything else.
TEST(PatchTails, chunksHoldDifferencesToTheLeftOrAtARowsBeginningToAbove) {
  PatchTails tails = noise(3, 3);
  const std::vector<uint8_t> bytes = encodeTailsChunk(tails, 1, 2, TailsStorage::kZstd, {}, 3);
  std::vector<uint8_t> expected, high;
  for (uint32_t p : {1u, 2u}) {
    const std::span<const uint16_t> h = tails.heightsOf(p);
    for (int i = 0; i < 17 * 17; ++i) {
      const int before = i % 17 > 0 ? h[i - 1] : i > 0 ? h[i - 17] : 0;
      const int step = static_cast<int16_t>(static_cast<uint16_t>(h[i] - before));
      const int folded = step >= 0 ? 2 * step : -2 * step - 1;
      expected.push_back(static_cast<uint8_t>(folded % 256));
      high.push_back(static_cast<uint8_t>(folded / 256));
    }
  }
  expected.insert(expected.end(), high.begin(), high.end());
  for (uint32_t p : {1u, 2u}) {
    const uint8_t* texel = tails.texelsOf(p).data();
    for (int side : {16, 8, 4, 2})
      for (int channel = 0; channel < 3; ++channel, texel += side * side)
        for (int i = 0; i < side * side; ++i) {
          const int before = i % side > 0 ? texel[i - 1] : i > 0 ? texel[i - side] : 0;
          expected.push_back(static_cast<uint8_t>(texel[i] - before));
        }
  }
  std::vector<uint8_t> raw(expected.size());
  ASSERT_EQ(ZSTD_decompress(raw.data(), raw.size(), bytes.data(), bytes.size()), raw.size());
  EXPECT_TRUE(raw == expected);
}

class TailsOfPackage : public ::testing::Test {
 protected:
  // Built once, for no test changes it. Of the last version whose root pages hold what the tails do.
  static void SetUpTestSuite() {
    // More patches than a chunk has.
    ManyPatches source(cubeSphere(7, 50, kSeed), 0, 0, kSeed);
    patches_ = static_cast<uint32_t>(source.base().patches.size());
    ASSERT_GT(patches_, kTailsChunkPatches);
    const ScratchFolder folder;
    BuildOptions options;
    options.output = folder.file("many.relievo");
    options.workers = 2;
    options.zstd_level = 1;
    options.coded_index = false;
    auto built = buildPatchPackage(source, options);
    ASSERT_TRUE(built.ok()) << built.error().text();
    bytes_ = readAll(options.output);
    auto header = decodeHeader({bytes_.data(), kHeaderBytes}, options.output);
    ASSERT_TRUE(header.ok());
    header_ = *header;
    ASSERT_GT(header_.tails_bytes, 0u);
  }
  void SetUp() override { ASSERT_GT(header_.tails_bytes, 0u) << "no package was built"; }
  std::shared_ptr<Package> open(const std::vector<uint8_t>& bytes) {
    const std::string path = folder_.file("damaged.relievo");
    writeAll(path, bytes);
    auto package = Package::open(path);
    refusal_ = package.ok() ? "" : package.error().text();
    return package.ok() ? *package : nullptr;
  }
  // In both headers.
  static void setField(std::vector<uint8_t>& bytes, size_t offset, uint64_t value) {
    for (uint8_t* head : {bytes.data(), bytes.data() + bytes.size() - kHeaderBytes}) {
      storeLittle(head + offset, value);
      storeLittle(head + kHeaderBytes - 8, static_cast<uint64_t>(XXH3_64bits(head, kHeaderBytes - 8)));
    }
  }
  template <class T>
  void setDirectory(std::vector<uint8_t>& bytes, size_t offset, T value) {
    uint8_t* directory = bytes.data() + header_.tails_offset;
    storeLittle(directory + offset, value);
    setField(bytes, 312, XXH3_64bits(directory, header_.tails_bytes));
  }

  ScratchFolder folder_;
  static inline std::vector<uint8_t> bytes_;
  static inline PackageHeader header_;
  static inline uint32_t patches_ = 0;
  std::string refusal_;
};

TEST_F(TailsOfPackage, areThoseOfItsRootPages) {
  auto package = open(bytes_);
  ASSERT_TRUE(package) << refusal_;
  ASSERT_TRUE(package->hasTails());
  std::vector<std::string> problems;
  const PatchTails read = package->wholeTails(2, &problems);
  PatchTails made(patches_, package->manifest().texture.channels());
  tailsFromPages(*package, package->manifest().texture, true, 0, 2, made, &problems);
  EXPECT_TRUE(problems.empty()) << problems.front();
  EXPECT_TRUE(read == made);
  EXPECT_TRUE(package->tailProblems().empty());
  auto verified = verifyPackage(*package, 2, nullptr);
  ASSERT_TRUE(verified.ok());
  EXPECT_TRUE(verified->other.empty());
}

TEST_F(TailsOfPackage, packagesWithoutThemOpen) {
  auto old = bytes_;
  for (size_t offset : {296, 304, 312}) setField(old, offset, 0);
  auto package = open(old);
  ASSERT_TRUE(package) << refusal_;
  EXPECT_FALSE(package->hasTails());
  EXPECT_TRUE(package->tailProblems().empty());
}

TEST_F(TailsOfPackage, hostileHeaderFieldsAreRefusedByName) {
  const struct {
    size_t offset;
    uint64_t value;
    const char* says;
  } cases[] = {{296, bytes_.size() - 8, "tails lie outside the file"},
               {296, ~uint64_t{0}, "tails lie outside the file"},
               {304, header_.tails_bytes + 20, "expected a directory of tails of"},
               {304, 1, "expected a directory of tails of"}};
  for (const auto& c : cases) {
    auto broken = bytes_;
    setField(broken, c.offset, c.value);
    EXPECT_FALSE(open(broken)) << c.offset << " " << c.value;
    EXPECT_NE(refusal_.find(c.says), std::string::npos) << refusal_;
  }
}

// The package opens, says what is wrong, and shows what its root pages tell.
TEST_F(TailsOfPackage, damagedTheyAreMadeOfThePagesAndNamed) {
  const PatchTails sound = open(bytes_)->wholeTails(1, nullptr);
  EXPECT_EQ(sound.failures.pages, 0u);
  const std::atomic<bool> stop{true};
  EXPECT_FALSE(open(bytes_)->wholeTails(1, nullptr, &stop) == sound) << "interrupted";
  const uint64_t first_chunk = loadLittle<uint64_t>(bytes_.data() + header_.tails_offset + kTailsHeadBytes);
  const struct {
    const char* what;
    std::function<void(std::vector<uint8_t>&)> damage;
    const char* says;
  } cases[] = {
      {"a chunk's byte", [&](auto& b) { b[first_chunk + 100] ^= 1; },
       "the tails of patches 0 to 255 are damaged: their checksum does not match"},
      {"the directory's byte", [&](auto& b) { b[header_.tails_offset + 30] ^= 1; },
       "directory's checksum does not match"},
      {"patches", [&](auto& b) { setDirectory(b, 0, uint32_t{5}); }, "patches, found 5"},
      {"cells", [&](auto& b) { setDirectory(b, 4, uint32_t{32}); }, "expected 16 cells a side, found 32"},
      {"texels", [&](auto& b) { setDirectory(b, 8, uint32_t{8}); }, "expected 16 texels a side, found 8"},
      {"channels", [&](auto& b) { setDirectory(b, 12, uint32_t{3}); }, "expected 6 channels, found 3"},
      {"patches a chunk", [&](auto& b) { setDirectory(b, 16, uint32_t{1}); }, "expected 256 patches a chunk, found 1"},
      {"a chunk beyond the file", [&](auto& b) { setDirectory(b, 24, uint64_t{1} << 60); },
       "the tails of patches 0 to 255 lie beyond the end of the file"},
      {"a chunk's size", [&](auto& b) { setDirectory(b, 32, ~uint32_t{0}); },
       "the tails of patches 0 to 255 lie beyond the end of the file"},
      {"another chunk in its place",
       [&](auto& b) {
         uint8_t entry[kTailsEntryBytes];
         std::memcpy(entry, b.data() + header_.tails_offset + kTailsHeadBytes + kTailsEntryBytes, sizeof entry);
         std::memcpy(b.data() + header_.tails_offset + kTailsHeadBytes, entry, sizeof entry);
         setDirectory(b, 20, uint32_t{0});
       },
       "the tails of patches 0 to 255 are damaged: expected"},
  };
  for (size_t k = 0; k < std::size(cases); k += test::kSanitized ? std::size(cases) - 1 : 1) {
    const auto& c = cases[k];
    auto broken = bytes_;
    c.damage(broken);
    auto package = open(broken);
    ASSERT_TRUE(package) << c.what << ": " << refusal_;
    const auto problems = package->tailProblems();
    ASSERT_FALSE(problems.empty()) << c.what;
    EXPECT_NE(problems[0].find(c.says), std::string::npos) << c.what << ": " << problems[0];
    // Whatever is damaged, the same check tells of it, and they are made of the pages in the same way.
    if (k > 1 && k + 1 != std::size(cases) && !test::longTests()) continue;
    auto verified = verifyPackage(*package, 2, nullptr);
    ASSERT_TRUE(verified.ok());
    EXPECT_FALSE(verified->other.empty()) << c.what;
    if (k == 1 && !test::longTests()) continue;
    std::vector<std::string> said;
    EXPECT_TRUE(package->wholeTails(2, &said) == sound) << c.what;
    ASSERT_FALSE(said.empty()) << c.what;
  }
}

// From version 9 on root pages are stored over their tails.
TEST(TailsUnderPages, damagedTheyAndTheRootPagesAreNamedAndCounted) {
  if (test::kSanitized) GTEST_SKIP() << "about what is said; others read damaged packages under the sanitizer";
  ManyPatches source(cubeSphere(7, 50, kSeed), 0, 0, kSeed);
  ScratchFolder folder;
  BuildOptions options;
  options.output = folder.file("many.relievo");
  ASSERT_TRUE(buildPatchPackage(source, options).ok());
  auto bytes = readAll(options.output);
  const auto sound = *Package::open(options.output);
  const PatchTails tails = sound->wholeTails(1, nullptr);
  const uint64_t chunk = loadLittle<uint64_t>(bytes.data() + sound->header().tails_offset + kTailsHeadBytes);
  bytes[chunk + 100] ^= 1;
  writeAll(folder.file("damaged.relievo"), bytes);
  const auto damaged = *Package::open(folder.file("damaged.relievo"));
  const PageId root(Plane::kRelief, {3, 0, 0, 0}), other(Plane::kRelief, {kTailsChunkPatches, 0, 0, 0});
  const auto page = damaged->read(root);
  ASSERT_FALSE(page.ok());
  const std::string what = "the tails of patches 0 to 255 are damaged: their checksum does not match";
  EXPECT_NE(page.error().text().find("page plane relief patch 3 level 0 x 0 y 0: " + what), std::string::npos)
      << page.error().text();
  EXPECT_TRUE(damaged->read(other)->bytes == sound->read(other)->bytes) << "of another chunk";
  std::vector<std::string> said;
  const PatchTails made = damaged->wholeTails(2, &said);
  EXPECT_EQ(made.failures.pages, kTailsChunkPatches);
  ASSERT_FALSE(said.empty());
  EXPECT_EQ(made.heights[kTailsChunkPatches * kTailHeights], tails.heights[kTailsChunkPatches * kTailHeights]);
  const auto verified = verifyPackage(*damaged, {});
  ASSERT_TRUE(verified.ok());
  EXPECT_EQ(verified->damaged.size(), kTailsChunkPatches);
  EXPECT_EQ(verified->other.size(), 1u);
}

}  // namespace patch_tails_test
}  // namespace relievo
