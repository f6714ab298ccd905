#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <map>
#include <mutex>
#include <optional>

#include "src/base/channel.h"
#include "src/base/worker_threads.h"
#include "texturing/codec/page_codec.h"
#include "texturing/package/package.h"
#include "texturing/package/package_layout.h"
#include "texturing/package/package_sections.h"

namespace relievo {
namespace {

struct Job {
  uint64_t serial = 0;
  bool relief = false;
  IndexLayout::Block block;
};

// Do ranges lie one after the other without gaps, in whatever order they are added? Then each place but the ends is the
// start of one range as often as the end of one: the sums of a hash over both are the same, and takes no memory a
// range.
struct Tiling {
  uint64_t ends = 0, bytes = 0;
  bool complete = true;                // all ranges are known
  static uint64_t mixed(uint64_t v) {  // Stafford's mix 13
    v = (v ^ (v >> 30)) * 0xBF58476D1CE4E5B9ull;
    v = (v ^ (v >> 27)) * 0x94D049BB133111EBull;
    return v ^ (v >> 31);
  }
  void add(uint64_t offset, uint64_t size) {
    ends += mixed(offset + size) - mixed(offset);
    bytes += size;
  }
  void add(const Tiling& other) {
    ends += other.ends;
    bytes += other.bytes;
    complete = complete && other.complete;
  }
};

struct Outcome {
  uint64_t pages = 0, bytes = 0;
  Tiling tiling;
  std::vector<VerifyProblem> problems;
};

VerifyProblem problemOf(const Error& error, std::string what, std::optional<PageId> page = {}) {
  return {page, std::move(what), error.kind == ErrorKind::kIo, false};
}

Outcome verifyBlock(const Package& package, const PageSource& pages, PageDecoder& decoder, std::vector<uint8_t>& texels,
                    const Job& job, const std::atomic<bool>* stop) {
  Outcome out;
  const int planes = job.relief ? 1 : package.manifest().texture.planes();
  auto plane = [&](int k) { return job.relief ? Plane::kRelief : texturePlane(k); };
  out.pages = uint64_t{job.block.columns} * job.block.rows * planes;
  const NodeId& n = job.block.first;
  if (job.relief) {
    if (auto sound = package.checkReliefDetail(n); !sound)
      out.problems.push_back(problemOf(
          sound.error(), sound.error().text() + ": errors by block, relief level " + std::to_string(n.level)));
  }
  if (auto sound = package.checkIndex(PageId(plane(0), n)); !sound) {
    out.tiling.complete = false;
    out.problems.push_back(
        problemOf(sound.error(), sound.error().text() + ": " + std::to_string(out.pages) + " pages lost, " +
                                     (job.relief ? "relief" : "texture") + " patch " + std::to_string(n.patch) +
                                     " level " + std::to_string(n.level) + " x " + std::to_string(n.x) + ".." +
                                     std::to_string(n.x + job.block.columns - 1) + " y " + std::to_string(n.y) + ".." +
                                     std::to_string(n.y + job.block.rows - 1)));
    return out;
  }
  for (uint32_t y = 0; y < job.block.rows; ++y) {
    for (uint32_t x = 0; x < job.block.columns; ++x) {
      if (stop && stop->load()) return out;
      NodeId node = job.block.first;
      node.x += x;
      node.y += y;
      for (int k = 0; k < planes; ++k) {
        PageId id(plane(k), node);
        auto record = package.record(id);
        if (record) out.tiling.add(record->offset, record->size);
        else out.tiling.complete = false;
        auto page = pages.read(id);
        if (!page) {
          out.problems.push_back(problemOf(page.error(), page.error().text(), id));
          continue;
        }
        out.bytes += page->storedBytes();
        if (auto decoded = decoder.decodeToSlot(plane(k), page->bytes, texels); !decoded) {
          out.problems.push_back(problemOf(decoded.error(),
                                           "page " + describePage(id) + " at byte " +
                                               std::to_string(record ? record->offset : 0) + ": " +
                                               decoded.error().message,
                                           id));
        }
      }
    }
  }
  return out;
}

// Blocks are verified in any order and their outcomes taken in the index's. At most kAhead a worker wait for one that
// takes longer, so that what they found stays little.
class InOrder {
 public:
  InOrder(uint64_t ahead, std::function<void(Outcome&)> take) : ahead_(ahead), take_(std::move(take)) {}
  // Waits until a block of that number may be begun. False: closed.
  bool waitFor(uint64_t serial) {
    std::unique_lock lock(mutex_);
    moved_.wait(lock, [&] { return closed_ || serial < next_ + ahead_; });
    return !closed_;
  }
  void close() {
    {
      std::lock_guard lock(mutex_);
      closed_ = true;
    }
    moved_.notify_all();
  }
  void add(uint64_t serial, Outcome out) {
    {
      std::lock_guard lock(mutex_);
      waiting_.emplace(serial, std::move(out));
      for (auto first = waiting_.begin(); first != waiting_.end() && first->first == next_;
           first = waiting_.erase(first), ++next_)
        take_(first->second);
    }
    moved_.notify_all();
  }

