#include "texturing/stream/feedback.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdlib>

namespace relievo {

namespace {
constexpr uint32_t kNoParent = 0xFFFFFFFFu;

bool isNode(const std::array<uint32_t, 4>& p) {
  uint32_t level = (p[0] >> 8) & 0xFFu;
  return (p[0] & 0xFFu) == 1 && (p[0] >> 17) == 0 && level <= kMaxNodeLevel && p[1] < kMaxPatches &&
         (p[2] >> level) == 0 && (p[3] >> level) == 0;
}

// As ==, which GCC makes a call of memcmp.
bool equalPixels(const std::array<uint32_t, 4>& a, const std::array<uint32_t, 4>& b) {
  return ((a[0] ^ b[0]) | (a[1] ^ b[1]) | (a[2] ^ b[2]) | (a[3] ^ b[3])) == 0;
}

std::vector<FeedbackOffset> offsetsOf(int scale) {
  auto distance2 = [scale](const FeedbackOffset& a, const FeedbackOffset& b) {
    int dx = std::abs(a.x - b.x), dy = std::abs(a.y - b.y);
    dx = std::min(dx, scale - dx);
    dy = std::min(dy, scale - dy);
    return dx * dx + dy * dy;
  };
  std::vector<FeedbackOffset> remaining, order;
  for (int y = 0; y < scale; ++y)
    for (int x = 0; x < scale; ++x) remaining.push_back({x, y});
  std::vector<int> nearest(remaining.size(), 4 * scale * scale);
  size_t next = static_cast<size_t>(scale / 2 * scale + scale / 2);
  while (!remaining.empty()) {
    FeedbackOffset chosen = remaining[next];
    order.push_back(chosen);
    remaining.erase(remaining.begin() + static_cast<std::ptrdiff_t>(next));
    nearest.erase(nearest.begin() + static_cast<std::ptrdiff_t>(next));
    next = 0;
    for (size_t i = 0; i < remaining.size(); ++i) {
      nearest[i] = std::min(nearest[i], distance2(remaining[i], chosen));
      if (nearest[i] > nearest[next]) next = i;
    }
  }
  return order;
}
}  // namespace

FeedbackOffset feedbackOffset(int scale, uint64_t turn) {
  static const auto kOrders = [] {
    std::array<std::vector<FeedbackOffset>, kMaxFeedbackScale + 1> orders;
    for (int s = 1; s <= kMaxFeedbackScale; ++s) orders[static_cast<size_t>(s)] = offsetsOf(s);
    return orders;
  }();
  const auto& order = kOrders[static_cast<size_t>(std::clamp(scale, 1, kMaxFeedbackScale))];
  return order[turn % order.size()];
}

std::span<const NodeRequest> FeedbackAnalyzer::analyze(std::span<const std::array<uint32_t, 4>> pixels, int width_px,
                                                       int height_px) {
  requests_.clear();
  keys_.clear();
  parent_.clear();
  ordered_.clear();
  if (width_px <= 0 || height_px <= 0) return {};

  // Twice the distance from the centre in pixels, so that pixel centres are integers. Squared, so that floats appear
  // only at the end.
  auto width = static_cast<int64_t>(width_px), height = static_cast<int64_t>(height_px);
  height = std::min<int64_t>(height, static_cast<int64_t>(pixels.size()) / width);
  auto nearer = [&](uint32_t i, int64_t d2) {
    requests_[i].centre_distance = std::min(requests_[i].centre_distance, float(d2));
  };
  for (int64_t y = 0; y < height; ++y) {
    const auto* row = pixels.data() + y * width;
    int64_t dy = 2 * y + 1 - height_px;
    for (int64_t x = 0; x < width;) {
      // Neighbours mostly want the same node: one look-up serves a run of equal pixels.
      int64_t end = x + 1;
      while (end < width && equalPixels(row[end], row[x])) ++end;
      const auto& p = row[x];
      if (const std::optional<NodeId> node = nodeOf(p)) {
        if (requests_.size() + node->level < kMaxRequests) {
          uint32_t i = findOrAdd(packNode(*node));
          auto run = static_cast<uint32_t>(end - x);
          requests_[i].pixels += run;
          if ((p[0] >> 16 & 1u) && parent_[i] != kNoParent) requests_[parent_[i]].pixels += run;
          // The run's pixel that is nearest to the middle column.
          int64_t first = 2 * x + 1 - width_px, last = 2 * end - 1 - width_px;
          int64_t dx = first > 0 ? first : last < 0 ? last : (first & 1);
          nearer(i, dx * dx + dy * dy);
        }
      }
      x = end;
    }
  }
  // Parents precede their children.
  for (size_t i = requests_.size(); i-- > 0;)
    if (parent_[i] != kNoParent)
      requests_[parent_[i]].centre_distance =
          std::min(requests_[parent_[i]].centre_distance, requests_[i].centre_distance);

  double corner2 = double(width_px) * width_px + double(height_px) * height_px;
  sort_keys_.clear();
  for (uint32_t i = 0; i < requests_.size(); ++i) {
    auto d = static_cast<float>(std::sqrt(requests_[i].centre_distance / corner2));
    requests_[i].centre_distance = d;
    sort_keys_.emplace_back(uint64_t{requests_[i].node.level} << 32 | std::bit_cast<uint32_t>(d), i);
  }
  std::sort(sort_keys_.begin(), sort_keys_.end(), [&](const auto& a, const auto& b) {
    return a.first != b.first ? a.first < b.first : keys_[a.second] < keys_[b.second];
  });
  ordered_.reserve(requests_.size());
  for (const auto& [key, i] : sort_keys_) ordered_.push_back(requests_[i]);
  return ordered_;
}

std::optional<NodeId> FeedbackAnalyzer::nodeOf(const std::array<uint32_t, 4>& p) const {
  if (!isNode(p) || (domain_ && p[1] >= domain_->patchCount())) return std::nullopt;
  const NodeId node{p[1], p[0] >> 8 & 0xFFu, p[2], p[3]};
  return domain_ ? domain_->texturedNode(node) : node;
}

uint32_t FeedbackAnalyzer::findOrAdd(uint64_t key) {
  if (const uint32_t found = keys_.find(key); found != KeyIndex::kNone) return found;
  const NodeId node = unpackNode(key);
  const uint32_t parent = node.level > 0 ? findOrAdd(packNode(node.parent())) : kNoParent;
  requests_.push_back({node, 0, 3.0e38f});
  parent_.push_back(parent);
  return keys_.findOrAdd(key);
}

}  // namespace relievo
