// .ptm files: what is written is what is read, in every layout; whatever else is in a file costs one clear Error.
#include "texturing/import/ptm.h"
#include "tests/shared_data.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <new>
#include <random>
#include <thread>

#include "src/base/file.h"
#include "texturing/import/image_io.h"

// The largest single allocation since it was last set to 0. (g++ 12 sees one half of the pair inlined and warns.)
#pragma GCC diagnostic ignored "-Wmismatched-new-delete"
static std::atomic<size_t> largest_allocation{0};
void* operator new(size_t bytes) {
  size_t seen = largest_allocation.load();
  while (bytes > seen && !largest_allocation.compare_exchange_weak(seen, bytes)) {
  }
  if (void* p = std::malloc(bytes)) return p;
  throw std::bad_alloc();
}
void operator delete(void* p) noexcept { std::free(p); }
void operator delete(void* p, size_t) noexcept { std::free(p); }

namespace relievo {
namespace ptm_test {

namespace fs = std::filesystem;
using Bytes = std::vector<uint8_t>;

fs::path folder() {
  static const fs::path path = [] {
    auto p = fs::temp_directory_path() / ("relievo_ptm_test_" + std::to_string(::getpid()));
    fs::create_directories(p);
    return p;
  }();
  return path;
}
struct RemoveFolder : testing::Environment {
  void TearDown() override { fs::remove_all(folder()); }
};
[[maybe_unused]] auto* const kRemoveFolder = testing::AddGlobalTestEnvironment(new RemoveFolder);

std::string save(const std::string& name, const Bytes& bytes) {
  const std::string path = folder() / name;
  fs::remove(path);  // file systems flush a file that is rewritten in place, which takes its time
  std::ofstream(path, std::ios::binary | std::ios::trunc)
      .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  return path;
}
Bytes load(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return Bytes(std::istreambuf_iterator<char>(in), {});
}

// A raster of channels, top row first, and what surrounds it in a file.
struct Artwork {
  int64_t width = 0, height = 0;
  TextureFormat format;
  Bytes raw;  // channel-major
  uint8_t at(int c, int64_t x, int64_t y) const { return raw[static_cast<size_t>((c * height + y) * width + x)]; }
};

Artwork randomArtwork(Basis basis, int64_t width, int64_t height, uint32_t seed) {
  Artwork a{width, height, {}, {}};
  a.format.basis = basis;
  a.format.scale = {2, 1.5, 0.0625, 2, 1, 1.25};
  a.format.bias = {160, 161, 128, 127, 3, 0};
  a.raw.resize(static_cast<size_t>(a.format.channels() * width * height));
  std::mt19937 random(seed);
  for (auto& byte : a.raw) byte = static_cast<uint8_t>(random());
  return a;
}

void append(Bytes& out, const std::string& text) { out.insert(out.end(), text.begin(), text.end()); }

struct Layout {
  const char* size_separator = "\n";
  const char* line_end = "\n";
  const char* trailing = "";
};

Bytes header(const Artwork& a, const char* version, const char* format, const Layout& l = {}) {
  Bytes out;
  const std::string end = std::string(l.trailing) + l.line_end;
  append(out,
         version + end + format + end + std::to_string(a.width) + l.size_separator + std::to_string(a.height) + end);
  for (int k = 0; k < 6; ++k) append(out, (k ? " " : "") + std::to_string(a.format.scale[k]));
  append(out, end);
  for (int k = 0; k < 6; ++k) append(out, (k ? " " : "") + std::to_string(static_cast<int>(a.format.bias[k])));
  append(out, end);
  return out;
}

// Straight from the format's description.
Bytes fileLrgb12(const Artwork& a, const Layout& l = {}) {
  Bytes out = header(a, "PTM_1.2", "PTM_FORMAT_LRGB", l);
  for (int64_t y = a.height - 1; y >= 0; --y)
    for (int64_t x = 0; x < a.width; ++x)
      for (int c = 0; c < 6; ++c) out.push_back(a.at(c, x, y));
  for (int64_t y = a.height - 1; y >= 0; --y)
    for (int64_t x = 0; x < a.width; ++x)
      for (int c = 6; c < 9; ++c) out.push_back(a.at(c, x, y));
  return out;
}
Bytes fileLrgb11(const Artwork& a, const Layout& l = {}) {
  Bytes out = header(a, "PTM_1.1", "PTM_FORMAT_LRGB", l);
  for (int64_t y = a.height - 1; y >= 0; --y)
    for (int64_t x = 0; x < a.width; ++x)
      for (int c = 0; c < 9; ++c) out.push_back(a.at(c, x, y));
  return out;
}
Bytes fileRgb(const Artwork& a, const Layout& l = {}) {
  Bytes out = header(a, "PTM_1.2", "PTM_FORMAT_RGB", l);
  for (int c = 0; c < 3; ++c)
    for (int64_t y = a.height - 1; y >= 0; --y)
      for (int64_t x = 0; x < a.width; ++x)
        for (int k = 0; k < 6; ++k) out.push_back(a.at(3 * k + c, x, y));
  return out;
}
// Channels 0-5 of the artwork, then 6 as Cr and 7 as Cb.
Bytes fileLum(const Artwork& a, const std::array<double, 16>& matrix) {
  Bytes out = header(a, "PTM_1.2", "PTM_FORMAT_LUM");
  for (int i = 0; i < 16; ++i) append(out, (i ? " " : "") + std::to_string(matrix[i]));
  append(out, "\n");
  for (int64_t y = a.height - 1; y >= 0; --y)
    for (int64_t x = 0; x < a.width; ++x)
      for (int c = 0; c < 8; ++c) out.push_back(a.at(c, x, y));
  return out;
}
constexpr std::array<double, 16> kJpegMatrix{1.402, 1, 0, 0, -0.71414, 1, -0.34414, 0, 0, 1, 1.772, 0, 0, 0, 0, 1};

struct JpegPlaneSpec {
  int transform = 0, motion_x = 0, motion_y = 0, order = 0, reference = -1;
  Bytes jpeg, side;
};
Bytes fileJpeg(const Artwork& a, const char* format, const std::vector<JpegPlaneSpec>& planes) {
  Bytes out = header(a, "PTM_1.2", format);
  auto line = [&](auto member) {
    for (size_t i = 0; i < planes.size(); ++i) append(out, (i ? " " : "") + std::to_string(member(planes[i])));
    append(out, "\n");
  };
  append(out, "95\n");
  line([](auto& p) { return p.transform; });
  line([](auto& p) { return p.motion_x; });
  line([](auto& p) { return p.motion_y; });
  line([](auto& p) { return p.order; });
  line([](auto& p) { return p.reference; });
  line([](auto& p) { return p.jpeg.size(); });
  line([](auto& p) { return p.side.size(); });
  for (auto& p : planes) {
    out.insert(out.end(), p.jpeg.begin(), p.jpeg.end());
    out.insert(out.end(), p.side.begin(), p.side.end());
  }
  return out;
}
// A grey JPEG of smooth content, and what another decoder makes of it.
struct GreyJpeg {
  Bytes bytes, decoded;
};
GreyJpeg greyJpeg(int width, int height, int seed) {
  Bytes pixels(static_cast<size_t>(width * height));
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      pixels[static_cast<size_t>(y * width + x)] =
          static_cast<uint8_t>(128 + 60 * std::sin(0.3 * x + seed) + 50 * std::cos(0.2 * y - 0.1 * x + 2 * seed));
    }
  const std::string path = folder() / "plane.jpg";
  auto writer = ImageWriter::create(path, width, height, 1, SampleType::kUint8);
  EXPECT_TRUE(writer) << writer.error().text();
  EXPECT_TRUE((*writer)->appendRows(height, pixels.data()));
  EXPECT_TRUE((*writer)->commit());
  auto image = readImage8(path);
  EXPECT_TRUE(image && image->channels == 1);
  return {load(path), image->pixels};
}

Result<std::unique_ptr<TextureSource>> open(const std::string& path) { return openPtm(path); }

void expectReads(const std::string& path, const Artwork& a, uint32_t seed, int rectangles = 30) {
  auto source = open(path);
  ASSERT_TRUE(source) << source.error().text();
  ASSERT_EQ((*source)->width(), a.width);
  ASSERT_EQ((*source)->height(), a.height);
  ASSERT_EQ((*source)->format().basis, a.format.basis);
  EXPECT_EQ((*source)->format().scale, a.format.scale);
  EXPECT_EQ((*source)->format().bias, a.format.bias);
  const int channels = a.format.channels();
  std::mt19937 random(seed);
  for (int i = 0; i < rectangles; ++i) {
    Rect r{0, 0, a.width, a.height};
    if (i > 0) {
      r.x = static_cast<int64_t>(random() % a.width), r.y = static_cast<int64_t>(random() % a.height);
      r.width = 1 + static_cast<int64_t>(random() % (a.width - r.x)),
      r.height = 1 + static_cast<int64_t>(random() % (a.height - r.y));
      if (i % 3 == 0) r.x = 0, r.width = a.width;
    }
    Bytes out(static_cast<size_t>(channels * r.width * r.height)), expected(out.size());
    ASSERT_TRUE((*source)->read(r, out));
    size_t n = 0;
    for (int c = 0; c < channels; ++c)
      for (int64_t y = r.y; y < r.y + r.height; ++y)
        for (int64_t x = r.x; x < r.x + r.width; ++x) expected[n++] = a.at(c, x, y);
    ASSERT_TRUE(out == expected) << path << " rectangle " << r.x << " " << r.y << " " << r.width << " " << r.height;
  }
}

TEST(Ptm, ReadsEveryUncompressedLayout) {
  const Layout layouts[] = {{}, {" "}, {"\n", "\n", " "}, {" ", "\r\n"}, {"\r\n", "\r\n", "  "}};
  int i = 0;
  // Widths around the sixteen pixels that are taken apart at a time.
  for (int64_t width : {1, 15, 16, 17, 37, 130}) {
    for (const Layout& l : layouts) {
      const uint32_t seed = 100 + i++;
      SCOPED_TRACE("seed " + std::to_string(seed));
      Artwork lrgb = randomArtwork(Basis::kPtmLrgb, width, 23, seed),
              rgb = randomArtwork(Basis::kPtmRgb, width, 23, seed);
      expectReads(save("a.ptm", fileLrgb12(lrgb, l)), lrgb, seed);
      expectReads(save("b.ptm", fileLrgb11(lrgb, l)), lrgb, seed);
      expectReads(save("c.ptm", fileRgb(rgb, l)), rgb, seed);
    }
  }
}

TEST(Ptm, ReadsNarrowRectanglesOfWideImages) {
  // Rows far enough apart to be read one by one, and near enough to be read together.
  for (int64_t width : {700, 3001}) {
    Artwork a = randomArtwork(Basis::kPtmLrgb, width, 70, 7);
    expectReads(save("wide.ptm", fileLrgb12(a)), a, 8, 60);
    expectReads(save("wide11.ptm", fileLrgb11(a)), a, 8, 60);
  }
}

// Negative control of the comparisons above: rows the wrong way up, or two channels swapped, are noticed.
TEST(Ptm, TheComparisonNoticesFlippedRowsAndSwappedChannels) {
  Artwork a = randomArtwork(Basis::kPtmLrgb, 20, 10, 1);
  auto source = open(save("a.ptm", fileLrgb12(a)));
  ASSERT_TRUE(source);
  Bytes out(a.raw.size());
  ASSERT_TRUE((*source)->read({0, 0, 20, 10}, out));
  ASSERT_TRUE(out == a.raw);
  Artwork flipped = a, swapped = a;
  for (int c = 0; c < 9; ++c)
    for (int y = 0; y < 10; ++y) std::memcpy(&flipped.raw[(c * 10 + y) * 20], &a.raw[(c * 10 + 9 - y) * 20], 20);
  std::swap_ranges(swapped.raw.begin(), swapped.raw.begin() + 200, swapped.raw.begin() + 200);
  EXPECT_FALSE(out == flipped.raw);
  EXPECT_FALSE(out == swapped.raw);
}

TEST(Ptm, HeaderIsReadAlone) {
  Artwork a = randomArtwork(Basis::kPtmLrgb, 12, 5, 3);
  Bytes file = fileLrgb11(a);
  auto h = readPtmHeader(save("h.ptm", file));
  ASSERT_TRUE(h);
  EXPECT_EQ(h->format, PtmFormat::kLrgb);
  EXPECT_EQ(h->version_minor, 1);
  EXPECT_EQ(h->width, 12);
  EXPECT_EQ(h->height, 5);
  EXPECT_EQ(h->data_offset, file.size() - 12 * 5 * 9);
}

TEST(Ptm, LumBecomesRgbWithinHalfAStep) {
  Artwork a = randomArtwork(Basis::kPtmLrgb, 40, 30, 11);
  auto source = open(save("lum.ptm", fileLum(a, kJpegMatrix)));
  ASSERT_TRUE(source) << source.error().text();
  const TextureFormat f = (*source)->format();
  ASSERT_EQ(f.basis, Basis::kPtmRgb);
  EXPECT_EQ(f.bias[5], std::round(f.bias[5])) << "a .ptm file can only hold whole biases";
  Bytes out(18 * 40 * 30);
  ASSERT_TRUE((*source)->read({0, 0, 40, 30}, out));
  double worst = 0;
  for (int64_t y = 0; y < 30; ++y)
    for (int64_t x = 0; x < 40; ++x)
      for (int c = 0; c < 3; ++c) {
        double expected = (a.at(5, x, y) - a.format.bias[5]) * a.format.scale[5] +
                          kJpegMatrix[4 * c] * (a.at(6, x, y) - 128.0) +
                          kJpegMatrix[4 * c + 2] * (a.at(7, x, y) - 128.0);
        double found = (out[((15 + c) * 30 + y) * 40 + x] - f.bias[5]) * f.scale[5];
        worst = std::max(worst, std::abs(expected - found));
        for (int k = 0; k < 5; ++k) ASSERT_EQ(out[((3 * k + c) * 30 + y) * 40 + x], a.at(k, x, y));
      }
  EXPECT_LE(worst, f.scale[5] / 2 * 1.0001);
  EXPECT_GT(worst, f.scale[5] / 8) << "control: the bound is not met by accident";
}

TEST(Ptm, GreyLumIsExact) {
  Artwork a = randomArtwork(Basis::kPtmLrgb, 9, 8, 12);
  auto source = open(save("lum.ptm", fileLum(a, {0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1})));
  ASSERT_TRUE(source);
  EXPECT_EQ((*source)->format().scale, a.format.scale);
  Bytes out(18 * 72);
  ASSERT_TRUE((*source)->read({0, 0, 9, 8}, out));
  for (int k = 0; k < 6; ++k)
    for (int c = 0; c < 3; ++c) EXPECT_EQ(0, std::memcmp(&out[(3 * k + c) * 72], &a.raw[k * 72], 72));
}

TEST(Ptm, LumWithUnequalLuminanceIsRefused) {
  Artwork a = randomArtwork(Basis::kPtmLrgb, 9, 8, 12);
  for (const size_t colour : {1u, 5u, 9u}) {
    auto matrix = kJpegMatrix;
    matrix[colour] = 0.9;
    auto source = open(save("lum.ptm", fileLum(a, matrix)));
    ASSERT_FALSE(source) << "entry " << colour;
    EXPECT_EQ(source.error().kind, ErrorKind::kUnsupported);
  }
}

// Planes with references of both kinds, motion and side information; the expectation is computed here from what another
// decoder makes of the JPEGs.
std::vector<JpegPlaneSpec> jpegPlanes(int width, int height, int count, std::vector<Bytes>& expected) {
  std::vector<JpegPlaneSpec> planes(static_cast<size_t>(count));
  expected.assign(static_cast<size_t>(count), {});
  for (int i = 0; i < count; ++i) {
    auto jpeg = greyJpeg(width, height, i);
    planes[i].jpeg = jpeg.bytes;
    expected[i] = jpeg.decoded;
    planes[i].order = count - 1 - i;  // the last plane first
  }
  planes[3].reference = 5, planes[3].transform = 0;
  planes[2].reference = 3, planes[2].transform = 1;  // a chain: 5, 3, 2
  planes[1].reference = 7, planes[1].transform = 2, planes[1].motion_x = 3, planes[1].motion_y = -2;
  planes[0].reference = 1, planes[0].transform = 3, planes[0].motion_x = -5, planes[0].motion_y = 40;
  for (int i = count - 1; i >= 0; --i) {
    const auto& p = planes[i];
    if (p.reference >= 0) {
      for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
          int fx = p.transform & 2 ? std::clamp(x + p.motion_x, 0, width - 1) : x;
          int fy = p.transform & 2 ? std::clamp(y + p.motion_y, 0, height - 1) : y;
          int r = expected[p.reference][fy * width + fx];
          if (p.transform & 1) r = 255 - r;
          auto& sample = expected[i][y * width + x];
          sample = static_cast<uint8_t>(((sample + r - 128) % 256 + 256) % 256);
        }
    }
    if (i == 5 || i == 2) {
      for (int at : {0, width * 2 + 1, width * height - 1}) {
        for (int shift : {24, 16, 8, 0}) planes[i].side.push_back(static_cast<uint8_t>(at >> shift));
        planes[i].side.push_back(static_cast<uint8_t>(at * 7 + i));
        expected[i][at] = static_cast<uint8_t>(at * 7 + i);
      }
    }
  }
  return planes;
}

