#include "texturing/stream/page_sources.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>
#include <system_error>
#include <thread>

#include <xxhash.h>

#include "src/base/file.h"
#include "texturing/package/package_layout.h"

namespace relievo {
namespace {

constexpr double kSleepSliceS = 0.05;  // how soon a sleeping thread sees that it should stop
constexpr uint64_t kMaxTraceBytes = uint64_t{1} << 30;
constexpr const char* kTraceHeader = "relievo-trace 1";

uint64_t mix(uint64_t x) {  // splitmix64 (Steele, Lea, Flood 2014)
  x += 0x9E3779B97F4A7C15ull;
  x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9ull;
  x = (x ^ (x >> 27)) * 0x94D049BB133111EBull;
  return x ^ (x >> 31);
}
uint64_t hash(PageId id, uint64_t seed, uint64_t attempt) { return mix(mix(id.bits ^ seed) + attempt); }
double uniform(PageId id, uint64_t seed, uint64_t attempt) {
  return static_cast<double>(hash(id, seed, attempt) >> 11) * 0x1p-53;
}
constexpr uint64_t kEveryAttempt = ~uint64_t{0};

}  // namespace

SourceClock steadyClock(const std::atomic<bool>* stop) {
  auto now = [] { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); };
  return {now, [now, stop](double until_s) {
            for (double left = until_s - now(); left > 0 && !(stop && *stop); left = until_s - now())
              std::this_thread::sleep_for(std::chrono::duration<double>(stop ? std::min(left, kSleepSliceS) : left));
          }};
}

MemorySource::MemorySource(uint64_t budget_bytes, std::shared_ptr<const PageSource> inner)
    : budget_bytes_(budget_bytes), inner_(std::move(inner)) {}

bool MemorySource::store(PageId id, std::vector<uint8_t> bytes) const {
  if (auto it = entries_.find(id); it != entries_.end()) {
    bytes_ -= it->second.bytes.size();
    uses_.erase(it->second.use);
    entries_.erase(it);
  }
  if (bytes.size() > budget_bytes_) return false;
  while (bytes_ + bytes.size() > budget_bytes_) {
    if (!inner_) return false;
    auto oldest = entries_.find(uses_.back());
    bytes_ -= oldest->second.bytes.size();
    entries_.erase(oldest);
    uses_.pop_back();
  }
  uses_.push_front(id);
  bytes_ += bytes.size();
  entries_.emplace(id, Entry{std::move(bytes), uses_.begin()});
  return true;
}

Result<EncodedPage> MemorySource::read(PageId id) const {
  {
    std::lock_guard lock(mutex_);
    if (auto it = entries_.find(id); it != entries_.end()) {
      ++hits_;
      uses_.splice(uses_.begin(), uses_, it->second.use);
      return EncodedPage{it->second.bytes};
    }
  }
  if (!inner_) return Error{ErrorKind::kInvalidData, "memory", "there is no page " + describePage(id), "", {}};
  auto page = inner_->read(id);
  if (page) {
    std::lock_guard lock(mutex_);
    store(id, page->bytes);
  }
  return page;
}

bool MemorySource::put(PageId id, std::vector<uint8_t> bytes) const {
  std::lock_guard lock(mutex_);
  return store(id, std::move(bytes));
}

Result<void> MemorySource::load(std::span<const PageId> pages) const {
  for (PageId id : pages) {
    auto page = inner_ ? inner_->read(id) : read(id);
    if (!page) return page.error();
    std::lock_guard lock(mutex_);
    if (bytes_ + page->bytes.size() > budget_bytes_ && !entries_.contains(id)) {
      return Error{ErrorKind::kUsage,
                   "",
                   "the pages do not fit " + std::to_string(budget_bytes_) + " bytes of memory",
                   "give it more",
                   {}};
    }
    store(id, std::move(page->bytes));
  }
  return {};
}

uint64_t MemorySource::bytes() const {
  std::lock_guard lock(mutex_);
  return bytes_;
}
size_t MemorySource::pages() const {
  std::lock_guard lock(mutex_);
  return entries_.size();
}
uint64_t MemorySource::hits() const {
  std::lock_guard lock(mutex_);
  return hits_;
}

FailingSource::FailingSource(std::shared_ptr<const PageSource> inner, Rates rates, uint64_t seed, SourceClock clock)
    : inner_(std::move(inner)), rates_(rates), seed_(seed), clock_(std::move(clock)) {}

