// page_streamer.h - the life of a page, from a request to texels in a slot of the cache. Owned by the render thread;
// reading and decoding happen on worker threads. Nothing here waits for them, except pinRoots (start-up) and the
// destructor.
//
//   Absent -> Queued -> Decoding -> Ready -> Resident -> Absent        and Failed: README.md has the whole diagram
//
// Each request carries a ticket. An answer whose ticket is not that of a page in state Decoding is late or cancelled,
// and is dropped: in one place (takeResults). Order of service (page_rank.h), made anew in every frame: what is wanted
// now, what is predicted, what the list before the newest wanted; within a tier coarse before fine, then near the
// view's centre. Room: a page wanted now is never evicted for another one wanted now, and a missing node is only asked
// for when all of its planes will find slots (relief: half of one) beside everything else that is wanted. So a working
// set larger than the cache ends in a still state without loads, never in thrashing; what found no room is counted
// (deferred) and detailBias() asks the view for less. Faults: an error of kind kInvalidData without a byte offset is
// the source's word that there is no such page, and is final at once. All others may pass and are retried, at most
// kMaxAttempts attempts in all. Memory: at most bufferBytes(), besides the slots (which live on the GPU) and the first
// upload of the roots.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "src/artwork/basis.h"
#include "src/base/latency.h"
#include "texturing/codec/page_encoding.h"
#include "texturing/codec/page_id.h"
#include "texturing/package/page_failures.h"
#include "texturing/package/page_source.h"
#include "texturing/stream/detail_bias.h"
#include "texturing/stream/feedback.h"
#include "texturing/stream/page_jobs.h"
#include "texturing/stream/page_life.h"
#include "texturing/stream/page_table.h"
#include "texturing/stream/recent_use.h"
#include "texturing/stream/subslot_cache.h"

namespace relievo {

inline constexpr int kMaxAttempts = 4;

struct StreamerOptions {
  uint32_t slot_count = 1024;  // the cache budget over kSlotBytes; at most kMaxSlots
  // A block codec that all texture planes have: they are not decoded but unpacked to blocks, in slots of their own,
  // slot_count of them, and relief has relief_slot_count (cache_budget.h). Not with kResolved. Else all is RGBA8 in
  // slot_count slots.
  PageCodec upload = PageCodec::kLossless;
  uint32_t relief_slot_count = 0;
  // Relief pages take half a slot; over a base mesh less where little is in them, or where their compact form does.
  ReliefParts relief_parts = ReliefParts::kOnlyHalves;
  int workers = 2;  // 0: nobody works but who calls takeJob and finishJob (simulations, deterministic tests)
  // Texture planes that the effect plan streams, in order; plane i goes to PageTableEntry::slots[i]. {kResolved} for a
  // fixed light: the worker then reads the stored planes of `format` and evaluates them under `light` per texel.
  std::vector<Plane> texture_planes;
  TextureFormat format;
  // With it the pages of kNormalPlane are made of the relief's (relief_normals.h), which the source has; reads are
  // counted under relief. Not with blocks.
  std::optional<ReliefSurface> normals_of;
  std::array<double, 3> light{0, 0, 1};  // the unit vector towards it, in the artwork's space
  int max_reads = 0;          // reads under way at most, where a source is slow; fewer than workers: as many as workers
  uint32_t ready_limit = 64;  // decoded pages that may wait for a slot; workers pause when that many do
};

// Texels to copy into a slot of the page pool. The memory lives until the next beginFrame().
struct PageUpload {
  SlotIndex
      slot;  // of the texture's or the relief's, where those are two; of relief the name of a part (subslot_cache.h)
  PageId id;
  const uint8_t* texels;  // kSlotBytes, or slotBytes() of blocks; of relief to be packed (relief_subslots.h)
};

// Reading and decoding are counted under the planes that are stored, uploads under the planes that are streamed: they
// differ for kResolved. Since the start, unless it says "now".
struct StreamerStats {
  using ByPlane = std::array<uint64_t, kPlaneNumbers>;  // by plane number
  ByPlane pages_read{}, bytes_read{}, pages_decoded{}, pages_uploaded{};
  ByPlane bytes_decoded{}, bytes_uploaded{};  // texels
  // Now, by state and plane number; pinned roots that show a stand-in (damaged, or another light) are not Resident
  // here.
  std::array<ByPlane, kPageStates> pages{};
  std::array<std::array<uint64_t, kPageStates>, kPageStates> moves{};  // changes of state, [from][to]
  uint64_t queued = 0, decoding = 0, ready = 0;                        // now
  uint64_t resident = 0, resident_bytes = 0;                           // slots in use now, and what they hold
  uint64_t relief_bytes = 0;      // of those, slots that are divided for relief: whole, however full
  uint64_t hits = 0, misses = 0;  // pages that a new request list names: resident when it came, or not
  uint64_t evictions = 0, failed_pages = 0, retries = 0;  // which pages failed: PageStreamer::failures()
  // No longer wanted when it was still to be read; when it had been read; when it had been decoded. And their sum.
  uint64_t cancelled_before_read = 0, cancelled_before_decode = 0, cancelled_after_decode = 0, cancelled = 0;
  // Pages that a worker took for a predicted view only; wanted later (also while under way); gone without ever being
  // wanted. What is missing in the sum is still there or under way.
  uint64_t prefetched = 0, prefetch_used = 0, prefetch_wasted = 0;
  uint64_t deferred = 0;   // pages that found no slot in the last frame: the working set exceeds the cache
  uint64_t wanted = 0;     // pages that the last request lists name, without those that failed for good
  double detail_bias = 0;  // now
  // From the frame whose request list first wanted a page (and had room for it) to the frame in which it is placed, and
  // so shown; by the clock of beginFrame.
  LatencySummary latency_ms, latency_frames;
};

class PageStreamer {
 public:
  // decoder: null is PageDecoder, one per worker.
  PageStreamer(std::shared_ptr<const PageSource> source, StreamerOptions options, SlotDecoder decoder = {});
  ~PageStreamer();  // stops the workers; waits for the reads under way

