// The program as its users run it: exit codes, messages that name the file and what to do, and files that appear whole
// or not at all.
#include <gtest/gtest-spi.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>

#include "tests/tools/cli_fixture.h"
#include "tests/view_share.h"

namespace cli_test {

using namespace relievo::testing_support;

TEST_F(Cli, HelpIsThereForEverySubCommandAndGivesUnitsAndAnExample) {
  EXPECT_EQ(relievo("--help").exit_code, 0);
  for (const char* command :
       {"sample", "build", "info", "verify", "export", "render", "view", "bench", "compare", "accuracy", "selftest"}) {
    Outcome r = relievo(std::string(command) + " --help");
    EXPECT_EQ(r.exit_code, 0) << command;
    EXPECT_NE(r.output.find("xample"), std::string::npos) << command << ": no example in\n" << r.output;
  }
}

TEST_F(Cli, WrongUsageIsExitCode1) {
  EXPECT_EQ(relievo("").exit_code, 1);
  EXPECT_EQ(relievo("frobnicate").exit_code, 1);
  EXPECT_EQ(relievo("render").exit_code, 1);
  EXPECT_EQ(relievo("sample vase -o " + file("d")).exit_code, 1);
  EXPECT_EQ(relievo("sample coin --size 0x5 -o " + file("d")).exit_code, 1);
  EXPECT_EQ(relievo("render x.relievo -o y.png --size 12by7").exit_code, 1);
  const Outcome bare = relievo("build --relief heights.tif -o " + file("o.relievo"));
  EXPECT_EQ(bare.exit_code, 1);
  EXPECT_NE(bare.output.find("a height map lies under a texture"), std::string::npos) << bare.output;
}

TEST_F(Cli, AMissingFileIsExitCode2AndNamed) {
  for (const char* command :
       {"info ", "verify ", "export -o x.ply ", "render -o x.png ", "build -o x.relievo --ptm "}) {
    Outcome r = relievo(command + file("nowhere.bin"));
    EXPECT_EQ(r.exit_code, 2) << command << r.output;
    EXPECT_NE(r.output.find("nowhere.bin"), std::string::npos) << r.output;
  }
}

TEST_F(Cli, InvalidDataIsExitCode3AndUnsupportedIs5) {
  write("bad.ptm", "PTM_1.2\nPTM_FORMAT_LRGB\n4\n4\n1 1 1 1 1 1\n0 0 0 0 0 0\nshort");
  Outcome r = relievo("build --ptm " + file("bad.ptm") + " -o " + file("a.relievo"));
  EXPECT_EQ(r.exit_code, 3) << r.output;
  EXPECT_NE(r.output.find("bad.ptm"), std::string::npos);
  write("lut.ptm", "PTM_1.2\nPTM_FORMAT_PTM_C_LUT\n4\n4\n1 1 1 1 1 1\n0 0 0 0 0 0\n");
  r = relievo("build --ptm " + file("lut.ptm") + " -o " + file("a.relievo"));
  EXPECT_EQ(r.exit_code, 5) << r.output;
  EXPECT_NE(r.output.find("LUT"), std::string::npos) << r.output;
  write("no.relievo", "this is no package");
  for (const char* command : {"info ", "verify ", "render -o x.png "})
    EXPECT_EQ(relievo(command + file("no.relievo")).exit_code, 3);
  EXPECT_FALSE(fs::exists(file("a.relievo")));
  EXPECT_EQ(filesNamed(".part-"), 0);
}

// Formats of this field that nobody here reads are said to be what they are, wherever they are given.
TEST_F(Cli, ForeignFormatsAreUnsupportedByName) {
  const std::string info =
      R"({ "width": 4, "height": 4, "format": "jpg", "type": "bilinear", "colorspace": "mrgb", "nplanes": 18, "materials": [{"scale": [1]}] })";
  write("coin.rti", "#HSH1.2\n3\n4 4 3\n9 2 1\nnumbers");
  write("coin.hsh", "#made by a fitter\n" + std::string("\4\0\0\0\4\0\0\0\3\0\0\0\3\0\0\0", 16));
  write("dome.lp", "1\na.jpg 0 0 1\n");
  fs::create_directory(file("relight"));
  write("relight/info.json", info);
  for (auto [name, named] : {std::pair{"coin.rti", ".rti file (HSH)"},
                             {"coin.hsh", ".hsh"},
                             {"dome.lp", "light directions"},
                             {"relight", "relight folder (bilinear, mrgb)"},
                             {"relight/info.json", "relight folder (bilinear, mrgb)"}}) {
    for (const char* command : {"info ", "verify ", "render -o x.png ", "build -o x.relievo --ptm ",
                                "build -o x.relievo --image ", "build -o x.relievo --mesh "}) {
      const Outcome r = relievo(command + file(name));
      EXPECT_EQ(r.exit_code, 5) << command << r.output;
      EXPECT_NE(r.output.find(named), std::string::npos) << command << r.output;
      EXPECT_NE(r.output.find("unsupported"), std::string::npos) << command << r.output;
      EXPECT_EQ(r.output.find("damaged"), std::string::npos) << command << r.output;
    }
  }
  // Neither a file that only looks like one by its name, nor a folder of something else.
  fs::create_directory(file("folder"));
  EXPECT_EQ(relievo("info " + file("folder")).exit_code, 2);
  write("other.json", "{\"type\": \"FeatureCollection\"}");
  EXPECT_EQ(relievo("info " + file("other.json")).exit_code, 3);
}

TEST_F(Cli, WhatIsExpectedIsHintedAt) {
  Outcome r = relievo("show x");
  EXPECT_EQ(r.exit_code, 1);
  EXPECT_NE(r.output.find("found 'show'"), std::string::npos) << r.output;
  for (const char* command : {"sample", "build", "info", "verify", "export", "render", "view", "bench", "compare"})
    EXPECT_NE(r.output.find(command), std::string::npos) << r.output;
  r = relievo("render x.relievo -o x.png --background red");
  EXPECT_EQ(r.exit_code, 1);
  EXPECT_NE(r.output.find("for example R,G,B from 0 to 255: 24,24,26"), std::string::npos) << r.output;
  EXPECT_EQ(r.output.find("light"), std::string::npos) << r.output;
  for (const char* beyond : {"256,0,0", "0,0,-1"}) {
    r = relievo(std::string("render x.relievo -o x.png --background ") + beyond);
    EXPECT_EQ(r.exit_code, 1) << beyond;
    EXPECT_NE(r.output.find("from 0 to 255"), std::string::npos) << r.output;
  }
  r = relievo("render x.relievo -o x.png --light red");
  EXPECT_NE(r.output.find("towards the light"), std::string::npos) << r.output;
}

TEST_F(Cli, UnknownMembersOfAStateAreRefused) {
  write("state.json", R"({"azimuth_deg": 10, "elevation": 20})");
  Outcome r = relievo("render x.relievo -o x.png --state " + file("state.json"));
  EXPECT_EQ(r.exit_code, 3) << r.output;
  EXPECT_NE(r.output.find("state.json: there is no 'elevation'"), std::string::npos) << r.output;
  EXPECT_NE(r.output.find("elevation_deg"), std::string::npos) << r.output;
  write(
      "state.json",
      R"({"azimuth_deg": 10, "elevation_deg": 20, "distance_mm": 5, "fov_deg": 30, "orthographic": false, "target_mm": [0, 0, 0], "light": [0, 0, 1]})");
  EXPECT_EQ(relievo("render x.relievo -o x.png --state " + file("state.json")).exit_code, 2)
      << "only the package is missing";
}

// What a package says of itself reaches a terminal escaped.
TEST_F(Cli, ControlCharactersFromFilesAreEscaped) {
  const std::string evil =
      "a\x1b[2J\xc2\x9b"
      "5m.ptm";
  ASSERT_EQ(relievo("sample inscription -o " + file("s") + " --size 64x48 --write ptm-lrgb").exit_code, 0);
  fs::rename(file("s/ptm_lrgb.ptm"), file(evil));
  ASSERT_EQ(relievo("build --mm-per-pixel 1 --ptm '" + file(evil) + "' -o " + file("a.relievo")).exit_code, 0);
  for (const std::string& arguments :
       {"info " + file("a.relievo"), "info --json " + file("a.relievo"), "info '" + file("missing " + evil) + "'"}) {
    const Outcome r = relievo(arguments);
    EXPECT_EQ(r.output.find('\x1b'), std::string::npos) << arguments;
    EXPECT_EQ(r.output.find("\xc2\x9b"), std::string::npos) << arguments;
    EXPECT_NE(r.output.find("[2J"), std::string::npos) << arguments;
  }
}

// A size that nobody gave is not known, and nothing pretends that it were.
TEST_F(Cli, WithoutASizeLengthsArePixels) {
  ASSERT_EQ(relievo("sample inscription -o " + file("s") + " --size 300x200 --write ptm-lrgb,height").exit_code, 0);
  const std::string build = "build --ptm " + file("s/ptm_lrgb.ptm") + " -o " + file("a.relievo");
  Outcome r = relievo(build);
  ASSERT_EQ(r.exit_code, 0) << r.output;
  EXPECT_NE(r.output.find("no size is known, lengths count px"), std::string::npos) << r.output;
  r = relievo("info " + file("a.relievo"));
  EXPECT_NE(r.output.find("300 x 200 px, not known in mm"), std::string::npos) << r.output;
  EXPECT_EQ(r.output.find("300 mm"), std::string::npos) << r.output;
  auto info = nlohmann::json::parse(relievo("info --json " + file("a.relievo")).output);
  EXPECT_EQ(info["width_px"], 300);
  EXPECT_EQ(info["height_px"], 200);
  EXPECT_TRUE(info["mm_per_px"].is_null());
  EXPECT_FALSE(info.contains("width_mm"));
  r = relievo("render " + file("a.relievo") + " -o " + file("a.png") + " --mm-per-px 0.5");
  EXPECT_EQ(r.exit_code, 1) << r.output;
  EXPECT_NE(r.output.find("--mm-per-px needs the artwork's size"), std::string::npos) << r.output;
  EXPECT_EQ(relievo("verify " + file("a.relievo")).exit_code, 0);
  // Heights in mm would be a scale; heights in px are none.
  const std::string relief = build + " --relief " + file("s/height_16.tif");
  r = relievo(relief + " --relief-mm 0:5");
  EXPECT_EQ(r.exit_code, 1) << r.output;
  EXPECT_NE(r.output.find("--relief-px"), std::string::npos) << r.output;
  EXPECT_EQ(relievo(build + " --relief " + file("s/height_float.tif")).exit_code, 1);
  ASSERT_EQ(relievo(relief + " --relief-px 0:5").exit_code, 0);
  r = relievo("info " + file("a.relievo"));
  EXPECT_NE(r.output.find("0 to 5 px"), std::string::npos) << r.output;
  info = nlohmann::json::parse(relievo("info --json " + file("a.relievo")).output);
  EXPECT_NEAR(info["relief_max_px"].get<double>(), 5, 1e-9);
  EXPECT_FALSE(info.contains("relief_max_mm"));
  // With a size they are both.
  ASSERT_EQ(relievo(relief + " --relief-px 0:5 --mm-per-pixel 0.5").exit_code, 0);
  info = nlohmann::json::parse(relievo("info --json " + file("a.relievo")).output);
  EXPECT_NEAR(info["relief_max_mm"].get<double>(), 2.5, 1e-9);
  EXPECT_EQ(info["mm_per_px"], 0.5);
  EXPECT_EQ(info["width_mm"], 150);
}

// The picture that render writes says its scale; as an input that is offered, and taken when asked for.
TEST_F(Cli, AResolutionTagIsOfferedAndNotTaken) {
  ASSERT_EQ(relievo("sample coin -o " + file("s") + " --size 64x64 --package " + file("s.relievo")).exit_code, 0);
  Outcome r = relievo("render " + file("s.relievo") + " -o " + file("scan.png") + " --mm-per-px 0.5");
  if (noGl(r)) GTEST_SKIP() << r.output;
  ASSERT_EQ(r.exit_code, 0) << r.output;
  const std::string build = "build --image " + file("scan.png") + " -o " + file("a.relievo");
  r = relievo(build);
  ASSERT_EQ(r.exit_code, 0) << r.output;
  EXPECT_NE(r.output.find("add --mm-per-pixel 0.5 (or tag) if that is the size of the object"), std::string::npos)
      << r.output;
  EXPECT_TRUE(nlohmann::json::parse(relievo("info --json " + file("a.relievo")).output)["mm_per_px"].is_null());
  r = relievo(build + " --mm-per-pixel tag");
  ASSERT_EQ(r.exit_code, 0) << r.output;
  EXPECT_NEAR(nlohmann::json::parse(relievo("info --json " + file("a.relievo")).output)["mm_per_px"].get<double>(), 0.5,
              1e-4);
  write("plain.ppm", std::string("P6\n2 1\n255\n") + "\xff\x10\x10\x10\x10\xff");
  r = relievo("build --image " + file("plain.ppm") + " -o " + file("a.relievo") + " --mm-per-pixel tag");
  EXPECT_EQ(r.exit_code, 1) << r.output;
  EXPECT_NE(r.output.find("expected a resolution tag"), std::string::npos) << r.output;
  EXPECT_EQ(relievo("build --image " + file("plain.ppm") + " -o " + file("a.relievo") + " --mm-per-pixel -2").exit_code,
            1);
}

TEST_F(Cli, AReliefOfOtherProportionsIsRefused) {
  auto pgm = [&](const std::string& name, int w, int h) {
    write(name, "P5\n" + std::to_string(w) + " " + std::to_string(h) + "\n255\n" +
                    std::string(static_cast<size_t>(w * h), '\x40'));
  };
  write("image.ppm", "P6\n300 200\n255\n" + std::string(300 * 200 * 3, '\x50'));
  const std::string build =
      "build --image " + file("image.ppm") + " -o " + file("a.relievo") + " --mm-per-pixel 1 --relief-mm 0:5 --relief ";
  pgm("wide.pgm", 400, 200);
  Outcome r = relievo(build + file("wide.pgm"));
  EXPECT_EQ(r.exit_code, 3) << r.output;
  for (const char* told : {"wide.pgm", "300 x 200", "400 x 200", "1 %", "--stretch-relief"})
    EXPECT_NE(r.output.find(told), std::string::npos) << r.output;
  EXPECT_FALSE(fs::exists(file("a.relievo")));
  EXPECT_EQ(relievo(build + file("wide.pgm") + " --stretch-relief").exit_code, 0);
  for (auto [w, h] : {std::pair{600, 400}, {150, 100}, {31, 20}, {302, 200}}) {
    pgm("alike.pgm", w, h);
    EXPECT_EQ(relievo(build + file("alike.pgm")).exit_code, 0) << w << " x " << h;
  }
}

TEST_F(Cli, SampleBuildInfoVerifyRoundTrip) {
  Outcome r = relievo("sample inscription -o " + file("s") + " --size 300x200 --write height,ptm-lrgb --package " +
                      file("direct.relievo"));
  ASSERT_EQ(r.exit_code, 0) << r.output;
  EXPECT_TRUE(fs::exists(file("s/truth.json")));
  r = relievo("info " + file("direct.relievo") + " --json");
  ASSERT_EQ(r.exit_code, 0) << r.output;
  auto info = nlohmann::json::parse(r.output, nullptr, false);
  ASSERT_FALSE(info.is_discarded()) << r.output;
  EXPECT_EQ(relievo("verify " + file("direct.relievo")).exit_code, 0);
  // One flipped bit in the middle of the pages: named, and exit code 3.
  std::fstream damaged(file("direct.relievo"), std::ios::in | std::ios::out | std::ios::binary);
  damaged.seekg(static_cast<std::streamoff>(fs::file_size(file("direct.relievo")) / 2));
  char byte = static_cast<char>(damaged.peek());
  damaged.seekp(static_cast<std::streamoff>(fs::file_size(file("direct.relievo")) / 2));
  damaged.put(static_cast<char>(byte ^ 0x10));
  damaged.close();
  r = relievo("verify " + file("direct.relievo"));
  EXPECT_EQ(r.exit_code, 3) << r.output;
}

TEST_F(Cli, EncodingsAreChosenPlaneByPlane) {
  ASSERT_EQ(relievo("sample inscription -o " + file("s") + " --size 300x200 --write ptm-lrgb").exit_code, 0);
  const std::string build = "build --ptm " + file("s/ptm_lrgb.ptm") + " -o " + file("a.relievo") + " ";
  auto planes = [&](const std::string& options) {
    Outcome r = relievo(build + options);
    EXPECT_EQ(r.exit_code, 0) << r.output;
    auto info = nlohmann::json::parse(relievo("info " + file("a.relievo") + " --json").output, nullptr, false);
    EXPECT_EQ(relievo("verify " + file("a.relievo")).exit_code, 0);
    std::string out;
    if (!info.is_discarded())
      for (const auto& p : info["planes"])
        out += p["encoding"].get<std::string>() + (p["bytes"].get<uint64_t>() > 0 ? " " : "? ");
    return out;
  };
  EXPECT_EQ(planes(""), "lossless lossless lossless ");
  EXPECT_EQ(planes("--encoding q8"), "lossless lossless lossless ");
  EXPECT_EQ(planes("--encoding q6"), "q6 q6 q6 ");
  EXPECT_EQ(planes("--encoding jpeg --quality 75"), "jpeg75 jpeg75 jpeg75-ycc ");
  EXPECT_EQ(planes("--encoding-coefficients q5 --encoding-colour jpeg"), "q5 q5 jpeg90-ycc ");
  EXPECT_EQ(planes("--encoding bc4 --encoding-colour bc1"), "bc4 bc4 bc1 ");
  for (const char* wrong :
       {"--encoding q3", "--encoding webp", "--encoding-colour bc6", "--encoding jpeg --quality 0", "--quality 101"})
    EXPECT_EQ(relievo(build + wrong).exit_code, 1) << wrong;
  Outcome r = relievo(build + "--encoding bc7");
  ASSERT_EQ(r.exit_code, 0) << r.output;
  EXPECT_NE(relievo("info " + file("a.relievo")).output.find("bc7"), std::string::npos);
}

TEST_F(Cli, ATargetIsKeptWhenTheBuildFails) {
  write("old.relievo", "precious");
  write("bad.ptm", "PTM_1.2\nPTM_FORMAT_LRGB\n4\n4\n1 1 1 1 1 1\n0 0 0 0 0 0\nshort");
  EXPECT_NE(relievo("build --ptm " + file("bad.ptm") + " -o " + file("old.relievo")).exit_code, 0);
  std::ifstream in(file("old.relievo"));
  std::string text;
  in >> text;
  EXPECT_EQ(text, "precious");
}

TEST_F(Cli, AnInterruptedBuildLeavesNothingBehind) {
  // SIGINT after 1.5 s of a build that takes far longer.
  Outcome r = run("timeout -s INT 1.5 " RELIEVO_PROGRAM " sample painting -o " + file("s") +
                  " --size 32768x32768 --write height --package " + file("big.relievo"));
  EXPECT_NE(r.exit_code, 0) << r.output;
  EXPECT_FALSE(fs::exists(file("big.relievo")));
  EXPECT_EQ(filesNamed(".part-"), 0);
  int left = 0;
  if (fs::exists(file("s"))) {
    for (const auto& e : fs::recursive_directory_iterator(file("s")))
      left += e.path().string().find(".part-") != std::string::npos;
  }
  EXPECT_EQ(left, 0);
}

TEST_F(Cli, AFullDiskIsOneErrorAndLeavesNothing) {
  Outcome r = run("ulimit -f 64; " RELIEVO_PROGRAM " sample coin -o " + file("s") +
                  " --size 512x512 --write height --package " + file("big.relievo"));
  EXPECT_EQ(r.exit_code, 2) << r.output;
  EXPECT_FALSE(fs::exists(file("big.relievo")));
  EXPECT_EQ(filesNamed(".part-"), 0);
}

// What would be lost is still there, and the one line names both options.
TEST_F(Cli, OutputsOverwriteNeitherInputsNorOneAnother) {
  write("k.relievo", "precious");
  write("t.png", "precious");
  write("m.ply", "precious");
  write("state.json", "{}");
  fs::create_hard_link(file("k.relievo"), file("again.relievo"));
  const std::string k = file("k.relievo"), t = file("t.png"), m = file("m.ply"), n = file("new"),
                    mesh = "build --mesh " + m + " -o ";
  for (auto [command, one, other] :
       {std::array<std::string, 3>{"render " + k + " -o " + k, "-o", "FILE"},
        {"render " + k + " -o " + file("again.relievo"), "-o", "FILE"},
        {"render " + k + " -o " + n + " --stats " + k, "--stats", "FILE"},
        {"render " + k + " -o " + n + " --stats " + folder_ + "/./new", "--stats", "-o"},
        {"render " + k + " -o " + n + " --state " + file("state.json") + " --stats " + file("state.json"), "--stats",
         "--state"},
        {"bench " + k + " --json " + k, "--json", "FILE"},
        {"bench " + k + " --markdown " + k, "--markdown", "FILE"},
        {"bench " + k + " --json " + n + " --markdown " + n, "--markdown", "--json"},
        {mesh + m, "-o", "--mesh"},
        {mesh + n + " --report " + m, "--report", "--mesh"},
        {mesh + n + " --report " + n, "--report", "-o"},
        {mesh + k + " --report " + n + " --json " + n, "--json", "--report"},
        {mesh + n + " --texture " + t + " --report " + t, "--report", "--texture"},
        {"build --image " + t + " -o " + n + " --json " + t, "--json", "--image"},
        {"compare " + k + " -o " + folder_ + " --path " + file("report.json"), "-o", "--path"},
        {"sample coin --size 16x16 --write height -o " + file("s") + " --package " + file("s/truth.json"), "--package",
         "-o"}}) {
    if (command.find("compare") == 0) write("report.json", "precious");
    const Outcome r = relievo(command);
    EXPECT_EQ(r.exit_code, 1) << command << ": " << r.output;
    EXPECT_NE(r.output.find(": " + one + " would overwrite "), std::string::npos) << r.output;
    EXPECT_NE(r.output.find("put: " + other + " ("), std::string::npos) << r.output;
    EXPECT_EQ(std::count(r.output.begin(), r.output.end(), '\n'), command.find("sample") == 0 ? 2 : 1) << r.output;
  }
  for (const char* kept : {"k.relievo", "t.png", "m.ply", "report.json"}) {
    std::ifstream in(file(kept));
    std::string text;
    in >> text;
    EXPECT_EQ(text, "precious") << kept;
  }
  EXPECT_FALSE(fs::exists(n));
}

// Said at once, not after what takes long; nothing is made.
TEST_F(Cli, AnOutputThatCannotBeWrittenIsExitCode2BeforeAnythingIsRead) {
  for (const char* command : {"build --mesh nowhere.ply -o @ ", "build --mesh nowhere.ply -o x.relievo --report @",
                              "build --image nowhere.png -o x.relievo --json @", "render nowhere.relievo -o @",
                              "render nowhere.relievo -o x.png --stats @", "bench --json @", "bench --markdown @",
                              "sample coin --size 65536x65536 --package @"}) {
    const std::string target = file(command[0] == 'r' ? "." : "none/file");
    std::string all = command;
    all.replace(all.find('@'), 1, target);
    const Outcome r = relievo(all);
    EXPECT_EQ(r.exit_code, 2) << all << ": " << r.output;
    EXPECT_NE(r.output.find(target + ": -"), std::string::npos) << all << ": " << r.output;
  }
  EXPECT_TRUE(fs::is_empty(folder_));
}

TEST_F(Cli, ViewWithoutADisplayNamesRender) {
  ASSERT_EQ(
      relievo("sample coin -o " + file("s") + " --size 64x64 --write height --package " + file("c.relievo")).exit_code,
      0);
  Outcome r = run("env -u DISPLAY -u WAYLAND_DISPLAY " RELIEVO_PROGRAM " view " + file("c.relievo"));
  EXPECT_EQ(r.exit_code, 4) << r.output;
  EXPECT_NE(r.output.find("relievo render"), std::string::npos) << r.output;
}

// Exit code 4 is an excuse only where GL is not required, and only for want of GL.
TEST(NoGl, IsAFailureWhereGlIsRequiredOrTheReasonIsAnother) {
  const char* before = std::getenv("RELIEVO_REQUIRE_GL");
  const std::string kept = before ? before : "";
  const Outcome none{4, "relievo: error: no GL context without a window: OpenGL 3.3: no driver"},
      other{4, "relievo: error: no thread can be started"}, fine{0, ""};
  unsetenv("RELIEVO_REQUIRE_GL");
  EXPECT_TRUE(noGl(none));
  EXPECT_NONFATAL_FAILURE(noGl(other), "not for want of GL");
  setenv("RELIEVO_REQUIRE_GL", "1", 1);
  EXPECT_NONFATAL_FAILURE(noGl(none), "GL is required");
  EXPECT_NONFATAL_FAILURE(noGl(other), "GL is required");
  EXPECT_FALSE(noGl(fine));
  if (before) setenv("RELIEVO_REQUIRE_GL", kept.c_str(), 1);
  else unsetenv("RELIEVO_REQUIRE_GL");
}

TEST_F(Cli, RenderIsDeterministicAndReadsOnlyWhatThePlanNames) {
  ASSERT_EQ(
      relievo("sample inscription -o " + file("s") + " --size 700x500 --write height --package " + file("i.relievo"))
          .exit_code,
      0);
  std::string common =
      "render " + file("i.relievo") + " --size 320x180 --azimuth 30 --elevation 20 --light -0.7,0.2,0.5 --settle ";
  Outcome first = relievo(common + "-o " + file("a.png") + " --stats " + file("a.json"));
  if (noGl(first)) GTEST_SKIP() << first.output;
  ASSERT_EQ(first.exit_code, 0) << first.output;
  ASSERT_EQ(relievo(common + "-o " + file("b.png") + " --workers 5").exit_code, 0);
  EXPECT_EQ(run("cmp " + file("a.png") + " " + file("b.png")).exit_code, 0);
  auto stats = nlohmann::json::parse(std::ifstream(file("a.json")), nullptr, false);
  ASSERT_FALSE(stats.is_discarded());
  EXPECT_GT(stats["planes"]["relief"]["pages_read"].get<int>(), 0);
  EXPECT_EQ(stats["missing_pages"].get<int>(), 0);
  // Without relief no relief page is read; under a fixed light only resolved pages are uploaded.
  ASSERT_EQ(relievo(common + "-o " + file("c.png") + " --no-relief --stats " + file("c.json")).exit_code, 0);
  stats = nlohmann::json::parse(std::ifstream(file("c.json")), nullptr, false);
  EXPECT_FALSE(stats["planes"].contains("relief")) << stats.dump(1);
  const Outcome fixed = relievo(common + "-o " + file("d.png") + " --no-relight --stats " + file("d.json"));
  ASSERT_EQ(fixed.exit_code, 0) << fixed.output;
  stats = nlohmann::json::parse(std::ifstream(file("d.json")), nullptr, false);
  EXPECT_GT(stats["planes"]["resolved"]["pages_uploaded"].get<int>(), 0);
  EXPECT_EQ(stats["planes"]["a0-a2"]["pages_uploaded"].get<int>(), 0) << stats.dump(1);
}

// One error each, that says what to do; no picture.
TEST_F(Cli, CamerasThatAreNoneAreRefused) {
  ASSERT_EQ(
      relievo("sample inscription -o " + file("s") + " --size 200x100 --write height --package " + file("i.relievo"))
          .exit_code,
      0);
  write("parallel.json", R"({"orthographic": true, "distance_mm": 300, "fov_deg": 35})");
  write("bad.json", R"({"orthographic": "yes"})");
  for (auto [arguments, named] : {std::pair<const char*, const char*>{"--orthographic --fov 30", "--fov"},
                                  {"--mm-per-px 0.05 --fov 30", "--fov"},
                                  {"--mm-per-px 0", "above 0"},
                                  {"--mm-per-px -0.05", "above 0"},
                                  {"--mm-per-px nan", "above 0"},
                                  {"--mm-per-px inf", "above 0"},
                                  {"--mm-per-px small", "--mm-per-px"},
                                  {"--mm-per-px 0.05 --distance 300", "--distance"},
                                  {"--mm-per-px 0.05 --perspective", "--perspective"},
                                  {"--mm-per-px 0.0001", "--size"},
                                  {"--orthographic --perspective", "--perspective"},
                                  {"--fov 0.99", "1 to 170"},
                                  {"--fov 170.1", "1 to 170"},
                                  {"--fov nan", "1 to 170"},
                                  {"--orthographic --distance 0", "--distance"},
                                  {"--state parallel.json --fov 30", "--fov"}}) {
    std::string all = arguments;
    if (const size_t at = all.find("parallel.json"); at != std::string::npos)
      all.replace(at, 13, file("parallel.json"));
    const Outcome r = relievo("render " + file("i.relievo") + " -o " + file("x.png") + " " + all);
    EXPECT_EQ(r.exit_code, 1) << arguments << ": " << r.output;
    EXPECT_NE(r.output.find(named), std::string::npos) << arguments << ": " << r.output;
    EXPECT_EQ(std::count(r.output.begin(), r.output.end(), '\n'), 1 + (r.output.find("--help") != std::string::npos))
        << arguments << ": " << r.output;
    EXPECT_FALSE(fs::exists(file("x.png"))) << arguments;
  }
  EXPECT_EQ(relievo("render " + file("i.relievo") + " -o " + file("x.png") + " --state " + file("bad.json")).exit_code,
            3);
}

// In a scene or as an option: the plan names them, and what one cannot say is one error.
TEST_F(Cli, LightsAreThoseOfTheSceneOrTheOption) {
  ASSERT_EQ(relievo("sample coin --size 128x128 --package " + file("coin.relievo")).exit_code, 0);
  const std::string lights = R"([{"position_mm": [3, 4, 0]}, {"towards": [1, 0, 1], "color": [1, 0.5, 0]}])";
  write("scene.json",
        R"({"format": "relievo-scene", "version": 1, "artwork": "coin.relievo", "lights": )" + lights + "}");
  const std::string scene = relievo("plan --no-measure " + file("scene.json")).output,
                    options =
                        relievo("plan --no-measure " + file("coin.relievo") + " --lights '" + lights + "'").output;
  for (const std::string& plan : {scene, options}) {
    EXPECT_NE(plan.find("far away, towards 1 0 1, intensity 1, color 1 0.5 0"), std::string::npos) << plan;
    EXPECT_NE(plan.find("near, at 3 4 0 mm, intensity 1 at 5 mm"), std::string::npos) << plan;
    EXPECT_NE(plan.find("kept depth"), std::string::npos) << plan;
  }
  // Near ones cast shadows as well.
  EXPECT_EQ(scene.find(", shadows"), std::string::npos) << scene;
  const std::string shadowed = relievo("plan --no-measure --shadows " + file("scene.json")).output;
  for (const char* light : {"at 3 4 0 mm, intensity 1 at 5 mm, color 1 1 1, shadows", "color 1 0.5 0, shadows"})
    EXPECT_NE(shadowed.find(light), std::string::npos) << shadowed;
  // --light takes the place of the scene's.
  const std::string one = relievo("plan --no-measure " + file("scene.json") + " --light 1,0,1").output;
  EXPECT_EQ(one.find("LIGHTS"), std::string::npos) << one;
  EXPECT_NE(one.find("passes"), std::string::npos) << one;
  for (const char* wrong : {"--lights '[{\"at\": 3}]'", "--lights 7", "--lights '[{}]' --light 0,0,1"}) {
    const Outcome r = relievo("plan --no-measure " + file("coin.relievo") + " " + wrong);
    EXPECT_EQ(r.exit_code, 1) << wrong;
    EXPECT_NE(r.output.find("--light"), std::string::npos) << r.output;
  }
  EXPECT_EQ(relievo("accuracy " + file("scene.json") + " --quick -o " + file("accuracy")).exit_code, 1);
}

// The plan says how many directions a light with a size and the sky are, and the option is the scene's.
TEST_F(Cli, SoftLightIsInThePlan) {
  ASSERT_EQ(relievo("sample coin --size 128x128 --package " + file("coin.relievo")).exit_code, 0);
  write("scene.json", R"({"format": "relievo-scene", "version": 1, "artwork": "coin.relievo",
    "light": {"shadows": true, "size_deg": 4}, "effects": {"ambient_occlusion": 0.5}})");
  const std::string plan = relievo("plan --no-measure " + file("scene.json")).output;
  EXPECT_NE(plan.find("a light of 4 degrees: 64 directions"), std::string::npos) << plan;
  EXPECT_NE(plan.find("the sky, strength 0.5: 64 directions"), std::string::npos) << plan;
  EXPECT_NE(plan.find("soft shadow"), std::string::npos) << plan;
  const std::string glossy = relievo("plan --no-measure " + file("scene.json") + " --gloss 0.04").output;
  EXPECT_NE(glossy.find("reflectance 0.04, roughness 0.3, simulated; normals: fitted to the drawn relief"),
            std::string::npos)
      << glossy;
  EXPECT_NE(plan.find("OCCLUSION_FILES"), std::string::npos) << plan;
  EXPECT_EQ(plan,
            relievo("plan --no-measure " + file("coin.relievo") + " --shadows --light-size 4 --ambient-occlusion 0.5")
                .output);
  const std::string off =
      relievo("plan --no-measure " + file("scene.json") + " --light-size 0 --ambient-occlusion 0").output;
  EXPECT_EQ(off.find("directions"), std::string::npos) << off;
  EXPECT_EQ(relievo("plan --no-measure " + file("coin.relievo") + " --lights '[{}]' --light-size 4").exit_code, 1);
  EXPECT_EQ(relievo("plan --no-measure " + file("coin.relievo") + " --light-size 91").exit_code, 1);
}

