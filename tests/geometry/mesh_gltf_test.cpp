// glTF 2.0 as a scan's file: what comes out is compared with meshes written here from the format's description, and
// what no reader of this project takes is refused by name.
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <map>
#include <set>

#include "geometry/scan/mesh_read.h"
#include "tests/geometry/mesh_files.h"
#include "tests/geometry/must_read.h"

namespace relievo::test {
namespace mesh_gltf_test {

std::string refusal(const std::string& path, ErrorKind kind) {
  auto read = readMesh(path);
  EXPECT_FALSE(read.ok()) << path;
  if (read) return "";
  EXPECT_EQ(read.error().kind, kind) << read.error().text();
  return read.error().text();
}
const MeshFinding* finding(const LoadedMesh& m, const std::string& what) {
  for (const MeshFinding& f : m.diagnosis.findings)
    if (f.what.find(what) != std::string::npos) return &f;
  return nullptr;
}
std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const size_t at = text.find(from);
  EXPECT_NE(at, text.npos) << from;
  return at == text.npos ? text : text.replace(at, from.size(), to);
}
glm::dvec3 place(const LoadedMesh& m, size_t i) { return m.mesh.origin_mm + glm::dvec3(m.mesh.positions_mm[i]); }
// The largest distance between the triangles' corners and where they are to be; a triangle may begin at any corner.
double farthest(const LoadedMesh& m, const Sample& s, const std::function<glm::dvec3(glm::dvec3)>& moved) {
  EXPECT_EQ(m.mesh.triangles.size(), s.triangles.size());
  EXPECT_EQ(m.mesh.positions_mm.size(), s.positions.size());
  double worst = 0;
  for (size_t t = 0; t < std::min(s.triangles.size(), m.mesh.triangles.size()); ++t) {
    double best = 1e300;
    for (size_t turn = 0; turn < 3; ++turn) {
      double far = 0;
      for (size_t k = 0; k < 3; ++k)
        far = std::max(
            far, glm::length(place(m, m.mesh.triangles[t][(k + turn) % 3]) - moved(s.positions[s.triangles[t][k]])));
      best = std::min(best, far);
    }
    worst = std::max(worst, best);
  }
  return worst;
}
// Linear light to sRGB, by the standard's own formula.
int encoded(double linear) {
  return static_cast<int>(
      std::floor(255 * (linear <= 0.0031308 ? 12.92 * linear : 1.055 * std::pow(linear, 1 / 2.4) - 0.055) + 0.5));
}

TEST(MeshGltf, PositionsAreMetresWhetherInAGlbADataUriOrAFileBeside) {
  const Sample s = scanOfCubeSphere(4, 0.25);
  const auto mm = [](glm::dvec3 p) { return 1000.0 * p; };
  const LoadedMesh glb = mustRead(saveFile("a.glb", glbFile(s)));
  EXPECT_LT(farthest(glb, s, mm), 1e-4);
  EXPECT_EQ(glb.unit, "m");
  EXPECT_EQ(glb.mm_per_unit, 1000);
  EXPECT_LT(farthest(mustRead(saveFile("a.gltf", gltfFile(s))), s, mm), 1e-4);
  const GltfText text = gltfOf(s, "numbers%20of%20a.bin");
  saveFile("numbers of a.bin", text.binary);
  const LoadedMesh beside = mustRead(saveFile("b.gltf", text.json));
  EXPECT_LT(farthest(beside, s, mm), 1e-4);
  EXPECT_EQ(beside.named_files, std::vector<std::string>{(meshFolder() / "numbers of a.bin").string()});
  // Whoever knows better says so. The name alone does not decide between the two containers.
  EXPECT_LT(
      farthest(mustRead(saveFile("c.gltf", glbFile(s)), {.mm_per_unit = 10}), s, [](glm::dvec3 p) { return 10.0 * p; }),
      1e-6);
  EXPECT_GT(farthest(glb, s, [](glm::dvec3 p) { return p; }), 100) << "control";
}

TEST(MeshGltf, NodesPlaceMeshesAndMirrorsTurnTheirTriangles) {
  const Sample s = scanOfCubeSphere(3, 0.25);
  const MeshReadOptions metres{.mm_per_unit = 1};
  // A quarter turn about z, twice as large, moved; by parts and as a matrix.
  const auto moved = [](glm::dvec3 p) { return glm::dvec3(5 - 2 * p.y, 6 + 2 * p.x, 7 + 2 * p.z); };
  const std::string parts =
      "\"mesh\":0,\"translation\":[5,6,7],\"scale\":[2,2,2],\"rotation\":[0,0,0.70710678118654752,0.70710678118654752]";
  const LoadedMesh by_parts = mustRead(saveFile("a.glb", glbFile(s, "", parts)), metres);
  EXPECT_LT(farthest(by_parts, s, moved), 1e-6);
  EXPECT_GT(signedVolume(by_parts.mesh), 0);
  const std::string matrix = "\"mesh\":0,\"matrix\":[0,2,0,0,-2,0,0,0,0,0,2,0,5,6,7,1]";
  EXPECT_LT(farthest(mustRead(saveFile("a.glb", glbFile(s, "", matrix)), metres), s, moved), 1e-6);
  // Parents move their children; a node may be read once only.
  const std::string tree = "\"translation\":[1,0,0],\"children\":[1]},{\"mesh\":0,\"scale\":[3,1,1]";
  EXPECT_LT(farthest(mustRead(saveFile("a.glb", glbFile(s, "", tree)), metres), s,
                     [](glm::dvec3 p) { return glm::dvec3(1 + 3 * p.x, p.y, p.z); }),
            1e-6);
  for (const char* twice : {"\"children\":[1,1]},{\"mesh\":0", "\"children\":[1]},{\"mesh\":0,\"children\":[0]"})
    EXPECT_NE(refusal(saveFile("a.glb", glbFile(s, "", twice)), ErrorKind::kInvalidData).find("to have one parent"),
              std::string::npos);
  // An open sheet that is mirrored shows its other side unless its triangles turn; nothing repairs an open one.
  const Sample open = sheet(3, 2);
  const LoadedMesh mirrored = mustRead(saveFile("a.glb", glbFile(open, "", "\"mesh\":0,\"scale\":[-1,1,1]")), metres);
  ASSERT_EQ(mirrored.mesh.triangles.size(), open.triangles.size());
  for (const auto& t : mirrored.mesh.triangles)
    EXPECT_GT(
        glm::cross(place(mirrored, t[1]) - place(mirrored, t[0]), place(mirrored, t[2]) - place(mirrored, t[0])).z, 0);
}

TEST(MeshGltf, SeveralMeshesPrimitivesAndInstancesBecomeOneScan) {
  const Sample s = scanOfCubeSphere(3, 0.25);
  const std::string two = "\"children\":[1,2]},{\"mesh\":0},{\"mesh\":0,\"translation\":[2,0,0]";
  const LoadedMesh m = mustRead(saveFile("a.glb", glbFile(s, "", two)));
  EXPECT_EQ(m.diagnosis.pieces, 2u);
  EXPECT_EQ(m.mesh.triangles.size(), 2 * s.triangles.size());
  // A thousand nodes of the same mesh are more than the file may ask for.
  std::string many = "\"children\":[1";
  std::string nodes;
  for (int i = 1; i <= 1000; ++i) {
    if (i > 1) many += "," + std::to_string(i);
    nodes += "},{\"mesh\":0,\"translation\":[" + std::to_string(i) + ",0,0]";
  }
  EXPECT_NE(refusal(saveFile("a.glb", glbFile(s, "", many + "]" + nodes)), ErrorKind::kUnsupported)
                .find("repeat meshes into more than"),
            std::string::npos);
  // Two primitives with the same vertices; points are left out, and said to be.
  std::string text = gltfFile(s);
  const size_t begin = text.find("{\"attributes\""), end = text.find("}]}],\"bufferViews\"") + 1;
  const std::string primitive = text.substr(begin, end - begin);
  text.replace(begin, end - begin, primitive + "," + primitive + ",{\"attributes\":{\"POSITION\":0},\"mode\":0}");
  const LoadedMesh twice = mustRead(saveFile("a.gltf", text));
  EXPECT_EQ(twice.diagnosis.vertices_read, s.positions.size());
  EXPECT_EQ(twice.diagnosis.triangles_read, 2 * s.triangles.size());
  EXPECT_TRUE(finding(twice, "points or lines"));
}

// Six vertices of a strip, as a strip, as a fan, as triangles without indices; indices of all sizes.
TEST(MeshGltf, StripsFansAndIndicesOfEverySize) {
  std::string positions;
  for (int i = 0; i < 6; ++i)
    for (const float c : {static_cast<float>(i / 2), static_cast<float>(1 - i % 2), i == 5 ? 0.5f : 0.0f})
      put(positions, c);
  const auto file = [&](int mode, int component, const std::vector<uint32_t>& indices) {
    std::string bytes = positions;
    for (const uint32_t i : indices)
      component == 5121   ? put(bytes, static_cast<uint8_t>(i))
      : component == 5123 ? put(bytes, static_cast<uint16_t>(i))
                          : put(bytes, i);
    const std::string json =
        "{\"asset\":{\"version\":\"2.0\"},\"nodes\":[{\"mesh\":0}],\"meshes\":[{\"primitives\":[{\"attributes\":{"
        "\"POSITION\":0},\"mode\":" +
        std::to_string(mode) + (indices.empty() ? "" : ",\"indices\":1") +
        "}]}],\"buffers\":[{\"byteLength\":" + std::to_string(bytes.size()) +
        "}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":72},{\"buffer\":0,\"byteOffset\":72,\"byteLength\":" +
        std::to_string(bytes.size() - 72) +
        "}],\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":6,\"type\":\"VEC3\"},{\"bufferView\":1,"
        "\"componentType\":" +
        std::to_string(component) + ",\"count\":" + std::to_string(indices.size()) + ",\"type\":\"SCALAR\"}]}";
    return saveFile("modes.glb", glbOf(json, bytes));
  };
  const auto shape = [&](const std::string& path) {
    const LoadedMesh m = mustRead(path, {.mm_per_unit = 1});
    std::set<std::set<int>> out;
    for (const auto& t : m.mesh.triangles) {
      std::set<int> corners;
      for (const uint32_t v : t) {
        const glm::dvec3 p = place(m, v);
        corners.insert(static_cast<int>(std::lround(2 * p.x + 1 - p.y)));
      }
      out.insert(corners);
      EXPECT_GT(glm::cross(place(m, t[1]) - place(m, t[0]), place(m, t[2]) - place(m, t[0])).z, 0);
    }
    return out;
  };
  using Shape = std::set<std::set<int>>;
  const Shape strip{{0, 1, 2}, {1, 2, 3}, {2, 3, 4}, {3, 4, 5}};
  EXPECT_EQ(shape(file(5, 5125, {})), strip);
  for (const int component : {5121, 5123, 5125}) {
    EXPECT_EQ(shape(file(5, component, {0, 1, 2, 3, 4, 5})), strip);
    EXPECT_EQ(shape(file(4, component, {0, 1, 2, 2, 1, 3})), (Shape{{0, 1, 2}, {1, 2, 3}}));
    EXPECT_EQ(shape(file(6, component, {1, 3, 2, 0})), (Shape{{1, 2, 3}, {0, 1, 2}}));
    EXPECT_NE(refusal(file(4, component, {0, 1, 6}), ErrorKind::kInvalidData).find("names vertex 6, there are 6"),
              std::string::npos);
  }
  EXPECT_EQ(shape(file(5, 5121, {0, 1, 2, 2, 2, 3})), (Shape{{0, 1, 2}})) << "stitches have no area";
  EXPECT_NE(refusal(file(4, 5121, {0, 1, 2, 3}), ErrorKind::kInvalidData).find("three corners a triangle"),
            std::string::npos);
}

TEST(MeshGltf, QuantizedPositionsAreReadWithAndWithoutNormalizing) {
  std::string bytes;
  for (const int v : {0, 0, 32767, 32767, 0, 0, 0, -32768, 0, 0}) put(bytes, static_cast<int16_t>(v));
  const auto file = [&](bool normalized) {
    return saveFile(
        "quantized.glb",
        glbOf(std::string("{\"asset\":{\"version\":\"2.0\"},\"extensionsRequired\":[\"KHR_mesh_quantization\"],"
                          "\"nodes\":[{\"mesh\":0}],\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}],"
                          "\"buffers\":[{\"byteLength\":20}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":20,"
                          "\"byteStride\":6}],\"accessors\":[{\"bufferView\":0,\"componentType\":5122,\"count\":3,"
                          "\"type\":\"VEC3\",\"normalized\":") +
                  (normalized ? "true" : "false") + "}]}",
              bytes));
  };
  EXPECT_NEAR(mustRead(file(true), {.mm_per_unit = 1}).diagnosis.max_mm.x, 1, 1e-6);
  EXPECT_NEAR(mustRead(file(true), {.mm_per_unit = 1}).diagnosis.min_mm.y, -1, 1e-6);
  EXPECT_NEAR(mustRead(file(false), {.mm_per_unit = 1}).diagnosis.max_mm.x, 32767, 1e-2);
  EXPECT_NEAR(mustRead(file(true), {.mm_per_unit = 1}).diagnosis.max_mm.z, 1, 1e-6);
}

// Elements among others: the last one need not be followed by the rest of its stride, but must be there itself.
TEST(MeshGltf, InterleavedElementsEndWithTheLastOne) {
  const auto file = [](int view_bytes, int offset) {
    std::string bytes;
    for (int i = 0; i < 3; ++i)
      for (const float c : {9.0f, i == 1 ? 1.0f : 0.0f, i == 2 ? 1.0f : 0.0f, 0.0f, 7.0f}) put(bytes, c);
    return saveFile(
        "interleaved.glb",
        glbOf("{\"asset\":{\"version\":\"2.0\"},\"nodes\":[{\"mesh\":0}],\"meshes\":[{\"primitives\":[{"
              "\"attributes\":{\"POSITION\":0}}]}],\"buffers\":[{\"byteLength\":60}],\"bufferViews\":[{\"buffer\":0,"
              "\"byteLength\":" +
                  std::to_string(view_bytes) + ",\"byteStride\":20}],\"accessors\":[{\"bufferView\":0,\"byteOffset\":" +
                  std::to_string(offset) + ",\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"}]}",
              bytes));
  };
  const LoadedMesh m = mustRead(file(56, 4), {.mm_per_unit = 1});
  EXPECT_EQ(m.diagnosis.max_mm, glm::dvec3(1, 1, 0));
  for (const auto& [bytes, offset] : {std::pair{55, 4}, {56, 8}, {64, 4}, {56, 60}})
    EXPECT_NE(refusal(file(bytes, offset), ErrorKind::kInvalidData).find("within its part of the buffer"),
              std::string::npos);
}