TEST(Ptm, ReadsJpegVariants) {
  const int width = 45, height = 31;
  for (bool lrgb : {true, false}) {
    std::vector<Bytes> expected;
    auto planes = jpegPlanes(width, height, lrgb ? 9 : 18, expected);
    Artwork a = randomArtwork(lrgb ? Basis::kPtmLrgb : Basis::kPtmRgb, width, height, 1);
    for (int c = 0; c < a.format.channels(); ++c) {
      const Bytes& plane = expected[lrgb ? c : c % 3 * 6 + c / 3];  // RGB: the file has all of red first
      for (int y = 0; y < height; ++y)
        std::memcpy(&a.raw[(c * height + y) * width], &plane[(height - 1 - y) * width], width);
    }
    Bytes file = fileJpeg(a, lrgb ? "PTM_FORMAT_JPEG_LRGB" : "PTM_FORMAT_JPEG_RGB", planes);
    expectReads(save("jpeg.ptm", file), a, 5);

    // Negative control: forgetting one inversion shows.
    auto wrong = planes;
    wrong[2].transform = 0;
    auto source = open(save("jpeg.ptm", fileJpeg(a, lrgb ? "PTM_FORMAT_JPEG_LRGB" : "PTM_FORMAT_JPEG_RGB", wrong)));
    ASSERT_TRUE(source);
    Bytes out(a.raw.size());
    ASSERT_TRUE((*source)->read({0, 0, width, height}, out));
    EXPECT_FALSE(out == a.raw);
  }
}

