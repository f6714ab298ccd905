// `relievo accuracy` as its users run it, on a small sample; and its settings in the hands of render and compare.
#include <algorithm>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "tests/tools/cli_fixture.h"

namespace accuracy_cli_test {

using namespace relievo::testing_support;

class AccuracyCli : public Cli {
 protected:
  bool makeSample() {
    const Outcome r = relievo("sample coin --size 128x128 --package " + file("coin.relievo"));
    EXPECT_EQ(r.exit_code, 0) << r.output;
    return r.exit_code == 0;
  }
  std::string textOf(const std::string& name) const {
    std::ostringstream out;
    out << std::ifstream(file(name), std::ios::binary).rdbuf();
    return out.str();
  }
  // What render says its geometric error is at most, px.
  double predictedPx(const std::string& options) const {
    const Outcome r = relievo("render " + file("coin.relievo") + " -o " + file("a.png") + " --size 160x90 --stats " +
                              file("stats.json") + " " + options);
    EXPECT_EQ(r.exit_code, 0) << r.output;
    return r.exit_code == 0 ? nlohmann::json::parse(textOf("stats.json"))["predicted_error_px"].get<double>() : -1;
  }
};

TEST_F(AccuracyCli, AScenesCameraPathIsTaken) {
  ASSERT_TRUE(makeSample());
  auto scene = [&](const std::string& members) {
    std::ofstream(file("turn.json")) << R"({"format": "relievo-scene", "version": 1, "artwork": "coin.relievo")"
                                     << members << "}";
    return file("turn.json");
  };
  constexpr const char* kTurn =
      R"(, "camera": {"elevation_deg": 10, "distance_mm": 60},
         "camera_path": [{"time_s": 0, "azimuth_deg": -30}, {"time_s": 2, "azimuth_deg": 30}])";
  const std::string turn = scene(kTurn);
  const Outcome r = relievo("accuracy " + turn + " --quick --size 96x64 --views 1 --passes 1 --knobs filter " +
                            "--combinations 0 -o " + file("out"));
  if (noGl(r)) GTEST_SKIP() << r.output;
  ASSERT_EQ(r.exit_code, 0) << r.output;
  const auto made = nlohmann::json::parse(textOf("out/accuracy.json"));
  EXPECT_EQ(made["path"]["of"], "scene");
  EXPECT_NE(made["command"].get<std::string>().find("--path scene"), std::string::npos);

  // Two keys alone are a straight line: a quarter and three quarters of the way are the cameras of two frames.
  std::ofstream(file("cameras.json")) << R"({"cameras": [
      {"azimuth_deg": -15, "elevation_deg": 10, "distance_mm": 60}, {"azimuth_deg": 15, "elevation_deg": 10, "distance_mm": 60}]})";
  std::ofstream(file("others.json")) << R"({"cameras": [
      {"azimuth_deg": -30, "elevation_deg": 10, "distance_mm": 60}, {"azimuth_deg": 30, "elevation_deg": 10, "distance_mm": 60}]})";
  auto compared = [&](const std::string& what) {
    const Outcome c =
        relievo("compare " + what + " --quick --size 96x64 --frames 2 --strategies edge-lod --error-px 0.5 -o " +
                file("compared"));
    EXPECT_EQ(c.exit_code, 0) << c.output;
    std::vector<std::string> figures;
    if (c.exit_code != 0) return figures;
    const auto report = nlohmann::json::parse(textOf("compared/report.json"));
    for (const auto& f : report["runs"][0]["frames"])
      figures.push_back(f["triangles"].dump() + " " + f["max_px"].dump() + " " + f["p99_px"].dump());
    return figures;
  };
  const auto along = compared(turn);
  EXPECT_NE(textOf("compared/report.html").find("turn.json"), std::string::npos);
  EXPECT_EQ(along.size(), 2u);
  EXPECT_EQ(along, compared(file("coin.relievo") + " --path " + file("cameras.json")));
  EXPECT_NE(along, compared(file("coin.relievo") + " --path " + file("others.json"))) << "control: other cameras";

  auto refused = [&](const std::string& what) {
    const Outcome none = relievo("compare " + what + " -o " + file("no"));
    EXPECT_EQ(none.exit_code, 1) << none.output;
    return none.output;
  };
  EXPECT_NE(refused(file("coin.relievo") + " --path scene").find("--path scene needs a scene as FILE"),
            std::string::npos);
  EXPECT_NE(refused(scene("") + " --path scene").find("has no \"camera_path\""), std::string::npos);
  EXPECT_NE(refused(scene(std::string(kTurn) + R"(, "pose": {"rotate_deg": [0, 0, 90]})")).find("the scene has a pose"),
            std::string::npos);
}

