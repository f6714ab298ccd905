#include "texturing/stream/page_streamer.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <deque>
#include <optional>
#include <tuple>
#include <unordered_map>
#include <utility>

#include "src/base/parallel_for.h"
#include "texturing/codec/neutral_page.h"
#include "texturing/codec/page_codec.h"
#include "texturing/stream/cache_budget.h"
#include "texturing/stream/relief_subslots.h"
#include "texturing/stream/slot_pool.h"

namespace relievo {

namespace {

constexpr double kFirstBackOff_s = 0.1;
constexpr double kBackOffFactor = 4;
constexpr double kFadeEnd_s = 256;                  // longer than any fade; the fade's clock wraps after 1,024 s
constexpr size_t kMaxMessages = 1024;               // between two calls of takeMessages; further ones are only counted
constexpr size_t kMaxRememberedFailures = 65536;    // remembered failures, without those that are requested
constexpr std::ptrdiff_t kMaxPublishedJobs = 1024;  // jobs for each frame, more than workers can take until the next
constexpr uint64_t kNever = ~uint64_t{0};
constexpr uint64_t kAlways = kNever - 1;  // as the number of a request list: requested whatever the lists say

// The largest number of nodes: each has a slot for each of its planes.
uint32_t nodesAtMost(uint32_t slots, size_t planes) { return planes == 0 ? 0 : slots / static_cast<uint32_t>(planes); }

// A page in a state other than Absent, or Resident with more to remember.
struct Page {
  PageState state = PageState::kAbsent;
  bool permanent = false;    // kFailed for good
  bool speculative = false;  // prefetched, and not requested since
  int attempts = 0;
  uint64_t ticket = 0;
  uint64_t list = kNever;     // the last request list of its kind that named it
  uint64_t prefetch = 0;      // the last plan that prefetched it
  uint64_t plan = 0;          // the last plan that counted it
  uint64_t published_in = 0;  // the last plan that published it to the workers
  uint64_t wanted_frame = 0;  // the frame in which it was first requested; 0: it is not
  double wanted_s = 0;
  double retry_at_s = 0;
  float centre = 0;
  int part_level = 0;
  Texels texels;  // kReady
};

struct RequestedNode {
  NodeId node;
  float centre = 0;
  bool relief = false;
  friend bool operator<(const RequestedNode& a, const RequestedNode& b) {
    auto key = [](const RequestedNode& w) { return std::tuple(w.node.level, w.centre, !w.relief, packNode(w.node)); };
    return key(a) < key(b);
  }
};

}  // namespace

struct PageStreamer::Impl {
  Impl(std::shared_ptr<const PageSource> source_in, StreamerOptions options_in, SlotDecoder decoder_in)
      : source(std::move(source_in)),
        options(std::move(options_in)),
        decoder(std::move(decoder_in)),
        table(nodesAtMost(std::min(options.slot_count, kMaxSlots), options.texture_planes.size()),
              static_cast<int>(options.texture_planes.size())) {
    const bool blocks = isBlockCodec(options.upload);
    assert(!blocks || std::find(options.texture_planes.begin(), options.texture_planes.end(), Plane::kResolved) ==
                          options.texture_planes.end());
    pools.emplace_back(options.slot_count);
    if (blocks) pools.emplace_back(options.relief_slot_count);
    options.workers = std::max(0, options.workers);
    options.ready_limit = std::max(1u, options.ready_limit);
    if (options.normals_of) normals.emplace(*options.normals_of);
    jobs.emplace(*source, options.format, decoder, options.upload, options.relief_parts, options.workers,
                 options.max_reads, size_t(options.workers) + options.ready_limit, normals ? &*normals : nullptr);
    jobs->setLight(
        options.light, [](const PageJob&) { return true; }, started);
  }

  // --- states -------------------------------------------------------------------------------------------------------

  uint64_t count(PageState s) const { return state_counts.count(s); }
  void setState(PageId id, Page& page, PageState s) {
    state_counts.move(static_cast<size_t>(id.plane()), page.state, s);
    page.state = s;
  }
  using PageMap = std::unordered_map<PageId, Page>;
  PageMap::iterator forget(PageMap::iterator it) {
    Page& page = it->second;
    if (page.state != PageState::kAbsent) setState(it->first, page, PageState::kAbsent);
    return erase(it);
  }
  PageMap::iterator erase(PageMap::iterator it) {
    if (it->second.texels) returned.push_back(std::move(it->second.texels));
    return pages.erase(it);
  }
  bool isRelief(PageId id) const { return id.plane() == Plane::kRelief; }
  // One pool for all pages, or one for texture and one for relief.
  size_t poolIndex(bool relief) const { return relief && pools.size() > 1 ? 1 : 0; }
  SlotPool& poolOf(PageId id) { return pools[poolIndex(isRelief(id))]; }
  const SlotPool& poolOf(PageId id) const { return pools[poolIndex(isRelief(id))]; }
  SlotIndex find(PageId id) const { return poolOf(id).cache.find(id); }
  Tier tierOf(PageId id, const Page& page) const {
    uint64_t newest = list[isRelief(id)];
    if (page.list == kAlways || page.list == newest) return Tier::kVisible;
    if (page.prefetch == plan_number) return Tier::kPrefetch;
    return page.list + 1 == newest ? Tier::kRecent : Tier::kNone;
  }
  PageRank rankOf(PageId id, const Page& page) const { return {tierOf(id, page), page.centre, id}; }

