// triangle_blocks.h - which vertices each block of successive triangles names: who looks for a range of vertices passes
// over the other blocks. In most scans vertices are listed as triangles are, and a block names few; where they are not,
// nothing is passed over.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "src/base/parallel_for.h"

namespace relievo {

class TriangleBlocks {
 public:
  TriangleBlocks(std::span<const std::array<uint32_t, 3>> triangles, int workers)
      : count_(triangles.size()), ranges_((count_ + kBlock - 1) / kBlock) {
    constexpr size_t kBlocksAJob = 16;
    parallelFor((ranges_.size() + kBlocksAJob - 1) / kBlocksAJob, workers, nullptr, [&](size_t job) {
      for (size_t b = job * kBlocksAJob; b < std::min(ranges_.size(), (job + 1) * kBlocksAJob); ++b) {
        Range range;
        for (const auto& t : triangles.subspan(b * kBlock, std::min(kBlock, count_ - b * kBlock)))
          for (uint32_t v : t) range = {std::min(range.first, v), std::max(range.last, v)};
        ranges_[b] = range;
      }
    });
  }
  // visit(triangle) in their order, of all that name a vertex within first <= v < last and some others, until `stopped`
  // says so (asked once a block).
  template <class Stopped, class Visit>
  void forEach(size_t first, size_t last, Stopped stopped, Visit visit) const {
    for (size_t b = 0; b < ranges_.size() && !stopped(); ++b) {
      if (ranges_[b].last < first || ranges_[b].first >= last) continue;
      for (size_t t = b * kBlock; t < std::min(count_, (b + 1) * kBlock); ++t) visit(t);
    }
  }

 private:
  static constexpr size_t kBlock = 2048;  // 24 KB
  struct Range {
    uint32_t first = ~uint32_t{0}, last = 0;
  };
  size_t count_;
  std::vector<Range> ranges_;
};

}  // namespace relievo
