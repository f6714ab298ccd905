// textured_glb.h - a scan's surface as glTF 2.0 binary with its colours and normals in images: the mesh of
// mesh_export.h, but that each patch has vertices of its own, since texture coordinates differ on both sides of a
// patch's border; positions there have the same bits from both. The normal map is in tangent space (glTF 2.0, 3.9.3) of
// the NORMAL and TANGENT that the file states: tangents point along the patches' u, to the right in the images.
//
// Memory: the images, as pixels and as PNGs, rows of pages for each worker, and 20 bytes for each vertex that patches
// share; refused (kUsage) beyond memory_bytes. The same bytes for any number of workers.
#pragma once

#include "tools/export/mesh_export.h"

namespace relievo {

// options.maps_px: the images' largest side. kUsage: a flat artwork.
Result<MeshExportReport> exportTexturedGlb(const std::shared_ptr<const Package>& package,
                                           const MeshExportOptions& options);

}  // namespace relievo