TEST(MeshGltf, ColoursAreLinearLightTimesTheMaterials) {
  Sample s = scanOfCubeSphere(3, 0.25);
  decorate(s, 5);
  s.corner_uv.clear();
  const std::string tint = ",\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.5,1,0.25,1]}}]";
  for (const bool tinted : {false, true}) {
    const LoadedMesh m = mustRead(saveFile("a.glb", glbFile(s, tinted ? tint : "")));
    ASSERT_EQ(m.mesh.colours.size(), s.colours.size());
    const glm::dvec3 by = tinted ? glm::dvec3(0.5, 1, 0.25) : glm::dvec3(1);
    int off = 0;
    for (size_t i = 0; i < s.colours.size(); ++i)
      for (int c = 0; c < 3; ++c) off += m.mesh.colours[i][c] != encoded(by[c] * s.colours[i][c] / 255.0);
    EXPECT_EQ(off, 0) << tinted;
  }
  // Without colours of vertices a material's colour is the surface's.
  s.colours.clear();
  const LoadedMesh plain = mustRead(saveFile("a.glb", glbFile(s, tint)));
  EXPECT_EQ(paletteOf(plain.mesh),
            (std::vector<glm::u8vec3>{{static_cast<uint8_t>(encoded(0.5)), 255, static_cast<uint8_t>(encoded(0.25))}}));
}

