// texture_pages.h - all texture pages of a package, for tools that want the texels of a level: where a patch has no
// page of that level (PatchDomain::textureDepths()), what shaders show there, made from the patch's finest page or from
// its tail by bilinear filtering and rounded to bytes. const and thread-safe.
#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <span>

#include "texturing/codec/page_codec.h"
#include "texturing/package/kept_tails.h"
#include "texturing/package/package.h"

namespace relievo {

class TexturePages {
 public:
  explicit TexturePages(std::shared_ptr<const Package> package);
  // A page of a node of level 0 .. texture_depth, as PageDecoder::decodeToSlot() has it (kSlotBytes).
  Result<void> read(PageId id, PageDecoder& decoder, std::span<uint8_t> slot) const;
  // What it keeps at most once a patch without pages was read: all patches' tails.
  static uint64_t bytes(const Manifest& manifest);

 private:
  struct Tails {
    KeptTails tails;
    std::optional<TailBlocks> blocks;
  };
  const Tails& tails() const;
  Result<void> fromTail(PageId id, std::span<uint8_t> slot) const;

  std::shared_ptr<const Package> package_;
  mutable std::once_flag once_;
  mutable Tails tails_;
};

}  // namespace relievo
