// mesh_fixture.h - base meshes, reliefs, views and residency for the tests of the LOD over base meshes, all from one
// seed; and the checks that they share. Nothing here asks patchNeighbours: where patches meet is told by their corners'
// indices.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <functional>
#include <map>
#include <memory>
#include <numbers>
#include <set>
#include <string>
#include <tuple>
#include <vector>

#include "geometry/lod/mesh_lod.h"
#include "geometry/lod/mesh_vertex.h"
#include "geometry/lod/morph.h"
#include "geometry/lod/snap.h"
#include "src/artwork/patch_domain.h"
#include "tests/geometry/lod_fixture.h"

namespace relievo::test {

// ---- base meshes
// Patches may be turned and mirrored: their surface stays, their sides run another way.
inline void turnPatches(BaseMesh& mesh, Random& random, bool mirrored = true) {
  for (auto& c : mesh.patches) {
    for (int turns = random.integer(0, 3); turns > 0; --turns) c = {c[2], c[0], c[3], c[1]};
    if (mirrored && random.chance(0.5)) std::swap(c[1], c[2]);
  }
}

// A box's surface, n x n patches a face, its corners pulled onto a sphere (radius > 0) or left (the corners' normals
// point from the centre).
inline BaseMesh cubeSphere(int n, double radius_mm) {
  BaseMesh mesh;
  std::map<std::array<int, 3>, uint32_t> index;
  auto corner = [&](std::array<int, 3> at) {
    auto [place, is_new] = index.emplace(at, static_cast<uint32_t>(mesh.corners.size()));
    if (is_new) {
      glm::dvec3 d = glm::normalize(glm::dvec3(std::tan((at[0] / double(n) - 0.5) * std::numbers::pi / 2),
                                               std::tan((at[1] / double(n) - 0.5) * std::numbers::pi / 2),
                                               std::tan((at[2] / double(n) - 0.5) * std::numbers::pi / 2)));
      mesh.corners.push_back({glm::vec3(d * radius_mm), glm::vec3(d)});
    }
    return place->second;
  };
  for (int axis = 0; axis < 3; ++axis)
    for (int end = 0; end < 2; ++end)
      for (int j = 0; j < n; ++j)
        for (int i = 0; i < n; ++i) {
          std::array<uint32_t, 4> c{};
          for (int k = 0; k < 4; ++k) {
            std::array<int, 3> at{};
            at[axis] = end * n;
            at[(axis + 1) % 3] = i + (k & 1);
            at[(axis + 2) % 3] = j + (k >> 1);
            c[k] = corner(at);
          }
          if (end == 1) std::swap(c[1], c[2]);  // v x u points outwards
          mesh.patches.push_back(c);
        }
  return mesh;
}

// nu x nv corners joined to nu (- 1 where open) x nv (- 1) patches. twist: the seam in u joins v with nv - 1 - v (needs
// nv patches open in v).
inline BaseMesh gridMesh(int nu, int nv, bool closed_u, bool closed_v, bool twist,
                         const std::function<BaseCorner(double, double)>& at) {
  BaseMesh mesh;
  int pu = closed_u ? nu : nu - 1, pv = closed_v ? nv : nv - 1;
  for (int j = 0; j < nv; ++j)
    for (int i = 0; i < nu; ++i) mesh.corners.push_back(at(double(i) / pu, double(j) / pv));
  auto index = [&](int i, int j) {
    if (i == nu && twist) j = nv - 1 - j;
    return static_cast<uint32_t>((j % nv) * nu + i % nu);
  };
  for (int j = 0; j < pv; ++j)
    for (int i = 0; i < pu; ++i)
      mesh.patches.push_back({index(i, j), index(i + 1, j), index(i, j + 1), index(i + 1, j + 1)});
  return mesh;
}
inline BaseCorner cornerAt(const glm::dvec3& p, const glm::dvec3& n) {
  return {glm::vec3(p), glm::vec3(glm::normalize(n))};
}

inline BaseMesh torus(int nu, int nv, double radius_mm, double tube_mm) {
  return gridMesh(nu, nv, true, true, false, [=](double u, double v) {
    double a = -2 * std::numbers::pi * u, b = 2 * std::numbers::pi * v;
    glm::dvec3 ring(std::cos(a), std::sin(a), 0), n = std::cos(b) * ring + std::sin(b) * glm::dvec3(0, 0, 1);
    return cornerAt(radius_mm * ring + tube_mm * n, n);
  });
}
// A sheet of columns x rows patches, curved a little; size_mm a patch.
inline BaseMesh openSheet(int columns, int rows, double size_mm, double bend = 0.3, glm::dvec3 offset = {}) {
  return gridMesh(columns + 1, rows + 1, false, false, false, [=](double u, double v) {
    double x = (u - 0.5) * columns * size_mm, y = (0.5 - v) * rows * size_mm;
    return cornerAt(offset + glm::dvec3(x, y, bend * size_mm * (std::sin(3 * u) + std::cos(2 * v))),
                    glm::dvec3(-0.3 * bend * std::cos(3 * u), 0.2 * bend * std::sin(2 * v), 1));
  });
}
inline BaseMesh moebius(int n, double radius_mm, double width_mm, int across = 2) {
  return gridMesh(n, across + 1, true, false, true, [=](double u, double v) {
    double a = 2 * std::numbers::pi * u, h = a / 2, w = (v - 0.5) * width_mm;
    glm::dvec3 ring(std::cos(a), std::sin(a), 0), side = std::cos(h) * ring + std::sin(h) * glm::dvec3(0, 0, 1),
                                                  along(-std::sin(a), std::cos(a), 0);
    return cornerAt(radius_mm * ring + w * side, glm::cross(along, side));
  });
}
// Quads around one corner.
inline BaseMesh fan(int valence, double size_mm, double tip = 0.3) {
  BaseMesh mesh;
  mesh.corners.push_back(cornerAt({0, 0, tip * size_mm}, {0, 0, 1}));
  for (int k = 0; k < 2 * valence; ++k) {
    double a = std::numbers::pi * k / valence, r = k % 2 ? 1.3 : 1;
    mesh.corners.push_back(
        cornerAt({r * size_mm * std::cos(a), r * size_mm * std::sin(a), 0}, {0.4 * std::cos(a), 0.4 * std::sin(a), 1}));
  }
  for (int k = 0; k < valence; ++k) {
    auto ring = [&](int i) { return static_cast<uint32_t>(1 + (i + 2 * valence) % (2 * valence)); };
    mesh.patches.push_back({0, ring(2 * k + 2), ring(2 * k), ring(2 * k + 1)});
  }
  return mesh;
}

// ---- what tests of all sorts go over
struct NamedMesh {
  std::string name;
  BaseMesh mesh;
  bool closed = false;
};
inline std::vector<NamedMesh> wellShapedMeshes() {
  std::vector<NamedMesh> all;
  all.push_back({"cube sphere of 6", cubeSphere(1, 60), true});
  all.push_back({"cube sphere of 54", cubeSphere(3, 60), true});
  all.push_back({"torus", torus(9, 5, 80, 25), true});
  all.push_back({"open strip", openSheet(5, 1, 30)});
  all.push_back({"open sheet", openSheet(3, 4, 30)});
  all.push_back({"one patch", openSheet(1, 1, 100)});
  all.push_back({"Moebius strip", moebius(7, 60, 40)});
  all.push_back({"Moebius strip of one row", moebius(3, 60, 40, 1)});
  for (int valence : {3, 4, 5, 6, 7, 8, 20}) all.push_back({"fan of " + std::to_string(valence), fan(valence, 50)});
  return all;
}
inline std::vector<NamedMesh> hardMeshes() {
  std::vector<NamedMesh> all;
  BaseMesh needles = openSheet(4, 3, 1);
  for (BaseCorner& c : needles.corners) c.position_mm.x *= 1e4f;
  all.push_back({"needles 10,000:1", needles});
  BaseMesh collapsed = openSheet(4, 4, 20);
  for (int k : {6, 7, 8}) collapsed.corners[static_cast<size_t>(k)].position_mm = collapsed.corners[6].position_mm;
  all.push_back({"collapsed sides", collapsed});
  BaseMesh zero = openSheet(3, 3, 20);
  for (int k : {5, 6, 9, 10}) zero.corners[static_cast<size_t>(k)].position_mm = zero.corners[5].position_mm;
  all.push_back({"zero area", zero});
  BaseMesh point = openSheet(2, 2, 20);
  for (BaseCorner& c : point.corners) c.position_mm = {1, 2, 3};
  all.push_back({"one point", point});
  all.push_back({"corners 10^7 mm away", openSheet(3, 3, 20, 0.3, {1e7, -1e7, 1e7})});
  BaseMesh opposed = openSheet(3, 3, 20);
  for (size_t k = 0; k < opposed.corners.size(); k += 2) opposed.corners[k].normal = -opposed.corners[k].normal;
  all.push_back({"opposed normals", opposed});
  BaseMesh folded = openSheet(3, 3, 20);
  std::swap(folded.corners[5].position_mm, folded.corners[10].position_mm);
  all.push_back({"folded", folded});
  // Two pieces that touch: in one corner, and along a side that has the same places but other corners.
  BaseMesh touching = openSheet(2, 2, 20);
  BaseMesh second = openSheet(2, 2, 20, 0.3, {40, 0, 0});
  auto first_corner = static_cast<uint32_t>(touching.corners.size());
  touching.corners.insert(touching.corners.end(), second.corners.begin(), second.corners.end());
  for (auto c : second.patches) {
    for (uint32_t& k : c) k = k == 0 ? 8 : k + first_corner;
    touching.patches.push_back(c);
  }
  all.push_back({"two pieces that touch", touching});
  // Three sheets on one side: a border for all of them.
  BaseMesh book;
  for (int k = 0; k < 8; ++k)
    book.corners.push_back(cornerAt(
        {k < 2 ? 0 : 20 * std::cos(k / 2 * 2.0), k < 2 ? 0 : 20 * std::sin(k / 2 * 2.0), 20 * (k % 2)}, {1, 1, 0}));
  for (uint32_t k = 2; k < 8; k += 2) book.patches.push_back({0, k, 1, k + 1});
  all.push_back({"three sheets on a side", book});
  return all;
}

// ---- places
// A vertex of patch p at (x, y) of 2^unit_log2 a side, named so that all patches that share it use the same name.
struct Place {
  uint32_t kind = 0, a = 0, b = 0;  // 0 inside: patch; 1 on a side: its ends' corners, the smaller first; 2: a corner
  uint32_t s = 0, t = 0;            // inside: x, y; on a side: from the smaller corner
  friend auto operator<=>(const Place&, const Place&) = default;
};
inline Place placeOf(const BaseMesh& mesh, int unit_log2, uint32_t patch, uint32_t x, uint32_t y) {
  const auto& c = mesh.patches[patch];
  const uint32_t last = 1u << unit_log2;
  bool at_x = x == 0 || x == last, at_y = y == 0 || y == last;
  if (at_x && at_y) return {2, c[(x ? 1 : 0) + (y ? 2 : 0)]};
  if (!at_x && !at_y) return {0, patch, 0, x, y};
  uint32_t a = at_x ? c[x ? 1 : 0] : c[y ? 2 : 0], b = at_x ? c[x ? 3 : 2] : c[y ? 3 : 1], t = at_x ? y : x;
  if (a > b) std::swap(a, b), t = last - t;
  return {1, a, b, t};
}
inline uint64_t hashOf(const Place& p, uint64_t seed) {
  return mix(seed ^ mix((uint64_t{p.kind} << 62) ^ (uint64_t{p.a} << 32) ^ p.b) ^
             (mix((uint64_t{p.s} << 32) ^ p.t) * 3));
}

// ---- reliefs: 16-bit heights by place
using MeshHeight = std::function<uint16_t(uint32_t patch, uint32_t x, uint32_t y)>;
inline MeshHeight noiseOver(const BaseMesh& mesh, int unit_log2, uint64_t seed) {
  return [&mesh, unit_log2, seed](uint32_t patch, uint32_t x, uint32_t y) {
    return static_cast<uint16_t>(hashOf(placeOf(mesh, unit_log2, patch, x, y), seed) >> 48);
  };
}

struct MeshRelief {
  int depth = 0;
  double offset_mm = 0, scale_mm = 0;
  int unitLog2() const { return depth + 7; }
  float mm(uint16_t q, double exaggerate) const {  // as the shader: two numbers a frame
    return static_cast<float>(offset_mm * exaggerate) +
           static_cast<float>(scale_mm * exaggerate) * static_cast<float>(q);
  }
};

// Bounds made up: errors fall by about 4 a level, with rough and smooth places; monotone down the tree.
class MadeUpMeshOracle final : public ReliefOracle {
 public:
  MadeUpMeshOracle(const MeshRelief& relief, uint64_t seed, double error_mm)
      : relief_(relief), seed_(seed), error_mm_(error_mm) {}
  HeightBounds bounds(const NodeId& page) const override {
    double error = error_mm_;
    for (uint32_t level = 0; level <= page.level; ++level)
      error *= 0.05 + 0.9 * static_cast<double>(mix(seed_ ^ mix(packNode(page.ancestor(level)))) >> 11) * 0x1p-53;
    return {static_cast<float>(relief_.offset_mm), static_cast<float>(relief_.offset_mm + 65535 * relief_.scale_mm),
            static_cast<float>(error)};
  }
  std::vector<CoarseErrors> coarse(size_t patches) const {
    std::vector<CoarseErrors> all(patches);
    for (uint32_t p = 0; p < patches; ++p)
      for (int k = 0; k < 7; ++k)
        all[p][static_cast<size_t>(k)] = static_cast<float>(error_mm_ * std::ldexp(1.0, 7 - k)) *
                                         (0.3f + 0.7f * static_cast<float>(mix(p + seed_) & 255) / 255);
    return all;
  }

