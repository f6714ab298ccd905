#include "geometry/bake/corner_normals.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <iterator>
#include <limits>
#include <numbers>
#include <numeric>
#include <span>
#include <utility>

#include "geometry/bake/vertex_normals.h"
#include "geometry/mesh/triangle_blocks.h"
#include "src/base/parallel_for.h"

// What tells a crease from noise. Triangles of a noisy scan may meet at any angle, 40 degrees among them, so that an
// angle alone says nothing. But the angles around one of its vertices spread from none to the largest, while around a
// vertex of a crease there is a gap: a few edges are sharp and all others are several times flatter, because the sides
// of a crease are smooth. So an edge is a crease where
// - at both its ends the edges fall into at most kMostSharp sharp ones, it among them, and others of at most kRest of
//   the least sharp one's angle;
// - at both its ends few neighbours are rough, that is have sharp edges without such a gap. Where noise leaves a gap
//   at a vertex by chance, most vertices around it are rough;
// - it is connected to others, kLeastEdges or more, since chance joins few. The shortest real ones, around a peg or the
//   base of a pyramid, have more.
// Of a ball of 120,000 triangles whose normals are off by 6 to 60 degrees (root mean square) no edge is a crease.
// Creases compare no lengths, so that long triangles count as short ones do. A vertex is split where creases divide its
// triangles into several groups. The last vertex of a crease that flattens out is not, as the surface goes around it.
//
// A reduced scan of a machined part has rims without such a gap: more sharp edges than kMostSharp, or walls of a few
// skewed triangles. The plate around such a rim is known from the rest of it. A plate is kLeastPlate connected
// triangles or more, each within kFlat of the next, some of them long beside the edges at their ends, because a plane
// needs no vertices but on its rims. Lattices (heights in steps, marching cubes of few values) leave coplanar triangles
// by chance, but few, or all as long as their neighbours; scans by lines have two long and two short edges at each
// vertex. At a vertex with a sharp edge a plate keeps its normal up to the next sharp edge. What is smooth beside it
// takes that normal, too: it is the one that a fillet begins with.
namespace relievo {
namespace {

constexpr float kDegrees = std::numbers::pi_v<float> / 180;
// At least one edge at a vertex of a crease is as sharp as that: a cylinder of ten sides stays round, one of eight does
// not.
constexpr float kSharp = 40 * kDegrees;
// The least angle of the others, such as those between the walls of a letter, which meet its face at 90 degrees.
constexpr float kBlunt = 25 * kDegrees;
constexpr float kRest = 0.34f;  // a cylinder of twelve sides, 30 degrees between them, has rims of 90 degrees
constexpr size_t kMostSharp = 4, kLeastEdges = 6;
constexpr size_t kRoughShare = 4;  // at most a quarter of the neighbours
// What a plate is. With kLong 2.5 to 3 no triangle is one of planes with noise in steps of half to twice the distance
// of samples, of such planes scanned by lines, and of marching cubes of balls; with 2 many are.
constexpr float kFlat = 0.5f * kDegrees;
constexpr uint32_t kLeastPlate = 12;
constexpr float kLong = 3;          // an edge within the plate, beside the third shortest one at its end
constexpr uint32_t kLeastLong = 2;  // such ends
// At the tip of a cone no edge is sharp, but no triangle faces along the mean either.
constexpr float kTipStep = 20 * kDegrees, kTipSlope = 35 * kDegrees;

uint64_t edgeKey(uint32_t a, uint32_t b) { return static_cast<uint64_t>(std::min(a, b)) << 32 | std::max(a, b); }

// The triangles around a vertex, and the edges between two of them that meet it.
class Fan {
 public:
  struct Spoke {
    uint32_t to;             // its other vertex
    uint32_t first, second;  // of the fan's triangles
    float angle;             // between their normals
    float length;
  };

