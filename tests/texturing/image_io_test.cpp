// Images through OpenImageIO: regions of what was written, whatever the file's layout; damaged files cost one Error.
#include "texturing/import/image_io.h"
#include "texturing/import/image_io_module.h"

#ifdef RELIEVO_ADDRESS_SANITIZER
#include <sanitizer/lsan_interface.h>
#endif
#include <OpenImageIO/imagebuf.h>
#include <OpenImageIO/imagebufalgo.h>
#include <OpenImageIO/imageio.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <atomic>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <random>
#include <thread>

#include "src/base/file.h"

namespace relievo {
namespace image_io_test {

namespace fs = std::filesystem;
using relievo::writeImage;  // beside the one below, which writes as OpenImageIO does
using Bytes = std::vector<uint8_t>;

fs::path folder() {
  static const fs::path path = [] {
    auto p = fs::temp_directory_path() / ("relievo_image_io_test_" + std::to_string(::getpid()));
    fs::create_directories(p);
    return p;
  }();
  return path;
}
struct RemoveFolder : testing::Environment {
  void TearDown() override { fs::remove_all(folder()); }
};
[[maybe_unused]] auto* const kRemoveFolder = testing::AddGlobalTestEnvironment(new RemoveFolder);

Bytes load(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return Bytes(std::istreambuf_iterator<char>(in), {});
}
std::string save(const std::string& name, const Bytes& bytes) {
  const std::string path = folder() / name;
  fs::remove(path);  // file systems flush a file that is rewritten in place, which takes its time
  std::ofstream(path, std::ios::binary | std::ios::trunc)
      .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  return path;
}

template <class T>
OIIO::TypeDesc typeOf() {
  return OIIO::TypeDesc(OIIO::BaseTypeFromC<T>::value);
}

// What the tests read is written here by OpenImageIO itself, in layouts that our own writer does not have.
template <class T>
std::string writeImage(const std::string& name, int width, int height, int channels, const std::vector<T>& pixels,
                       OIIO::TypeDesc type, const char* compression = "none", int tile = 0) {
  const std::string path = folder() / name;
  OIIO::ImageSpec spec(width, height, channels, type);
  spec.attribute("compression", compression);
  spec.attribute("oiio:UnassociatedAlpha", 1);
  if (tile) spec.tile_width = spec.tile_height = tile;
  auto out = OIIO::ImageOutput::create(path);
  EXPECT_TRUE(out && out->open(path, spec));
  EXPECT_TRUE(out->write_image(typeOf<T>(), pixels.data()));
  EXPECT_TRUE(out->close());
  return path;
}

template <class T>
std::vector<T> noise(size_t count, uint32_t seed) {
  std::vector<T> out(count);
  std::mt19937 random(seed);
  for (T& v : out) {
    if constexpr (std::is_floating_point_v<T>) v = static_cast<T>(std::uniform_real_distribution<>(-3, 9)(random));
    else v = static_cast<T>(random());
  }
  return out;
}

Rect randomRect(std::mt19937& random, int64_t width, int64_t height) {
  Rect r{static_cast<int64_t>(random() % width), static_cast<int64_t>(random() % height), 0, 0};
  r.width = 1 + static_cast<int64_t>(random() % (width - r.x));
  r.height = 1 + static_cast<int64_t>(random() % (height - r.y));
  return r;
}

// expected(x, y) in mm.
template <class Expected>
void expectHeights(const std::string& path, std::optional<std::pair<double, double>> range, int64_t width,
                   int64_t height, Expected expected, uint64_t cache_bytes = uint64_t{256} << 20) {
  auto source = openHeightImage(path, range, {.cache_bytes = cache_bytes});
  ASSERT_TRUE(source) << source.error().text();
  ASSERT_EQ((*source)->width(), width);
  ASSERT_EQ((*source)->height(), height);
  std::mt19937 random(3);
  for (int i = 0; i < 40; ++i) {
    const Rect r = i ? randomRect(random, width, height) : Rect{0, 0, width, height};
    std::vector<float> out(static_cast<size_t>(r.width * r.height));
    auto read = (*source)->read(r, out);
    ASSERT_TRUE(read) << read.error().text();
    for (int64_t y = 0; y < r.height; ++y)
      for (int64_t x = 0; x < r.width; ++x) {
        const float found = out[static_cast<size_t>(y * r.width + x)];
        ASSERT_FLOAT_EQ(found, static_cast<float>(expected(r.x + x, r.y + y)))
            << path << " at " << r.x + x << ", " << r.y + y;
        ASSERT_GE(found, (*source)->minMm());
        ASSERT_LE(found, (*source)->maxMm());
      }
  }
}

TEST(HeightImage, IntegersMapToTheRange) {
  const int w = 130, h = 75;
  auto u16 = noise<uint16_t>(w * h, 1);
  u16[5] = 0, u16[6] = 65535;
  auto mm16 = [&](int64_t x, int64_t y) { return -2 + 7.0 * u16[static_cast<size_t>(y * w + x)] / 65535; };
  for (auto [name, compression, tile] : {std::tuple{"a.tif", "none", 0},
                                         {"b.tif", "zip", 0},
                                         {"c.tif", "lzw", 16},
                                         {"d.tif", "none", 32},
                                         {"e.png", "none", 0}}) {
    auto path = writeImage(name, w, h, 1, u16, OIIO::TypeUInt16, compression, tile);
    expectHeights(path, {{-2, 5}}, w, h, mm16);
    expectHeights(path, {{-2, 5}}, w, h, mm16, 8 * w * 8);  // a cache of a few rows: bands come and go
  }
  auto u8 = noise<uint8_t>(w * h, 2);
  expectHeights(writeImage("g.tif", w, h, 1, u8, OIIO::TypeUInt8), {{0, 1}}, w, h,
                [&](int64_t x, int64_t y) { return u8[static_cast<size_t>(y * w + x)] / 255.0; });
  auto u32 = noise<uint32_t>(w * h, 3);
  expectHeights(writeImage("h.tif", w, h, 1, u32, OIIO::TypeUInt32), {{0, 10}}, w, h,
                [&](int64_t x, int64_t y) { return 10.0 * u32[static_cast<size_t>(y * w + x)] / 4294967295.0; });
}

TEST(HeightImage, FloatsAreMillimetresAndTheirRangeIsTight) {
  const int w = 130, h = 75;
  auto f = noise<float>(w * h, 4);
  auto mm = [&](int64_t x, int64_t y) { return f[static_cast<size_t>(y * w + x)]; };
  for (auto [name, compression, tile] : {std::tuple{"f.tif", "none", 0}, {"f2.tif", "zip", 32}, {"f.exr", "zip", 0}}) {
    auto path = writeImage(name, w, h, 1, f, OIIO::TypeFloat, compression, tile);
    expectHeights(path, {}, w, h, mm);
    auto source = openHeightImage(path, {});
    ASSERT_TRUE(source);
    EXPECT_EQ((*source)->minMm(), *std::min_element(f.begin(), f.end()));
    EXPECT_EQ((*source)->maxMm(), *std::max_element(f.begin(), f.end()));
  }
  std::vector<double> d(f.begin(), f.end());
  expectHeights(writeImage("d.tif", w, h, 1, d, OIIO::TypeDesc::DOUBLE), {}, w, h, mm);
  std::vector<float> halves(f);
  for (float& v : halves) v = std::round(v * 8) / 8;  // what a half holds exactly
  expectHeights(writeImage("half.exr", w, h, 1, halves, OIIO::TypeHalf), {}, w, h,
                [&](int64_t x, int64_t y) { return halves[static_cast<size_t>(y * w + x)]; });
}

TEST(HeightImage, FloatsBesideARangeAreSharesOfIt) {
  const int w = 40, h = 30;
  auto shares = noise<float>(w * h, 14);
  for (float& v : shares) v = (v + 3) / 12;
  expectHeights(writeImage("shares.tif", w, h, 1, shares, OIIO::TypeFloat), {{10, 12}}, w, h,
                [&](int64_t x, int64_t y) { return 10 + 2.0 * shares[static_cast<size_t>(y * w + x)]; });
  // Beyond 0..1 they are mm: a range beside them would multiply millimetres.
  for (float beyond : {-0.01f, 1.01f, 250.0f}) {
    shares[77] = beyond;
    auto source = openHeightImage(writeImage("mm.tif", w, h, 1, shares, OIIO::TypeFloat), {{10, 12}});
    ASSERT_FALSE(source) << beyond;
    EXPECT_EQ(source.error().kind, ErrorKind::kUsage);
    EXPECT_NE(source.error().hint.find("leave out --relief-mm or --relief-px"), std::string::npos)
        << source.error().text();
  }
}

TEST(HeightImage, HolesAreRefusedWithTheirPlace) {
  for (float hole : {std::nanf(""), INFINITY, -INFINITY}) {
    auto f = noise<float>(50 * 40, 5);
    f[17 * 50 + 23] = hole;
    f[30 * 50 + 2] = hole;
    auto source = openHeightImage(writeImage("nan.tif", 50, 40, 1, f, OIIO::TypeFloat), {});
    ASSERT_FALSE(source);
    EXPECT_EQ(source.error().kind, ErrorKind::kInvalidData);
    EXPECT_NE(source.error().message.find("(23, 17)"), std::string::npos) << source.error().text();
  }
}

// Squares of lengths are finite in single precision as far as heights are accepted.
TEST(HeightImage, HeightsThatCannotBeDrawnAreRefused) {
  for (float height : {2e18f, -2e18f, std::numeric_limits<float>::max(), std::numeric_limits<float>::lowest()}) {
    auto f = noise<float>(50 * 40, 5);
    f[17 * 50 + 23] = height;
    auto source = openHeightImage(writeImage("far.tif", 50, 40, 1, f, OIIO::TypeFloat), {});
    ASSERT_FALSE(source) << height;
    EXPECT_EQ(source.error().kind, ErrorKind::kInvalidData);
    EXPECT_NE(source.error().message.find("within 1e18 mm"), std::string::npos) << source.error().text();
    f[17 * 50 + 23] = height < 0 ? -9e17f : 9e17f;
    EXPECT_TRUE(openHeightImage(writeImage("far.tif", 50, 40, 1, f, OIIO::TypeFloat), {})) << "control";
  }
}

// Programs for terrain write a number where there is no height, and name it as text in the tag GDAL_NODATA.
TEST(HeightImage, HolesThatTheFileNamesAreRefusedWithTheirPlace) {
  // A TIFF with that tag, whose directory is moved to the file's end; big: as BigTIFF.
  auto tagged = [](const std::string& path, const std::string& value) {
    Bytes file = load(path);
    auto u16 = [&](size_t at) { return static_cast<uint32_t>(file[at] | file[at + 1] << 8); };
    auto u32 = [&](size_t at) { return u16(at) | u16(at + 2) << 16; };
    auto put = [](Bytes& to, uint64_t v, int bytes) {
      for (int i = 0; i < bytes; ++i) to.push_back(static_cast<uint8_t>(v >> (8 * i)));
    };
    const size_t old = u32(4), entries = u16(old);
    Bytes text(value.begin(), value.end());
    text.push_back(0);
    file.resize((file.size() + 1) / 2 * 2);
    const size_t text_at = file.size();
    file.insert(file.end(), text.begin(), text.end());
    file.resize((file.size() + 1) / 2 * 2);
    const size_t directory = file.size();
    Bytes end;
    put(end, entries + 1, 2);
    end.insert(end.end(), file.begin() + static_cast<std::ptrdiff_t>(old + 2),
               file.begin() + static_cast<std::ptrdiff_t>(old + 2 + 12 * entries));
    put(end, 42113, 2), put(end, 2, 2), put(end, text.size(), 4);
    if (text.size() <= 4) text.resize(4), end.insert(end.end(), text.begin(), text.end());
    else put(end, text_at, 4);
    put(end, 0, 4);
    file.insert(file.end(), end.begin(), end.end());
    for (int i = 0; i < 4; ++i) file[4 + i] = static_cast<uint8_t>(directory >> (8 * i));
    return save("tagged.tif", file);
  };
  auto expectHole = [](const std::string& path, std::optional<std::pair<double, double>> range) {
    auto source = openHeightImage(path, range);
    ASSERT_FALSE(source);
    EXPECT_EQ(source.error().kind, ErrorKind::kInvalidData);
    EXPECT_NE(source.error().message.find("(23, 17)"), std::string::npos) << source.error().text();
  };
  for (const auto& [sample, text] : {std::pair<float, const char*>{-9999, "-9999"},
                                     {std::numeric_limits<float>::lowest(), "-3.4028234663852886e+38"},
                                     {-32768, "-32768 "}}) {
    auto f = noise<float>(50 * 40, 5);
    const auto sound = tagged(writeImage("holes.tif", 50, 40, 1, f, OIIO::TypeFloat), text);
    EXPECT_TRUE(openHeightImage(sound, {})) << "control: a file whose pixels are all there";
    f[17 * 50 + 23] = f[30 * 50 + 2] = sample;
    const auto plain = writeImage("holes.tif", 50, 40, 1, f, OIIO::TypeFloat);
    if (sample > -1e18f) {
      EXPECT_TRUE(openHeightImage(plain, {})) << "control: without the tag it is a height";
    }
    expectHole(tagged(plain, text), {});
  }
  std::vector<uint8_t> u8(50 * 40, 7);
  u8[17 * 50 + 23] = 255;
  expectHole(tagged(writeImage("holes.tif", 50, 40, 1, u8, OIIO::TypeUInt8), "255"), {{0, 1}});
  std::vector<uint16_t> u16(50 * 40, 7);
  u16[17 * 50 + 23] = 0;
  expectHole(tagged(writeImage("holes.tif", 50, 40, 1, u16, OIIO::TypeUInt16), "0"), {{0, 1}});
  EXPECT_TRUE(openHeightImage(tagged(writeImage("holes.tif", 50, 40, 1, u16, OIIO::TypeUInt16), "nan"), {{0, 1}}));
}

TEST(HeightImage, WhatIsNoHeightIsRefused) {
  auto three = writeImage("rgb.tif", 8, 8, 3, noise<uint8_t>(192, 1), OIIO::TypeUInt8);
  EXPECT_EQ(openHeightImage(three, {{0, 1}}).error().kind, ErrorKind::kUnsupported);
  auto signed16 = writeImage("i16.tif", 8, 8, 1, noise<int16_t>(64, 1), OIIO::TypeInt16);
  EXPECT_EQ(openHeightImage(signed16, {{0, 1}}).error().kind, ErrorKind::kUnsupported);
  auto u16 = writeImage("u16.tif", 8, 8, 1, noise<uint16_t>(64, 1), OIIO::TypeUInt16);
  EXPECT_EQ(openHeightImage(u16, {}).error().kind, ErrorKind::kUsage);
  EXPECT_EQ(openHeightImage(u16, {{1, 0}}).error().kind, ErrorKind::kUsage);
  EXPECT_EQ(openHeightImage(u16, {{0, NAN}}).error().kind, ErrorKind::kUsage);
  EXPECT_EQ(openHeightImage(folder() / "missing.tif", {}).error().kind, ErrorKind::kIo);
  EXPECT_EQ(openHeightImage(save("empty.tif", {}), {}).error().kind, ErrorKind::kInvalidData);
  EXPECT_EQ(openHeightImage(save("text.tif", Bytes(100, 'x')), {}).error().kind, ErrorKind::kInvalidData);
}

TEST(ColourImage, ReadsRegionsOfEveryLayout) {
  const int w = 133, h = 90;
  for (int channels : {1, 2, 3, 4}) {
    auto pixels = noise<uint8_t>(static_cast<size_t>(w * h * channels), 6);
    for (auto [name, compression, tile] :
         {std::tuple{"a.tif", "none", 0}, {"b.tif", "zip", 0}, {"c.tif", "lzw", 16}, {"d.png", "none", 0}}) {
      auto path = writeImage(name, w, h, channels, pixels, OIIO::TypeUInt8, compression, tile);
      for (uint64_t cache_bytes : {uint64_t{1} << 28, uint64_t{3 * w * 40}}) {
        auto source = openColourImage(path, {.cache_bytes = cache_bytes});
        ASSERT_TRUE(source) << source.error().text();
        std::mt19937 random(3);
        for (int i = 0; i < 25; ++i) {
          const Rect r = i ? randomRect(random, w, h) : Rect{0, 0, w, h};
          Bytes out(static_cast<size_t>(3 * r.width * r.height));
          auto read = (*source)->read(r, out);
          ASSERT_TRUE(read) << read.error().text();
          size_t n = 0;
          for (int c = 0; c < 3; ++c)
            for (int64_t y = r.y; y < r.y + r.height; ++y)
              for (int64_t x = r.x; x < r.x + r.width; ++x) {
                ASSERT_EQ(out[n++], pixels[static_cast<size_t>((y * w + x) * channels + (channels < 3 ? 0 : c))])
                    << path << " channels " << channels;
              }
        }
      }
    }
  }
}

TEST(ColourImage, SixteenBitIsRounded) {
  std::vector<uint16_t> pixels(256 * 3);
  for (size_t i = 0; i < pixels.size(); ++i) pixels[i] = static_cast<uint16_t>(i * 85);
  auto source = openColourImage(writeImage("c16.png", 16, 16, 3, pixels, OIIO::TypeUInt16));
  ASSERT_TRUE(source);
  Bytes out(768);
  ASSERT_TRUE((*source)->read({0, 0, 16, 16}, out));
  for (size_t i = 0; i < 256; ++i)
    for (size_t c = 0; c < 3; ++c) EXPECT_NEAR(out[c * 256 + i], pixels[3 * i + c] / 257.0, 0.501);
}

TEST(ColourImage, ManyThreadsReadTheSame) {
  const int w = 400, h = 300;
  auto pixels = noise<uint8_t>(w * h * 3, 8);
  for (const char* name : {"t.tif", "t.png"}) {
    auto path = writeImage(name, w, h, 3, pixels, OIIO::TypeUInt8, "zip");
    auto source = openColourImage(path, {.cache_bytes = 3 * w * 64});
    ASSERT_TRUE(source);
    std::atomic<int> wrong{0};
    std::vector<std::thread> threads;
    for (uint32_t t = 0; t < 4; ++t) {
      threads.emplace_back([&, t] {
        std::mt19937 random(t);
        for (int i = 0; i < 30; ++i) {
          const Rect r = randomRect(random, w, h);
          Bytes out(static_cast<size_t>(3 * r.width * r.height));
          if (!(*source)->read(r, out)) ++wrong;
          for (int64_t y = 0; y < r.height; ++y)
            for (int64_t x = 0; x < r.width; ++x)
              wrong += out[static_cast<size_t>(y * r.width + x)] !=
                       pixels[static_cast<size_t>(((r.y + y) * w + r.x + x) * 3)];
        }
      });
    }
    for (auto& t : threads) t.join();
    EXPECT_EQ(wrong, 0) << name;
  }
}

TEST(ColourImage, ProvenanceNamesTheFileAndItsDigest) {
  auto path = writeImage("named.png", 8, 8, 3, noise<uint8_t>(192, 1), OIIO::TypeUInt8);
  auto source = openColourImage(path);
  ASSERT_TRUE(source);
  EXPECT_EQ((*source)->provenance().name, "named.png");
  EXPECT_EQ((*source)->provenance().xxh3, *hashFile(path));
}

// As OpenImageIO turns a whole image; but for 5 and 7, which its reorient() (2.4) takes for one another: of 5 the first
// row is the picture's left side and the first column its top, of 7 its right side and its bottom (EXIF 2.3, 4.6.4).
OIIO::ImageBuf turnedWhole(const std::string& path, int orientation) {
  const OIIO::ImageBuf stored(path);
  if (orientation == 5) return OIIO::ImageBufAlgo::transpose(stored);
  if (orientation == 7) return OIIO::ImageBufAlgo::rotate180(OIIO::ImageBufAlgo::transpose(stored));
  return OIIO::ImageBufAlgo::reorient(stored);
}

TEST(Orientation, OfExifIsAppliedToEveryRectangle) {
  const int w = 70, h = 41;
  auto pixels = noise<uint8_t>(w * h * 3, 21);
  auto heights = noise<uint16_t>(w * h, 22);
  for (int orientation = 1; orientation <= 8; ++orientation) {
    for (int tile : {0, 16}) {
      auto save = [&](const std::string& name, int channels, OIIO::TypeDesc type, const void* data) {
        // Names of their own: ImageBuf keeps what it read under a name.
        const std::string path = folder() / (name + std::to_string(orientation) + "_" + std::to_string(tile) + ".tif");
        OIIO::ImageSpec spec(w, h, channels, type);
        spec.attribute("Orientation", orientation);
        if (tile) spec.tile_width = spec.tile_height = tile;
        auto out = OIIO::ImageOutput::create(path);
        EXPECT_TRUE(out && out->open(path, spec) && out->write_image(type, data) && out->close());
        return path;
      };
      const std::string colour = save("turned", 3, OIIO::TypeUInt8, pixels.data()),
                        relief = save("turned_height", 1, OIIO::TypeUInt16, heights.data());
      const OIIO::ImageBuf turned = turnedWhole(colour, orientation), turned_relief = turnedWhole(relief, orientation);
      ASSERT_EQ(turned.spec().width, orientation >= 5 ? h : w);
      auto facts = readImageFacts(colour);
      ASSERT_TRUE(facts);
      EXPECT_EQ(facts->width_px, turned.spec().width);
      EXPECT_EQ(facts->height_px, turned.spec().height);
      expectHeights(
          relief, {{0, 65535}}, turned_relief.spec().width, turned_relief.spec().height, [&](int64_t x, int64_t y) {
            return std::round(65535.0 * turned_relief.getchannel(static_cast<int>(x), static_cast<int>(y), 0, 0));
          });
      for (bool orient : {true, false}) {
        const OIIO::ImageBuf stored(colour);
        const OIIO::ImageBuf& expected = orient ? turned : stored;
        auto source = openColourImage(colour, {.cache_bytes = 3 * w * 16, .orient = orient});
        ASSERT_TRUE(source) << source.error().text();
        ASSERT_EQ((*source)->width(), expected.spec().width);
        ASSERT_EQ((*source)->height(), expected.spec().height);
        std::mt19937 random(5);
        for (int i = 0; i < 12; ++i) {
          const Rect r = i ? randomRect(random, (*source)->width(), (*source)->height())
                           : Rect{0, 0, (*source)->width(), (*source)->height()};
          Bytes out(static_cast<size_t>(3 * r.width * r.height));
          ASSERT_TRUE((*source)->read(r, out));
          for (int c = 0; c < 3; ++c)
            for (int64_t y = 0; y < r.height; ++y)
              for (int64_t x = 0; x < r.width; ++x)
                ASSERT_EQ(
                    out[static_cast<size_t>((c * r.height + y) * r.width + x)],
                    std::lround(255 * expected.getchannel(static_cast<int>(r.x + x), static_cast<int>(r.y + y), 0, c)))
                    << "orientation " << orientation << " tile " << tile;
        }
      }
    }
  }
}

TEST(ImageFacts, TellAlphaAndTheResolutionTag) {
  auto facts = [&](const char* name, int channels, float x, float y, const char* unit) {
    const std::string path = folder() / name;
    OIIO::ImageSpec spec(8, 8, channels, OIIO::TypeUInt8);
    if (x > 0)
      spec.attribute("XResolution", x), spec.attribute("YResolution", y), spec.attribute("ResolutionUnit", unit);
    if (x != y) spec.attribute("PixelAspectRatio", y / x);
    auto out = OIIO::ImageOutput::create(path);
    const Bytes pixels(static_cast<size_t>(64 * channels), 9);
    EXPECT_TRUE(out && out->open(path, spec) && out->write_image(OIIO::TypeUInt8, pixels.data()) && out->close());
    auto read = readImageFacts(path);
    EXPECT_TRUE(read) << read.error().text();
    return read ? *read : ImageFacts{};
  };
  EXPECT_NEAR(facts("dpi.tif", 3, 300, 300, "in").tag_mm_per_px, 25.4 / 300, 1e-9);
  EXPECT_EQ(facts("dpi.tif", 3, 300, 300, "in").tag, "300 dpi");
  EXPECT_NEAR(facts("dpcm.tif", 3, 200, 200, "cm").tag_mm_per_px, 0.05, 1e-9);
  EXPECT_NEAR(facts("dpi.jpg", 3, 600, 600, "in").tag_mm_per_px, 25.4 / 600, 1e-9);
  EXPECT_NEAR(facts("dpi.png", 3, 300, 300, "in").tag_mm_per_px, 25.4 / 300, 1e-4);  // whole pixels a metre
  EXPECT_EQ(facts("oblong.tif", 3, 300, 150, "in").tag_mm_per_px, 0) << "pixels that are not square";
  EXPECT_EQ(facts("ratio.tif", 3, 300, 300, "none").tag_mm_per_px, 0);
  EXPECT_EQ(facts("untold.tif", 3, 0, 0, "").tag_mm_per_px, 0);
  for (int channels : {1, 2, 3, 4})
    EXPECT_EQ(facts("alpha.png", channels, 0, 0, "").alpha, channels % 2 == 0) << channels;
}

// What a header claims is refused by the limit's name before it is allocated; the same file is read where the limit
// allows it.
TEST(ImageLimits, AreCheckedBeforeTheLibraryAllocates) {
  const uint64_t mib = uint64_t{1} << 20;
  auto expectBeyond = [](const auto& result, const char* option) {
    ASSERT_FALSE(result);
    EXPECT_EQ(result.error().kind, ErrorKind::kRuntime) << result.error().text();
    EXPECT_NE(result.error().hint.find(option), std::string::npos) << result.error().text();
    EXPECT_NE(result.error().hint.find("--memory-mib"), std::string::npos) << result.error().text();
  };
  const std::string tiled = writeImage("tile.tif", 1024, 1024, 3, Bytes(3 << 20), OIIO::TypeUInt8, "zip", 1024);
  expectBeyond(openColourImage(tiled, {.memory_budget_bytes = 16 * mib}), "--max-tile-mib to 4,");
  EXPECT_TRUE(openColourImage(tiled, {.memory_budget_bytes = 16 * mib, .max_tile_bytes = 4 * mib}));
  EXPECT_TRUE(openColourImage(tiled, {.memory_budget_bytes = 24 * mib}));
  const std::string height =
      writeImage("tile16.tif", 1024, 1024, 1, std::vector<uint16_t>(1 << 20), OIIO::TypeUInt16, "zip", 1024);
  expectBeyond(openHeightImage(height, {{0, 1}}, {.memory_budget_bytes = 8 * mib}), "--max-tile-mib");
  // Kept as a whole: a mesh's image.
  const std::string plain = writeImage("whole.tif", 1024, 1024, 3, Bytes(3 << 20), OIIO::TypeUInt8);
  expectBeyond(readImage8(plain, {.memory_budget_bytes = 8 * mib}), "--max-image-mib to 4,");
  EXPECT_TRUE(readImage8(plain, {.memory_budget_bytes = 9 * mib}));
  EXPECT_TRUE(readImage8(plain, {.memory_budget_bytes = 8 * mib, .max_decoded_bytes = 3 * mib}));
  // Decoded as a whole, by its header alone: nothing behind it is there to be read.
  Bytes png{0x89, 'P', 'N', 'G',  '\r', '\n', 0x1a, '\n', 0, 0, 0, 13, 'I', 'H', 'D',
            'R',  0,   0,   0x40, 0,    0,    0,    0x40, 0, 8, 2, 0,  0,   1};
  png.resize(60000);
  expectBeyond(openColourImage(save("interlaced.png", png)), "--max-image-mib to 769,");
  png[28] = 0;
  EXPECT_EQ(openColourImage(save("rows.png", png)).error().kind, ErrorKind::kInvalidData);
  Bytes jpeg{0xff, 0xd8, 0xff, 0xe0, 0, 4, 0, 0, 0xff, 0xc2, 0, 17, 8, 0x80, 0, 0x80, 0, 3};
  jpeg.resize(300000);
  expectBeyond(openColourImage(save("progressive.jpg", jpeg)), "--max-image-mib to 6145,");
  // The packing ratio.
  const std::string blank = writeImage("blank.tif", 4096, 4096, 1, Bytes(1 << 24), OIIO::TypeUInt8, "zip");
  EXPECT_TRUE(openColourImage(blank));
  auto packed = openColourImage(blank, {.max_packing = 10});
  ASSERT_FALSE(packed);
  EXPECT_EQ(packed.error().kind, ErrorKind::kInvalidData);
  EXPECT_NE(packed.error().hint.find("--max-packing"), std::string::npos) << packed.error().text();
}

// ---- writing

TEST(WriteImage, PngRoundTripIsExact) {
  // Four channels: colour under zero alpha must survive too.
  for (int channels : {1, 2, 3, 4}) {
    auto pixels = noise<uint8_t>(static_cast<size_t>(31 * 17 * channels), 9);
    const std::string path = folder() / "w.png";
    ASSERT_TRUE(writeImage(path, 31, 17, channels, pixels));
    auto image = readImage8(path);
    ASSERT_TRUE(image) << image.error().text();
    EXPECT_EQ(image->channels, channels);
    EXPECT_TRUE(image->pixels == pixels) << channels << " channels";
  }
}

// In whole pixels a metre, as PNG counts.
TEST(WriteImage, PngTellsItsScale) {
  const auto pixels = noise<uint8_t>(8 * 8 * 3, 9);
  const std::string path = folder() / "scale.png";
  auto perMetre = [&]() -> uint32_t {
    std::ifstream in(path, std::ios::binary);
    const std::string bytes((std::istreambuf_iterator<char>(in)), {});
    const size_t at = bytes.find("pHYs");
    if (at == std::string::npos) return 0;
    EXPECT_EQ(bytes.at(at + 12), 1) << "metres";
    uint32_t x = 0, y = 0;
    for (size_t k = 0; k < 4; ++k)
      x = x << 8 | static_cast<uint8_t>(bytes.at(at + 4 + k)), y = y << 8 | static_cast<uint8_t>(bytes.at(at + 8 + k));
    EXPECT_EQ(x, y);
    return x;
  };
  for (auto [mm_per_px, px_per_m] : {std::pair{0.05, 20000u},
                                     {0.0423333333, 23622u},
                                     {0.3, 3333u},
                                     {0.29296875, 3413u},
                                     {1000.0, 1u},
                                     {0.0, 0u},
                                     {2001.0, 0u},
                                     {1e-9, 0u}}) {
    ASSERT_TRUE(writeImage(path, 8, 8, 3, pixels, mm_per_px));
    EXPECT_EQ(perMetre(), px_per_m) << mm_per_px;
    EXPECT_TRUE(readImage8(path)->pixels == pixels);
  }
}

// IEC 61966-2-1, in double precision.
double linearOf(uint8_t code) {
  const double v = code / 255.0;
  return v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
}

TEST(WriteImage, TiffRoundTripIsExactAndJpegIsClose) {
  for (int channels : {1, 2, 3, 4}) {
    auto pixels = noise<uint8_t>(static_cast<size_t>(31 * 17 * channels), 9);
    const std::string path = folder() / "w.tif";
    ASSERT_TRUE(writeImage(path, 31, 17, channels, pixels));
    auto image = readImage8(path);
    ASSERT_TRUE(image) << image.error().text();
    EXPECT_TRUE(image->channels == channels && image->pixels == pixels) << channels << " channels";
  }
  const Bytes grey(31 * 17 * 3, 100);
  ASSERT_TRUE(writeImage(folder() / "w.jpeg", 31, 17, 3, grey));
  auto jpeg = readImage8(folder() / "w.jpeg");
  ASSERT_TRUE(jpeg);
  for (const uint8_t v : jpeg->pixels) EXPECT_NEAR(v, 100, 1);
  auto refused = writeImage(folder() / "alpha.jpg", 31, 17, 4, Bytes(31 * 17 * 4));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kUsage);
  EXPECT_FALSE(fs::exists(folder() / "alpha.jpg"));
}

// Linear light, premultiplied, each value the nearest that a half has (2^-11 of it, or 2^-25).
TEST(WriteImage, ExrIsLinearLight) {
  for (int channels : {1, 3, 4}) {
    const int w = 256, h = 5;
    auto pixels = noise<uint8_t>(static_cast<size_t>(w * h * channels), 19);
    for (int x = 0; x < w; ++x)
      for (int c = 0; c < channels; ++c)
        pixels[static_cast<size_t>(x * channels + c)] = c == 3 ? 255 : static_cast<uint8_t>(x);  // every code, opaque
    const std::string path = folder() / "w.exr";
    ASSERT_TRUE(writeImage(path, w, h, channels, pixels));
    auto in = OIIO::ImageInput::open(path);
    ASSERT_TRUE(in);
    EXPECT_TRUE(in->spec().format == OIIO::TypeHalf);
    std::vector<float> back(pixels.size());
    ASSERT_TRUE(in->read_image(0, 0, 0, channels, OIIO::TypeFloat, back.data()));
    for (size_t i = 0; i < back.size(); ++i) {
      const size_t c = i % static_cast<size_t>(channels);
      const double alpha = channels == 4 ? pixels[i - c + 3] / 255.0 : 1;
      const double expected = c == 3 ? alpha : alpha * linearOf(pixels[i]);
      ASSERT_NEAR(back[i], expected, expected / 2048 + 1.0 / (1 << 25)) << i;
    }
  }
}

// As other programs read it: pixels a unit of length.
TEST(WriteImage, EveryFormatTellsItsScale) {
  const auto pixels = noise<uint8_t>(8 * 8 * 3, 9);
  for (const char* name : {"scale.tif", "scale.exr", "scale.jpg"}) {
    for (const double mm_per_px : {0.05, 0.0423333333, 0.29296875, 25.4 / 300, 0.0}) {
      const std::string path = folder() / name;
      ASSERT_TRUE(writeImage(path, 8, 8, 3, pixels, mm_per_px));
      auto in = OIIO::ImageInput::open(path);
      ASSERT_TRUE(in);
      const auto& spec = in->spec();
      const double mm = spec.get_string_attribute("ResolutionUnit", "in") == "cm" ? 10 : 25.4;
      const float x = spec.get_float_attribute("XResolution", 0), y = spec.get_float_attribute("YResolution", 0);
      if (mm_per_px == 0) {
        EXPECT_TRUE(std::string(name) == "scale.jpg" || x == 0) << name << " says a scale that nobody gave: " << x;
        continue;
      }
      ASSERT_GT(x, 0) << name;
      EXPECT_EQ(x, y) << name;
      // JFIF counts whole pixels an inch or a centimetre.
      EXPECT_NEAR(mm / x, mm_per_px, mm_per_px * (std::string(name) == "scale.jpg" ? 0.006 : 1e-5)) << name;
    }
  }
}

TEST(WriteImage, OtherNamesAreRefused) {
  for (const char* name : {"w.bmp", "w", "w.png.gif", "w.exr/x"}) {
    auto written = writeImage(folder() / name, 8, 8, 3, Bytes(192));
    ASSERT_FALSE(written) << name;
    EXPECT_EQ(written.error().kind, ErrorKind::kUsage) << name;
  }
  EXPECT_EQ(*imageFormatOf("-"), ImageFormat::kPng);
}

// Bytes that lie about what they keep.
class LyingBytes final : public ImageBytes {
 public:
  uint64_t keeps = ~uint64_t{0};     // what is beyond is lost without a word
  uint64_t fails_at = ~uint64_t{0};  // writing there is an error
  Bytes bytes;
  Result<void> write(uint64_t offset, std::span<const uint8_t> from) override {
    if (offset + from.size() > fails_at) return Error{ErrorKind::kIo, "the disk", "is full", "", {}};
    for (size_t i = 0; i < from.size() && offset + i < keeps; ++i) {
      if (bytes.size() <= offset + i) bytes.resize(offset + i + 1);
      bytes[offset + i] = from[i];
    }
    return {};
  }
  Result<void> read(uint64_t offset, std::span<uint8_t> out) override {
    for (size_t i = 0; i < out.size(); ++i) out[i] = bytes.at(offset + i);
    return {};
  }
  uint64_t size() const override { return bytes.size(); }
};

// What the library does not notice is found all the same: a disk that is full wherever it may be, bytes that are lost
// or others.
TEST(WriteImage, WhatIsNotOnTheDiskIsNotWritten) {
  const int w = 64, h = 48;
  const auto pixels = noise<uint8_t>(w * h * 6, 5);  // as many bytes as halves need
  for (const ImageFormat format : {ImageFormat::kPng, ImageFormat::kTiff, ImageFormat::kExr, ImageFormat::kJpeg}) {
    const auto encode = [&](LyingBytes& bytes, uint64_t flip) -> Result<void> {
      auto encoder = createEncoder(
          {"picture", format, w, h, 3, format == ImageFormat::kExr ? SampleType::kHalf : SampleType::kUint8, 0}, bytes);
      if (!encoder) return encoder.error();
      for (int y = 0; y < h; ++y)
        if (auto done = (*encoder)->appendRows(
                1, pixels.data() + static_cast<size_t>(y) * w * (format == ImageFormat::kExr ? 6 : 3));
            !done)
          return done;
      if (flip < bytes.bytes.size()) bytes.bytes[flip] ^= 0x10;
      return (*encoder)->finish();
    };
    LyingBytes whole;
    ASSERT_TRUE(encode(whole, ~uint64_t{0})) << "the control: " << encode(whole, ~uint64_t{0}).error().text();
    const uint64_t size = whole.bytes.size();
    for (uint64_t at = 0; at < size; at += 1 + size / 97) {
      LyingBytes full;
      full.fails_at = at;
      auto written = encode(full, ~uint64_t{0});
      ASSERT_FALSE(written) << static_cast<int>(format) << " full at " << at << " of " << size;
      EXPECT_EQ(written.error().text(), "the disk: is full");
    }
    LyingBytes last;
    last.fails_at = size - 1;
    EXPECT_FALSE(encode(last, ~uint64_t{0})) << static_cast<int>(format);
    for (const uint64_t kept : {uint64_t{0}, size / 4, size / 2, size - 1}) {
      LyingBytes lost;
      lost.keeps = kept;
      EXPECT_FALSE(encode(lost, ~uint64_t{0})) << static_cast<int>(format) << " lost from " << kept << " of " << size;
    }
    if (format == ImageFormat::kPng || format == ImageFormat::kTiff) {  // which write their samples as they come
      LyingBytes other;
      EXPECT_FALSE(encode(other, size / 3)) << static_cast<int>(format) << ": a sample is another";
    }
  }
}

template <class T>
void expectWriterRoundTrip(SampleType type, const char* name, int channels) {
  const int w = 61, h = 50;
  auto pixels = noise<T>(static_cast<size_t>(w * h * channels), 10);
  const std::string path = folder() / (std::string("writer_") + name);
  auto writer = ImageWriter::create(path, w, h, channels, type);
  ASSERT_TRUE(writer) << writer.error().text();
  for (int y = 0, rows = 1; y < h; y += rows, rows = 1 + rows * 5 % 13) {
    rows = std::min(rows, h - y);
    ASSERT_TRUE((*writer)->appendRows(rows, &pixels[static_cast<size_t>(y * w * channels)]));
  }
  EXPECT_FALSE(fs::exists(path)) << "must not appear before it is whole";
  ASSERT_TRUE((*writer)->commit());
  auto in = OIIO::ImageInput::open(path);
  ASSERT_TRUE(in);
  EXPECT_TRUE(in->spec().format == typeOf<T>());
  std::vector<T> back(pixels.size());
  ASSERT_TRUE(in->read_image(0, 0, 0, channels, typeOf<T>(), back.data()));
  EXPECT_TRUE(back == pixels) << name;
  in->close();
  fs::remove(path);
}

TEST(ImageWriter, RoundTripIsExact) {
  for (int channels : {1, 3}) {
    expectWriterRoundTrip<uint8_t>(SampleType::kUint8, "w.tif", channels);
    expectWriterRoundTrip<uint16_t>(SampleType::kUint16, "w.tiff", channels);
    expectWriterRoundTrip<float>(SampleType::kFloat, "w.TIF", channels);
    expectWriterRoundTrip<uint8_t>(SampleType::kUint8, "w.png", channels);
    expectWriterRoundTrip<uint16_t>(SampleType::kUint16, "w.png", channels);
  }
}

TEST(ImageWriter, JpegIsClose) {
  const int w = 64, h = 48;
  Bytes pixels(w * h * 3);
  for (int y = 0; y < h; ++y)
    for (int x = 0; x < w; ++x)
      for (int c = 0; c < 3; ++c)
        pixels[static_cast<size_t>((y * w + x) * 3 + c)] =
            static_cast<uint8_t>(128 + 90 * std::sin(0.1 * x + c) * std::cos(0.13 * y));
  const std::string path = folder() / "w.jpg";
  auto writer = ImageWriter::create(path, w, h, 3, SampleType::kUint8);
  ASSERT_TRUE(writer);
  ASSERT_TRUE((*writer)->appendRows(h, pixels.data()));
  ASSERT_TRUE((*writer)->commit());
  auto image = readImage8(path);
  ASSERT_TRUE(image);
  int worst = 0;
  for (size_t i = 0; i < pixels.size(); ++i) worst = std::max(worst, std::abs(image->pixels[i] - pixels[i]));
  EXPECT_LE(worst, 6);
  EXPECT_GT(worst, 0) << "control: it is a JPEG";
}

TEST(ImageWriter, LeavesNothingBehind) {
  const size_t before = static_cast<size_t>(std::distance(fs::directory_iterator(folder()), {}));
  const std::string path = folder() / "gone.tif";
  {
    auto writer = ImageWriter::create(path, 10, 10, 1, SampleType::kUint8);
    ASSERT_TRUE(writer);
    ASSERT_TRUE((*writer)->appendRows(5, Bytes(50).data()));
    EXPECT_EQ(static_cast<size_t>(std::distance(fs::directory_iterator(folder()), {})), before + 1)
        << "control: the part file";
  }
  EXPECT_EQ(static_cast<size_t>(std::distance(fs::directory_iterator(folder()), {})), before);
  EXPECT_EQ(ImageWriter::create(folder() / "no" / "such.tif", 10, 10, 1, SampleType::kUint8).error().kind,
            ErrorKind::kIo);
  EXPECT_EQ(ImageWriter::create(folder() / "x.bmp2", 10, 10, 1, SampleType::kUint8).error().kind, ErrorKind::kUsage);
  EXPECT_EQ(ImageWriter::create(folder() / "x.jpg", 10, 10, 1, SampleType::kFloat).error().kind, ErrorKind::kUsage);
}

// ---- damaged files

std::vector<std::string> smallFiles() {
  std::vector<uint16_t> smooth(24 * 20);
  for (size_t i = 0; i < smooth.size(); ++i) smooth[i] = static_cast<uint16_t>(i * 130);
  auto colour = noise<uint8_t>(24 * 20 * 3, 3);
  return {writeImage("s1.tif", 24, 20, 1, smooth, OIIO::TypeUInt16),
          writeImage("s2.tif", 24, 20, 1, smooth, OIIO::TypeUInt16, "zip"),
          writeImage("s3.tif", 24, 20, 1, smooth, OIIO::TypeUInt16, "lzw", 16),
          writeImage("s4.png", 24, 20, 1, smooth, OIIO::TypeUInt16),
          writeImage("s5.png", 24, 20, 3, colour, OIIO::TypeUInt8),
          writeImage("s6.jpg", 24, 20, 3, colour, OIIO::TypeUInt8, "jpeg:95"),
          writeImage("s7.jpg", 24, 20, 1, smooth, OIIO::TypeUInt8, "jpeg:95")};
}

// All pixels, or the error. One channel is read as heights, three as colours: neither is converted on the way.
Result<Bytes> readAll(const std::string& path) {
  if (auto height = openHeightImage(path, {{0, 1}})) {
    const int64_t w = (*height)->width(), h = (*height)->height();
    if (w * h > 1 << 22) return Bytes();
    std::vector<float> heights(static_cast<size_t>(w * h));
    if (auto read = (*height)->read({0, 0, w, h}, heights); !read) return read.error();
    Bytes out(heights.size() * sizeof(float));
    std::memcpy(out.data(), heights.data(), out.size());
    return out;
  } else if (height.error().kind != ErrorKind::kUnsupported) {
    return height.error();
  }
  auto source = openColourImage(path);
  if (!source) return source.error();
  if ((*source)->width() * (*source)->height() > 1 << 22) return Bytes();
  Bytes out(static_cast<size_t>(3 * (*source)->width() * (*source)->height()));
  if (auto read = (*source)->read({0, 0, (*source)->width(), (*source)->height()}, out); !read) return read.error();
  return out;
}

// The file opens once, for its header; for the library, which opens it again, the system has no descriptor left.
TEST(ImageDamage, AFileThatTheSystemDoesNotOpenAgainIsNotCalledDamaged) {
  for (const char* end : {"pgm", "png", "jpg", "tif", "exr", "tga", "bmp", "hdr"}) {
    const bool grey = std::string_view(end) == "pgm";
    const std::string path = writeImage<uint8_t>("again." + std::string(end), 8, 8, grey ? 1 : 3,
                                                 noise<uint8_t>(8 * 8 * 3, 5), OIIO::TypeDesc::UNKNOWN);
    ASSERT_TRUE(readImageFacts(path)) << end;  // control; and the format's reader is ready
    rlimit before{};
    ASSERT_EQ(::getrlimit(RLIMIT_NOFILE, &before), 0);
    const int next = ::dup(0);
    ASSERT_GE(next, 0);
    ::close(next);
    const rlimit one_more{static_cast<rlim_t>(next) + 1, before.rlim_max};
    ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &one_more), 0);
    auto facts = readImageFacts(path);
    ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &before), 0);
    ASSERT_FALSE(facts) << end;
    EXPECT_EQ(facts.error().kind, ErrorKind::kIo) << facts.error().text();
  }
}

