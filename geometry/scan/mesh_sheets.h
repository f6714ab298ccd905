// mesh_sheets.h - from triangles that share vertices to surfaces: what lies across each edge, which way round the
// triangles of a piece run, and sheets where more than two triangles meet. Internal to mesh_read.
#pragma once

#include <atomic>

#include "geometry/mesh/mesh_edges.h"
#include "geometry/mesh/tri_mesh.h"

namespace relievo {

struct EdgeCensus {
  std::vector<uint32_t> mate;         // by half-edge: the one across; kNoHalfEdge: open or crowded
  std::vector<uint32_t> open;         // half-edges of edges with one triangle, in the edges' order
  std::vector<uint32_t> crowded;      // half-edges of edges with three or more, edge after edge
  std::vector<uint32_t> crowded_end;  // where each edge's end
  std::vector<uint32_t> duplicates;   // triangles of the same three vertices as an earlier one, ascending
};
// Soon after *stop is set: a part of it. The same for any number of workers (0: one a core), as all here.
EdgeCensus takeCensus(const TriMesh& mesh, const std::atomic<bool>* stop = nullptr, int workers = 1);

// The pieces that mates hold together: triangles of piece p are order[end[p - 1]] .. order[end[p]].
struct Pieces {
  std::vector<uint32_t> order, end;
  size_t count() const { return end.size(); }
  std::span<const uint32_t> triangles(size_t piece) const {
    size_t begin = piece == 0 ? 0 : end[piece - 1];
    return std::span(order).subspan(begin, end[piece] - begin);
  }
};

// Which triangles to turn so that those of a piece run alike: as most of them do; closed pieces (crowded edges count as
// closed), and those whose holes are at most 5 % of their area, outwards, by their signed volume. A piece with one side
// only, as a Moebius strip has, is to be cut open where its triangles, met one after the other, come back to those met
// first on their other side.
struct Turned {
  Pieces pieces;
  std::vector<bool> turn;                       // of each triangle
  bool complete = false;                        // else interrupted
  std::vector<uint32_t> triangles;              // turned against their piece
  std::vector<uint32_t> inside_out;             // a triangle of each closed piece that was turned as a whole
  std::vector<uint32_t> inside_out_with_holes;  // the same of pieces that are closed but for small holes
  std::vector<uint32_t> cut;  // a half-edge of each edge to cut. They form lines that end at borders, if at all
  size_t cut_pieces = 0;
};
// Soon after *stop is set: a part of it, with which turnOver() leaves the mesh as it is.
Turned findTurns(const TriMesh& mesh, const EdgeCensus& census, const std::atomic<bool>* stop = nullptr,
                 int workers = 1);
// Turns and cuts. splitFans() then gives both sides of a cut their own vertices.
void turnOver(TriMesh& mesh, EdgeCensus& census, Turned& turned);
Pieces findPieces(const TriMesh& mesh, const std::vector<uint32_t>& mate, const std::atomic<bool>* stop = nullptr);

// Pairs the half-edges of crowded edges, those only that run against each other. Where they alternate around the edge:
// across the solid, so that two bodies that touch there stay two. Else the flattest pair first: a fin on a surface, or
// a surface through another, is a sheet of its own. What is left over is open, and so is all of an edge with more than
// kMaxPaired triangles.
inline constexpr size_t kMaxPaired = 32;
void pairCrowded(const TriMesh& mesh, EdgeCensus& census);

// Has no vertex several fans of triangles around it? Turning triangles over does not change that. False, too: *stop was
// set.
bool oneFanAVertex(const TriMesh& mesh, const std::vector<uint32_t>& mate, const std::atomic<bool>* stop = nullptr);

// Gives every fan of triangles around a vertex, but for the first, a vertex of its own, so that vertices are what mates
// say; the vertices that had several go to split. Where an edge is still named by others than two mates (a sheet that
// curls up to touch itself along an edge), those others are cut off at one end of the edge. False: that came to no end,
// or *stop was set.
bool splitFans(TriMesh& mesh, EdgeCensus& census, std::vector<uint32_t>& split,
               const std::atomic<bool>* stop = nullptr);

}  // namespace relievo
