// relievo export: what a mesh file holds is compared with the surface evaluated here, straight from the definition
// S = P + h N, and read back by the project's own readers of meshes.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>
#include <random>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include "geometry/scan/mesh_read.h"
#include "tests/texturing/patch_fixture.h"
#include "tests/view_share.h"
#include "texturing/codec/resolve.h"
#include "texturing/import/image_io.h"
#include "texturing/package/package_builder.h"
#include "texturing/package/patch_package_builder.h"
#include "tools/export/map_atlas.h"
#include "tools/export/map_export.h"
#include "tools/export/mesh_export.h"
#include "tools/export/patch_levels.h"
#include "tools/export/patch_maps.h"
#include "tools/export/shared_vertices.h"
#include "tools/export/surface_rows.h"

namespace export_test {

using namespace relievo;
using namespace relievo::testing_support;

std::string bytesOf(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

// Noise over a ball of patches that lie every way round.
class ExportBall : public ::testing::Test {
 protected:
  static constexpr int kReliefDepth = 1, kFinest = 8;
  std::shared_ptr<const Package> packageOf(const PatchSource& source) {
    BuildOptions options;
    options.output = folder_.file("ball.relievo");
    const auto built = buildPatchPackage(source, options);
    EXPECT_TRUE(built.ok()) << built.error().text();
    auto package = Package::open(options.output);
    EXPECT_TRUE(package.ok()) << package.error().text();
    return *package;
  }
  MeshExportReport exported(const std::shared_ptr<const Package>& package, const std::string& name,
                            MeshExportOptions options = {}) {
    options.output = folder_.file(name);
    auto report = exportMesh(package, options);
    EXPECT_TRUE(report.ok()) << name << ": " << report.error().text();
    return report.ok() ? *report : MeshExportReport{};
  }
  LoadedMesh readBack(const std::string& name) {
    auto mesh = readMesh(folder_.file(name));
    EXPECT_TRUE(mesh.ok()) << name << ": " << mesh.error().text();
    return mesh.ok() ? std::move(*mesh) : LoadedMesh{};
  }
  ScratchFolder folder_;
};

TEST_F(ExportBall, MapsOfPatchesAreTheSameWithLessMemory) {
  const auto package = packageOf(NoisyPatches(cubeSphere(1, 40, 3), 1, kReliefDepth, 7));
  for (const ExportMap map : {ExportMap::kHeight, ExportMap::kNormal, ExportMap::kAlbedo})
    for (const int level : test::kSanitized ? std::vector{3} : std::vector{3, kFinest}) {
      MapExportOptions options;
      options.map = map;
      options.level = level;
      options.output = folder_.file("whole.tif");
      const auto whole = exportPatchMaps(package, options);
      ASSERT_TRUE(whole.ok()) << whole.error().text();
      EXPECT_EQ(whole->width, 3 * ((1 << level) + 1)) << "6 patches in 3 columns and 2 rows";
      EXPECT_EQ(whole->height, 2 * ((1 << level) + 1));
      int allowed = 0, refused = 0;
      for (uint64_t kib = 16 << 10; kib > 16; kib /= 2) {
        options.output = folder_.file("less.tif");
        options.memory_bytes = kib << 10;
        const auto less = exportPatchMaps(package, options);
        refused += !less.ok();
        if (!less) continue;
        ++allowed;
        EXPECT_TRUE(bytesOf(folder_.file("less.tif")) == bytesOf(folder_.file("whole.tif"))) << level << " " << kib;
      }
      EXPECT_GT(allowed, 2);
      EXPECT_GT(refused, 1);
    }
}

// Findings of anything but the direction of patches, which lie every way round here, and borders, which are counted
// apart.
std::string unexpectedFindings(const MeshDiagnosis& d) {
  std::string text;
  for (const MeshFinding& f : d.findings)
    if (f.what.find("flipped") == std::string::npos && f.what != "open borders")
      text += f.what + " (" + std::to_string(f.count) + "); ";
  return text;
}

TEST_F(ExportBall, WhatIsClosedComesOutClosedAtEveryLevelAndInEveryFormat) {
  const NoisyPatches source(cubeSphere(2, 40, 3), 0, kReliefDepth, 7);
  const auto package = packageOf(source);
  const uint64_t patches = source.base().patches.size();
  for (int level = 0; level <= (test::kSanitized ? 3 : kFinest); ++level) {
    for (const std::string format : {"ply", "obj", "off", "stl"}) {
      if (level > 4 && format != "ply" && format != "stl") continue;  // text of a million lines
      const std::string name = "ball." + format;
      const MeshExportReport report = exported(package, name, {.level = level});
      const uint64_t faces = patches * 2 << (2 * level);
      EXPECT_EQ(report.faces, faces);
      const LoadedMesh read = readBack(name);
      EXPECT_EQ(read.diagnosis.triangles_read, faces) << name << level;
      EXPECT_EQ(read.diagnosis.triangles, faces) << name << level;
      EXPECT_EQ(read.diagnosis.border_loops, 0u) << name << level;
      EXPECT_EQ(read.diagnosis.pieces, 1u) << name << level;
      // Euler: V - E + F = 2 of a ball, E = 3 F / 2.
      EXPECT_EQ(read.diagnosis.vertices, faces / 2 + 2) << name << level;
      if (format != "stl") {
        EXPECT_EQ(read.diagnosis.vertices_read, faces / 2 + 2) << name << level << ": welded by identity";
        EXPECT_EQ(report.vertices, faces / 2 + 2);
        EXPECT_EQ(unexpectedFindings(read.diagnosis), "") << name << level;
      }
    }
  }
}

// The same patches, none of which shares a corner with another.
BaseMesh cornersApart(BaseMesh mesh) {
  std::vector<BaseCorner> corners;
  for (auto& patch : mesh.patches)
    for (uint32_t& c : patch) {
      corners.push_back(mesh.corners[c]);
      c = static_cast<uint32_t>(corners.size() - 1);
    }
  mesh.corners = corners;
  return mesh;
}

// Control: what is open is seen to be open, and patches that share no corner to be apart.
TEST_F(ExportBall, WhatIsOpenComesOutOpen) {
  const NoisyPatches open(cubeSphere(2, 40, 3, true), 0, kReliefDepth, 7);
  exported(packageOf(open), "open.ply", {.level = 4});
  EXPECT_EQ(readBack("open.ply").diagnosis.border_loops, 1u);
  const BaseMesh apart = cornersApart(cubeSphere(2, 40, 3));
  const NoisyPatches torn(apart, 0, kReliefDepth, 7);
  exported(packageOf(torn), "torn.ply", {.level = 4});
  EXPECT_EQ(readBack("torn.ply").diagnosis.border_loops, apart.patches.size());
}

// Three patches at one side, which counts as border of each.
BaseMesh threeAtASide() {
  BaseMesh fan;
  for (const glm::vec3 p :
       {glm::vec3(0, 0, 0), {0, 10, 0}, {10, 0, 0}, {10, 10, 0}, {-10, 0, 0}, {-10, 10, 0}, {0, 0, 10}, {0, 10, 10}})
    fan.corners.push_back({p, glm::normalize(glm::vec3(0.3f, 0.1f, 1))});
  fan.patches = {{0, 2, 1, 3}, {0, 4, 1, 5}, {0, 6, 1, 7}};
  return fan;
}

// No builder makes a package of such heights; export refuses it as invalid data.
TEST_F(ExportBall, HeightsThatPatchesDoNotShareAreNoticed) {
  const BaseMesh base = cubeSphere(2, 40, 3);
  constexpr uint64_t kCells = 8;
  SharedVertices shared(base, uniformLevels(base.patches.size(), 3));
  for (const auto& [x, y] : {std::pair<uint64_t, uint64_t>{0, 0}, {kCells, 3}, {5, kCells}}) {
    const uint64_t i = shared.index(4, x, y);
    EXPECT_TRUE(shared.add(i, {0, 0, 1}, 700, {1, 2, 3}));
    EXPECT_TRUE(shared.add(i, {0, 2, 0}, 700, {9, 9, 9})) << "control";
    EXPECT_FALSE(shared.add(i, {0, 0, 1}, 701, {1, 2, 3}));
    EXPECT_EQ(shared[i].normal, glm::vec3(0, 2, 1));
    EXPECT_EQ(shared[i].colour, glm::u8vec3(1, 2, 3));
  }
}

// Only its corners are welded; its places still coincide.
TEST_F(ExportBall, ASideOfThreePatchesStaysThreeBordersAtOnePlace) {
  const auto package = packageOf(NoisyPatches(threeAtASide(), 0, 0, 7));
  constexpr uint64_t kCells = 8;
  const MeshExportReport report = exported(package, "fan.obj", {.level = 3});
  EXPECT_EQ(report.vertices, 3 * (kCells + 1) * (kCells + 1) - 2 * 2)
      << "two corners, each once instead of three times";
  std::ifstream in(folder_.file("fan.obj"));
  std::map<std::string, int> places;
  size_t vertices = 0;
  for (std::string line; std::getline(in, line);)
    if (line.starts_with("v ")) {
      std::istringstream text(line.substr(2));
      std::string x, y, z;
      text >> x >> y >> z;
      ++places[x + " " + y + " " + z], ++vertices;
    }
  EXPECT_EQ(vertices, report.vertices);
  EXPECT_EQ(places.size(), report.vertices - 2 * (kCells - 1)) << "the side's inner vertices are there three times";
}

TEST_F(ExportBall, SharedVerticesHaveTheSameBitsFromAllPatches) {
  const BaseMesh joined = cubeSphere(3, 40, 3);
  const auto package = packageOf(NoisyPatches(joined, 0, 0, 7));
  const ExportGrid grid(package, 6);
  const uint64_t n = grid.cellsPerPatchSide();
  const SharedVertices shared(joined, uniformLevels(joined.patches.size(), grid.level()));
  std::map<uint64_t, std::vector<glm::dvec3>> places;
  size_t others = 0;
  for (uint32_t p = 0; p < joined.patches.size(); ++p)
    for (uint64_t y = 0; y <= n; ++y)
      for (uint64_t x = 0; x <= n; x += y == 0 || y == n ? 1 : n) {
        const uint64_t i = shared.index(p, x, y);
        const ExportGrid::Ray ray = grid.ray(p, x, y);
        places[i].push_back(ray.at(0.1));
        others += ray.base != joined.point(p, std::nextafter(x / double(n), 0.5), y / double(n));
        const SharedVertices::Place place = shared.place(i);
        EXPECT_EQ(shared.index(place.patch, place.x, place.y), i);
      }
  EXPECT_EQ(places.size(), shared.size());
  for (const auto& [i, seen] : places) {
    EXPECT_GE(seen.size(), 2u) << "a closed mesh";
    for (const glm::dvec3& p : seen) EXPECT_TRUE(p == seen[0]) << i;
  }
  EXPECT_GT(others, places.size() / 2) << "control: a last bit more or less shows";
}

// Every vertex of the surface, and every one once, at the place that the definition gives.
TEST_F(ExportBall, VerticesAreThoseOfTheDefinition) {
  BaseMesh base = cubeSphere(1, 40, 5);
  base.origin_mm = {1, -2, 3};
  const NoisyPatches source(base, 0, kReliefDepth, 11);
  const auto package = packageOf(source);
  for (const int level : test::kSanitized ? std::vector{0, 3} : std::vector{0, 3, kFinest}) {
    exported(package, "ball.ply", {.level = level});
    const LoadedMesh read = readBack("ball.ply");
    using Key = std::array<int64_t, 3>;
    std::set<Key> expected;
    const int n = 1 << level, step = source.cells() / n;
    constexpr double kGrid = 1e-3;  // mm; far below the distances between vertices, far above what floats lose
    const auto keyOf = [&](const glm::dvec3& p) {
      return Key{std::llround(p.x / kGrid), std::llround(p.y / kGrid), std::llround(p.z / kGrid)};
    };
    const auto near = [&](const Key& k) {
      for (int64_t dx = -1; dx <= 1; ++dx)
        for (int64_t dy = -1; dy <= 1; ++dy)
          for (int64_t dz = -1; dz <= 1; ++dz)
            if (expected.contains({k[0] + dx, k[1] + dy, k[2] + dz})) return true;
      return false;
    };
    for (uint32_t p = 0; p < base.patches.size(); ++p)
      for (int y = 0; y <= n; ++y)
        for (int x = 0; x <= n; ++x) {
          const double u = x / double(n), v = y / double(n);
          const double h = source.reliefOffsetMm() + source.reliefScaleMm() * source.height(p, x * step, y * step);
          expected.insert(keyOf(base.origin_mm + base.point(p, u, v) + h * base.normal(p, u, v)));
        }
    size_t misses = 0;
    for (const glm::vec3& p : read.mesh.positions_mm) misses += !near(keyOf(read.mesh.origin_mm + glm::dvec3(p)));
    EXPECT_EQ(misses, 0u) << "level " << level;
    EXPECT_NEAR(static_cast<double>(read.mesh.positions_mm.size()), static_cast<double>(expected.size()),
                0.02 * static_cast<double>(expected.size()))
        << "rounding puts some vertices on two places of the grid";
    // Control: a height off by 1/100 of its range is seen.
    size_t off = 0;
    for (const glm::vec3& p : read.mesh.positions_mm) off += !near(keyOf(read.mesh.origin_mm + glm::dvec3(p) * 1.001));
    EXPECT_GT(off, read.mesh.positions_mm.size() / 2);
  }
}

// Cells are cut along (0,0)-(1,1) of each patch, as the format defines its surface.
TEST_F(ExportBall, CellsAreCutAlongTheFirstDiagonal) {
  const NoisyPatches source(cubeSphere(1, 40, 5), 0, 0, 11);
  exported(packageOf(source), "ball.ply", {.level = 0});
  const LoadedMesh read = readBack("ball.ply");
  const BaseMesh& base = source.base();
  using Key = std::array<long long, 3>;
  std::set<std::pair<Key, Key>> edges;
  const auto keyOf = [](const glm::dvec3& p) {
    return Key{std::llround(p.x * 100), std::llround(p.y * 100), std::llround(p.z * 100)};
  };
  for (const auto& t : read.mesh.triangles)
    for (size_t k = 0; k < 3; ++k) {
      const auto at = [&](size_t i) {
        return keyOf(read.mesh.origin_mm + glm::dvec3(read.mesh.positions_mm[t[i % 3]]));
      };
      edges.emplace(at(k), at(k + 1)), edges.emplace(at(k + 1), at(k));
    }
  const auto corner = [&](uint32_t p, int u, int v) {
    const double h = source.reliefOffsetMm() + source.reliefScaleMm() * source.height(p, 128 * u, 128 * v);
    return keyOf(base.point(p, u, v) + h * base.normal(p, u, v));  // the origin lies 3.7 m away: from there
  };
  for (uint32_t p = 0; p < base.patches.size(); ++p) {
    EXPECT_TRUE(edges.contains(std::pair(corner(p, 0, 0), corner(p, 1, 1)))) << p;
    EXPECT_FALSE(edges.contains(std::pair(corner(p, 1, 0), corner(p, 0, 1)))) << p;
  }
}

TEST_F(ExportBall, ErrorsChooseTheCoarsestLevelThatKeepsThem) {
  const NoisyPatches source(cubeSphere(1, 40, 5), 0, kReliefDepth, 11);
  const auto package = packageOf(source);
  for (int level = 0; level <= (test::kSanitized ? 2 : kFinest); ++level) {
    const MeshExportReport as_asked = exported(package, "a.ply", {.level = level});
    ASSERT_TRUE(as_asked.error_mm.has_value());
    EXPECT_EQ(*as_asked.error_mm == 0, level == kFinest);
    const MeshExportReport chosen = exported(package, "b.ply", {.error_mm = *as_asked.error_mm});
    EXPECT_LE(*chosen.error_mm, *as_asked.error_mm);
    EXPECT_LE(chosen.level, level);
    const MeshExportReport finer = exported(package, "c.ply", {.error_mm = *as_asked.error_mm * 0.999 - 1e-9});
    EXPECT_EQ(finer.level > level, level < kFinest);
  }
}

// What is left of a grid whose sides have fewer cells covers the patch once, and none of it is turned over.
TEST(PatchLevelsTest, TrianglesCoverThePatchWhateverItsSides) {
  const int finest = test::kSanitized ? 2 : 4;
  size_t snapped = 0, in_line = 0, left = 0;
  for (int grid = 0; grid <= finest; ++grid) {
    const int sides = grid + 1;
    for (int k = 0; k < sides * sides * sides * sides; ++k) {
      PatchLevels p{.grid = static_cast<uint8_t>(grid)};
      for (int s = 0, rest = k; s < 4; ++s, rest /= sides)
        p.sides[static_cast<size_t>(s)] = static_cast<uint8_t>(rest % sides);
      const uint64_t n = p.cells();
      int64_t area = 0;  // doubled
      uint64_t triangles = 0;
      const auto add = [&](uint64_t x, uint64_t y, bool above) {
        const auto a = p.snapped(x, y), b = above ? p.snapped(x + 1, y) : p.snapped(x + 1, y + 1),
                   c = above ? p.snapped(x + 1, y + 1) : p.snapped(x, y + 1);
        const auto of = [](const auto& q, size_t i) { return static_cast<int64_t>(q[i]); };
        const int64_t cross =
            (of(b, 0) - of(a, 0)) * (of(c, 1) - of(a, 1)) - (of(b, 1) - of(a, 1)) * (of(c, 0) - of(a, 0));
        EXPECT_GE(cross, 0) << "turned over";
        // Across a corner between two sides of half the cells one has its corners in a line: it fills a T-junction.
        const bool corners = a != b && b != c && c != a;
        EXPECT_EQ(p.hasTriangle(x, y, above), corners) << grid << " " << k << " " << x << " " << y;
        EXPECT_TRUE(corners || cross == 0);
        in_line += corners && cross == 0;
        area += cross;
        triangles += corners;
      };
      for (uint64_t y = 0; y < n; ++y)
        for (uint64_t x = 0; x < n; ++x) add(x, y, true), add(x, y, false);
      EXPECT_EQ(area, static_cast<int64_t>(2 * n * n));
      EXPECT_EQ(p.triangles(), triangles);
      EXPECT_EQ(p.isSnapped(), triangles < 2 * n * n);
      snapped += p.isSnapped();
      left += triangles;
    }
  }
  EXPECT_GT(snapped, 50u);
  EXPECT_LT(in_line, left / 100);
}

TEST(PatchLevelsTest, EachPatchIsAsFineAsItsErrorAndItsSidesAsBothNeed) {
  const BaseMesh ball = cubeSphere(6, 40, 3);
  const std::vector<PatchNeighbours> neighbours = patchNeighbours(ball);
  std::mt19937 random(5);
  std::uniform_real_distribution<double> exponent(-2, 2), fall(0.2, 1);
  std::vector<std::vector<float>> errors;
  for (size_t p = 0; p < ball.patches.size(); ++p) {
    std::vector<float>& e = errors.emplace_back();
    double at = std::pow(10, exponent(random));
    for (int level = 0; level < 7; ++level, at *= fall(random)) e.push_back(static_cast<float>(at));
    e.push_back(0);
  }
  size_t snapped = 0, coarse = 0;
  for (const double error : {0.0, 0.01, 0.1, 1.0, 1000.0}) {
    const std::vector<PatchLevels> levels = patchLevelsWithin(neighbours, errors, error);
    double bound = 0;
    uint8_t finest = 0;
    for (const PatchLevels& p : levels) finest = std::max(finest, p.grid);
    for (size_t p = 0; p < levels.size(); ++p) {
      EXPECT_LE(errors[p][levels[p].grid], error);
      bound = std::max(bound, double{errors[p][levels[p].grid]});
      uint8_t finest_side = 0;
      for (size_t s = 0; s < 4; ++s) {
        const PatchNeighbour& n = neighbours[p][s];
        const uint8_t side = levels[p].sides[s];
        EXPECT_EQ(side, levels[n.patch].sides[n.side]);
        finest_side = std::max(finest_side, side);
        if (side == levels[p].grid) continue;
        EXPECT_LT(side, levels[p].grid);
        EXPECT_LE(2 * errors[p][side], error) << "where levels meet, the error may be twice as large";
        bound = std::max(bound, 2 * double{errors[p][side]});
        ++snapped;
      }
      // No finer than itself, or a side, needs.
      EXPECT_TRUE(finest_side == levels[p].grid || errors[p][levels[p].grid - 1u] > error);
      coarse += levels[p].grid < finest;
    }
    EXPECT_EQ(errorOf(levels, errors), bound);
    EXPECT_EQ(levels == uniformLevels(levels.size(), 7), error == 0);
    EXPECT_EQ(levels == uniformLevels(levels.size(), 0), error == 1000);
  }
  EXPECT_GT(snapped, 20u);
  EXPECT_GT(coarse, 20u);
}

// Noise of which each patch's errors fall fourfold a level, from another one on.
class GradedPatches : public NoisyPatches {
 public:
  using NoisyPatches::NoisyPatches;
  Result<CoarseErrors> coarseErrors(uint32_t patch) const override {
    CoarseErrors out;
    for (size_t level = 0; level < out.size(); ++level)
      out[level] = static_cast<float>(std::ldexp(3.0, -2 * static_cast<int>(patch * 7 % 5 + level)));
    return out;
  }
};

TEST_F(ExportBall, WithinAnErrorPatchesHaveLevelsOfTheirOwnAndNothingOpens) {
  const GradedPatches source(cubeSphere(2, 40, 3), 0, 0, 7);
  const auto package = packageOf(source);
  const auto errors = patchErrors(*package);
  ASSERT_TRUE(errors.ok());
  for (const double error : {0.5, 0.1, 0.02}) {
    const std::vector<PatchLevels> levels = patchLevelsWithin(patchNeighbours(source.base()), *errors, error);
    uint64_t faces = 0;
    size_t snapped = 0;
    for (const PatchLevels& p : levels) faces += p.triangles(), snapped += p.isSnapped();
    EXPECT_GT(snapped, 2u) << error;
    for (const std::string format : {"ply", "obj", "off", "stl", "glb"}) {
      if (test::kSanitized && format != "ply" && format != "stl") continue;
      const MeshExportReport report = exported(package, "graded." + format, {.error_mm = error});
      EXPECT_LT(report.least_level, report.level);
      EXPECT_EQ(report.faces, faces) << error;
      ASSERT_TRUE(report.error_mm.has_value());
      EXPECT_LE(*report.error_mm, error);
      const LoadedMesh read = readBack("graded." + format);
      EXPECT_EQ(read.diagnosis.triangles_read, faces) << format << error;
      EXPECT_EQ(read.diagnosis.triangles, faces) << format << error;
      EXPECT_EQ(read.diagnosis.border_loops, 0u) << format << error;
      EXPECT_EQ(read.diagnosis.pieces, 1u) << format << error;
      EXPECT_EQ(read.diagnosis.vertices, faces / 2 + 2) << format << error;
      if (format == "stl") continue;
      EXPECT_EQ(report.vertices, faces / 2 + 2) << format << error << ": each is named by a face";
      EXPECT_EQ(read.diagnosis.vertices_read, faces / 2 + 2) << format << error;
      EXPECT_EQ(unexpectedFindings(read.diagnosis), "") << format << error;
    }
    // All at the finest of these levels are more, and have vertices at the same places among others.
    const LoadedMesh some = readBack("graded.ply");
    exported(package, "all.ply", {.level = exported(package, "graded.ply", {.error_mm = error}).level});
    const LoadedMesh all = readBack("all.ply");
    const auto places = [](const LoadedMesh& mesh) {
      std::set<std::array<float, 3>> out;
      for (const glm::vec3& p : mesh.mesh.positions_mm) {
        const glm::vec3 at(glm::dvec3(p) + mesh.mesh.origin_mm);
        out.insert({at.x, at.y, at.z});
      }
      return out;
    };
    const auto of_all = places(all), of_some = places(some);
    EXPECT_LT(of_some.size(), of_all.size());
    EXPECT_TRUE(std::includes(of_all.begin(), of_all.end(), of_some.begin(), of_some.end()));
  }
}

TEST_F(ExportBall, TheBytesDoNotDependOnTheWorkers) {
  if (test::kSanitized) GTEST_SKIP() << "about figures; others export under the sanitizer";
  const NoisyPatches source(cubeSphere(2, 40, 3), 0, 0, 7);
  const auto package = packageOf(source);
  for (const std::string format : {"ply", "glb", "stl"}) {
    exported(package, "one." + format, {.workers = 1});
    exported(package, "five." + format, {.workers = 5});
    EXPECT_TRUE(bytesOf(folder_.file("one." + format)) == bytesOf(folder_.file("five." + format))) << format;
  }
  const auto graded = packageOf(GradedPatches(cubeSphere(2, 40, 3), 0, 0, 7));
  exported(graded, "one.ply", {.error_mm = 0.1, .workers = 1});
  exported(graded, "five.ply", {.error_mm = 0.1, .workers = 5});
  EXPECT_TRUE(bytesOf(folder_.file("one.ply")) == bytesOf(folder_.file("five.ply")));
}

TEST_F(ExportBall, FloatsCountFromTheOriginWhereTheScanLiesFarAway) {
  BaseMesh far = cubeSphere(1, 40, 5);
  far.origin_mm = {12345678.125, -7654321.5, 100000};
  const NoisyPatches source(far, 0, 0, 11);
  const auto package = packageOf(source);
  EXPECT_TRUE(exported(package, "far.ply", {.level = 4}).from_origin);
  const LoadedMesh ply = readBack("far.ply");
  EXPECT_LT(glm::length(ply.diagnosis.max_mm), 100);
  EXPECT_NE(bytesOf(folder_.file("far.ply")).find("comment origin 12345678.125 -7654321.5"), std::string::npos);
  // Text keeps the scan's coordinates; the same vertices in the same order.
  exported(package, "far.obj", {.level = 4});
  const LoadedMesh obj = readBack("far.obj");
  ASSERT_EQ(obj.mesh.positions_mm.size(), ply.mesh.positions_mm.size());
  double worst = 0;
  for (size_t i = 0; i < obj.mesh.positions_mm.size(); ++i)
    worst = std::max(worst, glm::length(obj.mesh.origin_mm + glm::dvec3(obj.mesh.positions_mm[i]) - far.origin_mm -
                                        ply.mesh.origin_mm - glm::dvec3(ply.mesh.positions_mm[i])));
  EXPECT_LT(worst, 1e-5) << "a float of 12345678 has steps of 1";
  // Near its zero, floats hold the scan's coordinates.
  BaseMesh close = far;
  close.origin_mm = {30, 0, 0};
  EXPECT_FALSE(exported(packageOf(NoisyPatches(close, 0, 0, 11)), "near.ply", {.level = 4}).from_origin);
  EXPECT_GT(readBack("near.ply").diagnosis.max_mm.x, 50);
}

TEST_F(ExportBall, TheBaseMeshIsQuadsWhereTheFormatHasThem) {
  const NoisyPatches source(cubeSphere(2, 40, 3), 0, 0, 7);
  const auto package = packageOf(source);
  const uint64_t patches = source.base().patches.size();
  for (const std::string format : {"ply", "obj", "off", "stl", "glb"}) {
    const bool quads = format != "stl" && format != "glb";
    const MeshExportReport report = exported(package, "base." + format, {.base = true});
    EXPECT_EQ(report.quads, quads);
    EXPECT_EQ(report.faces, quads ? patches : 2 * patches);
    if (format == "glb") continue;
    const LoadedMesh read = readBack("base." + format);
    EXPECT_EQ(read.diagnosis.triangles, 2 * patches);
    EXPECT_EQ(read.diagnosis.vertices, source.base().corners.size());
    EXPECT_EQ(read.diagnosis.border_loops, 0u);
  }
}

// ---- glTF, read here by its specification ----
struct Glb {
  nlohmann::json json;
  std::string binary, problem;
};
Glb parseGlb(const std::string& bytes) {
  Glb glb;
  const auto word = [&](size_t at) {
    uint32_t v = 0;
    if (at + 4 <= bytes.size()) std::memcpy(&v, bytes.data() + at, 4);
    return v;
  };
  if (bytes.substr(0, 4) != "glTF" || word(4) != 2) return {{}, {}, "no glTF 2"};
  if (word(8) != bytes.size()) return {{}, {}, "another length than stated"};
  const uint32_t json_bytes = word(12);
  if (word(16) != 0x4E4F534A || json_bytes % 4) return {{}, {}, "the first chunk is no JSON"};
  glb.json = nlohmann::json::parse(bytes.substr(20, json_bytes), nullptr, false);
  if (glb.json.is_discarded()) return {{}, {}, "no JSON"};
  const uint32_t binary_bytes = word(20 + json_bytes);
  if (word(24 + json_bytes) != 0x004E4942 || binary_bytes % 4 || 28 + json_bytes + binary_bytes != bytes.size())
    return {{}, {}, "the second chunk is not the rest"};
  glb.binary = bytes.substr(28 + json_bytes);
  return glb;
}
// Value c of element i.
double glbValue(const Glb& glb, int accessor, size_t i, size_t c) {
  const auto& a = glb.json["accessors"][static_cast<size_t>(accessor)];
  const auto& view = glb.json["bufferViews"][a["bufferView"].get<size_t>()];
  const int type = a["componentType"];
  const size_t size = type == 5123 ? 2 : 4, count = a["type"] == "SCALAR" ? 1 : a["type"] == "VEC3" ? 3 : 4;
  const size_t stride = view.value("byteStride", size * count);
  const char* at =
      glb.binary.data() + view["byteOffset"].get<size_t>() + a["byteOffset"].get<size_t>() + i * stride + c * size;
  if (at + size > glb.binary.data() + glb.binary.size()) return NAN;
  float f;
  uint32_t u;
  uint16_t s;
  if (type == 5126) return std::memcpy(&f, at, 4), f;
  if (type == 5125) return std::memcpy(&u, at, 4), u;
  return std::memcpy(&s, at, 2), s / 65535.0;
}

TEST_F(ExportBall, GlbHoldsTheMeshOfThePly) {
  const NoisyPatches source(cubeSphere(2, 40, 3), 0, 0, 7);
  const auto package = packageOf(source);
  const MeshExportReport report = exported(package, "ball.glb", {.level = 5});
  exported(package, "ball.ply", {.level = 5});
  const LoadedMesh ply = readBack("ball.ply");
  const std::string bytes = bytesOf(folder_.file("ball.glb"));
  const Glb glb = parseGlb(bytes);
  ASSERT_EQ(glb.problem, "");
  const auto& node = glb.json["nodes"][0];
  EXPECT_EQ(node["scale"], nlohmann::json::parse("[0.001, 0.001, 0.001]"));
  EXPECT_EQ(node["translation"], nlohmann::json::parse("[1.0, -2.0, 3.0]"));
  EXPECT_EQ(node["extras"]["position_unit"], "mm");
  const auto& attributes = glb.json["meshes"][0]["primitives"][0]["attributes"];
  EXPECT_EQ(glb.json["accessors"][0]["count"], report.vertices);
  ASSERT_EQ(ply.mesh.positions_mm.size(), report.vertices);
  std::array<double, 3> low{1e9, 1e9, 1e9}, high{-1e9, -1e9, -1e9};
  double worst = 0, length_off = 0, colour_off = 0;
  for (size_t i = 0; i < report.vertices; ++i) {
    double length = 0;
    for (size_t c = 0; c < 3; ++c) {
      const double v = glbValue(glb, attributes["POSITION"], i, c), n = glbValue(glb, attributes["NORMAL"], i, c);
      low[c] = std::min(low[c], v), high[c] = std::max(high[c], v);
      const auto k = static_cast<glm::length_t>(c);
      worst = std::max(worst, std::abs(v - (ply.mesh.origin_mm[k] + double{ply.mesh.positions_mm[i][k]})));
      length += n * n;
      const double s = ply.mesh.colours[i][k] / 255.0;
      colour_off = std::max(colour_off, std::abs(glbValue(glb, attributes["COLOR_0"], i, c) -
                                                 (s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4))));
    }
    length_off = std::max(length_off, std::abs(length - 1));
  }
  EXPECT_LT(worst, 1e-5) << "both count from the origin, 3.7 m away";
  EXPECT_LT(length_off, 1e-5);
  EXPECT_LT(colour_off, 1e-5) << "linear light";
  EXPECT_EQ(glb.json["accessors"][0]["min"], nlohmann::json(low));
  EXPECT_EQ(glb.json["accessors"][0]["max"], nlohmann::json(high));
  std::set<std::array<uint32_t, 2>> open;  // directed or not: an edge that is met twice is closed
  for (size_t t = 0; t < report.faces; ++t)
    for (size_t k = 0; k < 3; ++k) {
      const auto a = static_cast<uint32_t>(glbValue(glb, 2, 3 * t + k, 0)),
                 b = static_cast<uint32_t>(glbValue(glb, 2, 3 * t + (k + 1) % 3, 0));
      ASSERT_LT(a, report.vertices);
      const std::array edge{std::min(a, b), std::max(a, b)};
      if (!open.erase(edge)) open.insert(edge);
    }
  EXPECT_EQ(open.size(), 0u);
  // Control: the parser sees a file that is cut, and one that states more.
  EXPECT_NE(parseGlb(bytes.substr(0, bytes.size() - 4)).problem, "");
  std::string longer = bytes;
  longer[8] = static_cast<char>(longer[8] + 4);
  EXPECT_NE(parseGlb(longer).problem, "");
}

// What a viewer makes of a .glb with maps: its images, and what its vertices say at a place of them.
struct TexturedGlb {
  explicit TexturedGlb(const Glb& from, const std::string& folder) : glb(from) {
    const auto& json = glb.json;
    for (const auto& image : json["images"]) {
      const auto& view = json["bufferViews"][image["bufferView"].get<size_t>()];
      const std::string name = folder + image["name"].get<std::string>() + ".png";
      std::ofstream(name, std::ios::binary)
          << glb.binary.substr(view["byteOffset"].get<size_t>(), view["byteLength"].get<size_t>());
      auto read = readImage8(name, {});
      EXPECT_TRUE(read.ok()) << read.error().text();
      images.push_back(std::move(*read));
    }
    const auto& of = json["meshes"][0]["primitives"][0]["attributes"];
    auto vectors = [&](const char* name, size_t components) {
      std::vector<glm::dvec4> out(json["accessors"][of[name].get<size_t>()]["count"].get<size_t>(), glm::dvec4(0));
      for (size_t i = 0; i < out.size(); ++i)
        for (size_t c = 0; c < components; ++c) out[i][static_cast<glm::length_t>(c)] = glbValue(glb, of[name], i, c);
      return out;
    };
    positions = vectors("POSITION", 3), normals = vectors("NORMAL", 3), tangents = vectors("TANGENT", 4),
    uv = vectors("TEXCOORD_0", 2);
    for (size_t i = 0; i < json["accessors"][2]["count"].get<size_t>(); ++i)
      indices.push_back(static_cast<uint32_t>(glbValue(glb, 2, i, 0)));
  }
  // In px of the images.
  glm::dvec2 pixel(uint32_t v) const { return {uv[v].x * images[0].width, uv[v].y * images[0].height}; }
  std::array<uint8_t, 3> texel(size_t image, int x, int y) const {
    std::array<uint8_t, 3> out;
    for (size_t c = 0; c < 3; ++c)
      out[c] = images[image].pixels[3 * static_cast<size_t>(y * images[image].width + x) + c];
    return out;
  }
  Glb glb;
  std::vector<Image8> images;
  std::vector<glm::dvec4> positions, normals, tangents, uv;
  std::vector<uint32_t> indices;
};

TEST_F(ExportBall, GlbWithMapsShowsTheColoursAndNormalsOfTheTexels) {
  const GradedPatches source(cubeSphere(2, 40, 3), 0, 0, 7);
  const auto package = packageOf(source);
  const double error = 0.1;
  const MeshExportReport report = exported(package, "ball.glb", {.error_mm = error, .maps_px = 2048});
  ASSERT_TRUE(report.maps_px.has_value());
  const Glb glb = parseGlb(bytesOf(folder_.file("ball.glb")));
  ASSERT_EQ(glb.problem, "");
  const TexturedGlb shown(glb, folder_.file(""));
  ASSERT_EQ(shown.images.size(), 2u);
  const auto& material = glb.json["materials"][0];
  EXPECT_EQ(material["pbrMetallicRoughness"]["baseColorTexture"]["index"], 0);
  EXPECT_EQ(material["normalTexture"]["index"], 1);
  EXPECT_EQ(shown.images[0].width, (*report.maps_px)[0]);
  EXPECT_EQ(shown.images[0].height, (*report.maps_px)[1]);

  // The same surface as without maps: the same triangles, with the same bits.
  const MeshExportReport plain = exported(package, "plain.glb", {.error_mm = error});
  EXPECT_EQ(report.faces, plain.faces);
  EXPECT_EQ(shown.indices.size(), 3 * plain.faces);
  const Glb welded = parseGlb(bytesOf(folder_.file("plain.glb")));
  const auto trianglesOf = [](const Glb& of) {
    std::multiset<std::array<std::array<double, 3>, 3>> out;
    for (size_t i = 0; i < of.json["accessors"][2]["count"].get<size_t>(); i += 3) {
      std::array<std::array<double, 3>, 3> t;
      for (size_t k = 0; k < 3; ++k)
        for (size_t c = 0; c < 3; ++c) t[k][c] = glbValue(of, 0, static_cast<size_t>(glbValue(of, 2, i + k, 0)), c);
      std::rotate(t.begin(), std::min_element(t.begin(), t.end()), t.end());
      out.insert(t);
    }
    return out;
  };
  EXPECT_TRUE(trianglesOf(glb) == trianglesOf(welded));
  // All of a place's vertices have the normal of the one that it has without maps.
  std::map<std::array<double, 3>, std::array<double, 3>> normal_at;
  const auto three = [](const Glb& of, const char* name, size_t i) {
    const auto& accessor = of.json["meshes"][0]["primitives"][0]["attributes"][name];
    return std::array{glbValue(of, accessor, i, 0), glbValue(of, accessor, i, 1), glbValue(of, accessor, i, 2)};
  };
  for (size_t i = 0; i < plain.vertices; ++i) normal_at[three(welded, "POSITION", i)] = three(welded, "NORMAL", i);
  double normal_off = 0;
  for (size_t i = 0; i < report.vertices; ++i) {
    const auto of_plain = normal_at.at(three(glb, "POSITION", i)), own = three(glb, "NORMAL", i);
    for (size_t c = 0; c < 3; ++c) normal_off = std::max(normal_off, std::abs(of_plain[c] - own[c]));
  }
  EXPECT_LT(normal_off, 1e-6);

  // Tiles are the patches' texels. On the triangle that shows it, a texel's normal is the package's.
  const auto atlas = MapAtlas::create(package, 2048);
  ASSERT_TRUE(atlas.ok());
  size_t compared = 0, triangles_seen = 0;
  double worst = 0, mean = 0;
  for (uint32_t p = 0; p < source.base().patches.size(); ++p) {
    const MapAtlas::Tile tile = atlas->tile(p);
    EXPECT_EQ(tile.side, 128) << "all fit";
    for (int y = 0; y < tile.side; y += 5)
      for (int x = 0; x < tile.side; x += 7)
        for (size_t c = 0; c < 3; ++c)
          ASSERT_EQ(shown.texel(0, tile.x + x, tile.y + y)[c], source.texel(p, static_cast<int>(c), x, y)) << p;
  }
  for (size_t i = 0; i < shown.indices.size(); i += 3) {
    const std::array corner{shown.indices[i], shown.indices[i + 1], shown.indices[i + 2]};
    const glm::dvec2 a = shown.pixel(corner[0]), e = shown.pixel(corner[1]) - a, f = shown.pixel(corner[2]) - a;
    const double det = e.x * f.y - e.y * f.x;
    if (std::abs(det) < 1) continue;
    EXPECT_LT(det, 0) << "counter-clockwise, with v down";
    const glm::dvec2 centre = glm::floor(a + (e + f) / 3.0) + 0.5, at = centre - a;
    const double to_e = (at.x * f.y - at.y * f.x) / det, to_f = (e.x * at.y - e.y * at.x) / det;
    if (to_e < 0 || to_f < 0 || to_e + to_f > 1) continue;  // no centre of a texel
    ++triangles_seen;
    uint32_t patch = 0;
    const auto in = [&](const MapAtlas::Tile& t) {
      return centre.x > t.x && centre.x < t.x + t.side && centre.y > t.y && centre.y < t.y + t.side;
    };
    while (!in(atlas->tile(patch))) ++patch;
    const MapAtlas::Tile tile = atlas->tile(patch);
    const int x = static_cast<int>(centre.x), y = static_cast<int>(centre.y);
    glm::dvec3 expected;
    for (int c = 0; c < 3; ++c) expected[c] = source.texel(patch, 3 + c, x - tile.x, y - tile.y) - 127.5;
    const auto mixed = [&](const std::vector<glm::dvec4>& of) {
      return glm::dvec3((1 - to_e - to_f) * of[corner[0]] + to_e * of[corner[1]] + to_f * of[corner[2]]);
    };
    const glm::dvec3 normal = mixed(shown.normals), tangent = mixed(shown.tangents);
    EXPECT_EQ(shown.tangents[corner[0]].w, 1);
    expected = glm::normalize(expected);
    const glm::dmat3 axes(tangent, glm::cross(normal, tangent), normal);
    if ((glm::inverse(axes) * expected).z < 0.1) continue;  // no normal map shows what faces away
    const auto bytes = shown.texel(1, x, y);
    const glm::dvec3 map = glm::dvec3(bytes[0], bytes[1], bytes[2]) / 127.5 - 1.0;
    const glm::dvec3 found = glm::normalize(map.x * tangent + map.y * glm::cross(normal, tangent) + map.z * normal);
    const double off = std::acos(std::min(glm::dot(found, expected), 1.0)) * 180 / 3.14159265358979;
    worst = std::max(worst, off);
    mean += off;
    ++compared;
  }
  EXPECT_GT(compared, 200u);
  EXPECT_GT(compared, triangles_seen / 10);
  mean /= static_cast<double>(compared);
  EXPECT_LT(mean, 0.5) << "degrees, of 8 bits";
  EXPECT_LT(worst, 5);
  std::cout << "[ figures  ] normals of the map: mean " << mean << ", at most " << worst << " degrees off, of "
            << compared << "\n";
}

// Of a basis of light: what render shows under light from the front, and no normals.
TEST_F(ExportBall, GlbWithMapsOfABasisOfLightHasColoursAlone) {
  for (const Basis basis : {Basis::kColour, Basis::kPtmRgb}) {
    const NoisyPatches source(cubeSphere(1, 40, 3), 0, 0, 7, basis);
    const auto package = packageOf(source);
    exported(package, "basis.glb", {.level = 1, .maps_px = 1024});
    const Glb glb = parseGlb(bytesOf(folder_.file("basis.glb")));
    ASSERT_EQ(glb.problem, "");
    EXPECT_FALSE(glb.json["materials"][0].contains("normalTexture"));
    const TexturedGlb shown(glb, folder_.file(""));
    ASSERT_EQ(shown.images.size(), 1u);
    const auto atlas = MapAtlas::create(package, 1024);
    ASSERT_TRUE(atlas.ok());
    const MapAtlas::Tile tile = atlas->tile(2);
    ASSERT_EQ(tile.side, 128);
    std::vector<std::vector<uint8_t>> slots(static_cast<size_t>(source.format().planes()),
                                            std::vector<uint8_t>(kSlotBytes));
    std::vector<const uint8_t*> pointers;
    const auto at = [](int x, int y) {
      return 4 * static_cast<size_t>((y + kPageBorderPx) * kPageFullPx + x + kPageBorderPx);
    };
    for (size_t k = 0; k < slots.size(); ++k) {
      for (int y = 0; y < 128; ++y)
        for (int x = 0; x < 128; ++x)
          for (int c = 0; c < 3; ++c)
            slots[k][at(x, y) + static_cast<size_t>(c)] = source.texel(2, static_cast<int>(3 * k) + c, x, y);
      pointers.push_back(slots[k].data());
    }
    std::vector<uint8_t> lit(kSlotBytes);
    resolvePage(source.format(), {0, 0, 1}, pointers, lit.data());
    for (int y = 0; y < 128; y += 3)
      for (int x = 0; x < 128; x += 5)
        for (size_t c = 0; c < 3; ++c)
          ASSERT_EQ(shown.texel(0, tile.x + x, tile.y + y)[c], lit[at(x, y) + c]) << x << " " << y;
  }
}

TEST_F(ExportBall, MapsFitTheSideThatIsAllowedOrAreRefused) {
  const auto package = packageOf(NoisyPatches(cubeSphere(3, 40, 3), 1, 0, 7));
  int last = 1 << 20;
  for (const int most : {4096, 1024, 512, 128, 64, 16}) {
    const auto atlas = MapAtlas::create(package, most);
    if (most == 16) {
      ASSERT_FALSE(atlas.ok());
      EXPECT_EQ(atlas.error().kind, ErrorKind::kUsage);
      break;
    }
    ASSERT_TRUE(atlas.ok()) << atlas.error().text();
    EXPECT_LE(std::max(atlas->width(), atlas->height()), most);
    std::vector<uint8_t> taken(static_cast<size_t>(atlas->width()) * static_cast<size_t>(atlas->height()));
    size_t texels = 0;
    for (uint32_t p = 0; p < 54; ++p) {
      const MapAtlas::Tile t = atlas->tile(p);
      EXPECT_LE(t.side, std::min(last, 256));
      for (int y = t.y - 1; y <= t.y + t.side; ++y)
        for (int x = t.x - 1; x <= t.x + t.side; ++x, ++texels)
          EXPECT_EQ(taken.at(static_cast<size_t>(y * atlas->width() + x))++, 0) << "tiles overlap";
    }
    EXPECT_GT(texels, taken.size() / 3);
    last = 0;
    for (uint32_t p = 0; p < 54; ++p) last = std::max(last, atlas->tile(p).side);
    // A tile of fewer texels has their means, and its border is the neighbour's.
    PageDecoder decoder;
    MapAtlas::Texels read;
    ASSERT_TRUE(atlas->read(7, decoder, read).ok());
    EXPECT_EQ(read.side, atlas->tile(7).side + 2);
    EXPECT_EQ(read.colours.size(), static_cast<size_t>(read.side * read.side));
    for (const glm::vec3& n : read.normals) EXPECT_NEAR(glm::length(n), 1, 1e-5);
  }
  MeshExportOptions options;
  options.maps_px = 512;
  options.output = folder_.file("maps.ply");
  EXPECT_EQ(exportMesh(package, options).error().kind, ErrorKind::kUsage);
  options.output = folder_.file("maps.glb");
  options.memory_bytes = 1 << 20;
  EXPECT_EQ(exportMesh(package, options).error().kind, ErrorKind::kUsage);
  for (const int workers : {1, 5})
    exported(package, "maps" + std::to_string(workers) + ".glb", {.level = 3, .maps_px = 512, .workers = workers});
  EXPECT_TRUE(bytesOf(folder_.file("maps1.glb")) == bytesOf(folder_.file("maps5.glb")));
}

// ---- flat artworks ----
// Read back, the compressed mesh is the other one: as closed, with as many triangles, all within half a step of theirs.
TEST_F(ExportBall, DracosGlbIsThePlainOnesMesh) {
  const auto package = packageOf(NoisyPatches(cubeSphere(2, 40, 3), 0, kReliefDepth, 7));
  exported(package, "plain.glb", {.level = 4});
  const LoadedMesh plain = readBack("plain.glb");
  auto at = [](const LoadedMesh& m, uint32_t v) { return m.mesh.origin_mm + glm::dvec3(m.mesh.positions_mm[v]); };
  // Corners of triangles, from place to how often it is one, on a grid that is far coarser than steps.
  constexpr double kGrid = 0.5;
  auto cornersOf = [&](const LoadedMesh& m) {
    std::map<std::array<int64_t, 3>, std::vector<glm::dvec3>> out;
    for (uint32_t v = 0; v < m.mesh.positions_mm.size(); ++v) {
      const glm::dvec3 p = at(m, v) / kGrid;
      out[{std::llround(p.x), std::llround(p.y), std::llround(p.z)}].push_back(at(m, v));
    }
    return out;
  };
  const auto places = cornersOf(plain);
  double area = 0;
  for (const auto& t : plain.mesh.triangles)
    area += glm::length(glm::cross(at(plain, t[1]) - at(plain, t[0]), at(plain, t[2]) - at(plain, t[0]))) / 2;
  for (const int bits : {12, 16}) {
    const MeshExportReport report = exported(package, "draco.glb", {.level = 4, .draco_bits = bits});
    ASSERT_TRUE(report.draco_step);
    EXPECT_NEAR(*report.draco_step * (std::exp2(bits) - 1), 83, 8) << "the ball's diameter";
    EXPECT_LT(report.file_bytes, bytesOf(folder_.file("plain.glb")).size() / 4);
    EXPECT_EQ(report.file_bytes, bytesOf(folder_.file("draco.glb")).size());
    const LoadedMesh read = readBack("draco.glb");
    EXPECT_EQ(read.mesh.triangles.size(), plain.mesh.triangles.size());
    EXPECT_EQ(read.mesh.positions_mm.size(), plain.mesh.positions_mm.size());
    EXPECT_EQ(read.diagnosis.border_loops, plain.diagnosis.border_loops);
    // Where patches lie the other way round, Draco takes a vertex for each side; they are welded again.
    const std::string findings = unexpectedFindings(read.diagnosis);
    EXPECT_TRUE(findings.starts_with("duplicate vertices (") && std::count(findings.begin(), findings.end(), ';') == 1)
        << findings;
    EXPECT_EQ(unexpectedFindings(plain.diagnosis), "");
    double farthest = 0, area_read = 0;
    for (uint32_t v = 0; v < read.mesh.positions_mm.size(); ++v) {
      const glm::dvec3 p = at(read, v);
      double nearest = 1e9;
      for (int k = 0; k < 27; ++k) {
        const glm::dvec3 cell = p / kGrid + glm::dvec3(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1);
        const auto found = places.find({std::llround(cell.x), std::llround(cell.y), std::llround(cell.z)});
        if (found == places.end()) continue;
        for (const glm::dvec3& q : found->second)
          nearest = std::min(nearest, std::max({std::abs(p.x - q.x), std::abs(p.y - q.y), std::abs(p.z - q.z)}));
      }
      farthest = std::max(farthest, nearest);
    }
    EXPECT_LT(farthest, 0.5 * *report.draco_step * 1.01 + 1e-5) << bits;
    EXPECT_GT(farthest, 0.1 * *report.draco_step) << "control: positions are rounded";
    for (const auto& t : read.mesh.triangles)
      area_read += glm::length(glm::cross(at(read, t[1]) - at(read, t[0]), at(read, t[2]) - at(read, t[0]))) / 2;
    EXPECT_NEAR(area_read, area, area * 1e-3);
    ASSERT_EQ(read.mesh.colours.size(), read.mesh.positions_mm.size());
  }
  std::map<std::array<int, 3>, int> colours, compressed;
  for (const glm::u8vec3& c : plain.mesh.colours) ++colours[{c.x, c.y, c.z}];
  for (const glm::u8vec3& c : readBack("draco.glb").mesh.colours) ++compressed[{c.x, c.y, c.z}];
  EXPECT_TRUE(colours == compressed);
  EXPECT_GT(colours.size(), 100u);
  const MeshExportReport base = exported(package, "base.glb", {.base = true, .draco_bits = 14});
  EXPECT_EQ(base.faces, readBack("base.glb").mesh.triangles.size());
  // What cannot be is said, and nothing is written.
  auto refused = [&](const std::string& name, MeshExportOptions options) {
    options.output = folder_.file(name);
    const auto report = exportMesh(package, options);
    EXPECT_FALSE(report.ok());
    EXPECT_EQ(bytesOf(options.output), "");
    return report.ok() ? "" : report.error().text();
  };
  EXPECT_NE(refused("a.ply", {.level = 4, .draco_bits = 16}).find("only a .glb can be compressed"), std::string::npos);
  EXPECT_NE(refused("a.glb", {.level = 8, .draco_bits = 16, .memory_bytes = uint64_t{100} << 20}).find("--memory-mib"),
            std::string::npos);
}

TEST_F(ExportBall, AFlatArtworkLiesAroundItsCentreWithItsOwnHeights) {
  const NoisyTexture texture(300, 200, Basis::kColour, 5);
  const NoisyHeights heights(300, 200, 9);
  BuildOptions options;
  options.output = folder_.file("flat.relievo");
  options.mm_per_px = 0.5;
  ASSERT_TRUE(buildPackage(texture, &heights, options).ok());
  auto package = Package::open(options.output);
  ASSERT_TRUE(package.ok());
  const FlatDomain d = (*package)->manifest().domain.flat();
  std::vector<float> map(300 * 200);
  (void)heights.read({0, 0, 300, 200}, map);
  const int finest = 7 + d.relief_depth;
  for (const int level : {finest, finest - 1, 3}) {
    const MeshExportReport report = exported(*package, "flat.ply", {.level = level});
    EXPECT_EQ(report.error_mm.has_value(), level >= 7);
    const double step = static_cast<double>(d.patchPx()) / (1 << level);  // texels
    const auto columns = static_cast<size_t>(std::ceil(300 / step)) + 1,
               rows = static_cast<size_t>(std::ceil(200 / step)) + 1;
    ASSERT_EQ(report.vertices, columns * rows);
    const LoadedMesh read = readBack("flat.ply");
    EXPECT_EQ(read.diagnosis.border_loops, 1u);
    EXPECT_EQ(read.diagnosis.vertices, columns * rows);
    EXPECT_EQ(unexpectedFindings(read.diagnosis), "");
    double worst_place = 0, worst_height = 0;
    for (size_t y = 0; y < rows; ++y)
      for (size_t x = 0; x < columns; ++x) {
        const glm::dvec3 p = read.mesh.origin_mm + glm::dvec3(read.mesh.positions_mm[y * columns + x]);
        const double tx = std::min(static_cast<double>(x) * step, 300.0),
                     ty = std::min(static_cast<double>(y) * step, 200.0);
        worst_place = std::max({worst_place, std::abs(p.x - (tx - 150) * 0.5), std::abs(p.y - (100 - ty) * 0.5)});
        worst_height = std::max(worst_height, std::abs(p.z - naiveHeightMm(heights, map, d, tx, ty)));
      }
    EXPECT_LT(worst_place, 1e-4) << level;
    EXPECT_LT(worst_height, 0.51 * d.relief_scale_mm + 1e-5) << level;
    for (const auto& t : read.mesh.triangles) {
      const auto& p = read.mesh.positions_mm;
      ASSERT_GT(glm::cross(p[t[1]] - p[t[0]], p[t[2]] - p[t[0]]).z, 0) << "towards the viewer";
    }
  }
}

// Colours of vertices between texels are the mean of the four around them; at the border, of those that there are.
TEST_F(ExportBall, ColoursAreThoseOfTheTexels) {
  const NoisyTexture texture(300, 200, Basis::kColour, 5);
  BuildOptions options;
  options.output = folder_.file("flat.relievo");
  ASSERT_TRUE(buildPackage(texture, nullptr, options).ok());
  auto package = Package::open(options.output);
  ASSERT_TRUE(package.ok());
  const MeshExportReport report = exported(*package, "flat.ply");  // without relief: a vertex a texel
  ASSERT_EQ(report.vertices, 301u * 201u);
  const LoadedMesh read = readBack("flat.ply");
  int worst = 0;
  for (int64_t y = 0; y <= 200; ++y)
    for (int64_t x = 0; x <= 300; ++x)
      for (int c = 0; c < 3; ++c) {
        int sum = 0;
        for (const int64_t j : {y - 1, y})
          for (const int64_t i : {x - 1, x})
            sum += texture.at(c, std::clamp<int64_t>(i, 0, 299), std::clamp<int64_t>(j, 0, 199));
        worst = std::max(worst, std::abs(4 * read.mesh.colours[static_cast<size_t>(y * 301 + x)][c] - sum));
      }
  EXPECT_LE(worst, 2) << "quarters: rounded to the nearest";
}

// ---- maps ----
class ExportMaps : public ExportBall {
 protected:
  static constexpr int kWidth = 300, kHeight = 200;
  static constexpr double kMmPerPx = 0.5;
  void SetUp() override {
    BuildOptions options;
    options.output = folder_.file("flat.relievo");
    options.mm_per_px = kMmPerPx;
    ASSERT_TRUE(buildPackage(texture_, &heights_, options).ok());
    auto package = Package::open(options.output);
    ASSERT_TRUE(package.ok());
    package_ = *package;
    domain_ = package_->manifest().domain.flat();
    map_.resize(size_t{kWidth} * kHeight);
    (void)heights_.read({0, 0, kWidth, kHeight}, map_);
  }
  MapExportReport mapped(ExportMap map, const std::string& name, MapExportOptions options = {}) {
    options.map = map;
    options.output = folder_.file(name);
    auto report = exportMap(package_, options);
    EXPECT_TRUE(report.ok()) << name << ": " << report.error().text();
    return report.ok() ? *report : MapExportReport{};
  }
  // Of the vertex (x, y) of the grid of `step` texels a cell.
  double heightAt(double x, double y, double step) const {
    return naiveHeightMm(heights_, map_, domain_, std::min(x * step, double{kWidth}),
                         std::min(y * step, double{kHeight}));
  }
  std::vector<float> heightsOf(const std::string& name, std::optional<std::pair<double, double>> range = {}) {
    auto image = openHeightImage(folder_.file(name), range);
    EXPECT_TRUE(image.ok()) << image.error().text();
    std::vector<float> values(static_cast<size_t>((*image)->width() * (*image)->height()));
    EXPECT_TRUE((*image)->read({0, 0, (*image)->width(), (*image)->height()}, values).ok());
    return values;
  }
  const NoisyTexture texture_{kWidth, kHeight, Basis::kColour, 5};
  const NoisyHeights heights_{kWidth, kHeight, 9};
  std::shared_ptr<const Package> package_;
  FlatDomain domain_;
  std::vector<float> map_;
};

TEST_F(ExportMaps, HeightsAreThoseOfTheSurfaceAtTheCellsCentres) {
  for (const int level : {7 + domain_.relief_depth, 7}) {
    const double step = static_cast<double>(domain_.patchPx()) / (1 << level), low = domain_.relief_offset_mm,
                 high = low + 65535 * domain_.relief_scale_mm;
    for (const std::string name : {"h.tif", "h.exr", "h.png", "d.tif", "d.png"}) {
      const bool depth = name[0] == 'd', png = name.ends_with(".png");
      const MapExportReport r = mapped(depth ? ExportMap::kDepth : ExportMap::kHeight, name, {.level = level});
      const auto columns = static_cast<size_t>(std::ceil(kWidth / step));
      ASSERT_EQ(r.width, static_cast<int64_t>(columns));
      ASSERT_EQ(r.height, static_cast<int64_t>(std::ceil(kHeight / step)));
      EXPECT_EQ(r.scaled, png);
      EXPECT_NEAR(r.low_mm, depth ? 0 : low, 1e-9);
      EXPECT_NEAR(r.high_mm, depth ? high - low : high, 1e-9);
      std::optional<std::pair<double, double>> range;
      if (png) range = {r.low_mm, r.high_mm};
      const std::vector<float> values = heightsOf(name, range);
      double worst = 0, worst_other = 0;
      for (size_t i = 0; i < values.size(); ++i) {
        const auto x = static_cast<double>(i % columns), y = static_cast<double>(i / columns);
        const double along = (heightAt(x, y, step) + heightAt(x + 1, y + 1, step)) / 2,
                     across = (heightAt(x + 1, y, step) + heightAt(x, y + 1, step)) / 2, found = double{values[i]};
        worst = std::max(worst, std::abs((depth ? high - found : found) - along));
        worst_other = std::max(worst_other, std::abs((depth ? high - found : found) - across));
      }
      EXPECT_LT(worst, 1.1 * domain_.relief_scale_mm + 1e-6) << name << level;
      EXPECT_GT(worst_other, 100 * domain_.relief_scale_mm) << "control: cells cut along the other diagonal";
      if (name.ends_with(".exr")) continue;  // its density is no tag that readImageFacts() takes
      const auto facts = readImageFacts(folder_.file(name));
      ASSERT_TRUE(facts.ok());
      EXPECT_NEAR(facts->tag_mm_per_px, kMmPerPx * step, 1e-3 * kMmPerPx * step) << name;
    }
  }
}

TEST_F(ExportMaps, NormalsAreThoseOfTheBilinearCellsInBothConventions) {
  const int level = 7 + domain_.relief_depth;
  const double step = static_cast<double>(domain_.patchPx()) / (1 << level), mm = step * kMmPerPx;
  for (const bool down : {false, true}) {
    mapped(ExportMap::kNormal, "n.png", {.level = level, .normal_y_down = down});
    const auto image = readImage8(folder_.file("n.png"));  // the upper bytes
    ASSERT_TRUE(image.ok());
    ASSERT_EQ(image->channels, 3);
    double worst = 0, flipped = 0;
    for (int y = 0; y < image->height; ++y)
      for (int x = 0; x < image->width; ++x) {
        const auto h = [&](int dx, int dy) { return heightAt(x + dx, y + dy, step); };
        const double along_x = (h(1, 0) + h(1, 1) - h(0, 0) - h(0, 1)) / 2 / mm,
                     along_y = (h(0, 0) + h(1, 0) - h(0, 1) - h(1, 1)) / 2 / mm;  // y up
        const glm::dvec3 n = glm::normalize(glm::dvec3(-along_x, down ? along_y : -along_y, 1));
        for (int c = 0; c < 3; ++c) {
          const double found = image->pixels[static_cast<size_t>(3 * (y * image->width + x) + c)];
          worst = std::max(worst, std::abs(found - 255 * (n[c] + 1) / 2));
          if (c == 1) flipped = std::max(flipped, std::abs(found - 255 * (1 - n[c]) / 2));
        }
      }
    EXPECT_LT(worst, 1.01);
    EXPECT_GT(flipped, 20) << "control: the other convention";
  }
}

TEST_F(ExportMaps, AlbedoIsTheTexelsThemselves) {
  for (const std::string name : {"a.png", "a.tif"}) {
    const MapExportReport r = mapped(ExportMap::kAlbedo, name);
    ASSERT_EQ(r.width, kWidth);
    ASSERT_EQ(r.height, kHeight);
    const auto image = readImage8(folder_.file(name));
    ASSERT_TRUE(image.ok());
    size_t differ = 0;
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x)
        for (int c = 0; c < 3; ++c)
          differ += image->pixels[static_cast<size_t>(3 * (y * kWidth + x) + c)] != texture_.at(c, x, y);
    EXPECT_EQ(differ, 0u) << name;
  }
}

