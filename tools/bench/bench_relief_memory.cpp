// bench_relief_memory.cpp - what a relief's finest triangles take of the page cache, all of the artwork resident as a
// view would have it: the finest pages, every third level above them, the roots; or tails.
#include <algorithm>
#include <array>
#include <cstdio>
#include <vector>

#include "src/engine/engine.h"
#include "texturing/codec/page_codec.h"
#include "texturing/package/patch_tails.h"
#include "texturing/stream/page_streamer.h"
#include "texturing/stream/relief_subslots.h"
#include "tools/bench/bench_groups.h"

namespace relievo {

Result<void> reliefMemoryBench(BenchContext& context) {
  constexpr int kAncestorStride = 3;  // levels between pages that a view wants one above the other
  const PatchDomain& domain = context.package->manifest().domain;
  if (domain.relief_depth < 0) return Error{ErrorKind::kUnsupported, "", "the artwork has no relief", "", {}};
  const bool over_mesh = !domain.isFlat();
  const bool with_tails = drawnWithTails(domain, EngineOptions{}.most_pinned_patches);

  std::vector<NodeRequest> requests;
  for (int level = domain.relief_depth; level >= 0; level = level == 0 ? -1 : std::max(level - kAncestorStride, 0))
    for (uint32_t patch = 0; patch < domain.patchCount(); ++patch)
      for (uint32_t y = 0; y < 1u << level; ++y)
        for (uint32_t x = 0; x < 1u << level; ++x) {
          const NodeId node{patch, static_cast<uint32_t>(level), x, y};
          if (domain.nodeExists(node)) requests.push_back({node, 1, 0});
        }
  if (requests.size() > kMaxSlots)
    return Error{
        ErrorKind::kUnsupported, "", "its relief has more pages than a cache holds", "measure a smaller artwork", {}};
  StreamerOptions so;
  so.slot_count = static_cast<uint32_t>(requests.size());
  so.relief_parts = over_mesh ? ReliefParts::kCompact : ReliefParts::kOnlyHalves;
  PageStreamer streamer(context.package, so);
  for (uint64_t frame = 1; !streamer.settled() || streamer.residentRelief().size() < requests.size(); ++frame) {
    if (context.stopped()) return {};
    streamer.beginFrame(frame, benchSeconds());
    streamer.requestRelief(requests);
    streamer.placeReady(256);
    if (streamer.stats().failed_pages > 0)
      return Error{ErrorKind::kInvalidData, "", "a relief page is damaged", "relievo verify names it", {}};
  }

  // Triangles of each page's samples, where no finer page lies over it; what of a flat artwork's pages lies beyond its
  // border counts as theirs.
  const SubslotCache& cache = streamer.cache(Plane::kRelief);
  double triangles = 0;
  std::array<uint32_t, 3> of_cells{};  // 128, 64, 32 a side
  uint32_t compact = 0;
  for (const NodeRequest& w : requests) {
    const int level = partOf(streamer.findRelief(w.node)).level;
    ++of_cells[static_cast<size_t>(reliefStepLog2(level))];
    compact += isThird(level);
    if (static_cast<int>(w.node.level) == domain.relief_depth)
      triangles += 2.0 * reliefCells(level) * reliefCells(level);
  }
  const double tail_bytes = with_tails ? 2.0 * kTailHeights * domain.patchCount() : 0;
  const double bytes = static_cast<double>(streamer.stats().relief_bytes) + tail_bytes;
  char note[200];
  std::snprintf(
      note, sizeof note,
      "%.2f MiB: %u slots, with %u, %u and %u pages of 128, 64 and 32 cells a side, %u of all compact; tails %.2f MiB",
      bytes / (1 << 20), cache.dividedCount(), of_cells[0], of_cells[1], of_cells[2], compact, tail_bytes / (1 << 20));
  context.row({.what = "resident displacement a triangle of the finest grids",
               .measured = bytes / triangles,
               .unit = "B",
               .goal = 1,
               .baseline_name = "a slot a page",
               .baseline = static_cast<double>(requests.size() * kSlotBytes) / triangles,
               .note = note});
  return {};
}

}  // namespace relievo
