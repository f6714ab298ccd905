// Packages against a naive dense pyramid, page by page and byte by byte.
#include "texturing/package_builder.h"

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <csignal>
#include <fstream>
#include <thread>

#include "package_fixture.h"
#include "texturing/package.h"

namespace relievo {
namespace {

using namespace testing_support;

[[maybe_unused]] std::string fileBytes(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

Result<BuildReport> build(const std::string& path, const TextureSource& t, const HeightSource* h = nullptr, int workers = 2,
                          uint64_t budget = uint64_t{256} << 20) {
  BuildOptions o;
  o.output = path;
  o.workers = workers;
  o.mm_per_px = 0.25;
  o.memory_budget_bytes = budget;
  o.tool_version = "test";
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
  const PlanarDomain& d = (*package)->manifest().domain;
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
      ASSERT_EQ(channels, naivePage(levels, d, n, k)) << "level " << n.level << " x " << n.x << " y " << n.y << " plane " << k;
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
                                            ::testing::Values(Size{1, 1}, Size{1, 300}, Size{257, 1}, Size{127, 127}, Size{128, 128}, Size{129, 129},
                                                              Size{130, 300}, Size{700, 300}, Size{300, 1300}, Size{1153, 1041})));
INSTANTIATE_TEST_SUITE_P(Others, EveryPage,
                         ::testing::Combine(::testing::Values(Basis::kColour, Basis::kPtmRgb),
                                            ::testing::Values(Size{1, 1}, Size{5, 3}, Size{129, 127}, Size{700, 300}, Size{1100, 520})));

}  // namespace
}  // namespace relievo
