// Whole images as the JPEGs that they came as: what is kept of a file, what is read of it, and what is refused. The
// oracle of texels is the image reader's (OpenImageIO), in tests/tools; here an encoder of our own makes the files.
#include "texturing/codec/image_jpeg.h"

#include <gtest/gtest.h>
#include <jpeglib.h>

#include <cmath>
#include <cstdlib>
#include <string>

#include "src/artwork/patch_domain.h"

namespace relievo {
namespace image_jpeg_test {

constexpr int kWidth = 90, kHeight = 37;

std::vector<uint8_t> texels(int components) {
  std::vector<uint8_t> out;
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x)
      for (int c = 0; c < components; ++c)
        out.push_back(static_cast<uint8_t>(128 + 100 * std::sin(0.2 * x + c) * std::cos(0.15 * y)));
  return out;
}

struct Kind {
  int components = 3, samples = 2;
  bool progressive = false, comment = false, scans = false;
};
std::vector<uint8_t> encoded(const Kind& kind) {
  jpeg_compress_struct info;
  jpeg_error_mgr errors;
  info.err = jpeg_std_error(&errors);
  jpeg_create_compress(&info);
  unsigned char* bytes = nullptr;
  unsigned long size = 0;
  jpeg_mem_dest(&info, &bytes, &size);
  info.image_width = kWidth, info.image_height = kHeight;
  info.input_components = kind.components;
  info.in_color_space = kind.components == 3 ? JCS_RGB : kind.components == 4 ? JCS_CMYK : JCS_GRAYSCALE;
  jpeg_set_defaults(&info);
  info.restart_interval = 3;
  info.comp_info[0].h_samp_factor = info.comp_info[0].v_samp_factor = kind.samples;
  if (kind.progressive) jpeg_simple_progression(&info);
  const jpeg_scan_info one_each[3] = {{1, {0}, 0, 63, 0, 0}, {1, {1}, 0, 63, 0, 0}, {1, {2}, 0, 63, 0, 0}};
  if (kind.scans) info.scan_info = one_each, info.num_scans = 3;
  jpeg_start_compress(&info, TRUE);
  const std::string said = "made by nobody";
  if (kind.comment) {
    jpeg_write_marker(&info, JPEG_COM, reinterpret_cast<const JOCTET*>(said.data()),
                      static_cast<unsigned>(said.size()));
    jpeg_write_marker(&info, JPEG_APP0 + 1, reinterpret_cast<const JOCTET*>(said.data()),
                      static_cast<unsigned>(said.size()));
  }
  std::vector<uint8_t> pixels = texels(kind.components);
  while (info.next_scanline < info.image_height) {
    JSAMPROW row = &pixels[static_cast<size_t>(info.next_scanline) * kWidth * static_cast<size_t>(kind.components)];
    jpeg_write_scanlines(&info, &row, 1);
  }
  jpeg_finish_compress(&info);
  std::vector<uint8_t> out(bytes, bytes + size);
  jpeg_destroy_compress(&info);
  std::free(bytes);
  return out;
}

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
  for (const Kind& kind : {Kind{}, Kind{.samples = 1}, Kind{.components = 1, .samples = 1}, Kind{.progressive = true},
                           Kind{.scans = true}}) {
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
  EXPECT_EQ(file.size(), bare.size() + 2 * (4 + 14));
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
