#include "geometry/scan/gltf_document.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <optional>

#include "geometry/scan/mesh_file.h"
#include "src/base/json_parse.h"

namespace relievo::mesh_file {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kLargestNumber = 9007199254740992.0;  // 2^53: beyond it doubles of JSON leave out integers

// One object of the file, named as a path: "accessors[3]". Steps after an error do nothing.
class Parser {
 public:
  explicit Parser(const std::string& path) : path_(path) {}
  bool failed() const { return failed_; }
  const Error& error() const { return error_; }
  void note(std::string message, std::string hint = "the file is damaged; get a whole copy, or write it anew",
            ErrorKind kind = ErrorKind::kInvalidData) {
    if (failed_) return;
    failed_ = true;
    error_ = {kind, path_, std::move(message), std::move(hint), {}};
  }

  const Json* find(const Json& object, const char* key) {
    if (!object.is_object()) return nullptr;
    const auto at = object.find(key);
    return at == object.end() ? nullptr : &*at;
  }
  // An integer from 0 to most. Without the key: otherwise; where that is none, an error.
  uint64_t integer(const Json& object, const std::string& where, const char* key, uint64_t most,
                   std::optional<uint64_t> otherwise = {}) {
    const Json* value = find(object, key);
    if (!value && otherwise) return *otherwise;
    const double number = value && value->is_number() ? value->get<double>() : -1;
    if (number >= 0 && number <= kLargestNumber && number == std::floor(number) && number <= static_cast<double>(most))
      return static_cast<uint64_t>(number);
    note("expected " + where + "." + key + " to be an integer of 0 to " + std::to_string(most) + ", found " +
         (!value               ? "none"
          : value->is_number() ? numberText(value->get<double>())
                               : std::string("a ") + value->type_name()));
    return 0;
  }
  // An index into a list of n; kNoIndex where it is not given.
  uint32_t index(const Json& object, const std::string& where, const char* key, size_t n) {
    if (!find(object, key)) return kNoIndex;
    if (n == 0) note("expected " + where + "." + key + " to name one of a list, which the file does not have");
    return static_cast<uint32_t>(integer(object, where, key, n > 0 ? n - 1 : 0));
  }
  // The same of a list's own entry, which names one of n nodes.
  uint32_t node(const Json& entry, const std::string& where, size_t n) {
    const double number = entry.is_number() ? entry.get<double>() : -1;
    if (number >= 0 && number < static_cast<double>(n) && number == std::floor(number))
      return static_cast<uint32_t>(number);
    note("expected " + where + " to be one of the file's " + std::to_string(n) + " nodes");
    return 0;
  }
  bool flag(const Json& object, const std::string& where, const char* key) {
    const Json* value = find(object, key);
    if (value && !value->is_boolean()) note("expected " + where + "." + key + " to be true or false");
    return value && value->is_boolean() && value->get<bool>();
  }
  std::string text(const Json& object, const std::string& where, const char* key) {
    const Json* value = find(object, key);
    if (value && !value->is_string()) note("expected " + where + "." + key + " to be text");
    return value && value->is_string() ? value->get<std::string>() : std::string();
  }
  // n numbers; false: not given.
  template <size_t n>
  bool numbers(const Json& object, const std::string& where, const char* key, std::array<double, n>& out) {
    const Json* value = find(object, key);
    if (!value) return false;
    bool good = value->is_array() && value->size() == n;
    for (size_t i = 0; good && i < n; ++i) {
      good = (*value)[i].is_number() && std::isfinite((*value)[i].get<double>());
      if (good) out[i] = (*value)[i].get<double>();
    }
    if (!good) note("expected " + where + "." + key + " to be " + std::to_string(n) + " numbers");
    return good;
  }
  // Calls one(object, "name[i]") for each of a list, which need not be there.
  template <class F>
  void each(const Json& object, const std::string& where, const char* key, F&& one) {
    const Json* list = find(object, key);
    if (!list || failed_) return;
    const std::string name = where.empty() ? key : where + "." + key;
    if (!list->is_array()) return note("expected " + name + " to be a list");
    for (size_t i = 0; i < list->size() && !failed_; ++i) one((*list)[i], name + "[" + std::to_string(i) + "]");
  }
  size_t lengthOf(const Json& object, const char* key) {
    const Json* list = find(object, key);
    return list && list->is_array() ? list->size() : 0;
  }