TEST(MeshGltf, TheBaseColourImageIsNamedOrInTheFile) {
  Sample s = sheet(3, 2, 0.1);
  decorate(s, 5);
  s.colours.clear();
  const std::string material =
      ",\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}}],\"textures\":[{\"source\":0";
  const auto with = [&](const std::string& image, const std::string& sampler = "") {
    return material + sampler + "}],\"images\":[{" + image + "}]";
  };
  const LoadedMesh named = mustRead(saveFile("a.glb", glbFile(s, with("\"uri\":\"a%20skin.png\""))));
  EXPECT_EQ(imagePath(named.mesh), (meshFolder() / "a skin.png").string());
  EXPECT_EQ(named.named_files, std::vector<std::string>{imagePath(named.mesh)});
  EXPECT_TRUE(named.mesh.images[0].repeats);
  EXPECT_FALSE(named.mesh.images[0].file.bytes);
  std::vector<glm::vec2> of(s.positions.size());
  for (size_t t = s.triangles.size(); t-- > 0;)
    for (size_t k = 0; k < 3; ++k) of[s.triangles[t][k]] = s.corner_uv[t][k];
  ASSERT_EQ(named.mesh.corner_uv.size(), s.triangles.size());
  for (size_t t = 0; t < s.triangles.size(); ++t)
    for (size_t k = 0; k < 3; ++k) EXPECT_EQ(named.mesh.corner_uv[t][k], of[named.mesh.triangles[t][k]]);
  const LoadedMesh inside = mustRead(saveFile(
      "a.glb", glbFile(s, with("\"uri\":\"data:image/png;base64," + base64("a picture") + "\"", ",\"sampler\":0") +
                              ",\"samplers\":[{\"wrapS\":33071,\"wrapT\":33071}]")));
  ASSERT_EQ(inside.mesh.images.size(), 1u);
  ASSERT_TRUE(inside.mesh.images[0].file.bytes);
  const std::vector<uint8_t>& bytes = *inside.mesh.images[0].file.bytes;
  EXPECT_EQ(std::string(bytes.begin(), bytes.end()), "a picture");
  EXPECT_TRUE(imagePath(inside.mesh).empty());
  EXPECT_FALSE(inside.mesh.images[0].repeats);
  const LoadedMesh view = mustRead(saveFile("a.glb", glbFile(s, with("\"bufferView\":1,\"mimeType\":\"image/png\""))));
  ASSERT_TRUE(view.mesh.images.size() == 1 && view.mesh.images[0].file.bytes);
  EXPECT_EQ(view.mesh.images[0].file.bytes->size(), 12 * s.triangles.size()) << "the indices' bytes";
  // KHR_texture_transform, by its own example: scale, then turn, then move.
  const std::string turned = replaced(with("\"uri\":\"a.png\""), "{\"index\":0}",
                                      "{\"index\":0,\"extensions\":{\"KHR_texture_transform\":{\"offset\":[0,1],"
                                      "\"rotation\":1.5707963267948966,\"scale\":[0.5,0.5]}}}");
  const LoadedMesh moved = mustRead(saveFile("a.glb", glbFile(s, turned)));
  for (size_t t = 0; t < s.triangles.size(); ++t)
    for (size_t k = 0; k < 3; ++k) {
      const glm::vec2 from = of[moved.mesh.triangles[t][k]], to = moved.mesh.corner_uv[t][k];
      // From the upper left: (u, v) -> (v / 2, 1 - u / 2).
      EXPECT_NEAR(to.x, (1 - from.y) / 2, 1e-6);
      EXPECT_NEAR(1 - to.y, 1 - from.x / 2, 1e-6);
    }
}

