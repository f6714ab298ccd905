// Contours, sections and cuts of surfaces that are known: a cap of a sphere, a tilted plane, a ball. Lengths are those
// of geometry, not of the code under test.
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <map>
#include <sstream>

#include "tests/texturing/patch_fixture.h"
#include "texturing/package/package_builder.h"
#include "texturing/package/patch_package_builder.h"
#include "tools/export/line_file.h"
#include "tools/export/surface_lines.h"

namespace surface_lines_test {

using namespace relievo;
using namespace relievo::testing_support;

constexpr double kPi = 3.14159265358979323846;

// Heights by a function of the place from the centre, x right, y up, mm.
class HeightsOf final : public HeightSource {
 public:
  HeightsOf(int64_t width, int64_t height, double mm_per_px, std::function<double(double, double)> at, double low,
            double high)
      : width_(width), height_(height), mm_(mm_per_px), at_(std::move(at)), low_(low), high_(high) {}
  int64_t width() const override { return width_; }
  int64_t height() const override { return height_; }
  double minMm() const override { return low_; }
  double maxMm() const override { return high_; }
  Provenance provenance() const override { return {"", "", "a function", {}}; }
  Result<void> read(const Rect& r, std::span<float> out) const override {
    for (int64_t y = 0; y < r.height; ++y)
      for (int64_t x = 0; x < r.width; ++x)
        out[static_cast<size_t>(y * r.width + x)] =
            static_cast<float>(at_((static_cast<double>(r.x + x) + 0.5 - static_cast<double>(width_) / 2) * mm_,
                                   (static_cast<double>(height_) / 2 - static_cast<double>(r.y + y) - 0.5) * mm_));
    return {};
  }

