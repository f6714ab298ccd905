// Images of many channels: between texels, between levels, and averages of what is finer than the samples.
#include "geometry/bake/mip_image.h"

#include <gtest/gtest.h>

#include <array>
#include <random>

namespace relievo {
namespace mip_image_test {

TEST(MipImage, linearChannelsAreReadAsTheyAre) {
  constexpr int kWidth = 37, kHeight = 21, kChannels = 9;
  std::vector<uint8_t> texels;
  auto value = [](double x, double y, int c) { return 20 + c + (c % 2 ? 4 : 2) * x + (c % 3 ? 1 : 3) * y; };
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x)
      for (int c = 0; c < kChannels; ++c) texels.push_back(static_cast<uint8_t>(value(x, y, c)));
  const MipImage image(kWidth, kHeight, kChannels, texels, 3);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> unit(0, 1);
  std::array<float, kChannels> out{};
  for (int i = 0; i < 2000; ++i) {
    const double x = unit(random) * (kWidth - 1), y = unit(random) * (kHeight - 1);  // pixel centres are whole numbers
    image.sample({(x + 0.5) / kWidth, 1 - (y + 0.5) / kHeight}, static_cast<float>(-unit(random)), out);
    for (int c = 0; c < kChannels; ++c) ASSERT_NEAR(out[static_cast<size_t>(c)], value(x, y, c), 0.01) << x << " " << y;
    // Two levels up the same, away from borders that repeat, but for rounded bytes.
    if (x < 8 || y < 8 || x > kWidth - 9 || y > kHeight - 9) continue;
    image.sample({(x + 0.5) / kWidth, 1 - (y + 0.5) / kHeight}, static_cast<float>(2 * unit(random)), out);
    for (int c = 0; c < kChannels; ++c) ASSERT_NEAR(out[static_cast<size_t>(c)], value(x, y, c), 1.1) << x << " " << y;
  }
  image.sample({-3, 5}, 0, out);  // beyond: the corner
  EXPECT_EQ(out[0], texels[0]);
  image.sample({0.5, 0.5}, 100, out);
  image.sample({0.5, 0.5}, std::nanf(""), out);
}

TEST(MipImage, repeatsWhereItIsToldTo) {
  constexpr int kWidth = 8, kHeight = 4;
  std::vector<uint8_t> texels;
  for (int i = 0; i < kWidth * kHeight; ++i) texels.push_back(static_cast<uint8_t>(7 * i));
  const MipImage clamped(kWidth, kHeight, 1, texels, 2), repeated(kWidth, kHeight, 1, texels, 2, true);
  std::mt19937 random(3);
  std::uniform_real_distribution<float> unit(0, 1);
  auto at = [](const MipImage& image, float u, float v, float lod) {
    float out = 0;
    image.sample({u, v}, lod, {&out, 1});
    return out;
  };
  for (int i = 0; i < 500; ++i) {
    const float u = 0.01f + 0.98f * unit(random), v = 0.01f + 0.98f * unit(random), lod = 2 * unit(random);
    const float inside = at(clamped, u, v, lod);
    EXPECT_EQ(at(repeated, u, v, lod), inside);
    for (const glm::vec2& away : {glm::vec2(1, 0), glm::vec2(-2, 3), glm::vec2(0, -1)}) {
      const bool far_u = std::abs(u + away.x - 0.5f) > 0.5f + 0.5f / kWidth,
                 far_v = std::abs(v + away.y - 0.5f) > 0.5f + 0.5f / kHeight;
      if ((far_u || away.x == 0) && (far_v || away.y == 0)) {
        EXPECT_NEAR(at(repeated, u + away.x, v + away.y, lod), inside, 1e-2);
      }
    }
  }
  // Rounded coordinates do not reach the other side.
  EXPECT_EQ(at(repeated, 1.00001f, 0.5f, 0), at(clamped, 1, 0.5f, 0));
  EXPECT_EQ(at(repeated, 0.5f, -0.00001f, 0), at(clamped, 0.5f, 0, 0));
  EXPECT_EQ(at(clamped, 3.3f, 0.5f, 0), at(clamped, 1, 0.5f, 0));
}

TEST(MipImage, whatIsFinerIsAveraged) {
  constexpr int kSide = 64;
  std::vector<uint8_t> texels;
  for (int y = 0; y < kSide; ++y)
    for (int x = 0; x < kSide; ++x) texels.push_back((x + y) % 2 ? 255 : 0);
  const MipImage image(kSide, kSide, 1, texels, 16);
  std::mt19937 random(2);
  std::uniform_real_distribution<float> unit(0, 1);
  float most = 0, most_sharp = 0, out = 0;
  for (int i = 0; i < 1000; ++i) {
    const glm::vec2 uv(unit(random), unit(random));
    image.sample(uv, 1 + 5 * unit(random), {&out, 1});
    most = std::max(most, std::abs(out - 128));
    image.sample(uv, 0, {&out, 1});
    most_sharp = std::max(most_sharp, std::abs(out - 128));
  }
  EXPECT_LE(most, 0.5f);
  EXPECT_GT(most_sharp, 100.0f);  // control: the image itself is not grey
}

}  // namespace mip_image_test
}  // namespace relievo
