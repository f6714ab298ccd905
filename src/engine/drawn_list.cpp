#include "src/engine/drawn_list.h"

#include <algorithm>
#include <utility>

#include "geometry/lod/mesh_lod.h"

namespace relievo {
namespace {

std::unique_ptr<LodWorker> workerOf(const Artwork& artwork, bool with_tails) {
  const Manifest& m = artwork.manifest;
  if (m.domain.isFlat()) return std::make_unique<LodWorker>(m.domain.flat(), artwork.oracle);
  auto lod = std::make_shared<MeshLod>(m.base, m.domain.relief_depth, m.domain.relief_offset_mm,
                                       m.domain.relief_scale_mm, artwork.oracle, m.coarse_errors, with_tails);
  return std::make_unique<LodWorker>(
      [lod](const LodView& view, const ReliefSet& resident) { return lod->select(view, resident); });
}

}  // namespace

DrawnList::DrawnList(const Artwork& artwork, bool with_tails) : worker_(workerOf(artwork, with_tails)) {}

void DrawnList::reset() {
  relief_requests_.clear();
  instances_.clear();
  pinned_.clear();
  resident_generation_ = ~uint64_t{0};
  adopted_frame_ = 0;
  posted_.clear();
}

void DrawnList::post(uint64_t frame, const LodView& lod, const std::optional<TextureView>& texture,
                     const ViewTransform& view, double exaggerate, PageStreamer& streamer) {
  if (streamer.reliefGeneration() != resident_generation_) {
    resident_generation_ = streamer.reliefGeneration();
    const auto nodes = streamer.residentRelief();
    resident_ = std::make_shared<ReliefSet>(nodes.begin(), nodes.end());
  }
  worker_->post({frame, lod, resident_, texture});
  posted_.push_back({frame, view, exaggerate, ++requests_});
}

void DrawnList::adopt(LodAnswer answer, bool relief, PageStreamer& streamer, TextureDemand& demand,
                      EngineStats& stats) {
  stats.lod_ms = answer.evaluate_ms;
  while (!posted_.empty() && posted_.front().frame < answer.frame) posted_.pop_front();
  if (posted_.empty() || posted_.front().frame != answer.frame) return;  // asked for before streaming was restarted
  relief_requests_.clear();
  for (const ReliefRequest& w : answer.lod.requests) relief_requests_.push_back({w.page, 1, w.priority});
  if (answer.texture) {
    stats.determine_ms = answer.determine_ms;
    demand.takeGeometry(*answer.texture);
  }
  std::vector<NodeId> pages;
  if (relief) {
    pages.reserve(answer.lod.instances.size());
    for (const PatchInstance& p : answer.lod.instances)
      if (p.relief_page.level != kTailLevel) pages.push_back(p.relief_page);
    std::sort(pages.begin(), pages.end());
    pages.erase(std::unique(pages.begin(), pages.end()), pages.end());
    for (const NodeId& page : pages)
      if (streamer.findRelief(page) == kNoSlot) return;  // evicted meanwhile: the next answer will know
    for (const NodeId& page : pages) streamer.pinRelief(page);
    for (const NodeId& page : pinned_) streamer.unpinRelief(page);
  }
  pinned_ = std::move(pages);
  number_ += answer.lod.instances != instances_ || answer.lod.backs_are_hidden != backs_are_hidden_;
  backs_are_hidden_ = answer.lod.backs_are_hidden;
  instances_ = std::move(answer.lod.instances);
  stats.predicted_error_px = answer.lod.max_error_px;
  stats.edges_limited = answer.lod.limited_by_residency;
  adopted_frame_ = answer.frame;
  made_ = posted_.front();
}

}  // namespace relievo
