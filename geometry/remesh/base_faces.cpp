#include "geometry/remesh/base_faces.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <optional>
#include <span>
#include <tuple>
#include <vector>

#include "geometry/remesh/triangle_pairs.h"
#include "src/base/parallel_for.h"

namespace relievo {

namespace {

double angleBetween(const glm::dvec3& a, const glm::dvec3& b) {
  return std::atan2(glm::length(glm::cross(a, b)), glm::dot(a, b));
}

class FacePairs {
 public:
  FacePairs(const Surface& surface, std::span<const uint32_t> look_of, int workers)
      : s_(surface),
        look_of_(look_of),
        workers_(workers),
        normal_(surface.triangles.size()),
        convex_(surface.twin.size(), 0),
        mate_(surface.triangles.size(), kNoIndex) {
    forEach(normal_.size(), [&](uint32_t t) {
      const glm::dvec3 p = at(t, 0);
      normal_[t] = unit(glm::cross(at(t, 1) - p, at(t, 2) - p));
    });
    findQuads();
  }

  // Pairs all triangles but for some at borders. Those of two triangles that may be one patch come first: they fold by
  // at most max_fold, have four corners, and look alike. Convex quads of these first of all: others are cut as well,
  // but no pair is exchanged for one, since packages take more bytes where a regular mesh is paired in several ways.
  // False: some triangle stays alone that has no border.
  bool pair(double max_fold) {
    chooseQuads(max_fold);
    std::fill(mate_.begin(), mate_.end(), kNoIndex);
    std::vector<std::array<uint32_t, 3>> neighbours(mate_.size());
    std::vector<uint8_t> may_stay_alone(mate_.size(), 0);
    for (const bool all : {false, true}) {
      pairFlattestFirst(!all);
      for (uint32_t h = 0; h < s_.twin.size(); ++h) {
        const bool open = s_.twin[h] == kNoIndex;
        may_stay_alone[h / 3] |= all && open;
        const bool may = !open && (all || (fold_[h] >= 0 && convex_[h]));
        neighbours[h / 3][h % 3] = may ? s_.twin[h] / 3 : kNoIndex;
      }
      pairMoreTriangles(neighbours, may_stay_alone, mate_);
    }
    for (uint32_t t = 0; t < mate_.size(); ++t)
      if (mate_[t] == kNoIndex && borderOf(t) == kNoIndex) return false;
    return true;
  }

  size_t patches() const {
    size_t count = 0;
    for (uint32_t t = 0; t < mate_.size(); ++t)
      if (const uint32_t h = sharedSide(t); h == kNoIndex || fold_[h] < 0 || h < s_.twin[h]) ++count;
    return count;
  }

  BaseMesh base(FaceNormals kind) const {
    BaseMesh base;
    base.cut = true;
    base.corners.reserve(s_.points.size());
    for (const glm::vec3& p : s_.points) base.corners.push_back({p, {}});
    base.patches.reserve(mate_.size() / 2);
    std::vector<uint32_t> middle(s_.twin.size(), kNoIndex);
    std::vector<uint32_t> normals_of;  // for each corner from the points on: the half edge whose middle it is
    for (uint32_t t = 0; t < mate_.size(); ++t) {
      const uint32_t shared = sharedSide(t), h = shared == kNoIndex ? borderOf(t) : shared, g = s_.twin[h];
      const uint32_t a = corner(h, 0), b = corner(h, 1), c = corner(h, 2);
      if (shared != kNoIndex && fold_[h] >= 0) {
        // The diagonal from (0, 0) to (1, 1) is the side that both share, along which patches are cut.
        if (h < g) base.patches.push_back({a, c, corner(g, 2), b});
        continue;
      }
      const uint32_t side = g == kNoIndex ? h : std::min(h, g);
      if (middle[side] == kNoIndex) {
        middle[side] = static_cast<uint32_t>(base.corners.size());
        base.corners.push_back({(s_.points[a] + s_.points[b]) / 2.0f, {}});
        normals_of.push_back(side);
      }
      base.patches.push_back({middle[side], a, b, c});
    }
    assignNormals(base, normals_of, kind);
    return base;
  }

