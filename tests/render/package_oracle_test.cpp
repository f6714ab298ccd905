// What LOD learns of a package's relief: bounds and errors of each page, of those without bytes as well.
#include <cstdint>
#include <memory>
#include <string>

#include <gtest/gtest.h>

#include "src/engine/artwork.h"
#include "tests/texturing/patch_fixture.h"
#include "texturing/package/package.h"
#include "texturing/package/patch_package_builder.h"

namespace relievo::package_oracle_test {
namespace {

// Every second patch is even: its relief page has no bytes.
class HalfEven final : public testing_support::NoisyPatches {
 public:
  HalfEven() : NoisyPatches(testing_support::cubeSphere(2, 50, 7), 0, 0, 7) {}
  uint16_t height(uint32_t patch, int x, int y) const override {
    const bool inside = x % 128 != 0 && y % 128 != 0;
    return static_cast<uint16_t>(20'000 + (inside && patch % 2 ? 40 * (x % 3) + y % 5 : 0));
  }
};

TEST(PackageOracle, PagesWithoutBytesHaveTheirOwnBounds) {
  testing_support::ScratchFolder folder;
  BuildOptions options;
  options.output = folder.file("a.relievo");
  ASSERT_TRUE(buildPatchPackage(HalfEven(), options).ok());
  const auto opened = Package::open(options.output);
  ASSERT_TRUE(opened.ok());
  const Artwork artwork = artworkFromPackage(*opened);
  for (uint32_t patch = 0; patch < (*opened)->manifest().domain.patchCount(); ++patch) {
    const NodeId root{patch, 0, 0, 0};
    const auto record = (*opened)->record(PageId(Plane::kRelief, root));
    ASSERT_TRUE(record.ok());
    EXPECT_EQ(record->size == 0, patch % 2 == 0) << patch;
    const HeightBounds bounds = artwork.oracle->bounds(root);
    EXPECT_EQ(bounds.min_mm, static_cast<float>(record->relief.min_mm)) << patch;
    EXPECT_EQ(bounds.max_mm, static_cast<float>(record->relief.max_mm)) << patch;
    EXPECT_EQ(bounds.error_mm, static_cast<float>(record->relief.error_mm)) << patch;
  }
}

}  // namespace
}  // namespace relievo::package_oracle_test
