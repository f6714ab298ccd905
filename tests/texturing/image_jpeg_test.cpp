// Whole images as the JPEGs that they came as: what is kept of a file, what is read of it, and what is refused.
// Files are made by libjpeg itself; that texels are those of the image reader a build asks of each
// (scan_inputs_cli_test).
#include "texturing/codec/image_jpeg.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/texturing/jpeg_file.h"

namespace relievo {
namespace image_jpeg_test {

using namespace testing_support;

constexpr int kWidth = 90, kHeight = 37;

std::vector<uint8_t> texels(int components) {
  std::vector<uint8_t> out;
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x)
      for (int c = 0; c < components; ++c)
        out.push_back(static_cast<uint8_t>(128 + 100 * std::sin(0.2 * x + c) * std::cos(0.15 * y)));
  return out;
}

std::vector<uint8_t> encoded(const JpegKind& kind) { return jpegFile(kWidth, kHeight, texels(kind.components), kind); }

Result<std::vector<uint8_t>> decoded(std::span<const uint8_t> jpeg, size_t rows_at_once, uint32_t width = kWidth) {
  auto reader = ImageJpegReader::open(jpeg, width, kHeight);
  if (!reader) return reader.error();
  std::vector<uint8_t> rgb(size_t{3} * kWidth * kHeight);
  for (size_t y = 0; y < kHeight; y += rows_at_once) {
    const size_t rows = std::min(rows_at_once, kHeight - y);
    if (auto read = reader->read(rows, std::span(rgb).subspan(3 * y * kWidth, 3 * rows * kWidth)); !read)
      return read.error();
  }
  return rgb;
}

TEST(ImageJpeg, IsReadRowByRow) {
  for (const JpegKind& kind : {JpegKind{}, JpegKind{.samples = 1}, JpegKind{.components = 1, .samples = 1},
                               JpegKind{.progressive = true}, JpegKind{.scans = true}}) {
    const auto file = encoded(kind);
    const auto plain = plainJpeg(file);
    EXPECT_EQ(plain, file) << "nothing to leave out";
    const auto all = decoded(plain, kHeight), rows = decoded(plain, 1);
    ASSERT_TRUE(all.ok()) << all.error().text();
    ASSERT_TRUE(rows.ok()) << rows.error().text();
    EXPECT_EQ(*all, *rows);
    const auto truth = texels(kind.components);
    double sum = 0;
    for (size_t i = 0; i < all->size(); ++i)
      sum += std::abs(int{(*all)[i]} - int{kind.components == 1 ? truth[i / 3] : truth[i]});
    EXPECT_LT(sum / static_cast<double>(all->size()), 6) << "as near as the encoder's quality";
  }
}

TEST(ImageJpeg, WhatDescribesItIsLeftOut) {
  std::vector<uint8_t> file = encoded({.comment = true});
  const auto bare = encoded({});
  EXPECT_EQ(file.size(), bare.size() + 2 * (4 + 15));
  EXPECT_EQ(plainJpeg(file), bare);
  // And what follows it, such as the further pictures of a phone.
  const auto second = file;
  file.insert(file.end(), second.begin(), second.end());
  EXPECT_EQ(plainJpeg(file), bare);
}

TEST(ImageJpeg, OtherKindsAreLeftAlone) {
  // Scans without end: the last of three once more, and again.
  auto scans = encoded({.scans = true});
  size_t last = 0;
  for (size_t i = 0; i + 1 < scans.size(); ++i)
    if (scans[i] == 0xFF && scans[i + 1] == 0xDA) last = i;
  const std::vector<uint8_t> once(scans.begin() + static_cast<std::ptrdiff_t>(last), scans.end() - 2);
  for (int scan = 4; scan <= kMostJpegScans + 1; ++scan) {
    scans.insert(scans.end() - 2, once.begin(), once.end());
    const bool few = scan <= kMostJpegScans;
    EXPECT_EQ(plainJpeg(scans).empty(), !few) << scan;
    EXPECT_EQ(ImageJpegReader::open(scans, kWidth, kHeight).ok(), few) << scan;
  }
  const auto four = encoded({.components = 4, .samples = 1});
  EXPECT_FALSE(ImageJpegReader::open(four, kWidth, kHeight).ok()) << "four components";
  const auto file = encoded({});
  EXPECT_FALSE(decoded(file, 1, kWidth + 1).ok()) << "another width";
  std::vector<uint8_t> longer = file;
  longer.push_back(0);
  EXPECT_FALSE(decoded(longer, 1).ok()) << "a byte too many";
  EXPECT_TRUE(decoded(file, 1).ok()) << "control";
}

TEST(ImageJpeg, AnythingIsAnImageOrAnError) {
  const auto file = encoded({.comment = true});
  const auto plain = plainJpeg(file);
  for (size_t size = 0; size < plain.size(); ++size) {
    EXPECT_FALSE(decoded(std::span(plain).first(size), 5).ok()) << size;
    EXPECT_TRUE(plainJpeg(std::span(file).first(size)).empty()) << size;
  }
  int sound = 0;
  for (size_t i = 0; i < 4000; ++i) {
    std::vector<uint8_t> damaged = file;
    damaged[(i * 7919) % file.size()] ^= static_cast<uint8_t>(1 + i % 255);
    const auto kept = plainJpeg(damaged);
    const auto rgb = decoded(kept, 4);
    sound += rgb.ok();
    if (!rgb) {
      EXPECT_EQ(rgb.error().kind, ErrorKind::kInvalidData);
    }
  }
  EXPECT_LT(sound, 4000);
  EXPECT_GT(sound, 0) << "a JPEG's code has no checksum: the package's has";
}

}  // namespace image_jpeg_test
}  // namespace relievo
