// box_tree.h - boxes of the successive parts of a list, and of ever more of them: which parts may lie where.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
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

// Eight boxes side by side, which are tested with vector instructions. Lanes that no box was set to are
// empty boxes.
struct BoxGroup {
  static constexpr size_t kBoxes = 8;
  using Lanes = std::array<float, kBoxes>;
  std::array<Lanes, 3> low, high;
  BoxGroup() {
    for (size_t axis = 0; axis < 3; ++axis) {
      low[axis].fill(std::numeric_limits<float>::infinity());
      high[axis].fill(-std::numeric_limits<float>::infinity());
    }
  }
  void set(size_t lane, const Box& box) {
    for (int axis = 0; axis < 3; ++axis) {
      low[static_cast<size_t>(axis)][lane] = box.low[axis];
      high[static_cast<size_t>(axis)][lane] = box.high[axis];
    }
  }
  Box box(size_t lane) const {
    return {{low[0][lane], low[1][lane], low[2][lane]}, {high[0][lane], high[1][lane], high[2][lane]}};
  }
  // Of p from each box, in single precision: compare with SearchReach::squared(). p is clamped to the box, which takes
  // two instructions for a vector of boxes; the distance beyond a side takes comparisons with 0. Vectors by name:
  // compilers turn loops over so few lanes into branches and single floats.
  Lanes squaredDistances(const glm::vec3& p) const noexcept {
    typedef float Vector __attribute__((vector_size(sizeof(Lanes))));
    const std::array<float, 3> place{p.x, p.y, p.z};
    Vector sum{};
    for (size_t axis = 0; axis < 3; ++axis) {
      Vector below, above;
      std::memcpy(&below, low[axis].data(), sizeof below);
      std::memcpy(&above, high[axis].data(), sizeof above);
      const Vector at = place[axis] - Vector{};
      const Vector from = at < below ? below : at, inside = from > above ? above : from, away = inside - at;
      sum += away * away;
    }
    Lanes out;
    std::memcpy(out.data(), &sum, sizeof sum);
    return out;
  }
};

// A place from which boxes are searched in single precision, and how far. No box within the distance is missed.
class SearchReach {
 public:
  explicit SearchReach(const glm::dvec3& place)
      : place_(place), slack_(kRounding * (std::abs(place.x) + std::abs(place.y) + std::abs(place.z))) {}
  const glm::vec3& place() const { return place_; }
  void set(double distance) {
    const double reach = distance * (1 + kRounding) + slack_;
    squared_ = static_cast<float>(reach * reach * (1 + kRounding));
  }
  // Nothing is near enough from here on.
  void end() { squared_ = -1; }
  // A box whose BoxGroup::squaredDistances() is larger than this lies beyond the distance.
  float squared() const { return squared_; }

 private:
  // Larger than the errors of rounding the place (6e-8 of each coordinate), the differences and their squares.
  static constexpr double kRounding = 1e-6;
  glm::vec3 place_;
  double slack_;
  float squared_ = std::numeric_limits<float>::infinity();
};

// Boxes of a list's successive parts, and of ever more of them.
class BoxTree {
 public:
  BoxTree() = default;
  explicit BoxTree(const std::vector<Box>& parts) : parts_(parts.size()) {
    levels_.push_back(groupsOf(parts));
    while (levels_.back().size() > 1) {
      std::vector<Box> coarse(levels_.back().size());
      for (size_t i = 0; i < coarse.size(); ++i)
        for (size_t lane = 0; lane < kFan; ++lane) coarse[i].add(levels_.back()[i].box(lane));
      levels_.push_back(groupsOf(coarse));
    }
  }
  size_t parts() const { return parts_; }
  Box part(size_t i) const { return levels_[0][i / kFan].box(i % kFan); }
  // visit(part) for those whose boxes, and all above them, `wanted` takes, in their order.
  template <class Wanted, class Visit>
  void forEach(Wanted wanted, Visit visit) const {
    if (parts_ > 0) descend(levels_.size() - 1, 0, wanted, visit);
  }
  // visit(part) for all parts whose boxes lie within the reach, which may shrink meanwhile, and for some that lie a
  // little further away; about the nearest first.
  template <class Visit>
  void nearToFar(const SearchReach& reach, Visit visit) const {
    // A stack instead of recursion, so that functions compiled for several machines (simd_dispatch.h) have it inlined.
    struct Pending {
      float squared;
      uint32_t level;
      size_t group;
    };
    std::array<Pending, kMostPending> pending;
    size_t count = 0;
    if (parts_ > 0) pending[count++] = {0, static_cast<uint32_t>(levels_.size() - 1), 0};
    while (count > 0) {
      const Pending at = pending[--count];
      if (!(at.squared <= reach.squared())) continue;
      const BoxGroup::Lanes squared = levels_[at.level][at.group].squaredDistances(reach.place());
      std::array<size_t, kFan> near;  // lanes
      size_t lanes = 0;
      for (size_t lane = 0, boxes = boxesIn(at.level, at.group); lane < boxes; ++lane) {
        if (!(squared[lane] <= reach.squared())) continue;
        size_t place = lanes++;
        for (; place > 0 && squared[near[place - 1]] > squared[lane]; --place) near[place] = near[place - 1];
        near[place] = lane;
      }
      if (at.level > 0) {
        for (size_t k = lanes; k-- > 0;) pending[count++] = {squared[near[k]], at.level - 1, at.group * kFan + near[k]};
      } else {
        for (size_t k = 0; k < lanes && squared[near[k]] <= reach.squared(); ++k) visit(at.group * kFan + near[k]);
      }
    }
  }
  size_t nearest(const glm::dvec3& place) const {
    size_t best = 0;
    double least = std::numeric_limits<double>::infinity();
    forEach([&](const Box& box) { return box.squaredDistance(place) < least; },
            [&](size_t i) {
              least = part(i).squaredDistance(place);
              best = i;
            });
    return best;
  }

 private:
  static constexpr size_t kFan = BoxGroup::kBoxes;
  static constexpr size_t kMostPending = 22 * kFan;  // 8^22 parts are beyond 64 bits
  static std::vector<BoxGroup> groupsOf(const std::vector<Box>& boxes) {
    std::vector<BoxGroup> groups((boxes.size() + kFan - 1) / kFan);
    for (size_t i = 0; i < boxes.size(); ++i) groups[i / kFan].set(i % kFan, boxes[i]);
    return groups;
  }
  // Boxes of a group, as many as there are.
  size_t boxesIn(size_t level, size_t group) const {
    const size_t boxes = level == 0 ? parts_ : levels_[level - 1].size();
    return std::min(kFan, boxes - group * kFan);
  }
  template <class Wanted, class Visit>
  void descend(size_t level, size_t group, Wanted& wanted, Visit& visit) const {
    const BoxGroup& boxes = levels_[level][group];
    for (size_t lane = 0, count = boxesIn(level, group); lane < count; ++lane) {
      if (!wanted(boxes.box(lane))) continue;
      if (level == 0) visit(group * kFan + lane);
      else descend(level - 1, group * kFan + lane, wanted, visit);
    }
  }
  size_t parts_ = 0;
  std::vector<std::vector<BoxGroup>> levels_;  // the parts' boxes first
};

}  // namespace relievo
