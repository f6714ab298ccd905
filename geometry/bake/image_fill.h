// image_fill.h - the texels of an image that no triangle of a scan shows, as between the parts of an atlas. Coarser
// levels would mix them into what is shown, and they take bytes: so they become what lies around them, smoothly.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "geometry/mesh/tri_mesh.h"

namespace relievo {

struct FilledImage {
  std::vector<uint8_t> rgb;  // rows top first
  double shown = 0;          // the share of its texels that the scan shows, or that lie beside such
};
// number: of the image in TriMesh::image_of; texels: R, G, B, rows top first. Images that are repeated (kTimesOver)
// stay as they are.
FilledImage fillUnshown(const TriMesh& mesh, uint16_t number, int width, int height, bool repeats,
                        std::span<const uint8_t> texels);

}  // namespace relievo