TEST_F(Cli, ShadingSaysWhichValueIsWhichColour) {
  ASSERT_EQ(relievo("sample coin --size 128x128 --package " + file("coin.relievo")).exit_code, 0);
  write("scene.json", R"({"format": "relievo-scene", "version": 1, "artwork": "coin.relievo",
    "shading": {"kind": "slope", "full_deg": 40}})");
  const Outcome plan = relievo("plan --no-measure " + file("scene.json"));
  EXPECT_NE(plan.output.find("slope: 0 degrees is RGB 255 255 255"), std::string::npos) << plan.output;
  EXPECT_NE(plan.output.find("40 degrees is RGB 0 0 0"), std::string::npos) << plan.output;
  EXPECT_EQ(plan.output.find("plane     rgb"), std::string::npos) << plan.output;
  // The option takes the place of the scene's.
  const std::string other =
      relievo("plan --no-measure " + file("scene.json") + R"( --shading '{"kind": "depth", "high_mm": 2}')").output;
  EXPECT_NE(other.find("2 mm is RGB 255 255 255"), std::string::npos) << other;
  const std::string none = relievo("plan --no-measure " + file("scene.json") + " --shading none").output;
  EXPECT_EQ(none.find("degrees"), std::string::npos) << none;
  for (const char* wrong :
       {"--shading height", "--shading '{\"radius_mm\": 1}'", "--shading '{\"kind\": \"slope\", \"full_deg\": 0}'"}) {
    const Outcome r = relievo("plan --no-measure " + file("coin.relievo") + " " + wrong);
    EXPECT_EQ(r.exit_code, 1) << wrong;
    EXPECT_NE(r.output.find("--shading"), std::string::npos) << r.output;
  }
  EXPECT_EQ(relievo("accuracy " + file("scene.json") + " --quick -o " + file("accuracy")).exit_code, 1);
}

