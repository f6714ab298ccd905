// page_jobs.h - between the render thread and those who read and decode: an ordered list of jobs one way, outcomes and
// empty buffers the other. The one mutex is held for moves of a few values only, never while something is read or
// decoded, so the render thread does not wait for a source. Workers are threads of its own, or whoever calls take() and
// finish().
#pragma once

#include <array>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <vector>

#include "src/base/worker_threads.h"
#include "texturing/stream/page_loader.h"
#include "texturing/stream/page_rank.h"

namespace relievo {

// A page being read and decoded. The ticket tells this request from earlier ones for the same page.
struct PageJob {
  PageId id;
  uint64_t ticket = 0;
};

struct RankedJob {
  PageRank rank;
  uint64_t ticket = 0;
};

class PageJobs {
 public:
  // The first three outlive the jobs. workers: threads that decode at a time. max_reads: reads under way, at most; as
  // many threads as workers serve a fast source, and more are added while all of them wait for a slow one (a link with
  // latency). max_buffers: jobs under way and decoded pages that are not returned yet, at most. upload, relief_parts,
  // normals: as for PageLoader. Fewer threads where the system refuses some; not one: throws ThreadStartFailure.
  PageJobs(const PageSource& source, const TextureFormat& format, const SlotDecoder& decoder, PageCodec upload,
           ReliefParts relief_parts, int workers, int max_reads, size_t max_buffers,
           const ReliefNormals* normals = nullptr);
  ~PageJobs();  // waits for the reads under way, not for decoding what they bring

  // --- any thread
  // The best job, if there is one and a buffer for it. What is taken is to be finished. Prefetching gets half of the
  // buffers at most, so that what is wanted now finds one.
  std::optional<PageJob> take();
  void finish(const PageJob& job);  // reads, decodes, delivers
  bool wanted(const PageJob& job) const;

  // --- the render thread
  struct Report {
    std::vector<PageJob> started;  // since the last report
    std::vector<LoadOutcome> done;
  };
  // Both vectors are replaced; `returned` is emptied. Throws what a worker threw (out of memory).
  void collect(Report& report, std::vector<Texels>& returned);
  // Replaces all jobs that are not taken yet; the best is last. What was taken meanwhile is left out, and named in
  // started. Every job under way is then wanted or not as still_wanted says (under the mutex: be brief).
  void publish(std::vector<RankedJob>& jobs, std::vector<PageJob>& started,
               const std::function<bool(const PageJob&)>& still_wanted);
  // Jobs taken until now are not wanted any more and have the old light, later ones the new; started and still_wanted
  // as for publish.
  void setLight(const std::array<double, 3>& light, const std::function<bool(const PageJob&)>& still_wanted,
                std::vector<PageJob>& started);
  size_t maxBuffers() const { return max_buffers_; }

 private:
  struct Running {
    PageJob job;
    bool wanted = true;
    std::array<double, 3> light{0, 0, 1};
  };
  void work();
  void addThreads();       // the mutex is held
  bool available() const;  // the mutex is held
  PageJob takeLocked();
  Running* find(uint64_t ticket);
  const Running* find(uint64_t ticket) const;

  const PageSource& source_;
  const TextureFormat& format_;
  const SlotDecoder& decoder_;
  const PageCodec upload_;
  const ReliefParts relief_parts_;
  const ReliefNormals* normals_;
  const int workers_;
  const size_t max_threads_, max_buffers_;
  LoadGate gate_;

  mutable std::mutex mutex_;
  std::condition_variable work_;
  bool stop_ = false;
  std::vector<RankedJob> jobs_;
  std::vector<Running> running_;
  std::vector<PageJob> started_;
  std::vector<LoadOutcome> done_;
  std::vector<Texels> pool_;
  size_t free_buffers_;  // those of the pool, and those not made yet
  std::vector<std::unique_ptr<PageLoader>> loaders_;
  std::array<double, 3> light_{0, 0, 1};
  size_t finished_ = 0;                     // jobs, since the last publish()
  WorkerThreads threads_{"relievo-pages"};  // last
};

}  // namespace relievo
