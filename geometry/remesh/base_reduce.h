// base_reduce.h - a scan of millions of triangles down to some ten thousand, quickly and with its topology kept: what a
// base mesh is made from. Half-edge collapses by passes, ever longer edges; where that would turn triangles over or
// pinch the surface, none. meshoptimizer 0.18 was tried for this: on a sphere of a million triangles it leaves edges
// that three triangles share.
#pragma once

#include <atomic>
#include <cstdint>
#include <span>
#include <vector>

#include "geometry/remesh/base_topology.h"

namespace relievo {

// A part of a scan on its own, its border and the vertices that stay as they are: parts of which neighbours are treated
// alike still fit together. Edges up to that length collapse, where that turns the surface little.
struct Thinned {
  std::vector<glm::vec3> points;
  std::vector<Triangle> triangles;
  std::vector<uint32_t> vertex;  // of the part's surface that each is
};
Thinned thinned(Surface part, float length, std::span<const uint32_t> stay,
                const std::atomic<bool>* interrupted = nullptr);

struct Reduced {
  Surface surface;
  std::vector<uint32_t> vertex;  // of the scan's surface that each vertex is: none is moved
};
// To about that many triangles; more where the shape holds out against it, all of them where the scan has no more. The
// vertices that are named stay.
Reduced reduceSurface(Surface scan, size_t triangles, std::span<const uint32_t> keep = {},
                      const std::atomic<bool>* interrupted = nullptr);

}  // namespace relievo