 private:
  const std::string& path_;
  bool failed_ = false;
  Error error_;
};

// What is known: appearance alone, or read here.
bool knownExtension(const std::string& name) {
  for (const char* known :
       {"KHR_mesh_quantization", "KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_transform",
        "EXT_texture_webp", "KHR_lights_punctual", "KHR_xmp_json_ld", "KHR_xmp", "KHR_animation_pointer"})
    if (name == known) return true;
  return name.starts_with("KHR_materials_");
}

class DocumentParser {
 public:
  DocumentParser(const Json& json, const std::string& path) : json_(json), p_(path) {}

  Result<GltfDocument> parse() {
    if (!json_.is_object()) p_.note("expected a JSON object", "this is no glTF file");
    checkAsset();
    checkExtensions();
    for (auto step :
         {&DocumentParser::buffers, &DocumentParser::accessors, &DocumentParser::images, &DocumentParser::materials,
          &DocumentParser::meshes, &DocumentParser::nodes, &DocumentParser::scene})
      if (!p_.failed()) (this->*step)();
    if (p_.failed()) return p_.error();
    return std::move(out_);
  }

 private:
  void checkAsset() {
    const Json* asset = p_.find(json_, "asset");
    const std::string version = asset ? p_.text(*asset, "asset", "version") : "";
    if (version == "2.0") return;
    if (version.starts_with("1."))
      return p_.note("expected glTF 2.0, found version " + inQuotes(version), "write it as glTF 2.0",
                     ErrorKind::kUnsupported);
    const std::string least = asset ? p_.text(*asset, "asset", "minVersion") : "";
    if (version.starts_with("2.") && (least.empty() || least == "2.0")) return;
    p_.note("expected asset.version 2.0, found " + inQuotes(version), "this is no glTF 2.0 file");
  }

  void checkExtensions() {
    std::string unknown;
    size_t n = 0;
    p_.each(json_, "", "extensionsRequired", [&](const Json& name, const std::string& where) {
      if (!name.is_string()) return p_.note("expected " + where + " to be text");
      const auto& text = name.get_ref<const std::string&>();
      if (knownExtension(text) || ++n > 4) return;
      unknown += (unknown.empty() ? "" : ", ") + inQuotes(text);
    });
    if (!unknown.empty())
      p_.note("it requires " + unknown + ", which this program does not read",
              "write it without: no compression of textures (Basis, WebP)", ErrorKind::kUnsupported);
  }

  void buffers() {
    p_.each(json_, "", "buffers", [&](const Json& b, const std::string& where) {
      GltfBuffer buffer{p_.text(b, where, "uri"), 0};
      buffer.bytes = p_.integer(b, where, "byteLength", uint64_t{1} << 52);
      out_.buffers.push_back(std::move(buffer));
    });
    p_.each(json_, "", "bufferViews", [&](const Json& v, const std::string& where) {
      GltfView view;
      view.buffer = p_.index(v, where, "buffer", out_.buffers.size());
      if (view.buffer == kNoIndex) p_.note("expected " + where + ".buffer, found none");
      view.offset = p_.integer(v, where, "byteOffset", uint64_t{1} << 52, 0);
      view.bytes = p_.integer(v, where, "byteLength", uint64_t{1} << 52);
      view.stride = static_cast<uint32_t>(p_.integer(v, where, "byteStride", 252, 0));
      if (const Json* extensions = p_.find(v, "extensions"))
        if (const Json* packed = p_.find(*extensions, "EXT_meshopt_compression"))
          view.packed = packing(*packed, where + ".extensions.EXT_meshopt_compression");
      out_.views.push_back(view);
    });
  }
  GltfPacking packing(const Json& json, const std::string& where) {
    GltfPacking out;
    out.buffer = p_.index(json, where, "buffer", out_.buffers.size());
    if (out.buffer == kNoIndex) p_.note("expected " + where + ".buffer, found none");
    out.offset = p_.integer(json, where, "byteOffset", uint64_t{1} << 52, 0);
    out.bytes = p_.integer(json, where, "byteLength", uint64_t{1} << 52);
    out.stride = static_cast<uint32_t>(p_.integer(json, where, "byteStride", 256));
    out.count = p_.integer(json, where, "count", uint64_t{1} << 52);
    constexpr std::array<const char*, 3> kModes{"ATTRIBUTES", "TRIANGLES", "INDICES"};
    constexpr std::array<const char*, 4> kFilters{"NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL"};
    const auto oneOf = [&](const char* key, std::span<const char* const> known, const std::string& text) -> size_t {
      for (size_t i = 0; i < known.size(); ++i)
        if (text == known[i]) return i;
      p_.note("expected " + where + "." + key + " to be " + known.front() + " to " + known.back() + ", found " +
                  inQuotes(text),
              "write the file without compression", ErrorKind::kUnsupported);
      return 0;
    };
    out.mode = static_cast<GltfPacking::Mode>(oneOf("mode", kModes, p_.text(json, where, "mode")));
    if (p_.find(json, "filter"))
      out.filter = static_cast<GltfPacking::Filter>(oneOf("filter", kFilters, p_.text(json, where, "filter")));
    const bool attributes = out.mode == GltfPacking::Mode::kAttributes;
    if (attributes ? out.stride == 0 || out.stride % 4 != 0 : out.stride != 2 && out.stride != 4)
      p_.note("expected " + where + ".byteStride to be " + (attributes ? "a multiple of 4" : "2 or 4") + ", found " +
              std::to_string(out.stride));
    return out;
  }

