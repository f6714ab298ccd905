// mesh_detail.h - how fine an export of a surface as triangles is.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "src/base/result.h"
#include "texturing/package/package.h"
#include "tools/export/patch_levels.h"
#include "tools/export/surface_rows.h"

namespace relievo {

struct MeshDetail {
  int least_level = 0, level = 0;    // of the patches with the fewest and the most cells
  std::vector<PatchLevels> patches;  // none of a flat artwork, whose one sheet has the cells of `level`
  std::optional<double> error_mm;    // upper bound of the distance from full detail; nothing: not known

  // grid: of `level`. vertices: those that patches share are one each.
  uint64_t faces(const ExportGrid& grid) const;
  uint64_t vertices(const ExportGrid& grid) const;
};
// level: of all patches. Else the fewest cells within error_mm; without it, full detail. Over a base mesh patch by
// patch: full detail is then the fewest cells that show all of a patch. Errors: kUsage of a level that the package does
// not have, those of ExportGrid::errorBound().
Result<MeshDetail> chooseDetail(const std::shared_ptr<const Package>& package, std::optional<int> level,
                                std::optional<double> error_mm, const std::atomic<bool>* interrupted);
// One line for the file. detail: null for the base mesh alone.
std::string aboutText(const Package& package, const MeshDetail* detail);

}  // namespace relievo
