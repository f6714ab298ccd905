// The program where the system gives few threads: the same bytes as with many, or exit code 4 and one sentence; it
// never hangs nor aborts.
#include "tests/base/thread_limit.h"

#include <iterator>

#include "tests/tools/cli_fixture.h"
#include "tests/view_share.h"

namespace relievo {
namespace thread_limit_test {

using testing_support::Outcome;

class ThreadLimit : public testing_support::Cli {
 protected:
  static std::string bytesOf(const std::string& path) {
    std::ifstream in(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  // `arguments` write the file `output`, or none where that is empty.
  void expectSameOrSentence(const std::string& arguments, const std::string& output) {
    const Outcome whole = relievo(arguments);
    if (testing_support::noGl(whole)) GTEST_SKIP() << whole.output;
    ASSERT_EQ(whole.exit_code, 0) << whole.output;
    const std::string expected = output.empty() ? "" : bytesOf(file(output));
    const std::vector<int> limits = test::kSanitized ? std::vector{0, 3} : std::vector{0, 1, 2, 3, 6, 12, 24};
    for (int most : limits) {
      if (!output.empty()) testing_support::fs::remove(file(output));
      // The sanitizers' libraries want to be first.
      const Outcome r = testing_support::run(
          "timeout -s KILL 300 env ASAN_OPTIONS=\"$ASAN_OPTIONS:verify_asan_link_order=0\" "
          "LD_PRELOAD=" RELIEVO_THREAD_LIMIT " RELIEVO_MOST_THREADS=" +
          std::to_string(most) + " RELIEVO_THREADS_REFUSED=" + file("refused") + " " RELIEVO_PROGRAM " " + arguments);
      SCOPED_TRACE("at most " + std::to_string(most) + " threads: " + arguments + "\n" + r.output);
      if (r.exit_code == 0) {
        if (!output.empty()) {
          EXPECT_TRUE(bytesOf(file(output)) == expected);
        }
      } else {
        EXPECT_EQ(r.exit_code, 4);
        EXPECT_NE(r.output.find("relievo: error: "), std::string::npos);
        EXPECT_NE(r.output.find("thread"), std::string::npos);
        EXPECT_NE(r.output.find("ulimit -u"), std::string::npos);
        EXPECT_EQ(r.output.find("terminate"), std::string::npos);
        if (!output.empty()) {
          EXPECT_FALSE(testing_support::fs::exists(file(output)));
        }
      }
      EXPECT_EQ(filesNamed(".part"), 0);
      if (most == 0) {
        EXPECT_GT(std::atoi(bytesOf(file("refused")).c_str()), 0) << "nothing was tested";
      }
    }
  }
  void makePackage() {
    const Outcome made = relievo("sample coin --size 300x200 --write height,ptm-lrgb,mesh -o " + file("s") +
                                 " --package " + file("coin.relievo"));
    ASSERT_EQ(made.exit_code, 0) << made.output;
  }
};

TEST_F(ThreadLimit, BuildOfAPtmAndHeights) {
  makePackage();
  expectSameOrSentence("build --ptm " + file("s/ptm_lrgb.ptm") + " --relief " + file("s/height_float.tif") +
                           " --mm-per-pixel 0.1 -o " + file("built.relievo"),
                       "built.relievo");
}

// A given number of patches: no rounds of others, whose threads would be the same.
TEST_F(ThreadLimit, BuildOfAScan) {
  std::ofstream(file("octahedron.off")) << "OFF\n6 8 0\n9 0 0\n-9 0 0\n0 9 0\n0 -9 0\n0 0 9\n0 0 -9\n3 0 2 4\n3 2 1 4\n"
                                           "3 1 3 4\n3 3 0 4\n3 2 0 5\n3 1 2 5\n3 3 1 5\n3 0 3 5\n";
  expectSameOrSentence("build --mesh " + file("octahedron.off") + " --patches 24 -o " + file("built.relievo"),
                       "built.relievo");
}

TEST_F(ThreadLimit, Sample) {
  expectSameOrSentence("sample inscription --size 1100x300 --package " + file("made.relievo"), "made.relievo");
}

TEST_F(ThreadLimit, Verify) {
  makePackage();
  expectSameOrSentence("verify " + file("coin.relievo"), "");
}

TEST_F(ThreadLimit, Render) {
  makePackage();
  expectSameOrSentence("render " + file("coin.relievo") + " -o " + file("picture.png") + " --size 160x120",
                       "picture.png");
}

}  // namespace thread_limit_test
}  // namespace relievo
