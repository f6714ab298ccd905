// What no patch shows of an image becomes what lies around it.
#include "texturing/package/image_fill.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>

namespace relievo {
namespace image_fill_test {

constexpr int kWidth = 96, kHeight = 64;

// Two triangles a rectangle of texels.
void add(ShownMarks& marks, double x0, double y0, double x1, double y1) {
  auto at = [](double x, double y) { return glm::ivec2(glm::round(256.0 * glm::dvec2(x, y))); };
  marks.add({at(x0, y0), at(x1, y0), at(x1, y1)});
  marks.add({at(x1, y1), at(x0, y1), at(x0, y0)});
}

// Red on the left, blue on the right, both of which are shown but for their borders; green in between.
std::vector<uint8_t> colours() {
  std::vector<uint8_t> texels;
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const bool left = x < 26, right = x >= 70;
      texels.insert(texels.end(),
                    {static_cast<uint8_t>(left ? 200 + y % 3 : 0), static_cast<uint8_t>(!left && !right ? 255 : 0),
                     static_cast<uint8_t>(right ? 190 : 0)});
    }
  return texels;
}

TEST(ImageFill, WhatIsShownStaysAndTheRestIsLikeItsNeighbours) {
  const std::vector<uint8_t> texels = colours();
  ShownMarks marks(kWidth, kHeight, false);
  add(marks, 0, 0, 24, kHeight);
  add(marks, 72, 0, kWidth, kHeight);
  EXPECT_NEAR(marks.share(), 0.5 + 3.0 / kWidth, 0.02);
  std::vector<uint8_t> filled = texels;
  std::move(marks).fillRest(filled);
  auto at = [&](const std::vector<uint8_t>& rgb, int x, int y) {
    return &rgb[static_cast<size_t>(3 * (y * kWidth + x))];
  };
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      const uint8_t *now = at(filled, x, y), *before = at(texels, x, y);
      if (x < 25 || x >= 71) {
        ASSERT_TRUE(std::equal(now, now + 3, before)) << x << " " << y;
      } else {
        ASSERT_EQ(now[1], 0) << "no green is left at " << x << " " << y;
        ASSERT_GT(now[0] + now[2], 150);
      }
      ASSERT_TRUE(x >= 36 || now[0] > now[2]) << x << " " << y;
      ASSERT_TRUE(x < 60 || now[0] < now[2]) << x << " " << y;
    }
}

// Their rows are filled by several threads.
TEST(ImageFill, AllRowsOfALargeOneAreFilled) {
  constexpr int kLarge = 1500;
  std::vector<uint8_t> rgb;
  for (int i = 0; i < kLarge * kLarge; ++i) {
    const bool left = i % kLarge < kLarge / 2;
    const std::array<uint8_t, 3> colour = left ? std::array<uint8_t, 3>{200, 0, 0} : std::array<uint8_t, 3>{0, 255, 0};
    rgb.insert(rgb.end(), colour.begin(), colour.end());
  }
  ShownMarks marks(kLarge, kLarge, false);
  add(marks, 0, 0, kLarge / 2 - 2, kLarge);
  std::move(marks).fillRest(rgb);
  for (size_t i = 0; i < rgb.size(); i += 3) ASSERT_TRUE(rgb[i] == 200 && rgb[i + 1] == 0) << i / 3 / kLarge;
}

TEST(ImageFill, AllOrNothingStays) {
  const std::vector<uint8_t> texels = colours();
  std::vector<uint8_t> filled = texels;
  ShownMarks all(kWidth, kHeight, false);
  add(all, 0, 0, kWidth, kHeight);
  EXPECT_EQ(all.share(), 1);
  std::move(all).fillRest(filled);
  EXPECT_EQ(filled, texels);
  ShownMarks nothing(kWidth, kHeight, false);
  std::move(nothing).fillRest(filled);
  EXPECT_EQ(filled, texels);
}

TEST(ImageFill, ImagesAreRepeatedBeyondTheirBordersOrEndThere) {
  ShownMarks repeated(kWidth, kHeight, true), ends(kWidth, kHeight, false), large(kWidth, kHeight, true);
  for (ShownMarks* marks : {&repeated, &ends}) add(*marks, 0.9 * kWidth, 0, 1.35 * kWidth, kHeight);
  EXPECT_NEAR(repeated.share(), 0.45 + 3.0 / kWidth, 0.02);
  EXPECT_NEAR(ends.share(), 0.1 + 1.5 / kWidth, 0.02);
  add(large, 0, 0, 900.0 * kWidth, 0.01);
  EXPECT_EQ(large.share(), 1) << "as much as to count as all";
}

// A file may have any number of large triangles: the time stays bounded.
TEST(ImageFill, SoManyLargeTrianglesCountAsAll) {
  constexpr int kSide = 600;
  ShownMarks marks(kSide, kSide, false);
  const std::array<glm::ivec2, 3> half{glm::ivec2(0), glm::ivec2(256 * kSide, 0), glm::ivec2(256 * kSide)};
  for (int i = 0; i < 63; ++i) marks.add(half);
  EXPECT_NEAR(marks.share(), 0.5, 0.01);
  marks.add(half);
  EXPECT_EQ(marks.share(), 1);
  for (int i = 0; i < 200; ++i) marks.add(half);
  EXPECT_EQ(marks.share(), 1);
}

// Every texel that lies on a triangle, or up to a texel and a half beside it, in real numbers; none much farther.
TEST(ImageFill, MarksReachATexelAndAHalf) {
  for (int turn = 0; turn < 40; ++turn) {
    std::array<glm::dvec2, 3> corner;
    std::array<glm::ivec2, 3> triangle;
    for (size_t k = 0; k < 3; ++k) {
      const double angle = 0.157 * turn + 2.1 * static_cast<double>(k), radius = k == 2 ? 3 + turn % 5 : 22;
      triangle[k] = glm::ivec2(256.0 * (glm::dvec2(48, 32) + radius * glm::dvec2(std::cos(angle), std::sin(angle))));
      corner[k] = glm::dvec2(triangle[k]) / 256.0;
    }
    if (turn % 2 == 1) std::swap(corner[0], corner[1]), std::swap(triangle[0], triangle[1]);
    std::vector<uint8_t> texels(3 * kWidth * kHeight, 255);
    // The rest is filled with what is shown: white stays, black goes.
    ShownMarks marks(kWidth, kHeight, false);
    marks.add(triangle);
    auto cross = [](const glm::dvec2& a, const glm::dvec2& b) { return a.x * b.y - a.y * b.x; };
    const double side = cross(corner[1] - corner[0], corner[2] - corner[0]) < 0 ? -1 : 1;
    int near = 0, far = 0;
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x) {
        double outside = -1e9;
        for (size_t k = 0; k < 3; ++k) {
          const glm::dvec2 along = corner[(k + 1) % 3] - corner[k];
          outside =
              std::max(outside, -side * cross(along, glm::dvec2(x + 0.5, y + 0.5) - corner[k]) / glm::length(along));
        }
        near += outside <= 1.5;
        far += outside <= 1.5 * 1.125;
      }
    const double marked = marks.share() * kWidth * kHeight;
    EXPECT_GE(marked, 0.97 * near - 3) << turn;  // but for what lies far beyond a sharp corner
    EXPECT_LE(marked, far) << turn;
  }
}

}  // namespace image_fill_test
}  // namespace relievo
