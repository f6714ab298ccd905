// drawn_list.h - the list of patches that is drawn. Each view is posted to the LOD worker; its answer becomes the drawn
// list, a frame late at most times, and is drawn with the view that it was made for: what that view culled is never
// looked at. The relief pages that it displaces from are pinned while it is drawn.
#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <vector>

#include "geometry/lod/lod_worker.h"
#include "src/engine/artwork.h"
#include "src/engine/engine_stats.h"
#include "src/engine/texture_demand.h"
#include "src/render/camera.h"
#include "texturing/stream/page_streamer.h"

namespace relievo {

class DrawnList {
 public:
  // The view that a list was made for.
  struct Made {
    uint64_t frame = 0;
    ViewTransform view;
    double exaggerate = 1;
    uint64_t request = 0;  // counted from 1
  };

  // with_tails: patches that few pixels show may be drawn from their tails.
  DrawnList(const Artwork& artwork, bool with_tails);

  // Another streamer begins: nothing is drawn before its first list.
  void reset();
  // Asks for the list of a view. texture: what its geometry needs of the texture, too.
  void post(uint64_t frame, const LodView& lod, const std::optional<TextureView>& texture, const ViewTransform& view,
            double exaggerate, PageStreamer& streamer);
  std::optional<LodAnswer> tryTake() { return worker_->tryTake(); }
  LodAnswer waitFor(uint64_t frame) { return worker_->waitFor(frame); }
  // The answer's list becomes the drawn one if every relief page that it displaces from is still there. relief: of the
  // plan.
  void adopt(LodAnswer answer, bool relief, PageStreamer& streamer, TextureDemand& demand, EngineStats& stats);
  // A frame with the list as it is: how late that is.
  void countLag() { lag_.add(1 + requests_ - made_.request); }

  const Made& made() const { return made_; }
  const std::vector<PatchInstance>& instances() const { return instances_; }
  bool backsAreHidden() const { return backs_are_hidden_; }  // see LodResult
  uint64_t number() const { return number_; }                // differs whenever instances() does
  uint64_t adoptedFrame() const { return adopted_frame_; }   // of the request whose answer is drawn; 0: none is
  const std::vector<NodeRequest>& reliefRequests() const { return relief_requests_; }
  // Relief that was resident as of the last request.
  const std::shared_ptr<const ReliefSet>& resident() const { return resident_; }
  uint64_t residentGeneration() const { return resident_generation_; }
  const LatencyHistogram& lag() const { return lag_; }

 private:
  std::unique_ptr<LodWorker> worker_;
  std::vector<NodeRequest> relief_requests_;
  std::shared_ptr<const ReliefSet> resident_ = std::make_shared<ReliefSet>();
  uint64_t resident_generation_ = ~uint64_t{0};
  std::vector<PatchInstance> instances_;
  bool backs_are_hidden_ = false;
  uint64_t number_ = 0;
  std::vector<NodeId> pinned_;  // pages that instances_ displaces from
  uint64_t adopted_frame_ = 0;
  uint64_t requests_ = 0;  // so far
  LatencyHistogram lag_;
  Made made_;
  std::deque<Made> posted_;  // requests whose answers are still to come
};

}  // namespace relievo
