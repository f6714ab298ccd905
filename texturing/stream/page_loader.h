// page_loader.h - turns a PageId into the texels of a slot: reads from the source, decodes, and for a fixed light
// evaluates the stored planes. Each thread uses a loader of its own at a time.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <semaphore>
#include <span>
#include <string>
#include <vector>

#include "src/artwork/basis.h"
#include "src/base/result.h"
#include "texturing/codec/page_codec.h"
#include "texturing/codec/page_id.h"
#include "texturing/package/page_source.h"
#include "texturing/stream/relief_normals.h"
#include "texturing/stream/relief_subslots.h"

namespace relievo {

using Texels = std::unique_ptr<uint8_t[]>;  // kSlotBytes; of a page of blocks the first slotBytes() count
inline Texels makeTexels() { return std::make_unique<uint8_t[]>(kSlotBytes); }

// Decodes bytes to slot texels, or to blocks (slotBytes() of them) if these are uploaded. Called from several threads
// at once.
using SlotDecoder = std::function<Result<void>(Plane, std::span<const uint8_t> encoded, std::span<uint8_t> texels)>;

// The cost of a job, by stored plane.
struct LoadCost {
  Plane plane;
  uint64_t bytes = 0;
  bool decoded = false;
};

struct LoadOutcome {
  enum class End : uint8_t { kLoaded, kFailed, kCancelledBeforeRead, kCancelledBeforeDecode };
  PageId id;
  uint64_t ticket = 0;
  End end = End::kFailed;
  Texels texels;               // kLoaded
  std::optional<Error> error;  // kFailed
  bool permanent = false;      // kFailed: the page does not exist
  std::vector<LoadCost> costs;
  int part_level = 0;  // kLoaded: the level of the part of a slot that the page takes (subslot_cache.h)
};

// Limits the number of threads that decode. Shared by the threads of one PageJobs; a thread that waits for its source
// does not count.
struct LoadLimiter {
  std::counting_semaphore<> decode;  // held while decoding
  std::atomic<int> reading{0};
  explicit LoadLimiter(int workers) : decode(workers) {}
  void beginReading() { ++reading; }
  void endReading() { --reading; }
  void beginDecoding() { decode.acquire(); }
  void endDecoding() { decode.release(); }
};

class PageLoader {
 public:
  // All arguments must outlive the loader. decoder: empty for a PageDecoder of the loader's own. upload: a block codec
  // for texture pages that are unpacked only; then nothing is resolved or made. relief_parts: the parts that relief
  // pages may take. limiter: may be null. normals: makes the pages of the normal plane (kNormalPlane), which the source
  // does not have; null: the source has all planes of the format.
  PageLoader(const PageSource& source, const TextureFormat& format, const SlotDecoder& decoder,
             PageCodec upload = PageCodec::kLossless, ReliefParts relief_parts = ReliefParts::kOnlyHalves,
             LoadLimiter* limiter = nullptr, const ReliefNormals* normals = nullptr);
  // Loads a page. Asks `wanted` before each read and between a read and its decoding, and gives up if it answers false.
  // Sets end, error, permanent, costs and part_level of the outcome.
  void load(PageId id, const std::array<double, 3>& light, const std::function<bool()>& wanted, uint8_t* texels,
            LoadOutcome& outcome);

 private:
  // Loads a stored page, or makes a normal page from stored ones.
  bool loadPlane(PageId id, const std::function<bool()>& wanted, uint8_t* texels, LoadOutcome& outcome);
  bool loadStored(PageId id, const std::function<bool()>& wanted, uint8_t* texels, LoadOutcome& outcome);

  const PageSource& source_;
  const TextureFormat& format_;
  const SlotDecoder& decoder_;
  const PageCodec upload_;
  const ReliefParts relief_parts_;
  LoadLimiter* limiter_;
  const ReliefNormals* normals_;
  std::optional<PageDecoder> default_decoder_;
  std::vector<Texels> scratch_;
  Texels relief_scratch_;
};

// For messages: "relief page of patch 0, level 3, column 1, row 2".
std::string pageDescription(PageId id);

}  // namespace relievo
