// repeated_images.h - how often a scan shows its images over. Patches that hold the texels themselves take as many more
// bytes; those of the scan's own triangles can show the images instead (MeshBake::imagesOn()). Pure.
#pragma once

#include <cmath>
#include <cstddef>
#include <span>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/mesh/tri_mesh.h"

namespace relievo {

// More often than this an image is repeated; parts of an atlas may overlap a little.
inline constexpr double kTimesOver = 1.5;

// Of each image: the area of all triangles in it, in times of its own.
inline std::vector<double> timesShown(const TriMesh& mesh, size_t images) {
  std::vector<double> times(images);
  if (mesh.corner_uv.empty()) return times;
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    const uint16_t image = mesh.image_of.empty() ? uint16_t{0} : mesh.image_of[t];
    if (image >= images) continue;
    const auto& uv = mesh.corner_uv[t];
    const glm::dvec2 a(uv[1] - uv[0]), b(uv[2] - uv[0]);
    times[image] += 0.5 * std::abs(a.x * b.y - a.y * b.x);
  }
  return times;
}

// Do repeated images take so many texels that patches should show them, whatever their number? texels: an image's own.
inline bool repeatsMuch(std::span<const double> times, std::span<const double> texels) {
  constexpr double kMuch = 16 * 1024.0 * 1024.0, kOfOwn = 4;
  double own = 0, shown = 0;
  for (size_t i = 0; i < times.size(); ++i) {
    if (times[i] < kTimesOver) continue;
    own += texels[i];
    shown += times[i] * texels[i];
  }
  return shown > kMuch && shown > kOfOwn * own;
}

}  // namespace relievo
