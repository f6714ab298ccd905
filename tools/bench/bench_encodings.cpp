// bench_encodings.cpp - what each page encoding costs in accuracy, size and time. The package's pages are decoded,
// encoded anew and shown by the engine, which sees no difference to a package built that way: relit pictures against
// those of the package as it is.
#include <time.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <mutex>
#include <numbers>
#include <unordered_map>

#include "src/base/file.h"
#include "src/base/parallel_for.h"
#include "src/engine/engine.h"
#include "src/render/block_formats.h"
#include "texturing/codec/page_codec.h"
#include "texturing/package/package_layout.h"
#include "tools/bench/bench_groups.h"
#include "tools/bench/encodings_plot.h"

namespace relievo {
namespace {

struct Choice {
  const char* coefficients;
  const char* colour;
  bool quick;  // is measured in a quick run, too
};
constexpr Choice kChoices[] = {{"lossless", "lossless", true},
                               {"q7", "q7", false},
                               {"q6", "q6", true},
                               {"q5", "q5", true},
                               {"q4", "q4", false},
                               {"q6", "jpeg90", false},
                               {"jpeg98", "jpeg98", false},
                               {"jpeg95", "jpeg95", false},
                               {"jpeg90", "jpeg90", true},
                               {"jpeg75", "jpeg75", false},
                               {"jpeg50", "jpeg50", false},
                               {"bc4", "bc4", true},
                               {"bc5", "bc5", false},
                               {"bc7", "bc7", true},
                               {"bc1", "bc1", true},
                               {"bc4", "bc1", false}};
constexpr std::array<double, 3> kLights[] = {{0.6, 0.4, 0.7}, {-0.8, 0.1, 0.5}, {0.1, -0.5, 0.85}};

double threadSeconds() { return benchCpuSeconds(CLOCK_THREAD_CPUTIME_ID); }

std::string nameOf(const Choice& c) {
  return std::string(c.coefficients) == c.colour ? c.colour : std::string(c.coefficients) + "+" + c.colour;
}

// The package's texture pages in other encodings, made when first read; relief as it is.
class EncodedAnew final : public PageSource {
 public:
  EncodedAnew(std::shared_ptr<const Package> package, const PlaneEncodings& encodings)
      : package_(std::move(package)), encodings_(encodings) {}
  Result<EncodedPage> read(PageId id) const override {
    if (!isTexturePlane(id.plane())) return package_->read(id);
    {
      std::lock_guard lock(mutex_);
      if (auto found = pages_.find(id); found != pages_.end()) return EncodedPage{found->second};
    }
    auto page = package_->read(id);
    if (!page) return page.error();
    std::vector<uint8_t> channels(kTexturePageBytes);
    if (auto decoded = PageDecoder().decodeTexture(page->bytes, channels); !decoded) return decoded.error();
    PageEncoder encoder(1);
    auto bytes = encoder.encodeTexture(channels, encodings_[static_cast<size_t>(texturePlaneIndex(id.plane()))]);
    std::lock_guard lock(mutex_);
    return EncodedPage{pages_.emplace(id, std::vector<uint8_t>(bytes.begin(), bytes.end())).first->second};
  }

