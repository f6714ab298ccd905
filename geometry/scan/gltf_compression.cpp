#include "geometry/scan/gltf_compression.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <exception>
#include <limits>
#include <memory>
#include <optional>

#include <draco/compression/decode.h>
#include <draco/mesh/mesh.h>
#include <meshoptimizer.h>

namespace relievo::mesh_file {
namespace {

// A triangle and a point of what Draco codes take no less than that: a corner's symbol has a bit or more, but what
// repeats is coded in a part of it.
constexpr uint64_t kMostADracoByte = 256;

// The numbers at the beginning of a code, which its decoder would trust.
class DracoHead {
 public:
  explicit DracoHead(std::span<const uint8_t> code) : code_(code) {}
  // Says what is wrong, or nothing.
  std::string check(uint64_t points, uint64_t triangles) {
    constexpr std::array<uint8_t, 5> kMagic{'D', 'R', 'A', 'C', 'O'};
    constexpr uint8_t kMesh = 1, kEdgebreaker = 1;
    constexpr uint32_t kHasMetadata = 0x8000;
    std::array<uint8_t, 11> head{};
    for (uint8_t& b : head) b = byte();
    if (short_ || !std::equal(kMagic.begin(), kMagic.end(), head.begin())) return "its first bytes are not Draco's";
    const int version = 256 * head[5] + head[6];
    if (version != 0x202 || head[7] != kMesh)
      return "expected a mesh of Draco's version 2.2, found version " + std::to_string(head[5]) + "." +
             std::to_string(head[6]);
    if ((head[9] | head[10] << 8) & kHasMetadata) return "it has metadata, which this program does not read";
    uint64_t first, second;
    if (head[8] == kEdgebreaker) {
      byte();  // the kind of traversal
      second = number(), first = number();
    } else {
      first = number(), second = number();
    }
    if (short_) return "it ends within its head";
    // Edgebreaker counts vertices of the surface, of which seams make several points.
    if (first != triangles || (head[8] != kEdgebreaker && second != points) || second > points)
      return "it has " + std::to_string(first) + " triangles and " + std::to_string(second) +
             " vertices, its accessors " + std::to_string(triangles) + " and " + std::to_string(points);
    if (const uint64_t most = kMostADracoByte * code_.size(); first > most || points > most)
      return "so few bytes cannot be " + std::to_string(first) + " triangles";
    return {};
  }

