// A package is opened as far as it is sound: every truncation, every byte damaged.
#include "texturing/package.h"

#include <gtest/gtest.h>
#include <xxhash.h>

#include <fstream>
#include <random>

#include "package_fixture.h"
#include "tests/view_share.h"
#include "texturing/package_builder.h"
#include "texturing/package_layout.h"

namespace relievo {
namespace {

using namespace testing_support;
using test::kSanitized;

std::vector<uint8_t> readAll(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}
void writeAll(const std::string& path, std::span<const uint8_t> bytes) {
  std::ofstream out(path, std::ios::binary);
  out.write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
}

class SmallPackage : public ::testing::Test {
 protected:
  void SetUp() override {
    NoisyTexture texture(150, 40, Basis::kPtmLrgb, 1, 1);  // two patches of one level
    NoisyHeights heights(150, 40, 2, 0.001);
    BuildOptions o;
    o.output = path_;
    o.workers = 1;
    ASSERT_TRUE(buildPackage(texture, &heights, o).ok());
    bytes_ = readAll(path_);
    ASSERT_EQ(loadLittle<uint64_t>(bytes_.data() + 16), bytes_.size());
  }
  // All pages decoded, one after the other.
  static std::vector<uint8_t> content(const Package& package, uint64_t* failed) {
    std::vector<uint8_t> all, slot(kSlotBytes);
    PageDecoder decoder;
    const PlanarDomain& d = package.manifest().domain;
    auto add = [&](PageId id) {
      auto page = package.read(id);
      if (!page || !decoder.decodeToSlot(id.plane(), page->bytes, slot).ok()) {
        ++*failed;
        return;
      }
      all.insert(all.end(), slot.begin(), slot.end());
    };
    forEachNode(d, d.texture_depth, [&](const NodeId& n) {
      for (int k = 0; k < package.manifest().texture.planes(); ++k) add(PageId(texturePlane(k), n));
    });
    if (d.relief_depth >= 0) forEachNode(d, d.relief_depth, [&](const NodeId& n) { add(PageId(Plane::kRelief, n)); });
    return all;
  }
  // Rewrites a header field in both copies, with a fitting checksum: what an attacker would do.
  template <class T>
  std::vector<uint8_t> withField(size_t offset, T value) const {
    std::vector<uint8_t> out = bytes_;
    for (uint8_t* head : {out.data(), out.data() + out.size() - kHeaderBytes}) {
      storeLittle(head + offset, value);
      storeLittle(head + kHeaderBytes - 8, static_cast<uint64_t>(XXH3_64bits(head, kHeaderBytes - 8)));
    }
    return out;
  }

