// How many rounds bases of simplified triangles get: as many as lead somewhere.
#include "geometry/bake/simplified_rounds.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

namespace relievo {
namespace simplified_rounds_test {

using Next = SimplifiedRounds::Next;
using Own = SimplifiedRounds::OwnTriangles;

// The rounds that bakes of these ratios to the target get, up to the first that does not say "again". In the other way
// the first base misses by more.
struct Outcome {
  size_t rounds = 0;
  Next last = Next::kAgain;
  bool over = false;
  friend bool operator==(const Outcome&, const Outcome&) = default;
};
Outcome roundsOf(const std::vector<double>& ratios, Own own) {
  SimplifiedRounds rounds;
  double least = 1e300;
  for (size_t i = 0; i < ratios.size(); ++i) {
    const bool better = ratios[i] < least;
    least = std::min(least, ratios[i]);
    Next next = rounds.after({ratios[i], least, better, least <= 1}, own);
    if (next == Next::kSameBase) next = rounds.after({1.1 * ratios[i], least, false, least <= 1}, own);
    if (next != Next::kAgain) return {i + 1, next, rounds.over()};
  }
  return {ratios.size(), Next::kAgain, rounds.over()};
}

TEST(SimplifiedRounds, ThatLeadNowhereEndEarlyWhereTheOwnTrianglesCanBePatches) {
  // 28 after two rounds that gained a third together: three more would end at 10.
  const std::vector<double> slow{30, 28, 20, 18, 15, 13};
  EXPECT_EQ(roundsOf(slow, Own::kMany), (Outcome{3, Next::kOwnTriangles, false}));
  // Control: where there is nothing else, every round is tried, and at the end what there is is kept.
  EXPECT_EQ(roundsOf(slow, Own::kNone), (Outcome{6, Next::kEnd, true}));
  // Control: rounds that halve what is missed lead to the target: 30, 15, 7.5, and three more end at 1.
  EXPECT_EQ(roundsOf({30, 15, 7.5, 3.7}, Own::kMany), (Outcome{4, Next::kAgain, false}));
  // Not before the third round: the first ones are of a base that nothing is known about.
  EXPECT_EQ(roundsOf({30, 29.9}, Own::kMany), (Outcome{2, Next::kAgain, false}));
  // Few own triangles are worth their bytes at once where the target is far off, and after three bases anyhow.
  EXPECT_EQ(roundsOf({30, 15, 7.5, 3.7}, Own::kFew), (Outcome{1, Next::kOwnTriangles, false}));
  EXPECT_EQ(roundsOf({4.1}, Own::kFew), (Outcome{1, Next::kOwnTriangles, false}));
  EXPECT_EQ(roundsOf({3.9, 3.5}, Own::kFew), (Outcome{2, Next::kAgain, false}));
  EXPECT_EQ(roundsOf({3.9, 1.5, 1.2}, Own::kFew), (Outcome{3, Next::kOwnTriangles, false}));
  // What stops to gain after a good begin ends, too, once the last two rounds show it.
  EXPECT_EQ(roundsOf({30, 12, 9, 8.9, 8.8}, Own::kMany), (Outcome{4, Next::kOwnTriangles, false}));
}

TEST(SimplifiedRounds, ThatDoNotComeNearTheTargetEndEarlyWhereThereMayBeMorePatches) {
  // 5 after two rounds that gained a third together: three more would end at 2.7, not near enough to go on.
  const std::vector<double> slow{7.5, 6.5, 5, 4.5, 4, 3.8};
  EXPECT_EQ(roundsOf(slow, Own::kTooMany), (Outcome{3, Next::kEnd, false}));
  EXPECT_EQ(roundsOf(slow, Own::kMany), (Outcome{6, Next::kOwnTriangles, true})) << "control: near enough for these";
  EXPECT_EQ(roundsOf(slow, Own::kNone), (Outcome{6, Next::kEnd, true})) << "control: nothing else is left";
  // 4 after two rounds that halved it: three more would end at 1.4.
  EXPECT_EQ(roundsOf({8, 6, 4, 3}, Own::kTooMany), (Outcome{4, Next::kAgain, false}));
  // Where bakes take long, what is far off after the first base is left at once.
  EXPECT_EQ(roundsOf({8, 6, 4, 3}, Own::kFarTooMany), (Outcome{1, Next::kEnd, false}));
  EXPECT_EQ(roundsOf({4.1}, Own::kFarTooMany), (Outcome{1, Next::kEnd, false}));
  EXPECT_EQ(roundsOf({4, 3, 2, 1.5}, Own::kFarTooMany), (Outcome{4, Next::kAgain, false}));
  EXPECT_EQ(roundsOf({4, 3.9, 3.8}, Own::kFarTooMany), (Outcome{3, Next::kEnd, false}));
}

TEST(SimplifiedRounds, EndWhereNoMoreHelp) {
  // Twice in a row no better; then the own triangles, if there may be so many patches.
  EXPECT_EQ(roundsOf({20, 21, 22}, Own::kMany), (Outcome{3, Next::kOwnTriangles, true}));
  EXPECT_EQ(roundsOf({3, 3.1, 3.2}, Own::kMany), (Outcome{3, Next::kOwnTriangles, true}));
  EXPECT_EQ(roundsOf({3, 3.1, 3.2}, Own::kNone), (Outcome{3, Next::kEnd, true}));
  EXPECT_EQ(roundsOf({40}, Own::kMany), (Outcome{1, Next::kOwnTriangles, true}));
  EXPECT_EQ(roundsOf({40}, Own::kTooMany), (Outcome{1, Next::kEnd, true}));
  // Near the target four times in a row where there is nothing else, but no more than twice once it is kept.
  EXPECT_EQ(roundsOf({3, 1.9, 2, 2.1, 2.2, 2.3}, Own::kNone), (Outcome{6, Next::kEnd, true}));
  EXPECT_EQ(roundsOf({3, 1.9, 2, 2.1, 2.2}, Own::kNone), (Outcome{5, Next::kAgain, false}));
  EXPECT_EQ(roundsOf({3, 1.9, 2, 2.1}, Own::kMany), (Outcome{4, Next::kOwnTriangles, true}));
  EXPECT_EQ(roundsOf({1.5, 0.95, 1.2, 1.3}, Own::kMany), (Outcome{4, Next::kEnd, true}));
  // Six bakes as a rule, eleven where the target is nearly kept.
  EXPECT_EQ(roundsOf(std::vector<double>{3, 2.9, 2.8, 2.7, 2.6, 2.5, 2.4}, Own::kMany),
            (Outcome{6, Next::kOwnTriangles, true}));
  std::vector<double> near;
  for (int i = 0; i < 12; ++i) near.push_back(1.25 - 0.01 * i);
  EXPECT_EQ(roundsOf(near, Own::kMany), (Outcome{11, Next::kOwnTriangles, true}));
}

// The first base is baked in both ways, and the others in the better one.
TEST(SimplifiedRounds, TakeTheWayThatMissesLess) {
  for (const bool other_is_better : {false, true}) {
    SimplifiedRounds rounds;
    EXPECT_FALSE(rounds.otherWay());
    EXPECT_EQ(rounds.after({3, 3, true, false}, Own::kMany), Next::kSameBase);
    EXPECT_TRUE(rounds.otherWay());
    EXPECT_EQ(rounds.after(other_is_better ? SimplifiedRounds::Bake{2, 2, true, false}
                                           : SimplifiedRounds::Bake{4, 3, false, false},
                           Own::kMany),
              Next::kAgain);
    EXPECT_EQ(rounds.otherWay(), other_is_better);
    EXPECT_EQ(rounds.firstWasBetter(), !other_is_better);
    // Never again, whatever comes.
    EXPECT_EQ(rounds.after({1.5, 1.5, true, false}, Own::kMany), Next::kAgain);
    EXPECT_EQ(rounds.otherWay(), other_is_better);
    EXPECT_FALSE(rounds.firstWasBetter());
  }
}

TEST(SimplifiedRounds, CountBothWaysOfTheFirstBaseAsOne) {
  // The first base was better than what there was before, if either of its bakes was: the next one is in vain once.
  SimplifiedRounds rounds;
  EXPECT_EQ(rounds.after({3, 3, true, false}, Own::kNone), Next::kSameBase);
  EXPECT_EQ(rounds.after({40, 3, false, false}, Own::kNone), Next::kAgain) << "the better one is not hopeless";
  EXPECT_EQ(rounds.after({3.1, 3, false, false}, Own::kNone), Next::kAgain);
  EXPECT_EQ(rounds.after({3.2, 3, false, false}, Own::kNone), Next::kEnd);
  // What is hopeless in one way is not tried in the other.
  SimplifiedRounds hopeless;
  EXPECT_EQ(hopeless.after({40, 40, true, false}, Own::kTooMany), Next::kEnd);
  EXPECT_FALSE(hopeless.otherWay());
}

}  // namespace simplified_rounds_test
}  // namespace relievo
