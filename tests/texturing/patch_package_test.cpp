// Packages over a base mesh, page by page against what PACKAGE.md says of them.
#include "texturing/package/patch_package_builder.h"

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <xxhash.h>

#include <algorithm>
#include <atomic>
#include <csignal>
#include <fstream>
#include <iostream>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>

#include "patch_fixture.h"
#include "tests/other_bases.h"
#include "tests/view_share.h"
#include "texturing/package/package.h"
#include "texturing/package/package_base.h"
#include "texturing/package/package_layout.h"

namespace relievo {
namespace patch_package_test {

using namespace testing_support;
using test::kSanitized;

constexpr uint64_t kSeed = 17;

Result<BuildReport> build(const std::string& path, const PatchSource& source, int workers = 2,
                          uint64_t budget = uint64_t{256} << 20, bool compact = true, bool coded_index = true,
                          bool by_border = true) {
  BuildOptions o;
  o.output = path;
  o.compact = compact;
  o.coded_index = coded_index;
  o.base_by_border = by_border;
  o.workers = workers;
  o.memory_budget_bytes = budget;
  o.tool_version = "test";
  o.manifest_extra = R"({"mesh": {"pieces": 3}})";
  return buildPatchPackage(source, o);
}

// One patch's levels by the naive rule: as an artwork of its own.
std::vector<NaiveImage> levelsOf(const NoisyPatches& source, uint32_t patch) {
  std::vector<NaiveImage> levels(static_cast<size_t>(source.textureDepth()) + 1);
  NaiveImage& finest = levels.back();
  finest.width = finest.height = source.texelSide();
  for (int c = 0; c < source.format().channels(); ++c) {
    finest.channels.emplace_back();
    for (int y = 0; y < finest.height; ++y)
      for (int x = 0; x < finest.width; ++x) finest.channels.back().push_back(256 * source.texel(patch, c, x, y));
  }
  for (size_t l = levels.size() - 1; l-- > 0;) levels[l] = naiveCoarser(levels[l + 1], source.format());
  return levels;
}

enum class Borders {
  kNeighbours,
  kOwnEdge,
  kNeverReversed,
  kMirroredAcross,
  kOwnCorner,
  kAcrossCreases
};  // all but the first are wrong

// Do the normals at two places of levels, of three channels behind the colour's, differ by more than 40 degrees?
bool differ(const NaiveImage& one, std::array<int64_t, 2> a, const NaiveImage& other, std::array<int64_t, 2> b) {
  glm::dvec3 m, n;
  for (int c = 0; c < 3; ++c) {
    auto component = [&](const NaiveImage& image, const std::array<int64_t, 2>& at) {
      return static_cast<double>((image.at(3 + c, at[0], at[1]) + 128) / 256) / 127.5 - 1;
    };
    m[c] = component(one, a), n[c] = component(other, b);
  }
  return glm::dot(m, n) < std::sqrt(0.587) * glm::length(m) * glm::length(n);
}

// Texel (x, y) of a patch's level, which may lie beyond one of its sides: there, by the corners alone, the patch that
// has them both. Normals end at creases.
int64_t texelAt(const BaseMesh& base, const std::vector<std::vector<NaiveImage>>& levels, uint32_t patch, size_t level,
                int c, int64_t x, int64_t y, Borders how) {
  const int64_t n = levels[patch][level].width;
  const bool out_x = x < 0 || x >= n, out_y = y < 0 || y >= n;
  if (out_x != out_y && how != Borders::kOwnEdge) {
    // The side's ends, the first one at along = 0; how far beyond it the texel lies.
    const int64_t along = out_x ? y : x, beyond = out_x ? (x < 0 ? -1 - x : x - n) : (y < 0 ? -1 - y : y - n);
    const size_t first = out_x ? (x < 0 ? 0 : 1) : (y < 0 ? 0 : 2), second = first + (out_x ? 2 : 1);
    const uint32_t a = base.patches[patch][first], b = base.patches[patch][second];
    for (uint32_t q = 0; q < base.patches.size(); ++q) {
      const auto& corners = base.patches[q];
      const auto at_a = std::find(corners.begin(), corners.end(), a),
                 at_b = std::find(corners.begin(), corners.end(), b);
      if (q == patch || at_a == corners.end() || at_b == corners.end()) continue;
      int64_t ka = at_a - corners.begin(), kb = at_b - corners.begin();
      EXPECT_TRUE((ka ^ kb) == 1 || (ka ^ kb) == 2);
      // From a's corner: along the axis in which a and b differ, and inwards along the other.
      const bool axis_x = (ka ^ kb) == 1;
      const int64_t inwards = how == Borders::kMirroredAcross ? 3 - beyond : beyond;
      const bool a_first = how == Borders::kNeverReversed || (axis_x ? ka % 2 : ka / 2) == 0;
      const bool side_first = (axis_x ? ka / 2 : ka % 2) == 0;
      const int64_t u = a_first ? along : n - 1 - along, w = side_first ? inwards : n - 1 - inwards;
      const int64_t edge = side_first ? 0 : n - 1;
      if (c >= 3 && levels[q][level].channels.size() == 6 && how != Borders::kAcrossCreases &&
          differ(levels[patch][level], {x, y}, levels[q][level], {axis_x ? u : edge, axis_x ? edge : u}))
        break;
      return levels[q][level].at(c, axis_x ? u : w, axis_x ? w : u);
    }
  }
  const int64_t own = levels[patch][level].at(c, x, y);  // clamps
  if (!(out_x && out_y) || how == Borders::kOwnCorner) return own;
  // Beyond a corner: what brings the four texels around it to the mean of all patches' corner texels. In bytes, as
  // pages hold.
  auto byte = [](int64_t v) { return static_cast<double>((v + 128) / 256); };
  const size_t k = static_cast<size_t>((x < 0 ? 0 : 1) + (y < 0 ? 0 : 2));
  const int64_t cx = x < 0 ? 0 : n - 1, cy = y < 0 ? 0 : n - 1;
  double sum = 0, count = 0;
  for (uint32_t q = 0; q < base.patches.size(); ++q)
    for (size_t j = 0; j < 4; ++j)
      if (base.patches[q][j] == base.patches[patch][k]) {
        if (c >= 3 && levels[q][level].channels.size() == 6 && how != Borders::kAcrossCreases &&
            differ(levels[patch][level], {cx, cy}, levels[q][level], {j % 2 ? n - 1 : 0, j / 2 ? n - 1 : 0}))
          return own;
        sum += byte(levels[q][level].at(c, j % 2 ? n - 1 : 0, j / 2 ? n - 1 : 0)), ++count;
      }
  const double beside = byte(texelAt(base, levels, patch, level, c, x < 0 ? -1 : n, cy, how)) +
                        byte(texelAt(base, levels, patch, level, c, cx, y < 0 ? -1 : n, how));
  return 256 * std::llround(std::clamp(std::floor(4 * sum / count + 0.5 + 1e-9) - byte(own) - beside, 0.0, 255.0));
}

struct PageCounts {
  uint64_t texture = 0, relief = 0, wrong = 0;
};
using NaiveLevels = std::vector<std::vector<NaiveImage>>;  // by patch and level
NaiveLevels levelsOf(const NoisyPatches& source) {
  NaiveLevels levels;
  for (uint32_t p = 0; p < source.base().patches.size(); ++p) levels.push_back(levelsOf(source, p));
  return levels;
}
PageCounts comparePages(const Package& package, const NoisyPatches& source, const NaiveLevels& levels, Borders how) {
  const BaseMesh& base = *package.manifest().base;
  PageCounts counts;
  PageDecoder decoder;
  std::vector<uint8_t> channels(kTexturePageBytes), expected;
  forEachNode(package.manifest().domain, source.textureDepth(), [&](const NodeId& node) {
    for (int plane = 0; plane < source.format().planes(); ++plane) {
      auto page = package.read(PageId(texturePlane(plane), node));
      ASSERT_TRUE(page.ok()) << page.error().text();
      ASSERT_TRUE(decoder.decodeTexture(page->bytes, channels).ok());
      expected.clear();
      for (int c = 3 * plane; c < 3 * plane + 3; ++c)
        for (int j = -kPageBorderPx; j < kPagePx + kPageBorderPx; ++j)
          for (int i = -kPageBorderPx; i < kPagePx + kPageBorderPx; ++i)
            expected.push_back(
                static_cast<uint8_t>((texelAt(base, levels, node.patch, node.level, c, int64_t{node.x} * kPagePx + i,
                                              int64_t{node.y} * kPagePx + j, how) +
                                      128) /
                                     256));
      ++counts.texture;
      counts.wrong += expected != channels;
    }
  });
  return counts;
}

TEST(PatchPackage, everyTexturePageEqualsTheNaiveOneWithItsNeighboursBorders) {
  std::cout << "seed " << kSeed << "\n";
  for (auto [open, partly_even] : {std::pair{false, false}, {true, false}, {false, true}}) {
    NoisyPatches source(cubeSphere(2, 100, kSeed, open), 1, 0, kSeed);
    source.partly_even = partly_even;
    ScratchFolder folder;
    auto built = build(folder.file("a.relievo"), source);
    ASSERT_TRUE(built.ok()) << built.error().text();
    EXPECT_EQ(folder.entries(), 1u);
    EXPECT_EQ(source.texel_calls, static_cast<int>(source.base().patches.size())) << "the source works once";
    auto package = Package::open(folder.file("a.relievo"));
    ASSERT_TRUE(package.ok()) << package.error().text();
    EXPECT_TRUE((*package)->warnings().empty());
    const NaiveLevels levels = levelsOf(source);
    auto counts = comparePages(**package, source, levels, Borders::kNeighbours);
    EXPECT_EQ(counts.texture, (open ? 20u : 24u) * 5 * 2);
    EXPECT_EQ(counts.wrong, 0u);
    if (open || partly_even || kSanitized) continue;
    // Negative controls: what a builder that took the wrong texels would give is told apart. All pages have a side.
    EXPECT_GT(comparePages(**package, source, levels, Borders::kOwnEdge).wrong, counts.texture * 9 / 10);
    EXPECT_GT(comparePages(**package, source, levels, Borders::kNeverReversed).wrong, counts.texture / 2);
    EXPECT_GT(comparePages(**package, source, levels, Borders::kMirroredAcross).wrong, counts.texture * 9 / 10);
    EXPECT_GT(comparePages(**package, source, levels, Borders::kOwnCorner).wrong, counts.texture * 2 / 5);
    EXPECT_GT(comparePages(**package, source, levels, Borders::kAcrossCreases).wrong, counts.texture * 2 / 5);
  }
}

// What bilinear filtering shows at a corner is the same from all patches that meet there, three or four or more; at
// sides, too.
TEST(PatchPackage, patchesAgreeOnWhatTheirSidesAndCornersShow) {
  // A fan of five around corner 0, beside the cube's three and four.
  BaseMesh fan;
  fan.corners.push_back({{0, 0, 0}, {0, 0, 1}});
  for (int i = 0; i < 10; ++i) {
    const float a = 0.62831853f * static_cast<float>(i), r = i % 2 ? 1.6f : 1.0f;
    fan.corners.push_back({{r * std::cos(a), r * std::sin(a), 0}, {0, 0, 1}});
  }
  for (uint32_t i = 0; i < 5; ++i) fan.patches.push_back({0, 1 + 2 * i, 1 + (2 * i + 2) % 10, 2 + 2 * i});
  for (const BaseMesh& mesh : {cubeSphere(2, 10, kSeed), fan}) {
    NoisyPatches source(mesh, 1, 0, kSeed, Basis::kPtmLrgb);
    ScratchFolder folder;
    ASSERT_TRUE(build(folder.file("a.relievo"), source).ok());
    auto package = Package::open(folder.file("a.relievo"));
    ASSERT_TRUE(package.ok());
    PageDecoder decoder;
    std::vector<uint8_t> page(kTexturePageBytes);
    double worst = 0, worst_own = 0;  // of a byte's steps; own: were the corner's texel repeated
    uint64_t clamped = 0, corners = 0;
    for (uint32_t level : {0u, 1u}) {
      std::map<uint32_t, std::array<std::array<double, 2>, 4>>
          seen;  // by the mesh's corner: least and greatest; of own likewise
      for (uint32_t p = 0; p < mesh.patches.size(); ++p) {
        for (uint32_t k = 0; k < 4; ++k) {
          const uint32_t last = (1u << level) - 1;
          auto encoded = (*package)->read(PageId(texturePlane(2), NodeId{p, level, k % 2 * last, k / 2 * last}));
          ASSERT_TRUE(encoded.ok());
          ASSERT_TRUE(decoder.decodeTexture(encoded->bytes, page).ok());
          auto at = [&](int x, int y) { return static_cast<double>(page[static_cast<size_t>(y * kPageFullPx + x)]); };
          const int x = k % 2 ? 131 : 3, y = k / 2 ? 131 : 3;  // the four texels around the corner begin here
          const double beyond = at(k % 2 ? x + 1 : x, k / 2 ? y + 1 : y),
                       own = at(k % 2 ? x : x + 1, k / 2 ? y : y + 1);
          const double mean = (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1)) / 4,
                       repeated = mean + (own - beyond) / 4;
          ++corners;
          if (beyond == 0 || beyond == 255) {
            ++clamped;
            continue;
          }
          auto& s = seen.try_emplace(mesh.patches[p][k],
                                     std::array<std::array<double, 2>, 4>{{{1e9, -1e9}, {1e9, -1e9}, {}, {}}})
                        .first->second;
          s[0] = {std::min(s[0][0], mean), std::max(s[0][1], mean)};
          s[1] = {std::min(s[1][0], repeated), std::max(s[1][1], repeated)};
        }
      }
      for (const auto& [corner, s] : seen) {
        if (s[0][1] < s[0][0]) continue;
        worst = std::max(worst, s[0][1] - s[0][0]);
        worst_own = std::max(worst_own, s[1][1] - s[1][0]);
      }
    }
    EXPECT_EQ(worst, 0);
    EXPECT_GT(worst_own, 4) << "negative control: a repeated texel would show a seam";
    EXPECT_LT(clamped, corners / 3);
  }
}

TEST(PatchPackage, otherBasesDeepTreesAndMeshesOfOnePatch) {
  for (Basis basis : {Basis::kColour, Basis::kPtmLrgb, test::otherBases()[1], test::otherBases()[3]}) {
    BaseMesh one;
    for (int k = 0; k < 4; ++k) one.corners.push_back({{float(k % 2), float(k / 2), 0}, {0, 0, 1}});
    one.patches.push_back({2, 0, 3, 1});
    NoisyPatches source(one, 2, 1, kSeed, basis);
    for (const bool compact : {true, false}) {
      if (test::kSanitized && compact == (basis > Basis::kAlbedoNormal)) continue;
      ScratchFolder folder;
      ASSERT_TRUE(build(folder.file("a.relievo"), source, 2, uint64_t{256} << 20, compact).ok());
      auto package = Package::open(folder.file("a.relievo"));
      ASSERT_TRUE(package.ok());
      EXPECT_EQ(packageVersion((*package)->header()), compact ? 12u : basis > Basis::kAlbedoNormal ? 3u : 2u);
      EXPECT_EQ((*package)->manifest().base->patches, one.patches);
      auto counts = comparePages(**package, source, levelsOf(source), Borders::kNeighbours);
      EXPECT_EQ(counts.texture, 21u * static_cast<unsigned>(source.format().planes()));
      EXPECT_EQ(counts.wrong, 0u);
    }
  }
}

// A package of version 10 and an older one tell the same, but for bounds that are rounded away from what they bound.
TEST(PatchPackage, compactPackagesTellWhatOlderOnesDo) {
  const NoisyPatches source(cubeSphere(2, 50, kSeed), 0, 1, kSeed);
  ScratchFolder folder;
  std::shared_ptr<Package> packages[2];
  for (const bool compact : {false, true}) {
    const std::string path = folder.file(compact ? "compact.relievo" : "older.relievo");
    ASSERT_TRUE(build(path, source, 2, uint64_t{256} << 20, compact).ok());
    auto opened = Package::open(path);
    ASSERT_TRUE(opened.ok()) << opened.error().text();
    packages[compact] = *opened;
  }
  const Package &older = *packages[0], &compact = *packages[1];
  const Manifest &a = older.manifest(), &b = compact.manifest();
  EXPECT_LT(compact.header().base_bytes, older.header().base_bytes);
  EXPECT_LT(compact.header().index_bytes, older.header().index_bytes * 2 / 5);
  ASSERT_EQ(a.base->patches, b.base->patches);
  for (size_t i = 0; i < a.base->corners.size(); ++i)
    EXPECT_EQ(a.base->corners[i].position_mm, b.base->corners[i].position_mm);
  PageDecoder decoder;
  std::vector<uint16_t> from_older(kReliefPageSamples), from_compact(kReliefPageSamples);
  size_t wider = 0;
  for (uint32_t p = 0; p < a.base->patches.size(); ++p) {
    for (size_t k = 0; k < a.coarse_errors[p].size(); ++k) {
      const float error = a.coarse_errors[p][k], rounded = b.coarse_errors[p][k];
      EXPECT_TRUE(rounded >= error && rounded <= error * 1.02f) << error << " " << rounded;
      wider += rounded > error;
    }
    for (size_t i = 0; i < a.coarse_blocks[p].size(); ++i) {
      const size_t k = i < 4 ? 4 : i < 20 ? 5 : 6;
      // Either is rounded up from the same.
      EXPECT_GE(coarseBlockMm(b.coarse_errors[p][k], b.coarse_blocks[p][i]),
                coarseBlockMm(a.coarse_errors[p][k], a.coarse_blocks[p][i]) - a.coarse_errors[p][k] / 254);
    }
    const HeightSlopes &s = a.height_slopes[p], &r = b.height_slopes[p];
    EXPECT_TRUE(r.min_u <= s.min_u && r.max_u >= s.max_u && r.min_v <= s.min_v && r.max_v >= s.max_v);
    for (uint32_t level = 0; level < 2; ++level) {
      const NodeId node{p, level, level, 0};
      const PageId page(Plane::kRelief, node);
      auto one = older.read(page), other = compact.read(page);
      ASSERT_TRUE(one.ok() && other.ok());
      EXPECT_NE(one->bytes[0], other->bytes[0]) << "stored in two ways";
      ASSERT_TRUE(decoder.decodeRelief(one->bytes, from_older).ok());
      ASSERT_TRUE(decoder.decodeRelief(other->bytes, from_compact).ok());
      EXPECT_EQ(from_older, from_compact);
      std::array<float, kReliefDetailBytes> errors[2];
      EXPECT_TRUE(older.reliefErrors(node, errors[0]));
      EXPECT_TRUE(compact.reliefErrors(node, errors[1]));
      EXPECT_EQ(errors[0], errors[1]);
      EXPECT_EQ(*std::max_element(errors[0].begin(), errors[0].end()) == 0, level == 1) << "the finest have no errors";
    }
  }
  EXPECT_GT(wider, 0u) << "control: bounds are rounded";
}

TEST(PatchPackage, packedBaseMeshesOfAnyBytesAreSectionsOrErrors) {
  const NoisyPatches source(cubeSphere(1, 10, kSeed), 0, 0, kSeed);
  ScratchFolder folder;
  BuildOptions options;
  options.output = folder.file("a.relievo");
  options.coded_base = false;
  ASSERT_TRUE(buildPatchPackage(source, options).ok());
  const std::vector<uint8_t> file = readAll(options.output);
  const auto header = decodeHeader({file.data(), kHeaderBytes}, "");
  ASSERT_TRUE(header.ok());
  const auto first = file.begin() + static_cast<std::ptrdiff_t>(header->base_offset);
  const std::vector<uint8_t> packed(first, first + static_cast<std::ptrdiff_t>(header->base_bytes));
  const auto section = unpackBaseSection(packed, 6);
  ASSERT_TRUE(section.ok());
  EXPECT_EQ(section->size(), baseSectionBytes(8, 6));
  EXPECT_TRUE(decodeBaseSection(*section, 6).ok());
  EXPECT_EQ(packBaseSection(*section, 19), packed);
  for (size_t n = 0; n < packed.size(); ++n) {
    const std::vector<uint8_t> cut(packed.begin(), packed.begin() + static_cast<std::ptrdiff_t>(n));
    EXPECT_FALSE(unpackBaseSection(cut, 6).ok()) << n;
  }
  EXPECT_FALSE(unpackBaseSection(packed, 5).ok());
  EXPECT_FALSE(unpackBaseSection(packed, 7).ok());
  std::mt19937 random(kSeed);
  int errors = 0;
  for (int i = 0; i < 5000; ++i) {
    std::vector<uint8_t> bytes = packed;
    for (uint32_t n = 1 + random() % 4; n > 0; --n)
      bytes[random() % (random() % 2 ? bytes.size() : 24)] ^= static_cast<uint8_t>(1u << random() % 8);
    const auto unpacked = unpackBaseSection(bytes, 6);
    if (unpacked.ok()) (void)decodeBaseSection(*unpacked, 6);
    else ++errors;
  }
  EXPECT_GT(errors, 1000);
}

// What a reader and the build need for a packed section, as its frame's head says it (RFC 8878, 3.1.1.1.2): a window of
// at most a MiB, however large the section is.
TEST(PatchPackage, packedBaseMeshesTakeSmallWindows) {
  auto windowLogOf = [](uint32_t patches) {
    std::vector<uint8_t> section(baseSectionBytes(0, patches));
    storeLittle(section.data() + 4, patches);
    const std::vector<uint8_t> packed = packBaseSection(section, 19);
    EXPECT_EQ(*unpackBaseSection(packed, patches), section);
    return 10 + (packed[4 + 5] >> 3);
  };
  const auto patches_of_mib = static_cast<uint32_t>((uint64_t{1} << 20) / baseSectionBytes(0, 1));
  EXPECT_EQ(windowLogOf(5 * patches_of_mib), 20);
  EXPECT_LT(windowLogOf(patches_of_mib / 4), 20) << "control: those of small ones are as large as they are";
}

void expectSubsamplesAndBounds(bool compact) {
  // How far bounds of the base mesh's section are rounded: of a part of an error; of a block's share; of a
  // slope.
  const double part_steps = compact ? 6.6 : 255, share_steps = compact ? 14 : 200;
  const double slope_slack = compact ? 1.0 / 64 : 1e-5;
  NoisyPatches source(cubeSphere(1, 50, kSeed), 0, 2, kSeed);
  ScratchFolder folder;
  ASSERT_TRUE(build(folder.file("a.relievo"), source, 2, uint64_t{256} << 20, compact).ok());
  auto opened = Package::open(folder.file("a.relievo"));
  ASSERT_TRUE(opened.ok());
  const Package& package = **opened;
  const PatchDomain& d = package.manifest().domain;
  EXPECT_EQ(d.relief_depth, 2);
  EXPECT_EQ(package.manifest().error_unit_mm, source.errorUnitMm());
  PageDecoder decoder;
  std::vector<uint16_t> samples(kReliefPageSamples);
  std::vector<float> blocks(kReliefDetailBytes);
  std::vector<DeviationShape> shapes(kReliefDetailBytes);
  int narrow_shapes = 0, narrow_between = 0;
  uint64_t pages = 0;
  forEachNode(d, 2, [&](const NodeId& node) {
    ++pages;
    auto page = package.read(PageId(Plane::kRelief, node));
    ASSERT_TRUE(page.ok());
    ASSERT_TRUE(decoder.decodeRelief(page->bytes, samples).ok());
    const int step = 1 << (2 - static_cast<int>(node.level));
    const int x0 = static_cast<int>(node.x) * kPagePx * step, y0 = static_cast<int>(node.y) * kPagePx * step;
    for (int j = 0; j <= kPagePx; ++j)
      for (int i = 0; i <= kPagePx; ++i)
        ASSERT_EQ(samples[static_cast<size_t>(j * kReliefSamples + i)],
                  source.height(node.patch, x0 + i * step, y0 + j * step));
    int low = 65535, high = 0;
    for (int y = y0; y <= y0 + kPagePx * step; ++y)
      for (int x = x0; x <= x0 + kPagePx * step; ++x)
        low = std::min<int>(low, source.height(node.patch, x, y)),
        high = std::max<int>(high, source.height(node.patch, x, y));
    auto record = package.record(PageId(Plane::kRelief, node));
    ASSERT_TRUE(record.ok());
    EXPECT_NEAR(record->relief.min_mm, d.relief_offset_mm + low * d.relief_scale_mm, 1e-6);
    EXPECT_NEAR(record->relief.max_mm, d.relief_offset_mm + high * d.relief_scale_mm, 1e-6);
    // Errors: bounds of the source's, by no more than the steps they are kept in, or a finer block's where that is
    // larger.
    ASSERT_TRUE(package.reliefErrors(node, blocks));
    ASSERT_TRUE(package.reliefShapes(node, shapes));
    const int level = static_cast<int>(node.level);
    float largest = 0;
    for (size_t i = 0; i < blocks.size(); ++i) {
      const size_t across = size_t{16} << level, block = (node.y * 16 + i / 16) * across + node.x * 16 + i % 16;
      float finest = source.error(node.patch, level, block);
      Deviation all = deviationOf(finest, source.shape(node.patch, 7 + level, block));
      for (int finer = level + 1; finer < 2; ++finer)
        for (size_t k = 0; k < size_t{1} << 2 * (finer - level); ++k) {
          const size_t scale = size_t{1} << (finer - level), bx = block % across * scale + k % scale,
                       by = block / across * scale + k / scale;
          const float there = source.error(node.patch, finer, by * (across * scale) + bx);
          finest = std::max(finest, there);
          all = joined(all, deviationOf(there, source.shape(node.patch, 7 + finer, by * (across * scale) + bx)));
        }
      const Deviation kept = deviationOf(blocks[i], shapes[i]);
      for (auto part : {&Deviation::below_mm, &Deviation::above_mm, &Deviation::aside_mm}) {
        EXPECT_GE(kept.*part, all.*part);
        EXPECT_LE(kept.*part, all.*part + 1.001 * (source.errorUnitMm() + kept.mm / 255));
        narrow_shapes += kept.*part < 0.5 * kept.mm;
      }
      EXPECT_GE(kept.between_mm, all.between_mm);
      EXPECT_LE(kept.between_mm,
                all.between_mm + 1.001 * (source.errorUnitMm() + (kept.below_mm + kept.above_mm) / 255));
      EXPECT_GE(kept.apart_mm, all.apart_mm);
      EXPECT_LE(kept.apart_mm, all.apart_mm + 1.001 * (source.errorUnitMm() + kept.mm / 127));
      narrow_between += kept.between_mm < 0.5 * (kept.below_mm + kept.above_mm);
      largest = std::max(largest, finest);
      EXPECT_GE(blocks[i], finest);
      EXPECT_LE(blocks[i], finest * (1 + 1.0 / 16) + source.errorUnitMm() * 1.001);
    }
    EXPECT_GE(record->relief.error_mm, largest);
    EXPECT_LE(record->relief.error_mm, largest + source.errorUnitMm() * 1.001);
    if (level == 2) {
      EXPECT_EQ(record->relief.error_mm, 0);
    }
  });
  EXPECT_EQ(pages, 6u * 21);
  EXPECT_GT(narrow_shapes, 1000);
  EXPECT_GT(narrow_between, 1000);
  for (uint32_t p = 0; p < 6; ++p) {
    const CoarseErrors& e = package.manifest().coarse_errors[p];
    auto root = package.record(PageId(Plane::kRelief, NodeId{p, 0, 0, 0}));
    for (size_t k = 0; k < e.size(); ++k) {
      EXPECT_GE(e[k], source.coarseError(p, k));
      EXPECT_GE(e[k], k + 1 < e.size() ? e[k + 1] : root->relief.error_mm * (1 - 1e-6f));
    }
    const size_t cells = size_t{kPagePx} << source.reliefDepth(), row = cells + 1;
    std::vector<uint16_t> heights(row * row);
    ASSERT_TRUE(source.heights(p, heights).ok());
    std::array<double, 4> steepest{1e300, -1e300, 1e300, -1e300};
    for (size_t i = 0; i < heights.size(); ++i) {
      auto slope = [&](size_t to) {
        return (heights[to] - heights[i]) * source.reliefScaleMm() * static_cast<double>(cells);
      };
      if (i % row < cells)
        steepest = {std::min(steepest[0], slope(i + 1)), std::max(steepest[1], slope(i + 1)), steepest[2], steepest[3]};
      if (i / row < cells)
        steepest = {steepest[0], steepest[1], std::min(steepest[2], slope(i + row)),
                    std::max(steepest[3], slope(i + row))};
    }
    const HeightSlopes& known = package.manifest().height_slopes[p];
    EXPECT_LE(known.min_u, steepest[0]);
    EXPECT_GE(known.max_u, steepest[1]);
    EXPECT_LE(known.min_v, steepest[2]);
    EXPECT_GE(known.max_v, steepest[3]);
    EXPECT_NEAR(known.max_v - known.min_u, steepest[3] - steepest[0], slope_slack * (steepest[3] - steepest[0]));
    const CoarseShapes& coarse_shapes = package.manifest().coarse_shapes[p];
    auto expectKept = [&](double own_mm, const DeviationShape& own, double kept_mm, const DeviationShape& kept) {
      const Deviation was = deviationOf(own_mm, own), is = deviationOf(kept_mm, kept);
      for (auto part : {&Deviation::below_mm, &Deviation::above_mm, &Deviation::aside_mm}) {
        EXPECT_GE(is.*part, was.*part * (1 - 1e-6));
        EXPECT_LE(is.*part, was.*part + 1.001 * is.mm / part_steps);
      }
      EXPECT_GE(is.between_mm, was.between_mm * (1 - 1e-6));
      EXPECT_LE(is.between_mm, was.between_mm + 1.001 * (is.below_mm + is.above_mm) / part_steps);
      EXPECT_GE(is.apart_mm, was.apart_mm * (1 - 1e-6));
      EXPECT_LE(is.apart_mm, was.apart_mm + 2.002 * is.mm / part_steps);
    };
    for (size_t k = 0; k < kFirstShapedBlock; ++k)
      expectKept(source.coarseError(p, k), source.shape(p, static_cast<int>(k), 0), e[k], coarse_shapes[k]);
    const CoarseBlocks& shares = package.manifest().coarse_blocks[p];
    std::vector<float> finer(256);
    ASSERT_TRUE(package.reliefErrors({p, 0, 0, 0}, finer));
    int below_whole = 0;
    for (int grid = kBlockedGrids - 1; grid >= 0; --grid) {
      const int k = kFirstBlockedGrid + grid;
      const size_t side = size_t{1} << (k - 3);
      std::vector<float> of_grid(side * side);
      for (size_t i = 0; i < of_grid.size(); ++i) {
        of_grid[i] = coarseBlockMm(e[static_cast<size_t>(k)], shares[kFirstCoarseBlock[static_cast<size_t>(grid)] + i]);
        float largest = source.coarseBlock(p, k, i);
        for (size_t j = 0; j < 4; ++j) {
          // The root's blocks come back rounded once more.
          const float inside = finer[(2 * (i / side) + j / 2) * 2 * side + 2 * (i % side) + j % 2];
          EXPECT_GE(of_grid[i], grid == kBlockedGrids - 1 ? inside / (1 + 1.0f / 16) : inside);
          largest = std::max(largest, inside);
        }
        EXPECT_GE(of_grid[i], source.coarseBlock(p, k, i));
        expectKept(source.coarseBlock(p, k, i), source.shape(p, k, i), of_grid[i],
                   coarse_shapes[kFirstShapedBlock + kFirstCoarseBlock[static_cast<size_t>(grid)] + i]);
        EXPECT_LE(of_grid[i],
                  std::min<double>(e[static_cast<size_t>(k)], largest + e[static_cast<size_t>(k)] / share_steps));
        below_whole += of_grid[i] < 0.9f * e[static_cast<size_t>(k)];
      }
      finer = of_grid;
    }
    EXPECT_GT(below_whole, 0) << "all blocks are as bad as the whole";
  }
}
TEST(PatchPackage, reliefPagesAreSubsamplesAndTheirBoundsHold) { expectSubsamplesAndBounds(true); }
TEST(PatchPackage, reliefPagesAreSubsamplesAndTheirBoundsHoldInOlderOnes) { expectSubsamplesAndBounds(false); }

TEST(PatchPackage, keepsTheBaseMeshAndTellsOfTheScan) {
  NoisyPatches source(cubeSphere(2, 100, kSeed), 0, 0, kSeed);
  ScratchFolder folder;
  ASSERT_TRUE(build(folder.file("a.relievo"), source).ok());
  auto package = Package::open(folder.file("a.relievo"));
  ASSERT_TRUE(package.ok());
  const Manifest& m = (*package)->manifest();
  ASSERT_TRUE(m.base);
  EXPECT_EQ(*m.base, source.base());
  EXPECT_FALSE(m.domain.isFlat());
  EXPECT_EQ(m.domain.patchCount(), 24u);
  EXPECT_EQ(m.texture.basis, Basis::kAlbedoNormal);
  double mean = 0;
  for (const auto& p : m.base->patches)
    for (auto [a, b] : {std::pair{0, 1}, {0, 2}, {1, 3}, {2, 3}})
      mean += glm::distance(m.base->corners[p[static_cast<size_t>(a)]].position_mm,
                            m.base->corners[p[static_cast<size_t>(b)]].position_mm) /
              96.0;
  EXPECT_NEAR(m.domain.mm_per_px * 128, mean, 1e-4 * mean);
  auto json = nlohmann::json::parse((*package)->manifestJson());
  EXPECT_EQ(json["mesh"]["pieces"], 3);
  EXPECT_EQ(json["version"], 12);
  EXPECT_EQ(json["base"]["corners"], source.base().corners.size());
  EXPECT_EQ(m.sources.at(0).name, "noise, seed 17");
}

BaseMesh cutSphere() {
  BaseMesh cut = cubeSphere(2, 100, kSeed);
  cut.cut = true;
  return cut;
}

// Patches that are cut are told from version 11 on, however the index is stored; older storage cannot.
TEST(PatchPackage, keepsThatPatchesAreCut) {
  const BaseMesh cut = cutSphere();
  const NoisyPatches source(cut, 0, 0, kSeed);
  ScratchFolder folder;
  const std::string path = folder.file("a.relievo");
  constexpr uint64_t kBudget = uint64_t{256} << 20;
  for (const auto& [by_border, coded_index] : {std::pair{false, false}, {false, true}, {true, false}, {true, true}}) {
    ASSERT_TRUE(build(path, source, 2, kBudget, true, coded_index, by_border).ok());
    auto package = Package::open(path);
    ASSERT_TRUE(package.ok()) << package.error().text();
    EXPECT_EQ(*(*package)->manifest().base, cut);
    EXPECT_EQ((*package)->header().coded_index, coded_index);
    EXPECT_EQ((*package)->header().base_by_border, by_border);
    const auto json = nlohmann::json::parse((*package)->manifestJson());
    EXPECT_EQ(json["version"], by_border ? 14 : 11);
    EXPECT_EQ((*package)->manifest().tail_edges, by_border);
    EXPECT_EQ(json["base"]["cut"], true);
    std::vector<uint16_t> samples(kReliefPageSamples), truth(kReliefPageSamples);
    for (uint32_t p = 0; p < cut.patches.size(); ++p) {
      auto page = (*package)->read(PageId(Plane::kRelief, {p, 0, 0, 0}));
      ASSERT_TRUE(page.ok() && source.heights(p, truth).ok()) << p;
      ASSERT_TRUE(PageDecoder().decodeRelief(page->bytes, samples).ok()) << p;
      EXPECT_TRUE(samples == truth) << p;
    }
  }
  BuildOptions twelve;
  twelve.output = path;
  twelve.tail_edges = false;
  ASSERT_TRUE(buildPatchPackage(source, twelve).ok());
  const auto package = Package::open(path);
  ASSERT_TRUE(package.ok()) << package.error().text();
  EXPECT_EQ(packageVersion((*package)->header()), 12u);
  EXPECT_EQ(*(*package)->manifest().base, cut);
  EXPECT_FALSE((*package)->manifest().tail_edges);
  const auto refused = build(path, source, 2, kBudget, false);
  ASSERT_FALSE(refused.ok());
  EXPECT_NE(refused.error().text().find("need a package of version 11"), std::string::npos) << refused.error().text();
}

// Another kind of storage is a later version's.
TEST(PatchPackage, refusesOtherKindsOfStorage) {
  const NoisyPatches source(cutSphere(), 0, 0, kSeed);
  ScratchFolder folder;
  const std::string path = folder.file("a.relievo");
  struct Field {
    uint32_t at, kind;
    std::string words;
  };
  for (const bool by_border : {false, true}) {
    ASSERT_TRUE(build(path, source, 2, uint64_t{256} << 20, true, true, by_border).ok());
    const std::vector<uint8_t> sound = readAll(path);
    const std::string version = by_border ? "version 14" : "version 11";
    std::vector<Field> fields{{2076, 1, ""},
                              {2076, 2, "interpolated by kind 1 in " + version + ", found 2"},
                              {2072, 1, "an index of kind 2"}};
    if (by_border) {
      fields.push_back({2052, 3, "expected storage of kind 4 in version 14, found 3"});
      fields.push_back({2052, 5, "expected storage of kind 4 in version 14, found 5"});
      fields.push_back({2072, 0, "expected tails of kind 1 in version 14, found 2"});
    } else {
      fields.push_back({2076, 0, "interpolated by kind 1 in version 11, found 0"});
      fields.push_back({2072, 0, "expected storage of kind 2 in version 11, found 3"});
    }
    for (const Field& field : fields) {
      std::vector<uint8_t> other = sound;
      for (uint8_t* head : {other.data(), other.data() + other.size() - kHeaderBytes}) {
        storeLittle(head + field.at, field.kind);
        storeLittle(head + kHeaderBytes - 8, static_cast<uint64_t>(XXH3_64bits(head, kHeaderBytes - 8)));
      }
      writeAll(path, other);
      const auto found = Package::open(path);
      EXPECT_EQ(found.ok(), field.words.empty()) << field.at << " " << field.kind;
      if (!found.ok()) {
        EXPECT_NE(found.error().text().find(field.words), std::string::npos) << found.error().text();
      }
    }
  }
}

TEST(PatchPackage, theSameBytesForAnyWorkersAndMemory) {
  if (test::kSanitized) GTEST_SKIP() << "about figures; others build packages under the sanitizer";
  NoisyPatches source(cubeSphere(2, 100, kSeed), 1, 1, kSeed);
  ScratchFolder folder;
  std::vector<std::vector<uint8_t>> all;
  for (auto [workers, budget] :
       {std::pair{1, 256}, {2, 256}, {3, 256}, {3, 1}}) {  // the last keeps all it can in files
    const std::string path = folder.file("a.relievo");
    ASSERT_TRUE(build(path, source, workers, static_cast<uint64_t>(budget) << 20).ok());
    EXPECT_EQ(folder.entries(), 1u);
    all.push_back(readAll(path));
  }
  for (size_t i = 1; i < all.size(); ++i) EXPECT_TRUE(all[0] == all[i]) << i;
  // Negative control: another source gives others.
  NoisyPatches other(cubeSphere(2, 100, kSeed), 1, 1, kSeed + 1);
  ASSERT_TRUE(build(folder.file("a.relievo"), other).ok());
  EXPECT_FALSE(all[0] == readAll(folder.file("a.relievo")));
}

// A source with one sample off, or one that fails.
class FaultyPatches final : public NoisyPatches {
 public:
  enum class Fault { kNone, kSide, kCorner, kInside, kFails, kErrorTooLarge, kNotANumber };
  FaultyPatches(BaseMesh base, Fault fault) : NoisyPatches(std::move(base), 0, 0, kSeed), fault_(fault) {}
  uint16_t height(uint32_t patch, int x, int y) const override {
    const uint16_t h = NoisyPatches::height(patch, x, y);
    const bool here = patch == 4 && ((fault_ == Fault::kSide && x == 0 && y == 50) ||
                                     (fault_ == Fault::kCorner && x == 128 && y == 0) ||
                                     (fault_ == Fault::kInside && x == 7 && y == 9));
    return here ? static_cast<uint16_t>(h + 1) : h;
  }
  Result<void> texels(uint32_t patch, std::span<uint8_t> out) const override {
    if (fault_ == Fault::kFails && patch == 4) return Error{ErrorKind::kIo, "scan.ply", "no more", "", {}};
    return NoisyPatches::texels(patch, out);
  }
  Result<void> errors(uint32_t patch, int level, std::span<float> out) const override {
    auto done = NoisyPatches::errors(patch, level, out);
    if (patch == 4 && fault_ == Fault::kErrorTooLarge) out[3] = 22.0f;  // 65,535 units are 21.8 mm
    if (patch == 4 && fault_ == Fault::kNotANumber) out[3] = NAN;
    return done;
  }