 private:
  std::shared_ptr<const Package> package_;
  PlaneEncodings encodings_;
  mutable std::mutex mutex_;
  mutable std::unordered_map<PageId, std::vector<uint8_t>> pages_;
};

struct View {
  OrbitCamera camera;
  int width = 0, height = 0;
};

struct Measured {
  double squared = 0, samples = 0;
  int max = 0;
  void add(const std::vector<uint8_t>& a, const std::vector<uint8_t>& b) {
    for (size_t i = 0; i + 3 < a.size(); i += 4) {
      if (a[i + 3] == 0 || b[i + 3] == 0) continue;
      for (size_t c = 0; c < 3; ++c) {
        int d = std::abs(a[i + c] - b[i + c]);
        squared += d * d;
        max = std::max(max, d);
      }
      samples += 3;
    }
  }
  double psnr() const { return squared > 0 ? 10 * std::log10(255.0 * 255.0 * samples / squared) : 99; }
};

// Every n-th texture node of the package, coarse ones included, so that a fraction of the pages stands for all.
std::vector<NodeId> sampledNodes(const FlatDomain& d, uint64_t n) {
  std::vector<NodeId> nodes;
  uint64_t serial = 0;
  for (int level = d.texture_depth; level >= 0; --level) {
    NodeGrid grid = d.nodeGrid(level);
    for (uint64_t y = 0; y < grid.rows; ++y)
      for (uint64_t x = 0; x < grid.columns; ++x)
        if (serial++ % n == 0) nodes.push_back(d.nodeAt(level, x, y));
  }
  return nodes;
}

// The largest difference, in relit pixels, of what two neighbouring pages of the finest level hold of the same texels.
Result<double> seamOf(const EncodedAnew& source, const Manifest& m, int pairs) {
  const FlatDomain d = m.domain.flat();
  const NodeGrid grid = d.nodeGrid(d.texture_depth);
  const int planes = m.texture.planes();
  PageDecoder decoder;
  auto page = [&](uint64_t x, uint64_t y, std::vector<uint8_t>& channels) -> Result<void> {
    channels.resize(kTexturePageBytes * static_cast<size_t>(planes));
    for (int k = 0; k < planes; ++k) {
      auto bytes = source.read(PageId(texturePlane(k), d.nodeAt(d.texture_depth, x, y)));
      if (!bytes) return bytes.error();
      auto out = std::span(channels).subspan(kTexturePageBytes * static_cast<size_t>(k), kTexturePageBytes);
      if (auto decoded = decoder.decodeTexture(bytes->bytes, out); !decoded) return decoded;
    }
    return {};
  };
  double worst = 0;
  std::vector<uint8_t> left, right;
  for (int i = 0; i < pairs && grid.columns > 1; ++i) {
    const uint64_t x = static_cast<uint64_t>(i) * 7 % (grid.columns - 1), y = static_cast<uint64_t>(i) * 5 % grid.rows;
    if (auto r = page(x, y, left); !r) return r.error();
    if (auto r = page(x + 1, y, right); !r) return r.error();
    for (size_t row = 0; row < kPageFullPx; ++row) {
      for (size_t column = 0; column < 2 * kPageBorderPx; ++column) {
        std::array<double, 18> a{}, b{};
        for (int c = 0; c < m.texture.channels(); ++c) {
          const size_t at = (static_cast<size_t>(c) * kPageFullPx + row) * kPageFullPx + column;
          a[static_cast<size_t>(c)] = left[at + kPagePx], b[static_cast<size_t>(c)] = right[at];
        }
        for (const auto& light : kLights) {
          auto n = normalizedLight(light);
          auto p = evaluatePixel(m.texture, a.data(), n[0], n[1]), q = evaluatePixel(m.texture, b.data(), n[0], n[1]);
          for (size_t c = 0; c < 3; ++c) worst = std::max(worst, std::abs(p[c] - q[c]));
        }
      }
    }
  }
  return worst;
}

class EncodingsBench {
 public:
  explicit EncodingsBench(BenchContext& context) : context_(context), manifest_(context.package->manifest()) {
    const FlatDomain d = manifest_.domain.flat();
    const int width = context.quick ? 320 : 1280, height = context.quick ? 180 : 720;
    View minified{fitCamera(d, width, height), width, height};
    View close = minified;  // a texel a pixel
    close.camera.distance_mm = height * d.mm_per_px / (2 * std::tan(close.camera.fov_deg * std::numbers::pi / 360));
    views_ = {close, minified};
    nodes_ = sampledNodes(d, context.quick ? 16 : 1);
  }

  Result<void> run(const Choice& choice) {
    auto coefficients = parseEncoding(choice.coefficients, 90), colour = parseEncoding(choice.colour, 90);
    if (!coefficients) return coefficients.error();
    if (!colour) return colour.error();
    const PlaneEncodings encodings = planeEncodings(manifest_.texture, *coefficients, *colour);
    auto source = std::make_shared<EncodedAnew>(context_.package, encodings);
    EncodingFigures f;
    f.name = nameOf(choice);
    if (auto done = encodeAll(*source, &f); !done) return done;
    if (context_.stopped()) return {};
    if (auto done = decodeSpeed(*source, &f); !done) return done;
    Artwork artwork = artworkFromPackage(context_.package);
    artwork.source = source;
    artwork.manifest.encodings = encodings;
    std::vector<std::vector<uint8_t>> pictures;
    if (auto done = show(artwork, Upload::kRgba8, &f.rgba8, &pictures); !done) return done;
    if (truth_.empty()) truth_ = pictures;
    Measured all;
    for (size_t i = 0; i < pictures.size(); ++i) all.add(truth_[i], pictures[i]);
    f.psnr_db = all.psnr();
    f.max_error = all.max;
    f.exact = all.max == 0;
    if (const auto codec = commonBlockCodec(artwork.manifest);
        codec && !missingBlockExtension(*codec, gl::currentContextInfo().api)) {
      f.as_blocks = true;
      std::vector<std::vector<uint8_t>> blocks;
      if (auto done = show(artwork, Upload::kBlocks, &f.blocks, &blocks); !done) return done;
      Measured beside;
      for (size_t i = 0; i < blocks.size(); ++i) beside.add(pictures[i], blocks[i]);
      f.blocks_differ = beside.max;
    }
    auto seam = seamOf(*source, manifest_, context_.quick ? 4 : 32);
    if (!seam) return seam.error();
    f.seam = *seam;
    report(f);
    figures_.push_back(f);
    return {};
  }