 private:
  MeshRelief relief_;
  uint64_t seed_;
  double error_mm_;
};

// ---- views
inline std::pair<glm::dvec3, glm::dvec3> boxOf(const BaseMesh& mesh) {
  glm::dvec3 low(1e300), high(-1e300);
  for (const BaseCorner& c : mesh.corners)
    low = glm::min(low, glm::dvec3(c.position_mm)), high = glm::max(high, glm::dvec3(c.position_mm));
  return {low, high};
}
// From all of it in view to a few cells across the screen.
inline Camera randomMeshCamera(const BaseMesh& mesh, int unit_log2, Random& random) {
  auto [low, high] = boxOf(mesh);
  double size = std::max(glm::length(high - low), 1e-3);
  Camera c;
  c.fov_y = random.real(0.2, 1.6);
  c.aspect = random.real(0.5, 2.5);
  auto patch = static_cast<uint32_t>(random.integer(0, static_cast<int>(mesh.patches.size()) - 1));
  double u = random.real(0, 1), v = random.real(0, 1);
  c.target = mesh.point(patch, u, v);
  double cell = size * std::ldexp(1.0, -unit_log2 - 1);
  double distance = std::exp(random.real(std::log(8 * cell), std::log(3 * size)));
  double tilt = std::acos(random.real(-1, 1)), turn = random.real(0, 6.2832);
  glm::dvec3 d(std::sin(tilt) * std::cos(turn), std::sin(tilt) * std::sin(turn), std::cos(tilt));
  if (random.chance(0.7)) d = glm::normalize(d + 2.0 * mesh.normal(patch, u, v));
  if (!(glm::length(d) > 0.5)) d = {0, 0, 1};
  c.eye = c.target + distance * d;
  c.near_mm = distance * random.real(0.001, 0.3);
  c.far_mm = distance * 1000 + 10 * size;
  return c;
}

// Pages as they may have arrived: some rounds of asking, each want granted or not, some pages lost again.
inline ReliefSet randomMeshResidency(MeshLod& lod, const LodView& view, Random& random) {
  ReliefSet resident;
  int rounds = random.integer(0, 5);
  double granted = random.real(0.3, 1), lost = random.chance(0.5) ? 0 : random.real(0, 0.3);
  for (int round = 0; round < rounds; ++round) {
    for (const ReliefRequest& request : lod.select(view, resident).requests)
      if (random.chance(granted)) resident.insert(request.page);
    std::erase_if(resident, [&](const NodeId& n) {
      return mix(packNode(n) ^ static_cast<uint64_t>(round)) % 1000 < static_cast<uint64_t>(lost * 1000) && n.level > 0;
    });
  }
  return resident;
}

// ---- seams
using Bits = std::array<uint32_t, 3>;
inline Bits bitsOf(glm::vec3 v) {
  // -0 is 0: where a corner's coordinate is -0, sides that run from it differ in that sign, which no picture shows.
  v += glm::vec3(0.0f);
  return {std::bit_cast<uint32_t>(v.x), std::bit_cast<uint32_t>(v.y), std::bit_cast<uint32_t>(v.z)};
}
using MeshVertexFunction = std::function<Bits(const PatchInstance&, uint32_t x, uint32_t y)>;  // (x, y): units, snapped
using MeshGridFunction =
    std::function<Bits(const PatchInstance&, uint32_t i, uint32_t j)>;  // (i, j): of the grid; as drawn

struct MeshSeams {
  uint64_t lines = 0, pairs = 0, comparisons = 0, mismatches = 0, across_patches = 0, unbalanced = 0;
  void operator+=(const MeshSeams& o) {
    lines += o.lines, pairs += o.pairs, comparisons += o.comparisons, mismatches += o.mismatches,
        across_patches += o.across_patches, unbalanced += o.unbalanced;
  }
};

// Lines are what nodes can meet at: a side between two patches, or a line of units inside one. Every drawn node's side
// lies on one; where two sides overlap, their vertices must be the same. drawn: instead of vertex, where vertices are
// on their way to their places.
inline MeshSeams compareMeshSeams(const BaseMesh& mesh, int unit_log2, const std::vector<PatchInstance>& instances,
                                  const MeshVertexFunction& vertex, bool snapped = true,
                                  const MeshGridFunction& drawn = {}) {
  struct Entry {
    uint32_t from, to;
    std::vector<std::pair<uint32_t, Bits>> vertices;  // by place along the line, growing
    uint32_t patch;
  };
  std::map<std::array<uint32_t, 4>, std::vector<Entry>> lines;
  std::map<std::array<uint32_t, 2>, std::vector<uint32_t>> users;
  for (uint32_t p = 0; p < mesh.patches.size(); ++p)
    for (const auto& ends : kSideCorners) {
      auto [a, b] =
          std::minmax(mesh.patches[p][static_cast<size_t>(ends[0])], mesh.patches[p][static_cast<size_t>(ends[1])]);
      users[{a, b}].push_back(p);
    }
  const uint32_t last_unit = 1u << unit_log2;
  for (const PatchInstance& p : instances) {
    const uint32_t last = 1u << p.grid_level, size = last_unit >> p.node.level;
    for (int side = 0; side < 4; ++side) {
      const bool upright = side == kLeft || side == kRight;
      const auto x0 = static_cast<uint32_t>(p.x0), y0 = static_cast<uint32_t>(p.y0);
      const uint32_t across = (upright ? x0 : y0) + (side == kRight || side == kBottom ? size : 0),
                     along = upright ? y0 : x0;
      std::array<uint32_t, 4> line{0, p.node.patch, upright ? 1u : 0u, across};
      bool flip = false;
      if (across == 0 || across == last_unit) {
        uint32_t a = mesh.patches[p.node.patch][static_cast<size_t>(kSideCorners[static_cast<size_t>(side)][0])];
        uint32_t b = mesh.patches[p.node.patch][static_cast<size_t>(kSideCorners[static_cast<size_t>(side)][1])];
        flip = a > b;
        if (flip) std::swap(a, b);
        const auto& who = users[{a, b}];
        if (who.size() != 2 || who[0] == who[1]) continue;
        line = {1, a, b, 0};
      }
      Entry e{along, along + size, {}, p.node.patch};
      for (uint32_t k = 0; k <= last; ++k) {
        uint32_t i = side == kLeft ? 0 : side == kRight ? last : k, j = side == kTop ? 0 : side == kBottom ? last : k;
        std::array<uint32_t, 2> g = drawn     ? ownVertex(i, j, p)
                                    : snapped ? snapVertex(i, j, p)
                                              : std::array<uint32_t, 2>{i, j};
        uint32_t x = x0 + (g[0] << p.step_log2), y = y0 + (g[1] << p.step_log2), t = upright ? y : x;
        if (!e.vertices.empty() && e.vertices.back().first == t) continue;
        e.vertices.push_back({t, drawn ? drawn(p, i, j) : vertex(p, x, y)});
      }
      if (flip) {
        std::tie(e.from, e.to) = std::pair{last_unit - e.to, last_unit - e.from};
        for (auto& v : e.vertices) v.first = last_unit - v.first;
        std::reverse(e.vertices.begin(), e.vertices.end());
      }
      lines[line].push_back(std::move(e));
    }
  }
  MeshSeams report;
  for (auto& [line, entries] : lines) {
    ++report.lines;
    std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) { return a.from < b.from; });
    for (size_t i = 0; i < entries.size(); ++i) {
      for (size_t k = 0; k < entries.size(); ++k) {
        const Entry &a = entries[i], &b = entries[k];
        uint32_t from = std::max(a.from, b.from), to = std::min(a.to, b.to);
        if (i == k || from >= to) continue;
        if (i > k) continue;
        ++report.pairs;
        report.unbalanced += std::max(a.to - a.from, b.to - b.from) > 2 * std::min(a.to - a.from, b.to - b.from);
        report.across_patches += a.patch != b.patch;
        auto first = [&](const Entry& e) {
          return std::find_if(e.vertices.begin(), e.vertices.end(), [&](const auto& v) { return v.first >= from; });
        };
        auto va = first(a), vb = first(b);
        for (; va != a.vertices.end() && va->first <= to && vb != b.vertices.end() && vb->first <= to; ++va, ++vb) {
          ++report.comparisons;
          if (*va != *vb) ++report.mismatches;
        }
        if ((va != a.vertices.end() && va->first <= to) || (vb != b.vertices.end() && vb->first <= to))
          ++report.mismatches;
      }
    }
  }
  return report;
}