 private:
  Fault fault_;
};

TEST(PatchPackage, sourcesThatWouldCrackOrFailAreRefusedByName) {
  using Fault = FaultyPatches::Fault;
  ScratchFolder folder;
  auto refusal = [&](Fault fault) {
    auto built = build(folder.file("a.relievo"), FaultyPatches(cubeSphere(1, 10, kSeed), fault));
    const size_t entries = folder.entries();
    std::filesystem::remove(folder.file("a.relievo"));
    EXPECT_EQ(entries, built.ok() ? 1u : 0u);
    return built.ok() ? std::string() : built.error().text();
  };
  EXPECT_EQ(refusal(Fault::kNone), "");
  EXPECT_EQ(refusal(Fault::kInside), "");  // control: nobody else has that sample
  const std::string side = refusal(Fault::kSide), corner = refusal(Fault::kCorner);
  EXPECT_NE(side.find("differ along the side that they share"), std::string::npos) << side;
  EXPECT_NE(side.find("4"), std::string::npos) << side;
  EXPECT_NE(corner.find("differ"), std::string::npos) << corner;
  EXPECT_EQ(refusal(Fault::kFails), "scan.ply: no more");
  EXPECT_NE(refusal(Fault::kErrorTooLarge).find("patch 4: its error of 22"), std::string::npos);
  EXPECT_NE(refusal(Fault::kNotANumber).find("patch 4"), std::string::npos);
}

TEST(PatchPackage, unfitMeshesAreRefused) {
  ScratchFolder folder;
  auto refused = [&](BaseMesh base, int texture_depth = 0, int relief_depth = 0) {
    auto built = build(folder.file("a.relievo"), NoisyPatches(std::move(base), texture_depth, relief_depth, kSeed));
    EXPECT_EQ(folder.entries(), 0u);
    return built.ok() ? std::string() : built.error().text();
  };
  BaseMesh good = cubeSphere(1, 10, kSeed), bad = good;
  bad.patches[2][1] = 99;
  EXPECT_NE(refused(bad).find("corner 99"), std::string::npos);
  bad = good;
  bad.patches.clear();
  EXPECT_NE(refused(bad).find("no patch"), std::string::npos);
  EXPECT_NE(refused(good, -1), "");
  EXPECT_NE(refused(good, 18), "");
  EXPECT_NE(refused(good, 0, -1), "");
  EXPECT_NE(refused(good, 0, 18), "");
}

// Whoever reads patch 12 presses Ctrl-C.
class StoppingPatches final : public NoisyPatches {
 public:
  using NoisyPatches::NoisyPatches;
  Result<void> texels(uint32_t patch, std::span<uint8_t> out) const override {
    if (patch == 12) stop = true;
    return NoisyPatches::texels(patch, out);
  }
  mutable std::atomic<bool> stop{false};
};

TEST(PatchPackage, interruptedOrOutOfSpaceItLeavesNothing) {
  StoppingPatches source(cubeSphere(2, 100, kSeed), 1, 0, kSeed);
  ScratchFolder folder;
  const std::string path = folder.file("a.relievo");
  BuildOptions o;
  o.output = path;
  o.workers = 2;
  o.interrupted = &source.stop;
  auto built = buildPatchPackage(source, o);
  ASSERT_FALSE(built.ok());
  EXPECT_EQ(built.error().kind, ErrorKind::kInterrupted);
  EXPECT_EQ(folder.entries(), 0u);

  rlimit before{};
  ASSERT_EQ(::getrlimit(RLIMIT_FSIZE, &before), 0);
  auto handler = std::signal(SIGXFSZ, SIG_IGN);
  rlimit small{uint64_t{1} << 20, before.rlim_max};
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &small), 0);
  built = build(path, source);
  auto with_files = build(path, source, 2, 1);
  ::setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, handler);
  ASSERT_FALSE(built.ok());
  EXPECT_EQ(built.error().kind, ErrorKind::kIo);
  ASSERT_FALSE(with_files.ok());
  EXPECT_EQ(with_files.error().kind, ErrorKind::kIo);
  EXPECT_EQ(folder.entries(), 0u);
  EXPECT_TRUE(build(path, source).ok());
}

