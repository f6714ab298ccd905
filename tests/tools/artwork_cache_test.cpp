// view and render of what is no package: built once into a cache that is found by content, stays within its bound and
// leaves nothing half done.
#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "tests/tools/cli_fixture.h"
#include "texturing/import/image_io.h"

namespace relievo {
namespace artwork_cache_test {

namespace fs = std::filesystem;
using testing_support::Outcome;
using testing_support::run;

class ArtworkCache : public testing_support::Cli {
 protected:
  std::string cache() const { return file("cache"); }
  std::vector<fs::path> packages() const {
    std::vector<fs::path> found;
    std::error_code none;
    for (const auto& e : fs::directory_iterator(cache(), none))
      if (e.path().extension() == ".relievo") found.push_back(e.path());
    std::sort(found.begin(), found.end());
    return found;
  }
  int filesInCache() const {
    return static_cast<int>(std::distance(fs::directory_iterator(cache()), fs::directory_iterator()));
  }
  Outcome render(const std::string& artwork, const std::string& picture, const std::string& more = "") const {
    return relievo("render " + file(artwork) + " -o " + file(picture) + " --size 160x120 --cache-dir " + cache() + " " +
                   more);
  }
  std::string bytes(const std::string& name) const {
    std::ifstream in(file(name), std::ios::binary);
    std::stringstream all;
    all << in.rdbuf();
    return all.str();
  }
  void sample(const std::string& arguments) const {
    const Outcome made = relievo("sample " + arguments + " -o " + file("sample"));
    ASSERT_EQ(made.exit_code, 0) << made.output;
  }
  // A scan of two triangles whose colour another file says.
  void writeScan(const std::string& colour) const {
    write("scan.obj", "mtllib scan.mtl\nv 0 0 0\nv 9 0 0\nv 9 9 1\nv 0 9 0\nusemtl a\nf 1 2 3\nf 1 3 4\n");
    write("scan.mtl", "newmtl a\nKd " + colour + "\n");
  }
};

TEST_F(ArtworkCache, APtmIsBuiltOnceAndDrawnAsItsPackage) {
  sample("inscription --size 160x128 --write ptm-lrgb");
  const Outcome first = render("sample/ptm_lrgb.ptm", "first.png");
  ASSERT_EQ(first.exit_code, 0) << first.output;
  ASSERT_EQ(packages().size(), 1u);
  const auto made = fs::last_write_time(packages()[0]);
  // The control of "no build": the inode stays.
  const int before = ::open(packages()[0].c_str(), O_RDONLY);
  const Outcome second = render("sample/ptm_lrgb.ptm", "second.png");
  ASSERT_EQ(second.exit_code, 0) << second.output;
  ASSERT_EQ(packages().size(), 1u);
  struct stat held {
  }, now{};
  ::fstat(before, &held);
  ::stat(packages()[0].c_str(), &now);
  ::close(before);
  EXPECT_EQ(held.st_ino, now.st_ino) << "a second opening builds nothing";
  EXPECT_GE(fs::last_write_time(packages()[0]), made);
  ASSERT_EQ(relievo("build --ptm " + file("sample/ptm_lrgb.ptm") + " -o " + file("made.relievo")).exit_code, 0);
  EXPECT_TRUE(bytes("made.relievo") == bytes("cache/" + packages()[0].filename().string()))
      << "the bytes of relievo build";
  ASSERT_EQ(render("made.relievo", "made.png").exit_code, 0);
  EXPECT_TRUE(bytes("first.png") == bytes("made.png"));
  EXPECT_TRUE(bytes("first.png") == bytes("second.png"));
}

TEST_F(ArtworkCache, FoundByContentNotByName) {
  sample("inscription --size 96x64 --write ptm-lrgb");
  fs::copy(file("sample/ptm_lrgb.ptm"), file("other.ptm"));
  ASSERT_EQ(render("sample/ptm_lrgb.ptm", "a.png").exit_code, 0);
  ASSERT_EQ(render("other.ptm", "b.png").exit_code, 0);
  EXPECT_EQ(packages().size(), 1u) << "the same bytes under another name";
  std::string changed = bytes("other.ptm");
  changed.back() = static_cast<char>(changed.back() ^ 64);
  write("other.ptm", changed);
  ASSERT_EQ(render("other.ptm", "c.png").exit_code, 0);
  EXPECT_EQ(packages().size(), 2u);
}

TEST_F(ArtworkCache, WhatAScanNamesCounts) {
  writeScan("0.9 0.1 0.1");
  const Outcome red = render("scan.obj", "red.png");
  ASSERT_EQ(red.exit_code, 0) << red.output;
  EXPECT_EQ(packages().size(), 1u);
  writeScan("0.1 0.1 0.9");
  ASSERT_EQ(render("scan.obj", "blue.png").exit_code, 0);
  EXPECT_EQ(packages().size(), 2u);
  EXPECT_TRUE(bytes("red.png") != bytes("blue.png")) << "the picture follows the material";
  writeScan("0.9 0.1 0.1");
  ASSERT_EQ(render("scan.obj", "again.png").exit_code, 0);
  EXPECT_EQ(packages().size(), 2u) << "known already";
  EXPECT_TRUE(bytes("red.png") == bytes("again.png"));
  const Outcome over = render("scan.obj", "scan.mtl");
  EXPECT_EQ(over.exit_code, 1) << over.output;
  EXPECT_NE(over.output.find("scan.mtl"), std::string::npos);
}

TEST_F(ArtworkCache, AnImageIsDrawn) {
  sample("painting --size 96x64 --write albedo");
  const auto images = [&] {
    std::vector<std::string> found;
    for (const auto& e : fs::directory_iterator(file("sample")))
      if (e.path().extension() == ".png" || e.path().extension() == ".tif")
        found.push_back("sample/" + e.path().filename().string());
    return found;
  }();
  ASSERT_FALSE(images.empty());
  const Outcome drawn = render(images[0], "a.png");
  EXPECT_EQ(drawn.exit_code, 0) << drawn.output;
  EXPECT_EQ(packages().size(), 1u);
}

TEST_F(ArtworkCache, StaysWithinItsBoundWithoutWhatIsInUse) {
  sample("inscription --size 512x512 --write ptm-lrgb");
  const std::string first = bytes("sample/ptm_lrgb.ptm");
  std::vector<std::string> names;
  for (int i = 0; i < 4; ++i) {
    std::string changed = first;
    changed.back() = static_cast<char>(changed.back() ^ (i + 1));
    write("a" + std::to_string(i) + ".ptm", changed);
  }
  ASSERT_EQ(render("a0.ptm", "p.png").exit_code, 0);
  const fs::path oldest = packages()[0];
  const auto mib = static_cast<int>(fs::file_size(oldest) >> 20) * 2 + 1;  // room for one and a bit, or two
  ASSERT_EQ(render("a1.ptm", "p.png").exit_code, 0);
  ASSERT_EQ(packages().size(), 2u);
  // Another process shows the oldest one.
  const int in_use = ::open(oldest.c_str(), O_RDONLY);
  ASSERT_EQ(::flock(in_use, LOCK_SH), 0);
  for (const char* name : {"a2.ptm", "a3.ptm"})
    ASSERT_EQ(render(name, "p.png", "--cache-dir-mib " + std::to_string(mib)).exit_code, 0);
  EXPECT_TRUE(fs::exists(oldest)) << "in use";
  EXPECT_LT(packages().size(), 4u) << "the bound is kept";
  ::close(in_use);
  ASSERT_EQ(render("a1.ptm", "p.png", "--cache-dir-mib 0").exit_code, 0) << "a bound of nothing keeps what it draws";
  ASSERT_EQ(render("a2.ptm", "p.png", "--cache-dir-mib 0").exit_code, 0);
  EXPECT_EQ(packages().size(), 1u);
  EXPECT_FALSE(fs::exists(oldest)) << "control: no longer in use";
}

TEST_F(ArtworkCache, AFolderThatCannotBeWrittenIsSaid) {
  sample("inscription --size 96x64 --write ptm-lrgb");
  write("cache", "a file");
  const Outcome refused = render("sample/ptm_lrgb.ptm", "a.png");
  EXPECT_EQ(refused.exit_code, 2) << refused.output;
  EXPECT_NE(refused.output.find("--cache-dir"), std::string::npos) << refused.output;
  EXPECT_NE(refused.output.find("ptm_lrgb.ptm"), std::string::npos) << refused.output;
  EXPECT_EQ(std::count(refused.output.begin(), refused.output.end(), '\n'), 1) << refused.output;
  EXPECT_FALSE(fs::exists(file("a.png")));
}

TEST_F(ArtworkCache, TheUsersFolderIsTheDefault) {
  sample("inscription --size 96x64 --write ptm-lrgb");
  const std::string draw = std::string(RELIEVO_PROGRAM) + " render " + file("sample/ptm_lrgb.ptm") + " -o " +
                           file("a.png") + " --size 64x48";
  Outcome done = run("env -u XDG_CACHE_HOME HOME=" + file("home") + " " + draw);
  EXPECT_EQ(done.exit_code, 0) << done.output;
  EXPECT_TRUE(fs::is_directory(file("home/.cache/relievo")));
  done = run("env XDG_CACHE_HOME=" + file("xdg") + " HOME=" + file("home") + " " + draw);
  EXPECT_EQ(done.exit_code, 0) << done.output;
  EXPECT_TRUE(fs::is_directory(file("xdg/relievo")));
  done = run("env -u XDG_CACHE_HOME -u HOME " + draw);
  EXPECT_EQ(done.exit_code, 2) << done.output;
  EXPECT_NE(done.output.find("--cache-dir"), std::string::npos) << done.output;
}

TEST_F(ArtworkCache, TwoAtOnceBothDraw) {
  sample("inscription --size 512x512 --write ptm-lrgb");
  const std::string draw = std::string(RELIEVO_PROGRAM) + " render " + file("sample/ptm_lrgb.ptm") +
                           " --size 64x48 --cache-dir " + cache() + " -o ";
  const Outcome done =
      run("( " + draw + file("a.png") + " & a=$!; " + draw + file("b.png") + "; b=$?; wait $a && exit $b )");
  EXPECT_EQ(done.exit_code, 0) << done.output;
  EXPECT_EQ(packages().size(), 1u);
  EXPECT_TRUE(bytes("a.png") == bytes("b.png"));
}

TEST_F(ArtworkCache, AnInterruptedBuildLeavesNothing) {
  sample("coin --size 2048x2048 --write mesh");
  const Outcome stopped =
      testing_support::runUntil(cache(), std::string(RELIEVO_PROGRAM) + " render " + file("sample/mesh.ply") + " -o " +
                                             file("a.png") + " --cache-dir " + cache());
  EXPECT_EQ(stopped.exit_code, 130) << stopped.output;
  EXPECT_EQ(filesInCache(), 0);
  EXPECT_FALSE(fs::exists(file("a.png")));
}

// A build that was killed leaves its file; the next one has another name and takes it away all the same.
TEST_F(ArtworkCache, WhatAKilledBuildLeftGoesWithTheNextOne) {
  sample("painting --size 3000x3000 --write ptm-lrgb");
  const std::string big = std::string(RELIEVO_PROGRAM) + " render " + file("sample/ptm_lrgb.ptm") + " -o " +
                          file("a.png") + " --cache-dir " + cache();
  run("( " + big + " & pid=$!; n=0; until ls " + cache() +
      "/*.part-* >/dev/null 2>&1 || [ $((n += 1)) -gt 600 ]; do sleep 0.05; done; kill -KILL $pid; wait $pid )");
  ASSERT_TRUE(packages().empty()) << "it was killed before it was done";
  ASSERT_EQ(filesInCache(), 1);
  sample("inscription --size 96x64 --write ptm-lrgb");
  ASSERT_EQ(render("sample/ptm_lrgb.ptm", "a.png").exit_code, 0);
  EXPECT_EQ(packages().size(), 1u);
  EXPECT_EQ(filesInCache(), 2) << "the package and its list of names";
}

// The folder may hold files of others, packages among them: they are no part of the cache and not its to remove.
TEST_F(ArtworkCache, FilesOfOthersStay) {
  sample("inscription --size 96x64 --write ptm-lrgb");
  fs::create_directory(cache());
  const std::string key(32, 'a'), digits(16, '0');
  const std::vector<std::string> others{"mine.relievo",
                                        key + ".relievo",
                                        key + "-" + digits + "0.relievo",
                                        key + "-new-x.relievo",
                                        "x" + key + "-" + digits + ".relievo",
                                        "mine.relievo.part-7-" + digits};
  for (const std::string& name : others) write("cache/" + name, "precious");
  const std::vector<std::string> own{key + "-" + digits + ".relievo", key + "-new-7.relievo",
                                     key + "-new-7.relievo.part-7-" + digits};
  for (const std::string& name : own) write("cache/" + name, "the cache's");
  ASSERT_EQ(render("sample/ptm_lrgb.ptm", "a.png", "--cache-dir-mib 0").exit_code, 0);
  for (const std::string& name : others) EXPECT_EQ(bytes("cache/" + name), "precious") << name;
  for (const std::string& name : own) EXPECT_FALSE(fs::exists(file("cache/" + name))) << "the control: " << name;
}

// A package says what its image shows: others than who made the cache do not read it.
TEST_F(ArtworkCache, TheFolderIsTheUsersAlone) {
  sample("inscription --size 96x64 --write ptm-lrgb");
  ASSERT_EQ(run("umask 022; cd " + folder_ +
                "; " RELIEVO_PROGRAM " render sample/ptm_lrgb.ptm --size 64x48 -o a.png --cache-dir cache/of/mine")
                .exit_code,
            0);
  EXPECT_EQ(fs::status(file("cache/of/mine")).permissions(), fs::perms::owner_all);
}

TEST_F(ArtworkCache, WhatAnImageLosesIsSaid) {
  ASSERT_TRUE(writeImage(file("clear.png"), 8, 8, 4, std::vector<uint8_t>(256, 99)).ok());
  ASSERT_TRUE(writeImage(file("solid.png"), 8, 8, 3, std::vector<uint8_t>(192, 99)).ok());
  for (int times = 0; times < 2; ++times) {
    const Outcome drawn = render("clear.png", "a.png");
    ASSERT_EQ(drawn.exit_code, 0) << drawn.output;
    EXPECT_NE(drawn.output.find("clear.png: its alpha channel is ignored"), std::string::npos) << drawn.output;
  }
  EXPECT_EQ(render("solid.png", "b.png").output, "") << "the control";
  // As build says it, of an image and of what a scan names.
  write("scan.obj",
        "mtllib scan.mtl\nv 0 0 0\nv 9 0 0\nv 9 9 1\nv 0 9 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl a\n"
        "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n");
  for (const std::string name : {"clear.png", "solid.png"}) {
    write("scan.mtl", "newmtl a\nmap_Kd " + name + "\n");
    for (const std::string& input : {"--image " + file(name), "--mesh " + file("scan.obj") + " --patches 1"}) {
      const Outcome built = relievo("build " + input + " -o " + file("made.relievo"));
      ASSERT_EQ(built.exit_code, 0) << built.output;
      EXPECT_EQ(built.output.find(name + ": its alpha channel is ignored") != std::string::npos, name == "clear.png")
          << input << ": " << built.output;
    }
  }
}

TEST_F(ArtworkCache, ADamagedPackageIsBuiltAgain) {
  sample("inscription --size 96x64 --write ptm-lrgb");
  ASSERT_EQ(render("sample/ptm_lrgb.ptm", "a.png").exit_code, 0);
  fs::resize_file(packages()[0], 100);
  const Outcome again = render("sample/ptm_lrgb.ptm", "b.png");
  EXPECT_EQ(again.exit_code, 0) << again.output;
  EXPECT_TRUE(bytes("a.png") == bytes("b.png"));
  EXPECT_GT(fs::file_size(packages()[0]), 100u);
}

}  // namespace artwork_cache_test
}  // namespace relievo