// GPUs that contract a * b + c to fma, one way or the other; PlainOps: one that does not.
struct FmaSecond {  // a * b rounds, the second product does not
  static float mulAdd(float a, float b, float c) { return std::fma(a, b, c); }
  static float mulMulAdd(float a, float b, float c, float d) { return std::fma(c, d, a * b); }
};
struct FmaFirst {
  static float mulAdd(float a, float b, float c) { return std::fma(a, b, c); }
  static float mulMulAdd(float a, float b, float c, float d) { return std::fma(a, b, c * d); }
};

// As the vertex shader computes it, with a model of contraction. Heights come out of the instance's relief page: a
// vertex between its samples gets another one's height.
template <class Ops>
auto pointsOf(const BaseMesh& mesh, const MeshRelief& relief, const MeshHeight& height, const LodView& view) {
  std::vector<EyeCorner> corners;
  for (const BaseCorner& c : mesh.corners)
    corners.push_back({glm::vec3(glm::dvec3(c.position_mm) - view.eye_mm), c.normal});
  return [&mesh, &relief, &height, corners = std::move(corners), flat = !view.relief, exaggerate = view.exaggerate](
             const PatchInstance& p, uint32_t x, uint32_t y) {
    const auto& c = mesh.patches[p.node.patch];
    float mm = 0;
    if (!flat) {
      const bool tail = p.relief_page.level == kTailLevel;
      const uint32_t between =
          (1u << (tail ? relief.unitLog2() - kTailCellsLog2 : relief.depth - static_cast<int>(p.relief_page.level))) -
          1;
      mm = relief.mm(height(p.node.patch, x & ~between, y & ~between), exaggerate);
    }
    return meshVertexFromEye<Ops>(c, {corners[c[0]], corners[c[1]], corners[c[2]], corners[c[3]]}, x, y,
                                  1u << relief.unitLog2(), mm, mesh.cut);
  };
}
template <class Ops>
MeshVertexFunction twinOf(const BaseMesh& mesh, const MeshRelief& relief, const MeshHeight& height,
                          const LodView& view) {
  return [point = pointsOf<Ops>(mesh, relief, height, view)](const PatchInstance& p, uint32_t x, uint32_t y) {
    return bitsOf(point(p, x, y));
  };
}
// With geomorph. between: as betweenVertices, for what is broken on purpose.
template <class Ops>
MeshGridFunction morphReferenceOf(const BaseMesh& mesh, const MeshRelief& relief, const MeshHeight& height,
                                  const LodView& view,
                                  std::function<glm::vec3(const glm::vec3&, const glm::vec3&, const glm::vec3&, float)>
                                      between = betweenVertices<Ops>) {
  return [point = pointsOf<Ops>(mesh, relief, height, view), between](const PatchInstance& p, uint32_t i, uint32_t j) {
    auto at = [&](uint32_t x, uint32_t y) {
      return point(p, static_cast<uint32_t>(p.x0) + (x << p.step_log2),
                   static_cast<uint32_t>(p.y0) + (y << p.step_log2));
    };
    return bitsOf(drawnVertex(p, i, j, at, between));
  };
}

