// feedback.h - from the pixels of a feedback pass to the pages that a view wants.
// A feedback pixel is 4 uint32 (RGBA32UI): x = 0 background, else 1; then the node of the texture level that the pixel
// wants: x = 1 | level << 8 | 1 << 16 when the next coarser level is wanted too (always requested; kept for counting),
// y = patch, z = node x, w = node y.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "src/artwork/node_id.h"
#include "src/base/key_index.h"

namespace relievo {

struct NodeRequest {
  NodeId node;
  uint32_t pixels = 0;        // feedback pixels that want it (0: it is an ancestor of one that is wanted)
  float centre_distance = 0;  // smallest distance from the view's centre, 0..1 (1: a corner)
};

// A feedback picture of 1/scale: pixel (i, j) is the full picture's pixel (i * scale + x, j * scale + y). Over scale^2
// turns x, y run through all offsets, each once, in an order in which every beginning is spread well (each offset is
// the one farthest from those before it, blocks repeating on all sides); the first is the block's middle.
// scale 1..kMaxFeedbackScale.
inline constexpr int kMaxFeedbackScale = 16;
struct FeedbackOffset {
  int x = 0, y = 0;
};
FeedbackOffset feedbackOffset(int scale, uint64_t turn);

// No more nodes than slots can exist (slots are 16-bit): pixels that would exceed this are dropped.
inline constexpr size_t kMaxRequests = 65536;

// Unique nodes, ordered as they should be requested: coarse before fine, then near to the view's centre. The parent of
// every wanted node is wanted too, up to the root (trilinear reads the parent; the others are what shows while it is
// missing): 1/3 more pages. An ancestor is as near to the centre as the nearest of those that want it. Pixels that are
// no node's name (a driver's garbage: other bits in x, levels or coordinates out of range) are dropped. Keeps its
// scratch memory between calls. The result is valid until the next call and depends on the pixels alone.
class FeedbackAnalyzer {
 public:
  std::span<const NodeRequest> analyze(std::span<const std::array<uint32_t, 4>> pixels, int width_px, int height_px);

 private:
  uint32_t findOrAdd(uint64_t key);  // index into requests_

  std::vector<NodeRequest> requests_;
  KeyIndex keys_;                 // packNode of requests_[i]
  std::vector<uint32_t> parent_;  // index of requests_[i]'s parent, always smaller than i
  std::vector<NodeRequest> ordered_;
  std::vector<std::pair<uint64_t, uint32_t>> sort_keys_;
};

}  // namespace relievo
