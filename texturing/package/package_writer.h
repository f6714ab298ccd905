// package_writer.h - shared by the builders of packages: temporary storage, workers whose parts are written in order,
// and the file with its index. Internal to texturing/.
#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <nlohmann/json_fwd.hpp>
#include <span>
#include <string>
#include <vector>

#include "src/base/file.h"
#include "src/base/result.h"
#include "src/base/worker_threads.h"
#include "texturing/package/package_builder.h"
#include "texturing/package/package_layout.h"
#include "texturing/package/package_tails.h"

namespace relievo {

inline constexpr int kPartsAhead = 2;  // finished parts a worker that may wait to be written

// Bytes at any offset: in memory when small, else in a file without a name beside the output. Regions that do not
// overlap may be written and read by several threads.
class SpillStore {
 public:
  static Result<std::unique_ptr<SpillStore>> create(uint64_t size, bool in_memory, const std::string& beside);
  ~SpillStore();
  Result<void> write(uint64_t offset, const void* bytes, size_t size);
  Result<void> read(uint64_t offset, void* bytes, size_t size) const;

 private:
  SpillStore() = default;
  Result<void> holds(uint64_t offset, size_t size) const;
  Error failed(const char* doing, int error_number) const;
  std::string path_;
  uint64_t size_ = 0;
  std::unique_ptr<uint8_t[]> memory_;
  int fd_ = -1;
};

// Hands out the bytes that spills may keep in memory.
struct SpillBudget {
  uint64_t left = 0;
  std::string beside;
  Result<std::unique_ptr<SpillStore>> create(uint64_t size) {
    bool in_memory = size <= left;
    if (in_memory) left -= size;
    return SpillStore::create(size, in_memory, beside);
  }
};

uint64_t encodedHash(std::span<const uint8_t> encoded);  // xxh3-64

// What a relief node knows of the samples below it, in 16-bit units.
struct BlockError {  // src/artwork/deviation.h, in those units
  uint16_t error = 0, below = 0, above = 0, aside = 0;
  uint32_t between = 0, apart = 0;
  friend BlockError joined(const BlockError& a, const BlockError& b) {
    return {std::max(a.error, b.error), std::max(a.below, b.below),     std::max(a.above, b.above),
            std::max(a.aside, b.aside), std::max(a.between, b.between), std::max(a.apart, b.apart)};
  }
};
struct NodeRange {
  uint16_t min = 65535, max = 0, error = 0;
  std::array<BlockError, kReliefDetailBytes> blocks{};
};

struct Placed {               // a page that was made
  uint64_t index_offset = 0;  // of its entry, in the file
  uint32_t size = 0;
  uint64_t checksum = 0;
  bool relief = false;
  uint64_t detail_offset = 0;  // relief: of its errors by block; 0: it has none
  NodeRange range;
};
// What a part hands to the next stage: bytes at a place of a spill.
struct SpillBlock {
  uint64_t offset = 0;
  std::vector<uint8_t> bytes;
};
struct BuildPart {
  std::vector<uint8_t> bytes;
  std::vector<Placed> pages;
  uint64_t texels = 0;  // finest texels of the texture done
  SpillBlock texture_spill, relief_spill;
  uint64_t spill_node = 0;  // of spill_range
  NodeRange spill_range;
  Result<void> status;
  void place(const Placed& page, std::span<const uint8_t> encoded) {
    pages.push_back(page);
    pages.back().size = static_cast<uint32_t>(encoded.size());
    pages.back().checksum = encodedHash(encoded);
    bytes.insert(bytes.end(), encoded.begin(), encoded.end());
  }
};

// Workers take jobs in order and make parts of them; the caller takes the parts in that order, so what is written does
// not depend on the workers. next (called by one worker at a time) gives the next job, or false; make_worker is called
// by each worker's thread. Where no thread can be started, take() does the jobs.
template <class Job>
class OrderedWorkers {
 public:
  using Worker = std::function<BuildPart(const Job&)>;
  OrderedWorkers(int workers, int ahead, const std::atomic<bool>* interrupted, std::function<bool(Job*)> next,
                 std::function<Worker()> make_worker)
      : next_(std::move(next)),
        make_worker_(std::move(make_worker)),
        interrupted_(interrupted),
        ahead_(static_cast<uint64_t>(workers) * static_cast<uint64_t>(1 + ahead)) {
    threads_.start(static_cast<size_t>(workers), [this] { work(); });
  }
  ~OrderedWorkers() {
    {
      std::lock_guard lock(mutex_);
      stopped_ = true;
    }
    room_.notify_all();
    threads_.join();
  }
  // The next part in order; waits at most a tenth of a second (then null). Throws what a worker threw.
  std::unique_ptr<BuildPart> take() {
    threads_.rethrow();
    if (threads_.empty()) workOnce(own_worker_);
    std::unique_lock lock(mutex_);
    ready_.wait_for(lock, std::chrono::milliseconds(100), [&] { return done_.contains(written_); });
    auto found = done_.find(written_);
    if (found == done_.end()) return nullptr;
    auto out = std::make_unique<BuildPart>(std::move(found->second));
    done_.erase(found);
    ++written_;
    lock.unlock();
    room_.notify_all();
    return out;
  }

