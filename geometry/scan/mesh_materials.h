// mesh_materials.h - what a scan's triangles show: images, and colours of materials and of faces as a palette. Internal
// to mesh_read.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "geometry/scan/mesh_file.h"

namespace relievo::mesh_file {

// The triangles from `first` on, up to the next run's.
struct MaterialRun {
  size_t first = 0;
  uint16_t image = kNoImage;          // of RawMesh::images
  glm::u8vec3 colour = kPlainColour;  // where they have no image
};

// The number of an image that is added to RawMesh::images; kNoImage: there are too many.
uint16_t addImage(RawMesh& mesh, MeshImage image);
// The same, or that of an equal one that is there already; of one without any file kNoImage.
uint16_t shareImage(RawMesh& mesh, MeshImage image);

// Gives triangles what their materials have: RawMesh::image_of, and face_colours where they have no image. Colours of
// vertices come before those of materials, and so does one plain grey for all. Images that no triangle shows are
// dropped.
void useMaterials(RawMesh& mesh, std::span<const MaterialRun> runs, const MeshReadOptions& options);

// Says that so many materials have a map of normals or bumps which is not used.
void noteNormalMaps(RawMesh& mesh, uint64_t materials);

// The colours of faces without an image as one more image, a palette, and texture coordinates that name its texels. Of
// more than kPaletteColumns colours it has several rows.
void paintFaces(RawMesh& mesh);

}  // namespace relievo::mesh_file
