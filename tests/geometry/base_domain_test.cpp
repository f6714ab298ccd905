// Base meshes of shapes whose topology, borders and surface are known: kept, followed, and reached by lines along the
// normals.
#include "geometry/remesh/base_domain.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <random>

#include "geometry/remesh/base_reduce.h"
#include "geometry/remesh/base_sheet.h"
#include "geometry/remesh/chunk_reduce.h"
#include "geometry/remesh/feature_curves.h"
#include "geometry/scan/mesh_read.h"
#include "tests/geometry/base_shapes.h"
#include "tests/geometry/scan_shapes.h"
#include "tests/shared_data.h"
#include "tests/view_share.h"

namespace relievo {
namespace base_domain_test {

using test::kSanitized;
using test::longTests;
constexpr double kDegrees = std::numbers::pi / 180;

BaseMesh baseOf(const TriMesh& mesh, uint32_t patches = 0) {
  auto base = makeBaseMesh(mesh, {.patches = patches});
  EXPECT_TRUE(base.ok()) << (base.ok() ? "" : base.error().text());
  return base.ok() ? *base : BaseMesh{};
}

double diagonalOf(const TriMesh& m) {
  glm::dvec3 lo(1e300), hi(-1e300);
  for (const glm::vec3& p : m.positions_mm) lo = glm::min(lo, glm::dvec3(p)), hi = glm::max(hi, glm::dvec3(p));
  return glm::length(hi - lo);
}

struct Topology {
  int64_t euler = 0;
  size_t pieces = 0, borders = 0, border_sides = 0;
  size_t shared_too_often = 0;  // sides of three patches or more
  size_t turned = 0;            // sides that two patches run along the same way: wound differently
  friend bool operator==(const Topology&, const Topology&) = default;
};

uint32_t rootOf(std::vector<uint32_t>& parent, uint32_t v) {
  while (parent[v] != v) v = parent[v];
  return v;
}

// Of polygons, wound alike.
template <class Face>
Topology topologyOf(size_t vertices, const std::vector<Face>& faces) {
  Topology t;
  std::map<std::array<uint32_t, 2>, std::pair<int, int>> sides;  // uses forwards and backwards
  std::vector<uint32_t> parent(vertices), loop(vertices);
  std::vector<uint8_t> used(vertices, 0), on_border(vertices, 0);
  for (uint32_t v = 0; v < vertices; ++v) parent[v] = loop[v] = v;
  for (const Face& f : faces) {
    for (size_t k = 0; k < f.size(); ++k) {
      const uint32_t a = f[k], b = f[(k + 1) % f.size()];
      auto& uses = sides[{std::min(a, b), std::max(a, b)}];
      ++(a < b ? uses.first : uses.second);
      used[a] = 1;
      parent[rootOf(parent, a)] = rootOf(parent, b);
    }
  }
  for (const auto& [ends, uses] : sides) {
    t.shared_too_often += uses.first + uses.second > 2;
    t.turned += uses.first > 1 || uses.second > 1;
    if (uses.first + uses.second != 1) continue;
    ++t.border_sides;
    on_border[ends[0]] = on_border[ends[1]] = 1;
    loop[rootOf(loop, ends[0])] = rootOf(loop, ends[1]);
  }
  int64_t corners = 0;
  for (uint32_t v = 0; v < vertices; ++v) {
    corners += used[v];
    t.pieces += used[v] && parent[v] == v;
    t.borders += on_border[v] && loop[v] == v;
  }
  t.euler = corners - static_cast<int64_t>(sides.size()) + static_cast<int64_t>(faces.size());
  return t;
}

// The patch's corners against the clock seen from outside: down, right, up.
std::array<uint32_t, 4> around(const std::array<uint32_t, 4>& p) { return {p[0], p[2], p[3], p[1]}; }

Topology topologyOf(const BaseMesh& base) {
  std::vector<std::array<uint32_t, 4>> faces;
  for (const auto& p : base.patches) faces.push_back(around(p));
  return topologyOf(base.corners.size(), faces);
}

struct Shape {
  double ratio95 = 0, angle95 = 0;  // longest side to shortest; farthest angle from 90 degrees: of 95 in 100 patches
  double inward = 0;                // corners that face away from their normal, of all patches' corners
};

Shape shapeOf(const BaseMesh& base) {
  std::vector<double> ratio, angle;
  Shape s;
  for (const auto& patch : base.patches) {
    const auto c = around(patch);
    double shortest = 1e300, longest = 0, worst = 0;
    for (int k = 0; k < 4; ++k) {
      const glm::dvec3 p = base.corners[c[k]].position_mm;
      const glm::dvec3 a = glm::dvec3(base.corners[c[(k + 1) % 4]].position_mm) - p,
                       b = glm::dvec3(base.corners[c[(k + 3) % 4]].position_mm) - p;
      shortest = std::min(shortest, glm::length(a));
      longest = std::max(longest, glm::length(a));
      worst = std::max(
          worst,
          std::abs(std::acos(std::clamp(glm::dot(glm::normalize(a), glm::normalize(b)), -1.0, 1.0)) / kDegrees - 90));
      s.inward += glm::dot(glm::cross(a, b), glm::dvec3(base.corners[c[k]].normal)) <= 0;
    }
    ratio.push_back(longest / shortest);
    angle.push_back(worst);
  }
  std::sort(ratio.begin(), ratio.end());
  std::sort(angle.begin(), angle.end());
  s.ratio95 = ratio[(ratio.size() - 1) * 95 / 100];
  s.angle95 = angle[(angle.size() - 1) * 95 / 100];
  s.inward /= 4.0 * static_cast<double>(base.patches.size());
  return s;
}

// Every triangle that faces along n against the line (Moeller and Trumbore 1997): no tree, no single precision.
struct Crossing {
  double along;
  glm::dvec3 normal;
};
std::vector<Crossing> crossings(const TriMesh& m, const glm::dvec3& p, const glm::dvec3& n, double reach) {
  std::vector<Crossing> found;
  for (const auto& t : m.triangles) {
    const glm::dvec3 a = m.positions_mm[t[0]], ab = glm::dvec3(m.positions_mm[t[1]]) - a,
                     ac = glm::dvec3(m.positions_mm[t[2]]) - a;
    const glm::dvec3 h = glm::cross(n, ac);
    const double det = glm::dot(ab, h);
    if (std::abs(det) < 1e-14) continue;
    const glm::dvec3 s = p - a, q = glm::cross(s, ab);
    const double u = glm::dot(s, h) / det, v = glm::dot(n, q) / det, along = glm::dot(ac, q) / det;
    // The far side of a thin wall faces the other way: no one asks for it.
    if (u < 0 || v < 0 || u + v > 1 || std::abs(along) > reach || glm::dot(glm::cross(ab, ac), n) < 0) continue;
    found.push_back({along, glm::normalize(glm::cross(ab, ac))});
  }
  std::sort(found.begin(), found.end(),
            [](const Crossing& x, const Crossing& y) { return std::abs(x.along) < std::abs(y.along); });
  return found;
}

// The part of lines from inside the patches that meet the surface once within half a patch, at less than 75 degrees,
// from behind.
double singleValued(const TriMesh& m, const BaseMesh& base, int samples = 3) {
  size_t good = 0, all = 0;
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    double longest = 0;
    for (int k = 0; k < 4; ++k) {
      const auto c = around(base.patches[p]);
      longest = std::max<double>(
          longest, glm::length(base.corners[c[(k + 1) % 4]].position_mm - base.corners[c[k]].position_mm));
    }
    for (int j = 0; j < samples; ++j) {
      for (int i = 0; i < samples; ++i) {
        // Off the middle: a line along a scan's edge would be counted twice.
        const double u = (i + 0.5017) / samples, v = (j + 0.4973) / samples;
        const glm::dvec3 n = glm::normalize(base.normal(p, u, v));
        const auto hits = crossings(m, base.point(p, u, v) + base.origin_mm - m.origin_mm, n, 0.5 * longest);
        ++all;
        good += hits.size() == 1 && glm::dot(hits[0].normal, n) > std::cos(75 * kDegrees);
      }
    }
  }
  return static_cast<double>(good) / static_cast<double>(all);
}

double distanceToSegment(const glm::dvec3& p, const glm::dvec3& a, const glm::dvec3& b) {
  const glm::dvec3 ab = b - a;
  const double t = std::clamp(glm::dot(p - a, ab) / std::max(glm::dot(ab, ab), 1e-300), 0.0, 1.0);
  return glm::length(p - a - t * ab);
}

struct BorderFit {
  double corners = 0, sides = 0;  // how far border corners, and points on border sides, lie from the scan's border
  double missed = 0;              // and the scan's border from the sides
};
BorderFit borderFit(const TriMesh& m, const BaseMesh& base) {
  std::map<std::array<uint32_t, 2>, int> uses;
  for (const auto& t : m.triangles) {
    for (int k = 0; k < 3; ++k) ++uses[{std::min(t[k], t[(k + 1) % 3]), std::max(t[k], t[(k + 1) % 3])}];
  }
  using Segment = std::array<glm::dvec3, 2>;
  std::vector<Segment> scan, sides;
  for (const auto& [e, n] : uses) {
    if (n == 1) scan.push_back({m.positions_mm[e[0]], m.positions_mm[e[1]]});
  }
  const auto neighbours = patchNeighbours(base);
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    for (int s = 0; s < 4; ++s) {
      if (neighbours[p][s].patch != PatchNeighbour::kNone) continue;
      sides.push_back({base.corners[base.patches[p][kSideCorners[s][0]]].position_mm,
                       base.corners[base.patches[p][kSideCorners[s][1]]].position_mm});
    }
  }
  auto distance = [](const glm::dvec3& p, const std::vector<Segment>& segments) {
    double least = 1e300;
    for (const Segment& s : segments) least = std::min(least, distanceToSegment(p, s[0], s[1]));
    return least;
  };
  BorderFit fit;
  for (const Segment& s : sides) {
    fit.corners = std::max(fit.corners, distance(s[0], scan));
    for (int k = 1; k < 8; ++k)
      fit.sides = std::max(fit.sides, distance(s[0] * (1 - k / 8.0) + s[1] * (k / 8.0), scan));
  }
  for (const Segment& s : scan) fit.missed = std::max(fit.missed, distance(s[0], sides));
  return fit;
}

