// glTF files whose meshes are compressed: written here by meshoptimizer's and Draco's own encoders, read as the same
// meshes without compression are; damaged ones are refused, and none takes memory for what it only states.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <set>
#include <string>
#include <tuple>
#include <vector>

#include <draco/compression/encode.h>
#include <draco/mesh/mesh.h>
#include <meshoptimizer.h>

#include "geometry/scan/mesh_read.h"
#include "tests/geometry/mesh_files.h"
#include "tests/geometry/must_read.h"

namespace relievo::test {
namespace mesh_gltf_compressed_test {

// A ball with colours and texture coordinates, by vertex as glTF has them.
Sample ball() {
  Sample s = scanOfCubeSphere(5, 0.25);
  for (const glm::dvec3& p : s.positions)
    s.colours.push_back({static_cast<uint8_t>(128 + 400 * p.x), static_cast<uint8_t>(128 + 400 * p.y), 200});
  for (const auto& t : s.triangles) {
    std::array<glm::vec2, 3> uv;
    for (size_t k = 0; k < 3; ++k) {
      const glm::dvec3& p = s.positions[t[k]];
      uv[k] = {static_cast<float>(std::round(256 * (0.5 + p.x)) / 256),
               static_cast<float>(std::round(256 * (0.5 + p.y)) / 256)};
    }
    s.corner_uv.push_back(uv);
  }
  return s;
}

struct Vertex {
  std::array<float, 3> position;
  std::array<uint8_t, 4> colour;
  std::array<float, 2> uv;
};
std::vector<Vertex> verticesOf(const Sample& s) {
  std::vector<Vertex> out(s.positions.size());
  for (size_t i = 0; i < out.size(); ++i) {
    for (int c = 0; c < 3; ++c) out[i].position[static_cast<size_t>(c)] = static_cast<float>(s.positions[i][c]);
    out[i].colour = {s.colours[i].x, s.colours[i].y, s.colours[i].z, 255};
  }
  for (size_t t = 0; t < s.triangles.size(); ++t)
    for (size_t k = 0; k < 3; ++k) out[s.triangles[t][k]].uv = {s.corner_uv[t][k].x, 1 - s.corner_uv[t][k].y};
  return out;
}
std::vector<uint32_t> indicesOf(const Sample& s) {
  std::vector<uint32_t> out;
  for (const auto& t : s.triangles) out.insert(out.end(), t.begin(), t.end());
  return out;
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const size_t at = text.find(from);
  EXPECT_NE(at, text.npos) << from;
  return at == text.npos ? text : text.replace(at, from.size(), to);
}

constexpr const char* kScene =
    "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0}],";
std::string accessorsOf(size_t vertices, size_t indices, bool views) {
  auto accessor = [&, n = 0](int component, const char* type, size_t count) mutable {
    return std::string("{") + (views ? "\"bufferView\":" + std::to_string(n++) + "," : "") +
           "\"componentType\":" + std::to_string(component) + ",\"count\":" + std::to_string(count) + ",\"type\":\"" +
           type + "\"" + (component == 5121 ? ",\"normalized\":true}" : "}");
  };
  const std::string positions = accessor(5126, "VEC3", vertices), colours = accessor(5121, "VEC4", vertices),
                    uv = accessor(5126, "VEC2", vertices), index = accessor(5125, "SCALAR", indices);
  return "\"accessors\":[" + positions + "," + colours + "," + uv + "," + index + "]";
}
constexpr const char* kPrimitive = "{\"attributes\":{\"POSITION\":0,\"COLOR_0\":1,\"TEXCOORD_0\":2},\"indices\":3";

struct Glb {
  std::string json, binary;
  std::string file() const { return glbOf(json, binary); }
};

// triangles: indices as those, else as a sequence. exponential: positions by that filter, of so many bits.
Glb meshopt(const Sample& s, bool triangles, int exponential_bits = 0) {
  Glb out;
  std::string views;
  const std::vector<Vertex> vertices = verticesOf(s);
  const std::vector<uint32_t> indices = indicesOf(s);
  auto add = [&](const std::vector<unsigned char>& code, size_t count, size_t stride, const char* mode,
                 const char* filter) {
    views += std::string(views.empty() ? "" : ",") +
             "{\"buffer\":1,\"byteOffset\":0,\"byteLength\":" + std::to_string(count * stride) +
             ",\"extensions\":{\"EXT_meshopt_compression\":{\"buffer\":0," +
             "\"byteOffset\":" + std::to_string(out.binary.size()) + ",\"byteLength\":" + std::to_string(code.size()) +
             ",\"byteStride\":" + std::to_string(stride) + ",\"count\":" + std::to_string(count) + ",\"mode\":\"" +
             mode + "\"" + filter + "}}}";
    out.binary.append(code.begin(), code.end());
    out.binary.resize((out.binary.size() + 3) / 4 * 4, '\0');
  };
  auto addVertices = [&](size_t stride, const char* filter, auto&& of) {
    std::vector<unsigned char> raw;
    for (const Vertex& v : vertices) {
      const auto part = of(v);
      const auto* p = reinterpret_cast<const unsigned char*>(part.data());
      raw.insert(raw.end(), p, p + stride);
    }
    if (*filter) {
      const std::vector<unsigned char> floats = raw;
      meshopt_encodeFilterExp(raw.data(), vertices.size(), stride, exponential_bits,
                              reinterpret_cast<const float*>(floats.data()));
    }
    std::vector<unsigned char> code(meshopt_encodeVertexBufferBound(vertices.size(), stride));
    code.resize(meshopt_encodeVertexBuffer(code.data(), code.size(), raw.data(), vertices.size(), stride));
    add(code, vertices.size(), stride, "ATTRIBUTES", filter);
  };
  addVertices(12, exponential_bits ? ",\"filter\":\"EXPONENTIAL\"" : "", [](const Vertex& v) { return v.position; });
  addVertices(4, "", [](const Vertex& v) { return v.colour; });
  addVertices(8, "", [](const Vertex& v) { return v.uv; });
  std::vector<unsigned char> code(std::max(meshopt_encodeIndexBufferBound(indices.size(), vertices.size()),
                                           meshopt_encodeIndexSequenceBound(indices.size(), vertices.size())));
  code.resize(triangles ? meshopt_encodeIndexBuffer(code.data(), code.size(), indices.data(), indices.size())
                        : meshopt_encodeIndexSequence(code.data(), code.size(), indices.data(), indices.size()));
  add(code, indices.size(), 4, triangles ? "TRIANGLES" : "INDICES", "");
  out.json = std::string(kScene) +
             "\"extensionsRequired\":[\"EXT_meshopt_compression\"],\"meshes\":[{\"primitives\":[" + kPrimitive +
             "}]}],\"bufferViews\":[" + views + "]," + accessorsOf(vertices.size(), indices.size(), true) +
             ",\"buffers\":[{\"byteLength\":" + std::to_string(out.binary.size()) + "},{\"byteLength\":999999," +
             "\"extensions\":{\"EXT_meshopt_compression\":{\"fallback\":true}}}]}";
  return out;
}

Glb draco(const Sample& s, bool edgebreaker) {
  ::draco::Mesh mesh;
  const std::vector<Vertex> vertices = verticesOf(s);
  mesh.set_num_points(static_cast<uint32_t>(vertices.size()));
  auto add = [&](::draco::GeometryAttribute::Type type, int8_t components, ::draco::DataType numbers, size_t bytes,
                 auto&& of) {
    ::draco::GeometryAttribute attribute;
    attribute.Init(type, nullptr, components, numbers, numbers == ::draco::DT_UINT8, static_cast<int64_t>(bytes), 0);
    const int id = mesh.AddAttribute(attribute, true, mesh.num_points());
    for (uint32_t i = 0; i < mesh.num_points(); ++i)
      mesh.attribute(id)->SetAttributeValue(::draco::AttributeValueIndex(i), of(vertices[i]).data());
    return std::to_string(mesh.attribute(id)->unique_id());
  };
  using Attribute = ::draco::GeometryAttribute;
  const std::string uv = add(Attribute::TEX_COORD, 2, ::draco::DT_FLOAT32, 8, [](const Vertex&v) { return v.uv; }),
                    position =
                        add(Attribute::POSITION, 3, ::draco::DT_FLOAT32, 12, [](const Vertex&v) { return v.position; }),
                    colour = add(Attribute::COLOR, 4, ::draco::DT_UINT8, 4, [](const Vertex&v) { return v.colour; });
  for (const auto& t : s.triangles) {
    ::draco::Mesh::Face face;
    for (size_t k = 0; k < 3; ++k) face[k] = ::draco::PointIndex(t[k]);
    mesh.AddFace(face);
  }
  ::draco::Encoder encoder;
  encoder.SetEncodingMethod(edgebreaker ? ::draco::MESH_EDGEBREAKER_ENCODING : ::draco::MESH_SEQUENTIAL_ENCODING);
  ::draco::EncoderBuffer code;
  EXPECT_TRUE(encoder.EncodeMeshToBuffer(mesh, &code).ok());
  Glb out;
  out.binary.assign(code.data(), code.size());
  out.json =
      std::string(kScene) + "\"extensionsRequired\":[\"KHR_draco_mesh_compression\"],\"meshes\":[{\"primitives\":[" +
      kPrimitive +
      ",\"extensions\":{\"KHR_draco_mesh_compression\":{\"bufferView\":0,\"attributes\":{\"POSITION\":" + position +
      ",\"COLOR_0\":" + colour + ",\"TEXCOORD_0\":" + uv +
      "}}}}]}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":" + std::to_string(out.binary.size()) + "}]," +
      accessorsOf(encoder.num_encoded_points() ? encoder.num_encoded_points() : vertices.size(), 3 * s.triangles.size(),
                  false) +
      ",\"buffers\":[{\"byteLength\":" + std::to_string(out.binary.size()) + "}]}";
  return out;
}

