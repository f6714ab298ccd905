// resident_planes.h - the pages of the planes that a plan reads: the streamer, the GPU's pool of its slots, and over
// many patches the tails. For other planes a streamer is made ready beside the present one (stream_switch.h), which is
// drawn until then. Needs a current GL context.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "src/engine/effect_plan.h"
#include "src/engine/engine.h"
#include "src/engine/stream_switch.h"
#include "src/engine/upload_choice.h"
#include "src/render/page_pool.h"
#include "src/render/tail_textures.h"
#include "texturing/package/kept_tails.h"
#include "texturing/stream/cache_budget.h"
#include "texturing/stream/page_streamer.h"

namespace relievo {

class ResidentPlanes {
 public:
  // Artwork and options outlive it. tail_bytes: what tails will take of the GPU's memory, at most, until they are made;
  // 0: there are none, and roots are pinned.
  ResidentPlanes(const Artwork& artwork, const EngineOptions& options, uint64_t tail_bytes, UploadChoice upload);

  // The smallest budget for the planes of a plan, tails included, bytes.
  uint64_t leastBytes(const EffectPlan& plan) const { return tail_bytes_ + minCacheBytes(needs(plan)); }
  // What all pages of the plan take.
  uint64_t mostBytes(const EffectPlan& plan) const;
  // Makes the tails, where there are any: from then on it is known what they take. Errors: kInterrupted;
  // kUnsupported: the context has no room for them.
  Result<void> makeTails();
  // Makes the pool for a plan's pages.
  void openPool(const EffectPlan& plan);
  // Then the first streamer, and waits for its roots.
  void openStreamer(const EffectPlan& plan, const Scene& scene);

  // Begins to make a streamer ready for the planes of another plan.
  void start(const EffectPlan& plan, const Scene& scene);
  bool starting() const { return switch_.busy(); }
  // The one made ready becomes the streamer, and what is resident for other planes is dropped. False: it is not ready
  // yet, or by now other planes are `wanted` than it was made for; then starting() is false.
  bool adopt(const EffectPlan& wanted);
  // Another fixed light.
  void setLight(const EffectPlan& plan, const std::array<double, 3>& light);
  const std::array<double, 3>& startedLight() const { return starting_light_; }

  PageStreamer& streamer() const { return *streamer_; }
  PagePool& pool() const { return *pool_; }
  const CacheSlots& slots() const { return slots_; }
  bool hasTails() const { return tails_.has_value(); }
  TailTextures* tailTextures() const { return tail_textures_.get(); }  // null without tails
  uint64_t tailBytes() const { return tail_bytes_; }
  // Texture levels beyond the root's over which roots give way to tails: as many as the tails' texels are good for, or
  // fewer, so that the roots that a screen full of patches asks for fit the cache with room to spare.
  double tailReach(const EffectPlan& plan, int width_px, int height_px) const;
  // Of shaders that look up pages or tails.
  void addDefines(gl::Defines& defines) const;
  std::string whyNotBlocks(const EffectPlan& plan) const;  // empty: blocks are uploaded, or were not asked for

  // Since the last call: what the tails could not be made of, and pages that failed.
  std::vector<std::string> takeTailMessages() { return std::exchange(tail_messages_, {}); }
  std::vector<std::string> takePageMessages();
  PageFailures failures() const;                                  // of tails and of all streamers
  const PageFailures& pastFailures() const { return failures_; }  // without those of the present streamer

 private:
  CacheNeeds needs(const EffectPlan& plan) const;
  uint64_t budget() const;
  void readTails();
  void setTailTexels(const EffectPlan& plan, const std::array<double, 3>& light);
  void take(std::unique_ptr<PageStreamer> next);

  const Artwork& artwork_;
  const EngineOptions& options_;
  uint64_t tail_bytes_ = 0;
  UploadChoice upload_;
  std::unique_ptr<PageStreamer> streamer_;
  StreamSwitch switch_;
  EffectPlan starting_plan_;  // of the streamer that is made ready
  std::array<double, 3> starting_light_{};
  CacheSlots slots_, starting_slots_;
  std::unique_ptr<PagePool> pool_;
  std::optional<KeptTails> tails_;
  std::unique_ptr<TailTextures> tail_textures_;
  std::vector<std::string> page_messages_;  // of streamers that ended
  std::vector<std::string> tail_messages_;
  PageFailures failures_;  // of the tails, and of streamers that ended
};

}  // namespace relievo
