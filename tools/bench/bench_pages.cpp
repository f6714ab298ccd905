// bench_pages.cpp - a page's way: how long it takes, how many of them a second, and what that does to the frames
// meanwhile.
#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <random>

#include "src/engine/engine.h"
#include "src/render/page_pool.h"
#include "src/render/picture_target.h"
#include "texturing/codec/page_codec.h"
#include "texturing/import/image_io.h"
#include "texturing/stream/page_sources.h"
#include "texturing/stream/page_streamer.h"
#include "tools/bench/bench_groups.h"

namespace relievo {
namespace {

constexpr int kWorkers = 2;

std::string text(const char* format, double a, double b = 0, double c = 0, double d = 0) {
  char out[200];
  std::snprintf(out, sizeof out, format, a, b, c, d);
  return out;
}

std::vector<NodeId> nodesOfLevel(const PatchDomain& d, int level) {
  std::vector<NodeId> nodes;
  for (uint32_t p = 0; p < d.patchCount(); ++p)
    for (uint32_t y = 0; y < 1u << level; ++y)
      for (uint32_t x = 0; x < 1u << level; ++x)
        if (NodeId n{p, static_cast<uint32_t>(level), x, y}; d.nodeExists(n)) nodes.push_back(n);
  return nodes;
}

// Looking straight at a place given in texels, a texel being `zoom` pixels on screen.
OrbitCamera above(const FlatDomain& d, double x_px, double y_px, double zoom) {
  OrbitCamera c;
  c.target_mm = {(x_px - 0.5 * static_cast<double>(d.width_px)) * d.mm_per_px,
                 (0.5 * static_cast<double>(d.height_px) - y_px) * d.mm_per_px, 0};
  c.distance_mm = d.mm_per_px * kBenchHeight / (2 * zoom * std::tan(c.fov_deg * std::numbers::pi / 360));
  return c;
}

uint64_t sum(const StreamerStats::ByPlane& counts) {
  uint64_t total = 0;
  for (uint64_t n : counts) total += n;
  return total;
}

// Every texture page of the package, nodes of one level after the other.
std::vector<PageId> texturePages(const Manifest& m) {
  std::vector<PageId> pages;
  for (int level = m.domain.texture_depth; level >= 0; --level)
    for (const NodeId& n : nodesOfLevel(m.domain, level))
      for (int k = 0; k < m.texture.planes() && m.domain.hasTexturePage(n); ++k) pages.emplace_back(texturePlane(k), n);
  return pages;
}

}  // namespace

// Moves from one finest node to another, far away; each brings one node into view (and, at first, some of its
// ancestors).
Result<void> pageLatencyBench(BenchContext& context) {
  const Manifest& m = context.package->manifest();
  const FlatDomain d = m.domain.flat();
  std::vector<NodeId> nodes = nodesOfLevel(d, d.texture_depth);
  // Whole nodes only, so that the view shows one and no border.
  std::erase_if(nodes, [&](const NodeId& n) {
    return d.patchOriginX(n.patch) + uint64_t{n.x + 1} * kPagePx > d.width_px ||
           d.patchOriginY(n.patch) + uint64_t{n.y + 1} * kPagePx > d.height_px;
  });
  std::mt19937 random(1);
  std::shuffle(nodes.begin(), nodes.end(), random);
  nodes.resize(std::min<size_t>(nodes.size(), context.quick ? 40 : 200));
  if (nodes.empty()) return {};

  // Peer: the page read, decoded and uploaded within the frame that wants it.
  std::vector<double> blocking_ms;
  PagePool pool(64);
  PageDecoder decoder;
  std::vector<uint8_t> texels(kSlotBytes);
  for (const NodeId& n : nodes) {
    double start = benchSeconds();
    for (int k = 0; k < m.texture.planes(); ++k) {
      PageId id(texturePlane(k), n);
      auto page = context.package->read(id);
      if (!page) return page.error();
      if (auto decoded = decoder.decodeToSlot(id.plane(), page->bytes, texels); !decoded) return decoded;
      PageUpload upload{static_cast<SlotIndex>(k), id, texels.data()};
      pool.upload({&upload, 1});
      finishFrame();
    }
    blocking_ms.push_back((benchSeconds() - start) * 1000);
  }

  Scene scene;
  scene.relief = false;
  auto made = Engine::create(artworkFromPackage(context.package), scene, {.cache_mib = 256, .workers = kWorkers});
  if (!made) return made.error();
  Engine& e = **made;
  e.resize(kBenchWidth, kBenchHeight);
  std::vector<double> frame_ms, frames_to_picture, ms_to_picture;
  for (const NodeId& n : nodes) {
    double side = kPagePx << (d.texture_depth - static_cast<int>(n.level));
    e.setCamera(above(d, static_cast<double>(d.patchOriginX(n.patch)) + (n.x + 0.5) * side,
                      static_cast<double>(d.patchOriginY(n.patch)) + (n.y + 0.5) * side, 12.8));
    double moved = benchSeconds();
    int frames = 0;
    for (int calm = 0; calm < 3 && frames < 600; ++frames) {
      double start = benchSeconds();
      e.frame(start);
      finishFrame();
      frame_ms.push_back((benchSeconds() - start) * 1000);
      const auto& requests = e.textureRequests();
      bool named = std::any_of(requests.begin(), requests.end(), [&](const NodeRequest& w) { return w.node == n; });
      bool there = named && e.stats().missing_pages == 0;
      if (there && calm == 0) {
        frames_to_picture.push_back(frames + 1);
        ms_to_picture.push_back((benchSeconds() - moved) * 1000);
      }
      calm = there ? calm + 1 : 0;
    }
    if (context.stopped()) return {};
  }
  const StreamerStats s = e.stats().streamer;
  std::string moves = text("%.0f moves, %.0f pages; frames of %.1f ms", static_cast<double>(nodes.size()),
                           static_cast<double>(s.latency_frames.count), median(frame_ms));
  context.row({.what = "wanted to visible, p99, frames",
               .measured = s.latency_frames.p99,
               .unit = "frames",
               .goal = 2,
               .baseline_name = "p50",
               .baseline = s.latency_frames.p50,
               .note = moves});
  context.row({.what = "wanted to visible, p50",
               .measured = s.latency_ms.p50,
               .unit = "ms",
               .baseline_name = "node read, decoded, uploaded within the frame",
               .baseline = median(blocking_ms)});
  context.row({.what = "wanted to visible, p99",
               .measured = s.latency_ms.p99,
               .unit = "ms",
               .baseline_name = "node read, decoded, uploaded within the frame",
               .baseline = quantile(blocking_ms, 0.99)});
  context.row({.what = "camera moved to visible, p99, frames",
               .measured = quantile(frames_to_picture, 0.99),
               .unit = "frames",
               .baseline_name = "p50",
               .baseline = median(frames_to_picture),
               .note = text("%.1f ms p99, with LOD, feedback and its way back", quantile(ms_to_picture, 0.99))});
  return {};
}

namespace {

// One thread: reading and checking, decoding, uploading apart.
struct StepTimes {
  double read_s = 0, decode_s = 0, upload_s = 0;  // of `counted` pages: the first tenth warms up
  double counted = 0;
  double bytes_a_page = 0;  // encoded
};
Result<StepTimes> timeSteps(const Package& package, std::span<const PageId> pages) {
  StepTimes times;
  size_t encoded_bytes = 0;
  PageDecoder decoder;
  PagePool pool(1024);
  std::vector<uint8_t> texels(kSlotBytes);
  for (size_t i = 0; i < pages.size(); ++i) {
    double t0 = benchSeconds();
    auto page = package.read(pages[i]);
    if (!page) return page.error();
    double t1 = benchSeconds();
    if (auto decoded = decoder.decodeToSlot(pages[i].plane(), page->bytes, texels); !decoded) return decoded.error();
    double t2 = benchSeconds();
    PageUpload upload{static_cast<SlotIndex>(i % 1024), pages[i], texels.data()};
    pool.upload({&upload, 1});
    if (i % 64 == 63) finishFrame();
    double t3 = benchSeconds();
    if (i >= pages.size() / 10) times.read_s += t1 - t0, times.decode_s += t2 - t1, times.upload_s += t3 - t2;
    encoded_bytes += page->bytes.size();
  }
  times.counted = static_cast<double>(pages.size() - pages.size() / 10);
  times.bytes_a_page = static_cast<double>(encoded_bytes) / static_cast<double>(pages.size());
  return times;
}

// Peer: pages of the same texels as PNG files, by OpenImageIO. Pages a second.
Result<double> pngRate(BenchContext& context, std::span<const PageId> pages) {
  double png_s = 0;
  const int png_pages = context.quick ? 60 : 200;
  PageDecoder decoder;
  std::vector<uint8_t> channels(kTexturePageBytes), rgb(kTexturePageBytes);
  for (int i = 0; i < png_pages; ++i) {
    PageId id = pages[static_cast<size_t>(i) * pages.size() / static_cast<size_t>(png_pages)];
    auto page = context.package->read(id);
    if (!page) return page.error();
    if (auto decoded = decoder.decodeTexture(page->bytes, channels); !decoded) return decoded.error();
    constexpr size_t kPlane = size_t{kPageFullPx} * kPageFullPx;
    for (size_t p = 0; p < kPlane; ++p)
      for (size_t c = 0; c < 3; ++c) rgb[3 * p + c] = channels[c * kPlane + p];
    std::string file = context.folder + "/page.png";
    if (auto written = writeImage(file, kPageFullPx, kPageFullPx, 3, rgb); !written) return written.error();
    double start = benchSeconds();
    auto image = readImage8(file);
    if (!image) return image.error();
    png_s += benchSeconds() - start;
  }
  return png_pages / png_s;
}

// The engine's way.
struct StreamTimes {
  double wall_s = 0, cpu_s = 0;
  double uploaded = 0;  // pages
};
StreamTimes timeStreaming(BenchContext& context, std::span<const PageId> pages) {
  const Manifest& m = context.package->manifest();
  const int planes = m.texture.planes();
  const size_t slots = std::max<size_t>(600, pages.size() / 10);
  StreamerOptions options;
  options.slot_count = static_cast<uint32_t>(slots);
  options.workers = kWorkers;
  options.format = m.texture;
  for (int k = 0; k < planes; ++k) options.texture_planes.push_back(texturePlane(k));
  PageStreamer streamer(context.package, options);
  PagePool pool(options.slot_count);
  const size_t batch =
      slots / static_cast<size_t>(planes) / 2;  // nodes wanted at a time; another half waits to be replaced
  uint64_t frame = 0;
  double limit_s = context.quick ? 2 : 6, start = benchSeconds(), cpu_start = benchCpuSeconds();
  std::vector<NodeRequest> requests;
  for (size_t first = 0; benchSeconds() - start < limit_s && !context.stopped(); first += batch / 4) {
    requests.clear();
    for (size_t i = 0; i < batch; ++i) {
      size_t node = (first + i) % (pages.size() / static_cast<size_t>(planes));
      requests.push_back({pages[node * static_cast<size_t>(planes)].node(), 1, 0.5f});
    }
    std::sort(requests.begin(), requests.end(),
              [](const NodeRequest& a, const NodeRequest& b) { return a.node.level < b.node.level; });
    // The window moves on before the workers run dry.
    do {
      streamer.beginFrame(++frame, benchSeconds());
      streamer.requestTexture(requests);
      pool.upload(streamer.placeReady(64));
      pool.uploadTable(streamer.table());
      submitFrame();
    } while (streamer.stats().queued > static_cast<uint64_t>(planes) * batch / 8);
  }
  finishFrame();
  StreamTimes times;
  times.wall_s = benchSeconds() - start;
  times.cpu_s = benchCpuSeconds() - cpu_start;
  times.uploaded = static_cast<double>(sum(streamer.stats().pages_uploaded));
  return times;
}

}  // namespace

// All texture pages of the package through source, workers and uploads, without drawing; the cache holds a tenth of
// them.
Result<void> decodeBench(BenchContext& context) {
  const Manifest& m = context.package->manifest();
  const int planes = m.texture.planes();
  const std::vector<PageId> pages = texturePages(m);
  auto steps =
      timeSteps(*context.package, std::span(pages).first(std::min<size_t>(pages.size(), context.quick ? 600 : 2000)));
  if (!steps) return steps.error();
  auto png = pngRate(context, pages);
  if (!png) return png.error();
  const StreamTimes streaming = timeStreaming(context, pages);
  const double rate = streaming.uploaded / streaming.wall_s;
  const double one_thread = steps->counted / (steps->read_s + steps->decode_s + steps->upload_s);
  std::string cost = text("%.0f us of processor time a page: %.0f pages/s on 2 free cores",
                          1e6 * streaming.cpu_s / streaming.uploaded, 2 * streaming.uploaded / streaming.cpu_s);
  context.row({.what = "pages of one plane, read, decoded, uploaded, " + std::to_string(kWorkers) + " workers",
               .measured = rate,
               .unit = "pages/s",
               .goal = 5000,
               .at_most = false,
               .baseline_name = "on one thread, one after the other",
               .baseline = one_thread,
               .note = cost});
  context.row({.what = "the same in nodes of " + std::to_string(planes) + " planes",
               .measured = rate / planes,
               .unit = "nodes/s",
               .baseline_name = "on one thread, one after the other",
               .baseline = one_thread / planes});
  context.row({.what = "decode alone, one thread",
               .measured = steps->counted / steps->decode_s,
               .unit = "pages/s",
               .at_most = false,
               .baseline_name = "PNG by OpenImageIO",
               .baseline = *png,
               .note = text("%.1f KB a page", steps->bytes_a_page / 1000)});
  context.row({.what = "read and checksum alone, one thread",
               .measured = steps->counted / steps->read_s,
               .unit = "pages/s",
               .baseline_name = "uploads alone",
               .baseline = steps->counted / steps->upload_s});
  return {};
}

// A path over the artwork at one texel a pixel, as fast as it takes to bring in about 1,000 pages a second, in a cache
// that holds little more than the view. Baseline: the same cameras with everything resident.
Result<void> streamingBench(BenchContext& context) {
  const Manifest& m = context.package->manifest();
  const FlatDomain d = m.domain.flat();
  constexpr double kWantedRate = 1000;
  const double seconds = context.quick ? 2.5 : 8;
  Scene scene;
  scene.relief = false;
  const double pages_in_view = (kBenchWidth / 128.0 + 1) * (kBenchHeight / 128.0 + 1) * 1.4 * m.texture.planes();
  const auto mib = [](double pages) { return pages * static_cast<double>(kSlotBytes) / (1024 * 1024); };
  auto made = Engine::create(artworkFromPackage(context.package), scene,
                             {.cache_mib = mib(2 * pages_in_view), .workers = kWorkers});
  if (!made) return made.error();
  auto whole =
      Engine::create(artworkFromPackage(context.package), scene,
                     {.cache_mib = mib(1.5 * static_cast<double>(texturePages(m).size()) + 64), .workers = kWorkers});
  if (!whole) return whole.error();
  (*made)->resize(kBenchWidth, kBenchHeight);
  (*whole)->resize(kBenchWidth, kBenchHeight);

  // Lines to and fro, the middle of the view within the artwork.
  const double left = std::min(0.5 * kBenchWidth, 0.5 * static_cast<double>(d.width_px)),
               right = static_cast<double>(d.width_px) - left;
  const double top = std::min(0.5 * kBenchHeight, 0.5 * static_cast<double>(d.height_px)),
               bottom = static_cast<double>(d.height_px) - top;
  auto cameraAfter = [&](double px) {
    double width = std::max(1.0, right - left);
    auto line = static_cast<int64_t>(px / width);
    double x = px - static_cast<double>(line) * width,
           y = std::fmod(static_cast<double>(line) * 0.45 * kBenchHeight, std::max(1.0, bottom - top));
    return above(d, line % 2 == 0 ? left + x : right - x, top + y, 1);
  };

  double speed = kWantedRate * 128 / ((kBenchHeight / 128.0 + 1) * 1.33 * m.texture.planes());  // px/s
  struct Frames {
    std::vector<double> ms, at_px;
    double rate = 0;
    uint64_t pages = 0;
  };
  // Runs for `seconds`; without a path, at a speed that holds the rate, else at the cameras of that path.
  auto run = [&](Engine& e, const Frames* path) {
    Frames f;
    // A column of finest nodes every 128 px, and a third more above them. The speed follows what half a second brought.
    double px = 0, start = benchSeconds(), now = start, window_start = start;
    const uint64_t at_start = sum(e.stats().streamer.pages_uploaded);
    uint64_t before = at_start;
    for (size_t i = 0; (path ? i < path->at_px.size() : now - start < seconds) && !context.stopped(); ++i) {
      e.setCamera(cameraAfter(path ? path->at_px[i] : px));
      double t = benchSeconds();
      e.frame(t);
      finishFrame();
      now = benchSeconds();
      f.ms.push_back((now - t) * 1000);
      f.at_px.push_back(px);
      px += std::min(speed * (now - t), 0.7 * kBenchWidth);
      if (now - window_start < 0.5) continue;
      uint64_t pages = sum(e.stats().streamer.pages_uploaded);
      double rate = static_cast<double>(pages - before) / (now - window_start);
      if (!path) speed *= std::clamp(kWantedRate / std::max(1.0, rate), 0.7, 1.4);
      before = pages;
      window_start = now;
    }
    f.pages = sum(e.stats().streamer.pages_uploaded) - at_start;
    f.rate = static_cast<double>(f.pages) / (now - start);
    return f;
  };
  run(**made, nullptr);  // warms up, and finds the speed
  Frames streaming = run(**made, nullptr);
  run(**whole, &streaming);  // brings everything in
  Frames still = run(**whole, &streaming);
  const double most = quantile(streaming.ms, 0.99), still_most = quantile(still.ms, 0.99);
  context.row({.what = "frame time while pages stream, p99 over the median",
               .measured = most - median(streaming.ms),
               .unit = "ms",
               .goal = 2,
               .baseline_name = "same cameras, all resident",
               .baseline = still_most - median(still.ms),
               .note = text("%.0f pages/s, %.0f frames", streaming.rate, static_cast<double>(streaming.ms.size()))});
  context.row({.what = "the same as a ratio, over that with all resident",
               .measured = most / median(streaming.ms) / (still_most / median(still.ms)),
               .unit = "x",
               .goal = 1.25});
  context.row(
      {.what = "median frame time while pages stream",
       .measured = median(streaming.ms),
       .unit = "ms",
       .baseline_name = "same cameras, all resident",
       .baseline = median(still.ms),
       .note = still.pages > 0 ? text("the baseline loaded %.0f pages", static_cast<double>(still.pages)) : ""});
  return {};
}

}  // namespace relievo