// A mesh's triangles whatever their order: each from its least corner on, corners as position, colour, coordinates.
using Corner = std::tuple<long, long, long, int, int, int, long, long>;
std::multiset<std::array<Corner, 3>> trianglesOf(const LoadedMesh& m, double in_mm) {
  std::multiset<std::array<Corner, 3>> out;
  for (size_t t = 0; t < m.mesh.triangles.size(); ++t) {
    std::array<Corner, 3> corners;
    for (size_t k = 0; k < 3; ++k) {
      const uint32_t v = m.mesh.triangles[t][k];
      const glm::dvec3 p = (m.mesh.origin_mm + glm::dvec3(m.mesh.positions_mm[v])) / in_mm;
      const glm::u8vec3 c = m.mesh.colours.empty() ? glm::u8vec3(0) : m.mesh.colours[v];
      const glm::vec2 uv = m.mesh.corner_uv.empty() ? glm::vec2(0) : m.mesh.corner_uv[t][k];
      corners[k] = {std::lround(p.x),         std::lround(p.y),        std::lround(p.z), c.x, c.y, c.z,
                    std::lround(1024 * uv.x), std::lround(1024 * uv.y)};
    }
    std::rotate(corners.begin(), std::min_element(corners.begin(), corners.end()), corners.end());
    out.insert(corners);
  }
  return out;
}

