// What `relievo bench` writes of its rows, from rows that are made up here.
#include "tools/bench/bench_report.h"
#include "tools/report/machine.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

namespace relievo {
namespace bench_report_test {

BenchRun madeUpRun() {
  BenchRow fast;
  fast.what = "copy of 2 | 3 pages";
  fast.measured = 0.25;
  fast.unit = "ms";
  fast.goal = 0.5;
  fast.baseline = 12.5;
  fast.baseline_name = "copy <by hand>";
  fast.note = "two\nlines";
  BenchRow slow = fast;
  slow.what = "pages read";
  slow.measured = 4000;
  slow.unit = "pages/s";
  slow.goal = 5000;
  slow.at_most = false;
  slow.baseline.reset();
  BenchRow bare;
  bare.what = "triangles";
  bare.measured = 12;
  BenchRun run;
  run.processor = "A processor";
  run.cores = 2;
  run.renderer = "A renderer";
  run.version = "relievo 9.9";
  run.artwork = "8 x 8 px";
  run.started = 1000000000;
  run.load = 1.5;
  run.groups = {{"one", "what one measures", {fast, slow}}, {"two", "what two measures", {bare}}, {"none", "no", {}}};
  return run;
}

TEST(BenchReport, ThePageIsThis) {
  EXPECT_EQ(benchMarkdown(madeUpRun()),
            R"(# Figures of one run of `relievo bench`

Written by `relievo bench --markdown`. Times are medians. A verdict compares the value with the goal. A baseline was measured in the same run.

| machine | |
|---|---|
| processor | A processor |
| cores | 2 |
| GL renderer | A renderer |
| load average before the run | 1.50 |
| artwork | 8 x 8 px |
| repetitions | all |
| version | relievo 9.9 |
| date | 2001-09-09 01:46 UTC |

## one

What one measures.

| figure | value | unit | goal | verdict | baseline | what the baseline is | notes |
|---|---|---|---|---|---|---|---|
| copy of 2 \| 3 pages | 0.25 | ms | at most 0.50 | ok | 12.5 | copy \<by hand> | two lines |
| pages read | 4000 | pages/s | at least 5000 | missed | | | two lines |

## two

What two measures.

| figure | value | unit | goal | verdict | baseline | what the baseline is | notes |
|---|---|---|---|---|---|---|---|
| triangles | 12.0 | | | | | | |

## none

No.

This artwork gives the group nothing to measure.
)");
}

TEST(BenchReport, AGroupThatDidNotRunIsNotMentioned) {
  BenchRun run = madeUpRun();
  run.groups.erase(run.groups.begin());
  const std::string page = benchMarkdown(run);
  EXPECT_EQ(page.find("## one"), std::string::npos);
  EXPECT_EQ(page.find("pages read"), std::string::npos);
  EXPECT_NE(page.find("## two"), std::string::npos);
}

TEST(BenchReport, JsonHasTheSameRows) {
  const auto json = nlohmann::json::parse(benchJson(madeUpRun()), nullptr, false);
  ASSERT_FALSE(json.is_discarded());
  ASSERT_EQ(json["rows"].size(), 3u);
  EXPECT_EQ(json["tool_version"], "relievo 9.9");
  EXPECT_EQ(json["rows"][0]["group"], "one");
  EXPECT_EQ(json["rows"][0]["met"], true);
  EXPECT_EQ(json["rows"][0]["baseline"], 12.5);
  EXPECT_EQ(json["rows"][1]["goal_is"], "at least");
  EXPECT_EQ(json["rows"][1]["met"], false);
  EXPECT_FALSE(json["rows"][1].contains("baseline"));
  EXPECT_FALSE(json["rows"][2].contains("goal"));
}

TEST(BenchReport, ALineForTheTerminal) {
  const BenchRun run = madeUpRun();
  EXPECT_EQ(benchLine(run.groups[0].rows[1]),
            "  pages read" + std::string(48, ' ') + "       4000 pages/s   >= 5000    MISS  two\nlines\n");
  EXPECT_NE(benchLine(run.groups[0].rows[0]).find("12.5 copy <by hand>; two"), std::string::npos);
}

TEST(BenchReport, TheProcessorHasAName) { EXPECT_NE(processorName(), ""); }

}  // namespace bench_report_test
}  // namespace relievo