// Likewise, but only as far as no height brings it back: across the normals that are interpolated along a border's
// sides.
struct BorderDeviation {
  double scan = 0, base = 0;  // of the scan's border from the base's, and of the base's from the scan's
};
BorderDeviation borderDeviation(const TriMesh& m, const BaseMesh& base) {
  auto surface = makeSurface(m.positions_mm, m.triangles);
  EXPECT_TRUE(surface.ok());
  struct End {
    glm::dvec3 p, n;
  };
  std::vector<std::array<End, 2>> sides;
  const auto neighbours = patchNeighbours(base);
  auto end = [&](uint32_t c) { return End{base.corners[c].position_mm, base.corners[c].normal}; };
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    for (int s = 0; s < 4; ++s) {
      if (neighbours[p][s].patch == PatchNeighbour::kNone)
        sides.push_back({end(base.patches[p][kSideCorners[s][0]]), end(base.patches[p][kSideCorners[s][1]])});
    }
  }
  // From the line at t along a side's normals; farther than a fifth of the diagonal is another part of the scan.
  const double reach = 0.2 * diagonalOf(m);
  auto flat = [](const glm::dvec3& d, const glm::dvec3& n) { return d - n * glm::dot(d, n); };
  auto fromLine = [&](const glm::dvec3& p, const std::array<End, 2>& s, double t) {
    const glm::dvec3 d = p - (s[0].p * (1 - t) + s[1].p * t), n = glm::normalize(s[0].n * (1 - t) + s[1].n * t);
    return std::abs(glm::dot(d, n)) > reach ? 1e300 : glm::length(flat(d, n));
  };
  BorderDeviation deviation;
  for (const auto& loop : surface->loops) {
    for (uint32_t v : loop) {
      const glm::dvec3 p = m.positions_mm[v];
      double least = 1e300;
      for (const auto& s : sides) {
        double best = 0;
        for (int k = 1; k <= 16; ++k) best = fromLine(p, s, k / 16.0) < fromLine(p, s, best) ? k / 16.0 : best;
        double lo = std::max(best - 1 / 16.0, 0.0), hi = std::min(best + 1 / 16.0, 1.0);
        for (int k = 0; k < 24; ++k) {
          const double x = lo + 0.382 * (hi - lo), y = lo + 0.618 * (hi - lo);
          (fromLine(p, s, x) < fromLine(p, s, y) ? hi : lo) = fromLine(p, s, x) < fromLine(p, s, y) ? y : x;
        }
        least = std::min({least, fromLine(p, s, best), fromLine(p, s, (lo + hi) / 2)});
      }
      deviation.scan = std::max(deviation.scan, least);
    }
  }
  for (const auto& s : sides) {
    for (int k = 0; k <= 16; ++k) {
      const double t = k / 16.0;
      const glm::dvec3 p = s[0].p * (1 - t) + s[1].p * t, n = glm::normalize(s[0].n * (1 - t) + s[1].n * t);
      double least = 1e300;
      for (const auto& loop : surface->loops) {
        for (size_t i = 0; i < loop.size(); ++i) {
          const glm::dvec3 a = glm::dvec3(m.positions_mm[loop[i]]) - p,
                           b = glm::dvec3(m.positions_mm[loop[(i + 1) % loop.size()]]) - p;
          if (std::abs(glm::dot(a, n)) <= reach)
            least = std::min(least, distanceToSegment(glm::dvec3(0), flat(a, n), flat(b, n)));
        }
      }
      deviation.base = std::max(deviation.base, least);
    }
  }
  return deviation;
}

struct Case {
  const char* name;
  TriMesh (*make)();
  Topology expected;  // border_sides is not compared
  double ratio95, angle95, single_valued;
};
void PrintTo(const Case& c, std::ostream* out) { *out << c.name; }