TEST_F(AccuracyCli, QuickMeasuresAndRecommends) {
  ASSERT_TRUE(makeSample());
  const Outcome r = relievo("accuracy " + file("coin.relievo") +
                            " --quick --size 96x64 --views 1 --passes 1 --knobs error-px,least-cell --combinations 1 "
                            "--psnr 10,59 --frame-ms 100000 -o " +
                            file("out"));
  if (noGl(r)) GTEST_SKIP() << r.output;
  ASSERT_EQ(r.exit_code, 0) << r.output;
  for (const char* name : {"report.html", "accuracy.csv", "front.svg", "error-px.svg", "settings-10-db.json"})
    EXPECT_TRUE(fs::exists(file("out/" + std::string(name)))) << name;
  EXPECT_FALSE(fs::exists(file("out/settings-59-db.json"))) << "no picture of bytes is as accurate";
  const auto json = nlohmann::json::parse(textOf("out/accuracy.json"));
  double finest = 0, coarsest = 0;
  for (const auto& row : json["rows"]) {
    if (row["value"] == "0.5 px") finest = row["psnr_db"];
    if (row["value"] == "8 px") coarsest = row["psnr_db"];
  }
  EXPECT_GT(finest, coarsest + 3);
  EXPECT_GT(json["truth"]["pixels"], 100);
  EXPECT_EQ(std::count_if(json["knobs"].begin(), json["knobs"].end(),
                          [](const auto& k) { return k["measured"].template get<bool>(); }),
            2);
  for (const auto& k : json["knobs"]) EXPECT_EQ(k["measured"].get<bool>(), k["why_not"].is_null()) << k["name"];
  EXPECT_EQ(json["path"]["of"], "flights");
  // Its files are settings of the other commands.
  const std::string fine = "--settings " + file("out/settings-100000-ms.json");
  EXPECT_GE(predictedPx(fine), 0);
}

TEST_F(AccuracyCli, SettingsAreTakenAndOptionsWin) {
  ASSERT_TRUE(makeSample());
  write("s.json", R"({"format": "relievo-settings", "version": 1, "error_px": 8, "sampling": "nearest"})");
  const Outcome gl = relievo("render " + file("coin.relievo") + " -o " + file("a.png") + " --size 64x64");
  if (noGl(gl)) GTEST_SKIP() << gl.output;
  const std::string tilted = "--azimuth 40 ";
  const double eight = predictedPx(tilted + "--error-px 8"), one = predictedPx(tilted + "--error-px 1");
  ASSERT_GT(eight, one) << "else nothing would be shown";
  EXPECT_EQ(predictedPx(tilted + "--settings " + file("s.json")), eight);
  EXPECT_EQ(predictedPx(tilted + "--settings " + file("s.json") + " --error-px 1"), one);
  EXPECT_EQ(predictedPx(tilted), one);
  const Outcome r =
      relievo("compare " + file("coin.relievo") + " --quick --size 96x64 --frames 1 --strategies edge-lod " +
              "--settings " + file("s.json") + " -o " + file("c"));
  ASSERT_EQ(r.exit_code, 0) << r.output;
  EXPECT_EQ(nlohmann::json::parse(textOf("c/report.json"))["runs"][0]["error_px"], 8);
}

TEST_F(AccuracyCli, BadInputsAreOneErrorEach) {
  ASSERT_TRUE(makeSample());
  const std::string coin = file("coin.relievo"), render = "render " + coin + " -o " + file("a.png") + " --settings ";
  write("unknown.json", R"({"format": "relievo-settings", "version": 1, "colour": 1})");
  write("type.json", R"({"format": "relievo-settings", "version": 1, "prefetch": "yes"})");
  write("newer.json", R"({"format": "relievo-settings", "version": 9})");
  struct Case {
    std::string arguments;
    int exit_code;
    std::string named;
  };
  const Case cases[] = {{render + file("unknown.json"), 3, "colour"},
                        {render + file("type.json"), 3, "prefetch"},
                        {render + file("newer.json"), 5, "version 9"},
                        {render + file("none.json"), 2, "none.json"},
                        {"compare " + coin + " -o " + file("c") + " --settings " + file("type.json"), 3, "prefetch"},
                        {"accuracy " + coin + " --knobs speed -o " + file("o"), 1, "there is no knob 'speed'"},
                        {"accuracy " + coin + " --psnr 40,x -o " + file("o"), 1, "--psnr"},
                        {"accuracy " + coin + " --frame-ms 0 -o " + file("o"), 1, "--frame-ms"},
                        {"accuracy " + coin + " --size 8x8 -o " + file("o"), 1, "8x8"},
                        {"accuracy " + file("type.json") + " -o " + file("o"), 3, "type.json"},
                        {"accuracy " + coin + " -o -", 1, "-o"}};
  for (const Case& c : cases) {
    const Outcome r = relievo(c.arguments);
    EXPECT_EQ(r.exit_code, c.exit_code) << c.arguments << "\n" << r.output;
    EXPECT_NE(r.output.find(c.named), std::string::npos) << r.output;
    EXPECT_EQ(std::count(r.output.begin(), r.output.end(), '\n'), 1) << r.output;
  }
  EXPECT_FALSE(fs::exists(file("o"))) << "nothing was measured";
}

TEST_F(AccuracyCli, AnInterruptionLeavesNoReport) {
  ASSERT_TRUE(makeSample());
  const Outcome r = run("timeout --foreground --preserve-status -k 60 -s INT 1.5 " RELIEVO_PROGRAM " accuracy " +
                        file("coin.relievo") + " -o " + file("out"));
  if (noGl(r)) GTEST_SKIP() << r.output;
  EXPECT_EQ(r.exit_code, 130) << r.output;
  EXPECT_NE(r.output.find("interrupted"), std::string::npos) << r.output;
  EXPECT_TRUE(fs::is_empty(file("out")));
}

}  // namespace accuracy_cli_test