TEST(Ptm, JpegVariantsKeepToTheMemoryBudget) {
  std::vector<Bytes> expected;
  Artwork a = randomArtwork(Basis::kPtmLrgb, 45, 31, 1);
  auto path = save("jpeg.ptm", fileJpeg(a, "PTM_FORMAT_JPEG_LRGB", jpegPlanes(45, 31, 9, expected)));
  auto source = openPtm(path, {.memory_budget_bytes = 9 * 45 * 31 - 1});
  ASSERT_FALSE(source);
  EXPECT_EQ(source.error().kind, ErrorKind::kUnsupported);
  EXPECT_TRUE(openPtm(path, {.memory_budget_bytes = 9 * 45 * 31}));
}

TEST(Ptm, RealFileWithInvertedPlanesIsSmooth) {
  const fs::path path = sharedData("tablet1.ptm");
  if (path.empty()) GTEST_SKIP() << "no ../shared/data/tablet1.ptm beside the checkout";
  auto source = open(path);
  ASSERT_TRUE(source) << source.error().text();
  Bytes raw(9 * 512 * 512);
  ASSERT_TRUE((*source)->read({0, 0, 512, 512}, raw));
  // Mean difference of horizontal neighbours: 1 to 7 for the planes as they are; a prediction undone wrongly leaves the
  // residual's noise or doubles the picture.
  for (int c = 0; c < 9; ++c) {
    double sum = 0;
    for (int y = 0; y < 512; ++y)
      for (int x = 1; x < 512; ++x) sum += std::abs(raw[(c * 512 + y) * 512 + x] - raw[(c * 512 + y) * 512 + x - 1]);
    EXPECT_LT(sum / (512 * 511), 8) << "plane " << c;
  }
  // The cloth around the tablet is black in all colours, and the tablet is not.
  for (int c = 6; c < 9; ++c) {
    EXPECT_LT(raw[(c * 512 + 10) * 512 + 10], 60);
    EXPECT_GT(raw[(c * 512 + 256) * 512 + 256], 90);
  }
}

