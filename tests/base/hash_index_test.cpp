// HashIndex and KeyIndex against std::unordered_map, over random sequences of what an owner does: each width of entry,
// hashes that collide, indexes that are full, that grow, that are emptied. The control: indexes with one fault each.
#include "src/base/hash_index.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <functional>
#include <optional>
#include <random>
#include <string>
#include <unordered_map>
#include <vector>

#include "src/base/key_index.h"
#include "tests/view_share.h"

namespace relievo {
namespace hash_index_test {

using Hash = std::function<uint64_t(uint32_t key)>;

struct NamedHash {
  const char* name;
  Hash of;
};
std::vector<NamedHash> hashes() {
  return {{"golden ratio", [](uint32_t key) { return hashOfKey(key); }},
          {"exact", [](uint32_t key) { return exactHash(key); }},
          {"all 0", [](uint32_t) { return uint64_t{0}; }},
          // All at home in the last cell; and for 64-bit entries the bits of a free one, but for the index.
          {"all ones", [](uint32_t) { return ~uint64_t{0}; }},
          {"one of three", [](uint32_t key) { return uint64_t{key % 3} << 62; }},
          {"of the same upper half", [](uint32_t key) { return 0x8000000000000000u | key; }},
          // Nobody at home in the first cells, where those of the last ones go on.
          {"near the end", [](uint32_t key) { return (0xFFFFFFFFu - uint64_t{key} % 5 * 0x08000000u) << 32; }}};
}

// Elements with keys at indices of the owner's choice, as slots of a cache are. Every answer is compared with that of
// the map; the first difference, or nothing.
template <class Index>
class Owner {
 public:
  Owner(uint64_t seed, Hash hash, size_t capacity, bool grows)
      : random_(seed), hash_(std::move(hash)), index_(capacity), grows_(grows) {
    most_ = grows ? 100 : capacity;
    for (auto i = static_cast<uint32_t>(most_ + 3); i-- > 0;) free_.push_back(i);
    keys_.resize(most_ + 3);
  }

  std::string run(int steps) {
    for (int step = 0; step < steps; ++step) {
      // Long stretches of growth and of decline, so that it is often full and often empty.
      const bool fills = step / 300 % 2 == 0;
      const uint32_t dice = upTo(20), key = upTo(static_cast<uint32_t>(2 * most_ + 2));
      std::string wrong = dice < 5                    ? look(key)
                          : dice < (fills ? 17u : 8u) ? add(key)
                          : dice < 19                 ? erase(key)
                          : upTo(20) == 0             ? clear()
                                                      : lookForAll();
      if (wrong.empty() && index_.size() != model_.size()) wrong = "size";
      if (wrong.empty() && asked_in_vain_) wrong = "asks about what is not there";
      if (!wrong.empty()) return "step " + std::to_string(step) + ": " + wrong;
    }
    return lookForAll();
  }
  int timesFull() const { return times_full_; }
  const Index& index() const { return index_; }

 private:
  uint32_t upTo(uint32_t n) { return static_cast<uint32_t>(random_() % n); }
  auto sameAs(uint32_t key) {
    return [this, key](uint32_t i) {
      asked_in_vain_ |= !keys_[i];
      return keys_[i] == key;
    };
  }
  std::string look(uint32_t key) {
    const auto known = model_.find(key);
    const uint32_t found = index_.find(hash_(key), sameAs(key));
    return found == (known == model_.end() ? Index::kNone : known->second) ? "" : "find " + std::to_string(key);
  }
  std::string lookForAll() {
    for (uint32_t key = 0; key < 2 * most_ + 2; ++key)
      if (std::string wrong = look(key); !wrong.empty()) return wrong;
    return {};
  }
  std::string add(uint32_t key) {
    if (grows_) index_.makeRoom([this](uint32_t i) { return hash_(*keys_[i]); });
    const bool full = model_.size() == index_.capacity();
    const uint32_t added = free_.back();
    const uint32_t found = index_.findOrAdd(hash_(key), added, sameAs(key));
    if (const auto known = model_.find(key); known != model_.end())
      return found == known->second ? "" : "add what is there, " + std::to_string(key);
    if (full) {
      ++times_full_;
      return found == Index::kNone ? "" : "add beyond the capacity";
    }
    if (found != added) return "add " + std::to_string(key);
    model_[key] = added;
    keys_[added] = key;
    free_.pop_back();
    if (free_.size() < 3) return erase(key);
    return {};
  }
  std::string erase(uint32_t key) {
    const auto known = model_.find(key);
    if (known == model_.end()) return {};
    if (std::string wrong = look(key); !wrong.empty()) return wrong;  // it must be there to be erased
    const uint32_t i = known->second;
    index_.erase(hash_(key), i, [this](uint32_t other) { return hash_(*keys_[other]); });
    model_.erase(known);
    keys_[i].reset();
    free_.push_back(i);
    return {};
  }
  std::string clear() {
    if (upTo(2)) index_.clear();
    else index_.reset(index_.capacity());
    for (auto [key, i] : model_) {
      keys_[i].reset();
      free_.push_back(i);
    }
    model_.clear();
    return lookForAll();
  }