 private:
  void work() {
    Worker worker;
    while (workOnce(worker)) {
    }
  }
  // One job, by a worker that is made for the first; false: there are no more.
  bool workOnce(Worker& worker) {
    if (!worker) worker = make_worker_();
    Job job;
    uint64_t serial;
    {
      std::unique_lock lock(mutex_);
      room_.wait(lock, [&] { return stopped_ || taken_ < written_ + ahead_; });
      if (stopped_ || (interrupted_ && interrupted_->load()) || !next_(&job)) return false;
      serial = taken_++;
    }
    BuildPart part = worker(job);
    {
      std::lock_guard lock(mutex_);
      done_.emplace(serial, std::move(part));
    }
    ready_.notify_one();
    return true;
  }

  std::mutex mutex_;
  std::condition_variable ready_, room_;
  std::function<bool(Job*)> next_;
  std::function<Worker()> make_worker_;
  const std::atomic<bool>* interrupted_;
  std::map<uint64_t, BuildPart> done_;
  uint64_t taken_ = 0, written_ = 0, ahead_;
  bool stopped_ = false;
  Worker own_worker_;                       // of take(), where there are no threads
  WorkerThreads threads_{"relievo-build"};  // last
};

// As many workers as are asked for and fit, by what each needs, into three quarters of the memory; at least one.
struct Workforce {
  int workers = 1;
  uint64_t left_bytes = 0;  // for spills: three quarters of the memory that the workers leave
};
Workforce workersThatFit(uint64_t worker_bytes, const BuildOptions& options, uint64_t jobs = ~uint64_t{0});

// Sets the offsets and sizes of what stands before the pages, from the manifest and the base section (whose bytes may
// change). Of an index that will be coded: as many bytes as it may take at most.
Result<void> placeSections(PackageHeader& header, const std::string& manifest, std::span<const uint8_t> base);

// The part file: pages as they come, everything else when it is finished.
class PackageWriter {
 public:
  // header: as placeSections left it.
  static Result<std::unique_ptr<PackageWriter>> create(const std::string& output, const PackageHeader& header,
                                                       std::string manifest, std::vector<uint8_t> base,
                                                       SpillBudget& spills);
  // The same, to go on with a file that create() made and that holds pages; place() says which.
  static Result<std::unique_ptr<PackageWriter>> resume(OutputFile file, const PackageHeader& header,
                                                       std::string manifest, SpillBudget& spills);
  Result<void> append(const BuildPart& part);
  Result<void> place(const BuildPart& part);  // as append(), for a part whose pages are in the file already
  OutputFile& file() { return file_; }
  // After the last page: the tails of the next patches, up to kTailsChunkPatches of them, as package_tails.h encodes
  // them.
  Result<void> appendTails(std::span<const uint8_t> chunk);
  // Images that patches show (patch_images.h): what their tiles take, one after the other, and the directory of them.
  // jpegs: there are such.
  void setImages(std::vector<std::vector<uint8_t>> tiles, std::vector<uint8_t> directory, bool jpegs) {
    header_.image_jpegs = jpegs;
    tiles_ = std::move(tiles);
    images_ = std::move(directory);
  }
  // Directory of tails, images, index, manifest, base mesh, header; renames. The file's bytes.
  Result<uint64_t> finish(const std::atomic<bool>* interrupted);

 private:
  explicit PackageWriter(OutputFile file) : file_(std::move(file)) {}
  Result<void> codeIndex(const std::atomic<bool>* interrupted);
  Result<void> movePages(uint64_t to, const std::atomic<bool>* interrupted);
  Result<void> writeIndex();
  OutputFile file_;
  PackageHeader header_;
  std::string manifest_;
  std::vector<uint8_t> base_;
  std::unique_ptr<SpillStore> index_;  // its entries, without checksums
  std::vector<uint8_t> index_code_;    // what stands for those of pages, where the header asks for it
  uint64_t offset_ = 0;                // of the next page, or chunk of tails
  std::vector<TailsChunk> tails_;
  std::vector<std::vector<uint8_t>> tiles_;
  std::vector<uint8_t> images_;
};

// Takes `parts` parts, appends them and hands each to accept; progress(part, or null while waiting).
template <class Job, class Progress, class Accept>
Result<void> writeParts(OrderedWorkers<Job>& workers, uint64_t parts, PackageWriter& writer,
                        const BuildOptions& options, Progress&& progress, Accept&& accept) {
  while (parts > 0) {
    if (options.interrupted && options.interrupted->load())
      return Error{ErrorKind::kInterrupted, options.output, "interrupted", "nothing was written", {}};
    auto part = workers.take();
    progress(part.get());
    if (!part) continue;
    --parts;
    if (!part->status.ok()) return part->status;
    if (auto appended = writer.append(*part); !appended) return appended;
    if (auto accepted = accept(*part); !accepted) return accepted;
  }
  return {};
}
template <class Job, class Progress>
Result<void> writeParts(OrderedWorkers<Job>& workers, uint64_t parts, PackageWriter& writer,
                        const BuildOptions& options, Progress&& progress) {
  return writeParts(workers, parts, writer, options, progress, [](const BuildPart&) { return Result<void>(); });
}

Error usage(std::string message, std::string hint = {});
// The manifest's members that repeat the header, then its sources, then as text.
nlohmann::ordered_json manifestJson(const PackageHeader& header, const std::string& tool_version);
Result<void> addSource(nlohmann::ordered_json& manifest, const Provenance& p, const char* role);
std::string manifestText(const nlohmann::ordered_json& manifest);

}  // namespace relievo