TEST(MeshGltfCompressed, MeshoptAndDracoAreReadAsTheMeshWithoutThem) {
  const Sample s = ball();
  const LoadedMesh plain = mustRead(saveFile("plain.glb", glbFile(s)));
  ASSERT_EQ(plain.mesh.triangles.size(), s.triangles.size());
  ASSERT_FALSE(plain.mesh.colours.empty() || plain.mesh.corner_uv.empty());
  const auto expected = trianglesOf(plain, 0.01);
  const std::vector<std::pair<const char*, Glb>> files{{"meshopt's triangles", meshopt(s, true)},
                                                       {"meshopt's sequences", meshopt(s, false)},
                                                       {"Draco's Edgebreaker", draco(s, true)},
                                                       {"Draco's sequential way", draco(s, false)}};
  for (const auto& [name, file] : files) {
    const LoadedMesh read = mustRead(saveFile("compressed.glb", file.file()));
    EXPECT_TRUE(trianglesOf(read, 0.01) == expected) << name;
    EXPECT_EQ(read.mesh.positions_mm.size(), plain.mesh.positions_mm.size()) << name;
  }
  Sample other = s;
  other.positions[7].x += 0.01;
  EXPECT_FALSE(trianglesOf(mustRead(saveFile("compressed.glb", draco(other, true).file())), 0.01) == expected)
      << "control";
}