TEST(Ptm, ProvenanceNamesTheFileAndItsDigest) {
  Artwork a = randomArtwork(Basis::kPtmLrgb, 10, 10, 2);
  auto path = save("named.ptm", fileLrgb12(a));
  auto source = open(path);
  ASSERT_TRUE(source);
  EXPECT_EQ((*source)->provenance().name, "named.ptm");
  EXPECT_EQ((*source)->provenance().xxh3, *hashFile(path));
  EXPECT_EQ((*openPtm(path, {.hash = false}))->provenance().xxh3, "");
}

TEST(Ptm, ManyThreadsReadTheSame) {
  Artwork a = randomArtwork(Basis::kPtmRgb, 300, 200, 21);
  auto path = save("threads.ptm", fileRgb(a));
  std::vector<std::thread> threads;
  for (uint32_t t = 0; t < 4; ++t) threads.emplace_back([&, t] { expectReads(path, a, t, 20); });
  for (auto& t : threads) t.join();
}

// ---- writing

class RasterOf : public TextureSource {
 public:
  explicit RasterOf(Artwork artwork) : a(std::move(artwork)) {}
  int64_t width() const override { return a.width; }
  int64_t height() const override { return a.height; }
  TextureFormat format() const override { return a.format; }
  Provenance provenance() const override { return {"test", "", "test"}; }
  Result<void> read(const Rect& r, std::span<uint8_t> out) const override {
    if (fail_below >= 0 && r.y < fail_below) return Error{ErrorKind::kRuntime, "source", "broken on purpose", "", {}};
    largest_rows = std::max<int64_t>(largest_rows, r.height);
    size_t n = 0;
    for (int c = 0; c < a.format.channels(); ++c)
      for (int64_t y = r.y; y < r.y + r.height; ++y, n += static_cast<size_t>(r.width)) {
        std::memcpy(&out[n], &a.raw[static_cast<size_t>((c * a.height + y) * a.width + r.x)],
                    static_cast<size_t>(r.width));
      }
    return {};
  }
  Artwork a;
  int64_t fail_below = -1;
  mutable std::atomic<int64_t> largest_rows{0};
};

