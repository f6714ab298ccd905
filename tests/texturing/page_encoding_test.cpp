// Lossy page encodings: bounds that follow from each, every truncation, mutated bytes, seams.
#include "texturing/codec/page_encoding.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <random>
#include <set>

#include <jpeglib.h>

#include "tests/texturing/jpeg_file.h"
#include "texturing/codec/page_block_codec.h"
#include "texturing/codec/page_codec.h"
#include "texturing/codec/page_jpeg_codec.h"

namespace relievo {
namespace page_encoding_test {

constexpr uint32_t kSeed = 4711;
constexpr int kSide = kPageFullPx;
constexpr size_t kChannel = size_t{kSide} * kSide;

// Smooth shapes, an edge and some noise, as if cut from a larger image at (x0, y0).
std::vector<uint8_t> naturalPage(int x0, int y0, int noise = 3) {
  std::vector<uint8_t> out(kTexturePageBytes);
  for (int c = 0; c < 3; ++c) {
    for (int y = 0; y < kSide; ++y) {
      for (int x = 0; x < kSide; ++x) {
        const int gx = x0 + x, gy = y0 + y;
        uint32_t h = (static_cast<uint32_t>(gx) * 2654435761u) ^ (static_cast<uint32_t>(gy) * 2246822519u) ^
                     (static_cast<uint32_t>(c) * 3266489917u);
        h = (h ^ (h >> 15)) * 2246822519u, h ^= h >> 13;
        double v = 120 + 60 * std::sin(0.06 * gx + c) * std::cos(0.045 * gy) + ((gx / 50 + gy / 70) % 2 ? 25 : 0);
        if (noise) v += static_cast<int>(h % static_cast<uint32_t>(2 * noise + 1)) - noise;
        out[static_cast<size_t>(c) * kChannel + static_cast<size_t>(y * kSide + x)] =
            static_cast<uint8_t>(std::clamp(v, 0.0, 255.0));
      }
    }
  }
  return out;
}

std::vector<uint8_t> encoded(PageEncoder& encoder, const std::vector<uint8_t>& page, PageEncoding e) {
  auto bytes = encoder.encodeTexture(page, e);
  return {bytes.begin(), bytes.end()};
}

std::vector<uint8_t> decoded(PageDecoder& decoder, const std::vector<uint8_t>& bytes) {
  std::vector<uint8_t> out(kTexturePageBytes);
  auto done = decoder.decodeTexture(bytes, out);
  EXPECT_TRUE(done.ok()) << (done.ok() ? "" : done.error().text());
  return out;
}

struct Error3 {
  int max = 0;
  double psnr = 0;
};
Error3 difference(const std::vector<uint8_t>& a, const std::vector<uint8_t>& b) {
  Error3 e;
  double sum = 0;
  for (size_t i = 0; i < a.size(); ++i) {
    int d = std::abs(a[i] - b[i]);
    e.max = std::max(e.max, d);
    sum += d * d;
  }
  e.psnr = sum > 0 ? 10 * std::log10(255.0 * 255.0 * static_cast<double>(a.size()) / sum) : INFINITY;
  return e;
}

std::vector<PageEncoding> allEncodings() {
  std::vector<PageEncoding> out{{}};
  for (uint8_t bits = kMinQuantisedBits; bits <= kMaxQuantisedBits; ++bits)
    out.push_back({PageCodec::kQuantised, bits});
  for (uint8_t quality : {1, 50, 90, 100})
    out.push_back({PageCodec::kJpeg, quality}), out.push_back({PageCodec::kJpegYcc, quality});
  for (PageCodec c : {PageCodec::kBc1, PageCodec::kBc4, PageCodec::kBc5, PageCodec::kBc7}) out.push_back({c, 0});
  return out;
}

TEST(PageEncoding, namesComeBackAndOthersAreRefused) {
  for (PageEncoding e : allEncodings()) {
    auto parsed = parseEncoding(encodingName(e), 33);
    ASSERT_TRUE(parsed.ok()) << encodingName(e);
    EXPECT_EQ(*parsed, e);
    auto bytes = encodingFromBytes(static_cast<uint8_t>(e.codec), e.parameter);
    ASSERT_TRUE(bytes.ok());
    EXPECT_EQ(*bytes, e);
  }
  EXPECT_EQ(*parseEncoding("jpeg", 33), (PageEncoding{PageCodec::kJpeg, 33}));
  EXPECT_EQ(*parseEncoding("q8", 90), PageEncoding{});
  for (const char* bad :
       {"", "q", "q3", "q9", "q66", "q-6", "jpeg0", "jpeg101", "jpegx", "bc2", "bc", "BC7", "lossless ", "q6 "}) {
    auto parsed = parseEncoding(bad, 90);
    ASSERT_FALSE(parsed.ok()) << bad;
    EXPECT_EQ(parsed.error().kind, ErrorKind::kUsage);
  }
  int known = 0;
  for (int codec = 0; codec < 256; ++codec) {
    for (int parameter = 0; parameter < 256; ++parameter) {
      auto e = encodingFromBytes(static_cast<uint8_t>(codec), static_cast<uint8_t>(parameter));
      known += e.ok();
      ASSERT_TRUE(e.ok() || e.error().kind == ErrorKind::kUnsupported);
    }
  }
  EXPECT_EQ(known, 1 + 4 + 200 + 4);
}

TEST(PageEncoding, planesGetWhatTheirChannelsAreGoodFor) {
  const PageEncoding jpeg{PageCodec::kJpeg, 80}, q6{PageCodec::kQuantised, 6};
  TextureFormat f;
  f.basis = Basis::kPtmLrgb;
  auto planes = planeEncodings(f, jpeg, q6);
  EXPECT_EQ(planes[0], jpeg);
  EXPECT_EQ(planes[1], jpeg);
  EXPECT_EQ(planes[2], q6);
  EXPECT_EQ(planes[3], PageEncoding{});
  EXPECT_EQ(planeEncodings(f, q6, jpeg)[2].codec, PageCodec::kJpegYcc);
  f.basis = Basis::kPtmRgb;
  EXPECT_EQ(planeEncodings(f, jpeg, q6)[5], (PageEncoding{PageCodec::kJpegYcc, 80}));
  f.basis = Basis::kColour;
  EXPECT_EQ(planeEncodings(f, jpeg, q6)[0], q6);
  f.basis = Basis::kAlbedoNormal;
  EXPECT_EQ(planeEncodings(f, jpeg, q6)[0], q6);
  EXPECT_EQ(planeEncodings(f, jpeg, q6)[1], jpeg) << "a normal is no colour";
}

// The largest error is half a step of 255 / (2^n - 1), rounded to bytes: exactly, for every value.
TEST(Quantised, everyValueGoesToTheNearestLevel) {
  PageEncoder encoder(1);
  PageDecoder decoder;
  std::vector<uint8_t> page(kTexturePageBytes);
  for (size_t i = 0; i < page.size(); ++i) page[i] = static_cast<uint8_t>(i % 256);
  for (uint8_t bits = kMinQuantisedBits; bits <= kMaxQuantisedBits; ++bits) {
    auto out = decoded(decoder, encoded(encoder, page, {PageCodec::kQuantised, bits}));
    const int top = (1 << bits) - 1;
    std::set<int> levels;
    int worst = 0;
    for (size_t i = 0; i < 256; ++i) {
      const int v = page[i];
      // The nearest level, by trying them all.
      double best = 1e9, level = 0;
      for (int k = 0; k <= top; ++k)
        if (std::abs(k * 255.0 / top - v) < best) best = std::abs(k * 255.0 / top - v), level = k * 255.0 / top;
      EXPECT_EQ(out[i], static_cast<int>(std::floor(level + 0.5))) << "bits " << int{bits} << " value " << v;
      levels.insert(out[i]);
      worst = std::max(worst, std::abs(out[i] - v));
    }
    EXPECT_EQ(levels.size(), size_t{1} << bits);
    EXPECT_EQ(worst, static_cast<int>(255.0 / top / 2)) << int{bits};
    // Again it is exact.
    EXPECT_EQ(decoded(decoder, encoded(encoder, out, {PageCodec::kQuantised, bits})), out);
    // Negative control: a bit less has a larger error.
    if (bits == kMinQuantisedBits) continue;
    const PageEncoding coarser{PageCodec::kQuantised, static_cast<uint8_t>(bits - 1)};
    EXPECT_GT(difference(page, decoded(decoder, encoded(encoder, page, coarser))).max, worst);
  }
}

TEST(Jpeg, betterWithQualityAndTheTransformIsOrthogonal) {
  PageEncoder encoder(1);
  PageDecoder decoder;
  auto page = naturalPage(0, 0);
  for (PageCodec codec : {PageCodec::kJpeg, PageCodec::kJpegYcc}) {
    double psnr = 0;
    size_t size = 0;
    for (uint8_t quality : {10, 30, 50, 70, 80, 90, 95, 98}) {
      auto bytes = encoded(encoder, page, {codec, quality});
      auto e = difference(page, decoded(decoder, bytes));
      EXPECT_GT(e.psnr, psnr) << encodingName({codec, quality});
      EXPECT_GT(bytes.size(), size);
      psnr = e.psnr, size = bytes.size();
      if (codec == PageCodec::kJpeg) {
        // Each of 64 orthonormal coefficients is off by at most half a step; then rounding. (No clamping occurs on this
        // page.)
        EXPECT_GE(e.psnr, 10 * std::log10(255 * 255 / std::pow(jpegStep(quality) / 2.0 + 0.75, 2))) << int{quality};
        EXPECT_LE(e.max, 8 * jpegStep(quality) / 2 + 1);
      }
    }
    EXPECT_GT(psnr, 45);
  }
  int previous = 256;
  for (int q = 1; q <= 100; ++q) {
    EXPECT_LE(jpegStep(q), previous);
    previous = jpegStep(q);
  }
  EXPECT_EQ(jpegStep(90), 4);
  EXPECT_EQ(jpegStep(100), 1);
}

// Decoded by plain libjpeg as any other reader would, the page is the same.
TEST(Jpeg, isAPlainJpegFile) {
  PageEncoder encoder(1);
  PageDecoder decoder;
  auto page = naturalPage(7, 9);
  for (PageCodec codec : {PageCodec::kJpeg, PageCodec::kJpegYcc}) {
    auto bytes = encoded(encoder, page, {codec, 85});
    ASSERT_EQ(bytes[0], 4);
    auto ours = decoded(decoder, bytes);
    jpeg_decompress_struct info;
    jpeg_error_mgr errors;
    info.err = jpeg_std_error(&errors);
    jpeg_create_decompress(&info);
    jpeg_mem_src(&info, bytes.data() + 1, bytes.size() - 1);
    ASSERT_EQ(jpeg_read_header(&info, TRUE), JPEG_HEADER_OK);
    info.out_color_space = JCS_RGB;
    info.dct_method = JDCT_ISLOW;
    jpeg_start_decompress(&info);
    ASSERT_EQ(info.output_width, unsigned{kSide});
    ASSERT_EQ(info.output_components, 3);
    std::vector<uint8_t> row(size_t{3} * kSide);
    for (size_t y = 0; y < kSide; ++y) {
      JSAMPROW rows = row.data();
      jpeg_read_scanlines(&info, &rows, 1);
      for (size_t x = 0; x < kSide; ++x)
        for (size_t c = 0; c < 3; ++c) ASSERT_EQ(row[3 * x + c], ours[c * kChannel + y * kSide + x]);
    }
    jpeg_finish_decompress(&info);
    jpeg_destroy_decompress(&info);
  }
}

// Near the top of the scale noise would grow: what does not fit a page is stored losslessly.
TEST(Jpeg, isNotUsedWhereItDoesNotFit) {
  std::mt19937 random(kSeed);
  std::vector<uint8_t> page(kTexturePageBytes);
  for (uint8_t& v : page) v = static_cast<uint8_t>(random());
  PageEncoder encoder(1);
  PageDecoder decoder;
  auto bytes = encoded(encoder, page, {PageCodec::kJpeg, 100});
  EXPECT_NE(bytes[0], 4);
  EXPECT_EQ(decoded(decoder, bytes), page);
  EXPECT_EQ(encoded(encoder, page, {PageCodec::kJpeg, 50})[0], 4);
}

// What follows from what a page may hold: other sizes, kinds and codings are refused.
TEST(Jpeg, othersAreRefused) {
  auto make = [](int side, int components, bool progressive, bool subsampled, int extra) {
    std::vector<uint8_t> pixels(static_cast<size_t>(side) * static_cast<size_t>(side * components), 99);
    for (size_t y = 0; y < static_cast<size_t>(side); ++y)
      pixels[y * static_cast<size_t>(side * components) + y] = static_cast<uint8_t>(y);
    const auto jpeg = testing_support::jpegFile(
        side, side, pixels, {.components = components, .samples = subsampled ? 2 : 1, .progressive = progressive});
    std::vector<uint8_t> page{4};
    page.insert(page.end(), jpeg.begin(), jpeg.end());
    page.resize(page.size() + static_cast<size_t>(extra));
    return page;
  };
  PageDecoder decoder;
  std::vector<uint8_t> slot(kSlotBytes);
  auto accepted = [&](const std::vector<uint8_t>& page) {
    return decoder.decodeToSlot(Plane::kTexture0, page, slot).ok();
  };
  EXPECT_TRUE(accepted(make(kSide, 3, false, false, 0)));  // the control: only what differs below is refused
  EXPECT_FALSE(accepted(make(kSide, 3, false, false, 1)));
  EXPECT_FALSE(accepted(make(kSide, 3, false, true, 0)));
  EXPECT_FALSE(accepted(make(kSide, 3, true, false, 0)));
  EXPECT_FALSE(accepted(make(kSide, 1, false, false, 0)));
  EXPECT_FALSE(accepted(make(kSide - 1, 3, false, false, 0)));
  EXPECT_FALSE(accepted(make(kSide + 8, 3, false, false, 0)));
  EXPECT_FALSE(accepted(make(4096, 3, false, false, 0)));
  EXPECT_TRUE(accepted(make(kSide, 3, false, false, 0))) << "after errors the decoder goes on";
}

TEST(Blocks, naturalPagesKeepTheirQuality) {
  PageEncoder encoder(1);
  PageDecoder decoder;
  auto page = naturalPage(0, 0);
  auto error = [&](PageCodec c) { return difference(page, decoded(decoder, encoded(encoder, page, {c, 0}))); };
  EXPECT_GT(error(PageCodec::kBc1).psnr, 33);
  EXPECT_GT(error(PageCodec::kBc4).psnr, 46);
  EXPECT_GT(error(PageCodec::kBc7).psnr, 41);
  // The same texels in another order of blocks.
  EXPECT_EQ(decoded(decoder, encoded(encoder, page, {PageCodec::kBc4, 0})),
            decoded(decoder, encoded(encoder, page, {PageCodec::kBc5, 0})));
  EXPECT_NE(encoded(encoder, page, {PageCodec::kBc4, 0}), encoded(encoder, page, {PageCodec::kBc5, 0}));
  // Negative control: the bounds are not met by a page of other content.
  EXPECT_LT(difference(naturalPage(30, 0), decoded(decoder, encoded(encoder, page, {PageCodec::kBc7, 0}))).psnr, 30);
}

// Two neighbours hold the same texels in 8 columns, 4 of either's border: two columns of blocks, or one of JPEG's.
// Their blocks begin at the same texels, as a page's side is a multiple of 8, so both decode to the same.
int seam(PageEncoding e, int apart, bool down) {
  PageEncoder encoder(1);
  PageDecoder decoder;
  auto first = decoded(decoder, encoded(encoder, naturalPage(0, 0), e));
  auto second = decoded(decoder, encoded(encoder, naturalPage(down ? 0 : apart, down ? apart : 0), e));
  int worst = 0;
  for (int c = 0; c < 3; ++c) {
    for (int along = 0; along < kSide; ++along) {
      for (int across = 0; across < kSide - apart; ++across) {
        auto at = [&](int x, int y) { return static_cast<size_t>(c) * kChannel + static_cast<size_t>(y * kSide + x); };
        const size_t a = down ? at(along, apart + across) : at(apart + across, along),
                     b = down ? at(along, across) : at(across, along);
        worst = std::max(worst, std::abs(first[a] - second[b]));
      }
    }
  }
  return worst;
}

TEST(AnyEncoding, neighboursAgreeWhereTheyOverlap) {
  for (PageEncoding e : allEncodings()) {
    EXPECT_EQ(seam(e, kPagePx, false), 0) << encodingName(e);
    EXPECT_EQ(seam(e, kPagePx, true), 0) << encodingName(e);
    // Negative control: pages two texels farther apart have other blocks, and the check sees their seam.
    if (isBlockCodec(e.codec) || e == PageEncoding{PageCodec::kJpeg, 90}) {
      EXPECT_GT(seam(e, kPagePx + 2, false), 0) << encodingName(e);
    }
  }
}

TEST(AnyEncoding, theSameBytesAgainAndSlotsAreOpaque) {
  PageEncoder a(1), b(1);
  PageDecoder decoder;
  std::vector<uint8_t> slot(kSlotBytes);
  auto page = naturalPage(3, 5), other = naturalPage(99, 1, 60);
  for (PageEncoding e : allEncodings()) {
    auto first = encoded(a, page, e);
    EXPECT_LE(first.size(), kMaxEncodedPageBytes);
    for (PageEncoding before : allEncodings()) encoded(b, other, before);  // leaves no trace
    EXPECT_EQ(encoded(b, page, e), first) << encodingName(e);
    auto channels = decoded(decoder, first);
    std::fill(slot.begin(), slot.end(), uint8_t{0xAA});
    ASSERT_TRUE(decoder.decodeToSlot(Plane::kTexture0, first, slot).ok());
    for (size_t i = 0; i < kChannel; ++i) {
      ASSERT_EQ(slot[4 * i], channels[i]) << encodingName(e);
      ASSERT_EQ(slot[4 * i + 1], channels[kChannel + i]);
      ASSERT_EQ(slot[4 * i + 2], channels[2 * kChannel + i]);
      ASSERT_EQ(slot[4 * i + 3], 255);
    }
  }
}

TEST(AnyEncoding, noiseStaysWithinTheLargestPage) {
  std::mt19937 random(kSeed);
  std::vector<uint8_t> page(kTexturePageBytes);
  for (uint8_t& v : page) v = static_cast<uint8_t>(random());
  PageEncoder encoder(1);
  PageDecoder decoder;
  for (PageEncoding e : allEncodings()) {
    auto bytes = encoded(encoder, page, e);
    EXPECT_LE(bytes.size(), kMaxEncodedPageBytes) << encodingName(e);
    decoded(decoder, bytes);
  }
}

TEST(AnyEncoding, everyTruncationFails) {
  PageEncoder encoder(1);
  PageDecoder decoder;
  std::vector<uint8_t> slot(kSlotBytes), channels(kTexturePageBytes);
  auto page = naturalPage(0, 0);
  for (PageEncoding e : allEncodings()) {
    auto whole = encoded(encoder, page, e);
    const size_t step = std::max<size_t>(1, whole.size() / 1000);
    for (size_t n = 0; n < whole.size(); n += n < 700 ? 1 : step) {
      std::vector<uint8_t> cut(
          whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(n));  // its own allocation: ASan sees an overrun
      ASSERT_FALSE(decoder.decodeToSlot(Plane::kTexture0, cut, slot).ok()) << encodingName(e) << " " << n;
      ASSERT_FALSE(n % 16 == 0 && decoder.decodeTexture(cut, channels).ok());
    }
    std::vector<uint8_t> longer = whole;
    longer.push_back(0);
    EXPECT_FALSE(decoder.decodeToSlot(Plane::kTexture0, longer, slot).ok()) << encodingName(e) << ": a byte too many";
    EXPECT_TRUE(decoder.decodeToSlot(Plane::kTexture0, whole, slot).ok()) << encodingName(e);
    if (e.codec != PageCodec::kLossless) {
      std::vector<uint16_t> samples(kReliefPageSamples);
      EXPECT_FALSE(decoder.decodeRelief(whole, samples).ok()) << "relief is lossless";
    }
  }
}

TEST(AnyEncoding, anyBytesDecodeOrFailCleanly) {
  std::mt19937 random(kSeed);
  PageEncoder encoder(1);
  PageDecoder decoder;
  std::vector<uint8_t> slot(kSlotBytes);
  auto page = naturalPage(0, 0);
  for (PageEncoding e : allEncodings()) {
    auto good = encoded(encoder, page, e);
    int ok = 0;
    const int tries = 400;
    for (int i = 0; i < tries; ++i) {
      auto bytes = good;
      int flips = 1 + static_cast<int>(random() % 6);
      // Half of them in the heads and tables.
      for (int f = 0; f < flips; ++f)
        bytes[random() % (random() % 2 ? bytes.size() : std::min<size_t>(bytes.size(), 640))] ^=
            static_cast<uint8_t>(1u << (random() % 8));
      if (random() % 16 == 0) bytes.resize(random() % 64);
      ok += decoder.decodeToSlot(Plane::kTexture0, bytes, slot).ok();
    }
    EXPECT_LT(ok, tries) << encodingName(e) << " seed " << kSeed;
    ASSERT_TRUE(decoder.decodeToSlot(Plane::kTexture0, good, slot).ok()) << "nothing is left of the bad ones";
  }
  // Heads that name nothing that there is.
  for (int b0 = 0; b0 < 256; ++b0) {
    for (int b1 : {0, 1, 3, 8, 16, 18, 19, 22, 24, 255}) {
      std::vector<uint8_t> bytes(600, 0);
      bytes[0] = static_cast<uint8_t>(b0), bytes[1] = static_cast<uint8_t>(b1);
      EXPECT_FALSE(decoder.decodeToSlot(Plane::kTexture0, bytes, slot).ok()) << b0 << " " << b1;
    }
  }
}

}  // namespace page_encoding_test
}  // namespace relievo
