#include "tools/export/shared_vertices.h"

#include <algorithm>
#include <cassert>

namespace relievo {
namespace {

constexpr uint32_t kNone = ~uint32_t{0};

}  // namespace

uint64_t SharedVertices::countAtMost(const BaseMesh& base, uint64_t cells) {
  uint64_t ends = 0;  // of patches, at sides; those that are shared count half
  for (const PatchNeighbours& n : patchNeighbours(base))
    for (const PatchNeighbour& side : n) ends += side.patch == PatchNeighbour::kNone ? 2 : 1;
  return base.corners.size() + ends / 2 * (cells - 1);
}

SharedVertices::SharedVertices(const BaseMesh& base, uint64_t cells)
    : base_(base), cells_(cells), corner_index_(base.corners.size(), kNone), side_index_(base.patches.size()) {
  const std::vector<PatchNeighbours> neighbours = patchNeighbours(base);
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    for (int k = 0; k < 4; ++k) {
      uint32_t& index = corner_index_[base.patches[p][static_cast<size_t>(k)]];
      if (index != kNone) continue;
      index = static_cast<uint32_t>(corner_of_.size());
      corner_of_.push_back({p, static_cast<Side>(k)});
    }
    for (const Side s : {kLeft, kRight, kTop, kBottom}) {
      const PatchNeighbour& n = neighbours[p][s];
      uint32_t& index = side_index_[p][s];
      if (n.patch != PatchNeighbour::kNone && n.patch < p) {
        index = side_index_[n.patch][n.side];
        continue;
      }
      index = static_cast<uint32_t>(side_of_.size());
      side_of_.push_back({p, s});
    }
  }
  vertices_.resize(corner_of_.size() + side_of_.size() * (cells - 1));
}

uint64_t SharedVertices::index(uint32_t patch, uint64_t x, uint64_t y) const {
  const auto& c = base_.patches[patch];
  const bool across = x == 0 || x == cells_, down = y == 0 || y == cells_;
  assert(across || down);
  if (across && down) return corner_index_[c[(x ? 1 : 0) + (y ? 2 : 0)]];
  const Side side = across ? (x == 0 ? kLeft : kRight) : (y == 0 ? kTop : kBottom);
  const auto [first, last] = kSideCorners[side];
  uint64_t along = across ? y : x;
  if (c[static_cast<size_t>(first)] > c[static_cast<size_t>(last)]) along = cells_ - along;
  return corner_of_.size() + side_index_[patch][side] * (cells_ - 1) + along - 1;
}

bool SharedVertices::add(uint64_t i, const glm::vec3& normal, uint16_t height, const glm::u8vec3& colour) {
  Vertex& v = vertices_[i];
  if (v.seen && v.height != height) return false;
  if (!v.seen) v.height = height, v.colour = colour, v.seen = true;
  v.normal += normal;
  return true;
}

SharedVertices::Place SharedVertices::place(uint64_t i) const {
  if (i < corner_of_.size()) {
    const auto& [patch, slot] = corner_of_[i];
    return {patch, slot % 2 ? cells_ : 0, slot / 2 ? cells_ : 0};
  }
  i -= corner_of_.size();
  const auto& [patch, side] = side_of_[i / (cells_ - 1)];
  uint64_t along = i % (cells_ - 1) + 1;
  const auto [first, last] = kSideCorners[side];
  const auto& c = base_.patches[patch];
  if (c[static_cast<size_t>(first)] > c[static_cast<size_t>(last)]) along = cells_ - along;
  switch (side) {
    case kLeft:
      return {patch, 0, along};
    case kRight:
      return {patch, cells_, along};
    case kTop:
      return {patch, along, 0};
    default:
      return {patch, along, cells_};
  }
}

}  // namespace relievo
