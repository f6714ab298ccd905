#include "texturing/stream/page_jobs.h"

#include <algorithm>
#include <cassert>
#include <utility>

#include "src/base/thread_priority.h"

namespace relievo {

PageJobs::PageJobs(const PageSource& source, const TextureFormat& format, const SlotDecoder& decoder, PageCodec upload,
                   ReliefParts relief_parts, int workers, int max_reads, size_t max_buffers,
                   const ReliefNormals* normals)
    : source_(source),
      format_(format),
      decoder_(decoder),
      upload_(upload),
      relief_parts_(relief_parts),
      normals_(normals),
      workers_(workers),
      max_threads_(static_cast<size_t>(std::max(workers, max_reads))),
      max_buffers_(max_buffers),
      limiter_(std::max(1, workers)),
      free_buffers_(max_buffers) {
  if (workers > 0) threads_.startAtLeastOne(static_cast<size_t>(workers), [this] { work(); });
}

PageJobs::~PageJobs() {
  {
    std::lock_guard lock(mutex_);
    stop_ = true;
    for (Running& r : running_) r.wanted = false;
  }
  work_.notify_all();
  threads_.join();
}

void PageJobs::work() {
  // A software driver draws on the same cores: frames come before pages.
  constexpr int kNice = 10;
  stepBack(kNice);
  for (;;) {
    PageJob job;
    {
      std::unique_lock lock(mutex_);
      work_.wait(lock, [&] { return stop_ || available(); });
      if (stop_) return;
      job = takeLocked();
    }
    finish(job);
  }
}

void PageJobs::addThreads() {
  // The source is slow: fewer jobs than threads were finished since the last publish(), a frame ago, and all threads
  // are reading.
  const size_t threads = threads_.size();
  const bool slow = std::exchange(finished_, 0) < threads && limiter_.reading.load() >= static_cast<int>(threads);
  if (!slow || stop_ || workers_ == 0) return;
  // If the system refuses more threads, the existing ones go on.
  const size_t max_threads = std::min({2 * threads, max_threads_, threads + jobs_.size()});
  if (max_threads > threads) threads_.start(max_threads - threads, [this] { work(); });
}

bool PageJobs::available() const {
  if (jobs_.empty() || free_buffers_ == 0) return false;
  return jobs_.back().rank.tier() != Tier::kPrefetch || 2 * free_buffers_ > max_buffers_;
}

PageJob PageJobs::takeLocked() {
  PageJob job{jobs_.back().rank.id, jobs_.back().ticket};
  jobs_.pop_back();
  started_.push_back(job);
  running_.push_back({job, true, light_});
  --free_buffers_;
  return job;
}

std::optional<PageJob> PageJobs::take() {
  std::lock_guard lock(mutex_);
  if (!available()) return {};
  return takeLocked();
}

PageJobs::Running* PageJobs::find(uint64_t ticket) {
  for (Running& r : running_)
    if (r.job.ticket == ticket) return &r;
  return nullptr;
}
const PageJobs::Running* PageJobs::find(uint64_t ticket) const { return const_cast<PageJobs*>(this)->find(ticket); }

bool PageJobs::wanted(const PageJob& job) const {
  std::lock_guard lock(mutex_);
  const Running* r = find(job.ticket);
  return r && r->wanted;
}

void PageJobs::finish(const PageJob& job) {
  std::unique_lock lock(mutex_);
  const Running* found = find(job.ticket);
  assert(found);
  if (!found) return;
  Running running = *found;
  Texels texels;
  if (!pool_.empty()) {
    texels = std::move(pool_.back());
    pool_.pop_back();
  }
  std::unique_ptr<PageLoader> loader;
  if (!loaders_.empty()) {
    loader = std::move(loaders_.back());
    loaders_.pop_back();
  }
  lock.unlock();

  if (!texels) texels = makeTexels();
  if (!loader)
    loader = std::make_unique<PageLoader>(source_, format_, decoder_, upload_, relief_parts_,
                                          workers_ > 0 ? &limiter_ : nullptr, normals_);
  LoadOutcome outcome;
  outcome.id = job.id;
  outcome.ticket = job.ticket;
  loader->load(
      job.id, running.light, [&] { return wanted(job); }, texels.get(), outcome);

  lock.lock();
  ++finished_;
  loaders_.push_back(std::move(loader));
  std::erase_if(running_, [&](const Running& r) { return r.job.ticket == job.ticket; });
  if (outcome.end == LoadOutcome::End::kLoaded) {
    outcome.texels = std::move(texels);
  } else {
    pool_.push_back(std::move(texels));
    ++free_buffers_;
    work_.notify_one();
  }
  outcomes_.push_back(std::move(outcome));
}

void PageJobs::collect(Report& report, std::vector<Texels>& returned) {
  threads_.rethrow();
  report.started.clear();
  report.done.clear();
  bool more_buffers = !returned.empty();
  {
    std::lock_guard lock(mutex_);
    report.started.swap(started_);
    report.done.swap(outcomes_);
    free_buffers_ += returned.size();
    for (Texels& t : returned) pool_.push_back(std::move(t));
  }
  returned.clear();
  if (more_buffers) work_.notify_all();
}

void PageJobs::publish(std::vector<RankedJob>& jobs, std::vector<PageJob>& started,
                       const std::function<bool(const PageJob&)>& still_wanted) {
  started.clear();
  bool any = false;
  {
    std::lock_guard lock(mutex_);
    started.swap(started_);
    for (const PageJob& s : started) std::erase_if(jobs, [&](const RankedJob& j) { return j.ticket == s.ticket; });
    for (Running& r : running_) r.wanted = !stop_ && still_wanted(r.job);
    jobs_.swap(jobs);
    any = !jobs_.empty();
    if (any) addThreads();
  }
  if (any) work_.notify_all();
}

void PageJobs::setLight(const std::array<double, 3>& light, const std::function<bool(const PageJob&)>& still_wanted,
                        std::vector<PageJob>& started) {
  started.clear();
  std::lock_guard lock(mutex_);
  started.swap(started_);
  light_ = light;
  for (Running& r : running_) r.wanted = r.wanted && still_wanted(r.job);
}

}  // namespace relievo