  // Pages that are loaded at once and stay (the roots of every plane in use). Call before the first frame.
  // A root that cannot be read is replaced by a neutral page (mid-grey texture, flat relief), counted and named, so
  // that a look-up always ends somewhere. Their uploads come with the next placeReady, beyond its limit.
  void pinRoots(std::span<const NodeId> texture_roots, std::span<const NodeId> relief_roots);

  // A frame, in this order. now_s drives back-off and the page fade.
  void beginFrame(uint64_t frame, double now_s);  // frame > 0, growing
  // The newest request lists; each replaces the previous of its kind. A list that is not replaced in a frame still
  // holds. centre_distance may be any urgency from 0 (first) to 2; what is negative or not a number counts as 2.
  void requestTexture(std::span<const NodeRequest> requests);
  void requestRelief(std::span<const NodeRequest> requests);
  // Pages that a predicted view will want; replaces the previous such lists. They come after all that is wanted now,
  // evict nothing that was used in the last kSparedFrames frames, have no room while detailBias() is above 0, and are
  // cancelled when no longer listed. One that becomes wanted is not read again.
  void requestPrefetch(std::span<const NodeRequest> texture, std::span<const NodeRequest> relief);
  // Touches what is resident of both lists and queues what is not; then places decoded pages (at most max_uploads) and
  // returns what to upload; updates the page table.
  std::span<const PageUpload> placeReady(uint32_t max_uploads);

  // What the workers do; any thread may. The best job, if one is to be had (see PageJobs::take); to be finished by
  // finishJob, which reads, decodes and delivers on the calling thread, or gives up where the job is no longer wanted.
  std::optional<PageJob> takeJob();
  void finishJob(const PageJob& job);
  bool jobWanted(const PageJob& job) const;  // false: cancelled meanwhile

  // Relief pages in use by the geometry being drawn stay until released (counted).
  SlotIndex findRelief(const NodeId& node) const;
  bool pinRelief(const NodeId& node);  // false: not resident (any more), nothing was pinned
  void unpinRelief(const NodeId& node);
  // Resident relief nodes, sorted, for the LOD worker; the generation changes whenever the set does.
  std::vector<NodeId> residentRelief() const;
  uint64_t reliefGeneration() const;

  // For kResolved: another fixed light. Pages resolved under the old one are dropped, except pinned roots: those show
  // the old light until their new texels arrive, before everything else. The others are resolved when they are wanted
  // again.
  void setLight(const std::array<double, 3>& light);

  // How many texture levels coarser the view should ask (add to its LOD bias) so that its requests fit the cache
  // (detail_bias.h); 0..kMaxDetailBias. Follows the request lists with each placeReady.
  double detailBias() const;
  // The detail bias that the request lists from now on were made with; nothing (as at first): not known, they follow it
  // by kLatencyLists at most. moved: the view is another one than that of the lists before.
  void setRequestBias(std::optional<double> bias, bool moved = false);

  // Everything that the last request lists ask for is resident (or has failed for good, or has no room at the largest
  // detail bias), nothing is under way, and the detail bias holds still.
  bool settled() const;
  PageState state(PageId id) const;
  const StreamerStats& stats() const;
  const PageFailures& failures() const;  // for good, since the start
  PageTable& table();
  const SubslotCache& cache(Plane plane = texturePlane(0)) const;  // where its pages sit
  // Cache, page table (without its texture) and what is known of each slot; not the pages that are on their way.
  uint64_t metadataBytes() const;
  uint64_t bufferBytes() const;  // upper bound of what decoded pages and scratch memory take
  // Messages that a user should see (each failed page once); cleared by the call.
  std::vector<std::string> takeMessages();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace relievo