  void addMessage(std::string text) {
    if (messages.size() < kMaxMessages) messages.push_back(std::move(text));
  }

  // Requests a page that has (or will have) room.
  void request(PageId id, float centre, uint64_t in_list) {
    Page& page = pages[id];
    page.list = in_list;
    page.plan = plan_number;
    page.centre = centre;
    if (page.wanted_frame == 0) {
      page.wanted_frame = frame;
      page.wanted_s = now_s;
    }
    if (page.speculative) {
      page.speculative = false;
      stats.prefetch_used += page.state != PageState::kQueued;
    }
    bool retry = page.state == PageState::kFailed && !page.permanent && now_s >= page.retry_at_s;
    if (page.state == PageState::kAbsent || retry) enqueue(id, page);
    stats.retries += retry;
  }
  void prefetch(PageId id, float centre) {
    Page& page = pages[id];
    page.prefetch = plan_number;
    if (page.state != PageState::kAbsent) return;
    page.speculative = true;
    page.centre = centre;
    enqueue(id, page);
  }
  void enqueue(PageId id, Page& page) {
    if (auto known = dropped_attempts.extract(id)) page.attempts = known.mapped();
    page.ticket = ++last_ticket;
    setState(id, page, PageState::kQueued);
    queued.push_back(id);
  }

  void fail(PageId id, Page& page, const Error& error, bool permanent) {
    setState(id, page, PageState::kFailed);
    ++page.attempts;
    stats.prefetch_wasted += std::exchange(page.speculative, false);
    page.permanent = permanent || page.attempts >= kMaxAttempts;
    page.retry_at_s = now_s + kFirstBackOff_s * std::pow(kBackOffFactor, page.attempts - 1);
    if (!page.permanent) return;
    ++stats.failed_pages;
    failures.add(id, error);
    std::erase(refresh, id);
    addMessage(pageDescription(id) + " cannot be shown: " + error.text());
  }

  void account(const std::vector<LoadCost>& costs) {
    for (const LoadCost& c : costs) {
      auto p = static_cast<size_t>(c.plane);
      ++stats.pages_read[p];
      stats.bytes_read[p] += c.bytes;
      stats.pages_decoded[p] += c.decoded;
    }
  }

  // --- workers ------------------------------------------------------------------------------------------------------

  PageMap::iterator findInState(PageId id, uint64_t ticket, PageState state) {
    auto it = pages.find(id);
    return it != pages.end() && it->second.ticket == ticket && it->second.state == state ? it : pages.end();
  }

  void noteStarted(const std::vector<PageJob>& started_jobs) {
    for (const PageJob& job : started_jobs) {
      auto it = findInState(job.id, job.ticket, PageState::kQueued);
      if (it == pages.end()) continue;
      setState(job.id, it->second, PageState::kDecoding);
      stats.prefetched += it->second.speculative;
    }
  }

  void takeResults() {
    jobs->collect(report, returned);
    noteStarted(report.started);
    for (LoadOutcome& o : report.done) {
      account(o.costs);
      auto it = findInState(o.id, o.ticket, PageState::kDecoding);
      switch (o.end) {
        case LoadOutcome::End::kCancelledBeforeRead:
        case LoadOutcome::End::kCancelledBeforeDecode:
          ++(o.end == LoadOutcome::End::kCancelledBeforeRead ? stats.cancelled_before_read
                                                             : stats.cancelled_before_decode);
          if (it != pages.end()) drop(it);
          break;
        case LoadOutcome::End::kFailed:
          if (it != pages.end()) {
            fail(o.id, it->second, *o.error, o.permanent);
          } else {
            ++stats.cancelled_after_decode;
            auto again = pages.find(o.id);
            ++(again == pages.end() ? dropped_attempts[o.id] : again->second.attempts);
          }
          break;
        case LoadOutcome::End::kLoaded:
          if (it == pages.end()) {
            ++stats.cancelled_after_decode;
            returned.push_back(std::move(o.texels));
            break;
          }
          it->second.texels = std::move(o.texels);
          it->second.part_level = o.part_level;
          setState(o.id, it->second, PageState::kReady);
          ready.push_back(o.id);
      }
    }
  }

  // Forgets a page that is under way; a prefetch was in vain.
  PageMap::iterator drop(PageMap::iterator it) {
    stats.prefetch_wasted += it->second.speculative && it->second.state != PageState::kQueued;
    if (it->second.attempts > 0) dropped_attempts[it->first] = it->second.attempts;
    return forget(it);
  }

