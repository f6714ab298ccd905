// reencoded_pages.h - the pages of an artwork as if its package had been built with other encodings or fewer bits: each
// page is decoded, rounded and encoded when it is first asked for, and kept. So what is read, decoded and drawn is what
// the package built anew would give, without building it. Thread-safe.
#pragma once

#include <memory>
#include <mutex>
#include <unordered_map>

#include "src/engine/artwork.h"
#include "texturing/codec/page_codec.h"
#include "texturing/package/page_source.h"
#include "tools/accuracy/knobs.h"

namespace relievo {

// A height of so many bits: the nearest multiple of 2^(16 - bits), 65535 at most. The same value always becomes the
// same one, so that pages that meet still agree.
uint16_t roundedHeight(uint16_t height, int bits);  // 16: as it is

class ReencodedPages final : public PageSource {
 public:
  // kUsage where the encoding has no such name.
  static Result<std::shared_ptr<ReencodedPages>> create(std::shared_ptr<const PageSource> pages,
                                                        const Manifest& manifest, const AccuracySetting& setting);
  Result<EncodedPage> read(PageId id) const override;
  const PlaneEncodings& encodings() const { return encodings_; }
  // What encoding has taken so far: CPU time of one thread for so many pages, s.
  double encodedSeconds() const;
  uint64_t encodedPages() const;

 private:
  struct Codec {
    PageEncoder encoder{3};
    PageDecoder decoder;
  };
  ReencodedPages(std::shared_ptr<const PageSource> pages, PlaneEncodings encodings, bool textures, int relief_bits)
      : pages_(std::move(pages)), encodings_(encodings), textures_(textures), relief_bits_(relief_bits) {}
  Result<EncodedPage> encoded(PageId id, Codec& codec) const;

  std::shared_ptr<const PageSource> pages_;
  PlaneEncodings encodings_;
  bool textures_;  // false: texture pages stay as they are
  int relief_bits_;
  mutable std::mutex mutex_;
  mutable std::unordered_map<PageId, EncodedPage> kept_;
  mutable std::vector<std::unique_ptr<Codec>> idle_;
  mutable double encoded_s_ = 0;
};

// The artwork with those pages; without a rebuilt setting as it is, and pages stays null.
Result<Artwork> artworkOf(std::shared_ptr<const Package> package, const AccuracySetting& setting,
                          std::shared_ptr<ReencodedPages>* pages);

}  // namespace relievo