// OpenImageIO 2.4's PNG reader leaks a string where the file ends (tests/lsan.supp). Clang's leak checker does not see
// whose it is: the library has no frame pointers.
#ifdef RELIEVO_ADDRESS_SANITIZER
class LeakOfTruncatedPngs {
 public:
  explicit LeakOfTruncatedPngs(const std::string& path) : png_(fs::path(path).extension() == ".png") {
    if (png_) __lsan_disable();
  }
  ~LeakOfTruncatedPngs() {
    if (png_) __lsan_enable();
  }

 private:
  bool png_;
};
#else
struct LeakOfTruncatedPngs {
  explicit LeakOfTruncatedPngs(const std::string&) {}
  ~LeakOfTruncatedPngs() {}
};
#endif

TEST(ImageDamage, EveryTruncatedLengthIsAnErrorOrLosesNothing) {
  for (const auto& whole_path : smallFiles()) {
    const LeakOfTruncatedPngs allowed(whole_path);
    const Bytes file = load(whole_path);
    auto whole = readAll(whole_path);
    ASSERT_TRUE(whole) << whole.error().text();
    auto path = save("cut" + fs::path(whole_path).extension().string(), file);
    size_t still_whole = 0;
    for (size_t length = file.size(); length-- > 0;) {
      ASSERT_EQ(0, ::truncate(path.c_str(), static_cast<off_t>(length)));
      auto cut = readAll(path);
      if (cut) {
        ASSERT_TRUE(*cut == *whole) << whole_path << " cut to " << length << " of " << file.size()
                                    << " reads as something else";
        ++still_whole;
      } else {
        EXPECT_EQ(cut.error().file, path);
        EXPECT_FALSE(cut.error().message.empty());
        EXPECT_EQ(cut.error().kind, ErrorKind::kInvalidData);
      }
      if (length % 32 == 0) (void)!!readImage8(path);
    }
    EXPECT_LT(still_whole, 30u) << whole_path << ": only trailing bytes that no pixel needs may be missing";
  }
}

