// What the program writes, as its users see it: a full disk, standard output that cannot be written, names that say the
// format, signals.
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <iterator>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "tests/tools/cli_fixture.h"
#include "tests/view_share.h"
#include "texturing/import/image_io.h"

namespace relievo::testing_support {
namespace output_cli_test {

const std::string kProgram = RELIEVO_PROGRAM;

class OutputCli : public Cli {
 protected:
  void SetUp() override {
    Cli::SetUp();
    ASSERT_EQ(relievo("sample coin --size 128x128 --package " + coin()).exit_code, 0);
    // As /dev/stdout, which a root whose program replaces it would lose.
    fs::create_symlink("/proc/self/fd/1", out());
  }
  std::string out() const { return file("standard-output"); }
  std::string coin() const { return file("coin.relievo"); }
  std::string get(const std::string& path) const {
    std::ifstream in(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }
  std::string picture(const std::string& target) const {
    return "render " + coin() + " --size 320x180 --settle -o " + target;
  }
  // Whether pictures are drawn on this machine at all.
  bool draws() const { return !noGl(relievo(picture(file("try.png")))); }
  static ptrdiff_t lines(const std::string& text) { return std::count(text.begin(), text.end(), '\n'); }
};

const char* const kSuffixes[] = {".png", ".tif", ".exr", ".jpg"};

// ulimit -f counts in 512 bytes here.
TEST_F(OutputCli, ADiskThatIsFullKeepsTheOldPicture) {
  if (!draws()) GTEST_SKIP() << "no GL";
  for (const std::string suffix : kSuffixes) {
    const std::string target = file("a" + suffix);
    size_t blocks = 6;  // fewer than any of them takes
    if (!test::kSanitized) {
      ASSERT_EQ(relievo(picture(target)).exit_code, 0);
      blocks = get(target).size() / 512;
    }
    ASSERT_GT(blocks, 3u);
    for (const size_t limit : {blocks / 2, blocks}) {
      if (test::kSanitized && limit == blocks) continue;  // the same way out, a little later
      write("a" + suffix, "precious");
      const Outcome r = run("ulimit -f " + std::to_string(limit) + "; MESA_SHADER_CACHE_DISABLE=true " + kProgram +
                            " " + picture(target));
      EXPECT_EQ(r.exit_code, 2) << suffix << " " << limit << ": " << r.output;
      EXPECT_EQ(lines(r.output), 1) << r.output;
      EXPECT_NE(r.output.find(target), std::string::npos) << r.output;
      EXPECT_EQ(get(target), "precious") << suffix << " " << limit;
      EXPECT_EQ(filesNamed(".part-"), 0);
    }
    if (test::kSanitized) continue;
    EXPECT_EQ(run("ulimit -f " + std::to_string(blocks + 1) + "; MESA_SHADER_CACHE_DISABLE=true " + kProgram + " " +
                  picture(target))
                  .exit_code,
              0)
        << "the control: with room for all of it";
  }
}

TEST_F(OutputCli, AFileSystemThatIsFullKeepsTheOldPicture) {
  if (!draws()) GTEST_SKIP() << "no GL";
  fs::create_directory(file("small"));
  if (run("mount -t tmpfs -o size=64k none " + file("small")).exit_code != 0)
    GTEST_SKIP() << "mounting a file system is not permitted; ulimit -f is tried above";
  for (const std::string suffix : kSuffixes) {
    const std::string target = file("small/a" + suffix);
    for (const int free_blocks : {0, 3}) {                 // of 4 KiB
      if (test::kSanitized && free_blocks == 0) continue;  // the same way out, a little earlier
      write("small/a" + suffix, "precious");
      run("head -c " + std::to_string((64 - 8 - 4 * free_blocks) * 1024) + " /dev/zero > " + file("small/filler"));
      const Outcome r = relievo(picture(target));
      EXPECT_EQ(r.exit_code, 2) << suffix << " " << free_blocks << ": " << r.output;
      EXPECT_EQ(lines(r.output), 1) << r.output;
      EXPECT_EQ(get(target), "precious") << suffix << " " << free_blocks;
      fs::remove(file("small/filler"));
      fs::remove(target);
    }
    EXPECT_TRUE(fs::is_empty(file("small"))) << "a part was left";
  }
  EXPECT_EQ(run("umount " + file("small")).exit_code, 0);
}

TEST_F(OutputCli, TheNameSaysTheFormat) {
  for (const char* name : {"a.bmp", "a.gif", "a", "a.png.txt", "png"}) {
    const Outcome r = relievo("render nowhere.relievo -o " + file(name));
    EXPECT_EQ(r.exit_code, 1) << name << ": " << r.output;
    EXPECT_NE(r.output.find(".png"), std::string::npos) << r.output;
  }
  if (!draws()) GTEST_SKIP() << "no GL";
  for (const auto& [name, magic] : {std::pair<std::string, std::string>{"a.png", "\x89PNG"},
                                    {"a.PNG", "\x89PNG"},
                                    {"a.tif", "II*"},
                                    {"a.tiff", "II*"},
                                    {"a.exr", "\x76\x2f\x31\x01"},
                                    {"a.jpg", "\xff\xd8\xff"},
                                    {"a.jpeg", "\xff\xd8\xff"}}) {
    const Outcome r = relievo(picture(file(name)));
    ASSERT_EQ(r.exit_code, 0) << name << ": " << r.output;
    EXPECT_EQ(get(file(name)).substr(0, magic.size()), magic) << name;
    if (test::kSanitized || name.size() != 5 || name == "a.PNG") continue;  // the same writers
    // Once more: the same bytes, whatever the time is.
    ASSERT_EQ(run("mv " + file(name) + " " + file("before") + "; sleep 1.1; " + kProgram + " " + picture(file(name)))
                  .exit_code,
              0);
    EXPECT_EQ(run("cmp " + file("before") + " " + file(name)).exit_code, 0) << name;
  }
  const auto png = readImage8(file("a.png")), tiff = readImage8(file("a.tif")), jpeg = readImage8(file("a.jpg"));
  ASSERT_TRUE(png && tiff && jpeg);
  EXPECT_TRUE(png->pixels == tiff->pixels);
  ASSERT_EQ(png->pixels.size(), jpeg->pixels.size());
  double off = 0;
  for (size_t i = 0; i < png->pixels.size(); ++i) off += std::abs(png->pixels[i] - jpeg->pixels[i]);
  EXPECT_LT(off / static_cast<double>(png->pixels.size()), 3);
}

// Nobody sees what was to be printed: exit code 2 and one line that says so.
TEST_F(OutputCli, StandardOutputThatCannotBeWrittenIsExitCode2) {
  if (!fs::exists("/dev/full")) GTEST_SKIP() << "there is no /dev/full here";
  write("t.png", "");
  const std::string image = file("t.png");
  ASSERT_TRUE(writeImage(image, 8, 8, 3, std::vector<uint8_t>(192, 99)).ok());
  std::vector<std::string> commands = {
      "info " + coin(),
      "info --json " + coin(),
      "verify " + coin(),
      "verify --json " + coin(),
      "--help",
      "--help-all",
      "--version",
      "info --help",
      "build --image " + image + " --mm-per-pixel 1 -o " + file("b.relievo"),
      "build --image " + image + " --mm-per-pixel 1 -o " + file("b.relievo") + " --json -",
      "build --image " + image + " --mm-per-pixel 1 -o " + file("b.relievo") + " --json " + out(),
      "sample coin --size 32x32 --write height -o " + file("s"),
      "sample coin --size 32x32 --package " + file("c.relievo")};
  if (draws()) {
    commands.insert(commands.end(), {picture("-"), picture(file("p.png")) + " --stats -",
                                     "bench " + coin() + " --quick --only page-table --json -"});
    if (!test::kSanitized) commands.push_back("bench " + coin() + " --quick --only page-table");
  }
  for (const std::string& command : commands) {
    const bool once = test::kSanitized;
    for (const char* redirection : {" >/dev/full", " >&-"}) {
      if (once && redirection == std::string(" >&-")) continue;
      // Standard error alone is looked at.
      const Outcome r = run("exec 3>&1; ( " + kProgram + " " + command + " 2>&3 " + redirection + " )");
      EXPECT_EQ(r.exit_code, 2) << command << redirection << ": " << r.output;
      EXPECT_NE(r.output.find("relievo: error: "), std::string::npos) << command << redirection << ": " << r.output;
      if (command.find("bench") == 0) continue;  // its rows may be there, too
      EXPECT_EQ(lines(r.output), 1) << command << redirection << ": " << r.output;
    }
    if (once) continue;
    EXPECT_EQ(run(kProgram + " " + command + " >/dev/null").exit_code, 0) << "the control: " << command;
  }
  // A reader that has gone is an error like another one, and no signal that leaves files behind.
  const Outcome gone =
      run("( { sleep 0.5; " + kProgram + " info " + coin() + "; echo $? >" + file("code") + "; } | true )");
  EXPECT_EQ(get(file("code")), "2\n") << gone.output;
}

// The next file opened would have standard output's number, and get what is printed.
TEST_F(OutputCli, AClosedStandardOutputHarmsNoFile) {
  const std::string before = get(coin());
  const auto closed = [](const std::string& arguments) {
    return run("( " + kProgram + " " + arguments + " )").exit_code;
  };
  EXPECT_EQ(closed("info " + coin() + " >&-"), 2);
  EXPECT_EQ(closed("sample coin --size 128x128 --package " + file("again.relievo") + " >&-"), 2)
      << "its summary was not seen";
  EXPECT_TRUE(get(file("again.relievo")) == before) << "what is printed was written into the package";
  EXPECT_TRUE(get(coin()) == before);
  EXPECT_EQ(closed("sample coin --size 128x128 --package " + file("third.relievo") + " >/dev/null <&- 2>&-"), 0);
  EXPECT_TRUE(get(file("third.relievo")) == before);
  if (!draws()) return;
  EXPECT_EQ(closed(picture(file("a.png")) + " >&-"), 0) << "it prints nothing";
  EXPECT_TRUE(get(file("a.png")) == get(file("try.png")));
}

TEST_F(OutputCli, DashIsStandardOutputForOneTextOrPicture) {
  const std::string image = file("t.png"), package = file("b.relievo");
  ASSERT_TRUE(writeImage(image, 8, 8, 3, std::vector<uint8_t>(192, 99)).ok());
  ASSERT_EQ(::mkfifo(file("pipe").c_str(), 0600), 0);
  // Packages and folders: refused, and nothing is made.
  for (const std::string& command :
       {"build --image " + image + " -o -", "build --image " + image + " --mm-per-pixel 1 -o " + out(),
        "build --image " + image + " -o " + file("pipe"), std::string("sample coin --size 16x16 --package -"),
        std::string("sample coin --size 16x16 -o -"), "compare " + coin() + " -o -", "bench " + coin() + " --plots -",
        "render " + coin() + " -o - --stats -", "render " + coin() + " -o - --stats " + out()}) {
    const Outcome r = run("cd " + folder_ + " && " + kProgram + " " + command);
    EXPECT_EQ(r.exit_code, 1) << command << ": " << r.output;
    EXPECT_EQ(lines(r.output), 1) << command << ": " << r.output;
    EXPECT_EQ(r.output.rfind("relievo: error: ", 0), 0u) << command << ": " << r.output;
    EXPECT_FALSE(fs::exists(file("-"))) << command;
  }
  const auto json = [&](const std::string& command) {
    const Outcome r = run("cd " + folder_ + " && ( " + kProgram + " " + command + " 2>/dev/null | cat )");
    EXPECT_FALSE(fs::exists(file("-"))) << command;
    return nlohmann::json::parse(r.output, nullptr, false);
  };
  for (const std::string& name : {std::string("-"), out()}) {
    EXPECT_TRUE(
        json("build --image " + image + " --mm-per-pixel 1 -o " + package + " --json " + name).contains("pages"))
        << name;
    EXPECT_TRUE(fs::is_symlink(out()));
  }
  if (!draws()) GTEST_SKIP() << "no GL";
  EXPECT_TRUE(json(picture(file("p.png")) + " --stats -").contains("triangles"));
  EXPECT_TRUE(json("bench " + coin() + " --quick --only page-table --json -").contains("rows"));
  ASSERT_EQ(run("cd " + folder_ + " && " + kProgram + " " + picture("-") + " > " + file("piped.png")).exit_code, 0);
  EXPECT_TRUE(get(file("piped.png")) == get(file("try.png")));
  ASSERT_EQ(run("( " + kProgram + " " + picture("-") + " | cat > " + file("piped2.png") + " )").exit_code, 0);
  EXPECT_TRUE(get(file("piped2.png")) == get(file("try.png")));
  if (run("command -v script").exit_code == 0) {
    const Outcome terminal = run("script -qec '" + kProgram + " " + picture("-") + "' /dev/null");
    EXPECT_EQ(terminal.exit_code, 1) << terminal.output;
    EXPECT_NE(terminal.output.find("terminal"), std::string::npos);
  }
}

// As by Ctrl-C: nothing is left, and the code is the documented one.
TEST_F(OutputCli, EverySignalThatEndsItLeavesNothing) {
  for (const char* signal : {"INT", "TERM", "HUP", "ALRM"}) {
    const std::string big = file("big.relievo");
    const Outcome r =
        run("( " + kProgram + " sample painting --size 32768x32768 --package " + big + " & pid=$!; n=0; until ls " +
            big + ".part-* >/dev/null 2>&1 || [ $((n += 1)) -gt 600 ]; do sleep 0.1; done; kill -" + signal +
            " $pid; wait $pid )");
    EXPECT_EQ(r.exit_code, 130) << signal << ": " << r.output;
    EXPECT_EQ(filesNamed("big"), 0) << signal;
  }
  // What nohup started goes on.
  const std::string nohup = file("nohup.relievo");
  const Outcome r =
      run("( trap '' HUP; " + kProgram + " sample painting --size " + (test::kSanitized ? "640x640" : "2048x2048") +
          " --package " + nohup + " & pid=$!; n=0; until ls " + nohup +
          "* >/dev/null 2>&1 || [ $((n += 1)) -gt 600 ]; do sleep 0.05; done; kill -HUP $pid; wait $pid )");
  EXPECT_EQ(r.exit_code, 0) << r.output;
  EXPECT_TRUE(fs::exists(nohup));
}

TEST_F(OutputCli, WhatAKilledBuildLeftGoesWithTheNextOne) {
  const std::string target = file("killed.relievo");
  run("( " + kProgram + " sample painting --size 32768x32768 --package " + target + " & pid=$!; n=0; until ls " +
      target + ".part-* >/dev/null 2>&1 || [ $((n += 1)) -gt 600 ]; do sleep 0.1; done; kill -KILL $pid; wait $pid )");
  ASSERT_EQ(filesNamed("killed.relievo.part-"), 1);
  ASSERT_EQ(relievo("sample coin --size 64x64 --package " + target).exit_code, 0);
  EXPECT_EQ(filesNamed("killed.relievo.part-"), 0);
  EXPECT_EQ(filesNamed("killed.relievo"), 1);
}

// A private file stays private, and a link stays one.
TEST_F(OutputCli, TheModeAndALinkStay) {
  ASSERT_EQ(::chmod(coin().c_str(), 0600), 0);
  fs::create_symlink("coin.relievo", file("link.relievo"));
  ASSERT_EQ(relievo("sample coin --size 64x64 --package " + file("link.relievo")).exit_code, 0);
  struct stat st {};
  ASSERT_EQ(::stat(coin().c_str(), &st), 0);
  EXPECT_EQ(st.st_mode & 0777, 0600u);
  EXPECT_TRUE(fs::is_symlink(file("link.relievo")));
}

// Whatever names the input: a pipe without a writer is not waited for.
TEST_F(OutputCli, InputsThatAreNoFilesAreRefused) {
  const std::string pipe = file("pipe");
  ASSERT_EQ(::mkfifo(pipe.c_str(), 0600), 0);
  for (const auto& [from, to] :
       {std::pair{"pipe", "pipe.ply"}, {"pipe", "pipe.obj"}, {"pipe", "pipe.png"}, {"pipe", "pipe.mtl"}})
    fs::create_symlink(from, file(to));
  write("m.obj", "mtllib pipe.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n");
  write("k.mtl", "newmtl k\nmap_Kd pipe.png\n");
  write("k.obj",
        "mtllib k.mtl\nusemtl k\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvt 1 1\nf 1/1 2/2 3/3\nf "
        "2/2 4/4 3/3\n");
  for (const std::string& input : {pipe, std::string("/dev/zero"), folder_}) {
    for (const std::string& command :
         {"info " + input, "verify " + input, "render " + input + " -o " + file("x.png"),
          "build --ptm " + input + " -o " + file("x"), "build --image " + input + " -o " + file("x"),
          "render " + coin() + " --state " + input + " -o " + file("x.png")}) {
      const Outcome r = run("timeout 20 " + kProgram + " " + command);
      EXPECT_EQ(r.exit_code, 2) << command << ": " << r.output;
      EXPECT_NE(r.output.find(input), std::string::npos) << r.output;
      EXPECT_EQ(lines(r.output), 1) << r.output;
    }
  }
  for (const std::string& mesh : {file("pipe.ply"), file("pipe.obj")}) {
    const Outcome r = run("timeout 20 " + kProgram + " build --mesh " + mesh + " -o " + file("x"));
    EXPECT_EQ(r.exit_code, 2) << mesh << ": " << r.output;
    EXPECT_NE(r.output.find("is a pipe"), std::string::npos) << r.output;
  }
  for (const char* mesh : {"m.obj", "k.obj"}) {
    const Outcome r = run("timeout 60 " + kProgram + " build --mesh " + file(mesh) + " -o " + file("x"));
    EXPECT_NE(r.exit_code, 124) << mesh << ": waits for the pipe that it names: " << r.output;
    EXPECT_NE(r.output.find("pipe"), std::string::npos) << mesh << ": " << r.output;
  }
}

}  // namespace output_cli_test
}  // namespace relievo::testing_support
