// simplified_rounds.h - how often a build bakes bases of a scan's simplified triangles (BaseDomain::simplifiedFaces),
// in which of two ways, and when it turns to the scan's own triangles instead. Pure.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

namespace relievo {

// What more rounds would bring is judged by what the last two brought: rounds that lead nowhere near the target are
// spared where the scan's own triangles can be patches, since these keep it, or where there may be more patches.
class SimplifiedRounds {
 public:
  static constexpr int kRounds = 5, kInVain = 2;  // bakes; of them in a row, none better than those before
  // Times the target: beyond the first the own triangles are worth their bytes at once, beyond the second no round is.
  static constexpr double kFarOff = 4, kHopeless = 32;
  // Times the target: twice as many rounds are worth their while, and as many in vain if there is nothing else.
  static constexpr double kNearly = 2;

  // Ratios of what was measured to the target (Fidelity::excess()).
  struct Bake {
    double own = 0, least = 0;  // of the last bake; of all bakes, of whatever base
    bool better = false;        // the last one has the least
    bool kept = false;          // the one of the least keeps the target
  };
  // kSameBase: the same base once more, in the other way.
  enum class Next : uint8_t { kAgain, kSameBase, kOwnTriangles, kEnd };
  // Whether the scan's own triangles may be patches. Few of them take hardly more bytes than simplified ones. kTooMany:
  // more patches than these rounds have may come next; kFarTooMany: and bakes take so long that they come next as soon
  // as the first base is far off; kNone: nothing comes next.
  enum class OwnTriangles : uint8_t { kNone, kFarTooMany, kTooMany, kMany, kFew };
  // The first base is baked in both ways, unless the first one is hopeless; all others in the better one. Which one
  // that is depends on the scan, and much: the other one may miss by ten times as much.
  Next after(Bake bake, OwnTriangles own) {
    const bool own_triangles = own == OwnTriangles::kMany || own == OwnTriangles::kFew;
    first_was_better_ = false;
    if (ways_ == 0 && bake.own <= kHopeless) {
      ways_ = 1;
      first_ = bake;
      other_way_ = true;
      return Next::kSameBase;
    }
    if (ways_ == 1) {
      other_way_ = bake.own < first_.own;
      first_was_better_ = !other_way_;
      bake.own = std::min(bake.own, first_.own);
      bake.better |= first_.better;
    }
    ways_ = 2;
    ++round_;
    in_vain_ = bake.better ? 0 : in_vain_ + 1;
    const int times = !bake.kept && bake.least < kNearly ? 2 : 1, rounds = times * kRounds;
    // What the last two rounds gained, as often again as rounds are left.
    const double gained = bake.least / least_before_[1], left = std::max(rounds - round_ + 1, 0) / 2.0;
    const double at_the_end = bake.least * std::pow(gained, left);
    bool in_sight = true;
    if (own == OwnTriangles::kFew) in_sight = round_ < 3 && bake.least <= kFarOff;
    if (own == OwnTriangles::kMany) in_sight = round_ < 3 || at_the_end <= kFarOff;
    const bool far = own == OwnTriangles::kFarTooMany;
    if (far || own == OwnTriangles::kTooMany) in_sight = round_ < 3 || at_the_end <= kNearly;
    if (far && bake.least > kFarOff) in_sight = false;
    least_before_ = {bake.least, least_before_[0]};
    over_ = round_ > rounds || in_vain_ >= (own_triangles ? 1 : times) * kInVain || bake.own > kHopeless;
    if (over_) return !bake.kept && own_triangles ? Next::kOwnTriangles : Next::kEnd;
    if (in_sight) return Next::kAgain;
    return own_triangles ? Next::kOwnTriangles : Next::kEnd;
  }
  // No further round is worth its while, whether or not there is anything else.
  bool over() const { return over_; }
  // The way of the next bake: the other one, or the first.
  bool otherWay() const { return other_way_; }
  // The last bake was the other way of the first base, and the first way missed less.
  bool firstWasBetter() const { return first_was_better_; }

 private:
  int round_ = 0, in_vain_ = 0;
  int ways_ = 0;  // of the first base that were tried
  bool over_ = false, other_way_ = false, first_was_better_ = false;
  Bake first_;
  // The least excess before the last round, and before the one before it.
  std::array<double, 2> least_before_{std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()};
};

}  // namespace relievo