  void accessors() {
    p_.each(json_, "", "accessors", [&](const Json& a, const std::string& where) {
      GltfAccessor accessor;
      accessor.view = p_.index(a, where, "bufferView", out_.views.size());
      accessor.offset = p_.integer(a, where, "byteOffset", uint64_t{1} << 52, 0);
      accessor.count = p_.integer(a, where, "count", uint64_t{1} << 52);
      accessor.normalized = p_.flag(a, where, "normalized");
      accessor.sparse = p_.find(a, "sparse") != nullptr;
      switch (p_.integer(a, where, "componentType", 5126)) {
        case 5120:
          accessor.component = GltfComponent::kInt8;
          break;
        case 5121:
          accessor.component = GltfComponent::kUint8;
          break;
        case 5122:
          accessor.component = GltfComponent::kInt16;
          break;
        case 5123:
          accessor.component = GltfComponent::kUint16;
          break;
        case 5125:
          accessor.component = GltfComponent::kUint32;
          break;
        case 5126:
          accessor.component = GltfComponent::kFloat;
          break;
        default:
          p_.note("expected " + where + ".componentType to be 5120 to 5123, 5125 or 5126");
      }
      const std::string type = p_.text(a, where, "type");
      constexpr std::pair<const char*, uint8_t> kTypes[] = {{"SCALAR", 1}, {"VEC2", 2}, {"VEC3", 3}, {"VEC4", 4},
                                                            {"MAT2", 4},   {"MAT3", 9}, {"MAT4", 16}};
      accessor.components = 0;
      for (const auto& [name, n] : kTypes)
        if (type == name) accessor.components = n;
      if (accessor.components == 0)
        p_.note("expected " + where + ".type to be SCALAR, VEC2, VEC3, VEC4 or a matrix, found " + inQuotes(type));
      out_.accessors.push_back(accessor);
    });
  }

  void images() {
    p_.each(json_, "", "images", [&](const Json& i, const std::string& where) {
      GltfImage image{p_.text(i, where, "uri"), p_.index(i, where, "bufferView", out_.views.size())};
      out_.images.push_back(std::move(image));
    });
    std::vector<bool> repeats;
    p_.each(json_, "", "samplers", [&](const Json& s, const std::string& where) {
      constexpr uint64_t kClamp = 33071, kRepeat = 10497, kMost = 65535;
      repeats.push_back(p_.integer(s, where, "wrapS", kMost, kRepeat) != kClamp ||
                        p_.integer(s, where, "wrapT", kMost, kRepeat) != kClamp);
    });
    p_.each(json_, "", "textures", [&](const Json& t, const std::string& where) {
      GltfTexture texture;
      texture.image = p_.index(t, where, "source", out_.images.size());
      const Json* extensions = texture.image == kNoIndex ? p_.find(t, "extensions") : nullptr;
      if (const Json* webp = extensions ? p_.find(*extensions, "EXT_texture_webp") : nullptr)
        texture.image = p_.index(*webp, where + ".extensions.EXT_texture_webp", "source", out_.images.size());
      const uint32_t sampler = p_.index(t, where, "sampler", repeats.size());
      texture.repeats = p_.failed() || sampler == kNoIndex || repeats[sampler];
      out_.textures.push_back(texture);
    });
  }