  void set(const TriMesh& mesh, uint32_t vertex, std::span<const uint32_t> triangles) {
    triangles_ = triangles;
    normals_.clear();
    ends_.clear();
    spokes_.clear();
    for (uint32_t i = 0; i < triangles.size(); ++i) {
      const auto& t = mesh.triangles[triangles[i]];
      const glm::vec3& p = mesh.positions_mm[t[0]];
      const glm::vec3 n = glm::cross(mesh.positions_mm[t[1]] - p, mesh.positions_mm[t[2]] - p);
      const float length = glm::length(n);
      normals_.push_back(length > 0 ? n / length : glm::vec3(0));
      for (uint32_t v : t)
        if (v != vertex) ends_.push_back({v, i});
    }
    std::sort(ends_.begin(), ends_.end());
    for (size_t i = 0, next = 0; i < ends_.size(); i = next) {
      for (next = i + 1; next < ends_.size() && ends_[next].first == ends_[i].first;) ++next;
      if (next - i == 2) {
        const uint32_t a = ends_[i].second, b = ends_[i + 1].second;
        spokes_.push_back({ends_[i].first, a, b, angleBetween(normals_[a], normals_[b]),
                           glm::distance(mesh.positions_mm[vertex], mesh.positions_mm[ends_[i].first])});
      }
    }
  }
  std::span<const uint32_t> triangles() const { return triangles_; }
  std::span<const Spoke> spokes() const { return spokes_; }

  // Are all spokes blunt, or is there a gap between the sharp ones and the others? sharp: the angle of the least sharp
  // one, infinite if all are blunt. The fewest that leave a gap are sharp, so that a cylinder of twelve sides has a
  // rim, but round walls.
  bool isClear(float& sharp_angle) {
    sharp_angle = std::numeric_limits<float>::infinity();
    angles_.clear();
    for (const Spoke& s : spokes_) angles_.push_back(s.angle);
    std::sort(angles_.begin(), angles_.end(), std::greater<>());
    if (angles_.empty() || angles_[0] < kSharp) return true;
    for (size_t sharp = 1; sharp <= std::min(kMostSharp, angles_.size()) && angles_[sharp - 1] >= kBlunt; ++sharp) {
      const float rest = sharp < angles_.size() ? angles_[sharp] : 0;
      if (rest > kRest * angles_[sharp - 1]) continue;
      sharp_angle = angles_[sharp - 1];
      return true;
    }
    return false;
  }

  // Is the vertex the tip of a cone? mean: its mean normal.
  bool isTip(const glm::vec3& mean) const {
    if (spokes_.size() != normals_.size()) return false;
    return std::all_of(spokes_.begin(), spokes_.end(), [](const Spoke& s) { return s.angle <= kTipStep; }) &&
           std::all_of(normals_.begin(), normals_.end(),
                       [&](const glm::vec3& n) { return angleBetween(n, mean) >= kTipSlope; });
  }

 private:
  static float angleBetween(const glm::vec3& a, const glm::vec3& b) {
    const float along = glm::dot(a, b), across = glm::length(glm::cross(a, b));
    return along != 0 || across > 0 ? angleOf(across, along) : 0;  // 0: a triangle without an area
  }

  std::span<const uint32_t> triangles_;
  std::vector<glm::vec3> normals_;
  std::vector<std::pair<uint32_t, uint32_t>> ends_;  // vertex, triangle of the fan
  std::vector<Spoke> spokes_;
  std::vector<float> angles_;
};

// Vertices in ranges, which are worked through in parallel. Few vertices of most scans are looked at, so that most of a
// range is passed over; where all are, a range takes 12 bytes for each of its triangles.
class VertexRanges {
 public:
  VertexRanges(const TriMesh& mesh, int workers, const std::atomic<bool>* interrupted)
      : mesh_(&mesh),
        blocks_(mesh.triangles, workers),
        workers_(workers),
        interrupted_(interrupted),
        count_(std::clamp<size_t>(mesh.positions_mm.size() / 4096, 1,
                                  std::max<size_t>(8, 4 * static_cast<size_t>(workerCount(workers))))) {}
  size_t count() const { return count_; }

  // visit(vertex, triangle, corner), vertices of a range by one thread. False: interrupted.
  template <class Visit>
  bool forEachCorner(Visit visit) const {
    return forEachRange([&](size_t, size_t first, size_t last) { cornersOf(first, last, visit); });
  }

