// What a user sees of packages that are damaged, cannot be read, or were made to take memory, stack and time.
#include <xxhash.h>

#include <algorithm>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "cli_fixture.h"
#include "tests/other_bases.h"
#include "tests/view_share.h"
#include "texturing/package/package_layout.h"

namespace package_cli_test {

using namespace relievo;
using namespace relievo::testing_support;

class PackageCli : public Cli {
 protected:
  void SetUp() override {
    Cli::SetUp();
    const Outcome made =
        relievo("sample inscription -o " + file("s") + " --size 400x300 --write height --package " + file("a.relievo"));
    ASSERT_EQ(made.exit_code, 0) << made.output;
    bytes_ = readAll("a.relievo");
    auto header = decodeHeader({reinterpret_cast<const uint8_t*>(bytes_.data()), kHeaderBytes}, "a.relievo");
    ASSERT_TRUE(header.ok());
    header_ = *header;
  }
  std::string readAll(const std::string& name) const {
    std::ifstream in(file(name), std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  // Both copies of the header, with fitting checksums: what an attacker would do.
  static void setHeader(std::string& bytes, const PackageHeader& h) {
    auto* p = reinterpret_cast<uint8_t*>(bytes.data());
    encodeHeader(h, {p, kHeaderBytes});
    encodeHeader(h, {p + bytes.size() - kHeaderBytes, kHeaderBytes});
  }
  // A file whose header has the artwork's size, and the index and pages that belong to it, behind the sound header's
  // manifest.
  PackageHeader hugeHeader(uint64_t side_px) const {
    PackageHeader h = header_;
    FlatDomain d = h.domain.flat();
    d.width_px = d.height_px = side_px;
    d.texture_depth = FlatDomain::depthFor(side_px, side_px);
    h.domain = d;
    const PackageLayout layout = packageLayout(h);
    h.index_bytes = layout.index_bytes;
    h.page_count = layout.page_count;
    h.pages_offset = h.index_offset + h.index_bytes;
    h.pages_bytes = h.page_count;
    h.file_bytes = h.pages_offset + h.pages_bytes + kHeaderBytes;
    return h;
  }
  // Standard output goes to the file, the rest into the outcome.
  Outcome runTo(const std::string& name, const std::string& command) const {
    return run("( " + command + " >" + file(name) + " )");
  }
  static std::ptrdiff_t lines(const std::string& text) { return std::count(text.begin(), text.end(), '\n'); }

  std::string bytes_;
  PackageHeader header_;
};

// 12 KB that claim 2^24 x 2^24 px: every command ends at once, with one line.
TEST_F(PackageCli, ClaimsThatTheFileCannotHoldAreRefusedByEveryCommand) {
  std::string bytes = bytes_.substr(0, 12288);
  encodeHeader(hugeHeader(uint64_t{1} << 24), {reinterpret_cast<uint8_t*>(bytes.data()), kHeaderBytes});
  write("huge.relievo", bytes);
  const std::string huge = file("huge.relievo");
  for (const std::string& command :
       {"info " + huge, "info --json " + huge, "verify " + huge, "verify --json " + huge, "verify --repair " + huge,
        "export " + huge + " -o " + file("p.ply"), "render " + huge + " -o " + file("p.png"), "view " + huge,
        "bench " + huge, "compare " + huge + " -o " + file("report")}) {
#ifdef RELIEVO_ADDRESS_SANITIZER
    const char* limit = "";  // the sanitizer maps terabytes
#else
    const char* limit = "ulimit -v 4000000; ";
#endif
    const Outcome r = run(limit + std::string("timeout 60 " RELIEVO_PROGRAM " ") + command);
    EXPECT_EQ(r.exit_code, 3) << command << ": " << r.output;
    EXPECT_EQ(lines(r.output), 1) << command << ": " << r.output;
    EXPECT_NE(r.output.find("found a file of 12288 bytes"), std::string::npos) << r.output;
  }
  EXPECT_FALSE(fs::exists(file("p.png")));
}

// A package of a basis that the program is not built with: nothing draws or describes it by mistake.
TEST_F(PackageCli, ABasisThatIsNotKnownIsUnsupported) {
  PackageHeader h = header_;
  h.texture.basis = test::otherBases()[0];
  std::string bytes = bytes_;
  setHeader(bytes, h);
  write("other.relievo", bytes);
  for (const char* command : {"info ", "info --json ", "verify ", "export -o x.ply ", "view "}) {
    const Outcome r = relievo(command + file("other.relievo"));
    EXPECT_EQ(r.exit_code, 5) << command << ": " << r.output;
    EXPECT_EQ(lines(r.output), 1) << r.output;
    EXPECT_NE(r.output.find("the texture's basis 'test-hsh4-lrgb' is not known to this program"), std::string::npos)
        << r.output;
  }
  EXPECT_EQ(relievo("info " + file("a.relievo")).exit_code, 0) << "control";
}

// A file that is as long as it claims, of holes: the walk over its index takes minutes, and ends when it is told to.
TEST_F(PackageCli, WalksOverAFilesClaimsEndWhenInterrupted) {
  PackageHeader h = hugeHeader(uint64_t{1} << 22);
  std::string bytes = bytes_.substr(0, header_.index_offset);
  encodeHeader(h, {reinterpret_cast<uint8_t*>(bytes.data()), kHeaderBytes});
  write("holes.relievo", bytes);
  std::error_code bad;
  fs::resize_file(file("holes.relievo"), h.file_bytes, bad);
  ASSERT_FALSE(bad) << "this file system has no room for holes: " << bad.message();
  for (const char* command : {"info ", "verify ", "verify --json "}) {
    for (const char* signal : {"INT", "TERM"}) {
      const Outcome r = runTo("out", "timeout --foreground --preserve-status -k 60 -s " + std::string(signal) +
                                         " 1 " RELIEVO_PROGRAM " " + command + file("holes.relievo"));
      EXPECT_EQ(r.exit_code, 130) << command << signal << ": " << r.output;
      EXPECT_NE(r.output.find("interrupted"), std::string::npos) << r.output;
    }
  }
  EXPECT_LT(fs::file_size(file("out")), uint64_t{64} << 20);
}

TEST_F(PackageCli, ADeepManifestTakesNoStack) {
  std::string deep;
  constexpr int kLevels = test::kSanitized ? 100000 : 300000;
  for (int i = 0; i < kLevels; ++i) deep += "{\"mesh\":";
  deep += "0" + std::string(kLevels, '}');
  // Of a scan, what the manifest says of it is printed.
  write("scan.off", "OFF\n4 2 0\n0 0 0\n10 0 0\n10 10 1\n0 10 0\n3 0 1 2\n3 0 2 3\n");
  ASSERT_EQ(relievo("build --mesh " + file("scan.off") + " -o " + file("scan.relievo")).exit_code, 0);
  for (const char* package : {"a.relievo", "scan.relievo"}) {
    std::string bytes = readAll(package);
    auto header = decodeHeader({reinterpret_cast<const uint8_t*>(bytes.data()), kHeaderBytes}, package);
    ASSERT_TRUE(header.ok());
    PackageHeader h = *header;
    h.manifest_offset = bytes.size();
    h.manifest_bytes = deep.size();
    h.manifest_hash = XXH3_64bits(deep.data(), deep.size());
    bytes += deep + std::string(kHeaderBytes, '\0');
    h.file_bytes = bytes.size();
    setHeader(bytes, h);
    write("deep.relievo", bytes);
    for (const char* command : {"info ", "info --json "}) {
      const Outcome r = relievo(command + file("deep.relievo"));
      EXPECT_EQ(r.exit_code, 0) << r.output.substr(0, 1000);
      EXPECT_NE(r.output.find("64 levels"), std::string::npos) << r.output.substr(0, 1000);
    }
    EXPECT_EQ(relievo("verify " + file("deep.relievo")).exit_code, 3);
  }
  // The same of the files that options name, which may be less long.
  deep = deep.substr(0, 100000 * std::string("{\"mesh\":").size());
  write("deep.json", deep);
  Outcome r = relievo("render " + file("a.relievo") + " -o " + file("p.png") + " --state " + file("deep.json"));
  EXPECT_EQ(r.exit_code, 3) << r.output;
  EXPECT_NE(r.output.find("64 levels"), std::string::npos) << r.output;
  r = relievo("compare " + file("a.relievo") + " -o " + file("report") + " --path " + file("deep.json"));
  EXPECT_EQ(r.exit_code, 3) << r.output;
  EXPECT_NE(r.output.find("64 levels"), std::string::npos) << r.output;
}

// One line, exit code 3, and the picture that was there stays; --allow-damage draws it all the same.
TEST_F(PackageCli, APictureOfADamagedPackageTakesNoGoodOnesPlace) {
  const std::string render = "render " + file("b.relievo") + " --size 160x90 -o " + file("p.png");
  write("b.relievo", bytes_);
  const Outcome sound = relievo(render);
  if (noGl(sound)) GTEST_SKIP() << sound.output;
  ASSERT_EQ(sound.exit_code, 0) << sound.output;
  EXPECT_EQ(sound.output, "");
  const std::string good = readAll("p.png");
  std::string damaged = bytes_;
  for (uint64_t i = 0; i < header_.pages_bytes; i += 64) damaged[header_.pages_offset + i] ^= 1;
  const std::string cut = bytes_.substr(0, header_.pages_offset + header_.pages_bytes / 4);
  for (const std::string& bytes : test::kSanitized ? std::vector{damaged} : std::vector{damaged, cut}) {
    write("b.relievo", bytes);
    Outcome r = relievo(render);
    EXPECT_EQ(r.exit_code, 3) << r.output;
    EXPECT_EQ(lines(r.output), 1) << r.output;
    EXPECT_NE(r.output.find("relievo: error: " + file("b.relievo") + ": "), std::string::npos) << r.output;
    for (const char* part : {" pages that the picture needs could not be read; the first: page plane ",
                             "relievo verify", "--allow-damage"})
      EXPECT_NE(r.output.find(part), std::string::npos) << part << " in " << r.output;
    EXPECT_TRUE(readAll("p.png") == good);
    r = relievo(render + " --allow-damage");
    EXPECT_EQ(r.exit_code, 0) << r.output;
    EXPECT_EQ(lines(r.output), 1) << r.output;
    EXPECT_NE(r.output.find("relievo: warning: "), std::string::npos) << r.output;
    EXPECT_FALSE(readAll("p.png") == good);
    write("p.png", good);
  }
  // What does not concern the picture does not keep it from being drawn: a damaged copy of the header.
  std::string copy = bytes_;
  copy[copy.size() - 100] ^= 1;
  write("b.relievo", copy);
  const Outcome r = relievo(render);
  EXPECT_EQ(r.exit_code, 0) << r.output;
  EXPECT_TRUE(readAll("p.png") == good);
}

TEST_F(PackageCli, CompareAndBenchMeasureNoDamagedPackage) {
  std::string damaged = bytes_;
  for (uint64_t i = 0; i < header_.pages_bytes; i += 64) damaged[header_.pages_offset + i] ^= 1;
  write("b.relievo", damaged);
  for (const std::string& command : {"bench --quick --only decode --json " + file("b.json") + " " + file("b.relievo"),
                                     "compare --quick --size 64x36 -o " + file("report") + " " + file("b.relievo")}) {
    const Outcome r = runTo("out", RELIEVO_PROGRAM " " + command);
    if (noGl(r)) GTEST_SKIP() << r.output;
    EXPECT_EQ(r.exit_code, 3) << command << ": " << r.output;
    EXPECT_EQ(lines(r.output), 1) << r.output;
    EXPECT_NE(r.output.find("page plane "), std::string::npos) << r.output;
  }
  EXPECT_FALSE(fs::exists(file("b.json")));
  EXPECT_FALSE(fs::exists(file("report/report.json")));
}

TEST_F(PackageCli, VerifyNamesTenAndCountsTheRest) {
  std::string damaged = bytes_;
  for (uint64_t i = 0; i < header_.pages_bytes; i += 64) damaged[header_.pages_offset + i] ^= 1;
  write("b.relievo", damaged);
  const Outcome r = relievo("verify " + file("b.relievo"));
  EXPECT_EQ(r.exit_code, 3) << r.output;
  EXPECT_EQ(lines(r.output), 10 + 1 + 1 + 1) << r.output;  // faults, the rest, the sum, the error
  const uint64_t pages = header_.page_count;
  ASSERT_GT(pages, 12u);
  EXPECT_NE(r.output.find("and " + std::to_string(pages - 10) + " more"), std::string::npos) << r.output;
  EXPECT_NE(r.output.find(std::to_string(pages) + " damaged pages, 0 other faults"), std::string::npos) << r.output;
  ASSERT_EQ(runTo("b.json", RELIEVO_PROGRAM " verify --json " + file("b.relievo")).exit_code, 3);
  auto json = nlohmann::json::parse(readAll("b.json"), nullptr, false);
  ASSERT_TRUE(json.is_object()) << readAll("b.json");
  EXPECT_EQ(json["damaged"].size(), pages);
  EXPECT_EQ(json["damaged_pages"], pages);
  for (const auto& page : json["damaged"]) EXPECT_TRUE(page["level"].is_number() && page["what"].is_string());
  EXPECT_TRUE(json["other"].empty() && json["unreadable"].empty());
}

// Storage that fails is not damage, and one cannot say that the package is sound.
TEST_F(PackageCli, VerifyTellsInputErrorsFromDamage) {
  Outcome r = relievo("verify --source-fail 100 " + file("a.relievo"));
  EXPECT_EQ(r.exit_code, 2) << r.output;
  EXPECT_EQ(r.output.find("damaged:"), std::string::npos) << r.output;
  EXPECT_NE(r.output.find("0 damaged pages"), std::string::npos) << r.output;
  EXPECT_NE(r.output.find(std::to_string(header_.page_count) + " parts could not be read"), std::string::npos)
      << r.output;
  ASSERT_EQ(runTo("b.json", RELIEVO_PROGRAM " verify --json --source-fail 100 " + file("a.relievo")).exit_code, 2);
  auto json = nlohmann::json::parse(readAll("b.json"), nullptr, false);
  ASSERT_TRUE(json.is_object()) << readAll("b.json");
  EXPECT_EQ(json["unreadable"].size(), header_.page_count);
  EXPECT_TRUE(json["damaged"].empty());
}

TEST_F(PackageCli, VerifyRepairsWhatIsThereTwice) {
  for (uint64_t at : {uint64_t{100}, uint64_t{bytes_.size() - 5}, uint64_t{header_.index_offset - 1}}) {
    std::string broken = bytes_;
    broken[at] ^= 4;
    write("b.relievo", broken);
    Outcome r = relievo("verify " + file("b.relievo"));
    EXPECT_EQ(r.exit_code, 3) << r.output;
    EXPECT_NE(r.output.find("0 damaged pages, 1 other faults"), std::string::npos) << r.output;
    EXPECT_NE(r.output.find("verify --repair restores it"), std::string::npos) << r.output;
    EXPECT_TRUE(readAll("b.relievo") == broken) << "without --repair nothing is written";
    r = relievo("verify --repair " + file("b.relievo"));
    EXPECT_EQ(r.exit_code, 0) << r.output;
    EXPECT_NE(r.output.find("repaired: the "), std::string::npos) << r.output;
    EXPECT_TRUE(readAll("b.relievo") == bytes_);
  }
  // Beside what is beyond repair: done, and said.
  std::string broken = bytes_;
  broken[100] ^= 4;
  broken[header_.pages_offset + 100] ^= 4;
  write("b.relievo", broken);
  const Outcome r = relievo("verify --repair " + file("b.relievo"));
  EXPECT_EQ(r.exit_code, 3) << r.output;
  EXPECT_NE(r.output.find("repaired: the header"), std::string::npos) << r.output;
  EXPECT_NE(r.output.find("1 damaged pages, 0 other faults"), std::string::npos) << r.output;
  broken[100] ^= 4;
  EXPECT_TRUE(readAll("b.relievo") == broken);
}

}  // namespace package_cli_test
