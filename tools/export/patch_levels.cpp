#include "tools/export/patch_levels.h"

#include <algorithm>
#include <cassert>

#include "geometry/lod/snap.h"

namespace relievo {

std::vector<PatchLevels> uniformLevels(size_t patches, int level) {
  PatchLevels one{.grid = static_cast<uint8_t>(level)};
  one.sides.fill(one.grid);
  return std::vector<PatchLevels>(patches, one);
}

bool PatchLevels::isSnapped() const {
  return std::any_of(sides.begin(), sides.end(), [&](uint8_t s) { return s < grid; });
}

std::array<uint64_t, 2> PatchLevels::snapped(uint64_t x, uint64_t y) const {
  const uint64_t last = cells();
  auto along = [&](uint64_t i, Side side) { return snapToEdge(static_cast<uint32_t>(i), grid, sides[side]); };
  std::array<uint64_t, 2> out{x, y};
  if (x == 0) out[1] = along(y, kLeft);
  if (x == last) out[1] = along(y, kRight);
  if (y == 0) out[0] = along(x, kTop);
  if (y == last) out[0] = along(x, kBottom);
  return out;
}

bool PatchLevels::hasTriangle(uint64_t x, uint64_t y, bool above) const {
  if (!isSnapped() || (x > 0 && y > 0 && x + 1 < cells() && y + 1 < cells())) return true;
  const auto a = snapped(x, y), b = above ? snapped(x + 1, y) : snapped(x, y + 1), c = snapped(x + 1, y + 1);
  return a != b && b != c && c != a;
}

uint64_t PatchLevels::triangles() const {
  const uint64_t n = cells();
  uint64_t none = 0;
  auto look = [&](uint64_t x, uint64_t y) {
    for (const bool above : {false, true}) none += !hasTriangle(x, y, above);
  };
  if (isSnapped()) {
    for (uint64_t y = 0; y < n; ++y)
      for (uint64_t x = 0; x < n; x += y == 0 || y + 1 == n || n == 1 ? 1 : n - 1) look(x, y);
  }
  return 2 * n * n - none;
}

std::vector<PatchLevels> patchLevelsWithin(const std::vector<PatchNeighbours>& neighbours,
                                           const std::vector<std::vector<float>>& errors, double error_mm) {
  assert(neighbours.size() == errors.size());
  std::vector<uint8_t> own(errors.size());
  std::vector<PatchLevels> out(errors.size());
  for (size_t p = 0; p < errors.size(); ++p) {
    const auto enough = std::find_if(errors[p].begin(), errors[p].end() - 1, [&](float e) { return e <= error_mm; });
    own[p] = static_cast<uint8_t>(enough - errors[p].begin());
  }
  auto raise = [&](size_t p, size_t side, uint8_t level) {
    const PatchNeighbour& n = neighbours[p][side];
    out[p].sides[side] = level;
    if (n.patch != PatchNeighbour::kNone) out[n.patch].sides[static_cast<size_t>(n.side)] = level;
  };
  for (size_t p = 0; p < errors.size(); ++p)
    for (size_t s = 0; s < 4; ++s) raise(p, s, std::max(out[p].sides[s], own[p]));
  for (bool changed = true; changed;) {
    changed = false;
    for (size_t p = 0; p < errors.size(); ++p) {
      PatchLevels& levels = out[p];
      levels.grid = std::max(own[p], *std::max_element(levels.sides.begin(), levels.sides.end()));
      for (size_t s = 0; s < 4; ++s) {
        uint8_t level = levels.sides[s];
        while (level < levels.grid && 2 * double{errors[p][level]} > error_mm) ++level;
        if (level == levels.sides[s]) continue;
        raise(p, s, level);
        changed = true;
      }
    }
  }
  return out;
}

double errorOf(const std::vector<PatchLevels>& levels, const std::vector<std::vector<float>>& errors) {
  double most = 0;
  for (size_t p = 0; p < levels.size(); ++p) {
    most = std::max(most, double{errors[p][levels[p].grid]});
    for (const uint8_t side : levels[p].sides)
      if (side < levels[p].grid) most = std::max(most, 2 * double{errors[p][side]});
  }
  return most;
}

Result<std::vector<std::vector<float>>> patchErrors(const Package& package, const std::atomic<bool>* stop) {
  const Manifest& m = package.manifest();
  const int depth = m.domain.relief_depth;
  std::vector<std::vector<float>> out(m.domain.patchCount());
  for (uint32_t patch = 0; patch < out.size(); ++patch) {
    const CoarseErrors& coarse = m.coarse_errors[patch];
    out[patch].assign(coarse.begin(), coarse.end());
    for (int level = 0; level < depth; ++level) {
      double most = 0;
      for (uint32_t y = 0; y < 1u << level; ++y)
        for (uint32_t x = 0; x < 1u << level; ++x) {
          if (stop && stop->load(std::memory_order_relaxed))
            return Error{ErrorKind::kInterrupted, package.path(), "interrupted", "", {}};
          auto record = package.record({Plane::kRelief, NodeId{patch, static_cast<uint32_t>(level), x, y}});
          if (!record) return record.error();
          most = std::max(most, double{record->relief.error_mm});
        }
      out[patch].push_back(static_cast<float>(most));
    }
    out[patch].push_back(0);
  }
  return out;
}

}  // namespace relievo
