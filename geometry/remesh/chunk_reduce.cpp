#include "geometry/remesh/chunk_reduce.h"

#include <algorithm>
#include <cmath>

#include "geometry/remesh/base_reduce.h"
#include "src/base/parallel_for.h"

namespace relievo {

namespace {

// What is known of a vertex: first the run that names it, or that several do; then its name in that run, or in the
// joined surface.
constexpr uint32_t kUnnamed = uint32_t{1} << 31;  // | run: not named yet
constexpr uint32_t kShared = kNoIndex - 1;        // by runs; no joined name yet

struct Run {
  Thinned left;
  std::vector<uint32_t> source;  // of each vertex left: the scan's, if runs share it; else kNoIndex
  bool sound = false;
};

Run thin(const TriMesh& mesh, size_t first, size_t last, std::vector<uint32_t>& names, const RunOptions& options,
         float length) {
  Run run;
  std::vector<uint32_t> shared, source;  // source: of the run's vertices, shared ones first
  for (size_t t = first; t < last; ++t)
    for (uint32_t v : mesh.triangles[t])
      if (names[v] == kShared) shared.push_back(v);
  std::sort(shared.begin(), shared.end());
  shared.erase(std::unique(shared.begin(), shared.end()), shared.end());
  source = shared;
  std::vector<Triangle> triangles;
  triangles.reserve(last - first);
  for (size_t t = first; t < last; ++t) {
    Triangle named;
    for (size_t k = 0; k < 3; ++k) {
      const uint32_t v = mesh.triangles[t][k];
      uint32_t& name = names[v];
      if (name == kShared) {
        named[k] = static_cast<uint32_t>(std::lower_bound(shared.begin(), shared.end(), v) - shared.begin());
        continue;
      }
      if (name & kUnnamed) {
        name = static_cast<uint32_t>(source.size());
        source.push_back(v);
      }
      named[k] = name;
    }
    triangles.push_back(named);
  }
  std::vector<glm::vec3> points(source.size());
  for (size_t i = 0; i < points.size(); ++i)
    points[i] = glm::vec3((glm::dvec3(mesh.positions_mm[source[i]]) - options.centre) / options.diagonal);
  auto surface = makeSurface(points, triangles);
  if (!surface) return run;
  std::vector<uint32_t>().swap(source);
  std::vector<glm::vec3>().swap(points);
  std::vector<Triangle>().swap(triangles);
  std::vector<uint32_t> stay;
  const std::vector<uint32_t> of = surface->source;
  for (uint32_t v = 0; v < of.size(); ++v)
    if (of[v] < shared.size()) stay.push_back(v);
  run.left = thinned(std::move(*surface), length, stay, options.interrupted);
  run.source.resize(run.left.vertex.size(), kNoIndex);
  for (size_t i = 0; i < run.source.size(); ++i)
    if (const uint32_t v = of[run.left.vertex[i]]; v < shared.size()) run.source[i] = shared[v];
  std::vector<uint32_t>().swap(run.left.vertex);
  run.sound = true;
  return run;
}

}  // namespace

std::optional<Surface> thinnedByRuns(const TriMesh& mesh, const RunOptions& options) {
  const size_t triangles = mesh.triangles.size();
  // Smaller ones fit into caches, larger ones leave less between them.
  const size_t length =
      options.run_triangles ? options.run_triangles : std::clamp(triangles / 32, size_t{1} << 16, size_t{1} << 19);
  const size_t count = (triangles + length - 1) / length;
  auto stopped = [&] { return options.interrupted && options.interrupted->load(std::memory_order_relaxed); };
  std::vector<uint32_t> names(mesh.positions_mm.size(), kNoIndex);
  std::vector<double> areas(count);
  for (size_t run = 0; run < count; ++run) {
    if (stopped()) return {};
    const uint32_t own = kUnnamed | static_cast<uint32_t>(run);
    for (size_t t = run * length; t < std::min(triangles, (run + 1) * length); ++t) {
      const Triangle& triangle = mesh.triangles[t];
      for (uint32_t v : triangle) {
        if (v >= names.size()) return {};
        names[v] = names[v] == kNoIndex || names[v] == own ? own : kShared;
      }
      const glm::vec3 a = mesh.positions_mm[triangle[0]];
      areas[run] +=
          0.5f * glm::length(glm::cross(mesh.positions_mm[triangle[1]] - a, mesh.positions_mm[triangle[2]] - a));
    }
  }
  double area = 0;
  for (double a : areas) area += a;
  area /= options.diagonal * options.diagonal;
  if (!(area > 0) || !std::isfinite(area)) return {};
  const auto side = static_cast<float>(std::sqrt(area / static_cast<double>(options.triangles) * 4 / std::sqrt(3.0)));

  std::vector<Run> runs(count);
  const bool done = parallelFor(
      count, options.workers, options.interrupted,
      [&](size_t run) {
        runs[run] = thin(mesh, run * length, std::min(triangles, (run + 1) * length), names, options, side);
      },
      [&](size_t taken) {
        if (options.progress) options.progress(static_cast<double>(taken) / static_cast<double>(count));
      });
  if (!done) return {};

  std::vector<glm::vec3> points;
  std::vector<Triangle> joined;
  std::vector<uint32_t> name;
  for (Run& run : runs) {
    if (!run.sound) return {};
    name.resize(run.source.size());
    for (size_t i = 0; i < name.size(); ++i) {
      uint32_t& known = run.source[i] == kNoIndex ? name[i] : names[run.source[i]];
      if (run.source[i] == kNoIndex || known == kShared) {
        known = static_cast<uint32_t>(points.size());
        points.push_back(run.left.points[i]);
      }
      name[i] = known;
    }
    for (const Triangle& t : run.left.triangles) joined.push_back({name[t[0]], name[t[1]], name[t[2]]});
    run = {};
  }
  std::vector<uint32_t>().swap(names);
  auto surface = makeSurface(points, joined);
  if (!surface) return {};
  return std::move(*surface);
}

}  // namespace relievo
