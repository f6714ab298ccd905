// page_streamer.h - the life of a page from a request to texels in a slot of the cache. Owned by the render thread;
// reading and decoding happen on worker threads. Nothing here waits for them, except pinRoots (start-up) and the
// destructor.
//
//   Absent -> Queued -> Decoding -> Ready -> Resident -> Absent        and Failed: texturing/README.md has the diagram
//
// - Late results: each request carries a ticket. A result whose ticket is not that of a page in state Decoding is
// dropped, in one place (takeResults).
// - Order of service (page_rank.h), recomputed in every frame: requested pages, then predicted ones, then those of the
// list before the newest; within a tier coarse before fine, then near the view's centre.
// - Room: a requested page is never evicted for another requested one, and a missing node is requested only if all of
// its planes find slots (relief: half of one) beside everything else that is requested. So a working set larger than
// the cache comes to rest without loads instead of thrashing. Pages without room are counted (deferred), and
// detailBias() asks the view for less.
// - Errors: kInvalidData without a byte offset means that the source has no such page, and is final. Other errors are
// retried, up to kMaxAttempts attempts.
// - Memory: at most bufferBytes(), besides the slots (on the GPU) and the first upload of the roots.
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
  uint32_t slot_count = 1024;  // the cache budget divided by kSlotBytes; at most kMaxSlots
  // A block codec that all texture planes have: they are unpacked to blocks instead of decoded, in slot_count slots of
  // their own, and relief has relief_slot_count (cache_budget.h). Not with kResolved. Any other codec: everything is
  // RGBA8 in slot_count slots.
  PageCodec upload = PageCodec::kLossless;
  uint32_t relief_slot_count = 0;
  // Relief pages take half a slot, or smaller parts over a base mesh where few samples or their compact form suffice.
  ReliefParts relief_parts = ReliefParts::kOnlyHalves;
  int workers = 2;  // 0: only callers of takeJob and finishJob work (simulations, deterministic tests)
  // Texture planes that the effect plan streams; plane i goes to PageTableEntry::slots[i]. {kResolved} for a fixed
  // light: the worker reads the stored planes of `format` and evaluates them under `light` for each texel.
  std::vector<Plane> texture_planes;
  TextureFormat format;
  // If set, the pages of kNormalPlane are computed from the source's relief pages (relief_normals.h), and their reads
  // are counted under relief. Not with blocks.
  std::optional<ReliefSurface> normals_of;
  std::array<double, 3> light{0, 0, 1};  // unit vector towards the light, in the artwork's space
  int max_reads = 0;          // largest number of reads under way, for a slow source; at least as many as workers
  uint32_t ready_limit = 64;  // number of decoded pages waiting for a slot at which workers pause
};

// Texels to copy into a slot of the page pool. Their memory is valid until the next beginFrame().
struct PageUpload {
  // Of the texture's or of the relief's slots, if these are separate; for relief the index of a part (subslot_cache.h).
  SlotIndex slot;
  PageId id;
  const uint8_t* texels;  // kSlotBytes, or slotBytes() of blocks; relief must be packed (relief_subslots.h)
};

// Reads and decodes are counted by stored plane, uploads by streamed plane; these differ for kResolved. Counts are
// since the start unless marked "now".
struct StreamerStats {
  using ByPlane = std::array<uint64_t, kPlaneNumbers>;  // by plane number
  ByPlane pages_read{}, bytes_read{}, pages_decoded{}, pages_uploaded{};
  ByPlane bytes_decoded{}, bytes_uploaded{};  // texels
  // Now, by state and plane number. Pinned roots that show a substitute (damaged, or of another light) do not count as
  // Resident.
  std::array<ByPlane, kPageStates> pages{};
  std::array<std::array<uint64_t, kPageStates>, kPageStates> moves{};  // transitions, [from][to]
  uint64_t queued = 0, decoding = 0, ready = 0;                        // now
  uint64_t resident = 0, resident_bytes = 0;                           // slots in use now, and their bytes
  uint64_t relief_bytes = 0;      // of these, slots that are divided for relief, however full
  uint64_t hits = 0, misses = 0;  // pages named by a new request list: resident at that time, or not
  uint64_t evictions = 0, failed_pages = 0, retries = 0;  // PageStreamer::failures() lists the failed pages
  // Cancelled before the read; after the read; after decoding; and their sum.
  uint64_t cancelled_before_read = 0, cancelled_before_decode = 0, cancelled_after_decode = 0, cancelled = 0;
  // Pages that a worker took only for a predicted view; of these, pages requested later (also while under way); pages
  // that left without being requested. The rest is still resident or under way.
  uint64_t prefetched = 0, prefetch_used = 0, prefetch_wasted = 0;
  uint64_t deferred = 0;   // pages that found no slot in the last frame: the working set exceeds the cache
  uint64_t wanted = 0;     // pages named by the last request lists, without those that failed for good
  double detail_bias = 0;  // now
  // From the frame whose request list first named a page (and had room for it) to the frame in which it is placed and
  // shown, by the clock of beginFrame.
  LatencySummary latency_ms, latency_frames;
};

