// Builds that are stopped and go on: the same bytes as one that was not, or a build from the start, whatever became of
// the checkpoint.
#include <gtest/gtest.h>

#include <chrono>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <thread>

#include "package_fixture.h"
#include "src/base/file.h"
#include "tests/view_share.h"
#include "texturing/package/package_builder.h"

namespace relievo {
namespace build_checkpoint_test {

using namespace testing_support;
namespace fs = std::filesystem;

using Files = std::map<std::string, std::string>;

Files filesIn(const std::string& folder) {
  Files out;
  for (const auto& e : fs::directory_iterator(folder)) {
    std::ifstream in(e.path(), std::ios::binary);
    out[e.path().filename().string()] = {std::istreambuf_iterator<char>(in), {}};
  }
  return out;
}
void restore(const std::string& folder, const Files& files) {
  for (const auto& e : fs::directory_iterator(folder)) fs::remove(e.path());
  for (const auto& [name, bytes] : files) std::ofstream(folder + "/" + name, std::ios::binary) << bytes;
}

// At its second read it waits until the first part is checkpointed, then stops the build or fails.
class StoppingTexture final : public TextureSource {
 public:
  StoppingTexture(const TextureSource& inner, std::string folder, std::atomic<bool>* stop)
      : inner_(inner), folder_(std::move(folder)), stop_(stop) {}
  int64_t width() const override { return inner_.width(); }
  int64_t height() const override { return inner_.height(); }
  TextureFormat format() const override { return inner_.format(); }
  Provenance provenance() const override { return inner_.provenance(); }
  Result<void> read(const Rect& rect, std::span<uint8_t> out) const override {
    if (++reads_ == 2) {
      for (int i = 0; i < 3000 && !checkpointed(); ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
      if (!stop_) return Error{ErrorKind::kIo, "photograph", "reading failed", "", {}};
      stop_->store(true);
    }
    return inner_.read(rect, out);
  }

 private:
  bool checkpointed() const {
    int parts = 0;
    for (const auto& e : fs::directory_iterator(folder_))
      parts += e.path().string().find(".part-") != std::string::npos && fs::file_size(e.path()) > 0;
    return parts == 2;
  }
  const TextureSource& inner_;
  std::string folder_;
  std::atomic<bool>* stop_;
  mutable std::atomic<int> reads_{0};
};

// Stops the build when the relief is read, which is the last part.
class StoppingHeights final : public HeightSource {
 public:
  StoppingHeights(const HeightSource& inner, std::atomic<bool>* stop) : inner_(inner), stop_(stop) {}
  int64_t width() const override { return inner_.width(); }
  int64_t height() const override { return inner_.height(); }
  double minMm() const override { return inner_.minMm(); }
  double maxMm() const override { return inner_.maxMm(); }
  Provenance provenance() const override { return inner_.provenance(); }
  Result<void> read(const Rect& rect, std::span<float> out) const override {
    stop_->store(true);
    return inner_.read(rect, out);
  }

 private:
  const HeightSource& inner_;
  std::atomic<bool>* stop_;
};

class Checkpoint : public ::testing::Test {
 protected:
  // The texture's finest stage has two parts and its next one has one; the relief is coarser and has its own.
  NoisyTexture texture_{1040, 520, Basis::kColour, 5};
  NoisyHeights heights_{520, 260, 6};
  ScratchFolder folder_;
  std::string notes_;

