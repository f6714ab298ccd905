// point_table.h - points at the same place have one name: an open hash table of indices into a vector of points. 0 and -0 are the same place.
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
  static constexpr uint32_t kNone = ~uint32_t{0};
  explicit PointTable(size_t points = 0) { rehash({}, points); }

  // The index of the point in points, of which all that are in the table are a part; it is appended if it is new.
  uint32_t find(std::vector<Point>& points, Point p) {
    p += Point(0);  // -0 + 0 is 0
    if (points.size() + points.size() / 2 >= table_.size()) rehash(points, 2 * points.size() + 64);
    uint32_t& entry = at(points, p);
    if (entry == kNone) {
      entry = static_cast<uint32_t>(points.size());
      points.push_back(p);
    }
    return entry;
  }
  // The entry of a point of points: kNone if the place is new. Room for all of them was asked for, none is -0.
  uint32_t& at(const std::vector<Point>& points, const Point& p) {
    size_t s = slot(p);
    while (table_[s] != kNone && points[table_[s]] != p) s = (s + 1) & (table_.size() - 1);
    return table_[s];
  }

 private:
  void rehash(const std::vector<Point>& points, size_t room) {
    table_.assign(std::bit_ceil(room + room / 2 + 2), kNone);
    shift_ = 64 - std::countr_zero(table_.size());
    for (size_t i = 0; i < points.size(); ++i) at(points, points[i]) = static_cast<uint32_t>(i);
  }
  size_t slot(const Point& p) const {
    uint64_t words[(sizeof(Point) + 7) / 8] = {}, h = 0;
    std::memcpy(words, &p, sizeof(Point));
    for (uint64_t w : words) h = ((h ^ w) ^ (w >> 29)) * 0x9E3779B97F4A7C15ull;
    h = (h ^ (h >> 32)) * 0xD6E8FEB86659FD93ull;
    return static_cast<size_t>((h ^ (h >> 29)) * 0x9E3779B97F4A7C15ull >> shift_);
  }
  std::vector<uint32_t> table_;
  int shift_ = 0;
};

}  // namespace relievo
