// map_export.h - a flat artwork's relief and colour as an image, row by row. A pixel is a cell of the grid of vertices:
// at level L there are 2^L along a patch's side, at the texture's finest level its texels, from the upper left.
//
//   height   mm (px where no size is known), of the surface at the cell's centre. 16-bit PNG: 0..65535 over the range
//            of the artwork's relief, which the report names
//   depth    mm below the highest place of that range; 16-bit PNG: 65535 - height
//   normal   of the bilinear surface through the cell's four samples, at its centre (the rule of
//            texturing/stream/relief_normals.h): (n + 1) / 2 in R, G, B, 16 bits or float; x right, y up or down
//   albedo   the texels as the package has them, sRGB, 8 bits (EXR: linear light); of a basis of light, the picture
//            under light from the front
//   lit      the picture under a light, as `relievo render` shows it straight from above at one texel a pixel
// Memory: rows of the pages side by side, as many at once as memory_bytes allows.
// TIFF and EXR have heights as 32-bit floats. All state the size of a pixel, where it is known.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "src/base/result.h"
#include "texturing/package/package.h"

namespace relievo {

enum class ExportMap { kHeight, kDepth, kNormal, kAlbedo, kLit };
Result<ExportMap> exportMapOf(const std::string& name);

struct MapExportOptions {
  std::string output;
  ExportMap map = ExportMap::kHeight;
  std::optional<int> level;  // 7 ..; nothing: the finest of the relief, of albedo and lit that of the texture
  bool normal_y_down = false;
  std::array<double, 3> light{0, 0, 1};  // of lit: towards it; of any length
  uint64_t memory_bytes = uint64_t{768} << 20;
  uint64_t library_bytes = 0;  // of these, what the library that writes images takes for itself
  std::function<void(double /*0..1*/)> progress;
  const std::atomic<bool>* interrupted = nullptr;
};
struct MapExportReport {
  int level = 0;
  int64_t width = 0, height = 0;
  double mm_per_px = 0;  // 0: not known
  // Of heights in 16 bits: what 0 and 65535 stand for.
  bool scaled = false;
  double low_mm = 0, high_mm = 0;
};
// Errors: kUsage (a scan; a format that cannot hold the map; a level or memory that it does not have), those of pages.
Result<MapExportReport> exportMap(std::shared_ptr<const Package> package, const MapExportOptions& options);

}  // namespace relievo
