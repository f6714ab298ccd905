// src/base: names of places, patches of both kinds, files that appear whole or not at all.
#include <malloc.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <random>
#include <set>
#include <vector>

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "src/artwork/node_id.h"
#include "src/artwork/patch_domain.h"
#include "src/base/file.h"
#include "src/base/heap.h"
#include "src/base/json_parse.h"
#include "src/base/printable.h"
#include "src/base/result.h"

namespace relievo {
namespace base_test {

namespace fs = std::filesystem;

// ---- Result, Error ----

TEST(Error, TextNamesFileOffsetMessageAndHint) {
  EXPECT_EQ((Error{ErrorKind::kInvalidData, "a.ptm", "expected 6, found 5", "get a whole copy", 17}.text()),
            "a.ptm: at byte 17: expected 6, found 5 (get a whole copy)");
  EXPECT_EQ((Error{ErrorKind::kIo, "a.ptm", "is a folder", "", {}}.text()), "a.ptm: is a folder");
  EXPECT_EQ((Error{ErrorKind::kRuntime, "", "no driver", "install one", {}}.text()), "no driver (install one)");
  EXPECT_EQ((Error{ErrorKind::kInvalidData, "f", "m", "", 0}.text()), "f: at byte 0: m") << "offset 0 is an offset";
}

TEST(Error, KindIsTheDocumentedExitCode) {
  const std::pair<ErrorKind, int> documented[] = {{ErrorKind::kUsage, 1},        {ErrorKind::kIo, 2},
                                                  {ErrorKind::kInvalidData, 3},  {ErrorKind::kRuntime, 4},
                                                  {ErrorKind::kUnsupported, 5},  {ErrorKind::kDifference, 7},
                                                  {ErrorKind::kInterrupted, 130}};
  for (const auto& [kind, code] : documented) EXPECT_EQ(Error{.kind = kind}.exitCode(), code);
}

TEST(Result, HoldsEitherAndMovesItsValue) {
  Result<std::unique_ptr<int>> value = std::make_unique<int>(5);
  ASSERT_TRUE(value.ok());
  std::unique_ptr<int> taken = std::move(*value);
  EXPECT_EQ(*taken, 5);
  Result<std::unique_ptr<int>> error = Error{.message = "no"};
  EXPECT_FALSE(error.ok());
  EXPECT_EQ(error.error().message, "no");
  Result<void> fine;
  EXPECT_TRUE(fine.ok());
}

// ---- NodeId ----

std::vector<uint32_t> corners(uint32_t maximum) {
  std::set<uint32_t> values = {0, maximum};
  for (uint32_t bit = 1; bit != 0 && bit <= maximum; bit <<= 1)
    values.insert({bit, bit - 1, std::min(bit + 1, maximum)});
  return {values.begin(), values.end()};
}

TEST(NodeId, PackingIsReversibleAndUniqueAtAllCorners) {
  const std::vector<uint32_t> places = corners((1u << kMaxNodeLevel) - 1), patches = corners(kMaxPatches - 1);
  std::vector<uint64_t> keys;
  for (uint32_t level = 0; level <= kMaxNodeLevel; ++level)
    for (uint32_t patch : patches)
      for (uint32_t x : places)
        for (uint32_t y : {x, places.front(), places.back(), places[places.size() / 2]}) {
          const NodeId n{patch, level, x, y};
          const uint64_t key = packNode(n);
          ASSERT_EQ(unpackNode(key), n);
          ASSERT_LT(key, uint64_t{1} << 59);
          ASSERT_NE(key + 1, 0u) << "key + 1 is what the page table stores, and 0 means empty there";
          keys.push_back(key);
        }
  std::sort(keys.begin(), keys.end());
  std::set<NodeId> distinct;
  for (uint64_t key : keys) distinct.insert(unpackNode(key));
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
  EXPECT_EQ(keys.size(), distinct.size());
}

TEST(NodeId, EachFieldHasItsOwnBits) {
  EXPECT_EQ(packNode({0, 0, 0, (1u << 17) - 1}), 0x1FFFFu);
  EXPECT_EQ(packNode({0, 0, (1u << 17) - 1, 0}), uint64_t{0x1FFFF} << 17);
  EXPECT_EQ(packNode({kMaxPatches - 1, 0, 0, 0}), uint64_t{0xFFFFF} << 34);
  EXPECT_EQ(packNode({0, 31, 0, 0}), uint64_t{31} << 54);
}

TEST(NodeId, FamilyTies) {
  const NodeId n{3, 5, 21, 30};
  for (uint32_t cy : {0u, 1u})
    for (uint32_t cx : {0u, 1u}) {
      EXPECT_EQ(n.child(cx, cy).parent(), n);
      EXPECT_EQ(n.child(cx, cy).ancestor(5), n);
    }
  EXPECT_EQ(n.ancestor(5), n);
  EXPECT_EQ(n.ancestor(0), (NodeId{3, 0, 0, 0}));
  NodeId up = n;
  while (up.level > 2) up = up.parent();
  EXPECT_EQ(n.ancestor(2), up);
}

// ---- FlatDomain ----

FlatDomain domainOf(uint64_t width, uint64_t height) {
  FlatDomain d;
  d.width_px = width;
  d.height_px = height;
  d.texture_depth = FlatDomain::depthFor(width, height);
  return d;
}

// Independent of the header's integer trick: the node's open square and the open artwork, in texels as long double.
bool meets(const FlatDomain& d, const NodeId& n) {
  const long double side = static_cast<long double>(d.patchPx()) / static_cast<long double>(uint64_t{1} << n.level);
  const bool landscape = d.patchColumns() >= d.patchRows();
  const long double x0 = (landscape ? n.patch * static_cast<long double>(d.patchPx()) : 0) + n.x * side;
  const long double y0 = (landscape ? 0 : n.patch * static_cast<long double>(d.patchPx())) + n.y * side;
  const long double right = std::min<long double>(x0 + side, d.width_px);
  const long double bottom = std::min<long double>(y0 + side, d.height_px);
  return right > x0 && bottom > y0;
}

const std::pair<uint64_t, uint64_t> kSizes[] = {{1, 1},     {1, 300},   {300, 1},    {127, 129},
                                                {128, 128}, {129, 128}, {256, 255},  {257, 256},
                                                {640, 480}, {480, 640}, {385, 1153}, {2000, 129}};

TEST(FlatDomain, NodeExistsWhereItsSquareMeetsTheArtwork) {
  for (const auto& [width, height] : kSizes) {
    const FlatDomain d = domainOf(width, height);
    // Two levels beyond the texels: relief may go deeper.
    for (uint32_t level = 0; level <= static_cast<uint32_t>(d.texture_depth) + 9 && level <= 9; ++level) {
      const uint32_t side = 1u << level;
      // All nodes of small levels; of large ones the rows and columns around every border.
      for (uint32_t patch = 0; patch < d.patchCount() + 2; ++patch)
        for (uint32_t y = 0; y<side; y += level> 6 ? 3 : 1)
          for (uint32_t x = 0; x<side; x += level> 6 ? 3 : 1) {
            const NodeId n{patch, level, x, y};
            ASSERT_EQ(d.nodeExists(n), patch < d.patchCount() && meets(d, n))
                << width << "x" << height << " patch " << patch << " level " << level << " at " << x << "," << y;
          }
      EXPECT_FALSE(d.nodeExists({0, level, side, 0}));
      EXPECT_FALSE(d.nodeExists({0, level, 0, side}));
    }
    EXPECT_FALSE(d.nodeExists({0, kMaxNodeLevel + 1, 0, 0}));
  }
}

TEST(FlatDomain, NodeExistsAtTheLargestSizesWithoutOverflow) {
  const uint64_t largest = uint64_t{1} << 24;
  for (const auto& [width, height] : {std::pair{largest, largest},
                                      {largest - 1, largest},
                                      {largest, uint64_t{1}},
                                      {largest * 3 + 1, largest},
                                      {largest, largest / 2 + 1}}) {
    const FlatDomain d = domainOf(width, height);
    ASSERT_LE(d.texture_depth, static_cast<int>(kMaxNodeLevel));
    std::mt19937 random(7);
    for (int i = 0; i < 20000; ++i) {
      const uint32_t level = static_cast<uint32_t>(random() % (kMaxNodeLevel + 1)), mask = (1u << level) - 1;
      NodeId n{static_cast<uint32_t>(random() % std::min(d.patchCount(), 64u)), level,
               static_cast<uint32_t>(random()) & mask, static_cast<uint32_t>(random()) & mask};
      if (i % 3 == 0) n.x = mask;  // the last column and row
      if (i % 3 == 1) n.y = mask;
      ASSERT_EQ(d.nodeExists(n), meets(d, n)) << "seed 7: level " << level << " at " << n.x << "," << n.y;
    }
  }
}

TEST(FlatDomain, PatchesCoverTheArtworkOnceAndAreTheSmallestThatCoverTheShorterSide) {
  for (const auto& [width, height] : kSizes) {
    const FlatDomain d = domainOf(width, height);
    const uint64_t shorter = std::min(width, height);
    EXPECT_GE(d.patchPx(), shorter);
    EXPECT_TRUE(d.patchPx() == uint64_t{kPagePx} || d.patchPx() / 2 < shorter);
    EXPECT_TRUE(d.patchColumns() == 1 || d.patchRows() == 1);
    uint64_t covered = 0;
    for (uint32_t p = 0; p < d.patchCount(); ++p) {
      EXPECT_EQ(d.patchOriginX(p) % d.patchPx(), 0u);
      EXPECT_TRUE(d.nodeExists({p, 0, 0, 0})) << "a patch without a texel";
      covered += std::min(d.patchPx(), width - d.patchOriginX(p)) * std::min(d.patchPx(), height - d.patchOriginY(p));
    }
    EXPECT_EQ(covered, width * height);
    // The pages of the finest level hold every texel once.
    uint64_t payload = 0;
    const uint32_t level = static_cast<uint32_t>(d.texture_depth);
    for (uint32_t p = 0; p < d.patchCount(); ++p)
      for (uint32_t y = 0; y < 1u << level; ++y)
        for (uint32_t x = 0; x < 1u << level; ++x)
          if (d.nodeExists({p, level, x, y}))
            payload += std::min<uint64_t>(kPagePx, width - d.patchOriginX(p) - x * uint64_t{kPagePx}) *
                       std::min<uint64_t>(kPagePx, height - d.patchOriginY(p) - y * uint64_t{kPagePx});
    EXPECT_EQ(payload, width * height);
  }
}

TEST(FlatDomain, LevelSizesHalveRoundingUp) {
  for (const auto& [width, height] : kSizes) {
    const FlatDomain d = domainOf(width, height);
    EXPECT_EQ(d.levelWidth(d.texture_depth), width);
    EXPECT_EQ(d.levelHeight(d.texture_depth), height);
    for (int level = d.texture_depth; level > 0; --level) {
      EXPECT_EQ(d.levelWidth(level - 1), (d.levelWidth(level) + 1) / 2);
      EXPECT_EQ(d.levelHeight(level - 1), (d.levelHeight(level) + 1) / 2);
    }
    EXPECT_LE(std::min(d.levelWidth(0), d.levelHeight(0)), uint64_t{kPagePx});
  }
}

// ---- PatchDomain ----

// Nodes of a level that exist, of all places within the patches and just beyond them.
uint64_t existing(const PatchDomain& d, uint32_t level) {
  uint64_t count = 0;
  for (uint32_t patch = 0; patch < d.patchCount() + 2; ++patch)
    for (uint32_t y = 0; y < (1u << level) + 2; ++y)
      for (uint32_t x = 0; x < (1u << level) + 2; ++x) count += d.nodeExists({patch, level, x, y}) ? 1 : 0;
  return count;
}

TEST(PatchDomain, OverAMeshEveryNodeOfEachPatchExistsAndNoneBeyond) {
  PatchMeasures measures;
  measures.texture_depth = 2;
  measures.relief_depth = 4;
  for (uint32_t patches : {1u, 2u, 7u}) {
    const auto d = PatchDomain::overMesh(patches, measures);
    EXPECT_FALSE(d.isFlat());
    EXPECT_EQ(d.patchCount(), patches);
    EXPECT_EQ(d.texelCount(), patches * 512.0 * 512.0);
    for (uint32_t level = 0; level <= 5; ++level) {
      const uint32_t side = 1u << level;
      for (uint32_t patch = 0; patch < patches; ++patch)
        for (uint32_t y = 0; y < side; ++y)
          for (uint32_t x = 0; x < side; ++x) ASSERT_TRUE(d.nodeExists({patch, level, x, y}));
      EXPECT_EQ(existing(d, level), uint64_t{patches} * side * side);
      EXPECT_EQ(d.nodeCount(static_cast<int>(level)), uint64_t{patches} * side * side);
    }
  }
  const auto largest = PatchDomain::overMesh(kMaxPatches);
  const uint32_t last = (1u << kMaxNodeLevel) - 1;
  EXPECT_TRUE(largest.nodeExists({kMaxPatches - 1, kMaxNodeLevel, last, last}));
  EXPECT_FALSE(largest.nodeExists({kMaxPatches, kMaxNodeLevel, last, last}));
  EXPECT_FALSE(largest.nodeExists({0, kMaxNodeLevel, last + 1, last}));
  EXPECT_FALSE(largest.nodeExists({0, kMaxNodeLevel + 1, 0, 0}));
  EXPECT_EQ(largest.nodeCount(kMaxNodeLevel), uint64_t{kMaxPatches} << (2 * kMaxNodeLevel));
}

TEST(PatchDomain, AFlatOneIsItsStrip) {
  bool cut_somewhere = false;
  for (const auto& [width, height] : kSizes) {
    const FlatDomain flat = domainOf(width, height);
    const PatchDomain d = flat;
    ASSERT_TRUE(d.isFlat());
    EXPECT_EQ(d.flat().width_px, width);
    EXPECT_EQ(d.flat().height_px, height);
    EXPECT_EQ(PatchDomain(d.flat()), d);
    EXPECT_EQ(d.patchCount(), flat.patchCount());
    EXPECT_EQ(d.texelCount(), static_cast<double>(width * height));
    for (uint32_t level = 0; level <= 4; ++level) {
      EXPECT_EQ(d.nodeCount(static_cast<int>(level)), existing(d, level)) << width << "x" << height;
      // Control: the same patches over a mesh have no border that cuts nodes off.
      const auto mesh = PatchDomain::overMesh(d.patchCount(), flat);
      EXPECT_NE(mesh, d);
      EXPECT_GE(existing(mesh, level), existing(d, level));
      cut_somewhere = cut_somewhere || existing(mesh, level) > existing(d, level);
    }
  }
  EXPECT_TRUE(cut_somewhere);
}

TEST(PatchDomain, OverAMeshThereIsNoFlatExtent) {
  EXPECT_THROW((void)PatchDomain::overMesh(3).flat(), std::bad_optional_access);
  EXPECT_NO_THROW((void)PatchDomain(domainOf(300, 100)).flat()) << "control";
}

// ---- files ----

class Files : public testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "relievo-base-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override { fs::remove_all(folder_); }
  std::string at(const char* name) const { return (folder_ / name).string(); }
  static void put(const std::string& path, const std::string& text) { std::ofstream(path, std::ios::binary) << text; }
  static std::string get(const std::string& path) {
    std::ifstream in(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  static std::span<const uint8_t> bytes(const std::string& text) {
    return {reinterpret_cast<const uint8_t*>(text.data()), text.size()};
  }
  size_t filesInFolder() const {
    return static_cast<size_t>(std::distance(fs::directory_iterator(folder_), fs::directory_iterator()));
  }
  fs::path folder_;
};

TEST_F(Files, InputReadsAnyRangeAndNamesTheOffsetWhereAFileEnds) {
  put(at("in"), "0123456789");
  Result<InputFile> file = InputFile::open(at("in"));
  ASSERT_TRUE(file.ok());
  EXPECT_EQ(file->size(), 10u);
  std::string out(4, ' ');
  std::span<uint8_t> span(reinterpret_cast<uint8_t*>(out.data()), out.size());
  for (uint64_t offset = 0; offset <= 6; ++offset) {
    ASSERT_TRUE(file->read(offset, span).ok());
    EXPECT_EQ(out, std::string("0123456789").substr(offset, 4));
  }
  for (uint64_t offset : {7, 9, 10, 1000}) {
    Result<void> read = file->read(offset, span);
    ASSERT_FALSE(read.ok());
    EXPECT_EQ(read.error().kind, ErrorKind::kInvalidData);
    EXPECT_EQ(read.error().offset, offset);
    EXPECT_EQ(read.error().file, at("in"));
  }
  EXPECT_TRUE(file->read(10, {}).ok());
  InputFile moved = std::move(*file);
  EXPECT_TRUE(moved.read(0, span).ok());
}

TEST_F(Files, InputOfNothingAndOfAFolderAreErrorsThatNameThem) {
  for (const std::string& path : {at("absent"), folder_.string()}) {
    Result<InputFile> file = InputFile::open(path);
    ASSERT_FALSE(file.ok());
    EXPECT_EQ(file.error().kind, ErrorKind::kIo);
    EXPECT_EQ(file.error().file, path);
  }
}

TEST_F(Files, TheTargetIsUntouchedUntilCommitAndThenWhole) {
  put(at("out"), "before");
  {
    Result<OutputFile> file = OutputFile::create(at("out"));
    ASSERT_TRUE(file.ok());
    ASSERT_TRUE(file->append(bytes("hello ")).ok());
    ASSERT_TRUE(file->append(bytes("world")).ok());
    EXPECT_EQ(file->size(), 11u);
    EXPECT_EQ(get(at("out")), "before");
    EXPECT_EQ(filesInFolder(), 2u);
    OutputFile moved = std::move(*file);
    ASSERT_TRUE(moved.writeAt(0, bytes("H")).ok());
    EXPECT_EQ(get(at("out")), "before");
    ASSERT_TRUE(moved.commit().ok());
    EXPECT_EQ(get(at("out")), "Hello world");
    EXPECT_EQ(filesInFolder(), 1u);
  }
  EXPECT_EQ(get(at("out")), "Hello world") << "the destructor took a committed file away";
  EXPECT_EQ(filesInFolder(), 1u);
}

TEST_F(Files, AnUncommittedFileLeavesNothing) {
  put(at("out"), "before");
  {
    Result<OutputFile> file = OutputFile::create(at("out"));
    ASSERT_TRUE(file.ok());
    ASSERT_TRUE(file->append(std::vector<uint8_t>(5 << 20, 7)).ok());  // more than the buffer
    EXPECT_EQ(filesInFolder(), 2u);
  }
  EXPECT_EQ(filesInFolder(), 1u);
  EXPECT_EQ(get(at("out")), "before");
}

TEST_F(Files, RemovePartFilesTakesAwayWhatIsUncommittedOnly) {
  ASSERT_TRUE(writeFile(at("done"), bytes("done")).ok());
  Result<OutputFile> a = OutputFile::create(at("a")), b = OutputFile::create(at("b"));
  ASSERT_TRUE(a.ok() && b.ok());
  EXPECT_EQ(filesInFolder(), 3u);
  removePartFiles();
  EXPECT_EQ(filesInFolder(), 1u);
  EXPECT_EQ(get(at("done")), "done");
}

TEST_F(Files, BytesArriveWhateverTheirSizesAndPlaces) {
  std::mt19937 random(11);
  std::vector<uint8_t> expected;
  Result<OutputFile> file = OutputFile::create(at("big"));
  ASSERT_TRUE(file.ok());
  while (expected.size() < (9u << 20)) {
    std::vector<uint8_t> chunk(random() % (2u << 20));
    for (uint8_t& b : chunk) b = static_cast<uint8_t>(random());
    ASSERT_TRUE(file->append(chunk).ok());
    expected.insert(expected.end(), chunk.begin(), chunk.end());
    // Somewhere in what was appended, flushed or still buffered or both.
    std::vector<uint8_t> patch(std::min<size_t>(expected.size(), 1 + random() % 1000), 0xAB);
    const size_t offset = random() % (expected.size() - patch.size() + 1);
    ASSERT_TRUE(file->writeAt(offset, patch).ok());
    std::copy(patch.begin(), patch.end(), expected.begin() + static_cast<std::ptrdiff_t>(offset));
  }
  EXPECT_EQ(file->size(), expected.size());
  ASSERT_TRUE(file->commit().ok());
  const std::string got = get(at("big"));
  ASSERT_EQ(got.size(), expected.size());
  EXPECT_TRUE(std::equal(expected.begin(), expected.end(), reinterpret_cast<const uint8_t*>(got.data()))) << "seed 11";
}

TEST_F(Files, AFolderOrAMissingFolderAsTargetIsAnError) {
  for (const std::string& path : {folder_.string(), at("missing/out")}) {
    Result<OutputFile> file = OutputFile::create(path);
    ASSERT_FALSE(file.ok()) << path;
    EXPECT_EQ(file.error().kind, ErrorKind::kIo);
    EXPECT_EQ(file.error().file, path);
    EXPECT_FALSE(writeFile(path, bytes("x")).ok());
  }
  EXPECT_EQ(filesInFolder(), 0u);
}

// The nearest to a full disk that needs no disk: files of this process may not grow beyond a limit.
struct FileSizeLimit {
  explicit FileSizeLimit(rlim_t limit) {
    old_handler = std::signal(SIGXFSZ, SIG_IGN);
    getrlimit(RLIMIT_FSIZE, &old);
    rlimit now = old;
    now.rlim_cur = limit;
    setrlimit(RLIMIT_FSIZE, &now);
  }
  ~FileSizeLimit() {
    setrlimit(RLIMIT_FSIZE, &old);
    std::signal(SIGXFSZ, old_handler);
  }
  rlimit old{};
  void (*old_handler)(int) = nullptr;
};

TEST_F(Files, AFullDiskIsAnErrorAndTheTargetStays) {
  put(at("out"), "before");
  const std::string text(100000, 'x');
  {
    FileSizeLimit limit(50000);
    Result<void> written = writeFile(at("out"), bytes(text));
    ASSERT_FALSE(written.ok());
    EXPECT_EQ(written.error().kind, ErrorKind::kIo);
    EXPECT_EQ(written.error().file, at("out"));
  }
  EXPECT_EQ(get(at("out")), "before");
  EXPECT_EQ(filesInFolder(), 1u);
  EXPECT_TRUE(writeFile(at("out"), bytes(text)).ok()) << "with space it works";
  EXPECT_EQ(get(at("out")), text);
}

TEST_F(Files, AFailedWriteIsNeverCommittedWithBytesMissing) {
  const std::string text(100000, 'x');
  Result<OutputFile> file = OutputFile::create(at("out"));
  ASSERT_TRUE(file.ok());
  ASSERT_TRUE(file->append(bytes(text)).ok());
  {
    FileSizeLimit limit(50000);
    ASSERT_FALSE(file->commit().ok());
    EXPECT_FALSE(fs::exists(at("out")));
  }
  // The caller frees some space and tries again: all of it, or an error.
  if (file->commit().ok()) {
    EXPECT_TRUE(get(at("out")) == text) << "committed a file with bytes missing";
  }
}

TEST_F(Files, TextFilesAreReadUpToALimit) {
  put(at("t"), "12345");
  Result<std::string> text = readTextFile(at("t"), 5);
  ASSERT_TRUE(text.ok());
  EXPECT_EQ(*text, "12345");
  Result<std::string> too_long = readTextFile(at("t"), 4);
  ASSERT_FALSE(too_long.ok());
  EXPECT_EQ(too_long.error().kind, ErrorKind::kInvalidData);
}

TEST_F(Files, HashesTellFilesApart) {
  put(at("a"), "relievo");
  put(at("b"), "relievo");
  put(at("c"), "relievO");
  put(at("empty"), "");
  ASSERT_TRUE(hashFile(at("a")).ok());
  EXPECT_EQ(*hashFile(at("a")), *hashFile(at("b")));
  EXPECT_NE(*hashFile(at("a")), *hashFile(at("c")));
  EXPECT_EQ(*hashFile(at("empty")), "2d06800538d394c2");  // xxh3-64 of nothing, from the xxHash specification
  EXPECT_FALSE(hashFile(at("absent")).ok());
}

TEST(Printable, EscapesWhatSteersATerminalAndNothingElse) {
  EXPECT_EQ(printable("coin (front).ptm C:\\x"), "coin (front).ptm C:\\x");
  EXPECT_EQ(printable("\xc3\xa9\xe2\x82\xac\xf0\x9f\xaa\x99"),
            "\xc3\xa9\xe2\x82\xac\xf0\x9f\xaa\x99");  // 2, 3 and 4 bytes
  EXPECT_EQ(printable(std::string_view("a\0b", 3)), "a\\x00b");
  EXPECT_EQ(printable("a\x1b[2Jb\nc\rd\te\x7f"), "a\\x1b[2Jb\\nc\\rd\\te\\x7f");
  EXPECT_EQ(printable("\xc2\x9b"
                      "31m"),
            "\\u009b31m");                                        // CSI as one character
  EXPECT_EQ(printable("\xe2\x80\xaegnp.exe"), "\\u202egnp.exe");  // right-to-left override
  // No UTF-8: alone, cut short, overlong, a surrogate, beyond the last character.
  EXPECT_EQ(printable("\x9b"
                      "31m"),
            "\\x9b31m");
  EXPECT_EQ(printable("\xe2\x82"), "\\xe2\\x82");
  EXPECT_EQ(printable("\xc0\x9b\xe0\x82\x9b"), "\\xc0\\x9b\\xe0\\x82\\x9b");
  EXPECT_EQ(printable("\xed\xa0\x80\xf4\x90\x80\x80"), "\\xed\\xa0\\x80\\xf4\\x90\\x80\\x80");
  for (int b = 0; b < 256; ++b)
    for (char c : printable(std::string(1, static_cast<char>(b)))) EXPECT_TRUE(c >= 0x20 && c < 0x7f) << b;
}

TEST(Printable, AnErrorIsOneLineWhateverItQuotes) {
  const Error e{ErrorKind::kInvalidData, "a\nb.ply", "found \"\x1b]0;x\x07\"", "get a whole\ncopy", uint64_t{7}};
  EXPECT_EQ(e.text(), "a\\nb.ply: at byte 7: found \"\\x1b]0;x\\x07\" (get a whole\\ncopy)");
}

long minorFaults() {
  struct rusage usage {};
  getrusage(RUSAGE_SELF, &usage);
  return usage.ru_minflt;
}
// Page faults that 16 MiB of malloc's memory take, piece by piece.
long faultsOfUse() {
  const long before = minorFaults();
  std::vector<std::unique_ptr<char[]>> blocks;
  for (int i = 0; i < 256; ++i) {
    blocks.push_back(std::unique_ptr<char[]>(new char[64 << 10]));
    for (int at = 0; at < 64 << 10; at += 4096) static_cast<volatile char&>(blocks.back()[static_cast<size_t>(at)]) = 1;
  }
  return minorFaults() - before;
}
TEST(HeapWarmer, MallocsMemoryIsThereBefore) {
#ifdef RELIEVO_SANITIZED
  GTEST_SKIP() << "sanitizers bring a malloc of their own";
#endif
  const long cold = faultsOfUse();
  { HeapWarmer heap(size_t{48} << 20); }
  const long warm = faultsOfUse();
  std::printf("[ heap ] 16 MiB: %ld page faults cold, %ld warm\n", cold, warm);
  EXPECT_LT(warm, 400);
  EXPECT_GT(cold, warm);
}

// A build beside it gives back what malloc has no use for, while the memory is warmed.
TEST(HeapWarmer, LeavesAloneWhatIsGivenBackMeanwhile) {
#ifdef RELIEVO_SANITIZED
  GTEST_SKIP() << "sanitizers bring a malloc of their own";
#endif
  for (int i = 0; i < 20; ++i) {
    HeapWarmer heap(size_t{48} << 20);
    malloc_trim(0);
  }
}

// ---- JSON of files ----

TEST(ParseJson, WhatIsDeeperOrWiderThanTheLimitsIsRefusedWithItsPlace) {
  auto nested = [](size_t depth) { return std::string(depth, '[') + std::string(depth, ']'); };
  EXPECT_TRUE(parseJson(nested(kMaxJsonDepth), "m").ok());
  for (size_t depth : {size_t{kMaxJsonDepth} + 1, size_t{1000000}}) {
    auto json = parseJson(nested(depth), "m");
    ASSERT_FALSE(json.ok()) << depth;
    EXPECT_EQ(json.error().kind, ErrorKind::kInvalidData);
    EXPECT_EQ(json.error().file, "m");
    EXPECT_EQ(json.error().offset, uint64_t{kMaxJsonDepth});
    EXPECT_NE(json.error().message.find("64 levels"), std::string::npos) << json.error().message;
  }
  EXPECT_TRUE(parseJson(nested(3), "m", 3).ok());
  EXPECT_FALSE(parseJson(nested(4), "m", 3).ok());
  std::string objects;
  for (int i = 0; i < 1000000; ++i) objects += "{\"a\":";
  EXPECT_EQ(parseJson(objects, "m").error().offset, 5 * uint64_t{kMaxJsonDepth});
  // Brackets and colons of strings are text.
  const std::string quoted = "{\"a\": \"" + std::string(1000, '[') + std::string(1000, ':') + "\\\"[[\", \"b\": 2}";
  auto json = parseJson(quoted, "m");
  ASSERT_TRUE(json.ok()) << json.error().text();
  EXPECT_EQ((*json)["b"], 2);
  auto wide = [](size_t members) {
    std::string text = "{";
    for (size_t i = 0; i < members; ++i) text += (i ? ",\"" : "\"") + std::to_string(i) + "\":0";
    return text + "}";
  };
  EXPECT_TRUE(parseJson(wide(kMaxJsonMembers), "m").ok());
  EXPECT_FALSE(parseJson(wide(kMaxJsonMembers + 1), "m").ok());
  std::string wides = "[" + wide(kMaxJsonMembers);
  for (size_t i = 0; i <= 2 * kMaxJsonComparisons / (kMaxJsonMembers * kMaxJsonMembers); ++i)
    wides += "," + wide(kMaxJsonMembers);
  const auto too_many = parseJson(wides + "]", "m");
  ASSERT_FALSE(too_many.ok());
  EXPECT_EQ(too_many.error().message, "too many of its JSON objects have hundreds of members");
  EXPECT_TRUE(parseJson("[" + wide(kMaxJsonMembers) + "," + wide(kMaxJsonMembers) + "]", "m").ok()) << "of one object";
  auto many = [](size_t values) {
    std::string text = "[0";
    for (size_t i = 1; i < values; ++i) text += ",0";
    return text + "]";
  };
  EXPECT_TRUE(parseJson(many(kMaxJsonValues - 1), "m").ok());
  EXPECT_FALSE(parseJson(many(kMaxJsonValues + 1), "m").ok());
}

TEST(ParseJson, WhatIsNoJsonIsAnErrorAtItsPlace) {
  for (auto [text, place] : {std::pair<const char*, uint64_t>{"{\"a\": nul}", 9},
                             {"[1, 2", 5},
                             {"", 0},
                             {"]", 0},
                             {"{} x", 3},
                             {"[1e999999]", 8}}) {
    auto json = parseJson(text, "state.json");
    ASSERT_FALSE(json.ok()) << text;
    EXPECT_EQ(json.error().kind, ErrorKind::kInvalidData) << text;
    EXPECT_EQ(json.error().offset, place) << text;
  }
  // In the order of the text.
  auto json = parseJson("{\"z\": 1, \"a\": [true, null]}", "m");
  ASSERT_TRUE(json.ok());
  EXPECT_EQ(json->dump(), "{\"z\":1,\"a\":[true,null]}");
}

}  // namespace base_test
}  // namespace relievo