// Mantissas of 20 bits: each coordinate of 250 mm within a few ten thousandths.
TEST(MeshGltfCompressed, MeshoptsFilterOfExponentsIsTakenBack) {
  const Sample s = ball();
  const auto expected = trianglesOf(mustRead(saveFile("plain.glb", glbFile(s))), 1);
  EXPECT_TRUE(trianglesOf(mustRead(saveFile("filtered.glb", meshopt(s, true, 20).file())), 1) == expected);
  Glb unfiltered = meshopt(s, true, 20);
  unfiltered.json = replaced(unfiltered.json, "EXPONENTIAL", "NONE");
  const auto read = readMesh(saveFile("filtered.glb", unfiltered.file()));
  EXPECT_FALSE(read.ok() && trianglesOf(*read, 1) == expected) << "control";
}

// Who has both reads what is not compressed.
TEST(MeshGltfCompressed, DataBesideDracosCodeIsReadInItsPlace) {
  const Sample s = ball();
  const GltfText text = gltfOf(s, "");
  const std::string both = replaced(text.json, "\"indices\":1",
                                    "\"indices\":1,\"extensions\":{\"KHR_draco_mesh_compression\":{\"bufferView\":0,"
                                    "\"attributes\":{\"POSITION\":0}}}");
  const LoadedMesh read = mustRead(saveFile("both.glb", glbOf(both, text.binary)));
  EXPECT_EQ(read.mesh.triangles.size(), s.triangles.size());
}

// Exporters write accessors of the same numbers once: each primitive's own code says what they stand for.
TEST(MeshGltfCompressed, PrimitivesMayShareAccessorsAndHaveCodesOfTheirOwn) {
  constexpr double kRounded = 0.7;  // mm: no coordinate lies halfway between two multiples
  const Sample one = ball();
  Sample other = one;
  for (glm::dvec3& p : other.positions) p = p * 0.5 + glm::dvec3(2, 0, 0);
  std::rotate(other.triangles.begin(), other.triangles.begin() + 5, other.triangles.end());
  const Glb a = draco(one, false), b = draco(other, false);
  const size_t begin = a.json.find("{\"attributes\""), end = a.json.find("]}],\"bufferViews\"");
  ASSERT_TRUE(begin != std::string::npos && end != std::string::npos);
  const std::string primitive = a.json.substr(begin, end - begin),
                    second = replaced(primitive, "\"bufferView\":0", "\"bufferView\":1"),
                    bytes = std::to_string(a.binary.size());
  Glb both;
  both.binary = a.binary + b.binary;
  const std::string all = std::to_string(both.binary.size());
  both.json = replaced(a.json, primitive, primitive + "," + second);
  both.json = replaced(both.json, "{\"buffer\":0,\"byteLength\":" + bytes + "}",
                       "{\"buffer\":0,\"byteLength\":" + bytes + "},{\"buffer\":0,\"byteOffset\":" + bytes +
                           ",\"byteLength\":" + std::to_string(b.binary.size()) + "}");
  both.json = replaced(both.json, "\"buffers\":[{\"byteLength\":" + bytes, "\"buffers\":[{\"byteLength\":" + all);
  auto expected = trianglesOf(mustRead(saveFile("a.glb", a.file())), kRounded);
  const auto of_other = trianglesOf(mustRead(saveFile("b.glb", b.file())), kRounded);
  EXPECT_FALSE(expected == of_other) << "control";
  expected.insert(of_other.begin(), of_other.end());
  EXPECT_EQ(mustRead(saveFile("both.glb", both.file())).diagnosis.triangles, 2 * one.triangles.size());
  EXPECT_TRUE(trianglesOf(mustRead(saveFile("both.glb", both.file())), kRounded) == expected);
}

