// Threads that the system refuses, and what threads throw: each loop and pool ends, with a result or with what was
// thrown.
#include <gtest/gtest.h>

#include <new>
#include <numeric>

#include "src/base/heap.h"
#include "src/base/parallel_for.h"
#include "src/base/worker_threads.h"
#include "tests/base/thread_limit.h"

namespace relievo {
namespace worker_threads_test {

class FewThreads : public ::testing::TestWithParam<long> {
 protected:
  void SetUp() override {
#ifdef __SANITIZE_THREAD__
    if (GetParam() >= 0) GTEST_SKIP() << "ThreadSanitizer itself takes pthread_create's place";
#endif
    testing_support::setMostThreads(GetParam());
  }
  void TearDown() override { testing_support::setMostThreads(-1); }
};
INSTANTIATE_TEST_SUITE_P(Limits, FewThreads, ::testing::Values(-1, 0, 1, 2, 3), [](const auto& limit) {
  return limit.param < 0 ? std::string("None") : std::to_string(limit.param);
});

TEST_P(FewThreads, ParallelForDoesEveryJobOnce) {
  const long refused = testing_support::threadsRefused();
  std::vector<int> done(10000);
  size_t seen = 0;
  // Those that started stay until one was refused: a thread that ended would make room for the next.
  auto job = [&](size_t i) {
    while (GetParam() >= 0 && testing_support::threadsRefused() == refused) std::this_thread::yield();
    ++done[i];
  };
  EXPECT_TRUE(parallelFor(done.size(), 5, nullptr, job, [&](size_t taken) { seen = taken; }));
  EXPECT_EQ(std::count(done.begin(), done.end(), 1), static_cast<std::ptrdiff_t>(done.size()));
  EXPECT_LE(seen, done.size());
  EXPECT_EQ(testing_support::threadsRefused() > refused, GetParam() >= 0);  // else nothing was tested
}

TEST_P(FewThreads, EachThreadOfALoopHasAStateOfItsOwn) {
  std::atomic<int> states{0};
  std::atomic<int> sum{0};
  EXPECT_TRUE(parallelForWith(
      1000, 4, nullptr, [&] { return ++states, std::make_unique<int>(0); },
      [&](std::unique_ptr<int>& mine, size_t) {
        ++*mine;
        ++sum;
      }));
  EXPECT_EQ(sum, 1000);
  EXPECT_GE(states, 1);
  EXPECT_LE(states, GetParam() < 0 ? 4 : 1 + GetParam());
}

TEST_P(FewThreads, WhatAJobThrowsReachesTheCaller) {
  for (size_t bad : {0, 1, 17, 999})
    EXPECT_THROW(parallelFor(1000, 4, nullptr,
                             [&](size_t i) {
                               if (i == bad) throw std::bad_alloc();
                             }),
                 std::bad_alloc)
        << bad;
  EXPECT_THROW(parallelForWith(
                   10, 4, nullptr, []() -> int { throw std::bad_alloc(); }, [](int&, size_t) {}),
               std::bad_alloc);
}

TEST_P(FewThreads, APoolHasAsManyAsItIsGiven) {
  std::mutex held;
  std::unique_lock hold(held);
  WorkerThreads threads("test");
  const size_t expected = GetParam() < 0 ? 3 : std::min(3L, GetParam());
  EXPECT_EQ(threads.start(3, [&] { std::lock_guard wait(held); }), expected);
  EXPECT_EQ(threads.size(), expected);
  EXPECT_EQ(threadsToBeHad(2), GetParam() < 0 ? 2u : std::min<size_t>(2, static_cast<size_t>(GetParam()) - expected));
  hold.unlock();
  threads.join();
  threads.rethrow();  // nothing
  if (GetParam() == 0) EXPECT_THROW(threads.startAtLeastOne(2, [] {}), ThreadStartFailure);
  else EXPECT_GE(threads.startAtLeastOne(2, [] {}), 1u);
}

TEST_P(FewThreads, ABackgroundTaskIsDoneByWhoAsks) {
  BackgroundTask<std::unique_ptr<int>> task("test",
                                            [seven = std::make_unique<int>(7)]() mutable { return std::move(seven); });
  EXPECT_EQ(*task.get(), 7);
  EXPECT_EQ(*task.get(), 7);
  EXPECT_TRUE(task.ready());
  BackgroundTask<int> throwing("test", []() -> int { throw std::bad_alloc(); });
  EXPECT_THROW(throwing.get(), std::bad_alloc);
  EXPECT_THROW(throwing.get(), std::bad_alloc);
  int done = 0;
  BackgroundTask<void>(
      "test", [&] { ++done; }, false)
      .get();
  EXPECT_EQ(done, 1);
  {
    BackgroundTask<void> never(
        "test", [&] { ++done; }, false);
  }
  EXPECT_EQ(done, 1);
}

TEST_P(FewThreads, MemoryIsWarmedOrNot) {
  HeapWarmer heap(size_t{8} << 20);
  heap.giveBack();
  heap.giveBack();
}

TEST(WorkerThreads, WhatAThreadThrowsIsKeptForItsOwner) {
  WorkerThreads threads("test");
  threads.start(3, [] { throw std::bad_alloc(); });
  threads.join();
  EXPECT_THROW(threads.rethrow(), std::bad_alloc);
}

TEST(WorkerThreads, TheSentenceSaysWhyAndWhatToDo) {
  const std::string text = ThreadStartFailure("Resource temporarily unavailable").what();
  EXPECT_EQ(text,
            "could not start a thread: Resource temporarily unavailable (close other programs, or raise the limits of "
            "processes and memory: ulimit -u, ulimit -v)");
}

}  // namespace worker_threads_test
}  // namespace relievo