// ---- damaged and hostile files ----
class BaseOfPackage : public ::testing::Test {
 protected:
  void SetUp() override {
    ASSERT_TRUE(build(path_, NoisyPatches(mesh_, 0, 0, kSeed), 2, uint64_t{256} << 20, false).ok());
    bytes_ = readAll(path_);
    auto header = decodeHeader({bytes_.data(), kHeaderBytes}, path_);
    ASSERT_TRUE(header.ok());
    header_ = *header;
  }
  // Fields of both headers, and of both base sections, with fitting checksums: what an attacker would do.
  template <class T>
  void setField(size_t offset, T value) {
    for (uint8_t* head : {bytes_.data(), bytes_.data() + bytes_.size() - kHeaderBytes}) {
      storeLittle(head + offset, value);
      storeLittle(head + kHeaderBytes - 8, static_cast<uint64_t>(XXH3_64bits(head, kHeaderBytes - 8)));
    }
  }
  template <class T>
  void setBase(size_t offset, T value) {
    for (uint64_t at : {header_.base_offset, header_.base_copy_offset}) storeLittle(bytes_.data() + at + offset, value);
    setField(280, static_cast<uint64_t>(XXH3_64bits(bytes_.data() + header_.base_offset, header_.base_bytes)));
  }
  // What opening says; empty when it opens.
  std::string refusal() {
    writeAll(damaged_, bytes_);
    auto package = Package::open(damaged_);
    bytes_ = readAll(path_);
    if (package.ok()) {
      warnings_ = (*package)->warnings();
      return {};
    }
    EXPECT_EQ(package.error().file, damaged_);
    return package.error().text();
  }
  template <class T>
  std::string withField(size_t offset, T value) {
    setField(offset, value);
    return refusal();
  }
  template <class T>
  std::string withBase(size_t offset, T value) {
    setBase(offset, value);
    return refusal();
  }

