#include "texturing/page_streamer.h"

#include <algorithm>
#include <atomic>
#include <bit>
#include <cassert>
#include <cmath>
#include <condition_variable>
#include <mutex>
#include <optional>
#include <thread>
#include <tuple>
#include <unordered_map>
#include <utility>

#include "texturing/page_codec.h"
#include "texturing/resolve.h"

namespace relievo {

namespace {

using Texels = std::unique_ptr<uint8_t[]>;  // kSlotBytes
Texels makeTexels() { return std::make_unique<uint8_t[]>(kSlotBytes); }

constexpr double kFirstBackOff_s = 0.1;
constexpr double kBackOffFactor = 4;
constexpr size_t kMaxMessages = 1024;        // between two calls of takeMessages; the rest is counted only
constexpr size_t kMaxKnownFailures = 65536;  // failures for good that are remembered, wanted ones apart
constexpr uint64_t kNever = ~uint64_t{0};
constexpr double kBiasStep = 0.05;
constexpr int kPressureLists = 3;  // wish lists in a row that must overflow before the bias rises
constexpr int kCalmLists = 8;  // wish lists in a row that must fit before it may fall: more than the feedback's latency

// An ordering of pages that is also the order of service: wish lists since a page was last wanted, then level, then
// distance from the centre (the bits of a float that is not negative are ordered as it is), then whole nodes.
struct Rank {
  uint64_t key = 0;
  PageId id;
  Rank() = default;
  Rank(uint64_t age, float centre, PageId page)
      : key(std::min<uint64_t>(age, 0xFFFF) << 48 | uint64_t{page.node().level} << 32 |
            std::bit_cast<uint32_t>(centre)),
        id(page) {}
  uint64_t age() const { return key >> 48; }
  friend bool operator<(const Rank& a, const Rank& b) {
    if (a.key != b.key) return a.key < b.key;
    uint64_t node_a = packNode(a.id.node()), node_b = packNode(b.id.node());
    return node_a != node_b ? node_a < node_b : a.id < b.id;
  }
};

struct Job {
  Rank rank;
  uint64_t ticket = 0;
};

// What a job cost, by stored plane.
struct Cost {
  Plane plane;
  uint64_t bytes = 0;
  bool decoded = false;
};

struct Outcome {
  PageId id;
  uint64_t ticket = 0;
  Texels texels;  // null: failed
  std::optional<Error> error;
  bool permanent = false;
  std::vector<Cost> costs;
};

// What a thread needs to turn a PageId into texels.
class Loader {
 public:
  Loader(const PageSource& source, const TextureFormat& format, const SlotDecoder& decoder)
      : source_(source), format_(format), decoder_(decoder) {
    if (!decoder_) own_.emplace();
  }

  void load(PageId id, double u, double v, uint8_t* texels, Outcome& outcome) {
    if (id.plane() != Plane::kResolved) {
      one(id, texels, outcome);
      return;
    }
    std::vector<const uint8_t*> slots;
    for (int k = 0; k < format_.planes(); ++k) {
      if (scratch_.size() <= size_t(k)) scratch_.push_back(makeTexels());
      if (!one(PageId(texturePlane(k), id.node()), scratch_[k].get(), outcome)) return;
      slots.push_back(scratch_[k].get());
    }
    resolvePage(format_, u, v, slots, texels);
  }

 private:
  bool one(PageId id, uint8_t* texels, Outcome& outcome) {
    Result<EncodedPage> page = source_.read(id);
    if (!page) {
      outcome.permanent = page.error().kind == ErrorKind::kInvalidData && !page.error().offset;
      outcome.error = page.error();
      return false;
    }
    outcome.costs.push_back({id.plane(), page->bytes.size(), false});
    std::span<uint8_t> out(texels, kSlotBytes);
    Result<void> decoded =
        own_ ? own_->decodeToSlot(id.plane(), page->bytes, out) : decoder_(id.plane(), page->bytes, out);
    if (!decoded) {
      outcome.error = decoded.error();
      return false;
    }
    outcome.costs.back().decoded = true;
    return true;
  }