 private:
  uint8_t byte() {
    if (at_ < code_.size()) return code_[at_++];
    short_ = true;
    return 0;
  }
  uint64_t number() {
    uint64_t out = 0;
    for (int shift = 0; shift < 63; shift += 7) {
      const uint8_t b = byte();
      out |= static_cast<uint64_t>(b & 0x7F) << shift;
      if (!(b & 0x80)) return out;
    }
    short_ = true;
    return 0;
  }
  std::span<const uint8_t> code_;
  size_t at_ = 0;
  bool short_ = false;
};

template <class T>
bool convert(const draco::PointAttribute& attribute, uint32_t points, uint8_t components, std::vector<uint8_t>& out) {
  std::array<T, 16> values{};
  uint8_t* at = out.data();
  for (uint32_t i = 0; i < points; ++i, at += components * sizeof(T)) {
    const draco::AttributeValueIndex index = attribute.mapped_index(draco::PointIndex(i));
    if (index.value() >= attribute.size() ||
        !attribute.ConvertValue<T>(index, static_cast<int8_t>(components), values.data()))
      return false;
    std::memcpy(at, values.data(), components * sizeof(T));
  }
  return true;
}
bool convert(const draco::PointAttribute& attribute, uint32_t points, DracoPart& part) {
  switch (part.as.component) {
    case GltfComponent::kInt8:
      return convert<int8_t>(attribute, points, part.as.components, part.bytes);
    case GltfComponent::kUint8:
      return convert<uint8_t>(attribute, points, part.as.components, part.bytes);
    case GltfComponent::kInt16:
      return convert<int16_t>(attribute, points, part.as.components, part.bytes);
    case GltfComponent::kUint16:
      return convert<uint16_t>(attribute, points, part.as.components, part.bytes);
    case GltfComponent::kUint32:
      return convert<uint32_t>(attribute, points, part.as.components, part.bytes);
    case GltfComponent::kFloat:
      return convert<float>(attribute, points, part.as.components, part.bytes);
  }
  return false;
}

// False: an index is larger than the accessor's numbers.
bool takeIndices(const draco::Mesh& mesh, DracoPart& part) {
  const size_t bytes = bytesOfComponent(part.as.component);
  const uint64_t most = bytes == 4 ? ~uint32_t{0} : (uint64_t{1} << 8 * bytes) - 1;
  uint8_t* at = part.bytes.data();
  for (draco::FaceIndex f(0); f < mesh.num_faces(); ++f)
    for (int k = 0; k < 3; ++k, at += bytes) {
      const uint32_t v = mesh.face(f)[k].value();
      if (v > most) return false;
      for (size_t b = 0; b < bytes; ++b) at[b] = static_cast<uint8_t>(v >> 8 * b);
    }
  return true;
}

std::string decode(std::span<const uint8_t> code, size_t attributes, std::span<DracoPart> parts) {
  uint64_t points = attributes > 0 ? parts[0].as.count : 0, corners = 0;
  for (size_t i = 0; i < parts.size(); ++i) {
    if (i >= attributes) corners = parts[i].as.count;
    else if (parts[i].as.count != points) return "its accessors differ in how many elements they have";
    if (parts[i].as.components > 4) return "its accessors have too many numbers each";
  }
  if (corners % 3 != 0) return "expected three indices a triangle";
  if (points > std::numeric_limits<uint32_t>::max()) return "it has too many points";
  if (std::string problem = DracoHead(code).check(points, corners / 3); !problem.empty()) return problem;
  draco::DecoderBuffer buffer;
  buffer.Init(reinterpret_cast<const char*>(code.data()), code.size());
  draco::Decoder decoder;
  auto decoded = decoder.DecodeMeshFromBuffer(&buffer);
  if (!decoded.ok()) return "Draco says: " + decoded.status().error_msg_string();
  const std::unique_ptr<draco::Mesh> mesh = std::move(decoded).value();
  if (mesh->num_points() != points || mesh->num_faces() != corners / 3)
    return "it has " + std::to_string(mesh->num_points()) + " points, its accessors " + std::to_string(points);
  for (size_t i = 0; i < parts.size(); ++i) {
    DracoPart& part = parts[i];
    part.bytes.resize(static_cast<size_t>(part.as.count) * part.as.components * bytesOfComponent(part.as.component));
    if (i >= attributes) {
      if (part.as.components != 1 || !takeIndices(*mesh, part)) return "its indices do not fit their accessor";
      continue;
    }
    const draco::PointAttribute* attribute = mesh->GetAttributeByUniqueId(part.attribute);
    if (!attribute) return "it has no attribute " + std::to_string(part.attribute);
    if (attribute->num_components() < part.as.components &&
        !(part.as.components == 4 && attribute->num_components() == 3))
      return "its attribute " + std::to_string(part.attribute) + " has too few numbers";
    if (!convert(*attribute, mesh->num_points(), part))
      return "its attribute " + std::to_string(part.attribute) + " does not fit its accessor";
  }
  return {};
}

}  // namespace

bool decompressMeshopt(const GltfPacking& p, std::span<const uint8_t> code, std::span<uint8_t> out) {
  const auto count = static_cast<size_t>(p.count);
  if (p.mode == GltfPacking::Mode::kTriangles)
    return count % 3 == 0 && meshopt_decodeIndexBuffer(out.data(), count, p.stride, code.data(), code.size()) == 0;
  if (p.mode == GltfPacking::Mode::kIndices)
    return meshopt_decodeIndexSequence(out.data(), count, p.stride, code.data(), code.size()) == 0;
  if (meshopt_decodeVertexBuffer(out.data(), count, p.stride, code.data(), code.size()) != 0) return false;
  switch (p.filter) {
    case GltfPacking::Filter::kNone:
      return true;
    case GltfPacking::Filter::kOctahedral:
      if (p.stride == 4 || p.stride == 8) meshopt_decodeFilterOct(out.data(), count, p.stride);
      return p.stride == 4 || p.stride == 8;
    case GltfPacking::Filter::kQuaternion:
      if (p.stride == 8) meshopt_decodeFilterQuat(out.data(), count, p.stride);
      return p.stride == 8;
    case GltfPacking::Filter::kExponential:
      meshopt_decodeFilterExp(out.data(), count, p.stride);
      return true;
  }
  return false;
}

std::string decompressDraco(std::span<const uint8_t> code, size_t attributes, std::span<DracoPart> parts) {
  // A damaged code may ask for any amount of memory.
  try {
    return decode(code, attributes, parts);
  } catch (const std::exception& e) {
    return std::string("Draco fails: ") + e.what();
  }
}

}  // namespace relievo::mesh_file
