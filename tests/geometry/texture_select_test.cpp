// CPU page requests against oracles that know nothing of nodes: every pixel's ray meets the plane (or a facet of
// the relief), and its footprint is measured by rays beside it, in double precision.
#include "geometry/lod/texture_select.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <set>

#include "tests/geometry/lod_fixture.h"
#include "tests/geometry/pixel_requests.h"

namespace relievo::test {
namespace texture_select_test {

constexpr uint64_t kSeed = 20261121;

// What all pixels of a flat artwork want; sampled off their centres, where a rasteriser may sample too.
std::set<NodeId> pixelsRequest(const FlatDomain& d, const TextureView& v, glm::dvec2 off = glm::dvec2(0)) {
  Rays rays(v);
  std::set<NodeId> wanted;
  NodeId last{~0u, 0, 0, 0};
  for (int y = 0; y < v.height_px; ++y) {
    for (int x = 0; x < v.width_px; ++x) {
      auto f = rays.footprint(d, x + 0.5 + off.x, y + 0.5 + off.y, glm::dvec3(0), glm::dvec3(0, 0, 1));
      if (!f) continue;
      int level = levelOf(d, v, *f);
      auto node = nodeAt(d, f->texel, level);
      if (!node) continue;
      if (v.anisotropy > 1 && level > 0) {  // the ends of the footprint
        for (double end : {-1.0, 1.0})
          if (auto tap = nodeAt(d, f->texel + end * tapReach(v, *f), level)) addWithAncestors(*tap, wanted);
      }
      if (*node == last) continue;
      last = *node;
      addWithAncestors(*node, wanted);
    }
  }
  return wanted;
}

struct Agreement {
  size_t wanted = 0, named = 0, missed = 0;
  size_t needless = 0,
         inexplicable = 0;  // named, not wanted; neither within the slack that the request source allows itself
  void operator+=(const Agreement& o) {
    wanted += o.wanted, named += o.named, missed += o.missed, needless += o.needless, inexplicable += o.inexplicable;
  }
  double recall() const { return wanted ? 1 - static_cast<double>(missed) / static_cast<double>(wanted) : 1; }
  double precision() const { return named ? 1 - static_cast<double>(needless) / static_cast<double>(named) : 1; }
  double precisionWithSlack() const {
    return named ? 1 - static_cast<double>(inexplicable) / static_cast<double>(named) : 1;
  }
};
Agreement agreement(const std::set<NodeId>& wanted, const std::vector<TextureRequest>& named) {
  Agreement a;
  std::set<NodeId> set;
  for (const TextureRequest& w : named) set.insert(w.node);
  a.wanted = wanted.size();
  a.named = named.size();
  for (const NodeId& n : wanted) a.missed += !set.contains(n);
  for (const NodeId& n : set) a.needless += !wanted.contains(n);
  return a;
}

std::string describe(const FlatDomain& d, const Camera& c) {
  char text[200];
  std::snprintf(text, sizeof text, "%llu x %llu, eye %.6g %.6g %.6g target %.6g %.6g fov %.4g",
                static_cast<unsigned long long>(d.width_px), static_cast<unsigned long long>(d.height_px), c.eye.x,
                c.eye.y, c.eye.z, c.target.x, c.target.y, c.fov_y);
  return text;
}

struct Flat {
  int views = 60, height_px = 120;
  bool orthographic = false;
  uint64_t seed = kSeed;
  std::function<void(Camera&, Random&)> camera;
  std::function<void(TextureView&)> settings, broken;  // broken: what the request source sees, but not the oracle
  std::function<void(std::vector<TextureRequest>&)> lose;
  std::vector<std::set<NodeId>>* known = nullptr;  // what the pixels of these views want, kept from run to run
};
Agreement flatAgreement(const Flat& f, bool report) {
  Random random(f.seed);
  Agreement total;
  const int views = report && kSanitized ? f.views / 4 : f.views;  // negative controls need them all
  for (int i = 0; i < views; ++i) {
    FlatDomain d = randomDomain(random);
    MadeUpOracle oracle(d, 1);
    Camera c = randomCamera(d, random);
    if (f.camera) f.camera(c, random);
    TextureView v = textureView(c, f.height_px, false, f.orthographic);
    v.lod_bias = -3;  // as many pages as eight times the size would have
    if (f.settings) f.settings(v);
    const bool is_known = f.known && static_cast<size_t>(i) < f.known->size();
    std::set<NodeId> wanted = is_known ? (*f.known)[static_cast<size_t>(i)] : pixelsRequest(d, v);
    if (f.known && !is_known) f.known->push_back(wanted);
    TextureView finer = v;
    finer.lod_bias -= kLodSlack;
    if (f.broken) f.broken(v);
    std::vector<TextureRequest> named = selectTextureNodes(d, oracle, v);
    if (f.lose) f.lose(named);
    Agreement a = agreement(wanted, named);
    a.inexplicable = a.needless;
    std::set<NodeId> within_slack = std::move(wanted);
    for (double x : {-kPixelSlack, 0.0, kPixelSlack}) {
      for (double y : {-kPixelSlack, 0.0, kPixelSlack}) {
        if (!report || a.inexplicable == 0)
          continue;  // each place is as much work as all above, and explains, if anything, more
        within_slack.merge(pixelsRequest(d, finer, {x, y}));
        a.inexplicable = agreement(within_slack, named).needless;
      }
    }
    total += a;
    if (report && a.missed)
      ADD_FAILURE() << "view " << i << " of seed " << f.seed << " missed " << a.missed << " of " << a.wanted << ": "
                    << describe(d, c);
  }
  return total;
}
void print(const char* what, const Agreement& a, bool flat = true) {
  std::printf("[ pages ] %s: seed %llu, %zu wanted, %zu named, recall %.4f %%, precision %.3f %%", what,
              static_cast<unsigned long long>(kSeed), a.wanted, a.named, 100 * a.recall(), 100 * a.precision());
  if (flat) std::printf(", %.3f %% within the slack", 100 * a.precisionWithSlack());
  std::printf("\n");
}

TEST(TextureSelect, FlatNothingIsMissed) {
  Agreement a = flatAgreement({}, true);
  print("flat", a);
  EXPECT_EQ(a.missed, 0u);
  EXPECT_GT(a.wanted, kSanitized ? 100u : 1000u);
  EXPECT_GT(a.precision(), 0.95);
  EXPECT_GT(a.precisionWithSlack(), 0.99);
}

TEST(TextureSelect, FlatWithinTheWholeRangeOfFieldsOfView) {
  for (double fov_deg : {1.0, 20.0, 90.0, 140.0, 170.0}) {
    Flat f;
    f.views = 25;
    f.camera = [&](Camera& c, Random&) { c.fov_y = fov_deg * 3.14159265358979 / 180; };
    Agreement a = flatAgreement(f, true);
    print(("field of view of " + std::to_string(static_cast<int>(fov_deg)) + " degrees").c_str(), a);
    EXPECT_EQ(a.missed, 0u);
    EXPECT_GT(a.precisionWithSlack(), fov_deg < 100 ? 0.99 : 0.9) << "at the horizon pages are hairlines";
  }
}

TEST(TextureSelect, FlatOrthographic) {
  Flat f;
  f.orthographic = true;
  f.views = 30;
  for (double ratio : {1.0, 8.0}) {
    f.settings = [&](TextureView& v) { v.anisotropy = ratio; };
    Agreement a = flatAgreement(f, true);
    print(ratio > 1 ? "orthographic, anisotropic" : "orthographic", a);
    EXPECT_EQ(a.missed, 0u);
    EXPECT_GT(a.wanted, kViewShare > 1 ? 50u : 200u);
    EXPECT_GT(ratio > 1 ? a.precision() : a.precisionWithSlack(), ratio > 1 ? 0.8 : 0.99);
  }
  std::vector<std::set<NodeId>> known;
  f.known = &known;
  f.settings = [&](TextureView& v) { v.lod_bias = -4; };
  f.broken = [](TextureView& v) { v.lod_bias += 0.3; };  // a view's pixels all want the same level
  EXPECT_GT(flatAgreement(f, false).missed, 5u) << "a third of a level too coarse";
  f.broken = [](TextureView& v) {  // the picture a twentieth larger: its border is not in view, its pixels are finer
    for (int column = 0; column < 4; ++column) v.clip_from_world[column][0] *= 1.05;
  };
  EXPECT_GT(flatAgreement(f, false).missed, 5u) << "another scale";
}

TEST(TextureSelect, FlatGrazing) {
  Flat f;
  f.views = 60;
  f.camera = [](Camera& c, Random& random) {
    double distance = glm::length(c.eye - c.target), tilt = random.real(1.5, 1.5707), turn = random.real(0, 6.2832);
    c.eye = c.target +
            distance * glm::dvec3(std::sin(tilt) * std::cos(turn), std::sin(tilt) * std::sin(turn), std::cos(tilt));
  };
  Agreement a = flatAgreement(f, true);
  print("grazing", a);
  EXPECT_EQ(a.missed, 0u);
  EXPECT_GT(a.precisionWithSlack(), 0.9);
}

TEST(TextureSelect, FlatFromBehindWithBiasAndNearestLevel) {
  Flat f;
  f.views = 60;
  f.camera = [](Camera& c, Random& random) {
    if (random.chance(0.5)) c.eye.z = -c.eye.z;
  };
  int view = 0;
  f.settings = [&](TextureView& v) {
    v.trilinear = ++view % 2 == 0;
    v.lod_bias = (view % 7) * 0.5 - 3;
  };
  Agreement a = flatAgreement(f, true);
  print("from behind too, biased, every other view with the nearest level", a);
  EXPECT_EQ(a.missed, 0u);
  EXPECT_GT(a.precisionWithSlack(), 0.99);
}

TEST(TextureSelect, FlatAnisotropic) {
  for (double ratio : {2.0, 8.0}) {
    Flat f;
    f.views = 40;
    f.settings = [&](TextureView& v) { v.anisotropy = ratio; };
    Agreement a = flatAgreement(f, true);
    print("anisotropic", a);
    EXPECT_EQ(a.missed, 0u);
    EXPECT_GT(a.precision(), 0.8) << "taps reach beyond the pixel; their pages are named too";
  }
}

TEST(TextureSelect, FlatNegativeControls) {
  std::vector<std::set<NodeId>> known;
  Flat f;
  f.known = &known;
  f.views = 40;
  f.lose = [](std::vector<TextureRequest>& named) {
    if (!named.empty()) named.pop_back();
  };
  EXPECT_GT(flatAgreement(f, false).missed, 10u) << "a page lost";
  f.lose = {};
  f.broken = [](TextureView& v) { v.lod_bias += 0.05; };
  EXPECT_GT(flatAgreement(f, false).missed, 10u) << "a twentieth of a level too coarse";
  f.broken = [](TextureView& v) { v.eye_mm.z *= 0.9; };
  EXPECT_GT(flatAgreement(f, false).missed, 10u) << "another eye";
  f.broken = [](TextureView& v) { v.width_px = v.width_px * 9 / 10; };
  EXPECT_GT(flatAgreement(f, false).missed, 10u) << "another size of the picture";
  f.broken = [](TextureView& v) { v.lod_bias -= 0.5; };
  Agreement fine = flatAgreement(f, false);
  EXPECT_EQ(fine.missed, 0u);
  EXPECT_LT(fine.precision(), 0.9) << "half a level too fine";
}

// ---- relief: a small artwork whose every facet is looked at
struct Terrain {
  FlatDomain domain;
  int64_t columns = 0, rows = 0;  // cells
  std::vector<double> heights;    // 0..1, a sample a cell's corner
  double height(int64_t i, int64_t j) const { return heights[static_cast<size_t>(j * (columns + 1) + i)]; }
  double spacing() const { return std::ldexp(1.0, domain.texture_depth - domain.relief_depth); }  // texels
  double mm(int64_t i, int64_t j) const {
    return domain.relief_offset_mm + 65535 * domain.relief_scale_mm * height(i, j);
  }
  glm::dvec3 place(int64_t i, int64_t j, double exaggerate) const {
    double x = static_cast<double>(i) * spacing(), y = static_cast<double>(j) * spacing();
    return {(x - 0.5 * static_cast<double>(domain.width_px)) * domain.mm_per_px,
            (0.5 * static_cast<double>(domain.height_px) - y) * domain.mm_per_px, mm(i, j) * exaggerate};
  }
};
class TerrainOracle final : public ReliefOracle {
 public:
  explicit TerrainOracle(const Terrain& t) : terrain_(t) {}
  HeightBounds bounds(const NodeId& page) const override {
    auto [known, added] = known_.try_emplace(page);
    if (added) known->second = measure(page);
    return known->second;
  }

