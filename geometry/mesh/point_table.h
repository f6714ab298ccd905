// point_table.h - points at the same place have one name: their index in a vector of points. 0 and -0 are the same
// place.
#pragma once

#include <cstdint>
#include <cstring>
#include <vector>

#include <glm/glm.hpp>

#include "src/base/hash_index.h"

namespace relievo {

template <class Point>
class PointTable {
 public:
  explicit PointTable(size_t room = 0) : index_(room) {}

  // The index of the point in points, of which a part is in the table; it is appended if it is new.
  uint32_t findOrAppend(std::vector<Point>& points, Point p) {
    p += Point(0);  // -0 + 0 is 0
    index_.makeRoom();
    uint32_t same = findOrAdd(points, p, static_cast<uint32_t>(points.size()));
    if (same == points.size()) points.push_back(p);
    return same;
  }
  // The index in the table of the same place as p (which is not -0), or index, which is in the table from now on. There
  // must be room.
  uint32_t findOrAdd(const std::vector<Point>& points, const Point& p, uint32_t index) {
    return index_.findOrAdd(hash(p), index, [&](uint32_t i) { return points[i] == p; });
  }
  // For a point that will be asked for soon.
  void prefetch(const Point& p) const { index_.prefetch(hash(p)); }

 private:
  static uint64_t hash(const Point& p) {
    uint64_t words[(sizeof(Point) + 7) / 8] = {}, h = 0;
    std::memcpy(words, &p, sizeof(Point));
    for (uint64_t w : words) h = ((h ^ w) ^ (w >> 29)) * 0x9E3779B97F4A7C15ull;
    h = (h ^ (h >> 32)) * 0xD6E8FEB86659FD93ull;
    return h ^ (h >> 29);
  }
  // Whose entries keep half of their hashes, so that other points are passed over without looking at them: for a
  // million points the one cache miss less halves the time. 67: at most 12 bytes a point.
  HashIndex<uint64_t, 67> index_;
};

}  // namespace relievo