  ScratchFolder folder_;
  std::string path_ = folder_.file("a.relievo"), damaged_ = folder_.file("b.relievo");
  std::vector<uint8_t> bytes_;
};

TEST_F(SmallPackage, tellsWhereItCameFrom) {
  auto package = Package::open(path_);
  ASSERT_TRUE(package.ok());
  const Manifest& m = (*package)->manifest();
  ASSERT_EQ(m.sources.size(), 2u);
  EXPECT_EQ(m.sources[0].name, "noise, seed 1");
  EXPECT_EQ(m.page_count, 8u);
  EXPECT_NE((*package)->manifestJson().find("\"width_px\": 150"), std::string::npos);
  EXPECT_FALSE((*package)->read(PageId(texturePlane(3), NodeId{0, 0, 0, 0})).ok());
  EXPECT_FALSE((*package)->read(PageId(texturePlane(0), NodeId{0, 1, 0, 0})).ok());
  EXPECT_FALSE((*package)->read(PageId(texturePlane(0), NodeId{2, 0, 0, 0})).ok());
  EXPECT_FALSE((*package)->read(PageId(Plane::kResolved, NodeId{0, 0, 0, 0})).ok());
}

TEST_F(SmallPackage, everyTruncationOpensOrFailsCleanly) {
  size_t opened = 0, lost = 0;
  for (size_t n = 0; n < bytes_.size(); n += n < 12000 ? 61 : 997) {
    writeAll(damaged_, {bytes_.data(), n});
    auto package = Package::open(damaged_);
    if (!package) {
      EXPECT_EQ(package.error().kind, ErrorKind::kInvalidData);
      EXPECT_EQ(package.error().file, damaged_);
      continue;
    }
    ++opened;
    EXPECT_FALSE((*package)->warnings().empty());
    uint64_t failed = 0;
    content(**package, &failed);
    lost += failed;
    auto report = verifyPackage(**package, 1, nullptr);
    ASSERT_TRUE(report.ok());
    EXPECT_FALSE(report->other.empty());
  }
  EXPECT_GT(opened, 10u);  // from the header on
  EXPECT_GT(lost, 10u);
}

// Each byte is flipped; what can be read afterwards is what was written, and verify knows of the rest.
TEST_F(SmallPackage, everyFlippedByteIsSeenOrHarmless) {
  uint64_t failed = 0;
  auto whole = Package::open(path_);
  ASSERT_TRUE(whole.ok());
  const std::vector<uint8_t> truth = content(**whole, &failed);
  ASSERT_EQ(failed, 0u);
  PackageHeader header = *decodeHeader({bytes_.data(), kHeaderBytes}, path_);
  size_t seen = 0, harmless = 0;
  // Pages are long and alike: every byte elsewhere, some of theirs. (The zeros of the headers are long, too.)
  std::vector<size_t> places;
  for (size_t i = 0; i < bytes_.size(); ++i) {
    bool in_pages = i >= header.pages_offset && i < header.pages_offset + header.pages_bytes;
    bool in_zeros = (i >= 256 && i < kHeaderBytes - 8) || (i >= bytes_.size() - kHeaderBytes + 256 && i < bytes_.size() - 8);
    if (!(in_pages || in_zeros) || i % 401 == 0) places.push_back(i);
  }
  std::fstream file;
  writeAll(damaged_, bytes_);
  for (size_t k = 0; k < places.size(); k += kSanitized ? 7 : 1) {
    const size_t i = places[k];
    {
      file.open(damaged_, std::ios::in | std::ios::out | std::ios::binary);
      file.seekp(static_cast<std::streamoff>(i));
      file.put(static_cast<char>(bytes_[i] ^ (1 << (i % 8))));
      file.close();
    }
    auto package = Package::open(damaged_);
    if (package) {  // one copy of the header is always sound
      auto report = verifyPackage(**package, 1, nullptr);
      ASSERT_TRUE(report.ok());
      uint64_t lost = 0;
      auto now = content(**package, &lost);
      if (report->damaged.empty() && report->other.empty()) {
        ++harmless;
        EXPECT_EQ(lost, 0u) << "byte " << i;
        EXPECT_TRUE(now == truth) << "byte " << i;
      } else {
        ++seen;
        if (lost == 0) {
          EXPECT_TRUE(now == truth) << "byte " << i;
        }
        for (const DamagedPage& page : report->damaged) EXPECT_NE(page.what.find("page plane "), std::string::npos);
      }
    } else {
      // A changed version number is not damage: such a file belongs to a newer tool.
      EXPECT_EQ(package.error().kind, ErrorKind::kUnsupported) << "byte " << i << ": " << package.error().text();
      ++seen;
    }
    file.open(damaged_, std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(static_cast<std::streamoff>(i));
    file.put(static_cast<char>(bytes_[i]));
    file.close();
  }
  EXPECT_GT(seen, kSanitized ? 150u : 1000u);
  // What is not seen: the padding before the index, and the second copy of the header, which nobody needed.
  EXPECT_LE(harmless, size_t{2} * kHeaderBytes);
}

TEST_F(SmallPackage, damagedPageIsNamedAndTheOthersLive) {
  auto package = Package::open(path_);
  ASSERT_TRUE(package.ok());
  PageId victim(texturePlane(1), NodeId{1, 0, 0, 0});
  auto record = (*package)->record(victim);
  ASSERT_TRUE(record.ok());
  bytes_[record->offset + record->size / 2] ^= 4;
  writeAll(damaged_, bytes_);
  auto damaged = Package::open(damaged_);
  ASSERT_TRUE(damaged.ok());
  auto page = (*damaged)->read(victim);
  ASSERT_FALSE(page.ok());
  EXPECT_EQ(page.error().offset, record->offset);
  EXPECT_NE(page.error().text().find("plane 1 patch 1 level 0 x 0 y 0"), std::string::npos) << page.error().text();
  auto report = verifyPackage(**damaged, 2, nullptr);
  ASSERT_TRUE(report.ok());
  ASSERT_EQ(report->damaged.size(), 1u);
  EXPECT_EQ(report->damaged[0].id, victim);
  EXPECT_EQ(report->pages, 8u);
}

TEST_F(SmallPackage, hostileHeaderFieldsAreRefused) {
  auto refused = [&](const std::vector<uint8_t>& bytes) {
    writeAll(damaged_, bytes);
    auto package = Package::open(damaged_);
    if (package) return false;
    EXPECT_FALSE(package.error().message.empty());
    return true;
  };
  for (uint64_t huge : {uint64_t{1} << 62, ~uint64_t{0}, ~uint64_t{0} - 4096, uint64_t{1} << 44, uint64_t{1} << 36}) {
    for (size_t field : {24u, 32u, 48u, 56u, 64u, 72u, 80u, 88u, 96u}) {
      EXPECT_TRUE(refused(withField(field, huge))) << "field " << field << " value " << huge;
    }
  }
  EXPECT_TRUE(refused(withField(88, uint64_t{0})));
  EXPECT_TRUE(refused(withField(104, double{NAN})));
  EXPECT_TRUE(refused(withField(104, -1.0)));
  EXPECT_TRUE(refused(withField(120, double{INFINITY})));
  EXPECT_TRUE(refused(withField(128, int32_t{5})));
  EXPECT_TRUE(refused(withField(132, int32_t{18})));
  EXPECT_TRUE(refused(withField(132, int32_t{-7})));
  EXPECT_TRUE(refused(withField(136, uint32_t{3})));
  EXPECT_TRUE(refused(withField(144, double{NAN})));
  // A longer file than there is: opens, and says so.
  EXPECT_FALSE(refused(withField(16, uint64_t{1} << 50)));
  // Negative control: a field set to what it is.
  EXPECT_FALSE(refused(withField(88, uint64_t{150})));
}

// What a newer tool wrote is unsupported, not damaged; what is known opens (and its pages say themselves how they are encoded).
TEST_F(SmallPackage, unknownEncodingsAreUnsupported) {
  auto kindOf = [&](const std::vector<uint8_t>& bytes) {
    writeAll(damaged_, bytes);
    auto package = Package::open(damaged_);
    return package.ok() ? std::string("opens") : package.error().kind == ErrorKind::kUnsupported ? package.error().text() : "another error";
  };
  for (size_t plane : {0u, 2u, 7u}) {
    for (uint8_t codec : {4, 16, 18, 24, 255}) {
      std::string text = kindOf(withField(240 + plane, codec));
      EXPECT_NE(text.find("plane " + std::to_string(plane)), std::string::npos) << text;
      EXPECT_NE(text.find("page encoding " + std::to_string(codec)), std::string::npos) << text;
    }
    EXPECT_NE(kindOf(withField(248 + plane, uint8_t{1})), "opens") << "lossless has no parameter";
    EXPECT_NE(kindOf(withField(240 + plane, uint8_t{1})), "opens") << "no bits";
    EXPECT_EQ(kindOf(withField(240 + plane, uint8_t{23})), "opens");
  }
}

TEST_F(SmallPackage, hostileIndexEntriesAreRefused) {
  PackageHeader header = *decodeHeader({bytes_.data(), kHeaderBytes}, path_);
  uint8_t* block = bytes_.data() + header.index_offset;  // patch 0, one node: three entries and the checksum
  for (auto [offset, size] : {std::pair{~uint64_t{0}, 1000u}, {uint64_t{0}, 1000u}, {header.pages_offset, ~0u}, {header.pages_offset, 0u},
                              {header.pages_offset + header.pages_bytes - 1, 2u}, {header.pages_offset + header.pages_bytes + 1, 1u}}) {
    storeLittle(block, offset);
    storeLittle(block + 8, size);
    storeLittle(block + 60, static_cast<uint64_t>(XXH3_64bits(block, 60)));
    writeAll(damaged_, bytes_);
    auto package = Package::open(damaged_);
    ASSERT_TRUE(package.ok());
    EXPECT_FALSE((*package)->read(PageId(texturePlane(0), NodeId{0, 0, 0, 0})).ok());
    EXPECT_TRUE((*package)->read(PageId(texturePlane(1), NodeId{0, 0, 0, 0})).ok());
  }
}

// The index's arithmetic, against enumeration: every entry has its own place and nothing is left over.
TEST(PackageLayout, entriesTileTheIndex) {
  for (auto [w, h] : {std::pair{1, 1}, {300, 700}, {5000, 2100}, {2100, 5000}, {40000, 90}}) {
    PlanarDomain d;
    d.width_px = static_cast<uint64_t>(w), d.height_px = static_cast<uint64_t>(h);
    d.texture_depth = PlanarDomain::depthFor(d.width_px, d.height_px);
    d.relief_depth = std::max(0, d.texture_depth - 1);
    TextureFormat format = sampleFormat(Basis::kPtmLrgb);
    PackageLayout layout = packageLayout(d, format, 8192, kReliefDetailBytes + kReliefShapesBytes);
    std::vector<uint8_t> used(layout.index_bytes);
    auto use = [&](uint64_t offset, uint32_t bytes) {
      for (uint32_t i = 0; i < bytes; ++i) {
        ASSERT_LT(offset + i - 8192, used.size());
        ASSERT_EQ(used[offset + i - 8192]++, 0);
      }
    };
    uint64_t nodes = 0;
    forEachNode(d, d.texture_depth, [&](const NodeId& n) {
      ASSERT_TRUE(layout.texture.contains(n));
      auto place = layout.texture.find(n);
      use(place.block_offset + place.node_offset, 60);
      nodes += 3;
    });
    forEachNode(d, d.relief_depth, [&](const NodeId& n) {
      auto place = layout.relief.find(n);
      use(place.block_offset + place.node_offset, kReliefEntryBytes);
      auto detail = layout.relief_detail.find(n);
      use(detail.block_offset + detail.node_offset, kReliefDetailBytes + kReliefShapesBytes);
      ++nodes;
    });
    EXPECT_EQ(nodes, layout.page_count);
    for (const IndexLayout* tree : {&layout.texture, &layout.relief, &layout.relief_detail}) {
      tree->forEachBlock([&](const IndexLayout::Block& b) {
        auto place = tree->find(b.first);
        EXPECT_EQ(place.block_offset, b.offset);
        EXPECT_EQ(place.block_bytes, b.bytes);
        EXPECT_EQ(place.node_offset, 0u);
        use(b.offset + b.bytes - 8, 8);
        return true;
      });
    }
    EXPECT_EQ(std::count(used.begin(), used.end(), 1), static_cast<std::ptrdiff_t>(used.size()));
  }
}

}  // namespace
}  // namespace relievo
