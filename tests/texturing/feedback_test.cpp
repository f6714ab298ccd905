// Feedback analysis: what the pixels want, in the order of request, against a naive count.
#include "texturing/stream/feedback.h"
#include "texturing/stream/request_memory.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <set>

namespace relievo {
namespace feedback_test {

using Pixel = std::array<uint32_t, 4>;
constexpr Pixel kBackground{};

Pixel pixelOf(const NodeId& n, bool coarser_too = false) {
  return {1u | n.level << 8 | (coarser_too ? 1u << 16 : 0u), n.patch, n.x, n.y};
}

struct Expected {
  uint32_t pixels = 0;
  double distance = 2;
};
// Every pixel alone, every ancestor, nothing clever.
std::map<NodeId, Expected> naive(const std::vector<Pixel>& pixels, int width, int height) {
  std::map<NodeId, Expected> nodes;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const Pixel& p = pixels[size_t(y) * width + x];
      NodeId n{p[1], (p[0] >> 8) & 0xFF, p[2], p[3]};
      bool valid = (p[0] & 0xFF) == 1 && p[0] < (1u << 17) && n.level <= 17 && n.patch < (1u << 20) &&
                   n.x < (uint64_t{1} << n.level) && n.y < (uint64_t{1} << n.level);
      if (!valid) continue;
      double d = std::hypot(x + 0.5 - width / 2.0, y + 0.5 - height / 2.0) / std::hypot(width / 2.0, height / 2.0);
      ++nodes[n].pixels;
      if ((p[0] >> 16) && n.level > 0) ++nodes[n.parent()].pixels;
      for (uint32_t l = 0; l <= n.level; ++l) {
        Expected& e = nodes[n.ancestor(l)];
        e.distance = std::min(e.distance, d);
      }
    }
  return nodes;
}

std::string compare(std::span<const NodeRequest> requests, const std::map<NodeId, Expected>& expected) {
  if (requests.size() != expected.size())
    return std::to_string(requests.size()) + " nodes, expected " + std::to_string(expected.size());
  std::set<NodeId> seen;
  for (size_t i = 0; i < requests.size(); ++i) {
    const NodeRequest& w = requests[i];
    if (!seen.insert(w.node).second) return "a node is named twice";
    auto it = expected.find(w.node);
    if (it == expected.end()) return "a node that no pixel wants";
    if (w.pixels != it->second.pixels) return "wrong number of pixels";
    if (std::abs(w.centre_distance - it->second.distance) > 1e-6) return "wrong distance";
    if (w.node.level > 0 && !seen.contains(w.node.parent())) return "a node before its parent";
    if (i == 0) continue;
    const NodeRequest& v = requests[i - 1];
    if (v.node.level > w.node.level || (v.node.level == w.node.level && v.centre_distance > w.centre_distance))
      return "not in the order of request";
  }
  return {};
}

// A view of an inclined plane, about as a feedback pass renders it.
std::vector<Pixel> inclinedView(int width, int height, uint32_t depth) {
  std::vector<Pixel> pixels(size_t(width) * height);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      if (x < width / 16) continue;  // background
      double distance = 1.0 + 6.0 * y / height;
      double u = (0.5 + (double(x) / width - 0.5) * 0.05 * distance), v = 0.4 + 0.1 * y / height;
      auto level = static_cast<uint32_t>(std::clamp(depth - std::log2(distance), 0.0, double(depth)));
      double side = std::ldexp(1.0, static_cast<int>(level));
      pixels[size_t(y) * width + x] =
          pixelOf({7, level, static_cast<uint32_t>(u * side), static_cast<uint32_t>(v * side)}, (x * 7 + y) % 5 == 0);
    }
  return pixels;
}

TEST(Feedback, AnInclinedViewAgreesWithANaiveCount) {
  FeedbackAnalyzer analyzer;
  for (auto [w, h] : {std::pair{160, 90}, {1, 1}, {7, 3}, {320, 200}}) {
    auto pixels = inclinedView(w, h, 9);
    EXPECT_EQ(compare(analyzer.analyze(pixels, w, h), naive(pixels, w, h)), "");
  }
}

TEST(Feedback, TheComparisonSeesErrors) {
  FeedbackAnalyzer analyzer;
  auto pixels = inclinedView(160, 90, 9);
  auto requests = analyzer.analyze(pixels, 160, 90);
  auto expected = naive(pixels, 160, 90);
  std::vector<NodeRequest> broken(requests.begin(), requests.end() - 1);
  EXPECT_NE(compare(broken, expected), "") << "a node lost";
  broken.assign(requests.begin(), requests.end());
  std::swap(broken.front(), broken.back());
  EXPECT_NE(compare(broken, expected), "") << "order";
  broken.assign(requests.begin(), requests.end());
  broken[3].pixels += 1;
  EXPECT_NE(compare(broken, expected), "") << "count";
}

