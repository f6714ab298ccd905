#include "geometry/bake/bake_trace.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>

#include "src/base/parallel_for.h"

namespace relievo {
namespace {

// The point of a line that is closest to the mesh, by alternating projection: from a point of the line to the mesh's
// closest point, from there back to the line, and so on. For a line that passes beside a border this converges to the
// border.
struct ClosestApproach {
  double along = 0, distance = 0;
};
ClosestApproach closestApproach(const RayScene& scene, const TriMesh& mesh, const Line& line) {
  constexpr int kSteps = 16;  // enough for a precision of 1e-5 where the surface slopes by 45 degrees
  ClosestApproach out;
  const double squared = glm::dot(line.direction, line.direction);
  SurfacePoint near;
  for (int step = 0; step < kSteps; ++step) {
    const glm::dvec3 at = line.at + out.along * line.direction;
    near = scene.closestPoint(at, near);
    out.distance = near.along;
    if (!(squared > 0)) break;
    const auto& t = mesh.triangles[near.triangle];
    const glm::dvec3 a(mesh.positions_mm[t[0]]), b(mesh.positions_mm[t[1]]), c(mesh.positions_mm[t[2]]);
    const glm::dvec3 index = a + near.b1 * (b - a) + near.b2 * (c - a);
    const double along = std::clamp(glm::dot(index - line.at, line.direction) / squared, -line.reach, line.reach);
    const bool settled = std::abs(along - out.along) <= 1e-7 * line.reach;
    out.along = along;
    if (settled) break;
  }
  return out;
}

// The height where a line meets the scan, and its weight (TracedHeights). Without a hit the height is the closest
// approach; the weight is then 0 unless the line touches the scan, as it does at a border.
void heightFromHit(const RayScene& scene, const TriMesh& mesh, const Line& line, const SurfacePoint& hit, float& height,
                   uint8_t& weight) {
  constexpr double kTouchShare = 1e-3;  // of the line's reach
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
    const ClosestApproach near = closestApproach(scene, mesh, line);
    height = static_cast<float>(near.along);
    weight = near.distance <= kTouchShare * line.reach * glm::length(line.direction) ? 1 : 0;
  }
}

// Heights without a hit become the mean of their neighbours in several rounds, since the closest approach jumps from
// sample to sample and would leave spikes.
constexpr int kSmoothingRounds = 8;

// Traces patches; each by one thread.
class SampleTracer {
 public:
  SampleTracer(const BakeContext& context, const TracedHeights& coarser, TracedHeights& out, std::vector<Probe>& probes)
      : context_(context),
        coarser_(coarser),
        out_(out),
        probes_(probes),
        n_(size_t{1} << out.cells_log2),
        coarser_step_(context.rasteriser && !coarser.heights.empty() ? n_ >> coarser.cells_log2 : 0),
        tiles_(n_ + 1, context.tileSize()),
        with_probes_(probes.empty()) {
    if (with_probes_) probes_.resize(context.layout.patches * probesPerPatch(context));
  }
  void trace(uint32_t patch);

 private:
  // The lines of one tile: first those of samples, then those of probes.
  struct Tile {
    LineBatch batch;
    std::vector<BasePoint> top, bottom;  // of the patch, at the tile's columns
    std::vector<size_t> targets;         // for each line the index of its sample, or of its probe
    size_t samples = 0;
  };
  using ProbeByTile = std::pair<size_t, size_t>;  // number of the tile, index of the probe
  std::vector<ProbeByTile> probesByTile(uint32_t patch) const;
  double fraction(size_t x) const { return static_cast<double>(std::min(x, n_)) / static_cast<double>(n_); }
  // Where a grid has sample (x, y) of a patch, and how far its line is searched. Nothing: it is traced with another
  // patch.
  struct SamplePlace {
    size_t index;
    double reach;
  };
  std::optional<SamplePlace> placeOf(uint32_t patch, size_t x, size_t y, size_t n) const;
  // Takes the sample over from the coarser grid; false: its line has to be traced.
  bool takeOver(uint32_t patch, size_t x, size_t y, size_t index);
  void addSamples(uint32_t patch, size_t x0, size_t y0, size_t x1, size_t y1, Tile& tile);
  void storeTile(const Tile& tile);