  // --- requests ---

  void toRequestedNodes(bool relief, std::span<const NodeRequest> requests, std::vector<RequestedNode>& out) {
    out.clear();
    out.reserve(requests.size());
    for (const NodeRequest& w : requests)
      out.push_back({w.node, w.centre_distance >= 0 ? std::min(w.centre_distance + 0.0f, 2.0f) : 2.0f, relief});
    if (!std::is_sorted(out.begin(), out.end())) std::sort(out.begin(), out.end());
  }
  static void merge(const std::array<std::vector<RequestedNode>, 2>& lists, std::vector<RequestedNode>& out) {
    out.clear();
    std::merge(lists[0].begin(), lists[0].end(), lists[1].begin(), lists[1].end(), std::back_inserter(out));
  }
  void request(bool relief, std::span<const NodeRequest> requests) {
    ++list[relief];
    is_new[relief] = true;
    toRequestedNodes(relief, requests, requested[relief]);
    merge(requested, merged);
    planned_frame = kNever;
  }

  std::span<const Plane> planesOf(const RequestedNode& w) const {
    static constexpr Plane kReliefOnly[] = {Plane::kRelief};
    return w.relief ? std::span<const Plane>(kReliefOnly) : std::span<const Plane>(options.texture_planes);
  }

  // Counts a used slot once for each plan, however often it is named; pinned ones are counted apart.
  void use(SlotPool& pool, SlotIndex slot, bool new_list) {
    pool.cache.touch(slot, frame);
    SlotUse& s = pool.slotOf(slot);
    if (!s.count(plan_number)) return;
    pool.recent.use(partOf(slot).slot);
    stats.hits += new_list;
    stats.prefetch_used += s.takePrefetched();
    ++wanted_pages;
    pool.countResident(slot, plan_number);
  }

  // The number of a node's missing pages; nothing if one of them can never be loaded.
  std::optional<uint32_t> absentPages(const RequestedNode& w) const {
    uint32_t absent = 0;
    for (Plane p : planesOf(w)) {
      PageId id(p, w.node);
      if (find(id) != kNoSlot) continue;
      ++absent;
      auto it = pages.find(id);
      if (it != pages.end() && it->second.permanent) return {};
    }
    return absent;
  }

  // Carries out the request lists: touches resident pages, gives the remaining room to missing ones and then to
  // predicted ones, cancels pages that are no longer requested, and publishes the workers' new jobs.
  void plan() {
    // Predicted pages count as used in the last frame: before current ones, behind those of this frame.
    if (touched_frame != frame) {
      touched_frame = frame;
      for (const auto& [slot, id] : predicted)
        if (find(id) == slot) poolOf(id).cache.touch(slot, frame - 1);
    }
    ++plan_number;
    planned_frame = frame;
    wanted_pages = 0;
    for (SlotPool& pool : pools) pool.beginPlan();
    missing.clear();
    for (const RequestedNode& w : merged) {
      auto planes = planesOf(w);
      if (!w.relief) {
        if (auto entry = table.find(w.node)) {
          for (size_t i = 0; i < planes.size(); ++i) use(pools[0], entry->slots[i], is_new[0]);
          continue;
        }
      }
      auto absent = absentPages(w);
      if (!absent) continue;  // it will never show, so that its resident pages need not stay
      for (Plane p : planes)
        if (SlotIndex slot = find(PageId(p, w.node)); slot != kNoSlot)
          use(pools[poolIndex(w.relief)], slot, is_new[w.relief]);
      if (*absent > 0) missing.emplace_back(&w, *absent);
    }

    for (const PageId& id : refresh) request(id, 0, kAlways);
    for (const auto& [node, absent] : missing) {
      // A node that is named twice is counted once.
      auto planes = planesOf(*node);
      auto same_node = pages.find(PageId(planes.back(), node->node));
      if (same_node != pages.end() && same_node->second.plan == plan_number) continue;
      wanted_pages += absent;
      if (is_new[node->relief]) stats.misses += absent;
      SlotPool& pool = pools[poolIndex(node->relief)];
      if (!pool.reserve(node->relief, absent)) {
        pool.deferred += absent;
        pool.deferred_relief += node->relief;
        continue;
      }
      for (Plane p : planes) {
        PageId id(p, node->node);
        if (find(id) == kNoSlot) request(id, node->centre, list[node->relief]);
      }
    }
    stats.deferred = 0;
    for (SlotPool& pool : pools) {
      pool.demand = pool.slots_used + pool.deferred - pool.deferred_relief / 2;
      stats.deferred += pool.deferred;
    }
    stats.wanted = wanted_pages;
    is_new = {};
    for (SlotPool& pool : pools)
      pool.unreserved_halves =
          static_cast<int64_t>(pool.free_halves + 2 * (pool.cache.slotCount() -
                                                       std::min<uint64_t>(pool.slots_used, pool.cache.slotCount())));
    planPrefetch();
    for (SlotPool& pool : pools)
      pool.openable_slots =
          pool.opened_slots + pool.cache.slotCount() - std::min<uint64_t>(pool.slots_used, pool.cache.slotCount());
    publish();
    if (count(PageState::kFailed) > kMaxRememberedFailures) forgetFailures();
    if (dropped_attempts.size() > kMaxRememberedFailures) dropped_attempts.clear();
  }