size_t filesInFolder() { return static_cast<size_t>(std::distance(fs::directory_iterator(folder()), {})); }

TEST(PtmWriter, RoundTripIsExact) {
  std::mt19937 random(77);
  for (Basis basis : {Basis::kPtmLrgb, Basis::kPtmRgb}) {
    // The second takes several bands.
    for (auto [w, h] : {std::pair<int64_t, int64_t>{33, 7}, {2500, 900}, {1, 1}}) {
      Artwork a = randomArtwork(basis, w, h, 31);
      for (double& s : std::span(a.format.scale).first<6>())
        s = static_cast<float>(std::exp(std::uniform_real_distribution<>(-7, 7)(random)));
      a.format.scale[2] = 0.1;  // a double that is no float
      RasterOf source(a);
      const std::string path = folder() / "written.ptm";
      auto written = writePtm(path, source);
      ASSERT_TRUE(written) << written.error().text();
      if (h == 900) {
        EXPECT_LT(source.largest_rows, 900) << "control: it was written in bands";
      }
      expectReads(path, a, 5, 4);
      // And by the description of the format, not only by our own reader.
      Bytes file = load(path), described = basis == Basis::kPtmLrgb ? fileLrgb12(a) : fileRgb(a);
      const size_t data = static_cast<size_t>(a.format.channels() * w * h);
      ASSERT_GT(file.size(), data);
      EXPECT_EQ(0, std::memcmp(file.data() + file.size() - data, described.data() + described.size() - data, data));
    }
  }
}