TEST(Feedback, CentreIsNearAndCornersAreFar) {
  FeedbackAnalyzer analyzer;
  std::vector<Pixel> pixels(101 * 51, kBackground);
  pixels[25 * 101 + 50] = pixelOf({0, 3, 1, 1});
  pixels[0] = pixelOf({0, 3, 7, 7});
  auto requests = analyzer.analyze(pixels, 101, 51);
  ASSERT_EQ(requests.size(), 7u);  // the root is common
  EXPECT_EQ(requests[5].node, (NodeId{0, 3, 1, 1}));
  EXPECT_EQ(requests[5].centre_distance, 0.0f);
  EXPECT_EQ(requests[6].node, (NodeId{0, 3, 7, 7}));
  EXPECT_GT(requests[6].centre_distance, 0.98f);
  EXPECT_LE(requests[6].centre_distance, 1.0f);
  EXPECT_EQ(requests[0].centre_distance, 0.0f) << "an ancestor is as near as the nearest that wants it";
  EXPECT_EQ(requests[0].pixels, 0u);
}

// As near to the centre as pixel centres get: half a pixel where the width is even, and of equal nodes the order of
// their names.
TEST(Feedback, TheMiddleOfARunAndTheOrderOfEqualsAreExact) {
  FeedbackAnalyzer analyzer;
  const std::vector<Pixel> four(4, pixelOf({0, 0, 0, 0})), five(5, pixelOf({0, 0, 0, 0}));
  EXPECT_FLOAT_EQ(analyzer.analyze(four, 4, 1)[0].centre_distance, static_cast<float>(std::sqrt(1.0 / (4 * 4 + 1))));
  EXPECT_EQ(analyzer.analyze(five, 5, 1)[0].centre_distance, 0.0f);
  const NodeId low{0, 1, 0, 1}, high{0, 1, 1, 0};
  ASSERT_LT(packNode(low), packNode(high));
  for (const bool swapped : {false, true}) {
    std::vector<Pixel> pixels(4, kBackground);
    pixels[swapped ? 3 : 0] = pixelOf(low), pixels[swapped ? 0 : 3] = pixelOf(high);
    const auto requests = analyzer.analyze(pixels, 4, 1);
    ASSERT_EQ(requests.size(), 3u);
    EXPECT_EQ(requests[1].node, low) << swapped;
    EXPECT_EQ(requests[2].node, high) << swapped;
  }
}

TEST(Feedback, NothingInNothingOut) {
  FeedbackAnalyzer analyzer;
  std::vector<Pixel> pixels(160 * 90, kBackground);
  EXPECT_TRUE(analyzer.analyze(pixels, 160, 90).empty());
  EXPECT_TRUE(analyzer.analyze({}, 0, 0).empty());
  EXPECT_TRUE(analyzer.analyze({}, 160, 90).empty()) << "fewer pixels than said";
  EXPECT_TRUE(analyzer.analyze(pixels, -4, 90).empty());
  pixels[0] = pixelOf({0, 0, 0, 0}, true);
  EXPECT_EQ(analyzer.analyze(pixels, 160, 90).size(), 1u) << "a root has no parent";
}

TEST(Feedback, NamesOutsideEveryTreeAreDropped) {
  FeedbackAnalyzer analyzer;
  std::vector<Pixel> bad = {{1 | 18u << 8, 0, 0, 0},
                            {1 | 31u << 8, 0, 0, 0},
                            {1 | 255u << 8, 0, 0, 0},
                            {1 | 3u << 8, 0, 8, 0},
                            {1 | 3u << 8, 0, 0, 8},
                            {1, 1u << 20, 0, 0},
                            {2, 0, 0, 0},
                            {1 | 1u << 17, 0, 0, 0},
                            {0xFFFFFFFF, 0xFFFFFFFF, 0xFFFFFFFF, 0xFFFFFFFF},
                            {1 | 17u << 8, 0, 1u << 17, 0}};
  for (const Pixel& p : bad) EXPECT_TRUE(analyzer.analyze({&p, 1}, 1, 1).empty()) << p[0];
  std::vector<Pixel> good = {{1 | 17u << 8, (1u << 20) - 1, (1u << 17) - 1, (1u << 17) - 1}};
  EXPECT_EQ(analyzer.analyze(good, 1, 1).size(), 18u);
}