  void materials() {
    p_.each(json_, "", "materials", [&](const Json& m, const std::string& where) {
      GltfMaterial material;
      material.name = p_.text(m, where, "name");
      material.name.resize(std::min<size_t>(material.name.size(), 100));
      if (const Json* normals = p_.find(m, "normalTexture")) {
        material.normals = mapOf(*normals, where + ".normalTexture");
        if (const Json* scale = p_.find(*normals, "scale")) {
          if (!scale->is_number()) return p_.note("expected " + where + ".normalTexture.scale to be a number");
          material.normal_scale = scale->get<double>();
        }
      }
      const Json* extensions = p_.find(m, "extensions");
      if (const Json* gloss = extensions ? p_.find(*extensions, "KHR_materials_pbrSpecularGlossiness") : nullptr)
        baseColour(*gloss, where + ".extensions.KHR_materials_pbrSpecularGlossiness", "diffuseFactor", "diffuseTexture",
                   material);
      else if (const Json* pbr = p_.find(m, "pbrMetallicRoughness"))
        baseColour(*pbr, where + ".pbrMetallicRoughness", "baseColorFactor", "baseColorTexture", material);
      out_.materials.push_back(std::move(material));
    });
  }
  void baseColour(const Json& from, const std::string& in, const char* factor, const char* image,
                  GltfMaterial& material) {
    std::array<double, 4> colour{};
    if (p_.numbers(from, in, factor, colour)) material.colour = {colour[0], colour[1], colour[2]};
    if (const Json* texture = p_.find(from, image)) material.colours = mapOf(*texture, in + "." + image);
  }
  GltfMap mapOf(const Json& texture, const std::string& where) {
    GltfMap map;
    GltfPlacement& placement = map.placement;
    map.texture = p_.index(texture, where, "index", out_.textures.size());
    placement.uv_set = static_cast<int>(p_.integer(texture, where, "texCoord", 255, 0));
    const Json* extensions = p_.find(texture, "extensions");
    const Json* turn = extensions ? p_.find(*extensions, "KHR_texture_transform") : nullptr;
    if (!turn) return map;
    std::array<double, 2> pair{};
    if (p_.numbers(*turn, where, "offset", pair)) placement.offset = {pair[0], pair[1]};
    if (p_.numbers(*turn, where, "scale", pair)) placement.scale = {pair[0], pair[1]};
    if (const Json* angle = p_.find(*turn, "rotation")) {
      if (angle->is_number()) placement.turn = angle->get<double>();
      else p_.note("expected " + where + ".rotation to be a number");
    }
    placement.uv_set =
        static_cast<int>(p_.integer(*turn, where, "texCoord", 255, static_cast<uint64_t>(placement.uv_set)));
    return map;
  }

  void meshes() {
    p_.each(json_, "", "meshes", [&](const Json& m, const std::string& where) {
      GltfMesh mesh;
      p_.each(m, where, "primitives", [&](const Json& p, const std::string& in) {
        GltfPrimitive primitive;
        const size_t accessors = out_.accessors.size();
        primitive.material = p_.index(p, in, "material", out_.materials.size());
        primitive.mode = static_cast<GltfPrimitive::Mode>(p_.integer(p, in, "mode", 6, 4));
        primitive.indices = p_.index(p, in, "indices", accessors);
        primitive.morphs = p_.lengthOf(p, "targets") > 0;
        if (const Json* attributes = p_.find(p, "attributes")) {
          primitive.positions = p_.index(*attributes, in + ".attributes", "POSITION", accessors);
          primitive.colours = p_.index(*attributes, in + ".attributes", "COLOR_0", accessors);
          const GltfMaterial plain;
          const GltfMaterial& material =
              p_.failed() || primitive.material == kNoIndex ? plain : out_.materials[primitive.material];
          const int set = material.placement().uv_set;
          if (material.normals.texture != kNoIndex) {
            primitive.normals = p_.index(*attributes, in + ".attributes", "NORMAL", accessors);
            primitive.tangents = p_.index(*attributes, in + ".attributes", "TANGENT", accessors);
          }
          const std::string name = "TEXCOORD_" + std::to_string(set);
          primitive.uv = p_.index(*attributes, in + ".attributes", name.c_str(), accessors);
          if (const Json* extensions = p_.find(p, "extensions"))
            if (const Json* code = p_.find(*extensions, "KHR_draco_mesh_compression"))
              primitive.draco = draco(*code, in + ".extensions.KHR_draco_mesh_compression", name);
        }
        mesh.primitives.push_back(primitive);
      });
      out_.meshes.push_back(std::move(mesh));
    });
  }

