// sample_writer.h - writes a sample artwork's files into a folder, in bands, within a fixed memory budget.
#pragma once

#include <atomic>
#include <cstdint>
#include <string>
#include <vector>

#include "src/base/result.h"
#include "tools/sample_artwork.h"

namespace relievo {

struct SampleWriteOptions {
  std::string folder;
  bool height = false, albedo = false, normals = false, ptm_lrgb = false, ptm_rgb = false, photos = false, mesh = false;
  int lights = 49;
  const std::atomic<bool>* interrupted = nullptr;
};
// Writes truth.json last. Returns the files written.
Result<std::vector<std::string>> writeSample(const SampleArtwork& artwork, const SampleWriteOptions& options);

}  // namespace relievo
