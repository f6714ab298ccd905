// surface_simplify.h - fewer triangles over the finest relief (strategy_surface.h), least error first.
//
// A vertex collapses onto a neighbour (Hoppe 1996, half-edge collapse), and of all vertices always the one whose
// collapse leaves the smallest error. That error is no estimate: it is the largest distance of the new triangles from
// the finest relief above the same places, at all of them. (Klein, Liebich, Strasser 1996, "Mesh Reduction with Error
// Control", do the same with Hausdorff distances. Quadric error metrics, which sum squares of distances to planes,
// leave a few places where the error is many times the rest, and those decide what a bound can promise.) Where the
// relief is flat and many collapses cost nothing, those of short edges come first, or a few vertices would get all
// triangles.
//
// Triangles never turn over in their patch's square, vertices on patches' sides stay on them, and vertices that are
// welded move together: no crack opens. Pure, one thread. Memory: about 30 bytes a triangle and 30 a vertex.
#pragma once

#include <cstdint>
#include <queue>
#include <span>
#include <vector>

#include "geometry/strategies/strategy_surface.h"

namespace relievo {

class SurfaceSimplifier {
 public:
  // triangles: three of the surface's vertices each. kept: a byte for each of the surface's vertices by weld(), other
  // than 0 if it must not move; or empty. Corners of patches never do. measured: the triangles' own error, mm.
  SurfaceSimplifier(const FineSurface& surface, std::span<const uint32_t> triangles, std::span<const uint8_t> kept,
                    double measured_mm = 0);
  // Collapses until no more triangles are left than that, or nothing can be collapsed within the error. Again and
  // again, with ever smaller targets.
  void reduce(size_t target_triangles, double error_mm = 1e30);
  std::vector<uint32_t> triangles() const;  // the surface's vertices, in the order of those given
  size_t count() const { return alive_; }
  // An upper bound of how far what is left lies from the relief.
  double errorMm() const { return error_ * surface_.fanUnitMm(); }

 private:
  struct Entry {
    float cost = 0;
    uint32_t vertex = 0;
    bool operator<(const Entry& o) const {  // std::priority_queue: the least first; ties by index, for determinism
      return cost > o.cost || (cost == o.cost && vertex > o.vertex);
    }
  };
  static constexpr uint32_t kNone = ~uint32_t{0};
  struct Vertex {             // a welded one
    uint32_t corner = kNone;  // the first of its triangles' corners
    uint32_t target = kNone;  // of its best collapse
    float error = 0;          // that it leaves
    float cost = -1;          // error, and a little for long edges; negative: there is no collapse
    bool kept = false, changed = false;
  };
  // A triangle at a vertex: which of its corners that is.
  uint32_t weldedAt(uint32_t corner) const { return welded_[corner_vertex_[corner]]; }
  static uint32_t next(uint32_t corner) { return corner % 3 == 2 ? corner - 2 : corner + 1; }
  void gather(uint32_t vertex);
  void evaluate(uint32_t vertex);
  // Of a collapse of the vertex that was gathered; infinite, or more than enough: none that is wanted.
  struct Cost {
    double error = 0, all = 0;
  };
  Cost costOf(uint32_t target, double enough);
  void collapse(uint32_t vertex, uint32_t target);
  void push(uint32_t vertex);

  const FineSurface& surface_;
  std::vector<uint32_t> names_;             // local vertex: the surface's
  std::vector<uint32_t> welded_;            // local vertex: its welded one
  std::vector<FineSurface::Place> places_;  // by local vertex
  std::vector<uint8_t> sides_;
  std::vector<uint32_t> corner_vertex_;  // by corner; the triangle is gone where its first corner's is kNone
  std::vector<uint32_t> next_corner_;    // of the same welded vertex
  std::vector<Vertex> vertices_;         // welded
  std::priority_queue<Entry> queue_;
  size_t alive_ = 0;
  double length_cost_ = 0;
  double error_ = 0;
  std::vector<uint32_t> ring_;    // corners of the vertex that was gathered
  std::vector<uint32_t> around_;  // its neighbours, welded
  std::vector<std::array<FineSurface::Sample, 2>> rims_;
};

}  // namespace relievo
