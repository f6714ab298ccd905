// Sources that stack. Time is a clock of the test's own: nothing here waits.
#include "texturing/stream/page_sources.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <condition_variable>
#include <filesystem>
#include <fstream>
#include <random>
#include <set>
#include <thread>

#include <xxhash.h>

#include "tests/render/test_artwork.h"
#include "tests/texturing/fake_sources.h"
#include "texturing/codec/page_codec.h"

namespace relievo {
namespace page_sources_test {

using fake::GatedSource;
using fake::MapSource;
using fake::ProceduralSource;

PageId page(uint32_t i, Plane plane = texturePlane(0)) { return PageId(plane, {0, 10, i % 1024, i / 1024}); }

// Sleeping is what makes time pass.
struct LoneClock {
  std::shared_ptr<double> now = std::make_shared<double>(100);
  SourceClock clock() const {
    return {[now = now] { return *now; }, [now = now](double until_s) { *now = std::max(*now, until_s); }};
  }
};

// Sleepers wait until they are told that it is time.
struct SharedClock {
  struct State {
    std::mutex mutex;
    std::condition_variable changed;
    double now = 0;
    std::vector<double> sleepers;
  };
  std::shared_ptr<State> state = std::make_shared<State>();
  SourceClock clock() const {
    return {[s = state] {
              std::lock_guard lock(s->mutex);
              return s->now;
            },
            [s = state](double until_s) {
              std::unique_lock lock(s->mutex);
              s->sleepers.push_back(until_s);
              s->changed.notify_all();
              s->changed.wait(lock, [&] { return s->now >= until_s; });
            }};
  }
  std::vector<double> waitForSleepers(size_t n) const {
    std::unique_lock lock(state->mutex);
    state->changed.wait(lock, [&] { return state->sleepers.size() >= n; });
    return state->sleepers;
  }
  void advanceTo(double s) const {
    {
      std::lock_guard lock(state->mutex);
      state->now = s;
    }
    state->changed.notify_all();
  }
};

// Pages of so many bytes, which name themselves.
class SizedSource : public PageSource {
 public:
  explicit SizedSource(size_t bytes) : bytes_(bytes) {}
  Result<EncodedPage> read(PageId id) const override {
    ++reads;
    EncodedPage p;
    p.bytes.assign(bytes_, static_cast<uint8_t>(fake::mix(id.bits)));
    return p;
  }
  mutable std::atomic<int> reads{0};