 private:
  glm::dvec3 at(uint32_t t, uint32_t k) const { return s_.points[s_.triangles[t][k]]; }
  // The corner at the half edge's origin (0), at its end (1), and across (2).
  uint32_t corner(uint32_t h, uint32_t k) const { return s_.triangles[h / 3][(h % 3 + k) % 3]; }
  uint32_t borderOf(uint32_t t) const {
    for (uint32_t h = 3 * t; h < 3 * t + 3; ++h)
      if (s_.twin[h] == kNoIndex) return h;
    return kNoIndex;
  }
  // The half edge of a triangle beyond which its partner lies; of two, the one that may be a quad's diagonal.
  uint32_t sharedSide(uint32_t t) const {
    uint32_t shared = kNoIndex;
    for (uint32_t h = 3 * t; h < 3 * t + 3; ++h) {
      if (s_.twin[h] == kNoIndex || s_.twin[h] / 3 != mate_[t]) continue;
      if (shared == kNoIndex || (fold_[h] >= 0 && fold_[shared] < 0)) shared = h;
    }
    return shared;
  }

  bool looksAlike(uint32_t t, uint32_t u) const { return look_of_.empty() || look_of_[t] == look_of_[u]; }
  // Two triangles that may be a patch, at the first of their two half edges.
  struct Quad {
    double fold, off_square;  // the angle that they fold by, and by how much the farthest corner is off a right angle
    uint32_t halfedge;
  };
  void findQuads() {
    for (uint32_t h = 0; h < s_.twin.size(); ++h)
      if (const uint32_t g = s_.twin[h];
          g != kNoIndex && g > h && looksAlike(h / 3, g / 3) && corner(h, 2) != corner(g, 2))
        quads_.push_back({0, 0, h});
    forEach(quads_.size(), [&](uint32_t i) {
      Quad& quad = quads_[i];
      const uint32_t h = quad.halfedge, g = s_.twin[h];
      quad.fold = angleBetween(normal_[h / 3], normal_[g / 3]);
      quad.off_square = offSquare(h, g);
      convex_[h] = convex_[g] = isConvex(h, g);
    });
  }
  void chooseQuads(double max_fold) {
    fold_.assign(s_.twin.size(), -1.0);
    for (const Quad& quad : quads_)
      if (quad.fold <= max_fold) fold_[quad.halfedge] = fold_[s_.twin[quad.halfedge]] = quad.fold;
  }
  template <class Use>
  void forEach(size_t count, Use&& use) const {
    constexpr size_t kAJob = 4096;
    parallelFor((count + kAJob - 1) / kAJob, workers_, nullptr, [&](size_t job) {
      for (size_t i = job * kAJob; i < std::min(count, (job + 1) * kAJob); ++i) use(static_cast<uint32_t>(i));
    });
  }
  // Do the two triangles at a side form a quad with angles of at most 180 degrees, but for rounding?
  bool isConvex(uint32_t h, uint32_t g) const {
    constexpr double kMostAngle = 180.001 * kDegree;
    const glm::dvec3 a = s_.points[corner(h, 0)], b = s_.points[corner(h, 1)], c = s_.points[corner(h, 2)],
                     d = s_.points[corner(g, 2)];
    return angleBetween(c - a, b - a) + angleBetween(d - a, b - a) <= kMostAngle &&
           angleBetween(c - b, a - b) + angleBetween(d - b, a - b) <= kMostAngle;
  }
  double offSquare(uint32_t h, uint32_t g) const {
    const glm::dvec3 p[4] = {s_.points[corner(h, 0)], s_.points[corner(g, 2)], s_.points[corner(h, 1)],
                             s_.points[corner(h, 2)]};
    double worst = 0;
    for (int k = 0; k < 4; ++k)
      worst = std::max(worst, std::abs(angleBetween(p[(k + 1) % 4] - p[k], p[(k + 3) % 4] - p[k]) - 90 * kDegree));
    return worst;
  }
  // Of equally flat ones, those whose quads are the squarest.
  void pairFlattestFirst(bool convex) {
    constexpr double kFlat = 0.01 * kDegree;
    std::vector<Quad> chosen;
    chosen.reserve(quads_.size());
    for (const Quad& quad : quads_)
      if (fold_[quad.halfedge] >= 0 && (!convex || convex_[quad.halfedge]))
        chosen.push_back({std::max(quad.fold, kFlat), quad.off_square, quad.halfedge});
    std::sort(chosen.begin(), chosen.end(), [](const Quad& x, const Quad& y) {
      return std::tie(x.fold, x.off_square, x.halfedge) < std::tie(y.fold, y.off_square, y.halfedge);
    });
    for (const Quad& c : chosen) {
      const uint32_t t = c.halfedge / 3, u = s_.twin[c.halfedge] / 3;
      if (mate_[t] != kNoIndex || mate_[u] != kNoIndex) continue;
      mate_[t] = u;
      mate_[u] = t;
    }
  }

