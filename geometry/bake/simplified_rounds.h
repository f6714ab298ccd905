// simplified_rounds.h - how often a build bakes bases of a scan's simplified triangles (BaseDomain::simplifiedFaces),
// and when it turns to the scan's own triangles instead. Pure.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

namespace relievo {

// What more rounds would bring is judged by what the last two brought: rounds that lead nowhere near the target are
// spared where the scan's own triangles can be patches, since these keep it.
class SimplifiedRounds {
 public:
  static constexpr int kRounds = 5, kInVain = 2;  // bakes; of them in a row, none better than those before
  // Times the target: beyond the first the own triangles are worth their bytes at once, beyond the second no round is.
  static constexpr double kFarOff = 4, kHopeless = 32;
  static constexpr double kNearly = 2;  // times the target: twice as many rounds are worth their while

  // Ratios of what was measured to the target (Fidelity::excess()).
  struct Bake {
    double own = 0, least = 0;  // of the last bake; of all bakes, of whatever base
    bool better = false;        // the last one has the least
    bool kept = false;          // the one of the least keeps the target
  };
  enum class Next : uint8_t { kAgain, kOwnTriangles, kEnd };
  // Whether the scan's own triangles may be patches. Few of them take hardly more bytes than simplified ones.
  enum class OwnTriangles : uint8_t { kTooMany, kMany, kFew };
  Next after(const Bake& bake, OwnTriangles own) {
    const bool own_triangles = own != OwnTriangles::kTooMany;
    ++round_;
    in_vain_ = bake.better ? 0 : in_vain_ + 1;
    const int times = !bake.kept && bake.least < kNearly ? 2 : 1, rounds = times * kRounds;
    // What the last two rounds gained, as often again as rounds are left.
    const double gained = bake.least / least_before_[1], left = std::max(rounds - round_ + 1, 0) / 2.0;
    const bool in_sight = own == OwnTriangles::kFew ? bake.least <= kFarOff
                                                    : round_ < 3 || bake.least * std::pow(gained, left) <= kFarOff;
    least_before_ = {bake.least, least_before_[0]};
    over_ = round_ > rounds || in_vain_ >= times * kInVain || bake.own > kHopeless;
    if (over_) return !bake.kept && own_triangles ? Next::kOwnTriangles : Next::kEnd;
    return in_sight || !own_triangles ? Next::kAgain : Next::kOwnTriangles;
  }
  // No further round is worth its while, whether or not there is anything else.
  bool over() const { return over_; }

 private:
  int round_ = 0, in_vain_ = 0;
  bool over_ = false;
  // The least excess before the last round, and before the one before it.
  std::array<double, 2> least_before_{std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()};
};

}  // namespace relievo
