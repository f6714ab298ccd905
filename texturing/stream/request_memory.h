// request_memory.h - what a view asked for over its last feedback results. A small, jittered feedback pass sees only
// one pixel of each scale x scale block at a time: a still view needs scale^2 results until every pixel was seen, and
// until then, and after, the pages that only some of them named must stay wanted, or they would be evicted and loaded
// anew. A still view remembers as many results as it takes to see every pixel; a moved one the last kMovingResults.
#pragma once

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "src/base/hash_index.h"
#include "texturing/stream/feedback.h"

namespace relievo {

// Under slow movement thin pages would come and go with the offsets: with the newest result alone 0.9 % of the pages
// that stay wanted drop out of the list from one frame to the next, with four results 0.3 % (relievo bench --only
// request source).
inline constexpr uint32_t kMovingResults = 4;

class RequestMemory {
 public:
  // newest: a result, parents included (FeedbackAnalyzer). view: differs between views, the same for results of a still
  // one. still_results: results until a still view has seen everything. The union, ordered as FeedbackAnalyzer orders;
  // valid until the next call. Closed under parents, since an ancestor is named whenever its descendant is. At most
  // kMaxRequests: above it only the newest result counts.
  std::span<const NodeRequest> add(std::span<const NodeRequest> newest, uint64_t view, uint32_t still_results);
  void clear();

 private:
  struct Entry {
    NodeRequest request;
    uint64_t key = 0;     // packNode
    uint64_t result = 0;  // the last that named it
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
