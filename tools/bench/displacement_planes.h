// displacement_planes.h - samples of a base mesh's patches that are displaced by one component or by three: the surface
// that would be drawn of them, and what they take. For tools/bench/displacement_table.cpp.
// Units: mm, in the scan's coordinates.
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/bake/bake_context.h"
#include "geometry/bake/baked_heights.h"
#include "geometry/bake/fidelity.h"
#include "geometry/bake/mesh_bake.h"
#include "geometry/mesh/closest_search.h"
#include "geometry/mesh/tri_mesh.h"
#include "geometry/mesh/triangle_point.h"
#include "src/base/result.h"

namespace relievo {

// The samples of a base mesh in the order of SampleLayout, all patches with as many, and the frames that they are
// displaced in: along the base's interpolated normal, which is not of length 1, and along two directions of length 1
// across it. A frame follows from the normal alone, so that patches agree about the samples that they share; it turns
// quickly only near one direction of the normal, `pole`.
struct DisplacedSamples {
  BakeContext context;
  int cells_log2;
  glm::dmat3 pole{1};  // turns the pole to (0, 0, -1)
  std::vector<BasePoint> points;

  // The base and the number of cells are those of a bake.
  DisplacedSamples(const TriMesh& scan, const MeshBake& bake);
  size_t cells() const { return size_t{1} << cells_log2; }
  // The columns: the normal, and the two directions across it.
  glm::dmat3 frame(const glm::dvec3& normal) const;
  // Heights of the bake.
  std::vector<glm::dvec3> heights(const MeshBake& bake) const;
  glm::dvec3 position(size_t sample, const glm::dvec3& components) const {
    return points[sample].position + frame(points[sample].normal) * components;
  }
  glm::dvec3 componentsOf(size_t sample, const glm::dvec3& position) const;
  // The samples of each patch's grid, rows of v from 0.
  std::vector<std::vector<uint32_t>> samplesOfPatches() const;
};

// The components of all samples in whole steps, as a package has heights.
class DisplacementPlanes {
 public:
  // components: of each sample, the height first. step_mm 0: no steps, only the 16 bits.
  DisplacementPlanes(const DisplacedSamples& samples, std::span<const glm::dvec3> components, double step_mm);
  const DisplacedSamples& samples() const { return samples_; }
  size_t patchesAside() const { return static_cast<size_t>(std::ranges::count(patch_aside_, uint8_t{1})); }
  // Triangles in the patches' order, made coarse where that is within the tolerance. patch_of: of each triangle.
  TriMesh surface(double tolerance_mm, std::vector<uint32_t>& patch_of) const;
  // Bits of the heights in a package with its base mesh, the bounds being those of `bake`, and of the pages that the
  // other two components would have if they were coded as heights are: pages without any cost a bit. base_step_mm: of
  // the lattice of the base's corners. package: a file that is written for it and removed.
  Result<uint64_t> bits(const MeshBake& bake, double slight_mm, double base_step_mm, const std::string& package) const;

 private:
  bool aside(uint32_t patch) const { return patch_aside_[patch] != 0; }

  const DisplacedSamples& samples_;
  BakedHeights planes_[3];
  std::vector<uint8_t> patch_aside_;  // has it components across the normal?
};

// The closest of the triangles of a part that ClosestSearch found.
std::pair<uint32_t, TrianglePoint> closestTriangle(const TriMesh& mesh, const ClosestSearch& search, size_t part,
                                                   const glm::dvec3& place);

// As measureFidelity() has it, of any triangles, in the scan's coordinates. distances: of the scan's places to the
// surface, then of as many on the surface to the scan; and the triangle of the surface for each.
struct MeasuredPlaces {
  std::vector<float> distances_mm;
  std::vector<uint32_t> triangles;
};
Fidelity fidelityOf(const FidelityScan& scan, const TriMesh& surface, const FidelityTarget& target,
                    MeasuredPlaces* places = nullptr);

}  // namespace relievo