  void planPrefetch() {
    predicted.clear();
    if (stats.deferred > 0 || bias.value() > 0) return;
    for (SlotPool& pool : pools) {
      pool.slots_used += pool.recent.idleCount();
      pool.free_halves = 0;  // idle halves beside used ones may have been used recently
    }
    for (const RequestedNode& w : predictions) {
      SlotPool& pool = pools[poolIndex(w.relief)];
      auto entry = w.relief ? std::nullopt : table.find(w.node);
      if (entry && pool.slotOf(entry->slots[0]).counted(plan_number)) continue;  // requested now
      auto absent = entry ? std::optional<uint32_t>(0) : absentPages(w);
      if (!absent || (pool.slots_used + *absent > pool.cache.slotCount() && !(w.relief && pool.free_halves > 0)))
        continue;
      for (Plane p : planesOf(w)) {
        PageId id(p, w.node);
        SlotIndex slot = pool.cache.find(id);
        if (slot == kNoSlot) {
          auto it = pages.find(id);
          bool counted = it != pages.end() && (it->second.plan == plan_number || it->second.prefetch == plan_number);
          if (!counted) pool.reserve(w.relief, 1);
          prefetch(id, w.centre);
        } else if (pool.slotOf(slot).count(plan_number)) {
          const uint64_t halves = pool.free_halves;
          pool.countResident(slot, plan_number, true);
          pool.free_halves = halves;
          predicted.emplace_back(slot, id);
        }
      }
    }
  }

  void publish() {
    if (queued.empty() && !published && count(PageState::kDecoding) == 0) return;
    published_jobs.clear();
    unwanted.clear();
    size_t kept = 0;
    for (const PageId& id : queued) {
      auto it = pages.find(id);
      if (it == pages.end() || it->second.state != PageState::kQueued) continue;
      if (std::exchange(it->second.published_in, plan_number) == plan_number) continue;
      PageRank rank = rankOf(id, it->second);
      if (rank.tier() == Tier::kNone) {
        unwanted.push_back(id);
        continue;
      }
      queued[kept++] = id;
      published_jobs.push_back({rank, it->second.ticket});
    }
    queued.resize(kept);
    auto last = [](const RankedJob& a, const RankedJob& b) { return b.rank < a.rank; };
    if (std::ssize(published_jobs) > kMaxPublishedJobs) {
      std::nth_element(published_jobs.begin(), published_jobs.end() - kMaxPublishedJobs, published_jobs.end(), last);
      published_jobs.erase(published_jobs.begin(), published_jobs.end() - kMaxPublishedJobs);
    }
    std::sort(published_jobs.begin(), published_jobs.end(), last);
    published = !published_jobs.empty();
    jobs->publish(published_jobs, started, [&](const PageJob& job) {
      auto it = pages.find(job.id);
      return it != pages.end() && it->second.ticket == job.ticket && tierOf(job.id, it->second) != Tier::kNone;
    });
    noteStarted(started);
    for (const PageId& id : unwanted) {
      auto it = pages.find(id);
      if (it->second.state != PageState::kQueued) continue;  // taken meanwhile: the worker cancels it
      ++stats.cancelled_before_read;
      drop(it);
    }
  }

  void forgetFailures() {
    for (auto it = pages.begin(); it != pages.end();) {
      bool old = it->second.state == PageState::kFailed && tierOf(it->first, it->second) == Tier::kNone;
      it = old ? forget(it) : std::next(it);
    }
  }

  // --- slots --------------------------------------------------------------------------------------------------------

  void addToTable(PageId id) {
    if (isRelief(id)) {
      ++relief_generation;
      return;
    }
    PageTableEntry entry;
    for (size_t i = 0; i < options.texture_planes.size(); ++i) {
      SlotIndex slot = find(PageId(options.texture_planes[i], id.node()));
      if (slot == kNoSlot) return;
      entry.slots[i] = static_cast<uint16_t>(slot);
    }
    entry.birth = fadeClock(now_s);
    table.insert(id.node(), entry);
    fade_starts.push_back({now_s, id.node()});
  }
  // Clears births before the fade's clock wraps, or the pages would fade again.
  void endFades() {
    for (; !fade_starts.empty() && fade_starts.front().at_s < now_s - kFadeEnd_s; fade_starts.pop_front()) {
      auto entry = table.find(fade_starts.front().node);
      if (!entry || entry->birth != fadeClock(fade_starts.front().at_s)) continue;  // evicted, or entered again
      entry->birth = 0;
      table.insert(fade_starts.front().node, *entry);
    }
  }
  void removeFromTable(PageId id) {
    if (isRelief(id)) {
      ++relief_generation;
    } else {
      table.erase(id.node());
    }
  }