 private:
  HeightBounds measure(const NodeId& page) const {
    const FlatDomain& d = terrain_.domain;
    int64_t cells = int64_t{kPagePx} << (d.relief_depth - static_cast<int>(page.level));
    auto x0 = static_cast<int64_t>(static_cast<double>(d.patchOriginX(page.patch)) / terrain_.spacing()) +
              static_cast<int64_t>(page.x) * cells;
    auto y0 = static_cast<int64_t>(static_cast<double>(d.patchOriginY(page.patch)) / terrain_.spacing()) +
              static_cast<int64_t>(page.y) * cells;
    const int64_t right = terrain_.columns, bottom = terrain_.rows;
    HeightBounds b{1e30f, -1e30f, 0};
    for (int64_t j = y0; j <= std::min(y0 + cells, bottom); ++j) {
      for (int64_t i = x0; i <= std::min(x0 + cells, right); ++i) {
        b.min_mm = std::min(b.min_mm, std::nextafter(static_cast<float>(terrain_.mm(i, j)), -1e30f));
        b.max_mm = std::max(b.max_mm, std::nextafter(static_cast<float>(terrain_.mm(i, j)), 1e30f));
      }
    }
    return b;
  }
  const Terrain& terrain_;
  mutable std::map<NodeId, HeightBounds> known_;
};

Terrain makeTerrain(int kind, double range_mm, int relief_shift) {
  Terrain t;
  t.domain = makeDomain(384, 256, relief_shift);
  t.domain.relief_scale_mm = range_mm / 65535;
  t.domain.relief_offset_mm = -0.4 * range_mm;
  t.columns = static_cast<int64_t>(static_cast<double>(t.domain.width_px) / t.spacing());
  t.rows = static_cast<int64_t>(static_cast<double>(t.domain.height_px) / t.spacing());
  for (int64_t j = 0; j <= t.rows; ++j)
    for (int64_t i = 0; i <= t.columns; ++i)
      t.heights.push_back(kind == 0   ? static_cast<double>(noiseHeight(i, j)) / 65535                       // rough
                          : kind == 1 ? 0.5 + 0.5 * std::sin(double(i) * 0.05) * std::cos(double(j) * 0.04)  // smooth
                                      : ((i / 23 + j / 31) % 2 ? 1.0 : 0.0));                                // walls
  return t;
}

// What pixels want of every facet in view that faces the eye, whether or not something hides it.
std::set<NodeId> facetsRequest(const Terrain& t, const TextureView& v) {
  Rays rays(v);
  std::set<NodeId> wanted;
  const int64_t right = t.columns, bottom = t.rows;
  for (int64_t j = 0; j < bottom; ++j) {
    for (int64_t i = 0; i < right; ++i) {
      const glm::dvec3 a = t.place(i, j, v.exaggerate), b = t.place(i + 1, j + 1, v.exaggerate);
      for (int half = 0; half < 2; ++half) {
        const glm::dvec3 c = half ? t.place(i, j + 1, v.exaggerate) : t.place(i + 1, j, v.exaggerate);
        glm::dvec3 middle = (a + b + c) / 3.0;
        glm::dvec4 clip = v.clip_from_world * glm::dvec4(middle, 1);
        double edge_x = 1 - 1.0 / v.width_px, edge_y = 1 - 1.0 / v.height_px;  // the outermost pixel centres
        if (!(clip.w > 0) || std::abs(clip.x) > clip.w * edge_x || std::abs(clip.y) > clip.w * edge_y ||
            std::abs(clip.z) > clip.w)
          continue;
        glm::dvec3 normal = glm::cross(b - a, c - a);
        if (normal.z < 0) normal = -normal;
        double x = (clip.x / clip.w + 1) * 0.5 * v.width_px, y = (1 - clip.y / clip.w) * 0.5 * v.height_px;
        if (glm::dot(normal, rays.direction(x, y)) >= 0) continue;
        auto f = rays.footprint(t.domain, x, y, middle, normal);
        if (!f) continue;
        if (auto node = nodeAt(t.domain, f->texel, levelOf(t.domain, v, *f))) addWithAncestors(*node, wanted);
      }
    }
  }
  return wanted;
}

Agreement reliefAgreement(const Terrain& t, int views, bool as_if_flat, bool report, double bias = -2,
                          bool orthographic = false) {
  TerrainOracle oracle(t);
  Random random(kSeed);
  Agreement total;
  for (int i = 0; i < views; ++i) {
    Camera c = randomCamera(t.domain, random);
    c.eye.z += 65535 * t.domain.relief_scale_mm * random.real(0, 1);
    TextureView v = textureView(c, 200, true, orthographic);
    v.exaggerate = random.chance(0.3) ? -1.5 : 1;
    v.lod_bias = bias;
    std::set<NodeId> wanted = facetsRequest(t, v);
    v.relief = !as_if_flat;
    Agreement a = agreement(wanted, selectTextureNodes(t.domain, oracle, v));
    total += a;
    if (report && a.missed)
      ADD_FAILURE() << "view " << i << " missed " << a.missed << " of " << a.wanted << ": " << describe(t.domain, c);
  }
  return total;
}

TEST(TextureSelect, ReliefNothingIsMissed) {
  for (int kind = 0; kind < 3; ++kind) {
    for (double range_mm : {0.0, 0.02, 1.0}) {
      for (int shift : {0, -1}) {
        Agreement a = reliefAgreement(makeTerrain(kind, range_mm, shift), kSanitized ? 3 : 12, false, true);
        char what[80];
        std::snprintf(what, sizeof what, "terrain %d, range %.2f mm, a sample every %d texels", kind, range_mm,
                      1 << -shift);
        print(what, a, false);
        EXPECT_EQ(a.missed, 0u);
        EXPECT_GT(a.wanted, kSanitized ? 5u : 50u);
      }
    }
  }
}

TEST(TextureSelect, ReliefOrthographic) {
  Agreement a;
  for (int kind = 0; kind < 3; ++kind)
    a += reliefAgreement(makeTerrain(kind, 1.0, 0), kSanitized ? 4 : 16, false, true, -2, true);
  print("orthographic, three terrains", a, false);
  EXPECT_EQ(a.missed, 0u);
  EXPECT_GT(a.wanted, kViewShare > 1 ? 30u : 150u);
  EXPECT_GT(reliefAgreement(makeTerrain(2, 1.0, 0), 16, true, false, -1, true).missed, 5u)
      << "walls, taken for a plane";
}

TEST(TextureSelect, ReliefNegativeControl) {
  EXPECT_GT(reliefAgreement(makeTerrain(2, 1.0, 0), 12, true, false, -1).missed, 5u) << "walls, taken for a plane";
}

// ---- form
TEST(TextureSelect, CoarseBeforeFineThenTheCentreEachOnceAfterItsParent) {
  Random random(kSeed);
  for (int i = 0; i < share(60); ++i) {
    FlatDomain d = randomDomain(random);
    MadeUpOracle oracle(d, 3, true);
    TextureView v = textureView(randomCamera(d, random), 180, random.chance(0.5));
    std::vector<TextureRequest> requests = selectTextureNodes(d, oracle, v);
    ASSERT_LE(requests.size(), kMaxTextureRequests);
    std::set<NodeId> seen;
    for (size_t k = 0; k < requests.size(); ++k) {
      const TextureRequest& w = requests[k];
      ASSERT_TRUE(d.nodeExists(w.node));
      ASSERT_LE(static_cast<int>(w.node.level), d.texture_depth);
      ASSERT_TRUE(seen.insert(w.node).second);
      ASSERT_TRUE(w.node.level == 0 || seen.contains(w.node.parent()));
      ASSERT_TRUE(w.priority >= 0 && w.priority <= 1);
      if (k == 0) continue;
      ASSERT_LE(requests[k - 1].node.level, w.node.level);
      ASSERT_TRUE(requests[k - 1].node.level < w.node.level || requests[k - 1].priority <= w.priority);
    }
  }
}

TEST(TextureSelect, ViewsThatAreNoneGetTheRoots) {
  FlatDomain d = makeDomain(5000, 300, 0);
  MadeUpOracle oracle(d, 3);
  const TextureView good = textureView({}, 100, false);
  const double nan = std::nan(""), infinite = std::numeric_limits<double>::infinity();
  std::vector<std::function<void(TextureView&)>> bad = {
      [&](TextureView& v) { v.clip_from_world[1][2] = nan; },
      [&](TextureView& v) { v.clip_from_world[3][3] = infinite; },
      [&](TextureView& v) { v.clip_from_world = glm::dmat4(0); },
      [&](TextureView& v) { v.clip_from_world = glm::dmat4(1), v.clip_from_world[3][3] = 0; },  // no w
      [&](TextureView& v) {
        v.clip_from_world = glm::dmat4({0, 0, 1, 0}, {0, 1, 0, 0}, {1, 0, 0, 0}, {0, 0, 0, 1});
      },  // orthographic, along the plane
      [&](TextureView& v) { v.eye_mm.x = nan; },
      [&](TextureView& v) { v.near_mm = 0; },
      [&](TextureView& v) { v.near_mm = nan; },
      [&](TextureView& v) { v.width_px = 0; },
      [&](TextureView& v) { v.height_px = -3; },
      [&](TextureView& v) { v.lod_bias = nan; },
      [&](TextureView& v) { v.exaggerate = infinite; },
      [&](TextureView& v) { v.anisotropy = 0.5; },
      [&](TextureView& v) { v.eye_mm.z = 0; }};
  for (size_t i = 0; i < bad.size(); ++i) {
    TextureView v = good;
    bad[i](v);
    std::vector<TextureRequest> requests = selectTextureNodes(d, oracle, v);
    ASSERT_EQ(requests.size(), d.patchCount()) << i;
    for (const TextureRequest& w : requests) EXPECT_EQ(w.node.level, 0u);
  }
}

TEST(TextureSelect, NeverMoreThanSlots) {
  FlatDomain d = makeDomain(1u << 20, 1u << 20, 0);
  MadeUpOracle oracle(d, 3);
  Camera c;
  c.eye = {0, 0, static_cast<double>(d.width_px) * d.mm_per_px * 0.8};
  TextureView v = textureView(c, 720, false);
  v.lod_bias = -9;  // texels of a five-hundredth of a pixel
  std::vector<TextureRequest> requests = selectTextureNodes(d, oracle, v);
  EXPECT_EQ(requests.size(), kMaxTextureRequests);
  std::set<NodeId> seen;
  for (const TextureRequest& w : requests) {
    ASSERT_TRUE(w.node.level == 0 || seen.contains(w.node.parent()));
    seen.insert(w.node);
  }
}

}  // namespace texture_select_test
}  // namespace relievo::test