  ScratchFolder folder_;
  std::string path_ = folder_.file("a.relievo"), damaged_ = folder_.file("b.relievo");
  BaseMesh mesh_ = cubeSphere(1, 10, kSeed);  // 8 corners, 6 patches
  std::vector<uint8_t> bytes_;
  std::vector<std::string> warnings_;
  PackageHeader header_;
};

TEST_F(BaseOfPackage, hostileHeaderFieldsAreRefused) {
  EXPECT_EQ(header_.base_bytes, baseSectionBytes(8, 6));
  EXPECT_EQ(withField(280, header_.base_hash), "") << "control: a field set to what it is";
  for (uint64_t huge : {uint64_t{1} << 62, ~uint64_t{0}, ~uint64_t{0} - 4096, uint64_t{1} << 44, uint64_t{1} << 36}) {
    for (size_t field : {264u, 272u, 288u}) EXPECT_NE(withField(field, huge), "") << field << " " << huge;
  }
  EXPECT_NE(withField(272, uint64_t{0}), "");
  EXPECT_NE(withField(272, header_.base_bytes - 1), "");
  EXPECT_NE(withField(272, uint64_t{39}), "");
  EXPECT_EQ(withField(264, uint64_t{0}), "");
  EXPECT_EQ(warnings_.size(), 1u) << "the header is no base mesh, but there is the copy";
  EXPECT_NE(withField(132, int32_t{-1}), "") << "a mesh without relief";
  EXPECT_NE(withField(136, uint32_t{4}).find("expected basis 0, 1 or 2 or 3"), std::string::npos);
  // The strip of whole patches.
  setField(88, uint64_t{6 * 128 - 1});
  EXPECT_NE(refusal(), "");
  setField(96, uint64_t{127});
  EXPECT_NE(refusal(), "");
  // Version 1 knows no albedo and normal, version 3 no basis by its number, versions 4 to 16 say how they store things,
  // and version 19 is yet to come.
  EXPECT_NE(withField(8, uint32_t{1}).find("expected basis 0, 1 or 2, found 3"), std::string::npos);
  EXPECT_NE(withField(8, uint32_t{3}).find("expected no number of a basis in version 3, found 3"), std::string::npos);
  EXPECT_NE(withField(8, uint32_t{4}).find("expected storage of kind 1 in version 4, found 0"), std::string::npos);
  EXPECT_NE(withField(8, uint32_t{5}).find("expected storage of kind 1 in version 5, found 0"), std::string::npos);
  EXPECT_NE(withField(8, uint32_t{6}).find("expected storage of kind 1 in version 6, found 0"), std::string::npos);
  EXPECT_NE(withField(8, uint32_t{7}).find("expected storage of kind 1 in version 7, found 0"), std::string::npos);
  EXPECT_NE(withField(8, uint32_t{8}).find("expected storage of kind 1 in version 8, found 0"), std::string::npos);
  EXPECT_NE(withField(8, uint32_t{10}).find("expected storage of kind 1 in version 10, found 0"), std::string::npos);
  EXPECT_NE(withField(8, uint32_t{11}).find("expected storage of kind 1 in version 11, found 0"), std::string::npos);
  EXPECT_NE(withField(8, uint32_t{12}).find("expected storage of kind 1 in version 12, found 0"), std::string::npos);
  EXPECT_NE(withField(8, uint32_t{20}).find("version 1 to 19, found 20"), std::string::npos);
}

