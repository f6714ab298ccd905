// surface_image.h - what lies on a scan's patches: the colours of its images, or a PTM's planes, read whole.
#pragma once

#include <vector>

#include "geometry/bake/mesh_bake.h"
#include "geometry/mesh/tri_mesh.h"
#include "src/artwork/basis.h"
#include "src/base/result.h"
#include "texturing/import/image_io.h"
#include "texturing/package/package_builder.h"
#include "tools/build_mesh.h"

namespace relievo {

struct SurfaceImage {
  // Of `pixels`: as TriMesh::image_of names them, or one for all: of one texel where the scan has one colour; or none.
  std::vector<MeshBake::Image> images;
  std::vector<Image8> pixels;  // three channels, or a PTM's planes
  // Of each of them the plainJpeg() that has the same texels; empty: its file is no such JPEG, or colours were changed.
  std::vector<std::vector<uint8_t>> jpegs;
  // Their maps of normals, and the JPEGs of those; an image without one has an empty one.
  std::vector<Image8> normal_pixels;
  std::vector<std::vector<uint8_t>> normal_jpegs;
  TextureFormat format{.basis = Basis::kAlbedoNormal};
  std::vector<Provenance> sources;  // files of their own
};
// The PTM that is asked for, else the image that is asked for (the mesh is read for either as MeshReadOptions::
// other_image says), else those of the mesh. One of several that is not there is replaced by a plain grey, with a
// warning. Images that take more than a third of the memory together are made smaller, with a warning; and so are maps
// of normals with which images had more texels than a package may have (kMostShownTexels). A map of normals that cannot
// be read, or has others (normal_map_fit.h), is left out, with a warning. Where no image is shown the mesh loses its
// texture coordinates; and its normals where no map of normals is.
// Errors: kUsage (no texture coordinates, or more than the memory allows), kInvalidData (a PTM of other proportions
// than the mesh's image), and those of the readers.
Result<SurfaceImage> readSurfaceImage(const MeshBuildArguments& arguments, TriMesh& mesh);

}  // namespace relievo
