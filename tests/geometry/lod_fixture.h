// lod_fixture.h - artworks, views and residency for the tests of the planar LOD, all from one seed.
#pragma once

#include <cmath>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <random>
#include <unordered_map>
#include <vector>

#include <glm/gtc/matrix_transform.hpp>

#include "geometry/lod/morph.h"
#include "geometry/lod/patch_vertex.h"
#include "geometry/lod/planar_lod.h"
#include "tests/view_share.h"

namespace relievo::test {

inline uint64_t mix(uint64_t v) {
  v = (v ^ (v >> 31)) * 0x9E3779B97F4A7C15ull;
  v = (v ^ (v >> 29)) * 0xBF58476D1CE4E5B9ull;
  return v ^ (v >> 32);
}

// One 16-bit height for every place of an artwork: noise, so that no two different places agree by chance (but 1 in
// 65536).
inline uint16_t noiseHeight(int64_t x_units, int64_t y_units) {
  return static_cast<uint16_t>(
      mix(static_cast<uint64_t>(x_units) * 0x100000001B3ull + static_cast<uint64_t>(y_units)) >> 48);
}

using HeightFunction = uint16_t (*)(int64_t x_units, int64_t y_units);

// Relief pages as the builder defines them: the height at the sample's place, clamped to the artwork. Computed when
// looked at.
class ReliefPages {
 public:
  struct Page {
    const ReliefPages& pages;
    int spacing_log2;
    int64_t x0, y0;
    uint16_t operator[](size_t index) const {
      auto i = static_cast<int64_t>(index % kReliefSamples), j = static_cast<int64_t>(index / kReliefSamples);
      return pages.height_(std::min(x0 + (i << spacing_log2), pages.right_),
                           std::min(y0 + (j << spacing_log2), pages.bottom_));
    }
  };
  ReliefPages(const FlatDomain& domain, HeightFunction height) : domain_(domain), height_(height) {
    right_ = static_cast<int64_t>(domain.width_px) << kUnitsPerTexelLog2;
    bottom_ = static_cast<int64_t>(domain.height_px) << kUnitsPerTexelLog2;
  }
  Page operator()(const NodeId& page) const {
    int spacing = reliefSpacingLog2(domain_, page.level);
    return {*this, spacing,
            (static_cast<int64_t>(domain_.patchOriginX(page.patch)) << kUnitsPerTexelLog2) +
                (static_cast<int64_t>(page.x) << (spacing + 7)),
            (static_cast<int64_t>(domain_.patchOriginY(page.patch)) << kUnitsPerTexelLog2) +
                (static_cast<int64_t>(page.y) << (spacing + 7))};
  }

 private:
  FlatDomain domain_;
  HeightFunction height_;
  int64_t right_, bottom_;
};

// Made-up bounds: errors fall by about 2 a level, with rough and smooth places; monotone down the tree. narrowing: the
// range of heights falls too, as a real relief's does; else every page claims the whole range.
class MadeUpOracle final : public ReliefOracle {
 public:
  MadeUpOracle(const FlatDomain& domain, uint64_t seed, bool narrowing = false)
      : domain_(domain), seed_(seed), narrowing_(narrowing) {}
  HeightBounds bounds(const NodeId& page) const override {
    double low = domain_.relief_offset_mm, high = low + 65535 * domain_.relief_scale_mm, error = high - low;
    for (uint32_t level = 0; level <= page.level; ++level) {
      uint64_t h = mix(seed_ ^ mix(packNode(page.ancestor(level))));
      error *= 0.2 + 0.8 * static_cast<double>(h >> 11) * 0x1p-53;
      if (!narrowing_ || level == 0) continue;
      double width = (high - low) * (0.4 + 0.4 * static_cast<double>(h & 255) / 255),
             at = static_cast<double>((h >> 8) & 255) / 255;
      low += (high - low - width) * at;
      high = low + width;
    }
    return {static_cast<float>(low), static_cast<float>(high), static_cast<float>(std::min(error, high - low))};
  }

