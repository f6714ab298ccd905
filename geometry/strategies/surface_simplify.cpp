#include "geometry/strategies/surface_simplify.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <unordered_map>

namespace relievo {
namespace {

constexpr size_t kMostTrianglesAround = 48;  // a vertex with more makes every collapse beside it slow
constexpr size_t kMostCopies = 8;            // of a vertex, one a patch: more are no side of two patches, and stay
constexpr double kStepsASample =
    0.02;  // that an edge costs besides, steps of the heights' range by its length in samples
constexpr double kNoCollapse = std::numeric_limits<double>::infinity();

}  // namespace

SurfaceSimplifier::SurfaceSimplifier(const FineSurface& surface, std::span<const uint32_t> triangles,
                                     std::span<const uint8_t> kept, double measured_mm)
    : surface_(surface),
      length_cost_(kStepsASample * surface.stepMm() / surface.fanUnitMm()),
      error_(measured_mm / surface.fanUnitMm()) {
  names_.assign(triangles.begin(), triangles.end());
  std::sort(names_.begin(), names_.end());
  names_.erase(std::unique(names_.begin(), names_.end()), names_.end());
  auto localOf = [&](uint32_t name) {
    return static_cast<uint32_t>(std::lower_bound(names_.begin(), names_.end(), name) - names_.begin());
  };
  std::unordered_map<uint32_t, uint32_t> seams;  // weld: welded vertex, of those that others may share
  for (uint32_t v = 0; v < names_.size(); ++v) {
    places_.push_back(surface.place(names_[v]));
    sides_.push_back(static_cast<uint8_t>(surface.sidesOf(names_[v])));
    const uint32_t weld = surface.weld(names_[v]);
    uint32_t own = static_cast<uint32_t>(vertices_.size());
    if (sides_[v] != 0) own = seams.try_emplace(weld, own).first->second;
    if (own == vertices_.size()) vertices_.emplace_back();
    if (surface.isCorner(names_[v]) || (!kept.empty() && kept[weld])) vertices_[own].kept = true;
    welded_.push_back(own);
  }
  alive_ = triangles.size() / 3;
  corner_vertex_.reserve(triangles.size());
  next_corner_.reserve(triangles.size());
  for (uint32_t c = 0; c < triangles.size(); ++c) {
    corner_vertex_.push_back(localOf(triangles[c]));
    Vertex& v = vertices_[weldedAt(c)];
    next_corner_.push_back(v.corner);
    v.corner = c;
  }
  for (uint32_t v = 0; v < vertices_.size(); ++v) {
    evaluate(v);
    push(v);
  }
}

void SurfaceSimplifier::push(uint32_t vertex) {
  if (vertices_[vertex].cost >= 0) queue_.push({vertices_[vertex].cost, vertex});
}

// Corners of triangles that are gone leave the list on the way.
void SurfaceSimplifier::gather(uint32_t vertex) {
  ring_.clear();
  around_.clear();
  uint32_t* link = &vertices_[vertex].corner;
  while (*link != kNone) {
    const uint32_t corner = *link;
    if (corner_vertex_[corner - corner % 3] == kNone) {
      *link = next_corner_[corner];
      continue;
    }
    ring_.push_back(corner);
    for (const uint32_t other : {weldedAt(next(corner)), weldedAt(next(next(corner)))})
      if (std::find(around_.begin(), around_.end(), other) == around_.end()) around_.push_back(other);
    link = &next_corner_[corner];
  }
}

void SurfaceSimplifier::evaluate(uint32_t vertex) {
  Vertex& v = vertices_[vertex];
  v.changed = false;
  v.cost = -1;
  if (v.kept) return;
  gather(vertex);
  if (ring_.size() > kMostTrianglesAround) return;
  Cost least{kNoCollapse, kNoCollapse};
  for (const uint32_t target : around_) {
    const Cost cost = costOf(target, least.all);
    if (!(cost.all < least.all)) continue;
    least = cost;
    v.target = target;
  }
  if (!std::isfinite(least.all)) return;
  v.error = static_cast<float>(least.error);
  v.cost = static_cast<float>(least.all);
}

// Of the vertex that was gathered.
SurfaceSimplifier::Cost SurfaceSimplifier::costOf(uint32_t target, double enough) {
  // Each of its copies, one a patch, goes to the target's copy in that patch; and along the sides that it lies on.
  std::array<std::array<uint32_t, 2>, kMostCopies> moves;
  size_t count = 0;
  for (const uint32_t corner : ring_) {
    const uint32_t copy = corner_vertex_[corner];
    size_t m = 0;
    while (m < count && moves[m][0] != copy) ++m;
    if (m == moves.size()) return {kNoCollapse, kNoCollapse};
    if (m == count) moves[count++] = {copy, kNone};
    for (const uint32_t other : {next(corner), next(next(corner))}) {
      if (weldedAt(other) != target) continue;
      const uint32_t to = corner_vertex_[other];
      if (moves[m][1] != kNone && moves[m][1] != to) return {kNoCollapse, kNoCollapse};
      moves[m][1] = to;
    }
  }
  for (size_t m = 0; m < count; ++m)
    if (moves[m][1] == kNone || (sides_[moves[m][0]] & ~sides_[moves[m][1]]) != 0) return {kNoCollapse, kNoCollapse};
  double error = 0, longest = 0;  // squares of samples
  for (size_t m = 0; m < count; ++m) {
    const FineSurface::Place& to = places_[moves[m][1]];
    rims_.clear();
    for (const uint32_t corner : ring_) {
      if (corner_vertex_[corner] != moves[m][0]) continue;
      const uint32_t b = next(corner), c = next(b);
      if (weldedAt(b) == target || weldedAt(c) == target) continue;
      const FineSurface::Place &pb = places_[corner_vertex_[b]], &pc = places_[corner_vertex_[c]];
      // Seen from outside, with y downwards, triangles turn so.
      if ((pb.i - to.i) * (pc.j - to.j) - (pb.j - to.j) * (pc.i - to.i) >= 0) return {kNoCollapse, kNoCollapse};
      longest = std::max(longest, static_cast<double>((pb.i - to.i) * (pb.i - to.i) + (pb.j - to.j) * (pb.j - to.j)));
      rims_.push_back({FineSurface::Sample{pb.i, pb.j}, FineSurface::Sample{pc.i, pc.j}});
    }
    if (rims_.empty()) return {kNoCollapse, kNoCollapse};  // a patch would lose all that it has here
    const double length = length_cost_ * std::sqrt(longest);
    if (length >= enough) return {kNoCollapse, kNoCollapse};
    error = std::max(error, surface_.fanDeviation(to.patch, {to.i, to.j}, rims_, enough - length));
    if (error + length >= enough) return {kNoCollapse, kNoCollapse};
  }
  return {error, error + length_cost_ * std::sqrt(longest)};
}

void SurfaceSimplifier::collapse(uint32_t vertex, uint32_t target) {
  gather(vertex);
  const std::vector<uint32_t> around = around_;
  // First the triangles that vanish say which copy goes where.
  std::array<std::array<uint32_t, 2>, kMostCopies> moves;
  size_t count = 0;
  auto known = [&](uint32_t copy) {
    size_t m = 0;
    while (m < count && moves[m][0] != copy) ++m;
    return m;
  };
  for (const uint32_t corner : ring_)
    for (const uint32_t other : {next(corner), next(next(corner))})
      if (weldedAt(other) == target && known(corner_vertex_[corner]) == count)
        moves[count++] = {corner_vertex_[corner], corner_vertex_[other]};
  for (const uint32_t corner : ring_) {
    const bool gone = weldedAt(next(corner)) == target || weldedAt(next(next(corner))) == target;
    if (gone) {
      corner_vertex_[corner - corner % 3] = kNone;
      --alive_;
      continue;
    }
    corner_vertex_[corner] = moves[known(corner_vertex_[corner])][1];
    next_corner_[corner] = vertices_[target].corner;
    vertices_[target].corner = corner;
  }
  vertices_[vertex].kept = true;  // gone
  vertices_[vertex].corner = kNone;
  for (const uint32_t other : around) {
    Vertex& v = vertices_[other];
    v.changed = true;
    if (v.kept || v.cost >= 0) continue;
    evaluate(other);  // it had no collapse; now it may have one
    push(other);
  }
}

void SurfaceSimplifier::reduce(size_t target_triangles, double error_mm) {
  const double most = error_mm / surface_.fanUnitMm();
  while (alive_ > target_triangles && !queue_.empty()) {
    const Entry entry = queue_.top();
    if (entry.cost > most) return;
    queue_.pop();
    Vertex& v = vertices_[entry.vertex];
    if (v.kept || v.cost != entry.cost) continue;
    if (v.changed) {
      evaluate(entry.vertex);
      if (v.cost > entry.cost || v.cost < 0) {
        push(entry.vertex);
        continue;
      }
    }
    error_ = std::max<double>(error_, v.error);
    collapse(entry.vertex, v.target);
  }
}

std::vector<uint32_t> SurfaceSimplifier::triangles() const {
  std::vector<uint32_t> out;
  out.reserve(3 * alive_);
  for (uint32_t c = 0; c < corner_vertex_.size(); c += 3) {
    if (corner_vertex_[c] == kNone) continue;
    for (uint32_t k = 0; k < 3; ++k) out.push_back(names_[corner_vertex_[c + k]]);
  }
  return out;
}

}  // namespace relievo
