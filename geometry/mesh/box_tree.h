// box_tree.h - boxes of the successive parts of a list, and of ever more of them: which parts may lie where.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

#include <glm/glm.hpp>

namespace relievo {

struct Box {
  glm::vec3 low{std::numeric_limits<float>::infinity()}, high{-std::numeric_limits<float>::infinity()};
  void add(const glm::vec3& p) {
    low = glm::min(low, p);
    high = glm::max(high, p);
  }
  void add(const Box& o) {
    low = glm::min(low, o.low);
    high = glm::max(high, o.high);
  }
  bool meets(const Box& o) const {
    return low.x <= o.high.x && o.low.x <= high.x && low.y <= o.high.y && o.low.y <= high.y && low.z <= o.high.z &&
           o.low.z <= high.z;
  }
  double squaredDistance(const glm::dvec3& p) const {
    const glm::dvec3 out = glm::max(glm::max(glm::dvec3(low) - p, p - glm::dvec3(high)), glm::dvec3(0));
    return glm::dot(out, out);
  }
};

// Boxes of a list's successive parts, and of ever more of them.
class BoxTree {
 public:
  BoxTree() = default;
  explicit BoxTree(std::vector<Box> parts) {
    levels_.push_back(std::move(parts));
    while (levels_.back().size() > kFan) {
      const std::vector<Box>& fine = levels_.back();
      std::vector<Box> coarse((fine.size() + kFan - 1) / kFan);
      for (size_t i = 0; i < fine.size(); ++i) {
        coarse[i / kFan].add(fine[i]);
      }
      levels_.push_back(std::move(coarse));
    }
  }
  const Box& part(size_t i) const { return levels_[0][i]; }
  // visit(part) for those whose boxes, and all above them, `wanted` takes, in their order.
  template <class Wanted, class Visit>
  void forEach(Wanted wanted, Visit visit) const {
    descend(levels_.size() - 1, 0, levels_.back().size(), wanted, visit);
  }
  // visit(part) for parts whose boxes lie within the square root of limit() of the place, which may shrink meanwhile;
  // about the nearest first.
  template <class Limit, class Visit>
  void nearToFar(const glm::dvec3& place, Limit limit, Visit visit) const {
    descendNearToFar(levels_.size() - 1, 0, levels_.back().size(), place, limit, visit);
  }
  size_t nearest(const glm::dvec3& place) const {
    size_t best = 0;
    double least = std::numeric_limits<double>::infinity();
    forEach([&](const Box& box) { return box.squaredDistance(place) < least; },
            [&](size_t i) {
              least = levels_[0][i].squaredDistance(place);
              best = i;
            });
    return best;
  }

 private:
  static constexpr size_t kFan = 8;
  template <class Wanted, class Visit>
  void descend(size_t level, size_t first, size_t last, Wanted& wanted, Visit& visit) const {
    for (size_t i = first; i < last; ++i) {
      if (!wanted(levels_[level][i])) continue;
      if (level == 0) visit(i);
      else descend(level - 1, i * kFan, std::min((i + 1) * kFan, levels_[level - 1].size()), wanted, visit);
    }
  }
  template <class Limit, class Visit>
  void descendNearToFar(size_t level, size_t first, size_t last, const glm::dvec3& place, Limit& limit,
                        Visit& visit) const {
    std::array<std::pair<double, size_t>, kFan> near;
    size_t count = 0;
    for (size_t i = first; i < last; ++i) {
      const double squared = levels_[level][i].squaredDistance(place);
      if (!(squared <= limit())) continue;
      size_t at = count++;
      for (; at > 0 && near[at - 1].first > squared; --at) near[at] = near[at - 1];
      near[at] = {squared, i};
    }
    for (size_t k = 0; k < count && near[k].first <= limit(); ++k) {
      const size_t i = near[k].second;
      if (level == 0) visit(i);
      else
        descendNearToFar(level - 1, i * kFan, std::min((i + 1) * kFan, levels_[level - 1].size()), place, limit, visit);
    }
  }
  std::vector<std::vector<Box>> levels_;
};

}  // namespace relievo
