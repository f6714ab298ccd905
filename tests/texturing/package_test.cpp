// A package is opened as far as it is sound: every truncation, every byte damaged.
#include "texturing/package/package.h"

#include <gtest/gtest.h>
#include <xxhash.h>

#include <algorithm>
#include <atomic>
#include <filesystem>
#include <fstream>
#include <random>
#include <tuple>

#include "package_fixture.h"
#include "tests/view_share.h"
#include "texturing/package/package_builder.h"
#include "texturing/package/package_layout.h"
#include "texturing/package/package_sections.h"
#include "texturing/stream/page_sources.h"

namespace relievo {
namespace package_test {

using namespace testing_support;
using test::kSanitized;
using test::longTests;
namespace fs = std::filesystem;

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
    const FlatDomain d = package.manifest().domain.flat();
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
    bool in_zeros =
        (i >= 256 && i < kHeaderBytes - 8) || (i >= bytes_.size() - kHeaderBytes + 256 && i < bytes_.size() - 8);
    if (!(in_pages || in_zeros) || i % 401 == 0) places.push_back(i);
  }
  std::fstream file;
  writeAll(damaged_, bytes_);
  for (size_t k = 0; k < places.size(); k += kSanitized ? 7 : longTests() ? 1 : 3) {
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
  EXPECT_GT(seen, kSanitized ? 150u : longTests() ? 1000u : 400u);
  EXPECT_EQ(harmless, 0u) << "both copies of the header and the padding before the index included";
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

// What a newer tool wrote is unsupported, not damaged; what is known opens (and its pages say themselves how they are
// encoded).
TEST_F(SmallPackage, unknownEncodingsAreUnsupported) {
  auto kindOf = [&](const std::vector<uint8_t>& bytes) {
    writeAll(damaged_, bytes);
    auto package = Package::open(damaged_);
    return package.ok()                                      ? std::string("opens")
           : package.error().kind == ErrorKind::kUnsupported ? package.error().text()
                                                             : "another error";
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
  for (auto [offset, size] : {std::pair{~uint64_t{0}, 1000u},
                              {uint64_t{0}, 1000u},
                              {header.pages_offset, ~0u},
                              {header.pages_offset, 0u},
                              {header.pages_offset + header.pages_bytes - 1, 2u},
                              {header.pages_offset + header.pages_bytes + 1, 1u}}) {
    storeLittle(block, offset);
    storeLittle(block + 8, size);
    storeLittle(block + 60, static_cast<uint64_t>(XXH3_64bits(block, 60)));
    writeAll(damaged_, bytes_);
    auto package = Package::open(damaged_);
    ASSERT_TRUE(package.ok());
    // Refused for where it points, not for the checksum of what stands there.
    auto page = (*package)->read(PageId(texturePlane(0), NodeId{0, 0, 0, 0}));
    ASSERT_FALSE(page.ok());
    EXPECT_NE(page.error().message.find("its index entry points outside the pages"), std::string::npos)
        << offset << ", " << size << ": " << page.error().text();
    EXPECT_TRUE((*package)->read(PageId(texturePlane(1), NodeId{0, 0, 0, 0})).ok());
  }
}

// The copy of a damaged header is believed only in a file of the length that it names.
TEST_F(SmallPackage, headerCopiesOfAnotherLengthAreRefused) {
  std::vector<uint8_t> damaged = bytes_;
  damaged[8] ^= 1;
  auto opens = [&](const std::vector<uint8_t>& bytes) {
    writeAll(damaged_, bytes);
    return Package::open(damaged_).ok();
  };
  EXPECT_TRUE(opens(damaged));  // negative control: of its own length
  std::vector<uint8_t> longer = damaged, shorter = damaged;
  longer.insert(longer.end() - kHeaderBytes, 100, uint8_t{0});
  EXPECT_FALSE(opens(longer));
  shorter.erase(shorter.end() - kHeaderBytes - 100, shorter.end() - kHeaderBytes);
  EXPECT_FALSE(opens(shorter));
}

// What a few KB of header claim, of a file that has no more: refused before anything is walked.
TEST_F(SmallPackage, claimsThatNoFileOfThisLengthHoldsAreRefused) {
  const PackageHeader sound = *decodeHeader({bytes_.data(), kHeaderBytes}, path_);
  auto refusal = [&](FlatDomain d, bool own_length) {
    d.texture_depth = FlatDomain::depthFor(d.width_px, d.height_px);
    PackageHeader h = sound;
    h.domain = d;
    const PackageLayout layout = packageLayout(h);
    h.index_bytes = layout.index_bytes;
    h.page_count = layout.page_count;
    h.pages_offset = h.index_offset + h.index_bytes;
    h.pages_bytes = h.page_count;
    h.file_bytes = own_length ? 12288 : h.pages_offset + h.pages_bytes + kHeaderBytes;
    std::vector<uint8_t> bytes(bytes_.begin(), bytes_.begin() + 12288);
    encodeHeader(h, {bytes.data(), kHeaderBytes});
    writeAll(damaged_, bytes);
    auto package = Package::open(damaged_);
    if (package) return std::string();
    EXPECT_EQ(package.error().kind, ErrorKind::kInvalidData);
    return package.error().text();
  };
  FlatDomain huge = sound.domain.flat();
  huge.width_px = huge.height_px = uint64_t{1} << 24;
  EXPECT_NE(refusal(huge, true).find("the index lies outside the file: expected it within 12288 bytes"),
            std::string::npos)
      << refusal(huge, true);
  EXPECT_NE(refusal(huge, false).find("found a file of 12288 bytes"), std::string::npos) << refusal(huge, false);
  // So many that the sums overflow: found before they are made.
  huge.width_px = uint64_t{1} << 44;
  huge.relief_depth = 17;
  EXPECT_NE(refusal(huge, false), "");
  EXPECT_NE(refusal(huge, true), "");
  // Fewer bytes than pages.
  auto few = sound;
  few.pages_bytes = few.page_count - 1;
  std::vector<uint8_t> bytes = bytes_;
  encodeHeader(few, {bytes.data(), kHeaderBytes});
  encodeHeader(few, {bytes.data() + bytes.size() - kHeaderBytes, kHeaderBytes});
  writeAll(damaged_, bytes);
  auto package = Package::open(damaged_);
  ASSERT_FALSE(package.ok());
  EXPECT_NE(package.error().message.find("a byte for each of 8 pages, found 7"), std::string::npos)
      << package.error().text();
  // Negative control: the same header, of an artwork that the file holds.
  EXPECT_EQ(refusal(sound.domain.flat(), false), "");
}

TEST_F(SmallPackage, aDeepManifestIsNoProvenanceAndNothingWorse) {
  PackageHeader h = *decodeHeader({bytes_.data(), kHeaderBytes}, path_);
  std::string deep;
  for (int i = 0; i < 1000000; ++i) deep += "{\"a\":";
  deep += "0" + std::string(1000000, '}');
  std::vector<uint8_t> bytes = bytes_;
  h.manifest_offset = bytes.size();
  h.manifest_bytes = deep.size();
  h.manifest_hash = XXH3_64bits(deep.data(), deep.size());
  bytes.insert(bytes.end(), deep.begin(), deep.end());
  bytes.resize(bytes.size() + kHeaderBytes);
  h.file_bytes = bytes.size();
  encodeHeader(h, {bytes.data(), kHeaderBytes});
  encodeHeader(h, {bytes.data() + bytes.size() - kHeaderBytes, kHeaderBytes});
  writeAll(damaged_, bytes);
  auto package = Package::open(damaged_);
  ASSERT_TRUE(package.ok()) << package.error().text();
  EXPECT_TRUE((*package)->manifestJson().empty());
  ASSERT_EQ((*package)->warnings().size(), 1u);
  EXPECT_NE((*package)->warnings()[0].find("64 levels"), std::string::npos) << (*package)->warnings()[0];
  auto report = verifyPackage(**package, 1, nullptr);
  ASSERT_TRUE(report.ok());
  EXPECT_TRUE(std::any_of(report->other.begin(), report->other.end(),
                          [](const std::string& what) { return what.find("64 levels") != std::string::npos; }));
}

// The damage of what is there twice, and of padding, is named by its place; repaired, the file has its old bytes.
TEST_F(SmallPackage, damagedCopiesAndPaddingAreNamedAndRepaired) {
  const PackageHeader header = *decodeHeader({bytes_.data(), kHeaderBytes}, path_);
  const uint64_t copy = header.file_bytes - kHeaderBytes, padding = header.manifest_offset + header.manifest_bytes;
  ASSERT_LT(padding, header.index_offset);
  auto faultsOf = [&] {
    auto package = Package::open(damaged_);
    EXPECT_TRUE(package.ok());
    auto report = verifyPackage(**package, 2, nullptr);
    EXPECT_TRUE(report.ok() && report->damaged.empty());
    return report->other;
  };
  for (auto [at, bytes, named] :
       {std::tuple<uint64_t, uint64_t, std::string>{
            20, 1, "the header at byte 0 is damaged; its copy at byte " + std::to_string(copy) + " is sound"},
        {0, kHeaderBytes, "the header at byte 0 is damaged"},
        {8, 1, "the header at byte 0 is damaged"},  // the version
        {copy + 3000, 1, "the header at byte " + std::to_string(copy) + " is damaged; its copy at byte 0 is sound"},
        {copy, kHeaderBytes, "the header at byte " + std::to_string(copy) + " is damaged"},
        {padding, header.index_offset - padding, "the padding at byte " + std::to_string(padding)},
        {header.index_offset - 1, 1, "found 1 other bytes"}}) {
    std::vector<uint8_t> broken = bytes_;
    for (uint64_t i = at; i < at + bytes; ++i) broken[i] ^= 0x5A;
    writeAll(damaged_, broken);
    const auto faults = faultsOf();
    ASSERT_EQ(faults.size(), 1u) << named;
    EXPECT_NE(faults[0].find(named), std::string::npos) << faults[0];
    // Interrupted before it wrote: as it was. Interrupted after half of it: it opens all the same.
    const std::atomic<bool> stop{true};
    auto repaired = repairPackage(damaged_, &stop);
    ASSERT_FALSE(repaired.ok());
    EXPECT_EQ(repaired.error().kind, ErrorKind::kInterrupted);
    EXPECT_TRUE(readAll(damaged_) == broken);
    std::vector<uint8_t> half = broken;
    std::copy_n(bytes_.begin() + static_cast<std::ptrdiff_t>(at), bytes / 2,
                half.begin() + static_cast<std::ptrdiff_t>(at));
    writeAll(damaged_, half);
    uint64_t failed = 0;
    auto opened = Package::open(damaged_);
    ASSERT_TRUE(opened.ok());
    content(**opened, &failed);
    EXPECT_EQ(failed, 0u);
    repaired = repairPackage(damaged_);
    ASSERT_TRUE(repaired.ok()) << repaired.error().text();
    ASSERT_EQ(repaired->size(), 1u);
    EXPECT_TRUE(readAll(damaged_) == bytes_) << named;
    EXPECT_TRUE(faultsOf().empty());
  }
  // Nothing to repair: nothing is written. What is not there twice stays as it is.
  auto nothing = repairPackage(damaged_);
  ASSERT_TRUE(nothing.ok());
  EXPECT_TRUE(nothing->empty());
  std::vector<uint8_t> broken = bytes_;
  broken[header.pages_offset + 100] ^= 1;
  writeAll(damaged_, broken);
  nothing = repairPackage(damaged_);
  ASSERT_TRUE(nothing.ok());
  EXPECT_TRUE(nothing->empty());
  EXPECT_TRUE(readAll(damaged_) == broken);
  // A header whose sections overlap repairs nothing.
  PackageHeader crossed = header;
  crossed.manifest_bytes = header.index_offset - header.manifest_offset + 10;
  broken = bytes_;
  encodeHeader(crossed, {broken.data(), kHeaderBytes});
  writeAll(damaged_, broken);
  nothing = repairPackage(damaged_);
  ASSERT_TRUE(nothing.ok());
  EXPECT_TRUE(nothing->empty());
  EXPECT_TRUE(readAll(damaged_) == broken);
}

// A copy that cannot be read is not called damaged, and not written over.
TEST_F(SmallPackage, copiesThatCannotBeReadAreNoDamage) {
  const PackageHeader header = *decodeHeader({bytes_.data(), kHeaderBytes}, path_);
  const uint64_t copy = header.file_bytes - kHeaderBytes;
  struct Unread {
    uint64_t from, to;
    size_t faults_expected;
  };
  for (const Unread unread : {Unread{0, 1, 1}, Unread{copy, copy + 1, 1},
                              Unread{header.index_offset - 1, header.index_offset, 1}, Unread{0, 0, 0}}) {
    const ReadBytes read = [&](uint64_t offset, std::span<uint8_t> out) -> Result<void> {
      if (offset < unread.to && unread.from < offset + out.size())
        return Error{ErrorKind::kIo, path_, "reading failed: Input/output error", "", {}};
      std::copy_n(bytes_.begin() + static_cast<std::ptrdiff_t>(offset), out.size(), out.begin());
      return {};
    };
    auto faults = sectionFaults({header, header.file_bytes}, read, nullptr);
    ASSERT_TRUE(faults.ok());
    ASSERT_EQ(faults->size(), unread.faults_expected) << unread.from;
    for (const SectionFault& fault : *faults) {
      EXPECT_TRUE(fault.unreadable) << fault.what;
      EXPECT_EQ(fault.mend, SectionFault::Mend::kNone);
      EXPECT_NE(fault.what.find("Input/output error"), std::string::npos) << fault.what;
      EXPECT_EQ(fault.what.find("damaged"), std::string::npos) << fault.what;
    }
  }
}

// Bytes that no section, or no page, accounts for.
TEST_F(SmallPackage, bytesThatBelongToNothingAreNamed) {
  const PackageHeader sound = *decodeHeader({bytes_.data(), kHeaderBytes}, path_);
  auto faultsOf = [&](const PackageHeader& h, std::vector<uint8_t> bytes) {
    encodeHeader(h, {bytes.data(), kHeaderBytes});
    encodeHeader(h, {bytes.data() + bytes.size() - kHeaderBytes, kHeaderBytes});
    writeAll(damaged_, bytes);
    auto package = Package::open(damaged_);
    EXPECT_TRUE(package.ok());
    auto report = verifyPackage(**package, 1, nullptr);
    EXPECT_TRUE(report.ok());
    std::string all;
    for (const std::string& what : report->other) all += what + "\n";
    return all;
  };
  EXPECT_EQ(faultsOf(sound, bytes_), "");
  // Between the pages and the header's copy.
  PackageHeader h = sound;
  std::vector<uint8_t> bytes = bytes_;
  bytes.insert(bytes.end() - kHeaderBytes, 100, uint8_t{0});
  h.file_bytes += 100;
  EXPECT_EQ(faultsOf(h, bytes), "100 bytes at byte " + std::to_string(h.pages_offset + h.pages_bytes) +
                                    " belong to nothing, between the pages and the header's copy\n");
  // Behind the last page, and called pages.
  h.pages_bytes += 100;
  EXPECT_NE(faultsOf(h, bytes).find(": 100 bytes belong to nothing"), std::string::npos) << faultsOf(h, bytes);
  // Behind the end.
  bytes = bytes_;
  writeAll(damaged_, bytes_);
  std::ofstream(damaged_, std::ios::binary | std::ios::app) << "more";
  auto package = Package::open(damaged_);
  ASSERT_TRUE(package.ok());
  auto report = verifyPackage(**package, 1, nullptr);
  ASSERT_TRUE(report.ok());
  ASSERT_EQ(report->other.size(), 1u);
  EXPECT_NE(report->other[0].find("the last 4 belong to nothing"), std::string::npos) << report->other[0];
}

// In the order of the index, whatever the workers; each handed out as it is found; what cannot be read is not called
// damaged.
TEST_F(SmallPackage, problemsComeInOrderAndInputErrorsAreNoDamage) {
  const PackageHeader header = *decodeHeader({bytes_.data(), kHeaderBytes}, path_);
  for (uint64_t i = 0; i < header.pages_bytes; i += 16) bytes_[header.pages_offset + i] ^= 1;
  writeAll(damaged_, bytes_);
  auto damaged = Package::open(damaged_), whole = Package::open(path_);
  ASSERT_TRUE(damaged.ok() && whole.ok());
  auto found = [&](const Package& package, int workers, const PageSource* pages) {
    std::vector<VerifyProblem> problems;
    VerifyOptions options;
    options.workers = workers;
    options.pages = pages;
    options.problem = [&](const VerifyProblem& problem) { problems.push_back(problem); };
    auto report = verifyPackage(package, options);
    EXPECT_TRUE(report.ok());
    EXPECT_TRUE(report->damaged.empty() && report->other.empty() && report->unreadable.empty())
        << "handed out, not kept";
    EXPECT_EQ(report->pages, 8u);
    return problems;
  };
  const auto one = found(**damaged, 1, nullptr);
  ASSERT_EQ(one.size(), 8u);
  for (int workers : {2, 7}) {
    const auto many = found(**damaged, workers, nullptr);
    ASSERT_EQ(many.size(), one.size());
    for (size_t i = 0; i < one.size(); ++i) EXPECT_EQ(many[i].what, one[i].what);
  }
  for (const VerifyProblem& problem : one) EXPECT_TRUE(problem.page && !problem.unreadable);
  const FailingSource failing(*whole, {.fail = 1}, 1);
  const auto unreadable = found(**whole, 2, &failing);
  ASSERT_EQ(unreadable.size(), 8u);
  for (const VerifyProblem& problem : unreadable) EXPECT_TRUE(problem.unreadable) << problem.what;
  auto report = verifyPackage(**whole, VerifyOptions{.progress = {}, .problem = {}, .pages = &failing});
  ASSERT_TRUE(report.ok());
  EXPECT_TRUE(report->damaged.empty() && report->other.empty());
  EXPECT_EQ(report->unreadable.size(), 8u);
  EXPECT_TRUE(found(**whole, 3, nullptr).empty());
}

TEST_F(SmallPackage, walksEndWhenInterrupted) {
  auto package = Package::open(path_);
  ASSERT_TRUE(package.ok());
  const std::atomic<bool> stop{true};
  auto usage = planeUsage(**package, texturePlane(0), &stop);
  ASSERT_FALSE(usage.ok());
  EXPECT_EQ(usage.error().kind, ErrorKind::kInterrupted);
  auto report = verifyPackage(**package, 2, nullptr, &stop);
  ASSERT_FALSE(report.ok());
  EXPECT_EQ(report.error().kind, ErrorKind::kInterrupted);
  EXPECT_EQ(planeUsage(**package, texturePlane(0))->pages, 2u);
}

// Cut while it is open: what was there is an error of its page. Its name gone: nothing changes.
TEST_F(SmallPackage, aFileThatChangesWhileItIsOpenIsNoSurprise) {
  writeAll(damaged_, bytes_);
  auto package = Package::open(damaged_);
  ASSERT_TRUE(package.ok());
  const PageId id(texturePlane(0), NodeId{1, 0, 0, 0});
  fs::remove(damaged_);
  EXPECT_TRUE((*package)->read(id).ok());
  EXPECT_EQ((*package)->readFailures().pages, 0u);
  writeAll(damaged_, bytes_);
  package = Package::open(damaged_);
  ASSERT_TRUE(package.ok());
  ASSERT_TRUE((*package)->read(id).ok());
  fs::resize_file(damaged_, (*package)->record(id)->offset + 10);
  auto page = (*package)->read(id);
  ASSERT_FALSE(page.ok());
  EXPECT_EQ(page.error().kind, ErrorKind::kInvalidData);
  EXPECT_EQ((*package)->readFailures().pages, 1u);
  EXPECT_NE((*package)->readFailures().first.find("plane 0 patch 1"), std::string::npos)
      << (*package)->readFailures().first;
}

// The index's arithmetic, against enumeration: every entry has its own place and nothing is left over.
TEST(PackageLayout, entriesTileTheIndex) {
  std::vector<PatchDomain> domains;
  for (auto [w, h] : {std::pair{1, 1}, {300, 700}, {5000, 2100}, {2100, 5000}, {40000, 90}}) {
    FlatDomain d;
    d.width_px = static_cast<uint64_t>(w), d.height_px = static_cast<uint64_t>(h);
    d.texture_depth = FlatDomain::depthFor(d.width_px, d.height_px);
    domains.emplace_back(d);
  }
  for (auto [patches, depth] : {std::pair{1, 0}, {3, 2}, {50, 5}}) {
    domains.push_back(PatchDomain::overMesh(static_cast<uint32_t>(patches)));
    domains.back().texture_depth = depth;
  }
  for (PatchDomain& d : domains) {
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

}  // namespace package_test
}  // namespace relievo