TEST(Feedback, GarbageNeitherCrashesNorFloods) {
  FeedbackAnalyzer analyzer;
  std::mt19937_64 random(11);
  for (int round = 0; round < 8; ++round) {
    std::vector<Pixel> pixels(640 * 360);
    for (Pixel& p : pixels) {
      for (uint32_t& v : p) v = static_cast<uint32_t>(random());
      if (round % 2 == 0) {  // well-formed, yet all different: the worst that there can be
        uint32_t level = random() % 18;
        p = pixelOf({p[1] & 0xFFFFFu, level, p[2] & ((1u << level) - 1), p[3] & ((1u << level) - 1)}, p[0] & 1);
      }
    }
    auto requests = analyzer.analyze(pixels, 640, 360);
    EXPECT_LE(requests.size(), kMaxRequests);
    EXPECT_TRUE(round % 2 == 1 || requests.size() > kMaxRequests - 32);
    std::set<NodeId> seen;
    for (const NodeRequest& w : requests) {
      ASSERT_TRUE(w.node.level == 0 || seen.contains(w.node.parent()));
      ASSERT_TRUE(seen.insert(w.node).second);
    }
  }
  auto pixels = inclinedView(160, 90, 9);
  EXPECT_EQ(compare(analyzer.analyze(pixels, 160, 90), naive(pixels, 160, 90)), "") << "and recovers";
}

// ---- offsets
TEST(FeedbackOffset, EveryPixelOfABlockOnceInScaleSquaredTurns) {
  for (int scale = 1; scale <= kMaxFeedbackScale; ++scale) {
    std::set<std::pair<int, int>> seen;
    for (int turn = 0; turn < scale * scale; ++turn) {
      FeedbackOffset o = feedbackOffset(scale, static_cast<uint64_t>(turn));
      ASSERT_TRUE(o.x >= 0 && o.y >= 0 && o.x < scale && o.y < scale);
      ASSERT_TRUE(seen.insert({o.x, o.y}).second) << "scale " << scale << " turn " << turn;
    }
    FeedbackOffset again = feedbackOffset(scale, static_cast<uint64_t>(scale * scale)),
                   first = feedbackOffset(scale, 0);
    EXPECT_EQ(again.x, first.x);
    EXPECT_EQ(again.y, first.y);
    EXPECT_EQ(first.x, scale / 2);
  }
}

// The largest distance of a pixel to the nearest sample after some turns, blocks repeating on all sides.
double largestHole(int scale, int turns, bool in_rows) {
  double largest = 0;
  for (int y = 0; y < scale; ++y)
    for (int x = 0; x < scale; ++x) {
      double nearest = 1e9;
      for (int t = 0; t < turns; ++t) {
        FeedbackOffset o =
            in_rows ? FeedbackOffset{t % scale, t / scale} : feedbackOffset(scale, static_cast<uint64_t>(t));
        int dx = std::abs(o.x - x), dy = std::abs(o.y - y);
        nearest = std::min(nearest, std::hypot(std::min(dx, scale - dx), std::min(dy, scale - dy)));
      }
      largest = std::max(largest, nearest);
    }
  return largest;
}
TEST(FeedbackOffset, EveryBeginningIsSpread) {
  for (int scale : {4, 8, 16}) {
    for (int turns : {2, 4, 8, 16}) {
      // Samples on a square grid would leave holes of scale / sqrt(2 turns).
      EXPECT_LE(largestHole(scale, turns, false), 1.5 * scale / std::sqrt(2.0 * turns) + 0.01)
          << scale << ", " << turns;
    }
    if (scale == 4) continue;
    EXPECT_GT(largestHole(scale, scale, true), 1.5 * scale / std::sqrt(2.0 * scale)) << "negative control: row by row";
  }
}

// ---- memory
std::vector<NodeRequest> chain(NodeId node, float distance) {
  std::vector<NodeRequest> requests;
  for (uint32_t level = 0; level <= node.level; ++level)
    requests.push_back({node.ancestor(level), level == node.level, distance});
  return requests;
}
bool has(std::span<const NodeRequest> requests, const NodeId& node) {
  return std::any_of(requests.begin(), requests.end(), [&](const NodeRequest& w) { return w.node == node; });
}

TEST(RequestMemory, AStillViewRemembersUntilEveryPixelWasSeenAgain) {
  RequestMemory memory;
  const NodeId thin{0, 5, 3, 7}, wide{0, 5, 20, 7};
  memory.add(chain(thin, 0.5f), 1, 64);
  for (int k = 1; k < 64; ++k) ASSERT_TRUE(has(memory.add(chain(wide, 0.2f), 1, 64), thin)) << k;
  auto after = memory.add(chain(wide, 0.2f), 1, 64);
  EXPECT_FALSE(has(after, thin)) << "64 results later nothing asks for it";
  EXPECT_EQ(after.size(), 6u);
}

