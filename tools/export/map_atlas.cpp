#include "tools/export/map_atlas.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <string>

#include "src/base/srgb.h"
#include "texturing/codec/resolve.h"
#include "texturing/package/patch_tails.h"

namespace relievo {
namespace {

// A patch's own texels a side.
int ownSide(const PatchDomain& domain, uint32_t patch) {
  const int depth = domain.textureDepthOf(patch);
  return depth == kNoTexturePage ? kTailTexels : kPagePx << depth;
}

double areaOf(const BaseMesh& base, uint32_t patch) {
  const auto& c = base.patches[patch];
  const auto at = [&](size_t k) { return glm::dvec3(base.corners[c[k]].position_mm); };
  return 0.5 * glm::length(glm::cross(at(3) - at(0), at(2) - at(1)));
}

// Means of sRGB bytes in linear light, without powers.
struct LightTables {
  std::array<float, 256> of_byte, below;  // below: what is less than that rounds to less than the byte
  LightTables() {
    for (size_t i = 0; i < 256; ++i) {
      of_byte[i] = static_cast<float>(linearFromSrgb(static_cast<double>(i) / 255));
      below[i] = static_cast<float>(linearFromSrgb((static_cast<double>(i) - 0.5) / 255));
    }
  }
  uint8_t byteOf(float light) const {
    return static_cast<uint8_t>(std::upper_bound(below.begin() + 1, below.end(), light) - below.begin() - 1);
  }
};

}  // namespace

MapAtlas::MapAtlas(std::shared_ptr<const Package> package)
    : package_(package), pages_(std::make_shared<const TexturePages>(std::move(package))) {}

Result<MapAtlas> MapAtlas::create(std::shared_ptr<const Package> package, int most_px) {
  MapAtlas out(package);
  const Manifest& m = package->manifest();
  const BaseMesh& base = *m.base;
  const auto patches = static_cast<uint32_t>(base.patches.size());
  std::vector<int> sides(patches);
  for (uint32_t p = 0; p < patches; ++p) sides[p] = ownSide(m.domain, p);
  // Else so many texels a mm, a power of two of a side each, but at least some.
  constexpr int kLeastSide = 2;
  constexpr double kCoarser = 0.84;  // 2^(-1/4)
  double area = 0;
  for (uint32_t p = 0; p < patches; ++p) area += areaOf(base, p);
  double density = 4.0 * most_px / std::sqrt(std::max(area, 1e-300));
  while (!out.pack(sides, most_px)) {
    bool least = true;
    for (uint32_t p = 0; p < patches; ++p) {
      const double wanted = density * std::sqrt(areaOf(base, p));
      int side = kLeastSide;
      while (2 * side <= ownSide(m.domain, p) && 1.41 * side < wanted) side *= 2;
      sides[p] = side;
      least &= side == kLeastSide;
    }
    density *= kCoarser;
    if (least && !out.pack(sides, most_px))
      return Error{ErrorKind::kUsage,
                   package->path(),
                   "its " + std::to_string(patches) + " patches are too many for maps of " + std::to_string(most_px) +
                       " px a side",
                   "allow larger --maps, or leave them out",
                   {}};
  }
  return out;
}

// Rows of tiles of falling heights.
bool MapAtlas::pack(const std::vector<int>& sides, int most_px) {
  std::vector<uint32_t> order(sides.size());
  std::iota(order.begin(), order.end(), 0u);
  std::stable_sort(order.begin(), order.end(), [&](uint32_t a, uint32_t b) { return sides[a] > sides[b]; });
  double area = 0;
  for (const int side : sides) area += std::pow(side + 2 * kBorder, 2);
  const int largest = sides[order[0]] + 2 * kBorder;
  if (largest > most_px || area > static_cast<double>(most_px) * most_px) return false;
  tiles_.resize(sides.size());
  const int width = std::min(most_px, std::max(largest, static_cast<int>(std::ceil(std::sqrt(area) / 64) * 64)));
  int x = 0, y = 0, row = largest;
  width_ = 0;
  for (const uint32_t p : order) {
    const int side = sides[p] + 2 * kBorder;
    if (x + side > width) {
      y += row;
      x = 0;
      row = side;
    }
    tiles_[p] = {x + kBorder, y + kBorder, sides[p]};
    x += side;
    width_ = std::max(width_, x);
  }
  height_ = y + row;
  return height_ <= most_px;
}

bool MapAtlas::hasNormals() const {
  return describe(package_->manifest().texture.basis).shading == Shading::kAlbedoNormal;
}

Result<void> MapAtlas::readPage(const NodeId& node, PageDecoder& decoder, std::span<uint8_t> colours,
                                std::span<uint8_t> normals) const {
  const TextureFormat& format = package_->manifest().texture;
  const Shading shading = describe(format.basis).shading;
  if (shading == Shading::kColour || shading == Shading::kAlbedoNormal) {
    if (auto read = pages_->read(PageId(texturePlane(0), node), decoder, colours); !read) return read;
    return hasNormals() ? pages_->read(PageId(texturePlane(1), node), decoder, normals) : Result<void>();
  }
  const auto planes = static_cast<size_t>(format.planes());
  std::vector<std::vector<uint8_t>> slots(planes, std::vector<uint8_t>(kSlotBytes));
  std::vector<const uint8_t*> pointers;
  for (size_t k = 0; k < planes; ++k) {
    if (auto read = pages_->read(PageId(texturePlane(static_cast<int>(k)), node), decoder, slots[k]); !read)
      return read;
    pointers.push_back(slots[k].data());
  }
  resolvePage(format, {0, 0, 1}, pointers, colours.data());
  return {};
}

Result<void> MapAtlas::read(uint32_t patch, PageDecoder& decoder, Texels& out) const {
  static const LightTables tables;
  const int side = tiles_[patch].side, full = side + 2 * kBorder;
  out.side = full;
  out.colours.resize(static_cast<size_t>(full) * static_cast<size_t>(full));
  out.normals.resize(hasNormals() ? out.colours.size() : 0);
  uint32_t level = 0;
  while (kPagePx << level < side) ++level;
  // Texels of the level for each of the tile's, along a side.
  const int step = std::max((kPagePx << level) / side, 1), last_page = (1 << level) - 1;
  std::vector<uint8_t> colours(kSlotBytes), normals(kSlotBytes);
  for (int page_y = 0; page_y <= last_page; ++page_y) {
    for (int page_x = 0; page_x <= last_page; ++page_x) {
      const NodeId node{patch, level, static_cast<uint32_t>(page_x), static_cast<uint32_t>(page_y)};
      if (auto read = readPage(node, decoder, colours, normals); !read) return read;
      // The tile's texels whose first texel lies in this page; the outermost pages have the border, too.
      const auto range = [&](int page) {
        return std::array{page * kPagePx / step - (page == 0 ? kBorder : 0),
                          (page + 1) * kPagePx / step + (page == last_page ? kBorder : 0)};
      };
      const auto [x0, x1] = range(page_x);
      const auto [y0, y1] = range(page_y);
      for (int y = y0; y < y1; ++y)
        for (int x = x0; x < x1; ++x) {
          // In the slot; beyond its gutter there is nothing.
          const int left = x * step - page_x * kPagePx + kPageBorderPx,
                    top = y * step - page_y * kPagePx + kPageBorderPx;
          glm::vec3 light(0), normal(0);
          float count = 0;
          for (int j = std::max(top, 0); j < std::min(top + step, int{kPageFullPx}); ++j)
            for (int i = std::max(left, 0); i < std::min(left + step, int{kPageFullPx}); ++i) {
              const size_t at = 4 * static_cast<size_t>(j * kPageFullPx + i);
              for (glm::length_t c = 0; c < 3; ++c) {
                light[c] += tables.of_byte[colours[at + static_cast<size_t>(c)]];
                normal[c] += 2.0f * static_cast<float>(normals[at + static_cast<size_t>(c)]) - 255;
              }
              ++count;
            }
          const auto to = static_cast<size_t>((y + kBorder) * full + x + kBorder);
          if (count == 1) {
            const size_t at = 4 * static_cast<size_t>(top * kPageFullPx + left);
            std::copy_n(colours.begin() + static_cast<ptrdiff_t>(at), 3, out.colours[to].begin());
          } else {
            for (glm::length_t c = 0; c < 3; ++c)
              out.colours[to][static_cast<size_t>(c)] = tables.byteOf(light[c] / count);
          }
          if (out.normals.empty()) continue;
          const float length = glm::length(normal);
          out.normals[to] = length > 0 ? normal / length : glm::vec3(0);
        }
    }
  }
  return {};
}

}  // namespace relievo
