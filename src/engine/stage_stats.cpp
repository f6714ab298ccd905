// The counters of several artworks as one: what is counted, measured or taken is added up, what is a bound is the
// largest, and of series of times, which only their percentiles are known of, the largest of each.
#include <algorithm>

#include "src/engine/stage.h"

namespace relievo {
namespace {

void addTo(LatencySummary& to, const LatencySummary& from) {
  to.count += from.count;
  to.p50 = std::max(to.p50, from.p50);
  to.p90 = std::max(to.p90, from.p90);
  to.p99 = std::max(to.p99, from.p99);
  to.max = std::max(to.max, from.max);
}

void addTo(StreamerStats& to, const StreamerStats& from) {
  using ByPlane = StreamerStats::ByPlane;
  for (ByPlane StreamerStats::*counts :
       {&StreamerStats::pages_read, &StreamerStats::bytes_read, &StreamerStats::pages_decoded,
        &StreamerStats::pages_uploaded, &StreamerStats::bytes_decoded, &StreamerStats::bytes_uploaded})
    for (size_t p = 0; p < (to.*counts).size(); ++p) (to.*counts)[p] += (from.*counts)[p];
  for (size_t s = 0; s < to.pages.size(); ++s)
    for (size_t p = 0; p < to.pages[s].size(); ++p) to.pages[s][p] += from.pages[s][p];
  for (size_t a = 0; a < to.moves.size(); ++a)
    for (size_t b = 0; b < to.moves[a].size(); ++b) to.moves[a][b] += from.moves[a][b];
  for (uint64_t StreamerStats::*count : {&StreamerStats::queued,
                                         &StreamerStats::decoding,
                                         &StreamerStats::ready,
                                         &StreamerStats::resident,
                                         &StreamerStats::resident_bytes,
                                         &StreamerStats::relief_bytes,
                                         &StreamerStats::hits,
                                         &StreamerStats::misses,
                                         &StreamerStats::evictions,
                                         &StreamerStats::failed_pages,
                                         &StreamerStats::retries,
                                         &StreamerStats::cancelled_before_read,
                                         &StreamerStats::cancelled_before_decode,
                                         &StreamerStats::cancelled_after_decode,
                                         &StreamerStats::cancelled,
                                         &StreamerStats::prefetched,
                                         &StreamerStats::prefetch_used,
                                         &StreamerStats::prefetch_wasted,
                                         &StreamerStats::deferred,
                                         &StreamerStats::wanted})
    to.*count += from.*count;
  to.detail_bias = std::max(to.detail_bias, from.detail_bias);
  addTo(to.latency_ms, from.latency_ms);
  addTo(to.latency_frames, from.latency_frames);
}

void addNames(std::vector<std::string>& to, const std::vector<std::string>& from) {
  for (const std::string& name : from)
    if (std::find(to.begin(), to.end(), name) == to.end()) to.push_back(name);
}

}  // namespace

EngineStats sumOf(std::span<const EngineStats> all) {
  EngineStats sum = all[0];
  for (const EngineStats& one : all.subspan(1)) {
    addTo(sum.streamer, one.streamer);
    sum.frames = std::max(sum.frames, one.frames);
    for (uint32_t EngineStats::*count :
         {&EngineStats::instances, &EngineStats::triangles, &EngineStats::draw_calls, &EngineStats::wanted_nodes,
          &EngineStats::missing_pages, &EngineStats::slots, &EngineStats::resident, &EngineStats::edges_limited})
      sum.*count += one.*count;
    for (uint64_t EngineStats::*bytes :
         {&EngineStats::cache_bytes, &EngineStats::texture_bytes, &EngineStats::tail_bytes})
      sum.*bytes += one.*bytes;
    for (double EngineStats::*time : {&EngineStats::lod_ms, &EngineStats::determine_ms, &EngineStats::predict_ms})
      sum.*time += one.*time;
    if (sum.why_not_blocks.empty()) sum.why_not_blocks = one.why_not_blocks;
    sum.samples = sum.samples == 0 ? one.samples : one.samples == 0 ? sum.samples : std::min(sum.samples, one.samples);
    sum.directions += one.directions;
    sum.refined = sum.refined && one.refined;
    sum.predicted_error_px = std::max(sum.predicted_error_px, one.predicted_error_px);
    sum.detail_bias = std::max(sum.detail_bias, one.detail_bias);
    addTo(sum.lod_lag_frames, one.lod_lag_frames);
    sum.switching = sum.switching || one.switching;
    sum.size_known = sum.size_known && one.size_known;
    addNames(sum.passes, one.passes);
    addNames(sum.planes_read, one.planes_read);
  }
  sum.samples = std::max(sum.samples, 1);
  return sum;
}

}  // namespace relievo