const Case kCases[] = {
    {"sphere", [] { return ballMesh(24); }, {2, 1, 0}, 2, 50, 1},
    {"torus", [] { return torusMesh(72, 30); }, {0, 1, 0}, 3, 60, 1},
    {"wavySheetWithHole", [] { return wavySheet(60); }, {0, 1, 2}, 4, 70, 0.96},
    {"cube", [] { return boxMesh(14, 50, 50, 50); }, {2, 1, 0}, 3, 60, 0.99},
    {"coinFace", [] { return discMesh(40); }, {1, 1, 1}, 3, 75, 0.98},
    {"thinSlab", [] { return boxMesh(20, 100, 80, 5); }, {2, 1, 0}, 20, 80, 0.97},
    {"panel", [] { return panelMesh(50); }, {1, 1, 1}, 1.5, 20, 0.98},
    {"bust", [] { return bustMesh(32); }, {2, 1, 0}, 3, 60, 0.99},
    {"tetrahedron",
     [] {
       TriMesh m;
       m.positions_mm = {{0, 0, 0}, {10, 0, 0}, {0, 10, 0}, {0, 0, 10}};
       m.triangles = {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {2, 0, 3}};
       return m;
     },
     {2, 1, 0},
     5,
     75,
     0.8},
    {"triangle",
     [] {
       TriMesh m;
       m.positions_mm = {{0, 0, 0}, {10, 0, 0}, {0, 10, 0}};
       m.triangles = {{0, 1, 2}};
       return m;
     },
     {1, 1, 1},
     5,
     75,
     0.98},
};

class BaseDomain : public testing::TestWithParam<Case> {};

TEST_P(BaseDomain, KeepsTheTopologyAndReachesTheSurface) {
  const TriMesh scan = GetParam().make();
  for (uint32_t patches : {0u, 150u}) {
    if (kSanitized && patches != 0) continue;
    SCOPED_TRACE(patches);
    const BaseMesh base = baseOf(scan, patches);
    ASSERT_EQ(baseMeshProblem(base), "");
    Topology t = topologyOf(base);
    EXPECT_EQ(t.border_sides > 0, GetParam().expected.borders > 0);
    t.border_sides = 0;
    EXPECT_EQ(t.euler, GetParam().expected.euler);
    EXPECT_EQ(t.pieces, GetParam().expected.pieces);
    EXPECT_EQ(t.borders, GetParam().expected.borders);
    EXPECT_EQ(t.shared_too_often, 0u);
    EXPECT_EQ(t.turned, 0u);

    const Shape s = shapeOf(base);
    EXPECT_LE(s.ratio95, GetParam().ratio95);
    EXPECT_LE(s.angle95, GetParam().angle95);
    EXPECT_LE(s.inward, 0.005);
    const double single = singleValued(scan, base);
    EXPECT_GE(single, GetParam().single_valued);
    RecordProperty(("single_valued_" + std::to_string(patches)).c_str(), std::to_string(single));
    printf("%s: %zu patches, 95 %% of them with sides within %.2f and angles within %.0f degrees, %.4f single-valued\n",
           GetParam().name, base.patches.size(), s.ratio95, s.angle95, single);

    if (t.borders == 0) continue;
    const BorderFit fit = borderFit(scan, base);
    const double diagonal = diagonalOf(scan);
    EXPECT_LT(fit.corners, 1e-5 * diagonal);
    EXPECT_LT(fit.sides, 0.02 * diagonal);
    EXPECT_LT(fit.missed, 0.02 * diagonal);
  }
}
INSTANTIATE_TEST_SUITE_P(Shapes, BaseDomain, testing::ValuesIn(kCases), [](const auto& i) { return i.param.name; });

// The checks above can fail.
TEST(BaseDomainControl, BrokenBasesFailTheChecks) {
  const TriMesh scan = wavySheet(60);
  const BaseMesh sound = baseOf(scan, 100);
  ASSERT_GT(singleValued(scan, sound), 0.96);

  BaseMesh flipped = sound;
  for (BaseCorner& c : flipped.corners) c.normal = -c.normal;
  EXPECT_LT(singleValued(scan, flipped), 0.01);
  EXPECT_GT(shapeOf(flipped).inward, 0.99);

  BaseMesh shifted = sound;
  for (BaseCorner& c : shifted.corners) c.position_mm += glm::vec3(10, 0, 30);
  EXPECT_LT(singleValued(scan, shifted), 0.5);
  EXPECT_GT(borderFit(scan, shifted).corners, 1e-2 * diagonalOf(scan));

  BaseMesh holed = sound;
  const auto beside = patchNeighbours(sound);
  auto within = [&](const PatchNeighbours& n) {
    return std::all_of(n.begin(), n.end(), [](const PatchNeighbour& x) { return x.patch != PatchNeighbour::kNone; });
  };
  for (uint32_t p = 0; p < sound.patches.size() && holed.patches.size() == sound.patches.size(); ++p) {
    bool inside = within(beside[p]);
    for (int s = 0; s < 4 && inside; ++s) inside = within(beside[beside[p][s].patch]);
    if (inside) holed.patches.erase(holed.patches.begin() + p);
  }
  EXPECT_NE(topologyOf(holed).euler, topologyOf(sound).euler);

  BaseMesh turned = sound;
  std::swap(turned.patches[7][1], turned.patches[7][2]);
  EXPECT_GT(topologyOf(turned).turned, 0u);

  BaseMesh crooked = sound;
  std::mt19937 random(7);
  std::uniform_real_distribution<float> by(-8, 8);
  for (BaseCorner& c : crooked.corners) c.position_mm += glm::vec3(by(random), by(random), 0);
  EXPECT_GT(shapeOf(crooked).angle95, 80);
}

TEST(BaseDomain, AboutAsManyPatchesAsAskedFor) {
  std::vector<uint32_t> numbers{30, 100, 1000};
  if (longTests()) numbers = {30, 64, 100, 300, 1000, 4000};
  for (const TriMesh& scan : {ballMesh(40), wavySheet(80), bustMesh(40)}) {
    for (uint32_t patches : numbers) {
      if (kSanitized && patches > 100) continue;
      const BaseMesh base = baseOf(scan, patches);
      EXPECT_GE(base.patches.size(), 0.7 * patches);
      EXPECT_LE(base.patches.size(), 1.3 * patches);
    }
  }
  EXPECT_EQ(baseOf(ballMesh(24), 6).patches.size(), 6u);
  // A scan of few triangles has as many patches as any other.
  const uint32_t many = kSanitized ? 500 : 2000;
  const BaseMesh fine = baseOf(boxMesh(1, 20, 20, 20), many);
  EXPECT_NEAR(static_cast<double>(fine.patches.size()), many, 0.3 * many);
  EXPECT_EQ(topologyOf(fine).euler, 2);
}

TEST(BaseDomain, FewPatchesWhereTheShapeIsSimple) {
  EXPECT_LE(baseOf(panelMesh(50)).patches.size(), 4u);
  EXPECT_LE(baseOf(boxMesh(20, 100, 80, 5)).patches.size(), 100u);
  EXPECT_LE(baseOf(ballMesh(24)).patches.size(), 100u);
}

