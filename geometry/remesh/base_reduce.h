// base_reduce.h - reduces a scan of millions of triangles to some ten thousand, and keeps its topology. The base mesh
// is made from the result. Half edges are collapsed in passes with ever longer edges, unless a collapse would flip
// triangles or change the topology (link condition, Dey et al. 1999).
// meshoptimizer 0.18 leaves edges with three triangles on a sphere of a million triangles, which is why it is not used.
#pragma once

#include <atomic>
#include <cstdint>
#include <span>
#include <vector>

#include "geometry/remesh/base_topology.h"

namespace relievo {

// Reduces a part of a scan. Its border and the locked vertices stay, so that neighbouring parts still fit together if
// they lock the same vertices. Edges up to `length` are collapsed where that hardly turns the surface.
struct ReducedPart {
  std::vector<glm::vec3> points;
  std::vector<Triangle> triangles;
  std::vector<uint32_t> vertex;  // for each vertex, its index in the part's surface
};
ReducedPart reducePart(Surface part, float length, std::span<const uint32_t> locked,
                       const std::atomic<bool>* interrupted = nullptr);

struct Reduced {
  Surface surface;
  std::vector<uint32_t> vertex;  // for each vertex, its index in the scan's surface; none is moved
};
// Reduces a scan to about `triangles` triangles; more are left where the shape does not allow collapses, and all of
// them if the scan has no more. Locked vertices stay.
Reduced reduceSurface(Surface scan, size_t triangles, std::span<const uint32_t> locked = {},
                      const std::atomic<bool>* interrupted = nullptr);

}  // namespace relievo
