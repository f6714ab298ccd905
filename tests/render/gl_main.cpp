#include <cstdio>
#include <cstdlib>
#include <cstring>

#include <gtest/gtest.h>

#include "tests/render/gl_fixture.h"

namespace relievo::gltest {
namespace {

std::unique_ptr<gl::HeadlessContext> g_context;
int g_errors_before = 0;

class NoGlErrors : public testing::EmptyTestEventListener {
  void OnTestStart(const testing::TestInfo&) override { g_errors_before = gl::debugErrorCount(); }
  void OnTestEnd(const testing::TestInfo&) override {
    if (int errors = takeGlErrors(); errors != 0) ADD_FAILURE() << errors << " GL errors in this test (see above)";
  }
};

}  // namespace

gl::Api api() { return g_context->info().api; }
gl::HeadlessContext& context() { return *g_context; }

int takeGlErrors() {
  const int now = gl::debugErrorCount();
  return now - std::exchange(g_errors_before, now);
}

}  // namespace relievo::gltest

int main(int argc, char** argv) {
  using namespace relievo;
  testing::InitGoogleTest(&argc, argv);
  if (testing::GTEST_FLAG(list_tests)) return RUN_ALL_TESTS();
  Result<std::unique_ptr<gl::HeadlessContext>> made = gl::HeadlessContext::create();
  if (!made) {
    const char* required = std::getenv("RELIEVO_REQUIRE_GL");
    const bool fail = required && std::strcmp(required, "1") == 0;
    std::printf("%s: %s\n", fail ? "FAILED" : "SKIPPED", made.error().text().c_str());
    return fail ? 1 : 77;
  }
  gltest::g_context = std::move(*made);
  std::printf("%s, %s\n", gltest::g_context->info().version.c_str(), gltest::g_context->info().renderer.c_str());
  testing::UnitTest::GetInstance()->listeners().Append(new gltest::NoGlErrors);
  const int result = RUN_ALL_TESTS();
  gltest::g_context.reset();
  return result;
}