TEST(MeshGltfCompressed, WhatDoesNotFitIsRefusedByItsName) {
  const Sample s = ball();
  const Glb by_draco = draco(s, true), sequential = draco(s, false), by_meshopt = meshopt(s, true);
  const std::string count = std::to_string(s.positions.size()), indices = std::to_string(3 * s.triangles.size());
  auto with = [](Glb file, const std::string& from, const std::string& to) {
    file.json = replaced(file.json, from, to);
    return file;
  };
  auto cut = [](Glb file, size_t bytes) {
    file.binary.resize(bytes);
    return file;
  };
  auto everyCount = [&](Glb file) {
    for (int k = 0; k < 3; ++k) file = with(file, "\"count\":" + count, "\"count\":4000000000");
    return file;
  };
  struct Case {
    Glb file;
    ErrorKind kind;
    const char* says;
  };
  const std::string huge = "999999999999";
  const std::vector<Case> cases{
      {with(by_draco, "\"count\":" + indices, "\"count\":3"), ErrorKind::kInvalidData, "triangles and"},
      {with(by_draco, "\"count\":" + count, "\"count\":4000000000"), ErrorKind::kInvalidData, "differ in how many"},
      {everyCount(sequential), ErrorKind::kInvalidData, "triangles and"},
      {everyCount(by_draco), ErrorKind::kInvalidData, "cannot be"},
      {with(by_draco, "\"POSITION\":1,", "\"POSITION\":9,"), ErrorKind::kInvalidData, "no attribute 9"},
      {with(by_draco, "\"indices\":3", "\"mode\":5,\"indices\":3"), ErrorKind::kUnsupported, "than as triangles"},
      {with(by_draco, "\"bufferView\":0", "\"bufferView\":4"), ErrorKind::kInvalidData, "bufferView"},
      {with(by_draco, "\"byteLength\":", "\"byteLength\":9"), ErrorKind::kInvalidData, "within its buffer"},
      {with(by_meshopt, "\"byteStride\":12", "\"byteStride\":10"), ErrorKind::kInvalidData, "multiple of 4"},
      {with(by_meshopt, "\"TRIANGLES\"", "\"POINTS\""), ErrorKind::kUnsupported, "to be ATTRIBUTES to INDICES"},
      {with(by_meshopt, "\"byteStride\":12,\"count\":" + count, "\"byteStride\":12,\"count\":" + huge),
       ErrorKind::kInvalidData, "compressed bytes, found "},
      {with(by_meshopt, "\"byteStride\":12,\"count\":" + count, "\"byteStride\":12,\"count\":5"),
       ErrorKind::kInvalidData, "no code of 5 elements"},
      {with(by_meshopt, "\"byteStride\":4,\"count\":" + count, "\"byteStride\":4,\"count\":1"), ErrorKind::kInvalidData,
       ""},
      {cut(by_meshopt, 100), ErrorKind::kInvalidData, "bytes of buffers[0]"},
  };
  for (const Case& c : cases) {
    const auto read = readMesh(saveFile("wrong.glb", c.file.file()));
    ASSERT_FALSE(read.ok()) << c.says;
    EXPECT_EQ(read.error().kind, c.kind) << read.error().text();
    EXPECT_NE(read.error().text().find(c.says), std::string::npos) << read.error().text();
  }
}

TEST(MeshGltfCompressed, DamagedCodesAreMeshesOrErrors) {
  const Sample s = ball();
  size_t refused = 0, tried = 0;
  for (const Glb& good : {meshopt(s, true), meshopt(s, false), draco(s, true), draco(s, false)})
    for (size_t at = 0; at < good.binary.size(); at += 1 + good.binary.size() / 150) {
      Glb bad = good;
      bad.binary[at] = static_cast<char>(bad.binary[at] ^ (1 << at % 8));
      refused += !readMesh(saveFile("damaged.glb", bad.file())).ok();
      ++tried;
    }
  EXPECT_GT(refused, tried / 20);
  EXPECT_LT(refused, tried) << "floats of any kind are floats";
}

}  // namespace mesh_gltf_compressed_test
}  // namespace relievo::test
