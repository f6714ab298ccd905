// Images that patches show: what is sampled, against the same in real numbers; what a package keeps of them; and what
// is shown where something of it is damaged.
#include "texturing/package/patch_images.h"

#include <gtest/gtest.h>
#include <xxhash.h>
#include <zstd.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <fstream>

#include "patch_fixture.h"
#include "src/base/srgb.h"
#include "tests/view_share.h"
#include "texturing/codec/image_jpeg.h"
#include "texturing/codec/page_jpeg_codec.h"
#include "texturing/package/package.h"
#include "texturing/package/package_layout.h"
#include "texturing/package/package_tails.h"
#include "texturing/package/patch_package_builder.h"
#include "texturing/package/texture_depths.h"

namespace relievo {
namespace patch_images_test {

using namespace testing_support;

constexpr uint64_t kSeed = 31;

struct Picture {
  int width, height;
  bool repeats;
  std::vector<uint8_t> rgb;
  bool fill = false;
  std::vector<uint8_t> jpeg;
  SourceImage source() const {
    return {.width = width, .height = height, .repeats = repeats, .rgb = rgb, .fill = fill, .jpeg = jpeg};
  }
};
Picture pictureOf(int width, int height, bool repeats, uint64_t seed) {
  Picture p{width, height, repeats, {}, false, {}};
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      for (int c = 0; c < 3; ++c) {
        const int noise = static_cast<int>(mixBits(seed + static_cast<uint64_t>(3 * (y * width + x) + c)) % 21);
        p.rgb.push_back(static_cast<uint8_t>(118 + 90 * std::sin(0.11 * x + c) * std::cos(0.07 * y) + noise));
      }
  return p;
}

// A level in real numbers, mean after mean in linear light; an odd border counts twice.
struct TrueLevel {
  int width, height;
  std::vector<double> rgb;
};
TrueLevel halved(const TrueLevel& fine) {
  TrueLevel out{(fine.width + 1) / 2, (fine.height + 1) / 2, {}};
  for (int y = 0; y < out.height; ++y)
    for (int x = 0; x < out.width; ++x)
      for (int c = 0; c < 3; ++c) {
        double sum = 0;
        for (int k = 0; k < 4; ++k) {
          const int i = std::min(2 * x + k % 2, fine.width - 1), j = std::min(2 * y + k / 2, fine.height - 1);
          sum += linearFromSrgb(fine.rgb[static_cast<size_t>(3 * (j * fine.width + i) + c)] / 255);
        }
        out.rgb.push_back(255 * srgbFromLinear(sum / 4));
      }
  return out;
}
double bilinear(const TrueLevel& level, bool repeats, double x, double y, int c) {
  const double i = std::floor(x - 0.5), j = std::floor(y - 0.5), f = x - 0.5 - i, g = y - 0.5 - j;
  auto at = [&](double px, double py) {
    auto inside = [&](double v, int n) {
      const auto k = static_cast<int>(v);
      return repeats ? ((k % n) + n) % n : std::clamp(k, 0, n - 1);
    };
    return level.rgb[static_cast<size_t>(3 * (inside(py, level.height) * level.width + inside(px, level.width)) + c)];
  };
  return (at(i, j) * (1 - f) + at(i + 1, j) * f) * (1 - g) + (at(i, j + 1) * (1 - f) + at(i + 1, j + 1) * f) * g;
}

TEST(PatchImages, SamplesAreBilinearInMeansOfLight) {
  for (const bool repeats : {false, true}) {
    const Picture picture = pictureOf(53, 38, repeats, kSeed);
    const ShownImage image(picture.source());
    const ShownImage::Repetition all{{repeats, repeats}, {}};
    TrueLevel level{picture.width, picture.height, {picture.rgb.begin(), picture.rgb.end()}};
    for (int k = 0; k < 4; ++k, level = halved(level)) {
      double largest = 0;
      int of_finer = 0;
      for (uint64_t i = 0; i < 2000; ++i) {
        const auto x = static_cast<int64_t>(mixBits(2 * i) % (53 * 3 * 256)) - 53 * 256,
                   y = static_cast<int64_t>(mixBits(2 * i + 1) % (38 * 3 * 256)) - 38 * 256;
        const auto found = image.sample(x, y, k, all);
        auto wrapped = [&](int64_t v, int64_t n) {
          return repeats ? static_cast<double>(((v % (256 * n)) + 256 * n) % (256 * n)) : static_cast<double>(v);
        };
        const double px = wrapped(x, 53) / 256 / (1 << k), py = wrapped(y, 38) / 256 / (1 << k);
        for (int c = 0; c < 3; ++c) {
          const double off = std::abs(found[static_cast<size_t>(c)] - bilinear(level, repeats, px, py, c));
          largest = std::max(largest, off);
          const int other = image.sample(x, y, k + 1, all)[static_cast<size_t>(c)];
          of_finer = std::max(of_finer, std::abs(other - found[static_cast<size_t>(c)]));
        }
      }
      // Weights are 256ths, of up to 200 steps between neighbours.
      EXPECT_LE(largest, 2.2) << "level " << k;
      EXPECT_GT(of_finer, 8) << "control: levels differ";
    }
    EXPECT_EQ(image.sample(0, 0, 100, all), image.sample(5000, 900, 6, all)) << "the coarsest is one texel";
  }
}

// Halves within one repetition show that one alone, to its border and beyond; others all that they run over.
TEST(PatchImages, OneRepetitionEndsAtItsBorder) {
  constexpr int kWidth = 40, kHeight = 30, kTexel = 256;
  Picture picture{kWidth, kHeight, true, {}};  // left dark, right bright
  for (int i = 0; i < kWidth * kHeight; ++i)
    for (int c = 0; c < 3; ++c) picture.rgb.push_back(static_cast<uint8_t>(i % kWidth < 20 ? 0 : 240));
  const ShownImage repeated(picture.source());
  picture.repeats = false;
  const ShownImage once(picture.source());
  auto places = [&](int from, int to) {
    return std::array{glm::ivec2(from, 0), glm::ivec2(to, 5), glm::ivec2(from, 9)};
  };
  for (const int turn : {-3, 0, 5}) {
    const int begin = turn * kWidth * kTexel, end = begin + kWidth * kTexel;
    for (const int slack : {0, 100, 128}) {
      const auto one = repeated.repetitionOf(places(begin - slack, end + slack));
      EXPECT_FALSE(one.repeats[0] || one.repeats[1]) << slack;
      for (const int level : {0, 2}) {
        EXPECT_EQ(repeated.sample(end + 400, 300, level, one)[0], 240) << "its own border";
        EXPECT_EQ(repeated.sample(begin - 400, 300, level, one)[0], 0);
      }
    }
    for (const auto& some :
         {repeated.repetitionOf(places(begin - 129, end)), repeated.repetitionOf(places(begin, end + 130))}) {
      EXPECT_TRUE(some.repeats[0]) << turn;
      EXPECT_FALSE(some.repeats[1]);
      EXPECT_EQ(repeated.sample(end + 400, 300, 0, some)[0], 0) << "the opposite border";
      EXPECT_EQ(repeated.sample(end, 300, 0, some)[0], 120) << "both, in the middle";
    }
  }
  EXPECT_FALSE(once.repetitionOf(places(0, 99 * kWidth * kTexel)).repeats[0]);
}

PatchImage somewhere(uint64_t seed, int8_t depth, std::array<uint16_t, 2> images, int extent) {
  PatchImage p;
  p.depth = depth;
  p.image = images;
  for (size_t half = 0; half < 2; ++half)
    for (size_t k = 0; k < 3; ++k) {
      for (int axis = 0; axis < 2; ++axis)
        p.at[half][k][axis] = static_cast<int32_t>(mixBits(seed + 8 * half + 2 * k + static_cast<uint64_t>(axis)) %
                                                   static_cast<uint64_t>(256 * extent)) -
                              128 * extent;
      const glm::dvec3 n = glm::normalize(glm::dvec3(0.2 * static_cast<double>(k) - 0.3, half ? 0.8 : -0.8, 0.7));
      p.normal[half][k] = glm::u8vec3(glm::round(127.5 * (n + 1.0)));
    }
  return p;
}

TEST(PatchImages, HalvesAreAffineAndGoOnBeyondThePatch) {
  const Picture a = pictureOf(70, 50, true, 1), b = pictureOf(40, 90, false, 2);
  const ShownImage image_a(a.source()), image_b(b.source());
  const PatchImage patch = somewhere(kSeed, 1, {0, 1}, 60);
  const ShownTexels which{8, -4, 120, 136};
  std::vector<uint8_t> out(3 * 136 * 136), normals(out.size());
  showImages(patch, {&image_a, &image_b}, which, out);
  showNormals(patch, which, normals);
  const std::array<const Picture*, 2> pictures{&a, &b};
  double largest = 0, furthest_normal = 0, other_half = 0;
  for (int j = 0; j < 136; ++j)
    for (int i = 0; i < 136; ++i) {
      const double u = (i - 4 + 0.5) / 256, v = (j + 120 + 0.5) / 256;
      for (const size_t half : {size_t{v > u}, size_t{v <= u}}) {
        const bool own = half == size_t{v > u};
        const double along = half ? v : u, across = half ? u : v;
        const glm::dvec2 at =
            (glm::dvec2(patch.at[half][0]) * (1 - along) + glm::dvec2(patch.at[half][1]) * (along - across) +
             glm::dvec2(patch.at[half][2]) * across) /
            256.0;
        const Picture& p = *pictures[half];
        const TrueLevel level{p.width, p.height, {p.rgb.begin(), p.rgb.end()}};
        // It runs over several repetitions of the one that is repeated.
        const glm::dvec2 size(p.width, p.height), place = p.repeats ? at - size * glm::floor(at / size) : at;
        auto byte = [&](size_t k) { return glm::dvec3(patch.normal[half][k]) / 127.5 - 1.0; };
        const glm::dvec3 normal = glm::normalize(byte(0) * (1 - along) + byte(1) * (along - across) + byte(2) * across);
        for (int c = 0; c < 3; ++c) {
          const size_t texel = static_cast<size_t>((c * 136 + j) * 136 + i);
          const double off = std::abs(out[texel] - bilinear(level, p.repeats, place.x, place.y, c));
          if (!own) other_half = std::max(other_half, off);
          else largest = std::max(largest, off);
          if (own) furthest_normal = std::max(furthest_normal, std::abs(normals[texel] - 127.5 * (normal[c] + 1)));
        }
      }
    }
  EXPECT_EQ(shownLevel(patch.at[0], 8), 0);
  EXPECT_LE(largest, 3) << "places and weights are 256ths";
  EXPECT_LE(furthest_normal, 0.51);
  EXPECT_GT(other_half, 50) << "control";
}

// Colours of corners are linear on a half, to a 2nd of a step, and go on beyond it as far as bytes do. The other half
// may show an image.
TEST(PatchImages, ColoursOfCornersAreLinearOnTheirHalf) {
  const Picture picture = pictureOf(70, 50, true, 1);
  const ShownImage image(picture.source());
  PatchImage patch = somewhere(kSeed, 1, {kCornerColours, kCornerColours}, 60);
  patch.colour[0] = {glm::u8vec3(0, 200, 31), glm::u8vec3(255, 10, 32), glm::u8vec3(90, 255, 250)};
  patch.colour[1] = {glm::u8vec3(40, 1, 255), glm::u8vec3(70, 180, 0), glm::u8vec3(0, 77, 140)};
  const ShownTexels which{7, -4, -4, 136};
  std::vector<uint8_t> out(3 * 136 * 136);
  showImages(patch, {nullptr, nullptr}, which, out);
  double largest = 0, other_half = 0;
  int beyond = 0;
  for (int j = 0; j < 136; ++j)
    for (int i = 0; i < 136; ++i) {
      const double u = (i - 4 + 0.5) / 128, v = (j - 4 + 0.5) / 128;
      for (const size_t half : {size_t{v > u}, size_t{v <= u}}) {
        const double along = half ? v : u, across = half ? u : v;
        const auto& c = patch.colour[half];
        const glm::dvec3 linear = glm::dvec3(c[0]) * (1 - along) + glm::dvec3(c[1]) * (along - across) +
                                  glm::dvec3(c[2]) * across,
                         expected = glm::clamp(linear, 0.0, 255.0);
        beyond += expected != linear;
        for (int k = 0; k < 3; ++k) {
          const double off = std::abs(out[static_cast<size_t>((k * 136 + j) * 136 + i)] - expected[k]);
          (half == size_t{v > u} ? largest : other_half) = std::max(half == size_t{v > u} ? largest : other_half, off);
        }
      }
    }
  EXPECT_LE(largest, 0.5 + 1e-9);
  EXPECT_GT(other_half, 50) << "control";
  EXPECT_GT(beyond, 0) << "some texel lies where they would be below 0";
  // The tail's are those of 16 texels a side.
  const MipFilter mip(TextureFormat{.basis = Basis::kAlbedoNormal});
  std::vector<uint8_t> tail(6 * kTailPatchTexels), whole(3 * 16 * 16);
  tailOfImages(patch, {nullptr, nullptr}, mip, tail);
  showImages(patch, {nullptr, nullptr}, {4, 0, 0, 16}, whole);
  for (size_t i = 0; i < 16 * 16; ++i) ASSERT_EQ(tail[i], whole[i]) << i;
  // A half of each kind.
  PatchImage both = patch;
  both.image[1] = 0;
  std::vector<uint8_t> mixed(out.size()), shown(out.size());
  showImages(both, {nullptr, &image}, which, mixed);
  both.image[0] = 0;
  showImages(both, {&image, &image}, which, shown);
  int of_image = 0;
  for (int j = 0; j < 136; ++j)
    for (int i = 0; i < 136; ++i) {
      const auto texel = static_cast<size_t>(j * 136 + i);
      const bool left = j > i;
      ASSERT_EQ(mixed[texel], left ? shown[texel] : out[texel]) << i << ", " << j;
      of_image += left;
    }
  EXPECT_EQ(of_image, 136 * 135 / 2);
}

TEST(PatchImages, ALevelHasTexelsAboutAsLongAsThePatchs) {
  PatchImage patch;
  for (const auto& [texels, side_log2, level] : {std::array{128, 7, 0},
                                                 {191, 7, 0},
                                                 {193, 7, 1},
                                                 {383, 7, 1},
                                                 {385, 7, 2},
                                                 {4000, 7, 5},
                                                 {4000, 10, 2},
                                                 {4000, 12, 0},
                                                 {4194303, 4, 18}}) {
    for (const int axis : {0, 1})
      for (const size_t k : {size_t{1}, size_t{2}}) {
        patch.at[1] = {};
        patch.at[1][k][axis] = 256 * texels;
        if (k == 1) patch.at[1][2] = patch.at[1][1];
        EXPECT_EQ(shownLevel(patch.at[1], side_log2), level) << texels;
        EXPECT_EQ(shownLevel(patch.at[0], side_log2), 0) << "the other half";
      }
  }
}

TEST(PatchImages, TilesMakeTheImage) {
  for (const auto& [width, height] : {std::pair{128, 128}, {1, 1}, {129, 300}, {260, 127}}) {
    const Picture picture = pictureOf(width, height, false, kSeed);
    StoredImage stored{static_cast<uint32_t>(width), static_cast<uint32_t>(height), false, {}};
    std::vector<uint8_t> channels(kTexturePageBytes), rgb(picture.rgb.size());
    for (uint32_t row = 0; row < stored.rows(); ++row)
      for (uint32_t column = 0; column < stored.columns(); ++column) {
        cutTile(picture.source(), column, row, channels);
        EXPECT_EQ(channels[0], channels[4 * kPageFullPx + 4]) << "borders repeat the tile's own texels";
        pasteTile(stored, column, row, channels, rgb);
      }
    EXPECT_EQ(rgb, picture.rgb) << width << " x " << height;
  }
}

// ---- the directory ----
PatchImages someImages(const BaseMesh& base) {
  PatchImages all;
  all.images = {{200, 90, true, false, false, {{100, 1}, {7, 2}}}, {128, 129, false, true, true, {{40'001, 3}}}};
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    const uint16_t first = p % 2, second = p / 2 % 2;
    all.of_patch.push_back(p % 3 == 0 ? PatchImage{}
                                      : somewhere(p, static_cast<int8_t>(p % 9), {first, second}, 1 << (p % 22)));
  }
  all.of_patch[1].at[0][0] = {kMostShownPlace, -kMostShownPlace};
  for (const size_t p : {size_t{2}, size_t{7}}) all.of_patch[p].depth = kNoTexturePage, all.of_patch[p].in_tail = true;
  return all;
}
constexpr KindsOfImages kAllKinds{.jpegs = true, .in_tails = true, .by_base = true};
constexpr uint64_t kTileBytes = 100 + 7 + 40'001;

bool same(const PatchImages& a, const PatchImages& b) {
  if (a.images.size() != b.images.size() || a.of_patch.size() != b.of_patch.size()) return false;
  for (size_t i = 0; i < a.images.size(); ++i) {
    const StoredImage &x = a.images[i], &y = b.images[i];
    if (x.width != y.width || x.height != y.height || x.repeats != y.repeats || x.is_jpeg != y.is_jpeg ||
        x.fill != y.fill || x.tiles.size() != y.tiles.size())
      return false;
    for (size_t t = 0; t < x.tiles.size(); ++t)
      if (x.tiles[t].size != y.tiles[t].size || x.tiles[t].hash != y.tiles[t].hash) return false;
  }
  for (size_t p = 0; p < a.of_patch.size(); ++p) {
    const PatchImage &x = a.of_patch[p], &y = b.of_patch[p];
    if (x.depth != y.depth || x.in_tail != y.in_tail) return false;
    if (!x.shows()) continue;
    if (x.image != y.image || x.normal != y.normal) return false;
    for (size_t half = 0; half < 2; ++half)
      if (x.hasColours(half) ? x.colour[half] != y.colour[half] : x.at[half] != y.at[half]) return false;
  }
  return true;
}

TEST(PatchImages, TheDirectoryIsWithoutLoss) {
  const BaseMesh base = cubeSphere(3, 10, kSeed);
  const PatchImages all = someImages(base);
  for (const bool by_base : {false, true}) {
    const auto decoded = decodePatchImages(encodePatchImages(all.images, all.of_patch, base, by_base), base, kTileBytes,
                                           {.jpegs = true, .in_tails = true, .by_base = by_base});
    ASSERT_TRUE(decoded.ok()) << decoded.error().text();
    EXPECT_TRUE(same(all, *decoded));
  }
  EXPECT_FALSE(
      decodePatchImages(encodePatchImages(all.images, all.of_patch, base, false), base, kTileBytes, kAllKinds).ok())
      << "control: neither is the other";
}

// Where a surface is smooth, normals are the base's; where it is faceted, they are those of its planes.
TEST(PatchImages, NormalsThatTheBaseTellsTakeHardlyAnyBytes) {
  BaseMesh base = cubeSphere(16, 10, kSeed);
  base.cut = true;
  auto bytesOf = [](const glm::dvec3& n) { return glm::u8vec3(glm::round(127.5 * (n + 1.0))); };
  for (const bool faceted : {false, true}) {
    PatchImages all;
    all.images = {{1, 1, false, false, false, {{100, 1}}}};
    for (const auto& corners : base.patches) {
      PatchImage& patch = all.of_patch.emplace_back();
      patch.in_tail = true;
      for (size_t half = 0; half < 2; ++half) {
        const std::array<uint32_t, 3> of{corners[0], corners[half == 0 ? 1 : 2], corners[3]};
        std::array<glm::dvec3, 3> at;
        for (size_t k = 0; k < 3; ++k) at[k] = base.corners[of[k]].position_mm;
        const glm::dvec3 plane = glm::normalize(glm::cross(at[1] - at[0], at[2] - at[0])) * (half == 0 ? -1.0 : 1.0);
        for (size_t k = 0; k < 3; ++k)
          patch.normal[half][k] = bytesOf(faceted ? plane : glm::dvec3(base.corners[of[k]].normal));
      }
    }
    const size_t bytes = encodePatchImages(all.images, all.of_patch, base, true).size(),
                 before = encodePatchImages(all.images, all.of_patch, base, false).size();
    EXPECT_LT(bytes, 300u) << base.patches.size() << " patches";
    EXPECT_GT(before, 10 * bytes);
    const auto decoded =
        decodePatchImages(encodePatchImages(all.images, all.of_patch, base, true), base, 100, kAllKinds);
    ASSERT_TRUE(decoded.ok());
    EXPECT_TRUE(same(all, *decoded));
  }
}

constexpr KindsOfImages kWithColours{.jpegs = true, .in_tails = true, .by_base = true, .colours = true};
PatchImages someColours(const BaseMesh& base) {
  PatchImages all = someImages(base);
  for (uint32_t p = 0; p < all.of_patch.size(); ++p)
    for (size_t half = 0; half < 2; ++half) {
      PatchImage& patch = all.of_patch[p];
      if (!patch.shows() || mixBits(2 * p + half) % 3 == 0) continue;
      patch.image[half] = kCornerColours;
      for (size_t k = 0; k < 3; ++k)
        for (int c = 0; c < 3; ++c)
          patch.colour[half][k][c] =
              static_cast<uint8_t>(mixBits(100 * p + 12 * half + 4 * k + static_cast<uint64_t>(c)));
    }
  return all;
}

TEST(PatchImages, ColoursOfCornersAreWithoutLoss) {
  const BaseMesh base = cubeSphere(3, 10, kSeed);
  PatchImages all = someColours(base);
  ASSERT_TRUE(all.anyColours());
  EXPECT_FALSE(someImages(base).anyColours());
  const auto decoded =
      decodePatchImages(encodePatchImages(all.images, all.of_patch, base, true), base, kTileBytes, kWithColours);
  ASSERT_TRUE(decoded.ok()) << decoded.error().text();
  EXPECT_TRUE(same(all, *decoded));
  PatchImages other = *decoded;
  for (PatchImage& patch : other.of_patch) patch.colour[1][2].b ^= 1;
  EXPECT_FALSE(same(all, other)) << "control";
  EXPECT_FALSE(
      decodePatchImages(encodePatchImages(all.images, all.of_patch, base, true), base, kTileBytes, kAllKinds).ok())
      << "before version 18";
  // Without any image, too.
  all.images.clear();
  for (PatchImage& patch : all.of_patch) patch.image.fill(kCornerColours);
  const auto alone = decodePatchImages(encodePatchImages(all.images, all.of_patch, base, true), base, 0, kWithColours);
  ASSERT_TRUE(alone.ok()) << alone.error().text();
  EXPECT_TRUE(same(all, *alone));
}

// A vertex's colour takes its bytes once, however many patches meet there.
TEST(PatchImages, AColourTakesBytesOncePerVertex) {
  BaseMesh base = cubeSphere(16, 10, kSeed);
  base.cut = true;
  PatchImages all;
  size_t largest = 0;
  for (const bool by_patch : {false, true}) {
    all.of_patch.clear();
    for (uint32_t p = 0; p < base.patches.size(); ++p) {
      PatchImage& patch = all.of_patch.emplace_back();
      patch.in_tail = true;
      patch.image.fill(kCornerColours);
      for (size_t half = 0; half < 2; ++half) {
        const std::array<uint32_t, 3> of{base.patches[p][0], base.patches[p][half == 0 ? 1 : 2], base.patches[p][3]};
        for (size_t k = 0; k < 3; ++k) {
          const uint64_t at = mixBits(by_patch ? 8 * p + k : of[k]);
          patch.colour[half][k] = {at % 256, at / 256 % 256, at / 65536 % 256};
          const glm::dvec3 normal(base.corners[of[k]].normal);
          patch.normal[half][k] = glm::u8vec3(glm::round(127.5 * (normal + 1.0)));
        }
      }
    }
    const size_t bytes = encodePatchImages(all.images, all.of_patch, base, true).size();
    if (!by_patch) {
      EXPECT_LT(bytes, 6 * base.corners.size()) << "noise of three bytes, and where it is";
    } else {
      EXPECT_GT(bytes, 2 * largest) << "control: colours that no two patches share";
    }
    largest = bytes;
  }
}

TEST(PatchImages, ADirectoryOfAnythingIsOneOrAnError) {
  const BaseMesh base = cubeSphere(2, 10, kSeed);
  const PatchImages all = someImages(base);
  const auto refused = [&](const PatchImages& images, uint64_t tile_bytes, const char* why,
                           KindsOfImages kinds = kAllKinds) {
    const auto decoded =
        decodePatchImages(encodePatchImages(images.images, images.of_patch, base, true), base, tile_bytes, kinds);
    EXPECT_FALSE(decoded.ok()) << why;
    if (!decoded) {
      EXPECT_EQ(decoded.error().kind, ErrorKind::kInvalidData);
    }
  };
  refused(all, kTileBytes - 1, "tiles of more bytes than there are");
  refused(all, kTileBytes, "a JPEG before version 15", {.in_tails = true, .by_base = true});
  refused(all, kTileBytes, "images in tails alone before version 16", {.jpegs = true, .by_base = true});
  refused(all, kTileBytes, "normals that follow the base before version 17", {.jpegs = true, .in_tails = true});
  PatchImages wrong = all;
  wrong.images[0].width = kMostShownSide + 1;
  refused(wrong, kTileBytes, "too wide");
  wrong = all;
  wrong.images[1].height = 0;
  refused(wrong, kTileBytes, "no row");
  wrong = all;
  wrong.images[0].width = wrong.images[0].height = kMostShownSide;
  refused(wrong, kTileBytes, "too many texels");
  // All together: 48 Mi before version 19, 80 Mi in it.
  KindsOfImages richer = kAllKinds;
  richer.colours = richer.richer = true;
  wrong = all;
  wrong.images[1].width = 8192;
  for (const auto& [rows, kinds] : {std::pair(6140, kAllKinds), std::pair(6148, richer), std::pair(10236, richer)}) {
    wrong.images[1].height = static_cast<uint32_t>(rows);
    EXPECT_TRUE(
        decodePatchImages(encodePatchImages(wrong.images, wrong.of_patch, base, true), base, kTileBytes, kinds).ok())
        << rows;
  }
  wrong.images[1].height = 6148;
  refused(wrong, kTileBytes, "more than 48 Mi texels before version 19");
  wrong.images[1].height = 10244;
  refused(wrong, kTileBytes, "more than 80 Mi texels", richer);
  wrong = all;
  wrong.images[1].tiles[0].size = 3 * 128 * 129 + (64 << 10) + 1;
  refused(wrong, kTileBytes - 40'001 + wrong.images[1].tiles[0].size, "a JPEG of more bytes than its texels");
  wrong = all;
  wrong.images[1].is_jpeg = false;
  wrong.images[1].tiles.push_back({1, 4});
  refused(wrong, kTileBytes + 1, "filled, and no JPEG");
  wrong = all;
  wrong.images[0].tiles[0].size = 0;
  refused(wrong, kTileBytes - 100, "a tile of no bytes");
  wrong = all;
  wrong.of_patch[4].depth = kMostShownDepth + 1;
  refused(wrong, kTileBytes, "too deep");
  wrong = all;
  wrong.of_patch[1].at[1][2].x = kMostShownPlace + 1;
  refused(wrong, kTileBytes, "too far outside");
  const auto bytes = encodePatchImages(all.images, all.of_patch, base, true);
  // The first patch that shows images names one that is not there.
  std::vector<uint8_t> raw(ZSTD_getFrameContentSize(bytes.data(), bytes.size()));
  ASSERT_EQ(ZSTD_decompress(raw.data(), raw.size(), bytes.data(), bytes.size()), raw.size());
  uint8_t& image = raw[4 + 2 * 9 + 3 * 12 + base.patches.size()];
  ASSERT_EQ(image, all.of_patch[1].image[0]);
  for (const uint8_t named : {image, uint8_t{2}}) {
    image = named;
    std::vector<uint8_t> frame(ZSTD_compressBound(raw.size()));
    frame.resize(ZSTD_compress(frame.data(), frame.size(), raw.data(), raw.size(), 1));
    EXPECT_EQ(decodePatchImages(frame, base, kTileBytes, kAllKinds).ok(), named < 2);
  }
  const PatchImages coloured = someColours(base);
  const auto of_colours = encodePatchImages(coloured.images, coloured.of_patch, base, true);
  int sound = 0;
  for (uint64_t i = 0; i < 4000; ++i) {
    std::vector<uint8_t> damaged = bytes;
    damaged[mixBits(3 * i) % bytes.size()] = static_cast<uint8_t>(mixBits(3 * i + 1));
    if (i % 3 == 0) damaged.resize(mixBits(3 * i + 2) % bytes.size());
    sound += decodePatchImages(damaged, base, kTileBytes, kAllKinds).ok();
    damaged = of_colours;
    damaged[mixBits(3 * i) % damaged.size()] = static_cast<uint8_t>(mixBits(3 * i + 1));
    if (i % 3 == 0) damaged.resize(mixBits(3 * i + 2) % damaged.size());
    sound += decodePatchImages(damaged, base, kTileBytes, kWithColours).ok();
  }
  EXPECT_LT(sound, 4000);
}

// ---- packages ----
// A third of the patches shows images, at levels 0 to 2, and where so told another third in tails alone; the others
// have noise at level 0.
class ShowingPatches final : public NoisyPatches {
 public:
  explicit ShowingPatches(Picture second = pictureOf(64, 130, false, 6), bool in_tails = false)
      : NoisyPatches(cut(cubeSphere(2, 100, kSeed)), 0, 0, kSeed),
        pictures_{pictureOf(300, 200, true, 5), std::move(second)},
        in_tails_(in_tails) {}
  int textureDepth() const override { return 2; }
  int textureDepthOf(uint32_t patch) const override {
    return patch % 3 == 0 || (in_tails_ && patch % 3 == 1) ? kNoTexturePage : 0;
  }
  std::vector<SourceImage> images() const override { return {pictures_[0].source(), pictures_[1].source()}; }
  PatchImage imageOf(uint32_t patch) const override {
    if (in_tails_ && patch % 3 == 1) {
      PatchImage out = somewhere(patch, kNoTexturePage, {1, 1}, 16);
      out.in_tail = true;
      return out;
    }
    if (patch % 3 != 0) return {};
    const uint16_t second = patch % 2;
    return somewhere(patch, static_cast<int8_t>(patch / 3 % 3), {0, second}, 100 << (patch / 3 % 3));
  }
  uint16_t height(uint32_t, int, int) const override { return 27'306; }
  Result<void> texels(uint32_t patch, std::span<uint8_t> out) const override {
    if (textureDepthOf(patch) == 0) return NoisyPatches::texels(patch, out);
    for (size_t i = 0; i < out.size(); ++i) out[i] = static_cast<uint8_t>(mixBits(patch + 99 * i));
    return {};
  }

 private:
  static BaseMesh cut(BaseMesh base) {
    base.cut = true;
    return base;
  }
  std::vector<Picture> pictures_;
  bool in_tails_;
};

BuildOptions optionsOf(const std::string& path) {
  BuildOptions options;
  options.output = path;
  options.workers = 2;
  options.texture_tolerance = kTextureTolerance;
  options.tool_version = "test";
  return options;
}

std::vector<uint8_t> channelsOf(const EncodedPage& page) {
  std::vector<uint8_t> channels(kTexturePageBytes);
  PageDecoder decoder;
  EXPECT_TRUE(decoder.decodeTexture(page.bytes, channels).ok());
  return channels;
}

TEST(PatchImages, PagesOfAPackageAreWhatItsImagesShow) {
  ScratchFolder folder;
  const ShowingPatches source;
  const std::string path = folder.file("a.relievo");
  const auto done = buildPatchPackage(source, optionsOf(path));
  ASSERT_TRUE(done.ok()) << done.error().text();
  auto opened = Package::open(path);
  ASSERT_TRUE(opened.ok()) << opened.error().text();
  const Package& package = **opened;
  EXPECT_TRUE(package.warnings().empty());
  EXPECT_EQ(packageVersion(package.header()), 17u);
  const auto shown = package.shownImages();
  EXPECT_EQ(shown.images, 2u);
  EXPECT_EQ(shown.patches, 8u);
  const auto report = verifyPackage(package, 2, nullptr);
  ASSERT_TRUE(report.ok());
  EXPECT_TRUE(report->damaged.empty() && report->other.empty());
  const PatchDomain& domain = package.manifest().domain;
  const std::vector<SourceImage> sources = source.images();
  const ShownImage first(sources[0]), second(sources[1]);
  int furthest = 0, pages = 0;
  for (uint32_t p = 0; p < domain.patchCount(); p += 3) {
    const PatchImage patch = source.imageOf(p);
    ASSERT_EQ(domain.textureDepthOf(p), patch.depth);
    EXPECT_EQ(package.header().domain.textureDepthOf(p), kNoTexturePage) << "the index has none of them";
    for (uint32_t level = 0; static_cast<int>(level) <= patch.depth; ++level)
      for (uint32_t k = 0; k < 1u << (2 * level); ++k, ++pages) {
        const NodeId node{p, level, k % (1u << level), k >> level};
        const ShownTexels which{7 + static_cast<int>(level), int64_t{node.x} * 128 - 4, int64_t{node.y} * 128 - 4, 136};
        std::vector<uint8_t> expected(kTexturePageBytes);
        showImages(patch, {&first, patch.image[1] == 0 ? &first : &second}, which, expected);
        auto page = package.read(PageId(texturePlane(0), node));
        ASSERT_TRUE(page.ok()) << page.error().text();
        EXPECT_EQ(page->storedBytes(), 0u) << "nothing is read for it";
        const auto found = channelsOf(*page);
        for (size_t i = 0; i < found.size(); ++i) furthest = std::max(furthest, std::abs(found[i] - expected[i]));
        showNormals(patch, which, expected);
        auto normals = package.read(PageId(texturePlane(1), node));
        ASSERT_TRUE(normals.ok());
        EXPECT_EQ(channelsOf(*normals), expected);
      }
    EXPECT_FALSE(package.read(PageId(texturePlane(0), {p, static_cast<uint32_t>(patch.depth) + 1, 0, 0})).ok());
  }
  EXPECT_EQ(pages, 3 * 1 + 3 * 5 + 2 * 21);
  EXPECT_LE(furthest, static_cast<int>(kTextureTolerance) + 1) << "images are kept within the tolerance";
  // Tails have the light of root pages, in the mean: theirs is a coarser level of the image.
  const PatchTails tails = package.wholeTails(1, nullptr);
  double furthest_tail = 0, control = 0, before = 0;
  for (uint32_t p = 0; p < domain.patchCount(); p += 3) {
    const auto root = channelsOf(*package.read(PageId(texturePlane(0), {p, 0, 0, 0})));
    double of_root = 0, of_tail = 0;
    for (size_t y = 4; y < 132; ++y)
      for (size_t x = 4; x < 132; ++x) of_root += linearFromSrgb(root[y * 136 + x] / 255.0) / (128 * 128);
    for (int i = 0; i < 256; ++i) of_tail += linearFromSrgb(tails.level(p, 0, 0)[i] / 255.0) / 256;
    const double light = 255 * srgbFromLinear(of_root), tail_light = 255 * srgbFromLinear(of_tail);
    furthest_tail = std::max(furthest_tail, std::abs(tail_light - light));
    control = std::max(control, p > 0 ? std::abs(before - light) : 0);
    before = tail_light;
  }
  EXPECT_LT(furthest_tail, 10) << "of needles, up to 400 texels long";
  EXPECT_GT(control, 15) << "another patch's";
}

// Their tails take no bytes: they follow from the images, as those of patches that have nothing but a tail.
TEST(PatchImages, TailsAreMadeOfThem) {
  ScratchFolder folder;
  const ShowingPatches source(pictureOf(64, 130, false, 6), true);
  BuildOptions options = optionsOf(folder.file("a.relievo"));
  options.texture_tolerance = 0;  // images are stored as they are
  ASSERT_TRUE(buildPatchPackage(source, options).ok());
  auto package = *Package::open(options.output);
  EXPECT_EQ(packageVersion(package->header()), 17u);
  EXPECT_EQ(package->shownImages().patches, 16u);
  const auto report = verifyPackage(*package, 2, nullptr);
  ASSERT_TRUE(report.ok());
  EXPECT_TRUE(report->damaged.empty() && report->other.empty());
  options.output = folder.file("b.relievo");
  options.image_tails = false;
  ASSERT_TRUE(buildPatchPackage(source, options).ok());
  auto before = *Package::open(options.output);
  EXPECT_EQ(packageVersion(before->header()), 14u);
  EXPECT_EQ(before->shownImages().patches, 8u);
  const PatchTails tails = package->wholeTails(2, nullptr);
  PatchTails stored = before->wholeTails(2, nullptr);
  const std::vector<SourceImage> images = source.images();
  const ShownImage first(images[0]), second(images[1]);
  const MipFilter mip(source.format());
  std::vector<uint8_t> expected(6 * kTailPatchTexels);
  double furthest = 0;
  for (uint32_t p = 0; p < 24; ++p) {
    const PatchImage patch = source.imageOf(p);
    const auto found = std::span(tails.texels).subspan(p * tails.patchTexels(), tails.patchTexels());
    if (!patch.shows()) {
      EXPECT_TRUE(std::ranges::equal(found, stored.texelsOf(p))) << p << ": others are stored";
      continue;
    }
    tailOfImages(patch, {patch.image[0] ? &second : &first, patch.image[1] ? &second : &first}, mip, expected);
    EXPECT_TRUE(std::ranges::equal(found, expected)) << p;
    EXPECT_EQ(package->manifest().domain.textureDepthOf(p), patch.depth);
    if (!patch.in_tail) continue;
    EXPECT_FALSE(package->read(PageId(texturePlane(0), {p, 0, 0, 0})).ok()) << p << ": it has no page";
    EXPECT_FALSE(std::ranges::equal(found, stored.texelsOf(p))) << "control: its own texels, which are not asked for";
    // The colours are the image's, whatever makes them: at a texel's middle, at level 0.
    ASSERT_EQ(std::max(shownLevel(patch.at[0], 4), shownLevel(patch.at[1], 4)), 0);
    for (int i = 0; i < 256; ++i) {
      const double u = (i % 16 + 0.5) / 16, v = (i / 16 + 0.5) / 16;
      const size_t half = v > u;
      const double along = half ? v : u, across = half ? u : v;
      const glm::dvec2 at =
          (glm::dvec2(patch.at[half][0]) * (1 - along) + glm::dvec2(patch.at[half][1]) * (along - across) +
           glm::dvec2(patch.at[half][2]) * across) /
          256.0;
      const SourceImage& image = images[patch.image[half]];
      const TrueLevel level{image.width, image.height, {image.rgb.begin(), image.rgb.end()}};
      for (int c = 0; c < 3; ++c)
        furthest = std::max(furthest, std::abs(tails.level(p, 0, c)[i] - bilinear(level, false, at.x, at.y, c)));
    }
  }
  EXPECT_LE(furthest, 3) << "places and weights are 256ths";
  // 16 tails of 2,040 texels.
  const auto tailBytes = [](const Package& of) { return of.tailBytes()->all; };
  EXPECT_LT(tailBytes(*package) + 8'000, tailBytes(*before));
}

// Patches that have colours of corners, of both kinds: some whose tails show all of them, and some at levels 0 to 2.
// Heights are in steps of that many mm.
class ColouredPatches : public NoisyPatches {
 public:
  explicit ColouredPatches(double scale_mm = 1e-4) : NoisyPatches(cutBase(), 0, 0, kSeed), scale_mm_(scale_mm) {}
  double reliefScaleMm() const override { return scale_mm_; }
  int textureDepth() const override { return 2; }
  int textureDepthOf(uint32_t) const override { return kNoTexturePage; }
  bool showsImages() const override { return true; }
  PatchImage imageOf(uint32_t patch) const override {
    PatchImage out = somewhere(patch, static_cast<int8_t>(patch % 4 - 1), {kCornerColours, kCornerColours}, 16);
    out.in_tail = patch % 4 == 0;
    for (size_t half = 0; half < 2; ++half)
      for (size_t k = 0; k < 3; ++k) {
        const uint64_t at = mixBits(9 * patch + 3 * half + k);
        out.colour[half][k] = {at % 256, at / 256 % 256, at / 65536 % 256};
      }
    return out;
  }
  uint16_t height(uint32_t, int, int) const override { return 27'306; }
  Result<void> texels(uint32_t patch, std::span<uint8_t> out) const override {
    std::fill(out.begin(), out.end(), static_cast<uint8_t>(patch));
    return {};
  }

 private:
  static BaseMesh cutBase() {
    BaseMesh base = cubeSphere(2, 100, kSeed);
    base.cut = true;
    return base;
  }
  double scale_mm_;
};

// Where all tails follow from images and heights are all the same, what is stored of them is not read.
TEST(PatchImages, TailsThatAreMadeOfImagesAreNotRead) {
  ScratchFolder folder;
  for (const double scale_mm : {0.0, 1e-4}) {
    const BuildOptions options = optionsOf(folder.file("a.relievo"));
    ASSERT_TRUE(buildPatchPackage(ColouredPatches(scale_mm), options).ok());
    const PatchTails before = (*Package::open(options.output))->wholeTails(1, nullptr);
    const uint64_t directory = (*Package::open(options.output))->header().tails_offset;
    {  // of the one chunk
      std::fstream out(options.output, std::ios::in | std::ios::out | std::ios::binary);
      std::array<char, 8> place{};
      out.seekg(static_cast<std::streamoff>(directory + kTailsHeadBytes)).read(place.data(), 8);
      const auto chunk = static_cast<std::streamoff>(std::bit_cast<uint64_t>(place));
      out.seekg(chunk + 9).read(place.data(), 1);
      place[0] = static_cast<char>(place[0] ^ 1);
      out.seekp(chunk + 9).write(place.data(), 1);
      ASSERT_TRUE(out.good());
    }
    auto package = *Package::open(options.output);
    std::vector<std::string> problems;
    const PatchTails after = package->wholeTails(1, &problems);
    EXPECT_EQ(problems.empty(), scale_mm == 0);
    if (scale_mm == 0) {
      EXPECT_EQ(after.texels, before.texels);
    }
    const auto report = verifyPackage(*package, 1, nullptr);
    ASSERT_TRUE(report.ok());
    EXPECT_FALSE(report->damaged.empty() && report->other.empty()) << "whoever checks a package is told";
  }
}

// Pages without bytes do not count where very many would wait for the index to be coded.
TEST(PatchImages, TheIndexIsCodedUnlessPagesOfManyBytesWaitForIt) {
  class EvenPatches final : public ColouredPatches {
   public:
    EvenPatches() : ColouredPatches(0) {}
    bool patchesAreEven() const override { return true; }
  };
  ScratchFolder folder;
  BuildOptions options = optionsOf(folder.file("a.relievo"));
  for (const uint64_t most : {23, 24}) {
    options.most_coded_pages = most;
    ASSERT_TRUE(buildPatchPackage(ColouredPatches(), options).ok());
    EXPECT_EQ((*Package::open(options.output))->header().coded_index, most == 24) << "24 pages of relief";
    ASSERT_TRUE(buildPatchPackage(EvenPatches(), options).ok());
    EXPECT_TRUE((*Package::open(options.output))->header().coded_index);
  }
}

TEST(PatchImages, APackageHasColoursOfCorners) {
  ScratchFolder folder;
  const ColouredPatches source;
  BuildOptions options = optionsOf(folder.file("a.relievo"));
  ASSERT_TRUE(buildPatchPackage(source, options).ok());
  auto opened = Package::open(options.output);
  ASSERT_TRUE(opened.ok()) << opened.error().text();
  const Package& package = **opened;
  EXPECT_TRUE(package.warnings().empty());
  EXPECT_EQ(packageVersion(package.header()), 18u);
  const auto shown = package.shownImages();
  EXPECT_EQ(shown.images, 0u);
  EXPECT_EQ(shown.patches, 24u);
  EXPECT_TRUE(shown.corner_colours && !shown.one_colour);
  const auto report = verifyPackage(package, 2, nullptr);
  ASSERT_TRUE(report.ok());
  EXPECT_TRUE(report->damaged.empty() && report->other.empty());
  const PatchTails tails = package.wholeTails(2, nullptr);
  const MipFilter mip(source.format());
  int pages = 0;
  for (uint32_t p = 0; p < 24; ++p) {
    const PatchImage patch = source.imageOf(p);
    std::vector<uint8_t> tail(6 * kTailPatchTexels);
    tailOfImages(patch, {nullptr, nullptr}, mip, tail);
    EXPECT_TRUE(std::ranges::equal(std::span(tails.texels).subspan(p * tails.patchTexels(), tails.patchTexels()), tail))
        << p;
    ASSERT_EQ(package.manifest().domain.textureDepthOf(p), patch.depth);
    for (int level = 0; level <= patch.depth; ++level, ++pages) {
      const NodeId node{p, static_cast<uint32_t>(level), 0, 0};
      std::vector<uint8_t> expected(kTexturePageBytes);
      showImages(patch, {nullptr, nullptr}, {7 + level, -4, -4, 136}, expected);
      auto page = package.read(PageId(texturePlane(0), node));
      ASSERT_TRUE(page.ok()) << page.error().text();
      EXPECT_EQ(channelsOf(*page), expected);
    }
  }
  EXPECT_EQ(pages, 6 * (1 + 2 + 3));
  // Where no patch may have them, texels are stored.
  options.output = folder.file("b.relievo");
  options.base_parity = false;
  ASSERT_TRUE(buildPatchPackage(source, options).ok());
  auto before = Package::open(options.output);
  ASSERT_TRUE(before.ok()) << before.error().text();
  EXPECT_EQ(packageVersion((*before)->header()), 16u);
  EXPECT_EQ((*before)->shownImages().patches, 0u);
}

// In place of a copy of its base mesh a package has what makes it good: fewer bytes, and as little is lost.
TEST(PatchImages, ADamagedBaseMeshIsMadeGoodByItsParity) {
  ScratchFolder folder;
  const ShowingPatches source(pictureOf(64, 130, false, 6), true);
  BuildOptions options = optionsOf(folder.file("a.relievo"));
  ASSERT_TRUE(buildPatchPackage(source, options).ok());
  options.output = folder.file("b.relievo");
  options.base_parity = false;
  ASSERT_TRUE(buildPatchPackage(source, options).ok());
  const auto package = *Package::open(folder.file("a.relievo")), before = *Package::open(options.output);
  const PackageHeader h = package->header();
  EXPECT_EQ(packageVersion(h), 17u);
  EXPECT_EQ(packageVersion(before->header()), 16u);
  EXPECT_TRUE(package->wholeTails(1, nullptr) == before->wholeTails(1, nullptr)) << "the same artwork";
  EXPECT_EQ(h.base_bytes, before->header().base_bytes);
  EXPECT_LT(h.baseCopyBytes(), h.base_bytes / 2);
  const std::vector<uint8_t> sound = readAll(folder.file("a.relievo"));
  const std::string path = folder.file("c.relievo");
  struct Fault {
    uint64_t at, count;
    std::string what, hint;
  };
  const std::string base_at = " at byte " + std::to_string(h.base_offset),
                    parity_at = " at byte " + std::to_string(h.base_copy_offset);
  for (const Fault& fault : {Fault{h.base_offset, 1, "the base mesh", "parity"},
                             Fault{h.base_offset + 40, parityBlockBytes(h.base_bytes), "the base mesh", "parity"},
                             Fault{h.base_copy_offset + 20, 1, "the base mesh's parity", "base mesh"},
                             Fault{h.base_copy_offset + 150, 7, "the base mesh's parity", "base mesh"}}) {
    std::vector<uint8_t> broken = sound;
    for (uint64_t i = 0; i < fault.count; ++i) broken[fault.at + i] ^= 0x21;
    writeAll(path, broken);
    auto damaged = Package::open(path);
    ASSERT_TRUE(damaged.ok()) << damaged.error().text();
    EXPECT_EQ(*(*damaged)->manifest().base, *package->manifest().base);
    const bool of_base = fault.hint == "parity";
    ASSERT_EQ((*damaged)->warnings().size(), of_base ? 1u : 0u) << "nobody needs the parity";
    if (of_base) {
      EXPECT_EQ((*damaged)->warnings()[0], "the base mesh" + base_at + " is damaged; its parity makes it good");
    }
    const auto report = verifyPackage(**damaged, 1, nullptr);
    ASSERT_TRUE(report.ok());
    ASSERT_EQ(report->other.size(), 1u);
    EXPECT_EQ(report->other[0], fault.what + (of_base ? base_at : parity_at) + " is damaged; the base mesh" +
                                    (of_base ? "'s parity" + parity_at : base_at) + " makes it good");
    const auto repaired = repairPackage(path);
    ASSERT_TRUE(repaired.ok()) << repaired.error().text();
    EXPECT_EQ(repaired->size(), 1u);
    EXPECT_TRUE(readAll(path) == sound);
  }
  // Negative control: half of it gone.
  std::vector<uint8_t> broken = sound;
  for (uint64_t i = 0; i < h.base_bytes / 2; ++i) broken[h.base_offset + i] ^= 0x21;
  writeAll(path, broken);
  const auto lost = Package::open(path);
  ASSERT_FALSE(lost.ok());
  EXPECT_NE(lost.error().text().find("the base mesh is damaged: its checksum does not match"), std::string::npos);
  EXPECT_FALSE(repairPackage(path).ok());
  EXPECT_TRUE(readAll(path) == broken);
}

// What cannot be had of an image is grey, and is named; all else is there.
TEST(PatchImages, TailsOfDamagedImagesAreNeutral) {
  ScratchFolder folder;
  const ShowingPatches source(pictureOf(64, 130, false, 6), true);
  const std::string path = folder.file("a.relievo");
  ASSERT_TRUE(buildPatchPackage(source, optionsOf(path)).ok());
  const PackageHeader h = (*Package::open(path))->header();
  PatchTails sound = (*Package::open(path))->wholeTails(1, nullptr);
  std::vector<uint8_t> neutral(6 * kTailPatchTexels);
  neutralTail(h.texture, neutral);
  for (const bool directory : {false, true}) {
    std::vector<uint8_t> bytes = readAll(path);
    // The first tile of the first image, or the directory.
    bytes[directory ? h.images_offset + 30 : h.tilesOffset() + 20] ^= 0x55;
    writeAll(folder.file("b.relievo"), bytes);
    const auto damaged = *Package::open(folder.file("b.relievo"));
    std::vector<std::string> problems;
    PatchTails found = damaged->wholeTails(2, &problems);
    uint64_t lost = 0;
    for (uint32_t p = 0; p < 24; ++p) {
      const PatchImage patch = source.imageOf(p);
      const bool is_lost = patch.shows() && (directory || patch.image[0] == 0 || patch.image[1] == 0);
      const auto texels = found.texelsOf(p);
      EXPECT_TRUE(std::ranges::equal(texels, is_lost ? std::span<uint8_t>(neutral) : sound.texelsOf(p))) << p;
      lost += is_lost;
    }
    EXPECT_EQ(lost, directory ? 16u : 8u);
    EXPECT_EQ(found.failures.pages, directory ? 0 : lost) << "nobody knows which ones a lost directory named";
    EXPECT_EQ(problems.size(), directory ? 0u : 1u);
    EXPECT_EQ(damaged->warnings().size(), directory ? 1u : 0u);
    const std::string said = directory ? damaged->warnings()[0] : problems[0];
    EXPECT_NE(
        said.find(directory ? "patches that show them are grey" : "tile 0 of image 0: its checksum does not match"),
        std::string::npos)
        << said;
  }
}

// A page's size, as the encoder of pages makes it.
Picture jpegPicture(bool fill, bool plain = false) {
  Picture p = pictureOf(kPageFullPx, kPageFullPx, false, 6);
  if (plain) std::fill(p.rgb.begin(), p.rgb.end(), 100);
  std::vector<uint8_t> texels, room(1 << 20);
  for (size_t i = 0; i < p.rgb.size(); ++i) {
    texels.push_back(p.rgb[i]);
    if (i % 3 == 2) texels.push_back(255);
  }
  JpegPageEncoder encoder;
  room.resize(encoder.encode(texels.data(), 30, true, room));
  p.jpeg = plainJpeg(room);
  p.fill = fill;
  auto reader = ImageJpegReader::open(p.jpeg, kPageFullPx, kPageFullPx);
  EXPECT_TRUE(reader.ok() && reader->read(kPageFullPx, p.rgb).ok());
  return p;
}

TEST(PatchImages, AnImageThatCameAsAJpegStaysOne) {
  ScratchFolder folder;
  for (const bool fill : {false, true}) {
    const ShowingPatches source(jpegPicture(fill));
    BuildOptions options = optionsOf(folder.file("a.relievo"));
    options.image_tails = false;
    ASSERT_TRUE(buildPatchPackage(source, options).ok());
    auto opened = Package::open(options.output);
    ASSERT_TRUE(opened.ok()) << opened.error().text();
    const Package& package = **opened;
    EXPECT_EQ(packageVersion(package.header()), 15u);
    const auto report = verifyPackage(package, 2, nullptr);
    ASSERT_TRUE(report.ok());
    EXPECT_TRUE(report->damaged.empty() && report->other.empty());
    std::vector<PatchImage> patches;
    for (uint32_t p = 0; p < 24; ++p) patches.push_back(source.imageOf(p));
    SourceImage second = source.images()[1];
    std::vector<uint8_t> rgb(second.rgb.begin(), second.rgb.end());
    if (fill) fillImage(second, 1, {second.width, second.height}, patches, rgb);
    EXPECT_EQ(rgb != std::vector<uint8_t>(second.rgb.begin(), second.rgb.end()), fill) << "some of it is not shown";
    second.rgb = rgb;
    const ShownImage first(source.images()[0]), jpeg(second);
    int exact = 0;
    for (uint32_t p = 0; p < 24; p += 3) {
      const ShownTexels which{7, -4, -4, 136};
      std::vector<uint8_t> expected(kTexturePageBytes);
      showImages(patches[p], {&first, patches[p].image[1] == 0 ? &first : &jpeg}, which, expected);
      const auto found = channelsOf(*package.read(PageId(texturePlane(0), {p, 0, 0, 0})));
      // On the half that shows the JPEG, without any tolerance.
      bool same = patches[p].image[1] == 1;
      for (size_t i = 0; i < found.size(); ++i)
        if (i / 136 % 136 > i % 136) same &= found[i] == expected[i];
      exact += same;
    }
    EXPECT_EQ(exact, 4);
  }
  // Without it the same image takes tiles, and the package is of the version before.
  Picture plain = jpegPicture(false);
  plain.jpeg.clear();
  BuildOptions options = optionsOf(folder.file("b.relievo"));
  options.image_tails = false;
  ASSERT_TRUE(buildPatchPackage(ShowingPatches(plain), options).ok());
  EXPECT_EQ(packageVersion((*Package::open(folder.file("b.relievo")))->header()), 14u);
  EXPECT_GT(std::filesystem::file_size(folder.file("b.relievo")),
            std::filesystem::file_size(folder.file("a.relievo")) + 10'000);
  // Nor is one kept whose tiles take fewer bytes.
  options.output = folder.file("c.relievo");
  ASSERT_TRUE(buildPatchPackage(ShowingPatches(jpegPicture(false, true)), options).ok());
  EXPECT_EQ(packageVersion((*Package::open(options.output))->header()), 14u);
}

TEST(PatchImages, ManyTexelsMakeAPackageOfVersion19) {
  ScratchFolder folder;
  Picture large{8192, 6148, false, {}, false, {}};
  large.rgb.assign(size_t{3} * 8192 * 6148, 100);
  ASSERT_TRUE(buildPatchPackage(ShowingPatches(std::move(large)), optionsOf(folder.file("a.relievo"))).ok());
  EXPECT_EQ(packageVersion((*Package::open(folder.file("a.relievo")))->header()), 19u);
  // Of too many none is built, whatever they look like.
  const auto built =
      buildPatchPackage(ShowingPatches(Picture{8192, 10244, false, {}, false, {}}), optionsOf(folder.file("b")));
  ASSERT_FALSE(built.ok());
  EXPECT_EQ(built.error().kind, ErrorKind::kUsage);
  BuildOptions old = optionsOf(folder.file("b"));
  old.base_parity = false;
  EXPECT_FALSE(buildPatchPackage(ShowingPatches(Picture{8192, 6148, false, {}, false, {}}), old).ok());
}

TEST(PatchImages, BesideThemOwnColoursGoOn) {
  ScratchFolder folder;
  const ShowingPatches source;
  ASSERT_TRUE(buildPatchPackage(source, optionsOf(folder.file("a.relievo"))).ok());
  auto package = *Package::open(folder.file("a.relievo"));
  const auto neighbours = patchNeighbours(source.base());
  double beside = 0, apart = 1e9;
  for (uint32_t p = 0; p < 24; ++p) {
    if (p % 3 == 0) continue;
    const auto page = channelsOf(*package->read(PageId(texturePlane(0), {p, 0, 0, 0})));
    double differs = 0;
    for (size_t y = 40; y < 100; ++y) differs += std::abs(page[y * 136 + 3] - page[y * 136 + 4]) / 60.0;
    if (neighbours[p][kLeft].patch % 3 == 0) beside = std::max(beside, differs);
    else apart = std::min(apart, differs);
  }
  EXPECT_LE(beside, 2) << "but for the tolerance";
  EXPECT_GT(apart, 10) << "control: others' colours are noise";
}

TEST(PatchImages, WhatIsDamagedIsFoundAndTheRestIsShown) {
  ScratchFolder folder;
  const ShowingPatches source;
  const std::string path = folder.file("a.relievo");
  ASSERT_TRUE(buildPatchPackage(source, optionsOf(path)).ok());
  const PackageHeader h = (*Package::open(path))->header();
  auto damage = [&](uint64_t offset) {
    const std::string copy = folder.file("b.relievo");
    std::filesystem::copy_file(path, copy, std::filesystem::copy_options::overwrite_existing);
    std::fstream file(copy, std::ios::in | std::ios::out | std::ios::binary);
    file.seekg(static_cast<std::streamoff>(offset));
    const char byte = static_cast<char>(file.get() ^ 0x55);
    file.seekp(static_cast<std::streamoff>(offset));
    file.put(byte);
    file.close();
    return *Package::open(copy);
  };
  auto others = [](const Package& package) {
    const auto report = verifyPackage(package, 1, nullptr);
    return report.ok() ? report->other : std::vector<std::string>{"none"};
  };
  const PageId shown(texturePlane(0), {0, 0, 0, 0}), stored(texturePlane(0), {1, 0, 0, 0});
  const auto tile = damage(h.tilesOffset() + 20);
  ASSERT_EQ(others(*tile).size(), 1u);
  EXPECT_NE(others(*tile)[0].find("tile 0 of image 0: its checksum does not match"), std::string::npos);
  const auto page = tile->read(shown);
  ASSERT_FALSE(page.ok());
  EXPECT_EQ(page.error().kind, ErrorKind::kInvalidData);
  EXPECT_TRUE(tile->read(stored).ok());
  const auto directory = damage(h.images_offset + 30);
  ASSERT_EQ(directory->warnings().size(), 1u);
  EXPECT_NE(directory->warnings()[0].find("directory's checksum does not match"), std::string::npos);
  EXPECT_EQ(directory->manifest().domain.textureDepthOf(0), kNoTexturePage) << "its tail stands in";
  EXPECT_FALSE(directory->read(shown).ok());
  EXPECT_TRUE(directory->read(stored).ok());
  EXPECT_EQ(others(*directory).size(), 1u);
  // Cut off before the images.
  const std::string cut = folder.file("c.relievo");
  std::filesystem::copy_file(path, cut);
  std::filesystem::resize_file(cut, h.tilesOffset() + 10);
  auto opened = Package::open(cut);
  ASSERT_TRUE(opened.ok()) << opened.error().text();
  EXPECT_FALSE((*opened)->read(shown).ok());
  EXPECT_TRUE((*opened)->read(stored).ok());
}

// Tails' colours end at edges in version 14 alone; images are the same in both.
TEST(PatchImages, AreThoseOfVersionThirteen) {
  ScratchFolder folder;
  const ShowingPatches source;
  BuildOptions options = optionsOf(folder.file("a.relievo"));
  options.image_tails = false;
  ASSERT_TRUE(buildPatchPackage(source, options).ok());
  const auto now = *Package::open(options.output);
  options.output = folder.file("b.relievo");
  options.tail_edges = false;
  ASSERT_TRUE(buildPatchPackage(source, options).ok());
  const auto before = *Package::open(options.output);
  EXPECT_EQ(packageVersion(before->header()), 13u);
  EXPECT_TRUE(now->manifest().tail_edges && !before->manifest().tail_edges);
  EXPECT_EQ(now->shownImages().patches, before->shownImages().patches);
  const PageId page(texturePlane(0), {3, 1, 1, 0});
  EXPECT_EQ(channelsOf(*now->read(page)), channelsOf(*before->read(page)));
  // Fields of version 14: what ends as no reader knows, images as none knows, and none at all.
  const std::vector<uint8_t> bytes = readAll(folder.file("a.relievo"));
  auto refusal = [&](size_t field, uint32_t value) {
    std::vector<uint8_t> header(bytes.begin(), bytes.begin() + kHeaderBytes);
    storeLittle(header.data() + field, value);
    storeLittle(header.data() + kHeaderBytes - 8, XXH3_64bits(header.data(), kHeaderBytes - 8));
    const auto decoded = decodeHeader(header, "a.relievo");
    return decoded ? std::string() : decoded.error().text();
  };
  EXPECT_EQ(refusal(2084, 1), "") << "control";
  EXPECT_NE(refusal(2084, 2).find("expected colours of tails that end by kind 1 in version 14, found 2"),
            std::string::npos);
  EXPECT_NE(refusal(2080, 2).find("expected images of kind 1 in version 14, found 2"), std::string::npos);
  EXPECT_EQ(refusal(2080, 0), "") << "no images are there";
  EXPECT_NE(refusal(2076, 0).find("expected cut patches with normals in version 14"), std::string::npos);
}

TEST(PatchImages, NeedAPackageThatHasThem) {
  ScratchFolder folder;
  const ShowingPatches source;
  for (const int left_out : {0, 1}) {
    BuildOptions options = optionsOf(folder.file("a.relievo"));
    if (left_out == 0) options.base_by_border = false;
    else options.texture_tolerance = -1;
    const auto done = buildPatchPackage(source, options);
    ASSERT_FALSE(done.ok());
    EXPECT_EQ(done.error().kind, ErrorKind::kUsage);
  }
}

}  // namespace patch_images_test
}  // namespace relievo