TEST(PtmWriter, FailureAndInterruptionLeaveWhatWasThere) {
  Artwork a = randomArtwork(Basis::kPtmLrgb, 2500, 900, 31);
  const Bytes before{'o', 'l', 'd'};
  const std::string path = save("kept.ptm", before);
  const size_t files = filesInFolder();
  RasterOf source(a);
  source.fail_below = 100;  // the last bands
  auto failed = writePtm(path, source);
  ASSERT_FALSE(failed);
  EXPECT_EQ(failed.error().message, "broken on purpose");
  std::atomic<bool> interrupted{true};
  auto stopped = writePtm(path, RasterOf(a), &interrupted);
  ASSERT_FALSE(stopped);
  EXPECT_EQ(stopped.error().kind, ErrorKind::kInterrupted);
  EXPECT_EQ(load(path), before);
  EXPECT_EQ(filesInFolder(), files) << "a part file was left behind";
}

TEST(PtmWriter, RefusesWhatTheFormatCannotHold) {
  Artwork a = randomArtwork(Basis::kPtmLrgb, 4, 4, 1);
  a.format.bias[3] = 127.5;
  EXPECT_EQ(writePtm(folder() / "x.ptm", RasterOf(a)).error().kind, ErrorKind::kUnsupported);
  Artwork colour{4, 4, {}, Bytes(48)};
  EXPECT_EQ(writePtm(folder() / "x.ptm", RasterOf(colour)).error().kind, ErrorKind::kUsage);
  EXPECT_FALSE(fs::exists(folder() / "x.ptm"));
}

// ---- damaged files

std::vector<std::pair<std::string, Bytes>> smallFiles() {
  Artwork lrgb = randomArtwork(Basis::kPtmLrgb, 7, 5, 1), rgb = randomArtwork(Basis::kPtmRgb, 7, 5, 2);
  std::vector<Bytes> expected;
  std::vector<std::pair<std::string, Bytes>> files{{"LRGB 1.2", fileLrgb12(lrgb)},
                                                   {"LRGB 1.1", fileLrgb11(lrgb, {" ", "\r\n", " "})},
                                                   {"RGB", fileRgb(rgb)},
                                                   {"LUM", fileLum(lrgb, kJpegMatrix)}};
  Artwork a = lrgb;
  a.width = 19, a.height = 17;
  files.emplace_back("JPEG_LRGB", fileJpeg(a, "PTM_FORMAT_JPEG_LRGB", jpegPlanes(19, 17, 9, expected)));
  files.emplace_back("JPEG_RGB", fileJpeg(a, "PTM_FORMAT_JPEG_RGB", jpegPlanes(19, 17, 18, expected)));
  return files;
}

void expectGoodError(const Error& e, const std::string& path) {
  EXPECT_EQ(e.file, path);
  EXPECT_FALSE(e.message.empty());
  EXPECT_FALSE(e.hint.empty()) << e.text();
  EXPECT_TRUE(e.kind == ErrorKind::kInvalidData || e.kind == ErrorKind::kUnsupported) << e.text();
}

TEST(PtmDamage, EveryTruncatedLengthIsAnError) {
  for (auto& [name, file] : smallFiles()) {
    ASSERT_TRUE(open(save("t.ptm", file))) << name << ", control: the whole file opens";
    const std::string path = folder() / "t.ptm";
    for (size_t length = file.size(); length-- > 0;) {
      ASSERT_EQ(0, ::truncate(path.c_str(), static_cast<off_t>(length)));
      auto source = open(path);
      ASSERT_FALSE(source) << name << " cut to " << length << " of " << file.size();
      EXPECT_EQ(source.error().kind, ErrorKind::kInvalidData);
      expectGoodError(source.error(), path);
    }
  }
}

TEST(PtmDamage, EveryTruncatedJpegIsAnError) {
  // The file as long as it should be, but a plane's JPEG ends early: in its place, zeros.
  std::vector<Bytes> expected;
  Artwork a = randomArtwork(Basis::kPtmLrgb, 19, 17, 1);
  auto planes = jpegPlanes(19, 17, 9, expected);
  const Bytes whole = planes[4].jpeg;
  for (size_t length = 0; length + 2 < whole.size(); ++length) {  // the last two bytes are the end marker
    std::fill(planes[4].jpeg.begin() + static_cast<ptrdiff_t>(length), planes[4].jpeg.end(), uint8_t{0});
    auto path = save("t.ptm", fileJpeg(a, "PTM_FORMAT_JPEG_LRGB", planes));
    auto source = open(path);
    // Zeros can stand for the zeros that were there.
    if (planes[4].jpeg != whole) {
      if (!source) expectGoodError(source.error(), path);
    }
    planes[4].jpeg = whole;
  }
  for (size_t cut = 3; cut < whole.size(); ++cut) {
    planes[4].jpeg = Bytes(whole.begin(), whole.end() - static_cast<ptrdiff_t>(cut));
    auto path = save("t.ptm", fileJpeg(a, "PTM_FORMAT_JPEG_LRGB", planes));
    auto source = open(path);
    ASSERT_FALSE(source) << "JPEG short of " << cut << " bytes";
    expectGoodError(source.error(), path);
  }
}

