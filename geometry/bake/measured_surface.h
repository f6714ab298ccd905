// measured_surface.h - the surface of a bake, made coarse where that hardly shows, for measuring distances: in blocks
// of at most 8 x 8 cells, each of the coarsest grid within a tolerance of the finest. Between blocks of different grids
// there are gaps up to the tolerance. Units: mm, relative to the base's origin_mm. The same for any number of workers.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/bake/mesh_bake.h"
#include "geometry/mesh/box_tree.h"
#include "geometry/mesh/closest_search.h"

namespace relievo {

class MeasuredSurface {
 public:
  // The fewest blocks within the tolerance; or, in a quarter of the time, some more.
  enum class Blocks : uint8_t { kFewest, kSoon };
  // Chooses the blocks. Incomplete if it was interrupted.
  MeasuredSurface(const MeshBake& baked, double tolerance_mm, Blocks choice, int workers,
                  const std::atomic<bool>* interrupted);

  // The blocks of consecutive patches. 10 bytes a triangle: the vertices, and boxes of rows of cells. Every row of a
  // block is a part of the search (geometry/mesh/closest_search.h).
  class Part {
   public:
    const Box& box() const { return box_; }
    // As closestByBoxes() has it.
    double distance(const glm::dvec3& place, double within, size_t& row, double enough = kNeverEnough) const noexcept;
    // Twice the summed areas of the triangles before the part, and with them.
    double areaBefore() const { return area_before_.front(); }
    double areaAfter() const { return area_before_.back(); }

   private:
    friend class MeasuredSurface;
    struct Row {
      uint32_t first_vertex, cells;
    };
    template <class Use>
    void forEachTriangle(const Row& row, Use use) const;
    std::vector<glm::vec3> vertices_;
    std::vector<Row> rows_;
    std::vector<double> area_before_;  // of each row; the last is behind them all
    BoxTree boxes_;
    Box box_;
  };
  size_t patches() const { return blocks_.size(); }
  uint64_t triangles(size_t patch) const { return triangles_[patch]; }
  // The patches [first, end), with area_before on those before them. Incomplete if it was interrupted.
  Part part(size_t first, size_t end, double area_before) const;

  // Appends the samples on a part when `count` are spread over the whole surface, moved by `shift`.
  static void addSamples(const Part& part, double whole_area, size_t count, const glm::dvec3& shift, int workers,
                         std::vector<glm::dvec3>& out);

 private:
  static constexpr size_t kMostBlockCells = 8;  // a side
  // `cells` cells a side at the cells (x, y) of the grid of 2^log2 cells.
  struct Block {
    uint8_t log2 = 0, cells = 0;
    uint16_t x = 0, y = 0;
  };
  // within: as blocksWithin() (grid_error.h) leaves it.
  static std::vector<Block> blocksOf(const std::vector<std::vector<uint8_t>>& within);

  const MeshBake& baked_;
  int workers_;
  const std::atomic<bool>* interrupted_;
  std::vector<std::vector<Block>> blocks_;  // of each patch
  std::vector<uint64_t> triangles_;
};

}  // namespace relievo