// Where a material has the diffuse colour of specular and gloss, that is its base colour; a WebP image has a place of
// its own.
TEST(MeshGltf, ColoursMayStandInExtensions) {
  Sample s = sheet(3, 2, 0.1);
  decorate(s, 5);
  s.colours.clear();
  const std::string gloss =
      "\"extensions\":{\"KHR_materials_pbrSpecularGlossiness\":{\"diffuseFactor\":[0.25,1,1,1],\"diffuseTexture\":{"
      "\"index\":1}}},\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}";
  const std::string tail =
      "],\"textures\":[{\"source\":0},{\"extensions\":{\"EXT_texture_webp\":{\"source\":1}}}],\"images\":[{\"uri\":"
      "\"a.png\"},{\"uri\":\"b.webp\"}]";
  const auto file = [&](const std::string& material, const char* required) {
    return saveFile("a.gltf", replaced(gltfFile(s, ",\"materials\":[{" + material + "}" + tail), "{\"asset\"",
                                       std::string("{\"extensionsRequired\":[\"") + required + "\"],\"asset\""));
  };
  const LoadedMesh m = mustRead(file(gloss, "KHR_materials_pbrSpecularGlossiness"));
  ASSERT_EQ(m.mesh.images.size(), 1u);
  EXPECT_EQ(imagePath(m.mesh), (meshFolder() / "b.webp").string());
  EXPECT_EQ(m.mesh.images[0].tint, glm::vec3(0.25f, 1, 1));
  const LoadedMesh plain = mustRead(file(gloss.substr(gloss.find("\"pbrMetallic")), "EXT_texture_webp"));
  EXPECT_EQ(imagePath(plain.mesh), (meshFolder() / "a.png").string());
  EXPECT_EQ(plain.mesh.images.at(0).tint, glm::vec3(1));
}