// ---- random cases
struct MeshCase {
  NamedMesh named;
  MeshRelief relief;
  std::shared_ptr<MadeUpMeshOracle> oracle;
  std::unique_ptr<MeshLod> lod;
  Camera camera;
  LodView view;
  ReliefSet resident;
};
inline MeshCase randomMeshCase(uint64_t seed, NamedMesh named) {
  Random random(seed);
  MeshCase c;
  c.named = std::move(named);
  turnPatches(c.named.mesh, random);
  c.named.mesh.cut = seed / 16 % 3 == 0;
  auto [low, high] = boxOf(c.named.mesh);
  c.relief.depth = random.integer(0, 6);
  c.relief.scale_mm = glm::length(high - low) * std::exp(random.real(-9, -2.5)) / 65535;
  c.relief.offset_mm = -random.real(0, 1) * 65535 * c.relief.scale_mm;
  double error = 65535 * c.relief.scale_mm * random.real(0.01, 1);
  c.oracle = std::make_shared<MadeUpMeshOracle>(c.relief, random.engine(), error);
  c.lod = std::make_unique<MeshLod>(
      std::make_shared<BaseMesh>(c.named.mesh), c.relief.depth, c.relief.offset_mm, c.relief.scale_mm, c.oracle,
      random.chance(0.8) ? c.oracle->coarse(c.named.mesh.patches.size()) : std::vector<CoarseErrors>{});
  c.camera = randomMeshCamera(c.named.mesh, c.relief.unitLog2(), random);
  double error_px = random.real(0.5, 8);
  c.view = random.chance(0.15) ? orthographicView(c.camera, glm::length(c.camera.eye - c.camera.target), error_px)
                               : makeView(c.camera, error_px);
  c.view.exaggerate = random.chance(0.3) ? random.real(0, 3) : 1;
  c.view.relief = !random.chance(0.1);
  c.view.min_cell_px = random.chance(0.3) ? random.real(0.5, 4) : 0;
  c.resident = randomMeshResidency(*c.lod, c.view, random);
  return c;
}
// The same with tails, often from further away, where patches are small.
struct MeshTailCase : MeshCase {
  explicit MeshTailCase(uint64_t seed, const NamedMesh& mesh) : MeshCase(randomMeshCase(seed, mesh)) {
    Random random(seed ^ 0x7A11);
    lod = std::make_unique<MeshLod>(std::make_shared<BaseMesh>(named.mesh), relief.depth, relief.offset_mm,
                                    relief.scale_mm, oracle, oracle->coarse(named.mesh.patches.size()), true);
    view.hide_backs = false;
    if (random.chance(0.6)) view.error_px *= std::exp(random.real(0, 5));
    resident = randomMeshResidency(*lod, view, random);
    const double lost = random.chance(0.5) ? 0.5 : 0;
    if (random.chance(0.1)) resident.clear();
    std::erase_if(resident, [&](const NodeId& n) { return n.level == 0 && random.chance(lost); });
  }
};
inline std::string describe(const MeshCase& c, uint64_t seed) {
  return "seed " + std::to_string(seed) + ", " + c.named.name + ", relief depth " + std::to_string(c.relief.depth) +
         ", " + std::to_string(c.resident.size()) + " pages resident";
}
inline std::vector<NamedMesh> allMeshes() {
  std::vector<NamedMesh> meshes = wellShapedMeshes();
  for (NamedMesh& hard : hardMeshes()) meshes.push_back(std::move(hard));
  return meshes;
}

}  // namespace relievo::test
