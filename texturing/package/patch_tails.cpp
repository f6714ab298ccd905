#include "texturing/package/patch_tails.h"

#include <algorithm>
#include <cassert>
#include <cstring>
#include <mutex>

#include "src/base/parallel_for.h"
#include "texturing/codec/neutral_page.h"
#include "texturing/codec/page_codec.h"
#include "texturing/codec/resolve.h"
#include "texturing/package/package_layout.h"

namespace relievo {
namespace {
constexpr int kAttempts = 4;  // to read a page: what fails may pass
}

void tailHeights(std::span<const uint16_t> samples, std::span<uint16_t> out) {
  assert(samples.size() == kReliefPageSamples && out.size() == kTailHeights);
  constexpr size_t kStep = kPagePx >> kTailCellsLog2;
  for (size_t y = 0; y < kTailSamples; ++y)
    for (size_t x = 0; x < kTailSamples; ++x)
      out[y * kTailSamples + x] = samples[y * kStep * kReliefSamples + x * kStep];
}

void tailTexels(const MipFilter& mip, std::span<const uint8_t> texels, std::span<uint8_t> out) {
  const size_t channels = out.size() / kTailPatchTexels;
  int side = texels.size() == channels * kTailTexels * kTailTexels ? kTailTexels : kPagePx;
  assert(texels.size() == channels * static_cast<size_t>(side) * static_cast<size_t>(side));
  uint8_t* to = out.data();
  if (side == kTailTexels) to = std::copy(texels.begin(), texels.end(), to);
  std::vector<uint16_t> level(texels.size() / 4), coarser;
  mip.downsample(texels.data(), side, side, level.data());
  for (side /= 2; side >= kTailTexels >> (kTailLevels - 1); side /= 2) {
    if (side <= kTailTexels) to = std::transform(level.begin(), level.end(), to, byteFromLevel);
    coarser.resize(level.size() / 4);
    mip.downsample(level.data(), side, side, coarser.data());
    level.swap(coarser);
  }
}

void neutralTail(const TextureFormat& format, std::span<uint8_t> out) {
  std::vector<uint8_t> page(kSlotBytes), texel;
  for (int plane = 0; plane < format.planes(); ++plane) {
    neutralPage(texturePlane(plane), format, PageCodec::kLossless, page.data());
    texel.insert(texel.end(), page.begin(), page.begin() + 3);
  }
  uint8_t* to = out.data();
  for (int level = 0; level < kTailLevels; ++level)
    for (const uint8_t value : texel) to = std::fill_n(to, PatchTails::side(level) * PatchTails::side(level), value);
}

void tailsFromPages(const PageSource& source, const TextureFormat& format, bool relief, uint32_t first, int workers,
                    PatchTails& tails, std::vector<std::string>* problems, const std::atomic<bool>* stop) {
  const MipFilter mip(format);
  std::mutex mutex;
  struct Buffers {
    PageDecoder decoder;
    std::vector<uint8_t> slot, root;
    std::vector<uint16_t> samples;
  };
  auto makeBuffers = [&] {
    return Buffers{{},
                   std::vector<uint8_t>(kSlotBytes),
                   std::vector<uint8_t>(static_cast<size_t>(format.channels()) * kPagePx * kPagePx),
                   std::vector<uint16_t>(kReliefPageSamples)};
  };
  parallelForWith(tails.patches, std::max(workers, 1), stop, makeBuffers, [&](Buffers& b, size_t i) {
    PageDecoder& decoder = b.decoder;
    std::vector<uint8_t>&slot = b.slot, &root = b.root;
    std::vector<uint16_t>& samples = b.samples;
    const auto at = static_cast<uint32_t>(i);
    const uint32_t patch = first + at;
    auto loadOnce = [&](PageId id) -> Result<void> {
      auto page = source.read(id);
      return page ? decoder.decodeToSlot(id.plane(), page->bytes, slot) : Result<void>(page.error());
    };
    auto load = [&](PageId id) {
      Result<void> loaded;
      for (int attempt = 0; attempt < kAttempts; ++attempt)
        if (loaded = loadOnce(id); loaded.ok()) return;
      neutralPage(id.plane(), format, PageCodec::kLossless, slot.data());
      std::lock_guard lock(mutex);
      tails.failures.add(id, loaded.error());
      if (problems)
        problems->push_back("the page of " + describePage(id) +
                            (loaded.error().offset ? " is damaged" : " is missing") +
                            ", a neutral one stands in: " + loaded.error().text());
    };
    if (relief) {
      load(PageId(Plane::kRelief, {patch, 0, 0, 0}));
      reliefSamples(slot, samples);
      tailHeights(samples, tails.heightsOf(at));
    }
    for (int plane = 0; plane < format.planes(); ++plane) {
      load(PageId(texturePlane(plane), {patch, 0, 0, 0}));
      uint8_t* to = root.data() + static_cast<size_t>(3 * plane) * kPagePx * kPagePx;
      for (size_t c = 0; c < 3; ++c)
        for (size_t y = 0; y < kPagePx; ++y) {
          const uint8_t* row = slot.data() + 4 * ((y + kPageBorderPx) * kPageFullPx + kPageBorderPx) + c;
          for (size_t x = 0; x < kPagePx; ++x) *to++ = row[4 * x];
        }
    }
    tailTexels(mip, root, tails.texelsOf(at));
  });
  if (problems) std::sort(problems->begin(), problems->end());
}

PatchTails planeOfTails(const PatchTails& tails, int plane) {
  PatchTails out(tails.patches, 3);
  out.heights.clear();
  for (uint32_t patch = 0; patch < tails.patches; ++patch)
    for (int level = 0; level < kTailLevels; ++level)
      for (int c = 0; c < 3; ++c)
        std::copy_n(tails.level(patch, level, 3 * plane + c),
                    static_cast<size_t>(PatchTails::side(level) * PatchTails::side(level)), out.level(patch, level, c));
  return out;
}

PatchTails resolvedTails(const PatchTails& tails, const TextureFormat& format, const std::array<double, 3>& light) {
  PatchTails out(tails.patches, 3);
  out.heights.clear();
  const size_t planes = static_cast<size_t>(format.planes());
  constexpr uint32_t kAtOnce = kSlotBytes / 4 / kTailPatchTexels;  // as many tails as a page has texels
  std::vector<std::vector<uint8_t>> slots(planes, std::vector<uint8_t>(kSlotBytes));
  std::vector<const uint8_t*> pointers;
  for (const auto& slot : slots) pointers.push_back(slot.data());
  std::vector<uint8_t> resolved(kSlotBytes);
  for (uint32_t first = 0; first < tails.patches; first += kAtOnce) {
    const uint32_t count = std::min(kAtOnce, tails.patches - first);
    auto forEach = [&](auto&& f) {  // f(texel of the slot, level, index in the level, patch)
      size_t at = 0;
      for (uint32_t patch = first; patch < first + count; ++patch)
        for (int level = 0; level < kTailLevels; ++level)
          for (size_t i = 0; i < static_cast<size_t>(PatchTails::side(level) * PatchTails::side(level)); ++i)
            f(at++, level, i, patch);
    };
    for (int c = 0; c < 3 * format.planes(); ++c)
      forEach([&](size_t at, int level, size_t i, uint32_t patch) {
        slots[static_cast<size_t>(c / 3)][4 * at + static_cast<size_t>(c % 3)] = tails.level(patch, level, c)[i];
      });
    resolvePage(format, light, pointers, resolved.data());
    for (int c = 0; c < 3; ++c)
      forEach([&](size_t at, int level, size_t i, uint32_t patch) {
        out.level(patch, level, c)[i] = resolved[4 * at + static_cast<size_t>(c)];
      });
  }
  return out;
}

}  // namespace relievo
