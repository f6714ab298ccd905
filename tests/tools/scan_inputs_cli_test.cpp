// relievo build --mesh with what its files bring along: glTF with images inside, units of the file, and turning.
#include <nlohmann/json.hpp>
#include <string>

#include "src/artwork/patch_domain.h"
#include "tests/geometry/mapped_sheet.h"
#include "tests/geometry/mesh_files.h"
#include "tests/texturing/jpeg_file.h"
#include "tests/tools/cli_fixture.h"
#include "tests/view_share.h"
#include "texturing/codec/page_codec.h"
#include "texturing/package/package.h"
#include "texturing/package/package_layout.h"

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

// As a figure's hair, or what a scanner saw beside it: patches of the scan's own triangles.
TEST_F(ScanInputs, OfManyPiecesNoneIsDropped) {
  if (test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  test::Sample s = slab();
  const size_t of_slab = s.triangles.size();
  for (int k = 0; k < 2500; ++k) {
    const double x = 30 + 0.5 * (k % 50), y = 0.5 * (k / 50);
    test::append(s, {{{x, y, 0}, {x + 0.1, y, 0}, {x, y + 0.1, 0.02}}, {{0, 1, 2}}, {}, {}});
  }
  write("a.ply", test::plyFile(s, {}));
  const Json mesh = built("a.ply");
  EXPECT_EQ(mesh["pieces"], 2501) << said_;
  EXPECT_EQ(said_.find("dropped"), std::string::npos) << said_;
  const auto package = Package::open(file("a.relievo"));
  ASSERT_TRUE(package.ok());
  const uint32_t patches = (*package)->header().domain.patchCount();
  EXPECT_GE(patches, 2500 + of_slab / 2);
  EXPECT_LE(patches, 2500 + of_slab) << "no base of larger patches, which has several for each of them";
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

TEST_F(ScanInputs, AJpegIsKeptAsItIs) {
  test::Sample s = test::sheet(24, 24, 0.01);
  for (const auto& t : s.triangles) {
    std::array<glm::vec2, 3> uv;
    for (size_t k = 0; k < 3; ++k)
      uv[k] = {static_cast<float>(s.positions[t[k]].x / 0.24), static_cast<float>(s.positions[t[k]].y / 0.24)};
    s.corner_uv.push_back(uv);
  }
  const auto texels = [](int side) {
    std::vector<uint8_t> out;
    for (int i = 0; i < 3 * side * side; ++i)
      out.push_back(static_cast<uint8_t>(128 + 90 * std::sin(0.9 * (i / 3 % side)) * std::cos(0.7 * (i / 3 / side)) +
                                         (i * 2654435761u >> 28)));
    return out;
  };
  // Built with the image of these bytes: the package's bytes for all images.
  const auto bytesOf = [&](const std::vector<uint8_t>& picture, const char* name, const std::string& factor = "") {
    write(name, std::string(picture.begin(), picture.end()));
    write("a.glb", test::glbFile(s, ",\"materials\":[{\"pbrMetallicRoughness\":{" + factor +
                                        "\"baseColorTexture\":{\"index\":0}}}],\"textures\":[{\"source\":0}],"
                                        "\"images\":[{\"uri\":\"" +
                                        name + "\"}]"));
    built("a.glb");
    EXPECT_NE(said_.find("stored once and as they are"), std::string::npos) << said_;
    EXPECT_EQ(relievo("verify " + file("a.relievo")).exit_code, 0);
    return (*Package::open(file("a.relievo")))->shownImages().bytes;
  };
  for (const bool progressive : {false, true}) {
    const auto jpeg = jpegFile(1024, 1024, texels(1024), {.progressive = progressive, .comment = true, .quality = 60});
    const uint64_t kept = bytesOf(jpeg, "a.jpg");
    EXPECT_GE(kept, jpeg.size() - 40);
    EXPECT_LE(kept, jpeg.size() + 16'000) << "and where patches lie in it";
    EXPECT_GT(bytesOf(jpeg, "a.jpg", "\"baseColorFactor\":[1,0.5,0.5,1],"), 2 * kept) << "other colours than its own";
  }
  // Of a large one some tiles are encoded first, and tell.
  const auto large = jpegFile(3072, 3072, texels(3072), {.quality = 60});
  EXPECT_LE(bytesOf(large, "b.jpg"), large.size() + 16'000);
  const auto plain = jpegFile(3072, 3072, std::vector<uint8_t>(size_t{3} * 3072 * 3072, 90), {});
  EXPECT_LT(bytesOf(plain, "b.jpg"), plain.size() / 2);
}

// Of a JPEG that claims more than it may it is said, by whichever reader.
TEST_F(ScanInputs, AJpegOfTooManyTexelsIsRefused) {
  const auto jpeg = jpegFile(2048, 2048, std::vector<uint8_t>(size_t{3} * 2048 * 2048, 90), {});
  write("a.jpg", std::string(jpeg.begin(), jpeg.end()));
  write("a.glb", test::glbFile(test::mappedSheet(4, 2).sample,
                               ",\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}}],"
                               "\"textures\":[{\"source\":0}],\"images\":[{\"uri\":\"a.jpg\"}]"));
  const auto saidWith = [&](const std::string& option, int exit_code) {
    const Outcome ran = relievo("build --mesh " + file("a.glb") + " -o " + file("a.relievo") + " " + option);
    EXPECT_EQ(ran.exit_code, exit_code) << ran.output;
    return ran.output;
  };
  EXPECT_NE(saidWith("--max-image-mib 8", 4).find("takes 12 MiB decoded, expected at most 8 MiB"), std::string::npos);
  EXPECT_NE(saidWith("--max-packing 9", 3).find("a.jpg: expected at least 1398101 bytes"), std::string::npos);
  saidWith("", 0);
}

// Larger than the pages of all patches would be in any reasonable time.
TEST_F(ScanInputs, AnImageOf8192TexelsASideIsShownAsItIs) {
  if (test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  const auto jpeg = jpegFile(8192, 8192, std::vector<uint8_t>(size_t{3} * 8192 * 8192, 90), {});
  write("a.jpg", std::string(jpeg.begin(), jpeg.end()));
  write("a.glb", test::glbFile(test::mappedSheet(40, 2).sample,
                               ",\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}}],"
                               "\"textures\":[{\"source\":0}],\"images\":[{\"uri\":\"a.jpg\"}]"));
  built("a.glb");
  EXPECT_NE(said_.find("images    1 stored once and as they are; 1600 patches show them"), std::string::npos) << said_;
  EXPECT_EQ(packageVersion((*Package::open(file("a.relievo")))->header()), 19u);
  EXPECT_EQ(relievo("verify " + file("a.relievo")).exit_code, 0);
}

// A sheet of 120 x 60 mm in four strips: an image, another one, a colour, no material.
TEST_F(ScanInputs, AnObjShowsAllOfItsMaterialsImagesAndColours) {
  if (test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  const test::Sample s = test::sheet(12, 6, 10);
  std::array<std::string, 4> faces{"usemtl a\n", "usemtl b\n", "usemtl c\n", "usemtl none\n"};
  std::string obj = "mtllib some.mtl\n";
  for (const glm::dvec3& p : s.positions)
    obj += "v " + test::number(p.x) + " " + test::number(p.y) + " " + test::number(p.z) + "\nvt 0.5 0.5\n";
  for (const auto& t : s.triangles) {
    const double x = (s.positions[t[0]].x + s.positions[t[1]].x + s.positions[t[2]].x) / 3;
    std::string face = "f";
    for (const uint32_t v : t) face += " " + std::to_string(v + 1) + "/" + std::to_string(v + 1);
    faces[static_cast<size_t>(x / 30)] += face + "\n";
  }
  for (const std::string& of_material : faces) obj += of_material;
  write("some.obj", obj);
  write("some.mtl", "newmtl a\nmap_Kd a.ppm\nnewmtl b\nmap_Kd b.ppm\nnewmtl c\nKd 0.1 0.2 1\n");
  const auto image = [&](const std::string& name, int side, std::array<uint8_t, 3> c) {
    std::string bytes = "P6\n" + std::to_string(side) + " " + std::to_string(side) + "\n255\n";
    for (int i = 0; i < side * side; ++i) bytes.append(c.begin(), c.end());
    write(name, bytes);
  };
  image("a.ppm", 4, {250, 10, 10});
  image("b.ppm", 4, {10, 250, 10});
  // The mean colour of the exported vertices in the middle of each strip.
  using Colours = std::array<std::array<int, 3>, 4>;
  const auto strips = [&](const std::string& options = "") {
    const Json mesh = built("some.obj", options);
    EXPECT_EQ(relievo("export " + file("a.relievo") + " -o " + file("out.off") + " --level 4").exit_code, 0);
    std::ifstream in(file("out.off"));
    std::string line;
    Colours sums{};
    std::array<int, 4> count{};
    while (std::getline(in, line)) {
      double x = 0, y = 0, z = 0;
      std::array<int, 3> c{};
      if (std::sscanf(line.c_str(), "%lf %lf %lf %d %d %d", &x, &y, &z, &c[0], &c[1], &c[2]) != 6) continue;
      const auto strip = static_cast<size_t>(std::clamp(x / 30, 0.0, 3.0));
      if (std::abs(x - 30 * static_cast<double>(strip) - 15) > 10) continue;
      ++count[strip];
      for (size_t k = 0; k < 3; ++k) sums[strip][k] += c[k];
    }
    for (size_t i = 0; i < 4; ++i)
      for (int& channel : sums[i]) channel = (channel + count[i] / 2) / std::max(count[i], 1);
    return sums;
  };
  const auto expectColours = [&](const Colours& found, const Colours& expected) {
    for (size_t i = 0; i < 4; ++i)
      for (size_t c = 0; c < 3; ++c) EXPECT_NEAR(found[i][c], expected[i][c], 3) << "strip " << i << "\n" << said_;
  };
  const std::array<int, 3> red{250, 10, 10}, green{10, 250, 10}, blue{26, 51, 255}, grey{204, 204, 204};
  expectColours(strips(), {red, green, blue, grey});
  EXPECT_EQ(said_.find("warning"), std::string::npos) << said_;
  const std::string info = relievo("info " + file("a.relievo")).output;
  EXPECT_NE(info.find("source    a.ppm"), std::string::npos) << info;
  EXPECT_NE(info.find("source    b.ppm"), std::string::npos) << info;
  // One for all.
  image("c.ppm", 4, {90, 100, 110});
  const std::array<int, 3> other{90, 100, 110};
  expectColours(strips("--texture " + file("c.ppm")), {other, other, other, other});
  // Together more than the memory's third: all of them smaller.
  image("a.ppm", 3000, {250, 10, 10});
  image("b.ppm", 1000, {10, 250, 10});
  expectColours(strips("--memory-mib 84"), {red, green, blue, grey});
  EXPECT_NE(said_.find("its 2 images are read at 1/2 of their width and height"), std::string::npos) << said_;
  // One that is not there is told, and grey; without any there is an error.
  fs::remove(file("b.ppm"));
  expectColours(strips(), {red, grey, blue, grey});
  EXPECT_NE(said_.find("b.ppm: not found; what shows it is grey"), std::string::npos) << said_;
  fs::remove(file("a.ppm"));
  const Outcome r = relievo("build --mesh " + file("some.obj") + " -o " + file("b.relievo"));
  EXPECT_EQ(r.exit_code, 2) << r.output;
  EXPECT_NE(r.output.find("--texture none"), std::string::npos) << r.output;
  EXPECT_FALSE(fs::exists(file("b.relievo")));
}

// A material's factor multiplies its image in linear light.
TEST_F(ScanInputs, AGltfsFactorMultipliesItsImage) {
  if (test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  test::Sample s = test::sheet(4, 4, 0.01);
  s.corner_uv.assign(s.triangles.size(), {glm::vec2(0.5f), glm::vec2(0.5f), glm::vec2(0.5f)});
  const std::string picture = std::string("P6\n1 1\n255\n") + "\xff\xc8\x64";
  write("a.gltf", test::gltfFile(s,
                                 ",\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.5,1,0,1],"
                                 "\"baseColorTexture\":{\"index\":0}}}],\"textures\":[{\"source\":0}],\"images\":[{"
                                 "\"uri\":\"data:image/x-portable-pixmap;base64," +
                                     test::base64(picture) + "\"}]"));
  built("a.gltf");
  EXPECT_EQ(relievo("export " + file("a.relievo") + " -o " + file("out.off") + " --level 2").exit_code, 0);
  std::ifstream in(file("out.off"));
  std::string line;
  int vertices = 0;
  while (std::getline(in, line)) {
    double x = 0, y = 0, z = 0;
    int r = 0, g = 0, b = 0;
    if (std::sscanf(line.c_str(), "%lf %lf %lf %d %d %d", &x, &y, &z, &r, &g, &b) != 6) continue;
    ++vertices;
    EXPECT_NEAR(r, 188, 1);  // sRGB of 0.5
    EXPECT_NEAR(g, 200, 1);
    EXPECT_EQ(b, 0);
  }
  EXPECT_GT(vertices, 9);
}

// How far normals of a package are from those of the surface that a sheet's map was made from, in degrees, in the mean:
// of root pages, or of the tail where a patch has none.
double degreesOff(const std::string& path, const test::MappedSheet& sheet) {
  auto package = *Package::open(path);
  const BaseMesh& base = *package->manifest().base;
  const PatchTails tails = package->wholeTails(1, nullptr);
  double sum = 0;
  int count = 0;
  std::vector<uint8_t> texels(kTexturePageBytes);
  PageDecoder decoder;
  for (uint32_t p = 0; p < base.patches.size(); p += 3) {
    const auto page = package->read(PageId(texturePlane(1), {p, 0, 0, 0}));
    EXPECT_EQ(page.ok(), package->manifest().domain.textureDepthOf(p) >= 0);
    if (page) {
      EXPECT_TRUE(decoder.decodeTexture(page->bytes, texels).ok());
    }
    const size_t side = page ? kPagePx : kTailTexels;
    const auto texelAt = [&](int c, size_t x, size_t y) {
      if (!page) return tails.level(p, 0, c + 3)[y * side + x];
      return texels[(static_cast<size_t>(c) * kPageFullPx + y + kPageBorderPx) * kPageFullPx + x + kPageBorderPx];
    };
    for (size_t y = 0; y < side; y += side / 16)
      for (size_t x = 0; x < side; x += side / 16) {
        const glm::dvec2 uv = (glm::dvec2(x, y) + 0.5) / static_cast<double>(side);
        const glm::dvec3 at = (base.origin_mm + base.point(p, uv.x, uv.y)) / 1000.0;
        glm::dvec3 n;
        for (int c = 0; c < 3; ++c) n[c] = texelAt(c, x, y) / 127.5 - 1;
        const double cosine = glm::dot(glm::normalize(n), sheet.trueNormal(at.x, at.y));
        sum += glm::degrees(std::acos(std::clamp(cosine, -1.0, 1.0)));
        ++count;
      }
  }
  return sum / count;
}
std::string mappedMaterial(const std::string& image, const std::string& more = "") {
  return ",\"materials\":[{" + more + "\"normalTexture\":{\"index\":0}}],\"textures\":[{\"source\":0}],\"images\":[{" +
         "\"uri\":\"" + image + "\"}]";
}

TEST_F(ScanInputs, AMapOfNormalsIsShown) {
  if (test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  test::MappedSheet sheet = test::mappedSheet(10, 512);
  write("n.ppm", sheet.ppm());
  write("a.glb", test::glbFile(sheet.sample, mappedMaterial("n.ppm")));
  built("a.glb");
  EXPECT_NE(said_.find("normals   of 1 map are used"), std::string::npos) << said_;
  EXPECT_EQ(said_.find("warning"), std::string::npos) << said_;
  EXPECT_LT(degreesOff(file("a.relievo"), sheet), 2);
  EXPECT_EQ((*Package::open(file("a.relievo")))->shownImages().normal_maps, 1u);
  const std::string info = relievo("info " + file("a.relievo")).output;
  EXPECT_NE(info.find("1 and 1 map of normals that"), std::string::npos) << info;
  EXPECT_NE(info.find("source    n.ppm"), std::string::npos) << info;
  EXPECT_EQ(relievo("verify " + file("a.relievo")).exit_code, 0);
  // What is written with maps shows the same once it is read again.
  EXPECT_EQ(relievo("export " + file("a.relievo") + " -o " + file("again.glb") + " --maps 1024").exit_code, 0);
  built("again.glb");
  EXPECT_LT(degreesOff(file("a.relievo"), sheet), 3);
  // Patches that have texels of their own have them in these; with y downwards as the file's tangents say.
  sheet = test::mappedSheet(10, 512, true);
  write("n.ppm", sheet.ppm());
  built("a.glb");
  EXPECT_GT(degreesOff(file("a.relievo"), sheet), 8) << "control: nothing says that y counts downwards";
  sheet.sample.tangents.assign(sheet.sample.positions.size(), {1, 0, 0, -1});
  write("a.glb", test::glbFile(sheet.sample, mappedMaterial("n.ppm")));
  built("a.glb");
  EXPECT_LT(degreesOff(file("a.relievo"), sheet), 2);
  built("a.glb", "--texture-tolerance 0 --encoding jpeg");
  EXPECT_EQ((*Package::open(file("a.relievo")))->shownImages().normal_maps, 0u);
  EXPECT_LT(degreesOff(file("a.relievo"), sheet), 4);
  EXPECT_GT(degreesOff((built("a.glb", "--texture none"), file("a.relievo")), sheet), 8) << "control: without it";
}

TEST_F(ScanInputs, AMapOfNormalsThatCannotBeUsedIsLeftOut) {
  if (test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  const test::MappedSheet sheet = test::mappedSheet(6, 64);
  const auto said = [&](const std::string& image) {
    write("a.glb", test::glbFile(sheet.sample, mappedMaterial(image)));
    built("a.glb");
    EXPECT_EQ(said_.find("normals   of"), std::string::npos) << said_;
    const size_t at = said_.find("warning: ");
    return at == std::string::npos ? "" : said_.substr(at, said_.find('\n', at) - at);
  };
  EXPECT_NE(said("none.png").find("none.png: opening failed"), std::string::npos) << said_;
  // Normals that a map would count from go with it: these lean by 37 degrees.
  test::MappedSheet leaning = sheet;
  leaning.fine = 0;
  std::fill(leaning.sample.normals.begin(), leaning.sample.normals.end(), glm::vec3(0.6f, 0, 0.8f));
  write("b.glb", test::glbFile(leaning.sample, mappedMaterial("none.png")));
  built("b.glb");
  EXPECT_LT(degreesOff(file("a.relievo"), leaning), 8);
  fs::create_directory(file("inner"));
  EXPECT_NE(said("../n.ppm").find("lies outside its folder; its normals are not used"), std::string::npos) << said_;
  // Those of another kind: all of them in the object's space, which may point anywhere.
  std::string ppm = "P6\n64 64\n255\n";
  for (int i = 0; i < 3 * 64 * 64; ++i) ppm += static_cast<char>(i % 3 == 2 ? (i / 3 % 8 ? 200 : 30) : 128);
  write("o.ppm", ppm);
  EXPECT_NE(said("o.ppm").find("o.ppm: expected normals in tangent space, found some that point into the surface"),
            std::string::npos)
      << said_;
  // Of an OBJ: a map of heights, in place of one of normals.
  std::string obj = "mtllib a.mtl\nusemtl a\n";
  for (const glm::dvec3& p : sheet.sample.positions)
    obj += "v " + test::number(p.x) + " " + test::number(p.y) + " " + test::number(p.z) + "\nvt " +
           test::number(10 * p.x) + " " + test::number(10 * p.y) + "\n";
  for (const auto& t : sheet.sample.triangles) {
    obj += "f";
    for (const uint32_t v : t) obj += " " + std::to_string(v + 1) + "/" + std::to_string(v + 1);
    obj += "\n";
  }
  write("a.obj", obj);
  write("a.mtl", "newmtl a\nmap_Bump b.ppm\n");
  write("b.ppm", "P6\n2 1\n255\n" + std::string("\x80\x80\x80\x20\x20\x20", 6));
  built("a.obj");
  EXPECT_NE(
      said_.find("b.ppm: expected normals in tangent space, found a map of another kind; its normals are not used"),
      std::string::npos)
      << said_;
  write("b.ppm", sheet.ppm());
  built("a.obj");
  EXPECT_NE(said_.find("normals   of 1 map are used"), std::string::npos) << said_;
}

// A package has room for so many texels of images: a map of more is halved, where its colours are not.
TEST_F(ScanInputs, AMapOfNormalsOfTooManyTexelsIsMadeSmaller) {
  if (test::kSanitized) GTEST_SKIP() << "about figures; others build scans under the sanitizer";
  constexpr int kSide = 9216;
  std::vector<uint8_t> texels(size_t{3} * kSide * kSide, 128);
  for (size_t i = 2; i < texels.size(); i += 3) texels[i] = 255;
  const auto plain = jpegFile(4096, 4096, std::vector<uint8_t>(size_t{3} * 4096 * 4096, 90), {});
  const auto jpeg = jpegFile(kSide, kSide, std::move(texels), {});
  write("n.jpg", std::string(jpeg.begin(), jpeg.end()));
  write("a.glb", test::glbFile(test::mappedSheet(40, 2).sample, mappedMaterial("n.jpg")));
  built("a.glb");
  EXPECT_NE(said_.find("its maps of normals are made smaller; images may have 80 Mi texels together"),
            std::string::npos)
      << said_;
  EXPECT_NE(said_.find("normals   of 1 map are used"), std::string::npos) << said_;
  // Where memory is short, too, before colours are.
  write("c.jpg", std::string(plain.begin(), plain.end()));
  write("a.glb",
        test::glbFile(test::mappedSheet(40, 2).sample,
                      ",\"materials\":[{\"normalTexture\":{\"index\":0},\"pbrMetallicRoughness\":{\"baseColorTexture\":"
                      "{\"index\":1}}}],\"textures\":[{\"source\":0},{\"source\":1}],\"images\":[{\"uri\":\"n.jpg\"},"
                      "{\"uri\":\"c.jpg\"}]"));
  built("a.glb");
  EXPECT_NE(said_.find("its maps of normals are made smaller"), std::string::npos) << said_;
  EXPECT_EQ(said_.find("are read at 1/"), std::string::npos) << said_;
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
