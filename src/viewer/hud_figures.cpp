#include "src/viewer/hud_figures.h"

#include <cstdio>

namespace relievo {
namespace {

template <class... Values>
std::string text(const char* format, Values... values) {
  char out[200];
  std::snprintf(out, sizeof out, format, values...);
  return out;
}

unsigned long long big(uint64_t v) { return v; }

}  // namespace

std::string bytesText(uint64_t bytes) {
  if (bytes < 1000) return std::to_string(bytes) + " B";
  double v = static_cast<double>(bytes);
  const char* units[] = {"kB", "MB", "GB", "TB"};
  size_t unit = 0;
  for (v /= 1000; v >= 999.5 && unit < 3; v /= 1000) ++unit;
  return text("%.*f %s", v < 9.995 ? 2 : v < 99.95 ? 1 : 0, v, units[unit]);
}

HudFigures hudFigures(const EngineStats& stats, const Manifest& manifest) {
  const StreamerStats& s = stats.streamer;
  HudFigures f;
  f.planes.push_back({"plane", "queued", "decoding", "ready", "resident", "failed", "read", "decoded", "uploaded"});
  for (size_t p = 0; p < s.pages_read.size(); ++p) {
    auto now = [&](PageState state) { return s.pages[static_cast<size_t>(state)][p]; };
    bool in_use = s.pages_read[p] + s.pages_uploaded[p] > 0;
    for (size_t state = 1; state < kPageStates; ++state) in_use = in_use || s.pages[state][p] > 0;
    if (!in_use) continue;
    std::vector<std::string> row{planeName(static_cast<Plane>(p), manifest.texture.basis)};
    for (PageState state :
         {PageState::kQueued, PageState::kDecoding, PageState::kReady, PageState::kResident, PageState::kFailed})
      row.push_back(std::to_string(now(state)));
    for (uint64_t bytes : {s.bytes_read[p], s.bytes_decoded[p], s.bytes_uploaded[p]}) row.push_back(bytesText(bytes));
    f.planes.push_back(std::move(row));
  }
  f.lines.push_back(text("upload %s   resident %s of %s   GPU textures %s", uploadFormatName(stats.upload).c_str(),
                         bytesText(s.resident_bytes).c_str(), bytesText(stats.cache_bytes).c_str(),
                         bytesText(stats.texture_bytes).c_str()));
  if (!stats.why_not_blocks.empty()) f.lines.push_back("no blocks: " + stats.why_not_blocks);
  const double asked = static_cast<double>(s.hits + s.misses);
  f.lines.push_back(text("hits %.1f %%   misses %llu   evictions %llu   retries %llu   failed %llu",
                         asked > 0 ? 100 * static_cast<double>(s.hits) / asked : 100, big(s.misses), big(s.evictions),
                         big(s.retries), big(s.failed_pages)));
  f.lines.push_back(text("cancelled %llu: %llu to read, %llu to decode, %llu decoded", big(s.cancelled),
                         big(s.cancelled_before_read), big(s.cancelled_before_decode), big(s.cancelled_after_decode)));
  f.lines.push_back(text("prefetched %llu   used %llu   wasted %llu", big(s.prefetched), big(s.prefetch_used),
                         big(s.prefetch_wasted)));
  f.lines.push_back(text("bias %.2f levels   no room for %llu pages   patch list p99 %.0f frames old",
                         stats.detail_bias, big(s.deferred), stats.lod_lag_frames.p99));
  f.lines.push_back(text("%s (O)   %.4g %s a px%s", stats.orthographic ? "orthographic" : "perspective",
                         stats.mm_per_px, stats.size_known ? "mm" : "px of the artwork",
                         stats.orthographic ? "" : " at the target"));
  if (s.latency_ms.count > 0) {
    f.lines.push_back(text("wanted to visible  p50 %.0f ms (%.0f frames)   p90 %.0f (%.0f)   p99 %.0f (%.0f)",
                           s.latency_ms.p50, s.latency_frames.p50, s.latency_ms.p90, s.latency_frames.p90,
                           s.latency_ms.p99, s.latency_frames.p99));
  }
  return f;
}

HudFigures hudFigures(const EngineStats& stats, const Stage& stage) {
  HudFigures all = hudFigures(stats, stage.engine(0).manifest());
  if (stage.size() == 1) return all;
  all.planes.resize(1);
  for (size_t i = 0; i < stage.size(); ++i) {
    HudFigures own = hudFigures(stage.engine(i).stats(), stage.engine(i).manifest());
    for (size_t row = 1; row < own.planes.size(); ++row) {
      own.planes[row][0] = std::to_string(i + 1) + " " + own.planes[row][0];
      all.planes.push_back(std::move(own.planes[row]));
    }
  }
  return all;
}

}  // namespace relievo