  // The page's texels leave their slot, or become outdated. mark: the state of the slot.
  void vacate(SlotUse& mark, PageId id) {
    state_counts.move(static_cast<size_t>(id.plane()), PageState::kResident, PageState::kAbsent);
    stats.prefetch_wasted += mark.takePrefetched();
    removeFromTable(id);
  }
  void upload(SlotIndex slot, PageId id, const uint8_t* texels) {
    uploads.push_back({slot, id, texels});
    ++stats.pages_uploaded[static_cast<size_t>(id.plane())];
    stats.bytes_uploaded[static_cast<size_t>(id.plane())] +=
        isRelief(id) ? partBytes(partOf(slot).level) : slotBytes(options.upload, id.plane());
  }

  void placeReady(uint32_t max_uploads) {
    takeResults();
    if (planned_frame != frame) plan();
    uploads.clear();
    for (auto& [id, texels] : root_uploads) {
      upload(find(id), id, texels.get());
      uploaded_roots.push_back(std::move(texels));
    }
    root_uploads.clear();

    ranked.clear();
    for (const PageId& id : ready) {
      auto it = pages.find(id);
      if (it != pages.end() && it->second.state == PageState::kReady) ranked.push_back(rankOf(id, it->second));
    }
    std::sort(ranked.begin(), ranked.end());
    ready.clear();
    uint32_t placed = 0;
    const auto compactCounted = [&](const Page& page) { return page.plan == plan_number && isThird(page.part_level); };
    size_t compact_left = 0;  // that will be placed in this frame
    for (size_t i = 0; i < std::min<size_t>(ranked.size(), max_uploads); ++i)
      compact_left += compactCounted(pages.at(ranked[i].id));
    for (const PageRank& r : ranked) {
      auto it = pages.find(r.id);
      if (compact_left > 0 && compactCounted(it->second)) --compact_left;
      SlotPool& pool = poolOf(r.id);
      SlotIndex before = pool.cache.find(r.id);
      std::optional<SubslotCache::Placement> placement;
      // Requested pages may evict all that are not; others only those that were not used for a while.
      bool upload_left = placed < max_uploads;
      const uint32_t min_age = r.tier() == Tier::kVisible ? 1 : kSparedFrames;
      if (upload_left)
        placement = isRelief(r.id) ? pool.placeRelief(r.id, frame, min_age, it->second.part_level,
                                                      it->second.plan == plan_number, compact_left > 0)
                                   : pool.cache.place(r.id, frame, min_age);
      if (!placement) {
        if (r.tier() == Tier::kNone || (upload_left && r.tier() == Tier::kPrefetch)) {
          ++stats.cancelled_after_decode;
          drop(it);
        } else {
          stats.deferred += upload_left && r.tier() == Tier::kVisible;
          ready.push_back(r.id);
        }
        continue;
      }
      ++placed;
      pool.resizeTables();
      for (const auto& out : placement->evicted) {
        ++stats.evictions;
        vacate(pool.slots[static_cast<size_t>(out.level)][out.index], out.page);
      }
      const uint32_t whole = partOf(placement->slot).slot;
      if (placement->emptied) pool.recent.forget(whole);
      Page& page = it->second;
      pool.slotOf(placement->slot).setPrefetched(page.speculative);
      if (!page.speculative) pool.recent.use(whole);
      if (page.wanted_frame > 0) {
        latency_frames.add(frame - page.wanted_frame);
        latency_us.add(static_cast<uint64_t>(std::llround(std::max(0.0, now_s - page.wanted_s) * 1e6)));
      }
      upload(placement->slot, r.id, page.texels.get());
      uploaded.push_back(std::move(page.texels));
      setState(r.id, page, PageState::kResident);
      erase(it);
      if (before != kNoSlot) {
        std::erase(refresh, r.id);
      } else {
        addToTable(r.id);
      }
    }
    updateBias();
  }

  // --- detail -------------------------------------------------------------------------------------------------------

  void updateBias() {
    if (bias_list == list[0] + list[1]) return;  // no new request list
    bias_list = list[0] + list[1];
    // If there are two pools, the one in greater need counts, in slots of the first, so that the numbers are continuous
    // when the other one takes over.
    DetailDemand demand{
        .pages = 0, .room = 0, .overflow = stats.deferred > 0, .moved = std::exchange(view_moved, false)};
    for (const SlotPool& pool : pools) {
      const double wanted = static_cast<double>(pool.demand) - pool.roots;
      const double room = pool.cache.slotCount() - static_cast<double>(pool.roots);
      if (&pool == &pools[0]) {
        demand.pages = wanted;
        demand.room = room;
      } else {
        demand.pages = std::max(demand.pages, wanted * (std::max(1.0, demand.room) / std::max(1.0, room)));
      }
    }
    bias.observe(demand, request_bias);
  }

