#include "tools/export/surface_lines.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <unordered_map>

#include "tools/export/shared_vertices.h"
#include "tools/export/surface_rows.h"

namespace relievo {
namespace {

constexpr uint64_t kBytesAPoint = 160, kMostPoints = 4000000000;

// Which multiples of a step lie between two values, or 0 alone.
struct Levels {
  double step = 0;  // 0: the level 0 alone
  double at(int64_t k) const { return step > 0 ? static_cast<double>(k) * step : 0; }
  // Of the levels above low and not above high: a value on a level is above it.
  int64_t first(double low) const { return step > 0 ? static_cast<int64_t>(std::floor(low / step)) : 0; }
  int64_t last(double high) const { return step > 0 ? static_cast<int64_t>(std::ceil(high / step)) : 0; }
};

struct Corner {
  uint64_t vertex = 0;  // its name: the same from all triangles around it
  glm::dvec3 at{0};
  double value = 0;
};

// Joins the pieces of lines that triangles have.
class LineJoiner {
 public:
  explicit LineJoiner(Levels levels) : levels_(levels) {}

  void add(const std::array<Corner, 3>& t) {
    const double low = std::min({t[0].value, t[1].value, t[2].value}),
                 high = std::max({t[0].value, t[1].value, t[2].value});
    for (int64_t k = levels_.first(low), last = levels_.last(high); k <= last; ++k) {
      const double level = levels_.at(k);
      std::array<uint32_t, 2> ends{};
      size_t found = 0;
      for (size_t i = 0; i < 3; ++i) {
        const Corner &a = t[i], &b = t[(i + 1) % 3];
        if ((a.value >= level) != (b.value >= level)) ends[found++] = pointOn(a, b, k, level);
      }
      if (found == 2) link(ends[0], ends[1]);
    }
  }
  uint64_t points() const { return points_.size(); }

  std::vector<SurfaceLine> lines() {
    std::vector<SurfaceLine> out;
    std::unordered_map<Key, uint32_t, Hash>().swap(index_);
    for (const bool open : {true, false})
      for (uint32_t i = 0; i < points_.size(); ++i)
        if (!points_[i].taken && (!open || points_[i].links[1] == kNone)) out.push_back(walk(i));
    std::erase_if(out, [](const SurfaceLine& line) { return line.points.size() < 2; });
    return out;
  }

 private:
  static constexpr uint32_t kNone = std::numeric_limits<uint32_t>::max();
  struct Point {
    glm::dvec3 at{0};
    int64_t level = 0;
    std::array<uint32_t, 2> links{kNone, kNone};
    bool taken = false;
  };
  struct Key {
    uint64_t a, b;
    int64_t level;
    bool operator==(const Key&) const = default;
  };
  struct Hash {
    size_t operator()(const Key& k) const {
      uint64_t h = k.a * 0x9E3779B97F4A7C15u ^ (k.b + 0x7F4A7C15u) * 0xC2B2AE3D27D4EB4Fu ^
                   static_cast<uint64_t>(k.level) * 0x165667B19E3779F9u;
      h ^= h >> 32;
      return static_cast<size_t>(h * 0x9E3779B97F4A7C15u);
    }
  };

  uint32_t pointOn(const Corner& one, const Corner& other, int64_t k, double level) {
    const bool in_order = one.vertex < other.vertex;
    const Corner &a = in_order ? one : other, &b = in_order ? other : one;
    const auto [at, fresh] = index_.try_emplace({a.vertex, b.vertex, k}, static_cast<uint32_t>(points_.size()));
    if (fresh) {
      const double share = (level - a.value) / (b.value - a.value);
      points_.push_back({a.at + share * (b.at - a.at), k});
    }
    return at->second;
  }
  // An edge of more than two triangles has more lines than one through its point: the others get one of their own.
  uint32_t withRoom(uint32_t point) {
    if (points_[point].links[1] == kNone) return point;
    points_.push_back({points_[point].at, points_[point].level});
    return static_cast<uint32_t>(points_.size() - 1);
  }
  void link(uint32_t a, uint32_t b) {
    a = withRoom(a);
    b = withRoom(b);
    const auto add = [&](uint32_t from, uint32_t to) {
      auto& links = points_[from].links;
      links[links[0] == kNone ? 0 : 1] = to;
    };
    add(a, b);
    add(b, a);
  }
  SurfaceLine walk(uint32_t first) {
    SurfaceLine line;
    line.level = levels_.at(points_[first].level);
    uint32_t before = kNone, at = first;
    while (at != kNone && !points_[at].taken) {
      Point& p = points_[at];
      p.taken = true;
      if (line.points.empty() || line.points.back() != p.at) line.points.push_back(p.at);
      const uint32_t next = p.links[0] == before ? p.links[1] : p.links[0];
      before = at;
      at = next;
    }
    line.closed = at == first;
    while (line.closed && line.points.size() > 1 && line.points.front() == line.points.back()) line.points.pop_back();
    return line;
  }