// Woven cloth of 100 x 100 under a round plateau with a steep rim, bent and cut as shape and skip say: border heights
// vary by 1 % of the diagonal, the border itself by 0.02 %.
TriMesh clothMesh(int n, const std::function<glm::dvec2(double, double)>& shape,
                  const std::function<bool(double, double)>& skip = {}) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> by(-1, 1);
  return gridMesh(
      n, n, false, false,
      [&](double u, double v) {
        const double weave =
            0.6 * std::sin(2 * std::numbers::pi * 17 * u) * std::cos(2 * std::numbers::pi * 19 * v) + 0.1 * by(random);
        const double rim = std::clamp((0.2 - std::hypot(u - 0.4, v - 0.35)) / 0.01, 0.0, 1.0);
        return glm::dvec3(100.0 * shape(u, v) + 0.02 * glm::dvec2(by(random), by(random)), weave + 12 * rim);
      },
      skip);
}

struct CornerCase {
  const char* name;
  TriMesh scan;
  std::vector<glm::dvec2> corners;  // x, y
  bool panel;
};
std::vector<CornerCase> cornerCases() {
  auto square = [](double u, double v) { return glm::dvec2(u, v); };
  std::vector<CornerCase> cases;
  const std::vector<glm::dvec2> four{{0, 0}, {100, 0}, {0, 100}, {100, 100}};
  cases.push_back({"square", clothMesh(150, square), four, true});
  cases.push_back({"trapezoid",
                   clothMesh(150, [](double u, double v) { return glm::dvec2(u * (1 - 0.4 * v) + 0.2 * v, v); }),
                   {{0, 0}, {100, 0}, {20, 100}, {80, 100}},
                   true});
  cases.push_back({"L",
                   clothMesh(180, square, [](double u, double v) { return u > 0.7 && v > 0.6; }),
                   {{0, 0}, {100, 0}, {0, 100}, {70, 60}, {100, 60}, {70, 100}},
                   false});
  auto holed = four;
  for (const glm::dvec2& p : {glm::dvec2(70, 70), glm::dvec2(90, 70), glm::dvec2(70, 90), glm::dvec2(90, 90)})
    holed.push_back(p);
  cases.push_back({"squareHole",
                   clothMesh(160, square, [](double u, double v) { return u > 0.7 && u < 0.9 && v > 0.7 && v < 0.9; }),
                   holed, false});
  return cases;
}

double farthestCorner(const BaseMesh& base, const std::vector<glm::dvec2>& corners) {
  double farthest = 0;
  for (const glm::dvec2& c : corners) {
    double least = 1e300;
    for (const BaseCorner& b : base.corners) least = std::min(least, glm::length(glm::dvec2(b.position_mm) - c));
    farthest = std::max(farthest, least);
  }
  return farthest;
}

TEST(BaseDomain, RoughBordersKeepTheirCorners) {
  for (const CornerCase& c : cornerCases()) {
    SCOPED_TRACE(c.name);
    const double diagonal = diagonalOf(c.scan);
    for (uint32_t patches : {0u, 100u}) {
      if (kSanitized && patches != 0) continue;
      const BaseMesh base = baseOf(c.scan, patches);
      const BorderDeviation deviation = borderDeviation(c.scan, base);
      printf("%s: %zu patches, corners within %.5f, borders within %.5f and %.5f of the diagonal\n", c.name,
             base.patches.size(), farthestCorner(base, c.corners) / diagonal, deviation.scan / diagonal,
             deviation.base / diagonal);
      EXPECT_LT(farthestCorner(base, c.corners), 1e-3 * diagonal);
      EXPECT_LT(deviation.scan, 2e-3 * diagonal);
      EXPECT_LT(deviation.base, 2e-3 * diagonal);
      EXPECT_TRUE(!c.panel || patches != 0 || base.patches.size() <= 4);

      // Without one of the corners the checks fail.
      BaseMesh cut = base;
      const glm::dvec2 at = c.corners.back();
      auto nearest =
          std::min_element(cut.corners.begin(), cut.corners.end(), [&](const BaseCorner& a, const BaseCorner& b) {
            return glm::length(glm::dvec2(a.position_mm) - at) < glm::length(glm::dvec2(b.position_mm) - at);
          });
      nearest->position_mm += 0.02f * (glm::vec3(50, 50, 0) - nearest->position_mm);
      EXPECT_GT(farthestCorner(cut, c.corners), 1e-3 * diagonal);
      EXPECT_GT(borderDeviation(c.scan, cut).scan, 2e-3 * diagonal);
    }
  }
}

// A refined base has about as many patches as are foretold, more where more is asked for.
TEST(BaseDomain, TellsHowManyPatchesRefiningTakes) {
  const TriMesh ball = ballMesh(24);
  auto domain = relievo::BaseDomain::create(ball);
  ASSERT_TRUE(domain);
  ASSERT_TRUE((*domain)->make());
  std::vector<RefineRequest> few, many;
  for (size_t i = 0; i < ball.positions_mm.size(); i += 2) many.push_back({glm::dvec3(ball.positions_mm[i])});
  few.push_back(many[0]);
  const uint32_t foretold = (*domain)->patchesToRefine(few);
  EXPECT_GT(foretold, (*domain)->patches());
  EXPECT_GT((*domain)->patchesToRefine(many), foretold);
  const auto refined = (*domain)->refine(few, 4096);
  ASSERT_TRUE(refined);
  EXPECT_NEAR(static_cast<double>(refined->patches.size()), foretold, 0.3 * foretold);
}

// Or as many as are asked for, of which those elsewhere are smaller, too; never more than there may be.
TEST(BaseDomain, RefinesToAsManyPatchesAsAreAskedFor) {
  const TriMesh ball = ballMesh(24);
  const std::vector<RefineRequest> requests{{glm::dvec3(ball.positions_mm[0])}};
  auto refinedTo = [&](uint32_t most, uint32_t least) -> BaseMesh {
    auto domain = relievo::BaseDomain::create(ball);
    if (!domain || !(*domain)->make()) return {};
    auto base = (*domain)->refine(requests, most, least);
    return base ? std::move(*base) : BaseMesh{};
  };
  // The patches on the far side of the ball.
  auto elsewhere = [&](const BaseMesh& base) {
    const glm::dvec3 at(ball.positions_mm[0]);
    size_t count = 0;
    for (uint32_t p = 0; p < base.patches.size(); ++p) count += glm::dot(base.point(p, 0.5, 0.5), at) < 0;
    return count;
  };
  const BaseMesh few = refinedTo(4096, 0), many = refinedTo(4096, 900), limited = refinedTo(500, 900);
  ASSERT_FALSE(few.patches.empty());
  EXPECT_LT(few.patches.size(), 450u);
  EXPECT_NEAR(static_cast<double>(many.patches.size()), 900, 0.3 * 900);
  EXPECT_NEAR(static_cast<double>(limited.patches.size()), 500, 0.3 * 500);
  EXPECT_GT(elsewhere(many), 2 * elsewhere(few));
  EXPECT_EQ(refinedTo(4096, 10).patches, few.patches) << "fewer than it takes anyway";
}

