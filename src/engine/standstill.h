// standstill.h - while a view settles: do the steps still lead anywhere? A view that wants more relief than the cache
// holds would otherwise wait for pages that nobody reads.
#pragma once

#include <array>
#include <cstdint>

#include "src/engine/drawn_list.h"
#include "texturing/stream/page_streamer.h"
#include "texturing/stream/recent_use.h"

namespace relievo {

class Standstill {
 public:
  // After each step. final_list: all the relief that the list asks for is there.
  void note(const PageStreamer& streamer, const DrawnList& list, bool final_list) {
    const StreamerStats& s = streamer.stats();
    const std::array<uint64_t, 6> now{
        streamer.reliefGeneration(), list.number(), list.reliefRequests().size(), s.resident, s.ready, s.deferred};
    const bool same = now == seen_ && streamer.detailBias() == bias_ && streamer.atRest();
    seen_ = now;
    bias_ = streamer.detailBias();
    steps_ = same ? steps_ + 1 : 0;
    starved_ = !final_list && (starved_ || steps_ > kStarvedSteps);
  }
  // Nothing will change any more.
  bool stuck() const { return steps_ >= kStuckSteps; }
  // Relief finds no place, for as long as no list is final.
  bool starved() const { return starved_; }

 private:
  // Steps that change nothing while no page is under way. After so many, more than a page that nobody asks for any more
  // keeps its place, the detail bias follows the lists of relief alone; after as many as it then takes to evaluate
  // those several times over, the view is stuck.
  static constexpr int kStarvedSteps = 2 * kSparedFrames, kStuckSteps = 64;

  std::array<uint64_t, 6> seen_{};
  double bias_ = -1;
  int steps_ = 0;
  bool starved_ = false;
};

}  // namespace relievo