TEST(MeshGltf, TrianglesShowTheirMaterialsImagesAndColours) {
  Sample s = sheet(3, 2, 0.1);
  decorate(s, 5);
  s.colours.clear();
  // Two triangles without texture coordinates, four of the first image, all of the second.
  std::string text = gltfFile(s,
                              ",\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}},{"
                              "\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.5,1,1,1],\"baseColorTexture\":{"
                              "\"index\":1}}}],\"textures\":[{\"source\":0},{\"source\":1}],\"images\":[{\"uri\":"
                              "\"a.png\"},{\"uri\":\"b.png\"}]");
  const size_t begin = text.find("{\"attributes\""), end = text.find("}]}],\"bufferViews\"") + 1;
  const std::string primitive = text.substr(begin, end - begin);
  const auto accessor = [&](int count) {
    return "{\"bufferView\":1,\"componentType\":5125,\"count\":" + std::to_string(count) + ",\"type\":\"SCALAR\"},";
  };
  const std::string plain = "{\"attributes\":{\"POSITION\":2},\"indices\":0}";
  std::string first = replaced(primitive, "\"indices\":1", "\"indices\":1"), second = primitive;
  for (std::string* p : {&first, &second}) {
    *p = replaced(*p, "\"POSITION\":0", "\"POSITION\":2");
    *p = replaced(*p, "\"TEXCOORD_0\":2", "\"TEXCOORD_0\":4");
  }
  second = replaced(replaced(second, "\"indices\":1", "\"indices\":3"), "\"material\":0", "\"material\":1");
  text.replace(begin, end - begin, plain + "," + first + "," + second);
  text = replaced(text, "\"accessors\":[", "\"accessors\":[" + accessor(6) + accessor(12));
  const LoadedMesh m = mustRead(saveFile("a.gltf", text));
  // Of the triangles that are there twice the first ones stay: two without coordinates, which have their material's
  // white, two of a.png, the rest of b.png, whose material multiplies it.
  ASSERT_EQ(m.mesh.images.size(), 3u);
  EXPECT_EQ(imagePath(m.mesh, 0), (meshFolder() / "b.png").string());
  EXPECT_EQ(imagePath(m.mesh, 1), (meshFolder() / "a.png").string());
  EXPECT_EQ(m.mesh.images[0].tint, glm::vec3(0.5f, 1, 1));
  EXPECT_EQ(m.mesh.images[1].tint, glm::vec3(1));
  EXPECT_EQ(paletteOf(m.mesh), (std::vector<glm::u8vec3>{glm::u8vec3(255)}));
  EXPECT_EQ(m.named_files.size(), 2u);
  std::array<size_t, 3> shown{};
  ASSERT_EQ(m.mesh.image_of.size(), m.mesh.triangles.size());
  for (const uint16_t image : m.mesh.image_of) ++shown.at(image);
  EXPECT_EQ(shown, (std::array<size_t, 3>{s.triangles.size() - 4, 2, 2}));
  EXPECT_FALSE(finding(m, "image")) << "nothing is lost";
  // Every triangle's coordinates are those of its own vertices, but for the two that had none.
  std::map<std::array<int, 2>, glm::vec2> of;
  for (size_t t = s.triangles.size(); t-- > 0;)
    for (size_t k = 0; k < 3; ++k) {
      const glm::dvec3 p = s.positions[s.triangles[t][k]];
      of[{static_cast<int>(std::lround(10 * p.x)), static_cast<int>(std::lround(10 * p.y))}] = s.corner_uv[t][k];
    }
  int none = 0, own = 0;
  for (size_t t = 0; t < m.mesh.triangles.size(); ++t)
    for (size_t k = 0; k < 3; ++k) {
      const glm::dvec3 p = place(m, m.mesh.triangles[t][k]) / 100.0;
      const glm::vec2 expected = of[{static_cast<int>(std::lround(p.x)), static_cast<int>(std::lround(p.y))}];
      own += glm::length(m.mesh.corner_uv[t][k] - expected) < 1e-6f;
      none += m.mesh.image_of[t] == 2 && m.mesh.corner_uv[t][k] == glm::vec2(0.5f);
    }
  EXPECT_EQ(own + none, static_cast<int>(3 * m.mesh.triangles.size()));
  EXPECT_GT(own, none);
  // The second image's own transform is not the first one's.
  const LoadedMesh moved = mustRead(saveFile(
      "a.gltf",
      replaced(text, "{\"index\":1}", "{\"index\":1,\"extensions\":{\"KHR_texture_transform\":{\"offset\":[10,0]}}}")));
  int beyond = 0;
  for (const auto& uv : moved.mesh.corner_uv) beyond += uv[0].x >= 10;
  // Of the repeated triangles the first ones stay.
  EXPECT_EQ(beyond, static_cast<int>(s.triangles.size()) - 4);
}

