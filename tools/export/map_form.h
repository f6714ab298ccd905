// map_form.h - what maps of flat artworks (map_export.cpp) and of scans (patch_maps.cpp) share: samples as files have
// them, levels, memory.
#pragma once

#include <cstdint>

#include "src/base/result.h"
#include "texturing/import/image_io.h"
#include "texturing/package/package.h"
#include "tools/export/map_export.h"

namespace relievo {

struct MapForm {
  int channels = 1;
  SampleType type = SampleType::kFloat;
  bool exr = false;
};
bool isColour(ExportMap map);  // of texels, not of relief
// A share of 0..1 in 16 bits.
uint16_t wordOf(double share);
float linearLight(uint8_t srgb);

// The level that is asked for, or the finest of what the map shows; kUsage where it is below `least` or beyond that.
Result<int> mapLevelOf(const Package& package, const MapExportOptions& options, int least);

// What is left of memory_bytes beside the library that writes images.
uint64_t memoryForRows(const MapExportOptions& options);
// Of the row that is written, and of what an encoder holds of it.
uint64_t writtenRowBytes(uint64_t columns, const MapForm& form);
// That the map takes this much beside the library, which is more than memoryForRows().
Error tooLarge(const MapExportOptions& options, const MapForm& form, int level, uint64_t bytes);

}  // namespace relievo