TEST_F(BaseOfPackage, hostileSectionsAreRefusedByName) {
  auto expect = [&](const std::string& found, const std::string& words) {
    EXPECT_NE(found.find(words), std::string::npos) << found;
  };
  EXPECT_EQ(withBase(0, uint32_t{8}), "") << "control: a field set to what it is";
  for (uint32_t corners : {0u, 7u, 9u, ~0u, 1u << 31})
    expect(withBase(0, corners), std::to_string(corners) + " corners and 6 patches take");
  for (uint32_t patches : {0u, 5u, ~0u})
    expect(withBase(4, patches), "expected 6 patches, found " + std::to_string(patches));
  expect(withBase(8, double{NAN}), "the origin is not finite");
  expect(withBase(32, double{NAN}), "unit of errors");
  expect(withBase(32, -1.0), "unit of errors");
  expect(withBase(40, std::numeric_limits<float>::infinity()), "corner 0 has no finite position");
  expect(withBase(40 + 24 + 12, 7.0f), "the normal of corner 1 is not of length 1");
  const size_t patches = 40 + 24 * 8, errors = patches + 16 * 6;
  expect(withBase(patches + 16, uint32_t{8}), "patch 1 names corner 8, which does not exist");
  expect(withBase(patches + 16, ~uint32_t{0}), "patch 1 names corner 4294967295");
  setBase(patches + 32, uint32_t{5});
  setBase(patches + 36, uint32_t{5});
  expect(refusal(), "patch 2 names a corner twice");
  const size_t slopes = errors + (28 + 84) * 6;
  for (float s : {NAN, INFINITY, 1e30f})
    expect(withBase(slopes + 16 * 4, s), "the slopes of patch 4 are not ranges of numbers");
  for (float e : {NAN, -1.0f, INFINITY}) expect(withBase(errors + 28 * 3, e), "the errors of patch 3");
  setBase(errors + 28 * 5, 1.0f);
  setBase(errors + 28 * 5 + 4, 2.0f);
  expect(refusal(), "the errors of patch 5 are not bounds that fall from level to level");
}

