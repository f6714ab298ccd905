// Virtual equals dense (virtual_equals_dense.h) for linear bases beside the PTM's: nothing but their
// description tells shader, resolver and reference of them. One has more planes than an entry of the page table and a
// texel beside it have room for. Negative controls: a light off by two degrees, and an oracle of another basis.
#include "tests/other_bases.h"
#include "tests/render/dense_subjects.h"
#include "tests/view_share.h"

namespace relievo {
namespace other_bases_gltest {

using namespace test;

Subject otherSubject(Basis basis) {
  NoiseHeight heights(500, 360, 4, 41);
  return denseSubject(FormattedNoise(500, 360, otherFormat(basis), 40), &heights);
}

class OtherBases : public testing::TestWithParam<size_t> {};

TEST_P(OtherBases, VirtualEqualsDense) {
  const Basis basis = otherBases()[GetParam()];
  const Subject subject = otherSubject(basis);
  expectEqual(compare(subject, {}, {.views = 4}), basisName(basis));
  expectEqual(compare(subject, {.relight = false}, {.views = 3}), "fixed light");
  Views run{.views = 3};
  run.wrong_oracle = [](DenseView& v) { v.light[0] += 0.035; };
  EXPECT_GT(compare(subject, {}, run).above_1, 100u) << "control";
}

TEST_P(OtherBases, OutOfAPackage) {
  const Basis basis = otherBases()[GetParam()];
  Subject subject = otherSubject(basis);
  TemporaryFolder folder;
  BuildOptions options;
  options.output = folder.file("other.relievo");
  options.mm_per_px = 0.1;
  NoiseHeight heights(500, 360, 4, 41);
  auto built = buildPackage(FormattedNoise(500, 360, otherFormat(basis), 40), &heights, options);
  ASSERT_TRUE(built.ok()) << built.error().text();
  auto package = Package::open(options.output);
  ASSERT_TRUE(package.ok()) << package.error().text();
  subject.artwork = artworkFromPackage(*package);
  expectEqual(compare(subject, {.relief = false}, {.views = 3}), basisName(basis));
}

INSTANTIATE_TEST_SUITE_P(All, OtherBases, testing::Range(size_t{0}, otherBases().size()));

TEST(OtherBasesControl, AnOracleOfAnotherBasisDiffers) {
  if (test::controlledWithOpenGl()) GTEST_SKIP() << "tried with OpenGL";
  // The same planes, two coefficients exchanged.
  static constexpr BasisDescription kExchanged = [] {
    BasisDescription d = kHsh4Lrgb;
    d.name = "test-hsh4-exchanged";
    std::swap(d.channels[1], d.channels[3]);
    return d;
  }();
  Subject subject = otherSubject(otherBases()[0]);
  auto wrong = std::make_shared<DenseTexture>(*subject.texture);
  wrong->format.basis = registerBasis(kExchanged).value();
  subject.texture = wrong;
  EXPECT_GT(compare(subject, {}, {.views = 2, .limit = 255}).above_1, 100u);
}

TEST(OtherBasesControl, WithoutALightThereIsNoColour) {
  Manifest manifest;
  manifest.texture = otherFormat(otherBases()[0]);
  EXPECT_EQ(sceneProblem({.unlit = true}, manifest), "a map of harmonics has no colour without a light");
  EXPECT_EQ(sceneProblem({}, manifest), "");
}

}  // namespace other_bases_gltest
}  // namespace relievo