// make() stops at the first base that is worth a bake, grow() goes on to what makeBaseMesh() returns at once.
TEST(BaseDomain, GrowsUntilNothingIsLost) {
  const TriMesh scan = relievo::helmet(1);
  auto domain = relievo::BaseDomain::create(scan);
  ASSERT_TRUE(domain);
  auto base = (*domain)->make();
  ASSERT_TRUE(base);
  EXPECT_LE((*domain)->lostArea(), 0.02);
  EXPECT_LE(base->patches.size(), 400u);
  int grown = 0;
  while ((*domain)->mayGrow()) {
    auto larger = (*domain)->grow();
    if (!larger) {
      EXPECT_EQ(larger.error().kind, ErrorKind::kUsage);
      break;
    }
    EXPECT_GT(larger->patches.size(), base->patches.size());
    base = std::move(larger);
    ++grown;
  }
  EXPECT_GE(grown, 1);
  EXPECT_FALSE((*domain)->mayGrow());
  const BaseMesh whole = baseOf(scan);
  EXPECT_EQ(base->patches, whole.patches);
  EXPECT_TRUE(std::equal(
      base->corners.begin(), base->corners.end(), whole.corners.begin(), whole.corners.end(),
      [](const BaseCorner& a, const BaseCorner& b) { return a.position_mm == b.position_mm && a.normal == b.normal; }));
}

TEST(BaseDomain, FinerPatchesWhereNothingIsLost) {
  using Growth = relievo::BaseDomain::Growth;
  const TriMesh ball = ballMesh(24);
  auto domain = relievo::BaseDomain::create(ball);
  ASSERT_TRUE(domain);
  auto base = (*domain)->make();
  ASSERT_TRUE(base);
  EXPECT_FALSE((*domain)->mayGrow());
  EXPECT_FALSE((*domain)->grow().ok());
  size_t patches = base->patches.size();
  EXPECT_LE(patches, 100u);
  for (int k = 0; k < 4; ++k) {  // to 800
    const auto finer = (*domain)->grow(Growth::kToBeFiner);
    ASSERT_TRUE(finer) << k;
    EXPECT_GT(finer->patches.size(), patches * 5 / 4);
    EXPECT_LE((*domain)->lostArea(), 0.0015);
    patches = finer->patches.size();
  }
  EXPECT_FALSE((*domain)->grow(Growth::kToBeFiner).ok());
  // A given number stays.
  auto given = relievo::BaseDomain::create(ball, {.patches = 100});
  ASSERT_TRUE(given && (*given)->make());
  EXPECT_FALSE((*given)->mayGrow());
  EXPECT_FALSE((*given)->grow(Growth::kToBeFiner).ok());
}

// Over a relief that one direction sees, every line along the normals meets the scan once, however steep its walls are.
TEST(BaseDomain, ReliefsOverAPlaneAreGrids) {
  auto linesThatMeetOnce = [](const TriMesh& scan, const BaseMesh& base) {
    std::mt19937 random(9);
    std::uniform_real_distribution<double> in(0.01, 0.99);
    int once = 0;
    for (int i = 0; i < 400; ++i) {
      const uint32_t p = random() % base.patches.size();
      const double u = in(random), v = in(random);
      once += crossings(scan, base.point(p, u, v), glm::normalize(base.normal(p, u, v)), 1e9).size() == 1;
    }
    return once;
  };
  const CornerCase square = cornerCases()[0];
  const BaseMesh base = baseOf(square.scan);
  EXPECT_EQ(base.patches.size(), 1u);
  EXPECT_EQ(linesThatMeetOnce(square.scan, base), 400);

  // A plateau that leans over its rim is none: its base's normals turn towards it.
  TriMesh leaning = square.scan;
  for (glm::vec3& p : leaning.positions_mm) p.x += 1.5f * std::max(p.z - 2, 0.0f);
  EXPECT_LT(linesThatMeetOnce(leaning, base), 396);
  const BaseMesh turned = baseOf(leaning);
  EXPECT_TRUE(std::any_of(turned.corners.begin(), turned.corners.end(),
                          [&](const BaseCorner& c) { return c.normal != turned.corners[0].normal; }));

  auto lostAreaOf = [](const TriMesh& scan) {
    auto domain = relievo::BaseDomain::create(scan);
    return domain && (*domain)->make() ? (*domain)->lostArea() : -1;
  };
  EXPECT_EQ(lostAreaOf(square.scan), 0);
  EXPECT_GT(lostAreaOf(leaning), 0);

  auto view_direction = [](const TriMesh& m) { return viewDirectionOf(m.positions_mm, m.triangles); };
  EXPECT_TRUE(isRelief(view_direction(square.scan)));
  EXPECT_EQ(view_direction(square.scan).direction, glm::dvec3(0, 0, 1));
  EXPECT_FALSE(isRelief(view_direction(leaning)));
  EXPECT_FALSE(isRelief(view_direction(ballMesh(8))));
  EXPECT_NEAR(view_direction(boxMesh(4, 10, 10, 10)).flat, 0, 1e-6);
}

TEST(FeatureCurves, DeviationFromASideIsMeasuredAcrossTheNormals) {
  // A quarter of a circle of radius 1: the chord's height is 1 - cos 45 degrees; and a wave along the normals costs
  // nothing.
  FeatureCurve arc{.points = {}, .arc_lengths = {0}, .border = true};
  for (int i = 0; i <= 200; ++i) {
    const double a = 90 * kDegrees * i / 200;
    arc.points.push_back({std::cos(a), std::sin(a), 0.3 * std::sin(20 * a)});
    if (i) arc.arc_lengths.push_back(arc.arc_lengths.back() + glm::length(arc.points[i] - arc.points[i - 1]));
  }
  const CurveEnd first{arc.points.front(), {0, 0, 1}, 0}, last{arc.points.back(), {0, 0, 1}, arc.length()};
  EXPECT_NEAR(deviationFromSide(arc, first, last), 1 - std::cos(45 * kDegrees), 1e-4);
  EXPECT_DOUBLE_EQ(deviationFromSide(arc, last, first), deviationFromSide(arc, first, last));
  const CurveEnd tilted_first{first.point, {0, 1, 0}, 0}, tilted_last{last.point, {0, 1, 0}, arc.length()};
  EXPECT_GT(deviationFromSide(arc, tilted_first, tilted_last), 0.25);  // the wave
  // Of a circle of 0.35 sides of 0.05 deviate by 0.0009; long ones deviate by more than allowed.
  FeatureCurve circle{.points = {}, .arc_lengths = {0}, .border = true};
  for (int i = 0; i <= 400; ++i) {
    circle.points.push_back({0.35 * std::cos(i * 0.9 * kDegrees), 0.35 * std::sin(i * 0.9 * kDegrees), 0});
    if (i)
      circle.arc_lengths.push_back(circle.arc_lengths.back() + glm::length(circle.points[i] - circle.points[i - 1]));
  }
  EXPECT_EQ(deviationForSides(circle, 0.05, 0.002), 0.002);
  EXPECT_GT(deviationForSides(circle, 0.8, 0.002), 0.02);
}