 private:
  std::mutex mutex_;
  std::condition_variable moved_;
  std::map<uint64_t, Outcome> waiting_;
  uint64_t next_ = 0, ahead_;
  bool closed_ = false;
  std::function<void(Outcome&)> take_;
};

}  // namespace

Result<VerifyReport> verifyPackage(const Package& package, const VerifyOptions& options) {
  constexpr uint64_t kAhead = 4;
  const Manifest& manifest = package.manifest();
  const PackageHeader& header = package.header();
  const PageSource& pages = options.pages ? *options.pages : package;
  const int workers = workerCount(options.workers);
  const auto stop = [&] { return options.interrupted && options.interrupted->load(); };
  const Error interrupted{ErrorKind::kInterrupted, package.path(), "interrupted", "", {}};
  VerifyReport report;
  auto say = [&](const VerifyProblem& problem) {
    if (options.problem) return options.problem(problem);
    if (problem.unreadable) report.unreadable.push_back(problem.what);
    else if (problem.page) report.damaged.push_back({*problem.page, problem.what});
    else report.other.push_back(problem.what);
  };
  const ReadBytes read = [&](uint64_t offset, std::span<uint8_t> out) { return package.readBytes(offset, out); };
  auto faults = sectionFaults({header, package.fileBytes()}, read, options.interrupted);
  if (!faults) return faults.error();
  for (const SectionFault& fault : *faults)
    say({{}, fault.what, fault.unreadable, fault.mend != SectionFault::Mend::kNone});
  if (const auto& problem = package.manifestProblem()) say(problemOf(*problem, problem->message));

  Tiling tiling;
  std::atomic<uint64_t> done{0};
  InOrder in_order(static_cast<uint64_t>(workers) * kAhead, [&](Outcome& out) {
    report.pages += out.pages;
    report.bytes += out.bytes;
    tiling.add(out.tiling);
    if (!stop())
      for (const VerifyProblem& problem : out.problems) say(problem);
  });
  Channel<Job> jobs(static_cast<size_t>(workers));
  struct Worker {
    PageDecoder decoder;
    std::vector<uint8_t> texels = std::vector<uint8_t>(kSlotBytes);
  };
  auto run = [&](Worker& worker, const Job& job) {
    Outcome out =
        stop() ? Outcome{} : verifyBlock(package, pages, worker.decoder, worker.texels, job, options.interrupted);
    done += out.pages;
    in_order.add(job.serial, std::move(out));
  };
  // Where no thread can be started, the caller's does the jobs as they come.
  std::optional<Worker> own_worker;
  WorkerThreads threads("relievo-verify");
  struct Closed {
    Channel<Job>& jobs;
    ~Closed() { jobs.close(); }
  } closed_before_joined{jobs};
  threads.start(static_cast<size_t>(workers), [&] {
    try {
      Worker worker;
      while (auto job = jobs.pop()) run(worker, *job);
    } catch (...) {  // nobody waits for room, or for this block
      jobs.close();
      in_order.close();
      throw;
    }
  });
  if (threads.empty()) own_worker.emplace();
  PackageLayout layout = packageLayout(header.domain, manifest.texture, 0, 0);
  uint64_t serial = 0;
  for (bool relief : {false, true}) {
    (relief ? layout.relief : layout.texture).forEachBlock([&](const IndexLayout::Block& block) {
      const Job job{serial++, relief, block};
      if (!in_order.waitFor(job.serial)) return false;
      if (own_worker) run(*own_worker, job);
      else if (!jobs.push(job)) return false;
      if (options.progress) options.progress(done, manifest.page_count);
      return !stop();
    });
  }
  jobs.close();
  threads.join();
  threads.rethrow();
  if (stop()) return interrupted;
  if (options.progress) options.progress(done, manifest.page_count);

  const uint64_t pages_end = header.pages_offset + header.pages_bytes;
  if (tiling.complete && (tiling.bytes != header.pages_bytes ||
                          tiling.ends != Tiling::mixed(pages_end) - Tiling::mixed(header.pages_offset))) {
    say({{},
         "expected pages one after the other in the " + std::to_string(header.pages_bytes) + " bytes at byte " +
             std::to_string(header.pages_offset) + ", found pages of " + std::to_string(tiling.bytes) + " bytes" +
             (tiling.bytes < header.pages_bytes
                  ? ": " + std::to_string(header.pages_bytes - tiling.bytes) + " bytes belong to nothing"
                  : ", some of which overlap"),
         false,
         false});
  }
  package.checkTails([&](const Error& error) { say(problemOf(error, error.text())); }, options.interrupted);
  package.checkImages([&](const Error& error) { say(problemOf(error, error.text())); }, options.interrupted);
  if (stop()) return interrupted;
  return report;
}

}  // namespace relievo
