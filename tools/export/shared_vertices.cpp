#include "tools/export/shared_vertices.h"

#include <algorithm>
#include <cassert>
#include <utility>

namespace relievo {
namespace {

constexpr uint32_t kNone = ~uint32_t{0};

}  // namespace

uint64_t SharedVertices::count(const BaseMesh& base, std::span<const PatchLevels> levels) {
  std::vector<bool> used(base.corners.size());
  for (const auto& patch : base.patches)
    for (const uint32_t corner : patch) used[corner] = true;
  auto out = static_cast<uint64_t>(std::count(used.begin(), used.end(), true));
  const std::vector<PatchNeighbours> neighbours = patchNeighbours(base);
  for (uint32_t p = 0; p < base.patches.size(); ++p)
    for (size_t s = 0; s < 4; ++s)
      if (neighbours[p][s].patch == PatchNeighbour::kNone || neighbours[p][s].patch >= p)
        out += (uint64_t{1} << levels[p].sides[s]) - 1;
  return out;
}

SharedVertices::SharedVertices(const BaseMesh& base, std::vector<PatchLevels> levels)
    : base_(base),
      levels_(std::move(levels)),
      corner_index_(base.corners.size(), kNone),
      side_index_(base.patches.size()) {
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
  side_first_.push_back(corner_of_.size());
  for (const auto& [patch, side] : side_of_)
    side_first_.push_back(side_first_.back() + (uint64_t{1} << levels_[patch].sides[side]) - 1);
  vertices_.resize(side_first_.back());
}

uint64_t SharedVertices::index(uint32_t patch, uint64_t x, uint64_t y) const {
  const auto& c = base_.patches[patch];
  const PatchLevels& levels = levels_[patch];
  const uint64_t n = levels.cells();
  const bool across = x == 0 || x == n, down = y == 0 || y == n;
  assert(across || down);
  if (across && down) return corner_index_[c[(x ? 1 : 0) + (y ? 2 : 0)]];
  const Side side = across ? (x == 0 ? kLeft : kRight) : (y == 0 ? kTop : kBottom);
  const auto [first, last] = kSideCorners[side];
  uint64_t along = across ? y : x;
  if (c[static_cast<size_t>(first)] > c[static_cast<size_t>(last)]) along = n - along;
  assert(along % (n >> levels.sides[side]) == 0);
  return side_first_[side_index_[patch][side]] + (along >> (levels.grid - levels.sides[side])) - 1;
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
    const uint64_t n = levels_[patch].cells();
    return {patch, slot % 2 ? n : 0, slot / 2 ? n : 0};
  }
  const auto behind = std::upper_bound(side_first_.begin(), side_first_.end(), i);
  const auto number = static_cast<size_t>(behind - side_first_.begin()) - 1;
  const auto& [patch, side] = side_of_[number];
  const PatchLevels& levels = levels_[patch];
  const uint64_t n = levels.cells();
  uint64_t along = (i - side_first_[number] + 1) << (levels.grid - levels.sides[side]);
  const auto [first, last] = kSideCorners[side];
  const auto& c = base_.patches[patch];
  if (c[static_cast<size_t>(first)] > c[static_cast<size_t>(last)]) along = n - along;
  switch (side) {
    case kLeft:
      return {patch, 0, along};
    case kRight:
      return {patch, n, along};
    case kTop:
      return {patch, along, 0};
    default:
      return {patch, along, n};
  }
}

}  // namespace relievo
