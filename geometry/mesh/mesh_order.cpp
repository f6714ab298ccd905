#include "geometry/mesh/mesh_order.h"

#include <algorithm>

#include "src/base/parallel_for.h"

namespace relievo {
namespace {

constexpr uint32_t kAxisBits = 7;

// 0bcba to 0b00c00b00a.
uint32_t spread(uint32_t x) {
  x = (x | x << 8) & 0x0300F00F;
  x = (x | x << 4) & 0x030C30C3;
  return (x | x << 2) & 0x09249249;
}

constexpr float kCells = 1 << kAxisBits;

uint32_t cellOf(const glm::vec3& from_low, float cells_a_unit) {
  uint32_t cell = 0;
  for (int axis = 0; axis < 3; ++axis)
    cell |= spread(static_cast<uint32_t>(std::clamp(from_low[axis] * cells_a_unit, 0.0f, kCells - 1))) << axis;
  return cell;
}
float cellsAUnit(const glm::vec3& low, const glm::vec3& high) {
  const glm::vec3 size = high - low;
  const float longest = std::max({size.x, size.y, size.z});
  return longest > 0 ? kCells / longest : 0.0f;
}

// Each triangle's place along the curve; empty: interrupted.
std::vector<uint32_t> placesAlongCurve(const TriMesh& mesh, int workers, const std::atomic<bool>* interrupted) {
  const size_t triangles = mesh.triangles.size();
  glm::vec3 low = mesh.positions_mm[mesh.triangles[0][0]], high = low;
  for (const glm::vec3& p : mesh.positions_mm) {
    low = glm::min(low, p);
    high = glm::max(high, p);
  }
  const float scale = cellsAUnit(low, high) / 3;

  std::vector<uint32_t> cell(triangles);
  constexpr size_t kAJob = size_t{1} << 16;
  const bool done = parallelFor((triangles + kAJob - 1) / kAJob, workers, interrupted, [&](size_t job) {
    for (size_t t = job * kAJob; t < std::min(triangles, (job + 1) * kAJob); ++t) {
      const auto& corner = mesh.triangles[t];
      const glm::vec3 sum = mesh.positions_mm[corner[0]] + mesh.positions_mm[corner[1]] + mesh.positions_mm[corner[2]];
      cell[t] = cellOf(sum - 3.0f * low, scale);
    }
  });
  if (!done) return {};
  std::vector<uint32_t> next((size_t{1} << 3 * kAxisBits) + 1, 0);
  for (uint32_t c : cell) ++next[c + 1];
  for (size_t c = 1; c < next.size(); ++c) next[c] += next[c - 1];
  if (interrupted && *interrupted) return {};
  for (uint32_t& c : cell) c = next[c]++;
  return cell;
}

}  // namespace

uint32_t placeOnCurve(const glm::vec3& place, const glm::vec3& low, const glm::vec3& high) {
  return cellOf(place - low, cellsAUnit(low, high));
}

bool needsOrder(const TriMesh& mesh) {
  constexpr size_t kLarge = size_t{8} << 20, kRun = size_t{1} << 16;
  if (mesh.triangles.size() < kManyTriangles) return false;
  if (mesh.triangles.size() >= kLarge) return true;
  // The last run that named a vertex; the first time in another run counts.
  std::vector<uint32_t> run(mesh.positions_mm.size(), 0);
  size_t again = 0;
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    const auto here = static_cast<uint32_t>(t / kRun + 1);
    for (uint32_t v : mesh.triangles[t]) {
      again += run[v] != 0 && run[v] != here;
      run[v] = here;
    }
  }
  return again > mesh.positions_mm.size() / 8;
}

std::vector<uint32_t> orderAlongCurve(const TriMesh& mesh, int workers) {
  if (mesh.triangles.empty()) return {};
  const std::vector<uint32_t> place = placesAlongCurve(mesh, workers, nullptr);
  std::vector<uint32_t> order(place.size());
  for (size_t t = 0; t < place.size(); ++t) order[place[t]] = static_cast<uint32_t>(t);
  return order;
}

bool orderTriangles(TriMesh& mesh, int workers, const std::atomic<bool>* interrupted) {
  const size_t triangles = mesh.triangles.size();
  if (triangles == 0) return true;
  const std::vector<uint32_t> place = placesAlongCurve(mesh, workers, interrupted);
  if (place.empty()) return false;
  auto moved = [&](auto& list) {
    std::remove_reference_t<decltype(list)> out(list.size());
    for (size_t t = 0; t < triangles; ++t) out[place[t]] = list[t];
    list = std::move(out);
  };
  moved(mesh.triangles);
  if (!mesh.corner_uv.empty()) moved(mesh.corner_uv);
  if (!mesh.corner_normals.empty()) moved(mesh.corner_normals);
  if (!mesh.image_of.empty()) moved(mesh.image_of);
  return true;
}

}  // namespace relievo
