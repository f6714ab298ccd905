// The page table: what was entered is found by the shader's two probes, and nothing else is.
#include "texturing/stream/page_table.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <set>
#include <unordered_map>

#include "shaders/page_table.h"

namespace relievo {
namespace page_table_test {

using Texel = std::array<uint32_t, 4>;

// The look-up as the shader does it, from uploaded texels only: written apart from PageTable::find.
struct ShaderView {
  std::vector<Texel> texels, extra;  // extra: planes 3..10 of all entries, then 11..18, and so on
  uint32_t seed = 0;

  // What a renderer does after a frame; the number of texels that it uploads.
  size_t apply(PageTable& table) {
    auto dirty = table.takeDirty();
    texels.resize(table.texels().size());
    extra.resize(table.extraTexels().size());
    for (uint32_t i : dirty) {
      texels[i] = table.texels()[i];
      for (size_t at = i; at < extra.size(); at += texels.size()) extra[at] = table.extraTexels()[at];
    }
    seed = table.seed();
    return dirty.size();
  }
  std::optional<PageTableEntry> find(const NodeId& n) const {
    auto mask = static_cast<uint32_t>(texels.size() - 1);
    uint32_t lo = n.y | n.x << 17, hi = n.x >> 15 | n.patch << 2 | n.level << 22;
    lo += 1;
    if (lo == 0) hi += 1;
    uint32_t h = shader::pageHash(lo, hi, seed);
    for (uint32_t i : {shader::pageProbe0(h, mask), shader::pageProbe1(h, mask)}) {
      const Texel& t = texels[i];
      if (t[0] != lo || t[1] != hi) continue;
      PageTableEntry entry;
      entry.birth = static_cast<uint16_t>(t[3] >> 16);
      entry.slots = {static_cast<uint16_t>(t[2]), static_cast<uint16_t>(t[2] >> 16), static_cast<uint16_t>(t[3])};
      for (size_t plane = 3; plane < entry.slots.size(); ++plane) {
        const size_t half = plane - 3;  // of a component: sixteen bits
        entry.slots[plane] =
            static_cast<uint16_t>(extra[i + half / 8 * texels.size()][half % 8 / 2] >> (half % 2 == 0 ? 0 : 16));
      }
      return entry;
    }
    return std::nullopt;
  }
};

PageTableEntry entryOf(uint64_t salt) {
  std::mt19937_64 random(salt);
  PageTableEntry e;
  for (auto& s : e.slots) s = static_cast<uint16_t>(random());
  e.birth = static_cast<uint16_t>(random());
  return e;
}
bool same(const std::optional<PageTableEntry>& a, const std::optional<PageTableEntry>& b) {
  return a.has_value() == b.has_value() && (!a || (a->slots == b->slots && a->birth == b->birth));
}

NodeId randomNode(std::mt19937_64& random, uint32_t patches) {
  auto level = static_cast<uint32_t>(random() % (kMaxNodeLevel + 1));
  auto mask = (1u << level) - 1;
  return {static_cast<uint32_t>(random() % patches), level, static_cast<uint32_t>(random()) & mask,
          static_cast<uint32_t>(random()) & mask};
}

TEST(PageTable, ShapeIsAPowerOfTwoAtALoadOfAtMostTwoFifths) {
  for (uint32_t nodes : {0u, 1u, 6u, 7u, 100u, 409u, 410u, 1024u, 21845u, 65536u}) {
    PageTable table(nodes);
    uint64_t entries = uint64_t{table.width()} * table.height();
    EXPECT_EQ(entries & (entries - 1), 0u);
    EXPECT_EQ(table.width() & (table.width() - 1), 0u);
    EXPECT_LE(table.width(), 1024u);
    EXPECT_LE(nodes, 0.4 * entries);
    EXPECT_LE(entries, std::max<uint64_t>(16, 5 * uint64_t{nodes} + 5)) << "and not larger than needed";
    EXPECT_EQ(table.texels().size(), entries);
    EXPECT_EQ(table.extraTexels().size(), table.extraLayers() * entries);
  }
}

// Entries come and go at full load; the shader's view agrees with a map after every frame. `lost` drops one dirty
// texel.
std::string compareWithMap(uint64_t seed, uint32_t capacity, int frames, bool lost) {
  std::mt19937_64 random(seed);
  PageTable table(capacity);
  ShaderView view;
  view.apply(table);
  std::unordered_map<NodeId, PageTableEntry> model;
  std::vector<NodeId> order;
  for (int frame = 0; frame < frames; ++frame) {
    for (int op = 0; op < 20; ++op) {
      if (!order.empty() && (order.size() == capacity || random() % 3 == 0)) {
        size_t i = random() % order.size();
        table.erase(order[i]);
        model.erase(order[i]);
        order[i] = order.back();
        order.pop_back();
      } else {
        NodeId node = order.empty() || random() % 8 ? randomNode(random, 1 + capacity) : order[random() % order.size()];
        PageTableEntry entry = entryOf(random());
        if (model.insert_or_assign(node, entry).second) order.push_back(node);
        table.insert(node, entry);
      }
      table.erase(randomNode(random, 7u << 16));  // most likely absent: nothing happens
    }
    for (const NodeId& n : order)
      if (!table.find(n)) {  // the erase above hit a real one
        model.erase(n);
      }
    std::erase_if(order, [&](const NodeId& n) { return !model.contains(n); });
    if (lost && frame == frames / 2) {
      table.takeDirty();
    } else {
      view.apply(table);
    }
    if (table.size() != model.size()) return "frame " + std::to_string(frame) + ": different sizes";
    for (const auto& [node, entry] : model)
      if (!same(view.find(node), entry) || !same(table.find(node), entry))
        return "frame " + std::to_string(frame) + ": a node differs";
    for (int i = 0; i < 50; ++i) {
      NodeId node = randomNode(random, 1 + capacity);
      if (!model.contains(node) && (view.find(node) || table.find(node)))
        return "frame " + std::to_string(frame) + ": a ghost";
    }
  }
  return {};
}

TEST(PageTable, TheShadersViewAgreesWithAMap) {
  for (uint64_t seed = 1; seed <= 30; ++seed) {
    auto capacity = static_cast<uint32_t>(seed <= 20 ? 1 + seed * 3 : 40 * seed);
    ASSERT_EQ(compareWithMap(seed, capacity, 120, false), "") << "seed " << seed;
  }
}

TEST(PageTable, TheComparisonSeesALostUpdate) { EXPECT_NE(compareWithMap(5, 300, 60, true), ""); }

TEST(PageTable, UpToThreePlanesNeedNoSecondTexture) {
  for (int planes = 1; planes <= kMaxTexturePlanes; ++planes) {
    PageTable table(50, planes);
    const size_t layers = planes <= 3 ? 0 : planes <= 11 ? 1 : planes <= 19 ? 2 : planes <= 27 ? 3 : 4;
    EXPECT_EQ(table.extraTexels().size(), layers * table.texels().size());
    EXPECT_EQ(table.texelBytes(), (table.texels().size() + table.extraTexels().size()) * 16);
    std::mt19937_64 random(planes);
    std::vector<NodeId> nodes;
    for (uint32_t i = 0; i < 50; ++i) {
      nodes.push_back({i, 17, static_cast<uint32_t>(random()) >> 15, static_cast<uint32_t>(random()) >> 15});
      table.insert(nodes.back(), entryOf(i));
    }
    for (uint32_t i = 0; i < 50; ++i) {
      auto found = table.find(nodes[i]);
      ASSERT_TRUE(found);
      EXPECT_EQ(found->birth, entryOf(i).birth);
      for (int k = 0; k < planes; ++k) EXPECT_EQ(found->slots[k], entryOf(i).slots[k]);
    }
  }
}

TEST(PageTable, KeyHalvesCarry) {
  // x's low 15 bits and y all ones: key + 1 carries into the high half.
  PageTable table(4);
  NodeId node{3, 17, 0x7FFF, 0x1FFFF};
  ASSERT_EQ(static_cast<uint32_t>(packNode(node)), 0xFFFFFFFFu);
  table.insert(node, entryOf(1));
  ShaderView view;
  view.apply(table);
  EXPECT_TRUE(same(view.find(node), entryOf(1)));
  EXPECT_FALSE(view.find({3, 17, 0x8000, 0x1FFFF}));
  PageTable all(4);
  NodeId first{0, 0, 0, 0};
  all.insert(first, entryOf(2));
  EXPECT_TRUE(same(all.find(first), entryOf(2))) << "the key 0 is not the empty key";
}

// A screen's worth of neighbouring nodes: the keys that really occur, and the hardest for a weak hash.
std::vector<NodeId> neighbours(uint32_t count) {
  std::vector<NodeId> nodes;
  for (uint32_t level = 0; level <= kMaxNodeLevel; ++level) {
    uint32_t side = std::min(1u << level, 64u), first = ((1u << level) - side) / 2;
    for (uint32_t y = 0; y < side; ++y)
      for (uint32_t x = 0; x < side && nodes.size() < count; ++x) nodes.push_back({0, level, first + x, first + y});
  }
  for (uint32_t patch = 1; nodes.size() < count; ++patch) nodes.push_back({patch, 0, 0, 0});
  return nodes;
}

TEST(PageTable, UpdatesAreProportionalToWhatChanged) {
  auto nodes = neighbours(40000);
  PageTable table(40000);
  ShaderView view;
  EXPECT_EQ(view.apply(table), table.texels().size()) << "all of them at first";
  EXPECT_EQ(view.apply(table), 0u);
  size_t rehashes = 0, texels = 0, frames = 0;
  for (size_t i = 0; i < nodes.size();) {
    uint32_t seed = table.seed();
    for (int k = 0; k < 8 && i < nodes.size(); ++k, ++i) table.insert(nodes[i], entryOf(i));
    size_t changed = view.apply(table);
    if (table.seed() != seed) {
      ++rehashes;
      EXPECT_EQ(changed, table.texels().size());
    } else {
      texels += changed;
      ++frames;
    }
  }
  EXPECT_LE(rehashes, 2u);
  EXPECT_LE(static_cast<double>(texels) / frames / 8, 2.0) << "texels for each node entered";
  for (size_t i = 0; i < nodes.size(); ++i) ASSERT_TRUE(same(view.find(nodes[i]), entryOf(i)));
  for (size_t i = 0; i < nodes.size(); ++i) {
    table.erase(nodes[i]);
    ASSERT_EQ(view.apply(table), 1u);
  }
  EXPECT_EQ(table.size(), 0u);
  for (const Texel& t : view.texels) ASSERT_EQ(t[0] | t[1], 0u);
}

TEST(PageTable, DirtyTexelsAreAscendingAndNamedOnce) {
  PageTable table(500);
  table.takeDirty();
  for (uint32_t i = 0; i < 100; ++i)
    for (int twice = 0; twice < 2; ++twice) table.insert({i % 10, 4, i / 10, 3}, entryOf(i + twice));
  auto dirty = table.takeDirty();
  EXPECT_TRUE(std::is_sorted(dirty.begin(), dirty.end()));
  EXPECT_EQ(std::adjacent_find(dirty.begin(), dirty.end()), dirty.end());
  EXPECT_LT(dirty.size(), 250u);
}

// Small tables loop often: a rehash finds another seed, and everything is still there.
TEST(PageTable, RehashesKeepEverything) {
  constexpr int kNodes = 12;
  int rehashes = 0;
  for (uint64_t seed = 1; seed <= 4000; ++seed) {
    std::mt19937_64 random(seed);
    PageTable table(kNodes);  // 32 cells
    ShaderView view;
    std::vector<NodeId> nodes;
    uint32_t first = table.seed();
    for (int i = 0; i < kNodes; ++i) {
      nodes.push_back(randomNode(random, 1000));
      table.insert(nodes.back(), entryOf(seed * 100 + i));
      // Whatever moved, what was uploaded is what the table has: a cell left over from before a rehash may be some
      // node's other probe.
      view.apply(table);
      ASSERT_TRUE(std::ranges::equal(view.texels, table.texels()) &&
                  std::ranges::equal(view.extra, table.extraTexels()))
          << "seed " << seed << ", node " << i;
    }
    rehashes += table.seed() != first;
    for (int i = 0; i < kNodes; ++i) ASSERT_TRUE(same(view.find(nodes[i]), entryOf(seed * 100 + i))) << "seed " << seed;
  }
  EXPECT_GT(rehashes, 0) << "this test saw no rehash";
  EXPECT_LT(rehashes, 400);
}

// Pearson's chi-square of counts against the same expectation everywhere, in standard deviations from its mean.
double chiSquareSigma(const std::vector<uint32_t>& counts, double total) {
  double expected = total / counts.size(), chi2 = 0;
  for (uint32_t c : counts) chi2 += (c - expected) * (c - expected) / expected;
  double dof = counts.size() - 1.0;
  return (chi2 - dof) / std::sqrt(2 * dof);
}

using Hash = std::pair<uint32_t, uint32_t> (*)(uint64_t key, uint32_t seed, uint32_t mask);
std::pair<uint32_t, uint32_t> ours(uint64_t key, uint32_t seed, uint32_t mask) {
  uint32_t h = shader::pageHash(static_cast<uint32_t>(key), static_cast<uint32_t>(key >> 32), seed);
  return {shader::pageProbe0(h, mask), shader::pageProbe1(h, mask)};
}
std::pair<uint32_t, uint32_t> weak(uint64_t key, uint32_t seed, uint32_t mask) {
  auto h = static_cast<uint32_t>((key >> 32) * 0x85EBCA77u) ^ static_cast<uint32_t>(key) * 0x9E3779B1u ^ seed;
  return {h & mask, (h >> 7) & mask};
}

// The largest deviation over tables and seeds: each probe alone, and the two together in 32 x 32 boxes.
double worstSigma(Hash hash, const std::vector<NodeId>& nodes) {
  double worst = 0;
  for (uint32_t mask : {0xFFFu, 0x1FFFFu})
    for (uint32_t seed : {1u, 0x12345678u, 0xFFFFFFFFu, 77u}) {
      std::vector<uint32_t> first(1024), second(1024), low(1024), pair(1024);
      for (const NodeId& n : nodes) {
        auto [a, b] = hash(packNode(n) + 1, seed, mask);
        uint64_t cells = uint64_t{mask} + 1;
        ++first[a * 1024ull / cells];
        ++second[b * 1024ull / cells];
        ++low[b & 1023];
        ++pair[(a * 32ull / cells) * 32 + b * 32ull / cells];
      }
      for (const auto* counts : {&first, &second, &low, &pair})
        worst = std::max(worst, chiSquareSigma(*counts, nodes.size()));
    }
  return worst;
}

TEST(PageTableHash, ProbesAreUniformAndIndependentOnNeighbouringNodes) {
  auto nodes = neighbours(40000);
  EXPECT_LT(worstSigma(ours, nodes), 5.0);
  EXPECT_GT(worstSigma(weak, nodes), 20.0) << "the check does not see a bad hash";
}

TEST(PageTableHash, TheTwoProbesAreNeverTheSameCell) {
  std::mt19937_64 random(3);
  for (int i = 0; i < 200000; ++i) {
    auto mask = (2u << (random() % 18)) - 1;
    auto [a, b] = ours(random(), static_cast<uint32_t>(random()), mask);
    ASSERT_NE(a, b);
    ASSERT_LE(a, mask);
    ASSERT_LE(b, mask);
  }
}

TEST(PageTableHash, EachKeyBitAndSeedBitFlipsHalfOfTheHash) {
  std::mt19937_64 random(4);
  for (int bit = 0; bit < 59 + 32; ++bit) {
    double flips = 0;
    constexpr int kTrials = 4000;
    for (int i = 0; i < kTrials; ++i) {
      uint64_t key = random() >> 5;
      auto seed = static_cast<uint32_t>(random());
      auto lo = static_cast<uint32_t>(key), hi = static_cast<uint32_t>(key >> 32);
      uint64_t other = bit < 59 ? key ^ (uint64_t{1} << bit) : key;
      uint32_t other_seed = bit < 59 ? seed : seed ^ (1u << (bit - 59));
      flips +=
          std::popcount(shader::pageHash(lo, hi, seed) ^
                        shader::pageHash(static_cast<uint32_t>(other), static_cast<uint32_t>(other >> 32), other_seed));
    }
    // Standard deviation of the mean: sqrt(32 / 4 / trials) = 0.045.
    EXPECT_NEAR(flips / kTrials, 16.0, 0.4) << "bit " << bit;
  }
}

// Keys that collide under one seed must not under another, or a rehash could never end.
TEST(PageTableHash, AnotherSeedSeparatesWhatCollided) {
  std::unordered_map<uint32_t, uint64_t> seen;
  std::mt19937_64 random(5);
  int collisions = 0;
  for (int i = 0; i < 400000; ++i) {
    uint64_t key = random() >> 5;
    auto hash = [](uint64_t k, uint32_t seed) {
      return shader::pageHash(static_cast<uint32_t>(k), static_cast<uint32_t>(k >> 32), seed);
    };
    auto [it, is_new] = seen.emplace(hash(key, 1), key);
    if (is_new || it->second == key) continue;
    ++collisions;
    EXPECT_NE(hash(key, 2), hash(it->second, 2));
  }
  EXPECT_GT(collisions, 5) << "about 19 are expected";
}

}  // namespace page_table_test
}  // namespace relievo