  // visit(range, vertex, triangles) for the vertices v that wanted[v] is not 0 for, with all their triangles in order.
  // False: interrupted.
  template <class Visit>
  bool forEachFan(std::span<const uint8_t> wanted, Visit visit) const {
    return forEachRange([&](size_t range, size_t first, size_t last) {
      auto isWanted = [&](size_t v) { return wanted[v] != 0; };
      if (std::none_of(wanted.begin() + static_cast<std::ptrdiff_t>(first),
                       wanted.begin() + static_cast<std::ptrdiff_t>(last), [](uint8_t w) { return w != 0; }))
        return;
      std::vector<uint32_t> end(last - first + 1, 0), triangles;
      cornersOf(first, last, [&](uint32_t v, size_t, size_t) { end[v - first + 1] += isWanted(v); });
      std::partial_sum(end.begin(), end.end(), end.begin());
      triangles.resize(end.back());
      end.pop_back();  // end[v] is the begin of v's triangles, and grows to their end
      cornersOf(first, last, [&](uint32_t v, size_t t, size_t) {
        if (isWanted(v)) triangles[end[v - first]++] = static_cast<uint32_t>(t);
      });
      if (stopped()) return;
      for (size_t v = first, begin = 0; v < last; begin = end[v - first], ++v)
        if (end[v - first] > begin)
          visit(range, static_cast<uint32_t>(v), std::span(triangles).subspan(begin, end[v - first] - begin));
    });
  }

 private:
  bool stopped() const { return interrupted_ && interrupted_->load(std::memory_order_relaxed); }
  template <class Work>
  bool forEachRange(Work work) const {
    const size_t vertices = mesh_->positions_mm.size();
    return parallelFor(count_, workers_, interrupted_,
                       [&](size_t range) { work(range, vertices * range / count_, vertices * (range + 1) / count_); });
  }
  template <class Visit>
  void cornersOf(size_t first, size_t last, Visit visit) const {
    blocks_.forEach(
        first, last, [this] { return stopped(); },
        [&](size_t i) {
          for (size_t k = 0; k < 3; ++k)
            if (const uint32_t v = mesh_->triangles[i][k]; v >= first && v < last) visit(v, i, k);
        });
  }

