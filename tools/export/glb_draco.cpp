#include "tools/export/glb_draco.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <exception>
#include <memory>
#include <utility>
#include <vector>

#include <draco/compression/encode.h>
#include <draco/mesh/mesh.h>

#include "tools/export/mesh_format_glb.h"

namespace relievo {
namespace {

constexpr int kNormalBits = 10;

struct Ids {
  int position = 0, normal = 0, colour = 0;
};

// An attribute of all points, of `bytes` each, which are not filled yet.
draco::PointAttribute& addAttribute(draco::Mesh& mesh, draco::GeometryAttribute::Type type, int8_t components,
                                    draco::DataType numbers, size_t bytes, int& id) {
  draco::GeometryAttribute attribute;
  attribute.Init(type, nullptr, components, numbers, numbers == draco::DT_UINT16, static_cast<int64_t>(bytes), 0);
  id = mesh.AddAttribute(attribute, true, mesh.num_points());
  return *mesh.attribute(id);
}

Result<std::unique_ptr<draco::Mesh>> meshIn(OutputFile& file, const MeshFacts& facts, Ids& ids) {
  const GlbLayout layout(facts);
  auto mesh = std::make_unique<draco::Mesh>();
  mesh->set_num_points(static_cast<uint32_t>(facts.vertices));
  auto& positions = addAttribute(*mesh, draco::GeometryAttribute::POSITION, 3, draco::DT_FLOAT32, 12, ids.position);
  auto& normals = addAttribute(*mesh, draco::GeometryAttribute::NORMAL, 3, draco::DT_FLOAT32, 12, ids.normal);
  draco::PointAttribute* colours =
      facts.colours ? &addAttribute(*mesh, draco::GeometryAttribute::COLOR, 4, draco::DT_UINT16, 8, ids.colour)
                    : nullptr;
  constexpr uint64_t kPiece = 1 << 15;  // vertices, or triangles
  ByteBuffer bytes;
  for (uint64_t first = 0; first < facts.vertices; first += kPiece) {
    bytes.resize(std::min(kPiece, facts.vertices - first) * layout.stride);
    if (auto read = file.readBack(layout.vertices_at + first * layout.stride, bytes); !read) return read.error();
    for (uint64_t i = 0; i * layout.stride < bytes.size(); ++i) {
      const uint8_t* v = bytes.data() + i * layout.stride;
      const draco::AttributeValueIndex at(static_cast<uint32_t>(first + i));
      positions.SetAttributeValue(at, v);
      normals.SetAttributeValue(at, v + 12);
      if (colours) colours->SetAttributeValue(at, v + 24);
    }
  }
  mesh->SetNumFaces(facts.faces);
  for (uint64_t first = 0; first < facts.faces; first += kPiece) {
    bytes.resize(std::min(kPiece, facts.faces - first) * 12);
    if (auto read = file.readBack(layout.indices_at + first * 12, bytes); !read) return read.error();
    for (uint64_t i = 0; 12 * i < bytes.size(); ++i) {
      std::array<uint32_t, 3> corners;
      std::memcpy(corners.data(), bytes.data() + 12 * i, 12);
      draco::Mesh::Face face;
      for (size_t k = 0; k < 3; ++k) face[k] = draco::PointIndex(corners[k]);
      mesh->SetFace(draco::FaceIndex(static_cast<uint32_t>(first + i)), face);
    }
  }
  return mesh;
}

Result<DracoReport> compress(OutputFile& file, const MeshFacts& facts, int position_bits) {
  Ids ids;
  auto mesh = meshIn(file, facts, ids);
  if (!mesh) return mesh.error();
  GlbDraco code;
  code.position = (*mesh)->attribute(ids.position)->unique_id();
  code.normal = (*mesh)->attribute(ids.normal)->unique_id();
  if (facts.colours) code.colour = (*mesh)->attribute(ids.colour)->unique_id();
  draco::Encoder encoder;
  encoder.SetEncodingMethod(draco::MESH_EDGEBREAKER_ENCODING);
  encoder.SetSpeedOptions(3, 3);
  encoder.SetTrackEncodedProperties(true);
  encoder.SetAttributeQuantization(draco::GeometryAttribute::POSITION, position_bits);
  encoder.SetAttributeQuantization(draco::GeometryAttribute::NORMAL, kNormalBits);
  draco::EncoderBuffer encoded;
  if (const draco::Status status = encoder.EncodeMeshToBuffer(**mesh, &encoded); !status.ok())
    return Error{ErrorKind::kRuntime,
                 file.path(),
                 "Draco cannot compress it: " + status.error_msg_string(),
                 "leave out --draco, or choose another --level",
                 {}};
  mesh->reset();
  code.bytes = encoded.size();
  MeshFacts written = facts;
  written.vertices = encoder.num_encoded_points();
  written.faces = encoder.num_encoded_faces();
  if (auto done = file.truncate(0); !done) return done.error();
  if (auto done = file.append(glbHead(written, code)); !done) return done.error();
  const auto* data = reinterpret_cast<const uint8_t*>(encoded.data());
  if (auto done = file.append({data, encoded.size()}); !done) return done.error();
  const ByteBuffer padding((4 - encoded.size() % 4) % 4);
  if (auto done = file.append(padding); !done) return done.error();
  const glm::vec3 extent = facts.high - facts.low;
  return DracoReport{written.vertices, std::max({extent.x, extent.y, extent.z}) / (std::exp2(position_bits) - 1)};
}

}  // namespace

uint64_t dracoBytes(const MeshFacts& facts) { return 160 * facts.vertices + 140 * facts.faces; }

Result<DracoReport> compressGlb(OutputFile& file, const MeshFacts& facts, int position_bits) {
  try {
    return compress(file, facts, position_bits);
  } catch (const std::exception& e) {
    return Error{ErrorKind::kRuntime,
                 file.path(),
                 std::string("Draco fails: ") + e.what(),
                 "leave out --draco, or choose a coarser --level",
                 {}};
  }
}

}  // namespace relievo
