#include "geometry/remesh/chunk_reduce.h"

#include <algorithm>
#include <cmath>

#include "geometry/remesh/base_reduce.h"
#include "src/base/parallel_for.h"

namespace relievo {

namespace {

// Labels of the scan's vertices: first the chunk that uses a vertex, or that several do; then its index in that chunk,
// or in the joined surface.
constexpr uint32_t kUnlabelled = uint32_t{1} << 31;  // | chunk: not indexed yet
constexpr uint32_t kShared = kNoIndex - 1;           // used by several chunks; no joined index yet

struct Chunk {
  ReducedPart reduced;
  // For each remaining vertex its index in the scan if chunks share it, otherwise kNoIndex.
  std::vector<uint32_t> source;
  bool valid = false;
};

Chunk reduceChunk(const TriMesh& mesh, size_t first, size_t last, std::vector<uint32_t>& labels,
                  const ChunkOptions& options, float edge_length) {
  Chunk chunk;
  std::vector<uint32_t> shared, source;  // source: scan indices of the chunk's vertices, shared ones first
  for (size_t t = first; t < last; ++t)
    for (uint32_t v : mesh.triangles[t])
      if (labels[v] == kShared) shared.push_back(v);
  std::sort(shared.begin(), shared.end());
  shared.erase(std::unique(shared.begin(), shared.end()), shared.end());
  source = shared;
  std::vector<Triangle> triangles;
  triangles.reserve(last - first);
  for (size_t t = first; t < last; ++t) {
    Triangle chunk_triangle;
    for (size_t k = 0; k < 3; ++k) {
      const uint32_t v = mesh.triangles[t][k];
      uint32_t& label = labels[v];
      if (label == kShared) {
        chunk_triangle[k] = static_cast<uint32_t>(std::lower_bound(shared.begin(), shared.end(), v) - shared.begin());
        continue;
      }
      if (label & kUnlabelled) {
        label = static_cast<uint32_t>(source.size());
        source.push_back(v);
      }
      chunk_triangle[k] = label;
    }
    triangles.push_back(chunk_triangle);
  }
  std::vector<glm::vec3> points(source.size());
  for (size_t i = 0; i < points.size(); ++i)
    points[i] = glm::vec3((glm::dvec3(mesh.positions_mm[source[i]]) - options.centre) / options.diagonal);
  auto surface = makeSurface(points, triangles);
  if (!surface) return chunk;
  std::vector<uint32_t>().swap(source);
  std::vector<glm::vec3>().swap(points);
  std::vector<Triangle>().swap(triangles);
  std::vector<uint32_t> locked;
  const std::vector<uint32_t> of = surface->source;
  for (uint32_t v = 0; v < of.size(); ++v)
    if (of[v] < shared.size()) locked.push_back(v);
  chunk.reduced = reducePart(std::move(*surface), edge_length, locked, options.interrupted);
  chunk.source.resize(chunk.reduced.vertex.size(), kNoIndex);
  for (size_t i = 0; i < chunk.source.size(); ++i)
    if (const uint32_t v = of[chunk.reduced.vertex[i]]; v < shared.size()) chunk.source[i] = shared[v];
  std::vector<uint32_t>().swap(chunk.reduced.vertex);
  chunk.valid = true;
  return chunk;
}

}  // namespace

std::optional<Surface> reduceByChunks(const TriMesh& mesh, const ChunkOptions& options) {
  const size_t triangles = mesh.triangles.size();
  // Smaller chunks fit into caches, larger ones leave fewer triangles between them.
  const size_t chunk_length =
      options.chunk_triangles ? options.chunk_triangles : std::clamp(triangles / 32, size_t{1} << 16, size_t{1} << 19);
  const size_t count = (triangles + chunk_length - 1) / chunk_length;
  auto stopped = [&] { return options.interrupted && options.interrupted->load(std::memory_order_relaxed); };
  std::vector<uint32_t> labels(mesh.positions_mm.size(), kNoIndex);
  std::vector<double> areas(count);
  for (size_t chunk = 0; chunk < count; ++chunk) {
    if (stopped()) return {};
    const uint32_t own_label = kUnlabelled | static_cast<uint32_t>(chunk);
    for (size_t t = chunk * chunk_length; t < std::min(triangles, (chunk + 1) * chunk_length); ++t) {
      const Triangle& triangle = mesh.triangles[t];
      for (uint32_t v : triangle) {
        if (v >= labels.size()) return {};
        labels[v] = labels[v] == kNoIndex || labels[v] == own_label ? own_label : kShared;
      }
      const glm::vec3 a = mesh.positions_mm[triangle[0]];
      areas[chunk] +=
          0.5f * glm::length(glm::cross(mesh.positions_mm[triangle[1]] - a, mesh.positions_mm[triangle[2]] - a));
    }
  }
  double area = 0;
  for (double a : areas) area += a;
  area /= options.diagonal * options.diagonal;
  if (!(area > 0) || !std::isfinite(area)) return {};
  const auto side = static_cast<float>(std::sqrt(area / static_cast<double>(options.triangles) * 4 / std::sqrt(3.0)));

  std::vector<Chunk> chunks(count);
  const bool done = parallelFor(
      count, options.workers, options.interrupted,
      [&](size_t chunk) {
        chunks[chunk] = reduceChunk(mesh, chunk * chunk_length, std::min(triangles, (chunk + 1) * chunk_length), labels,
                                    options, side);
      },
      [&](size_t taken) {
        if (options.progress) options.progress(static_cast<double>(taken) / static_cast<double>(count));
      });
  if (!done) return {};

  std::vector<glm::vec3> points;
  std::vector<Triangle> joined;
  std::vector<uint32_t> label;
  for (Chunk& chunk : chunks) {
    if (!chunk.valid) return {};
    label.resize(chunk.source.size());
    for (size_t i = 0; i < label.size(); ++i) {
      uint32_t& joined_label = chunk.source[i] == kNoIndex ? label[i] : labels[chunk.source[i]];
      if (chunk.source[i] == kNoIndex || joined_label == kShared) {
        joined_label = static_cast<uint32_t>(points.size());
        points.push_back(chunk.reduced.points[i]);
      }
      label[i] = joined_label;
    }
    for (const Triangle& t : chunk.reduced.triangles) joined.push_back({label[t[0]], label[t[1]], label[t[2]]});
    chunk = {};
  }
  std::vector<uint32_t>().swap(labels);
  auto surface = makeSurface(points, joined);
  if (!surface) return {};
  return std::move(*surface);
}

}  // namespace relievo
