// What is said of the geometry's error: with --least-cell 0 it is about twice --error-px at most, by default more at
// steps, and that is what is said.
#include <gtest/gtest.h>

#include <fstream>
#include <string>

#include <nlohmann/json.hpp>

#include "tests/tools/cli_fixture.h"

namespace relievo {
namespace error_promise_test {

using ErrorPromise = testing_support::Cli;

TEST_F(ErrorPromise, IsKeptOrSaid) {
  const auto made = relievo("sample coin --size 1024x1024 --package " + file("coin.relievo"));
  ASSERT_EQ(made.exit_code, 0) << made.output;
  auto stats = [&](const std::string& more) {
    const auto drawn = relievo("render " + file("coin.relievo") + " -o " + file("p.png") +
                               " --size 320x240 --azimuth 30 --elevation 20 --stats " + file("s.json") + " " + more);
    EXPECT_EQ(drawn.exit_code, 0) << drawn.output;
    std::ifstream in(file("s.json"));
    return nlohmann::json::parse(in);
  };
  for (double budget : {1.0, 3.0}) {
    const std::string asked = "--error-px " + std::to_string(budget);
    const auto by_default = stats(asked), kept = stats(asked + " --least-cell 0"),
               same = stats(asked + " --least-cell 2");
    EXPECT_LE(kept["predicted_error_px"], 2.2 * budget);
    EXPECT_GT(by_default["predicted_error_px"], 2.2 * budget)
        << "control: by default steps are farther off, and it says so";
    EXPECT_GT(kept["triangles"], by_default["triangles"]);
    EXPECT_EQ(same["predicted_error_px"], by_default["predicted_error_px"]) << "2 is the default";
  }
  EXPECT_EQ(relievo("render " + file("coin.relievo") + " -o " + file("p.png") + " --least-cell -1").exit_code, 1);
}

}  // namespace error_promise_test
}  // namespace relievo
