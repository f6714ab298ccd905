#include "texturing/package/texture_pages.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <functional>
#include <vector>

#include "texturing/package/crease_gutter.h"
#include "texturing/package/package_layout.h"

namespace relievo {
namespace {

// Rows of RGBA texels, some of them beyond the patch.
struct CoarseTexels {
  const uint8_t* rgba;
  int stride, border;
};

// Texel (x, y) of `slot` is texel (x0 + x, y0 + y) of a level whose texels are 1/ratio of the coarse ones wide.
void interpolate(const CoarseTexels& coarse, int64_t x0, int64_t y0, double ratio, std::span<uint8_t> slot) {
  struct Place {
    int first;     // of the two coarse texels around it
    double share;  // of the second
  };
  auto placeOf = [&](int64_t texel) {
    const double at = (static_cast<double>(texel) + 0.5) / ratio - 0.5 + coarse.border, first = std::floor(at);
    return Place{static_cast<int>(first), at - first};
  };
  std::array<Place, kPageFullPx> columns;
  for (int x = 0; x < kPageFullPx; ++x) columns[static_cast<size_t>(x)] = placeOf(x0 + x);
  uint8_t* to = slot.data();
  for (int y = 0; y < kPageFullPx; ++y) {
    const auto [row, v] = placeOf(y0 + y);
    for (const auto& [column, u] : columns) {
      const uint8_t* from = coarse.rgba + 4 * (row * coarse.stride + column);
      const uint8_t* below = from + 4 * coarse.stride;
      for (int c = 0; c < 3; ++c) {
        const double top = from[c] * (1 - u) + from[c + 4] * u, bottom = below[c] * (1 - u) + below[c + 4] * u;
        to[c] = static_cast<uint8_t>(top * (1 - v) + bottom * v + 0.5);
      }
      to[3] = 255;
      to += 4;
    }
  }
}

}  // namespace

TexturePages::TexturePages(std::shared_ptr<const Package> package) : package_(std::move(package)) {}

uint64_t TexturePages::bytes(const Manifest& m) {
  if (!m.domain.hasUntexturedPatch()) return 0;
  constexpr uint64_t kMeshBytes = 64;  // of a patch's neighbours and corners
  return m.domain.patchCount() *
         (2 * kTailHeights + static_cast<uint64_t>(m.texture.channels()) * kTailPatchTexels + kMeshBytes);
}

const TexturePages::Tails& TexturePages::tails() const {
  std::call_once(once_, [&] {
    tails_.tails = package_->tails(1, nullptr, nullptr, 0);
    const Manifest& m = package_->manifest();
    tails_.blocks.emplace(tails_.tails, *m.base, GutterEnds{.colours = m.tail_edges, .normals = hasNormals(m.texture)});
  });
  return tails_;
}

Result<void> TexturePages::read(PageId id, PageDecoder& decoder, std::span<uint8_t> slot) const {
  const NodeId node = id.node();
  const PatchDomain& domain = package_->manifest().domain;
  const bool left_out =
      domain.nodeExists(node) && static_cast<int>(node.level) <= domain.texture_depth && !domain.hasTexturePage(node);
  const auto shown = left_out ? domain.texturedNode(node) : node;
  if (!shown) return fromTail(id, slot);
  auto page = package_->read(PageId(id.plane(), *shown));
  if (!page) return page.error();
  if (!left_out) return decoder.decodeToSlot(id.plane(), page->bytes, slot);
  std::vector<uint8_t> coarse(kSlotBytes);
  if (auto decoded = decoder.decodeToSlot(id.plane(), page->bytes, coarse); !decoded) return decoded;
  // In texels of the node's level, from the corner of the page that is shown.
  const uint32_t finer = node.level - shown->level;
  auto first = [&](uint32_t at, uint32_t of) {
    return (int64_t{at} - (int64_t{of} << finer)) * kPagePx - kPageBorderPx;
  };
  interpolate({coarse.data(), kPageFullPx, kPageBorderPx}, first(node.x, shown->x), first(node.y, shown->y),
              std::ldexp(1.0, static_cast<int>(finer)), slot);
  return {};
}

Result<void> TexturePages::fromTail(PageId id, std::span<uint8_t> slot) const {
  const NodeId node = id.node();
  const Tails& all = tails();
  if (all.tails.failures().pages > 0)
    return Error{ErrorKind::kInvalidData,
                 package_->path(),
                 "the tail of page " + describePage(id) + " may be damaged, and it has nothing else",
                 "rebuild the package, or get a whole copy",
                 {}};
  std::vector<uint32_t> words(tailBlockTexels(0));
  all.blocks->write(node.patch, 0, texturePlaneIndex(id.plane()), words.data());
  if (std::adjacent_find(words.begin(), words.end(), std::not_equal_to<>()) == words.end()) {  // of a plain colour
    for (size_t i = 0; i < slot.size(); i += 4) storeLittle(&slot[i], words[0] | uint32_t{255} << 24);
    return {};
  }
  std::vector<uint8_t> rgba(4 * tailBlockTexels(0));
  for (size_t i = 0; i < tailBlockTexels(0); ++i)
    for (size_t c = 0; c < 3; ++c) rgba[4 * i + c] = static_cast<uint8_t>(words[i] >> (8 * c));
  interpolate({rgba.data(), static_cast<int>(tailBlockSide(0)), 1}, int64_t{node.x} * kPagePx - kPageBorderPx,
              int64_t{node.y} * kPagePx - kPageBorderPx,
              std::ldexp(double{kPagePx} / kTailTexels, static_cast<int>(node.level)), slot);
  return {};
}

}  // namespace relievo