  Result<void> writePlots() const {
    if (context_.plots.empty()) return {};
    for (auto [name, text] :
         {std::pair{"/encodings.svg", encodingsPlot(figures_)}, {"/encodings.md", encodingsTable(figures_)}}) {
      if (auto written = writeFile(context_.plots + name, {reinterpret_cast<const uint8_t*>(text.data()), text.size()});
          !written)
        return written;
    }
    return {};
  }

 private:
  // Every sampled page, by all cores.
  Result<void> encodeAll(const EncodedAnew& source, EncodingFigures* f) {
    std::mutex mutex;
    uint64_t bytes = 0;
    std::atomic<bool> failed{false};
    Result<void> status;
    const double start = benchCpuSeconds();
    parallelFor(nodes_.size(), 0, &failed, [&](size_t i) {
      if (context_.stopped()) return;
      uint64_t size = 0;
      for (int k = 0; k < manifest_.texture.planes(); ++k) {
        auto page = source.read(PageId(texturePlane(k), nodes_[i]));
        std::lock_guard lock(mutex);
        if (!page) {
          status = page.error();
          failed = true;
          return;
        }
        size += page->bytes.size();
      }
      std::lock_guard lock(mutex);
      bytes += size;
    });
    if (!status.ok()) return status;
    f->encode_cpu_s = benchCpuSeconds() - start;
    const uint64_t all = packageLayout(manifest_.domain, manifest_.texture, 0, 0).texture.nodeCount();
    const double share = static_cast<double>(nodes_.size()) / static_cast<double>(all);
    f->bytes_per_px = static_cast<double>(bytes) / share / manifest_.domain.texelCount();
    return {};
  }

  Result<void> decodeSpeed(const EncodedAnew& source, EncodingFigures* f) {
    std::vector<std::pair<Plane, std::vector<uint8_t>>> pages;
    const size_t step = std::max<size_t>(1, nodes_.size() / (context_.quick ? 16 : 100));
    for (size_t i = 0; i < nodes_.size(); i += step) {
      for (int k = 0; k < manifest_.texture.planes(); ++k) {
        auto page = source.read(PageId(texturePlane(k), nodes_[i]));
        if (!page) return page.error();
        pages.emplace_back(texturePlane(k), std::move(page->bytes));
      }
    }
    PageDecoder decoder;
    std::vector<uint8_t> slot(kSlotBytes);
    std::vector<double> seconds;
    for (int repeat = 0; repeat < (context_.quick ? 3 : 9); ++repeat) {
      const double start = threadSeconds();
      for (const auto& [plane, bytes] : pages)
        if (auto decoded = decoder.decodeToSlot(plane, bytes, slot); !decoded) return decoded;
      seconds.push_back(threadSeconds() - start);
    }
    f->decode_us = median(seconds) * 1e6 / static_cast<double>(pages.size());
    return {};
  }

