// fake_sources.h - page sources for tests. They stack: a procedural source at the bottom, wrappers that fail, slow
// down, record (page_sources.h) or block around it. Encoded pages are a few bytes that name their page; fakeDecode()
// turns them into texels that name their page and place, so that a texel in the wrong slot shows.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
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

#include "texturing/codec/page_codec.h"
#include "texturing/package/page_source.h"
#include "texturing/stream/cache_budget.h"
#include "texturing/stream/page_sources.h"

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

// Refuses bytes that are short, corrupt or of another plane. upload: what is written is what goes to the GPU,
// slotBytes() of it.
inline Result<void> fakeDecodeFor(PageCodec upload, Plane plane, std::span<const uint8_t> encoded,
                                  std::span<uint8_t> texels) {
  Error error{ErrorKind::kInvalidData, "fake", "expected 24 bytes of a page, found something else", "", {}};
  PageId id;
  uint64_t check = 0;
  if (encoded.size() != 24 || texels.size() != slotBytes(upload, plane)) return error;
  std::memcpy(&id.bits, encoded.data(), 8);
  std::memcpy(&check, encoded.data() + 8, 8);
  if (check != mix(id.bits ^ 0xABCDEF) || id.plane() != plane) return error;
  // texelByte() of each, eight at a time.
  static_assert(std::endian::native == std::endian::little);
  const uint64_t bits = mix(id.bits);
  for (size_t i = 0; i < texels.size(); i += 8) {
    const uint64_t eight = bits ^ 0x0101010101010101ull * static_cast<uint8_t>(i >> 10);
    std::memcpy(texels.data() + i, &eight, std::min<size_t>(8, texels.size() - i));
  }
  return {};
}

inline Result<void> fakeDecode(Plane plane, std::span<const uint8_t> encoded, std::span<uint8_t> texels) {
  return fakeDecodeFor(PageCodec::kLossless, plane, encoded, texels);
}

inline bool texelsAreOf(PageId id, const uint8_t* texels, PageCodec upload = PageCodec::kLossless) {
  for (size_t i = 0; i < slotBytes(upload, id.plane()); ++i)
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
class MapSource : public PageSource {
 public:
  std::map<PageId, std::vector<uint8_t>> pages;
  Result<EncodedPage> read(PageId id) const override {
    auto it = pages.find(id);
    if (it == pages.end()) return Error{ErrorKind::kInvalidData, "memory", "there is no such page", "", {}};
    return EncodedPage{it->second};
  }
};

class SlowSource : public RateLimitedSource {
 public:
  SlowSource(std::shared_ptr<const PageSource> inner, std::chrono::microseconds delay)
      : RateLimitedSource(std::move(inner), {.latency_ms = static_cast<double>(delay.count()) / 1000}) {}
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