// Where no grid has an error nothing is kept of its parts, and what lies behind is found all the same.
TEST_F(BaseOfPackage, withoutErrorsNothingIsSaidOfParts) {
  const std::vector<uint8_t> good(
      bytes_.begin() + static_cast<std::ptrdiff_t>(header_.base_offset),
      bytes_.begin() + static_cast<std::ptrdiff_t>(header_.base_offset + header_.base_bytes));
  auto section = decodeBaseSection(good, 6);
  ASSERT_TRUE(section.ok());
  ASSERT_EQ(section->coarse_blocks.size(), 6u);
  section->texture_depths = {0, 1, -1, 2, 0, 3};
  for (const bool any_error : {true, false}) {
    for (CoarseErrors& errors : section->coarse_errors) errors.fill(0);
    if (any_error) section->coarse_errors[3][0] = 0.5f;
    const auto back = decodeBaseSection(encodeBaseSection(*section), 6);
    ASSERT_TRUE(back.ok()) << back.error().text();
    EXPECT_EQ(back->coarse_errors, section->coarse_errors);
    EXPECT_EQ(back->coarse_blocks.size(), any_error ? 6u : 0u);
    EXPECT_EQ(back->shapes.size(), any_error ? 6u : 0u);
    EXPECT_EQ(back->slopes, section->slopes);
    EXPECT_EQ(back->texture_depths, section->texture_depths);
  }
}