  const TriMesh* mesh_;
  TriangleBlocks blocks_;
  int workers_;
  const std::atomic<bool>* interrupted_;
  size_t count_;
};

// Marks the vertices that a triangle leans away from by half of kSharp, since one of two triangles with that angle
// between them does. All tips are among them. False: interrupted.
bool findSuspects(const TriMesh& mesh, const VertexRanges& ranges, std::span<const glm::vec3> normals,
                  std::vector<uint8_t>& suspect) {
  static_assert(kTipSlope >= kSharp / 2);
  constexpr float kCosine = 0.9396926f;  // of kSharp / 2
  suspect.assign(normals.size(), 0);
  return ranges.forEachCorner([&](uint32_t v, size_t triangle, size_t) {
    const auto& t = mesh.triangles[triangle];
    const glm::vec3& p = mesh.positions_mm[t[0]];
    const glm::vec3 n = glm::cross(mesh.positions_mm[t[1]] - p, mesh.positions_mm[t[2]] - p);
    const float along = glm::dot(n, normals[v]);
    if (along < 0 || along * along < kCosine * kCosine * glm::dot(n, n)) suspect[v] = 1;
  });
}

// Sets of what has numbers that are far apart, such as the triangles of plates among all. numbers: in any order, also
// several times.
class JoinedSets {
 public:
  explicit JoinedSets(std::vector<uint32_t> numbers) : numbers_(std::move(numbers)) {
    std::sort(numbers_.begin(), numbers_.end());
    numbers_.erase(std::unique(numbers_.begin(), numbers_.end()), numbers_.end());
    parent_.resize(numbers_.size());
    std::iota(parent_.begin(), parent_.end(), 0u);
  }
  std::span<const uint32_t> numbers() const { return numbers_; }
  // Less than numbers().size(); the same for all of a set.
  uint32_t setOf(uint32_t number) {
    auto i = static_cast<uint32_t>(std::lower_bound(numbers_.begin(), numbers_.end(), number) - numbers_.begin());
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void join(uint32_t a, uint32_t b) {
    a = setOf(a), b = setOf(b);
    parent_[std::max(a, b)] = std::min(a, b);
  }

 private:
  std::vector<uint32_t> numbers_, parent_;
};

// Leaves those edges that are connected to enough others.
void dropShortCreases(std::vector<uint64_t>& edges) {
  std::vector<uint32_t> vertices;
  for (uint64_t e : edges) vertices.insert(vertices.end(), {static_cast<uint32_t>(e >> 32), static_cast<uint32_t>(e)});
  JoinedSets creases(std::move(vertices));
  for (uint64_t e : edges) creases.join(static_cast<uint32_t>(e >> 32), static_cast<uint32_t>(e));
  std::vector<uint32_t> count(creases.numbers().size(), 0);
  for (uint64_t e : edges) ++count[creases.setOf(static_cast<uint32_t>(e))];
  std::erase_if(edges, [&](uint64_t e) { return count[creases.setOf(static_cast<uint32_t>(e))] < kLeastEdges; });
}

// plates: the triangles of plates, ascending, as far as they meet a vertex that is looked at. False: interrupted.
bool findPlates(const TriMesh& mesh, const VertexRanges& ranges, std::span<const uint8_t> vertices,
                std::vector<uint32_t>& plates) {
  constexpr size_t kThirdShortest = 2;
  struct Found {
    Fan fan;
    std::vector<std::array<uint32_t, 2>> flat;  // two triangles in one plane
    std::vector<uint32_t> ends;                 // of long edges between two such triangles: one of these
    std::vector<float> lengths;
  };
  std::vector<Found> found(ranges.count());
  const bool done = ranges.forEachFan(vertices, [&](size_t range, uint32_t v, std::span<const uint32_t> around) {
    Found& f = found[range];
    f.fan.set(mesh, v, around);
    f.lengths.clear();
    for (const Fan::Spoke& s : f.fan.spokes()) f.lengths.push_back(s.length);
    f.lengths.resize(std::max(f.lengths.size(), kThirdShortest + 1), std::numeric_limits<float>::infinity());
    std::nth_element(f.lengths.begin(), f.lengths.begin() + kThirdShortest, f.lengths.end());
    const float long_length = kLong * f.lengths[kThirdShortest];
    for (const Fan::Spoke& s : f.fan.spokes()) {
      if (s.angle > kFlat) continue;
      if (s.length >= long_length) f.ends.push_back(around[s.first]);
      if (v < s.to || !vertices[s.to]) f.flat.push_back({around[s.first], around[s.second]});  // once for each edge
    }
  });
  if (!done) return false;
  size_t pairs = 0;
  for (const Found& f : found) pairs += f.flat.size();
  std::vector<uint32_t> triangles;
  triangles.reserve(2 * pairs);
  for (const Found& f : found)
    for (const auto& pair : f.flat) triangles.insert(triangles.end(), pair.begin(), pair.end());
  JoinedSets sets(std::move(triangles));
  for (const Found& f : found)
    for (const auto& [a, b] : f.flat) sets.join(a, b);
  std::vector<uint32_t> count(sets.numbers().size(), 0), ends(count.size(), 0);
  for (uint32_t t : sets.numbers()) ++count[sets.setOf(t)];
  for (const Found& f : found)
    for (uint32_t t : f.ends) ++ends[sets.setOf(t)];
  std::copy_if(sets.numbers().begin(), sets.numbers().end(), std::back_inserter(plates),
               [&](uint32_t t) { return count[sets.setOf(t)] >= kLeastPlate && ends[sets.setOf(t)] >= kLeastLong; });
  return true;
}

struct Creases {
  std::vector<uint64_t> edges;  // edgeKey(), ascending
  std::vector<uint32_t> tips;
};
// False: interrupted.
bool findCreases(const TriMesh& mesh, const VertexRanges& ranges, std::span<const glm::vec3> normals,
                 std::vector<uint8_t> vertices, Creases& out) {
  std::vector<Creases> found(ranges.count());  // edges: once for each end that says so
  std::vector<Fan> fans(ranges.count());
  std::vector<uint8_t> rough(vertices.size(), 0);
  const bool found_ends = ranges.forEachFan(vertices, [&](size_t range, uint32_t v, std::span<const uint32_t> around) {
    Fan& fan = fans[range];
    fan.set(mesh, v, around);
    if (fan.isTip(normals[v])) return found[range].tips.push_back(v);
    float sharp = 0;
    if (!fan.isClear(sharp)) rough[v] = 1;
    for (const Fan::Spoke& s : fan.spokes())
      if (s.angle >= sharp) found[range].edges.push_back(edgeKey(v, s.to));
  });
  if (!found_ends) return false;
  std::vector<uint64_t> ends;
  for (Creases& f : found) {
    ends.insert(ends.end(), f.edges.begin(), f.edges.end());
    out.tips.insert(out.tips.end(), f.tips.begin(), f.tips.end());
    f = {};
  }
  std::sort(ends.begin(), ends.end());
  for (size_t i = 1; i < ends.size(); ++i)
    if (ends[i] == ends[i - 1]) out.edges.push_back(ends[i]);
  std::fill(vertices.begin(), vertices.end(), uint8_t{0});
  for (uint64_t e : out.edges) vertices[e >> 32] = vertices[static_cast<uint32_t>(e)] = 1;
  const bool looked_around =
      ranges.forEachFan(vertices, [&](size_t range, uint32_t v, std::span<const uint32_t> around) {
        Fan& fan = fans[range];
        fan.set(mesh, v, around);
        size_t count = 0;
        for (const Fan::Spoke& s : fan.spokes()) count += rough[s.to];
        if (kRoughShare * count > fan.spokes().size()) vertices[v] = 0;
      });
  if (!looked_around) return false;
  std::erase_if(out.edges, [&](uint64_t e) { return !vertices[e >> 32] || !vertices[static_cast<uint32_t>(e)]; });
  dropShortCreases(out.edges);
  return true;
}

// The corners with a normal of their own, 3 t + k ascending, and which of the extra normals that is.
struct SplitCorners {
  std::vector<std::array<uint32_t, 2>> corners;
  std::vector<glm::vec3> normals;
};
// suspect: as findSuspects() has it. False: interrupted.
bool splitVertices(const TriMesh& mesh, const VertexRanges& ranges, const Creases& creases,
                   std::span<const uint32_t> plates, std::span<const uint8_t> suspect, SplitCorners& out) {
  constexpr uint8_t kOnSides = 1, kTip = 2;
  constexpr uint32_t kNoNormal = ~uint32_t{0};
  std::vector<uint8_t> wanted(mesh.positions_mm.size(), 0);
  for (uint32_t t : plates)
    for (uint32_t v : mesh.triangles[t])
      if (suspect[v]) wanted[v] = kOnSides;
  for (uint64_t e : creases.edges) wanted[e >> 32] = wanted[static_cast<uint32_t>(e)] = kOnSides;
  for (uint32_t v : creases.tips) wanted[v] = kTip;
  struct Work {
    SplitCorners found;
    Fan fan;
    std::vector<uint32_t> group;  // for each triangle of the fan, another one of its group; its first one: itself
    std::vector<uint8_t> plate;   // is the triangle one of a plate's?
    std::vector<uint8_t> plated;  // has the group such triangles? At its first one
    std::vector<glm::vec3> sums;  // of the groups, at their first triangles
    std::vector<uint32_t> name;   // and which of found.normals that is
  };
  std::vector<Work> works(ranges.count());
  const bool done = ranges.forEachFan(wanted, [&](size_t range, uint32_t v, std::span<const uint32_t> triangles) {
    Work& w = works[range];
    w.fan.set(mesh, v, triangles);
    w.group.resize(triangles.size());
    std::iota(w.group.begin(), w.group.end(), 0u);
    auto rootOf = [&](uint32_t i) {
      while (w.group[i] != i) i = w.group[i] = w.group[w.group[i]];
      return i;
    };
    auto join = [&](const Fan::Spoke& s) {
      const uint32_t a = rootOf(s.first), b = rootOf(s.second);
      w.group[std::max(a, b)] = std::min(a, b);
    };
    auto isCrease = [&](const Fan::Spoke& s) {
      return std::binary_search(creases.edges.begin(), creases.edges.end(), edgeKey(v, s.to));
    };
    w.plate.assign(triangles.size(), 0);
    w.plated.assign(triangles.size(), 0);
    if (wanted[v] == kOnSides) {
      for (const Fan::Spoke& s : w.fan.spokes())
        if (s.angle < kSharp && !isCrease(s)) join(s);
      for (uint32_t i = 0; i < triangles.size(); ++i)
        if (std::binary_search(plates.begin(), plates.end(), triangles[i])) w.plate[i] = w.plated[rootOf(i)] = 1;
      // What is no plate is divided by creases alone.
      for (const Fan::Spoke& s : w.fan.spokes())
        if (!w.plated[rootOf(s.first)] && !w.plated[rootOf(s.second)] && !isCrease(s)) join(s);
      bool divided = false;
      for (const Fan::Spoke& s : w.fan.spokes()) divided |= rootOf(s.first) != rootOf(s.second);
      if (!divided) return;
    }
    w.sums.assign(triangles.size(), glm::vec3(0));
    auto cornerOf = [&](uint32_t triangle) {
      const auto& t = mesh.triangles[triangle];
      return t[0] == v ? 0u : t[1] == v ? 1u : 2u;
    };
    for (uint32_t i = 0; i < triangles.size(); ++i) {
      if (w.plated[rootOf(i)] && !w.plate[i]) continue;
      const auto shares = cornerShares(mesh, mesh.triangles[triangles[i]]);
      w.sums[rootOf(i)] += shares[cornerOf(triangles[i])];
    }
    w.name.assign(triangles.size(), kNoNormal);
    for (uint32_t i = 0; i < triangles.size(); ++i) {
      const uint32_t root = rootOf(i);  // the first triangle of its group
      if (const float length = glm::length(w.sums[i]); length > 0) {
        w.name[i] = static_cast<uint32_t>(w.found.normals.size());
        w.found.normals.push_back(w.sums[i] / length);
      }
      if (w.name[root] != kNoNormal)
        w.found.corners.push_back({3 * triangles[i] + cornerOf(triangles[i]), w.name[root]});
    }
  });
  if (!done) return false;
  for (Work& w : works) {
    const auto before = static_cast<uint32_t>(out.normals.size());
    for (const auto& [corner, normal] : w.found.corners) out.corners.push_back({corner, before + normal});
    out.normals.insert(out.normals.end(), w.found.normals.begin(), w.found.normals.end());
    w = {};
  }
  std::sort(out.corners.begin(), out.corners.end());
  return true;
}

}  // namespace

bool makeCornerNormals(const TriMesh& mesh, int workers, const std::atomic<bool>* interrupted, CornerNormals& out) {
  out = {};
  if (!makeVertexNormals(mesh, workers, interrupted, out.normals)) return false;
  const VertexRanges ranges(mesh, workers, interrupted);
  SplitCorners found;
  {
    std::vector<uint8_t> suspect;
    if (!findSuspects(mesh, ranges, out.normals, suspect)) return false;
    if (std::find(suspect.begin(), suspect.end(), 1) == suspect.end()) return true;
    Creases creases;
    if (!findCreases(mesh, ranges, out.normals, suspect, creases)) return false;
    std::vector<uint32_t> plates;
    if (!findPlates(mesh, ranges, suspect, plates)) return false;
    if (creases.edges.empty() && creases.tips.empty() && plates.empty()) return true;
    if (!splitVertices(mesh, ranges, creases, plates, suspect, found)) return false;
  }
  if (found.corners.empty()) return true;
  const auto vertices = static_cast<uint32_t>(out.normals.size());
  out.normals.insert(out.normals.end(), found.normals.begin(), found.normals.end());
  out.runs.resize((mesh.triangles.size() + 63) / 64);
  for (size_t i = 0; i < found.corners.size(); ++i) {
    const uint32_t corner = found.corners[i][0], triangle = corner / 3;
    if (i == 0 || found.corners[i - 1][0] / 3 != triangle) {
      out.split.push_back(mesh.triangles[triangle]);
      out.runs[triangle / 64].split |= uint64_t{1} << triangle % 64;
    }
    out.split.back()[corner % 3] = vertices + found.corners[i][1];
  }
  uint32_t before = 0;
  for (CornerNormals::Run& run : out.runs) {
    run.before = before;
    before += static_cast<uint32_t>(std::popcount(run.split));
  }
  return true;
}

}  // namespace relievo