// A scene in the artwork's place is drawn as its options would have it; options given beside it win.
TEST_F(Cli, ASceneIsDrawnAsItsOptionsWouldHaveIt) {
  ASSERT_EQ(relievo("sample coin --size 128x128 --package " + file("coin.relievo")).exit_code, 0);
  write("scene.json", R"({"format": "relievo-scene", "version": 1, "artwork": "coin.relievo",
    "camera": {"azimuth_deg": 25, "elevation_deg": 15, "fov_deg": 20}, "light": {"towards": [-0.8, 0.3, 0.4]},
    "surface": {"exaggerate": 2}, "effects": {"exposure": 0.5}, "settings": {"error_px": 3, "sampling": "nearest"},
    "picture": {"size_px": [96, 64], "background": [255, 0, 128]}})");
  const std::string scene = file("scene.json"),
                    options = file("coin.relievo") +
                              " --azimuth 25 --elevation 15 --fov 20 --light=-0.8,0.3,0.4 "
                              "--exaggerate 2 --exposure 0.5 --error-px 3 --sampling nearest "
                              "--background 255,0,128";
  const Outcome drawn = relievo("render " + scene + " -o " + file("a.png"));
  if (noGl(drawn)) GTEST_SKIP() << "no GL";
  ASSERT_EQ(drawn.exit_code, 0) << drawn.output;
  const auto same = [&](const std::string& a, const std::string& b) {
    return run("cmp -s " + file(a) + " " + file(b)).exit_code == 0;
  };
  ASSERT_EQ(relievo("render " + options + " --size 96x64 -o " + file("b.png")).exit_code, 0);
  EXPECT_TRUE(same("a.png", "b.png"));
  ASSERT_EQ(relievo("render " + scene + " --azimuth 30 -o " + file("c.png")).exit_code, 0);
  EXPECT_FALSE(same("a.png", "c.png")) << "the control: an option that wins";
  ASSERT_EQ(relievo("render " + scene + " --orthographic -o " + file("d.png")).exit_code, 0);
  EXPECT_FALSE(same("a.png", "d.png"));
  // Every command that reads an artwork takes it.
  for (const char* command : {"info ", "verify ", "plan --no-measure ", "plan --size 32x32 "})
    EXPECT_EQ(relievo(command + scene).exit_code, 0) << command;
  EXPECT_EQ(relievo("export " + scene + " -o " + file("coin.ply") + " --level 4").exit_code, 0);
  const Outcome two = relievo("render " + scene + " --state " + scene + " -o " + file("e.png"));
  EXPECT_EQ(two.exit_code, 1) << two.output;
  // No input is overwritten, and what a scene names and is not there is told by its name.
  EXPECT_EQ(relievo("plan " + scene + " --no-measure --json " + scene).exit_code, 1);
  write("lost.json", R"({"format": "relievo-scene", "version": 1, "artwork": "lost.relievo"})");
  const Outcome lost = relievo("render " + file("lost.json") + " -o " + file("e.png"));
  EXPECT_EQ(lost.exit_code, 2) << lost.output;
  EXPECT_NE(lost.output.find("lost.relievo"), std::string::npos) << lost.output;
}

