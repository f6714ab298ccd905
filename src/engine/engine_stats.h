// engine_stats.h - what the engine counts and measures; times in ms, memory in bytes.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "src/base/latency.h"
#include "src/engine/effects/relief_shading.h"
#include "texturing/package/package.h"
#include "texturing/stream/page_streamer.h"

namespace relievo {

struct EngineStats {
  StreamerStats streamer;
  uint64_t frames = 0;
  uint32_t instances = 0, triangles = 0, draw_calls = 0;  // of the last frame
  uint32_t wanted_nodes = 0, missing_pages = 0;           // of the last request lists
  uint32_t slots = 0, resident = 0;
  PageCodec upload = PageCodec::kLossless;  // texture pages on the GPU now: a block codec, or any other for RGBA8
  std::string why_not_blocks;  // empty: pages are blocks, or blocks were not asked for, or the light is fixed
  uint64_t cache_bytes = 0;    // all slots together
  uint64_t texture_bytes = 0;  // what GL has allocated for the slots by now
  uint64_t tail_bytes = 0;     // on the GPU, besides the slots
  int samples = 1;             // that the last picture is the average of
  int directions = 0;          // that the light of its last sample came from, of lights with a size and of the sky
  bool refined = true;         // no sample and no direction of the scene is missing
  double predicted_error_px = 0;
  double detail_bias = 0;
  uint32_t edges_limited = 0;
  double lod_ms = 0;        // the last LOD evaluation, on its worker
  double determine_ms = 0;  // the part of lod_ms that named texture pages; 0 with kFeedback
  // How many frames before the one that drew it a patch list was asked for; 1 at best. Frames that waited for their
  // list do not count.
  LatencySummary lod_lag_frames;
  // The evaluation of the last predicted views, on a worker of its own. 0: the camera never moved, or no prefetch.
  double predict_ms = 0;
  bool switching = false;       // the scene asks for other planes, whose root pages are not resident yet
  bool reversed_depth = false;  // in use
  bool orthographic = false;    // the camera
  bool size_known = true;       // else mm_per_px counts the artwork's pixels
  double mm_per_px = 0;         // orthographic: everywhere in the picture; else on the plane through the target
  ReliefShading shading;        // of the scene
  std::vector<std::string> passes, planes_read;
};

// A JSON object, indented; planes by the names that the manifest's basis gives them.
std::string engineStatsJson(const EngineStats& stats, const Manifest& manifest);

}  // namespace relievo