Result<EncodedPage> FailingSource::read(PageId id) const {
  uint64_t attempt = 0;
  {
    std::lock_guard lock(mutex_);
    attempt = static_cast<uint64_t>(attempts_[id]++);
  }
  double draw = uniform(id, seed_, attempt);
  if (uniform(id, seed_, kEveryAttempt) < rates_.permanent || draw < rates_.fail) {
    return Error{
        ErrorKind::kIo, "simulated storage", "page " + describePage(id) + ": the read failed on purpose", "", {}};
  }
  auto page = inner_->read(id);
  if (!page) return page;
  auto& bytes = page->bytes;
  if ((draw -= rates_.fail) < rates_.truncate) {
    bytes.resize(bytes.size() / 2);
  } else if ((draw -= rates_.truncate) < rates_.corrupt) {
    uint64_t where = mix(hash(id, seed_, attempt));
    if (!bytes.empty()) bytes[(where >> 3) % bytes.size()] ^= static_cast<uint8_t>(1u << (where & 7));
  } else if ((draw -= rates_.corrupt) < rates_.late) {
    clock_.sleepUntil(clock_.now_s() + rates_.late_s);
  }
  return page;
}

int FailingSource::attempts(PageId id) const {
  std::lock_guard lock(mutex_);
  auto it = attempts_.find(id);
  return it == attempts_.end() ? 0 : it->second;
}
int FailingSource::maxAttempts() const {
  std::lock_guard lock(mutex_);
  int max = 0;
  for (const auto& [id, n] : attempts_) max = std::max(max, n);
  return max;
}

RateLimitedSource::RateLimitedSource(std::shared_ptr<const PageSource> inner, Limits limits, uint64_t seed,
                                     SourceClock clock)
    : inner_(std::move(inner)), limits_(limits), seed_(seed), clock_(std::move(clock)) {}

double RateLimitedSource::latency_s(PageId id) const {
  return (limits_.latency_ms + limits_.jitter_ms * uniform(id, seed_, kEveryAttempt)) / 1000;
}

Result<EncodedPage> RateLimitedSource::read(PageId id) const {
  double requested_s = clock_.now_s();
  auto page = inner_->read(id);
  double transferred_s = requested_s;
  if (limits_.bytes_per_s > 0 && page) {
    std::lock_guard lock(mutex_);
    link_free_s_ = std::max(link_free_s_, requested_s) + static_cast<double>(page->storedBytes()) / limits_.bytes_per_s;
    transferred_s = link_free_s_;
  }
  clock_.sleepUntil(transferred_s + latency_s(id));
  return page;
}

CheckedSource::CheckedSource(std::shared_ptr<const PageSource> inner, ChecksumOf checksum_of)
    : inner_(std::move(inner)), checksum_of_(std::move(checksum_of)) {}

Result<EncodedPage> CheckedSource::read(PageId id) const {
  auto page = inner_->read(id);
  if (!page) return page;
  auto expected = checksum_of_(id);
  if (!expected || expected->matches(XXH3_64bits(page->bytes.data(), page->bytes.size()))) return page;
  ++caught_;
  return Error{ErrorKind::kIo,
               "",
               "page " + describePage(id) + " arrived damaged: its checksum does not match",
               "check the storage",
               {}};
}

CheckedSource::ChecksumOf checksumsOf(std::shared_ptr<const Package> package) {
  return [package](PageId id) -> std::optional<PageChecksum> {
    auto record = package->record(id);
    if (!record) return std::nullopt;
    // Others are what is read; such a page comes with the heights of its tail.
    if (id.plane() != Plane::kRelief || id.node().level > 0) return record->checksum;
    const auto page = package->read(id);
    if (!page || page->from_tail == 0) return record->checksum;
    return PageChecksum{XXH3_64bits(page->bytes.data(), page->bytes.size())};
  };
}

RecordingSource::RecordingSource(std::shared_ptr<const PageSource> inner) : inner_(std::move(inner)) {}

Result<EncodedPage> RecordingSource::read(PageId id) const {
  size_t place = 0;
  {
    std::lock_guard lock(mutex_);
    place = reads_.size();
    reads_.push_back({id, 0});
  }
  auto page = inner_->read(id);
  if (page) {
    std::lock_guard lock(mutex_);
    reads_[place].bytes = static_cast<uint32_t>(page->storedBytes());
  }
  return page;
}

