// The coded index: without loss but for hashes' upper halves, small, refused where bytes are damaged, and as PACKAGE.md
// says, by a reader of its own.
#include "texturing/package/index_code.h"

#include <algorithm>
#include <array>
#include <bit>
#include <map>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <xxhash.h>

#include "patch_fixture.h"
#include "tests/texturing/format_coder.h"
#include "tests/view_share.h"
#include "texturing/codec/page_codec.h"
#include "texturing/package/package.h"
#include "texturing/package/patch_package_builder.h"

namespace relievo::index_code_test {
namespace {

using format_coder::Coder;
using format_coder::Model;
using namespace testing_support;

constexpr uint32_t kSeed = 20261127;
constexpr uint64_t kPages = 70'000;

// Patches of two texture planes, some of which lack levels.
PatchDomain patchesOf(uint32_t count, int texture_depth, int relief_depth) {
  PatchMeasures m;
  m.texture_depth = texture_depth, m.relief_depth = relief_depth;
  m.mm_per_px = 1;
  PatchDomain d = PatchDomain::overMesh(count, m);
  TextureDepths depths(count);
  for (uint32_t p = 0; p < count; ++p)
    depths[p] = static_cast<int8_t>(std::min(static_cast<int>(p % 3) - 1, texture_depth));
  d.setTextureDepths(std::make_shared<const TextureDepths>(depths));
  return d;
}

struct Tree {
  std::vector<IndexLayout::Block> blocks;
  std::vector<uint8_t> entries;
  bool relief = false;
  friend bool operator==(const Tree& a, const Tree& b) { return a.entries == b.entries; }
};

// How a tree's entries may be: as builders leave them, or of any content that is allowed.
enum class Content { kUsual, kAny, kEmpty };  // kEmpty: usual, but every third page has no bytes

Tree made(const IndexLayout& layout, bool relief, Content content) {
  Tree t{{}, {}, relief};
  layout.forEachBlock([&](const IndexLayout::Block& block) {
    t.blocks.push_back(block);
    return true;
  });
  t.entries.resize(layout.bytes());
  std::mt19937_64 random(kSeed);
  uint64_t offset = kPages;
  const size_t entry = relief ? kReliefEntryBytes : kTextureEntryBytes;
  for (const IndexLayout::Block& block : t.blocks) {
    uint8_t* p = t.entries.data() + (block.offset - t.blocks[0].offset);
    for (size_t k = 0; k < (block.bytes - 8) / entry; ++k, p += entry) {
      const bool usual = content != Content::kAny, empty = content == Content::kEmpty && k % 3 > 0;
      const auto size = static_cast<uint32_t>(empty ? 0 : usual ? 20 + random() % 200 : random());
      storeLittle(p, usual ? offset : kPages + (random() >> (2 + random() % 60)));
      storeLittle(p + 8, size);
      storeLittle(p + 12, uint64_t{static_cast<uint32_t>(empty ? XXH3_64bits("", 0) : random())});
      offset += size;
      if (!relief) continue;
      const uint64_t step = usual ? 74 : 1, least = usual ? 20'000 + step * (random() % 100) : random() % 65'536,
                     most = usual ? least + step * (random() % 60) : least + random() % (65'536 - least);
      storeLittle(p + 20, static_cast<uint16_t>(least));
      storeLittle(p + 22, static_cast<uint16_t>(most));
      storeLittle(p + 24, static_cast<uint16_t>(usual ? 0 : random()));
    }
  }
  return t;
}

// "Coded index" of PACKAGE.md, as an entry's fields.
struct Entry {
  uint64_t offset = 0, size = 0, hash = 0, min = 0, max = 0, error = 0;
};
std::vector<Entry> readInItsWords(std::span<const uint8_t> code, size_t entries, int planes, bool relief,
                                  bool version10) {
  struct Numbers {
    std::array<Model, 64> width;
    std::array<std::array<Model, 2>, 64> upper;
  };
  Coder c(code);
  auto number = [&](Numbers& m) -> uint64_t {
    size_t node = 1;
    for (int i = 0; i < 6; ++i) node = 2 * node + static_cast<size_t>(c.bit(m.width[node]));
    const size_t width = node - 64;
    if (width == 0) return 0;
    uint64_t v = 1;
    for (size_t i = 1; i < width; ++i)
      v = 2 * v + (i <= 2 ? static_cast<uint64_t>(c.bit(m.upper[width][i - 1])) : c.plain(1));
    return v;
  };
  const uint64_t least = relief ? c.plain(16) : 0, step = relief ? c.plain(16) : 0;
  std::array<Model, 2> apart;
  auto distance = std::make_unique<std::array<Numbers, 2>>(), size = std::make_unique<std::array<Numbers, 2>>();
  auto min = std::make_unique<Numbers>(), range = std::make_unique<Numbers>(), error = std::make_unique<Numbers>();
  std::vector<Entry> out;
  uint64_t next = kPages;
  for (size_t i = 0; i < entries; ++i) {
    const size_t kind = relief || i % static_cast<size_t>(planes) == 0 ? 0 : 1;
    Entry e;
    e.offset = next;
    if (c.bit(apart[kind])) {
      const bool before = c.plain(1) != 0;
      const uint64_t far = number((*distance)[kind]);
      e.offset = before ? next - far : next + far;
    }
    e.size = number((*size)[kind]);
    e.hash = e.size == 0 && version10 ? static_cast<uint32_t>(XXH3_64bits("", 0)) : c.plain(32);
    next = e.offset + e.size;
    if (relief) {
      e.min = least + step * number(*min);
      e.max = e.min + step * number(*range);
      e.error = number(*error);
    }
    out.push_back(e);
  }
  EXPECT_TRUE(c.ended());
  return out;
}

TEST(IndexCode, IsWithoutLossSmallAndAsThePackagesWordsSay) {
  const PackageLayout layout =
      packageLayout(patchesOf(100, 1, 2), TextureFormat{.basis = Basis::kAlbedoNormal}, 4096, 0);
  std::map<std::pair<bool, bool>, size_t> of_empty;  // bytes by relief and version
  for (const auto& [content, version10] : {std::pair{Content::kUsual, false},
                                           {Content::kUsual, true},
                                           {Content::kAny, false},
                                           {Content::kAny, true},
                                           {Content::kEmpty, false},
                                           {Content::kEmpty, true}})
    for (const bool relief : {false, true}) {
      const IndexCodeOf of{2, kPages, version10};
      const Tree tree = made(relief ? layout.relief : layout.texture, relief, content);
      const auto code = encodeIndexBlocks(of, relief, tree.blocks, tree.entries);
      ASSERT_TRUE(code);
      Tree again = tree;
      std::fill(again.entries.begin(), again.entries.end(), uint8_t{0xAA});
      ASSERT_TRUE(decodeIndexBlocks(*code, of, relief, again.blocks, again.entries));
      const size_t entry = relief ? kReliefEntryBytes : kTextureEntryBytes;
      const size_t entries = (relief ? 1 : 2) * (relief ? layout.relief : layout.texture).nodeCount();
      const auto words = readInItsWords(*code, entries, 2, relief, version10);
      size_t i = 0;
      for (const IndexLayout::Block& block : tree.blocks)
        for (uint64_t at = 0; at + 8 < block.bytes; at += entry, ++i) {
          const uint8_t* p = tree.entries.data() + (block.offset - tree.blocks[0].offset) + at;
          const uint8_t* q = again.entries.data() + (p - tree.entries.data());
          ASSERT_TRUE(std::equal(p, p + entry, q)) << i;
          ASSERT_EQ(words[i].offset, loadLittle<uint64_t>(p));
          ASSERT_EQ(words[i].size, loadLittle<uint32_t>(p + 8));
          ASSERT_EQ(words[i].hash, loadLittle<uint32_t>(p + 12));
          if (!relief) continue;
          ASSERT_EQ(words[i].min, loadLittle<uint16_t>(p + 20));
          ASSERT_EQ(words[i].max, loadLittle<uint16_t>(p + 22));
          ASSERT_EQ(words[i].error, loadLittle<uint16_t>(p + 24));
        }
      EXPECT_EQ(i, entries);
      if (content == Content::kUsual) {
        EXPECT_LT(code->size(), (relief ? 15 : 11) * entries / 2) << "four bytes a page are its hash";
      }
      if (content == Content::kEmpty) of_empty[{relief, version10}] = code->size() * 12 / entries;
    }
  for (const bool relief : {false, true}) {
    const auto without = of_empty[{relief, true}], with = of_empty[{relief, false}];
    EXPECT_LE(without + 24, with) << "in 12ths of a byte a page: two of three hashes are missing";
  }
}

TEST(IndexCode, RefusesWhatNoBuilderMakes) {
  const IndexCodeOf of{2, kPages};
  const PackageLayout layout = packageLayout(patchesOf(3, 0, 0), TextureFormat{.basis = Basis::kAlbedoNormal}, 4096, 0);
  const Tree tree = made(layout.relief, true, Content::kUsual);
  EXPECT_TRUE(encodeIndexBlocks(of, true, tree.blocks, tree.entries)) << "control";
  Tree before = tree, crossed = tree;
  storeLittle(before.entries.data(), kPages - 1);
  EXPECT_FALSE(encodeIndexBlocks(of, true, before.blocks, before.entries));
  storeLittle(crossed.entries.data() + 20, uint16_t{9});
  storeLittle(crossed.entries.data() + 22, uint16_t{8});
  EXPECT_FALSE(encodeIndexBlocks(of, true, crossed.blocks, crossed.entries));
}

TEST(IndexCode, DamagedBytesAreRefusedOrOtherEntries) {
  const IndexCodeOf of{2, kPages};
  const PackageLayout layout =
      packageLayout(patchesOf(40, 1, 1), TextureFormat{.basis = Basis::kAlbedoNormal}, 4096, 0);
  const Tree tree = made(layout.relief, true, Content::kUsual);
  const auto code = *encodeIndexBlocks(of, true, tree.blocks, tree.entries);
  Tree out = tree;
  for (size_t length : {size_t{0}, size_t{3}, code.size() / 2, code.size() - 1})
    EXPECT_FALSE(decodeIndexBlocks(std::span(code).first(length), of, true, out.blocks, out.entries)) << length;
  auto longer = code;
  longer.push_back(0);
  EXPECT_FALSE(decodeIndexBlocks(longer, of, true, out.blocks, out.entries));
  std::vector<IndexLayout::Block> fewer(tree.blocks.begin(), tree.blocks.end() - 1);
  EXPECT_FALSE(decodeIndexBlocks(code, of, true, fewer, out.entries)) << "entries of other blocks";
  std::mt19937 random(kSeed);
  int refused = 0;
  for (int i = 0; i < 300; ++i) {
    auto damaged = code;
    damaged[random() % damaged.size()] ^= static_cast<uint8_t>(1 + random() % 255);
    const bool taken = decodeIndexBlocks(damaged, of, true, out.blocks, out.entries);
    refused += !taken;
    if (taken) {
      EXPECT_FALSE(out == tree);
    }
  }
  EXPECT_GT(refused, 100);
}

TEST(IndexCode, DirectoriesTileTheirSectionAndItsEntries) {
  const std::vector<IndexChunk> chunks{{0, 0, 30, 1}, {1000, 0, 40, 2}};
  const auto bytes = encodeIndexDirectory(chunks);
  const uint64_t section = bytes.size() + 70;
  EXPECT_EQ(indexDirectoryBytes(bytes, section), bytes.size());
  EXPECT_EQ(indexDirectoryBytes(std::vector<uint8_t>(16, 0xFF), section), section) << "of any bytes";
  const auto read = decodeIndexDirectory(bytes, section, 2000);
  ASSERT_TRUE(read);
  EXPECT_EQ((*read)[1].offset, bytes.size() + 30);
  EXPECT_EQ((*read)[1].first, 1000u);
  EXPECT_FALSE(decodeIndexDirectory(bytes, section + 1, 2000));
  EXPECT_FALSE(decodeIndexDirectory(bytes, section, 1000)) << "a chunk without entries";
  for (size_t at = 0; at < bytes.size(); ++at) {
    auto damaged = bytes;
    damaged[at] ^= 1;
    EXPECT_FALSE(decodeIndexDirectory(damaged, section, 2000)) << at;
  }
  EXPECT_FALSE(decodeIndexDirectory(encodeIndexDirectory(std::vector{chunks[1], chunks[0]}), section, 2000));
  EXPECT_FALSE(decodeIndexDirectory(encodeIndexDirectory(std::vector{chunks[1]}), bytes.size(), 2000));
  for (const uint64_t first : {uint64_t{0}, uint64_t{1000}, uint64_t{500}}) {
    const auto three = encodeIndexDirectory(std::vector<IndexChunk>{{0, 0, 30, 1}, {1000, 0, 40, 2}, {first, 0, 0, 3}});
    EXPECT_FALSE(decodeIndexDirectory(three, three.size() + 70, 2000)) << first;
  }
}

// Pages of few bytes.
class Plain final : public NoisyPatches {
 public:
  Plain() : NoisyPatches(cubeSphere(test::kSanitized ? 4 : 6, 100, kSeed), 1, 1, kSeed) {}
  uint16_t height(uint32_t patch, int x, int y) const override {
    const bool inside = x % 256 != 0 && y % 256 != 0;
    return static_cast<uint16_t>(30'000 + (inside ? 50 * (patch % 7) : 0));
  }
  Result<void> texels(uint32_t patch, std::span<uint8_t> out) const override {
    std::fill(out.begin(), out.end(), static_cast<uint8_t>(100 + patch % 5));
    return {};
  }
};

class CodedIndex : public testing::Test {
 protected:
  // Built once, for no test changes them.
  static void SetUpTestSuite() {
    folder_ = std::make_unique<ScratchFolder>();
    ASSERT_TRUE(build("coded.relievo", true) && build("plain.relievo", false));
    coded_ = *Package::open(folder_->file("coded.relievo"));
    plain_ = *Package::open(folder_->file("plain.relievo"));
  }
  static void TearDownTestSuite() { coded_.reset(), plain_.reset(), folder_.reset(); }
  void SetUp() override { ASSERT_TRUE(coded_ && plain_) << "no package was built"; }
  static bool build(const std::string& name, bool coded) {
    BuildOptions o;
    o.output = folder_->file(name);
    o.workers = 2;
    o.coded_index = coded;
    o.base_by_border = false;
    return buildPatchPackage(Plain(), o).ok();
  }
  template <class F>
  void forEachPage(F&& f) const {
    const Manifest& m = plain_->manifest();
    const PackageLayout layout = packageLayout(m.domain, m.texture, 0, 0);
    for (const bool relief : {false, true})
      (relief ? layout.relief : layout.texture).forEachBlock([&](const IndexLayout::Block& block) {
        for (uint32_t k = 0; k < block.columns * block.rows; ++k) {
          NodeId node = block.first;
          node.x += k % block.columns, node.y += k / block.columns;
          for (int plane = 0; plane < (relief ? 1 : m.texture.planes()); ++plane)
            f(PageId(relief ? Plane::kRelief : texturePlane(plane), node));
        }
        return true;
      });
  }

  static inline std::unique_ptr<ScratchFolder> folder_;
  static inline std::shared_ptr<Package> coded_, plain_;
};

TEST_F(CodedIndex, TellsWhatAPlainOneDoes) {
  EXPECT_EQ(packageVersion(coded_->header()), 10u);
  EXPECT_EQ(packageVersion(plain_->header()), 8u);
  const uint64_t detail = packageLayout(plain_->header()).relief_detail.bytes(),
                 of_pages = plain_->header().index_bytes - detail;
  EXPECT_LT((coded_->header().index_bytes - detail) * 5 / 2, of_pages);
  uint64_t pages = 0, over_tails = 0, empty = 0;
  PageDecoder decoder;
  std::vector<uint16_t> a_samples(kReliefPageSamples), b_samples(kReliefPageSamples);
  forEachPage([&](PageId id) {
    const auto a = coded_->record(id), b = plain_->record(id);
    ASSERT_TRUE(a.ok() && b.ok());
    EXPECT_EQ(a->relief.min_mm, b->relief.min_mm);
    EXPECT_EQ(a->relief.max_mm, b->relief.max_mm);
    EXPECT_EQ(a->relief.error_mm, b->relief.error_mm);
    const auto page = coded_->read(id), as_plain = plain_->read(id);
    ASSERT_TRUE(page.ok() && as_plain.ok());
    EXPECT_EQ(page->storedBytes(), a->size);
    const bool root = id.plane() == Plane::kRelief && id.node().level == 0;
    if (root) {  // stored over its tail
      EXPECT_EQ(page->bytes[0], a->size > 0 ? 14 : 16);
      EXPECT_LT(page->storedBytes(), as_plain->storedBytes());
      empty += a->size == 0;
      ASSERT_TRUE(decoder.decodeRelief(page->bytes, a_samples) && decoder.decodeRelief(as_plain->bytes, b_samples));
      EXPECT_TRUE(a_samples == b_samples);
      ++over_tails;
    } else {
      EXPECT_TRUE(page->bytes == as_plain->bytes);
      EXPECT_EQ(a->size, b->size);
      EXPECT_EQ(a->checksum.value, b->checksum.value & 0xFFFFFFFF);
    }
    if (id.plane() == Plane::kRelief) {
      std::array<float, kReliefDetailBytes> coded, plain;
      ASSERT_TRUE(coded_->reliefErrors(id.node(), coded) && plain_->reliefErrors(id.node(), plain));
      EXPECT_TRUE(coded == plain);
    }
    ++pages;
  });
  EXPECT_EQ(pages, coded_->manifest().page_count);
  EXPECT_EQ(over_tails, coded_->manifest().domain.patchCount());
  EXPECT_GE(empty, over_tails / 8) << "even ones have no bytes";
  EXPECT_LT(empty, over_tails / 2) << "control: others do";
  EXPECT_GT(pages, 2 * kIndexChunkEntries) << "several chunks of a tree";
  const auto verified = verifyPackage(*coded_, {});
  ASSERT_TRUE(verified.ok());
  EXPECT_TRUE(verified->damaged.empty() && verified->other.empty());
}

TEST_F(CodedIndex, DamageLosesThePagesOfItsPart) {
  const std::vector<uint8_t> good = readAll(folder_->file("coded.relievo"));
  const PackageHeader& h = coded_->header();
  auto lostWith = [&](uint64_t at, std::string* why) {
    std::vector<uint8_t> bytes = good;
    bytes[at] ^= 1;
    writeAll(folder_->file("damaged.relievo"), bytes);
    const auto package = Package::open(folder_->file("damaged.relievo"));
    EXPECT_TRUE(package.ok());
    uint64_t lost = 0;
    forEachPage([&](PageId id) {
      const auto page = (*package)->read(id);
      if (page.ok()) return;
      ++lost;
      *why = page.error().text();
    });
    const auto verified = verifyPackage(**package, {});
    EXPECT_TRUE(verified.ok());
    EXPECT_EQ(verified->damaged.empty() && verified->other.empty(), lost == 0);
    return lost;
  };
  std::string why;
  EXPECT_EQ(lostWith(h.index_offset + 8, &why), h.page_count) << "the directory's checksum";
  EXPECT_NE(why.find("the index is damaged: its directory does not fit it"), std::string::npos) << why;
  const auto chunks = loadLittle<uint64_t>(good.data() + h.index_offset);
  ASSERT_GE(chunks, 3u);
  const uint64_t lost = lostWith(h.index_offset + kIndexHeadBytes + kIndexChunkBytes * chunks + 20, &why);
  EXPECT_GE(lost, kIndexChunkEntries);
  EXPECT_LT(lost, 2 * kIndexChunkEntries);
  EXPECT_NE(why.find("a part of the index is damaged: its checksum does not match"), std::string::npos) << why;
}

// Where every checksum is right, too.
TEST_F(CodedIndex, PartsOfOtherEntriesAreRefused) {
  std::vector<uint8_t> bytes = readAll(folder_->file("coded.relievo"));
  const PackageHeader& h = coded_->header();
  uint8_t* directory = bytes.data() + h.index_offset;
  const auto chunks = loadLittle<uint64_t>(directory);
  // The second part begins within a block.
  storeLittle(directory + kIndexHeadBytes + kIndexChunkBytes,
              loadLittle<uint64_t>(directory + kIndexHeadBytes + kIndexChunkBytes) + 1);
  storeLittle(directory + 8,
              static_cast<uint64_t>(XXH3_64bits(directory + kIndexHeadBytes, kIndexChunkBytes * chunks)));
  writeAll(folder_->file("damaged.relievo"), bytes);
  const auto package = Package::open(folder_->file("damaged.relievo"));
  ASSERT_TRUE(package.ok());
  const auto page = (*package)->read(PageId(texturePlane(0), {0, 0, 0, 0}));
  ASSERT_FALSE(page.ok());
  EXPECT_NE(page.error().text().find("it is no code of its entries"), std::string::npos) << page.error().text();
}

}  // namespace
}  // namespace relievo::index_code_test
