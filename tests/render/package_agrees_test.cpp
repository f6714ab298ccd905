// A package holds the very pages that the oracle cuts from its dense pyramid and relief: every page of small artworks,
// byte for byte, borders included. No GL.
#include <gtest/gtest.h>

#include <cstring>

#include "tests/other_bases.h"
#include "tests/render/dense_pages.h"
#include "tests/render/test_artwork.h"
#include "texturing/codec/page_codec.h"

namespace relievo {
namespace package_agrees_test {

struct Counts {
  size_t pages = 0, different = 0, relief_steps = 0;
};

void compareAll(int64_t w, int64_t h, Basis basis, bool relief, uint32_t oracle_seed_offset, Counts* counts) {
  test::TemporaryFolder folder;
  test::NoiseTexture texture(w, h, basis, 5);
  // Another number of samples than texels.
  test::NoiseHeight heights(w * 2 / 3 + 1, h * 3 / 4 + 1, 7, 6);
  BuildOptions options;
  options.output = folder.file("small.relievo");
  options.workers = 2;
  options.stretch_relief = true;
  auto built = buildPackage(texture, relief ? &heights : nullptr, options);
  ASSERT_TRUE(built.ok()) << built.error().text();
  auto package = Package::open(options.output);
  ASSERT_TRUE(package.ok()) << package.error().text();
  const FlatDomain d = (*package)->manifest().domain.flat();
  ASSERT_EQ(relief, d.relief_depth >= 0);

  test::NoiseTexture oracle_texture(w, h, basis, 5 + oracle_seed_offset);
  auto dense = buildDenseTexture(oracle_texture, d);
  ASSERT_TRUE(dense.ok());
  std::shared_ptr<const DenseRelief> dense_relief;
  if (relief) {
    auto r = buildDenseRelief(heights, d);
    ASSERT_TRUE(r.ok());
    dense_relief = std::make_shared<DenseRelief>(std::move(*r));
  }
  auto oracle = densePages(std::make_shared<DenseTexture>(std::move(*dense)), dense_relief);

  PageDecoder decoder;
  std::vector<uint8_t> expected(kSlotBytes), found(kSlotBytes);
  std::vector<Plane> planes;
  for (int k = 0; k < texture.format().planes(); ++k) planes.push_back(texturePlane(k));
  if (relief) planes.push_back(Plane::kRelief);
  for (Plane plane : planes) {
    const int depth = plane == Plane::kRelief ? d.relief_depth : d.texture_depth;
    for (uint32_t level = 0; static_cast<int>(level) <= depth; ++level)
      for (uint32_t patch = 0; patch < d.patchCount(); ++patch)
        for (uint32_t y = 0; y < 1u << level; ++y)
          for (uint32_t x = 0; x < 1u << level; ++x) {
            const PageId id(plane, {patch, level, x, y});
            auto a = (*package)->read(id), b = oracle->read(id);
            ASSERT_EQ(a.ok(), b.ok()) << "plane " << int(plane) << " level " << level << " " << x << " " << y;
            if (!a.ok()) continue;
            ASSERT_TRUE(decoder.decodeToSlot(plane, a->bytes, found).ok());
            ASSERT_TRUE(decoder.decodeToSlot(plane, b->bytes, expected).ok());
            ++counts->pages;
            if (std::memcmp(found.data(), expected.data(), kSlotBytes) == 0) continue;
            if (plane != Plane::kRelief) {
              ++counts->different;
              size_t at = 0;
              while (found[at] == expected[at]) ++at;
              if (counts->different <= 10 && oracle_seed_offset == 0)
                std::printf(
                    "  %lld x %lld %s: plane %d, patch %u, level %u, %u %u: texel (%d, %d) channel %d is %d, not %d\n",
                    static_cast<long long>(w), static_cast<long long>(h), basisName(basis), int(plane), patch, level, x,
                    y, int(at / 4 % kPageFullPx) - kPageBorderPx, int(at / 4 / kPageFullPx) - kPageBorderPx,
                    int(at % 4), found[at], expected[at]);
              continue;
            }
            // A height half way between two steps may round to either, single precision being what a builder may use.
            for (size_t i = 0; i < kSlotBytes; i += 4) {
              const int p = expected[i] << 8 | expected[i + 1], q = found[i] << 8 | found[i + 1];
              counts->relief_steps += p != q;
              counts->different += std::abs(p - q) > 1;
            }
          }
  }
}

TEST(PackageAgrees, EveryPageIsTheOracles) {
  Counts counts;
  for (Basis basis : {Basis::kColour, Basis::kPtmLrgb, Basis::kPtmRgb})
    for (auto [w, h] : {std::pair<int64_t, int64_t>{1, 1}, {129, 257}, {600, 333}})
      compareAll(w, h, basis, true, 0, &counts);
  for (Basis basis : test::otherBases()) compareAll(129, 257, basis, true, 0, &counts);
  compareAll(1100, 300, Basis::kPtmLrgb, false, 0, &counts);
  std::printf("%zu pages, %zu differ, %zu height samples a step off\n", counts.pages, counts.different,
              counts.relief_steps);
  EXPECT_GT(counts.pages, 100u);
  EXPECT_EQ(counts.different, 0u);
}

TEST(PackageAgrees, NegativeControlAnotherTextureDiffers) {
  Counts counts;
  compareAll(300, 200, Basis::kPtmLrgb, true, 1, &counts);
  EXPECT_GT(counts.different, 5u);
}

}  // namespace package_agrees_test
}  // namespace relievo
