// The head-up display: what it says, where it draws, and that it leaves the rest of the picture alone. And the viewer's
// small helpers.
#include <unistd.h>
#include <array>
#include <cstdint>

#include <filesystem>
#include <fstream>
#include <vector>

#include <gtest/gtest.h>

#include "src/gl/objects.h"
#include "src/render/over_background.h"
#include "src/render/overlay_pass.h"
#include "src/viewer/hud.h"
#include "src/viewer/viewer.h"
#include "tests/render/gl_fixture.h"

namespace relievo {
namespace hud_gltest {

constexpr int kWidth = 640, kHeight = 360;

struct Picture {
  gl::Texture colour = gl::createTexture(GL_TEXTURE_2D, "picture");
  gl::Framebuffer framebuffer = gl::Framebuffer::create("picture");
  Picture() {
    glBindTexture(GL_TEXTURE_2D, colour.id());
    glTexStorage2D(GL_TEXTURE_2D, 1, GL_RGBA8, kWidth, kHeight);
    glBindFramebuffer(GL_FRAMEBUFFER, framebuffer.id());
    glFramebufferTexture2D(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_TEXTURE_2D, colour.id(), 0);
    glClearColor(0.2f, 0.4f, 0.6f, 1);
    glClear(GL_COLOR_BUFFER_BIT);
  }
  // How many pixels of the rectangle (origin top left) differ from the clear colour.
  int touched(int left, int top, int right, int bottom) const {
    std::vector<uint8_t> px(kWidth * kHeight * 4);
    glReadPixels(0, 0, kWidth, kHeight, GL_RGBA, GL_UNSIGNED_BYTE, px.data());
    int count = 0;
    for (int y = top; y < bottom; ++y)
      for (int x = left; x < right; ++x) {
        const uint8_t* p = &px[static_cast<size_t>(((kHeight - 1 - y) * kWidth + x) * 4)];
        count += p[0] != 51 || p[1] != 102 || p[2] != 153;
      }
    return count;
  }
};

TEST(Hud, LineNamesTheFigures) {
  HudState s{.fps = 31.4, .frame_ms = 31.85, .resident_pages = 312, .slots = 3628, .missing_pages = 4};
  s.error_px = 1;
  s.predicted_error_px = 0.84;
  EXPECT_EQ(hudLine(s), "31 fps  31.9 ms   pages 312 of 3628, 4 missing   error at most 0.84 px");
  s.mm_per_px = 0.0416667;
  EXPECT_EQ(hudLine(s), "31 fps  31.9 ms   pages 312 of 3628, 4 missing   error at most 0.84 px   0.04167 mm a px");
  s.size_known = false;
  EXPECT_EQ(hudLine(s),
            "31 fps  31.9 ms   pages 312 of 3628, 4 missing   error at most 0.84 px   0.04167 px of the artwork a px");
  // What is promised is the bound that holds, not the budget.
  s.mm_per_px = 0;
  s.predicted_error_px = 8.6;
  EXPECT_EQ(hudLine(s),
            "31 fps  31.9 ms   pages 312 of 3628, 4 missing   error at most 8.60 px so far (asked for 1.0)");
  s.missing_pages = 0;
  EXPECT_EQ(hudLine(s),
            "31 fps  31.9 ms   pages 312 of 3628, 0 missing   error at most 8.60 px in places (asked for 1.0)");
  s = {.duration_s = 4, .time_s = 1.26, .playing = true};
  EXPECT_TRUE(hudLine(s).ends_with("   1.3 of 4.0 s, playing"));
  s.playing = false;
  EXPECT_TRUE(hudLine(s).ends_with("   1.3 of 4.0 s, paused"));
  s = {.unlit = true};
  EXPECT_TRUE(hudLine(s).ends_with("   unlit"));
  s.shading = "slope";
  EXPECT_TRUE(hudLine(s).ends_with(" px   slope"));
  s = {.shadows = true, .gloss = true};
  EXPECT_TRUE(hudLine(s).ends_with(" px   shadows, gloss"));
  s = {.unlit = true, .ambient_occlusion = true};
  EXPECT_TRUE(hudLine(s).ends_with(" px   unlit, ambient occlusion"));
}

TEST(Hud, DrawsInItsCornerAndNowhereElse) {
  auto hud = Hud::create(gltest::api(), 1);
  ASSERT_TRUE(hud.ok()) << hud.error().text();
  Picture picture;
  ASSERT_EQ(picture.touched(0, 0, kWidth, kHeight), 0);
  (*hud)->draw({.message = "hello"}, kWidth, kHeight);
  EXPECT_GT(picture.touched(0, 0, kWidth, 60), 1000);
  EXPECT_EQ(picture.touched(0, 60, kWidth, kHeight), 0);
}

TEST(Hud, AGrowingTextFitsAtOnce) {
  auto hud = Hud::create(gltest::api(), 1);
  ASSERT_TRUE(hud.ok());
  Picture picture;
  (*hud)->draw({.message = "m"}, kWidth, kHeight);
  ASSERT_EQ(picture.touched(600, 0, kWidth, 60), 0);
  (*hud)->draw({.message = std::string(85, 'm')}, kWidth, kHeight);
  EXPECT_GT(picture.touched(600, 0, kWidth, 60), 100);
}

TEST(Hud, HelpAndLightComeWhenAsked) {
  auto hud = Hud::create(gltest::api(), 1);
  ASSERT_TRUE(hud.ok());
  Picture picture;
  glClear(GL_COLOR_BUFFER_BIT);
  (*hud)->draw({.light = {0.5, 0.5, 0.7}, .show_light = true}, kWidth, kHeight);
  EXPECT_GT(picture.touched(0, 240, 200, kHeight), 1000) << "the light's gauge, bottom left";
  EXPECT_EQ(picture.touched(200, 60, kWidth, kHeight), 0);
  glClear(GL_COLOR_BUFFER_BIT);
  (*hud)->draw({.unlit = true, .light = {0.5, 0.5, 0.7}, .show_light = true}, kWidth, kHeight);
  EXPECT_EQ(picture.touched(0, 60, kWidth, kHeight), 0) << "no gauge where no light changes the picture";
  glClear(GL_COLOR_BUFFER_BIT);
  (*hud)->draw({.help = true}, kWidth, kHeight);
  EXPECT_GT(picture.touched(160, 100, 480, 260), 10000) << "the help, in the middle";
}

EngineStats busyStats() {
  EngineStats s;
  s.detail_bias = 0.25;
  s.lod_lag_frames = {100, 1, 1, 2, 3};
  StreamerStats& t = s.streamer;
  for (size_t p : {0u, 1u, 2u, 8u}) {
    t.pages_read[p] = t.pages_uploaded[p] = 120 + p;
    t.bytes_read[p] = 2'345'678;
    t.bytes_decoded[p] = t.bytes_uploaded[p] = (120 + p) * 73'984;
    for (size_t state = 1; state < kPageStates; ++state) t.pages[state][p] = 10 * state + p;
  }
  s.mm_per_px = 0.042;
  t.hits = 990, t.misses = 10, t.evictions = 5, t.retries = 3, t.failed_pages = 1;
  t.cancelled = 9, t.cancelled_before_read = 6, t.cancelled_before_decode = 2, t.cancelled_after_decode = 1;
  t.prefetched = 20, t.prefetch_used = 15, t.prefetch_wasted = 2, t.deferred = 7;
  t.latency_ms = {.count = 400, .p50 = 18, .p90 = 33, .p99 = 51};
  t.latency_frames = {.count = 400, .p50 = 1, .p90 = 2, .p99 = 3};
  return s;
}

TEST(HudFigures, NameEveryPlaneInUseAndEveryCounter) {
  Manifest manifest;
  manifest.texture.basis = Basis::kPtmLrgb;
  HudFigures f = hudFigures(busyStats(), manifest);
  ASSERT_EQ(f.planes.size(), 5u);
  EXPECT_EQ(f.planes[1],
            (std::vector<std::string>{"a0-a2", "10", "20", "30", "40", "50", "2.35 MB", "8.88 MB", "8.88 MB"}));
  EXPECT_EQ(f.planes[4][0], "relief");
  EXPECT_EQ(f.planes[4][1], "18");
  std::string lines;
  for (const auto& l : f.lines) lines += l + "\n";
  for (const char* part : {"hits 99.0 %", "misses 10", "evictions 5", "retries 3", "failed 1",
                           "cancelled 9: 6 to read, 2 to decode, 1 decoded", "prefetched 20   used 15   wasted 2",
                           "bias 0.25", "no room for 7", "patch list p99 2 frames old",
                           "perspective (O)   0.042 mm a px at the target", "p50 18 ms (1 frames)", "p99 51 (3)"})
    EXPECT_NE(lines.find(part), std::string::npos) << part << " in\n" << lines;
  EngineStats parallel = busyStats();
  parallel.orthographic = true;
  EXPECT_EQ(hudFigures(parallel, manifest).lines[5], "orthographic (O)   0.042 mm a px");
  EngineStats blocks = busyStats();
  blocks.upload = PageCodec::kBc7;
  blocks.streamer.resident_bytes = 8'140'000, blocks.cache_bytes = 66'000'000, blocks.texture_bytes = 12'300'000;
  EXPECT_EQ(hudFigures(blocks, manifest).lines[0],
            "upload bc7 blocks   resident 8.14 MB of 66.0 MB   GPU textures 12.3 MB");
  blocks.upload = PageCodec::kLossless, blocks.why_not_blocks = "a reason";
  EXPECT_EQ(hudFigures(blocks, manifest).lines[0].substr(0, 12), "upload rgba8");
  EXPECT_EQ(hudFigures(blocks, manifest).lines[1], "no blocks: a reason");
  HudFigures idle = hudFigures({}, manifest);
  EXPECT_EQ(idle.planes.size(), 1u) << "planes that are not in use stay away";
  EXPECT_EQ(idle.lines.size() + 1, f.lines.size()) << "no latency before the first page";
}

TEST(HudFigures, BytesHaveThreeDigits) {
  for (auto [bytes, text] : std::initializer_list<std::pair<uint64_t, const char*>>{{0, "0 B"},
                                                                                    {999, "999 B"},
                                                                                    {1000, "1.00 kB"},
                                                                                    {9994, "9.99 kB"},
                                                                                    {9996, "10.0 kB"},
                                                                                    {123456, "123 kB"},
                                                                                    {999499, "999 kB"},
                                                                                    {999600, "1.00 MB"},
                                                                                    {4060000000, "4.06 GB"},
                                                                                    {5000000000000000, "5000 TB"}})
    EXPECT_EQ(bytesText(bytes), text);
}

TEST(Hud, ThePanelStandsBelowTheLineWithinThePicture) {
  Manifest manifest;
  manifest.texture.basis = Basis::kPtmLrgb;
  auto hud = Hud::create(gltest::api(), 1);
  ASSERT_TRUE(hud.ok());
  Picture picture;
  (*hud)->draw({.message = "hello", .figures = hudFigures(busyStats(), manifest)}, kWidth, kHeight);
  EXPECT_GT(picture.touched(0, 60, kWidth, 240), 20000);
  EXPECT_EQ(picture.touched(0, 285, kWidth, kHeight), 0) << "it leaves the artwork free";
  EXPECT_EQ(picture.touched(kWidth - 4, 0, kWidth, kHeight), 0) << "and is not cut off";
  glClear(GL_COLOR_BUFFER_BIT);
  (*hud)->draw({.message = "hello"}, kWidth, kHeight);
  EXPECT_EQ(picture.touched(0, 60, kWidth, kHeight), 0) << "and goes again";
}

TEST(Overlay, ClipsToItsRectangle) {
  const uint8_t white[4] = {255, 255, 255, 255};
  auto pass = OverlayPass::create(gltest::api(), 2, 2, white);
  ASSERT_TRUE(pass.ok()) << pass.error().text();
  Picture picture;
  const OverlayVertex corners[3] = {{-kWidth, 0, 0, 0, ~0u}, {3 * kWidth, 0, 0, 0, ~0u}, {0, 4 * kHeight, 0, 0, ~0u}};
  const uint16_t indices[3] = {0, 1, 2};
  const OverlayCommand command{.clip = {10, 20, 40, 50}, .indices = 3};
  pass->draw(corners, indices, {&command, 1}, kWidth, kHeight);
  EXPECT_EQ(picture.touched(10, 20, 40, 50), 30 * 30);
  EXPECT_EQ(picture.touched(0, 0, kWidth, kHeight), 30 * 30);
}

TEST(Viewer, SnapshotsTakeTheFirstFreeNumber) {
  const auto folder = std::filesystem::temp_directory_path() / ("relievo-snapshot-" + std::to_string(getpid()));
  std::filesystem::create_directories(folder);
  EXPECT_EQ(freeSnapshotName(folder.string(), "coin"), (folder / "coin-0001.png").string());
  for (const char* taken : {"coin-0001.png", "coin-0002.png", "coin-0004.png"}) std::ofstream(folder / taken) << "x";
  EXPECT_EQ(freeSnapshotName(folder.string(), "coin"), (folder / "coin-0003.png").string());
  std::filesystem::remove_all(folder);
}

TEST(Viewer, BackgroundShowsWhereTheArtworkIsNot) {
  const std::vector<uint8_t> rgba = {1, 2, 3, 255, 9, 9, 9, 0};
  EXPECT_EQ(overBackground(rgba, {24, 25, 26}), (std::vector<uint8_t>{1, 2, 3, 24, 25, 26}));
  // Half of white over black is half of its light, 188 in sRGB (IEC 61966-2-1), not half of its number.
  const std::vector<uint8_t> half = {255, 255, 255, 128};
  EXPECT_EQ(overBackground(half, {0, 0, 0}), (std::vector<uint8_t>{188, 188, 188}));
}

}  // namespace hud_gltest
}  // namespace relievo