  std::shared_ptr<const PageSource> source;
  StreamerOptions options;
  SlotDecoder decoder;
  std::vector<SlotPool> pools;
  PageTable table;

  uint64_t frame = 0, planned_frame = 0, touched_frame = 0, plan_number = 0, last_ticket = 0;
  struct FadeStart {
    double at_s;
    NodeId node;
  };
  std::deque<FadeStart> fade_starts;  // in the page table, in the order of their times
  double now_s = 0;
  PageMap pages;
  PageStateCounts state_counts;
  std::unordered_map<PageId, int> dropped_attempts;  // of failed pages that were cancelled in a later attempt
  std::vector<PageId> queued, ready;                 // may contain pages that are in another state by now
  bool published = false;                            // the workers may still hold jobs of the last publish()
  std::vector<PageId> refresh;                       // pinned pages whose texels are outdated

  std::array<uint64_t, 2> list{};  // number of the newest request list: texture, relief
  std::array<bool, 2> is_new{};    // no plan has used it yet
  std::array<std::vector<RequestedNode>, 2> requested;
  std::vector<RequestedNode> merged;       // coarse before fine, then near the centre
  std::vector<RequestedNode> predictions;  // the same for the prefetch lists
  uint64_t wanted_pages = 0;
  std::vector<std::pair<SlotIndex, PageId>> predicted;  // resident, and expected to be requested

  std::vector<PageUpload> uploads;
  std::vector<Texels> uploaded, uploaded_roots, returned;
  std::vector<std::pair<PageId, Texels>> root_uploads;
  uint64_t relief_generation = 1;

  DetailBias bias;
  uint64_t bias_list = 0;
  std::optional<double> request_bias;
  bool view_moved = false;  // since the last list was evaluated

  StreamerStats stats;
  LatencyHistogram latency_us, latency_frames;
  PageFailures failures;
  std::vector<std::string> messages;

  // Scratch memory, kept between calls.
  std::array<std::vector<RequestedNode>, 2> next_predictions;
  std::vector<std::pair<const RequestedNode*, uint32_t>> missing;
  std::vector<RankedJob> published_jobs;
  std::vector<PageJob> started;
  std::vector<PageId> unwanted;
  std::vector<PageRank> ranked;
  PageJobs::Report report;

