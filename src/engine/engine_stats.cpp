#include "src/engine/engine_stats.h"

#include <nlohmann/json.hpp>

#include "src/engine/effect_plan.h"
#include "src/engine/upload_choice.h"
#include "src/render/depth.h"

namespace relievo {
namespace {

// Which value is which colour.
nlohmann::ordered_json legendJson(const ReliefShading& shading, const Manifest& manifest) {
  const ShadingScale scale = scaleOf(shading, manifest);
  nlohmann::ordered_json legend = {{"kind", shadingName(shading.kind)}, {"unit", scale.unit}};
  if (shading.kind == ReliefShading::Kind::kCurvature) legend["radius"] = curvatureRadius(shading, manifest);
  for (size_t k = 0; k < kShadingStops; ++k) {
    const glm::dvec3 bytes = glm::round(255.0 * scale.colours[k]);
    const double share = static_cast<double>(k) / (kShadingStops - 1);
    legend["stops"].push_back(
        {{"value", scale.from + (scale.to - scale.from) * share},
         {"rgb", {static_cast<int>(bytes.x), static_cast<int>(bytes.y), static_cast<int>(bytes.z)}}});
  }
  return legend;
}

}  // namespace

std::string engineStatsJson(const EngineStats& s, const Manifest& manifest) {
  nlohmann::ordered_json planes = nlohmann::ordered_json::object();
  for (size_t p = 0; p < s.streamer.pages_read.size(); ++p) {
    if (s.streamer.pages_read[p] == 0 && s.streamer.pages_uploaded[p] == 0) continue;
    // What is made of a flat artwork's relief takes a texture plane's place.
    const bool made = s.shading.isOn() && manifest.domain.isFlat() && static_cast<Plane>(p) == kNormalPlane;
    auto& plane = planes[made ? std::string(shadingName(s.shading.kind))
                              : planeName(static_cast<Plane>(p), manifest.texture.basis)];
    plane = {{"pages_read", s.streamer.pages_read[p]},         {"bytes_read", s.streamer.bytes_read[p]},
             {"pages_decoded", s.streamer.pages_decoded[p]},   {"bytes_decoded", s.streamer.bytes_decoded[p]},
             {"pages_uploaded", s.streamer.pages_uploaded[p]}, {"bytes_uploaded", s.streamer.bytes_uploaded[p]}};
    for (size_t state = 1; state < kPageStates; ++state)
      plane["states"][std::string(kPageStateNames[state])] = s.streamer.pages[state][p];
  }
  auto latencyJson = [](const LatencySummary& l) {
    return nlohmann::ordered_json{{"count", l.count}, {"p50", l.p50}, {"p90", l.p90}, {"p99", l.p99}, {"max", l.max}};
  };
  auto mib = [](uint64_t bytes) { return static_cast<double>(bytes) / (1024 * 1024); };
  uint64_t resident_pages = 0;
  for (uint64_t of_plane : s.streamer.pages[static_cast<size_t>(PageState::kResident)]) resident_pages += of_plane;
  nlohmann::ordered_json j = {
      {"planes_read", s.planes_read},
      {"passes", s.passes},
      {"samples", s.samples},
      {"light_directions", s.directions},
      {"planes", planes},
      {"draw_calls", s.draw_calls},
      {"instances", s.instances},
      {"triangles", s.triangles},
      {"frames", s.frames},
      {"wanted_nodes", s.wanted_nodes},
      {"missing_pages", s.missing_pages},
      {"slots", s.slots},
      {"resident_pages", resident_pages},
      {"upload", uploadFormatName(s.upload)},
      {"depth", depthName(s.reversed_depth)},
      {"projection", s.orthographic ? "orthographic" : "perspective"},
      {std::string(s.size_known ? "mm_per_px" : "artwork_px_per_px") + (s.orthographic ? "" : "_at_target"),
       s.mm_per_px},
      {"resident_mib", mib(s.streamer.resident_bytes)},
      {"relief_mib", mib(s.streamer.relief_bytes)},
      {"cache_mib", mib(s.cache_bytes)},
      {"texture_mib", mib(s.texture_bytes)},
      {"tails_mib", mib(s.tail_bytes)},
      {"evictions", s.streamer.evictions},
      {"hits", s.streamer.hits},
      {"misses", s.streamer.misses},
      {"cancelled", s.streamer.cancelled},
      {"cancelled_before_read", s.streamer.cancelled_before_read},
      {"cancelled_before_decode", s.streamer.cancelled_before_decode},
      {"cancelled_after_decode", s.streamer.cancelled_after_decode},
      {"predict_ms", s.predict_ms},
      {"prefetched", s.streamer.prefetched},
      {"prefetch_used", s.streamer.prefetch_used},
      {"prefetch_wasted", s.streamer.prefetch_wasted},
      {"latency_ms", latencyJson(s.streamer.latency_ms)},
      {"latency_frames", latencyJson(s.streamer.latency_frames)},
      {"failed_pages", s.streamer.failed_pages},
      {"retries", s.streamer.retries},
      {"predicted_error_px", s.predicted_error_px},
      {"detail_bias_levels", s.detail_bias},
      {"edges_limited_by_residency", s.edges_limited},
      {"lod_ms", s.lod_ms},
      {"lod_lag_frames", latencyJson(s.lod_lag_frames)},
      {"determine_ms", s.determine_ms},
  };
  if (s.shading.isOn()) j["shading"] = legendJson(s.shading, manifest);
  if (!s.why_not_blocks.empty()) j["why_not_blocks"] = s.why_not_blocks;
  return j.dump(2);
}

}  // namespace relievo
