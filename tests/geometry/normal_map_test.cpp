// Scans with maps of normals: which belong to which triangles, with which normals of the file; which way their y
// counts; and texels against the normals of the surface that the map was made from.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "geometry/bake/mesh_bake.h"
#include "geometry/bake/normal_map_fit.h"
#include "geometry/bake/vertex_normals.h"
#include "geometry/mesh/mesh_order.h"
#include "geometry/remesh/base_faces.h"
#include "geometry/scan/mesh_tjunction.h"
#include "src/artwork/patch_domain.h"
#include "tests/geometry/mapped_sheet.h"
#include "tests/geometry/mesh_shapes.h"
#include "tests/geometry/must_read.h"

namespace relievo::test {
namespace normal_map_test {

const MeshFinding* unusedMaps(const LoadedMesh& m) {
  for (const MeshFinding& f : m.diagnosis.findings)
    if (f.what == "maps of normals or bumps") return &f;
  return nullptr;
}
// Materials: the first one's members; and two textures of two images, colours and normals.
std::string materialWith(const std::string& members, const std::string& samplers = "") {
  return ",\"materials\":[{" + members + "}],\"textures\":[{\"source\":0},{\"source\":1" + samplers +
         "}],\"images\":[{\"uri\":\"colours.png\"},{\"uri\":\"normals.png\"}]";
}
const std::string kColours = "\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}",
                  kNormals = "\"normalTexture\":{\"index\":1,\"scale\":0.5}";
LoadedMesh readSheet(const Sample& s, const std::string& tail, const std::string& node = "\"mesh\":0",
                     const MeshReadOptions& options = {}) {
  return mustRead(saveFile("mapped.glb", glbFile(s, tail, node)), options);
}
glm::dvec3 place(const LoadedMesh& m, size_t t, size_t k) {
  return m.mesh.origin_mm + glm::dvec3(m.mesh.positions_mm[m.mesh.triangles[t][k]]);
}

TEST(NormalMap, OfAGltfBelongsToTheImageOfItsMaterial) {
  const MappedSheet sheet = mappedSheet(4, 8);
  const Sample& s = sheet.sample;
  const LoadedMesh both = readSheet(s, materialWith(kColours + "," + kNormals));
  ASSERT_EQ(both.mesh.images.size(), 1u);
  const MeshImage& image = both.mesh.images[0];
  EXPECT_EQ(image.file.path, (meshFolder() / "colours.png").string());
  EXPECT_EQ(image.normals.file.path, (meshFolder() / "normals.png").string());
  EXPECT_EQ(image.normals.scale, 0.5f);
  EXPECT_FALSE(image.normals.may_be_bumps);
  EXPECT_EQ(image.normals.y, NormalMap::Y::kUnknown);
  EXPECT_EQ(unusedMaps(both), nullptr);
  ASSERT_EQ(both.mesh.corner_normals.size(), s.triangles.size());
  for (size_t t = 0; t < s.triangles.size(); ++t)
    for (size_t k = 0; k < 3; ++k) {
      const glm::dvec3 at = place(both, t, k) / 1000.0;
      EXPECT_LT(glm::distance(glm::dvec3(both.mesh.corner_normals[t][k]), MappedSheet::smoothNormal(at.x, at.y)), 1e-4);
    }
  // Without colours: white, times the material's factor.
  const LoadedMesh alone =
      readSheet(s, materialWith("\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.5,1,0.25,1]}," + kNormals));
  ASSERT_EQ(alone.mesh.images.size(), 1u);
  EXPECT_FALSE(alone.mesh.images[0].file.isThere());
  EXPECT_EQ(alone.mesh.images[0].tint, glm::vec3(0.5f, 1, 0.25f));
  EXPECT_TRUE(alone.mesh.images[0].normals.file.isThere());
  // The file's normals are for maps alone.
  EXPECT_TRUE(readSheet(s, materialWith(kColours)).mesh.corner_normals.empty());
  // What does not fit the image, is not shown, or has no coordinates is left out, and said.
  const auto leftOut = [&](const LoadedMesh& m) {
    const MeshFinding* found = unusedMaps(m);
    EXPECT_TRUE(found && found->count == 1 && found->done == "not used");
    return std::none_of(m.mesh.images.begin(), m.mesh.images.end(),
                        [](const MeshImage& i) { return i.normals.file.isThere(); });
  };
  EXPECT_TRUE(leftOut(readSheet(s, materialWith(kColours + ",\"normalTexture\":{\"index\":1,\"texCoord\":1}"))));
  EXPECT_TRUE(leftOut(
      readSheet(s, materialWith(kColours + ",\"normalTexture\":{\"index\":1,\"extensions\":{\"KHR_texture_transform\":{"
                                           "\"scale\":[2,2]}}}"))));
  EXPECT_TRUE(leftOut(readSheet(s, materialWith(kColours + "," + kNormals, ",\"sampler\":0") +
                                       ",\"samplers\":[{\"wrapS\":33071,\"wrapT\":33071}]")));
  Sample other = s;
  other.colours.assign(s.positions.size(), {200, 100, 50});
  EXPECT_TRUE(leftOut(readSheet(other, materialWith(kNormals)))) << "colours of vertices";
  other = s;
  other.corner_uv.clear();
  EXPECT_TRUE(leftOut(readSheet(other, materialWith(kNormals)))) << "no texture coordinates";
  const LoadedMesh instead = readSheet(s, materialWith(kColours + "," + kNormals), "\"mesh\":0", {.other_image = true});
  EXPECT_NE(unusedMaps(instead), nullptr) << "another image stands in";
  EXPECT_EQ(unusedMaps(readSheet(s, materialWith("},{" + kNormals))), nullptr) << "control: of no triangle's material";
}

TEST(NormalMap, NormalsTurnWithTheirNodes) {
  const MappedSheet sheet = mappedSheet(4, 8);
  const std::string tail = materialWith(kColours + "," + kNormals);
  struct Case {
    std::string node;
    glm::dmat3 matrix;
  };
  const std::vector<Case> cases{
      {"\"mesh\":0,\"scale\":[1,2,4]", glm::dmat3(1, 0, 0, 0, 2, 0, 0, 0, 4)},
      {"\"mesh\":0,\"scale\":[-1,1,1]", glm::dmat3(-1, 0, 0, 0, 1, 0, 0, 0, 1)},
      {"\"mesh\":0,\"rotation\":[0.7071067811865476,0,0,0.7071067811865476]", glm::dmat3(1, 0, 0, 0, 0, 1, 0, -1, 0)},
  };
  for (const Case& c : cases)
    for (const bool turned : {false, true}) {
      MeshReadOptions options;
      if (turned) options.turn = glm::dmat3(0, 1, 0, 0, 0, 1, 1, 0, 0);
      const LoadedMesh m = readSheet(sheet.sample, tail, c.node, options);
      const glm::dmat3 matrix = options.turn * c.matrix, of_normals = glm::transpose(glm::inverse(matrix));
      double off = 0, plain = 0;
      ASSERT_EQ(m.mesh.corner_normals.size(), m.mesh.triangles.size());
      for (size_t t = 0; t < m.mesh.triangles.size(); ++t)
        for (size_t k = 0; k < 3; ++k) {
          const glm::dvec3 at = glm::inverse(matrix) * place(m, t, k) / 1000.0,
                           n = MappedSheet::smoothNormal(at.x, at.y);
          const glm::dvec3 found(m.mesh.corner_normals[t][k]);
          off = std::max(off, glm::distance(found, glm::normalize(of_normals * n)));
          plain = std::max(plain, glm::distance(found, n));
        }
      EXPECT_LT(off, 1e-4) << c.node << turned;
      EXPECT_GT(plain, 0.1) << "control: as the file has them";
    }
}

TEST(NormalMap, TangentsSayWhichWayItsYCounts) {
  MappedSheet sheet = mappedSheet(4, 8);
  const auto yOf = [&](float hand, const std::string& node) {
    sheet.sample.tangents.assign(sheet.sample.positions.size(), {1, 0, 0, hand});
    return readSheet(sheet.sample, materialWith(kColours + "," + kNormals), node).mesh.images[0].normals.y;
  };
  for (const char* node : {"\"mesh\":0", "\"mesh\":0,\"scale\":[-1,1,1]"}) {
    EXPECT_EQ(yOf(1, node), NormalMap::Y::kUpwards) << node;
    EXPECT_EQ(yOf(-1, node), NormalMap::Y::kDownwards) << node;
    EXPECT_EQ(yOf(0, node), NormalMap::Y::kUnknown) << node;
  }
  // Mirrored in the image, the same hands say the opposite.
  for (auto& uv : sheet.sample.corner_uv)
    for (glm::vec2& at : uv) at.x = 1 - at.x;
  EXPECT_EQ(yOf(1, "\"mesh\":0"), NormalMap::Y::kDownwards);
}

TEST(NormalMap, OfAnObjIsNamedByNormOrBump) {
  const MappedSheet sheet = mappedSheet(2, 8);
  std::string faces;
  for (const glm::dvec3& p : sheet.sample.positions)
    faces += "v " + number(p.x) + " " + number(p.y) + " " + number(p.z) + "\n";
  for (const glm::dvec3& p : sheet.sample.positions)
    faces += "vt " + number(p.x / 0.1) + " " + number(p.y / 0.1) + "\n";
  for (const glm::vec3& n : sheet.sample.normals)
    faces += "vn " + number(3 * n.x) + " " + number(3 * n.y) + " " + number(3 * n.z) + "\n";
  faces += "usemtl a\n";
  for (const auto& t : sheet.sample.triangles) {
    faces += "f";
    for (const uint32_t v : t) {
      const std::string i = std::to_string(v + 1);
      faces += " " + i + "/" + i + "/" + i;
    }
    faces += "\n";
  }
  const auto read = [&](const std::string& material, bool library_first = true) {
    saveFile("mapped.mtl", "newmtl a\nKd 0.2 0.4 1\n" + material);
    const std::string library = "mtllib mapped.mtl\n";
    return mustRead(saveFile("mapped.obj", library_first ? library + faces : faces + library));
  };
  LoadedMesh m = read("map_Kd c.png\nmap_Bump -bm 0.5 my bumps.png\nnorm n.png\n");
  ASSERT_EQ(m.mesh.images.size(), 1u);
  EXPECT_EQ(imagePath(m.mesh), (meshFolder() / "c.png").string());
  EXPECT_EQ(m.mesh.images[0].normals.file.path, (meshFolder() / "n.png").string());
  EXPECT_FALSE(m.mesh.images[0].normals.may_be_bumps);
  EXPECT_EQ(m.mesh.images[0].tint, glm::vec3(1));
  EXPECT_EQ(unusedMaps(m), nullptr);
  ASSERT_EQ(m.mesh.corner_normals.size(), m.mesh.triangles.size());
  for (size_t t = 0; t < m.mesh.triangles.size(); ++t)
    for (size_t k = 0; k < 3; ++k) {
      const glm::dvec3 at = place(m, t, k);
      EXPECT_LT(glm::distance(glm::dvec3(m.mesh.corner_normals[t][k]), MappedSheet::smoothNormal(at.x, at.y)), 1e-4);
    }
  EXPECT_NE(std::find(m.named_files.begin(), m.named_files.end(), (meshFolder() / "my bumps.png").string()),
            m.named_files.end());
  m = read("norm n.png\nmap_Bump -bm 0.5 my bumps.png\n");
  EXPECT_EQ(m.mesh.images[0].normals.file.path, (meshFolder() / "n.png").string()) << "in any order";
  // Without an image, with the colour; as bumps, with their factor.
  for (const char* behind : {"bump my bumps.png -bm 0.5\n", "bump  my bumps.png  -bm 0.5 \n"}) {
    m = read(behind);
    EXPECT_EQ(m.mesh.images[0].normals.file.path, (meshFolder() / "my bumps.png").string()) << behind;
    EXPECT_EQ(m.mesh.images[0].normals.scale, 0.5f);
  }
  m = read("bump my -bm bumps.png\n");
  EXPECT_EQ(m.mesh.images[0].normals.file.path, (meshFolder() / "my -bm bumps.png").string()) << "a part of its name";
  m = read("map_Bump -bm 0.5 my bumps.png\n");
  ASSERT_EQ(m.mesh.images.size(), 1u);
  EXPECT_FALSE(m.mesh.images[0].file.isThere());
  EXPECT_TRUE(m.mesh.images[0].normals.may_be_bumps);
  EXPECT_EQ(m.mesh.images[0].normals.scale, 0.5f);
  EXPECT_NEAR(m.mesh.images[0].tint.r, std::pow((0.2 + 0.055) / 1.055, 2.4), 1e-3);
  // One that repeats beside an image that does not.
  m = read("map_Kd -clamp on c.png\nnorm n.png\n");
  EXPECT_FALSE(m.mesh.images[0].normals.file.isThere());
  ASSERT_NE(unusedMaps(m), nullptr);
  // Whoever names the material last has no use for the normals before it, but for the map.
  m = read("norm n.png\n", false);
  EXPECT_TRUE(m.mesh.images[0].normals.file.isThere());
  EXPECT_TRUE(m.mesh.corner_normals.empty());
  m = mustRead(saveFile("mapped.obj", "vn 0 0 1\nmtllib mapped.mtl\n" + faces));
  EXPECT_TRUE(m.mesh.images[0].normals.file.isThere());
  EXPECT_TRUE(m.mesh.corner_normals.empty()) << "the first one was read over, so that all others have other numbers";
}

// Normals stay with their corners through repair: duplicate vertices, dropped and turned triangles, splits.
TEST(NormalMap, NormalsStayWithTheirCorners) {
  const MappedSheet sheet = mappedSheet(6, 8);
  Sample s = sheet.sample;
  // A triangle of two sides on one line first, one turned over, and one that is there twice.
  s.triangles.insert(s.triangles.begin(), {0, 1, 1});
  s.corner_uv.insert(s.corner_uv.begin(), s.corner_uv[0]);
  std::swap(s.triangles[20][1], s.triangles[20][2]);
  s.triangles.push_back(s.triangles[5]);
  s.corner_uv.push_back(s.corner_uv[5]);
  LoadedMesh m = readSheet(s, materialWith(kColours + "," + kNormals));
  ASSERT_EQ(m.mesh.triangles.size(), sheet.sample.triangles.size());
  EXPECT_EQ(triMeshProblem(m.mesh), "");
  const auto off = [&](const TriMesh& mesh, int& none) {
    double most = 0;
    none = 0;
    for (size_t t = 0; t < mesh.triangles.size(); ++t)
      for (size_t k = 0; k < 3; ++k) {
        const glm::dvec3 at = (mesh.origin_mm + glm::dvec3(mesh.positions_mm[mesh.triangles[t][k]])) / 1000.0,
                         found(mesh.corner_normals[t][k]);
        if (found == glm::dvec3(0)) ++none;
        else most = std::max(most, glm::distance(found, MappedSheet::smoothNormal(at.x, at.y)));
      }
    return most;
  };
  int none = 0;
  EXPECT_LT(off(m.mesh, none), 1e-4);
  EXPECT_EQ(none, 3) << "those of the triangle that was turned pointed inwards with it";
  EXPECT_TRUE(orderTriangles(m.mesh));
  EXPECT_LT(off(m.mesh, none), 1e-4);
  EXPECT_EQ(none, 3);
  // A split has the normal between.
  const auto [a, b, c] = m.mesh.triangles[0];
  const auto normals = m.mesh.corner_normals[0];
  const auto middle = static_cast<uint32_t>(m.mesh.positions_mm.size());
  m.mesh.positions_mm.push_back(0.75f * m.mesh.positions_mm[a] + 0.25f * m.mesh.positions_mm[b]);
  const TJunction junction{.half_edge = 0, .vertex = middle, .along = 0.25};
  EXPECT_TRUE(splitAtTJunctions(m.mesh, std::span(&junction, 1)).empty());
  ASSERT_EQ(m.mesh.corner_normals.size(), m.mesh.triangles.size());
  const glm::vec3 between = glm::normalize(0.75f * normals[0] + 0.25f * normals[1]);
  int found = 0;
  for (size_t t = 0; t < m.mesh.triangles.size(); ++t)
    for (size_t k = 0; k < 3; ++k)
      if (m.mesh.triangles[t][k] == middle) found += glm::distance(m.mesh.corner_normals[t][k], between) < 1e-5f;
  EXPECT_EQ(found, 2);
}

TriMesh meshOf(const MappedSheet& sheet) {
  LoadedMesh m = readSheet(sheet.sample, materialWith(kColours + "," + kNormals), "\"mesh\":0", {.mm_per_unit = 1000});
  return std::move(m.mesh);
}
MeshBake::Image imageOf(const MappedSheet& sheet, const std::vector<uint8_t>& texel) {
  return {.width = 1,
          .height = 1,
          .texels = texel,
          .repeats = true,
          .normals_width = sheet.texels,
          .normals_height = sheet.texels,
          .normals = sheet.map};
}

TEST(NormalMap, TheSurfaceTellsWhichWayItsYCounts) {
  const std::vector<uint8_t> texel{1, 2, 3};
  for (const bool downwards : {false, true}) {
    const NormalMapFit found = downwards ? NormalMapFit::kDownwards : NormalMapFit::kUpwards;
    MappedSheet sheet = mappedSheet(6, 256, downwards, 0.2, 0.5);
    MeshBake::Image image = imageOf(sheet, texel);
    TriMesh mesh = meshOf(sheet);
    EXPECT_EQ(normalMapFit(mesh, 0, image, NormalMap::Y::kUnknown, {}), found);
    EXPECT_EQ(normalMapFit(mesh, 0, image, NormalMap::Y::kUpwards, {}), NormalMapFit::kUpwards) << "the file says it";
    EXPECT_EQ(normalMapFit(mesh, 0, image, NormalMap::Y::kDownwards, {}), NormalMapFit::kDownwards);
    // By the vertices' normals, where the file has none.
    sheet = mappedSheet(6, 256, downwards, 0.2);
    image = imageOf(sheet, texel);
    mesh = meshOf(sheet);
    std::vector<glm::vec3> normals;
    ASSERT_TRUE(makeVertexNormals(mesh, 1, nullptr, normals));
    mesh.corner_normals.clear();
    EXPECT_EQ(normalMapFit(mesh, 0, image, NormalMap::Y::kUnknown, normals), found);
  }
  // What is as far off both ways counts upwards: a map of what is finer than triangles.
  MappedSheet sheet = mappedSheet(10, 256);
  const TriMesh mesh = meshOf(sheet);
  for (size_t i = 0; i < sheet.map.size(); ++i)
    sheet.map[i] = i % 3 == 2 ? 240 : static_cast<uint8_t>(96 + (i * 2654435761u >> 26));
  EXPECT_EQ(normalMapFit(mesh, 0, imageOf(sheet, texel), NormalMap::Y::kUnknown, {}), NormalMapFit::kUpwards);
  // Of another kind: a thirtieth of the map points inwards.
  for (size_t i = 2; i < sheet.map.size(); i += 3)
    if (i / 3 / 256 % 30 == 0) sheet.map[i] = 40;
  EXPECT_EQ(normalMapFit(mesh, 0, imageOf(sheet, texel), NormalMap::Y::kUnknown, {}), NormalMapFit::kNone);
}

// Texels of patches that have their own, against the surface that the map was made from.
TEST(NormalMap, TexelsHaveTheNormalsOfTheSource) {
  const std::vector<uint8_t> texel{200, 100, 50};
  for (const bool downwards : {false, true}) {
    const MappedSheet sheet = mappedSheet(10, 512, downwards, 1, 0.5);
    const TriMesh mesh = meshOf(sheet);
    auto surface = makeSurface(mesh.positions_mm, mesh.triangles);
    ASSERT_TRUE(surface.ok());
    const BaseMesh base = facesBase(*surface, 1000);
    MeshBake::Image image = imageOf(sheet, texel);
    image.normals_downwards = downwards;
    const auto meanOff = [&](const MeshBake::Image& of) {
      BakeOptions options{.cells_log2 = 3, .fit = false, .touch_mm = 1e-3};
      auto baked = MeshBake::create(mesh, std::span(&of, 1), base, options);
      EXPECT_TRUE(baked.ok());
      EXPECT_EQ((*baked)->textureDepthOf(0), 0) << "its 51 texels a quad need a page";
      double sum = 0;
      int count = 0;
      for (uint32_t p = 0; p < base.patches.size(); p += 3) {
        constexpr size_t kPlane = 128 * 128;
        std::vector<uint8_t> out(6 * kPlane);
        EXPECT_TRUE((*baked)->texels(p, out).ok());
        EXPECT_EQ(out[kPlane + 77], 100) << "green of the one colour";
        for (size_t i = 0; i < kPlane; i += 37) {
          const glm::dvec3 at = (mesh.origin_mm + base.point(p, (static_cast<double>(i % 128) + 0.5) / 128,
                                                             (static_cast<double>(i / 128) + 0.5) / 128)) /
                                1000.0;
          const glm::dvec3 n =
              glm::normalize(glm::dvec3(out[3 * kPlane + i], out[4 * kPlane + i], out[5 * kPlane + i]) / 127.5 - 1.0);
          sum += glm::degrees(std::acos(std::clamp(glm::dot(n, sheet.trueNormal(at.x, at.y)), -1.0, 1.0)));
          ++count;
        }
      }
      return sum / count;
    };
    EXPECT_LT(meanOff(image), 2);
    image.normals_downwards = !downwards;
    EXPECT_GT(meanOff(image), 8) << "control: y the other way";
    image.normals = {};
    image.normals_width = image.normals_height = 0;
    image.width = image.height = 512;
    const std::vector<uint8_t> many(3 * 512 * 512, 100);
    image.texels = many;
    EXPECT_GT(meanOff(image), 8) << "control: without the map";
  }
}

}  // namespace normal_map_test
}  // namespace relievo::test