// However few rows of pages fit into memory, the map is the same.
TEST_F(ExportMaps, LessMemoryTakesLongerAndGivesTheSameBytes) {
  const int finest = 7 + std::max(domain_.relief_depth, domain_.texture_depth);
  const ExportGrid grid(package_, 7 + domain_.relief_depth);
  const RowParts all{.heights = true, .positions = true, .colours = false};
  const uint64_t whole = SheetReader::bytes(grid, all);
  EXPECT_EQ(SheetReader::within(grid, all, whole).rows, kPageFullPx);
  const RowParts few = SheetReader::within(grid, all, whole / 2);
  EXPECT_LT(few.rows, kPageFullPx / 2);
  EXPECT_LE(SheetReader::bytes(grid, few), whole / 2);
  // Vertices' colours and heights, with any number of rows at once.
  for (const int rows : {1, 2, 3, 40}) {
    const ExportGrid coarse(package_, 8);
    RowParts fewer;
    fewer.rows = rows;
    SheetReader reader(coarse, {}), other(coarse, fewer);
    reader.begin(0);
    other.begin(0);
    SheetRow expected, found;
    for (uint64_t y = 0; y < coarse.rows(); ++y) {
      ASSERT_TRUE(reader.read(y, expected).ok());
      ASSERT_TRUE(other.read(y, found).ok());
      EXPECT_EQ(found.heights, expected.heights) << rows << " " << y;
      EXPECT_EQ(found.colours, expected.colours) << rows << " " << y;
    }
  }
  for (const ExportMap map : {ExportMap::kHeight, ExportMap::kNormal, ExportMap::kAlbedo})
    for (int level = 7; level <= finest; ++level) {
      if (level > 7 + (map == ExportMap::kAlbedo ? domain_.texture_depth : domain_.relief_depth)) continue;
      mapped(map, "whole.tif", {.level = level});
      const std::string expected = bytesOf(folder_.file("whole.tif"));
      size_t allowed = 0;
      for (const uint64_t kib : {300, 260, 220, 200, 180, 160, 140, 120, 100, 80, 60, 1}) {
        MapExportOptions options;
        options.map = map;
        options.output = folder_.file("few.tif");
        options.level = level;
        options.memory_bytes = kib << 10;
        const auto report = exportMap(package_, options);
        if (!report) {
          EXPECT_NE(report.error().text().find("--memory-mib allows"), std::string::npos) << report.error().text();
          continue;
        }
        ++allowed;
        EXPECT_TRUE(bytesOf(folder_.file("few.tif")) == expected) << level << " " << kib;
      }
      EXPECT_GE(allowed, 4u);
      EXPECT_LT(allowed, 12u);
    }
}

