// triangle_runs.h - boxes of runs of 16 triangles, and a tree of them, in 2 bytes a triangle. Runs are the mesh's own
// where these are short, otherwise those of its triangles along a curve, which takes 4 bytes a triangle more and a
// sort. Const and thread-safe.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/mesh/box_tree.h"
#include "geometry/mesh/mesh_order.h"
#include "geometry/mesh/tri_mesh.h"
#include "src/base/parallel_for.h"

namespace relievo {

class TriangleRuns {
 public:
  static constexpr size_t kRun = 16;  // a strip of 16 is not much longer than it is wide

  // The mesh's arrays are used in place: they must outlive the runs unchanged. workers: 0 is one for each core.
  TriangleRuns(const TriMesh& mesh, int workers) : mesh_(&mesh) {
    std::vector<Box> boxes = runBoxes(workers);
    if (!coherent(boxes)) {
      order_ = orderAlongCurve(mesh, workers);
      boxes = runBoxes(workers);
    }
    putAlongCurve(boxes);
    boxes_ = BoxTree(boxes);
  }
  // Whether triangles are taken in another order than the mesh's.
  bool ordered() const { return !order_.empty(); }
  // Triangles of a run: kRun, but of the mesh's last. Runs are numbered along a curve, so that those beside one another
  // in the tree of boxes lie near one another: runs of a mesh may be the rows of a grid.
  size_t sizeOf(size_t run) const { return std::min(kRun, triangles() - kRun * run_at_[run]); }
  uint32_t triangle(size_t run, size_t i) const { return triangleAt(kRun * run_at_[run] + i); }
  size_t triangles() const { return mesh_->triangles.size(); }
  const TriMesh& mesh() const { return *mesh_; }
  const BoxTree& boxes() const { return boxes_; }
  Box boxOf(uint32_t triangle) const {
    Box box;
    for (uint32_t v : mesh_->triangles[triangle]) box.add(mesh_->positions_mm[v]);
    return box;
  }

 private:
  uint32_t triangleAt(size_t place) const { return order_.empty() ? static_cast<uint32_t>(place) : order_[place]; }
  void putAlongCurve(std::vector<Box>& boxes) {
    Box all;
    for (const Box& box : boxes) all.add(box);
    std::vector<std::pair<uint32_t, uint32_t>> places;  // along the curve, and the run
    for (const Box& box : boxes)
      places.push_back(
          {placeOnCurve(0.5f * (box.low + box.high), all.low, all.high), static_cast<uint32_t>(places.size())});
    std::sort(places.begin(), places.end());
    const std::vector<Box> before = boxes;
    for (size_t i = 0; i < places.size(); ++i) {
      run_at_.push_back(places[i].second);
      boxes[i] = before[places[i].second];
    }
  }
  std::vector<Box> runBoxes(int workers) const {
    constexpr size_t kRunsPerJob = 1024;
    std::vector<Box> boxes((triangles() + kRun - 1) / kRun);
    parallelFor((boxes.size() + kRunsPerJob - 1) / kRunsPerJob, workers, nullptr, [&](size_t job) {
      for (size_t b = job * kRunsPerJob; b < std::min(boxes.size(), (job + 1) * kRunsPerJob); ++b)
        for (size_t i = b * kRun; i < std::min(triangles(), (b + 1) * kRun); ++i) boxes[b].add(boxOf(triangleAt(i)));
    });
    return boxes;
  }
  // Whether runs' boxes are, on average, hardly larger than 16 triangles in a row.
  bool coherent(const std::vector<Box>& boxes) const {
    constexpr double kMostTriangles = 2.0 * kRun;
    auto size = [](const Box& box) { return static_cast<double>(glm::length(box.high - box.low)); };
    double runs = 0, triangles = 0;
    for (size_t b = 0; b < boxes.size(); ++b) {
      runs += size(boxes[b]);
      triangles += size(boxOf(static_cast<uint32_t>(b * kRun)));
    }
    return runs <= kMostTriangles * triangles;
  }

  const TriMesh* mesh_;
  std::vector<uint32_t> order_;   // of the triangles; empty: the mesh's
  std::vector<uint32_t> run_at_;  // of a run's number, which of those in a row it is
  BoxTree boxes_;
};

}  // namespace relievo