TEST(MeshGltf, TheSceneThatIsNamedIsShownOrAllRootsWithoutOne) {
  const Sample s = scanOfCubeSphere(2, 0.25);
  const std::string nodes = "\"children\":[1]},{\"mesh\":0},{\"mesh\":0,\"scale\":[2,2,2]";
  const std::string text = gltfFile(s, "", nodes), scenes = "\"scene\":0,\"scenes\":[{\"nodes\":[0]}]";
  const auto width = [&](const std::string& instead) {
    const LoadedMesh m = mustRead(saveFile("a.gltf", replaced(text, scenes, instead)));
    return m.diagnosis.max_mm.x - m.diagnosis.min_mm.x;
  };
  const double one = width(scenes);
  EXPECT_NEAR(width("\"scene\":1,\"scenes\":[{\"nodes\":[0]},{\"nodes\":[2]}]"), 2 * one, 1e-3);
  EXPECT_NEAR(width("\"scenes\":[{\"nodes\":[2]},{\"nodes\":[0]}]"), 2 * one, 1e-3) << "the first";
  EXPECT_NEAR(width("\"extras\":0"), 2 * one, 1e-3);
  const LoadedMesh all = mustRead(saveFile("a.gltf", replaced(text, scenes, "\"extras\":0")));
  EXPECT_EQ(all.diagnosis.pieces, 2u) << "a child is no root";
}

TEST(MeshGltf, AnInterruptionIsSeen) {
  const std::atomic<bool> stop = true;
  const auto read = readMesh(saveFile("a.glb", glbFile(scanOfCubeSphere(4, 0.25))), {.interrupted = &stop});
  ASSERT_FALSE(read.ok());
  EXPECT_EQ(read.error().kind, ErrorKind::kInterrupted);
}

TEST(MeshGltf, WhatIsNotReadIsRefusedByItsName) {
  const Sample s = scanOfCubeSphere(2, 0.25);
  const std::string good = gltfFile(s);
  struct Case {
    std::string text;
    ErrorKind kind;
    std::string says;
  };
  const auto required = [&](const char* name) {
    return replaced(good, "{\"asset\"", std::string("{\"extensionsRequired\":[\"") + name + "\"],\"asset\"");
  };
  const std::string position = "\"bufferView\":0,\"componentType\"";
  const std::vector<Case> cases{
      {required("KHR_texture_webp"), ErrorKind::kUnsupported, "KHR_texture_webp"},
      {required("KHR_texture_basisu"), ErrorKind::kUnsupported, "KHR_texture_basisu"},
      {replaced(good, position, "\"sparse\":{\"count\":1}," + position), ErrorKind::kUnsupported, "a sparse accessor"},
      {replaced(good, position, "\"componentType\""), ErrorKind::kInvalidData, "expected the data of POSITION"},
      {replaced(good, "\"version\":\"2.0\"", "\"version\":\"1.0\""), ErrorKind::kUnsupported, "expected glTF 2.0"},
      {replaced(good, "data:application/octet-stream", "http://example.org/data"), ErrorKind::kUnsupported,
       "which is no file beside it"},
      {replaced(good, ";base64,", ","), ErrorKind::kInvalidData, "in base64"},
      {replaced(good, ";base64,", ";base64,*"), ErrorKind::kInvalidData, "letters of base64"},
      {replaced(good, "\"count\":", "\"count\":1"), ErrorKind::kInvalidData, "within its part of the buffer"},
      {replaced(good, "\"byteLength\":", "\"byteLength\":9007199254740991,\"was\":"), ErrorKind::kInvalidData,
       "byteLength"},
      {replaced(good, "\"indices\":1", "\"indices\":7"), ErrorKind::kInvalidData, "indices to be an integer"},
      {replaced(good, "\"indices\":1", "\"indices\":0"), ErrorKind::kInvalidData, "of whole numbers"},
      {replaced(good, "\"indices\":1", "\"indices\":-1"), ErrorKind::kInvalidData, "found -1"},
      {replaced(good, "\"indices\":1", "\"indices\":0.5"), ErrorKind::kInvalidData, "found 0.5"},
      {replaced(good, "\"POSITION\":0", "\"POSITION\":1"), ErrorKind::kInvalidData, "of 3 numbers each"},
      {replaced(good, "\"nodes\":[0]", "\"nodes\":[3]"), ErrorKind::kInvalidData, "one of the file's 1 nodes"},
      {replaced(good, "\"mesh\":0", "\"mesh\":0,\"children\":[9]"), ErrorKind::kInvalidData, "one of the file's"},
      {"[]", ErrorKind::kInvalidData, "expected a JSON object"},
      {"", ErrorKind::kInvalidData, ""},
      {std::string(200, '['), ErrorKind::kInvalidData, ""},
      {"glTF", ErrorKind::kInvalidData, ""},
  };
  for (const Case& c : cases)
    EXPECT_NE(refusal(saveFile("a.gltf", c.text), c.kind).find(c.says), std::string::npos) << c.says;
  // As many colours and texture coordinates as positions.
  Sample full = sheet(2, 2);
  decorate(full, 3);
  for (const char* type : {"\"type\":\"VEC4\"", "\"type\":\"VEC2\""}) {
    std::string text = gltfFile(full);
    const size_t at = text.rfind("\"count\":9", text.find(type));
    EXPECT_NE(
        refusal(saveFile("a.gltf", text.replace(at, 9, "\"count\":8")), ErrorKind::kInvalidData)
            .find("to have as many colours, texture coordinates, normals and tangents as its 9 positions, found 8"),
        std::string::npos);
  }
  // Buffers outside the folder are not opened.
  const GltfText outside = gltfOf(s, "../x.bin");
  EXPECT_NE(refusal(saveFile("a.gltf", outside.json), ErrorKind::kInvalidData).find("lies outside its folder"),
            std::string::npos);
  EXPECT_NE(refusal(saveFile("a.gltf", gltfOf(s, "gone.bin").json), ErrorKind::kIo).find("gone.bin"),
            std::string::npos);
  // The containers' own lengths.
  const std::string glb = glbFile(s);
  std::string longer = glb, chunk = glb, version = glb;
  longer[8] = static_cast<char>(longer[8] + 1);
  chunk[13] = '\x7f';
  version[4] = 3;
  EXPECT_NE(refusal(saveFile("a.glb", longer), ErrorKind::kInvalidData).find("as its header states"),
            std::string::npos);
  EXPECT_NE(refusal(saveFile("a.glb", chunk), ErrorKind::kInvalidData).find("JSON chunk"), std::string::npos);
  EXPECT_NE(refusal(saveFile("a.glb", version), ErrorKind::kUnsupported).find("version 2"), std::string::npos);
}

