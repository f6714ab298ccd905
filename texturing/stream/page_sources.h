// page_sources.h - page sources that wrap another one: memory in front of slow storage, storage that is slow or damaged
// on purpose (for users, tests and benchmarks), and a record of reads. They are read from several threads at once.
// Random behaviour follows from a seed, the page and, for repeated reads, the attempt, so that a run can be repeated
// whatever the threads do.
//
// A package checks its own pages. Sources that damage pages behind its back belong below a CheckedSource:
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

// The time of sources that wait. sleepUntil returns once now() has reached the argument.
struct SourceClock {
  std::function<double()> now_s;
  std::function<void(double)> sleepUntil;
};
// The machine's clock. Nobody sleeps any longer once *stop is set; it may be null.
SourceClock steadyClock(const std::atomic<bool>* stop = nullptr);

// Encoded pages in memory. With an inner source it is a cache that evicts the least recently read page when the budget
// is spent. Without one it holds what was put in.
class MemorySource : public PageSource {
 public:
  explicit MemorySource(uint64_t budget_bytes, std::shared_ptr<const PageSource> inner = {});
  Result<EncodedPage> read(PageId id) const override;
  // False: the page does not fit, and nothing may be evicted since there is no inner source, or it is larger than the
  // budget.
  bool put(PageId id, std::vector<uint8_t> bytes) const;
  // Reads these pages of the inner source. Stops at the first error, and with kUsage when the budget is spent.
  Result<void> load(std::span<const PageId> pages) const;
  uint64_t bytes() const;  // encoded bytes held now, without the map's own
  size_t pages() const;
  uint64_t hits() const;  // reads answered from memory

 private:
  struct Entry {
    std::vector<uint8_t> bytes;
    std::list<PageId>::iterator use;
  };
  bool store(PageId id, std::vector<uint8_t> bytes) const;  // the mutex is held

  uint64_t budget_bytes_;
  std::shared_ptr<const PageSource> inner_;
  mutable std::mutex mutex_;
  mutable std::unordered_map<PageId, Entry> entries_;
  mutable std::list<PageId> uses_;  // most recently read first
  mutable uint64_t bytes_ = 0, hits_ = 0;
};

// A source of which a share of reads fails.
class FailingSource : public PageSource {
 public:
  struct Rates {  // shares of reads, 0 to 1, drawn in this order
    double fail = 0, truncate = 0, corrupt = 0;
    double permanent = 0;  // share of pages that can never be read
    double late = 0;       // share of reads that are correct, but late
    double late_s = 5;
  };
  FailingSource(std::shared_ptr<const PageSource> inner, Rates rates, uint64_t seed, SourceClock clock = steadyClock());
  Result<EncodedPage> read(PageId id) const override;
  int attempts(PageId id) const;
  int maxAttempts() const;

 private:
  std::shared_ptr<const PageSource> inner_;
  Rates rates_;
  uint64_t seed_;
  SourceClock clock_;
  mutable std::mutex mutex_;
  mutable std::unordered_map<PageId, int> attempts_;
};

// A link of limited bandwidth that all reads share, in the order of the calls. A read returns latency_ms plus 0 to
// jitter_ms after its bytes were transferred.
class RateLimitedSource : public PageSource {
 public:
  struct Limits {
    double bytes_per_s = 0;  // 0: unlimited
    double latency_ms = 0, jitter_ms = 0;
  };
  RateLimitedSource(std::shared_ptr<const PageSource> inner, Limits limits, uint64_t seed = 1,
                    SourceClock clock = steadyClock());
  Result<EncodedPage> read(PageId id) const override;
  double latency_s(PageId id) const;  // of this page, from seed and page only

 private:
  std::shared_ptr<const PageSource> inner_;
  Limits limits_;
  uint64_t seed_;
  SourceClock clock_;
  mutable std::mutex mutex_;
  mutable double link_free_s_ = 0;
};

// Compares each page's xxh3-64 with the expected one; a page without one passes. A difference is a temporary error
// (kIo), since the next read may be sound.
class CheckedSource : public PageSource {
 public:
  using ChecksumOf = std::function<std::optional<PageChecksum>(PageId)>;
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

// Records reads in the order in which they began.
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

// A trace is a text: a line "relievo-trace 1", then for each read a line "plane patch level x y bytes".
Result<void> writeTrace(const std::string& path, std::span<const PageRead> reads);
Result<std::vector<PageRead>> readTrace(const std::string& path);

// A package on storage that is slow or damaged on purpose.
struct SimulatedStorage {
  double rate_mb_per_s = 0;  // 10^6 bytes a second; 0: unlimited
  double latency_ms = 0, jitter_ms = 0;
  double fail_percent = 0;  // of reads; a quarter each fails, ends early, comes changed, or comes kLateS late
  double memory_mib = 0;    // memory for encoded pages in front of the storage
  uint64_t seed = 1;
  static constexpr double kLateS = 5;
  bool any() const {
    return rate_mb_per_s > 0 || latency_ms > 0 || jitter_ms > 0 || fail_percent > 0 || memory_mib > 0;
  }
};
std::shared_ptr<const PageSource> withSimulatedStorage(std::shared_ptr<const Package> package,
                                                       const SimulatedStorage& storage,
                                                       SourceClock clock = steadyClock());

}  // namespace relievo