  const PageSource& source_;
  const TextureFormat& format_;
  const SlotDecoder& decoder_;
  std::optional<PageDecoder> own_;
  std::vector<Texels> scratch_;
};

// What shows in place of a damaged root: 128 grey under every light, or relief at the lower end of its range.
void neutralPage(Plane plane, const TextureFormat& format, uint8_t* texels) {
  std::array<uint8_t, 4> texel{128, 128, 128, 255};
  auto raw = [&](int k, double value) {
    double scale = format.scale[k] != 0 ? format.scale[k] : 1;
    return static_cast<uint8_t>(std::clamp(std::round(value / scale + format.bias[k]), 0.0, 255.0));
  };
  int k = static_cast<int>(plane);
  if (plane == Plane::kRelief) {
    texel = {};
  } else if (isTexturePlane(plane) && format.basis == Basis::kPtmLrgb && k < 2) {
    for (int c = 0; c < 3; ++c) texel[c] = raw(3 * k + c, 3 * k + c == 5 ? 255 : 0);
  } else if (isTexturePlane(plane) && format.basis == Basis::kPtmRgb && k < 6) {
    for (int c = 0; c < 3; ++c) texel[c] = raw(k, k == 5 ? 128 : 0);
  }
  for (size_t i = 0; i < kSlotBytes; ++i) texels[i] = texel[i & 3];
}

std::string describe(PageId id) {
  NodeId n = id.node();
  std::string plane = id.plane() == Plane::kRelief ? "relief"
                      : id.plane() == Plane::kResolved
                          ? "texture"
                          : "texture plane " + std::to_string(static_cast<int>(id.plane()));
  return plane + " page of patch " + std::to_string(n.patch) + ", level " + std::to_string(n.level) + ", column " +
         std::to_string(n.x) + ", row " + std::to_string(n.y);
}

// A node has a slot for each of its planes.
uint32_t nodesAtMost(uint32_t slots, size_t planes) { return planes == 0 ? 0 : slots / static_cast<uint32_t>(planes); }

// Between the render thread and the workers; everything under the mutex, which is only held for moves of a few values.
struct Exchange {
  std::mutex mutex;
  std::condition_variable work;
  bool stop = false;
  std::vector<Job> jobs;                             // the best one last
  std::vector<std::pair<PageId, uint64_t>> started;  // since the render thread last looked
  std::vector<Outcome> done;
  std::vector<Texels> pool;
  size_t buffers = 0, max_buffers = 0;  // made so far, and at most
  double light_u = 0, light_v = 0;
};

struct Page {
  PageState state = PageState::kAbsent;
  bool permanent = false;  // kFailed for good
  int attempts = 0;
  uint64_t ticket = 0;
  uint64_t list = 0;     // the last wish list of its kind that wanted it
  uint64_t plan = 0;     // the last plan that counted it
  uint64_t offered = 0;  // the last plan that offered it to the workers
  double retry_at_s = 0;
  float centre = 0;
  Texels texels;  // kReady
};

struct Wish {
  NodeId node;
  float centre = 0;
  bool relief = false;
  friend bool operator<(const Wish& a, const Wish& b) {
    auto key = [](const Wish& w) { return std::tuple(w.node.level, w.centre, !w.relief, packNode(w.node)); };
    return key(a) < key(b);
  }
};

}  // namespace

struct PageStreamer::Impl {
  Impl(std::shared_ptr<const PageSource> source_in, StreamerOptions options_in, SlotDecoder decoder_in)
      : source(std::move(source_in)),
        options(std::move(options_in)),
        decoder(std::move(decoder_in)),
        cache(options.slot_count, options.replacement),
        table(nodesAtMost(cache.slotCount(), options.texture_planes.size()), static_cast<int>(options.texture_planes.size())),
        slot_plan(cache.slotCount()) {
    options.workers = std::max(1, options.workers);
    options.ready_limit = std::max(1u, options.ready_limit);
    exchange.max_buffers = size_t(options.workers) + options.ready_limit;
    exchange.light_u = options.light_u;
    exchange.light_v = options.light_v;
    for (int i = 0; i < options.workers; ++i) threads.emplace_back([this] { work(); });
  }
  ~Impl() {
    {
      std::lock_guard lock(exchange.mutex);
      exchange.stop = true;
    }
    exchange.work.notify_all();
    for (std::thread& t : threads) t.join();
  }