TEST_F(ExportMaps, WhatAFormatOrAnArtworkCannotHoldIsRefused) {
  const auto refused = [&](const std::shared_ptr<const Package>& package, ExportMap map, const std::string& name,
                           std::optional<int> level, const std::string& text) {
    MapExportOptions options;
    options.map = map;
    options.output = folder_.file(name);
    options.level = level;
    const size_t before = folder_.entries();
    const auto report = exportMap(package, options);
    ASSERT_FALSE(report.ok()) << name;
    EXPECT_EQ(report.error().kind, ErrorKind::kUsage);
    EXPECT_NE(report.error().text().find(text), std::string::npos) << report.error().text();
    EXPECT_EQ(folder_.entries(), before);
  };
  refused(package_, ExportMap::kHeight, "a.jpg", {}, "JPEG");
  refused(package_, ExportMap::kHeight, "a.ply", {}, "ends in .png");
  refused(package_, ExportMap::kHeight, "a.tif", 6, "expected a --level of 7 to ");
  refused(package_, ExportMap::kAlbedo, "a.tif", 8 + domain_.texture_depth, "expected a --level of 7 to ");
  refused(packageOf(NoisyPatches(cubeSphere(1, 40, 3), 0, 0, 7)), ExportMap::kHeight, "a.tif", {},
          "is no flat artwork");
  BuildOptions options;
  options.output = folder_.file("plain.relievo");
  ASSERT_TRUE(buildPackage(texture_, nullptr, options).ok());
  refused(*Package::open(options.output), ExportMap::kNormal, "a.tif", {}, "has no relief");
}

}  // namespace export_test
