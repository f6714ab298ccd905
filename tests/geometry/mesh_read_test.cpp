// Mesh files: what is written is what is read, in every format and type; every defect is found, named and repaired as
// mesh_read.h says. Oracles: writers from the formats' descriptions, OpenMesh's readers, writers and half-edges,
// analytic volumes and areas.
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"  // OpenMesh leaves new colours as they are
#include "geometry/scan/mesh_read.h"

#include <gtest/gtest.h>

#include <OpenMesh/Core/IO/MeshIO.hh>
#include <OpenMesh/Core/Mesh/TriMesh_ArrayKernelT.hh>
#include <algorithm>
#include <cstdio>
#include <numeric>
#include <set>

#include "geometry/mesh/triangle_blocks.h"
#include "geometry/scan/mesh_sheets.h"
#include "tests/geometry/mesh_files.h"
#include "tests/geometry/must_read.h"
#include "tests/shared_data.h"

namespace relievo::test {
namespace mesh_read_test {

namespace fs = std::filesystem;

uint32_t pick(std::mt19937& random, uint32_t n) { return static_cast<uint32_t>(random() % n); }

LoadedMesh mustRepair(const TriMesh& mesh) {
  auto repaired = repairMesh(mesh, "test");
  EXPECT_TRUE(repaired.ok()) << repaired.error().text();
  if (!repaired) return {};
  EXPECT_EQ(triMeshProblem(repaired->mesh), "");
  return std::move(*repaired);
}
uint64_t found(const MeshDiagnosis& d, const std::string& what) {
  for (const MeshFinding& f : d.findings)
    if (f.what == what) {
      EXPECT_GT(f.count, 0u);
      EXPECT_EQ(f.places_mm.empty(), what == "vertices of no triangle" || what.starts_with("faces of")) << what;
      EXPECT_LE(f.places_mm.size(), 8u);
      return f.count;
    }
  return 0;
}
// All that was found, but what open and several pieces have anyway.
std::string defects(const MeshDiagnosis& d) {
  std::string out;
  for (const MeshFinding& f : d.findings)
    if (f.what != "open borders" && f.what != "isolated pieces") out += f.what + "; ";
  return out;
}

// The repaired mesh as OpenMesh sees it: it takes every face, and no vertex is complex.
using HalfEdges = OpenMesh::TriMesh_ArrayKernelT<>;
struct Seen {
  size_t refused = 0, complex_vertices = 0, border_loops = 0, pieces = 0;
};
Seen seenByOpenMesh(const TriMesh& mesh) {
  omerr().disable();  // what it refuses is counted
  HalfEdges h;
  Seen seen;
  for (const glm::vec3& p : mesh.positions_mm) h.add_vertex({p.x, p.y, p.z});
  for (const auto& t : mesh.triangles) {
    auto v = [&](size_t k) { return OpenMesh::VertexHandle(static_cast<int>(t[k])); };
    if (!h.add_face(v(0), v(1), v(2)).is_valid()) ++seen.refused;
  }
  for (auto v : h.vertices()) seen.complex_vertices += !h.is_manifold(v);
  std::set<int> done;
  for (auto e : h.halfedges()) {
    if (!h.is_boundary(e) || done.count(e.idx())) continue;
    ++seen.border_loops;
    for (OpenMesh::HalfedgeHandle at = e; done.insert(at.idx()).second;) at = h.next_halfedge_handle(at);
  }
  std::vector<int> piece(h.n_faces());
  std::iota(piece.begin(), piece.end(), 0);
  auto root = [&](int i) {
    while (piece[static_cast<size_t>(i)] != i)
      i = piece[static_cast<size_t>(i)] = piece[static_cast<size_t>(piece[static_cast<size_t>(i)])];
    return i;
  };
  for (auto f : h.faces())
    for (auto g : h.ff_range(f)) piece[static_cast<size_t>(root(f.idx()))] = root(g.idx());
  for (size_t i = 0; i < piece.size(); ++i) seen.pieces += piece[i] == static_cast<int>(i);
  return seen;
}
void expectManifold(const LoadedMesh& loaded) {
  Seen seen = seenByOpenMesh(loaded.mesh);
  EXPECT_EQ(seen.refused, 0u);
  EXPECT_EQ(seen.complex_vertices, 0u);
  EXPECT_EQ(seen.border_loops, loaded.diagnosis.border_loops);
  EXPECT_EQ(seen.pieces, loaded.diagnosis.pieces);
}

// ---- formats ----

// What of a sample a file keeps.
void expectSame(const LoadedMesh& loaded, const Sample& s, bool colours, bool uv) {
  const TriMesh& m = loaded.mesh;
  ASSERT_EQ(m.positions_mm.size(), s.positions.size());
  EXPECT_EQ(m.triangles, s.triangles);
  for (size_t i = 0; i < s.positions.size(); ++i)
    ASSERT_EQ(glm::dvec3(m.positions_mm[i]) + m.origin_mm, s.positions[i]) << "vertex " << i;
  EXPECT_EQ(m.colours, colours ? s.colours : std::vector<glm::u8vec3>());
  EXPECT_TRUE(uv ? m.corner_uv == s.corner_uv : m.corner_uv.empty());
  EXPECT_EQ(defects(loaded.diagnosis), "");
  EXPECT_EQ(loaded.diagnosis.pieces, 1u);
  EXPECT_EQ(loaded.diagnosis.border_loops, 0u);
  EXPECT_EQ(loaded.diagnosis.triangles_read, s.triangles.size());
  EXPECT_EQ(loaded.diagnosis.triangles, s.triangles.size());
  EXPECT_EQ(loaded.diagnosis.vertices, s.positions.size());
}

TEST(MeshFormats, PlyInEveryEncodingAndType) {
  Sample plain = scanOfCubeSphere(5), full = plain;
  decorate(full, 7);
  Sample coarse = plain;  // for types that hold whole numbers, and not many of them
  for (auto& p : coarse.positions) p = glm::round(p);
  for (Encoding encoding : {Encoding::kAscii, Encoding::kLittle, Encoding::kBig}) {
    SCOPED_TRACE(static_cast<int>(encoding));
    expectSame(mustRead(saveFile("a.ply", plyFile(plain, {.encoding = encoding}))), plain, false, false);
    for (bool clutter : {false, true})
      for (const char* end : {"\n", "\r\n"}) {
        LoadedMesh m =
            mustRead(saveFile("a.ply", plyFile(full, {.encoding = encoding, .clutter = clutter, .line_end = end})));
        expectSame(m, full, true, true);
        EXPECT_EQ(imagePath(m.mesh), (meshFolder() / "image of a test.png").string());
      }
    for (const char* type : {"char", "int8", "short", "int16", "int", "int32", "float", "float32", "double", "float64"})
      expectSame(mustRead(saveFile("a.ply", plyFile(coarse, {.encoding = encoding, .coordinate = type}))), coarse,
                 false, false);
    for (const char* type : {"uchar", "ushort", "float", "double"}) {
      if (std::string(type) == "double") continue;
      expectSame(mustRead(saveFile("a.ply", plyFile(full, {.encoding = encoding, .colour = type}))), full, true, true);
    }
    for (const char* index : {"uchar", "short", "ushort", "int", "uint"})
      for (const char* count : {"uchar", "char", "ushort", "int", "uint"})
        expectSame(mustRead(saveFile("a.ply", plyFile(plain, {.encoding = encoding, .index = index, .count = count}))),
                   plain, false, false);
  }
  // Negative control: one coordinate other than it was.
  Sample other = plain;
  other.positions[3].y += 1.0 / 4096;
  LoadedMesh m = mustRead(saveFile("a.ply", plyFile(other, {})));
  EXPECT_NE(glm::dvec3(m.mesh.positions_mm[3]) + m.mesh.origin_mm, plain.positions[3]);
}

TEST(MeshFormats, PlyTextureCoordinatesOfVertices) {
  Sample s = sheet(3, 2);
  decorate(s, 3);
  std::vector<glm::vec2> of(s.positions.size());
  for (size_t t = s.triangles.size(); t-- > 0;)
    for (size_t k = 0; k < 3; ++k) of[s.triangles[t][k]] = s.corner_uv[t][k];
  LoadedMesh m = mustRead(saveFile("a.ply", plyFile(s, {.vertex_uv = true})));
  ASSERT_EQ(m.mesh.corner_uv.size(), s.triangles.size());
  for (size_t t = 0; t < s.triangles.size(); ++t)
    for (size_t k = 0; k < 3; ++k) EXPECT_EQ(m.mesh.corner_uv[t][k], of[m.mesh.triangles[t][k]]);
}

TEST(MeshFormats, PlyStrips) {
  // Two strips over a sheet of 2 x 2: vertex 3 y + x.
  std::string file =
      "ply\nformat ascii 1.0\nelement vertex 9\nproperty float x\nproperty float y\nproperty float z\nelement "
      "tristrips 1\n"
      "property list int int vertex_indices\nend_header\n";
  for (int i = 0; i < 9; ++i) file += std::to_string(i % 3) + " " + std::to_string(i / 3) + " 0\n";
  LoadedMesh m = mustRead(saveFile("a.ply", file + "13 0 3 1 4 2 5 -1 3 6 4 7 5 8\n"));
  EXPECT_EQ(m.mesh.triangles.size(), 8u);
  EXPECT_DOUBLE_EQ(area(m.mesh), 4);
  EXPECT_EQ(defects(m.diagnosis), "");  // every second triangle turned, else they were flipped
  EXPECT_EQ(m.diagnosis.border_loops, 1u);
}

TEST(MeshFormats, ObjWithMaterials) {
  Sample s = scanOfCubeSphere(4);
  decorate(s, 11);
  saveFile(
      "test.mtl",
      "newmtl other\nmap_Kd no.png\nnewmtl surface\r\nKd 1 1 1\nmap_Kd -s 2 2 -clamp on sub dir\\my image.png\r\n");
  for (bool negative : {false, true}) {
    LoadedMesh m = mustRead(saveFile("a.obj", objFile(s, negative)));
    expectSame(m, s, true, true);
    EXPECT_EQ(imagePath(m.mesh), (meshFolder() / "sub dir/my image.png").string());
  }
  Sample plain = scanOfCubeSphere(4);
  saveFile("test.mtl", "newmtl surface\nKd 1 1 1\n");
  expectSame(mustRead(saveFile("a.obj", objFile(plain))), plain, false, false);
  // An image, but no texture coordinates.
  saveFile("test.mtl", "newmtl surface\nmap_Kd a.png\n");
  LoadedMesh bare = mustRead(saveFile("a.obj", objFile(plain)));
  EXPECT_EQ(imagePath(bare.mesh), "");
  EXPECT_NE(defects(bare.diagnosis).find("a.png"), std::string::npos);

  // Lines that go on, faces before their vertices, a line without its end, colours to 255.
  LoadedMesh m = mustRead(
      saveFile("b.obj", "f 1 2 \\\n 3\nv 0 0 0 255 128 0\nv 1 0 0 0 0 0\r\nv 0 1 0 1 1 1\nl 1 2\nf 1 3 4\nv -1 0 0"));
  EXPECT_EQ(m.mesh.triangles.size(), 2u);
  ASSERT_EQ(m.mesh.colours.size(), 4u);
  EXPECT_EQ(m.mesh.colours[0], glm::u8vec3(255, 128, 0));
  EXPECT_EQ(m.mesh.colours[2], glm::u8vec3(1, 1, 1));

  // Without the material file there is a mesh, and a finding.
  m = mustRead(saveFile("c.obj", "mtllib none.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n"));
  EXPECT_EQ(imagePath(m.mesh), "");
  EXPECT_NE(defects(m.diagnosis).find("none.mtl"), std::string::npos);

  // Maps of normals and bumps without texture coordinates, said once for each material that faces use.
  saveFile("bumps.mtl",
           "newmtl a\nmap_Bump -bm 1 a.png\nnewmtl b\nnorm b.png\nnewmtl c\nbump c.png\nnewmtl d\nKd 1 0 0\n");
  const auto mapsOf = [&](const char* faces) {
    const LoadedMesh obj =
        mustRead(saveFile("c.obj", std::string("mtllib bumps.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\n") + faces));
    for (const MeshFinding& f : obj.diagnosis.findings)
      if (f.what == "maps of normals or bumps") return f.count;
    return uint64_t{0};
  };
  EXPECT_EQ(mapsOf("usemtl a\nf 1 2 3\nusemtl d\nf 2 4 3\n"), 1u);
  EXPECT_EQ(mapsOf("usemtl b\nf 1 2 3\nusemtl c\nf 2 4 3\n"), 2u);
  EXPECT_EQ(mapsOf("usemtl d\nf 1 2 3\n"), 0u) << "control: of no material that is used";

  // Two images, each on its material's triangles.
  saveFile("two.mtl", "newmtl a\nmap_Kd a.png\nnewmtl b\nmap_Kd b.png\nnewmtl red\nKd 1 0 0\n");
  const std::string corners = "mtllib two.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 2 0\nvt 0 0\n";
  m = mustRead(
      saveFile("d.obj", corners + "usemtl a\nf 1/1 2/1 3/1\nusemtl b\nf 1/1 3/1 4/1\nf 4/1 3/1 5/1\nusemtl red\n"));
  EXPECT_EQ(imagePath(m.mesh, 0), (meshFolder() / "b.png").string());
  EXPECT_EQ(imagePath(m.mesh, 1), (meshFolder() / "a.png").string());
  EXPECT_EQ(m.mesh.images.size(), 2u);
  EXPECT_EQ(m.mesh.image_of, (std::vector<uint16_t>{1, 0, 0}));
  // Beside an image a material without one has its colour, or the vertices' where these have some; and so has a face
  // without texture coordinates.
  m = mustRead(saveFile("d.obj", corners + "usemtl a\nf 1/1 2/1 3/1\nf 1 3 4\nusemtl red\nf 4/1 3/1 5/1\n"));
  EXPECT_EQ(m.mesh.image_of, (std::vector<uint16_t>{0, 1, 1}));
  EXPECT_EQ(paletteOf(m.mesh), (std::vector<glm::u8vec3>{{204, 204, 204}, {255, 0, 0}}));
  EXPECT_EQ(m.mesh.corner_uv[1][0], glm::vec2(0.25f, 0.5f));
  EXPECT_EQ(m.mesh.corner_uv[2][2], glm::vec2(0.75f, 0.5f));
  m = mustRead(saveFile("d.obj", corners + "v 9 9 9 0 0 0\nusemtl a\nf 1/1 2/1 3/1\nusemtl red\nf 4/1 3/1 6/1\n"));
  EXPECT_EQ(m.mesh.image_of, (std::vector<uint16_t>{0, kNoImage}));
  EXPECT_EQ(m.mesh.images.size(), 1u);
  // An image from elsewhere takes the place of all of them.
  auto other = readMesh(saveFile("d.obj", corners + "usemtl a\nf 1/1 2/1 3/1\nusemtl red\nf 4/1 3/1 5/1\n"),
                        {.other_image = true});
  ASSERT_TRUE(other);
  EXPECT_TRUE(other->mesh.image_of.empty());
  EXPECT_EQ(other->mesh.corner_uv[1][0], glm::vec2(0));
}

const MeshFinding* finding(const LoadedMesh& m, const std::string& what) {
  for (const MeshFinding& f : m.diagnosis.findings)
    if (f.what.find(what) != std::string::npos) return &f;
  return nullptr;
}

// Programs that leave out texture coordinates may leave in what names them: the scan is read without.
TEST(MeshFormats, ObjFacesMayNameTextureCoordinatesWhereThereAreNone) {
  const std::string points = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 1\n";
  LoadedMesh m = mustRead(saveFile("a.obj", points + "f 1/1/1 2/2/2 3/3/3\nf 2/2 4/4 3\n"));
  EXPECT_EQ(m.mesh.triangles.size(), 2u);
  EXPECT_TRUE(m.mesh.corner_uv.empty());
  const MeshFinding* f = finding(m, "of which the file has none");
  ASSERT_TRUE(f) << defects(m.diagnosis);
  EXPECT_EQ(f->count, 5u);
  EXPECT_FALSE(finding(mustRead(saveFile("a.obj", points + "f 1 2 3\nf 2 4 3\n")), "of which")) << "control";
}

// Without an image, each triangle has its material's Kd: a texel of a row of them.
TEST(MeshFormats, ObjMaterialsColourTheirTriangles) {
  saveFile("kd.mtl", "newmtl red\nKd 1 0 0\nnewmtl plain\nnewmtl blue\nKd 0 0.2 1.5\nnewmtl not\nKd 0 nan 0\n");
  const std::string corners = "mtllib kd.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 2 0\n";
  LoadedMesh m = mustRead(
      saveFile("kd.obj", corners + "usemtl red\nf 1 2 3\nusemtl blue\nf 1 3 4\nusemtl red\nusemtl plain\nf 4 3 5\n"));
  EXPECT_EQ(paletteOf(m.mesh), (std::vector<glm::u8vec3>{{0, 51, 255}, {204, 204, 204}, {255, 0, 0}}));
  ASSERT_EQ(m.mesh.corner_uv.size(), 3u);
  EXPECT_FALSE(m.mesh.images[0].repeats);
  for (size_t t = 0; t < 3; ++t) {
    const auto& positions = m.mesh.positions_mm;
    glm::vec3 centre(0);
    for (uint32_t v : m.mesh.triangles[t]) centre += positions[v] / 3.0f;
    centre += glm::vec3(m.mesh.origin_mm);
    const size_t expected = centre.y < 0.5f ? 2 : centre.y < 0.9f ? 0 : 1;
    for (const glm::vec2& uv : m.mesh.corner_uv[t])
      EXPECT_EQ(uv, glm::vec2((static_cast<float>(expected) + 0.5f) / 3, 0.5f)) << centre.y;
  }
  EXPECT_FALSE(finding(m, "image") || finding(m, "colour")) << defects(m.diagnosis);
  // Texture coordinates of no image do not count, but for an image from elsewhere.
  const std::string with_uv = saveFile("kd.obj", corners + "vt 0 0\nusemtl red\nf 1/1 2/1 3/1\n");
  EXPECT_EQ(paletteOf(mustRead(with_uv).mesh), (std::vector<glm::u8vec3>{{255, 0, 0}}));
  auto other = readMesh(with_uv, {.other_image = true});
  ASSERT_TRUE(other);
  EXPECT_TRUE(other->mesh.images.empty());
  EXPECT_EQ(other->mesh.corner_uv.at(0)[0], glm::vec2(0));
  // One grey for all, what is no number, colours of vertices: no row.
  for (const char* none : {"f 1 2 3\n", "usemtl plain\nf 1 2 3\n", "usemtl not\nf 1 2 3\nf 1 3 4\n",
                           "v 2 2 2 1 0 0\nusemtl red\nf 1 2 6\n"}) {
    m = mustRead(saveFile("kd.obj", corners + none));
    EXPECT_TRUE(m.mesh.images.empty()) << none;
  }
}

// What cannot be shown is said: colours of materials beside those of vertices, images without numbers, colours of
// faces.
TEST(MeshFormats, ColoursThatAreNotReadAreFindings) {
  saveFile("some.mtl",
           "newmtl a\nKd 1 0 0\nmap_Kd a.png\nnewmtl red\nKd 1 0 0\nnewmtl grey\nKd .5 .5 .5\nnewmtl blue\nKd 0 0 1\n");
  const std::string corners = "mtllib some.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 2 0\nvt 0 0\n";
  // Beside colours of vertices those of materials are missed, greys are not.
  const std::string coloured = corners + "v 3 3 3 1 0 0\n";
  LoadedMesh m = mustRead(saveFile("a.obj", coloured + "usemtl red\nf 1/1 2/1 3/1\nusemtl grey\nf 1/1 3/1 4/1\n"));
  const MeshFinding* f = finding(m, "with a colour alone (material \"red\")");
  ASSERT_TRUE(f) << defects(m.diagnosis);
  EXPECT_EQ(f->count, 1u);
  m = mustRead(saveFile("a.obj", coloured + "usemtl red\nf 1 2 3\nusemtl blue\nf 1 3 4\nf 4 3 5\n"));
  f = finding(m, "with a colour alone (material \"blue\" and 1 more)");
  ASSERT_TRUE(f) << defects(m.diagnosis);
  EXPECT_EQ(f->count, 3u);
  for (const char* none : {"usemtl grey\nf 1/1 2/1 3/1\n", "usemtl a\nf 1/1 2/1 3/1\n", "f 1 2 3\n"}) {
    m = mustRead(saveFile("a.obj", corners + none));
    EXPECT_FALSE(finding(m, "image") || finding(m, "colour")) << none << defects(m.diagnosis);
  }
  m = mustRead(saveFile("a.obj", "mtllib none.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl m\nf 1 2 3\n"));
  ASSERT_TRUE(finding(m, "cannot be read (none.mtl)"));
  EXPECT_EQ(finding(m, "none.mtl")->done, "the result has no colour");
  EXPECT_EQ(m.named_files, std::vector<std::string>{(meshFolder() / "none.mtl").string()});

  auto ply = [](const char* images, const char* face, const char* values) {
    std::string text = std::string("ply\nformat ascii 1.0\n") + images +
                       "element vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty float s\n"
                       "property float t\nelement face 3\nproperty list uchar int vertex_indices\n" +
                       face + "end_header\n0 0 0 0 0\n1 0 0 1 0\n1 1 0 1 1\n0 0 1 0 1\n";
    for (const char* corners_of : {"3 0 1 2", "3 0 2 3", "3 0 3 1"}) {
      text += std::string(corners_of) + " " + std::string(values, std::strcspn(values, "|")) + "\n";
      values += std::min(std::strlen(values), std::strcspn(values, "|") + 1);
    }
    return text;
  };
  const char* two = "comment TextureFile a.png\ncomment TextureFile b.png\n";
  m = mustRead(saveFile("two.ply", ply(two, "property int texnumber\n", "1|0|1")));
  EXPECT_EQ(imagePath(m.mesh), (meshFolder() / "b.png").string());
  EXPECT_EQ(imagePath(m.mesh, 1), (meshFolder() / "a.png").string());
  EXPECT_EQ(m.mesh.image_of, (std::vector<uint16_t>{0, 1, 0}));
  EXPECT_FALSE(finding(m, "images")) << defects(m.diagnosis);
  m = mustRead(saveFile("two.ply", ply(two, "property int texnumber\n", "1|0|-1")));
  ASSERT_EQ(m.mesh.images.size(), 3u);
  EXPECT_EQ(m.mesh.image_of, (std::vector<uint16_t>{1, 0, 2})) << "a face without an image is grey";
  EXPECT_EQ(paletteOf(m.mesh), (std::vector<glm::u8vec3>{{204, 204, 204}}));
  m = mustRead(saveFile("two.ply", ply(two, "property int texnumber\n", "0|0|0")));
  EXPECT_EQ(imagePath(m.mesh), (meshFolder() / "a.png").string());
  EXPECT_FALSE(finding(m, "images")) << defects(m.diagnosis);
  m = mustRead(saveFile("two.ply", ply(two, "property int texnumber\n", "7|-1|2")));  // none of them
  EXPECT_TRUE(finding(m, "further images, without numbers")) << defects(m.diagnosis);
  m = mustRead(saveFile("two.ply", ply(two, "", "||")));
  EXPECT_EQ(imagePath(m.mesh), (meshFolder() / "a.png").string());
  EXPECT_TRUE(finding(m, "further images, without numbers")) << defects(m.diagnosis);
  EXPECT_EQ(m.named_files.size(), 2u);
  m = mustRead(saveFile("two.ply", ply("", "property uchar red\nproperty uchar green\nproperty uchar blue\n",
                                       "255 0 0|0 255 0|0 0 255")));
  f = finding(m, "faces with a colour of their own");
  ASSERT_TRUE(f) << defects(m.diagnosis);
  EXPECT_EQ(f->count, 3u);
}

// OBJ repeats its images unless a material says otherwise; where a format says nothing the border goes on.
TEST(MeshFormats, TextureCoordinatesOutsideTheImage) {
  saveFile("plain.mtl", "newmtl m\nmap_Kd a.png\n");
  saveFile("clamped.mtl", "newmtl m\nmap_Kd -clamp on a.png\n");
  for (const char* mtl : {"plain", "clamped", "none"}) {
    auto obj = [&](const char* far) {
      return mustRead(saveFile("a.obj", std::string("mtllib ") + mtl +
                                            ".mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt " + far +
                                            "\nusemtl m\nf 1/1 2/2 3/3\n"));
    };
    LoadedMesh m = obj("0 3.5");
    const bool repeats = m.mesh.images.empty() ? m.mesh.texture_repeats : m.mesh.images[0].repeats;
    EXPECT_EQ(repeats, std::string(mtl) != "clamped");
    EXPECT_EQ(m.mesh.images.empty(), std::string(mtl) == "none");
    const MeshFinding* f = finding(m, "triangles with texture coordinates outside the image");
    ASSERT_TRUE(f) << defects(m.diagnosis);
    EXPECT_EQ(f->count, 1u);
    EXPECT_EQ(f->places_mm.size(), 1u);
    EXPECT_EQ(f->done, repeats ? "the image is repeated" : "the image's border goes on");
    for (const char* within : {"0 1", "0 1.00005", "-0.00005 1"})
      EXPECT_FALSE(finding(obj(within), "outside")) << within;
    EXPECT_TRUE(finding(obj("-0.001 1"), "outside"));
  }
  const LoadedMesh off = mustRead(saveFile("a.off", "STOFF 3 1 0\n0 0 0 0 0\n1 0 0 2 0\n0 1 0 0 1\n3 0 1 2\n"));
  EXPECT_FALSE(off.mesh.texture_repeats);
  EXPECT_TRUE(finding(off, "outside"));
}

TEST(MeshFormats, Off) {
  Sample plain = scanOfCubeSphere(4), coloured = plain;
  decorate(coloured, 5);
  coloured.corner_uv.clear();
  for (bool binary : {false, true}) {
    expectSame(mustRead(saveFile("a.off", offFile(plain, binary))), plain, false, false);
    expectSame(mustRead(saveFile("a.off", offFile(coloured, binary))), coloured, true, false);
  }
  LoadedMesh m = mustRead(saveFile("a.off",
                                   "STCNOFF 3 1 0 # all of it\n0 0 0  0 0 1  1 0 0 1  0.25 0.5\n1 0 0  0 0 1  0 1 0 1  "
                                   "1 0\n0 1 0  0 0 1  0 0 1 1  0 1\n3 0 1 2"));
  ASSERT_EQ(m.mesh.corner_uv.size(), 1u);
  EXPECT_EQ(m.mesh.corner_uv[0][0], glm::vec2(0.25f, 0.5f));
  EXPECT_EQ(m.mesh.colours[1], glm::u8vec3(0, 255, 0));
}

// Every number behind the header's line turned around, as a program writes it that does not turn them.
TEST(MeshFormats, OffInLittleEndianOrder) {
  const Sample plain = scanOfCubeSphere(4);
  auto bytes = offFile(plain, true);
  size_t at = 0;
  while (bytes[at] != '\n') ++at;
  for (++at; at + 4 <= bytes.size(); at += 4)
    std::reverse(bytes.begin() + static_cast<std::ptrdiff_t>(at), bytes.begin() + static_cast<std::ptrdiff_t>(at + 4));
  LoadedMesh m = mustRead(saveFile("little.off", bytes));
  EXPECT_TRUE(finding(m, "little-endian"));
  m.diagnosis.findings.clear();
  expectSame(m, plain, false, false);
}

// Faces that end with their corners, as pmp-library writes them; a byte too few or a word too many is damage.
TEST(MeshFormats, OffWithoutCountsOfColours) {
  const Sample plain = scanOfCubeSphere(4);
  const auto whole = offFile(plain, true);
  const size_t faces = plain.triangles.size(), face_bytes = 5 * 4, kept = 4 * 4;
  std::string bytes = whole.substr(0, whole.size() - faces * face_bytes);
  for (size_t f = 0; f < faces; ++f) bytes += whole.substr(whole.size() - (faces - f) * face_bytes, kept);
  LoadedMesh m = mustRead(saveFile("short.off", bytes));
  EXPECT_TRUE(finding(m, "without counts of colours"));
  m.diagnosis.findings.clear();
  expectSame(m, plain, false, false);
  for (const int more : {-1, 4}) {
    std::string other = bytes;
    other.resize(static_cast<size_t>(static_cast<int64_t>(bytes.size()) + more));
    const auto refused = readMesh(saveFile("other.off", other), {});
    ASSERT_FALSE(refused.ok()) << more;
    EXPECT_EQ(refused.error().kind, ErrorKind::kInvalidData) << refused.error().text();
  }
}

TEST(MeshFormats, MaterialFilesLieInTheMeshsFolder) {
  namespace fs = std::filesystem;
  fs::create_directories(meshFolder() / "inner/deeper");
  saveFile("secret.mtl", "newmtl surface\nKd 1 0 0\n");
  saveFile("inner/deeper/near.mtl", "newmtl surface\nKd 1 0 0\n");
  fs::remove(meshFolder() / "inner/link.mtl");
  fs::create_symlink("../secret.mtl", meshFolder() / "inner/link.mtl");
  fs::remove(meshFolder() / "inner/inside.mtl");
  fs::create_symlink("deeper/near.mtl", meshFolder() / "inner/inside.mtl");
  auto obj = [](const std::string& library) {
    return "mtllib " + library + "\nusemtl surface\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
  };
  for (const std::string& outside :
       {std::string("../secret.mtl"), std::string("deeper/../../secret.mtl"), (meshFolder() / "secret.mtl").string(),
        std::string("link.mtl"), std::string("/etc/passwd")}) {
    const std::string path = saveFile("inner/a.obj", obj(outside));
    auto refused = readMesh(path);
    ASSERT_FALSE(refused) << outside;
    EXPECT_EQ(refused.error().kind, ErrorKind::kInvalidData);
    EXPECT_NE(refused.error().text().find(fs::path(outside).filename().string()), std::string::npos)
        << refused.error().text();
    EXPECT_NE(refused.error().hint.find("--allow-outside"), std::string::npos) << refused.error().text();
    EXPECT_TRUE(readMesh(path, {.allow_outside = true})) << outside;
  }
  for (const char* within : {"deeper/near.mtl", "inside.mtl", "./deeper/../deeper/near.mtl", "absent.mtl"})
    EXPECT_TRUE(readMesh(saveFile("inner/a.obj", obj(within)))) << within;
  // The same from within the folder, by names alone.
  const fs::path before = fs::current_path();
  fs::current_path(meshFolder() / "inner");
  for (const char* within : {"deeper/near.mtl", "inside.mtl", "absent.mtl"}) {
    saveFile("inner/a.obj", obj(within));
    EXPECT_TRUE(readMesh("a.obj")) << within;
  }
  for (const char* outside : {"../secret.mtl", "../absent.mtl", "link.mtl"}) {
    saveFile("inner/a.obj", obj(outside));
    EXPECT_FALSE(readMesh("a.obj")) << outside;
  }
  fs::current_path(before);
  EXPECT_FALSE(
      checkBesideMesh((meshFolder() / "inner/a.obj").string(), (meshFolder() / "picture.png").string(), "the image"));
  EXPECT_FALSE(checkBesideMesh((meshFolder() / "inner/a.obj").string(), (meshFolder() / "inner2/picture.png").string(),
                               "the image"));
  EXPECT_TRUE(checkBesideMesh((meshFolder() / "inner/a.obj").string(), (meshFolder() / "inner/picture.png").string(),
                              "the image"));
}

TEST(MeshFormats, Stl) {
  Sample s = scanOfCubeSphere(4);
  for (bool binary : {false, true}) {
    LoadedMesh m = mustRead(saveFile("a.stl", stlFile(s, binary)));
    EXPECT_EQ(m.diagnosis.vertices_read, 3 * s.triangles.size());
    EXPECT_EQ(m.diagnosis.vertices, s.positions.size());
    EXPECT_EQ(defects(m.diagnosis), "");
    EXPECT_EQ(m.diagnosis.border_loops, 0u);
    ASSERT_EQ(m.mesh.triangles.size(), s.triangles.size());
    for (size_t t = 0; t < s.triangles.size(); ++t)
      for (size_t k = 0; k < 3; ++k)
        ASSERT_EQ(glm::dvec3(m.mesh.positions_mm[m.mesh.triangles[t][k]]) + m.mesh.origin_mm,
                  s.positions[s.triangles[t][k]]);
  }
}

TEST(MeshFormats, PolygonsAreCutByEars) {
  // An arrow head whose fan from its first corner leaves it, by text and by binary; and a comb of 60 teeth.
  LoadedMesh m = mustRead(saveFile("a.off", "OFF\n4 1 0\n0 0 0\n4 -2 0\n1 0 0\n4 2 0\n4 3 0 1 2\n"));
  EXPECT_EQ(m.diagnosis.triangles_read, 2u);
  EXPECT_DOUBLE_EQ(area(m.mesh), 2);
  EXPECT_EQ(defects(m.diagnosis), "");
  std::string vertices, corners;
  constexpr int kTeeth = 30;
  for (int i = 0; i <= kTeeth; ++i) vertices += "v " + std::to_string(i) + " 0 " + std::to_string(i % 3) + "\n";
  for (int i = kTeeth; i >= 0; --i)
    vertices += "v " + std::to_string(i) + (i % 2 ? " 5 " : " 1 ") + std::to_string(i % 3) + "\n";
  for (int i = 1; i <= 2 * kTeeth + 2; ++i) corners += " " + std::to_string(i);
  m = mustRead(saveFile("a.obj", vertices + "f" + corners + "\n"));
  EXPECT_EQ(m.diagnosis.triangles_read, static_cast<uint64_t>(2 * kTeeth));
  double flat = 0;  // seen from above: the comb's area, each part once
  for (const auto& t : m.mesh.triangles) {
    glm::dvec3 a(m.mesh.positions_mm[t[0]]),
        n = glm::cross(glm::dvec3(m.mesh.positions_mm[t[1]]) - a, glm::dvec3(m.mesh.positions_mm[t[2]]) - a);
    flat += 0.5 * std::abs(n.z);
  }
  EXPECT_NEAR(flat, kTeeth * 3.0, 1e-4);
  // Negative control: the fan from corner 0 covers more.
  double fan = 0;
  std::vector<glm::dvec2> p;
  for (int i = 0; i <= kTeeth; ++i) p.emplace_back(i, 0);
  for (int i = kTeeth; i >= 0; --i) p.emplace_back(i, i % 2 ? 5 : 1);
  for (size_t k = 1; k + 1 < p.size(); ++k) {
    glm::dvec2 u = p[k] - p[0], v = p[k + 1] - p[0];
    fan += 0.5 * std::abs(u.x * v.y - u.y * v.x);
  }
  EXPECT_GT(fan, kTeeth * 3.0 + 1);
}

TEST(MeshFormats, LargeCoordinatesKeepTheirDetail) {
  // A coin of 24 mm whose place is told to 0.0625 um in a system 12 km away.
  const glm::dvec3 far(12345678.125, -9876543.5, 10000000);
  Sample s = scanOfCubeSphere(6, 12, far);
  struct File {
    const char* name;
    std::string bytes;
  };
  for (const File& f : {File{"far.ply", plyFile(s, {.coordinate = "double"})},
                        File{"far.ply", plyFile(s, {.encoding = Encoding::kAscii, .coordinate = "double"})},
                        File{"far.obj", objFile(s)}, File{"far.off", offFile(s)}, File{"far.stl", stlFile(s, false)}}) {
    SCOPED_TRACE(f.name);
    std::string path = saveFile(f.name, f.bytes);
    LoadedMesh m = mustRead(path);
    ASSERT_EQ(m.mesh.triangles.size(), s.triangles.size());
    double worst = 0;
    for (size_t t = 0; t < s.triangles.size(); ++t)
      for (size_t k = 0; k < 3; ++k)
        worst = std::max(worst, glm::length(glm::dvec3(m.mesh.positions_mm[m.mesh.triangles[t][k]]) + m.mesh.origin_mm -
                                            s.positions[s.triangles[t][k]]));
    EXPECT_LE(worst, 3e-6);  // floats of at most 42 mm
    EXPECT_LT(glm::length(m.mesh.origin_mm - far), 60);
    EXPECT_EQ(defects(m.diagnosis).find("degenerate"), std::string::npos);
    // Negative control: the floats that OpenMesh reads are a quarter of a millimetre off, or more.
    HalfEdges h;
    if (path.ends_with(".off"))
      continue;  // it does not know comments in OFF files: it goes on with counts that nobody set
    ASSERT_TRUE(OpenMesh::IO::read_mesh(h, path));
    double off = 0;
    for (auto v : h.vertices()) {
      auto p = h.point(v);
      double nearest = 1e30;
      for (const glm::dvec3& q : s.positions)
        nearest = std::min(nearest, glm::length(glm::dvec3(p[0], p[1], p[2]) - q));
      off = std::max(off, nearest);
    }
    EXPECT_GT(off, 0.2);
  }
  // A mesh around 0 keeps its very floats.
  Sample near = scanOfCubeSphere(3, 0.3);
  EXPECT_EQ(mustRead(saveFile("near.ply", plyFile(near, {}))).mesh.origin_mm, glm::dvec3(0));
}

TEST(MeshFormats, Units) {
  Sample s = scanOfCubeSphere(3, 2);
  LoadedMesh m = mustRead(saveFile("a.ply", plyFile(s, {})), {.mm_per_unit = 25.4});
  for (size_t i = 0; i < s.positions.size(); ++i)
    EXPECT_LT(glm::length(glm::dvec3(m.mesh.positions_mm[i]) + m.mesh.origin_mm - 25.4 * s.positions[i]), 1e-5);
  double low = 0, high = 0;
  for (const glm::dvec3& p : s.positions) low = std::min(low, p.x), high = std::max(high, p.x);
  EXPECT_NEAR(m.diagnosis.max_mm.x - m.diagnosis.min_mm.x, (high - low) * 25.4, 1e-4);
  auto bad = readMesh(saveFile("a.ply", plyFile(s, {})), {.mm_per_unit = 0});
  ASSERT_FALSE(bad.ok());
  EXPECT_EQ(bad.error().kind, ErrorKind::kUsage);
}

TEST(MeshFormats, FilesOfOpenMesh) {
  Sample s = scanOfCubeSphere(5);
  decorate(s, 17);
  HalfEdges h;
  h.request_vertex_colors();
  for (size_t i = 0; i < s.positions.size(); ++i) {
    auto v = h.add_vertex({static_cast<float>(s.positions[i].x), static_cast<float>(s.positions[i].y),
                           static_cast<float>(s.positions[i].z)});
    h.set_color(v, {s.colours[i].x, s.colours[i].y, s.colours[i].z});
  }
  for (const auto& t : s.triangles) h.add_face(h.vertex_handle(t[0]), h.vertex_handle(t[1]), h.vertex_handle(t[2]));
  using Options = OpenMesh::IO::Options;
  struct Case {
    const char* name;
    Options options;
    bool colours;
  };
  int read = 0;
  for (const Case& c : {Case{"om.ply", Options(Options::VertexColor), true},
                        Case{"om.ply", Options(Options::VertexColor | Options::Binary), true},
                        Case{"om.ply", Options(Options::VertexColor | Options::Binary | Options::MSB), true},
                        Case{"om.ply", Options(Options::VertexColor | Options::ColorFloat), true},
                        Case{"om.off", Options(Options::VertexColor), true}, Case{"om.off", Options(), false},
                        Case{"om.obj", Options(), false}, Case{"om.stl", Options(), false},
                        Case{"om.stl", Options(Options::Binary), false}}) {
    SCOPED_TRACE(c.name);
    std::string path = meshFolder() / c.name;
    omlog().disable();
    ASSERT_TRUE(OpenMesh::IO::write_mesh(h, path, c.options, 17));
    LoadedMesh m = mustRead(path);
    ++read;
    if (std::string(c.name) == "om.stl") {  // its vertices come in another order
      EXPECT_EQ(m.diagnosis.vertices, s.positions.size());
      EXPECT_EQ(m.diagnosis.border_loops, 0u);
      EXPECT_NEAR(signedVolume(m.mesh) / signedVolume(toMesh(s)), 1, 1e-5);
      continue;
    }
    Sample expected = s;
    expected.corner_uv.clear();
    if (!c.colours) expected.colours.clear();
    expectSame(m, expected, c.colours, false);
  }
  EXPECT_EQ(read, 9);
}

// ---- refusals ----

void expectRefused(const std::string& path, ErrorKind kind, const std::string& part) {
  auto read = readMesh(path);
  ASSERT_FALSE(read.ok()) << path << " was read, expected: " << part;
  EXPECT_EQ(read.error().kind, kind) << read.error().text();
  EXPECT_NE(read.error().text().find(part), std::string::npos) << read.error().text();
  EXPECT_NE(read.error().text().find(path), std::string::npos) << read.error().text();
}

// Blender 2.4 left out the word "comment".
TEST(MeshFormats, PlyHeadersMaySayWhoMadeThem) {
  const std::string elements =
                        "element vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face "
                        "1\nproperty list uchar int "
                        "vertex_indices\n",
                    body = "end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
                    by = "Created by Blender3D 247 - www.blender.org, source file: \n";
  const LoadedMesh m = mustRead(saveFile("a.ply", "ply\nformat ascii 1.0\n" + by + elements + body));
  EXPECT_EQ(m.mesh.triangles.size(), 1u);
  const MeshFinding* f = finding(m, "header lines that are no part of it (\"Created by Blender3D 247");
  ASSERT_TRUE(f) << defects(m.diagnosis);
  EXPECT_EQ(f->count, 1u);
  // Elsewhere such a line is taken for damage.
  expectRefused(saveFile("a.ply", "ply\nformat ascii 1.0\n" + elements + by + body), ErrorKind::kInvalidData,
                "expected a line of a PLY header");
  expectRefused(saveFile("a.ply", "ply\n" + by + "format ascii 1.0\n" + elements + body), ErrorKind::kInvalidData,
                "expected a line of a PLY header");
}

TEST(MeshRefusals, SayWhatIsWrongAndWhere) {
  const ErrorKind invalid = ErrorKind::kInvalidData;
  const std::string head =
      "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face "
      "1\nproperty list uchar int vertex_indices\nend_header\n";
  for (const char* bad : {"nan", "inf", "-inf"}) {
    expectRefused(saveFile("a.ply", head + "0 0 0\n1 0 0\n0 " + bad + " 0\n3 0 1 2\n"), invalid,
                  "vertex 2 (from 0): expected y to be a finite number");
    expectRefused(saveFile("a.obj", std::string("v 0 0 0\nv 1 0 ") + bad + "\nv 0 1 0\nf 1 2 3\n"), invalid,
                  "vertex 1 (from 0): expected z");
    expectRefused(saveFile("a.off", std::string("OFF\n3 1 0\n") + bad + " 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"), invalid,
                  "vertex 0 (from 0): expected x");
  }
  Sample s = scanOfCubeSphere(2), nan = s;
  nan.positions[4].z = std::nan("");
  expectRefused(saveFile("a.ply", plyFile(nan, {})), invalid, "vertex 4 (from 0): expected z to be a finite number");
  expectRefused(saveFile("a.stl", stlFile(nan, true)), invalid, "expected finite coordinates");
  expectRefused(saveFile("a.ply", head + "0 0 0\n1 0 0\n0 1e13 0\n3 0 1 2\n"), invalid, "within 10^12 mm of 0");
  expectRefused(saveFile("a.ply", head + "0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n"), invalid,
                "face 0 names vertex 3, there are 3");
  expectRefused(saveFile("a.ply", head + "0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n"), invalid, "face 0 names vertex -1");
  expectRefused(saveFile("a.ply", head + "0 0 0\n1 0 0\n0 1 0\n3 0 1 1.5\n"), invalid, "face 0 names vertex 1.5");
  expectRefused(saveFile("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 9\n"), invalid,
                "face 2 names vertex 9, there are 3");
  expectRefused(saveFile("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -4\n"), invalid, "face 1 (line 4) names vertex -4");
  expectRefused(saveFile("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 2 3\n"), invalid, "face 1 (line 4) names vertex 0");
  for (const char* with_uv :
       {"f 1/1 2/1 3/1\nvt 0 0\n", "vt 0 0\nf 1/1 2/1 3/2\n", "f 1/-1 2/-1 3/-1\n", "f 1/0 2/0 3/0\n"})
    expectRefused(saveFile("a.obj", std::string("v 0 0 0\nv 1 0 0\nv 0 1 0\n") + with_uv), invalid,
                  "names texture coordinates");
  expectRefused(saveFile("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 5\n"), invalid, "face 0 names vertex 5");
  expectRefused(saveFile("a.ply", head + "0 0 0\n1 0 0\n0 one 0\n3 0 1 2\n"), invalid, "\"one\" in line 12");
  expectRefused(saveFile("a.ply", head + "0 0 0\n1 0 0\n"), invalid, "bytes left in the file");
  expectRefused(saveFile("a.ply", head + "0 0 0\n1 0 0\n0 1 0\n"), invalid, "bytes left in the file");
  expectRefused(saveFile("a.ply", head + "0 0 0\n1 0 0\n0 1 0\n2 0 1"), invalid, "found no triangle");
  for (const char* name : {"a.ply", "a.obj", "a.off", "a.stl"}) {
    expectRefused(saveFile(name, ""), invalid, "expected");
    expectRefused(saveFile(name, "This is a letter to the museum.\n"), invalid, "expected");
    expectRefused(saveFile(name, std::string(2000, '\0')), invalid, "expected");
  }
  expectRefused(saveFile("a.xyz", "0 0 0\n"), ErrorKind::kUnsupported, ".ply, .obj, .stl, .off, .glb or .gltf");
  expectRefused(saveFile("a.off", "4OFF\n3 1 0\n"), ErrorKind::kUnsupported, "three coordinates");
  expectRefused((meshFolder() / "none.ply").string(), ErrorKind::kIo, "none.ply");
  std::string text = stlFile(s, false);
  expectRefused(saveFile("a.stl", text.substr(0, text.size() / 2)), invalid, "truncated");
  std::string binary = stlFile(s, true, "made by a test");
  expectRefused(saveFile("a.stl", binary.substr(0, binary.size() / 2)), invalid, "triangles stated");
}

TEST(MeshFormats, FacesOfOffMayGoOnOverSeveralLines) {
  const std::string vertices = "0 0 0\n4 0 0\n4 4 0\n0 4 0\n2 6 0\n";
  const LoadedMesh one = mustRead(saveFile("a.off", "OFF\n5 2 0\n" + vertices + "4 0 1 2 3\n3 3 2 4\n"));
  EXPECT_DOUBLE_EQ(area(one.mesh), 20);
  for (const char* faces :
       {"4 0 1 \n2\n3\n\n3 3 2 4\n", "4\r\n0 1 2 3\r\n3\r\n3\r\n2\r\n4",
        "4 0 1 # half of it\n# a comment\n2 3\n3 3 2 4 255 0 0\n", "4 0 1 2 3 0.5 0.5 0.5\n3 3 2\n4\n"}) {
    const LoadedMesh several = mustRead(saveFile("a.off", "OFF\n5 2 0\n" + vertices + faces));
    EXPECT_EQ(several.mesh.triangles, one.mesh.triangles) << faces;
    EXPECT_EQ(several.mesh.positions_mm, one.mesh.positions_mm) << faces;
  }
  // Controls: a corner too few is told from a face that goes on, wherever it lacks.
  for (const auto& [faces, message] :
       {std::pair{"4 0 1 2\n3 3 2 4\n",
                  "expected 4 corners of face 0, found \"3\" behind them in line 9, the first in line 8"},
        std::pair{"4 0 1 2 3\n3 3 2\n\n\n",
                  "expected 3 corners of face 1, found the end of the file behind 2, the first in line 9"},
        std::pair{"4 0 1 2 3\n3 3 2\n",
                  "expected 3 corners of face 1, found 4 bytes left in the file behind their count in line 9"},
        std::pair{"4 0 1\n2 x\n3 3 2 4\n", "expected 4 corners of face 0, found \"x\" in line 9"}})
    expectRefused(saveFile("a.off", "OFF\n5 2 0\n" + vertices + faces), ErrorKind::kInvalidData, message);
}

TEST(MeshColours, BlackOfAllVerticesOfAPlyIsNone) {
  const std::string head =
      "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty uchar "
      "red\nproperty uchar green\nproperty uchar blue\nelement face 1\nproperty list uchar int "
      "vertex_indices\nend_header\n";
  for (const bool black : {true, false}) {
    const auto read = readMesh(
        saveFile("black.ply", head + "0 0 0 0 0 0\n1 0 0 0 0 0\n0 1 0 0 0 " + (black ? "0" : "1") + "\n3 0 1 2\n"));
    ASSERT_TRUE(read.ok()) << read.error().text();
    EXPECT_EQ(read->mesh.colours.empty(), black);
    EXPECT_EQ(finding(*read, "black") != nullptr, black);
  }
}

// One in a hundred is a program's slip, more are damage.
TEST(MeshRepair, AFewVerticesThatAreNoNumbersAreDroppedWithTheirTriangles) {
  const Sample sound = scanOfCubeSphere(8);
  const size_t few = sound.positions.size() / 100;
  ASSERT_GE(few, 2u);
  Sample s = sound;
  for (size_t i = 0; i < few; ++i)
    s.positions[7 + 40 * i][static_cast<glm::length_t>(i % 3)] = i % 2 ? HUGE_VAL : std::nan("");
  std::set<uint32_t> bad;
  for (size_t i = 0; i < few; ++i) bad.insert(static_cast<uint32_t>(7 + 40 * i));
  const auto read = readMesh(saveFile("few.ply", plyFile(s, {})));
  const auto whole = readMesh(saveFile("sound.ply", plyFile(sound, {})));
  ASSERT_TRUE(read.ok() && whole.ok());
  uint64_t lost = 0;
  for (const auto& t : whole->mesh.triangles)
    lost += std::any_of(t.begin(), t.end(), [&](uint32_t v) {
      const glm::dvec3 p = whole->mesh.origin_mm + glm::dvec3(whole->mesh.positions_mm[v]);
      return std::any_of(bad.begin(), bad.end(),
                         [&](uint32_t b) { return glm::length(p - sound.positions[b]) < 1e-5; });
    });
  EXPECT_GT(lost, 3 * few);
  EXPECT_EQ(read->diagnosis.triangles, whole->diagnosis.triangles - lost);
  EXPECT_EQ(read->diagnosis.border_loops, few);
  const auto& findings = read->diagnosis.findings;
  const auto found = std::find_if(findings.begin(), findings.end(),
                                  [](const MeshFinding& f) { return f.what.find("no numbers") != std::string::npos; });
  ASSERT_NE(found, findings.end());
  EXPECT_EQ(found->count, few);
  EXPECT_EQ(found->done, "dropped with their " + std::to_string(lost) + " triangles");
  s.positions[3].x = std::nan("");
  expectRefused(saveFile("more.ply", plyFile(s, {})), ErrorKind::kInvalidData, "to be a finite number");
}

TEST(MeshRefusals, BadVerticesAreCounted) {
  auto refused = [](const char* vertices) {
    const auto r = readMesh(saveFile("a.obj", std::string(vertices) + "f 1 2 3\n"));
    EXPECT_FALSE(r.ok());
    return r.ok() ? Error{} : r.error();
  };
  Error e = refused("v 0 0 0\nv nan 0 0\nv 0 inf 0\nv 0 0 1e99\n");
  EXPECT_NE(e.message.find("vertex 1 (from 0)"), std::string::npos) << e.text();
  EXPECT_NE(e.message.find("2 more vertices are like that"), std::string::npos) << e.text();
  EXPECT_EQ(e.hint.find("--unit"), std::string::npos) << "no unit makes a number of it";
  e = refused("v 0 0 0\nv 1 0 0\nv 0 0 1e99\n");
  EXPECT_EQ(e.message.find("like that"), std::string::npos) << e.text();
  EXPECT_NE(e.hint.find("--unit"), std::string::npos) << e.text();
}

TEST(MeshRefusals, CountsAreCheckedBeforeAnythingIsAllocated) {
  for (const char* format : {"ascii", "binary_little_endian", "binary_big_endian"}) {
    std::string head = std::string("ply\nformat ") + format +
                       " 1.0\nelement vertex 1000000000\nproperty float x\nproperty float y\nproperty float z\nelement "
                       "face 1\nproperty list uchar int vertex_indices\nend_header\n";
    expectRefused(saveFile("a.ply", head + "0 0 0\n"), ErrorKind::kInvalidData,
                  "expected 1000000000 elements \"vertex\"");
  }
  expectRefused(saveFile("a.off", "OFF\n1000000000 1 0\n0 0 0\n"), ErrorKind::kInvalidData,
                "expected 1000000000 vertices");
  expectRefused(saveFile("a.off", "OFF\n3 18446744073709551615 0\n0 0 0\n"), ErrorKind::kInvalidData,
                "18446744073709551615 faces");
  expectRefused(saveFile("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n1000000000 0 1 2\n"), ErrorKind::kInvalidData,
                "1000000000 corners of face 0");
}

TEST(MeshRefusals, Interrupted) {
  std::atomic<bool> stop{true};
  auto read = readMesh(saveFile("a.ply", plyFile(scanOfCubeSphere(3), {})), {.interrupted = &stop});
  ASSERT_FALSE(read.ok());
  EXPECT_EQ(read.error().kind, ErrorKind::kInterrupted);
  // Between any two reports of progress, too.
  for (int steps = 1; steps < 50; ++steps) {
    int left = steps;
    stop = false;
    double last = 0;
    auto again = readMesh(saveFile("a.ply", plyFile(scanOfCubeSphere(3), {})), {.progress =
                                                                                    [&](double done) {
                                                                                      EXPECT_GE(done, last);
                                                                                      EXPECT_LE(done, 1);
                                                                                      last = done;
                                                                                      if (--left == 0) stop = true;
                                                                                    },
                                                                                .interrupted = &stop});
    if (again.ok()) {
      EXPECT_EQ(last, 1);
      EXPECT_GT(steps, 3);
      return;
    }
    EXPECT_EQ(again.error().kind, ErrorKind::kInterrupted);
  }
  FAIL() << "never finished";
}

// Within the long steps, too: they end where they are, and say so.
TEST(MeshRefusals, InterruptedWithinAStep) {
  TriMesh mesh = mustRead(saveFile("a.ply", plyFile(scanOfCubeSphere(20), {}))).mesh;
  std::swap(mesh.triangles[7][0], mesh.triangles[7][1]);  // something to turn
  const auto before = mesh.triangles;
  const std::atomic<bool> stop{true}, go_on{false};
  EXPECT_TRUE(std::ranges::all_of(takeCensus(mesh, &stop).mate, [](uint32_t m) { return m == kNoHalfEdge; }));
  EdgeCensus census = takeCensus(mesh, &go_on);
  EXPECT_LT(findPieces(mesh, census.mate, &stop).order.size(), before.size());
  EXPECT_EQ(findPieces(mesh, census.mate, &go_on).order.size(), before.size());
  Turned turned = findTurns(mesh, census, &stop);
  EXPECT_TRUE(turned.triangles.empty());
  turnOver(mesh, census, turned);
  EXPECT_EQ(mesh.triangles, before);
  turned = findTurns(mesh, census, &go_on);
  EXPECT_EQ(turned.triangles.size(), 1u);
  turnOver(mesh, census, turned);
  EXPECT_NE(mesh.triangles, before);
  EXPECT_FALSE(oneFanAVertex(mesh, census.mate, &stop));
  EXPECT_TRUE(oneFanAVertex(mesh, census.mate, &go_on));
  std::vector<uint32_t> split;
  EXPECT_FALSE(splitFans(mesh, census, split, &stop));
  EXPECT_TRUE(splitFans(mesh, census, split, &go_on));
}

// ---- repairs ----

TEST(MeshRepairs, ASoundMeshStaysAsItIs) {
  for (const Sample& s : {scanOfCubeSphere(6), sheet(5, 4)}) {
    TriMesh m = toMesh(s);
    LoadedMesh r = mustRepair(m);
    EXPECT_EQ(defects(r.diagnosis), "");
    EXPECT_EQ(r.mesh.triangles, m.triangles);
    EXPECT_EQ(r.mesh.positions_mm, m.positions_mm);
    expectManifold(r);
  }
}

TEST(MeshRepairs, DuplicateVerticesAreWelded) {
  Sample s = scanOfCubeSphere(5), loose;
  for (const auto& t : s.triangles)
    for (uint32_t v : t) {
      if (v % 3 == 0) loose.positions.push_back(s.positions[v] + glm::dvec3(-0.0));
      else loose.positions.push_back(s.positions[v]);
    }
  for (uint32_t t = 0; t < s.triangles.size(); ++t) loose.triangles.push_back({3 * t, 3 * t + 1, 3 * t + 2});
  LoadedMesh r = mustRepair(toMesh(loose));
  EXPECT_EQ(found(r.diagnosis, "duplicate vertices"), 3 * s.triangles.size() - s.positions.size());
  EXPECT_EQ(r.diagnosis.vertices, s.positions.size());
  EXPECT_EQ(r.diagnosis.border_loops, 0u);
  EXPECT_EQ(defects(r.diagnosis), "duplicate vertices; ");
  expectManifold(r);
  // Control: vertices that differ by one bit are no duplicates.
  TriMesh m = toMesh(loose);
  m.positions_mm[0].x = std::nextafter(m.positions_mm[0].x, 1e9f);
  EXPECT_EQ(found(mustRepair(m).diagnosis, "duplicate vertices"), 3 * s.triangles.size() - s.positions.size() - 1);
  // Zeros of either sign are one place.
  Sample zeros{
      {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {-0.0, 0, -0.0}, {0, -1, 0}, {1, -0.0, 0}}, {{0, 1, 2}, {3, 4, 5}}, {}, {}};
  EXPECT_EQ(found(mustRepair(toMesh(zeros)).diagnosis, "duplicate vertices"), 2u);
}

TEST(MeshRepairs, DegenerateAndDuplicateTrianglesAreDropped) {
  Sample s = scanOfCubeSphere(3);
  size_t sound = s.triangles.size();
  s.triangles.push_back({0, 0, 1});
  s.triangles.push_back({2, 2, 2});
  auto first = s.triangles[5];
  s.triangles.push_back(first);
  s.triangles.push_back({first[1], first[2], first[0]});
  s.triangles.push_back({first[1], first[0], first[2]});  // the other way round
  decorate(s, 1);
  auto uv = s.corner_uv;
  // The first degenerate one is moved before all others, which then move up.
  TriMesh m = toMesh(s);
  std::rotate(m.triangles.begin(), m.triangles.begin() + static_cast<std::ptrdiff_t>(sound), m.triangles.end());
  std::rotate(m.corner_uv.begin(), m.corner_uv.begin() + static_cast<std::ptrdiff_t>(sound), m.corner_uv.end());
  m.images.resize(m.triangles.size());
  for (size_t t = 0; t < m.triangles.size(); ++t) m.image_of.push_back(static_cast<uint16_t>(t));
  const LoadedMesh moved = mustRepair(m);
  ASSERT_EQ(moved.mesh.image_of.size(), sound);
  for (size_t t = 0; t < sound; ++t)
    EXPECT_EQ(moved.mesh.corner_uv[t], m.corner_uv[moved.mesh.image_of[t]]) << "image and coordinates move together";
  LoadedMesh r = mustRepair(toMesh(s));
  EXPECT_EQ(found(r.diagnosis, "degenerate triangles"), 2u);
  EXPECT_EQ(found(r.diagnosis, "duplicate triangles"), 3u);
  EXPECT_EQ(r.mesh.triangles.size(), sound);
  EXPECT_EQ(defects(r.diagnosis), "degenerate triangles; duplicate triangles; ");
  uv.resize(sound);
  EXPECT_EQ(r.mesh.corner_uv, uv);
  expectManifold(r);
  auto none = repairMesh(toMesh({{{0, 0, 0}, {1, 0, 0}, {2, 0, 0}}, {{0, 1, 2}}, {}, {}}), "line");
  ASSERT_FALSE(none.ok());
  EXPECT_EQ(none.error().kind, ErrorKind::kInvalidData);
}

TEST(MeshRepairs, FlippedTrianglesTurnAsTheirPiece) {
  for (uint32_t seed = 1; seed <= 20; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937 random(seed);
    Sample s = seed % 2 ? scanOfCubeSphere(6) : sheet(7, 5);
    decorate(s, seed);
    TriMesh m = toMesh(s);
    size_t flipped = 0;
    for (size_t t = 0; t < m.triangles.size(); ++t)
      if (random() % 10 < 3) {
        std::swap(m.triangles[t][0], m.triangles[t][2]);
        std::swap(m.corner_uv[t][0], m.corner_uv[t][2]);
        ++flipped;
      }
    LoadedMesh r = mustRepair(m);
    EXPECT_EQ(found(r.diagnosis, "flipped triangles"), flipped);
    EXPECT_EQ(defects(r.diagnosis), "flipped triangles; ");
    expectManifold(r);
    for (size_t t = 0; t < m.triangles.size(); ++t)
      for (size_t k = 0; k < 3; ++k) {
        size_t was = 0;
        while (s.triangles[t][was] != r.mesh.triangles[t][k]) ++was;
        ASSERT_EQ(r.mesh.corner_uv[t][k], s.corner_uv[t][was]);
      }
    if (seed % 2) {
      EXPECT_NEAR(signedVolume(r.mesh), signedVolume(toMesh(s)), 1);
    }
    // Control: OpenMesh refuses faces of what it was.
    EXPECT_GT(seenByOpenMesh(m).refused, 0u);
  }
}

TEST(MeshRepairs, ClosedPiecesFaceOutwards) {
  Sample s = scanOfCubeSphere(4, 10, {100, 0, 0}), other = scanOfCubeSphere(4, 10, {-100, 0, 0});
  for (auto& t : s.triangles) std::swap(t[1], t[2]);
  append(s, other);
  LoadedMesh r = mustRepair(toMesh(s));
  EXPECT_EQ(found(r.diagnosis, "closed pieces inside out"), 1u);
  EXPECT_EQ(defects(r.diagnosis), "closed pieces inside out; ");
  EXPECT_NEAR(signedVolume(r.mesh) / (2 * signedVolume(toMesh(other))), 1, 1e-4);
  EXPECT_EQ(r.diagnosis.pieces, 2u);
  EXPECT_EQ(found(r.diagnosis, "isolated pieces"), 1u);
  // Control: an open piece has no outside; most of its triangles decide.
  Sample open = sheet(4, 4);
  for (auto& t : open.triangles) std::swap(t[1], t[2]);
  EXPECT_EQ(defects(mustRepair(toMesh(open)).diagnosis), "");
}

// But for a hole of few triangles, or two of them; not where a quarter of the ball is missing, nor as a sheet that
// waves.
TEST(MeshRepairs, PiecesThatAreClosedButForSmallHolesFaceOutwards) {
  constexpr const char* kWithHoles = "pieces inside out that are closed but for small holes";
  for (const bool turned : {false, true})
    for (const int missing : {1, 2, 3}) {
      Sample s = scanOfCubeSphere(8, 10, {1000, 0, 0});
      const double above = missing == 3 ? 0.25 : 0.95;
      std::erase_if(s.triangles, [&](const std::array<uint32_t, 3>& t) {
        const glm::dvec3 p = (s.positions[t[0]] + s.positions[t[1]] + s.positions[t[2]]) / 3.0 - glm::dvec3(1000, 0, 0);
        const double up = p.z / glm::length(p);
        return up > above || (missing == 2 && -up > above);
      });
      if (turned)
        for (auto& t : s.triangles) std::swap(t[1], t[2]);
      const LoadedMesh r = mustRepair(toMesh(s));
      const bool turns = turned && missing < 3;
      EXPECT_EQ(found(r.diagnosis, kWithHoles), turns ? 1u : 0u) << missing;
      const double outwards = turned && !turns ? -1 : 1;
      glm::dvec3 facing(0);  // how far each triangle faces away from the ball's centre
      for (const auto& t : r.mesh.triangles) {
        auto at = [&](size_t k) {
          return r.mesh.origin_mm + glm::dvec3(r.mesh.positions_mm[t[k]]) - glm::dvec3(1000, 0, 0);
        };
        facing.x += glm::dot(glm::cross(at(1) - at(0), at(2) - at(0)), at(0)) > 0 ? 1 : -1;
      }
      EXPECT_EQ(facing.x, outwards * static_cast<double>(r.mesh.triangles.size())) << missing << turned;
    }
}

Sample ring(int n, bool twisted) {
  Sample s;
  for (int i = 0; i < n; ++i) {
    double a = 2 * M_PI * i / n, twist = twisted ? a / 2 : 0.3;
    for (double w : {-1.0, 1.0})
      s.positions.emplace_back((10 + w * std::cos(twist)) * std::cos(a), (10 + w * std::cos(twist)) * std::sin(a),
                               w * std::sin(twist));
  }
  for (int i = 0; i < n; ++i) {
    auto a = static_cast<uint32_t>(2 * i), b = a + 1, c = static_cast<uint32_t>(2 * ((i + 1) % n)), d = c + 1;
    if (twisted && i == n - 1) std::swap(c, d);
    s.triangles.push_back({a, c, d});
    s.triangles.push_back({a, d, b});
  }
  return s;
}

constexpr const char* kOneSided = "pieces with one side only, as a Moebius strip has";

TEST(MeshRepairs, AMoebiusStripIsCutOpen) {
  for (const bool turned : {false, true}) {
    TriMesh m = toMesh(ring(40, true));
    if (turned)
      for (size_t t = 0; t < m.triangles.size(); t += 3) std::swap(m.triangles[t][1], m.triangles[t][2]);
    LoadedMesh r = mustRepair(m);
    EXPECT_EQ(found(r.diagnosis, kOneSided), 1u);
    EXPECT_EQ(defects(r.diagnosis), "flipped triangles; " + std::string(kOneSided) + "; ");
    EXPECT_EQ(r.mesh.triangles.size(), m.triangles.size());
    EXPECT_EQ(r.mesh.positions_mm.size(), m.positions_mm.size() + 2) << "across the strip, where it was cut";
    EXPECT_EQ(r.diagnosis.pieces, 1u);
    EXPECT_EQ(r.diagnosis.border_loops, 1u) << "of what can be laid flat";
    expectManifold(r);
  }
  // Control: a ring without the twist stays as it is, and has two borders.
  LoadedMesh plain = mustRepair(toMesh(ring(40, false)));
  EXPECT_EQ(defects(plain.diagnosis), "");
  EXPECT_EQ(plain.diagnosis.border_loops, 2u);
  expectManifold(plain);
}

// A box of two triangles a side, from corner a to corner b, its vertices shared by place through repairMesh.
Sample box(glm::dvec3 a, glm::dvec3 b) {
  Sample s;
  for (int i = 0; i < 8; ++i) s.positions.emplace_back(i & 1 ? b.x : a.x, i & 2 ? b.y : a.y, i & 4 ? b.z : a.z);
  for (std::array<uint32_t, 4> q :
       {std::array<uint32_t, 4>{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}}) {
    s.triangles.push_back({q[0], q[1], q[2]});
    s.triangles.push_back({q[0], q[2], q[3]});
  }
  return s;
}

TEST(MeshRepairs, BodiesThatTouchAtAVertexOrAnEdgeComeApart) {
  for (bool edge : {false, true})
    for (bool inside_out : {false, true}) {
      Sample s = box({0, 0, 0}, {1, 1, 1}), other = box({1, 1, edge ? 0 : 1}, {2, 2, edge ? 1 : 2});
      if (inside_out)
        for (auto& t : other.triangles) std::swap(t[1], t[2]);
      append(s, other);
      LoadedMesh r = mustRepair(toMesh(s));
      EXPECT_EQ(r.diagnosis.pieces, 2u);
      EXPECT_EQ(r.diagnosis.border_loops, 0u);
      EXPECT_EQ(r.diagnosis.vertices, 16u);
      EXPECT_NEAR(signedVolume(r.mesh), 12, 1e-6);
      EXPECT_EQ(found(r.diagnosis, "non-manifold edges"), edge ? 1u : 0u);
      EXPECT_EQ(found(r.diagnosis, "non-manifold vertices"), edge ? 0u : 1u);
      EXPECT_EQ(found(r.diagnosis, "closed pieces inside out"), inside_out ? 1u : 0u);
      expectManifold(r);
    }
  // Control: bodies that do not touch.
  Sample apart = box({0, 0, 0}, {1, 1, 1});
  append(apart, box({3, 3, 3}, {4, 4, 4}));
  EXPECT_EQ(defects(mustRepair(toMesh(apart)).diagnosis), "");
  // Control: OpenMesh and the checker see what is wrong before.
  Sample s = box({0, 0, 0}, {1, 1, 1}), other = box({1, 1, 0}, {2, 2, 1});
  append(s, other);
  TriMesh m = toMesh(s);
  for (auto& t : m.triangles)
    for (uint32_t& v : t) v = v == 8 ? 3 : v == 12 ? 7 : v;  // the edge that both have
  EXPECT_NE(triMeshProblem(m).find("more than two triangles share the edge"), std::string::npos);
  EXPECT_GT(seenByOpenMesh(m).refused, 0u);
}

TEST(MeshRepairs, SheetsAtNonManifoldEdges) {
  // A fin on a sheet becomes a sheet of its own, from either side and with its triangles either way.
  for (double up : {1.0, -1.0})
    for (bool turned : {false, true}) {
      Sample s = sheet(4, 4);
      auto base = static_cast<uint32_t>(s.positions.size());
      for (uint32_t x = 0; x < 4; ++x) s.positions.emplace_back(x + 0.5, 2, up);
      for (uint32_t x = 1; x < 3; ++x) {
        uint32_t a = 2 * 5 + x, b = a + 1;
        s.triangles.push_back(turned ? std::array<uint32_t, 3>{b, a, base + x}
                                     : std::array<uint32_t, 3>{a, b, base + x});
      }
      s.positions.resize(base + 3);
      LoadedMesh r = mustRepair(toMesh(s));
      EXPECT_EQ(found(r.diagnosis, "non-manifold edges"), 2u);
      EXPECT_EQ(r.mesh.triangles.size(), 34u);
      expectManifold(r);
      // The sheet is whole: one piece of 32 triangles with one border.
      EXPECT_EQ(r.diagnosis.border_loops, r.diagnosis.pieces);
      TriMesh flat = r.mesh;
      flat.triangles.resize(32);
      EXPECT_EQ(seenByOpenMesh(flat).border_loops, 1u);
    }
  // Two sheets that cross in a line of edges: two sheets.
  Sample cross = sheet(2, 2), wall = sheet(2, 2);
  for (auto& p : wall.positions) p = {p.x, 1, p.y - 1};
  append(cross, wall);
  LoadedMesh r = mustRepair(toMesh(cross));
  EXPECT_EQ(found(r.diagnosis, "non-manifold edges"), 2u);
  EXPECT_EQ(r.diagnosis.pieces, 2u);
  EXPECT_EQ(r.diagnosis.border_loops, 2u);
  expectManifold(r);
  // A wall inside a body: the body stays closed.
  Sample walled = box({0, 0, 0}, {1, 1, 1});
  walled.triangles.push_back({0, 1, 7});
  walled.triangles.push_back({0, 7, 6});
  r = mustRepair(toMesh(walled));
  expectManifold(r);
  EXPECT_EQ(r.diagnosis.pieces, 2u);
  EXPECT_EQ(r.diagnosis.border_loops, 1u);
}

TEST(MeshRepairs, ASheetThatCurlsUpToTouchItself) {
  // A strip along a spiral whose second turn touches an edge of its first: one fan holds both at either end of that
  // edge.
  Sample s;
  for (uint32_t i = 0; i < 12; ++i)
    for (double y : {0.0, 1.0})
      s.positions.emplace_back((5 + i * 0.3) * std::cos(i * 0.7), y, (5 + i * 0.3) * std::sin(i * 0.7));
  s.positions[2 * 11] = s.positions[2 * 3];
  s.positions[2 * 11 + 1] = s.positions[2 * 3 + 1];
  for (uint32_t i = 0; i + 1 < 12; ++i) {
    s.triangles.push_back({2 * i, 2 * i + 2, 2 * i + 3});
    s.triangles.push_back({2 * i, 2 * i + 3, 2 * i + 1});
  }
  LoadedMesh r = mustRepair(toMesh(s));
  EXPECT_EQ(found(r.diagnosis, "non-manifold edges"), 1u);
  EXPECT_EQ(r.diagnosis.pieces, 1u);
  EXPECT_EQ(r.diagnosis.triangles, 22u);
  expectManifold(r);
  // Closed into one fan at both ends of the edge: three pages that hang together at top and bottom.
  Sample pages;
  pages.positions = {{0, 0, 0}, {0, 1, 0}, {0, 2, 0}, {0, -1, 0}};
  for (int k = 0; k < 3; ++k) pages.positions.emplace_back(std::cos(2 * k), 0.5, std::sin(2 * k));
  for (uint32_t k = 0; k < 3; ++k) {
    pages.triangles.push_back({0, 1, 4 + k});
    pages.triangles.push_back({1, 2, 4 + k});
    pages.triangles.push_back({3, 0, 4 + k});
  }
  expectManifold(mustRepair(toMesh(pages)));
}

TEST(MeshRepairs, TJunctionsAreClosed) {
  // One quad of side 4 beside a sheet of 1 x 4: three vertices lie on its edge.
  Sample s = sheet(1, 4);
  append(s, {{{1, 0, 0}, {5, 0, 0}, {5, 4, 0}, {1, 4, 0}}, {{0, 1, 2}, {0, 2, 3}}, {}, {}});
  decorate(s, 1);
  for (auto& uv : s.corner_uv) uv = {glm::vec2(0), glm::vec2(0), glm::vec2(0)};
  for (size_t t = 8; t < 10; ++t)
    for (size_t k = 0; k < 3; ++k) s.corner_uv[t][k] = glm::vec2(s.positions[s.triangles[t][k]]) / 8.0f;
  TriMesh two_images = toMesh(s);
  two_images.images.resize(2);
  for (size_t t = 0; t < 10; ++t) two_images.image_of.push_back(t == 9 ? 1 : 0);
  LoadedMesh r = mustRepair(two_images);
  ASSERT_EQ(r.mesh.image_of.size(), 13u);
  for (size_t t = 0; t < 13; ++t) {
    float x = 0, y = 0;  // the quad's upper half is left of its diagonal
    for (const uint32_t v : r.mesh.triangles[t]) x += r.mesh.positions_mm[v].x / 3, y += r.mesh.positions_mm[v].y / 3;
    x += static_cast<float>(r.mesh.origin_mm.x), y += static_cast<float>(r.mesh.origin_mm.y);
    EXPECT_EQ(r.mesh.image_of[t], x > 1 && y > x - 1 ? 1 : 0) << x << " " << y;
  }
  EXPECT_EQ(found(r.diagnosis, "T-junctions"), 3u);
  EXPECT_EQ(r.diagnosis.pieces, 1u);
  EXPECT_EQ(r.diagnosis.border_loops, 1u);
  EXPECT_EQ(r.mesh.triangles.size(), 13u);
  EXPECT_DOUBLE_EQ(area(r.mesh), 20);
  expectManifold(r);
  for (size_t t = 0; t < r.mesh.triangles.size(); ++t)
    for (size_t k = 0; k < 3; ++k)
      if (r.mesh.corner_uv[t][k] != glm::vec2(0)) {
        EXPECT_EQ(r.mesh.corner_uv[t][k], glm::vec2(r.mesh.positions_mm[r.mesh.triangles[t][k]]) / 8.0f);
      }
  // Control: the same vertices at the edge's ends only.
  Sample sound = sheet(1, 1, 4);
  append(sound, {{{4, 0, 0}, {8, 0, 0}, {8, 4, 0}, {4, 4, 0}}, {{0, 1, 2}, {0, 2, 3}}, {}, {}});
  EXPECT_EQ(found(mustRepair(toMesh(sound)).diagnosis, "T-junctions"), 0u);
  // Off the edge: within the tolerance (1e-7 of a diagonal of 6.4) and beyond.
  for (auto [off, junctions] : {std::pair{3e-7, 3u}, {3e-6, 0u}, {-3e-7, 3u}, {-3e-6, 0u}}) {
    TriMesh m = toMesh(s);
    for (size_t v = 3; v <= 7; v += 2) m.positions_mm[v].x += static_cast<float>(off);
    EXPECT_EQ(found(mustRepair(m).diagnosis, "T-junctions"), junctions) << off;
  }
}

// More edges than one thread looks at in one go.
TEST(MeshRepairs, TJunctionsOfManyEdges) {
  constexpr int kTimes = 100;
  Sample all;
  for (int i = 0; i < kTimes; ++i) {
    Sample s = sheet(1, 4);
    append(s, {{{1, 0, 0}, {5, 0, 0}, {5, 4, 0}, {1, 4, 0}}, {{0, 1, 2}, {0, 2, 3}}, {}, {}});
    for (auto& p : s.positions) p.x += static_cast<float>(10 * i);
    append(all, s);
  }
  const LoadedMesh r = mustRepair(toMesh(all));
  EXPECT_EQ(found(r.diagnosis, "T-junctions"), 3u * kTimes);
  EXPECT_EQ(r.mesh.triangles.size(), 13u * kTimes);
  EXPECT_EQ(r.diagnosis.pieces, uint32_t{kTimes});
  expectManifold(r);
}

TEST(MeshRepairs, TJunctionsOnAllSidesOfATriangle) {
  for (uint32_t seed = 1; seed <= 30; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937 random(seed);
    // A triangle in a ring of triangles that touch its sides at 0 to 5 dyadic places each.
    Sample s{{{0, 0, 0}, {16, 0, 0}, {0, 16, 0}}, {{0, 1, 2}}, {}, {}};
    size_t junctions = 0;
    for (uint32_t k = 0; k < 3; ++k) {
      glm::dvec3 a = s.positions[k], b = s.positions[(k + 1) % 3],
                 out = k == 0   ? glm::dvec3(8, -8, 0)
                       : k == 1 ? glm::dvec3(16, 16, 0)
                                : glm::dvec3(-8, 8, 0);
      std::set<int> cuts;
      for (uint32_t n = random() % 6; n > 0; --n) cuts.insert(1 + static_cast<int>(random() % 15));
      junctions += cuts.size();
      std::vector<uint32_t> line{k};
      for (int c : cuts) {
        line.push_back(static_cast<uint32_t>(s.positions.size()));
        s.positions.push_back(a + (b - a) * (c / 16.0));
      }
      line.push_back((k + 1) % 3);
      auto tip = static_cast<uint32_t>(s.positions.size());
      s.positions.push_back(out);
      for (size_t i = 0; i + 1 < line.size(); ++i) s.triangles.push_back({line[i + 1], line[i], tip});
    }
    LoadedMesh r = mustRepair(toMesh(s));
    EXPECT_EQ(found(r.diagnosis, "T-junctions"), junctions);
    EXPECT_EQ(r.diagnosis.pieces, 1u);
    EXPECT_EQ(r.diagnosis.border_loops, 1u);
    EXPECT_NEAR(area(r.mesh), area(toMesh(s)), 1e-9);
    expectManifold(r);
  }
}

TEST(MeshRepairs, AClosedSurfaceWithAZeroAreaTriangleIsClosedAfterwards) {
  // The middle of an edge is a vertex on one side; a triangle without area fills in on the other.
  Sample s = box({0, 0, 0}, {2, 2, 2});
  // Edge 4-5 of the top {4,5,7,6} and the front: the top's triangle {4,5,7} gets the middle, the front keeps the edge.
  s.positions.emplace_back(1, 0, 2);
  for (auto& t : s.triangles)
    if (t == std::array<uint32_t, 3>{4, 5, 7}) t = {4, 8, 7};
  s.triangles.push_back({8, 5, 7});
  s.triangles.push_back({4, 5, 8});
  LoadedMesh r = mustRepair(toMesh(s));
  EXPECT_EQ(found(r.diagnosis, "degenerate triangles"), 1u);
  EXPECT_EQ(found(r.diagnosis, "T-junctions"), 1u);
  EXPECT_EQ(r.diagnosis.border_loops, 0u);
  EXPECT_NEAR(signedVolume(r.mesh), 48, 1e-6);
  expectManifold(r);
}

TEST(MeshRepairs, BordersAndPiecesAreCounted) {
  Sample s = scanOfCubeSphere(6);
  // Two holes of a triangle each, far apart.
  s.triangles.erase(s.triangles.begin() + 100);
  s.triangles.erase(s.triangles.begin() + 10);
  append(s, {{{500, 0, 0}, {510, 0, 0}, {500, 10, 0}}, {{0, 1, 2}}, {}, {}});
  s.positions.emplace_back(1, 2, 3);  // of no triangle
  LoadedMesh r = mustRepair(toMesh(s));
  EXPECT_EQ(r.diagnosis.border_loops, 3u);
  EXPECT_EQ(found(r.diagnosis, "open borders"), 3u);
  EXPECT_EQ(r.diagnosis.pieces, 2u);
  EXPECT_EQ(found(r.diagnosis, "isolated pieces"), 1u);
  EXPECT_EQ(found(r.diagnosis, "vertices of no triangle"), 1u);
  EXPECT_NEAR(r.diagnosis.max_mm.x, 510, 1e-6);
  expectManifold(r);
  for (const MeshFinding& f : r.diagnosis.findings)
    if (f.what == "isolated pieces") {
      EXPECT_EQ(f.places_mm.at(0), glm::dvec3(500, 0, 0));
    }
}

// Scans carry dust: a body, and as many single triangles of that area each.
TEST(MeshRepairs, TheSmallestOfManyPiecesAreDroppedAndTheirAreaIsSaid) {
  const auto dustySample = [](size_t pieces, float side) {
    Sample s = scanOfCubeSphere(12);
    for (size_t k = 0; k < pieces; ++k) {
      const float x = 2000.0f + 10.0f * static_cast<float>(k);
      append(s, {{{x, 0, 0}, {x + side, 0, 0}, {x, side, 0}}, {{0, 1, 2}}, {}, {}});
    }
    return s;
  };
  const auto dusty = [&](size_t pieces, float side) { return mustRepair(toMesh(dustySample(pieces, side))); };
  const auto droppedOf = [](const LoadedMesh& r) -> const MeshFinding* {
    for (const MeshFinding& f : r.diagnosis.findings)
      if (f.what.find("smallest of ") == 0) return &f;
    return nullptr;
  };
  constexpr size_t kMost = 2048;
  LoadedMesh r = dusty(kMost + 500, 0.05f);
  ASSERT_TRUE(droppedOf(r));
  EXPECT_EQ(droppedOf(r)->what, "smallest of 2549 pieces");
  EXPECT_EQ(droppedOf(r)->count, 501u);
  EXPECT_EQ(droppedOf(r)->done.find("dropped, 0.0"), 0u) << droppedOf(r)->done;
  EXPECT_EQ(r.diagnosis.pieces, kMost);
  EXPECT_EQ(r.diagnosis.triangles, r.mesh.triangles.size());
  EXPECT_EQ(r.diagnosis.border_loops, kMost - 1);
  expectManifold(r);
  // The controls: no more pieces than that, and pieces that are more than dust.
  r = dusty(kMost - 1, 0.05f);
  EXPECT_EQ(droppedOf(r), nullptr);
  EXPECT_EQ(r.diagnosis.pieces, kMost);
  r = dusty(kMost + 500, 5);
  EXPECT_LT(r.diagnosis.pieces, kMost + 501);
  EXPECT_GT(r.diagnosis.pieces, kMost + 300);
  // Where each triangle may be shown all stay.
  const Sample sample = dustySample(kMost + 500, 0.05f);
  const std::string path = saveFile("dusty.ply", plyFile(sample, {}));
  r = mustRead(path, {.all_pieces_up_to = sample.triangles.size()});
  EXPECT_EQ(droppedOf(r), nullptr);
  EXPECT_EQ(r.diagnosis.pieces, kMost + 501);
  r = mustRead(path, {.all_pieces_up_to = sample.triangles.size() - 1});
  EXPECT_EQ(r.diagnosis.pieces, kMost);
}

// Triangles between few vertices: everything that can be wrong is.
TEST(MeshRepairs, RandomTrianglesBecomeSheets) {
  size_t problems_before = 0, meshes = 0;
  for (uint32_t seed = 1; seed <= 400; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937 random(seed);
    Sample s;
    uint32_t vertices = 4 + pick(random, 12), triangles = 1 + pick(random, 60);
    int lattice = seed % 3 ? 1000 : 3;  // a coarse lattice has duplicates, lines and T-junctions in plenty
    for (uint32_t i = 0; i < vertices; ++i)
      s.positions.emplace_back(static_cast<int>(random() % static_cast<uint32_t>(lattice)),
                               static_cast<int>(random() % static_cast<uint32_t>(lattice)),
                               static_cast<int>(random() % static_cast<uint32_t>(lattice)));
    for (uint32_t t = 0; t < triangles; ++t)
      s.triangles.push_back({pick(random, vertices), pick(random, vertices), pick(random, vertices)});
    if (seed % 2) decorate(s, seed);
    TriMesh m = toMesh(s);
    problems_before += !triMeshProblem(m).empty();
    auto r = repairMesh(m, "random");
    if (!r) {
      EXPECT_NE(r.error().message.find("degenerate triangles only"), std::string::npos) << r.error().text();
      continue;
    }
    ++meshes;
    EXPECT_EQ(triMeshProblem(r->mesh), "");
    expectManifold(*r);
    // Repaired is repaired: what is left is what is only reported. Vertices split in place would be welded again, so
    // copies are moved.
    for (size_t i = 0; i < r->mesh.positions_mm.size(); ++i)
      r->mesh.positions_mm[i] += glm::vec3(0.001f * static_cast<float>(i), 0.01f * static_cast<float>(i % 7), 0);
    auto again = repairMesh(r->mesh, "again");
    ASSERT_TRUE(again.ok());
    if (found(again->diagnosis, "T-junctions") > 0) continue;  // the moved vertices made new ones
    if (again->diagnosis.vertices_read == again->diagnosis.vertices) {
      EXPECT_EQ(again->diagnosis.pieces, r->diagnosis.pieces);
    }
    EXPECT_EQ(found(again->diagnosis, "non-manifold edges") + found(again->diagnosis, "non-manifold vertices"), 0u)
        << defects(again->diagnosis);
  }
  EXPECT_GT(problems_before, 300u);  // control: the checker sees what they were
  EXPECT_GT(meshes, 300u);
}

// A sound body with every defect that can be repaired put into it comes back: closed, one piece, its very volume and
// area.
TEST(MeshRepairs, AllDefectsAtOnce) {
  for (uint32_t seed = 1; seed <= 30; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937 random(seed);
    const Sample sound = scanOfCubeSphere(8);
    const TriMesh truth = toMesh(sound);
    Sample s = sound;
    // The middle of an edge on one side of it only. Each triangle at most once, and not where its neighbour was cut.
    std::vector<bool> touched(s.triangles.size());
    size_t junctions = 0;
    for (uint32_t n = pick(random, 20); n > 0; --n) {
      size_t t = pick(random, static_cast<uint32_t>(sound.triangles.size())), neighbour = 0;
      const uint32_t a = sound.triangles[t][0], b = sound.triangles[t][1], c = sound.triangles[t][2];
      while (neighbour == t || std::count_if(sound.triangles[neighbour].begin(), sound.triangles[neighbour].end(),
                                             [&](uint32_t v) { return v == a || v == b; }) < 2)
        ++neighbour;
      if (touched[t] || touched[neighbour]) continue;
      touched[t] = touched[neighbour] = true;
      auto middle = static_cast<uint32_t>(s.positions.size());
      s.positions.push_back(0.5 * (s.positions[a] + s.positions[b]));
      s.triangles[t] = {a, middle, c};
      s.triangles.push_back({middle, b, c});
      ++junctions;
    }
    for (auto& t : s.triangles)
      if (pick(random, 5) == 0) std::swap(t[0], t[1]);
    size_t degenerate = pick(random, 10), copies = pick(random, 10);
    for (size_t i = 0; i < degenerate; ++i) s.triangles.push_back({5, pick(random, 100), 5});
    std::set<uint32_t> copied;
    for (size_t i = 0; i < copies; ++i) copied.insert(pick(random, static_cast<uint32_t>(sound.triangles.size())));
    for (uint32_t t : copied) {
      auto [a, b, c] = s.triangles[t];
      s.triangles.push_back({b, c, a});
    }
    // Vertices of their own for half of the corners; shuffled triangles; a stray vertex.
    size_t duplicates = 0;
    for (size_t t = 0; t < s.triangles.size(); ++t)
      for (uint32_t& v : s.triangles[t])
        if (pick(random, 2) == 0) {
          s.positions.push_back(glm::dvec3(s.positions[v]));
          v = static_cast<uint32_t>(s.positions.size() - 1);
          ++duplicates;
        }
    std::shuffle(s.triangles.begin(), s.triangles.end(), random);
    s.positions.emplace_back(1e6, 0, 0);
    LoadedMesh r = mustRepair(toMesh(s));
    EXPECT_EQ(found(r.diagnosis, "duplicate vertices"), duplicates);
    EXPECT_EQ(found(r.diagnosis, "degenerate triangles"), degenerate);
    EXPECT_EQ(found(r.diagnosis, "duplicate triangles"), copied.size());
    EXPECT_EQ(found(r.diagnosis, "T-junctions"), junctions);
    EXPECT_EQ(found(r.diagnosis, "vertices of no triangle"), 1u);
    EXPECT_GT(found(r.diagnosis, "flipped triangles"), 30u);
    EXPECT_EQ(r.diagnosis.pieces, 1u);
    EXPECT_EQ(r.diagnosis.border_loops, 0u);
    EXPECT_EQ(r.mesh.triangles.size(), truth.triangles.size() + 2 * junctions);
    EXPECT_NEAR(signedVolume(r.mesh) / signedVolume(truth), 1, 1e-6);
    EXPECT_NEAR(area(r.mesh) / area(truth), 1, 1e-6);
    expectManifold(r);
    EXPECT_NE(triMeshProblem(toMesh(s)), "");  // control
  }
}

TEST(MeshRepairs, TheSameTwice) {
  std::mt19937 random(5);
  Sample s;
  for (int i = 0; i < 300; ++i) s.positions.emplace_back(random() % 20, random() % 20, random() % 20);
  for (int t = 0; t < 3000; ++t) s.triangles.push_back({pick(random, 300), pick(random, 300), pick(random, 300)});
  LoadedMesh a = mustRepair(toMesh(s)), b = mustRepair(toMesh(s));
  EXPECT_EQ(a.mesh.positions_mm, b.mesh.positions_mm);
  EXPECT_EQ(a.mesh.triangles, b.mesh.triangles);
  EXPECT_EQ(defects(a.diagnosis), defects(b.diagnosis));
}

// Soups with everything that can be wrong, sheets of them whose vertices are far apart in the list, and sound bodies.
TEST(MeshRepairs, AnyNumberOfWorkersFindsTheSame) {
  auto same = [](const LoadedMesh& a, const LoadedMesh& b) {
    auto places = [](const MeshDiagnosis& d) {
      std::vector<glm::dvec3> all;
      for (const MeshFinding& f : d.findings) all.insert(all.end(), f.places_mm.begin(), f.places_mm.end());
      return all;
    };
    return a.mesh.positions_mm == b.mesh.positions_mm && a.mesh.triangles == b.mesh.triangles &&
           a.mesh.colours == b.mesh.colours && a.mesh.corner_uv == b.mesh.corner_uv &&
           defects(a.diagnosis) == defects(b.diagnosis) && places(a.diagnosis) == places(b.diagnosis) &&
           a.diagnosis.pieces == b.diagnosis.pieces && a.diagnosis.border_loops == b.diagnosis.border_loops;
  };
  size_t meshes = 0, noticed = 0;
  for (uint32_t seed = 1; seed <= 40; ++seed) {
    SCOPED_TRACE(seed);
    std::mt19937 random(seed);
    Sample s;
    if (seed % 4 == 0) {
      s = scanOfCubeSphere(seed == 40 ? 40 : 1 + static_cast<int>(seed) / 4);
      if (seed % 8 == 0) std::swap(s.triangles[0][0], s.triangles[0][1]);
    } else {
      const uint32_t vertices = 4 + pick(random, 300), triangles = 1 + pick(random, 4 * vertices),
                     lattice = seed % 4 == 1 ? 1000 : 12;
      for (uint32_t i = 0; i < vertices; ++i)
        s.positions.emplace_back(pick(random, lattice), pick(random, lattice), pick(random, lattice));
      for (uint32_t t = 0; t < triangles; ++t)
        s.triangles.push_back({pick(random, vertices), pick(random, vertices), pick(random, vertices)});
    }
    if (seed % 2) decorate(s, seed);
    auto alone = repairMesh(toMesh(s), "alone", 1);
    if (!alone) continue;
    ++meshes;
    for (int workers : {2, 3, 20}) {
      auto together = repairMesh(toMesh(s), "together", workers);
      ASSERT_TRUE(together.ok()) << together.error().text();
      EXPECT_TRUE(same(*alone, *together)) << workers;
    }
    std::reverse(s.triangles.begin(), s.triangles.end());
    std::reverse(s.corner_uv.begin(), s.corner_uv.end());
    auto reversed = repairMesh(toMesh(s), "reversed", 2);
    noticed += reversed.ok() && !same(*alone, *reversed);
  }
  EXPECT_GT(meshes, 35u);
  EXPECT_GT(noticed, 30u) << "negative control: triangles in another order are seen to differ";
}

// Whoever looks for some vertices sees all triangles that name one of them, in order, and not all others.
TEST(TriangleBlocks, PassOverWhatNamesNoneOfTheVertices) {
  for (bool shuffled : {false, true}) {
    Sample s = scanOfCubeSphere(40);
    std::mt19937 random(7);
    if (shuffled) std::shuffle(s.triangles.begin(), s.triangles.end(), random);
    const TriangleBlocks blocks(s.triangles, 2);
    const auto vertices = static_cast<uint32_t>(s.positions.size());
    size_t visits = 0, looks = 0;
    for (int i = 0; i < 100; ++i) {
      const uint32_t first = pick(random, vertices), last = std::min(vertices, first + pick(random, 200));
      std::vector<size_t> visited;
      blocks.forEach(
          first, last, [] { return false; }, [&](size_t t) { visited.push_back(t); });
      EXPECT_TRUE(std::is_sorted(visited.begin(), visited.end()));
      for (size_t t = 0; t < s.triangles.size(); ++t) {
        const bool named = std::ranges::any_of(s.triangles[t], [&](uint32_t v) { return v >= first && v < last; });
        if (named) {
          ASSERT_TRUE(std::binary_search(visited.begin(), visited.end(), t))
              << first << " to " << last << ": triangle " << t;
        }
      }
      visits += visited.size();
      looks += s.triangles.size();
    }
    if (shuffled) EXPECT_GT(visits, looks * 9 / 10) << "control: where triangles lie anywhere nothing is passed over";
    else EXPECT_LT(visits, looks / 2);
  }
}

TEST(MeshRepairs, WhatCallersGetWrongIsRefused) {
  const TriMesh good = toMesh(sheet(2, 2));
  auto refused = [](TriMesh m, const char* part) {
    auto r = repairMesh(std::move(m), "made");
    ASSERT_FALSE(r.ok()) << part;
    EXPECT_EQ(r.error().kind, ErrorKind::kInvalidData);
    EXPECT_NE(r.error().text().find(part), std::string::npos) << r.error().text();
  };
  TriMesh m = good;
  m.triangles[3][1] = 9;
  refused(m, "triangle 3 names vertex 9, there are 9");
  m = good;
  m.positions_mm[4].y = std::nanf("");
  refused(m, "vertex 4 (from 0): expected y to be a finite number");
  m = good;
  m.origin_mm.x = INFINITY;
  refused(m, "vertex 0");
  m = good;
  m.colours.resize(3);
  refused(m, "expected a colour a vertex");
  m = good;
  m.corner_uv.resize(3);
  refused(m, "texture coordinates of 8 triangles");
  m = good;
  m.triangles.clear();
  refused(m, "no triangle");
  m = good;
  for (auto& p : m.positions_mm) p *= 1e-8f;
  refused(m, "nanometre");
}

// Negative controls of the checker itself.
TEST(MeshChecker, NamesEveryBrokenPromise) {
  const TriMesh good = toMesh(sheet(2, 2));
  EXPECT_EQ(triMeshProblem(good), "");
  auto problem = [](const TriMesh& mesh) { return triMeshProblem(mesh); };
  TriMesh m = good;
  m.triangles[0][0] = 77;
  EXPECT_NE(problem(m).find("names vertex 77"), std::string::npos);
  m = good;
  m.positions_mm[2].x = INFINITY;
  EXPECT_NE(problem(m).find("not finite"), std::string::npos);
  m = good;
  m.triangles[1][0] = m.triangles[1][1];
  EXPECT_NE(problem(m).find("degenerate"), std::string::npos);
  m = good;
  m.positions_mm[4] = (m.positions_mm[0] + m.positions_mm[8]) * 0.5f;
  m.triangles[0] = {0, 4, 8};
  EXPECT_NE(problem(m).find("degenerate"), std::string::npos);
  m = good;
  m.triangles.push_back({0, 4, 8});
  m.positions_mm[8].z = 1;
  EXPECT_NE(problem(m).find("more than two"), std::string::npos);
  m = good;
  m.positions_mm.emplace_back(1, 1, 1);
  EXPECT_NE(problem(m).find("no triangle names vertex"), std::string::npos);
  m = good;
  m.colours.resize(2);
  EXPECT_NE(problem(m).find("colours"), std::string::npos);
}

TEST(MeshReal, Laurana) {
  const fs::path path = sharedData("laurana.ply");
  if (path.empty()) GTEST_SKIP() << "no ../shared/data/laurana.ply beside the checkout";
  LoadedMesh m = mustRead(path.string());
  EXPECT_EQ(m.diagnosis.vertices_read, 25160u);
  EXPECT_EQ(m.diagnosis.triangles_read, 50000u);
  EXPECT_EQ(m.diagnosis.vertices, 25160u);
  EXPECT_EQ(m.diagnosis.triangles, 50000u);
  EXPECT_EQ(m.mesh.colours.size(), 25160u);
  EXPECT_EQ(m.diagnosis.pieces, 1u);
  expectManifold(m);
  // Euler's number of a surface: V - E + F = 2 - 2 genus - borders, E from the borders' length.
  HalfEdges h;
  ASSERT_TRUE(OpenMesh::IO::read_mesh(h, path.string()));
  EXPECT_EQ(h.n_vertices(), 25160u);
  EXPECT_EQ(h.n_faces(), 50000u);
  for (auto v : h.vertices()) {
    auto p = h.point(v);
    ASSERT_EQ(glm::dvec3(m.mesh.positions_mm[static_cast<size_t>(v.idx())]) + m.mesh.origin_mm,
              glm::dvec3(p[0], p[1], p[2]));
  }
}

}  // namespace mesh_read_test
}  // namespace relievo::test