 private:
  int64_t width_, height_;
  double mm_;
  std::function<double(double, double)> at_;
  double low_, high_;
};

class SurfaceLinesTest : public ::testing::Test {
 protected:
  static constexpr double kMm = 0.25, kRadius = 60, kFloor = 20;
  static constexpr int kSide = 500, kHigh = 400;  // 125 x 100 mm
  std::shared_ptr<const Package> flat(const std::function<double(double, double)>& at, double low, double high) {
    const NoisyTexture texture(kSide, kHigh, Basis::kColour, 3);
    const HeightsOf heights(kSide, kHigh, kMm, at, low, high);
    BuildOptions options;
    options.output = folder_.file("flat.relievo");
    options.mm_per_px = kMm;
    EXPECT_TRUE(buildPackage(texture, &heights, options).ok());
    return *Package::open(options.output);
  }
  // A cap of radius 60 about the centre, its middle at height 40, on a floor at height 0.
  std::shared_ptr<const Package> cap() {
    return flat(
        [](double x, double y) {
          const double r2 = x * x + y * y;
          return std::max(0.0, std::sqrt(std::max(kRadius * kRadius - r2, 0.0)) - kFloor);
        },
        0, kRadius - kFloor);
  }
  std::shared_ptr<const Package> plane() {
    return flat([](double x, double y) { return 0.05 * x + 0.02 * y; }, -10, 10);
  }
  static double lengthOf(const SurfaceLine& line) {
    double sum = 0;
    for (size_t i = 1; i < line.points.size(); ++i) sum += glm::length(line.points[i] - line.points[i - 1]);
    return sum + (line.closed ? glm::length(line.points.front() - line.points.back()) : 0);
  }
  std::string textOf(const std::string& name) {
    std::ifstream in(folder_.file(name));
    return {std::istreambuf_iterator<char>(in), {}};
  }
  ScratchFolder folder_;
};

TEST_F(SurfaceLinesTest, ContoursOfACapAreClosedCirclesOfItsRadii) {
  const auto lines = contoursOf(cap(), 4.7, {});
  ASSERT_TRUE(lines.ok()) << lines.error().text();
  std::map<int, int> at_level;
  for (const SurfaceLine& line : lines->lines) {
    const double expected = std::sqrt(kRadius * kRadius - (line.level + kFloor) * (line.level + kFloor));
    const int level = static_cast<int>(std::lround(line.level / 4.7));
    ++at_level[level];
    if (level == 0) continue;                  // the floor itself
    if (expected > kHigh * kMm / 2) continue;  // cut off by the border
    EXPECT_TRUE(line.closed) << line.level;
    double least = 1e9, most = 0;
    for (const glm::dvec3& p : line.points) {
      least = std::min(least, glm::length(glm::dvec2(p)));
      most = std::max(most, glm::length(glm::dvec2(p)));
      EXPECT_NEAR(p.z, line.level, 1e-9);
    }
    // A chord of a cell of 0.25 mm lies up to 0.25^2 / 8 / 60 off in height, and so much more where the cap is flat.
    const double tolerance = 4e-3 * kRadius / expected;
    EXPECT_NEAR(least, expected, tolerance) << line.level;
    EXPECT_NEAR(most, expected, tolerance) << line.level;
    EXPECT_NEAR(lengthOf(line) / (2 * kPi * expected), 1, 1e-3) << line.level;
  }
  for (int level = 1; level <= 8; ++level)
    EXPECT_EQ(at_level[level], level < 3 ? 2 : 1) << level << " is one joined line, or two arcs from border to border";
  EXPECT_EQ(at_level.count(9), 0u);
}

TEST_F(SurfaceLinesTest, ContoursOfAPlaneAreStraightParallelAndOpen) {
  const auto lines = contoursOf(plane(), 0.5, {});
  ASSERT_TRUE(lines.ok()) << lines.error().text();
  EXPECT_EQ(lines->lines.size(), 17u) << "from -4.0 to 4.0 of -4.125 to 4.125";
  double worst = 0;
  for (const SurfaceLine& line : lines->lines) {
    EXPECT_FALSE(line.closed);
    for (const glm::dvec3& p : line.points) {
      worst = std::max(worst, std::abs(0.05 * p.x + 0.02 * p.y - line.level));
      EXPECT_LE(std::abs(p.x), kSide * kMm / 2 + 1e-9);
      EXPECT_LE(std::abs(p.y), kHigh * kMm / 2 + 1e-9);
    }
    // From border to border.
    for (const glm::dvec3& p : {line.points.front(), line.points.back()})
      EXPECT_TRUE(std::abs(p.x) > kSide * kMm / 2 - 1e-6 || std::abs(p.y) > kHigh * kMm / 2 - 1e-6)
          << p.x << " " << p.y;
    const double chord = glm::length(line.points.front() - line.points.back());
    EXPECT_NEAR(lengthOf(line), chord, 1e-3 * chord + 0.2 * kMm) << "but for the last half pixel at each border";
  }
  // Heights are steps of 20 mm / 65535; at the border the last half pixel repeats.
  EXPECT_LT(worst, 0.05 * kMm / 2 + 0.02 * kMm / 2 + 20.0 / 65535);
}

TEST_F(SurfaceLinesTest, SectionsFollowTheSurfaceFromOnePlaceToTheOther) {
  const auto package = cap();
  const auto section = sectionOf(package, {-30, -10}, {40, 25}, {});
  ASSERT_TRUE(section.ok()) << section.error().text();
  ASSERT_EQ(section->lines.size(), 1u);
  const std::vector<glm::dvec3>& points = section->lines[0].points;
  EXPECT_LT(glm::length(glm::dvec2(points.front()) - glm::dvec2(-30, -10)), 1e-9);
  EXPECT_LT(glm::length(glm::dvec2(points.back()) - glm::dvec2(40, 25)), 1e-9);
  const glm::dvec2 along = glm::normalize(glm::dvec2(70, 35));
  double before = -1e-12;
  for (const glm::dvec3& p : points) {
    const glm::dvec2 from(p.x + 30, p.y + 10);
    EXPECT_NEAR(along.x * from.y - along.y * from.x, 0, 1e-9);
    EXPECT_GE(glm::dot(along, from), before);
    before = glm::dot(along, from);
    const double r2 = p.x * p.x + p.y * p.y;
    // Chords across cells of 0.35 mm, where the cap is steep: 0.35^2 / 8 * 60^2 / 38^3 each way.
    EXPECT_NEAR(p.z, std::sqrt(kRadius * kRadius - r2) - kFloor, 2.2e-3);
  }
  // Along both borders, where all vertices lie on one side of the line; beyond them there is nothing.
  for (const double x : {-kSide * kMm / 2, kSide * kMm / 2}) {
    const auto border = sectionOf(plane(), {x, -20}, {x, 30}, {});
    ASSERT_TRUE(border.ok());
    ASSERT_EQ(border->lines.size(), 1u) << x;
    EXPECT_NEAR(border->lines[0].points.front().y, -20, 1e-9);
    EXPECT_NEAR(border->lines[0].points.back().y, 30, 1e-9);
    EXPECT_NEAR(border->lines[0].points.back().z, 0.05 * x + 0.6, 0.01);
  }
  const auto beyond = sectionOf(package, {70, -20}, {70, 30}, {});
  ASSERT_TRUE(beyond.ok());
  EXPECT_TRUE(beyond->lines.empty());
  // Ends outside the artwork end at its border.
  const auto longer = sectionOf(package, {0, 0}, {500, 0}, {});
  ASSERT_EQ(longer->lines.size(), 1u);
  EXPECT_NEAR(longer->lines[0].points.back().x, kSide * kMm / 2, 1e-9);
}

// A cubed ball of radius 40 about (3, 3, 3) without relief of its own: its base mesh's quads, bilinear.
TEST_F(SurfaceLinesTest, APlaneCutsAScanInClosedLinesAcrossItsPatches) {
  const NoisyPatches source(cubeSphere(6, 40, 3), 0, 0, 7);
  BuildOptions options;
  options.output = folder_.file("ball.relievo");
  ASSERT_TRUE(buildPatchPackage(source, options).ok());
  const auto package = *Package::open(options.output);
  const double noise = std::max(
      std::abs(package->manifest().domain.relief_offset_mm),
      std::abs(package->manifest().domain.relief_offset_mm + 65535 * package->manifest().domain.relief_scale_mm));
  const glm::dvec3 centre = package->manifest().base->origin_mm;
  for (const glm::dvec3 normal : {glm::dvec3(0, 0, 2), glm::dvec3(1, 2, -1)}) {
    const double length = glm::length(normal), off = 9;
    const auto cut = planeCutOf(package, normal, glm::dot(normal, centre) + off * length, {.level = 4});
    ASSERT_TRUE(cut.ok()) << cut.error().text();
    ASSERT_GE(cut->lines.size(), 1u);
    const SurfaceLine* longest = &cut->lines[0];
    for (const SurfaceLine& line : cut->lines) {
      EXPECT_TRUE(line.closed) << "a closed surface";
      if (line.points.size() > longest->points.size()) longest = &line;
      for (const glm::dvec3& p : line.points) EXPECT_NEAR(glm::dot(normal, p - centre) / length, off, 1e-9);
    }
    const double expected = std::sqrt(40.0 * 40 - off * off);
    glm::dvec3 middle(0);
    for (const glm::dvec3& p : longest->points) middle += p / static_cast<double>(longest->points.size());
    for (const glm::dvec3& p : longest->points)
      EXPECT_NEAR(glm::length(p - centre - off * normal / length), expected, 1.2 * noise + 0.6);
  }
  EXPECT_TRUE(planeCutOf(package, {0, 0, 1}, 1000, {})->lines.empty());
  EXPECT_FALSE(planeCutOf(package, {0, 0, 0}, 1, {}).ok());
}

TEST_F(SurfaceLinesTest, WhatCannotBeIsRefusedAndMemoryIsBounded) {
  const auto package = cap();
  const auto refused = [&](const Result<SurfaceLines>& r, const std::string& text) {
    ASSERT_FALSE(r.ok()) << text;
    EXPECT_EQ(r.error().kind, ErrorKind::kUsage);
    EXPECT_NE(r.error().text().find(text), std::string::npos) << r.error().text();
  };
  refused(contoursOf(package, 1e-6, {}), "at most 100000 heights");
  refused(contoursOf(package, 0, {}), "at most 100000 heights");
  refused(contoursOf(package, 1, {.level = 30}), "expected a --level of 0 to");
  refused(contoursOf(package, 0.01, {.memory_bytes = 1 << 20}), "--memory-mib allows 1");
  refused(sectionOf(package, {1, 1}, {1, 1}, {}), "between two places");
  std::atomic<bool> stop = true;
  const auto stopped = contoursOf(package, 1, {.interrupted = &stop});
  ASSERT_FALSE(stopped.ok());
  EXPECT_EQ(stopped.error().kind, ErrorKind::kInterrupted);
}

TEST_F(SurfaceLinesTest, FilesHaveTheLinesInMillimetres) {
  const auto lines = contoursOf(cap(), 8, {});
  LineDrawing drawing{.kind = LineDrawing::Kind::kContours, .title = "a < b & c", .width = 125, .height = 100};
  ASSERT_TRUE(writeLines(folder_.file("c.csv"), drawing, *lines).ok());
  ASSERT_TRUE(writeLines(folder_.file("c.svg"), drawing, *lines).ok());
  std::istringstream csv(textOf("c.csv"));
  std::string line;
  std::getline(csv, line);
  EXPECT_EQ(line, "line,closed,height_mm,x_mm,y_mm");
  size_t points = 0, all = 0;
  for (const SurfaceLine& l : lines->lines) all += l.points.size();
  while (std::getline(csv, line)) {
    size_t number = 0;
    int closed = 0;
    double height = 0, x = 0, y = 0;
    ASSERT_EQ(std::sscanf(line.c_str(), "%zu,%d,%lf,%lf,%lf", &number, &closed, &height, &x, &y), 5) << line;
    ++points;
    const SurfaceLine& of = lines->lines.at(number - 1);
    EXPECT_EQ(closed == 1, of.closed);
    EXPECT_EQ(height, of.level);
    if (height > 8) {  // the circle at 8 mm meets the border, where half a pixel repeats
      EXPECT_NEAR(std::hypot(x, y), std::sqrt(3600 - (height + 20) * (height + 20)), 0.02);
    }
  }
  EXPECT_EQ(points, all);
  const std::string svg = textOf("c.svg");
  // 125 x 100 mm, with 3 % of the longer side around and 6 % below.
  EXPECT_NE(svg.find("width=\"132.5mm\" height=\"115mm\" viewBox=\"-66.25 -53.75 132.5 115\""), std::string::npos)
      << svg.substr(0, 400);
  EXPECT_NE(svg.find("<title>a &lt; b &amp; c</title>"), std::string::npos);
  EXPECT_NE(svg.find("scale 1:1"), std::string::npos);
  EXPECT_NE(svg.find("<g data-height=\"16\">"), std::string::npos);
  EXPECT_NE(svg.find("h20\""), std::string::npos) << "a bar of 20 mm";
  // Of the path at height 16: closed, y downwards.
  const size_t at = svg.find("<path", svg.find("<g data-height=\"16\">"));
  const std::string path = svg.substr(at, svg.find("/>", at) - at);
  EXPECT_EQ(path.substr(path.size() - 2), "Z\"");
  const SurfaceLine* sixteen = nullptr;
  for (const SurfaceLine& l : lines->lines)
    if (l.level == 16) sixteen = &l;
  ASSERT_TRUE(sixteen);
  double x = 0, y = 0;
  ASSERT_EQ(std::sscanf(path.c_str(), "<path d=\"M%lf %lf", &x, &y), 2);
  EXPECT_NEAR(x, sixteen->points[0].x, 1e-6);
  EXPECT_NEAR(y, -sixteen->points[0].y, 1e-6);
  EXPECT_EQ(writeLines(folder_.file("c.pdf"), drawing, *lines).error().kind, ErrorKind::kUsage);
  // A section's distances count from its beginning.
  const auto section = sectionOf(cap(), {-10, 5}, {30, 5}, {});
  drawing = {.kind = LineDrawing::Kind::kSection, .from = {-10, 5, 0}, .along = {1, 0, 0}};
  ASSERT_TRUE(writeLines(folder_.file("s.csv"), drawing, *section).ok());
  std::istringstream profile(textOf("s.csv"));
  std::getline(profile, line);
  EXPECT_EQ(line, "line,closed,distance_mm,x_mm,y_mm,z_mm");
  std::getline(profile, line);
  EXPECT_EQ(line.substr(0, 12), "1,0,0,-10,5,") << line;
  // A plane is seen from its normal's side: right, up and normal are right-handed, up is near y.
  for (const glm::dvec3 normal :
       {glm::dvec3(0, 0, 3), glm::dvec3(1, 2, -1), glm::dvec3(0, -1, 0), glm::dvec3(0, 1, 0)}) {
    const auto [right, up] = planeAxes(normal);
    EXPECT_NEAR(glm::length(glm::cross(right, up) - glm::normalize(normal)), 0, 1e-12);
    EXPECT_GT(std::abs(glm::normalize(normal).y) > 0.95 ? -up.z : up.y, 0);
  }
}

}  // namespace surface_lines_test
