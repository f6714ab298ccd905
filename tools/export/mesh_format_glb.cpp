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

class GlbFormat final : public MeshFormat {
 public:
  bool quads() const override { return false; }
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
    std::string json = jsonOf(f).dump(-1, ' ', true, nlohmann::ordered_json::error_handler_t::replace);
    json.resize(kJsonBytes, ' ');
    const uint64_t binary = vertexBytes(f) + indexBytes(f);
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

 private:
  static uint64_t stride(const MeshFacts& f) { return f.colours ? 32 : 24; }
  static uint64_t vertexBytes(const MeshFacts& f) { return f.vertices * stride(f); }
  static uint64_t indexBytes(const MeshFacts& f) { return f.faces * 12; }

  static nlohmann::ordered_json jsonOf(const MeshFacts& f) {
    using Json = nlohmann::ordered_json;
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
    Json attributes = {{"POSITION", 0}, {"NORMAL", 1}};
    if (f.colours) attributes["COLOR_0"] = 3;
    constexpr int kTriangles = 4;
    const Json primitive = {{"attributes", attributes}, {"indices", 2}, {"material", 0}, {"mode", kTriangles}};
    const Json mesh = {{"primitives", Json::array({primitive})}};
    json["meshes"] = Json::array({mesh});
    const Json material = {{"pbrMetallicRoughness", {{"metallicFactor", 0}, {"roughnessFactor", 1}}},
                           {"doubleSided", true}};
    json["materials"] = Json::array({material});
    json["accessors"] = Json::array();
    auto accessor = [&](int view, int offset, int component, uint64_t count, const char* type) -> Json& {
      json["accessors"].push_back({{"bufferView", view},
                                   {"byteOffset", offset},
                                   {"componentType", component},
                                   {"count", count},
                                   {"type", type}});
      return json["accessors"].back();
    };
    Json& positions = accessor(0, 0, kFloat, f.vertices, "VEC3");
    positions["min"] = listOf(f.low);
    positions["max"] = listOf(f.high);
    accessor(0, 12, kFloat, f.vertices, "VEC3");
    accessor(1, 0, kUnsignedInt, 3 * f.faces, "SCALAR");
    if (f.colours) accessor(0, 24, kUnsignedShort, f.vertices, "VEC4")["normalized"] = true;
    json["bufferViews"] = Json::array();
    json["bufferViews"].push_back({{"buffer", 0},
                                   {"byteOffset", 0},
                                   {"byteLength", vertexBytes(f)},
                                   {"byteStride", stride(f)},
                                   {"target", kArrayBuffer}});
    json["bufferViews"].push_back(
        {{"buffer", 0}, {"byteOffset", vertexBytes(f)}, {"byteLength", indexBytes(f)}, {"target", kElementArray}});
    const Json buffer = {{"byteLength", vertexBytes(f) + indexBytes(f)}};
    json["buffers"] = Json::array({buffer});
    return json;
  }
};

}  // namespace

std::unique_ptr<MeshFormat> makeGlbFormat() { return std::make_unique<GlbFormat>(); }

}  // namespace relievo