// OpenEXR allocates what an attribute claims before it reads: 271 bytes took 1.8 GB. The claim is compared with the
// file's length first.
TEST(ImageDamage, AnExrAttributeLargerThanTheFileIsRefusedBeforeItIsAllocated) {
  const Bytes sound = load(writeImage("sound.exr", 6, 5, 1, noise<float>(30, 9), OIIO::TypeDesc::FLOAT, "zip"));
  EXPECT_TRUE(openHeightImage(save("same.exr", sound), {}));
  // Every attribute, one by one: name, type, size, as the library wrote them.
  size_t at = 8, attributes = 0;
  while (sound[at] != 0) {
    const std::string name = reinterpret_cast<const char*>(&sound[at]);
    size_t size_at = at + name.size() + 1;
    const std::string type = reinterpret_cast<const char*>(&sound[size_at]);
    size_at += type.size() + 1;
    const uint32_t size = sound[size_at] | sound[size_at + 1] << 8;
    std::vector<uint32_t> claims{0x70000000u, 0xFFFFFFFFu, static_cast<uint32_t>(sound.size() - size_at - 3)};
    // Where the type says how long a value is, the library does not look at its size: behind another one it would see
    // other attributes than we, and believe what they claim.
    if (type != "string") claims.insert(claims.end(), {size - 1, size + 1});
    for (const uint32_t claimed : claims) {
      Bytes bytes = sound;
      std::memcpy(&bytes[size_at], &claimed, sizeof claimed);
      const auto image = openHeightImage(save("claims.exr", bytes), {});
      ASSERT_FALSE(image) << name;
      EXPECT_EQ(image.error().kind, ErrorKind::kInvalidData);
      EXPECT_NE(image.error().message.find("\"" + name + "\""), std::string::npos) << image.error().text();
      EXPECT_EQ(image.error().offset, size_at);
    }
    at = size_at + 4 + size;
    ++attributes;
  }
  EXPECT_GE(attributes, 8u) << "channels, compression, windows, ...";
}