  GltfPrimitive::Draco draco(const Json& json, const std::string& where, const std::string& uv) {
    GltfPrimitive::Draco out;
    out.view = p_.index(json, where, "bufferView", out_.views.size());
    if (out.view == kNoIndex) p_.note("expected " + where + ".bufferView, found none");
    const Json* attributes = p_.find(json, "attributes");
    if (!attributes) return out;
    const auto number = [&](const std::string& name) {
      return p_.index(*attributes, where + ".attributes", name.c_str(), kNoIndex);
    };
    out.positions = number("POSITION"), out.colours = number("COLOR_0"), out.uv = number(uv);
    out.normals = number("NORMAL"), out.tangents = number("TANGENT");
    return out;
  }

  void nodes() {
    const size_t n = p_.lengthOf(json_, "nodes");
    p_.each(json_, "", "nodes", [&](const Json& node, const std::string& where) {
      GltfNode out;
      out.mesh = p_.index(node, where, "mesh", out_.meshes.size());
      out.skinned = p_.find(node, "skin") != nullptr;
      p_.each(node, where, "children",
              [&](const Json& child, const std::string& in) { out.children.push_back(p_.node(child, in, n)); });
      if (glm::dmat4 matrix; transform(node, where, matrix)) {
        out.matrix = static_cast<uint32_t>(out_.matrices.size());
        out_.matrices.push_back(matrix);
      }
      out_.nodes.push_back(std::move(out));
    });
  }
  // False: none. Columns of a matrix, or translation * rotation (a quaternion x y z w) * scale.
  bool transform(const Json& node, const std::string& where, glm::dmat4& matrix) {
    std::array<double, 16> whole{};
    if (p_.numbers(node, where, "matrix", whole)) {
      for (int c = 0; c < 4; ++c)
        for (int r = 0; r < 4; ++r) matrix[c][r] = whole[static_cast<size_t>(4 * c + r)];
      return true;
    }
    std::array<double, 3> move{0, 0, 0}, scale{1, 1, 1};
    std::array<double, 4> q{0, 0, 0, 1};
    const bool moves = p_.numbers(node, where, "translation", move), turns = p_.numbers(node, where, "rotation", q),
               scales = p_.numbers(node, where, "scale", scale);
    if (!moves && !turns && !scales) return false;
    const double length = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(length > 0)) {
      p_.note("expected " + where + ".rotation to be a quaternion of length 1");
      return false;
    }
    const double x = q[0] / length, y = q[1] / length, z = q[2] / length, w = q[3] / length;
    matrix = glm::dmat4(1);
    matrix[0] = glm::dvec4(1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w), 0) * scale[0];
    matrix[1] = glm::dvec4(2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w), 0) * scale[1];
    matrix[2] = glm::dvec4(2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y), 0) * scale[2];
    matrix[3] = {move[0], move[1], move[2], 1};
    return true;
  }

  // The scene that the file names, or its first; of a file without scenes all nodes that are no children.
  void scene() {
    const size_t scenes = p_.lengthOf(json_, "scenes");
    if (scenes == 0) {
      std::vector<bool> child(out_.nodes.size());
      for (const GltfNode& node : out_.nodes)
        for (const uint32_t c : node.children) child[c] = true;
      for (size_t i = 0; i < child.size(); ++i)
        if (!child[i]) out_.roots.push_back(static_cast<uint32_t>(i));
      return;
    }
    const uint32_t shown = p_.index(json_, "the file", "scene", scenes);
    if (p_.failed()) return;
    const Json& one = (*p_.find(json_, "scenes"))[shown == kNoIndex ? 0 : shown];
    p_.each(one, "the scene", "nodes", [&](const Json& node, const std::string& in) {
      out_.roots.push_back(p_.node(node, in, out_.nodes.size()));
    });
  }

  const Json& json_;
  Parser p_;
  GltfDocument out_;
};

}  // namespace

Result<GltfDocument> parseGltf(std::string_view text, const std::string& path) {
  auto json = parseJson(text, path);
  if (!json) return json.error();
  return DocumentParser(*json, path).parse();
}

}  // namespace relievo::mesh_file
