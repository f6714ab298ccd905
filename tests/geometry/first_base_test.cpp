// What takes the place of a first base that can only miss: what takes the fewest bytes, if there is any.
#include "geometry/bake/first_base.h"

#include <gtest/gtest.h>

#include <vector>

namespace relievo {
namespace first_base_test {

TEST(FirstBase, IsHopelessBeyondTwiceThePatchesThereMayBe) {
  // The smallest closed piece takes six: 1,365 of them may still be baked.
  EXPECT_FALSE(isHopeless(6 * 1365, 0, 1));
  EXPECT_FALSE(isHopeless(8192, 0, 1));
  EXPECT_TRUE(isHopeless(8193, 0, 1));
  EXPECT_TRUE(isHopeless(6 * 1366, 0, 1));
}

TEST(FirstBase, IsHopelessWhereMoreThanThreeHundredthsAreOutOfReach) {
  EXPECT_FALSE(isHopeless(800, 0.029, 1));
  EXPECT_TRUE(isHopeless(800, 0.031, 1));
  // A target ten times as coarse allows ten times as much, a finer one no less.
  EXPECT_FALSE(isHopeless(800, 0.29, 10));
  EXPECT_TRUE(isHopeless(800, 0.31, 10));
  EXPECT_FALSE(isHopeless(800, 0.029, 0.1));
  // The number of patches does not depend on it.
  EXPECT_TRUE(isHopeless(8193, 0, 10));
}

// What was asked for, one after the other; 0 is the base of simplified triangles.
struct Tried {
  std::vector<uint32_t> bases;
  Result<bool> replaced = false;
};
// Own triangles fit into so many patches; simplified ones: whether there is such a base, or an error.
Tried tried(uint32_t own_triangles_take, const Result<bool>& simplified, uint32_t most_faces_first = 4096) {
  Tried out;
  out.replaced = replaceFirstBase(
      most_faces_first,
      [&](uint32_t max_patches) -> Result<bool> {
        out.bases.push_back(max_patches);
        return own_triangles_take <= max_patches;
      },
      [&] {
        out.bases.push_back(0);
        return simplified;
      });
  return out;
}

TEST(FirstBase, IsReplacedByWhatTakesTheFewestBytes) {
  auto expectTried = [](const Tried& out, const std::vector<uint32_t>& bases, bool replaced) {
    EXPECT_EQ(out.bases, bases);
    ASSERT_TRUE(out.replaced.ok());
    EXPECT_EQ(*out.replaced, replaced);
  };
  expectTried(tried(4096, true), {4096}, true);
  expectTried(tried(4097, true), {4096, 0}, true);
  expectTried(tried(4097, true, 12'288), {12'288}, true);
  expectTried(tried(65'536, false), {4096, 0, 65'536}, true);
  // Control: where nothing can take its place, it stays.
  expectTried(tried(65'537, false), {4096, 0, 65'536}, false);
}

TEST(FirstBase, FewOwnTrianglesAreTakenAtOnceWhereTheySuitTheTexture) {
  EXPECT_EQ(mostFacesAtOnce(FaceTexels::kSome, 0), 4096u);
  EXPECT_EQ(mostFacesAtOnce(FaceTexels::kSome, 127), 4096u);
  EXPECT_EQ(mostFacesAtOnce(FaceTexels::kSome, 128), 36'864u) << "images of many texels";
  EXPECT_EQ(mostFacesAtOnce(FaceTexels::kShown, 128), 36'864u);
  EXPECT_EQ(mostFacesAtOnce(FaceTexels::kNone, 0), 4096u);
  EXPECT_EQ(mostFacesAtOnce(FaceTexels::kEach, 1000), 0u);
}

TEST(FirstBase, MoreOwnTrianglesComeFirstWhereMostLieBesideCreases) {
  EXPECT_EQ(mostFacesFirst(0, 1, FaceTexels::kSome), 36'864u);
  EXPECT_EQ(mostFacesFirst(0.49, 1, FaceTexels::kSome), 36'864u);
  EXPECT_EQ(mostFacesFirst(0.5, 1, FaceTexels::kSome), 65'536u);
  EXPECT_EQ(mostFacesFirst(1, 1, FaceTexels::kSome), 65'536u);
}
TEST(FirstBase, FewerOwnTrianglesComeBeforeSmallerPatches) {
  EXPECT_EQ(mostFacesBeforeSmaller(0.49), 4096u);
  EXPECT_EQ(mostFacesBeforeSmaller(0.5), 12'288u);
}
TEST(FirstBase, FewerOwnTrianglesComeFirstWhereOthersTakeFewBytes) {
  EXPECT_EQ(mostFacesFirst(0, 0.1, FaceTexels::kSome), 36'864u) << "a finer tolerance";
  EXPECT_EQ(mostFacesFirst(0, 2, FaceTexels::kSome), 36'864u);
  EXPECT_EQ(mostFacesFirst(0, 4, FaceTexels::kSome), 18'432u);
  EXPECT_EQ(mostFacesFirst(1, 4, FaceTexels::kSome), 32'768u);
  EXPECT_EQ(mostFacesFirst(0, 1000, FaceTexels::kSome), 4096u);
  EXPECT_EQ(mostFacesFirst(0.49, 1, FaceTexels::kEach), 4096u) << "unsuited";
  EXPECT_EQ(mostFacesFirst(0.5, 1, FaceTexels::kEach), 12'288u) << "unsuited";
}

TEST(FirstBase, ManyOwnTrianglesComeFirstWhereTheyNeedNoTexels) {
  for (const auto& [texels, most] : {std::pair{FaceTexels::kShown, 131'072u}, {FaceTexels::kNone, 262'144u}}) {
    EXPECT_EQ(mostFacesFirst(0, 1, texels), most);
    EXPECT_EQ(mostFacesFirst(1, 1, texels), most);
    EXPECT_EQ(mostLightFaces(texels, 0.1), most);
    EXPECT_EQ(mostLightFaces(texels, 2), most);
    EXPECT_EQ(mostLightFaces(texels, 8), most / 4) << "others need fewer samples";
    EXPECT_EQ(mostLightFaces(texels, 1000), 4096u);
    EXPECT_EQ(mostLightFacesAtLast(texels, 1), 1'048'576u);
    EXPECT_EQ(mostLightFacesAtLast(texels, 2), 1'048'576u);
    EXPECT_EQ(mostLightFacesAtLast(texels, 3), 0u) << "others are few";
  }
  for (const FaceTexels texels : {FaceTexels::kEach, FaceTexels::kSome}) {
    EXPECT_EQ(mostLightFaces(texels, 1), 0u);
    EXPECT_EQ(mostLightFacesAtLast(texels, 1), 0u);
  }
}
// Corners lie closer to the scan than the target asks for, and no closer than numbers in single precision tell.
TEST(FirstBase, OwnTrianglesLieOnAFinerLattice) {
  EXPECT_DOUBLE_EQ(baseStepFor(3e-5, 1), 6e-6);
  EXPECT_DOUBLE_EQ(faceStepFor(3e-5, 1), 9e-7);
  EXPECT_EQ(faceStepFor(1e-9, 1), finestBaseStep(1));
}

TEST(FirstBase, BasesOfLargeScansGrowInLargeSteps) {
  const size_t large = 2 * size_t{262'144} + 1, patches = 700;
  // Of at most a page a patch: half as many again.
  EXPECT_EQ(leastRefined(large, patches, 9'000'000, 7), 1050u);
  EXPECT_EQ(leastRefined(large, patches, 9'000'000, 5), 1050u);
  // Of several: two for each page of 128 x 128 cells.
  EXPECT_EQ(leastRefined(large, 67, 16'384 * 600, 9), 1200u);
  EXPECT_EQ(leastRefined(large, 67, 16'384 * 600, 8), 1200u);
  EXPECT_EQ(leastRefined(large, 67, 16'384 * 600, 7), 100u) << "control: of one page";
  EXPECT_EQ(leastRefined(large, 3000, 1'000'000, 6), kMostPatches) << "and no more than there may be";
  EXPECT_EQ(leastRefined(large, 67, uint64_t{1} << 40, 10), kMostPatches);
  // As many as they need otherwise.
  EXPECT_EQ(leastRefined(large - 1, patches, 9'000'000, 7), 0u);
  EXPECT_EQ(leastRefined(large - 1, patches, 9'000'000, 9), 0u);
}

TEST(FirstBase, ErrorsEndTheSearch) {
  const Tried out = tried(5000, Error{ErrorKind::kInterrupted, "", "interrupted", "", {}});
  EXPECT_EQ(out.bases, (std::vector<uint32_t>{4096, 0}));
  ASSERT_FALSE(out.replaced.ok());
  EXPECT_EQ(out.replaced.error().kind, ErrorKind::kInterrupted);
}

// What moreOf() asks for from so many simplified triangles on: those with a sign are own triangles. Own triangles fit
// into so many patches, simplified ones into so many.
std::vector<int> triedMore(uint32_t& most_simplified, uint32_t own_take, uint32_t simplified_take, bool& found,
                           uint32_t most_light = 0) {
  std::vector<int> bases;
  const Result<bool> done = moreOf(
      most_simplified, most_light,
      [&](uint32_t max_patches) -> Result<bool> {
        bases.push_back(-static_cast<int>(max_patches));
        return own_take <= max_patches;
      },
      [&](uint32_t max_patches) -> Result<bool> {
        bases.push_back(static_cast<int>(max_patches));
        return simplified_take <= max_patches;
      });
  EXPECT_TRUE(done.ok());
  found = done.ok() && *done;
  return bases;
}

TEST(FirstBase, WhereAllOthersMissMorePatchesAreTriedFourTimesAsManyAtATime) {
  uint32_t most = kMostPatches;
  bool found = false;
  // Own triangles are not few enough: one step after the other, each of which is baked and misses.
  EXPECT_EQ(triedMore(most, 300'000, 1, found), std::vector<int>{16'384});
  EXPECT_TRUE(found);
  EXPECT_EQ(triedMore(most, 300'000, 1, found), (std::vector<int>{-262'144, 65'536}));
  EXPECT_EQ(triedMore(most, 300'000, 1, found), (std::vector<int>{-262'144, 131'072}));
  EXPECT_TRUE(found);
  EXPECT_TRUE(triedMore(most, 300'000, 1, found).empty()) << "nothing is left";
  EXPECT_FALSE(found);
  // Own triangles take the place of the second step.
  most = kMostPatches;
  EXPECT_EQ(triedMore(most, 100'000, 1, found), std::vector<int>{16'384});
  EXPECT_EQ(triedMore(most, 100'000, 1, found), std::vector<int>{-262'144});
  EXPECT_TRUE(found);
  // Those without texels come before all of that, once.
  most = kMostPatches;
  EXPECT_EQ(triedMore(most, 300'000, 1, found, kMostLightFaces), std::vector<int>{-1'048'576});
  EXPECT_TRUE(found);
  EXPECT_EQ(most, kMostPatches);
  EXPECT_EQ(triedMore(most, 2'000'000, 1, found, kMostLightFaces), (std::vector<int>{-1'048'576, 16'384}));
  EXPECT_EQ(triedMore(most, 2'000'000, 1, found, kMostLightFaces), (std::vector<int>{-262'144, 65'536}));
  // Steps that are no base, as of very many pieces, are passed over.
  most = kMostPatches;
  EXPECT_EQ(triedMore(most, 300'000, 100'000, found), (std::vector<int>{16'384, -262'144, 65'536, -262'144, 131'072}));
  EXPECT_TRUE(found);
  most = kMostPatches;
  triedMore(most, 300'000, 200'000, found);
  EXPECT_FALSE(found);
}

TEST(FirstBase, AnErrorEndsMorePatches) {
  uint32_t most = kMostPatches;
  const Error interrupted{ErrorKind::kInterrupted, "", "interrupted", "", {}};
  int asked = 0;
  const Result<bool> done = moreOf(
      most, 0, [&](uint32_t) -> Result<bool> { return ++asked, interrupted; },
      [&](uint32_t) -> Result<bool> { return ++asked, false; });
  ASSERT_FALSE(done.ok());
  EXPECT_EQ(done.error().kind, ErrorKind::kInterrupted);
  EXPECT_EQ(asked, 2) << "simplified triangles once, own ones once";
}

}  // namespace first_base_test
}  // namespace relievo