class PageStreamer {
 public:
  // decoder: null for a PageDecoder for each worker.
  PageStreamer(std::shared_ptr<const PageSource> source, StreamerOptions options, SlotDecoder decoder = {});
  ~PageStreamer();  // stops the workers and waits for reads under way

  // Loads pages that are never evicted: the roots of every plane in use. Call it before the first frame. A root that
  // cannot be read is replaced by a neutral page (mid-grey texture, flat relief), counted and reported, so that a
  // look-up always finds a page. The uploads come with the next placeReady, beyond its limit.
  void pinRoots(std::span<const NodeId> texture_roots, std::span<const NodeId> relief_roots);

  // Call the following once for each frame, in this order. now_s drives the delay between attempts and the page fade.
  void beginFrame(uint64_t frame, double now_s);  // frame > 0, growing
  // The newest request lists; each replaces the previous one of its kind, and holds until it is replaced.
  // centre_distance may be any urgency from 0 (first) to 2; negative values and NaN count as 2.
  void requestTexture(std::span<const NodeRequest> requests);
  void requestRelief(std::span<const NodeRequest> requests);
  // Pages of a predicted view; replaces the previous such lists. They come after all requested pages, evict nothing
  // used in the last kSparedFrames frames, have no room while detailBias() is above 0, and are cancelled when they are
  // no longer listed. A prefetched page that is requested later is not read again.
  void requestPrefetch(std::span<const NodeRequest> texture, std::span<const NodeRequest> relief);
  // Touches resident pages of both lists and queues missing ones; then places at most max_uploads decoded pages,
  // updates the page table, and returns the uploads.
  std::span<const PageUpload> placeReady(uint32_t max_uploads);

  // The work of a worker thread; may be called from any thread. takeJob() returns the best available job
  // (PageJobs::take). finishJob() must follow: it reads, decodes and delivers on the calling thread, or gives up if the
  // job was cancelled.
  std::optional<PageJob> takeJob();
  void finishJob(const PageJob& job);
  bool jobWanted(const PageJob& job) const;  // false: cancelled meanwhile

  // Relief pages that the drawn geometry uses stay until they are unpinned as often as pinned.
  SlotIndex findRelief(const NodeId& node) const;
  bool pinRelief(const NodeId& node);  // false: not resident, and not pinned
  void unpinRelief(const NodeId& node);
  // Resident relief nodes, sorted, for the LOD worker. The generation changes whenever the set does.
  std::vector<NodeId> residentRelief() const;
  uint64_t reliefGeneration() const;

  // For kResolved: sets another fixed light. Pages resolved under the old light are dropped, and resolved again when
  // they are requested. Only pinned roots show the old light until their new texels arrive, before everything else.
  void setLight(const std::array<double, 3>& light);

  // The number of texture levels, 0 to kMaxDetailBias, by which the view should request coarser pages (to be added to
  // its LOD bias) so that its requests fit the cache (detail_bias.h). Updated by placeReady.
  double detailBias() const;
  // The detail bias with which the following request lists are made. Nothing (the default): unknown; lists follow the
  // bias within kLatencyLists. moved: the view differs from that of the previous lists.
  void setRequestBias(std::optional<double> bias, bool moved = false);

  // True if nothing that was requested is on its way: no page is queued or being read or decoded, and none is to be
  // read again. Then only other request lists, or another detail bias, make pages come. Decoded pages may wait for a
  // place.
  bool atRest() const;
  // True if every page of the last request lists is resident (or has failed for good, or has no room at the largest
  // detail bias), nothing is under way, and the detail bias does not change.
  bool settled() const;
  PageState state(PageId id) const;
  const StreamerStats& stats() const;
  const PageFailures& failures() const;  // pages that failed for good, since the start
  PageTable& table();
  const SubslotCache& cache(Plane plane = texturePlane(0)) const;  // the cache that holds this plane's pages
  // The memory of the cache, the page table (without its texture) and the state of slots; without pages under way.
  uint64_t metadataBytes() const;
  uint64_t bufferBytes() const;  // upper bound of the memory of decoded pages and scratch
  // Messages for the user (each failed page once). The call clears them.
  std::vector<std::string> takeMessages();

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace relievo