std::vector<PageRead> RecordingSource::trace() const {
  std::lock_guard lock(mutex_);
  return reads_;
}

std::vector<PageId> RecordingSource::reads() const {
  std::lock_guard lock(mutex_);
  std::vector<PageId> ids;
  ids.reserve(reads_.size());
  for (const PageRead& r : reads_) ids.push_back(r.id);
  return ids;
}

Result<void> writeTrace(const std::string& path, std::span<const PageRead> reads) {
  std::string text = std::string(kTraceHeader) + "\n";
  for (const PageRead& r : reads) {
    NodeId n = r.id.node();
    const uint32_t values[] = {static_cast<uint32_t>(r.id.plane()), n.patch, n.level, n.x, n.y, r.bytes};
    for (uint32_t v : values) text += std::to_string(v) + ' ';
    text.back() = '\n';
  }
  return writeFile(path, {reinterpret_cast<const uint8_t*>(text.data()), text.size()});
}

Result<std::vector<PageRead>> readTrace(const std::string& path) {
  auto text = readTextFile(path, kMaxTraceBytes);
  if (!text) return text.error();
  std::vector<PageRead> reads;
  size_t at = 0;
  for (size_t line = 1; at < text->size(); ++line) {
    size_t end = std::min(text->find('\n', at), text->size());
    std::string text_line = text->substr(at, end - at);
    auto invalid = [&](const std::string& what) {
      return Error{ErrorKind::kInvalidData, path,
                   "line " + std::to_string(line) + ": expected " + what + ", found '" + text_line.substr(0, 60) + "'",
                   "", at};
    };
    if (line == 1) {
      if (text_line != kTraceHeader) return invalid(std::string("'") + kTraceHeader + "'");
    } else {
      std::array<uint32_t, 6> v{};  // plane patch level x y bytes
      const char *next = text_line.data(), *last = next + text_line.size();
      bool complete = true;
      for (size_t i = 0; complete && i < v.size(); ++i) {
        if (i > 0) complete = next < last && *next++ == ' ';
        auto [rest, failed] = std::from_chars(next, last, v[i]);
        complete = complete && failed == std::errc();
        next = rest;
      }
      if (!complete || next != last) return invalid("plane patch level x y bytes");
      NodeId node{v[1], v[2], v[3], v[4]};
      bool can_exist = v[0] < static_cast<uint32_t>(Plane::kShared) && node.patch < kMaxPatches &&
                       node.level <= kMaxNodeLevel && node.x >> node.level == 0 && node.y >> node.level == 0;
      if (!can_exist) return invalid("a page that can exist");
      reads.push_back({PageId(static_cast<Plane>(v[0]), node), v[5]});
    }
    at = end + 1;
  }
  if (at == 0)
    return Error{ErrorKind::kInvalidData, path, std::string("expected '") + kTraceHeader + "', found an empty file", "",
                 0};
  return reads;
}

std::shared_ptr<const PageSource> withSimulatedStorage(std::shared_ptr<const Package> package,
                                                       const SimulatedStorage& storage, SourceClock clock) {
  if (!storage.any()) return package;
  std::shared_ptr<const PageSource> source = package;
  if (storage.fail_percent > 0) {
    double each = storage.fail_percent / 400;
    FailingSource::Rates rates{
        .fail = each, .truncate = each, .corrupt = each, .late = each, .late_s = SimulatedStorage::kLateS};
    source = std::make_shared<FailingSource>(source, rates, storage.seed, clock);
  }
  if (storage.rate_mb_per_s > 0 || storage.latency_ms > 0 || storage.jitter_ms > 0) {
    RateLimitedSource::Limits limits{storage.rate_mb_per_s * 1e6, storage.latency_ms, storage.jitter_ms};
    source = std::make_shared<RateLimitedSource>(source, limits, storage.seed, clock);
  }
  if (storage.fail_percent > 0) source = std::make_shared<CheckedSource>(source, checksumsOf(package));
  if (storage.memory_mib > 0)
    source = std::make_shared<MemorySource>(static_cast<uint64_t>(storage.memory_mib * 1024 * 1024), source);
  return source;
}

}  // namespace relievo
