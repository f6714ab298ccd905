// feedback.h - from the pixels of a feedback pass to the pages that a view wants.
// A feedback pixel is 4 uint32 (RGBA32UI): x = 0 background, else 1; then the node of the texture level that the pixel wants:
// x = 1 | level << 8 | 1 << 16 when the next coarser level is wanted too (always requested; kept for counting),
// y = patch, z = node x, w = node y.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "src/base/node_id.h"

namespace relievo {

struct NodeWant {
  NodeId node;
  uint32_t pixels = 0;           // feedback pixels that want it
  float centre_distance = 0;     // smallest distance from the view's centre, 0..1 (1: a corner)
};

// Unique nodes, ordered as they should be requested: coarse before fine, then near to the view's centre. The parent of every wanted
// node is wanted too (trilinear reads it, and it is what shows while the node is missing).
// Out-of-range levels or coordinates (a driver's garbage) are dropped. Keeps its scratch memory between calls.
class FeedbackAnalyzer {
 public:
  std::span<const NodeWant> analyze(std::span<const std::array<uint32_t, 4>> pixels, int width_px, int height_px);

 private:
  std::vector<NodeWant> wants_;
  std::vector<uint32_t> table_;
};

}  // namespace relievo
