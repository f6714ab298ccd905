// sample_writer.h - writes a sample artwork's files into a folder, in bands, within a fixed memory budget (below 1
// GiB).
//   height_float.tif, height_16.tif   mm; 16 bit: 0..65535 is MIN..MAX mm of truth.json
//   albedo.png, normals.png           sRGB; RGB = XYZ, +Y up (.tif above 64 Mpx, or 65,500 px a side)
//   ptm_lrgb.ptm, ptm_rgb.ptm
//   photos/light_NNN.jpg, lights.lp   with cast shadows (.tif where a side is more than 65,500 px)
//   mesh.ply                          at most 4 M triangles
//   truth.json                        what all of these are to be measured by; written last
#pragma once

#include <atomic>
#include <cstdint>
#include <string>
#include <vector>

#include "src/base/result.h"
#include "tools/sample/sample_artwork.h"

namespace relievo {

inline constexpr int kMaxSampleLights = 999;

struct SampleWriteOptions {
  std::string folder;
  bool height = false, albedo = false, normals = false, ptm_lrgb = false, ptm_rgb = false, photos = false, mesh = false;
  bool mesh_uv = false;  // texture coordinates in mesh.ply, for the PTMs
  int lights = 49;
  const std::atomic<bool>* interrupted = nullptr;
};
// Writes truth.json last. Returns the files written.
Result<std::vector<std::string>> writeSample(const SampleArtwork& artwork, const SampleWriteOptions& options);

// Which places a distant light reaches over a grid of heights: 255 lit, 0 in shadow, softened over about a pixel.
// Swept from the light's side in O(1) a pixel: the shadow's height over a place is what its neighbour towards the light
// casts or passes on, less the ray's fall between them (linear between the two nearest neighbours). light: unit, y up.
std::vector<uint8_t> castShadows(const std::vector<float>& heights, int64_t width, int64_t height, double mm_per_px,
                                 const std::array<double, 3>& light);

}  // namespace relievo
