#include "src/artwork/base_mesh.h"

#include <algorithm>
#include <cmath>
#include <compare>
#include <numeric>

namespace relievo {

std::vector<PatchNeighbours> patchNeighbours(const BaseMesh& mesh) {
  auto ends = [&](uint32_t use) {  // of side use % 4 of patch use / 4
    const auto& c = mesh.patches[use / 4];
    return std::array{c[kSideCorners[use % 4][0]], c[kSideCorners[use % 4][1]]};
  };
  // Sides by their corner of the smaller index, then by the other one.
  struct Use {
    uint32_t other_end, side;
    auto operator<=>(const Use&) const = default;
  };
  const auto uses = static_cast<uint32_t>(4 * mesh.patches.size());
  std::vector<uint32_t> first(mesh.corners.size() + 1, 0);
  for (uint32_t use = 0; use < uses; ++use) ++first[std::ranges::min(ends(use)) + 1];
  std::partial_sum(first.begin(), first.end(), first.begin());
  std::vector<uint32_t> next(first.begin(), first.end() - 1);
  std::vector<Use> of_corner(uses);
  for (uint32_t use = 0; use < uses; ++use) {
    const auto e = ends(use);
    of_corner[next[std::ranges::min(e)]++] = {std::ranges::max(e), use};
  }
  std::vector<PatchNeighbours> all(mesh.patches.size());
  for (size_t c = 0; c < mesh.corners.size(); ++c) {
    const auto begin = of_corner.begin() + first[c], end = of_corner.begin() + first[c + 1];
    std::sort(begin, end);
    for (auto use = begin; use != end;) {
      const auto behind = std::find_if(use, end, [&](const Use& u) { return u.other_end != use->other_end; });
      if (behind - use == 2 && use[0].side / 4 != use[1].side / 4)
        for (size_t k = 0; k < 2; ++k) {
          const uint32_t here = use[static_cast<ptrdiff_t>(k)].side, there = use[static_cast<ptrdiff_t>(1 - k)].side;
          const bool reversed = ends(here)[0] != ends(there)[0];
          all[here / 4][here % 4] = {there / 4, static_cast<Side>(there % 4), reversed};
        }
      use = behind;
    }
  }
  return all;
}

float onStep(float v, double step, double new_step) {
  return static_cast<float>(std::nearbyint(double{v} / step) * new_step + 0.0);  // no -0
}

BaseMesh onLattice(const BaseMesh& mesh, double step_mm) {
  BaseMesh out;
  out.origin_mm = mesh.origin_mm;
  out.patches = mesh.patches;
  out.cut = mesh.cut;
  constexpr uint32_t kUnnamed = ~uint32_t{0};
  std::vector<uint32_t> number(mesh.corners.size(), kUnnamed);
  auto add = [&](uint32_t corner) {
    number[corner] = static_cast<uint32_t>(out.corners.size());
    out.corners.push_back(mesh.corners[corner]);
  };
  for (auto& patch : out.patches)
    for (uint32_t& corner : patch) {
      if (number[corner] == kUnnamed) add(corner);
      corner = number[corner];
    }
  for (uint32_t c = 0; c < number.size(); ++c)
    if (number[c] == kUnnamed) add(c);
  for (BaseCorner& c : out.corners) {
    // The largest component of the normal is what the others leave of its length.
    int largest = 0;
    for (int axis = 0; axis < 3; ++axis) {
      c.position_mm[axis] = onStep(c.position_mm[axis], step_mm, step_mm);
      if (std::abs(c.normal[axis]) > std::abs(c.normal[largest])) largest = axis;
    }
    double left = 1;
    for (int i = 1; i <= 3; ++i) {
      float& n = c.normal[(largest + i) % 3];
      if (i == 3) n = static_cast<float>(std::copysign(std::sqrt(std::max(0.0, left)), n));
      n = onStep(n, 1 / kNormalSteps, 1 / kNormalSteps);
      left -= double{n} * n;
    }
  }
  return out;
}

BaseMesh inSequence(const BaseMesh& mesh) {
  const std::vector<PatchNeighbours> neighbours = patchNeighbours(mesh);
  auto sideAt = [](size_t i) { return std::array<Side, 4>{kTop, kRight, kBottom, kLeft}[i % 4]; };  // of the loop
  struct Open {
    uint32_t patch;
    size_t side;
  };
  BaseMesh out = mesh;
  out.patches.clear();
  std::vector<uint8_t> taken(mesh.patches.size(), 0);
  std::vector<Open> open;
  auto take = [&](uint32_t patch, size_t reached_by) {
    taken[patch] = 1;
    out.patches.push_back(mesh.patches[patch]);
    for (size_t k = 4; k > 0; --k) open.push_back({patch, (reached_by + k) % 4});
  };
  for (uint32_t first = 0; first < mesh.patches.size(); ++first) {
    if (!taken[first]) take(first, 0);
    while (!open.empty()) {
      const Open at = open.back();
      open.pop_back();
      const PatchNeighbour& n = neighbours[at.patch][sideAt(at.side)];
      if (n.patch == PatchNeighbour::kNone || taken[n.patch]) continue;
      size_t by = 0;
      while (sideAt(by) != n.side) ++by;
      take(n.patch, by);
    }
  }
  return out;
}

std::string baseMeshProblem(const BaseMesh& mesh) {
  if (mesh.patches.empty()) return "there is no patch";
  if (mesh.patches.size() > kMaxPatches) return "there are more than 2^20 patches";
  auto finite = [](const auto& v) { return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z); };
  if (!finite(mesh.origin_mm)) return "the origin is not finite";
  for (size_t i = 0; i < mesh.corners.size(); ++i) {
    const BaseCorner& c = mesh.corners[i];
    if (!finite(c.position_mm)) return "corner " + std::to_string(i) + " has no finite position";
    if (!finite(c.normal) || std::abs(glm::length(c.normal) - 1.0f) > 1e-3f)
      return "the normal of corner " + std::to_string(i) + " is not of length 1";
  }
  for (size_t p = 0; p < mesh.patches.size(); ++p) {
    auto c = mesh.patches[p];
    for (uint32_t corner : c) {
      if (corner >= mesh.corners.size())
        return "patch " + std::to_string(p) + " names corner " + std::to_string(corner) + ", which does not exist";
    }
    std::sort(c.begin(), c.end());
    if (std::adjacent_find(c.begin(), c.end()) != c.end())
      return "patch " + std::to_string(p) + " names a corner twice";
  }
  return {};
}

bool isStretched(const BaseMesh& mesh) {
  constexpr double kStretch = 3, kShare = 0.1;
  constexpr size_t kMostPatches = 2048;
  const size_t apart = mesh.patches.size() / kMostPatches + 1;
  double area = 0, stretched = 0;
  for (size_t i = 0; i < mesh.patches.size(); i += apart) {
    std::array<glm::dvec3, 4> p;
    for (size_t k = 0; k < 4; ++k) p[k] = mesh.corners[mesh.patches[i][k]].position_mm;
    const glm::dvec3 u = p[1] - p[0] + p[3] - p[2], v = p[2] - p[0] + p[3] - p[1];
    const double uu = glm::dot(u, u), vv = glm::dot(v, v), uv = glm::dot(u, v);
    // Squares of a square's half axes, as space sees it.
    const double mean = 0.5 * (uu + vv), apart_by = std::sqrt(0.25 * (uu - vv) * (uu - vv) + uv * uv);
    const double own = std::sqrt(std::max(0.0, uu * vv - uv * uv));
    area += own;
    if (mean + apart_by > kStretch * kStretch * (mean - apart_by)) stretched += own;
  }
  return area > 0 && stretched >= kShare * area;
}

}  // namespace relievo
