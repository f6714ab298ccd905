// mesh_tjunction.h - vertices of open borders that lie on another open edge: a crack of no width, closed by splitting
// that edge's triangle there. Internal to mesh_read.
#pragma once

#include "geometry/mesh/mesh_edges.h"
#include "geometry/mesh/tri_mesh.h"

namespace relievo {

struct TJunction {
  uint32_t half_edge, vertex;
  double along;  // 0..1, from the half-edge's start
};
// Of the open half-edges, by half-edge and place along it. tolerance: of the distance to the edge; what is as near to
// one of its ends is none. Stops beyond max_count or a time that only files made for it exceed: then *complete is
// false. workers: 0 is one for each core.
std::vector<TJunction> findTJunctions(const TriMesh& mesh, std::span<const uint32_t> open, double tolerance,
                                      size_t max_count, int workers, bool* complete);

// Splits the triangles; corner_uv is interpolated. A triangle that a split would turn over or make degenerate (thinner
// than the tolerance) stays: its junctions are returned.
std::vector<TJunction> splitAtTJunctions(TriMesh& mesh, std::span<const TJunction> junctions);

}  // namespace relievo