  std::mt19937_64 random_;
  Hash hash_;
  Index index_;
  bool grows_;
  size_t most_ = 0;
  int times_full_ = 0;
  bool asked_in_vain_ = false;
  std::vector<std::optional<uint32_t>> keys_;  // by index
  std::vector<uint32_t> free_;
  std::unordered_map<uint32_t, uint32_t> model_;
};

// The first difference over all hashes, capacities and seeds; `each` sees every owner afterwards.
template <class Index>
std::string firstDifference(bool grows, const std::function<void(const Owner<Index>&, size_t)>& each = {}) {
  for (const NamedHash& hash : hashes())
    for (size_t capacity : {0, 1, 2, 3, 7, 20, 61})
      for (uint64_t seed = 1; seed <= (test::longTests() ? 3 : 1); ++seed) {
        Owner<Index> owner(seed, hash.of, capacity, grows);
        if (std::string wrong = owner.run(test::kSanitized ? 1000 : 2000); !wrong.empty())
          return std::string(hash.name) + ", capacity " + std::to_string(capacity) + ", seed " + std::to_string(seed) +
                 ", " + wrong;
        if (each) each(owner, capacity);
      }
  return {};
}

template <class Index>
class HashIndexTest : public testing::Test {};
// 100: the last free cell is the only one.
using Indexes = testing::Types<HashIndex<uint16_t>, HashIndex<uint32_t>, HashIndex<uint64_t>, HashIndex<uint16_t, 67>,
                               HashIndex<uint64_t, 67>, HashIndex<uint16_t, 100>, HashIndex<uint32_t, 100>,
                               HashIndex<uint64_t, 100>>;
TYPED_TEST_SUITE(HashIndexTest, Indexes);

TYPED_TEST(HashIndexTest, AgreesWithAMapAtItsCapacity) {
  EXPECT_EQ(firstDifference<TypeParam>(false,
                                       [](const Owner<TypeParam>& owner, size_t capacity) {
                                         EXPECT_GT(owner.timesFull(), 20);
                                         EXPECT_EQ(owner.index().capacity(), capacity);
                                       }),
            "");
}

TYPED_TEST(HashIndexTest, AgreesWithAMapAsItGrows) {
  EXPECT_EQ(firstDifference<TypeParam>(
                true, [](const Owner<TypeParam>& owner, size_t) { EXPECT_GE(owner.index().capacity(), 96u); }),
            "");
}

TYPED_TEST(HashIndexTest, TakesTheLargestIndex) {
  TypeParam index(2);
  auto never = [](uint32_t) { return false; };
  for (uint64_t hash : {uint64_t{0}, ~uint64_t{0}})
    EXPECT_EQ(index.findOrAdd(hash, TypeParam::kMaxIndex, never), TypeParam::kMaxIndex);
  for (uint64_t hash : {uint64_t{0}, ~uint64_t{0}}) {
    EXPECT_EQ(index.find(hash, [](uint32_t i) { return i == TypeParam::kMaxIndex; }), TypeParam::kMaxIndex);
    EXPECT_EQ(index.find(hash, never), TypeParam::kNone);
  }
  EXPECT_EQ(index.findOrAdd(1, 1, never), TypeParam::kNone) << "full";
}

TEST(HashIndex, KeepsToItsBudget) {
  EXPECT_LE((HashIndex<uint16_t, 67>(65535).bytes()), size_t{3 * 65535});
  EXPECT_LE((HashIndex<uint64_t, 67>(1000000).bytes()), size_t{12 * 1000000});
  EXPECT_LE(HashIndex<uint32_t>(1000).bytes(), size_t{8 * 1000 + 4});
}

// Entries with hashes do not look at elements of another upper half; with exact ones only the right one is asked about.
TEST(HashIndex, EntriesWithHashesPassOthersOver) {
  HashIndex<uint64_t, 100> wide(500);
  HashIndex<uint32_t, 100> narrow(500);
  int asked_wide = 0, asked_narrow = 0;
  for (uint32_t key = 0; key < 500; ++key) {
    wide.findOrAdd(exactHash(key), key, [&](uint32_t) { return ++asked_wide > 0; });
    narrow.findOrAdd(exactHash(key), key, [&](uint32_t i) { return ++asked_narrow < 0 || i == key; });
  }
  EXPECT_EQ(asked_wide, 0);
  EXPECT_GT(asked_narrow, 100) << "control";
  for (uint32_t key = 0; key < 1000; ++key)
    EXPECT_EQ(wide.find(exactHash(key), [&](uint32_t) { return ++asked_wide > 0; }), key < 500 ? key : wide.kNone);
  EXPECT_EQ(asked_wide, 500);
}

// ---- the control

enum class Fault {
  kNone,
  kGapStays,
  kTombstoneFull,
  kHashIsEnough,
  kNoWrap,
  kClearLeavesOne,
  kGrowthForgets,
  kNoLimit
};

// The same in the plainest way, with a fault.
template <Fault kFault>
class PlainIndex {
 public:
  static constexpr uint32_t kNone = ~0u;
  explicit PlainIndex(size_t capacity) { reset(capacity); }
  size_t size() const { return size_; }
  size_t capacity() const { return capacity_; }
  template <class IsSame>
  uint32_t find(uint64_t hash, IsSame&& is_same) const {
    const size_t at = locate(hash, is_same);
    return at < cells_.size() && cells_[at] ? cells_[at]->index : kNone;
  }
  template <class IsSame>
  uint32_t findOrAdd(uint64_t hash, uint32_t index, IsSame&& is_same) {
    if (const uint32_t found = find(hash, is_same); found != kNone) return found;
    if (size_ >= capacity_ + (kFault == Fault::kNoLimit)) return kNone;
    const size_t at = locate(hash, [](uint32_t) { return false; });
    if (at == cells_.size()) return kNone;
    cells_[at] = Cell{hash, index};
    ++size_;
    return index;
  }
  template <class HashOf>
  void erase(uint64_t hash, uint32_t index, const HashOf& /*hash_of*/) {
    const size_t at = locate(hash, [&](uint32_t i) { return i == index; });
    if (at == cells_.size()) return;
    --size_;
    if (kFault == Fault::kTombstoneFull) {
      cells_[at]->index = kNone - 1;  // never free again
      return;
    }
    cells_[at].reset();
    if (kFault == Fault::kGapStays) return;
    refill(cells_.size());
  }
  void clear() {
    for (size_t i = kFault == Fault::kClearLeavesOne ? 1 : 0; i < cells_.size(); ++i) cells_[i].reset();
    size_ = 0;
  }
  void reset(size_t capacity) {
    capacity_ = capacity;
    cells_.assign(2 * capacity + 2, {});
    size_ = 0;
  }
  template <class HashOf>
  void makeRoom(const HashOf& /*hash_of*/) {
    if (size_ < capacity_) return;
    capacity_ = 2 * capacity_ + 32;
    if (kFault == Fault::kGrowthForgets) cells_.resize(2 * capacity_ + 2);
    else refill(2 * capacity_ + 2);
  }

