// What no triangle shows of an image becomes what lies around it; and images that are shown over and over.
#include "geometry/bake/image_fill.h"

#include <gtest/gtest.h>

#include "geometry/bake/repeated_images.h"

namespace relievo {
namespace image_fill_test {

// Two triangles a rectangle of texture coordinates.
void add(TriMesh& mesh, uint16_t image, float u0, float v0, float u1, float v1) {
  for (const std::array<glm::vec2, 3>& uv : {std::array{glm::vec2(u0, v0), glm::vec2(u1, v0), glm::vec2(u1, v1)},
                                             std::array{glm::vec2(u1, v1), glm::vec2(u0, v1), glm::vec2(u0, v0)}}) {
    mesh.triangles.push_back({0, 1, 2});
    mesh.corner_uv.push_back(uv);
    mesh.image_of.push_back(image);
  }
}

TEST(ImageFill, WhatIsShownStaysAndTheRestIsLikeItsNeighbours) {
  constexpr int kWidth = 96, kHeight = 64;
  // Red on the left, blue on the right, both of which are shown but for their borders; green in between, and in
  // image 1.
  TriMesh mesh;
  add(mesh, 0, 0, 0, 0.25f, 1);
  add(mesh, 0, 0.75f, 0, 1, 1);
  add(mesh, 1, 0, 0, 1, 1);
  std::vector<uint8_t> texels;
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const bool left = x < 26, right = x >= 70;
      texels.insert(texels.end(),
                    {static_cast<uint8_t>(left ? 200 + y % 3 : 0), static_cast<uint8_t>(!left && !right ? 255 : 0),
                     static_cast<uint8_t>(right ? 190 : 0)});
    }
  const FilledImage filled = fillUnshown(mesh, 0, kWidth, kHeight, false, texels);
  EXPECT_NEAR(filled.shown, 0.5 + 3.0 / kWidth, 0.02);
  auto at = [&](const std::vector<uint8_t>& rgb, int x, int y) {
    return &rgb[static_cast<size_t>(3 * (y * kWidth + x))];
  };
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const uint8_t *now = at(filled.rgb, x, y), *before = at(texels, x, y);
      if (x < 25 || x >= 71) {
        ASSERT_TRUE(std::equal(now, now + 3, before)) << x << " " << y;
      } else {
        ASSERT_EQ(now[1], 0) << "no green is left at " << x << " " << y;
        ASSERT_GT(now[0] + now[2], 150);
      }
      ASSERT_TRUE(x >= 36 || now[0] > now[2]) << x << " " << y;
      ASSERT_TRUE(x < 60 || now[0] < now[2]) << x << " " << y;
    }
  EXPECT_EQ(fillUnshown(mesh, 1, kWidth, kHeight, false, texels).rgb, texels) << "all of it is shown";
  EXPECT_EQ(fillUnshown(mesh, 2, kWidth, kHeight, false, texels).rgb, texels) << "nothing is known of it";
  // Repeated, or beyond the border of one that is not.
  TriMesh beyond;
  add(beyond, 0, 0.9f, 0, 1.35f, 1);
  EXPECT_NEAR(fillUnshown(beyond, 0, kWidth, kHeight, true, texels).shown, 0.45 + 3.0 / kWidth, 0.02);
  EXPECT_NEAR(fillUnshown(beyond, 0, kWidth, kHeight, false, texels).shown, 0.1 + 1.5 / kWidth, 0.02);
  TriMesh far_out;
  add(far_out, 0, 0, 0, 900, 0.0001f);
  EXPECT_EQ(fillUnshown(far_out, 0, kWidth, kHeight, true, texels).shown, 1) << "as much as to count as all";
}

TEST(RepeatedImages, AreThoseThatTheScanShowsOverAndOver) {
  TriMesh mesh;
  add(mesh, 0, 0, 0, 3, 2);
  add(mesh, 1, 0.1f, 0.1f, 0.6f, 0.9f);
  add(mesh, kNoImage, 0, 0, 50, 50);
  const auto times = timesShown(mesh, 2);
  EXPECT_NEAR(times[0], 6, 1e-6);
  EXPECT_NEAR(times[1], 0.4, 1e-6);
  const auto much = [&](double of_first, double of_second) {
    return repeatsMuch(times, std::array{of_first, of_second});
  };
  EXPECT_TRUE(much(1 << 22, 1 << 20));
  EXPECT_FALSE(much(1 << 20, 1 << 30)) << "few texels, and many that are shown once";
  EXPECT_FALSE(repeatsMuch(std::array{3.0}, std::array{double{1 << 25}})) << "not often";
  EXPECT_TRUE(timesShown(TriMesh{}, 1)[0] == 0);
}

}  // namespace image_fill_test
}  // namespace relievo