 private:
  size_t bytes_;
};

// --- memory ---

TEST(MemorySource, AnswersFromMemoryWithinItsBudgetAndForgetsTheLeastRecentlyRead) {
  auto inner = std::make_shared<SizedSource>(100);
  MemorySource memory(350, inner);
  for (uint32_t i : {0u, 1u, 2u, 0u}) ASSERT_TRUE(memory.read(page(i)));
  EXPECT_EQ(inner->reads, 3);
  EXPECT_EQ(memory.hits(), 1u);
  ASSERT_TRUE(memory.read(page(3)));  // page 1 goes
  EXPECT_EQ(memory.pages(), 3u);
  EXPECT_EQ(memory.bytes(), 300u);
  for (uint32_t i : {0u, 2u, 3u}) ASSERT_TRUE(memory.read(page(i)));
  EXPECT_EQ(inner->reads, 4);
  auto again = memory.read(page(1));
  ASSERT_TRUE(again);
  EXPECT_EQ(inner->reads, 5);
  EXPECT_EQ(again->bytes, inner->read(page(1))->bytes);
}

TEST(MemorySource, NeverExceedsItsBudgetAndNeverServesAnotherPage) {
  constexpr uint64_t kSeed = 7, kBudget = 5000;
  std::mt19937 random(kSeed);
  auto inner = std::make_shared<MapSource>();
  for (uint32_t i = 0; i < 200; ++i) inner->pages[page(i)].assign(1 + random() % 900, static_cast<uint8_t>(i));
  inner->pages[page(200)].assign(kBudget + 1, 200);  // never fits
  MemorySource memory(kBudget, inner);
  for (int k = 0; k < 5000; ++k) {
    uint32_t i = random() % 201;
    auto read = memory.read(page(i));
    ASSERT_TRUE(read);
    ASSERT_EQ(read->bytes, inner->pages[page(i)]) << "seed " << kSeed << ", step " << k;
    ASSERT_LE(memory.bytes(), kBudget);
  }
  EXPECT_GT(memory.hits(), 100u);
}

TEST(MemorySource, WithoutAnInnerSourceWhatWasPutInIsAllThereIs) {
  MemorySource memory(10);
  EXPECT_TRUE(memory.put(page(1), {1, 2, 3}));
  EXPECT_TRUE(memory.put(page(2), {4, 5, 6, 7}));
  EXPECT_FALSE(memory.put(page(3), {1, 2, 3, 4})) << "nothing may go";
  EXPECT_TRUE(memory.put(page(1), {9})) << "in place of the old one";
  EXPECT_EQ(memory.bytes(), 5u);
  EXPECT_EQ(memory.read(page(1))->bytes, std::vector<uint8_t>{9});
  auto missing = memory.read(page(3));
  ASSERT_FALSE(missing);
  EXPECT_EQ(missing.error().kind, ErrorKind::kInvalidData) << "final: there is no such page";
  EXPECT_FALSE(missing.error().offset);
}

TEST(MemorySource, LoadSaysWhenThePagesDoNotFit) {
  auto inner = std::make_shared<SizedSource>(100);
  std::vector<PageId> pages{page(0), page(1), page(2)};
  MemorySource enough(300, inner), tight(299, inner);
  ASSERT_TRUE(enough.load(pages));
  ASSERT_TRUE(enough.read(page(2)));
  EXPECT_EQ(inner->reads, 3);
  EXPECT_FALSE(tight.load(pages));
}

// --- rate and latency ---

TEST(RateLimitedSource, AReadTakesItsBytesAndItsLatency) {
  LoneClock lone;
  RateLimitedSource source(std::make_shared<SizedSource>(2000), {.bytes_per_s = 1e6, .latency_ms = 50}, 1,
                           lone.clock());
  for (int i = 1; i <= 10; ++i) {
    ASSERT_TRUE(source.read(page(static_cast<uint32_t>(i))));
    EXPECT_NEAR(*lone.now, 100 + i * 0.052, 1e-9);
  }
}

// When reads that begin together end, latencies taken off, in order.
std::vector<double> endsOfReadsTogether(const std::vector<const RateLimitedSource*>& sources,
                                        const SharedClock& shared) {
  std::vector<std::thread> readers;
  for (size_t i = 0; i < sources.size(); ++i)
    readers.emplace_back([&, i] { EXPECT_TRUE(sources[i]->read(page(static_cast<uint32_t>(i)))); });
  auto ends = shared.waitForSleepers(sources.size());
  shared.advanceTo(1e9);
  for (auto& t : readers) t.join();
  std::sort(ends.begin(), ends.end());
  return ends;
}

TEST(RateLimitedSource, ReadsInFlightShareTheRateAndOverlapTheirLatencies) {
  constexpr RateLimitedSource::Limits kLimits{.bytes_per_s = 1e6, .latency_ms = 100};
  SharedClock shared;
  auto inner = std::make_shared<SizedSource>(1000);
  RateLimitedSource source(inner, kLimits, 1, shared.clock());
  auto ends = endsOfReadsTogether(std::vector<const RateLimitedSource*>(8, &source), shared);
  for (size_t i = 0; i < ends.size(); ++i) EXPECT_NEAR(ends[i], 0.1 + 0.001 * static_cast<double>(i + 1), 1e-9);
  // Negative control: two lines are twice as fast, and the check sees it.
  SharedClock other;
  RateLimitedSource a(inner, kLimits, 1, other.clock()), b(inner, kLimits, 1, other.clock());
  ends = endsOfReadsTogether({&a, &b, &a, &b, &a, &b, &a, &b}, other);
  EXPECT_NEAR(ends.back(), 0.1 + 0.004, 1e-9);
}

TEST(RateLimitedSource, AnIdleLineIsNotSavedUp) {
  LoneClock lone;
  RateLimitedSource source(std::make_shared<SizedSource>(1000), {.bytes_per_s = 1e6}, 1, lone.clock());
  *lone.now = 500;
  ASSERT_TRUE(source.read(page(1)));
  EXPECT_NEAR(*lone.now, 500.001, 1e-9);
}

TEST(RateLimitedSource, JitterFollowsFromSeedAndPage) {
  auto inner = std::make_shared<SizedSource>(1);
  RateLimitedSource::Limits limits{.latency_ms = 10, .jitter_ms = 40};
  RateLimitedSource a(inner, limits, 1), b(inner, limits, 1), other(inner, limits, 2);
  double sum = 0, low = 1, high = 0;
  int same = 0;
  for (uint32_t i = 0; i < 1000; ++i) {
    double s = a.latency_s(page(i));
    EXPECT_EQ(s, b.latency_s(page(i)));
    same += s == other.latency_s(page(i));
    sum += s, low = std::min(low, s), high = std::max(high, s);
  }
  EXPECT_LT(same, 5);
  EXPECT_NEAR(sum / 1000, 0.030, 0.002);
  EXPECT_GE(low, 0.010);
  EXPECT_LE(high, 0.050);
  EXPECT_GT(high - low, 0.038);
}

// --- faults ---

TEST(FailingSource, WhatGoesWrongFollowsFromSeedPageAndAttempt) {
  auto inner = std::make_shared<SizedSource>(64);
  FailingSource::Rates rates{.fail = 0.1, .truncate = 0.1, .corrupt = 0.1, .permanent = 0.05, .late = 0.1, .late_s = 5};
  auto run = [&](uint64_t seed, bool backwards) {
    LoneClock lone;
    FailingSource source(inner, rates, seed, lone.clock());
    std::map<std::pair<uint32_t, int>, std::string> what;
    for (uint32_t k = 0; k < 2000; ++k) {
      uint32_t i = backwards ? 1999 - k : k;
      for (int attempt = 0; attempt < 3; ++attempt) {
        double before = *lone.now;
        auto read = source.read(page(i));
        auto sound = inner->read(page(i));
        what[{i, attempt}] = !read                         ? "fails"
                             : read->bytes.size() < 64     ? "short"
                             : read->bytes != sound->bytes ? "corrupt"
                             : *lone.now > before          ? "late"
                                                           : "sound";
        EXPECT_TRUE(*lone.now == before || *lone.now == before + 5);
      }
      EXPECT_EQ(source.attempts(page(i)), 3);
    }
    return what;
  };
  auto first = run(1, false);
  EXPECT_EQ(first, run(1, true)) << "the order of reads must not matter";
  EXPECT_NE(first, run(2, false));
  std::map<std::string, int> counts;
  for (auto& [key, what] : first) ++counts[what];
  EXPECT_NEAR(counts["fails"], 6000 * (0.05 + 0.95 * 0.1), 100);
  for (const char* kind : {"short", "corrupt", "late"}) EXPECT_NEAR(counts[kind], 6000 * 0.95 * 0.1, 100) << kind;
}

// Real pages: a flipped bit can decode to wrong texels without a complaint.
struct RealPages {
  std::shared_ptr<MapSource> source = std::make_shared<MapSource>();
  std::map<PageId, std::vector<uint8_t>> texels;
  explicit RealPages(uint32_t count) {
    PageEncoder encoder(1);
    PageDecoder decoder;
    std::mt19937 random(11);
    std::vector<uint8_t> channels(kTexturePageBytes);
    for (uint32_t i = 0; i < count; ++i) {
      for (size_t k = 0; k < channels.size(); ++k) channels[k] = static_cast<uint8_t>(k / 9 + random() % 7);
      auto bytes = encoder.encodeTexture(channels);
      source->pages[page(i)].assign(bytes.begin(), bytes.end());
      texels[page(i)].resize(kSlotBytes);
      EXPECT_TRUE(decoder.decodeToSlot(page(i).plane(), bytes, texels[page(i)]));
    }
  }
  CheckedSource::ChecksumOf checksums() const {
    return [s = source](PageId id) -> std::optional<PageChecksum> {
      auto it = s->pages.find(id);
      if (it == s->pages.end()) return std::nullopt;
      return PageChecksum{XXH3_64bits(it->second.data(), it->second.size())};
    };
  }
  struct Tally {
    int refused_by_source = 0, refused_by_decoder = 0, sound = 0, wrong = 0;
  };
  Tally readAll(const PageSource& from) const {
    Tally tally;
    PageDecoder decoder;
    std::vector<uint8_t> out(kSlotBytes);
    for (const auto& [id, expected] : texels) {
      auto read = from.read(id);
      if (!read) {
        ++tally.refused_by_source;
        EXPECT_NE(read.error().kind, ErrorKind::kInvalidData) << "a fault of the way, which may pass";
      } else if (!decoder.decodeToSlot(id.plane(), read->bytes, out)) {
        ++tally.refused_by_decoder;
      } else {
        ++(out == expected ? tally.sound : tally.wrong);
      }
    }
    return tally;
  }
};

TEST(CheckedSource, NoDamagePassesAsAPage) {
  RealPages real(200);
  for (FailingSource::Rates rates : {FailingSource::Rates{.corrupt = 1}, FailingSource::Rates{.truncate = 1}}) {
    CheckedSource checked(std::make_shared<FailingSource>(real.source, rates, 3), real.checksums());
    auto tally = real.readAll(checked);
    EXPECT_EQ(tally.refused_by_source, 200);
    EXPECT_EQ(checked.caught(), 200u);
  }
  CheckedSource sound(real.source, real.checksums());
  EXPECT_EQ(real.readAll(sound).sound, 200);
  // Negative control: without the check, wrong texels come through.
  FailingSource corrupt(real.source, {.corrupt = 1}, 3);
  auto tally = real.readAll(corrupt);
  EXPECT_GT(tally.wrong, 0) << "the decoder alone sees everything: is the check needed?";
  std::printf("[ sources ] of 200 pages with one flipped bit the decoder alone refuses %d and shows %d wrong\n",
              tally.refused_by_decoder, tally.wrong);
}

TEST(CheckedSource, KnowsAPackagesPages) {
  test::TemporaryFolder folder;
  std::string why;
  auto package = test::noisePackage(folder, 300, 200, Basis::kPtmLrgb, 5, 4, &why);
  ASSERT_TRUE(package) << why;
  auto checksums = checksumsOf(package);
  PageId there(texturePlane(1), {0, 1, 0, 0}), relief(Plane::kRelief, {0, 0, 0, 0}),
      missing(texturePlane(0), {0, 9, 0, 0});
  for (PageId id : {there, relief}) {
    auto read = package->read(id);
    ASSERT_TRUE(read);
    const auto expected = checksums(id);
    ASSERT_TRUE(expected);
    EXPECT_EQ(expected->value, XXH3_64bits(read->bytes.data(), read->bytes.size()));
  }
  EXPECT_FALSE(checksums(missing));
  CheckedSource checked(package, checksums);
  EXPECT_EQ(checked.read(missing).error().kind, ErrorKind::kInvalidData) << "that there is no such page is not hidden";
}

TEST(SimulatedStorage, StacksOnlyWhatIsAskedFor) {
  test::TemporaryFolder folder;
  std::string why;
  auto package = test::noisePackage(folder, 300, 200, Basis::kPtmLrgb, 0, 4, &why);
  ASSERT_TRUE(package) << why;
  EXPECT_EQ(withSimulatedStorage(package, {}), package);
  LoneClock lone;
  PageId root(texturePlane(0), {0, 0, 0, 0});
  auto bytes = package->read(root)->bytes;
  auto slow = withSimulatedStorage(package, {.rate_mb_per_s = 2, .latency_ms = 20}, lone.clock());
  ASSERT_TRUE(slow->read(root));
  EXPECT_NEAR(*lone.now, 100 + static_cast<double>(bytes.size()) / 2e6 + 0.02, 1e-9);
  auto kept = withSimulatedStorage(package, {.latency_ms = 20, .memory_mib = 1}, lone.clock());
  ASSERT_TRUE(kept->read(root));
  double once = *lone.now;
  ASSERT_TRUE(kept->read(root));
  EXPECT_EQ(*lone.now, once) << "the second read comes from memory";
  // Everything goes wrong: what passes is late, and sound.
  int passed = 0;
  for (uint64_t seed = 1; seed <= 100; ++seed) {
    auto bad = withSimulatedStorage(package, {.fail_percent = 100, .seed = seed}, lone.clock());
    double before = *lone.now;
    auto read = bad->read(root);
    if (!read) continue;
    ++passed;
    EXPECT_EQ(read->bytes, bytes);
    EXPECT_EQ(*lone.now, before + SimulatedStorage::kLateS);
  }
  EXPECT_GT(passed, 10);
  EXPECT_LT(passed, 45);
}

TEST(SteadyClock, ASleeperEndsWhenItIsTold) {
  std::atomic<bool> stop{false};
  SourceClock clock = steadyClock(&stop);
  std::thread sleeper([&] { clock.sleepUntil(clock.now_s() + 1e9); });
  stop = true;
  sleeper.join();  // the test program's time limit is the check
  double start = clock.now_s();
  steadyClock().sleepUntil(start + 0.002);
  EXPECT_GE(clock.now_s(), start + 0.002);
}

// --- traces ---

TEST(RecordingSource, ListsReadsInTheOrderInWhichTheyBeganWithSizes) {
  auto map = std::make_shared<MapSource>();
  for (uint32_t i = 0; i < 3; ++i) map->pages[page(i)].resize(10 + i);
  auto gate = std::make_shared<GatedSource>(map);
  RecordingSource record(gate);
  std::thread slow([&] { EXPECT_TRUE(record.read(page(2))); });
  gate->waitForReaders(1);
  EXPECT_EQ(record.trace(), (std::vector<PageRead>{{page(2), 0}})) << "still under way";
  gate->open();
  slow.join();
  EXPECT_TRUE(record.read(page(0)));
  EXPECT_FALSE(record.read(page(9)));
  EXPECT_EQ(record.trace(), (std::vector<PageRead>{{page(2), 12}, {page(0), 10}, {page(9), 0}}));
  EXPECT_EQ(record.reads(), (std::vector<PageId>{page(2), page(0), page(9)}));
}

TEST(Trace, ComesBackFromItsFile) {
  test::TemporaryFolder folder;
  std::mt19937 random(5);
  std::vector<PageRead> reads;
  for (int i = 0; i < 500; ++i) {
    uint32_t level = random() % (kMaxNodeLevel + 1), mask = (1u << level) - 1;
    NodeId node{static_cast<uint32_t>(random() % kMaxPatches), level, static_cast<uint32_t>(random()) & mask,
                static_cast<uint32_t>(random()) & mask};
    reads.push_back({PageId(static_cast<Plane>(random() % 31), node), static_cast<uint32_t>(random())});
  }
  ASSERT_TRUE(writeTrace(folder.file("t"), reads));
  auto back = readTrace(folder.file("t"));
  ASSERT_TRUE(back) << back.error().text();
  EXPECT_EQ(*back, reads);
  ASSERT_TRUE(writeTrace(folder.file("t"), {}));
  back = readTrace(folder.file("t"));
  ASSERT_TRUE(back);
  EXPECT_TRUE(back->empty());
}

TEST(Trace, BadFilesAreNamedWithTheirLine) {
  test::TemporaryFolder folder;
  auto read = [&](const std::string& text) {
    std::ofstream(folder.file("t"), std::ios::binary) << text;
    return readTrace(folder.file("t"));
  };
  const std::string head = "relievo-trace 1\n", good = "0 0 3 7 7 1234\n";
  ASSERT_TRUE(read(head + good));
  for (const char* bad :
       {"0 0 3 7 7\n", "0 0 3 7 7 1 2\n", "0 0 3 8 7 1\n", "0 0 18 0 0 1\n", "31 0 0 0 0 1\n", "0 1048576 0 0 0 1\n",
        "-1 0 0 0 0 1\n", "0 0 0 0 0 4294967296\n", "x\n", "\n", "0  0 3 7 7 1\n", "0 0 3 7 7 1 \n"}) {
    auto r = read(head + good + bad);
    ASSERT_FALSE(r) << bad;
    EXPECT_EQ(r.error().kind, ErrorKind::kInvalidData);
    EXPECT_NE(r.error().text().find("line 3"), std::string::npos) << r.error().text();
  }
  EXPECT_FALSE(read(""));
  EXPECT_FALSE(read("relievo-trace 2\n" + good));
  EXPECT_EQ(readTrace(folder.file("nowhere")).error().kind, ErrorKind::kIo);
  // Every truncation is refused, or is a shorter trace, or a last number cut short.
  const std::string whole = head + good + good;
  for (size_t n = 0; n < whole.size(); ++n) {
    auto r = read(whole.substr(0, n));
    if (r) {
      EXPECT_LE(r->size(), 2u);
    }
  }
}

}  // namespace page_sources_test
}  // namespace relievo