  // --- worker threads -----------------------------------------------------------------------------------------------

  void work() {
    Loader loader(*source, options.format, decoder);
    std::unique_lock lock(exchange.mutex);
    for (;;) {
      exchange.work.wait(lock, [&] {
        return exchange.stop ||
               (!exchange.jobs.empty() && (!exchange.pool.empty() || exchange.buffers < exchange.max_buffers));
      });
      if (exchange.stop) return;
      Job job = exchange.jobs.back();
      exchange.jobs.pop_back();
      exchange.started.emplace_back(job.rank.id, job.ticket);
      Texels texels;
      if (exchange.pool.empty()) {
        ++exchange.buffers;
      } else {
        texels = std::move(exchange.pool.back());
        exchange.pool.pop_back();
      }
      double u = exchange.light_u, v = exchange.light_v;
      lock.unlock();
      if (!texels) texels = makeTexels();
      Outcome outcome;
      outcome.id = job.rank.id;
      outcome.ticket = job.ticket;
      loader.load(job.rank.id, u, v, texels.get(), outcome);
      lock.lock();
      if (outcome.error) {
        exchange.pool.push_back(std::move(texels));
      } else {
        outcome.texels = std::move(texels);
      }
      exchange.done.push_back(std::move(outcome));
    }
  }

  // --- render thread: states ----------------------------------------------------------------------------------------

  uint64_t& count(PageState s) { return state_count[static_cast<size_t>(s)]; }
  void setState(Page& page, PageState s) {
    --count(page.state);
    page.state = s;
    ++count(s);
  }
  Page& pageOf(PageId id) {
    auto [it, is_new] = pages.try_emplace(id);
    if (is_new) ++count(PageState::kAbsent);
    return it->second;
  }
  using PageMap = std::unordered_map<PageId, Page>;
  PageMap::iterator forget(PageMap::iterator it) {
    --count(it->second.state);
    if (it->second.state == PageState::kFailed && it->second.permanent) --permanent_failures;
    if (it->second.texels) returned.push_back(std::move(it->second.texels));
    return pages.erase(it);
  }
  bool isRelief(PageId id) const { return id.plane() == Plane::kRelief; }
  uint64_t ageOf(PageId id, const Page& page) const {
    return page.list == kAlways ? 0 : list[isRelief(id)] - page.list;
  }
  Rank rankOf(PageId id, const Page& page) const { return {ageOf(id, page), page.centre, id}; }

  void say(std::string text) {
    if (messages.size() < kMaxMessages) messages.push_back(std::move(text));
  }

  // Wants a page that has (or will have) room.
  void request(PageId id, float centre, uint64_t in_list) {
    Page& page = pageOf(id);
    page.list = in_list;
    page.centre = centre;
    bool retry = page.state == PageState::kFailed && !page.permanent && now_s >= page.retry_at_s;
    if (page.state != PageState::kAbsent && !retry) return;
    if (retry) ++stats.retries;
    page.ticket = ++last_ticket;
    setState(page, PageState::kQueued);
    queued.push_back(id);
  }

  void fail(PageId id, Page& page, const Error& error, bool permanent) {
    setState(page, PageState::kFailed);
    ++page.attempts;
    page.permanent = permanent || page.attempts >= kMaxAttempts;
    page.retry_at_s = now_s + kFirstBackOff_s * std::pow(kBackOffFactor, page.attempts - 1);
    if (!page.permanent) return;
    ++permanent_failures;
    ++stats.failed_pages;
    std::erase(refresh, id);
    say(describe(id) + " cannot be shown: " + error.text());
  }

