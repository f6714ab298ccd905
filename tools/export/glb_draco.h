// glb_draco.h - a .glb with its mesh compressed by Draco (KHR_draco_mesh_compression): what the .glb format has written
// is read back, encoded as a whole and written in its place. Positions are rounded to a grid of 2^bits a side over the
// mesh's largest extent, normals to 2^10 directions a coordinate; colours stay as they are. Where the surface has edges
// of more than two triangles, vertices of several fans, or neighbours that run against each other, Draco takes a vertex
// for each.
#pragma once

#include <cstdint>

#include "src/base/file.h"
#include "tools/export/mesh_format.h"

namespace relievo {

// What compressGlb() takes, about.
uint64_t dracoBytes(const MeshFacts& facts);

struct DracoReport {
  uint64_t vertices = 0;
  double step = 0;  // of positions, in the mesh's unit: none moves by more than half of it along an axis
};
// file: as the .glb format has written a mesh of such facts to it; not committed.
Result<DracoReport> compressGlb(OutputFile& file, const MeshFacts& facts, int position_bits);

}  // namespace relievo
