// page_streamer.h - the life of a page: Absent -> Queued -> Decoding -> Ready -> Resident (-> Absent), or Failed.
// Owned by the render thread; reading and decoding happen on worker threads. Nothing here waits.
//
// Order of service: newest batch first, coarse before fine, then near the view's centre. A queued page that the newest
// two batches of its kind no longer want is cancelled before it is read. A failed page is retried with back-off
// kMaxAttempts times, then stays Failed (its ancestor shows); it is named once.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "src/base/result.h"
#include "texturing/basis.h"
#include "texturing/feedback.h"
#include "texturing/page_cache.h"
#include "texturing/page_id.h"
#include "texturing/page_source.h"
#include "texturing/page_table.h"

namespace relievo {

enum class PageState : uint8_t { kAbsent, kQueued, kDecoding, kReady, kResident, kFailed };
inline constexpr int kMaxAttempts = 4;

struct StreamerOptions {
  uint32_t slot_count = 1024;      // the cache budget over kSlotBytes
  int workers = 2;
  // Texture planes that the effect plan streams, in order; plane i goes to PageTableEntry::slots[i]. {kResolved} for a
  // fixed light: the worker then reads the stored planes of `format` and evaluates them for (light_u, light_v) per texel.
  std::vector<Plane> texture_planes;
  TextureFormat format;
  double light_u = 0, light_v = 0;
};

// Texels to copy into a slot of the page pool. The memory lives until the next beginFrame().
struct PageUpload {
  SlotIndex slot;
  PageId id;
  const uint8_t* texels;  // kSlotBytes
};

struct StreamerStats {
  std::array<uint64_t, 16> pages_read{}, bytes_read{}, pages_decoded{}, pages_uploaded{};  // by plane number
  uint64_t evictions = 0, cancelled = 0, failed_pages = 0, retries = 0;
  uint64_t queued = 0, decoding = 0, ready = 0, resident = 0;  // now
  uint64_t deferred = 0;  // pages that found no slot in the last frame: the working set exceeds the cache
};

class PageStreamer {
 public:
  PageStreamer(std::shared_ptr<const PageSource> source, StreamerOptions options);
  ~PageStreamer();  // stops the workers

  // Pages that are loaded at once and stay (the roots of every plane in use). Call before the first frame.
  void pinRoots(std::span<const NodeId> texture_roots, std::span<const NodeId> relief_roots);

  // A frame, in this order. now_s drives back-off and the page fade.
  void beginFrame(uint64_t frame, double now_s);
  // The newest wish lists; each replaces the previous of its kind. Touches what is resident, queues what is not.
  void wantTexture(std::span<const NodeWant> wants);
  void wantRelief(std::span<const NodeWant> wants);
  // Places decoded pages (at most max_uploads) and returns what to upload; updates the page table.
  std::span<const PageUpload> placeReady(uint32_t max_uploads);

  // Relief pages in use by the geometry being drawn stay until released (counted).
  SlotIndex findRelief(const NodeId& node) const;
  void pinRelief(const NodeId& node);
  void unpinRelief(const NodeId& node);
  // Resident relief nodes, for the LOD worker; the generation changes whenever the set does.
  std::vector<NodeId> residentRelief() const;
  uint64_t reliefGeneration() const;

  // Everything that the last wish lists ask for is resident (or has failed for good), nothing is under way.
  bool settled() const;
  PageState state(PageId id) const;
  const StreamerStats& stats() const;
  PageTable& table();
  const PageCache& cache() const;
  // Messages that a user should see (each failed page once); cleared by the call.
  std::vector<std::string> takeMessages();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace relievo
