// mesh_repair.h - the steps from triangles as a file has them to a mesh that keeps TriMesh's promises. Internal to
// mesh_read.
#pragma once

#include "geometry/scan/mesh_read.h"

namespace relievo {

// Zero area: two corners are one, or the height above the longest side is below this part of it (rounding of double,
// far below that of the floats: slivers of scans stay).
inline constexpr double kDegenerate = 1e-13;
inline constexpr size_t kMaxPlaces = 8;  // of a finding
bool isDegenerate(const TriMesh& mesh, const std::array<uint32_t, 3>& triangle);

// findings and the numbers read are kept, all else of the diagnosis is filled in. Every index and number must have been
// checked. The same for any number of workers (0: one a core). all_pieces_up_to: as MeshReadOptions has it.
Result<void> repairTriangles(TriMesh& mesh, MeshDiagnosis& diagnosis, const std::string& name,
                             const std::function<void(double)>& progress, const std::atomic<bool>* interrupted,
                             int workers, size_t all_pieces_up_to);

}  // namespace relievo