  void account(const std::vector<Cost>& costs) {
    for (const Cost& c : costs) {
      auto p = static_cast<size_t>(c.plane);
      ++stats.pages_read[p];
      stats.bytes_read[p] += c.bytes;
      stats.pages_decoded[p] += c.decoded;
    }
  }

  // The mutex is held.
  void noteStarted() {
    for (const auto& [id, ticket] : exchange.started) {
      auto it = pages.find(id);
      if (it != pages.end() && it->second.ticket == ticket && it->second.state == PageState::kQueued)
        setState(it->second, PageState::kDecoding);
    }
    exchange.started.clear();
  }

  void takeResults() {
    outcomes.clear();
    bool more_buffers = false;
    {
      std::lock_guard lock(exchange.mutex);
      noteStarted();
      outcomes.swap(exchange.done);
      more_buffers = !returned.empty();
      for (Texels& t : returned) exchange.pool.push_back(std::move(t));
      returned.clear();
    }
    if (more_buffers) exchange.work.notify_all();
    for (Outcome& o : outcomes) {
      account(o.costs);
      auto it = pages.find(o.id);
      if (it == pages.end() || it->second.ticket != o.ticket || it->second.state != PageState::kDecoding) {
        ++stats.cancelled;
        if (o.texels) returned.push_back(std::move(o.texels));
      } else if (o.error) {
        fail(o.id, it->second, *o.error, o.permanent);
      } else {
        it->second.texels = std::move(o.texels);
        setState(it->second, PageState::kReady);
        ready.push_back(o.id);
      }
    }
  }

  // --- render thread: wishes ----------------------------------------------------------------------------------------

  void want(bool relief, std::span<const NodeWant> wants) {
    ++list[relief];
    auto& mine = wishes[relief];
    next_wishes.clear();
    next_wishes.reserve(wants.size());
    for (const NodeWant& w : wants)
      next_wishes.push_back({w.node, w.centre_distance >= 0 ? std::min(w.centre_distance + 0.0f, 2.0f) : 2.0f, relief});
    if (!std::is_sorted(next_wishes.begin(), next_wishes.end())) std::sort(next_wishes.begin(), next_wishes.end());
    mine.swap(next_wishes);
    merged.clear();
    std::merge(wishes[0].begin(), wishes[0].end(), wishes[1].begin(), wishes[1].end(), std::back_inserter(merged));
    planned_frame = kNever;
  }

  std::span<const Plane> planesOf(const Wish& w) const {
    static constexpr Plane kReliefOnly[] = {Plane::kRelief};
    return w.relief ? std::span<const Plane>(kReliefOnly) : std::span<const Plane>(options.texture_planes);
  }

  // Counts a slot in use once a plan, however often it is named; pinned ones are counted apart.
  uint32_t use(SlotIndex slot) {
    cache.touch(slot, frame);
    if (slot_plan[slot] == plan_number) return 0;
    slot_plan[slot] = plan_number;
    ++wanted_pages;
    return cache.isPinned(slot) ? 0 : 1;
  }