TEST(FeatureCurves, CornersOfRoughBorders) {
  const unsigned seed = 4;
  printf("seed %u\n", seed);
  std::mt19937 random(seed);
  std::normal_distribution<double> by(0, 1);
  // Regular polygons of that many corners, with noise of 0.05 % of the diagonal across and 0.2 % along the normal.
  for (int corners : {3, 4, 5, 6, 0}) {
    BorderLoop border;
    const int n = 1200;
    std::vector<glm::dvec3> truth;
    for (int i = 0; i < n; ++i) {
      const double a = 2 * std::numbers::pi * i / n;
      glm::dvec3 p(0.35 * std::cos(a), 0.35 * std::sin(a), 0);
      if (corners) {
        const double step = 2 * std::numbers::pi / corners, from = std::floor(a / step + 1e-9) * step,
                     t = (a - from) / step;
        p = {0.35 * (std::cos(from) * (1 - t) + std::cos(from + step) * t),
             0.35 * (std::sin(from) * (1 - t) + std::sin(from + step) * t), 0};
        if (i * corners % n == 0) truth.push_back(p);
      }
      border.vertices.push_back(i);
      border.points.push_back(glm::vec3(p + glm::dvec3(0.0005 * by(random), 0.0005 * by(random), 0.002 * by(random))));
    }
    const auto found = borderCorners({border});
    EXPECT_EQ(found.size(), static_cast<size_t>(corners));
    for (const glm::dvec3& p : truth) {
      double least = 1;
      for (uint32_t v : found) least = std::min(least, glm::length(glm::dvec3(border.points[v]) - p));
      EXPECT_LT(least, 0.01);
    }
  }
}

TEST(BaseDomain, CreasesLieOnSides) {
  const TriMesh scan = boxMesh(14, 50, 40, 30);
  const BaseMesh base = baseOf(scan, 120);
  // With every crease on sides, every patch lies in a face.
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    double off[3] = {0, 0, 0};
    const double half[3] = {25, 20, 15};
    for (uint32_t c : base.patches[p]) {
      for (int k = 0; k < 3; ++k)
        off[k] = std::max(off[k], std::abs(std::abs(static_cast<double>(base.corners[c].position_mm[k])) - half[k]));
    }
    EXPECT_LT(std::min({off[0], off[1], off[2]}), 1e-3) << "patch " << p;
  }
}

// A package keeps few bits of round numbers. What is rounded off is small beside patches, and no normal gets longer
// than 1, which bounds of heights rely on.
TEST(BaseDomain, CornersAreRoundNumbers) {
  // The second has crumbs, whose sides are a thousandth of its diagonal.
  for (const TriMesh& scan : {bustMesh(30), together(ballMesh(24), ballMesh(4, 0.05), {80, 0, 0})}) {
    const BaseMesh base = baseOf(scan);
    const double diagonal = diagonalOf(scan);
    double shortest = diagonal, finest = diagonal, step = 1;
    for (const auto& patch : base.patches)
      for (const auto& [a, b] : kSideCorners)
        shortest = std::min(shortest, glm::length(glm::dvec3(base.corners[patch[static_cast<size_t>(a)]].position_mm -
                                                             base.corners[patch[static_cast<size_t>(b)]].position_mm)));
    // The largest power of two that all coordinates are multiples of.
    auto isMultiple = [](double v, double of) { return std::floor(v / of) * of == v; };
    for (const BaseCorner& c : base.corners) {
      for (int k = 0; k < 3; ++k)
        while (step > 1e-12 && !isMultiple(c.position_mm[k], step)) step /= 2;
      const float length = glm::length(c.normal);
      EXPECT_LE(length, 1.0f);
      EXPECT_GE(length, 1.0f - 5e-4f);
      for (int k = 0; k < 3; ++k) EXPECT_TRUE(isMultiple(c.normal[k], 1.0 / 4096)) << c.normal[k];
    }
    finest = std::min(diagonal / 65536, shortest / 32);
    EXPECT_GT(step, finest / 2.2);
    EXPECT_LE(step, finest * 1.1);
    // Control: the scan's own vertices are no such numbers.
    EXPECT_TRUE(std::any_of(scan.positions_mm.begin(), scan.positions_mm.end(),
                            [&](const glm::vec3& p) { return !isMultiple(p.x, step); }));
  }
}

TEST(BaseDomain, Deterministic) {
  const TriMesh scan = bustMesh(40);
  EXPECT_EQ(baseOf(scan, 200), baseOf(scan, 200));
  EXPECT_EQ(baseOf(scan), baseOf(scan));
}

TEST(BaseDomain, FarFromTheOrigin) {
  TriMesh scan = ballMesh(24), far = scan;
  far.origin_mm = {1e7, -2e7, 3e7};
  const BaseMesh here = baseOf(scan, 100), there = baseOf(far, 100);
  EXPECT_EQ(there.origin_mm, far.origin_mm);
  EXPECT_EQ(here.corners, there.corners);
}

TEST(BaseDomain, PiecesStayPieces) {
  // A sphere, a crumb and a sheet.
  const TriMesh scan = together(together(ballMesh(24), ballMesh(4, 1), {80, 0, 0}), wavySheet(30, 0), {0, 100, 0});
  const Topology t = topologyOf(baseOf(scan));
  EXPECT_EQ(t.pieces, 3u);
  EXPECT_EQ(t.borders, 1u);
  EXPECT_EQ(t.euler, 2 + 2 + 1);
}

TEST(BaseDomain, PiecesThatTouchAreTold) {
  // Two boxes with one vertex in common: two pieces, by name and by place.
  TriMesh scan = together(boxMesh(6, 10, 10, 10), boxMesh(6, 10, 10, 10), {10, 10, 10});
  auto find = [&](const glm::vec3& p) {
    for (uint32_t v = 0; v < scan.positions_mm.size(); ++v) {
      if (scan.positions_mm[v] == p) return v;
    }
    return ~0u;
  };
  const uint32_t touch = find({5, 5, 5});
  ASSERT_NE(touch, ~0u);
  size_t renamed = 0;
  for (auto& t : scan.triangles) {
    for (uint32_t& v : t) {
      if (v != touch && scan.positions_mm[v] == scan.positions_mm[touch]) v = touch, ++renamed;
    }
  }
  ASSERT_GT(renamed, 0u);
  const Topology t = topologyOf(baseOf(scan, 200));
  EXPECT_EQ(t.pieces, 2u);
  EXPECT_EQ(t.euler, 4);
}

TEST(BaseDomain, WindingIsMadeOne) {
  TriMesh scan = ballMesh(16);
  std::mt19937 random(3);
  for (auto& t : scan.triangles) {
    if (random() % 4 == 0) std::swap(t[0], t[1]);
  }
  const BaseMesh base = baseOf(scan, 100);
  EXPECT_EQ(topologyOf(base).turned, 0u);
  for (const BaseCorner& c : base.corners) EXPECT_GT(glm::dot(c.normal, glm::normalize(c.position_mm)), 0.9f);
}