// Several artworks in one picture, whichever comes first; what takes one artwork says so.
TEST_F(Cli, ArtworksOfASceneAreSeenTogether) {
  for (const char* kind : {"coin", "inscription"})
    ASSERT_EQ(
        relievo("sample " + std::string(kind) + " --size 128x128 --package " + file(kind + std::string(".relievo")))
            .exit_code,
        0);
  const auto scene = [&](const std::string& artworks) {
    return R"({"format": "relievo-scene", "version": 1, "picture": {"size_px": [96, 64]}, "artworks": [)" + artworks +
           "]}";
  };
  const std::string stone = R"({"file": "inscription.relievo", "pose": {"rotate_deg": [-25, 0, 0]}})",
                    coin = R"({"file": "coin.relievo", "pose": {"position_mm": [0, -100, 200]}})",
                    aside = R"({"file": "coin.relievo", "pose": {"position_mm": [90, -100, 200]}})";
  for (const auto& [name, artworks] : {std::pair<std::string, std::string>{"two", stone + "," + coin},
                                       {"turned", coin + "," + stone},
                                       {"moved", stone + "," + aside},
                                       {"one", stone}})
    write(name + ".json", scene(artworks));
  write("alone.json", R"({"format": "relievo-scene", "version": 1, "picture": {"size_px": [96, 64]},
    "artwork": "inscription.relievo", "pose": {"rotate_deg": [-25, 0, 0]}})");
  // Nobody who takes one artwork takes the first.
  const std::string folder = file("o"), mesh = file("x.ply");
  for (const std::string& command :
       {std::string("info "), std::string("verify "), "accuracy --quick -o " + folder + " ", "export -o " + mesh + " ",
        "compare -o " + folder + " "}) {
    const Outcome refused = relievo(command + file("two.json"));
    EXPECT_EQ(refused.exit_code, 1) << command;
    EXPECT_NE(refused.output.find("has 2 artworks, and this command takes one"), std::string::npos) << refused.output;
    EXPECT_NE(refused.output.find("inscription.relievo, "), std::string::npos) << refused.output;
  }
  EXPECT_EQ(relievo("info " + file("one.json")).exit_code, 0) << "the control";
  EXPECT_EQ(relievo("plan --no-measure " + file("two.json") + " --json " + file("coin.relievo")).exit_code, 1)
      << "an input";
  const std::string plan = relievo("plan --no-measure " + file("two.json")).output;
  for (const char* named : {"inscription.relievo\n", "coin.relievo\n", "composition"})
    EXPECT_NE(plan.find(named), std::string::npos) << plan;
  EXPECT_EQ(relievo("plan --no-measure " + file("one.json")).output.find("composition"), std::string::npos);
  const Outcome drawn = relievo("render " + file("two.json") + " -o " + file("two.png") + " --stats " +
                                file("two.stats") + " --frames 2");
  if (noGl(drawn)) GTEST_SKIP() << "no GL";
  ASSERT_EQ(drawn.exit_code, 0) << drawn.output;
  std::ifstream in(file("two.stats"));
  const auto stats = nlohmann::json::parse(in);
  EXPECT_EQ(stats["artworks"].size(), 2u);
  EXPECT_GT(stats["composition_mib"], 0);
  for (const char* name : {"turned", "moved", "one", "alone"})
    ASSERT_EQ(
        relievo("render " + file(name + std::string(".json")) + " -o " + file(name + std::string(".png"))).exit_code,
        0);
  const auto same = [&](const std::string& a, const std::string& b) {
    return run("cmp -s " + file(a) + " " + file(b)).exit_code == 0;
  };
  EXPECT_TRUE(same("two.png", "turned.png"));
  EXPECT_FALSE(same("two.png", "moved.png")) << "the control: another pose";
  EXPECT_TRUE(same("one.png", "alone.png")) << "a list of one is that one";
  EXPECT_FALSE(same("two.png", "one.png"));
  // What is wrong with one is said of it.
  write("lost.json", scene(stone + R"(,{"file": "lost.relievo"})"));
  const Outcome lost = relievo("render " + file("lost.json") + " -o " + file("e.png"));
  EXPECT_EQ(lost.exit_code, 2) << lost.output;
  EXPECT_NE(lost.output.find("lost.relievo"), std::string::npos) << lost.output;
  const Outcome unlit = relievo("render " + file("two.json") + " --unlit -o " + file("e.png"));
  EXPECT_EQ(unlit.exit_code, 1);
  EXPECT_NE(unlit.output.find("inscription.relievo: "), std::string::npos) << unlit.output;
}

