// gltf_document.h - the JSON of a glTF 2.0 file as plain data: what a mesh's surface needs of it, with every index in
// range and every number of its kind. Internal to mesh_read_gltf. Safe for untrusted text.
//
// nlohmann-json stands in gltf_document.cpp alone. Offsets and lengths are not compared with files here: gltf_buffers
// does that, for what is used.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <glm/glm.hpp>

#include "src/base/result.h"

namespace relievo::mesh_file {

inline constexpr uint32_t kNoIndex = std::numeric_limits<uint32_t>::max();

struct GltfBuffer {
  std::string uri;  // empty: the binary chunk of a .glb
  uint64_t bytes = 0;
};
// EXT_meshopt_compression: where the compressed elements lie, and how.
struct GltfPacking {
  enum class Mode : uint8_t { kAttributes, kTriangles, kIndices };
  enum class Filter : uint8_t { kNone, kOctahedral, kQuaternion, kExponential };
  uint32_t buffer = 0, stride = 0;
  uint64_t offset = 0, bytes = 0, count = 0;
  Mode mode = Mode::kAttributes;
  Filter filter = Filter::kNone;
};
struct GltfView {
  uint32_t buffer = 0, stride = 0;  // 0: elements lie one behind the other
  uint64_t offset = 0, bytes = 0;
  std::optional<GltfPacking> packed;  // then its buffer may hold nothing
};
enum class GltfComponent : uint8_t { kInt8, kUint8, kInt16, kUint16, kUint32, kFloat };
constexpr size_t bytesOfComponent(GltfComponent c) {
  return c == GltfComponent::kInt8 || c == GltfComponent::kUint8     ? 1
         : c == GltfComponent::kInt16 || c == GltfComponent::kUint16 ? 2
                                                                     : 4;
}
struct GltfAccessor {
  uint32_t view = kNoIndex;
  GltfComponent component = GltfComponent::kFloat;
  uint8_t components = 1;  // of an element: 1 to 4, of matrices up to 16
  bool normalized = false, sparse = false;
  uint64_t offset = 0, count = 0;
};
struct GltfImage {
  std::string uri;  // empty: in `view`
  uint32_t view = kNoIndex;
};
struct GltfTexture {
  uint32_t image = kNoIndex;  // none that this program reads
  bool repeats = true;
};
// Which texture coordinates an image has.
struct GltfPlacement {
  int uv_set = 0;
  // KHR_texture_transform: uv -> offset + turned(scale * uv).
  glm::dvec2 offset{0}, scale{1};
  double turn = 0;
  bool operator==(const GltfPlacement&) const = default;
};
struct GltfMap {
  uint32_t texture = kNoIndex;
  GltfPlacement placement;
};
struct GltfMaterial {
  glm::dvec3 colour{1};  // linear light; the base colour, or the diffuse one of KHR_materials_pbrSpecularGlossiness
  GltfMap colours, normals;
  double normal_scale = 1;
  std::string name;
  // Of the images that are read: the colours', or where there are none the normals'.
  const GltfPlacement& placement() const { return (colours.texture == kNoIndex ? normals : colours).placement; }
};
struct GltfPrimitive {
  enum class Mode : uint8_t { kPoints, kLines, kLineLoop, kLineStrip, kTriangles, kStrip, kFan };
  uint32_t positions = kNoIndex, colours = kNoIndex, uv = kNoIndex, indices = kNoIndex, material = kNoIndex;
  uint32_t normals = kNoIndex, tangents = kNoIndex;  // where its material has a map of normals, which counts from them
  Mode mode = Mode::kTriangles;
  bool morphs = false;
  // KHR_draco_mesh_compression: the view of the code, and the attributes' numbers in it.
  struct Draco {
    uint32_t view = kNoIndex, positions = kNoIndex, colours = kNoIndex, uv = kNoIndex, normals = kNoIndex,
             tangents = kNoIndex;
  };
  std::optional<Draco> draco;
};
struct GltfMesh {
  std::vector<GltfPrimitive> primitives;
};
struct GltfNode {
  uint32_t mesh = kNoIndex;
  uint32_t matrix = kNoIndex;  // of GltfDocument::matrices; none: it stays where its parent is
  bool skinned = false;
  std::vector<uint32_t> children;
};
struct GltfDocument {
  std::vector<GltfBuffer> buffers;
  std::vector<GltfView> views;
  std::vector<GltfAccessor> accessors;
  std::vector<GltfImage> images;
  std::vector<GltfTexture> textures;
  std::vector<GltfMaterial> materials;
  std::vector<GltfMesh> meshes;
  std::vector<GltfNode> nodes;
  std::vector<glm::dmat4> matrices;
  std::vector<uint32_t> roots;  // nodes of the scene that is shown
};

// path: for errors. kUnsupported names the required extensions that it does not know.
Result<GltfDocument> parseGltf(std::string_view json, const std::string& path);

}  // namespace relievo::mesh_file