  // From the wish lists: touches what is resident, gives the room that is left to what is missing, cancels what is no
  // longer wanted, and hands the workers their new order of service.
  void plan() {
    ++plan_number;
    planned_frame = frame;
    wanted_pages = 0;
    uint64_t room_used = cache.pinnedCount();
    uint64_t deferred = 0;
    missing.clear();
    {
      std::lock_guard lock(exchange.mutex);
      noteStarted();
    }

    for (const Wish& w : merged) {
      auto planes = planesOf(w);
      if (!w.relief) {
        if (auto entry = table.find(w.node)) {
          for (size_t i = 0; i < planes.size(); ++i) room_used += use(entry->slots[i]);
          continue;
        }
      }
      bool failed = false;
      uint32_t absent = 0;
      for (Plane p : planes) {
        PageId id(p, w.node);
        if (cache.find(id) != kNoSlot) continue;
        ++absent;
        auto it = pages.find(id);
        failed = failed || (it != pages.end() && it->second.state == PageState::kFailed && it->second.permanent);
      }
      if (failed) continue;  // it will never show: what is there of it need not stay
      for (Plane p : planes)
        if (SlotIndex slot = cache.find(PageId(p, w.node)); slot != kNoSlot) room_used += use(slot);
      if (absent > 0) missing.emplace_back(&w, absent);
    }

    for (const PageId& id : refresh) request(id, 0, kAlways);
    for (const auto& [wish, absent] : missing) {
      // A node named twice: counted once.
      auto planes = planesOf(*wish);
      auto twin = pages.find(PageId(planes.back(), wish->node));
      if (twin != pages.end() && twin->second.plan == plan_number) continue;
      wanted_pages += absent;
      if (room_used + absent > cache.slotCount()) {
        deferred += absent;
        continue;
      }
      room_used += absent;
      for (Plane p : planes) {
        PageId id(p, wish->node);
        if (cache.find(id) != kNoSlot) continue;
        request(id, wish->centre, list[wish->relief]);
        pages.find(id)->second.plan = plan_number;
      }
    }
    stats.deferred = deferred;
    stats.wanted = wanted_pages;
    publish();
    if (permanent_failures > kMaxKnownFailures) forgetFailures();
  }

  void publish() {
    if (queued.empty() && !published) return;
    jobs.clear();
    size_t kept = 0;
    for (const PageId& id : queued) {
      auto it = pages.find(id);
      if (it == pages.end() || it->second.state != PageState::kQueued) continue;
      if (ageOf(id, it->second) >= 2) {
        ++stats.cancelled;
        forget(it);
        continue;
      }
      if (std::exchange(it->second.offered, plan_number) == plan_number) continue;
      queued[kept++] = id;
      jobs.push_back({rankOf(id, it->second), it->second.ticket});
    }
    queued.resize(kept);
    std::sort(jobs.begin(), jobs.end(), [](const Job& a, const Job& b) { return b.rank < a.rank; });
    {
      std::lock_guard lock(exchange.mutex);
      if (!exchange.started.empty()) {  // taken while this list was made
        noteStarted();
        std::erase_if(jobs, [&](const Job& j) {
          auto it = pages.find(j.rank.id);
          return it == pages.end() || it->second.state != PageState::kQueued;
        });
      }
      exchange.jobs.swap(jobs);
      published = !exchange.jobs.empty();
    }
    if (published) exchange.work.notify_all();
  }

  void forgetFailures() {
    for (auto it = pages.begin(); it != pages.end();) {
      bool old = it->second.state == PageState::kFailed && it->second.permanent && ageOf(it->first, it->second) >= 2;
      it = old ? forget(it) : std::next(it);
    }
  }

  // --- render thread: slots -----------------------------------------------------------------------------------------

  void enter(PageId id) {
    if (isRelief(id)) {
      ++relief_generation;
      return;
    }
    PageTableEntry entry;
    for (size_t i = 0; i < options.texture_planes.size(); ++i) {
      SlotIndex slot = cache.find(PageId(options.texture_planes[i], id.node()));
      if (slot == kNoSlot) return;
      entry.slots[i] = static_cast<uint16_t>(slot);
    }
    entry.birth = static_cast<uint16_t>(static_cast<uint64_t>(std::max(0.0, now_s) * 64) & 0xFFFFu);
    table.insert(id.node(), entry);
  }
  void leave(PageId id) {
    if (isRelief(id)) {
      ++relief_generation;
    } else {
      table.erase(id.node());
    }
  }

