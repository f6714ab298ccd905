#include "texturing/stream/page_loader.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "texturing/codec/resolve.h"
#include "texturing/package/package_layout.h"
#include "texturing/package/page_failures.h"
#include "texturing/stream/cache_budget.h"

namespace relievo {

PageLoader::PageLoader(const PageSource& source, const TextureFormat& format, const SlotDecoder& decoder,
                       PageCodec upload, ReliefParts relief_parts, LoadLimiter* limiter, const ReliefNormals* normals)
    : source_(source),
      format_(format),
      decoder_(decoder),
      upload_(upload),
      relief_parts_(relief_parts),
      limiter_(limiter),
      normals_(normals) {
  if (!decoder_) default_decoder_.emplace();
}

void PageLoader::load(PageId id, const std::array<double, 3>& light, const std::function<bool()>& wanted,
                      uint8_t* texels, LoadOutcome& outcome) {
  if (id.plane() != Plane::kResolved) {
    if (!loadPlane(id, wanted, texels, outcome) || id.plane() != Plane::kRelief) return;
    outcome.part_level = reliefPartLevel({texels, kSlotBytes}, relief_parts_);
    return;
  }
  std::vector<const uint8_t*> slots;
  for (int k = 0; k < format_.planes(); ++k) {
    if (scratch_.size() <= size_t(k)) scratch_.push_back(makeTexels());
    if (!loadPlane(PageId(texturePlane(k), id.node()), wanted, scratch_[k].get(), outcome)) return;
    slots.push_back(scratch_[k].get());
  }
  resolvePage(format_, light, slots, texels);
}

bool PageLoader::loadPlane(PageId id, const std::function<bool()>& wanted, uint8_t* texels, LoadOutcome& outcome) {
  if (!normals_ || id.plane() != kNormalPlane) return loadStored(id, wanted, texels, outcome);
  auto readRelief = [&](const NodeId& node, std::span<uint16_t> samples) {
    if (!relief_scratch_) relief_scratch_ = makeTexels();
    if (!loadStored(PageId(Plane::kRelief, node), wanted, relief_scratch_.get(), outcome)) return false;
    reliefSamples({relief_scratch_.get(), kSlotBytes}, samples);
    return true;
  };
  if (!normals_->make(id.node(), readRelief, texels)) return false;
  outcome.end = LoadOutcome::End::kLoaded;
  return true;
}

namespace {
// Ends the step also if an exception is thrown, so that no other thread waits for one that ended.
class LimiterScope {
 public:
  using Step = void (LoadLimiter::*)();
  LimiterScope(LoadLimiter* limiter, Step begin, Step end) : limiter_(limiter), end_(end) {
    if (limiter_) (limiter_->*begin)();
  }
  LimiterScope(const LimiterScope&) = delete;
  LimiterScope& operator=(const LimiterScope&) = delete;
  ~LimiterScope() {
    if (limiter_) (limiter_->*end_)();
  }

 private:
  LoadLimiter* limiter_;
  Step end_;
};
}  // namespace

bool PageLoader::loadStored(PageId id, const std::function<bool()>& wanted, uint8_t* texels, LoadOutcome& outcome) {
  auto end = [&](LoadOutcome::End how) {
    outcome.end = how;
    return how == LoadOutcome::End::kLoaded;
  };
  if (!wanted()) return end(LoadOutcome::End::kCancelledBeforeRead);
  Result<EncodedPage> page = [&] {
    const LimiterScope reading(limiter_, &LoadLimiter::beginReading, &LoadLimiter::endReading);
    return source_.read(id);
  }();
  if (!page) {
    outcome.permanent = page.error().kind == ErrorKind::kInvalidData && !page.error().offset;
    outcome.error = page.error();
    return end(LoadOutcome::End::kFailed);
  }
  outcome.costs.push_back({id.plane(), page->storedBytes(), false});
  if (!wanted()) return end(LoadOutcome::End::kCancelledBeforeDecode);
  std::span<uint8_t> out(texels, slotBytes(upload_, id.plane()));
  const bool blocks = isBlockCodec(upload_) && isTexturePlane(id.plane());
  Result<void> decoded = [&] {
    const LimiterScope decoding(limiter_, &LoadLimiter::beginDecoding, &LoadLimiter::endDecoding);
    return !default_decoder_ ? decoder_(id.plane(), page->bytes, out)
           : blocks          ? default_decoder_->decodeToBlocks(upload_, page->bytes, out)
                             : default_decoder_->decodeToSlot(id.plane(), page->bytes, out);
  }();
  if (!decoded) {
    outcome.error = decoded.error();
    return end(LoadOutcome::End::kFailed);
  }
  outcome.costs.back().decoded = true;
  return end(LoadOutcome::End::kLoaded);
}

std::string pageDescription(PageId id) {
  NodeId n = id.node();
  std::string plane = id.plane() == Plane::kRelief ? "relief"
                      : id.plane() == Plane::kResolved
                          ? "texture"
                          : "texture plane " + std::to_string(texturePlaneIndex(id.plane()));
  return plane + " page of patch " + std::to_string(n.patch) + ", level " + std::to_string(n.level) + ", column " +
         std::to_string(n.x) + ", row " + std::to_string(n.y);
}

}  // namespace relievo
