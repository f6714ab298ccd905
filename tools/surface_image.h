// surface_image.h - what lies on a scan's patches: the colours of an image, or a PTM's planes, read whole.
#pragma once

#include <optional>

#include "geometry/mesh/tri_mesh.h"
#include "src/artwork/basis.h"
#include "src/base/result.h"
#include "texturing/import/image_io.h"
#include "texturing/package/package_builder.h"
#include "tools/build_mesh.h"

namespace relievo {

struct SurfaceImage {
  Image8 image;  // channels interleaved: three, or a PTM's planes; empty: the scan has no image
  TextureFormat format{.basis = Basis::kAlbedoNormal};
  std::optional<Provenance> source;  // of a file of its own
};
// The PTM that is asked for, else the image that is asked for or that the mesh names, else its palette.
// Errors: kUsage (no texture coordinates, or more than the memory allows), kInvalidData (a PTM of other proportions
// than the mesh's image), and those of the readers.
Result<SurfaceImage> readSurfaceImage(const MeshBuildArguments& arguments, const TriMesh& mesh);

}  // namespace relievo
