#include "tools/export/map_form.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "src/base/srgb.h"

namespace relievo {

bool isColour(ExportMap map) { return map == ExportMap::kAlbedo || map == ExportMap::kLit; }

uint16_t wordOf(double share) { return static_cast<uint16_t>(std::lround(65535 * std::clamp(share, 0.0, 1.0))); }

float linearLight(uint8_t srgb) { return static_cast<float>(linearFromSrgb(srgb / 255.0)); }

Result<int> mapLevelOf(const Package& package, const MapExportOptions& o, int least) {
  const PatchDomain& d = package.manifest().domain;
  const int finest = kPageCellsLog2 + (isColour(o.map) ? d.texture_depth : d.relief_depth);
  const int level = o.level.value_or(finest);
  if (level >= least && level <= finest) return level;
  return Error{ErrorKind::kUsage,
               package.path(),
               "expected a --level of " + std::to_string(least) + " to " + std::to_string(finest) +
                   " for this map, found " + std::to_string(level),
               "level " + std::to_string(finest) + " is its full detail",
               {}};
}

uint64_t memoryForRows(const MapExportOptions& o) { return o.memory_bytes - std::min(o.memory_bytes, o.library_bytes); }

uint64_t writtenRowBytes(uint64_t columns, const MapForm& form) {
  // OpenEXR packs 16 rows at once, and was measured to hold about six times their samples.
  constexpr uint64_t kRows = 3, kExrRows = 16 * 6;
  return columns * static_cast<uint64_t>(form.channels) * sizeof(float) * (form.exr ? kExrRows : kRows);
}

Error tooLarge(const MapExportOptions& o, const MapForm& form, int level, uint64_t bytes) {
  return {ErrorKind::kUsage,
          o.output,
          "level " + std::to_string(level) + " takes " + std::to_string(((bytes + o.library_bytes) >> 20) + 1) +
              " MiB of memory, --memory-mib allows " + std::to_string(o.memory_bytes >> 20),
          form.exr ? "allow more, choose a coarser --level, or name a .tif" : "allow more, or choose a coarser --level",
          {}};
}

}  // namespace relievo
