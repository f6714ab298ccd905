// point_table.h - points at the same place have one name: an open hash table of indices into a vector of points. 0 and
// -0 are the same place. An entry keeps half of its point's hash, so that other points' entries are passed over without
// looking at the points (for a million points, the one cache miss less halves the time).
#pragma once

#include <bit>
#include <cstdint>
#include <cstring>
#include <vector>

#include <glm/glm.hpp>

namespace relievo {

template <class Point>
class PointTable {
 public:
  explicit PointTable(size_t room = 0) { rehash({}, room); }

  // The index of the point in points, of which a part is in the table; it is appended if it is new.
  uint32_t findOrAppend(std::vector<Point>& points, Point p) {
    p += Point(0);  // -0 + 0 is 0
    if (points.size() >= room_) rehash(points, 2 * points.size() + 64);
    uint32_t same = findOrAdd(points, p, static_cast<uint32_t>(points.size()));
    if (same == points.size()) points.push_back(p);
    return same;
  }
  // The index in the table of the same place as p (which is not -0), or index, which is in the table from now on. There
  // must be room.
  uint32_t findOrAdd(const std::vector<Point>& points, const Point& p, uint32_t index) {
    const uint64_t h = hash(p), tag = h << 32;
    for (size_t s = h >> shift_;; s = (s + 1) & (table_.size() - 1)) {
      uint64_t entry = table_[s];
      if (entry == kNone) {
        table_[s] = tag | index;
        return index;
      }
      if ((entry ^ tag) >> 32 == 0 && points[static_cast<uint32_t>(entry)] == p) return static_cast<uint32_t>(entry);
    }
  }
  // For a point that will be asked for soon: the table is larger than caches.
  void prefetch(const Point& p) const { __builtin_prefetch(&table_[hash(p) >> shift_]); }

 private:
  static constexpr uint64_t kNone = ~uint64_t{0};  // no index is 2^32 - 1

  void rehash(const std::vector<Point>& points, size_t room) {
    room_ = room;
    table_.assign(std::bit_ceil(room + room / 4 + 2), kNone);
    shift_ = 64 - std::countr_zero(table_.size());
    for (size_t i = 0; i < points.size(); ++i) findOrAdd(points, points[i], static_cast<uint32_t>(i));
  }
  static uint64_t hash(const Point& p) {
    uint64_t words[(sizeof(Point) + 7) / 8] = {}, h = 0;
    std::memcpy(words, &p, sizeof(Point));
    for (uint64_t w : words) h = ((h ^ w) ^ (w >> 29)) * 0x9E3779B97F4A7C15ull;
    h = (h ^ (h >> 32)) * 0xD6E8FEB86659FD93ull;
    return h ^ (h >> 29);
  }
  std::vector<uint64_t> table_;
  size_t room_ = 0;
  int shift_ = 0;
};

}  // namespace relievo