// ---- other formats: units, colours of faces, turning ----

TEST(MeshUnits, CommentsStateThemAndOthersAreMillimetres) {
  const Sample s = scanOfCubeSphere(2, 3);
  const auto width = [&](const std::string& path) {
    const LoadedMesh m = mustRead(path);
    EXPECT_NEAR(m.diagnosis.max_mm.x - m.diagnosis.min_mm.x, 6 * m.mm_per_unit, 1e-3);
    return m.unit + " " + std::to_string(static_cast<int>(m.mm_per_unit));
  };
  const std::string ply = plyFile(s, {}), obj = objFile(s), off = offFile(s);
  EXPECT_EQ(width(saveFile("a.ply", ply)), "mm 1");
  EXPECT_EQ(width(saveFile("a.ply", replaced(ply, "made for a test", "unit cm"))), "cm 10");
  EXPECT_EQ(width(saveFile("a.ply", replaced(ply, "made for a test", "Units: meters"))), "m 1000");
  EXPECT_EQ(width(saveFile("a.ply", replaced(ply, "made for a test", "unit pixels (no size)"))), "mm 1");
  EXPECT_EQ(width(saveFile("a.ply", replaced(ply, "made for a test", "unit m is what the other file has"))), "mm 1");
  EXPECT_EQ(width(saveFile("a.obj", "# unit = inches\n" + obj)), "in 25");
  EXPECT_EQ(width(saveFile("a.obj", "#units mm\n#unit m\n" + obj)), "mm 1");
  EXPECT_EQ(width(saveFile("a.off", replaced(off, "# a test", "# unit m"))), "m 1000");
  EXPECT_EQ(width(saveFile("a.stl", stlFile(s, true))), "mm 1");
}

TEST(MeshTurns, UpAndRotateAreExactInQuartersAndKeepTheShape) {
  const Sample s = scanOfCubeSphere(3, 0.25);
  const std::string path = saveFile("a.ply", plyFile(s, {.coordinate = "double"}));
  const auto turned = [&](char up, glm::dvec3 degrees, const std::function<glm::dvec3(glm::dvec3)>& moved) {
    const LoadedMesh m = mustRead(path, {.turn = turnOf(up, degrees)});
    EXPECT_GT(signedVolume(m.mesh), 0);
    return farthest(m, s, moved);
  };
  EXPECT_EQ(turned('y', {0, 0, 0}, [](glm::dvec3 p) { return p; }), 0);
  EXPECT_EQ(turned('z', {0, 0, 0}, [](glm::dvec3 p) { return glm::dvec3(p.x, p.z, -p.y); }), 0);
  EXPECT_EQ(turned('x', {0, 0, 0}, [](glm::dvec3 p) { return glm::dvec3(-p.y, p.x, p.z); }), 0);
  EXPECT_EQ(turned('y', {90, 0, 0}, [](glm::dvec3 p) { return glm::dvec3(p.x, -p.z, p.y); }), 0);
  EXPECT_EQ(turned('y', {0, 90, 0}, [](glm::dvec3 p) { return glm::dvec3(p.z, p.y, -p.x); }), 0);
  EXPECT_EQ(turned('y', {0, 0, -270}, [](glm::dvec3 p) { return glm::dvec3(-p.y, p.x, p.z); }), 0);
  // x first, then z.
  EXPECT_EQ(turned('y', {90, 0, 90}, [](glm::dvec3 p) { return glm::dvec3(p.z, p.x, p.y); }), 0);
  const double c = std::cos(0.5235987755982988), n = 0.5;
  EXPECT_LT(
      turned('z', {30, 0, 0}, [&](glm::dvec3 p) { return glm::dvec3(p.x, c * p.z + n * p.y, n * p.z - c * p.y); }),
      1e-7);
}

// Of each triangle the colour that its texture coordinates name in the palette.
std::vector<glm::u8vec3> paletteColours(const TriMesh& m) {
  std::vector<glm::u8vec3> out;
  const std::vector<glm::u8vec3> palette = paletteOf(m);
  const size_t columns = std::min(palette.size(), kPaletteColumns), rows = palette.size() / columns;
  for (const auto& uv : m.corner_uv) {
    EXPECT_EQ(uv[0], uv[1]);
    EXPECT_EQ(uv[0], uv[2]);
    const auto x = static_cast<size_t>(uv[0].x * static_cast<double>(columns)),
               y = static_cast<size_t>((1 - uv[0].y) * static_cast<double>(rows));
    out.push_back(palette.at(y * columns + x));
  }
  return out;
}

