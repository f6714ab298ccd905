#include "geometry/bake/bake_trace.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "src/base/parallel_for.h"

namespace relievo {
namespace {

// Where a line comes closest to the mesh: from its point to the mesh's closest one, from there back to the line, and so
// on. It ends at borders that the line only just passes by, and at the nearest border from beyond it.
struct Approach {
  double along = 0, distance = 0;
};
Approach closestApproach(const RayScene& scene, const TriMesh& mesh, const Line& line) {
  constexpr int kSteps = 16;  // as many as a surface sloped by 45 degrees takes to 1e-5
  Approach out;
  const double squared = glm::dot(line.direction, line.direction);
  SurfacePoint near;
  for (int step = 0; step < kSteps; ++step) {
    const glm::dvec3 at = line.at + out.along * line.direction;
    near = scene.closestPoint(at, near);
    out.distance = near.along;
    if (!(squared > 0)) break;
    const auto& t = mesh.triangles[near.triangle];
    const glm::dvec3 a(mesh.positions_mm[t[0]]), b(mesh.positions_mm[t[1]]), c(mesh.positions_mm[t[2]]);
    const glm::dvec3 place = a + near.b1 * (b - a) + near.b2 * (c - a);
    const double along = std::clamp(glm::dot(place - line.at, line.direction) / squared, -line.reach, line.reach);
    const bool settled = std::abs(along - out.along) <= 1e-7 * line.reach;
    out.along = along;
    if (settled) break;
  }
  return out;
}

// The height along a line that meets the scan so, and its weight (Traced). 0 where it meets nothing within reach nor
// nearly does: borders that it touches are met.
void heightAlong(const RayScene& scene, const TriMesh& mesh, const Line& line, const SurfacePoint& hit, float& height,
                 uint8_t& weight) {
  constexpr double kNearly = 1e-3;  // of what a line reaches
  if (hit) {
    height = static_cast<float>(hit.along);
    const auto& t = mesh.triangles[hit.triangle];
    const glm::vec3& a = mesh.positions_mm[t[0]];
    const glm::vec3 normal = glm::cross(mesh.positions_mm[t[1]] - a, mesh.positions_mm[t[2]] - a),
                    direction(line.direction);
    const float cosine =
        glm::dot(normal, direction) / std::sqrt(glm::dot(normal, normal) * glm::dot(direction, direction));
    weight = static_cast<uint8_t>(1 + static_cast<int>(254 * std::clamp(cosine, 0.0f, 1.0f)));
  } else {
    const Approach near = closestApproach(scene, mesh, line);
    height = static_cast<float>(near.along);
    weight = near.distance <= kNearly * line.reach * glm::length(line.direction) ? 1 : 0;
  }
}

// What the lines do not know takes the mean of its neighbours, again and again: no spikes where the closest point
// jumps.
constexpr int kSmoothings = 8;

// The patches of one grid, each on one thread.
class SampleTracer {
 public:
  SampleTracer(const BakeGround& ground, Traced& out, std::vector<Probe>& probes)
      : ground_(ground),
        out_(out),
        probes_(probes),
        n_(size_t{1} << out.cells_log2),
        tiles_(n_ + 1, ground.tile()),
        with_probes_(probes.empty()) {
    if (with_probes_) probes_.resize(ground.layout.patches * probesAPatch(ground));
  }
  void trace(uint32_t patch);

 private:
  // One tile's lines: those of samples, then those of probes.
  struct Tile {
    LineLookup look;
    std::vector<size_t> to;  // of each line: a sample's place; then probes'
    size_t samples = 0;
  };
  using ProbeByTile = std::pair<size_t, size_t>;  // the tile's number, the probe
  std::vector<ProbeByTile> probesByTile(uint32_t patch) const;
  double share(size_t x) const { return static_cast<double>(std::min(x, n_)) / static_cast<double>(n_); }
  void addSamples(uint32_t patch, size_t x0, size_t y0, size_t x1, size_t y1, Tile& tile) const;
  void keep(const Tile& tile);

