// Virtual equals dense over the whole way: a sample artwork of 2048 x 2048 texels with relief, built into a package,
// against the oracle that reads the same sources. 20 random views of each PTM basis (RELIEVO_LONG_TESTS=1: 100 of 4096
// x 4096 texels).
#include "tests/render/test_artwork.h"
#include "tests/render/virtual_equals_dense.h"
#include "texturing/package/package_builder.h"
#include "tools/sample/sample_artwork.h"

namespace relievo {
namespace sample_equals_dense_gltest {

using namespace test;

class SampleEqualsDense : public testing::TestWithParam<Basis> {};

TEST_P(SampleEqualsDense, RandomViews) {
  TemporaryFolder folder;
  const int side = test::longTests() ? 4096 : 2048;
  SampleArtwork sample({.kind = SampleKind::kInscription, .width = side, .height = side, .seed = 3});
  auto texture = sample.ptmSource(GetParam());
  auto heights = sample.heightSource();
  BuildOptions options;
  options.output = folder.file("sample.relievo");
  options.mm_per_px = sample.mmPerPx();
  auto built = buildPackage(*texture, heights.get(), options);
  ASSERT_TRUE(built.ok()) << built.error().text();
  auto package = Package::open(options.output);
  ASSERT_TRUE(package.ok()) << package.error().text();
  Subject s;
  s.artwork = artworkFromPackage(*package);
  const FlatDomain domain = s.artwork.manifest.domain.flat();
  auto dense = buildDenseTexture(*texture, domain);
  ASSERT_TRUE(dense.ok());
  s.texture = std::make_shared<DenseTexture>(std::move(*dense));
  auto relief = buildDenseRelief(*heights, domain);
  ASSERT_TRUE(relief.ok());
  s.relief = std::make_shared<DenseRelief>(std::move(*relief));
  expectEqual(compare(s, {}, {.views = test::longTests() ? 100 : 40}), basisName(GetParam()));
}

INSTANTIATE_TEST_SUITE_P(Bases, SampleEqualsDense, testing::Values(Basis::kPtmLrgb, Basis::kPtmRgb), [](const auto& i) {
  return i.param == Basis::kPtmLrgb ? std::string("Lrgb") : std::string("Rgb");
});

}  // namespace sample_equals_dense_gltest
}  // namespace relievo
