// fake_sources.h - page sources for tests. They stack: a procedural source at the bottom, wrappers that fail, slow
// down, block or record around it. Encoded pages are a few bytes that name their page; fakeDecode() turns them into
// texels that name their page and place, so that a texel in the wrong slot shows.
#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstring>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "texturing/page_codec.h"
#include "texturing/page_source.h"

namespace relievo::fake {

inline uint64_t mix(uint64_t x) {  // splitmix64
  x += 0x9E3779B97F4A7C15ull;
  x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9ull;
  x = (x ^ (x >> 27)) * 0x94D049BB133111EBull;
  return x ^ (x >> 31);
}

inline uint8_t texelByte(PageId id, size_t i) {
  return static_cast<uint8_t>(mix(id.bits) >> (8 * (i & 7))) ^ static_cast<uint8_t>(i >> 10);
}

inline std::vector<uint8_t> fakeEncode(PageId id) {
  std::vector<uint8_t> bytes(24, static_cast<uint8_t>(id.plane()));
  uint64_t check = mix(id.bits ^ 0xABCDEF);
  std::memcpy(bytes.data(), &id.bits, 8);
  std::memcpy(bytes.data() + 8, &check, 8);
  return bytes;
}

// Refuses bytes that are short, corrupt or of another plane.
inline Result<void> fakeDecode(Plane plane, std::span<const uint8_t> encoded, std::span<uint8_t> texels) {
  Error error{ErrorKind::kInvalidData, "fake", "expected 24 bytes of a page, found something else", "", {}};
  PageId id;
  uint64_t check = 0;
  if (encoded.size() != 24 || texels.size() != kSlotBytes) return error;
  std::memcpy(&id.bits, encoded.data(), 8);
  std::memcpy(&check, encoded.data() + 8, 8);
  if (check != mix(id.bits ^ 0xABCDEF) || id.plane() != plane) return error;
  for (size_t i = 0; i < texels.size(); ++i) texels[i] = texelByte(id, i);
  return {};
}

inline bool texelsAreOf(PageId id, const uint8_t* texels) {
  for (size_t i = 0; i < kSlotBytes; ++i)
    if (texels[i] != texelByte(id, i)) return false;
  return true;
}

// Every page for which exists() holds (default: all of them).
class ProceduralSource : public PageSource {
 public:
  explicit ProceduralSource(std::function<bool(PageId)> exists = {}) : exists_(std::move(exists)) {}
  Result<EncodedPage> read(PageId id) const override {
    if (exists_ && !exists_(id)) return Error{ErrorKind::kInvalidData, "fake", "there is no such page", "", {}};
    return EncodedPage{fakeEncode(id)};
  }

 private:
  std::function<bool(PageId)> exists_;
};

// What was kept is what is served.
class MemorySource : public PageSource {
 public:
  std::map<PageId, std::vector<uint8_t>> pages;
  Result<EncodedPage> read(PageId id) const override {
    auto it = pages.find(id);
    if (it == pages.end()) return Error{ErrorKind::kInvalidData, "memory", "there is no such page", "", {}};
    return EncodedPage{it->second};
  }
};

// Counts and lists what is asked for.
class RecordingSource : public PageSource {
 public:
  explicit RecordingSource(std::shared_ptr<const PageSource> inner) : inner_(std::move(inner)) {}
  Result<EncodedPage> read(PageId id) const override {
    {
      std::lock_guard lock(mutex_);
      reads_.push_back(id);
    }
    return inner_->read(id);
  }
  std::vector<PageId> reads() const {
    std::lock_guard lock(mutex_);
    return reads_;
  }

 private:
  std::shared_ptr<const PageSource> inner_;
  mutable std::mutex mutex_;
  mutable std::vector<PageId> reads_;
};

// Some reads fail, end early or come back changed: which ones follows from the seed, the page and the attempt, so that
// a run can be repeated whatever the threads do.
class FailingSource : public PageSource {
 public:
  struct Rates {
    double fail = 0, truncate = 0, corrupt = 0;
    double forever = 0;  // of the pages: never readable
  };
  FailingSource(std::shared_ptr<const PageSource> inner, Rates rates, uint64_t seed)
      : inner_(std::move(inner)), rates_(rates), seed_(seed) {}
  Result<EncodedPage> read(PageId id) const override {
    int attempt = 0;
    {
      std::lock_guard lock(mutex_);
      attempt = attempts_[id]++;
    }
    if (uniform(id, -1) < rates_.forever) return failure(id);
    double dice = uniform(id, attempt);
    if (dice < rates_.fail) return failure(id);
    auto page = inner_->read(id);
    if (!page) return page;
    if ((dice -= rates_.fail) < rates_.truncate) {
      page->bytes.resize(page->bytes.size() / 2);
    } else if ((dice -= rates_.truncate) < rates_.corrupt) {
      page->bytes[page->bytes.size() / 3] ^= 0x40;
    }
    return page;
  }
  int attempts(PageId id) const {
    std::lock_guard lock(mutex_);
    auto it = attempts_.find(id);
    return it == attempts_.end() ? 0 : it->second;
  }
  int mostAttempts() const {
    std::lock_guard lock(mutex_);
    int most = 0;
    for (const auto& [id, n] : attempts_) most = std::max(most, n);
    return most;
  }

 private:
  double uniform(PageId id, int attempt) const {
    return static_cast<double>(mix(mix(id.bits ^ seed_) + static_cast<uint64_t>(attempt)) >> 11) * 0x1p-53;
  }
  Error failure(PageId id) const {
    return {ErrorKind::kIo, "fake", "the read of page " + std::to_string(id.bits) + " failed", "", {}};
  }
  std::shared_ptr<const PageSource> inner_;
  Rates rates_;
  uint64_t seed_;
  mutable std::mutex mutex_;
  mutable std::map<PageId, int> attempts_;
};

class SlowSource : public PageSource {
 public:
  SlowSource(std::shared_ptr<const PageSource> inner, std::chrono::microseconds delay)
      : inner_(std::move(inner)), delay_(delay) {}
  Result<EncodedPage> read(PageId id) const override {
    std::this_thread::sleep_for(delay_);
    return inner_->read(id);
  }

 private:
  std::shared_ptr<const PageSource> inner_;
  std::chrono::microseconds delay_;
};

// Never answers while the gate is shut.
class GatedSource : public PageSource {
 public:
  explicit GatedSource(std::shared_ptr<const PageSource> inner, bool open = false)
      : inner_(std::move(inner)), open_(open) {}
  Result<EncodedPage> read(PageId id) const override {
    std::unique_lock lock(mutex_);
    ++waiting_;
    changed_.notify_all();
    changed_.wait(lock, [&] { return open_; });
    --waiting_;
    lock.unlock();
    return inner_->read(id);
  }
  void open(bool is_open = true) const {
    {
      std::lock_guard lock(mutex_);
      open_ = is_open;
    }
    changed_.notify_all();
  }
  void waitForReaders(int n) const {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, [&] { return waiting_ >= n; });
  }

 private:
  std::shared_ptr<const PageSource> inner_;
  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  mutable bool open_;
  mutable int waiting_ = 0;
};

}  // namespace relievo::fake