  const BakeContext& context_;
  const TracedHeights& coarser_;
  TracedHeights& out_;
  std::vector<Probe>& probes_;
  const size_t n_, coarser_step_;  // coarser_step_: cells for each cell of the coarser grid; 0: there is none
  const Tiles tiles_;
  const bool with_probes_;
};

std::vector<SampleTracer::ProbeByTile> SampleTracer::probesByTile(uint32_t patch) const {
  std::vector<ProbeByTile> by_tile;
  if (!with_probes_) return by_tile;
  const size_t count = probesPerPatch(context_);
  auto tileOf = [&](double t) { return tiles_.tileOf(static_cast<size_t>(t * static_cast<double>(n_))); };
  for (size_t k = patch * count; k < (patch + 1) * count; ++k) {
    const glm::dvec2 at = probePosition(k);
    by_tile.push_back({tileOf(at.y) * tiles_.per_side + tileOf(at.x), k});
  }
  std::sort(by_tile.begin(), by_tile.end());
  return by_tile;
}

// Samples that patches share are traced with the first patch only.
std::optional<SampleTracer::SamplePlace> SampleTracer::placeOf(uint32_t patch, size_t x, size_t y, size_t n) const {
  const SampleLayout& l = context_.layout;
  const auto& corners = context_.base.patches[patch];
  const size_t m = n - 1;
  const bool on_u = x == 0 || x == n, on_v = y == 0 || y == n;
  if (!on_u && !on_v) return SamplePlace{l.interiorBegin(patch, m) + (y - 1) * m + x - 1, context_.patch_reach[patch]};
  if (on_u && on_v) {
    const uint32_t c = corners[(x ? 1 : 0) + (y ? 2 : 0)];
    if (context_.corner_patch[c] != patch) return std::nullopt;
    return SamplePlace{c, context_.corner_reach[c]};
  }
  const size_t s = on_u ? (x ? kRight : kLeft) : (y ? kBottom : kTop), i = on_u ? y : x;
  const uint32_t side = l.patch_sides[patch][s];
  if (l.side_patch[side] != patch) return std::nullopt;
  const auto [a, b] = kSideCorners[s];
  const bool forward = corners[static_cast<size_t>(a)] < corners[static_cast<size_t>(b)];
  return SamplePlace{l.sideBegin(side, m) + (forward ? i : n - i) - 1, context_.side_reach[side]};
}

// Numbers of cells are powers of two, so that a sample's (u, v), and with it its line, have the same bits on both
// grids. Heights without a hit were smoothed, and are found anew. Rays are not taken over: Embree traces them in
// packets, and which of two triangles a ray along their common side takes depends on the others of its packet.
bool SampleTracer::takeOver(uint32_t patch, size_t x, size_t y, size_t index) {
  if (coarser_step_ == 0 || x % coarser_step_ != 0 || y % coarser_step_ != 0) return false;
  const auto place = placeOf(patch, x / coarser_step_, y / coarser_step_, n_ / coarser_step_);
  if (coarser_.weights[place->index] == 0) return false;
  out_.heights[index] = coarser_.heights[place->index];
  out_.weights[index] = coarser_.weights[place->index];
  return true;
}

void SampleTracer::addSamples(uint32_t patch, size_t x0, size_t y0, size_t x1, size_t y1, Tile& tile) {
  // BakeContext::patchPoint() interpolates along u first: on both sides, once for all rows.
  std::array<BasePoint, 4> corners;
  for (size_t k = 0; k < 4; ++k) corners[k] = context_.cornerPoint(context_.base.patches[patch][k]);
  tile.top.clear();
  tile.bottom.clear();
  for (size_t x = x0; x < x1; ++x) {
    tile.top.push_back(lerp(corners[0], corners[1], fraction(x)));
    tile.bottom.push_back(lerp(corners[2], corners[3], fraction(x)));
  }
  for (size_t y = y0; y < y1; ++y) {
    for (size_t x = x0; x < x1; ++x) {
      const auto place = placeOf(patch, x, y, n_);
      if (!place || takeOver(patch, x, y, place->index)) continue;
      const bool inside = x > 0 && x < n_ && y > 0 && y < n_;
      const BasePoint at = inside && !context_.base.cut ? lerp(tile.top[x - x0], tile.bottom[x - x0], fraction(y))
                                                        : context_.gridPoint(patch, x, y, n_);
      tile.batch.add(lineThrough(at, place->reach), fraction(x), fraction(y), 0);
      tile.targets.push_back(place->index);
    }
  }
  tile.samples = tile.targets.size();
}

void SampleTracer::storeTile(const Tile& tile) {
  const auto& batch = tile.batch;
  const auto& targets = tile.targets;
  const size_t samples = tile.samples;
  for (size_t i = 0; i < samples; ++i)
    heightFromHit(*context_.scene, *context_.mesh, batch.lines[i], batch.hits[i], out_.heights[targets[i]],
                  out_.weights[targets[i]]);
  for (size_t i = samples; i < targets.size(); ++i) {
    if (!batch.hits[i]) continue;
    const auto& positions = context_.mesh->positions_mm;
    const auto& t = context_.mesh->triangles[batch.hits[i].triangle];
    const glm::dvec3 a(positions[t[0]]), b(positions[t[1]]), c(positions[t[2]]);
    const glm::dvec3 normal = glm::normalize(glm::cross(b - a, c - a));
    probes_[targets[i]] = {batch.hits[i].along, std::abs(glm::dot(batch.lines[i].direction, normal))};
  }
}

void SampleTracer::trace(uint32_t patch) {
  Tile tile;
  const std::vector<ProbeByTile> by_tile = probesByTile(patch);
  auto next_probe = by_tile.begin();
  size_t tile_number = 0;
  tiles_.forEach([&](size_t x0, size_t y0, size_t x1, size_t y1) {
    context_.beginBatch(tile.batch, patch, fraction(x0), fraction(y0), fraction(x1), fraction(y1));
    tile.targets.clear();
    addSamples(patch, x0, y0, x1, y1, tile);
    for (; next_probe != by_tile.end() && next_probe->first == tile_number; ++next_probe) {
      const glm::dvec2 at = probePosition(next_probe->second);
      tile.batch.add(lineThrough(context_.patchPoint(patch, at.x, at.y), context_.patch_reach[patch]), at.x, at.y, 0);
      tile.targets.push_back(next_probe->second);
    }
    ++tile_number;
    context_.intersect(tile.batch);
    storeTile(tile);
    return !context_.stopped();
  });
}

// Smooths the samples without a hit among `count` samples from index `from` on. neighbours(i): the mean of the i-th
// sample's neighbours.
template <class Neighbours>
void smooth(TracedHeights& traced, size_t from, size_t count, Neighbours neighbours) {
  std::vector<std::pair<size_t, float>> next;
  for (int round = 0; round < kSmoothingRounds; ++round) {
    next.clear();
    for (size_t i = 0; i < count; ++i)
      if (!traced.weights[from + i]) next.push_back({from + i, neighbours(i)});
    if (next.empty()) return;
    for (const auto& [i, h] : next) traced.heights[i] = h;
  }
}

// Smooths sides between their corners first, then interiors between the sides, so that patches still agree on shared
// samples.
void smoothUnresolved(const BakeContext& context, TracedHeights& traced) {
  const SampleLayout& l = context.layout;
  const size_t n = size_t{1} << traced.cells_log2, m = n - 1;
  auto& heights = traced.heights;
  const auto& found = traced.weights;
  for (size_t side = 0; side < l.sides.size(); ++side) {
    const size_t first = l.sideBegin(side, m);
    smooth(traced, first, m, [&](size_t i) {
      const float before = i ? heights[first + i - 1] : heights[l.sides[side][0]];
      const float after = i + 1 < m ? heights[first + i + 1] : heights[l.sides[side][1]];
      return 0.5f * (before + after);
    });
  }
  std::vector<float> grid((n + 1) * (n + 1));
  for (uint32_t patch = 0; patch < l.patches; ++patch) {
    const size_t first = l.interiorBegin(patch, m);
    if (std::find(found.begin() + static_cast<ptrdiff_t>(first), found.begin() + static_cast<ptrdiff_t>(first + m * m),
                  0) == found.begin() + static_cast<ptrdiff_t>(first + m * m))
      continue;
    l.gather<float>(context.base, patch, m, heights, grid);
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

Result<TracedHeights> traceSamples(const BakeContext& context, int cells_log2, std::vector<Probe>& probes,
                                   const std::function<void(double)>& progress, const TracedHeights& coarser) {
  const SampleLayout& l = context.layout;
  const size_t count = l.count((size_t{1} << cells_log2) - 1);
  TracedHeights out{cells_log2, std::vector<float>(count), std::vector<uint8_t>(count)};
  SampleTracer tracer(context, coarser, out, probes);
  const bool done = parallelFor(
      l.patches, context.workers, context.interrupted,
      [&](size_t patch) { tracer.trace(static_cast<uint32_t>(patch)); },
      [&](size_t taken) {
        if (progress) progress(static_cast<double>(taken) / static_cast<double>(l.patches));
      });
  if (!done) return Error{ErrorKind::kInterrupted, "", "interrupted", ""};
  smoothUnresolved(context, out);
  for (size_t i = 0; i < l.corners; ++i) {
    if (context.corner_used[i]) continue;
    out.heights[i] = out.heights[context.base.patches[0][0]];
    out.weights[i] = 1;
  }
  return out;
}

}  // namespace relievo
