// page_loader.h - what a thread needs to turn a PageId into the texels of a slot: reads from the source, decodes, and
// for a fixed light evaluates the stored planes. One loader per thread at a time.
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

// Encoded bytes to slot texels, or to blocks where those are uploaded (slotBytes() of them). Called from several
// threads at once.
using SlotDecoder = std::function<Result<void>(Plane, std::span<const uint8_t> encoded, std::span<uint8_t> texels)>;

// What a job cost, by stored plane.
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
  bool permanent = false;      // kFailed, and there is no such page
  std::vector<LoadCost> costs;
  int part_level = 0;  // kLoaded: of the part of a slot that the page takes (subslot_cache.h)
};

// Shared by the threads of one PageJobs: a thread that waits for its source does not count as one that works.
struct LoadGate {
  std::counting_semaphore<> decode;  // who decodes holds one
  std::atomic<int> reading{0};
  explicit LoadGate(int workers) : decode(workers) {}
  void beginReading() { ++reading; }
  void endReading() { --reading; }
  void beginDecoding() { decode.acquire(); }
  void endDecoding() { decode.release(); }
};

class PageLoader {
 public:
  // All outlive the loader. decoder: empty is a PageDecoder of its own. upload: a block codec for texture pages that
  // are unpacked, not decoded; then nothing is resolved or made. relief_parts: that relief pages may take. gate: may be
  // null. normals: makes the pages of the normal plane (kNormalPlane), which the source does not have; null: it has all
  // planes of the format.
  PageLoader(const PageSource& source, const TextureFormat& format, const SlotDecoder& decoder,
             PageCodec upload = PageCodec::kLossless, ReliefParts relief_parts = ReliefParts::kOnlyHalves,
             LoadGate* gate = nullptr, const ReliefNormals* normals = nullptr);
  // Asks `wanted` before each read and between each read and its decoding; false: gives up. Sets end, error, permanent,
  // costs and part_level of the outcome.
  void load(PageId id, const std::array<double, 3>& light, const std::function<bool()>& wanted, uint8_t* texels,
            LoadOutcome& outcome);

 private:
  // A page that is stored, or a normal page that is made of stored ones.
  bool loadPlane(PageId id, const std::function<bool()>& wanted, uint8_t* texels, LoadOutcome& outcome);
  bool loadOne(PageId id, const std::function<bool()>& wanted, uint8_t* texels, LoadOutcome& outcome);

  const PageSource& source_;
  const TextureFormat& format_;
  const SlotDecoder& decoder_;
  const PageCodec upload_;
  const ReliefParts relief_parts_;
  LoadGate* gate_;
  const ReliefNormals* normals_;
  std::optional<PageDecoder> own_;
  std::vector<Texels> scratch_;
  Texels relief_scratch_;
};

// For messages: "relief page of patch 0, level 3, column 1, row 2".
std::string pageWords(PageId id);

}  // namespace relievo