  BuildOptions options(int workers = 1) {
    BuildOptions o;
    o.output = folder_.file("a.relievo");
    o.workers = workers;
    o.memory_budget_bytes = uint64_t{256} << 20;
    o.tool_version = "test";
    o.checkpoint_s = 0;
    o.resume = true;
    o.note = [this](const std::string& text) { notes_ += text + "\n"; };
    return o;
  }
  std::string whole(const BuildOptions& like, const TextureSource& texture) {
    ScratchFolder elsewhere;
    BuildOptions o = like;
    o.output = elsewhere.file("a.relievo");
    o.checkpoint_s = -1, o.resume = false, o.workers = 3;
    auto built = buildPackage(texture, &heights_, o);
    EXPECT_TRUE(built.ok()) << built.error().text();
    return filesIn(fs::path(o.output).parent_path())["a.relievo"];
  }
  std::string folder() { return fs::path(folder_.file("a")).parent_path(); }
  // What an interrupted build leaves: the pages and the journal.
  Files interruptedBuild() {
    restore(folder(), {});
    std::atomic<bool> stop{false};
    StoppingTexture stopping(texture_, folder(), &stop);
    BuildOptions o = options();
    o.interrupted = &stop;
    auto built = buildPackage(stopping, &heights_, o);
    EXPECT_FALSE(built.ok());
    EXPECT_EQ(built.error().kind, ErrorKind::kInterrupted);
    EXPECT_NE(built.error().text().find("--resume"), std::string::npos) << built.error().text();
    Files left = filesIn(folder());
    EXPECT_EQ(left.size(), 2u);
    notes_.clear();
    return left;
  }
  static std::string journalIn(const Files& files) {
    for (const auto& [name, bytes] : files)
      if (bytes.starts_with("RELJ")) return name;
    return "";
  }
  void expectTheSamePackage(const std::string& expected, const BuildOptions& o, const std::string& note) {
    notes_.clear();
    auto built = buildPackage(texture_, &heights_, o);
    ASSERT_TRUE(built.ok()) << built.error().text();
    const Files now = filesIn(folder());
    ASSERT_EQ(now.size(), 1u);
    EXPECT_TRUE(now.at("a.relievo") == expected);
    EXPECT_NE(notes_.find(note), std::string::npos) << notes_;
  }
};

TEST_F(Checkpoint, ABuildGoesOnWithAnyNumberOfWorkers) {
  const std::string expected = whole(options(), texture_);
  for (int workers : {1, 2, 4}) {
    interruptedBuild();
    expectTheSamePackage(expected, options(workers), "going on from a checkpoint");
  }
}

TEST_F(Checkpoint, ABuildThatIsStoppedTwiceGoesOn) {
  const std::string expected = whole(options(), texture_);
  const Files first = interruptedBuild();
  // The second is stopped before it reads anything.
  std::atomic<bool> stop{true};
  BuildOptions o = options();
  o.interrupted = &stop;
  auto built = buildPackage(texture_, &heights_, o);
  ASSERT_FALSE(built.ok());
  EXPECT_EQ(built.error().kind, ErrorKind::kInterrupted);
  EXPECT_TRUE(filesIn(folder()) == first);  // compared so that a difference does not print them
  expectTheSamePackage(expected, options(2), "going on from a checkpoint");
}

TEST_F(Checkpoint, AnErrorKeepsWhatIsDoneWhenAskedTo) {
  const std::string expected = whole(options(), texture_);
  StoppingTexture failing(texture_, folder(), nullptr);
  auto built = buildPackage(failing, &heights_, options());
  ASSERT_FALSE(built.ok());
  EXPECT_EQ(built.error().kind, ErrorKind::kIo);
  EXPECT_NE(built.error().text().find("--resume"), std::string::npos) << built.error().text();
  expectTheSamePackage(expected, options(2), "going on from a checkpoint");
}

TEST_F(Checkpoint, WithoutResumeNothingIsLeftAndWhatWasLeftIsRemoved) {
  std::atomic<bool> stop{false};
  StoppingTexture stopping(texture_, folder(), &stop);
  BuildOptions o = options();
  o.resume = false;
  o.interrupted = &stop;
  EXPECT_FALSE(buildPackage(stopping, &heights_, o).ok());
  EXPECT_EQ(folder_.entries(), 0u);
  interruptedBuild();
  o.interrupted = nullptr;
  expectTheSamePackage(whole(options(), texture_), o, "");
}

TEST_F(Checkpoint, WithNoneTheBuildStartsFromTheBeginning) {
  expectTheSamePackage(whole(options(), texture_), options(), "building from the start: there is no checkpoint");
}

TEST_F(Checkpoint, OtherInputsOrOptionsStartFromTheBeginning) {
  const Files left = interruptedBuild();
  const NoisyTexture original = texture_;
  for (int change = 0; change < 5; ++change) {
    restore(folder(), left);
    BuildOptions o = options();
    texture_ = original;
    if (change == 0) texture_ = NoisyTexture(1040, 520, Basis::kColour, 6);
    if (change == 1) o.zstd_level = 3;
    if (change == 2) o.colour = {PageCodec::kQuantised, 6};
    if (change == 3) o.mm_per_px = 2;
    if (change == 4) o.tool_version = "another";
    expectTheSamePackage(
        whole(o, texture_), o,
        "building from the start: the inputs, the options or the program are not those of the checkpoint");
  }
}

TEST_F(Checkpoint, ALivingBuildsFilesAreNotTaken) {
  const Files left = interruptedBuild();
  auto held = OutputFile::orphans(folder_.file("a.relievo"));
  ASSERT_TRUE(held.ok());
  ASSERT_EQ(held->size(), 2u);
  for (OutputFile& f : *held) f.keep();
  auto built = buildPackage(texture_, &heights_, options());
  ASSERT_TRUE(built.ok()) << built.error().text();
  EXPECT_NE(notes_.find("there is no checkpoint"), std::string::npos) << notes_;
  Files now = filesIn(folder());
  now.erase("a.relievo");
  EXPECT_TRUE(now == left);
}

// A stop in the last part, which the build mostly sees behind it, and a kill while the file is filled in: the work is
// not lost.
TEST_F(Checkpoint, ABuildThatIsStoppedAtItsEndGoesOn) {
  const std::string expected = whole(options(), texture_);
  restore(folder(), {});
  std::atomic<bool> stop{false};
  BuildOptions o = options();
  o.interrupted = &stop;
  const StoppingHeights stopping(heights_, &stop);
  auto built = buildPackage(texture_, &stopping, o);
  ASSERT_FALSE(built.ok());
  EXPECT_EQ(built.error().kind, ErrorKind::kInterrupted);
  const Files left = filesIn(folder());
  ASSERT_EQ(left.size(), 2u);
  expectTheSamePackage(expected, options(2), "going on from a checkpoint");

  // As a kill leaves it that comes when the file is filled in: anything before the pages and behind them.
  Files killed = left;
  for (auto& [name, bytes] : killed) {
    if (name == journalIn(left)) continue;
    const size_t first_page = bytes.find_first_not_of('\0');
    std::fill(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(first_page), '\xAA');
    bytes += std::string(5000, '\xAA');
  }
  restore(folder(), killed);
  expectTheSamePackage(expected, options(2), "going on from a checkpoint");
}

// Every byte of the journal's records is covered by a checksum, and every page by its own. A damaged checkpoint never
// makes another package, and never a failure.
TEST_F(Checkpoint, DamageNeverMakesAnotherPackage) {
  const std::string expected = whole(options(), texture_);
  const Files left = interruptedBuild();
  const std::string journal = journalIn(left);
  ASSERT_FALSE(journal.empty());
  const std::string& records = left.at(journal);
  // The journal's head, a part, and the first checkpoint: type, bytes, checksum, body.
  auto bytesAt = [&](size_t at) {
    uint64_t value = 0;
    std::memcpy(&value, records.data() + at, sizeof value);
    return static_cast<size_t>(value);
  };
  constexpr size_t kHead = 20;
  const size_t part = kHead + bytesAt(4), checkpoint = part + kHead + bytesAt(part + 4), end = checkpoint + kHead + 8;
  ASSERT_LE(end, records.size());
  const size_t pages_end = bytesAt(checkpoint + kHead);

  const std::string start = "building from the start: ", damaged = start + "the checkpoint is damaged",
                    on = "going on from a checkpoint";
  auto expectAfter = [&](const std::string& name, const std::string& bytes, const std::string& what,
                         const std::string& note) {
    SCOPED_TRACE((name == journal ? "journal, " : "pages, ") + what);
    Files files = left;
    files[name] = bytes;
    restore(folder(), files);
    BuildOptions o = options(2);
    o.checkpoint_s = 1000;  // none: many builds, and each checkpoint waits for the disk
    expectTheSamePackage(expected, o, note);
  };
  for (const auto& [name, bytes] : left) {
    std::map<size_t, std::string> flipped, cut;
    if (name == journal) {
      for (size_t at : {size_t{0}, size_t{5}, size_t{12}, kHead}) flipped[at] = start;
      for (size_t at :
           {size_t{0}, size_t{4}, size_t{19}, kHead, kHead + 30, bytesAt(part + 4) / 2, kHead + bytesAt(part + 4) - 1})
        flipped[part + at] = damaged;
      for (size_t at : {size_t{0}, size_t{4}, size_t{12}, kHead, kHead + 7}) flipped[checkpoint + at] = damaged;
      cut = {{0, start}, {3, start}, {part, damaged}, {checkpoint - 1, damaged}, {end - 1, damaged}, {end, on}};
    } else {
      const size_t first_page = bytes.find_first_not_of('\0');
      ASSERT_LT(first_page, pages_end);
      for (size_t at : {first_page, first_page + 100, (first_page + pages_end) / 2, pages_end - 1})
        flipped[at] = damaged;
      flipped[first_page / 2] = on;  // filled in again
      cut = {{0, damaged}, {first_page - 1, damaged}, {pages_end - 1, damaged}, {pages_end, on}};
    }
    size_t tried = 0;
    for (const auto& [at, note] : flipped) {
      if (test::kSanitized && ++tried % 2 == 0) continue;
      std::string other = bytes;
      other[at] = static_cast<char>(other[at] ^ 0x20);
      expectAfter(name, other, "byte " + std::to_string(at), note);
    }
    for (const auto& [size, note] : cut)
      expectAfter(name, bytes.substr(0, size), "cut at " + std::to_string(size), note);
  }
  restore(folder(), left);
  expectTheSamePackage(expected, options(2), on);
}

}  // namespace build_checkpoint_test
}  // namespace relievo
