// Texture pages as blocks on the GPU: the picture is that of RGBA8 pages, for every codec and filter, while pages come
// and go, over storage that fails, and when the scene changes its planes. How near: BC7 is exact; of BC1, BC4 and BC5
// drivers may decode a texel 2 of 255 beside ours (bc_blocks_gltest.cpp), and a colour as far.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <map>
#include <set>
#include <utility>

#include "src/artwork/bases/ptm.h"
#include "src/engine/engine.h"
#include "src/gl/program.h"
#include "src/render/block_formats.h"
#include "src/render/page_pool.h"
#include "tests/render/gl_fixture.h"
#include "tests/render/made_engine.h"
#include "tests/render/test_artwork.h"
#include "tests/view_share.h"
#include "texturing/codec/bc_blocks.h"
#include "texturing/codec/page_block_codec.h"
#include "texturing/stream/page_sources.h"

namespace relievo {
namespace block_upload_gltest {

constexpr int kWidth = 192, kHeight = 108;
constexpr uint32_t kSeed = 20261121;
constexpr int kTexelTolerance = 2;  // of a driver's BC1 and BC4
constexpr std::array kCodecs{PageCodec::kBc1, PageCodec::kBc4, PageCodec::kBc5, PageCodec::kBc7};

std::optional<std::string> missing(PageCodec codec) { return missingBlockExtension(codec, gltest::api()); }

// Built once a program.
std::shared_ptr<const Package> blockPackage(int64_t w, int64_t h, Basis basis, PageEncoding coefficients,
                                            PageEncoding colour, double range_mm = 12) {
  static const test::TemporaryFolder folder;
  static std::map<std::string, std::shared_ptr<const Package>> all;
  const std::string name = std::to_string(w) + "x" + std::to_string(h) + "-" + basisName(basis) + "-" +
                           encodingName(coefficients) + "-" + encodingName(colour) +
                           (range_mm > 0 ? ".relievo" : "-flat.relievo");
  if (all[name]) return all[name];
  test::NoiseTexture texture(w, h, basis, 5);
  test::NoiseHeight heights(w, h, std::max(1.0, range_mm), 105);
  BuildOptions options;
  options.output = folder.file(name);
  options.mm_per_px = 0.1;
  options.coefficients = coefficients;
  options.colour = colour;
  auto built = buildPackage(texture, range_mm > 0 ? &heights : nullptr, options);
  EXPECT_TRUE(built.ok()) << (built.ok() ? "" : built.error().text());
  auto package = Package::open(options.output);
  EXPECT_TRUE(package.ok());
  if (package.ok()) all[name] = *package;
  return all[name];
}

OrbitCamera camera(double turn) {
  OrbitCamera c;
  c.azimuth_deg = 40 * std::sin(turn);
  c.elevation_deg = 25 * std::cos(1.7 * turn);
  c.distance_mm = 90 + 50 * std::sin(2.3 * turn);
  c.target_mm = {30 * std::cos(turn), 20 * std::sin(turn), 0};
  return c;
}

struct Difference {
  int max = 0;
  size_t pixels = 0;  // of the artwork
};
Difference differenceOf(const std::vector<uint8_t>& a, const std::vector<uint8_t>& b) {
  Difference d;
  EXPECT_EQ(a.size(), b.size());
  for (size_t i = 0; i + 3 < std::min(a.size(), b.size()); i += 4) {
    EXPECT_EQ(a[i + 3], b[i + 3]);
    d.pixels += a[i + 3] != 0;
    for (size_t c = 0; c < 3; ++c) d.max = std::max(d.max, std::abs(a[i + c] - b[i + c]));
  }
  return d;
}

class BlockUpload : public ::testing::Test {
 protected:
  // Colour is drawn unlit: the normals beside it are no blocks.
  static std::unique_ptr<Engine> makeEngine(std::shared_ptr<const Package> package, Upload upload, Scene scene,
                                            std::shared_ptr<const PageSource> source = {}, double cache_mib = 64) {
    scene.unlit = package->manifest().texture.basis == Basis::kColour;
    Artwork artwork = artworkFromPackage(package);
    if (source) artwork.source = source;
    EngineOptions options;
    options.upload = upload;
    options.cache_mib = cache_mib;
    return test::makeEngine(artwork, scene, options, kWidth, kHeight);
  }
  static std::vector<uint8_t> settled(Engine& e, const OrbitCamera& c) {
    e.setCamera(c);
    auto done = e.settle(60);
    EXPECT_TRUE(done.ok()) << (done.ok() ? "" : done.error().text());
    EXPECT_EQ(e.stats().detail_bias, 0) << "the cache is too small for this test";
    return e.readPixels();
  }
};

std::vector<Scene> everyFilter() {
  std::vector<Scene> scenes;
  for (Sampling sampling : {Sampling::kNearest, Sampling::kBilinear, Sampling::kTrilinear, Sampling::kAnisotropic})
    for (Filter filter : {Filter::kExact, Filter::kFast}) scenes.push_back({.sampling = sampling, .filter = filter});
  return scenes;
}

// About a texel a pixel at a slant, magnified (page edges cross the view), minified; with OpenGL ES the first alone.
std::vector<OrbitCamera> everyDistance() {
  OrbitCamera near = camera(0.7), slant = camera(2), far = camera(3);
  near.distance_mm = 12;
  near.target_mm = {0.3, -0.2, 0};
  slant.azimuth_deg = 65;
  slant.distance_mm = 50;
  far.distance_mm = 200;
  std::vector<OrbitCamera> all{slant, near, far};
  all.resize(test::esShare(all.size()));
  return all;
}

TEST_F(BlockUpload, ThePictureIsThatOfRgba8) {
  int compared = 0;
  for (PageCodec codec : kCodecs) {
    if (missing(codec)) {
      std::printf("[ blocks ] %s\n", missing(codec)->c_str());
      continue;
    }
    auto package = blockPackage(601, 333, Basis::kColour, {codec, 0}, {codec, 0});
    ASSERT_TRUE(package);
    int worst_exact = 0, worst_fast = 0;
    size_t pixels = 0;
    for (const Scene& scene : everyFilter()) {
      auto rgba8 = makeEngine(package, Upload::kRgba8, scene), blocks = makeEngine(package, Upload::kBlocks, scene);
      ASSERT_TRUE(rgba8 && blocks);
      for (const OrbitCamera& view : everyDistance()) {
        const Difference d = differenceOf(settled(*rgba8, view), settled(*blocks, view));
        int& worst = scene.filter == Filter::kFast ? worst_fast : worst_exact;
        worst = std::max(worst, d.max);
        pixels += d.pixels;
      }
      EXPECT_EQ(rgba8->stats().upload, PageCodec::kLossless);
      EXPECT_EQ(blocks->stats().upload, codec);
      EXPECT_TRUE(blocks->stats().why_not_blocks.empty());
      EXPECT_EQ(blocks->stats().streamer.bytes_uploaded[0],
                blocks->stats().streamer.pages_uploaded[0] * pageBlockBytes(codec));
    }
    std::printf("[ blocks ] %s: %zu pixels, largest difference to RGBA8 %d of 255 (fast filter %d)\n",
                encodingName({codec, 0}).c_str(), pixels, worst_exact, worst_fast);
    EXPECT_GT(pixels, test::esShare(size_t{150'000}));
    EXPECT_LE(worst_exact, codec == PageCodec::kBc7 ? 0 : kTexelTolerance);
    // The texture unit may filter RGBA8 in 8 bits and blocks in float.
    EXPECT_LE(worst_fast, (codec == PageCodec::kBc7 ? 0 : kTexelTolerance) + 1);
    ++compared;
  }
  if (compared == 0) GTEST_SKIP() << "this context samples no block formats";
}

// Three planes, relit: what 2 of 255 in each channel can do to a pixel. BC7 is exact here, too.
TEST_F(BlockUpload, RelitPtmsAgree) {
  int compared = 0;
  for (PageCodec codec : kCodecs) {
    if (missing(codec)) continue;
    auto package = blockPackage(500, 300, Basis::kPtmLrgb, {codec, 0}, {codec, 0});
    ASSERT_TRUE(package);
    Scene scene;
    scene.light = {0.4, -0.3, 0.8};
    auto rgba8 = makeEngine(package, Upload::kRgba8, scene), blocks = makeEngine(package, Upload::kBlocks, scene);
    ASSERT_TRUE(rgba8 && blocks);
    const auto light = normalizedLight(scene.light);
    const auto basis = ptmBasis(light[0], light[1]);
    double luminance = 0;
    for (size_t k = 0; k < 6; ++k)
      luminance += kTexelTolerance * std::abs(package->manifest().texture.scale[k] * basis[k]);
    const double bound = luminance + kTexelTolerance * (255 + luminance) / 255 +
                         1;  // luminance is 255 at most where a pixel is not clamped
    int worst = 0;
    for (const OrbitCamera& view : everyDistance())
      worst = std::max(worst, differenceOf(settled(*rgba8, view), settled(*blocks, view)).max);
    std::printf("[ blocks ] %s, LRGB relit: largest difference %d of 255, bound %.1f\n",
                encodingName({codec, 0}).c_str(), worst, bound);
    EXPECT_LE(worst, codec == PageCodec::kBc7 ? 0 : bound);
    ++compared;
  }
  if (compared == 0) GTEST_SKIP() << "this context samples no block formats";
}

// Six planes: two textures of page table entries.
TEST_F(BlockUpload, SixPlanesAgree) {
  if (missing(PageCodec::kBc7)) GTEST_SKIP() << *missing(PageCodec::kBc7);
  auto package = blockPackage(300, 200, Basis::kPtmRgb, {PageCodec::kBc7, 0}, {PageCodec::kBc7, 0});
  ASSERT_TRUE(package);
  Scene scene;
  scene.light = {0.2, 0.5, 0.8};
  auto rgba8 = makeEngine(package, Upload::kRgba8, scene), blocks = makeEngine(package, Upload::kBlocks, scene);
  ASSERT_TRUE(rgba8 && blocks);
  for (const OrbitCamera& view : everyDistance())
    EXPECT_EQ(differenceOf(settled(*rgba8, view), settled(*blocks, view)).max, 0);
}

// --- negative controls ---

// A page's blocks changed on their way.
class ChangedBlocks final : public PageSource {
 public:
  ChangedBlocks(std::shared_ptr<const PageSource> inner, PageCodec codec,
                std::function<void(std::vector<uint8_t>&)> change)
      : inner_(std::move(inner)), codec_(codec), change_(std::move(change)) {}
  Result<EncodedPage> read(PageId id) const override {
    auto page = inner_->read(id);
    if (!page || !isTexturePlane(id.plane())) return page;
    std::vector<uint8_t> blocks(pageBlockBytes(codec_));
    if (auto unpacked = PageDecoder().decodeToBlocks(codec_, page->bytes, blocks); !unpacked) return unpacked.error();
    change_(blocks);
    std::vector<uint8_t> raw{6, static_cast<uint8_t>(codec_)};  // blocks that are not packed (PACKAGE.md)
    raw.insert(raw.end(), blocks.begin(), blocks.end());
    return EncodedPage{raw};
  }

 private:
  std::shared_ptr<const PageSource> inner_;
  PageCodec codec_;
  std::function<void(std::vector<uint8_t>&)> change_;
};

TEST_F(BlockUpload, TheComparisonSeesWrongBlocks) {
  if (test::controlledWithOpenGl()) GTEST_SKIP() << "tried with OpenGL";
  int compared = 0;
  for (PageCodec codec : kCodecs) {
    if (missing(codec)) continue;
    auto package = blockPackage(601, 333, Basis::kColour, {codec, 0}, {codec, 0});
    ASSERT_TRUE(package);
    const Scene scene;
    const OrbitCamera view = everyDistance()[1];
    auto rgba8 = makeEngine(package, Upload::kRgba8, scene);
    const auto right = settled(*rgba8, view);
    auto worst = [&](std::function<void(std::vector<uint8_t>&)> change) {
      auto e = makeEngine(package, Upload::kBlocks, scene,
                          std::make_shared<ChangedBlocks>(package, codec, std::move(change)));
      return differenceOf(right, settled(*e, view)).max;
    };
    const int tolerance = codec == PageCodec::kBc7 ? 0 : kTexelTolerance;
    EXPECT_LE(worst([](std::vector<uint8_t>&) {}), tolerance) << "raw blocks are blocks, too";
    // A row of blocks off: of the first set.
    const auto row = static_cast<std::ptrdiff_t>(blockFormats(codec)[0].block_bytes * kBlocksPerSide);
    EXPECT_GT(worst([&](std::vector<uint8_t>& b) {
                std::rotate(b.begin(), b.begin() + row, b.begin() + row * kBlocksPerSide);
              }),
              20);
    if (codec == PageCodec::kBc4) {  // sets in another order: channels change places
      EXPECT_GT(
          worst([&](std::vector<uint8_t>& b) { std::rotate(b.begin(), b.begin() + row * kBlocksPerSide, b.end()); }),
          20);
    }
    ++compared;
  }
  if (compared == 0) GTEST_SKIP() << "this context samples no block formats";
}

// --- the pool ---

// The driver's texel of each slot's middle, channel 0. sampler: of the pool's, u_pool or u_blocks0.
std::vector<uint8_t> middles(const PagePool& pool, int slots, const std::string& sampler) {
  PageTable table(16, 1);
  auto linked = gl::Program::linkTexts(
      gltest::api(),
      {"middles.vert",
       "void main() {\n  vec2 p = vec2(float((gl_VertexID & 1) << 2), float((gl_VertexID & 2) << 1)) - 1.0;\n  "
       "gl_Position = vec4(p, 0.0, 1.0);\n}\n"},
      {"middles.frag", "uniform sampler2DArray " + sampler +
                           ";\nlayout(location = 0) out vec4 o;\n"
                           "void main() {\n  int slot = int(gl_FragCoord.x) + 64 * int(gl_FragCoord.y);\n"
                           "  o = texelFetch(" +
                           sampler +
                           ", ivec3((slot & 7) * 136 + 68, ((slot >> 3) & 7) * 136 + 68, slot >> 6), 0);\n}\n"},
      {});
  EXPECT_TRUE(linked.ok()) << (linked.ok() ? "" : linked.error().text());
  const int rows = (slots + 63) / 64;
  gl::Texture colour = gl::createTexture(GL_TEXTURE_2D, "middles");
  glActiveTexture(GL_TEXTURE0);
  glBindTexture(GL_TEXTURE_2D, colour.id());
  glTexImage2D(GL_TEXTURE_2D, 0, GL_RGBA8, 64, rows, 0, GL_RGBA, GL_UNSIGNED_BYTE, nullptr);
  gl::Framebuffer framebuffer = gl::Framebuffer::create("middles");
  glBindFramebuffer(GL_FRAMEBUFFER, framebuffer.id());
  glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, colour.id(), 0);
  glViewport(0, 0, 64, rows);
  linked->use();
  pool.bind(*linked, table);
  gl::VertexArray nothing = gl::VertexArray::create("nothing");
  glBindVertexArray(nothing.id());
  glDisable(GL_BLEND);
  glDisable(GL_DEPTH_TEST);
  glDisable(GL_CULL_FACE);
  glDrawArrays(GL_TRIANGLES, 0, 3);
  std::vector<uint8_t> out(static_cast<size_t>(64 * rows * 4));
  glReadPixels(0, 0, 64, rows, GL_RGBA, GL_UNSIGNED_BYTE, out.data());
  glBindVertexArray(0);
  std::vector<uint8_t> first;
  for (int i = 0; i < slots; ++i) first.push_back(out[static_cast<size_t>(4 * i)]);
  return first;
}

// A page of one value in every channel.
std::vector<uint8_t> uniformPage(PageCodec codec, uint8_t value) {
  std::array<uint8_t, 64> texels;
  texels.fill(value);
  std::vector<uint8_t> page(pageBlockBytes(codec)), block(static_cast<size_t>(blockBytes(codec)));
  if (codec == PageCodec::kBc1) encodeBc1(texels.data(), block.data());
  if (codec == PageCodec::kBc7) encodeBc7(texels.data(), block.data());
  if (codec == PageCodec::kBc4 || codec == PageCodec::kBc5) {
    block.resize(8);  // a channel's, whichever
    encodeBc4(texels.data(), block.data());
  }
  for (size_t i = 0; i < page.size(); ++i) page[i] = block[i % block.size()];
  return page;
}

std::vector<std::pair<PageCodec, bool>> codecsStagedAndNot() {
  std::vector<std::pair<PageCodec, bool>> all;
  for (PageCodec codec : kCodecs)
    for (bool staged : {false, true}) all.emplace_back(codec, staged);
  return all;
}

// The textures grow under what is there: none of it is lost, none is overwritten.
// Whether texels go as they are or through a ring, which is filled more than once.
TEST_F(BlockUpload, AGrowingPoolKeepsWhatIsThere) {
  int compared = 0;
  for (auto [codec, staged] : codecsStagedAndNot()) {
    if (missing(codec)) continue;
    constexpr uint32_t kSlots = 1100;
    PagePool pool(CacheSlots{.upload = codec, .texture = kSlots, .relief = 1}, staged);
    auto value = [](uint32_t slot) { return static_cast<uint8_t>(slot * 37 % 251); };
    std::vector<uint64_t> sizes;
    uint32_t from = 0;
    for (uint32_t to : {5u, 500u, 700u, kSlots}) {
      std::vector<std::vector<uint8_t>> pages;
      std::vector<PageUpload> uploads;
      for (uint32_t slot = from; slot < to; ++slot) pages.push_back(uniformPage(codec, value(slot)));
      for (uint32_t slot = from; slot < to; ++slot)
        uploads.push_back({slot, PageId(texturePlane(0), NodeId{0, 0, 0, 0}), pages[slot - from].data()});
      pool.upload(uploads);
      from = to;
      if (sizes.empty() || sizes.back() != pool.textureBytes()) sizes.push_back(pool.textureBytes());
    }
    EXPECT_GT(pool.bytesUploaded(), UploadRing::kSegments * UploadRing::kSegmentBytes) << "the ring goes round";
    EXPECT_EQ(pool.bytesUploaded(), kSlots * pageBlockBytes(codec));
    const bool copies = epoxy_has_gl_extension("GL_ARB_copy_image") || epoxy_has_gl_extension("GL_EXT_copy_image") ||
                        epoxy_has_gl_extension("GL_OES_copy_image");
    EXPECT_EQ(sizes.size() > 1, copies) << "it grows, or takes all at once";
    EXPECT_EQ(sizes.back(), (kSlots + kSlotsPerLayer - 1) / kSlotsPerLayer * kSlotsPerLayer * pageBlockBytes(codec))
        << "relief's come with relief";
    const auto found = middles(pool, kSlots, "u_blocks0");
    for (uint32_t slot = 0; slot < kSlots; ++slot)
      ASSERT_NEAR(found[slot], value(slot), codec == PageCodec::kBc1 ? 6 : 2)
          << "slot " << slot << " of " << encodingName({codec, 0});
    ++compared;
  }
  if (compared == 0) GTEST_SKIP() << "this context samples no block formats";
}

// The same of RGBA8, by image copies or (where extensions are left out) layer by layer. The control: a page that
// another took the place of.
TEST_F(BlockUpload, AGrowingPoolKeepsItsTexels) {
  for (bool staged : {false, true}) {
    constexpr uint32_t kSlots = 1100;
    PagePool pool(CacheSlots{.upload = PageCodec::kLossless, .texture = kSlots, .relief = 0}, staged);
    auto value = [](uint32_t slot) { return static_cast<uint8_t>(1 + slot * 37 % 251); };
    uint32_t sizes = 0;
    uint64_t size = 0;
    std::vector<uint8_t> page(kSlotBytes);
    for (uint32_t slot = 0; slot < kSlots; ++slot) {
      std::fill(page.begin(), page.end(), value(slot));
      const PageUpload upload{slot, PageId(texturePlane(0), NodeId{0, 0, 0, 0}), page.data()};
      pool.upload({&upload, 1});
      sizes += std::exchange(size, pool.textureBytes()) != pool.textureBytes();
    }
    EXPECT_EQ(sizes, 3u) << "it grew twice";
    const auto found = middles(pool, kSlots, "u_pool");
    for (uint32_t slot = 0; slot < kSlots; ++slot)
      ASSERT_EQ(found[slot], value(slot)) << "slot " << slot << (staged ? ", staged" : "");
    const PageUpload another{3, PageId(texturePlane(0), NodeId{0, 0, 0, 0}), page.data()};
    pool.upload({&another, 1});
    EXPECT_NE(middles(pool, kSlots, "u_pool")[3], value(3));
  }
}

// --- while pages come and go ---

// A small cache and a camera that moves: never more than the budget, no holes; and what is left of it in the end is
// nothing.
TEST_F(BlockUpload, UnderPressureTheBudgetHoldsAndThePictureComesBack) {
  if (test::controlledWithOpenGl()) GTEST_SKIP() << "about what lies outside the shaders; tried with OpenGL";
  constexpr PageCodec kCodec = PageCodec::kBc1;
  if (missing(kCodec)) GTEST_SKIP() << *missing(kCodec);
  auto package = blockPackage(1601, 801, Basis::kPtmLrgb, {kCodec, 0}, {kCodec, 0});
  ASSERT_TRUE(package);
  const Scene scene;
  OrbitCamera far = camera(1);
  far.distance_mm = 900;
  auto roomy = makeEngine(package, Upload::kBlocks, scene);
  const auto right = settled(*roomy, far);
  constexpr double kMib = 1.6;
  auto e = makeEngine(package, Upload::kBlocks, scene, {}, kMib);
  ASSERT_TRUE(e);
  e->resize(2 * kWidth, 2 * kHeight);
  const uint64_t budget = static_cast<uint64_t>(kMib * 1024 * 1024);
  const uint64_t rounding = kSlotsPerLayer * (kSlotBytes + pageBlockBytes(kCodec));  // of textures, to whole layers
  double highest_bias = 0;
  // At least so many frames; a fast GPU draws more of them while pages come in.
  for (int i = 0; i < test::glShare(150) || (e->stats().streamer.evictions <= 50 && i < 50'000); ++i) {
    OrbitCamera c = camera(i * 0.05);
    c.distance_mm = i % 50 < 25 ? 40 : 120;
    e->setCamera(c);
    e->frame(0.02 * i);
    const EngineStats s = e->stats();
    ASSERT_LE(s.cache_bytes, budget);
    ASSERT_LE(s.streamer.resident_bytes, s.cache_bytes);
    ASSERT_LE(s.texture_bytes, budget + rounding);
    highest_bias = std::max(highest_bias, s.detail_bias);
  }
  EXPECT_GT(highest_bias, 0.1) << "is there any pressure?";
  EXPECT_GT(e->stats().streamer.evictions, 50u);
  e->resize(kWidth, kHeight);
  EXPECT_EQ(settled(*e, far), right);
}

TEST_F(BlockUpload, FaultsLeaveNoTraceOrShowAncestors) {
  constexpr PageCodec kCodec = PageCodec::kBc7;
  if (missing(kCodec)) GTEST_SKIP() << *missing(kCodec);
  auto package = blockPackage(601, 333, Basis::kColour, {kCodec, 0}, {kCodec, 0});
  ASSERT_TRUE(package);
  const OrbitCamera view = camera(0.8);
  const Scene scene;
  auto sound = makeEngine(package, Upload::kBlocks, scene);
  const auto right = settled(*sound, view);
  auto failing = std::make_shared<FailingSource>(
      package, FailingSource::Rates{.fail = 0.05, .truncate = 0.05, .corrupt = 0.05}, kSeed);
  auto e = makeEngine(package, Upload::kBlocks, scene, std::make_shared<CheckedSource>(failing, checksumsOf(package)));
  EXPECT_EQ(settled(*e, view), right) << "seed " << kSeed;
  EXPECT_EQ(e->stats().streamer.failed_pages, 0u) << "another seed, please";
  EXPECT_GT(failing->maxAttempts(), 1) << "does anything fail?";
}

// Pages that hold other blocks than the manifest says (or none) are damaged: their ancestors show, each is named once.
class OtherCodec final : public PageSource {
 public:
  explicit OtherCodec(std::shared_ptr<const PageSource> inner) : inner_(std::move(inner)) {}
  Result<EncodedPage> read(PageId id) const override {
    auto page = inner_->read(id);
    if (!page || !isTexturePlane(id.plane()) || id.node().level < 2) return page;
    std::vector<uint8_t> bytes(page->bytes.begin(), page->bytes.end());
    bytes[1] = static_cast<uint8_t>(PageCodec::kBc1);
    return EncodedPage{bytes};
  }

 private:
  std::shared_ptr<const PageSource> inner_;
};

TEST_F(BlockUpload, PagesOfAnotherCodecAreDamaged) {
  if (test::controlledWithOpenGl()) GTEST_SKIP() << "about what lies outside the shaders; tried with OpenGL";
  constexpr PageCodec kCodec = PageCodec::kBc7;
  if (missing(kCodec)) GTEST_SKIP() << *missing(kCodec);
  auto package = blockPackage(601, 333, Basis::kColour, {kCodec, 0}, {kCodec, 0});
  ASSERT_TRUE(package);
  auto e = makeEngine(package, Upload::kBlocks, {.relief = false}, std::make_shared<OtherCodec>(package));
  OrbitCamera near = camera(0.8);
  near.distance_mm = 20;
  e->setCamera(near);
  auto done = e->settle(60);
  ASSERT_TRUE(done.ok()) << done.error().text();
  const EngineStats s = e->stats();
  EXPECT_GT(s.streamer.failed_pages, 0u);
  const auto messages = e->takeMessages();
  EXPECT_EQ(std::set(messages.begin(), messages.end()).size(), s.streamer.failed_pages);
  size_t black = 0, seen = 0;
  const auto pixels = e->readPixels();
  for (size_t i = 0; i < pixels.size(); i += 4) {
    seen += pixels[i + 3] != 0;
    black += pixels[i + 3] != 0 && pixels[i] == 0;
  }
  EXPECT_GT(seen, 1000u);
  EXPECT_EQ(black, 0u) << "an ancestor should show";
}

class DamagedRoots final : public PageSource {
 public:
  explicit DamagedRoots(std::shared_ptr<const PageSource> inner) : inner_(std::move(inner)) {}
  Result<EncodedPage> read(PageId id) const override {
    if (isTexturePlane(id.plane())) return Error{ErrorKind::kInvalidData, "test", "there is no such page", "", {}};
    return inner_->read(id);
  }

 private:
  std::shared_ptr<const PageSource> inner_;
};

TEST_F(BlockUpload, UnreadableRootsShowNeutralBlocks) {
  int compared = 0;
  for (PageCodec codec : kCodecs) {
    if (missing(codec)) continue;
    for (Basis basis : {Basis::kColour, Basis::kPtmLrgb}) {
      auto package = blockPackage(200, 150, basis, {codec, 0}, {codec, 0}, 0);
      ASSERT_TRUE(package);
      Scene scene;
      scene.light = {0.5, 0.2, 0.8};
      auto e = makeEngine(package, Upload::kBlocks, scene, std::make_shared<DamagedRoots>(package));
      ASSERT_TRUE(e);
      e->setCamera(camera(0.8));
      (void)e->settle(60);
      const auto pixels = e->readPixels();
      size_t seen = 0;
      int worst = 0;
      for (size_t i = 0; i < pixels.size(); i += 4) {
        if (pixels[i + 3] == 0) continue;
        ++seen;
        for (size_t c = 0; c < 3; ++c) worst = std::max(worst, std::abs(pixels[i + c] - 128));
      }
      EXPECT_GT(seen, 100u);
      EXPECT_LE(worst, codec == PageCodec::kBc1 ? 12 : 4) << encodingName({codec, 0}) << ", " << basisName(basis);
      EXPECT_EQ(e->takeMessages().size(),
                static_cast<size_t>(package->manifest().texture.planes()) * package->manifest().domain.patchCount());
    }
    ++compared;
  }
  if (compared == 0) GTEST_SKIP() << "this context samples no block formats";
}

// --- which format, and said how ---

TEST_F(BlockUpload, AFixedLightIsRgba8AndBack) {
  constexpr PageCodec kCodec = PageCodec::kBc7;
  if (missing(kCodec)) GTEST_SKIP() << *missing(kCodec);
  auto package = blockPackage(500, 300, Basis::kPtmLrgb, {kCodec, 0}, {kCodec, 0});
  ASSERT_TRUE(package);
  Scene relit, fixed;
  fixed.relight = false;
  fixed.light = relit.light = {0.3, 0.3, 0.8};
  const OrbitCamera view = everyDistance()[1];
  auto e = makeEngine(package, Upload::kBlocks, relit);
  const auto right_relit = settled(*makeEngine(package, Upload::kRgba8, relit), view);
  const auto right_fixed = settled(*makeEngine(package, Upload::kRgba8, fixed), view);
  EXPECT_NE(right_relit, right_fixed);
  for (int i = 0; i < 4; ++i) {
    const bool relight = i % 2 == 0;
    ASSERT_TRUE(e->setScene(relight ? relit : fixed).ok());
    EXPECT_EQ(settled(*e, view), relight ? right_relit : right_fixed) << i;
    EXPECT_EQ(e->stats().upload, relight ? kCodec : PageCodec::kLossless);
    EXPECT_LE(e->stats().cache_bytes, uint64_t{64} << 20);
  }
}

TEST_F(BlockUpload, PackagesWithoutBlocksFallBackAndSayWhy) {
  for (auto [coefficients, colour] : {std::pair{PageEncoding{}, PageEncoding{}},
                                      {PageEncoding{PageCodec::kBc4, 0}, PageEncoding{PageCodec::kBc1, 0}}}) {
    auto package = blockPackage(200, 150, Basis::kPtmLrgb, coefficients, colour);
    ASSERT_TRUE(package);
    auto e = makeEngine(package, Upload::kBlocks, {});
    auto rgba8 = makeEngine(package, Upload::kRgba8, {});
    ASSERT_TRUE(e && rgba8);
    EXPECT_EQ(settled(*e, camera(2)), settled(*rgba8, camera(2)));
    EXPECT_EQ(e->stats().upload, PageCodec::kLossless);
    EXPECT_FALSE(e->stats().why_not_blocks.empty());
    EXPECT_EQ(e->takeMessages().size(), 1u) << "said once";
    EXPECT_TRUE(rgba8->takeMessages().empty());
    EXPECT_TRUE(rgba8->stats().why_not_blocks.empty()) << "nobody asked";
  }
}

TEST_F(BlockUpload, ColourLitByItsReliefIsNoBlocksAndSaysWhy) {
  auto package = blockPackage(200, 150, Basis::kColour, {PageCodec::kBc1, 0}, {PageCodec::kBc1, 0});
  ASSERT_TRUE(package);
  if (missing(PageCodec::kBc1)) GTEST_SKIP() << "this context has no BC1";
  auto lit = test::makeEngine(artworkFromPackage(package), {}, {.upload = Upload::kBlocks}, kWidth, kHeight);
  ASSERT_TRUE(lit);
  EXPECT_EQ(lit->stats().upload, PageCodec::kLossless);
  EXPECT_NE(lit->stats().why_not_blocks.find("--unlit"), std::string::npos);
  EXPECT_FALSE(lit->takeMessages().empty());
}

// Run once more without the extension (tests.cmake): then the error names it, and auto does without.
TEST_F(BlockUpload, AContextWithoutBc7IsNamed) {
  auto package = blockPackage(200, 150, Basis::kColour, {PageCodec::kBc7, 0}, {PageCodec::kBc7, 0});
  ASSERT_TRUE(package);
  const Artwork artwork = artworkFromPackage(package);
  auto engine = Engine::create(artwork, {}, {.upload = Upload::kBlocks});
  const auto extension = missing(PageCodec::kBc7);
  // Mesa heeds it; were it not, this run would be the other one again.
  const char* without = std::getenv("MESA_EXTENSION_OVERRIDE");
  if (without && std::strstr(without, "-GL_ARB_texture_compression_bptc") && gltest::context().info().software) {
    ASSERT_TRUE(extension);
  }
  ASSERT_EQ(engine.ok(), !extension);
  if (!engine.ok()) {
    EXPECT_EQ(engine.error().kind, ErrorKind::kUnsupported);
    EXPECT_NE(engine.error().text().find(*extension), std::string::npos) << engine.error().text();
  }
  auto automatic = makeEngine(package, Upload::kAuto, {});
  ASSERT_TRUE(automatic);
  EXPECT_EQ(automatic->stats().upload,
            extension || gltest::context().info().software ? PageCodec::kLossless : PageCodec::kBc7);
  EXPECT_EQ(automatic->stats().why_not_blocks.empty(), isBlockCodec(automatic->stats().upload));
}

}  // namespace block_upload_gltest
}  // namespace relievo
