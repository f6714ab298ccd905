#include "tools/export/mesh_format_glb.h"

#include <array>
#include <cmath>
#include <nlohmann/json.hpp>

#include "src/base/srgb.h"

namespace relievo {
namespace {

constexpr size_t kJsonBytes = 4096;  // a multiple of 4; what `about` says is cut to fit
constexpr size_t kAboutBytes = 1024;
constexpr uint64_t kHeadBytes = 12 + 8 + kJsonBytes + 8;
constexpr int kFloat = 5126, kUnsignedShort = 5123, kUnsignedInt = 5125, kArrayBuffer = 34962, kElementArray = 34963;

// glTF's vertex colours are linear light: 16 bits keep the dark ones apart.
const std::array<uint16_t, 256>& linearLight16() {
  static const std::array<uint16_t, 256> table = [] {
    std::array<uint16_t, 256> t{};
    for (size_t i = 0; i < t.size(); ++i)
      t[i] = static_cast<uint16_t>(std::lround(65535 * linearFromSrgb(static_cast<double>(i) / 255)));
    return t;
  }();
  return table;
}

std::array<double, 3> listOf(const glm::dvec3& v) { return {v.x, v.y, v.z}; }

uint64_t strideOf(const MeshFacts& f) { return f.colours ? 32 : 24; }
uint64_t vertexBytes(const MeshFacts& f) { return f.vertices * strideOf(f); }
uint64_t indexBytes(const MeshFacts& f) { return f.faces * 12; }

using Json = nlohmann::ordered_json;

// All but the places of the numbers.
Json sceneOf(const MeshFacts& f, const Json& primitive) {
  constexpr double kMetres = 0.001;
  Json json = Json::object();
  json["asset"] = {{"version", "2.0"},
                   {"generator", "relievo " RELIEVO_VERSION},
                   {"extras", {{"about", f.about.substr(0, kAboutBytes)}}}};
  json["scene"] = 0;
  const Json scene = {{"nodes", Json::array({0})}};
  json["scenes"] = Json::array({scene});
  const Json node = {{"mesh", 0},
                     {"name", "artwork"},
                     {"translation", listOf(f.origin * kMetres)},
                     {"scale", listOf(glm::dvec3(kMetres))},
                     {"extras", {{"position_unit", f.size_known ? "mm" : "px"}, {"origin", listOf(f.origin)}}}};
  json["nodes"] = Json::array({node});
  const Json mesh = {{"primitives", Json::array({primitive})}};
  json["meshes"] = Json::array({mesh});
  const Json material = {{"pbrMetallicRoughness", {{"metallicFactor", 0}, {"roughnessFactor", 1}}},
                         {"doubleSided", true}};
  json["materials"] = Json::array({material});
  return json;
}
Json primitiveOf(const MeshFacts& f) {
  constexpr int kTriangles = 4;
  Json attributes = {{"POSITION", 0}, {"NORMAL", 1}};
  if (f.colours) attributes["COLOR_0"] = 3;
  return {{"attributes", attributes}, {"indices", 2}, {"material", 0}, {"mode", kTriangles}};
}
// view: of an accessor's numbers, at that byte of it; negative: none.
struct AccessorPlace {
  int view, offset;
};
Json accessorsOf(const MeshFacts& f, const std::array<AccessorPlace, 4>& places) {
  Json out = Json::array();
  auto add = [&](int component, uint64_t count, const char* type) -> Json& {
    const AccessorPlace& place = places[out.size()];
    Json accessor = Json::object();
    if (place.view >= 0) accessor["bufferView"] = place.view, accessor["byteOffset"] = place.offset;
    accessor["componentType"] = component;
    accessor["count"] = count;
    accessor["type"] = type;
    out.push_back(accessor);
    return out.back();
  };
  Json& positions = add(kFloat, f.vertices, "VEC3");
  positions["min"] = listOf(f.low);
  positions["max"] = listOf(f.high);
  add(kFloat, f.vertices, "VEC3");
  add(kUnsignedInt, 3 * f.faces, "SCALAR");
  if (f.colours) add(kUnsignedShort, f.vertices, "VEC4")["normalized"] = true;
  return out;
}

ByteBuffer headOf(const Json& document, uint64_t binary) {
  std::string json = document.dump(-1, ' ', true, Json::error_handler_t::replace);
  json.resize(kJsonBytes, ' ');
  ByteBuffer out;
  for (const char c : {'g', 'l', 'T', 'F'}) out.push_back(static_cast<uint8_t>(c));
  put(out, uint32_t{2});
  put(out, static_cast<uint32_t>(kHeadBytes + binary));
  put(out, static_cast<uint32_t>(kJsonBytes));
  put(out, uint32_t{0x4E4F534A});  // JSON
  out.insert(out.end(), json.begin(), json.end());
  put(out, static_cast<uint32_t>(binary));
  put(out, uint32_t{0x004E4942});  // BIN
  return out;
}

class GlbFormat final : public MeshFormat {
 public:
  bool quads() const override { return false; }
  bool takesDraco() const override { return true; }
  bool holdsMaps() const override { return true; }
  Result<void> check(const std::string& path, const MeshFacts& f) const override {
    if (auto good = MeshFormat::check(path, f); !good) return good;
    const uint64_t bytes = kHeadBytes + vertexBytes(f) + indexBytes(f);
    if (bytes <= 0xFFFFFFFF) return {};
    return Error{ErrorKind::kUsage,
                 path,
                 "a .glb holds at most 4 GiB, found " + std::to_string(f.vertices) + " vertices and " +
                     std::to_string(f.faces) + " triangles, which take " + std::to_string(bytes >> 20) + " MiB",
                 "choose a coarser --level, allow an --error-mm, or name a .ply",
                 {}};
  }
  ByteBuffer head(const MeshFacts& f) const override {
    Json json = sceneOf(f, primitiveOf(f));
    json["accessors"] = accessorsOf(f, {AccessorPlace{0, 0}, {0, 12}, {1, 0}, {0, 24}});
    json["bufferViews"] = Json::array();
    json["bufferViews"].push_back({{"buffer", 0},
                                   {"byteOffset", 0},
                                   {"byteLength", vertexBytes(f)},
                                   {"byteStride", strideOf(f)},
                                   {"target", kArrayBuffer}});
    json["bufferViews"].push_back(
        {{"buffer", 0}, {"byteOffset", vertexBytes(f)}, {"byteLength", indexBytes(f)}, {"target", kElementArray}});
    const Json buffer = {{"byteLength", vertexBytes(f) + indexBytes(f)}};
    json["buffers"] = Json::array({buffer});
    return headOf(json, vertexBytes(f) + indexBytes(f));
  }
  void vertex(const MeshFacts& f, const ExportVertex& v, ByteBuffer& out) const override {
    put(out, glm::vec3(v.position));
    put(out, v.normal);
    if (!f.colours) return;
    for (glm::length_t c = 0; c < 3; ++c) put(out, linearLight16()[v.colour[c]]);
    put(out, uint16_t{0xFFFF});
  }
  void face(const std::array<uint32_t, 4>& corners, int count, ByteBuffer& out) const override {
    for (int k = 0; k < count; ++k) put(out, corners[static_cast<size_t>(k)]);
  }
};

}  // namespace

std::unique_ptr<MeshFormat> makeGlbFormat() { return std::make_unique<GlbFormat>(); }

GlbLayout::GlbLayout(const MeshFacts& f)
    : vertices_at(kHeadBytes), stride(strideOf(f)), indices_at(kHeadBytes + vertexBytes(f)) {}

ByteBuffer glbHead(const MeshFacts& f, const GlbDraco& draco) {
  constexpr const char* kExtension = "KHR_draco_mesh_compression";
  const uint64_t binary = (draco.bytes + 3) / 4 * 4;
  Json primitive = primitiveOf(f), attributes = {{"POSITION", draco.position}, {"NORMAL", draco.normal}};
  if (f.colours) attributes["COLOR_0"] = draco.colour;
  primitive["extensions"][kExtension] = {{"bufferView", 0}, {"attributes", attributes}};
  Json json = sceneOf(f, primitive);
  json["extensionsUsed"] = json["extensionsRequired"] = Json::array({kExtension});
  json["accessors"] = accessorsOf(f, {AccessorPlace{-1, 0}, {-1, 0}, {-1, 0}, {-1, 0}});
  const Json view = {{"buffer", 0}, {"byteOffset", 0}, {"byteLength", draco.bytes}}, buffer = {{"byteLength", binary}};
  json["bufferViews"] = Json::array({view});
  json["buffers"] = Json::array({buffer});
  return headOf(json, binary);
}

ByteBuffer glbHead(const MeshFacts& f, const GlbMaps& maps) {
  constexpr int kStride = 48, kTriangles = 4, kLinear = 9729, kLinearMipmaps = 9987, kClamp = 33071;
  const uint64_t vertices = kStride * f.vertices;
  Json json = sceneOf(f, {{"attributes", {{"POSITION", 0}, {"NORMAL", 1}, {"TANGENT", 3}, {"TEXCOORD_0", 4}}},
                          {"indices", 2},
                          {"material", 0},
                          {"mode", kTriangles}});
  json["accessors"] = accessorsOf(f, {AccessorPlace{0, 0}, {0, 12}, {1, 0}, {0, 24}});
  auto floats = [&](int offset, const char* type) {
    json["accessors"].push_back(
        {{"bufferView", 0}, {"byteOffset", offset}, {"componentType", kFloat}, {"count", f.vertices}, {"type", type}});
  };
  floats(24, "VEC4");
  floats(40, "VEC2");
  uint64_t at = 0;
  json["bufferViews"] = Json::array();
  auto view = [&](uint64_t bytes) -> Json& {
    json["bufferViews"].push_back({{"buffer", 0}, {"byteOffset", at}, {"byteLength", bytes}});
    at += (bytes + 3) / 4 * 4;
    return json["bufferViews"].back();
  };
  view(vertices)["byteStride"] = kStride;
  view(indexBytes(f));
  for (const int k : {0, 1}) json["bufferViews"][static_cast<size_t>(k)]["target"] = k ? kElementArray : kArrayBuffer;
  json["samplers"] = Json::array();
  json["samplers"].push_back(
      {{"magFilter", kLinear}, {"minFilter", kLinearMipmaps}, {"wrapS", kClamp}, {"wrapT", kClamp}});
  Json& material = json["materials"][0];
  auto image = [&](uint64_t bytes, const char* name) {
    view(bytes);
    json["images"].push_back(
        {{"bufferView", json["bufferViews"].size() - 1}, {"mimeType", "image/png"}, {"name", name}});
    json["textures"].push_back({{"sampler", 0}, {"source", json["images"].size() - 1}});
    return Json{{"index", json["textures"].size() - 1}};
  };
  material["pbrMetallicRoughness"]["baseColorTexture"] = image(maps.colour_bytes, "colour");
  if (maps.normal_bytes > 0) material["normalTexture"] = image(maps.normal_bytes, "normal");
  const Json buffer = {{"byteLength", at}};
  json["buffers"] = Json::array({buffer});
  return headOf(json, at);
}

}  // namespace relievo