 private:
  struct Cell {
    uint64_t hash;
    uint32_t index;
  };
  template <class IsSame>
  size_t locate(uint64_t hash, IsSame&& is_same) const {
    size_t at = static_cast<size_t>((hash >> 32) * cells_.size() >> 32);
    for (size_t probes = 0; probes < cells_.size(); ++probes, ++at) {
      if (at == cells_.size()) {
        if (kFault == Fault::kNoWrap) break;
        at = 0;
      }
      if (!cells_[at]) return at;
      if (cells_[at]->index == kNone - 1) continue;
      if (is_same(cells_[at]->index) || (kFault == Fault::kHashIsEnough && cells_[at]->hash == hash)) return at;
    }
    return cells_.size();
  }
  void refill(size_t cells) {
    std::vector<std::optional<Cell>> old(cells);
    old.swap(cells_);
    for (const auto& cell : old)
      if (cell) cells_[locate(cell->hash, [](uint32_t) { return false; })] = cell;
  }
  std::vector<std::optional<Cell>> cells_;
  size_t capacity_ = 0, size_ = 0;
};

TEST(HashIndexControl, NoticesEachFault) {
  if (test::kSanitized) GTEST_SKIP() << "of figures, not of memory";
  EXPECT_EQ(firstDifference<PlainIndex<Fault::kNone>>(false), "");
  EXPECT_EQ(firstDifference<PlainIndex<Fault::kNone>>(true), "");
  EXPECT_NE(firstDifference<PlainIndex<Fault::kGapStays>>(false), "");
  EXPECT_NE(firstDifference<PlainIndex<Fault::kTombstoneFull>>(false), "");
  EXPECT_NE(firstDifference<PlainIndex<Fault::kHashIsEnough>>(false), "");
  EXPECT_NE(firstDifference<PlainIndex<Fault::kNoWrap>>(false), "");
  EXPECT_NE(firstDifference<PlainIndex<Fault::kClearLeavesOne>>(false), "");
  EXPECT_NE(firstDifference<PlainIndex<Fault::kGrowthForgets>>(true), "");
  EXPECT_NE(firstDifference<PlainIndex<Fault::kNoLimit>>(false), "");
}

// ---- KeyIndex

TEST(KeyIndex, NumbersKeysAsTheyCome) {
  std::mt19937_64 random(1);
  KeyIndex index;
  for (int round = 0; round < 40; ++round) {
    std::unordered_map<uint64_t, uint32_t> model;
    // Names of places, and any; also 0 and all ones.
    const uint64_t keys = 1 + random() % 3000, mask = round % 2 ? ~uint64_t{0} : 0x0040001C000700FFu;
    for (uint64_t i = 0; i < keys; ++i) {
      const uint64_t key = i == 3 ? 0 : i == 5 ? ~uint64_t{0} : random() & mask;
      const auto known = model.find(key);
      ASSERT_EQ(index.find(key), known == model.end() ? KeyIndex::kNone : known->second);
      const auto number = model.emplace(key, static_cast<uint32_t>(model.size())).first->second;
      ASSERT_EQ(index.findOrAdd(key), number);
      ASSERT_EQ(index.find(key), number);
      ASSERT_EQ(index[number], key);
      ASSERT_EQ(index.size(), model.size());
    }
    for (const auto& [key, number] : model) ASSERT_EQ(index.find(key), number);
    index.clear();
    EXPECT_EQ(index.size(), 0u);
    for (const auto& [key, number] : model) ASSERT_EQ(index.find(key), KeyIndex::kNone);
  }
}

TEST(Hashes, AreDifferentForDifferentKeys) {
  // Odd factors have inverses modulo 2^n.
  uint64_t inverse = 1;
  for (int i = 0; i < 6; ++i) inverse *= 2 - 0x9E3779B97F4A7C15u * inverse;
  std::mt19937_64 random(2);
  for (int i = 0; i < 1000; ++i) {
    const uint64_t key = random();
    ASSERT_EQ(hashOfKey(key) * inverse, key);
    const auto part = static_cast<uint32_t>(key), back = static_cast<uint32_t>(exactHash(part) >> 32);
    uint32_t inverse32 = 1;
    for (int k = 0; k < 5; ++k) inverse32 *= 2 - 0x9E3779B9u * inverse32;
    ASSERT_EQ(back * inverse32, part);
  }
}

}  // namespace hash_index_test
}  // namespace relievo