// Pictures of a scene that moves: each is that of its moment alone, whatever was drawn before it.
TEST_F(Cli, ASceneThatMovesIsDrawnMomentByMoment) {
  ASSERT_EQ(relievo("sample coin --size 128x128 --package " + file("coin.relievo")).exit_code, 0);
  const auto scene = [](const std::string& more) {
    return R"({"format": "relievo-scene", "version": 1, "artwork": "coin.relievo", "picture": {"size_px": [64, 48]})" +
           more + "}";
  };
  write("film.json", scene(R"(, "camera_path": [{"time_s": 0, "azimuth_deg": -30}, {"time_s": 2, "azimuth_deg": 40}],
    "lights": [{"towards": [-1, 0, 1], "keys": [{"time_s": 0, "intensity": 1}, {"time_s": 1, "intensity": 0.25}]}])"));
  const std::string film = "render " + file("film.json");
  const Outcome drawn = relievo(film + " --frames 3 -o " + file("f-%02d.png"));
  if (noGl(drawn)) GTEST_SKIP() << "no GL";
  ASSERT_EQ(drawn.exit_code, 0) << drawn.output;
  EXPECT_EQ(filesNamed("f-0"), 3);
  const auto same = [&](const std::string& a, const std::string& b) {
    return run("cmp -s " + file(a) + " " + file(b)).exit_code == 0;
  };
  for (const std::string time : {"2", "1", "0"}) {  // f-00.png is at 0 s, and so on
    ASSERT_EQ(relievo(film + " --time " + time + " -o " + file("moment.png")).exit_code, 0);
    EXPECT_TRUE(same("moment.png", "f-0" + time + ".png")) << time;
    EXPECT_FALSE(same("moment.png", "f-0" + std::to_string((time[0] - '0' + 1) % 3) + ".png")) << "the control";
  }
  // A moment is that of a scene that does not move; without --time it is the first.
  write("still.json",
        scene(R"(, "camera": {"azimuth_deg": 40}, "lights": [{"towards": [-1, 0, 1], "intensity": 0.25}])"));
  ASSERT_EQ(relievo("render " + file("still.json") + " -o " + file("still.png")).exit_code, 0);
  const auto distance = [&](const std::string& arguments) {
    const Outcome r = relievo("render " + arguments + " --distance 60 -o " + file("still.png"));
    EXPECT_EQ(r.exit_code, 0) << r.output;
    return run("cat " + file("still.png")).output;
  };
  EXPECT_EQ(distance(file("still.json")), distance(file("film.json") + " --time 2"));
  EXPECT_EQ(distance(file("film.json")), distance(file("film.json") + " --time 0"));
  EXPECT_NE(distance(file("film.json")), distance(file("film.json") + " --time 2")) << "the control";
  EXPECT_EQ(distance(file("film.json") + " --azimuth 5 --light 0,0,1"),
            distance(file("film.json") + " --azimuth 5 --light 0,0,1 --time 2"))
      << "options given beside it hold still";
  // Interrupted, it leaves whole pictures.
  const Outcome stopped =
      run("( " + std::string(RELIEVO_PROGRAM) + " " + film + " --frames 90000 -o " + file("cut-%05d.png") +
          " & pid=$!; until [ -e " + file("cut-00001.png") + " ]; do sleep 0.05; done; kill -INT $pid; wait $pid )");
  EXPECT_EQ(stopped.exit_code, 130) << stopped.output;
  EXPECT_LT(filesNamed("cut-"), 90000);
  for (const auto& picture : fs::directory_iterator(folder_)) {
    const std::string name = picture.path().filename().string();
    if (!name.starts_with("cut-")) continue;
    const std::string bytes = run("cat " + picture.path().string()).output;
    EXPECT_TRUE(name.ends_with(".png") && bytes.size() > 50 && bytes.substr(bytes.size() - 8, 4) == "IEND") << name;
  }
}

TEST_F(Cli, WhatASceneThatMovesCannotDoIsOneError) {
  ASSERT_EQ(relievo("sample coin --size 128x128 --package " + file("coin.relievo")).exit_code, 0);
  write("film.json", R"({"format": "relievo-scene", "version": 1, "artwork": "f-3.png",
    "camera_path": [{"time_s": 0, "azimuth_deg": -30}, {"time_s": 2, "azimuth_deg": 40}]})");
  for (const auto& [arguments, named] : {
           std::pair{"film.json --time 2.5 -o a.png", "from 0 to the scene's 2 s, found 2.5"},
           {"film.json --time 1 -o a-%d.png", "--time is of one picture"},
           {"film.json -o a-%d.png", "say how many"},
           {"film.json --fps 2 --frames 3 -o a-%d.png", "say how many"},
           {"film.json --fps 2 -o a.png", "-o names one"},
           {"film.json --fps 999999 -o a-%d.png", "--fps"},
           {"film.json --fps 1000 --duration 3 -o a-%d.png", "--duration"},
           {"film.json --fps 2 --stats s.json -o a-%d.png", "--stats is of one picture"},
           {"film.json --frames 4 -o f-%d.png", "would take the place of FILE"},
           {"coin.relievo --time 1 -o a.png", "no scene with a duration"},
           {"coin.relievo --fps 1 -o a-%d.png", "no scene with a duration"},
           {"coin.relievo --frames 1 -o a-%d.png", "no scene with a duration"},
       }) {
    const Outcome r = run("cd " + folder_ + " && " + RELIEVO_PROGRAM + " render " + arguments);
    EXPECT_EQ(r.exit_code, 1) << arguments << r.output;
    EXPECT_NE(r.output.find(named), std::string::npos) << arguments << r.output;
  }
  EXPECT_EQ(filesNamed("a-") + filesNamed("a.png"), 0);
}