  std::optional<ReliefNormals> normals;
  std::optional<PageJobs> jobs;  // last, so that its threads end before what they use
};

PageStreamer::PageStreamer(std::shared_ptr<const PageSource> source, StreamerOptions options, SlotDecoder decoder)
    : impl_(std::make_unique<Impl>(std::move(source), std::move(options), std::move(decoder))) {}

PageStreamer::~PageStreamer() = default;

void PageStreamer::pinRoots(std::span<const NodeId> texture_roots, std::span<const NodeId> relief_roots) {
  Impl& m = *impl_;
  std::vector<LoadOutcome> roots;
  auto add = [&](Plane plane, const NodeId& node) {
    PageId id(plane, node);
    if (SlotIndex slot = m.find(id); slot != kNoSlot) {
      m.poolOf(id).cache.pin(slot);
      return;
    }
    roots.emplace_back();
    roots.back().id = id;
  };
  for (const NodeId& node : texture_roots)
    for (Plane p : m.options.texture_planes) add(p, node);
  for (const NodeId& node : relief_roots) add(Plane::kRelief, node);
  for (const SlotPool& pool : m.pools) {
    const size_t room = pool.cache.slotCount() - pool.cache.residentCount();
    size_t needed = 0;
    std::erase_if(roots, [&](const LoadOutcome& root) { return &m.poolOf(root.id) == &pool && ++needed > room; });
    if (needed <= room) continue;
    m.addMessage("the cache has " + std::to_string(pool.cache.slotCount()) +
                 " slots, the artwork's coarsest pages alone need " + std::to_string(needed) +
                 " (raise the cache's budget)");
  }

  auto makeLoader = [&] {
    return std::make_unique<PageLoader>(*m.source, m.options.format, m.decoder, m.options.upload,
                                        m.options.relief_parts, nullptr, m.normals ? &*m.normals : nullptr);
  };
  parallelForWith(roots.size(), std::max(m.options.workers, 1), nullptr, makeLoader,
                  [&](std::unique_ptr<PageLoader>& loader, size_t i) {
                    LoadOutcome& root = roots[i];
                    root.texels = makeTexels();
                    for (int attempt = 0; attempt < kMaxAttempts && !root.permanent; ++attempt) {
                      root.error.reset();
                      loader->load(
                          root.id, m.options.light, [] { return true; }, root.texels.get(), root);
                      if (!root.error) break;
                    }
                    if (root.error) neutralPage(root.id.plane(), m.options.format, m.options.upload, root.texels.get());
                    if (root.id.plane() == Plane::kRelief && root.part_level == 0) root.part_level = kReliefPartLevel;
                  });

  for (LoadOutcome& root : roots) {
    m.account(root.costs);
    SlotPool& pool = m.poolOf(root.id);
    auto placement = pool.cache.place(root.id, m.frame, 1, root.part_level);
    if (!placement) continue;
    pool.resizeTables();
    pool.cache.pin(placement->slot);
    pool.roots = pool.cache.pinnedCount();
    Page& page = m.pages[root.id];
    for (PageState s : {PageState::kQueued, PageState::kDecoding}) m.setState(root.id, page, s);
    if (root.error) {  // remembered, so that it is not tried (and reported) again
      m.setState(root.id, page, PageState::kFailed);
      page.permanent = true;
      page.list = kAlways;
      ++m.stats.failed_pages;
      m.failures.add(root.id, *root.error);
      m.addMessage("the coarsest " + pageDescription(root.id) +
                   " is damaged, a neutral one stands in: " + root.error->text());
    } else {
      for (PageState s : {PageState::kReady, PageState::kResident}) m.setState(root.id, page, s);
      m.pages.erase(root.id);
    }
    m.root_uploads.emplace_back(root.id, std::move(root.texels));
    m.addToTable(root.id);
  }
}

void PageStreamer::beginFrame(uint64_t frame, double now_s) {
  Impl& m = *impl_;
  m.frame = frame;
  m.now_s = now_s;
  for (SlotPool& pool : m.pools) pool.recent.beginFrame(frame);
  for (Texels& t : m.uploaded) m.returned.push_back(std::move(t));
  m.uploaded.clear();
  m.uploaded_roots.clear();
  m.uploads.clear();
  m.endFades();
  m.takeResults();
}

void PageStreamer::requestTexture(std::span<const NodeRequest> requests) {
  if (!impl_->options.texture_planes.empty()) impl_->request(false, requests);
}
void PageStreamer::requestRelief(std::span<const NodeRequest> requests) { impl_->request(true, requests); }

void PageStreamer::requestPrefetch(std::span<const NodeRequest> texture, std::span<const NodeRequest> relief) {
  Impl& m = *impl_;
  if (m.options.texture_planes.empty()) texture = {};
  m.toRequestedNodes(false, texture, m.next_predictions[0]);
  m.toRequestedNodes(true, relief, m.next_predictions[1]);
  Impl::merge(m.next_predictions, m.predictions);
  m.planned_frame = kNever;
}

std::optional<PageJob> PageStreamer::takeJob() { return impl_->jobs->take(); }
void PageStreamer::finishJob(const PageJob& job) { impl_->jobs->finish(job); }
bool PageStreamer::jobWanted(const PageJob& job) const { return impl_->jobs->wanted(job); }

std::span<const PageUpload> PageStreamer::placeReady(uint32_t max_uploads) {
  impl_->placeReady(max_uploads);
  return impl_->uploads;
}

SlotIndex PageStreamer::findRelief(const NodeId& node) const { return impl_->find(PageId(Plane::kRelief, node)); }

bool PageStreamer::pinRelief(const NodeId& node) {
  SlotIndex slot = findRelief(node);
  if (slot == kNoSlot) return false;
  impl_->pools[impl_->poolIndex(true)].cache.pin(slot);
  return true;
}

void PageStreamer::unpinRelief(const NodeId& node) {
  SlotIndex slot = findRelief(node);
  assert(slot != kNoSlot);
  if (slot != kNoSlot) impl_->pools[impl_->poolIndex(true)].cache.unpin(slot);
}

std::vector<NodeId> PageStreamer::residentRelief() const {
  std::vector<NodeId> nodes;
  cache(Plane::kRelief).forEach([&](PageId id) {
    if (id.plane() == Plane::kRelief) nodes.push_back(id.node());
  });
  std::sort(nodes.begin(), nodes.end());
  return nodes;
}

uint64_t PageStreamer::reliefGeneration() const { return impl_->relief_generation; }

void PageStreamer::setLight(const std::array<double, 3>& light) {
  Impl& m = *impl_;
  m.options.light = light;
  m.jobs->setLight(
      light, [](const PageJob& job) { return job.id.plane() != Plane::kResolved; }, m.started);
  m.noteStarted(m.started);
  for (auto it = m.pages.begin(); it != m.pages.end();) {
    bool is_ready = it->second.state == PageState::kReady;
    bool old = it->first.plane() == Plane::kResolved && (it->second.state == PageState::kDecoding || is_ready);
    m.stats.cancelled_after_decode += old && is_ready;
    it = old ? m.drop(it) : std::next(it);
  }
  std::vector<PageId> resolved;
  SubslotCache& cache = m.pools[0].cache;
  cache.forEach([&](PageId id) {
    if (id.plane() == Plane::kResolved) resolved.push_back(id);
  });
  for (PageId id : resolved) {
    SlotIndex slot = cache.find(id);
    if (cache.isPinned(slot)) {
      auto it = m.pages.find(id);
      bool damaged = it != m.pages.end() && it->second.permanent;
      if (damaged || std::find(m.refresh.begin(), m.refresh.end(), id) != m.refresh.end()) continue;
      m.state_counts.move(static_cast<size_t>(id.plane()), PageState::kResident, PageState::kAbsent);
      m.refresh.push_back(id);
    } else {
      m.vacate(m.pools[0].slotOf(slot), id);
      m.pools[0].recent.forget(slot);
      cache.remove(id);
    }
  }
  m.planned_frame = kNever;
}

double PageStreamer::detailBias() const { return impl_->bias.value(); }

void PageStreamer::setRequestBias(std::optional<double> bias, bool moved) {
  impl_->request_bias = bias;
  impl_->view_moved = impl_->view_moved || moved;
}

bool PageStreamer::atRest() const {
  const Impl& m = *impl_;
  if (m.count(PageState::kQueued) + m.count(PageState::kDecoding) > 0) return false;
  if (!m.refresh.empty() || !m.root_uploads.empty() || m.planned_frame == kNever) return false;
  for (const auto& [id, page] : m.pages)
    if (page.state == PageState::kFailed && !page.permanent && m.tierOf(id, page) == Tier::kVisible) return false;
  return true;
}

bool PageStreamer::settled() const {
  const Impl& m = *impl_;
  if (!atRest() || m.count(PageState::kReady) > 0) return false;
  if (m.stats.deferred > 0 && m.bias.value() < kMaxDetailBias) return false;
  return m.bias.isStill();
}

PageState PageStreamer::state(PageId id) const {
  if (impl_->find(id) != kNoSlot) return PageState::kResident;
  auto it = impl_->pages.find(id);
  return it == impl_->pages.end() ? PageState::kAbsent : it->second.state;
}

const StreamerStats& PageStreamer::stats() const {
  Impl& m = *impl_;
  m.stats.queued = m.count(PageState::kQueued);
  m.stats.decoding = m.count(PageState::kDecoding);
  m.stats.ready = m.count(PageState::kReady);
  m.stats.resident = m.stats.resident_bytes = m.stats.relief_bytes = 0;
  for (const SlotPool& pool : m.pools) {
    const Plane plane = &pool == &m.pools[0] ? texturePlane(0) : Plane::kRelief;
    m.stats.resident += pool.cache.residentCount();
    m.stats.relief_bytes += pool.cache.dividedCount() * kSlotBytes;
    m.stats.resident_bytes += pool.cache.residentCount() * slotBytes(m.options.upload, plane);
  }
  m.stats.pages = m.state_counts.pages;
  m.stats.moves = m.state_counts.moves;
  m.stats.cancelled = m.stats.cancelled_before_read + m.stats.cancelled_before_decode + m.stats.cancelled_after_decode;
  for (size_t p = 0; p < m.stats.pages_read.size(); ++p) {
    const size_t bytes = slotBytes(m.options.upload, static_cast<Plane>(p));
    m.stats.bytes_decoded[p] = m.stats.pages_decoded[p] * bytes;
  }
  m.stats.detail_bias = m.bias.value();
  m.stats.latency_ms = summarize(m.latency_us, 1e-3);
  m.stats.latency_frames = summarize(m.latency_frames, 1);
  return m.stats;
}

PageTable& PageStreamer::table() { return impl_->table; }
const SubslotCache& PageStreamer::cache(Plane plane) const {
  return impl_->pools[impl_->poolIndex(plane == Plane::kRelief)].cache;
}

uint64_t PageStreamer::metadataBytes() const {
  const Impl& m = *impl_;
  uint64_t bytes = m.table.metadataBytes();
  for (const SlotPool& pool : m.pools) {
    bytes += pool.cache.metadataBytes() + pool.recent.bytes();
    for (const auto& slots : pool.slots) bytes += slots.capacity() * sizeof(slots[0]);
  }
  return bytes;
}

uint64_t PageStreamer::bufferBytes() const {
  const Impl& m = *impl_;
  bool resolve = std::find(m.options.texture_planes.begin(), m.options.texture_planes.end(), Plane::kResolved) !=
                 m.options.texture_planes.end();
  uint64_t scratch =
      resolve ? uint64_t(std::max({1, m.options.workers, m.options.max_reads})) * m.options.format.planes() : 0;
  if (m.normals) scratch += uint64_t(std::max({1, m.options.workers, m.options.max_reads}));
  return (m.jobs->maxBuffers() + scratch) * kSlotBytes + (m.normals ? ReliefNormals::kCachedBytes : 0);
}

const PageFailures& PageStreamer::failures() const { return impl_->failures; }
std::vector<std::string> PageStreamer::takeMessages() { return std::exchange(impl_->messages, {}); }

}  // namespace relievo