// OpenImageIO reads the names of these segments, and the IPTC metadata within, without looking where they end: they are
// kept from it. Under AddressSanitizer any that is not ends this test.
TEST(ImageDamage, AJpegIsReadWithoutTheMetadataThatEndsTooSoon) {
  using namespace std::string_literals;
  constexpr int kWidth = 16, kHeight = 4000;  // several bands
  const std::string sound_path =
      writeImage("sound.jpg", kWidth, kHeight, 3, noise<uint8_t>(3 * kWidth * kHeight, 9), OIIO::TypeUInt8);
  const Bytes sound = load(sound_path);
  auto pixels = [](const std::string& path) {
    std::vector<uint8_t> out(3 * kWidth * kHeight);
    const ImageReadOptions small{.cache_bytes = 1 << 14};
    auto image = openColourImage(path, small);
    EXPECT_TRUE(image) << image.error().text();
    if (!image) return out;
    // From below: the file is opened anew for each band that the cache has dropped.
    for (int y = kHeight - 100; y >= 0; y -= 100) {
      const auto read =
          (*image)->read({0, y, kWidth, 100}, std::span(out).subspan(static_cast<size_t>(y) * kWidth * 3));
      EXPECT_TRUE(read) << read.error().text();
    }
    return out;
  };
  auto with = [&](uint8_t marker, const std::string& data, const std::string& before = "", int times = 1) {
    Bytes bytes(sound.begin(), sound.begin() + 2);
    const size_t size = data.size() + 2;
    for (int k = 0; k < times; ++k) {
      bytes.insert(bytes.end(), before.begin(), before.end());
      for (const size_t b : {size_t{0xff}, size_t{marker}, size >> 8, size & 255})
        bytes.push_back(static_cast<uint8_t>(b));
      bytes.insert(bytes.end(), data.begin(), data.end());
    }
    bytes.insert(bytes.end(), sound.begin() + 2, sound.end());
    return save("metadata.jpg", bytes);
  };
  const std::vector<uint8_t> expected = pixels(sound_path);
  const std::string xmp = "http://ns.adobe.com/xap/1.0/\0"s, iptc = "Photoshop 3.0\0"s + "8BIM\4\4\0\0\0\0"s;
  const std::string tiff = "II*\0\10\0\0\0"s + "\0\0\0\0\0\0"s;
  for (const auto& [marker, data] : {std::pair{0xe1, "Exif\0\0"s + tiff},
                                     {0xe1, xmp + "<x:xmpmeta/>"},
                                     {0xed, iptc + "\0\5\x1c\2\x50\0\0"s},
                                     {0xe2, "FPXR\0\0"s},
                                     {0xe3, ""s}}) {
    const std::string path = with(static_cast<uint8_t>(marker), data);
    EXPECT_TRUE(openColourImage(path, {})) << marker;
  }
  for (const std::string& before : {""s, "garbage\xff\0\xff"s}) {
    for (const auto& [marker, data] : {std::pair{0xe1, ""s},
                                       {0xe1, "Ex"s},
                                       {0xe1, "Exif\0"s},
                                       {0xe1, "Exif\0\0II*"s},
                                       {0xe1, xmp.substr(0, 28)},
                                       {0xed, ""s},
                                       {0xe2, ""s},
                                       {0xe2, "ICC_PROFILE\0\1"s},
                                       {0xed, "Photoshop 3"s},
                                       {0xed, iptc.substr(0, 17)},
                                       {0xed, iptc},
                                       {0xed, "Photoshop 3.0\0"s + "8BIM\4\4\7caption\0\0\0\5\x1c\2\x50\0\0"s},
                                       {0xed, iptc + "\0\6\x1c\2\x50\0\0"s}}) {
      const std::string path = with(static_cast<uint8_t>(marker), data, before);
      // libjpeg complains of the bytes between, and OpenImageIO then of the rows.
      if (!before.empty()) {
        EXPECT_TRUE(openColourImage(path, {}));
      } else {
        EXPECT_EQ(pixels(path), expected) << marker << " of " << data.size() << " bytes";
      }
    }
  }
  EXPECT_EQ(pixels(with(0xed, iptc, "", 1024)), expected);
  // Metadata that is whole is read beside it: this one turns the picture by half a turn.
  const std::string turned = "II*\0\10\0\0\0\1\0\22\1\3\0\1\0\0\0\3\0\0\0\0\0\0\0"s;
  const std::string exif = "\xff\xe1\0"s + static_cast<char>(8 + turned.size()) + "Exif\0\0"s + turned;
  std::vector<uint8_t> backwards;
  for (int y = kHeight - 100; y >= 0; y -= 100) {
    for (int c = 0; c < 3; ++c) {
      const auto plane = expected.begin() + (static_cast<ptrdiff_t>(y) * 3 + c * 100) * kWidth;
      backwards.insert(backwards.end(), std::make_reverse_iterator(plane + 100 * kWidth),
                       std::make_reverse_iterator(plane));
    }
  }
  EXPECT_EQ(pixels(with(0xed, iptc, exif)), backwards);
  const auto too_many = openColourImage(with(0xed, iptc, "", 1025), {});
  ASSERT_FALSE(too_many);
  EXPECT_EQ(too_many.error().kind, ErrorKind::kInvalidData);
}