TEST(BaseDomain, NeedlesAndCollapsedShapes) {
  auto one = [](std::initializer_list<glm::vec3> points) {
    TriMesh m;
    m.positions_mm = points;
    m.triangles = {{0, 1, 2}};
    return m;
  };
  const TriMesh needle = one({{0, 0, 0}, {10000, 0, 0}, {0, 1, 0}});
  const BaseMesh base = baseOf(needle, 50);
  EXPECT_EQ(baseMeshProblem(base), "");
  EXPECT_EQ(topologyOf(base).euler, 1);
  EXPECT_EQ(topologyOf(base).borders, 1u);
  // A box 1 : 10,000, and one whose sides hold needles.
  for (const TriMesh& m : {boxMesh(4, 10000, 1, 1), boxMesh(4, 1000, 1000, 0.1)}) {
    const BaseMesh thin = baseOf(m, 100);
    EXPECT_EQ(topologyOf(thin).euler, 2);
  }
}

void expectRefused(const TriMesh& mesh, const std::string& because) {
  auto base = makeBaseMesh(mesh);
  ASSERT_FALSE(base.ok()) << because;
  EXPECT_EQ(base.error().kind, ErrorKind::kInvalidData);
  EXPECT_NE(base.error().message.find(because), std::string::npos) << base.error().text();
}

TEST(BaseDomain, RefusesByName) {
  expectRefused({}, "no triangle");
  expectRefused(moebiusMesh(), "one side only");
  TriMesh m = boxMesh(2, 1, 1, 1);
  m.triangles[3][1] = 1000;
  expectRefused(m, "names vertex 1000");
  m = boxMesh(2, 1, 1, 1);
  m.triangles[3][1] = m.triangles[3][0];
  expectRefused(m, "one vertex twice");
  m = boxMesh(2, 1, 1, 1);
  m.positions_mm[5].y = NAN;
  expectRefused(m, "finite");
  m = boxMesh(2, 1, 1, 1);
  m.positions_mm.push_back({9, 9, 9});
  m.triangles.push_back({m.triangles[0][0], m.triangles[0][1], static_cast<uint32_t>(m.positions_mm.size() - 1)});
  expectRefused(m, "three triangles share");
  m = together(ballMesh(8), boxMesh(2, 0, 0, 0), {100, 0, 0});
  expectRefused(m, "has no area");
  m = boxMesh(2, 5, 0, 0);
  expectRefused(m, "has no area");
}

TEST(BaseDomain, InterruptedAndProgress) {
  std::atomic<bool> interrupted{true};
  auto stopped = makeBaseMesh(ballMesh(24), {.interrupted = &interrupted});
  ASSERT_FALSE(stopped.ok());
  EXPECT_EQ(stopped.error().kind, ErrorKind::kInterrupted);
  std::vector<double> seen;
  ASSERT_TRUE(makeBaseMesh(ballMesh(24), {.progress = [&](double x) { seen.push_back(x); }}).ok());
  EXPECT_TRUE(std::is_sorted(seen.begin(), seen.end()));
  EXPECT_EQ(seen.front(), 0.0);
  EXPECT_EQ(seen.back(), 1.0);
  EXPECT_EQ(makeBaseMesh(ballMesh(8), {.patches = (1u << 20) + 1}).error().kind, ErrorKind::kUsage);
}

// Rough surfaces of all kinds, far down: nothing is pinched, closed, opened or moved.
TEST(ReduceSurface, KeepsTheTopology) {
  const unsigned seed = 11;
  printf("seed %u\n", seed);
  std::mt19937 random(seed);
  std::normal_distribution<float> by(0, 0.4f);
  for (TriMesh m : {ballMesh(40), torusMesh(150, 60), wavySheet(90), boxMesh(30, 60, 60, 2)}) {
    for (glm::vec3& p : m.positions_mm) p += glm::vec3(by(random), by(random), by(random));
    auto scan = makeSurface(m.positions_mm, m.triangles);
    ASSERT_TRUE(scan.ok());
    const auto expected = topologyOf(scan->points.size(), scan->triangles);
    for (size_t wanted : {3000, 300, 20}) {
      const Reduced r = reduceSurface(*scan, wanted);
      EXPECT_LT(r.surface.triangles.size(), scan->triangles.size());
      Topology t = topologyOf(r.surface.points.size(), r.surface.triangles);
      t.border_sides = expected.border_sides;
      EXPECT_EQ(t, expected);
      for (size_t v = 0; v < r.vertex.size(); ++v) ASSERT_EQ(r.surface.points[v], scan->points[r.vertex[v]]);
    }
  }
}

TEST(ReduceSurface, StopsWithinAPass) {
  const TriMesh m = wavySheet(90);
  auto scan = makeSurface(m.positions_mm, m.triangles);
  ASSERT_TRUE(scan.ok());
  const std::atomic<bool> stop{true}, go_on{false};
  EXPECT_EQ(reducePart(*scan, 20, {}, &stop).triangles.size(), m.triangles.size());
  EXPECT_LT(reducePart(*scan, 20, {}, &go_on).triangles.size(), m.triangles.size() / 2);
}

TEST(ReduceSurface, KeepsNamedVertices) {
  const TriMesh m = wavySheet(120, 0);
  auto scan = makeSurface(m.positions_mm, m.triangles);
  ASSERT_TRUE(scan.ok());
  std::vector<uint32_t> corners;
  for (uint32_t v = 0; v < scan->points.size(); ++v) {
    const glm::vec3 p = scan->points[v];
    if ((p.x == 0 || p.x == 100) && (p.y == 0 || p.y == 100)) corners.push_back(v);
  }
  ASSERT_EQ(corners.size(), 4u);
  auto left = [&](const Reduced& r) {
    return std::count_if(corners.begin(), corners.end(),
                         [&](uint32_t v) { return std::find(r.vertex.begin(), r.vertex.end(), v) != r.vertex.end(); });
  };
  EXPECT_EQ(left(reduceSurface(*scan, 300, corners)), 4);
  EXPECT_LT(left(reduceSurface(*scan, 300)), 4);  // unnamed, they go
}

