// gltf_compression.h - meshes of glTF files as they are compressed: EXT_meshopt_compression by meshoptimizer,
// KHR_draco_mesh_compression by Draco. Safe for untrusted bytes. Internal to gltf_buffers.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "geometry/scan/gltf_document.h"

namespace relievo::mesh_file {

// out: count * stride bytes. False: the code is damaged, or one of other elements.
bool decompressMeshopt(const GltfPacking& packing, std::span<const uint8_t> code, std::span<uint8_t> out);

// What an accessor stands for.
struct DracoPart {
  uint32_t attribute = kNoIndex;  // its number in the code; of indices none
  GltfAccessor as;                // of what numbers, and how many
  std::vector<uint8_t> bytes;     // without gaps
};
// The first `attributes` parts are those of points, the others are indices of triangles. Says what is wrong, or
// nothing.
std::string decompressDraco(std::span<const uint8_t> code, size_t attributes, std::span<DracoPart> parts);

}  // namespace relievo::mesh_file
