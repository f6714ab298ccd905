#include "tools/export/mesh_detail.h"

#include <algorithm>
#include <cstdio>

#include "src/base/printable.h"
#include "tools/export/shared_vertices.h"

namespace relievo {
namespace {

MeshDetail uniformDetail(const Manifest& manifest, int level) {
  MeshDetail out{.least_level = level, .level = level};
  if (!manifest.domain.isFlat()) out.patches = uniformLevels(manifest.domain.patchCount(), level);
  return out;
}

Result<MeshDetail> chooseUniform(const std::shared_ptr<const Package>& package, std::optional<int> asked,
                                 std::optional<double> error_mm, const std::atomic<bool>* interrupted) {
  const Manifest& m = package->manifest();
  const int finest = ExportGrid::finestLevel(m);
  if (asked && (*asked < 0 || *asked > finest))
    return Error{ErrorKind::kUsage,
                 package->path(),
                 "expected a --level of 0 to " + std::to_string(finest) + ", found " + std::to_string(*asked),
                 "level " + std::to_string(finest) + " is its full detail",
                 {}};
  for (int level = error_mm ? 0 : asked.value_or(finest);; ++level) {
    auto bound = ExportGrid(package, level).errorBound(interrupted);
    if (!bound) return bound.error();
    const bool enough = !error_mm || level == finest || (*bound && **bound <= *error_mm);
    if (!enough) continue;
    MeshDetail out = uniformDetail(m, level);
    out.error_mm = *bound;
    return out;
  }
}

}  // namespace

uint64_t MeshDetail::faces(const ExportGrid& grid) const {
  uint64_t faces = grid.isFlat() ? 2 * (grid.columns() - 1) * (grid.rows() - 1) : 0;
  for (const PatchLevels& p : patches) faces += p.triangles();
  return faces;
}

uint64_t MeshDetail::vertices(const ExportGrid& grid) const {
  if (grid.isFlat()) return grid.columns() * grid.rows();
  uint64_t vertices = SharedVertices::count(*grid.manifest().base, patches);
  for (const PatchLevels& p : patches) vertices += p.ownVertices();
  return vertices;
}

Result<MeshDetail> chooseDetail(const std::shared_ptr<const Package>& package, std::optional<int> level,
                                std::optional<double> error_mm, const std::atomic<bool>* interrupted) {
  const Manifest& m = package->manifest();
  if (level || m.domain.isFlat() || m.domain.relief_depth < 0)
    return chooseUniform(package, level, error_mm, interrupted);
  auto errors = patchErrors(*package, interrupted);
  if (!errors) return errors.error();
  MeshDetail out;
  out.patches = patchLevelsWithin(patchNeighbours(*m.base), *errors, error_mm.value_or(0));
  out.error_mm = errorOf(out.patches, *errors);
  const auto [least, most] =
      std::minmax_element(out.patches.begin(), out.patches.end(),
                          [](const PatchLevels& a, const PatchLevels& b) { return a.grid < b.grid; });
  out.least_level = least->grid;
  out.level = most->grid;
  return out;
}

std::string aboutText(const Package& package, const MeshDetail* detail) {
  const std::string& path = package.path();
  std::string text = printable(path.substr(path.rfind('/') + 1)) + ", exported by relievo " RELIEVO_VERSION;
  if (!detail) return text + ", base mesh";
  text += ", ";
  if (detail->least_level < detail->level) text += std::to_string(uint64_t{1} << detail->least_level) + " to ";
  text += std::to_string(uint64_t{1} << detail->level) + " cells a patch side";
  if (!detail->error_mm) return text;
  char number[40];
  std::snprintf(number, sizeof number, "%.3g", *detail->error_mm);
  return text + ", within " + number + (package.manifest().size_known ? " mm" : " px") + " of full detail";
}

}  // namespace relievo
