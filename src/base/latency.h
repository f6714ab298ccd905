// latency.h - percentiles of a long series in bounded memory: a histogram with 16 buckets per power of two, so that a
// percentile is exact below 16 and at most 1/16 too large above (Gil Tene's HdrHistogram, the same idea).
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>

namespace relievo {

class LatencyHistogram {
 public:
  void add(uint64_t value) {
    ++buckets_[bucketOf(value)];
    ++count_;
    max_ = std::max(max_, value);
  }
  uint64_t count() const { return count_; }
  uint64_t max() const { return max_; }
  // The smallest bound that at least `share` (0..1) of the values do not exceed; 0 when there are none.
  uint64_t percentile(double share) const {
    auto rank = static_cast<uint64_t>(std::ceil(share * static_cast<double>(count_)));
    uint64_t sum = 0;
    for (size_t b = 0; b < buckets_.size(); ++b)
      if ((sum += buckets_[b]) >= std::max<uint64_t>(1, rank)) return std::min(max_, lastOf(b));
    return max_;
  }

 private:
  static constexpr int kBits = 4;                    // 2^4 buckets per power of two
  static constexpr size_t kBuckets = 16 * (33 - 4);  // values from 2^32 on share the last
  static size_t bucketOf(uint64_t value) {
    if (value < 16) return static_cast<size_t>(value);
    int shift = std::bit_width(value) - 1 - kBits;
    return std::min(kBuckets - 1, static_cast<size_t>(16 * (shift + 1)) + static_cast<size_t>((value >> shift) & 15));
  }
  static uint64_t lastOf(size_t bucket) {
    if (bucket < 16) return bucket;
    if (bucket == kBuckets - 1) return ~uint64_t{0};
    size_t shift = bucket / 16 - 1;
    return (((16 + bucket % 16) + 1) << shift) - 1;
  }

  std::array<uint64_t, kBuckets> buckets_{};
  uint64_t count_ = 0, max_ = 0;
};

// Of a series of latencies: milliseconds, or frames.
struct LatencySummary {
  uint64_t count = 0;
  double p50 = 0, p90 = 0, p99 = 0, max = 0;
};
inline LatencySummary summarize(const LatencyHistogram& h, double unit) {
  auto at = [&](double share) { return static_cast<double>(h.percentile(share)) * unit; };
  return {h.count(), at(0.5), at(0.9), at(0.99), static_cast<double>(h.max()) * unit};
}

}  // namespace relievo