TEST(PtmDamage, EveryWrongHeaderFieldIsAnErrorWithItsPlace) {
  const char* numbers[] = {"",     "-1",  "0", "nan", "inf", "-inf", "1e400", "x", "99999999999999999999999",
                           "0x10", "1,5", "-0"};
  for (auto& [name, file] : smallFiles()) {
    // The header's tokens: all text before the binary data; their count follows from the format.
    size_t tokens = 2 + 2 + 6 + 6;
    if (name == "LUM") tokens += 16;
    if (name == "JPEG_LRGB") tokens += 1 + 9 * 8 - 9;
    if (name == "JPEG_RGB") tokens += 1 + 18 * 8 - 18;
    size_t at = 0;
    for (size_t t = 0; t < tokens; ++t) {
      while (std::isspace(file[at])) ++at;
      size_t end = at;
      while (!std::isspace(file[end])) ++end;
      const std::string original(file.begin() + static_cast<ptrdiff_t>(at), file.begin() + static_cast<ptrdiff_t>(end));
      for (const char* replacement : numbers) {
        if (original == replacement) continue;
        Bytes damaged(file.begin(), file.begin() + static_cast<ptrdiff_t>(at));
        append(damaged, replacement);
        damaged.insert(damaged.end(), file.begin() + static_cast<ptrdiff_t>(end), file.end());
        auto path = save("h.ptm", damaged);
        largest_allocation = 0;
        auto source = open(path);
        EXPECT_LT(largest_allocation.load(), size_t{1} << 20) << name << " token " << t << " = " << replacement;
        if (source) {
          // Some replacements are lawful: another quality, bias, transform, motion, reference or matrix entry.
          EXPECT_GE(t, 10u) << name << " token " << t << " = '" << replacement << "' instead of " << original;
        } else {
          expectGoodError(source.error(), path);
          EXPECT_TRUE(source.error().offset.has_value()) << source.error().text();
        }
      }
      at = end;
    }
  }
}

TEST(PtmDamage, JpegPlanesThatContradictThemselvesAreRefused) {
  std::vector<Bytes> expected;
  const Artwork a = randomArtwork(Basis::kPtmLrgb, 19, 17, 6);
  const auto sound = jpegPlanes(19, 17, 9, expected);
  EXPECT_TRUE(open(save("planes.ptm", fileJpeg(a, "PTM_FORMAT_JPEG_LRGB", sound))));
  auto refused = [&](const std::vector<JpegPlaneSpec>& planes, const char* because) {
    const auto path = save("planes.ptm", fileJpeg(a, "PTM_FORMAT_JPEG_LRGB", planes));
    const auto source = open(path);
    ASSERT_FALSE(source) << because;
    expectGoodError(source.error(), path);
    EXPECT_NE(source.error().message.find(because), std::string::npos) << source.error().text();
  };
  for (const size_t bytes : {1u, 4u, 6u}) {
    auto planes = sound;
    planes[4].side.assign(bytes, 0);
    refused(planes, "records of 5 bytes");
  }
  for (const int reference : {4, 0}) {  // itself, and one that is decoded later
    auto planes = sound;
    planes[4].reference = reference;
    refused(planes, "decoded earlier");
  }
}

TEST(PtmDamage, AbsurdSizesAllocateNothing) {
  const std::pair<const char*, const char*> sizes[] = {{"1099511627776", "1099511627776"},
                                                       {"1099511627776", "1"},
                                                       {"3037000500", "3037000500"},
                                                       {"65500", "65500"},
                                                       {"65501", "1"},
                                                       {"9223372036854775807", "2"},
                                                       {"4294967296", "4294967296"},
                                                       {"1", "65500"}};
  for (auto& [name, file] : smallFiles()) {
    for (auto& [w, h] : sizes) {
      std::string text(file.begin(), file.end());
      size_t at = text.find_first_of("0123456789", text.find_first_of("\r\n", text.find("PTM_FORMAT")));
      size_t end = text.find_first_not_of("0123456789", at);
      size_t at2 = text.find_first_of("0123456789", end), end2 = text.find_first_not_of("0123456789", at2);
      text = text.substr(0, at) + w + text.substr(end, at2 - end) + h + text.substr(end2);
      auto path = save("s.ptm", Bytes(text.begin(), text.end()));
      largest_allocation = 0;
      auto source = open(path);
      ASSERT_FALSE(source) << name << " " << w << " x " << h;
      expectGoodError(source.error(), path);
      EXPECT_LT(largest_allocation.load(), size_t{2} << 20) << name << " " << w << " x " << h;
    }
  }
}