TEST(RequestMemory, AMovedViewRemembersAFewResults) {
  RequestMemory memory;
  const NodeId old{0, 5, 3, 7}, now{0, 5, 20, 7};
  for (int k = 0; k < 10; ++k) memory.add(chain(old, 0.5f), 1, 64);
  uint64_t view = 1;
  for (uint32_t k = 1; k < kMovingResults; ++k) EXPECT_TRUE(has(memory.add(chain(now, 0.2f), ++view, 64), old));
  EXPECT_FALSE(has(memory.add(chain(now, 0.2f), ++view, 64), old));
  // Standing still again brings nothing back, and forgets nothing of the new view.
  for (int k = 0; k < 20; ++k) memory.add(chain(old, 0.5f), view, 64);
  EXPECT_TRUE(has(memory.add(chain(old, 0.5f), view, 64), now));
}

TEST(RequestMemory, AgreesWithTheUnionOfTheLastResults) {
  std::mt19937_64 random(12);
  FeedbackAnalyzer analyzer;
  RequestMemory memory;
  std::vector<std::vector<NodeRequest>> results;
  constexpr uint32_t kStill = 9;
  for (int k = 0; k < 200; ++k) {
    std::vector<Pixel> pixels(64);
    for (Pixel& p : pixels) {
      uint32_t level = random() % 6;
      p = pixelOf({static_cast<uint32_t>(random() % 2), level, static_cast<uint32_t>(random()) & ((1u << level) - 1),
                   static_cast<uint32_t>(random()) & ((1u << level) - 1)});
    }
    auto newest = analyzer.analyze(std::span(pixels).first(random() % 65 / 8 * 8), 8, 8);
    results.emplace_back(newest.begin(), newest.end());
    auto requests = memory.add(newest, 77, kStill);
    std::map<NodeId, float> expected;
    for (size_t r = results.size() - std::min<size_t>(results.size(), kStill); r < results.size(); ++r)
      for (const NodeRequest& w : results[r]) expected.emplace(w.node, 2.0f);
    ASSERT_EQ(requests.size(), expected.size()) << k;
    for (size_t i = 0; i < requests.size(); ++i) {
      ASSERT_TRUE(expected.contains(requests[i].node));
      ASSERT_TRUE(i == 0 || std::pair(requests[i - 1].node.level, requests[i - 1].centre_distance) <=
                                std::pair(requests[i].node.level, requests[i].centre_distance));
      ASSERT_TRUE(requests[i].node.level == 0 || has(requests.first(i), requests[i].node.parent()))
          << "closed under parents";
    }
    ASSERT_TRUE(results.size() <= kStill || k < 20 || requests.size() > newest.size())
        << "negative control: the newest alone is less";
  }
}

TEST(RequestMemory, FloodsAreForgotten) {
  RequestMemory memory;
  for (uint32_t k = 0; k < 40; ++k) {
    std::vector<NodeRequest> flood;
    for (uint32_t i = 0; i < 5000; ++i) flood.push_back({{k, 13, i, k}, 1, 0.5f});
    EXPECT_LE(memory.add(flood, 1, 64).size(), kMaxRequests);
  }
  memory.clear();
  EXPECT_EQ(memory.add(chain({0, 3, 1, 1}, 0), 1, 64).size(), 4u);
}

// As large as feedback gets (every pixel of a screen), and again with the scratch memory of the call before, which was
// larger or smaller.
TEST(Feedback, AWholeScreenGivesTheNaiveAnswerWhateverWasAnalysedBefore) {
  FeedbackAnalyzer analyzer;
  std::map<int, size_t> nodes;
  for (auto [w, h] : {std::pair{160, 90}, {1280, 720}, {160, 90}, {1280, 720}}) {
    const auto pixels = inclinedView(w, h, w == 160 ? 5 : 8);  // of a screen: pages of some 128 of its pixels
    const auto requests = analyzer.analyze(pixels, w, h);
    EXPECT_EQ(compare(requests, naive(pixels, w, h)), "") << w << " x " << h;
    EXPECT_TRUE(nodes.emplace(w, requests.size()).first->second == requests.size()) << w << " x " << h;
  }
  EXPECT_GT(nodes[160], 5u);
  EXPECT_GT(nodes[1280], 2 * nodes[160]);
}

}  // namespace feedback_test
}  // namespace relievo
