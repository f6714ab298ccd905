// feedback.h - turns the pixels of a feedback pass into the nodes that a view requests.
// A feedback pixel is 4 uint32 (RGBA32UI). x: 0 for background, otherwise 1 | level << 8, plus 1 << 16 if the next
// coarser level is wanted, too (it is always requested; the bit is for counting). y: patch. z, w: the node's x and y.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "src/artwork/node_id.h"
#include "src/artwork/patch_domain.h"
#include "src/base/key_index.h"

namespace relievo {

struct NodeRequest {
  NodeId node;
  uint32_t pixels = 0;        // feedback pixels that want it; 0: only an ancestor of a wanted node
  float centre_distance = 0;  // smallest distance from the view's centre, 0 to 1 (a corner)
};

// The offset (x, y) of a feedback picture of 1/scale: its pixel (i, j) is the full picture's pixel (i * scale + x, j *
// scale + y). Over scale^2 turns each offset occurs once, in an order of which every prefix is well spread: each offset
// is the one farthest from those before it, with blocks repeating on all sides; the first is the block's middle. scale:
// 1 to kMaxFeedbackScale.
inline constexpr int kMaxFeedbackScale = 16;
struct FeedbackOffset {
  int x = 0, y = 0;
};
FeedbackOffset feedbackOffset(int scale, uint64_t turn);

// More nodes than slots (16 bits) are useless: further pixels are dropped.
inline constexpr size_t kMaxRequests = 65536;

// Returns the unique nodes in the order of service: coarse before fine, then near to the view's centre. All ancestors
// of a wanted node are included, a third more pages: trilinear filtering reads the parent, and the others show while it
// is missing. Where a patch's texture ends at a coarser level, its finest node is wanted in the place of finer ones; a
// patch without texture pages wants none. An ancestor is as near to the centre as its nearest wanted descendant. Pixels
// that name no node (a driver's garbage: other bits in x, levels or coordinates out of range) are dropped. Scratch
// memory is kept between calls. The result is valid until the next call and depends on the pixels only.
class FeedbackAnalyzer {
 public:
  // domain: says which patches' textures end early; null: none does.
  explicit FeedbackAnalyzer(const PatchDomain* domain = nullptr) : domain_(domain) {}
  std::span<const NodeRequest> analyze(std::span<const std::array<uint32_t, 4>> pixels, int width_px, int height_px);

 private:
  uint32_t findOrAdd(uint64_t key);  // index into requests_

  std::optional<NodeId> nodeOf(const std::array<uint32_t, 4>& pixel) const;

  const PatchDomain* domain_;
  std::vector<NodeRequest> requests_;
  KeyIndex keys_;                 // packNode of requests_[i]
  std::vector<uint32_t> parent_;  // index of requests_[i]'s parent, which is smaller than i
  std::vector<NodeRequest> ordered_;
  std::vector<std::pair<uint64_t, uint32_t>> sort_keys_;
};

}  // namespace relievo