TEST_F(Cli, AnOrthographicPictureHasItsScale) {
  ASSERT_EQ(
      relievo("sample inscription -o " + file("s") + " --size 400x300 --write height --package " + file("i.relievo"))
          .exit_code,
      0);
  auto info = nlohmann::json::parse(relievo("info " + file("i.relievo") + " --json").output, nullptr, false);
  ASSERT_FALSE(info.is_discarded());
  auto render = [&](const std::string& arguments, const char* name) {
    const Outcome r = relievo("render " + file("i.relievo") + " " + arguments + " -o " +
                              file(std::string(name) + ".png") + " --stats " + file("stats.json"));
    if (noGl(r)) return nlohmann::json();
    EXPECT_EQ(r.exit_code, 0) << r.output;
    return nlohmann::json::parse(std::ifstream(file("stats.json")), nullptr, false);
  };
  // Of a PNG's header: width, height; and the pixels a metre of pHYs, 0 without it.
  auto header = [&](const char* name) {
    std::ifstream in(file(std::string(name) + ".png"), std::ios::binary);
    const std::string bytes((std::istreambuf_iterator<char>(in)), {});
    auto at = [&](size_t i) {
      uint32_t v = 0;
      for (size_t k = 0; k < 4; ++k) v = v << 8 | static_cast<uint8_t>(bytes.at(i + k));
      return v;
    };
    const size_t physical = bytes.find("pHYs");
    return std::array<uint32_t, 3>{at(16), at(20), physical == std::string::npos ? 0 : at(physical + 4)};
  };
  auto stats = render("--mm-per-px 2", "scaled");
  if (stats.is_null()) GTEST_SKIP() << "no GL";
  EXPECT_EQ(stats["projection"], "orthographic");
  EXPECT_NEAR(stats["mm_per_px"].get<double>(), 2, 1e-9);
  const double mm_per_texel = info["mm_per_px"].get<double>();
  // As large as all of the artwork takes, unless a size is given.
  EXPECT_EQ(header("scaled"),
            (std::array<uint32_t, 3>{static_cast<uint32_t>(std::ceil(400 * mm_per_texel / 2 - 1e-6)),
                                     static_cast<uint32_t>(std::ceil(300 * mm_per_texel / 2 - 1e-6)), 500}));
  char texel[40];
  std::snprintf(texel, sizeof texel, "--mm-per-px %.17g", mm_per_texel);
  render(texel, "texels");
  EXPECT_EQ(header("texels")[0], 400u);
  EXPECT_EQ(header("texels")[1], 300u);
  stats = render("--mm-per-px 2 --size 128x64 --azimuth 30 --target 10,5,0", "part");
  EXPECT_NEAR(stats["mm_per_px"].get<double>(), 2, 1e-9);
  EXPECT_EQ(header("part"), (std::array<uint32_t, 3>{128, 64, 500}));
  // The same camera twice: by its distance, and by what the viewer prints.
  stats = render("--orthographic --distance 300 --size 128x64", "distance");
  EXPECT_NEAR(stats["mm_per_px"].get<double>(), 600 * std::tan(17.5 * 3.14159265358979 / 180) / 64, 1e-9);
  write("state.json", R"({"orthographic": true, "distance_mm": 300, "fov_deg": 35})");
  render("--state " + file("state.json") + " --size 128x64", "state");
  EXPECT_EQ(run("cmp " + file("distance.png") + " " + file("state.png")).exit_code, 0);
  stats = render("--state " + file("state.json") + " --perspective --fov 40 --size 128x64", "perspective");
  EXPECT_EQ(stats["projection"], "perspective");
  EXPECT_GT(stats["mm_per_px_at_target"].get<double>(), 0);
  EXPECT_FALSE(stats.contains("mm_per_px"));
  EXPECT_EQ(header("perspective")[2], 0u) << "no scale: it is none";
  EXPECT_NE(run("cmp " + file("distance.png") + " " + file("perspective.png")).exit_code, 0);
}

