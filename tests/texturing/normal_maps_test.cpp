// Maps of normals of images that patches show: tangent frames and shown normals against the same in double precision,
// by other code; what a package keeps of them; and what is shown where one is damaged.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "patch_fixture.h"
#include "texturing/codec/image_jpeg.h"
#include "texturing/codec/page_jpeg_codec.h"
#include "texturing/package/package.h"
#include "texturing/package/package_layout.h"
#include "texturing/package/package_tails.h"
#include "texturing/package/patch_images.h"
#include "texturing/package/patch_package_builder.h"
#include "texturing/package/texture_depths.h"

namespace relievo {
namespace normal_maps_test {

using namespace testing_support;

constexpr uint32_t kAcross = 6;  // patches

double heightAt(double x, double y) { return 1.5 * std::sin(0.4 * x) * std::cos(0.5 * y); }
glm::dvec3 normalAt(double x, double y) {
  return glm::normalize(
      glm::dvec3(-0.6 * std::cos(0.4 * x) * std::cos(0.5 * y), 0.75 * std::sin(0.4 * x) * std::sin(0.5 * y), 1));
}
// Waves, seen from above: u to the right, v downwards.
BaseMesh wavyBase() {
  BaseMesh base;
  for (uint32_t j = 0; j <= kAcross; ++j)
    for (uint32_t i = 0; i <= kAcross; ++i) {
      const double x = i, y = -static_cast<double>(j);
      base.corners.push_back({glm::vec3(x, y, heightAt(x, y)), glm::vec3(normalAt(x, y))});
    }
  for (uint32_t j = 0; j < kAcross; ++j)
    for (uint32_t i = 0; i < kAcross; ++i) {
      const uint32_t c = j * (kAcross + 1) + i;
      base.patches.push_back({c, c + 1, c + kAcross + 1, c + kAcross + 2});
    }
  base.cut = true;
  return base;
}

struct Picture {
  int width, height;
  std::vector<uint8_t> rgb;
};
// Smooth waves of unit normals, up to 60 degrees off.
Picture normalPicture(int width, int height) {
  Picture p{width, height, {}};
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const glm::dvec3 n = glm::normalize(glm::dvec3(1.2 * std::sin(0.09 * x + 0.03 * y), 1.2 * std::cos(0.08 * y), 1));
      for (int c = 0; c < 3; ++c) p.rgb.push_back(static_cast<uint8_t>(std::lround(127.5 * n[c] + 127.5)));
    }
  return p;
}
Picture colourPicture(int width, int height) {
  Picture p{width, height, {}};
  for (int i = 0; i < 3 * width * height; ++i) p.rgb.push_back(static_cast<uint8_t>(90 + i % 97));
  return p;
}
SourceImage sourceOf(const Picture& p, bool normals = false, bool downwards = false) {
  return {.width = p.width,
          .height = p.height,
          .repeats = false,
          .rgb = p.rgb,
          .is_normals = normals,
          .normals_downwards = downwards};
}

// Where a corner of the base lies in the image, in texels; from the fourth column of patches on it is mirrored.
glm::dvec2 placeAt(double x, double y, bool mirrored, double scale) {
  const glm::dvec2 at(20 + 9 * x + 2 * y, 15 - 3 * x - 8 * y);
  return scale * (mirrored ? glm::dvec2(140 - at.x, at.y) : at);
}
PatchImage imageOfPatch(const BaseMesh& base, uint32_t p, double scale, int8_t depth) {
  PatchImage out;
  out.depth = depth;
  const bool mirrored = p % kAcross >= kAcross / 2;
  for (size_t half = 0; half < 2; ++half)
    for (size_t k = 0; k < 3; ++k) {
      const BaseCorner& c = base.corners[base.patches[p][k == 0 ? 0 : k == 2 ? 3 : half == 0 ? 1 : 2]];
      out.at[half][k] =
          glm::ivec2(glm::round(256.0 * placeAt(double{c.position_mm.x}, double{c.position_mm.y}, mirrored, scale)));
      out.normal[half][k] = glm::u8vec3(glm::round(127.5 * (glm::dvec3(c.normal) + 1.0)));
    }
  return out;
}
std::vector<PatchImage> allPatches(const BaseMesh& base, double scale, int8_t depth = 0) {
  std::vector<PatchImage> out;
  for (uint32_t p = 0; p < base.patches.size(); ++p) out.push_back(imageOfPatch(base, p, scale, depth));
  return out;
}

// ---- the same by other code: every half looks at every other ----
struct TrueHalf {
  std::array<glm::dvec3, 3> position, normal;
  std::array<glm::dvec2, 3> place;  // y upwards
  std::array<uint32_t, 3> corner;
  glm::dvec3 along;  // of the image's columns
  bool mirrored;
};
std::vector<TrueHalf> trueHalves(const BaseMesh& base, const std::vector<PatchImage>& patches) {
  std::vector<TrueHalf> out;
  for (uint32_t p = 0; p < patches.size(); ++p)
    for (size_t half = 0; half < 2; ++half) {
      TrueHalf h{};
      for (size_t k = 0; k < 3; ++k) {
        h.corner[k] = base.patches[p][k == 0 ? 0 : k == 2 ? 3 : half == 0 ? 1 : 2];
        h.position[k] = glm::dvec3(base.corners[h.corner[k]].position_mm);
        h.normal[k] = glm::normalize(glm::dvec3(patches[p].normal[half][k]) / 127.5 - 1.0);
        h.place[k] = {patches[p].at[half][k].x, -patches[p].at[half][k].y};
      }
      // dP = M dplace in the triangle's plane.
      const glm::dmat2 places(h.place[1] - h.place[0], h.place[2] - h.place[0]);
      const glm::dmat2 inverse = glm::inverse(places);
      const glm::dvec3 e = h.position[1] - h.position[0], f = h.position[2] - h.position[0];
      const glm::dvec3 of_x = e * inverse[0][0] + f * inverse[0][1], of_y = e * inverse[1][0] + f * inverse[1][1];
      h.along = of_x;
      h.mirrored = glm::dot(glm::cross(of_x, of_y), h.normal[0] + h.normal[1] + h.normal[2]) < 0;
      out.push_back(h);
    }
  return out;
}
double angleAt(const TrueHalf& h, size_t k) {
  const glm::dvec3 a = glm::normalize(h.position[(k + 1) % 3] - h.position[k]),
                   b = glm::normalize(h.position[(k + 2) % 3] - h.position[k]);
  return std::acos(std::clamp(glm::dot(a, b), -1.0, 1.0));
}
glm::dvec3 trueTangent(const std::vector<TrueHalf>& halves, size_t of, size_t k) {
  const TrueHalf& own = halves[of];
  glm::dvec3 sum(0);
  for (const TrueHalf& h : halves)
    for (size_t j = 0; j < 3; ++j)
      if (h.corner[j] == own.corner[k] && h.place[j] == own.place[k] && h.mirrored == own.mirrored)
        sum += angleAt(h, j) * glm::normalize(h.along - glm::dot(h.along, h.normal[j]) * h.normal[j]);
  return glm::normalize(sum);
}
double bilinear(const Picture& p, double x, double y, int c) {
  const double i = std::floor(x - 0.5), j = std::floor(y - 0.5), f = x - 0.5 - i, g = y - 0.5 - j;
  auto at = [&](double px, double py) {
    const int tx = std::clamp(static_cast<int>(px), 0, p.width - 1),
              ty = std::clamp(static_cast<int>(py), 0, p.height - 1);
    return static_cast<double>(p.rgb[static_cast<size_t>(3 * (ty * p.width + tx) + c)]);
  };
  return (at(i, j) * (1 - f) + at(i + 1, j) * f) * (1 - g) + (at(i, j + 1) * (1 - f) + at(i + 1, j + 1) * f) * g;
}
// At (u, v) of a patch; places count texels of the map, `scale` of a place's each.
glm::dvec3 trueNormal(const std::vector<TrueHalf>& halves, uint32_t patch, double u, double v, const Picture& map,
                      double scale, bool downwards) {
  const size_t half = v > u;
  const size_t number = 2 * patch + half;
  const TrueHalf& h = halves[number];
  const double along = half ? v : u, across = half ? u : v;
  const std::array<double, 3> w{1 - along, along - across, across};
  glm::dvec3 n(0), t(0), b(0);
  glm::dvec2 at(0);
  for (size_t k = 0; k < 3; ++k) {
    const glm::dvec3 tangent = trueTangent(halves, number, k);
    n += w[k] * h.normal[k];
    t += w[k] * tangent;
    b += w[k] * (h.mirrored != downwards ? -1.0 : 1.0) * glm::cross(h.normal[k], tangent);
    at += w[k] * glm::dvec2(h.place[k].x, -h.place[k].y) / 256.0;
  }
  glm::dvec3 m;
  for (int c = 0; c < 3; ++c) m[c] = bilinear(map, at.x * scale, at.y * scale, c) / 127.5 - 1;
  return glm::normalize(m.x * t + m.y * b + m.z * n);
}

NormalsOfHalves mapsOf(const ShownImage& map, const std::vector<TangentFrame>& frames, uint32_t patch) {
  return {ShownNormals{&map, frames[2 * patch]}, ShownNormals{&map, frames[2 * patch + 1]}};
}

TEST(NormalMaps, CornersShareTheirTangents) {
  const BaseMesh base = wavyBase();
  const std::vector<PatchImage> patches = allPatches(base, 1);
  const auto frames = framesOfHalves({HasNormals::kUpwards}, patches, base);
  const std::vector<TrueHalf> halves = trueHalves(base, patches);
  ASSERT_EQ(frames.size(), 2 * patches.size());
  double off = 0, own = 0;
  for (size_t p = 0; p < patches.size(); ++p)
    for (size_t half = 0; half < 2; ++half) {
      EXPECT_EQ(frames[2 * p + half].hand, halves[2 * p + half].mirrored ? -1 : 1) << p;
      for (size_t k = 0; k < 3; ++k) {
        const glm::dvec3 found(frames[2 * p + half].tangent[k]), n = halves[2 * p + half].normal[k];
        off = std::max(off, glm::distance(found, trueTangent(halves, 2 * p + half, k)));
        const glm::dvec3& along = halves[2 * p + half].along;
        own = std::max(own, glm::distance(found, glm::normalize(along - glm::dot(along, n) * n)));
        EXPECT_NEAR(glm::dot(found, n), 0, 1e-6);
      }
    }
  EXPECT_LT(off, 1e-5);
  EXPECT_GT(own, 0.05) << "control: each half's alone";
  // Without any map, of colours, or of a half without area in its image, there is none.
  EXPECT_TRUE(framesOfHalves({HasNormals::kNo}, patches, base).empty());
  std::vector<PatchImage> some = patches;
  some[3].at[0][1] = some[3].at[0][0];
  some[4].image[1] = kCornerColours;
  some[5] = {};
  const auto found = framesOfHalves({HasNormals::kDownwards}, some, base);
  EXPECT_FALSE(found[6].isKnown());
  EXPECT_TRUE(found[7].isKnown());
  EXPECT_FALSE(found[9].isKnown());
  EXPECT_FALSE(found[10].isKnown());
  EXPECT_EQ(found[0].hand, -frames[0].hand) << "y counts downwards";
}

TEST(NormalMaps, ShownNormalsAreThoseOfTheMapOnTheSurface) {
  const BaseMesh base = wavyBase();
  const Picture map = normalPicture(160, 90);
  for (const bool downwards : {false, true}) {
    // The map's texels are as large as places count, or half as large.
    for (const int times : {1, 2}) {
      const std::vector<PatchImage> patches = allPatches(base, times);
      const std::vector<TrueHalf> halves = trueHalves(base, patches);
      const ShownImage shown(sourceOf(map, true), {160 * times, 90 * times});
      const auto frames = framesOfHalves({downwards ? HasNormals::kDownwards : HasNormals::kUpwards}, patches, base);
      double off = 0, smooth = 0, other = 0;
      for (const uint32_t p : {0u, 8u, 16u, 23u, 35u}) {
        const ShownTexels which{5, 0, 0, 32};
        std::vector<uint8_t> out(3 * 32 * 32), plain(out.size()), turned(out.size());
        showNormals(patches[p], which, out, mapsOf(shown, frames, p));
        showNormals(patches[p], which, plain);
        auto wrong = frames;
        for (TangentFrame& f : wrong) f.hand = -f.hand;
        showNormals(patches[p], which, turned, mapsOf(shown, wrong, p));
        for (int j = 0; j < 32; ++j)
          for (int i = 0; i < 32; ++i) {
            const glm::dvec3 n = trueNormal(halves, p, (i + 0.5) / 32, (j + 0.5) / 32, map, 1.0 / times, downwards);
            for (int c = 0; c < 3; ++c) {
              const auto texel = static_cast<size_t>((c * 32 + j) * 32 + i);
              off = std::max(off, std::abs(out[texel] - (127.5 * n[c] + 127.5)));
              smooth = std::max(smooth, std::abs(plain[texel] - (127.5 * n[c] + 127.5)));
              other = std::max(other, std::abs(turned[texel] - (127.5 * n[c] + 127.5)));
            }
          }
      }
      EXPECT_LE(off, 1.7) << "the map's bytes, places and the normals' bytes are rounded";
      EXPECT_GT(smooth, 60) << "control: without the map";
      EXPECT_GT(other, 60) << "control: with y the other way";
    }
  }
}

TEST(NormalMaps, CoarserLevelsAreMeansOfNumbers) {
  const std::vector<uint8_t> rgb{0, 10, 200, 255, 20, 210, 0, 30, 220, 255, 40, 230};
  SourceImage image{.width = 2, .height = 2, .repeats = false, .rgb = rgb, .is_normals = true};
  const ShownImage normals(image);
  EXPECT_EQ(normals.sample(256, 256, 1, {}), (std::array<uint8_t, 3>{128, 25, 215}));
  image.is_normals = false;
  EXPECT_GT(ShownImage(image).sample(256, 256, 1, {})[0], 180) << "control: of colours the mean of light";
}

// Of an image whose texels are many more than a tail's, twice as many are shown and averaged.
TEST(NormalMaps, TailsHaveThem) {
  const BaseMesh base = wavyBase();
  const Picture map = normalPicture(320, 180), colours = colourPicture(320, 180);
  const ShownImage shown(sourceOf(map, true)), image(sourceOf(colours));
  const MipFilter mip(TextureFormat{.basis = Basis::kAlbedoNormal});
  for (const double scale : {1.0, 8.0}) {
    const std::vector<PatchImage> patches = allPatches(base, scale);
    const auto frames = framesOfHalves({HasNormals::kUpwards}, patches, base);
    std::vector<uint8_t> tail(6 * kTailPatchTexels), whole(3 * 16 * 16), twice(3 * 32 * 32);
    double off = 0;
    for (uint32_t p = 0; p < patches.size(); ++p) {
      const NormalsOfHalves maps = mapsOf(shown, frames, p);
      tailOfImages(patches[p], {&image, &image}, mip, tail, maps);
      showNormals(patches[p], {4, 0, 0, 16}, whole, maps);
      showNormals(patches[p], {5, 0, 0, 32}, twice, maps);
      const bool coarser = std::max(shownLevel(patches[p].at[0], 4), shownLevel(patches[p].at[1], 4)) > 0;
      EXPECT_EQ(coarser, scale > 1) << p;
      for (size_t c = 0; c < 3; ++c)
        for (size_t i = 0; i < 256; ++i) {
          const size_t x = 2 * (i % 16), y = 2 * (i / 16), at = (c * 32 + y) * 32 + x;
          const double mean = (twice[at] + twice[at + 1] + twice[at + 32] + twice[at + 33]) / 4.0;
          off = std::max(off, std::abs(tail[(3 + c) * 256 + i] - (coarser ? mean : whole[c * 256 + i])));
        }
    }
    EXPECT_LE(off, 0.5) << scale;
  }
}

// ---- the directory ----
TEST(NormalMaps, TheDirectorySaysWhichImagesAreNormals) {
  const BaseMesh base = wavyBase();
  PatchImages all;
  all.images = {{200, 90, true, false, false, {{100, 1}, {7, 2}}, false, false},
                {64, 90, true, false, false, {{50, 3}}, true, true},
                {20, 20, false, false, false, {{3, 3}}, false, false},
                {300, 20, false, true, true, {{9, 3}}, true, false}};
  all.of_patch = allPatches(base, 1);
  all.of_patch[5].image = {2, 0};
  constexpr uint64_t kBytes = 100 + 7 + 50 + 3 + 9;
  KindsOfImages kinds{.jpegs = true, .in_tails = true, .by_base = true, .colours = true, .richer = true};
  const auto decode = [&](const PatchImages& images) {
    return decodePatchImages(encodePatchImages(images.images, images.of_patch, base, true), base, kBytes, kinds);
  };
  const auto decoded = decode(all);
  ASSERT_TRUE(decoded.ok()) << decoded.error().text();
  for (size_t i = 0; i < 4; ++i) {
    EXPECT_EQ(decoded->images[i].is_normals, i % 2 == 1) << i;
    EXPECT_EQ(decoded->images[i].normals_downwards, i == 1) << i;
  }
  EXPECT_EQ(normalsOfImages(decoded->images),
            (std::vector{HasNormals::kDownwards, HasNormals::kNo, HasNormals::kUpwards, HasNormals::kNo}));
  EXPECT_EQ(placeSize(decoded->images, 0), glm::ivec2(200, 90));
  EXPECT_EQ(placeSize(decoded->images, 2), glm::ivec2(300, 20));
  const auto refused = [&](auto change, const char* why) {
    PatchImages wrong = all;
    change(wrong);
    const auto found = decode(wrong);
    EXPECT_FALSE(found.ok()) << why;
    if (!found) {
      EXPECT_EQ(found.error().kind, ErrorKind::kInvalidData);
    }
  };
  refused([](PatchImages& i) { i.images[0].is_normals = true; }, "the first image");
  refused([](PatchImages& i) { i.images[2].is_normals = true, i.of_patch[5].image = {0, 0}; }, "behind normals");
  refused([](PatchImages& i) { i.images[2].normals_downwards = true; }, "downwards, and no normals");
  refused([](PatchImages& i) { i.of_patch[7].image[1] = 1; }, "a patch shows normals as colours");
  kinds.richer = false;
  refused([](PatchImages&) {}, "before version 19");
}

// ---- packages ----
class MappedPatches final : public NoisyPatches {
 public:
  explicit MappedPatches(bool downwards)
      : NoisyPatches(wavyBase(), 0, 0, 7),
        downwards_(downwards),
        colours_(colourPicture(80, 45)),
        normals_(normalPicture(160, 90)) {}
  int textureDepth() const override { return 1; }
  int textureDepthOf(uint32_t) const override { return kNoTexturePage; }
  std::vector<SourceImage> images() const override {
    return {sourceOf(colours_), sourceOf(normals_, true, downwards_)};
  }
  PatchImage imageOf(uint32_t patch) const override {
    PatchImage out = imageOfPatch(base(), patch, 1, static_cast<int8_t>(patch % 3 - 1));
    out.in_tail = patch % 3 == 0;
    return out;
  }
  uint16_t height(uint32_t, int, int) const override { return 27'306; }
  const Picture& normals() const { return normals_; }

 private:
  bool downwards_;
  Picture colours_, normals_;
};
BuildOptions optionsOf(const std::string& path) {
  BuildOptions options;
  options.output = path;
  options.workers = 2;
  options.texture_tolerance = 0;
  options.tool_version = "test";
  return options;
}
std::vector<uint8_t> pageOf(const Package& package, int plane, const NodeId& node) {
  std::vector<uint8_t> channels(kTexturePageBytes);
  const auto page = package.read(PageId(texturePlane(plane), node));
  EXPECT_TRUE(page.ok()) << page.error().text();
  PageDecoder decoder;
  EXPECT_TRUE(page.ok() && decoder.decodeTexture(page->bytes, channels).ok());
  return channels;
}
// How far texels of a patch's root page are off the true normals, at most.
double offTrueNormals(const Package& package, const MappedPatches& source, uint32_t p, bool downwards) {
  std::vector<PatchImage> patches;
  for (uint32_t k = 0; k < source.base().patches.size(); ++k) patches.push_back(source.imageOf(k));
  const std::vector<TrueHalf> halves = trueHalves(source.base(), patches);
  const auto page = pageOf(package, 1, {p, 0, 0, 0});
  double off = 0;
  for (int j = 4; j < 132; j += 9)
    for (int i = 4; i < 132; i += 7) {
      const glm::dvec3 n = trueNormal(halves, p, (i - 3.5) / 128, (j - 3.5) / 128, source.normals(), 1, downwards);
      for (int c = 0; c < 3; ++c)
        off = std::max(off, std::abs(page[static_cast<size_t>((c * 136 + j) * 136 + i)] - (127.5 * n[c] + 127.5)));
    }
  return off;
}

TEST(NormalMaps, PagesOfAPackageHaveThem) {
  ScratchFolder folder;
  for (const bool downwards : {false, true}) {
    const MappedPatches source(downwards);
    const std::string path = folder.file("a.relievo");
    const auto done = buildPatchPackage(source, optionsOf(path));
    ASSERT_TRUE(done.ok()) << done.error().text();
    auto package = *Package::open(path);
    EXPECT_EQ(packageVersion(package->header()), 19u);
    EXPECT_EQ(package->shownImages().images, 1u);
    EXPECT_EQ(package->shownImages().normal_maps, 1u);
    EXPECT_FALSE(package->shownImages().corner_colours);
    const auto report = verifyPackage(*package, 2, nullptr);
    ASSERT_TRUE(report.ok());
    EXPECT_TRUE(report->damaged.empty() && report->other.empty());
    for (const uint32_t p : {1u, 5u, 34u}) {
      EXPECT_LE(offTrueNormals(*package, source, p, downwards), 1.7) << p;
      EXPECT_GT(offTrueNormals(*package, source, p, !downwards), 60) << "control";
    }
    // Tails, too: those that a builder made pages' tails of are the reader's.
    const PatchTails tails = package->wholeTails(2, nullptr);
    const ShownImage image(source.images()[0], {160, 90}), map(source.images()[1]);
    std::vector<PatchImage> patches;
    for (uint32_t k = 0; k < source.base().patches.size(); ++k) patches.push_back(source.imageOf(k));
    const auto frames = framesOfHalves(normalsOfImages(source.images()), patches, source.base());
    const MipFilter mip(source.format());
    std::vector<uint8_t> expected(6 * kTailPatchTexels);
    for (uint32_t p = 0; p < patches.size(); ++p) {
      tailOfImages(patches[p], {&image, &image}, mip, expected, mapsOf(map, frames, p));
      EXPECT_TRUE(
          std::ranges::equal(std::span(tails.texels).subspan(p * tails.patchTexels(), tails.patchTexels()), expected))
          << p;
    }
  }
}

// A map that is damaged is named; without it the surface is smooth, and its colours are there.
TEST(NormalMaps, WithoutADamagedOneTheSurfaceIsSmooth) {
  ScratchFolder folder;
  const MappedPatches source(false);
  const std::string path = folder.file("a.relievo");
  ASSERT_TRUE(buildPatchPackage(source, optionsOf(path)).ok());
  const auto sound = *Package::open(path);
  std::vector<uint8_t> bytes = readAll(path);
  bytes[sound->header().images_offset - 20] ^= 0x55;  // the last tile of the last image
  writeAll(folder.file("b.relievo"), bytes);
  const auto damaged = *Package::open(folder.file("b.relievo"));
  const auto report = verifyPackage(*damaged, 2, nullptr);
  ASSERT_TRUE(report.ok());
  ASSERT_EQ(report->other.size(), 1u);
  EXPECT_NE(report->other[0].find("of image 1: its checksum does not match"), std::string::npos) << report->other[0];
  const NodeId node{1, 0, 0, 0};
  EXPECT_EQ(pageOf(*damaged, 0, node), pageOf(*sound, 0, node));
  std::vector<uint8_t> smooth(kTexturePageBytes);
  showNormals(source.imageOf(1), {7, -4, -4, 136}, smooth);
  EXPECT_EQ(pageOf(*damaged, 1, node), smooth);
  EXPECT_NE(pageOf(*sound, 1, node), smooth) << "control";
  std::vector<std::string> problems;
  damaged->wholeTails(2, &problems);
  ASSERT_EQ(problems.size(), 1u);
  EXPECT_NE(problems[0].find("of image 1"), std::string::npos) << problems[0];
}

// One that came as a JPEG stays one; what no patch shows of it is filled by whoever reads it, as by the builder.
TEST(NormalMaps, AJpegStaysOneAndIsFilled) {
  Picture map = normalPicture(kPageFullPx, kPageFullPx);
  std::vector<uint8_t> texels, jpeg(1 << 20);
  for (size_t i = 0; i < map.rgb.size(); ++i) {
    texels.push_back(map.rgb[i]);
    if (i % 3 == 2) texels.push_back(255);
  }
  jpeg.resize(JpegPageEncoder().encode(texels.data(), 30, true, jpeg));
  jpeg = plainJpeg(jpeg);
  auto reader = ImageJpegReader::open(jpeg, kPageFullPx, kPageFullPx);
  ASSERT_TRUE(reader.ok() && reader->read(kPageFullPx, map.rgb).ok());
  class WithJpeg final : public NoisyPatches {
   public:
    WithJpeg(const Picture& map, const std::vector<uint8_t>& jpeg)
        : NoisyPatches(wavyBase(), 0, 0, 7), colours_(colourPicture(68, 68)), map_(map), jpeg_(jpeg) {}
    int textureDepthOf(uint32_t) const override { return kNoTexturePage; }
    std::vector<SourceImage> images() const override {
      std::vector<SourceImage> out{sourceOf(colours_), sourceOf(map_, true)};
      out[1].fill = true, out[1].jpeg = jpeg_;
      return out;
    }
    // Four patches' places over and over, some 36 texels each, so that tails show a coarser level.
    PatchImage imageOf(uint32_t patch) const override {
      PatchImage out = imageOfPatch(base(), patch, 4, 0);
      const uint32_t column = patch % kAcross % 2, row = patch / kAcross % 2;
      out.at = imageOfPatch(base(), row * kAcross + column, 4, 0).at;
      for (auto& half : out.at)
        for (glm::ivec2& at : half) at -= 256 * glm::ivec2(70, 40);
      return out;
    }
    uint16_t height(uint32_t, int, int) const override { return 27'306; }

   private:
    Picture colours_, map_;
    std::vector<uint8_t> jpeg_;
  };
  ScratchFolder folder;
  const WithJpeg source(map, jpeg);
  const std::string path = folder.file("a.relievo");
  ASSERT_TRUE(buildPatchPackage(source, optionsOf(path)).ok());
  const auto package = *Package::open(path);
  std::vector<PatchImage> patches;
  for (uint32_t p = 0; p < source.base().patches.size(); ++p) patches.push_back(source.imageOf(p));
  const std::vector<SourceImage> images = source.images();
  EXPECT_EQ(placeSize(images, 0), glm::ivec2(kPageFullPx)) << "places count the map's texels";
  std::vector<uint8_t> filled = map.rgb;
  fillImage(images[1], 0, placeSize(images, 0), patches, filled);
  EXPECT_NE(filled, map.rgb) << "some of it is not shown";
  SourceImage shown = images[1];
  shown.rgb = filled;
  const ShownImage map_shown(shown), image(images[0], placeSize(images, 0));
  const auto frames = framesOfHalves(normalsOfImages(images), patches, source.base());
  const PatchTails tails = package->wholeTails(1, nullptr);
  const MipFilter mip(source.format());
  std::vector<uint8_t> expected(kTexturePageBytes), tail(6 * kTailPatchTexels);
  for (uint32_t p = 0; p < patches.size(); ++p) {
    const NormalsOfHalves maps = mapsOf(map_shown, frames, p);
    showNormals(patches[p], {7, -4, -4, 136}, expected, maps);
    EXPECT_EQ(pageOf(*package, 1, {p, 0, 0, 0}), expected) << p;
    tailOfImages(patches[p], {&image, &image}, mip, tail, maps);
    EXPECT_TRUE(std::ranges::equal(std::span(tails.texels).subspan(p * tails.patchTexels(), tails.patchTexels()), tail))
        << p;
  }
  EXPECT_LT(std::filesystem::file_size(path), jpeg.size() + 40'000);
  EXPECT_GT(package->shownImages().bytes, jpeg.size());
}

TEST(NormalMaps, NeedAPackageThatHasThem) {
  ScratchFolder folder;
  BuildOptions options = optionsOf(folder.file("a.relievo"));
  options.base_parity = false;
  const auto done = buildPatchPackage(MappedPatches(false), options);
  ASSERT_FALSE(done.ok());
  EXPECT_EQ(done.error().kind, ErrorKind::kUsage);
}

}  // namespace normal_maps_test
}  // namespace relievo
