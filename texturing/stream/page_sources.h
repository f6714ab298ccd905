// page_sources.h - sources that stack on another one: memory in front of slow storage, storage that is slow or damaged
// on purpose (so that a user, a test or a benchmark sees how the engine bears it), and a list of what was read. All of
// them are read from several threads at once. What is random follows from a seed, the page and, where it is read again,
// the attempt: a run can be repeated, whatever the threads do.
//
// A package checks its own pages. What damages them behind its back belongs under a CheckedSource:
//   checked(rate-limited(failing(package)))
#pragma once

#include <atomic>
#include <functional>
#include <list>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "texturing/package/package.h"
#include "texturing/package/page_source.h"

namespace relievo {

// Time for sources that wait. sleepUntil returns once now() is at least that.
struct SourceClock {
  std::function<double()> now_s;
  std::function<void(double)> sleepUntil;
};
// The machine's; once *stop is set (it may be null) nobody sleeps any longer.
SourceClock steadyClock(const std::atomic<bool>* stop = nullptr);

// Encoded pages held in memory. Over another source: what was read stays, the least recently read goes when the budget
// is spent. Without one: what was put in is all there is.
class MemorySource : public PageSource {
 public:
  explicit MemorySource(uint64_t budget_bytes, std::shared_ptr<const PageSource> inner = {});
  Result<EncodedPage> read(PageId id) const override;
  // False when it does not fit beside what is held and nothing may go (there is no inner source), or never can.
  bool put(PageId id, std::vector<uint8_t> bytes) const;
  // Reads these pages of the inner source; the first error ends it, and so does a budget that is spent (kUsage).
  Result<void> load(std::span<const PageId> pages) const;
  uint64_t bytes() const;  // held now: encoded bytes, without the map's own
  size_t pages() const;
  uint64_t hits() const;  // reads answered from memory

 private:
  struct Held {
    std::vector<uint8_t> bytes;
    std::list<PageId>::iterator use;
  };
  bool hold(PageId id, std::vector<uint8_t> bytes) const;  // the mutex is held

  uint64_t budget_bytes_;
  std::shared_ptr<const PageSource> inner_;
  mutable std::mutex mutex_;
  mutable std::unordered_map<PageId, Held> held_;
  mutable std::list<PageId> uses_;  // most recently read first
  mutable uint64_t bytes_ = 0, hits_ = 0;
};

// A share of reads goes wrong.
class FailingSource : public PageSource {
 public:
  struct Rates {  // 0..1, of reads, in this order
    double fail = 0, truncate = 0, corrupt = 0;
    double forever = 0;  // of the pages: never readable
    double late = 0;     // of reads: right, but late
    double late_s = 5;
  };
  FailingSource(std::shared_ptr<const PageSource> inner, Rates rates, uint64_t seed, SourceClock clock = steadyClock());
  Result<EncodedPage> read(PageId id) const override;
  int attempts(PageId id) const;
  int mostAttempts() const;

 private:
  std::shared_ptr<const PageSource> inner_;
  Rates rates_;
  uint64_t seed_;
  SourceClock clock_;
  mutable std::mutex mutex_;
  mutable std::unordered_map<PageId, int> attempts_;
};

// A line of so many bytes a second that every read shares, in the order of asking; a read answers when its bytes are
// through, and its latency later: latency_ms plus 0..jitter_ms.
class RateLimitedSource : public PageSource {
 public:
  struct Limits {
    double bytes_per_s = 0;  // 0: unlimited
    double latency_ms = 0, jitter_ms = 0;
  };
  RateLimitedSource(std::shared_ptr<const PageSource> inner, Limits limits, uint64_t seed = 1,
                    SourceClock clock = steadyClock());
  Result<EncodedPage> read(PageId id) const override;
  double latency_s(PageId id) const;  // of this page: from seed and page alone

 private:
  std::shared_ptr<const PageSource> inner_;
  Limits limits_;
  uint64_t seed_;
  SourceClock clock_;
  mutable std::mutex mutex_;
  mutable double line_free_s_ = 0;
};

// Compares each page's xxh3-64 with the one that it should have; a page without one passes. What differs is an error
// that may pass (kIo): the next read can be sound.
class CheckedSource : public PageSource {
 public:
  using ChecksumOf = std::function<std::optional<uint64_t>(PageId)>;
  CheckedSource(std::shared_ptr<const PageSource> inner, ChecksumOf checksum_of);
  Result<EncodedPage> read(PageId id) const override;
  uint64_t caught() const { return caught_; }

 private:
  std::shared_ptr<const PageSource> inner_;
  ChecksumOf checksum_of_;
  mutable std::atomic<uint64_t> caught_{0};
};
CheckedSource::ChecksumOf checksumsOf(std::shared_ptr<const Package> package);

struct PageRead {
  PageId id;
  uint32_t bytes = 0;  // 0: it failed, or is still under way
  friend bool operator==(const PageRead&, const PageRead&) = default;
};

// Lists reads in the order in which they began.
class RecordingSource : public PageSource {
 public:
  explicit RecordingSource(std::shared_ptr<const PageSource> inner);
  Result<EncodedPage> read(PageId id) const override;
  std::vector<PageRead> trace() const;
  std::vector<PageId> reads() const;

 private:
  std::shared_ptr<const PageSource> inner_;
  mutable std::mutex mutex_;
  mutable std::vector<PageRead> reads_;
};

// A trace as text: a line "relievo-trace 1", then one a read: plane patch level x y bytes.
Result<void> writeTrace(const std::string& path, std::span<const PageRead> reads);
Result<std::vector<PageRead>> readTrace(const std::string& path);

// A package on storage that is slow or damaged on purpose.
struct SimulatedStorage {
  double rate_mb_per_s = 0;  // 10^6 bytes; 0: unlimited
  double latency_ms = 0, jitter_ms = 0;
  double fail_percent = 0;  // of reads: a quarter each fails, ends early, comes changed, comes kLateS late
  double memory_mib = 0;    // encoded pages kept in front of it
  uint64_t seed = 1;
  static constexpr double kLateS = 5;
  bool any() const {
    return rate_mb_per_s > 0 || latency_ms > 0 || jitter_ms > 0 || fail_percent > 0 || memory_mib > 0;
  }
};
std::shared_ptr<const PageSource> onSimulatedStorage(std::shared_ptr<const Package> package,
                                                     const SimulatedStorage& storage,
                                                     SourceClock clock = steadyClock());

}  // namespace relievo