// As packages were before they knew shapes of errors, and before they knew slopes.
TEST_F(BaseOfPackage, shapesAndSlopesMayBeMissing) {
  const std::vector<uint8_t> good(
      bytes_.begin() + static_cast<std::ptrdiff_t>(header_.base_offset),
      bytes_.begin() + static_cast<std::ptrdiff_t>(header_.base_offset + header_.base_bytes));
  auto whole = decodeBaseSection(good, 6);
  ASSERT_TRUE(whole.ok());
  EXPECT_EQ(whole->slopes.size(), 6u);
  EXPECT_EQ(whole->shapes.size(), 6u);
  std::vector<uint8_t> older(good.begin(), good.end() - 6 * static_cast<std::ptrdiff_t>(kBaseShapesBytes));
  auto without_shapes = decodeBaseSection(older, 6);
  ASSERT_TRUE(without_shapes.ok()) << without_shapes.error().text();
  EXPECT_TRUE(without_shapes->shapes.empty());
  EXPECT_EQ(without_shapes->slopes, whole->slopes);
  EXPECT_EQ(encodeBaseSection(*without_shapes), older);
  older.resize(older.size() - 6 * kBaseSlopesBytes);
  auto without = decodeBaseSection(older, 6);
  ASSERT_TRUE(without.ok()) << without.error().text();
  EXPECT_TRUE(without->slopes.empty());
  EXPECT_EQ(without->coarse_errors, whole->coarse_errors);
  EXPECT_EQ(encodeBaseSection(*without), older);
  // Control: a part of them is no section.
  older.push_back(0);
  EXPECT_FALSE(decodeBaseSection(older, 6).ok());
}

// Any bytes with a fitting checksum: a fit mesh or one clear error, and nothing is allocated that the bytes do not
// hold.
TEST_F(BaseOfPackage, anyBytesAreAFitMeshOrAnError) {
  std::cout << "seed " << kSeed << "\n";
  std::mt19937 random(kSeed);
  const std::vector<uint8_t> good(
      bytes_.begin() + static_cast<std::ptrdiff_t>(header_.base_offset),
      bytes_.begin() + static_cast<std::ptrdiff_t>(header_.base_offset + header_.base_bytes));
  int fit = 0, errors = 0;
  for (int i = 0; i < 20000; ++i) {
    std::vector<uint8_t> bytes = good;
    for (uint32_t n = 1 + random() % 4; n > 0; --n)
      bytes[random() % 3 ? random() % bytes.size() : random() % kBaseHeadBytes] ^=
          static_cast<uint8_t>(1u << random() % 8);
    if (random() % 4 == 0) bytes.resize(random() % 1000);
    auto section = decodeBaseSection(bytes, random() % 8 ? 6 : static_cast<uint32_t>(random()));
    if (section.ok()) {
      ++fit;
      ASSERT_EQ(baseMeshProblem(section->mesh), "");
      ASSERT_EQ(section->coarse_errors.size(), section->mesh.patches.size());
    } else {
      ++errors;
      ASSERT_NE(section.error().message.find("the base mesh is damaged"), std::string::npos);
    }
  }
  EXPECT_GT(fit, 1000);
  EXPECT_GT(errors, 1000);
}

TEST_F(BaseOfPackage, damagedItIsReadFromItsCopy) {
  for (size_t i = 0; i < header_.base_bytes; i += kSanitized ? 97 : 7) {
    bytes_[header_.base_offset + i] ^= 16;
    EXPECT_EQ(refusal(), "");
    ASSERT_EQ(warnings_.size(), 1u);
    EXPECT_NE(warnings_[0].find("its copy is used"), std::string::npos);
  }
  bytes_[header_.base_copy_offset + 50] ^= 1;
  EXPECT_EQ(refusal(), "");
  EXPECT_TRUE(warnings_.empty()) << "nobody needs the copy";
  // Negative control: both damaged.
  bytes_[header_.base_offset + 50] ^= 1;
  bytes_[header_.base_copy_offset + 60] ^= 1;
  EXPECT_NE(refusal().find("the base mesh is damaged: its checksum does not match"), std::string::npos);
}

