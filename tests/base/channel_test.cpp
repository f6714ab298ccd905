// src/base: hand-over between threads.
#include <algorithm>
#include <atomic>
#include <memory>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "src/base/channel.h"
#include "src/base/mailbox.h"

namespace relievo {
namespace channel_test {

TEST(Channel, KeepsTheOrderAndDrainsAfterClose) {
  Channel<int> channel;
  for (int i = 0; i < 5; ++i) EXPECT_TRUE(channel.push(i));
  EXPECT_EQ(channel.size(), 5u);
  channel.close();
  EXPECT_FALSE(channel.push(99));
  for (int i = 0; i < 5; ++i) EXPECT_EQ(channel.pop(), i);
  EXPECT_EQ(channel.pop(), std::nullopt);
  EXPECT_EQ(channel.tryPop(), std::nullopt);
}

TEST(Channel, TryPopNeverWaits) {
  Channel<std::unique_ptr<int>> channel;
  EXPECT_EQ(channel.tryPop(), std::nullopt);
  EXPECT_TRUE(channel.push(std::make_unique<int>(3)));
  std::optional<std::unique_ptr<int>> value = channel.tryPop();
  ASSERT_TRUE(value);
  EXPECT_EQ(**value, 3);
}

TEST(Channel, AFullOneHoldsItsPusherUntilThereIsSpace) {
  Channel<int> channel(2);
  ASSERT_TRUE(channel.push(0) && channel.push(1));
  std::atomic<bool> pushed = false;
  std::thread pusher([&] {
    EXPECT_TRUE(channel.push(2));
    pushed = true;
  });
  // Whatever the scheduling: while both places are taken, the third value is not in.
  EXPECT_FALSE(pushed);
  EXPECT_EQ(channel.size(), 2u);
  EXPECT_EQ(channel.pop(), 0);
  pusher.join();
  EXPECT_TRUE(pushed);
  EXPECT_EQ(channel.pop(), 1);
  EXPECT_EQ(channel.pop(), 2);
}

TEST(Channel, CloseWakesWaitingPushersAndPoppers) {
  Channel<int> full(1), empty;
  ASSERT_TRUE(full.push(0));
  std::vector<std::thread> threads;
  for (int i = 0; i < 3; ++i) {
    threads.emplace_back([&] { EXPECT_FALSE(full.push(1)); });
    threads.emplace_back([&] { EXPECT_EQ(empty.pop(), std::nullopt); });
  }
  full.close();
  empty.close();
  for (std::thread& t : threads) t.join();  // a missed wake-up would hang here
  EXPECT_EQ(full.pop(), 0);
}

TEST(Channel, ManyToManyLosesAndDoublesNothing) {
  constexpr int kPushers = 4, kPoppers = 4, kEach = 2000;
  Channel<int> channel(7);
  std::vector<std::vector<int>> got(kPoppers);
  std::vector<std::thread> pushers, poppers;
  for (int p = 0; p < kPoppers; ++p)
    poppers.emplace_back([&, p] {
      while (std::optional<int> v = channel.pop()) got[p].push_back(*v);
    });
  for (int p = 0; p < kPushers; ++p)
    pushers.emplace_back([&, p] {
      for (int i = 0; i < kEach; ++i) EXPECT_TRUE(channel.push(p * kEach + i));
    });
  for (std::thread& t : pushers) t.join();
  channel.close();
  for (std::thread& t : poppers) t.join();
  std::vector<int> all;
  for (const std::vector<int>& one : got) {
    all.insert(all.end(), one.begin(), one.end());
    // Each popper sees each pusher's values in that pusher's order.
    for (int p = 0; p < kPushers; ++p) {
      std::vector<int> mine;
      std::copy_if(one.begin(), one.end(), std::back_inserter(mine), [&](int v) { return v / kEach == p; });
      EXPECT_TRUE(std::is_sorted(mine.begin(), mine.end()));
    }
  }
  std::sort(all.begin(), all.end());
  ASSERT_EQ(all.size(), size_t{kPushers * kEach});
  for (int i = 0; i < kPushers * kEach; ++i) ASSERT_EQ(all[i], i);
}

TEST(Mailbox, NewestWins) {
  Mailbox<int> box;
  EXPECT_EQ(box.tryTake(), std::nullopt);
  box.post(1);
  box.post(2);
  EXPECT_EQ(box.tryTake(), 2);
  EXPECT_EQ(box.tryTake(), std::nullopt);
}

TEST(Mailbox, TheTakerEndsWithTheLastLetterAndNeverGoesBack) {
  Mailbox<int> box;
  constexpr int kLast = 20000;
  std::vector<int> taken;
  std::thread taker([&] {
    while (std::optional<int> v = box.take()) {
      taken.push_back(*v);
      if (*v == kLast) break;
    }
  });
  for (int i = 1; i <= kLast; ++i) box.post(i);
  taker.join();
  ASSERT_FALSE(taken.empty());
  EXPECT_EQ(taken.back(), kLast);
  EXPECT_TRUE(std::is_sorted(taken.begin(), taken.end()));
  EXPECT_EQ(std::adjacent_find(taken.begin(), taken.end()), taken.end()) << "a letter was taken twice";
}

TEST(Mailbox, CloseWakesTheTaker) {
  Mailbox<int> box;
  std::thread taker([&] { EXPECT_EQ(box.take(), std::nullopt); });
  box.close();
  taker.join();
}

}  // namespace channel_test
}  // namespace relievo
