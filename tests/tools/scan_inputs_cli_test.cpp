// relievo build --mesh with what its files bring along: glTF with images inside, units of the file, and turning.
#include <nlohmann/json.hpp>
#include <string>

#include "tests/geometry/mesh_files.h"
#include "tests/tools/cli_fixture.h"
#include "tests/view_share.h"

namespace scan_inputs_cli_test {

using namespace relievo;
using namespace relievo::testing_support;
using Json = nlohmann::json;

class ScanInputs : public Cli {
 protected:
  // The package's facts about its scan.
  Json built(const std::string& mesh, const std::string& options = "") const {
    const Outcome r = relievo("build --mesh " + file(mesh) + " -o " + file("a.relievo") + " " + options);
    EXPECT_EQ(r.exit_code, 0) << r.output;
    said_ = r.output;
    return Json::parse(relievo("info " + file("a.relievo") + " --json").output, nullptr, false)["mesh"];
  }
  std::array<double, 3> size(const Json& mesh) const {
    std::array<double, 3> out{};
    for (size_t c = 0; c < 3; ++c) out[c] = mesh["max_mm"][c].get<double>() - mesh["min_mm"][c].get<double>();
    return out;
  }
  mutable std::string said_;
};

// A slab of 40 x 30 x 20 in the file's units, waves on top.
test::Sample slab() {
  test::Sample s = test::scanOfCubeSphere(12, 1);
  for (glm::dvec3& p : s.positions) {
    p /= std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
    p *= glm::dvec3(20, 15, 10);
  }
  return s;
}

TEST_F(ScanInputs, UnitsComeFromTheFileUnlessTheyAreGiven) {
  if (test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  write("a.glb", test::glbFile(slab()));
  EXPECT_NEAR(size(built("a.glb"))[0], 40000, 1);
  EXPECT_NE(said_.find("a.glb (in m): "), std::string::npos) << said_;
  EXPECT_NEAR(size(built("a.glb", "--unit cm"))[0], 400, 0.01);
  EXPECT_NE(said_.find("a.glb (in cm): "), std::string::npos) << said_;
  std::string ply = test::plyFile(slab(), {});
  write("a.ply", ply);
  EXPECT_NEAR(size(built("a.ply"))[0], 40, 1e-3);
  write("a.ply", ply.replace(ply.find("made for a test"), 15, "unit in"));
  EXPECT_NEAR(size(built("a.ply"))[0], 40 * 25.4, 0.02);
  // A tolerance is in mm, whatever the unit.
  EXPECT_NEAR(built("a.ply", "--tolerance 3mm")["tolerance_mm"].get<double>(), 3, 1e-9);
}

TEST_F(ScanInputs, UpAndRotateTurnTheScanAndAreKept) {
  if (test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  write("a.ply", test::plyFile(slab(), {}));
  const auto expectSize = [&](const Json& mesh, double x, double y, double z) {
    const auto found = size(mesh);
    EXPECT_NEAR(found[0], x, 1e-3) << said_;
    EXPECT_NEAR(found[1], y, 1e-3) << said_;
    EXPECT_NEAR(found[2], z, 1e-3) << said_;
  };
  expectSize(built("a.ply", "--up y"), 40, 30, 20);
  EXPECT_NE(said_.find("a.ply (in mm): "), std::string::npos) << said_;
  expectSize(built("a.ply", "--up z"), 40, 20, 30);
  EXPECT_NE(said_.find("a.ply (in mm, its z up): "), std::string::npos) << said_;
  expectSize(built("a.ply", "--up x"), 30, 40, 20);
  expectSize(built("a.ply", "--rotate 0,90,0"), 20, 30, 40);
  EXPECT_NE(said_.find("a.ply (in mm, turned by 0, 90, 0 degrees): "), std::string::npos) << said_;
  expectSize(built("a.ply", "--rotate 0,0,45"), 70 / std::sqrt(2), 70 / std::sqrt(2), 20);
  for (const char* wrong : {"--up w", "--up -z", "--rotate 90", "--rotate 0,0,nan", "--rotate 0,0,9x"})
    EXPECT_EQ(relievo("build --mesh " + file("a.ply") + " -o " + file("b.relievo") + " " + wrong).exit_code, 1)
        << wrong;
  EXPECT_EQ(relievo("build --image " + file("a.png") + " --up z -o " + file("b.relievo")).exit_code, 1);
}

TEST_F(ScanInputs, AnImageInsideAGltfColoursIt) {
  test::Sample s = test::sheet(12, 12, 0.01);
  for (const auto& t : s.triangles) {
    std::array<glm::vec2, 3> uv;
    for (size_t k = 0; k < 3; ++k)
      uv[k] = {static_cast<float>(s.positions[t[k]].x / 0.12), static_cast<float>(s.positions[t[k]].y / 0.12)};
    s.corner_uv.push_back(uv);
  }
  const auto with = [&](const std::string& picture) {
    return ",\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}}],\"textures\":[{\"source\":"
           "0}],\"images\":[{\"uri\":\"" +
           picture + "\"}]";
  };
  const std::string picture = std::string("P6\n2 1\n255\n") + "\xff\x10\x10\x10\x10\xff";
  const std::string embedded = "data:image/x-portable-pixmap;base64," + test::base64(picture);
  // Red on the left and blue on the right, in the vertices of the exported surface.
  const auto reds = [&](const std::string& mesh) {
    built(mesh);
    EXPECT_EQ(relievo("export " + file("a.relievo") + " -o " + file("out.off") + " --level 3").exit_code, 0);
    std::ifstream in(file("out.off"));
    std::string line;
    int left = 0, right = 0;
    while (std::getline(in, line)) {
      double x = 0, y = 0, z = 0;
      int r = 0, g = 0, b = 0;
      if (std::sscanf(line.c_str(), "%lf %lf %lf %d %d %d", &x, &y, &z, &r, &g, &b) != 6) continue;
      if (x < 30) left += r > 200 && b < 60;
      if (x > 90) right += b > 200 && r < 60;
    }
    return std::pair(left, right);
  };
  write("inside.gltf", test::gltfFile(s, with(embedded)));
  const auto [left, right] = reds("inside.gltf");
  EXPECT_GT(left, 10);
  EXPECT_GT(right, 10);
  write("picture.ppm", picture);
  write("beside.glb", test::glbFile(s, with("picture.ppm")));
  EXPECT_EQ(reds("beside.glb"), std::pair(left, right));
  EXPECT_EQ(built("beside.glb", "--texture none")["file"], "beside.glb");
  // What cannot be decoded, or lies outside, is said.
  write("broken.gltf", test::gltfFile(s, with("data:image/png;base64," + test::base64("no picture"))));
  Outcome r = relievo("build --mesh " + file("broken.gltf") + " -o " + file("b.relievo"));
  EXPECT_EQ(r.exit_code, 3) << r.output;
  EXPECT_NE(r.output.find("broken.gltf, the image in it: "), std::string::npos) << r.output;
  EXPECT_EQ(r.output.find("/proc"), std::string::npos) << r.output;
  EXPECT_NE(r.output.find("--texture none"), std::string::npos) << r.output;
  fs::create_directory(file("inner"));
  write("inner/out.glb", test::glbFile(s, with("../picture.ppm")));
  r = relievo("build --mesh " + file("inner/out.glb") + " -o " + file("b.relievo"));
  EXPECT_EQ(r.exit_code, 3) << r.output;
  EXPECT_NE(r.output.find("lies outside its folder"), std::string::npos) << r.output;
  EXPECT_FALSE(fs::exists(file("b.relievo")));
}

// The project's own .glb is read as it was written, in the scan's own mm.
TEST_F(ScanInputs, AnExportedGlbCanBeBuiltAgain) {
  if (test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  write("a.ply", test::plyFile(slab(), {}));
  const auto before = size(built("a.ply"));
  ASSERT_EQ(relievo("export " + file("a.relievo") + " -o " + file("again.glb") + " --level 5").exit_code, 0);
  const Json again = built("again.glb");
  for (size_t c = 0; c < 3; ++c) EXPECT_NEAR(size(again)[c], before[c], 0.05);
  EXPECT_EQ(again["border_loops"], 0);
  EXPECT_EQ(again["unit"], "m");
}

}  // namespace scan_inputs_cli_test