// What can be read after any byte was flipped is what was written, and verify knows of the rest.
TEST_F(BaseOfPackage, aFlippedByteIsSeenOrHarmless) {
  auto content = [](const Package& package) {  // empty where a page is damaged
    std::vector<std::vector<uint8_t>> pages;
    for (uint32_t p = 0; p < 6; ++p)
      for (Plane plane : {Plane::kTexture0, texturePlane(1), Plane::kRelief}) {
        auto page = package.read(PageId(plane, NodeId{p, 0, 0, 0}));
        pages.push_back(page.ok() ? page->bytes : std::vector<uint8_t>());
      }
    return pages;
  };
  auto whole = Package::open(path_);
  ASSERT_TRUE(whole.ok());
  const auto truth = content(**whole);
  const auto coarse = (*whole)->manifest().coarse_errors;
  size_t seen = 0, harmless = 0, damaged_pages = 0;
  for (size_t i = 0; i < bytes_.size(); i += (i < header_.pages_offset ? 41 : 2999) * (kSanitized ? 5 : 1)) {
    bytes_[i] ^= static_cast<uint8_t>(1u << i % 8);
    writeAll(damaged_, bytes_);
    bytes_[i] ^= static_cast<uint8_t>(1u << i % 8);
    auto package = Package::open(damaged_);
    if (!package.ok()) {
      EXPECT_EQ(package.error().kind, ErrorKind::kUnsupported)
          << i << ": " << package.error().text();  // another version
      ++seen;
      continue;
    }
    EXPECT_EQ(*(*package)->manifest().base, mesh_);
    EXPECT_EQ((*package)->manifest().coarse_errors, coarse);
    const auto now = content(**package);
    size_t lost = 0;
    for (size_t k = 0; k < now.size(); ++k) {
      lost += now[k].empty();
      EXPECT_TRUE(now[k].empty() || now[k] == truth[k]) << "byte " << i;
    }
    auto report = verifyPackage(**package, 1, nullptr);
    ASSERT_TRUE(report.ok());
    const bool known = !report->damaged.empty() || !report->other.empty();
    EXPECT_TRUE(known || lost == 0) << "byte " << i;
    ++(known ? seen : harmless);
    damaged_pages += lost;
  }
  EXPECT_GT(seen, kSanitized ? 20u : 100u);
  EXPECT_GT(damaged_pages, kSanitized ? 1u : 5u);
  EXPECT_EQ(harmless, 0u) << "the padding, the second header and the base mesh's copy included";
}

// Either copy of the base mesh is named by its place, and written anew from the other; with both gone nothing is
// touched.
TEST_F(BaseOfPackage, damagedCopiesAreNamedAndRepaired) {
  const std::pair<uint64_t, uint64_t> copies[] = {{header_.base_offset, header_.base_copy_offset},
                                                  {header_.base_copy_offset, header_.base_offset}};
  for (auto [at, other] : copies) {
    std::vector<uint8_t> broken = bytes_;
    for (uint64_t i = 7; i < header_.base_bytes; i += 13) broken[at + i] ^= 0x21;
    writeAll(damaged_, broken);
    auto package = Package::open(damaged_);
    ASSERT_TRUE(package.ok());
    auto report = verifyPackage(**package, 1, nullptr);
    ASSERT_TRUE(report.ok());
    ASSERT_EQ(report->other.size(), 1u);
    EXPECT_EQ(report->other[0], "the base mesh at byte " + std::to_string(at) + " is damaged; its copy at byte " +
                                    std::to_string(other) + " is sound");
    auto repaired = repairPackage(damaged_);
    ASSERT_TRUE(repaired.ok()) << repaired.error().text();
    EXPECT_EQ(repaired->size(), 1u);
    EXPECT_TRUE(readAll(damaged_) == bytes_);
  }
  std::vector<uint8_t> broken = bytes_;
  for (auto [at, other] : copies) broken[at] ^= 1;
  writeAll(damaged_, broken);
  EXPECT_FALSE(repairPackage(damaged_).ok());
  EXPECT_TRUE(readAll(damaged_) == broken);
}

TEST_F(BaseOfPackage, everyTruncationOpensOrFailsCleanly) {
  size_t opened = 0, refused = 0;
  for (size_t n = 0; n < bytes_.size(); n += n < header_.pages_offset ? 331 : 40009) {
    writeAll(damaged_, {bytes_.data(), n});
    auto package = Package::open(damaged_);
    if (package.ok()) {
      ++opened;
      ASSERT_TRUE((*package)->manifest().base);
      EXPECT_EQ(*(*package)->manifest().base, mesh_);
      EXPECT_FALSE((*package)->warnings().empty());
    } else {
      ++refused;
      EXPECT_EQ(package.error().kind, ErrorKind::kInvalidData);
    }
  }
  EXPECT_GT(opened, 10u);
  EXPECT_GT(refused, 10u);
}

// Patches without relief or errors, which say so or do not.
class EvenPatches final : public NoisyPatches {
 public:
  EvenPatches(int relief_depth, bool said) : NoisyPatches(cutSphere(), 0, relief_depth, kSeed), said_(said) {}
  bool patchesAreEven() const override { return said_; }
  Result<void> heights(uint32_t /*patch*/, std::span<uint16_t> out) const override {
    ++height_calls;
    std::fill(out.begin(), out.end(), uint16_t{27'306});
    return {};
  }
  Result<void> errors(uint32_t /*patch*/, int /*level*/, std::span<float> out_mm) const override {
    std::fill(out_mm.begin(), out_mm.end(), 0.0f);
    return {};
  }
  Result<bool> coarseBlocks(uint32_t /*patch*/, int /*cells_log2*/, std::span<float> out_mm) const override {
    std::fill(out_mm.begin(), out_mm.end(), 0.0f);
    return true;
  }
  Result<CoarseErrors> coarseErrors(uint32_t /*patch*/) const override { return CoarseErrors{}; }
  bool errorShapes(uint32_t, int, std::span<DeviationShape>) const override { return false; }
  mutable std::atomic<int> height_calls{0};

 private:
  bool said_;
};

TEST(PatchPackage, evenPatchesAreLookedAtOnce) {
  ScratchFolder folder;
  const std::string path = folder.file("a.relievo");
  constexpr uint64_t kBudget = uint64_t{256} << 20;
  for (const int relief_depth : {0, 1})
    for (const bool light : {false, true}) {
      std::vector<std::vector<uint8_t>> bytes;
      std::vector<int> calls;
      for (const bool said : {false, true}) {
        const EvenPatches source(relief_depth, said);
        ASSERT_TRUE(build(path, source, 2, kBudget, true, light).ok());
        bytes.push_back(readAll(path));
        calls.push_back(source.height_calls);
      }
      EXPECT_TRUE(bytes[0] == bytes[1]) << relief_depth << " " << light;
      EXPECT_EQ(calls[0], 2 * 24) << "described, then written";
      EXPECT_LE(calls[1], 2 * 2) << "once a worker";
    }
}

TEST(FlatPackage, staysVersionOne) {
  ScratchFolder folder;
  NoisyTexture texture(300, 200, Basis::kPtmLrgb, 1);
  NoisyHeights heights(300, 200, 2);
  BuildOptions o;
  o.output = folder.file("a.relievo");
  ASSERT_TRUE(buildPackage(texture, &heights, o).ok());
  auto bytes = readAll(o.output);
  EXPECT_EQ(loadLittle<uint32_t>(bytes.data() + 8), 1u);
  EXPECT_TRUE(std::all_of(bytes.begin() + 264, bytes.begin() + kHeaderBytes - 8, [](uint8_t b) { return b == 0; }));
  auto package = Package::open(o.output);
  ASSERT_TRUE(package.ok());
  const Manifest& m = (*package)->manifest();
  EXPECT_FALSE(m.base);
  EXPECT_TRUE(m.coarse_errors.empty());
  EXPECT_EQ(m.error_unit_mm, m.domain.relief_scale_mm);
  EXPECT_EQ(nlohmann::json::parse((*package)->manifestJson())["version"], 1);
}

}  // namespace patch_package_test
}  // namespace relievo