  const BakeGround& ground_;
  Traced& out_;
  std::vector<Probe>& probes_;
  const size_t n_;
  const Tiles tiles_;
  const bool with_probes_;
};

std::vector<SampleTracer::ProbeByTile> SampleTracer::probesByTile(uint32_t patch) const {
  std::vector<ProbeByTile> by_tile;
  if (!with_probes_) return by_tile;
  const size_t places = probesAPatch(ground_);
  auto tileOf = [&](double t) { return tiles_.of(static_cast<size_t>(t * static_cast<double>(n_))); };
  for (size_t k = patch * places; k < (patch + 1) * places; ++k) {
    const glm::dvec2 at = probePlace(k);
    by_tile.push_back({tileOf(at.y) * tiles_.parts + tileOf(at.x), k});
  }
  std::sort(by_tile.begin(), by_tile.end());
  return by_tile;
}

// Samples on sides and corners are looked up with the first patch that they belong to.
void SampleTracer::addSamples(uint32_t patch, size_t x0, size_t y0, size_t x1, size_t y1, Tile& tile) const {
  const SampleLayout& l = ground_.layout;
  const auto& corners = ground_.base.patches[patch];
  const size_t n = n_, m = n - 1;
  for (size_t y = y0; y < y1; ++y) {
    for (size_t x = x0; x < x1; ++x) {
      const bool on_u = x == 0 || x == n, on_v = y == 0 || y == n;
      double reach = ground_.patch_reach[patch];
      size_t place = l.insideFirst(patch, m) + (y - 1) * m + x - 1;
      if (on_u && on_v) {
        const uint32_t c = corners[(x ? 1 : 0) + (y ? 2 : 0)];
        if (ground_.corner_patch[c] != patch) continue;
        place = c;
        reach = ground_.corner_reach[c];
      } else if (on_u || on_v) {
        const size_t s = on_u ? (x ? kRight : kLeft) : (y ? kBottom : kTop), i = on_u ? y : x;
        const uint32_t side = l.patch_sides[patch][s];
        if (l.side_patch[side] != patch) continue;
        const auto [a, b] = kSideCorners[s];
        const bool forward = corners[static_cast<size_t>(a)] < corners[static_cast<size_t>(b)];
        place = l.sideFirst(side, m) + (forward ? i : n - i) - 1;
        reach = ground_.side_reach[side];
      }
      tile.look.add(lineOf(ground_.at(patch, x, y, n), reach), share(x), share(y), 0);
      tile.to.push_back(place);
    }
  }
  tile.samples = tile.to.size();
}

void SampleTracer::keep(const Tile& tile) {
  const auto& [look, to, samples] = tile;
  for (size_t i = 0; i < samples; ++i)
    heightAlong(*ground_.scene, *ground_.mesh, look.lines[i], look.hits[i], out_.heights[to[i]], out_.weights[to[i]]);
  for (size_t i = samples; i < to.size(); ++i) {
    if (!look.hits[i]) continue;
    const auto& positions = ground_.mesh->positions_mm;
    const auto& t = ground_.mesh->triangles[look.hits[i].triangle];
    const glm::dvec3 a(positions[t[0]]), b(positions[t[1]]), c(positions[t[2]]);
    const glm::dvec3 normal = glm::normalize(glm::cross(b - a, c - a));
    probes_[to[i]] = {look.hits[i].along, std::abs(glm::dot(look.lines[i].direction, normal))};
  }
}

void SampleTracer::trace(uint32_t patch) {
  Tile tile;
  const std::vector<ProbeByTile> by_tile = probesByTile(patch);
  auto next_probe = by_tile.begin();
  size_t tile_number = 0;
  tiles_.forEach([&](size_t x0, size_t y0, size_t x1, size_t y1) {
    ground_.begin(tile.look, patch, share(x0), share(y0), share(x1), share(y1));
    tile.to.clear();
    addSamples(patch, x0, y0, x1, y1, tile);
    for (; next_probe != by_tile.end() && next_probe->first == tile_number; ++next_probe) {
      const glm::dvec2 at = probePlace(next_probe->second);
      tile.look.add(lineOf(ground_.inside(patch, at.x, at.y), ground_.patch_reach[patch]), at.x, at.y, 0);
      tile.to.push_back(next_probe->second);
    }
    ++tile_number;
    ground_.find(tile.look);
    keep(tile);
    return !ground_.stopped();
  });
}

// kSmoothings rounds over `count` samples from place `from` on; neighbours(i): the mean of those of the i-th.
template <class Neighbours>
void smooth(Traced& traced, size_t from, size_t count, Neighbours neighbours) {
  std::vector<std::pair<size_t, float>> next;
  for (int round = 0; round < kSmoothings; ++round) {
    next.clear();
    for (size_t i = 0; i < count; ++i)
      if (!traced.weights[from + i]) next.push_back({from + i, neighbours(i)});
    if (next.empty()) return;
    for (const auto& [i, h] : next) traced.heights[i] = h;
  }
}

// Sides between their corners, then the inside between the sides, so that shared samples stay shared.
void smoothUnknown(const BakeGround& ground, Traced& traced) {
  const SampleLayout& l = ground.layout;
  const size_t n = size_t{1} << traced.cells_log2, m = n - 1;
  auto& heights = traced.heights;
  const auto& found = traced.weights;
  for (size_t side = 0; side < l.sides.size(); ++side) {
    const size_t first = l.sideFirst(side, m);
    smooth(traced, first, m, [&](size_t i) {
      const float before = i ? heights[first + i - 1] : heights[l.sides[side][0]];
      const float after = i + 1 < m ? heights[first + i + 1] : heights[l.sides[side][1]];
      return 0.5f * (before + after);
    });
  }
  std::vector<float> grid((n + 1) * (n + 1));
  for (uint32_t patch = 0; patch < l.patches; ++patch) {
    const size_t first = l.insideFirst(patch, m);
    if (std::find(found.begin() + static_cast<ptrdiff_t>(first), found.begin() + static_cast<ptrdiff_t>(first + m * m),
                  0) == found.begin() + static_cast<ptrdiff_t>(first + m * m))
      continue;
    l.gather<float>(ground.base, patch, m, heights, grid);
    auto inner = [&](size_t x, size_t y) { return x > 0 && x < n && y > 0 && y < n; };
    auto height = [&](size_t x, size_t y) {
      return inner(x, y) ? heights[first + (y - 1) * m + x - 1] : grid[y * (n + 1) + x];
    };
    smooth(traced, first, m * m, [&](size_t i) {
      const size_t x = i % m + 1, y = i / m + 1;
      return 0.25f * (height(x - 1, y) + height(x + 1, y) + height(x, y - 1) + height(x, y + 1));
    });
  }
}

}  // namespace

Result<Traced> traceSamples(const BakeGround& ground, int cells_log2, std::vector<Probe>& probes,
                            const std::function<void(double)>& progress) {
  const SampleLayout& l = ground.layout;
  const size_t count = l.count((size_t{1} << cells_log2) - 1);
  Traced out{cells_log2, std::vector<float>(count), std::vector<uint8_t>(count)};
  SampleTracer tracer(ground, out, probes);
  const bool done = parallelFor(
      l.patches, ground.workers, ground.interrupted, [&](size_t patch) { tracer.trace(static_cast<uint32_t>(patch)); },
      [&](size_t taken) {
        if (progress) progress(static_cast<double>(taken) / static_cast<double>(l.patches));
      });
  if (!done) return Error{ErrorKind::kInterrupted, "", "interrupted", ""};
  smoothUnknown(ground, out);
  for (size_t i = 0; i < l.corners; ++i) {
    if (ground.used[i]) continue;
    out.heights[i] = out.heights[ground.base.patches[0][0]];
    out.weights[i] = 1;
  }
  return out;
}

}  // namespace relievo