  // Every view under every light, and what showing them costs.
  Result<void> show(const Artwork& artwork, Upload upload, EncodingFigures::Shown* f,
                    std::vector<std::vector<uint8_t>>* out) {
    Scene scene;
    scene.relief = false;  // it is the same for all
    scene.light = kLights[0];
    const EngineOptions options{.upload = upload, .interrupted = context_.interrupted};
    if (truth_.empty() || upload == Upload::kBlocks) {  // links the shaders
      auto engine = Engine::create(artwork, scene, options);
      if (!engine) return engine.error();
      if (auto settled = (*engine)->settle(60); !settled) return settled;
    }
    for (const View& view : views_) {
      const double start = benchSeconds(), start_cpu = benchCpuSeconds();
      auto engine = Engine::create(artwork, scene, options);
      if (!engine) return engine.error();
      Engine& e = **engine;
      e.resize(view.width, view.height);
      e.setCamera(view.camera);
      for (const auto& light : kLights) {
        scene.light = light;
        if (auto set = e.setScene(scene); !set) return set;
        if (auto settled = e.settle(60); !settled) return settled;
        if (&light == &kLights[0] && &view == &views_[0] && !context_.quick) {
          f->settle_ms = (benchSeconds() - start) * 1e3;
          f->settle_cpu_ms = (benchCpuSeconds() - start_cpu) * 1e3;
        }
        out->push_back(e.readPixels());
      }
      scene.light = kLights[0];
      if (&view != &views_[0]) continue;
      const EngineStats stats = e.stats();
      f->resident = static_cast<double>(stats.streamer.resident_bytes) * manifest_.texture.planes() /
                    (static_cast<double>(stats.resident) * kPagePx * kPagePx);
      std::vector<double> ms, cpu_ms;
      const double deadline = benchSeconds() + 5;  // software GL takes a second for a frame of BC7
      for (int i = 0; i < (context_.quick ? 5 : 30) && (i < 5 || benchSeconds() < deadline); ++i) {
        const double t = benchSeconds(), cpu = benchCpuSeconds();
        e.frame(t);
        e.readPixels();
        ms.push_back((benchSeconds() - t) * 1e3);
        cpu_ms.push_back((benchCpuSeconds() - cpu) * 1e3);
      }
      f->frame_ms = median(ms);
      f->frame_cpu_ms = median(cpu_ms);
    }
    return {};
  }

  void report(const EncodingFigures& f) {
    const EncodingFigures& base = figures_.empty() ? f : figures_.front();
    auto row = [&](std::string what, double v, const char* unit, double b, std::string note = "") {
      BenchRow r;
      r.what = f.name + ": " + what;
      r.measured = v;
      r.unit = unit;
      if (!figures_.empty()) r.baseline_name = "lossless", r.baseline = b;
      r.note = std::move(note);
      context_.row(r);
    };
    char note[160];
    if (!f.exact) {
      BenchRow r;
      r.what = f.name + ": relit pictures, PSNR";
      r.measured = f.psnr_db;
      r.unit = "dB";
      context_.row(r);
    }
    row("relit pictures, largest error of 255", f.max_error, "", base.max_error);
    row("largest seam along page edges, of 255", f.seam, "", base.seam);
    row("texture bytes per pixel, mip levels included", f.bytes_per_px, "B", base.bytes_per_px);
    std::snprintf(note, sizeof note, "encoding took %.1f s of CPU", f.encode_cpu_s);
    row("decoding, a thread", 1e6 / f.decode_us, "pages/s", 1e6 / base.decode_us, note);
    const auto shown = [&](const char* upload, const EncodingFigures::Shown& s, const EncodingFigures& b) {
      int n = std::snprintf(note, sizeof note, "%.1f ms of CPU, lossless %.1f", s.frame_cpu_ms, b.rgba8.frame_cpu_ms);
      if (!context_.quick)  // which encodes its pages on the way
        std::snprintf(note + n, sizeof note - static_cast<size_t>(n),
                      "; start to settled %.0f ms of CPU, lossless %.0f", s.settle_cpu_ms, b.rgba8.settle_cpu_ms);
      row(std::string("frame at a texel a pixel, ") + upload, s.frame_ms, "ms", b.rgba8.frame_ms, note);
    };
    row("resident bytes per texel, rgba8", f.rgba8.resident, "B", base.rgba8.resident);
    shown("rgba8", f.rgba8, base);
    if (!f.as_blocks) return;
    std::snprintf(note, sizeof note, "pictures differ from rgba8 by %d of 255 at most", f.blocks_differ);
    row("resident bytes per texel, blocks", f.blocks.resident, "B", base.rgba8.resident, note);
    shown("blocks", f.blocks, base);
  }

  BenchContext& context_;
  const Manifest& manifest_;
  std::vector<View> views_;
  std::vector<NodeId> nodes_;
  std::vector<std::vector<uint8_t>> truth_;  // the pictures of the first choice
  std::vector<EncodingFigures> figures_;
};

}  // namespace

Result<void> encodingsBench(BenchContext& context) {
  EncodingsBench bench(context);
  for (const Choice& choice : kChoices) {
    if (context.quick && !choice.quick) continue;
    if (context.stopped()) return {};
    if (context.package->manifest().texture.basis == Basis::kColour &&
        std::string(choice.coefficients) != choice.colour)
      continue;
    if (auto done = bench.run(choice); !done) return done;
  }
  return bench.writePlots();
}

}  // namespace relievo