  void placeReady(uint32_t max_uploads) {
    takeResults();
    if (planned_frame != frame) plan();
    uploads.clear();
    for (auto& [slot, texels] : root_uploads) {
      uploads.push_back({slot, cache.pageIn(slot), texels.get()});
      ++stats.pages_uploaded[static_cast<size_t>(uploads.back().id.plane())];
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
    for (const Rank& r : ranked) {
      auto it = pages.find(r.id);
      bool was_resident = cache.find(r.id) != kNoSlot;
      std::optional<PageCache::Placement> placement;
      if (placed < max_uploads) placement = cache.place(r.id, frame);
      if (!placement) {
        if (placed < max_uploads && r.age() >= 2) {
          ++stats.cancelled;
          forget(it);
        } else {
          stats.deferred += placed < max_uploads;
          ready.push_back(r.id);
        }
        continue;
      }
      ++placed;
      if (placement->evicted) {
        ++stats.evictions;
        leave(*placement->evicted);
      }
      uploads.push_back({placement->slot, r.id, it->second.texels.get()});
      uploaded.push_back(std::move(it->second.texels));
      ++stats.pages_uploaded[static_cast<size_t>(r.id.plane())];
      forget(it);
      if (was_resident) {
        std::erase(refresh, r.id);
      } else {
        enter(r.id);
      }
    }
    updateBias();
  }

  // --- detail -------------------------------------------------------------------------------------------------------

  void updateBias() {
    if (bias_list == list[0] + list[1]) return;  // no new wish list
    bias_list = list[0] + list[1];
    bias_moved = false;
    if (stats.deferred > 0) {
      calm_lists = 0;
      if (++pressure_lists < kPressureLists || bias >= kMaxDetailBias) return;
      overflow_bias = bias;
      bias = std::min(kMaxDetailBias, bias + kBiasStep);
      bias_moved = true;
      return;
    }
    pressure_lists = 0;
    if (bias <= 0 || ++calm_lists < kCalmLists) return;
    auto demand = static_cast<double>(wanted_pages);
    if (calm_lists == kCalmLists) calm_demand = demand;
    // A quarter more or less is another view: what overflowed then says nothing about now.
    if (std::abs(demand - calm_demand) > 0.25 * calm_demand) overflow_bias = -1;
    // One level finer has at most four nodes for each, and their parents: 5 times the demand.
    bool surely_fits = 5 * demand <= cache.slotCount() - std::min(cache.pinnedCount(), cache.slotCount());
    double lower = std::max(0.0, bias - kBiasStep);
    if (!surely_fits && lower <= overflow_bias + kBiasStep / 2) return;
    bias = lower;
    bias_moved = true;
    calm_demand = demand;
  }

  static constexpr uint64_t kAlways = ~uint64_t{0};

  std::shared_ptr<const PageSource> source;
  StreamerOptions options;
  SlotDecoder decoder;
  PageCache cache;
  PageTable table;
  Exchange exchange;
  std::vector<std::thread> threads;

  uint64_t frame = 0, planned_frame = 0, plan_number = 0, last_ticket = 0;
  double now_s = 0;
  PageMap pages;  // all that is neither Absent nor merely Resident
  std::array<uint64_t, 6> state_count{};
  uint64_t permanent_failures = 0;
  std::vector<PageId> queued, ready;  // may name pages that are no longer so
  bool published = false;             // the workers may still hold jobs of the last publish()
  std::vector<PageId> refresh;        // pinned pages whose texels are out of date

  std::array<uint64_t, 2> list{};  // number of the newest wish list: texture, relief
  std::array<std::vector<Wish>, 2> wishes;
  std::vector<Wish> merged;  // coarse before fine, then near the centre
  uint64_t wanted_pages = 0;
  std::vector<uint64_t> slot_plan;

  std::vector<PageUpload> uploads;
  std::vector<Texels> uploaded, uploaded_roots, returned;
  std::vector<std::pair<SlotIndex, Texels>> root_uploads;
  uint64_t relief_generation = 1;

  double bias = 0, overflow_bias = -1, calm_demand = 0;
  int pressure_lists = 0, calm_lists = 0;
  bool bias_moved = false;
  uint64_t bias_list = 0;

  StreamerStats stats;
  std::vector<std::string> messages;

  // Scratch, kept between calls.
  std::vector<Wish> next_wishes;
  std::vector<std::pair<const Wish*, uint32_t>> missing;
  std::vector<Job> jobs;
  std::vector<Rank> ranked;
  std::vector<Outcome> outcomes;
};

PageStreamer::PageStreamer(std::shared_ptr<const PageSource> source, StreamerOptions options, SlotDecoder decoder)
    : impl_(std::make_unique<Impl>(std::move(source), std::move(options), std::move(decoder))) {}

PageStreamer::~PageStreamer() = default;

void PageStreamer::pinRoots(std::span<const NodeId> texture_roots, std::span<const NodeId> relief_roots) {
  Impl& m = *impl_;
  std::vector<Outcome> roots;
  auto add = [&](Plane plane, const NodeId& node) {
    roots.emplace_back();
    roots.back().id = PageId(plane, node);
  };
  for (const NodeId& node : texture_roots)
    for (Plane p : m.options.texture_planes) add(p, node);
  for (const NodeId& node : relief_roots) add(Plane::kRelief, node);
  if (roots.size() > m.cache.slotCount() - m.cache.residentCount()) {
    m.say("the cache has " + std::to_string(m.cache.slotCount()) + " slots, the artwork's coarsest pages alone need " +
          std::to_string(roots.size()) + " (raise the cache's budget)");
    roots.resize(m.cache.slotCount() - m.cache.residentCount());
  }

  std::atomic<size_t> next{0};
  auto loadSome = [&] {
    Loader loader(*m.source, m.options.format, m.decoder);
    for (size_t i = next++; i < roots.size(); i = next++) {
      Outcome& root = roots[i];
      root.texels = makeTexels();
      for (int attempt = 0; attempt < kMaxAttempts && !root.permanent; ++attempt) {
        root.error.reset();
        loader.load(root.id, m.options.light_u, m.options.light_v, root.texels.get(), root);
        if (!root.error) break;
      }
      if (root.error) neutralPage(root.id.plane(), m.options.format, root.texels.get());
    }
  };
  std::vector<std::thread> helpers;
  for (size_t i = 1; i < std::min(roots.size(), size_t(m.options.workers)); ++i) helpers.emplace_back(loadSome);
  loadSome();
  for (std::thread& t : helpers) t.join();

  for (Outcome& root : roots) {
    m.account(root.costs);
    if (root.error) {
      Page& page = m.pageOf(root.id);  // remembered, so that it is not tried (and named) again
      m.setState(page, PageState::kFailed);
      page.permanent = true;
      page.list = Impl::kAlways;
      ++m.permanent_failures;
      ++m.stats.failed_pages;
      m.say("the coarsest " + describe(root.id) + " is damaged, a neutral one stands in: " + root.error->text());
    }
    bool known = m.cache.find(root.id) != kNoSlot;
    auto placement = m.cache.place(root.id, m.frame);
    if (!placement) continue;
    m.cache.pin(placement->slot);
    if (known) continue;
    m.root_uploads.emplace_back(placement->slot, std::move(root.texels));
    m.enter(root.id);
  }
}

void PageStreamer::beginFrame(uint64_t frame, double now_s) {
  Impl& m = *impl_;
  m.frame = frame;
  m.now_s = now_s;
  for (Texels& t : m.uploaded) m.returned.push_back(std::move(t));
  m.uploaded.clear();
  m.uploaded_roots.clear();
  m.uploads.clear();
  m.takeResults();
}

void PageStreamer::wantTexture(std::span<const NodeWant> wants) {
  if (!impl_->options.texture_planes.empty()) impl_->want(false, wants);
}
void PageStreamer::wantRelief(std::span<const NodeWant> wants) { impl_->want(true, wants); }

std::span<const PageUpload> PageStreamer::placeReady(uint32_t max_uploads) {
  impl_->placeReady(max_uploads);
  return impl_->uploads;
}

SlotIndex PageStreamer::findRelief(const NodeId& node) const { return impl_->cache.find(PageId(Plane::kRelief, node)); }

bool PageStreamer::pinRelief(const NodeId& node) {
  SlotIndex slot = findRelief(node);
  if (slot == kNoSlot) return false;
  impl_->cache.pin(slot);
  return true;
}

void PageStreamer::unpinRelief(const NodeId& node) {
  SlotIndex slot = findRelief(node);
  assert(slot != kNoSlot);
  if (slot != kNoSlot) impl_->cache.unpin(slot);
}

std::vector<NodeId> PageStreamer::residentRelief() const {
  std::vector<NodeId> nodes;
  impl_->cache.forEach([&](PageId id) {
    if (id.plane() == Plane::kRelief) nodes.push_back(id.node());
  });
  std::sort(nodes.begin(), nodes.end());
  return nodes;
}

uint64_t PageStreamer::reliefGeneration() const { return impl_->relief_generation; }

void PageStreamer::setLight(double u, double v) {
  Impl& m = *impl_;
  m.options.light_u = u;
  m.options.light_v = v;
  {
    // Jobs taken until now have the old light, later ones the new.
    std::lock_guard lock(m.exchange.mutex);
    m.noteStarted();
    m.exchange.light_u = u;
    m.exchange.light_v = v;
  }
  for (auto it = m.pages.begin(); it != m.pages.end();) {
    bool old = it->first.plane() == Plane::kResolved &&
               (it->second.state == PageState::kDecoding || it->second.state == PageState::kReady);
    it = old ? m.forget(it) : std::next(it);
  }
  std::vector<PageId> resolved;
  m.cache.forEach([&](PageId id) {
    if (id.plane() == Plane::kResolved) resolved.push_back(id);
  });
  for (PageId id : resolved) {
    if (m.cache.isPinned(m.cache.find(id))) {
      auto it = m.pages.find(id);
      bool damaged = it != m.pages.end() && it->second.state == PageState::kFailed && it->second.permanent;
      if (!damaged && std::find(m.refresh.begin(), m.refresh.end(), id) == m.refresh.end()) m.refresh.push_back(id);
    } else {
      m.table.erase(id.node());
      m.cache.remove(id);
    }
  }
  m.planned_frame = kNever;
}

double PageStreamer::detailBias() const { return impl_->bias; }

bool PageStreamer::settled() const {
  Impl& m = *impl_;
  if (m.count(PageState::kQueued) + m.count(PageState::kDecoding) + m.count(PageState::kReady) > 0) return false;
  if (!m.refresh.empty() || !m.root_uploads.empty() || m.planned_frame == kNever) return false;
  if (m.stats.deferred > 0 && m.bias < kMaxDetailBias) return false;
  if (m.bias_moved || (m.bias > 0 && m.stats.deferred == 0 && m.calm_lists < kCalmLists)) return false;
  for (const auto& [id, page] : m.pages)
    if (page.state == PageState::kFailed && !page.permanent && m.ageOf(id, page) == 0) return false;
  return true;
}

PageState PageStreamer::state(PageId id) const {
  if (impl_->cache.find(id) != kNoSlot) return PageState::kResident;
  auto it = impl_->pages.find(id);
  return it == impl_->pages.end() ? PageState::kAbsent : it->second.state;
}

const StreamerStats& PageStreamer::stats() const {
  Impl& m = *impl_;
  m.stats.queued = m.count(PageState::kQueued);
  m.stats.decoding = m.count(PageState::kDecoding);
  m.stats.ready = m.count(PageState::kReady);
  m.stats.resident = m.cache.residentCount();
  return m.stats;
}

PageTable& PageStreamer::table() { return impl_->table; }
const PageCache& PageStreamer::cache() const { return impl_->cache; }

uint64_t PageStreamer::bufferBytes() const {
  const Impl& m = *impl_;
  bool resolve = std::find(m.options.texture_planes.begin(), m.options.texture_planes.end(), Plane::kResolved) !=
                 m.options.texture_planes.end();
  uint64_t scratch = resolve ? uint64_t(m.options.workers) * m.options.format.planes() : 0;
  return (m.exchange.max_buffers + scratch) * kSlotBytes;
}

std::vector<std::string> PageStreamer::takeMessages() { return std::exchange(impl_->messages, {}); }

}  // namespace relievo