// An interlaced PNG is decoded as a whole. What no file of its length can hold is damage, not a matter of memory.
TEST(ImageDamage, AnInterlacedPngOfMorePixelsThanItsBytesCanHoldIsDamaged) {
  Bytes bytes{0x89, 'P',  'N', 'G', '\r', '\n', 0x1a, '\n', 0, 0, 0, 13, 'I', 'H', 'D',
              'R',  0x7f, 0,   0,   0,    0x7f, 0,    0,    0, 8, 2, 0,  0,   1};
  bytes.resize(80);
  const auto image = openColourImage(save("claims.png", bytes), {});
  ASSERT_FALSE(image);
  EXPECT_EQ(image.error().kind, ErrorKind::kInvalidData) << image.error().text();
}

TEST(ImageDamage, MutatedFilesNeverCrash) {
  const uint32_t seed = 20260102;
  const int kFiles = 400;
  std::cout << "seed " << seed << ", " << kFiles << " files each\n";
  for (const auto& whole_path : smallFiles()) {
    const LeakOfTruncatedPngs allowed(whole_path);
    const Bytes file = load(whole_path);
    std::mt19937 random(seed);
    int opened = 0;
    for (int i = 0; i < kFiles; ++i) {
      Bytes mutated = file;
      for (int n = 1 + static_cast<int>(random() % 4); n > 0; --n)
        mutated[random() % mutated.size()] = static_cast<uint8_t>(random());
      if (random() % 8 == 0) mutated.resize(random() % mutated.size() + 1);
      auto path = save("m" + fs::path(whole_path).extension().string(), mutated);
      auto all = readAll(path);
      if (all) ++opened;
      else EXPECT_EQ(all.error().file, path);
      if (i % 16 == 0) (void)!!openColourImage(path);
    }
    std::cout << fs::path(whole_path).filename() << ": " << opened << " still open\n";
  }
}

}  // namespace image_io_test
}  // namespace relievo
