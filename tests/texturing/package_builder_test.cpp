// Packages against a naive dense pyramid, page by page and byte by byte.
#include "texturing/package/package_builder.h"

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <csignal>
#include <fstream>
#include <map>
#include <thread>

#include "package_fixture.h"
#include "tests/geometry/cell_ranges.h"
#include "tests/view_share.h"
#include "texturing/package/package.h"
#include "texturing/package/package_layout.h"

namespace relievo {
namespace package_builder_test {

using namespace testing_support;
using test::kSanitized;

std::string fileBytes(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

Result<BuildReport> build(const std::string& path, const TextureSource& t, const HeightSource* h = nullptr,
                          int workers = 2, uint64_t budget = uint64_t{256} << 20) {
  BuildOptions o;
  o.output = path;
  o.workers = workers;
  o.mm_per_px = 0.25;
  o.memory_budget_bytes = budget;
  o.tool_version = "test";
  o.stretch_relief = true;  // pages are compared whatever the proportions
  return buildPackage(t, h, o);
}

struct Size {
  int64_t width, height;
};

class EveryPage : public ::testing::TestWithParam<std::tuple<Basis, Size>> {};

TEST_P(EveryPage, equalsTheNaivePyramid) {
  auto [basis, size] = GetParam();
  const uint64_t seed = 11;
  RecordProperty("seed", static_cast<int>(seed));
  ScratchFolder folder;
  NoisyTexture source(size.width, size.height, basis, seed);
  auto built = build(folder.file("a.relievo"), source);
  ASSERT_TRUE(built.ok()) << built.error().text();
  EXPECT_EQ(folder.entries(), 1u);
  auto package = Package::open(folder.file("a.relievo"));
  ASSERT_TRUE(package.ok()) << package.error().text();
  EXPECT_TRUE((*package)->warnings().empty());
  const FlatDomain d = (*package)->manifest().domain.flat();
  EXPECT_EQ(d.width_px, static_cast<uint64_t>(size.width));
  auto levels = naivePyramid(source, d.texture_depth);
  PageDecoder decoder;
  std::vector<uint8_t> channels(kTexturePageBytes);
  uint64_t pages = 0, pages_that_need_borders = 0;
  forEachNode(d, d.texture_depth, [&](const NodeId& n) {
    for (int k = 0; k < source.format().planes(); ++k) {
      auto page = (*package)->read(PageId(texturePlane(k), n));
      ASSERT_TRUE(page.ok()) << page.error().text();
      ASSERT_TRUE(decoder.decodeTexture(page->bytes, channels).ok());
      ASSERT_EQ(channels, naivePage(levels, d, n, k))
          << "level " << n.level << " x " << n.x << " y " << n.y << " plane " << k;
      pages_that_need_borders += channels != naivePage(levels, d, n, k, false);
      ++pages;
    }
  });
  EXPECT_EQ(pages, (*package)->manifest().page_count);
  EXPECT_EQ(pages, built->pages);
  // Negative control: pages without borders would not have passed, wherever there is more than one page.
  if (std::max(size.width, size.height) > kPagePx) {
    EXPECT_GT(pages_that_need_borders, 0u);
  }
  auto verified = verifyPackage(**package, 2, nullptr);
  ASSERT_TRUE(verified.ok());
  EXPECT_EQ(verified->pages, pages);
  EXPECT_TRUE(verified->damaged.empty() && verified->other.empty());
}

INSTANTIATE_TEST_SUITE_P(Lrgb, EveryPage,
                         ::testing::Combine(::testing::Values(Basis::kPtmLrgb),
                                            ::testing::Values(Size{1, 1}, Size{1, 300}, Size{257, 1}, Size{127, 127},
                                                              Size{128, 128}, Size{129, 129}, Size{130, 300},
                                                              Size{700, 300}, Size{300, 1300}, Size{1153, 1041})));
INSTANTIATE_TEST_SUITE_P(Others, EveryPage,
                         ::testing::Combine(::testing::Values(Basis::kColour, Basis::kPtmRgb),
                                            ::testing::Values(Size{1, 1}, Size{5, 3}, Size{129, 127}, Size{700, 300},
                                                              Size{1100, 520})));

// ---- relief ----

struct ReliefCase {
  Size texture, heights;
};
class ReliefPages : public ::testing::TestWithParam<ReliefCase> {};

// Samples of every relief page of a package, by node.
std::map<NodeId, std::vector<uint16_t>> decodeRelief(const Package& package) {
  std::map<NodeId, std::vector<uint16_t>> out;
  PageDecoder decoder;
  const FlatDomain d = package.manifest().domain.flat();
  forEachNode(d, d.relief_depth, [&](const NodeId& n) {
    auto page = package.read(PageId(Plane::kRelief, n));
    ASSERT_TRUE(page.ok()) << page.error().text();
    std::vector<uint16_t> samples(kReliefPageSamples);
    ASSERT_TRUE(decoder.decodeRelief(page->bytes, samples).ok());
    out.emplace(n, std::move(samples));
  });
  return out;
}

uint16_t sampleAt(const std::vector<uint16_t>& page, int i, int j) {
  return page[static_cast<size_t>(j * kReliefSamples + i)];
}

TEST_P(ReliefPages, areExactSharedAndBounded) {
  const ReliefCase c = GetParam();
  ScratchFolder folder;
  NoisyTexture texture(c.texture.width, c.texture.height, Basis::kPtmLrgb, 3);
  NoisyHeights heights(c.heights.width, c.heights.height, 5);
  auto built = build(folder.file("a.relievo"), texture, &heights);
  ASSERT_TRUE(built.ok()) << built.error().text();
  auto opened = Package::open(folder.file("a.relievo"));
  ASSERT_TRUE(opened.ok()) << opened.error().text();
  const Package& package = **opened;
  const FlatDomain d = package.manifest().domain.flat();
  ASSERT_EQ(d.relief_depth, naiveReliefDepth(d, heights));
  EXPECT_DOUBLE_EQ(d.relief_offset_mm, heights.minMm());
  EXPECT_DOUBLE_EQ(d.relief_scale_mm, (heights.maxMm() - heights.minMm()) / 65535.0);
  auto pages = decodeRelief(package);
  std::vector<float> map(static_cast<size_t>(heights.width() * heights.height()));
  ASSERT_TRUE(heights.read({0, 0, heights.width(), heights.height()}, map).ok());

  std::map<std::pair<int64_t, int64_t>, uint16_t> by_place;  // in finest cells
  uint64_t shared = 0;
  for (const auto& [n, page] : pages) {
    auto naive = naiveReliefPage(heights, map, d, n);
    int64_t stride = int64_t{1} << (d.relief_depth - static_cast<int>(n.level));
    int64_t patch_cells = int64_t{kPagePx} << d.relief_depth;
    int64_t ox = static_cast<int64_t>(d.patchOriginX(n.patch) / d.patchPx()) * patch_cells,
            oy = static_cast<int64_t>(d.patchOriginY(n.patch) / d.patchPx()) * patch_cells;
    for (int j = 0; j <= kPagePx; ++j) {
      for (int i = 0; i <= kPagePx; ++i) {
        uint16_t q = sampleAt(page, i, j);
        // Rounded to the nearest step, at every level from the sample's own place.
        ASSERT_NEAR(q, naive[static_cast<size_t>(j * kReliefSamples + i)], 0.5 + 1e-6)
            << "level " << n.level << " x " << n.x << " y " << n.y << " i " << i << " j " << j;
        auto [it, fresh] = by_place.emplace(
            std::pair{ox + (int64_t{n.x} * kPagePx + i) * stride, oy + (int64_t{n.y} * kPagePx + j) * stride}, q);
        if (!fresh) {
          ++shared;
          ASSERT_EQ(it->second, q) << "a shared place has other bits";  // between pages of a level, levels and patches
        }
      }
    }
  }
  if (d.relief_depth > 0) {
    EXPECT_GT(shared, 0u);
    // Negative control: with a range for each page, as 16-bit page formats like to have, shared samples would differ.
    uint64_t differing = 0;
    std::map<std::pair<int64_t, int64_t>, uint16_t> own_range;
    for (const auto& [n, page] : pages) {
      auto [low, high] = std::minmax_element(page.begin(), page.end());
      int64_t stride = int64_t{1} << (d.relief_depth - static_cast<int>(n.level));
      for (int i = 0; i <= kPagePx; ++i) {
        uint16_t q = static_cast<uint16_t>((sampleAt(page, i, 0) - *low) * 65535ll / std::max(1, *high - *low));
        auto [it, fresh] = own_range.emplace(std::pair{(int64_t{n.x} * kPagePx + i) * stride + (int64_t{n.patch} << 40),
                                                       int64_t{n.y} * kPagePx * stride},
                                             q);
        differing += !fresh && it->second != q;
      }
    }
    EXPECT_GT(differing, 0u);
  }

  // Bounds: against the finest samples of the square, by brute force.
  uint64_t tight = 0, block_tight = 0, block_smaller = 0, between_tight = 0, between_smaller = 0;
  const double scale = d.relief_scale_mm;
  for (const auto& [n, page] : pages) {
    auto record = package.record(PageId(Plane::kRelief, n));
    ASSERT_TRUE(record.ok());
    const ReliefBounds b = record->relief;
    if (static_cast<int>(n.level) == d.relief_depth) {
      EXPECT_EQ(b.error_mm, 0.0f);
    }
    int64_t stride = int64_t{1} << (d.relief_depth - static_cast<int>(n.level));
    int64_t patch_cells = int64_t{kPagePx} << d.relief_depth;
    int64_t ox =
        static_cast<int64_t>(d.patchOriginX(n.patch) / d.patchPx()) * patch_cells + int64_t{n.x} * kPagePx * stride;
    int64_t oy =
        static_cast<int64_t>(d.patchOriginY(n.patch) / d.patchPx()) * patch_cells + int64_t{n.y} * kPagePx * stride;
    double cell_px = static_cast<double>(d.patchPx()) / static_cast<double>(patch_cells);
    auto clampedX = [&](int64_t g) {
      return std::min(static_cast<double>(g) * cell_px, static_cast<double>(d.width_px));
    };
    auto clampedY = [&](int64_t g) {
      return std::min(static_cast<double>(g) * cell_px, static_cast<double>(d.height_px));
    };
    uint16_t low = 65535, high = 0;
    double worst = 0;
    std::array<double, 256> block_worst{};
    std::array<std::array<double, 2>, 256> sides{};
    test::CellRanges apart(kPagePx, stride);
    for (int64_t gy = 0; gy <= kPagePx * stride; ++gy) {
      for (int64_t gx = 0; gx <= kPagePx * stride; ++gx) {
        auto it = by_place.find({ox + gx, oy + gy});
        if (it == by_place.end()) continue;  // beyond the artwork
        low = std::min(low, it->second), high = std::max(high, it->second);
        // This level's surface at the sample's true (clamped) place.
        int i = static_cast<int>(std::min<int64_t>(gx / stride, kPagePx - 1)),
            j = static_cast<int>(std::min<int64_t>(gy / stride, kPagePx - 1));
        double x0 = clampedX(ox + i * stride), x1 = clampedX(ox + (i + 1) * stride), y0 = clampedY(oy + j * stride),
               y1 = clampedY(oy + (j + 1) * stride);
        if (x1 <= x0 || y1 <= y0) continue;
        double s = (clampedX(ox + gx) - x0) / (x1 - x0), t = (clampedY(oy + gy) - y0) / (y1 - y0);
        double a = sampleAt(page, i, j), bb = sampleAt(page, i + 1, j), cc = sampleAt(page, i, j + 1),
               dd = sampleAt(page, i + 1, j + 1);
        double triangles = s >= t ? a + s * (bb - a) + t * (dd - bb) : a + t * (cc - a) + s * (dd - cc);
        double bilinear = (1 - t) * ((1 - s) * a + s * bb) + t * ((1 - s) * cc + s * dd);
        double off = std::max(std::abs(triangles - it->second), std::abs(bilinear - it->second));
        worst = std::max(worst, off);
        double& block = block_worst[static_cast<size_t>(j / 8 * 16 + i / 8)];
        block = std::max(block, off);
        const double along = it->second - triangles;
        auto& [below, above] = sides[static_cast<size_t>(j / 8 * 16 + i / 8)];
        below = std::max(below, -along), above = std::max(above, along);
        apart.note(gx, gy, along);
      }
    }
    std::array<float, 256> block_errors{};
    std::array<DeviationShape, 256> shapes{};
    ASSERT_TRUE(package.reliefErrors(n, block_errors));
    ASSERT_TRUE(package.reliefShapes(n, shapes));
    for (size_t k = 0; k < block_errors.size(); ++k) {
      EXPECT_GE(block_errors[k], block_worst[k] * scale * (1 - 1e-9))
          << "level " << n.level << " x " << n.x << " y " << n.y << " block " << k;
      block_tight += block_worst[k] > 0 && block_errors[k] / 2 < block_worst[k] * scale;  // half the bound is none
      block_smaller += block_errors[k] < b.error_mm / 2;  // a part tells more than the whole
      const Deviation known = deviationOf(block_errors[k], shapes[k]);
      const double between =
          apart.largest(static_cast<int64_t>(k % 16 * 8), static_cast<int64_t>(k / 16 * 8), 8) * scale;
      EXPECT_GE(known.below_mm, sides[k][0] * scale * (1 - 1e-6)) << "level " << n.level << " block " << k;
      EXPECT_GE(known.above_mm, sides[k][1] * scale * (1 - 1e-6)) << "level " << n.level << " block " << k;
      EXPECT_GE(known.between_mm, between * (1 - 1e-6)) << "level " << n.level << " block " << k;
      EXPECT_GE(known.apart_mm, between * (1 - 1e-6)) << "level " << n.level << " block " << k;
      between_tight += between > 0 && known.between_mm / 2 < between;
      between_smaller += known.between_mm < 0.9 * (known.below_mm + known.above_mm);
    }
    EXPECT_GE(b.error_mm, worst * scale * (1 - 1e-9)) << "level " << n.level << " x " << n.x << " y " << n.y;
    EXPECT_LE(b.min_mm, d.relief_offset_mm + low * scale);
    EXPECT_GE(b.max_mm, d.relief_offset_mm + high * scale);
    EXPECT_NEAR(b.min_mm, d.relief_offset_mm + low * scale, 1e-5);
    EXPECT_NEAR(b.max_mm, d.relief_offset_mm + high * scale, 1e-5);
    // Negative control: half the bound is no bound (where there is a deviation at all).
    tight += worst > 0 && b.error_mm / 2 < worst * scale;
    if (n.level > 0) {
      auto parent = package.record(PageId(Plane::kRelief, n.parent()));
      ASSERT_TRUE(parent.ok());
      EXPECT_GE(parent->relief.error_mm, b.error_mm);
      EXPECT_LE(parent->relief.min_mm, b.min_mm);
      EXPECT_GE(parent->relief.max_mm, b.max_mm);
    }
  }
  if (d.relief_depth > 0) {
    EXPECT_GT(tight, 0u);
    EXPECT_GT(block_tight, 0u);
    EXPECT_GT(block_smaller, 0u);
    EXPECT_GT(between_tight, 0u);
    EXPECT_GT(between_smaller, 0u);
  }
}

INSTANTIATE_TEST_SUITE_P(Sizes, ReliefPages,
                         ::testing::Values(ReliefCase{{1, 1}, {1, 1}}, ReliefCase{{130, 1}, {130, 1}},
                                           ReliefCase{{129, 300}, {129, 300}}, ReliefCase{{700, 300}, {700, 300}},
                                           ReliefCase{{640, 600}, {321, 299}}, ReliefCase{{100, 90}, {400, 360}},
                                           ReliefCase{{1100, 520}, {1100, 520}}));

TEST(ReliefPages, flatReliefHasScaleZeroAndNoError) {
  class Flat final : public HeightSource {
   public:
    int64_t width() const override { return 200; }
    int64_t height() const override { return 200; }
    double minMm() const override { return 3; }
    double maxMm() const override { return 3; }
    Provenance provenance() const override { return {"flat", "", ""}; }
    Result<void> read(const Rect&, std::span<float> out) const override {
      std::fill(out.begin(), out.end(), 3.0f);
      return {};
    }
  } flat;
  ScratchFolder folder;
  NoisyTexture texture(200, 200, Basis::kColour, 1);
  ASSERT_TRUE(build(folder.file("a"), texture, &flat).ok());
  auto package = Package::open(folder.file("a"));
  ASSERT_TRUE(package.ok());
  EXPECT_EQ((*package)->manifest().domain.relief_scale_mm, 0.0);
  for (auto& [n, page] : decodeRelief(**package)) {
    EXPECT_EQ(*std::max_element(page.begin(), page.end()), 0);
    auto record = (*package)->record(PageId(Plane::kRelief, n));
    EXPECT_EQ(record->relief.min_mm, 3.0f);
    EXPECT_EQ(record->relief.max_mm, 3.0f);
    EXPECT_EQ(record->relief.error_mm, 0.0f);
  }
}

// ---- the same bytes, whatever the machine ----

TEST(Determinism, workersAndMemoryDoNotMatter) {
  ScratchFolder folder;
  const int width = kSanitized ? 600 : 1500, height = kSanitized ? 500 : 1100;
  NoisyTexture texture(width, height, Basis::kPtmLrgb, 21);
  NoisyHeights heights(width, height, 22);
  ASSERT_TRUE(build(folder.file("one"), texture, &heights, 1).ok());
  std::string one = fileBytes(folder.file("one"));
  ASSERT_GT(one.size(), size_t{1} << 20);
  ASSERT_TRUE(build(folder.file("two"), texture, &heights, 2).ok());
  EXPECT_TRUE(one == fileBytes(folder.file("two")));
  ASSERT_TRUE(build(folder.file("three"), texture, &heights, 3, uint64_t{1} << 30).ok());
  EXPECT_TRUE(one == fileBytes(folder.file("three")));
  ASSERT_TRUE(build(folder.file("spilled"), texture, &heights, 2, 1).ok());  // every spill goes to a file
  EXPECT_TRUE(one == fileBytes(folder.file("spilled")));
  // Negative control: another artwork has other bytes.
  NoisyTexture other(width, height, Basis::kPtmLrgb, 23);
  ASSERT_TRUE(build(folder.file("other"), other, &heights, 2).ok());
  EXPECT_FALSE(one == fileBytes(folder.file("other")));
  EXPECT_EQ(folder.entries(), 5u);
}

// ---- the size ----

TEST(Size, thatNobodyGaveIsSaidToBeUnknown) {
  ScratchFolder folder;
  NoisyTexture texture(200, 100, Basis::kColour, 21);
  NoisyHeights heights(200, 100, 22);
  BuildOptions o;
  o.mm_per_px = 0.25;
  for (bool known : {true, false}) {
    o.output = folder.file(known ? "known" : "unknown");
    o.size_known = known;
    ASSERT_TRUE(buildPackage(texture, &heights, o).ok());
    auto package = Package::open(o.output);
    ASSERT_TRUE(package.ok()) << package.error().text();
    EXPECT_EQ((*package)->manifest().size_known, known);
    EXPECT_EQ((*package)->manifest().domain.mm_per_px, known ? 0.25 : 1);
    EXPECT_EQ((*package)->manifestJson().find("size_known") == std::string::npos, known)
        << "a member of packages without a size alone";
    // What readers from before there was such a field take for padding.
    const std::string bytes = fileBytes(o.output);
    EXPECT_EQ(bytes.substr(140, 4), std::string(known ? "\0\0\0\0" : "\1\0\0\0", 4));
  }
}

TEST(Proportions, ofAHeightMapAreTheTextures) {
  ScratchFolder folder;
  NoisyTexture texture(300, 200, Basis::kColour, 21);
  BuildOptions o;
  o.output = folder.file("a");
  for (auto [width, height, good] : {std::tuple{300, 200, true},
                                     {150, 100, true},
                                     {31, 20, true},
                                     {302, 200, true},
                                     {305, 200, false},
                                     {200, 300, false},
                                     {600, 300, false}}) {
    NoisyHeights heights(width, height, 22);
    o.stretch_relief = false;
    auto built = buildPackage(texture, &heights, o);
    EXPECT_EQ(built.ok(), good) << width << " x " << height;
    o.stretch_relief = true;
    EXPECT_TRUE(buildPackage(texture, &heights, o).ok()) << width << " x " << height;
    if (good) continue;
    EXPECT_EQ(built.error().kind, ErrorKind::kInvalidData);
    for (const char* told : {"300 x 200", "within 1 %", "--stretch-relief"})
      EXPECT_NE(built.error().text().find(told), std::string::npos) << built.error().text();
  }
}

// ---- encodings ----

Result<BuildReport> buildEncoded(const std::string& path, const TextureSource& t, const HeightSource* h,
                                 PageEncoding coefficients, PageEncoding colour, int workers = 2) {
  BuildOptions o;
  o.output = path;
  o.workers = workers;
  o.coefficients = coefficients;
  o.colour = colour;
  return buildPackage(t, h, o);
}

// Every page is the encoding of the exact page: mip levels see nothing of what the finer ones lost.
TEST(Encodings, everyPageIsTheExactOneEncoded) {
  ScratchFolder folder;
  const int width = kSanitized ? 300 : 900, height = kSanitized ? 200 : 420;
  NoisyTexture texture(width, height, Basis::kPtmLrgb, 31, 3);
  NoisyHeights heights(width, height, 32);
  ASSERT_TRUE(build(folder.file("exact"), texture, &heights).ok());
  auto exact = Package::open(folder.file("exact"));
  ASSERT_TRUE(exact.ok());
  const FlatDomain d = (*exact)->manifest().domain.flat();
  PageDecoder decoder;
  PageEncoder encoder(1);
  const std::pair<PageEncoding, PageEncoding> choices[] = {{{PageCodec::kQuantised, 5}, {}},
                                                           {{PageCodec::kJpeg, 80}, {PageCodec::kJpeg, 60}},
                                                           {{PageCodec::kBc4, 0}, {PageCodec::kBc7, 0}},
                                                           {{}, {PageCodec::kBc1, 0}}};
  for (auto [coefficients, colour] : choices) {
    const std::string name = encodingName(coefficients) + " " + encodingName(colour);
    ASSERT_TRUE(buildEncoded(folder.file("lossy"), texture, &heights, coefficients, colour).ok());
    auto lossy = Package::open(folder.file("lossy"));
    ASSERT_TRUE(lossy.ok());
    const PlaneEncodings& encodings = (*lossy)->manifest().encodings;
    EXPECT_EQ(encodings, planeEncodings((*exact)->manifest().texture, coefficients, colour));
    EXPECT_NE((*lossy)->manifestJson().find('"' + encodingName(encodings[2]) + '"'), std::string::npos);
    std::vector<uint8_t> channels(kTexturePageBytes);
    int differ = 0;
    forEachNode(d, d.texture_depth, [&](const NodeId& n) {
      for (int k = 0; k < 3; ++k) {
        PageId id(texturePlane(k), n);
        auto page = (*exact)->read(id);
        ASSERT_TRUE(decoder.decodeTexture(page->bytes, channels).ok());
        auto expected = encoder.encodeTexture(channels, encodings[static_cast<size_t>(k)]);
        auto found = (*lossy)->read(id);
        ASSERT_TRUE(found.ok());
        ASSERT_TRUE(std::equal(expected.begin(), expected.end(), found->bytes.begin(), found->bytes.end()))
            << name << ": " << describePage(id);
        differ += found->bytes != page->bytes;
      }
    });
    EXPECT_GT(differ, kSanitized ? 5 : 10) << name << ": the negative control: lossy pages are others";
    forEachNode(d, d.relief_depth, [&](const NodeId& n) {
      PageId id(Plane::kRelief, n);
      ASSERT_EQ((*exact)->read(id)->bytes, (*lossy)->read(id)->bytes) << "relief stays lossless";
    });
    auto report = verifyPackage(**lossy, 2, nullptr);
    ASSERT_TRUE(report.ok());
    EXPECT_TRUE(report->damaged.empty() && report->other.empty());
    // Planes and their bytes, as `relievo info` shows them, add up.
    uint64_t pages = 0, bytes = 0;
    for (Plane p : {Plane::kTexture0, texturePlane(1), texturePlane(2), Plane::kRelief}) {
      PlaneUsage usage = *planeUsage(**lossy, p);
      pages += usage.pages, bytes += usage.bytes;
      EXPECT_EQ(usage.unknown_pages, 0u);
    }
    EXPECT_EQ(pages, (*lossy)->manifest().page_count);
    EXPECT_EQ(bytes, report->bytes);
  }
}

TEST(Encodings, theSameBytesWithAnyWorkers) {
  ScratchFolder folder;
  NoisyTexture texture(kSanitized ? 300 : 700, kSanitized ? 200 : 500, Basis::kPtmLrgb, 41);
  for (auto [coefficients, colour] :
       {std::pair{PageEncoding{PageCodec::kQuantised, 6}, PageEncoding{PageCodec::kJpeg, 85}},
        {PageEncoding{PageCodec::kBc7, 0}, PageEncoding{PageCodec::kBc1, 0}}}) {
    ASSERT_TRUE(buildEncoded(folder.file("one"), texture, nullptr, coefficients, colour, 1).ok());
    ASSERT_TRUE(buildEncoded(folder.file("three"), texture, nullptr, coefficients, colour, 3).ok());
    EXPECT_TRUE(fileBytes(folder.file("one")) == fileBytes(folder.file("three"))) << encodingName(coefficients);
  }
}

// ---- failures leave nothing behind ----

TEST(Failure, interruptedBuildLeavesTheFolderAsItWas) {
  ScratchFolder folder;
  NoisyTexture texture(3000, 3000, Basis::kPtmLrgb, 1);
  { std::ofstream(folder.file("a")) << "the previous package"; }
  std::atomic<bool> interrupted{false};
  BuildOptions o;
  o.output = folder.file("a");
  o.workers = 2;
  o.interrupted = &interrupted;
  o.progress = [&](const BuildProgress& p) {
    if (p.texels_done > 0) interrupted = true;
  };
  auto built = buildPackage(texture, nullptr, o);
  ASSERT_FALSE(built.ok());
  EXPECT_EQ(built.error().kind, ErrorKind::kInterrupted);
  EXPECT_EQ(folder.entries(), 1u);
  EXPECT_EQ(fileBytes(folder.file("a")), "the previous package");
}

TEST(Failure, failingSourceIsReportedAndLeavesNothing) {
  class Broken final : public TextureSource {
   public:
    int64_t width() const override { return 2500; }
    int64_t height() const override { return 600; }
    TextureFormat format() const override { return {}; }
    Provenance provenance() const override { return {}; }
    Result<void> read(const Rect& r, std::span<uint8_t> out) const override {
      if (r.x > 1500) return Error{ErrorKind::kInvalidData, "broken.ptm", "the data ends", "", 77};
      std::fill(out.begin(), out.end(), uint8_t{0});
      return {};
    }
  } broken;
  ScratchFolder folder;
  auto built = build(folder.file("a"), broken);
  ASSERT_FALSE(built.ok());
  EXPECT_EQ(built.error().file, "broken.ptm");
  EXPECT_EQ(folder.entries(), 0u);
}

// A full disk, played by the process's limit on file sizes (writes then fail with EFBIG).
TEST(Failure, failingWritesAreReportedAndLeaveNothing) {
  ScratchFolder folder;
  NoisyTexture texture(1500, 1500, Basis::kPtmLrgb, 1);
  auto old_handler = std::signal(SIGXFSZ, SIG_IGN);
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  rlimit small = before;
  small.rlim_cur = 3 << 20;
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
  auto built = build(folder.file("a"), texture);
  setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, old_handler);
  ASSERT_FALSE(built.ok());
  EXPECT_EQ(built.error().kind, ErrorKind::kIo);
  EXPECT_EQ(folder.entries(), 0u);
  // Negative control: without the limit it works.
  EXPECT_TRUE(build(folder.file("a"), texture).ok());
}

TEST(Failure, sourcesThatMakeNoSenseAreUsageErrors) {
  ScratchFolder folder;
  NoisyTexture empty(0, 5, Basis::kColour, 1), good(5, 5, Basis::kColour, 1);
  EXPECT_FALSE(build(folder.file("a"), empty).ok());
  BuildOptions o;
  o.output = folder.file("a");
  o.mm_per_px = 0;
  EXPECT_FALSE(buildPackage(good, nullptr, o).ok());
  o.mm_per_px = NAN;
  EXPECT_FALSE(buildPackage(good, nullptr, o).ok());
  o.mm_per_px = 1;
  o.output = folder.file("no/such/folder/a");
  EXPECT_FALSE(buildPackage(good, nullptr, o).ok());
  EXPECT_EQ(folder.entries(), 0u);
}
}  // namespace package_builder_test
}  // namespace relievo
