// page_jobs.h - the channel between the render thread and the workers that read and decode: an ordered list of jobs in
// one direction, outcomes and empty buffers in the other. Its mutex is held for moves of a few values only, never while
// something is read or decoded, so that the render thread does not wait for a source. Workers are threads of this
// object, or callers of take() and finish().
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

// A page to be read and decoded. The ticket tells this request from earlier ones for the same page.
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
  // source, format and decoder must outlive the jobs. workers: the number of threads that decode at a time. max_reads:
  // the largest number of reads under way; a fast source is served by as many threads as workers, and more are added
  // while all of them wait for a slow one (a link with latency). max_buffers: the largest number of jobs under way plus
  // decoded pages that were not returned yet. upload, relief_parts, normals: as for PageLoader. If the system refuses
  // some threads there are fewer; if it refuses all: throws ThreadStartFailure.
  PageJobs(const PageSource& source, const TextureFormat& format, const SlotDecoder& decoder, PageCodec upload,
           ReliefParts relief_parts, int workers, int max_reads, size_t max_buffers,
           const ReliefNormals* normals = nullptr);
  ~PageJobs();  // waits for reads under way, but not for the decoding of their results

  // --- any thread
  // The best job, if there is one and a buffer for it. The caller must finish it. Prefetching gets at most half of the
  // buffers, so that requested pages find one.
  std::optional<PageJob> take();
  void finish(const PageJob& job);  // reads, decodes and delivers
  bool wanted(const PageJob& job) const;

  // --- the render thread
  struct Report {
    std::vector<PageJob> started;  // since the last report
    std::vector<LoadOutcome> done;
  };
  // Replaces both vectors of the report and empties `returned`. Throws what a worker threw (out of memory).
  void collect(Report& report, std::vector<Texels>& returned);
  // Replaces all jobs that were not taken yet; the best is last. Jobs that were taken meanwhile are removed from `jobs`
  // and returned in `started`. still_wanted() decides for every job under way whether it goes on; it is called under
  // the mutex, so it must be brief.
  void publish(std::vector<RankedJob>& jobs, std::vector<PageJob>& started,
               const std::function<bool(const PageJob&)>& still_wanted);
  // Cancels jobs taken so far unless still_wanted() says otherwise; later jobs use the new light. started: as for
  // publish().
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
  LoadLimiter limiter_;

  mutable std::mutex mutex_;
  std::condition_variable work_;
  bool stop_ = false;
  std::vector<RankedJob> jobs_;
  std::vector<Running> running_;
  std::vector<PageJob> started_;
  std::vector<LoadOutcome> outcomes_;
  std::vector<Texels> pool_;
  size_t free_buffers_;  // of the pool, and those not allocated yet
  std::vector<std::unique_ptr<PageLoader>> loaders_;
  std::array<double, 3> light_{0, 0, 1};
  size_t finished_ = 0;                     // jobs finished since the last publish()
  WorkerThreads threads_{"relievo-pages"};  // last, so that threads end before what they use
};

}  // namespace relievo
