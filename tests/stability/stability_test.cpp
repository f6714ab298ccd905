// The table of hard cases as `relievo selftest --stability` prints it: every case holds, every naive method fails, and
// what does not hold is seen.
#include "tools/stability/stability.h"

#include <gtest/gtest.h>

#include <set>

namespace relievo {
namespace stability_test {

class EachPart : public ::testing::TestWithParam<StabilityPart> {};

TEST_P(EachPart, HoldsWhereTheNaiveMethodFails) {
  const std::vector<StabilityPart> parts{GetParam()};
  const auto rows = runStability(parts);
  ASSERT_EQ(rows.size(), GetParam().cases.size());
  for (const StabilityRow& row : rows) {
    EXPECT_TRUE(row.holds()) << row.hard_case->name << ": " << row.errors.measured << " " << row.hard_case->unit
                             << ", bound " << row.hard_case->bound;
    EXPECT_TRUE(row.naiveFails()) << row.hard_case->name << ": the naive method is off by " << row.errors.naive << " "
                                  << row.hard_case->unit << " only, bound " << row.hard_case->bound;
    EXPECT_GE(row.margin(), 1);
  }
}
INSTANTIATE_TEST_SUITE_P(Stability, EachPart, ::testing::ValuesIn(stabilityParts()),
                         [](const auto& i) { return std::string(i.param.name); });

TEST(Stability, TheSameFiguresAgain) {
  std::vector<StabilityPart> parts = stabilityParts();
  std::erase_if(parts, [](const StabilityPart& part) { return part.name == "sums"; });  // a second of counting
  const auto once = runStability(parts), again = runStability(parts);
  ASSERT_EQ(once.size(), again.size());
  std::set<std::string_view> names;
  for (size_t k = 0; k < once.size(); ++k) {
    EXPECT_EQ(once[k].errors.measured, again[k].errors.measured) << once[k].hard_case->name;
    EXPECT_GT(once[k].hard_case->bound, 0);
    EXPECT_TRUE(names.insert(once[k].hard_case->name).second) << once[k].hard_case->name << " is there twice";
  }
}

// The controls: an error over its bound, what is not a number, and a naive method that does not fail are told apart.
constexpr StabilityCase kMade[] = {
    {"off", "0", "far off", "px", 1,
     +[] {
       return StabilityErrors{1.5, 9};
     }},
    {"not a number", "0", "far off", "px", 1,
     +[] {
       StabilityErrors e;
       e.add(NAN, 9);
       e.add(0.5, 9);
       return e;
     }},
    {"not hard", "0", "as good", "px", 1,
     +[] {
       return StabilityErrors{0.5, 0.5};
     }},
    {"good", "0", "far off", "px", 1,
     +[] {
       return StabilityErrors{0.25, NAN};
     }},
    {"exact", "0", "far off", "px", 1,
     +[] {
       return StabilityErrors{0, 9};
     }},
};

TEST(StabilityControl, WhatDoesNotHoldIsSeen) {
  const std::vector<StabilityPart> parts{{"made", kMade}};
  const auto rows = runStability(parts);
  EXPECT_FALSE(rows[0].holds());
  EXPECT_LT(rows[0].margin(), 1);
  EXPECT_FALSE(rows[1].holds()) << "a number later does not hide it";
  EXPECT_TRUE(rows[2].holds());
  EXPECT_FALSE(rows[2].naiveFails());
  EXPECT_TRUE(rows[3].holds());
  EXPECT_EQ(rows[3].margin(), 4);
  const std::string table = stabilityTable(rows, false);
  EXPECT_NE(table.find("FAILS"), std::string::npos) << table;
  EXPECT_NE(table.find("SO DOES THE NAIVE METHOD"), std::string::npos) << table;
  EXPECT_NE(table.find("no number"), std::string::npos) << table;
  EXPECT_NE(table.find("exact"), std::string::npos) << table;
  EXPECT_NE(stabilityTable(rows, true).find("| made | good | 0 | 1 px | 0.25 px | 4 |"), std::string::npos);
}

}  // namespace stability_test
}  // namespace relievo
