// request_memory.h - remembers the requests of a view's last feedback results. A small, jittered feedback pass sees
// only one pixel of each scale x scale block at a time: a still view needs scale^2 results until each pixel was seen.
// Pages that only some of these results name must stay requested, or they would be evicted and loaded again. A still
// view remembers as many results as it takes to see every pixel, a moving one the last kMovingResults.
#pragma once

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "src/base/hash_index.h"
#include "texturing/stream/feedback.h"

namespace relievo {

// While a view moves slowly, pages seen by few pixels would come and go with the offsets: with only the newest result,
// 0.9 % of the pages that stay in view drop out of the list from one frame to the next; with four results 0.3 %
// (relievo bench --only request source).
inline constexpr uint32_t kMovingResults = 4;

class RequestMemory {
 public:
  // newest: a result with ancestors (FeedbackAnalyzer). view: a number that differs between views and stays the same
  // for the results of a still one. still_results: the number of results until a still view has seen everything.
  // Returns the union in FeedbackAnalyzer's order, valid until the next call. It contains all ancestors, since a result
  // that names a node names these. At most kMaxRequests; beyond it only the newest result counts.
  std::span<const NodeRequest> add(std::span<const NodeRequest> newest, uint64_t view, uint32_t still_results);
  void clear();

 private:
  struct Entry {
    NodeRequest request;
    uint64_t key = 0;     // packNode
    uint64_t result = 0;  // the last result that named it
  };
  uint32_t findOrAdd(uint64_t key, size_t index);
  void rebuildIndex(size_t entries);
  void sort();

  std::vector<Entry> entries_;
  HashIndex<uint32_t> index_;  // key -> entry
  std::vector<NodeRequest> ordered_;
  std::vector<std::pair<uint64_t, uint32_t>> sort_keys_;
  uint64_t result_ = 0, still_since_ = 0, view_ = 0;
};

}  // namespace relievo
