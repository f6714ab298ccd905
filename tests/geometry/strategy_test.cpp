// LOD strategies without a GPU: the registry, their lists, and the bounds that they share.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>
#include <set>
#include <span>
#include <sstream>

#include "geometry/strategies/lod_strategy.h"
#include "geometry/strategies/strategy_bounds.h"
#include "tests/geometry/lod_fixture.h"
#include "tests/view_share.h"

namespace relievo::test {
namespace strategy_test {

constexpr uint64_t kSeed = 20101;

StrategyScene madeUpScene(uint64_t width_px, uint64_t height_px) {
  StrategyScene scene;
  const FlatDomain domain = makeDomain(width_px, height_px, 0);
  scene.domain = domain;
  scene.oracle = std::make_shared<MadeUpOracle>(domain, kSeed, true);
  auto resident = std::make_shared<ReliefSet>();
  for (int level = 0; level <= scene.domain.relief_depth; ++level)
    for (uint32_t patch = 0; patch < scene.domain.patchCount(); ++patch)
      for (uint32_t y = 0; y < 1u << level; ++y)
        for (uint32_t x = 0; x < 1u << level; ++x)
          if (NodeId n{patch, static_cast<uint32_t>(level), x, y}; scene.domain.nodeExists(n)) resident->insert(n);
  scene.resident = resident;
  auto field = std::make_shared<ReliefField>(domain);
  ReliefPages pages(domain, noiseHeight);
  for (const NodeId& n : *resident)
    if (static_cast<int>(n.level) == scene.domain.relief_depth) field->setPage(n, pages(n));
  scene.field = field;
  return scene;
}

// Making simplified meshes of it takes the time of two tests.
StrategyScene pictureScene() {
  const uint64_t share = kSanitized ? 4 : longTests() ? 1 : 2;
  return madeUpScene(750 / share, 550 / share);
}

TEST(Strategies, AreNamedOnceAndControlsComeLast) {
  std::set<std::string> names;
  bool control = false;
  for (const StrategyEntry& e : lodStrategies()) {
    EXPECT_TRUE(names.insert(e.name).second) << e.name;
    EXPECT_FALSE(e.title.empty() || e.purpose.empty()) << e.name;
    EXPECT_TRUE(e.make) << e.name;
    EXPECT_EQ(findStrategy(e.name), &e);
    EXPECT_TRUE(!control || e.control) << e.name << " after a control";
    control = control || e.control;
  }
  EXPECT_EQ(findStrategy("nobody"), nullptr);
  EXPECT_GE(names.size(), 8u);
}

// A new strategy is one file, its declaration and its line in the registry: nothing else asks for a name.
TEST(Strategies, NobodyElseKnowsTheirNames) {
  namespace fs = std::filesystem;
  int files = 0, own = 0;
  for (const char* folder : {"geometry", "src", "tools"})
    for (const auto& entry : fs::recursive_directory_iterator(fs::path(RELIEVO_SOURCE_DIR) / folder)) {
      std::string ending = entry.path().extension().string(), name = entry.path().filename().string();
      if (ending != ".cpp" && ending != ".h") continue;
      std::stringstream text;
      text << std::ifstream(entry.path()).rdbuf();
      ++files;
      int known = 0;
      for (const StrategyEntry& e : lodStrategies())
        if (text.str().find("\"" + e.name + "\"") != std::string::npos) ++known;
      if (name.starts_with("strategy_")) {
        EXPECT_LE(known, 1) << entry.path();
        own += known;
      } else if (name != "lod_strategy.h") {
        EXPECT_EQ(known, 0) << entry.path();
      }
    }
  EXPECT_GT(files, 100);
  EXPECT_EQ(own, static_cast<int>(lodStrategies().size()));
}

// No place twice, none left out: the nodes' areas in view add up to the artwork where all of it is in view, and do not
// overlap.
TEST(Strategies, DrawEachPlaceOnceAndTheSameEveryTime) {
  for (auto [width, height] : {std::pair<uint64_t, uint64_t>{900, 700}, {2000, 310}, {300, 1500}}) {
    // Making simplified meshes takes the time.
    if (kSanitized || !test::longTests()) width /= 3, height /= 3;
    if (kSanitized && width > height) continue;
    StrategyScene scene = madeUpScene(width, height);
    Random random(kSeed);
    for (const StrategyEntry& e : lodStrategies()) {
      auto strategy = e.make(scene), again = e.make(scene);
      for (int k = 0; k < 6; k += kSanitized ? 5 : 1) {
        Camera camera = randomCamera(scene.domain.flat(), random);
        if (k == 0) {  // all in view
          camera = {};
          camera.eye = {0, 0, 4.0 * static_cast<double>(std::max(width, height)) * scene.domain.mm_per_px};
          camera.far_mm = 1e6;
        }
        LodView view = makeView(camera, std::exp(random.real(-0.5, 2)));
        if (k == 5) view = orthographicView(camera, glm::length(camera.eye - camera.target), view.error_px);
        StrategyResult chosen = strategy->select(view), other = again->select(view);
        EXPECT_EQ(chosen.instances, other.instances) << e.name;
        EXPECT_EQ(chosen.predicted_px, other.predicted_px) << e.name;
        EXPECT_EQ(chosen.instances, strategy->select(view).instances) << e.name << ": the same view again";
        EXPECT_EQ(chosen.ranges, strategy->select(view).ranges) << e.name << ": the same view again";
        EXPECT_EQ(chosen.ranges, other.ranges) << e.name;
        if (chosen.rule == GridRule::kTrianglesOnly)
          continue;  // no grids: see BisectionLeavesNoCracksAndKeepsItsBound, kept_mesh_test
        EXPECT_TRUE(std::is_sorted(chosen.instances.begin(), chosen.instances.end(), [](const auto& a, const auto& b) {
          return a.grid_level < b.grid_level;
        })) << e.name;
        std::set<NodeId> nodes;
        double area = 0;
        auto inside = [](int64_t from, int64_t size, int64_t border) {
          return static_cast<double>(std::min(from + size, border) - from);
        };
        for (const PatchInstance& p : chosen.instances) {
          EXPECT_TRUE(scene.resident->count(p.relief_page)) << e.name;
          EXPECT_TRUE(nodes.insert(p.node).second) << e.name;
          int64_t size = int64_t{1} << (p.step_log2 + p.grid_level);
          area += inside(p.x0, size, scene.field->widthUnits()) * inside(p.y0, size, scene.field->heightUnits());
        }
        for (const NodeId& n : nodes)
          for (uint32_t level = 0; level < n.level; ++level)
            EXPECT_FALSE(nodes.count(n.ancestor(level))) << e.name << ": a node and its ancestor";
        double whole = static_cast<double>(scene.field->widthUnits()) * static_cast<double>(scene.field->heightUnits());
        if (k == 0) {
          EXPECT_EQ(area, whole) << e.name;
        }
        EXPECT_LE(area, whole) << e.name;
      }
    }
  }
}

TEST(Strategies, ThatKeepTheBudgetPromiseNoMoreThanTwice) {
  StrategyScene scene = pictureScene();
  Random random(kSeed + 1);
  int kept = 0;
  for (const StrategyEntry& e : lodStrategies()) {
    auto strategy = e.make(scene);
    for (int k = 0; k < 20; k += kSanitized ? 3 : 1) {
      const Camera camera = randomCamera(scene.domain.flat(), random);
      LodView view = makeView(camera, std::exp(random.real(-0.5, 2)));
      if (k % 4 == 3) view = orthographicView(camera, glm::length(camera.eye - camera.target), view.error_px);
      StrategyResult chosen = strategy->select(view);
      if (!e.keeps_budget) continue;
      EXPECT_LE(chosen.predicted_px, 2 * chosen.error_px * (1 + 1e-9)) << e.name;
      EXPECT_GE(chosen.error_px, view.error_px);
      ++kept;
    }
  }
  EXPECT_GE(kept, kSanitized ? 14 : 40);
}

// Coarser budgets never draw more; a budget that nothing exceeds draws little.
TEST(Strategies, DrawLessForALargerBudget) {
  StrategyScene scene = pictureScene();
  for (const StrategyEntry& e : lodStrategies()) {
    for (bool orthographic : {false, true}) {
      auto strategy = e.make(scene);
      size_t cells_before = ~size_t{0};
      Camera camera;
      camera.eye = {5, -30, 40};
      camera.target = {0, 0, 0};
      for (double budget : {0.25, 1.0, 4.0, 16.0, 64.0}) {
        LodView view = orthographic ? orthographicView(camera, 40, budget) : makeView(camera, budget);
        view.min_cell_px = 2 * budget;
        size_t cells = 0;
        const StrategyResult chosen = strategy->select(view);
        if (chosen.rule == GridRule::kTrianglesOnly) cells = chosen.triangleCount() / 2;
        else
          for (const PatchInstance& p : chosen.instances) cells += size_t{1} << (2 * p.grid_level);
        EXPECT_LE(cells, cells_before) << e.name << " at " << budget << " px";
        cells_before = cells;
      }
      EXPECT_LT(cells_before, 20000u) << e.name << (orthographic ? ", orthographic" : "");
    }
  }
}

// Where an edge of one triangle ends, its neighbours have that vertex, too: no vertex lies inside another's edge. All
// triangles together cover what is in view, and the predicted bound holds at every sample.
TEST(Strategies, BisectionLeavesNoCracksAndKeepsItsBound) {
  for (auto [width, height] : {std::pair<uint64_t, uint64_t>{256, 256}, {300, 180}, {500, 130}}) {
    StrategyScene scene = madeUpScene(width, height);
    const ReliefField& field = *scene.field;
    auto strategy = findStrategy("bintree")->make(scene);
    // Slanting by 45 degrees without perspective, so that a step of height is as many pixels everywhere.
    const double size_mm = 4.0 * static_cast<double>(std::max(width, height)) * scene.domain.mm_per_px;
    Camera camera;
    camera.eye = {0, -size_mm, size_mm};
    camera.far_mm = 1e6;
    for (const double budget : kSanitized ? std::vector{3.0} : std::vector{0.02, 0.3, 3.0}) {
      const LodView view = orthographicView(camera, size_mm, budget);
      const StrategyResult chosen = strategy->select(view);
      ASSERT_EQ(chosen.triangles.size() % 3, 0u);
      using Place = std::pair<int64_t, int64_t>;
      auto placeOf = [&](const StrategyVertex& v) {
        return Place{std::min<int64_t>(v.x, field.widthUnits()), std::min<int64_t>(v.y, field.heightUnits())};
      };
      // Edges within the artwork that an odd number of triangles has.
      auto openEdges = [&](std::span<const StrategyVertex> triangles) {
        std::map<std::pair<Place, Place>, int> edges;
        for (size_t k = 0; k < triangles.size(); k += 3)
          for (size_t i = 0; i < 3; ++i)
            ++edges[std::minmax(placeOf(triangles[k + i]), placeOf(triangles[k + (i + 1) % 3]))];
        return std::count_if(edges.begin(), edges.end(), [&](const auto& e) {
          const auto& [a, b] = e.first;
          const bool border = (a.first == b.first && (a.first == 0 || a.first == field.widthUnits())) ||
                              (a.second == b.second && (a.second == 0 || a.second == field.heightUnits()));
          return a != b && (e.second % 2 == 1) != border;
        });
      };
      EXPECT_EQ(openEdges(chosen.triangles), 0);
      EXPECT_GT(openEdges(std::span(chosen.triangles).subspan(3)), 0) << "the control: a triangle is missing";
      double area = 0;
      for (size_t k = 0; k < chosen.triangles.size(); k += 3) {
        std::array<Place, 3> p;
        for (size_t i = 0; i < 3; ++i) p[i] = placeOf(chosen.triangles[k + i]);
        area += 0.5 * std::abs(static_cast<double>((p[1].first - p[0].first) * (p[2].second - p[0].second) -
                                                   (p[1].second - p[0].second) * (p[2].first - p[0].first)));
      }
      EXPECT_EQ(area, static_cast<double>(field.widthUnits()) * static_cast<double>(field.heightUnits()));
      const double px_per_mm = view.pixels_per_radian * std::sqrt(0.5);
      double worst_px = 0;
      for (size_t k = 0; k < chosen.triangles.size(); k += 3) {
        const StrategyVertex* t = &chosen.triangles[k];
        const Place a = placeOf(t[0]), b = placeOf(t[1]), c = placeOf(t[2]);
        const double whole = static_cast<double>((b.first - a.first) * (c.second - a.second) -
                                                 (b.second - a.second) * (c.first - a.first));
        if (whole == 0) continue;
        for (int i = 0; i <= 8; ++i)
          for (int j = 0; i + j <= 8; ++j) {
            const double u = i / 8.0, v = j / 8.0;
            const double x = static_cast<double>(a.first) + u * static_cast<double>(b.first - a.first) +
                             v * static_cast<double>(c.first - a.first),
                         y = static_cast<double>(a.second) + u * static_cast<double>(b.second - a.second) +
                             v * static_cast<double>(c.second - a.second);
            const double drawn = t[0].height_steps + u * (t[1].height_steps - t[0].height_steps) +
                                 v * (t[2].height_steps - t[0].height_steps);
            worst_px = std::max(worst_px,
                                std::abs(drawn - field.heightSteps(x, y)) * scene.domain.relief_scale_mm * px_per_mm);
          }
      }
      EXPECT_LE(worst_px, chosen.predicted_px * 1.02 + 1e-6) << width << " x " << height << " at " << budget << " px";
      EXPECT_GT(worst_px, 0) << "the control: coarser than the relief";
      if (budget < 0.1) {
        EXPECT_GT(worst_px, 0.9 * chosen.predicted_px) << "the control: a smaller bound would not hold";
      }
      std::printf("[ figures  ] %llu x %llu at %g px: %zu triangles, off by %.3g px, predicted %.3g px\n",
                  static_cast<unsigned long long>(width), static_cast<unsigned long long>(height), budget,
                  chosen.triangles.size() / 3, worst_px, chosen.predicted_px);
    }
  }
}

// The length metric's segments are as short as it says, wherever there are finer samples to cut them by; and not
// everywhere much shorter.
TEST(Strategies, TheLengthMetricKeepsItsLengths) {
  StrategyScene scene = madeUpScene(1500, 1100);
  ReliefBounds3d bounds(scene);
  auto strategy = findStrategy("edge-length")->make(scene);
  Random random(kSeed + 2);
  int checked = 0, long_ones = 0;
  for (int k = 0; k < 20; ++k) {
    LodView view = makeView(randomCamera(scene.domain.flat(), random), random.real(2, 8));
    ViewBounds screen(view);
    for (const PatchInstance& p : strategy->select(view).instances) {
      int coarsest = p.grid_level;
      for (const auto& side : p.edges)
        coarsest =
            std::min<int>(coarsest, side[1] == PatchInstance::kWholeEdge ? side[0] : 1 + std::min(side[0], side[1]));
      int level = static_cast<int>(p.node.level) + coarsest;
      if (level >= bounds.finestLevel()) continue;
      // By the distance, which is never less than the depth.
      double cell_mm = std::ldexp(scene.domain.mm_per_px, bounds.unitLog2() - kUnitsPerTexelLog2 - level);
      double distance = std::max(screen.nearestMm(bounds.box(p.node, 1)), view.near_mm);
      double cell_px = cell_mm * view.pixels_per_radian / distance;
      EXPECT_LE(cell_px, 4 * view.error_px * (1 + 1e-9));
      ++checked;
      long_ones += cell_px > view.error_px;
    }
  }
  EXPECT_GT(checked, 200);
  EXPECT_GT(long_ones, checked / 4);
}

}  // namespace strategy_test
}  // namespace relievo::test
