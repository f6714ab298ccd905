// patch_maps.h - a scan's heights, normals or colours as one image, an atlas of a tile a patch, and beside it what it
// takes to put the surface together again: NAME.map.json (the base mesh, where tiles lie, what samples mean) and
// NAME.map.obj (the base mesh's quads with texture coordinates into the atlas). PATCH_MAPS.md describes all three.
//
// Samples are those of the vertices that a mesh of the same level has (mesh_export.h): 2^level + 1 a side, so that
// neighbours repeat the vertices that they share.
//
// Memory: rows of the pages of a row of tiles; of normals also 28 bytes for each vertex on a side, and their pages are
// read twice. Each of the three files appears whole, the image first.
#pragma once

#include <string>

#include "src/base/result.h"
#include "tools/export/map_export.h"

namespace relievo {

// The files beside the image.
std::string patchMapJson(const std::string& image);
std::string patchMapObj(const std::string& image);

struct PatchMapReport {
  int level = 0;
  uint32_t patches = 0, columns = 0;
  int64_t width = 0, height = 0;
};
// map: height, normal or albedo, of an artwork over a base mesh. Errors: kUsage (other maps or artworks, a format that
// cannot hold the map, a level or memory that it does not have), those of pages and files.
Result<PatchMapReport> exportPatchMaps(std::shared_ptr<const Package> package, const MapExportOptions& options);

}  // namespace relievo
