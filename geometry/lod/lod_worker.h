// lod_worker.h - evaluates the LOD on a thread of its own: newest view in, newest patch list out. Whoever posts and
// tries to take waits for no evaluation; waitFor() does: the engine's first frame of a streamer, which has no list yet
// to draw, and settling.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <thread>

#include "geometry/lod/planar_lod.h"
#include "geometry/lod/texture_select.h"
#include "src/base/mailbox.h"

namespace relievo {

struct LodRequest {
  uint64_t frame = 0;
  LodView view;
  std::shared_ptr<const ReliefSet> resident;
  std::optional<TextureView> texture;  // the texture nodes of this view are asked for, too
};
struct LodAnswer {
  uint64_t frame = 0;  // of the request
  LodView view;
  LodResult lod;
  std::optional<std::vector<TextureRequest>> texture;  // when they were asked for
  double evaluate_ms = 0;                              // of both
  double determine_ms = 0;                             // of the texture nodes
};

// View and resident relief pages to what is drawn; called on the worker's thread alone.
using LodSelector = std::function<LodResult(const LodView&, const ReliefSet&)>;

// Used from one thread (the render thread).
class LodWorker {
 public:
  // Texture nodes that a request asks for are left out.
  explicit LodWorker(LodSelector strategy);
  LodWorker(FlatDomain domain, std::shared_ptr<const ReliefOracle> oracle);
  ~LodWorker();  // closes the mailbox and joins
  void post(LodRequest request);
  std::optional<LodAnswer> tryTake();
  // Waits for the answer to the posted request of this frame (or a later one).
  LodAnswer waitFor(uint64_t frame);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace relievo