TEST(PtmDamage, UnsupportedVariantsAreRefusedByName) {
  Artwork a = randomArtwork(Basis::kPtmLrgb, 4, 4, 1);
  for (const char* format :
       {"PTM_FORMAT_PTM_LUT", "PTM_FORMAT_PTM_C_LUT", "PTM_FORMAT_JPEGLS_RGB", "PTM_FORMAT_JPEGLS_LRGB"}) {
    auto source = open(save("u.ptm", header(a, "PTM_1.2", format)));
    ASSERT_FALSE(source);
    EXPECT_EQ(source.error().kind, ErrorKind::kUnsupported);
    EXPECT_EQ(source.error().exitCode(), 5);
    EXPECT_NE(source.error().message.find(format), std::string::npos);
  }
  EXPECT_EQ(open(save("u.ptm", header(a, "PTM_1.3", "PTM_FORMAT_LRGB"))).error().kind, ErrorKind::kUnsupported);
  EXPECT_EQ(open(save("u.ptm", header(a, "PTM_1.2", "PTM_FORMAT_XYZ"))).error().kind, ErrorKind::kInvalidData);
  EXPECT_EQ(open(folder() / "missing.ptm").error().kind, ErrorKind::kIo);
}

TEST(PtmDamage, TrailingBytes) {
  Artwork a = randomArtwork(Basis::kPtmLrgb, 10, 10, 1);
  Bytes file = fileLrgb12(a);
  file.resize(file.size() + 16);
  EXPECT_TRUE(open(save("t.ptm", file)));
  file.resize(file.size() + 1);
  auto source = open(save("t.ptm", file));
  ASSERT_FALSE(source) << "a file much longer than its header says is damaged";
  EXPECT_EQ(source.error().kind, ErrorKind::kInvalidData);
}

TEST(PtmDamage, FileThatShrinksWhileOpen) {
  Artwork a = randomArtwork(Basis::kPtmLrgb, 50, 50, 1);
  auto path = save("s.ptm", fileLrgb12(a));
  auto source = open(path);
  ASSERT_TRUE(source);
  ASSERT_EQ(0, ::truncate(path.c_str(), 1000));
  Bytes out(a.raw.size());
  auto read = (*source)->read({0, 0, 50, 50}, out);
  ASSERT_FALSE(read);
  expectGoodError(read.error(), path);
}

TEST(PtmDamage, MutatedFilesNeverCrash) {
  const uint32_t seed = 20260101;
  const int kFilesPerFormat = 3000;
  std::cout << "seed " << seed << ", " << kFilesPerFormat << " files a format\n";
  const char* tokens[] = {"0",
                          "-1",
                          "1",
                          "2",
                          "7",
                          "17",
                          "255",
                          "65500",
                          "65536",
                          "2147483647",
                          "4294967296",
                          "1e9",
                          "nan",
                          "9223372036854775807",
                          " ",
                          "\n",
                          "\r\n",
                          "PTM_1.1",
                          "PTM_FORMAT_LUM",
                          "PTM_FORMAT_JPEG_RGB"};
  for (auto& [name, file] : smallFiles()) {
    std::mt19937 random(seed);
    int opened = 0;
    size_t header_bytes = std::min<size_t>(file.size(), name.starts_with("JPEG") ? 700 : 130);
    for (int i = 0; i < kFilesPerFormat; ++i) {
      Bytes mutated = file;
      for (int n = 1 + static_cast<int>(random() % 3); n > 0; --n) {
        const size_t range = random() % 2 ? header_bytes : mutated.size();
        const size_t at = mutated.empty() ? 0 : random() % std::min(range, mutated.size());
        const auto place = mutated.begin() + static_cast<ptrdiff_t>(at);
        switch (random() % 6) {
          case 0:
          case 1:
            if (!mutated.empty()) *place = static_cast<uint8_t>(random());
            break;
          case 2:
            if (!mutated.empty()) *place ^= static_cast<uint8_t>(1u << random() % 8);
            break;
          case 3:
            mutated.resize(at);
            break;
          case 4:
            mutated.erase(place, place + static_cast<ptrdiff_t>(std::min<size_t>(random() % 9, mutated.size() - at)));
            break;
          default: {
            std::string token = tokens[random() % std::size(tokens)];
            mutated.insert(place, token.begin(), token.end());
          }
        }
      }
      auto path = save("f.ptm", mutated);
      largest_allocation = 0;
      auto source = openPtm(path, {.memory_budget_bytes = 1 << 24, .hash = false});
      // A JPEG variant's planes: at most 512 samples a byte (ptm_jpeg.cpp); plus constant buffers.
      EXPECT_LE(largest_allocation.load(), mutated.size() * 512 + (1 << 20));
      if (!source) {
        EXPECT_EQ(source.error().file, path);
        EXPECT_FALSE(source.error().message.empty());
        continue;
      }
      ++opened;
      auto& s = **source;
      const int channels = s.format().channels();
      if (s.width() * s.height() > 1 << 20) continue;
      Bytes out(static_cast<size_t>(channels * s.width() * s.height()));
      EXPECT_TRUE(s.read({0, 0, s.width(), s.height()}, out));
      Rect r{s.width() / 3, s.height() / 3, s.width() - s.width() / 3, s.height() - s.height() / 3};
      EXPECT_TRUE(s.read(r, out));
    }
    std::cout << name << ": " << opened << " of them still open\n";
    EXPECT_GT(opened, 0) << name << ", control: mutations of the pixels only must not be refused";
    EXPECT_LT(opened, kFilesPerFormat) << name;
  }
}

}  // namespace ptm_test
}  // namespace relievo