// Reduced chunk by chunk, in any order of the triangles: the same topology, borders in full detail, no vertex moved;
// the same for any number of workers.
TEST(ReduceByChunks, KeepsTopologyAndBorders) {
  const unsigned seed = 12;
  printf("seed %u\n", seed);
  std::mt19937 random(seed);
  std::normal_distribution<float> by(0, 0.2f);
  size_t smaller = 0;
  for (TriMesh m : {ballMesh(40), torusMesh(150, 60), wavySheet(90), boxMesh(30, 60, 60, 2),
                    together(ballMesh(20), torusMesh(40, 20), glm::vec3(200, 0, 0))}) {
    for (glm::vec3& p : m.positions_mm) p += glm::vec3(by(random), by(random), by(random));
    const auto expected = topologyOf(m.positions_mm.size(), m.triangles);
    for (bool shuffled : {false, true}) {
      if (shuffled) std::shuffle(m.triangles.begin(), m.triangles.end(), random);
      for (size_t run : {37, 1000, 4000}) {
        if (kSanitized && run != (shuffled ? 37 : 4000)) continue;
        ChunkOptions options{
            .chunk_triangles = run, .triangles = 500, .centre = {1, 2, 3}, .diagonal = 50, .workers = 1};
        const auto reduced = reduceByChunks(m, options);
        ASSERT_TRUE(reduced);
        EXPECT_EQ(topologyOf(reduced->points.size(), reduced->triangles), expected);
        EXPECT_LE(reduced->triangles.size(), m.triangles.size());
        if (!shuffled && run == 4000) smaller += 2 * reduced->triangles.size() < m.triangles.size();
        std::vector<std::array<float, 3>> scan;
        for (const glm::vec3& p : m.positions_mm) {
          const glm::vec3 q((glm::dvec3(p) - options.centre) / options.diagonal);
          scan.push_back({q.x, q.y, q.z});
        }
        std::sort(scan.begin(), scan.end());
        for (const glm::vec3& p : reduced->points)
          ASSERT_TRUE(std::binary_search(scan.begin(), scan.end(), std::array<float, 3>{p.x, p.y, p.z}));
        options.workers = 3;
        const auto again = reduceByChunks(m, options);
        ASSERT_TRUE(again);
        EXPECT_EQ(again->points, reduced->points);
        EXPECT_EQ(again->triangles, reduced->triangles);
        // Control: runs that do not meet where they should are seen.
        std::vector<Triangle> torn = reduced->triangles;
        torn.erase(torn.begin() + static_cast<std::ptrdiff_t>(torn.size() / 2));
        EXPECT_NE(topologyOf(reduced->points.size(), torn), expected);
      }
    }
  }
  EXPECT_EQ(smaller, 5u);
}

TEST(ReduceByChunks, RefusesWhatIsNoMesh) {
  const ChunkOptions options{.chunk_triangles = 100, .triangles = 100};
  const TriMesh sound = ballMesh(12);
  EXPECT_TRUE(reduceByChunks(sound, options));
  TriMesh m = sound;
  m.triangles[500][1] = static_cast<uint32_t>(m.positions_mm.size());
  EXPECT_FALSE(reduceByChunks(m, options));
  m = sound;
  m.triangles[7][1] = m.triangles[7][0];
  EXPECT_FALSE(reduceByChunks(m, options));
  m = sound;
  m.positions_mm[9].y = std::numeric_limits<float>::quiet_NaN();
  EXPECT_FALSE(reduceByChunks(m, options));
  m = sound;  // a third triangle at an edge, far from it in the list
  m.positions_mm.push_back({90, 90, 90});
  m.triangles.push_back({m.triangles[3][0], m.triangles[3][1], static_cast<uint32_t>(m.positions_mm.size() - 1)});
  EXPECT_FALSE(reduceByChunks(m, options));
  const std::atomic<bool> interrupted{true};
  ChunkOptions stopped = options;
  stopped.interrupted = &interrupted;
  EXPECT_FALSE(reduceByChunks(sound, stopped));
}

// Rough, torn and scattered scans: whatever comes out is sound and of the scan's topology.
TEST(BaseDomain, RandomScans) {
  for (unsigned seed = 1; seed <= (kSanitized ? 4 : longTests() ? 24 : 12); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    std::mt19937 random(seed);
    auto between = [&](double a, double b) { return std::uniform_real_distribution<double>(a, b)(random); };
    TriMesh m;
    switch (seed % 4) {
      case 0:
        m = torusMesh(6 + random() % 40, 4 + random() % 16);
        break;
      case 1:
        m = wavySheet(4 + random() % 30, between(0, 0.4));
        break;
      case 2:
        m = boxMesh(1 + random() % 12, between(0.01, 100), between(0.01, 100), between(0.01, 100));
        break;
      case 3:
        m = ballMesh(6, 5);
        for (int k = 0; k < 12; ++k)
          m = together(m, ballMesh(1 + random() % 4, between(0.1, 3)),
                       {between(-99, 99), between(-99, 99), between(-99, 99)});
    }
    if (random() % 2) {
      for (glm::vec3& p : m.positions_mm) p += glm::vec3(between(-3, 3), between(-3, 3), between(-3, 3));
    }
    if (random() % 2) std::erase_if(m.triangles, [&](const auto&) { return between(0, 1) < 0.04; });
    auto surface = makeSurface(m.positions_mm, m.triangles);
    ASSERT_TRUE(surface.ok());
    const Topology expected = topologyOf(surface->points.size(), surface->triangles);
    const BaseMesh base = baseOf(m, random() % 2 ? 0 : 1 + random() % 300);
    EXPECT_EQ(baseMeshProblem(base), "");
    const Topology t = topologyOf(base);
    EXPECT_EQ(t.euler, expected.euler);
    EXPECT_EQ(t.pieces, expected.pieces);
    EXPECT_EQ(t.borders, expected.borders);
    EXPECT_EQ(t.shared_too_often + t.turned, 0u);
  }
}

TEST(BaseDomain, ARealScan) {
  const auto path = sharedData("laurana.ply");
  if (path.empty()) GTEST_SKIP() << "no ../shared/data/laurana.ply beside the checkout";
  auto scan = readMesh(path.string());
  ASSERT_TRUE(scan.ok());
  const auto& mesh = scan->mesh;
  const Topology expected = topologyOf(mesh.positions_mm.size(), mesh.triangles);
  for (uint32_t patches : {0u, 300u}) {
    const BaseMesh base = baseOf(mesh, patches);
    const Topology t = topologyOf(base);
    EXPECT_EQ(t.euler, expected.euler);
    EXPECT_EQ(t.pieces, expected.pieces);
    EXPECT_EQ(t.borders, expected.borders);
    EXPECT_LE(base.patches.size(), 830u);
    const Shape s = shapeOf(base);
    EXPECT_LE(s.ratio95, 3.0);
    EXPECT_LE(s.angle95, 60.0);
    EXPECT_LE(s.inward, 0.005);
    const BorderFit fit = borderFit(mesh, base);
    EXPECT_LT(fit.corners, 1e-5 * diagonalOf(mesh));
    EXPECT_LT(fit.sides, 0.03 * diagonalOf(mesh));
    const BorderDeviation deviation = borderDeviation(mesh, base);
    EXPECT_LT(deviation.scan, (patches ? 0.01 : 2e-3) * diagonalOf(mesh));
    printf("borders within %.5f and %.5f of the diagonal, across the normals\n", deviation.scan / diagonalOf(mesh),
           deviation.base / diagonalOf(mesh));
    const double single = singleValued(mesh, base, 2);
    EXPECT_GE(single, 0.97);
    printf(
        "%zu patches, 95 %% of them with sides within %.2f and angles within %.0f degrees, %.4f single-valued; border "
        "sides within %.4f of the diagonal\n",
        base.patches.size(), s.ratio95, s.angle95, single, fit.sides / diagonalOf(mesh));
  }
}

}  // namespace base_domain_test
}  // namespace relievo