TEST_F(Cli, SimulatedStorageChangesTheWayAndNotThePicture) {
  if (relievo::test::kSanitized) GTEST_SKIP() << "about pictures; page_faults_test has the same sources";
  ASSERT_EQ(
      relievo("sample inscription -o " + file("s") + " --size 400x300 --write height --package " + file("i.relievo"))
          .exit_code,
      0);
  std::string common =
      "render " + file("i.relievo") + " --size 160x90 --workers 8 --timeout 60 --stats " + file("s.json") + " -o ";
  Outcome sound = relievo(common + file("a.png"));
  if (noGl(sound)) GTEST_SKIP() << sound.output;
  ASSERT_EQ(sound.exit_code, 0) << sound.output;
  Outcome slow = relievo(common + file("b.png") + " --source-rate 20 --source-latency 3 --source-jitter 2");
  ASSERT_EQ(slow.exit_code, 0) << slow.output;
  EXPECT_EQ(run("cmp " + file("a.png") + " " + file("b.png")).exit_code, 0);
  // Every read goes wrong: no picture, or where that is asked for one with stand-ins; one line says so.
  const std::string fails = " --source-fail 100 --source-seed 3";
  Outcome dead = relievo(common + file("c.png") + fails);
  EXPECT_EQ(dead.exit_code, 2) << dead.output;
  EXPECT_FALSE(fs::exists(file("c.png")));
  dead = relievo(common + file("c.png") + fails + " --allow-damage");
  ASSERT_EQ(dead.exit_code, 0) << dead.output;
  EXPECT_NE(run("cmp " + file("a.png") + " " + file("c.png")).exit_code, 0);
  auto stats = nlohmann::json::parse(std::ifstream(file("s.json")), nullptr, false);
  ASSERT_FALSE(stats.is_discarded());
  const int failed = stats["failed_pages"].get<int>();
  EXPECT_GT(failed, 1);
  EXPECT_EQ(std::count(dead.output.begin(), dead.output.end(), '\n'), 1) << dead.output;
  EXPECT_NE(dead.output.find("warning: " + file("i.relievo") + ": " + std::to_string(failed) + " of "),
            std::string::npos)
      << dead.output;
  for (const char* bad : {"--source-rate -1", "--source-latency x", "--source-fail 101", "--source-memory -3"}) {
    Outcome r = relievo(common + file("d.png") + " " + bad);
    EXPECT_EQ(r.exit_code, 1) << bad;
    EXPECT_NE(r.output.find(std::string(bad).substr(0, 12)), std::string::npos) << r.output;
  }
  for (const char* command : {"render --help", "view --help"})
    EXPECT_NE(relievo(command).output.find("Simulated storage"), std::string::npos);
}

TEST_F(Cli, BenchRunsAGroupAndWritesItsRows) {
  if (relievo::test::kSanitized) GTEST_SKIP() << "about figures";
  Outcome r = relievo("bench --quick --only decode --json " + file("b.json"));
  if (noGl(r)) GTEST_SKIP() << r.output;
  ASSERT_EQ(r.exit_code, 0) << r.output;
  auto json = nlohmann::json::parse(std::ifstream(file("b.json")), nullptr, false);
  ASSERT_FALSE(json.is_discarded());
  ASSERT_FALSE(json["rows"].empty());
  for (const auto& row : json["rows"]) {
    EXPECT_EQ(row["group"], "decode");
    EXPECT_GT(row["measured"].get<double>(), 0);
    EXPECT_GT(row["baseline"].get<double>(), 0) << "nothing to compare with";
  }
  EXPECT_EQ(relievo("bench --only nonsense").exit_code, 1);
}