TEST(MeshFaceColours, OfStlByBothConventions) {
  const Sample s = sheet(3, 2);
  const auto file = [&](const std::string& header, const std::function<uint16_t(size_t)>& bits) {
    std::string bytes = stlFile(s, true, header);
    for (size_t t = 0; t < s.triangles.size(); ++t) {
      const uint16_t b = bits(t);
      std::memcpy(bytes.data() + 84 + 50 * t + 48, &b, 2);
    }
    return saveFile("a.stl", bytes);
  };
  const auto channel = [](int five) { return static_cast<uint8_t>(std::lround(five * 255 / 31.0)); };
  // VisCAM: 1 rrrrr ggggg bbbbb.
  const LoadedMesh viscam = mustRead(file("viscam", [](size_t t) {
    return static_cast<uint16_t>(t % 4 == 3 ? 0x7FFF : 0x8000 | t << 10 | 31 << 5 | (31 - t));
  }));
  const std::vector<glm::u8vec3> colours = paletteColours(viscam.mesh);
  ASSERT_EQ(colours.size(), s.triangles.size());
  for (size_t t = 0; t < colours.size(); ++t) {
    const int i = static_cast<int>(t);
    EXPECT_EQ(colours[t], t % 4 == 3 ? glm::u8vec3(204) : glm::u8vec3(channel(i), 255, channel(31 - i))) << t;
  }
  // Magics: 0 bbbbb ggggg rrrrr; bit 15: the header's colour.
  const std::string header = "COLOR=\x10\x20\x30\xff,MATERIAL=";
  const LoadedMesh magics = mustRead(
      file(header, [](size_t t) { return static_cast<uint16_t>(t % 4 == 3 ? 0x8000 : t | 31 << 5 | (31 - t) << 10); }));
  const std::vector<glm::u8vec3> others = paletteColours(magics.mesh);
  ASSERT_EQ(others.size(), s.triangles.size());
  for (size_t t = 0; t < others.size(); ++t) {
    const int i = static_cast<int>(t);
    EXPECT_EQ(others[t], t % 4 == 3 ? glm::u8vec3(16, 32, 48) : glm::u8vec3(channel(i), 255, channel(31 - i))) << t;
  }
  // Zeros everywhere: no colours, or the header's alone.
  EXPECT_TRUE(mustRead(file("plain", [](size_t) { return uint16_t{0}; })).mesh.images.empty());
  EXPECT_EQ(paletteOf(mustRead(file(header, [](size_t) { return uint16_t{0}; })).mesh),
            (std::vector<glm::u8vec3>{{16, 32, 48}}));
}

TEST(MeshFaceColours, OfPlyEvenWhereTheyAreMany) {
  const Sample s = sheet(150, 100);
  const auto colourOf = [](size_t t) {
    return glm::u8vec3(static_cast<uint8_t>(t), static_cast<uint8_t>(t >> 8), static_cast<uint8_t>(7 * t));
  };
  const auto file = [&](const std::string& type, double scale) {
    std::string text = "ply\nformat ascii 1.0\nelement vertex " + std::to_string(s.positions.size()) +
                       "\nproperty float x\nproperty float y\nproperty float z\nelement face " +
                       std::to_string(s.triangles.size()) + "\nproperty list uchar int vertex_indices\nproperty " +
                       type + " red\nproperty " + type + " green\nproperty " + type + " blue\nend_header\n";
    for (const glm::dvec3& p : s.positions) text += number(p.x) + " " + number(p.y) + " " + number(p.z) + "\n";
    for (size_t t = 0; t < s.triangles.size(); ++t) {
      text += "3";
      for (const uint32_t v : s.triangles[t]) text += " " + std::to_string(v);
      for (int c = 0; c < 3; ++c) text += " " + number(scale * colourOf(t)[c]);
      text += "\n";
    }
    return saveFile("a.ply", text);
  };
  for (const auto& [type, scale] : {std::pair{"uchar", 1.0}, {"ushort", 257.0}, {"float", 1 / 255.0}}) {
    const LoadedMesh m = mustRead(file(type, scale));
    EXPECT_GT(paletteOf(m.mesh).size(), kPaletteColumns) << "more than one row";
    const std::vector<glm::u8vec3> colours = paletteColours(m.mesh);
    ASSERT_EQ(colours.size(), s.triangles.size());
    size_t off = 0;
    for (size_t t = 0; t < colours.size(); ++t) off += colours[t] != colourOf(t);
    EXPECT_EQ(off, 0u) << type;
  }
}

TEST(MeshFaceColours, OfPlyBehindTrianglesWithoutOne) {
  const LoadedMesh m = mustRead(
      saveFile("a.ply",
               "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\nelement "
               "tristrips 1\nproperty list int int vertex_indices\nelement face 1\nproperty list uchar int "
               "vertex_indices\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n0 0 0\n1 0 "
               "0\n0 1 0\n1 1 0\n0 2 0\n4 0 1 2 3\n3 2 3 4 250 10 20\n"));
  const std::vector<glm::u8vec3> colours = paletteColours(m.mesh);
  EXPECT_EQ(colours, (std::vector<glm::u8vec3>{{204, 204, 204}, {204, 204, 204}, {250, 10, 20}}));
}

}  // namespace mesh_gltf_test
}  // namespace relievo::test