 private:
  FlatDomain domain_;
  uint64_t seed_;
  bool narrowing_;
};

inline FlatDomain makeDomain(uint64_t width_px, uint64_t height_px, int relief_depth_minus_texture_depth) {
  FlatDomain d;
  d.width_px = width_px;
  d.height_px = height_px;
  d.mm_per_px = 0.05;
  d.texture_depth = FlatDomain::depthFor(width_px, height_px);
  d.relief_depth = std::clamp(d.texture_depth + relief_depth_minus_texture_depth, 0, static_cast<int>(kMaxNodeLevel));
  d.relief_scale_mm = 0.01 * static_cast<double>(std::min(width_px, height_px)) * d.mm_per_px / 65535 + 1e-7;
  d.relief_offset_mm = -0.3 * 65535 * d.relief_scale_mm;
  return d;
}

struct Camera {
  glm::dvec3 eye{0, 0, 100}, target{0};
  double fov_y = 0.8, aspect = 1.5, near_mm = 0.1, far_mm = 1e5;
  double viewport_height_px = 720;
};

inline LodView makeView(const Camera& c, double error_px = 1.0) {
  LodView v;
  glm::dvec3 forward = glm::normalize(c.target - c.eye);
  glm::dvec3 up = std::abs(forward.y) > 0.99 ? glm::dvec3(0, 0, 1) : glm::dvec3(0, 1, 0);
  v.clip_from_world = glm::perspective(c.fov_y, c.aspect, c.near_mm, c.far_mm) * glm::lookAt(c.eye, c.target, up);
  v.eye_mm = c.eye;
  v.pixels_per_radian = c.viewport_height_px / (2 * std::tan(c.fov_y / 2));
  v.near_mm = c.near_mm;
  v.error_px = error_px;
  return v;
}
// From the same side, height_mm of the world over the picture's height.
inline LodView orthographicView(const Camera& c, double height_mm, double error_px) {
  LodView v = makeView(c, error_px);
  glm::dvec3 forward = glm::normalize(c.target - c.eye);
  glm::dvec3 up = std::abs(forward.y) > 0.99 ? glm::dvec3(0, 0, 1) : glm::dvec3(0, 1, 0);
  double h = 0.5 * height_mm;
  v.clip_from_world =
      glm::ortho(-h * c.aspect, h * c.aspect, -h, h, -c.far_mm, c.far_mm) * glm::lookAt(c.eye, c.target, up);
  v.pixels_per_radian = c.viewport_height_px / height_mm;
  return v;
}

// What a drawn list deviates from the finest surface, in a picture.
struct Measured {
  double max_px = 0;
  uint64_t samples = 0;
};

struct Random {
  std::mt19937_64 engine;
  explicit Random(uint64_t seed) : engine(seed) {}
  double real(double a, double b) { return a + (b - a) * static_cast<double>(engine() >> 11) * 0x1p-53; }
  int integer(int a, int b) { return a + static_cast<int>(engine() % static_cast<uint64_t>(b - a + 1)); }
  bool chance(double p) { return real(0, 1) < p; }
};

// Anywhere in front of the artwork: from all of it in view to a texel across the screen, straight or grazing.
inline Camera randomCamera(const FlatDomain& d, Random& random) {
  double w = static_cast<double>(d.width_px) * d.mm_per_px, h = static_cast<double>(d.height_px) * d.mm_per_px;
  Camera c;
  c.fov_y = random.real(0.2, 1.6);
  c.aspect = random.real(0.5, 2.5);
  c.target = {random.real(-0.5, 0.5) * w, random.real(-0.5, 0.5) * h, 0};
  double distance = std::exp(random.real(std::log(4 * d.mm_per_px), std::log(3 * std::max(w, h) + 8 * d.mm_per_px)));
  double tilt = random.chance(0.5) ? random.real(0, 0.5) : random.real(0.5, 1.55), turn = random.real(0, 6.2832);
  c.eye = c.target +
          distance * glm::dvec3(std::sin(tilt) * std::cos(turn), std::sin(tilt) * std::sin(turn), std::cos(tilt));
  c.near_mm = distance * random.real(0.001, 0.3);
  c.far_mm = distance * 1000 + 10 * std::max(w, h);
  return c;
}

inline FlatDomain randomDomain(Random& random) {
  static constexpr uint64_t kSizes[][2] = {{1, 1},           {3, 1},
                                           {1, 500},         {128, 128},
                                           {129, 128},       {200, 131},
                                           {1000, 700},      {5000, 300},
                                           {300, 4000},      {4096, 4096},
                                           {777, 9001},      {1u << 20, 64},
                                           {1u << 20, 1000}, {1000, (1u << 20) - 3},
                                           {30000, 20001},   {(1u << 24) - 5, (1u << 24) - 77},
                                           {100003, 65537}};
  const auto& size = kSizes[random.integer(0, static_cast<int>(std::size(kSizes)) - 1)];
  return makeDomain(size[0], size[1], random.chance(0.15) ? -static_cast<int>(kMaxNodeLevel) : random.integer(-3, 4));
}

// Pages as they may have arrived: some rounds of asking, each want granted or not, some pages lost again.
inline ReliefSet randomResidency(const FlatDomain& domain, const ReliefOracle& oracle, const LodView& view,
                                 Random& random) {
  ReliefSet resident;
  int rounds = random.integer(0, 5);
  double granted = random.real(0.3, 1), lost = random.chance(0.5) ? 0 : random.real(0, 0.3);
  for (int round = 0; round < rounds; ++round) {
    for (const ReliefRequest& request : selectPlanarLod(domain, oracle, view, resident).requests)
      if (random.chance(granted)) resident.insert(request.page);
    std::erase_if(resident, [&](const NodeId& n) {
      return random.engine() % 1000 < static_cast<uint64_t>(lost * 1000) && n.level > 0;
    });
  }
  return resident;
}

// ---- random cases
struct PlanarCase {
  FlatDomain domain;
  std::shared_ptr<MadeUpOracle> oracle;
  Camera camera;
  LodView view;
  ReliefSet resident;
};
// narrowing: see MadeUpOracle; a claim about heights that the noise of the pages does not keep.
inline PlanarCase randomPlanarCase(uint64_t seed, bool narrowing = true) {
  Random random(seed);
  PlanarCase c;
  c.domain = randomDomain(random);
  c.oracle = std::make_shared<MadeUpOracle>(c.domain, random.engine(), narrowing);
  c.camera = randomCamera(c.domain, random);
  c.view = makeView(c.camera, random.real(0.7, 4));
  c.view.exaggerate = random.chance(0.3) ? random.real(0, 5) : 1;
  c.view.relief = !random.chance(0.05);
  c.resident = randomResidency(c.domain, *c.oracle, c.view, random);
  return c;
}
inline std::string describe(const PlanarCase& c, uint64_t seed) {
  return "seed " + std::to_string(seed) + ", " + std::to_string(c.domain.width_px) + " x " +
         std::to_string(c.domain.height_px) + ", relief depth " + std::to_string(c.domain.relief_depth) + " of " +
         std::to_string(c.domain.texture_depth) + ", " + std::to_string(c.resident.size()) + " pages resident";
}

// Lists and what they promise, in every particular.
inline bool sameList(const LodResult& a, const LodResult& b) {
  auto sameRequest = [](const ReliefRequest& p, const ReliefRequest& q) {
    return p.page == q.page && p.priority == q.priority;
  };
  return a.limited_by_residency == b.limited_by_residency && a.max_error_px == b.max_error_px &&
         a.error_px == b.error_px && a.instances == b.instances &&
         std::equal(a.requests.begin(), a.requests.end(), b.requests.begin(), b.requests.end(), sameRequest);
}

// ---- a drawn list as places
struct Placed {
  const PatchInstance* instance = nullptr;
  int64_t x0, y0, size;  // units
};
// By level and place along the strip; answers which drawn nodes lie beside a place.
class PlacedIndex {
 public:
  PlacedIndex(const FlatDomain& domain, const std::vector<PatchInstance>& instances)
      : unit_log2_(domain.texture_depth + 7 + kUnitsPerTexelLog2) {
    for (const PatchInstance& p : instances) {
      int64_t size = int64_t{1} << (unit_log2_ - static_cast<int>(p.node.level));
      placed_[{static_cast<int>(p.node.level), p.x0 / size, p.y0 / size}] = {&p, p.x0, p.y0, size};
      levels_ = std::max(levels_, static_cast<int>(p.node.level));
    }
  }
  const std::map<std::array<int64_t, 3>, Placed>& all() const { return placed_; }
  const Placed* at(int level, int64_t x, int64_t y) const {
    auto found = placed_.find({level, x, y});
    return found == placed_.end() ? nullptr : &found->second;
  }
  // The drawn node that covers a place (half open), of any level.
  const Placed* covering(int64_t x_units, int64_t y_units, int* count = nullptr) const {
    const Placed* result = nullptr;
    for (int level = 0; level <= levels_; ++level) {
      int shift = unit_log2_ - level;
      if (const Placed* p = at(level, x_units >> shift, y_units >> shift)) {
        result = p;
        if (count) ++*count;
      }
    }
    return result;
  }
  int unitLog2() const { return unit_log2_; }
  int levels() const { return levels_; }