  const Levels levels_;
  std::vector<Point> points_;
  std::unordered_map<Key, uint32_t, Hash> index_;
};

Error refused(const Package& package, const char* what, const char* hint = "") {
  return {ErrorKind::kUsage, package.path(), what, hint, {}};
}

using Field = std::function<double(const glm::dvec3&)>;

Result<SurfaceLines> trace(const std::shared_ptr<const Package>& package, const Field& field, Levels levels,
                           const SurfaceLineOptions& o) {
  const Manifest& m = package->manifest();
  if (m.domain.relief_depth < 0) return refused(*package, "has no relief");
  const int finest = ExportGrid::finestLevel(m), level = o.level.value_or(finest);
  if (level < 0 || level > finest)
    return Error{ErrorKind::kUsage,
                 package->path(),
                 "expected a --level of 0 to " + std::to_string(finest) + ", found " + std::to_string(level),
                 "level " + std::to_string(finest) + " is its full detail",
                 {}};
  const ExportGrid grid(package, level);
  const auto refuseMemory = [&](uint64_t bytes) {
    return Error{ErrorKind::kUsage,
                 package->path(),
                 "its lines at level " + std::to_string(level) + " take more than " + std::to_string((bytes >> 20)) +
                     " MiB of memory, --memory-mib allows " + std::to_string(o.memory_bytes >> 20),
                 "allow more, or choose a coarser --level or fewer lines",
                 {}};
  };
  uint64_t held = grid.isFlat() ? 0
                                : SharedVertices::count(*m.base, uniformLevels(grid.sheets(), grid.level())) *
                                      sizeof(SharedVertices::Vertex);
  const RowParts parts = SheetReader::within(grid, {.colours = false}, o.memory_bytes / 2);
  held += SheetReader::bytes(grid, parts) + grid.columns() * 2 * sizeof(Corner);
  if (held > o.memory_bytes) return refuseMemory(held);
  std::optional<SharedVertices> shared;
  if (!grid.isFlat()) shared.emplace(*m.base, uniformLevels(grid.sheets(), grid.level()));
  const uint64_t sheet_vertices = grid.columns() * grid.rows(), names = sheet_vertices * grid.sheets();
  const auto vertexName = [&](uint32_t sheet, uint64_t x, uint64_t y) {
    const bool border = x == 0 || y == 0 || x + 1 == grid.columns() || y + 1 == grid.rows();
    return shared && border ? names + shared->index(sheet, x, y) : sheet * sheet_vertices + y * grid.columns() + x;
  };
  LineJoiner joiner(levels);
  SheetReader reader(grid, parts);
  SheetRow row;
  std::vector<Corner> above(grid.columns()), below(grid.columns());
  const glm::dvec3 origin = grid.originMm();
  for (uint32_t sheet = 0; sheet < grid.sheets(); ++sheet) {
    reader.begin(sheet);
    for (uint64_t y = 0; y < grid.rows(); ++y) {
      if (o.interrupted && *o.interrupted)
        return Error{ErrorKind::kInterrupted, package->path(), "interrupted", "", {}};
      if (auto read = reader.read(y, row); !read) return read.error();
      std::swap(above, below);
      for (uint64_t x = 0; x < grid.columns(); ++x) {
        const glm::dvec3 at = origin + row.positions[x];
        below[x] = {vertexName(sheet, x, y), at, field(at)};
      }
      for (uint64_t x = 0; y > 0 && x + 1 < grid.columns(); ++x) {
        joiner.add({above[x], below[x + 1], above[x + 1]});
        joiner.add({above[x], below[x], below[x + 1]});
      }
      if (const uint64_t bytes = held + joiner.points() * kBytesAPoint;
          bytes > o.memory_bytes || joiner.points() > kMostPoints)
        return refuseMemory(bytes);
      if (o.progress)
        o.progress((sheet + static_cast<double>(y + 1) / static_cast<double>(grid.rows())) / grid.sheets());
    }
  }
  return SurfaceLines{level, joiner.lines()};
}

}  // namespace

Result<SurfaceLines> contoursOf(std::shared_ptr<const Package> package, double step_mm, const SurfaceLineOptions& o) {
  if (!package->manifest().domain.isFlat())
    return refused(*package, "is no flat artwork, whose heights have contours", "--plane cuts a scan");
  const PatchDomain& d = package->manifest().domain;
  constexpr double kMostLevels = 100000;
  if (!(step_mm > 0) || 65535 * d.relief_scale_mm / step_mm > kMostLevels)
    return refused(*package, "expected contours of at most 100000 heights", "choose a larger step");
  return trace(
      package, [](const glm::dvec3& p) { return p.z; }, {step_mm}, o);
}

Result<SurfaceLines> planeCutOf(std::shared_ptr<const Package> package, const glm::dvec3& normal, double offset,
                                const SurfaceLineOptions& o) {
  const double length = glm::length(normal);
  if (!(length > 0)) return refused(*package, "expected a plane's normal of more than 0");
  const glm::dvec3 n = normal / length;
  const double along = offset / length;
  return trace(
      package, [=](const glm::dvec3& p) { return glm::dot(n, p) - along; }, {}, o);
}

Result<SurfaceLines> sectionOf(std::shared_ptr<const Package> package, const glm::dvec2& from, const glm::dvec2& to,
                               const SurfaceLineOptions& o) {
  if (!package->manifest().domain.isFlat())
    return refused(*package, "is no flat artwork, which a line over it cuts", "--plane cuts a scan");
  const double length = glm::length(to - from);
  if (!(length > 0)) return refused(*package, "expected a section between two places, found one");
  const glm::dvec2 along = (to - from) / length;
  // A line along a border has all vertices on one side, and they count as above it: then the other side is tried.
  Result<SurfaceLines> cut = SurfaceLines{};
  for (const double sign : {1.0, -1.0}) {
    cut = planeCutOf(package, {-sign * along.y, sign * along.x, 0}, sign * (along.x * from.y - along.y * from.x), o);
    if (!cut || !cut->lines.empty()) break;
  }
  if (!cut) return cut;
  SurfaceLines out{cut->level, {}};
  SurfaceLine all, profile;
  for (const SurfaceLine& line : cut->lines)
    all.points.insert(all.points.end(), line.points.begin(), line.points.end());
  const auto distance = [&](const glm::dvec3& p) { return glm::dot(along, glm::dvec2(p) - from); };
  std::stable_sort(all.points.begin(), all.points.end(),
                   [&](const glm::dvec3& a, const glm::dvec3& b) { return distance(a) < distance(b); });
  // What lies before the first place and behind the second is cut off, between points where need be.
  for (size_t i = 0; i < all.points.size(); ++i) {
    const glm::dvec3& p = all.points[i];
    const double s = distance(p);
    if (i > 0) {
      const glm::dvec3& q = all.points[i - 1];
      const double before = distance(q);
      for (const double end : {0.0, length})
        if (before < end && s > end) profile.points.push_back(q + (end - before) / (s - before) * (p - q));
    }
    if (s >= 0 && s <= length) profile.points.push_back(p);
  }
  if (profile.points.size() > 1) out.lines.push_back(std::move(profile));
  return out;
}

}  // namespace relievo
