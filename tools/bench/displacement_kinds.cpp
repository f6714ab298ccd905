#include "tools/bench/displacement_kinds.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

#include "geometry/mesh/closest_search.h"
#include "geometry/mesh/triangle_point.h"
#include "src/base/parallel_for.h"

namespace relievo {
namespace {

constexpr double kAny = std::numeric_limits<double>::infinity();
constexpr size_t kJob = 2048;

template <class Use>
void forEachOf(size_t count, Use use) {
  parallelFor((count + kJob - 1) / kJob, 0, nullptr, [&](size_t job) {
    size_t part = kNoPart;
    for (size_t i = job * kJob; i < std::min(count, (job + 1) * kJob); ++i) use(i, part);
  });
}

glm::dvec3 closestOf(const TriMesh& mesh, const ClosestSearch& search, const glm::dvec3& place, size_t& part) {
  search.distance(place, kAny, part);
  const auto [triangle, at] = closestTriangle(mesh, search, part, place);
  const TriangleCorners t = cornersOf(mesh, triangle);
  return t.a + at.b1 * (t.b - t.a) + at.b2 * (t.c - t.a);
}

// The triangles between the samples, patch after patch.
std::vector<std::array<uint32_t, 3>> trianglesOf(const DisplacedSamples& samples) {
  std::vector<std::array<uint32_t, 3>> out;
  const size_t n = samples.cells(), row = n + 1;
  for (const std::vector<uint32_t>& grid : samples.samplesOfPatches())
    for (size_t y = 0; y < n; ++y)
      for (size_t x = 0; x < n; ++x) {
        const uint32_t *c = grid.data() + y * row + x, *d = c + row;
        out.push_back({c[0], d[1], c[1]});
        out.push_back({c[0], d[0], d[1]});
      }
  return out;
}

}  // namespace

std::vector<uint8_t> samplesOn(const DisplacedSamples& samples, std::span<const uint8_t> patches) {
  std::vector<uint8_t> out(samples.points.size());
  const auto grids = samples.samplesOfPatches();
  for (size_t patch = 0; patch < grids.size(); ++patch)
    if (patches[patch])
      for (uint32_t s : grids[patch]) out[s] = 1;
  return out;
}

std::vector<glm::dvec3> nearestComponents(const DisplacedSamples& samples, std::span<const glm::dvec3> components,
                                          std::span<const uint8_t> chosen, const ClosestSearch& scan) {
  std::vector<glm::dvec3> out(components.begin(), components.end());
  forEachOf(out.size(), [&](size_t i, size_t& part) {
    if (chosen[i])
      out[i] =
          samples.componentsOf(i, closestOf(*samples.context.mesh, scan, samples.position(i, components[i]), part));
  });
  return out;
}

std::vector<glm::dvec3> fittedComponents(const DisplacedSamples& samples, std::span<const glm::dvec3> components,
                                         std::span<const uint8_t> chosen, const FidelityScan& scan) {
  constexpr int kRounds = 16, kSmoothRounds = 10;
  constexpr double kOwnWeight = 0.25;  // of the place nearest to a sample, beside those nearest to its triangles
  std::vector<glm::dvec3> out(components.begin(), components.end());
  if (std::ranges::none_of(chosen, [](uint8_t c) { return c != 0; })) return out;
  TriMesh drawn;
  drawn.triangles = trianglesOf(samples);
  drawn.positions_mm.resize(out.size());
  std::vector<glm::dvec3> position(out.size());
  for (size_t i = 0; i < out.size(); ++i) position[i] = samples.position(i, out[i]);
  struct Pull {
    glm::dvec3 sum{0};
    double weight = 0;
  };
  std::vector<Pull> pulls(out.size()), own(out.size()), smooth(out.size());
  std::vector<std::pair<uint32_t, TrianglePoint>> at(scan.areaSamples());
  for (int round = 0; round < kRounds; ++round) {
    for (size_t i = 0; i < out.size(); ++i) drawn.positions_mm[i] = glm::vec3(position[i]);
    const ClosestSearch search(drawn, 0);
    forEachOf(at.size(), [&](size_t i, size_t& part) {
      search.distance(scan.positions()[i], kAny, part);
      at[i] = closestTriangle(drawn, search, part, scan.positions()[i]);
    });
    forEachOf(out.size(), [&](size_t i, size_t& part) {
      own[i] = {};
      if (!chosen[i]) return;
      own[i].weight = kOwnWeight;
      own[i].sum = kOwnWeight * (closestOf(scan.mesh(), scan.search(), position[i], part) - position[i]);
    });
    pulls = own;
    for (size_t i = 0; i < at.size(); ++i) {
      const auto& t = drawn.triangles[at[i].first];
      const double b1 = at[i].second.b1, b2 = at[i].second.b2;
      const std::array<double, 3> weight{1 - b1 - b2, b1, b2};
      const glm::dvec3 place = weight[0] * position[t[0]] + b1 * position[t[1]] + b2 * position[t[2]];
      for (size_t k = 0; k < 3; ++k)
        if (chosen[t[k]]) pulls[t[k]].sum += weight[k] * (scan.positions()[i] - place), pulls[t[k]].weight += weight[k];
    }
    // First over neighbours, so that triangles slide along the scan together.
    for (int pass = 0; round < kSmoothRounds && pass < 2; ++pass) {
      smooth = pulls;
      for (const auto& t : drawn.triangles)
        for (size_t k = 0; k < 3; ++k) {
          const uint32_t a = t[k], b = t[(k + 1) % 3];
          if (!chosen[a] || !chosen[b]) continue;
          constexpr double kShare = 0.2;
          smooth[a].sum += kShare * pulls[b].sum, smooth[a].weight += kShare * pulls[b].weight;
          smooth[b].sum += kShare * pulls[a].sum, smooth[b].weight += kShare * pulls[a].weight;
        }
      std::swap(pulls, smooth);
    }
    for (size_t i = 0; i < out.size(); ++i)
      if (chosen[i] && pulls[i].weight > 0) position[i] += pulls[i].sum / pulls[i].weight;
  }
  for (size_t i = 0; i < out.size(); ++i)
    if (chosen[i]) out[i] = samples.componentsOf(i, position[i]);
  return out;
}

std::vector<glm::dvec3> borderComponents(const DisplacedSamples& samples, std::span<const glm::dvec3> components,
                                         size_t& moved) {
  const TriMesh& scan = *samples.context.mesh;
  std::map<std::pair<uint32_t, uint32_t>, int> uses;
  for (const auto& t : scan.triangles)
    for (size_t k = 0; k < 3; ++k) ++uses[std::minmax(t[k], t[(k + 1) % 3])];
  TriMesh border;  // an edge is a triangle without area
  border.positions_mm = scan.positions_mm;
  for (const auto& [edge, count] : uses)
    if (count == 1) border.triangles.push_back({edge.first, edge.second, edge.second});
  std::vector<glm::dvec3> out(components.begin(), components.end());
  moved = 0;
  if (border.triangles.empty()) return out;
  const SampleLayout& l = samples.context.layout;
  std::vector<int> patches_of(l.sides.size());
  for (const auto& sides : l.patch_sides)
    for (uint32_t side : sides) ++patches_of[side];
  std::vector<uint8_t> chosen(out.size());
  const size_t m = samples.cells() - 1;
  for (size_t side = 0; side < l.sides.size(); ++side) {
    if (patches_of[side] != 1) continue;
    chosen[l.sides[side][0]] = chosen[l.sides[side][1]] = 1;
    std::fill_n(chosen.begin() + static_cast<ptrdiff_t>(l.sideBegin(side, m)), m, uint8_t{1});
  }
  for (const auto& sides : l.patch_sides)
    moved += std::ranges::any_of(sides, [&](uint32_t side) { return patches_of[side] == 1; });
  const ClosestSearch search(border, 0);
  forEachOf(out.size(), [&](size_t i, size_t& part) {
    if (chosen[i])
      out[i] = samples.componentsOf(i, closestOf(border, search, samples.position(i, components[i]), part));
  });
  return out;
}

BaseMesh withFittedDirections(const BaseMesh& base, const TriMesh& scan) {
  BaseMesh out = base;
  std::vector<double> length(base.corners.size()), sides(base.corners.size());
  for (const auto& patch : base.patches)
    for (const auto& [a, b] : kSideCorners) {
      const uint32_t from = patch[static_cast<size_t>(a)], to = patch[static_cast<size_t>(b)];
      const double mm = glm::length(base.corners[from].position_mm - base.corners[to].position_mm);
      for (uint32_t corner : {from, to}) length[corner] += mm, ++sides[corner];
    }
  struct Facet {
    glm::dvec3 centre, area;
  };
  std::vector<Facet> facets;
  for (uint32_t t = 0; t < scan.triangles.size(); ++t) {
    const TriangleCorners c = cornersOf(scan, t);
    facets.push_back({(c.a + c.b + c.c) / 3.0, glm::cross(c.b - c.a, c.c - c.a)});
  }
  const glm::dvec3 shift = base.origin_mm - scan.origin_mm;
  forEachOf(base.corners.size(), [&](size_t i, size_t&) {
    if (sides[i] == 0) return;
    const double radius = 0.5 * length[i] / sides[i];
    const glm::dvec3 at = glm::dvec3(base.corners[i].position_mm) + shift, old(base.corners[i].normal);
    glm::dvec3 sum(0);
    for (const Facet& f : facets)
      if (glm::dot(f.centre - at, f.centre - at) <= radius * radius && glm::dot(f.area, old) > 0) sum += f.area;
    if (glm::length(sum) > 0) out.corners[i].normal = glm::vec3(glm::normalize(sum));
  });
  return out;
}

}  // namespace relievo
