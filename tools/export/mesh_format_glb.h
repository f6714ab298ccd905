// mesh_format_glb.h - glTF 2.0 as one binary file (Khronos glTF 2.0 specification, 4.4): the JSON chunk, padded with
// spaces to one length, then vertices (interleaved: position, normal, colour), then indices. Positions are floats from
// the origin, in mm; the node's scale and translation make metres of them, as glTF counts.
#pragma once

#include <memory>

#include "tools/export/mesh_format.h"

namespace relievo {

std::unique_ptr<MeshFormat> makeGlbFormat();

// Where a file of that format has its parts, in bytes. A vertex: position and normal, three floats each; colour, four
// u16. A triangle: three u32.
struct GlbLayout {
  uint64_t vertices_at, stride, indices_at;
  explicit GlbLayout(const MeshFacts& facts);
};

// The head of a file whose binary chunk is Draco's code of the mesh.
struct GlbDraco {
  uint64_t bytes = 0;
  uint32_t position = 0, normal = 0, colour = 0;  // the attributes' numbers in it
};
ByteBuffer glbHead(const MeshFacts& facts, const GlbDraco& draco);

// The head of a file of vertices (position, normal, tangent of four floats, texture coordinates: 48 bytes), triangles,
// and two PNGs, each padded to 4 bytes: colours, and normals if they take any.
struct GlbMaps {
  uint64_t colour_bytes = 0, normal_bytes = 0;
};
ByteBuffer glbHead(const MeshFacts& facts, const GlbMaps& maps);

}  // namespace relievo