  // Weighted by the triangles' angles at the vertex; nothing where one of them hardly faces it.
  std::optional<glm::dvec3> meanNormal(uint32_t v, std::span<const uint32_t> fan) const {
    constexpr double kFacing = 0.5;
    glm::dvec3 sum{0};
    for (const uint32_t t : fan) {
      const auto& corners = s_.triangles[t];
      const auto k = static_cast<uint32_t>(std::find(corners.begin(), corners.end(), v) - corners.begin());
      sum += normal_[t] * angleBetween(at(t, (k + 1) % 3) - at(t, k), at(t, (k + 2) % 3) - at(t, k));
    }
    const glm::dvec3 mean = unit(sum);
    if (mean == glm::dvec3(0)) return std::nullopt;
    for (const uint32_t t : fan)
      if (glm::dot(normal_[t], mean) < kFacing) return std::nullopt;
    return mean;
  }
  // A direction that the triangles face as much as possible: those that face it least get more weight in each step.
  glm::dvec3 facedNormal(std::span<const uint32_t> fan) const {
    constexpr int kSteps = 24;
    glm::dvec3 sum{0}, best{0};
    for (const uint32_t t : fan) sum += normal_[t];
    double most = -2;
    for (int step = 1; step <= kSteps; ++step) {
      const glm::dvec3 direction = unit(sum);
      double least = 2;
      uint32_t least_facing = 0;
      for (const uint32_t t : fan)
        if (const double facing = glm::dot(normal_[t], direction); facing < least) least = facing, least_facing = t;
      if (direction == glm::dvec3(0)) break;
      if (least > most) most = least, best = direction;
      sum = direction + normal_[least_facing] / static_cast<double>(step + 1);
    }
    return best == glm::dvec3(0) ? glm::dvec3(0, 0, 1) : best;
  }
  // In the middle of a side, the mean of its two triangles.
  void assignNormals(BaseMesh& base, const std::vector<uint32_t>& middles, FaceNormals kind) const {
    std::vector<uint32_t> first(s_.points.size() + 1, 0), around(3 * s_.triangles.size());
    for (const Triangle& t : s_.triangles)
      for (uint32_t v : t) ++first[v + 1];
    std::partial_sum(first.begin(), first.end(), first.begin());
    std::vector<uint32_t> next(first.begin(), first.end() - 1);
    for (uint32_t t = 0; t < s_.triangles.size(); ++t)
      for (uint32_t v : s_.triangles[t]) around[next[v]++] = t;
    forEach(s_.points.size(), [&](uint32_t v) {
      const std::span<const uint32_t> fan(around.data() + first[v], around.data() + first[v + 1]);
      std::optional<glm::dvec3> normal;
      if (kind == FaceNormals::kMean) normal = meanNormal(v, fan);
      base.corners[v].normal = glm::vec3(normal ? *normal : facedNormal(fan));
    });
    for (size_t i = 0; i < middles.size(); ++i) {
      const uint32_t h = middles[i], g = s_.twin[h];
      glm::dvec3 mean = unit(normal_[h / 3] + (g == kNoIndex ? glm::dvec3(0) : normal_[g / 3]));
      if (mean == glm::dvec3(0)) mean = normal_[h / 3];
      base.corners[s_.points.size() + i].normal = glm::vec3(mean == glm::dvec3(0) ? glm::dvec3(0, 0, 1) : mean);
    }
  }

  const Surface& s_;
  std::span<const uint32_t> look_of_;
  const int workers_;
  std::vector<glm::dvec3> normal_;  // for each triangle
  std::vector<uint8_t> convex_;     // for each half edge of a quad
  std::vector<Quad> quads_;         // whatever they fold by
  std::vector<double> fold_;        // for each half edge: the angle that its two triangles fold by; below 0: no quad
  std::vector<uint32_t> mate_;      // for each triangle
};

}  // namespace

BaseMesh facesBase(const Surface& surface, uint32_t max_patches, FaceNormals normals, std::span<const uint32_t> look_of,
                   int workers) {
  if (surface.triangles.size() > 2 * size_t{max_patches}) return {};
  for (const bool any_look : {false, true}) {
    FacePairs pairs(surface, any_look ? std::span<const uint32_t>() : look_of, workers);
    for (const double degrees : {40, 60, 80})
      if (pairs.pair(degrees * kDegree) && pairs.patches() <= max_patches) return pairs.base(normals);
    if (look_of.empty()) break;
  }
  return {};
}

}  // namespace relievo
