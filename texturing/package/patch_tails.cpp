#include "texturing/package/patch_tails.h"

#include <algorithm>
#include <cassert>
#include <cstring>
#include <mutex>

#include "src/base/parallel_for.h"
#include "texturing/codec/neutral_page.h"
#include "texturing/codec/page_codec.h"
#include "texturing/codec/resolve.h"
#include "texturing/package/crease_gutter.h"
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

void tailsFromPages(const PageSource& source, const TextureFormat& format, bool relief, uint32_t first, uint32_t count,
                    int workers, PatchTails& tails, std::vector<std::string>* problems, const std::atomic<bool>* stop) {
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
  parallelForWith(count, std::max(workers, 1), stop, makeBuffers, [&](Buffers& b, size_t i) {
    PageDecoder& decoder = b.decoder;
    std::vector<uint8_t>&slot = b.slot, &root = b.root;
    std::vector<uint16_t>& samples = b.samples;
    const uint32_t patch = first + static_cast<uint32_t>(i);
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
      tailHeights(samples, tails.heightsOf(patch));
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
    tailTexels(mip, root, tails.texelsOf(patch));
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

TailBlocks::TailBlocks(const PatchTails& tails, const BaseMesh& base, GutterEnds ends)
    : tails_(tails),
      base_(base),
      ends_(ends),
      neighbours_(patchNeighbours(base)),
      first_(base.corners.size() + 1, 0),
      at_(base.patches.size() * 4) {
  for (const auto& patch : base.patches)
    for (uint32_t corner : patch) ++first_[corner + 1];
  for (size_t i = 1; i < first_.size(); ++i) first_[i] += first_[i - 1];
  std::vector<uint32_t> next(first_.begin(), first_.end() - 1);
  for (uint32_t i = 0; i < at_.size(); ++i) at_[next[base.patches[i / 4][i % 4]]++] = i;
}

std::array<uint8_t, 3> TailBlocks::threeAt(uint32_t patch, int level, size_t first_channel, size_t texel) const {
  std::array<uint8_t, 3> out;
  for (size_t c = 0; c < 3; ++c) out[c] = tails_.level(patch, level, static_cast<int>(first_channel + c))[texel];
  return out;
}

// As a page's border has it: what makes the mean of the four texels around the corner the same from all patches that
// meet there.
uint8_t TailBlocks::beyondCorner(uint32_t patch, size_t k, int level, int channel) const {
  const uint32_t corner = base_.patches[patch][k];
  const size_t last = static_cast<size_t>(PatchTails::side(level) - 1), side = last + 1;
  auto texelAt = [&](size_t slot) { return (slot / 2) * last * side + (slot % 2) * last; };
  auto cornerTexel = [&](uint32_t p, size_t slot) { return tails_.level(p, level, channel)[texelAt(slot)]; };
  size_t sum = 0;
  const size_t meet = first_[corner + 1] - first_[corner];
  const size_t three = GutterEnds::firstOf(static_cast<size_t>(channel));
  for (uint32_t i = first_[corner]; ends_.anyOf(three) && i < first_[corner + 1]; ++i)
    if (ends_.between(three, threeAt(patch, level, three, texelAt(k)),
                      threeAt(at_[i] / 4, level, three, texelAt(at_[i] % 4))))
      return cornerTexel(patch, k);
  for (uint32_t i = first_[corner]; i < first_[corner + 1]; ++i) sum += cornerTexel(at_[i] / 4, at_[i] % 4);
  const int four_means = static_cast<int>((8 * sum + meet) / (2 * meet));
  // Across the two sides that end here.
  auto across = [&](size_t s) -> int {
    const PatchNeighbour& n = neighbours_[patch][s];
    if (n.patch == PatchNeighbour::kNone) return cornerTexel(patch, k);
    const bool at_end = s == kLeft || s == kRight ? k / 2 : k % 2;
    const size_t t = at_end != n.reversed ? last : 0;
    const bool upright = n.side == kLeft || n.side == kRight;
    const size_t edge = n.side == kRight || n.side == kBottom ? last : 0;
    return tails_.level(n.patch, level, channel)[upright ? t * side + edge : edge * side + t];
  };
  const int x = across(k % 2 ? kRight : kLeft), y = across(k / 2 ? kBottom : kTop);
  return static_cast<uint8_t>(std::clamp(four_means - cornerTexel(patch, k) - x - y, 0, 255));
}

void TailBlocks::write(uint32_t patch, int level, uint32_t* out) const {
  const int side = PatchTails::side(level), last = side - 1;
  const size_t planes = static_cast<size_t>(tails_.channels) / 3, row = tailBlockSide(level);
  std::fill_n(out, tailBlockTexels(level) * planes, 0u);
  std::array<std::array<bool, kTailTexels>, 4> ended{};  // by side, the texels beyond which these three channels end
  for (int channel = 0; channel < tails_.channels; ++channel) {
    const uint8_t* own = tails_.level(patch, level, channel);
    auto put = [&](int x, int y, uint8_t value) {  // from -1 on
      out[(static_cast<size_t>(y + 1) * row + static_cast<size_t>(x + 1)) * planes +
          static_cast<size_t>(channel / 3)] |= uint32_t{value} << (8 * (channel % 3));
    };
    for (int y = 0; y < side; ++y)
      for (int x = 0; x < side; ++x) put(x, y, own[y * side + x]);
    for (size_t s = 0; s < 4; ++s) {
      const PatchNeighbour& n = neighbours_[patch][s];
      const bool upright = s == kLeft || s == kRight;
      const int edge = s == kRight || s == kBottom ? last : 0,
                beyond = edge == 0 && (s == kLeft || s == kTop) ? -1 : side;
      const uint8_t* from = n.patch == PatchNeighbour::kNone ? own : tails_.level(n.patch, level, channel);
      const size_t their_side = n.patch == PatchNeighbour::kNone ? s : static_cast<size_t>(n.side);
      const bool reversed = n.patch != PatchNeighbour::kNone && n.reversed;
      const bool their_upright = their_side == kLeft || their_side == kRight;
      const int their_edge = their_side == kRight || their_side == kBottom ? last : 0;
      for (int i = 0; i < side; ++i) {
        const int t = reversed ? last - i : i;
        const auto theirs = static_cast<size_t>(their_upright ? t * side + their_edge : their_edge * side + t),
                   nearest = static_cast<size_t>(upright ? i * side + edge : edge * side + i);
        bool& end = ended[s][static_cast<size_t>(i)];
        if (const auto first = static_cast<size_t>(channel); first % 3 == 0)
          end = n.patch != PatchNeighbour::kNone && ends_.anyOf(first) &&
                ends_.between(first, threeAt(patch, level, first, nearest), threeAt(n.patch, level, first, theirs));
        const uint8_t value = end ? own[nearest] : from[theirs];
        if (upright) put(beyond, i, value);
        else put(i, beyond, value);
      }
    }
    for (size_t k = 0; k < 4; ++k) put(k % 2 ? side : -1, k / 2 ? side : -1, beyondCorner(patch, k, level, channel));
  }
}

}  // namespace relievo
