#include "tools/accuracy/reencoded_pages.h"

#include <time.h>

#include <algorithm>
#include <utility>

namespace relievo {
namespace {

constexpr int kJpegQuality = 90;  // of "jpeg" without a number

double threadSeconds() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

}  // namespace

uint16_t roundedHeight(uint16_t height, int bits) {
  const int step = 1 << (16 - bits);
  return static_cast<uint16_t>(std::min(65535, (height + step / 2) / step * step));
}

Result<std::shared_ptr<ReencodedPages>> ReencodedPages::create(std::shared_ptr<const PageSource> pages,
                                                               const Manifest& manifest,
                                                               const AccuracySetting& setting) {
  PlaneEncodings encodings = manifest.encodings;
  const bool textures = !setting.encoding.empty() || setting.coefficient_bits < 8;
  if (!setting.encoding.empty()) {
    auto all = parseEncoding(setting.encoding, kJpegQuality);
    if (!all) return all.error();
    encodings = planeEncodings(manifest.texture, *all, *all);
  } else if (setting.coefficient_bits < 8) {
    const PageEncoding quantised{PageCodec::kQuantised, static_cast<uint8_t>(setting.coefficient_bits)};
    for (int p = 0; p < manifest.texture.planes(); ++p)
      if (!isColourPlane(manifest.texture, p)) encodings[static_cast<size_t>(p)] = quantised;
  }
  return std::shared_ptr<ReencodedPages>(
      new ReencodedPages(std::move(pages), encodings, textures, setting.relief_bits));
}

Result<EncodedPage> ReencodedPages::read(PageId id) const {
  std::unique_ptr<Codec> codec;
  {
    std::lock_guard lock(mutex_);
    if (auto found = kept_.find(id); found != kept_.end()) return found->second;
    if (!idle_.empty()) {
      codec = std::move(idle_.back());
      idle_.pop_back();
    }
  }
  if (!codec) codec = std::make_unique<Codec>();
  const double start = threadSeconds();
  auto page = encoded(id, *codec);
  const double took = threadSeconds() - start;
  std::lock_guard lock(mutex_);
  idle_.push_back(std::move(codec));
  if (!page) return page.error();
  encoded_s_ += took;
  kept_.emplace(id, *page);
  return page;
}

Result<EncodedPage> ReencodedPages::encoded(PageId id, Codec& codec) const {
  auto page = pages_->read(id);
  if (!page) return page;
  if (id.plane() == Plane::kRelief) {
    if (relief_bits_ >= 16) return page;
    std::vector<uint16_t> samples(kReliefPageSamples);
    if (auto done = codec.decoder.decodeRelief(page->bytes, samples); !done) return done.error();
    for (uint16_t& s : samples) s = roundedHeight(s, relief_bits_);
    const auto bytes = codec.encoder.encodeRelief(samples);
    return EncodedPage{{bytes.begin(), bytes.end()}};
  }
  if (!textures_) return page;
  std::vector<uint8_t> channels(kTexturePageBytes);
  if (auto done = codec.decoder.decodeTexture(page->bytes, channels); !done) return done.error();
  const auto bytes =
      codec.encoder.encodeTexture(channels, encodings_[static_cast<size_t>(texturePlaneIndex(id.plane()))]);
  return EncodedPage{{bytes.begin(), bytes.end()}};
}

double ReencodedPages::encodedSeconds() const {
  std::lock_guard lock(mutex_);
  return encoded_s_;
}
uint64_t ReencodedPages::encodedPages() const {
  std::lock_guard lock(mutex_);
  return kept_.size();
}

Result<Artwork> artworkOf(std::shared_ptr<const Package> package, const AccuracySetting& setting,
                          std::shared_ptr<ReencodedPages>* pages) {
  Artwork artwork = artworkFromPackage(package);
  pages->reset();
  if (!setting.rebuilt()) return artwork;
  auto made = ReencodedPages::create(package, package->manifest(), setting);
  if (!made) return made.error();
  *pages = *made;
  artwork.manifest.encodings = (*made)->encodings();
  artwork.source = *made;
  // Tails hold texels of the source, for some patches all that there are, and samples of the root pages.
  if (artwork.tails)
    artwork.tails = [tails = std::move(artwork.tails), bits = setting.relief_bits](int workers,
                                                                                   std::vector<std::string>* problems) {
      KeptTails out = tails(workers, problems);
      out.changeHeights([&](uint16_t height) { return roundedHeight(height, bits); });
      return out;
    };
  return artwork;
}

}  // namespace relievo