 private:
  int unit_log2_, levels_ = 0;
  std::map<std::array<int64_t, 3>, Placed> placed_;
};

// ---- watertightness
using VertexFunction = std::function<PatchVertex(const PatchInstance&, uint32_t i, uint32_t j)>;
struct SeamVertex {
  int64_t x, y;  // units, before clamping
  PatchVertex vertex;
  friend bool operator==(const SeamVertex&, const SeamVertex&) = default;
};
struct SeamReport {
  uint64_t pairs = 0, comparisons = 0, mismatches = 0;
  void operator+=(const SeamReport& o) { pairs += o.pairs, comparisons += o.comparisons, mismatches += o.mismatches; }
};

// Where a grid's vertex goes, in grid steps. Levels with geomorph (morph.h) have ownVertex instead of snapVertex.
using SnapFunction = std::array<uint32_t, 2> (*)(uint32_t i, uint32_t j, const PatchInstance&);
inline std::array<uint32_t, 2> ownVertex(uint32_t i, uint32_t j, const PatchInstance& p) {
  return vertexOnBorder(i, j, p).own;
}
inline std::array<uint32_t, 2> unsnappedVertex(uint32_t i, uint32_t j, const PatchInstance&) {
  return {i, j};
}  // a negative control

// The distinct vertices of one side, in order.
inline std::vector<SeamVertex> sideVertices(const PatchInstance& p, int side, const VertexFunction& vertex,
                                            SnapFunction snap) {
  std::vector<SeamVertex> out;
  uint32_t last = 1u << p.grid_level;
  for (uint32_t k = 0; k <= last; ++k) {
    uint32_t i = side == kLeft ? 0 : side == kRight ? last : k, j = side == kTop ? 0 : side == kBottom ? last : k;
    const std::array<uint32_t, 2> g = snap(i, j, p);
    SeamVertex v{p.x0 + (int64_t{g[0]} << p.step_log2), p.y0 + (int64_t{g[1]} << p.step_log2), vertex(p, i, j)};
    if (out.empty() || !(out.back() == v)) out.push_back(v);
  }
  return out;
}

// Compares both sides of every segment that two drawn nodes share: the same places, the same bits, none on one side
// alone.
inline SeamReport compareSeams(const FlatDomain& domain, const std::vector<PatchInstance>& instances,
                               const VertexFunction& vertex, SnapFunction snap = snapVertex) {
  PlacedIndex index(domain, instances);
  SeamReport report;
  auto compare = [&](const Placed& a, int side_a, const Placed& b, int side_b) {
    bool upright = side_a == kLeft || side_a == kRight;
    int64_t from = upright ? std::max(a.y0, b.y0) : std::max(a.x0, b.x0);
    int64_t to = from + std::min(a.size, b.size);
    auto within = [&](const Placed& p, int side) {
      std::vector<SeamVertex> v = sideVertices(*p.instance, side, vertex, snap);
      std::erase_if(v, [&](const SeamVertex& s) { return (upright ? s.y : s.x) < from || (upright ? s.y : s.x) > to; });
      return v;
    };
    std::vector<SeamVertex> va = within(a, side_a), vb = within(b, side_b);
    ++report.pairs;
    report.comparisons += std::max(va.size(), vb.size());
    if (va.size() != vb.size()) {
      report.mismatches += std::max(va.size(), vb.size());
      return;
    }
    for (size_t i = 0; i < va.size(); ++i) report.mismatches += !(va[i] == vb[i]);
  };
  static constexpr int kDx[4] = {-1, 1, 0, 0}, kDy[4] = {0, 0, -1, 1}, kOpposite[4] = {kRight, kLeft, kBottom, kTop};
  for (const auto& [place, p] : index.all()) {
    int level = static_cast<int>(place[0]);
    for (int side = 0; side < 4; ++side) {
      int64_t x = place[1] + kDx[side], y = place[2] + kDy[side];
      if (x < 0 || y < 0) continue;
      // Same level (once a pair), or a coarser neighbour (the finer one looks; any level difference, so imbalance shows
      // too).
      if (const Placed* same = index.at(level, x, y)) {
        if (side == kRight || side == kBottom) compare(p, side, *same, kOpposite[side]);
        continue;
      }
      for (int up = 1; up <= level; ++up)
        if (const Placed* coarser = index.at(level - up, x >> up, y >> up)) {
          compare(p, side, *coarser, kOpposite[side]);
          break;
        }
    }
  }
  return report;
}

}  // namespace relievo::test