// Every row of the JSON file is a row of the page; groups that did not run are not in it.
TEST_F(Cli, BenchWritesAPageOfTheGroupsThatRan) {
  if (relievo::test::kSanitized) GTEST_SKIP() << "about figures";
  Outcome r = relievo("bench --quick --only page-table --json " + file("b.json") + " --markdown " + file("b.md"));
  if (noGl(r)) GTEST_SKIP() << r.output;
  ASSERT_EQ(r.exit_code, 0) << r.output;
  auto json = nlohmann::json::parse(std::ifstream(file("b.json")), nullptr, false);
  ASSERT_FALSE(json.is_discarded());
  std::stringstream text;
  text << std::ifstream(file("b.md")).rdbuf();
  const std::string page = text.str();
  for (const char* line : {"| processor | ", "| cores | ", "| GL renderer | ", "| artwork | ", "| version | relievo ",
                           "| date | 20", "## page-table\n"})
    EXPECT_NE(page.find(std::string("\n") + line), std::string::npos) << line;
  EXPECT_EQ(page.find("\n## "), page.rfind("\n## ")) << "one group ran";
  ASSERT_FALSE(json["rows"].empty());
  for (const auto& row : json["rows"]) {
    const std::string start = "\n| " + row["what"].get<std::string>() + " | ";
    EXPECT_NE(page.find(start), std::string::npos) << start;
  }
  // Both on standard output would be two texts in one.
  EXPECT_EQ(relievo("bench --only page-table --json - --markdown -").exit_code, 1);
}

TEST_F(Cli, SelftestPrintsAndWritesItsTable) {
  Outcome r = relievo("selftest --stability --only time --json " + file("s.json") + " --markdown " + file("s.md"));
  EXPECT_EQ(r.exit_code, 0) << r.output;
  EXPECT_NE(r.output.find(" hold, 0 fail"), std::string::npos) << r.output;
  std::ifstream in(file("s.json"));
  const auto json = nlohmann::json::parse(in, nullptr, false);
  ASSERT_TRUE(json.contains("cases"));
  EXPECT_GE(json["cases"].size(), 2u);
  EXPECT_TRUE(json["cases"][0]["holds"].get<bool>());
  std::ifstream page(file("s.md"));
  const std::string table{std::istreambuf_iterator<char>(page), {}};
  EXPECT_NE(table.find("| time | "), std::string::npos) << table;
  r = relievo("selftest --only nothing");
  EXPECT_EQ(r.exit_code, 1) << r.output;
  EXPECT_NE(r.output.find("there are: textures, geometry"), std::string::npos) << r.output;
}

TEST_F(Cli, CompareNamesWhatIsWrongAndLeavesNoHalfReport) {
  ASSERT_EQ(
      relievo("sample inscription -o " + file("s") + " --size 300x200 --write ptm-lrgb --package " + file("a.relievo"))
          .exit_code,
      0);
  const std::string compare = "compare " + file("a.relievo") + " -o " + file("report") + " ";
  EXPECT_EQ(relievo("compare " + file("a.relievo")).exit_code, 1);  // no -o
  EXPECT_EQ(relievo("compare -o " + file("report") + " " + file("nowhere.relievo")).exit_code, 2);
  Outcome r = relievo(compare + "--strategies uniform,nobody");
  EXPECT_EQ(r.exit_code, 1) << r.output;
  EXPECT_NE(r.output.find("'nobody'"), std::string::npos) << r.output;
  EXPECT_EQ(relievo(compare + "--error-px 1,none").exit_code, 1);
  EXPECT_EQ(relievo(compare + "--error-px 0").exit_code, 1);
  EXPECT_EQ(relievo(compare + "--path " + file("nowhere.json")).exit_code, 2);
  write("path.json", "{\"cameras\": [{\"distance_mm\": \"far\"}]}");
  r = relievo(compare + "--path " + file("path.json"));
  EXPECT_EQ(r.exit_code, 3) << r.output;
  EXPECT_NE(r.output.find("camera 0"), std::string::npos) << r.output;
  write("path.json", "{\"cameras\": [{\"azimuth_deg\": 3}, {\"azimuth\": 3}]}");
  r = relievo(compare + "--path " + file("path.json"));
  EXPECT_EQ(r.exit_code, 3) << r.output;
  EXPECT_NE(r.output.find("camera 1: there is no 'azimuth'"), std::string::npos) << r.output;
  ASSERT_EQ(relievo("build --ptm " + file("s/ptm_lrgb.ptm") + " -o " + file("flat.relievo")).exit_code, 0);
  EXPECT_EQ(relievo("compare " + file("flat.relievo") + " -o " + file("report")).exit_code, 5);
  EXPECT_FALSE(fs::exists(file("report/report.json")));
  if (noGl(relievo("render " + file("a.relievo") + " -o " + file("a.png") + " --size 64x36")))
    GTEST_SKIP() << "no GL context";
  // Longer than anybody waits, interrupted: nothing is written.
  r = runUntil(file("stopped"), RELIEVO_PROGRAM " compare " + file("a.relievo") + " -o " + file("stopped") +
                                    " --frames 100000 --size 64x36");
  EXPECT_EQ(r.exit_code, 130) << r.output;
  EXPECT_NE(r.output.find("interrupted"), std::string::npos) << r.output;
  EXPECT_TRUE(fs::is_empty(file("stopped")));
  // The page is the largest of the three: a limit that it alone exceeds leaves none of them.
  const std::string quick = compare + "--quick --size 160x90 --frames 2 --error-px 1 --strategies edge-lod,uniform";
  r = run("ulimit -f 16; " RELIEVO_PROGRAM " " + quick);
  EXPECT_EQ(r.exit_code, 2) << r.output;
  EXPECT_TRUE(fs::is_empty(file("report"))) << r.output;
  r = relievo(quick);
  ASSERT_EQ(r.exit_code, 0) << r.output;
  for (const char* name : {"report.json", "report.html", "frames.csv", "summary.csv", "summary.tex",
                           "largest-triangles.svg", "p99-time.svg", "frames-error.svg"})
    EXPECT_TRUE(fs::exists(file(std::string("report/") + name))) << name;
  std::ifstream text(file("report/report.json"));
  auto report = nlohmann::json::parse(text, nullptr, false);
  ASSERT_FALSE(report.is_discarded());
  ASSERT_EQ(report["runs"].size(), 2u);
  EXPECT_EQ(report["runs"][0]["strategy"], "edge-lod");
  EXPECT_EQ(report["runs"][0]["frames"].size(), 2u);
  EXPECT_EQ(report["origin"]["command"],
            "relievo compare a.relievo --quick --strategies edge-lod,uniform --error-px 1 --size 160x90 --frames 2");
  EXPECT_EQ(report["origin"]["package_xxh3_64"].get<std::string>().size(), 16u);
  EXPECT_EQ(report["origin"]["source"], "inscription seed 1, relievo sample");
  // Several reports as one; what is no report is named, and nothing written.
  const std::string merge = "compare -o " + file("all") + " --merge " + file("report/report.json") + " ";
  write("none.json", "{\"runs\": 3}");
  r = relievo(merge + file("none.json"));
  EXPECT_EQ(r.exit_code, 3) << r.output;
  EXPECT_NE(r.output.find("none.json"), std::string::npos) << r.output;
  EXPECT_FALSE(fs::exists(file("all")));
  EXPECT_EQ(relievo(merge + file("nowhere.json")).exit_code, 2);
  EXPECT_EQ(relievo("compare " + file("a.relievo") + " -o " + file("all") + " --merge " + file("none.json")).exit_code,
            1);
  EXPECT_EQ(relievo("compare -o " + file("all")).exit_code, 1);  // neither FILE nor --merge
  ASSERT_EQ(relievo(merge + file("report/report.json")).exit_code, 0);
  for (const char* name : {"report.html", "summary.csv", "summary.tex", "1-largest-time.svg", "2-p99-triangles.svg"})
    EXPECT_TRUE(fs::exists(file(std::string("all/") + name))) << name;
}

}  // namespace cli_test
