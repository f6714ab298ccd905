#include "src/artwork/base_mesh.h"

#include <gtest/gtest.h>

#include <cmath>

namespace relievo {
namespace base_mesh_test {

// Patches (0, 0) and (1, 0) of a plane seen from above: u to the right, v down.
BaseMesh twoPatches() {
  BaseMesh m;
  for (float y : {0.0f, -1.0f}) {
    for (float x : {0.0f, 1.0f, 2.0f}) m.corners.push_back({{x, y, 0}, {0, 0, 1}});
  }
  m.patches = {{0, 1, 3, 4}, {1, 2, 4, 5}};
  return m;
}

TEST(BaseMesh, BilinearAndOriented) {
  BaseMesh m = twoPatches();
  m.corners[4].position_mm = {1.5f, -2, 1};
  EXPECT_EQ(m.point(0, 0, 0), glm::dvec3(0, 0, 0));
  EXPECT_EQ(m.point(0, 1, 0), glm::dvec3(1, 0, 0));
  EXPECT_EQ(m.point(0, 0, 1), glm::dvec3(0, -1, 0));
  EXPECT_EQ(m.point(0, 1, 1), glm::dvec3(1.5, -2, 1));
  EXPECT_EQ(m.point(0, 0.5, 0.5), glm::dvec3(0.625, -0.75, 0.25));
  EXPECT_EQ(m.normal(1, 0.3, 0.9), glm::dvec3(0, 0, 1));
  const glm::dvec3 along_u = m.point(1, 0.5, 0) - m.point(1, 0, 0), along_v = m.point(1, 0, 0.5) - m.point(1, 0, 0);
  EXPECT_GT(glm::dot(glm::cross(along_v, along_u), m.normal(1, 0, 0)), 0);
}

// Two triangles that meet along (0,0)-(1,1), and sides as before.
TEST(BaseMesh, CutIsLinearOnHalves) {
  BaseMesh bilinear = twoPatches(), cut;
  bilinear.corners[4].position_mm = {1.5f, -2, 1};
  bilinear.corners[4].normal = {0, 0.6f, 0.8f};
  cut = bilinear;
  cut.cut = true;
  EXPECT_FALSE(cut == bilinear);
  for (const double t : {0.0, 0.25, 0.5, 1.0})
    for (const glm::dvec2 at : {glm::dvec2(t, 0), glm::dvec2(t, 1), glm::dvec2(0, t), glm::dvec2(1, t)}) {
      EXPECT_EQ(cut.point(0, at.x, at.y), bilinear.point(0, at.x, at.y)) << at.x << " " << at.y;
      EXPECT_EQ(cut.normal(0, at.x, at.y), bilinear.normal(0, at.x, at.y)) << at.x << " " << at.y;
    }
  EXPECT_EQ(cut.point(0, 0.5, 0.5), glm::dvec3(0.75, -1, 0.5)) << "the middle of the diagonal";
  // The corners' weights 1/4, 1/2, 0, 1/4 to the right of it, and 1/4, 0, 1/2, 1/4 to the left.
  EXPECT_EQ(cut.point(0, 0.75, 0.25), glm::dvec3(0.875, -0.5, 0.25));
  EXPECT_EQ(cut.point(0, 0.25, 0.75), glm::dvec3(0.375, -1, 0.25));
  EXPECT_EQ(bilinear.point(0, 0.75, 0.25), glm::dvec3(0.84375, -0.4375, 0.1875)) << "control";
  EXPECT_NEAR(glm::distance(cut.normal(0, 0.75, 0.25), {0, 0.15, 0.95}), 0, 1e-7);
  EXPECT_EQ(cut.twist(0), glm::dvec3(0));
  EXPECT_EQ(bilinear.twist(0), glm::dvec3(0.5, -1, 1));
  EXPECT_TRUE(inSequence(onLattice(cut, 1.0 / 64)).cut);
  EXPECT_FALSE(inSequence(onLattice(bilinear, 1.0 / 64)).cut);
}

TEST(BaseMesh, NeighboursRunAlike) {
  const auto n = patchNeighbours(twoPatches());
  EXPECT_EQ(n[0][kRight], (PatchNeighbour{1, kLeft, false}));
  EXPECT_EQ(n[1][kLeft], (PatchNeighbour{0, kRight, false}));
  for (Side s : {kLeft, kTop, kBottom}) EXPECT_EQ(n[0][s].patch, PatchNeighbour::kNone);
  for (Side s : {kRight, kTop, kBottom}) EXPECT_EQ(n[1][s].patch, PatchNeighbour::kNone);
}

// The second patch turned in steps of 90 degrees: every side of it meets the first one's right side once, in either
// direction.
TEST(BaseMesh, NeighboursTurned) {
  struct Turn {
    std::array<uint32_t, 4> corners;
    Side side;
    bool reversed;
  };
  for (const Turn& t : {Turn{{1, 2, 4, 5}, kLeft, false}, Turn{{2, 5, 1, 4}, kBottom, false},
                        Turn{{5, 4, 2, 1}, kRight, true}, Turn{{4, 1, 5, 2}, kTop, true}}) {
    BaseMesh m = twoPatches();
    m.patches[1] = t.corners;
    const auto n = patchNeighbours(m);
    EXPECT_EQ(n[0][kRight], (PatchNeighbour{1, t.side, t.reversed}));
    EXPECT_EQ(n[1][t.side], (PatchNeighbour{0, kRight, t.reversed}));
  }
}

TEST(BaseMesh, AStripClosedUpsideDown) {
  // A Moebius strip of three patches: the last one's right side is the first one's left side, reversed.
  BaseMesh m;
  for (int k = 0; k < 3; ++k) {
    for (float y : {0.0f, 1.0f})
      m.corners.push_back({{static_cast<float>(k), y, static_cast<float>(k % 2)}, {0, 0, 1}});
  }
  m.patches = {{0, 2, 1, 3}, {2, 4, 3, 5}, {4, 1, 5, 0}};
  EXPECT_EQ(baseMeshProblem(m), "");
  const auto n = patchNeighbours(m);
  EXPECT_EQ(n[0][kRight], (PatchNeighbour{1, kLeft, false}));
  EXPECT_EQ(n[2][kRight], (PatchNeighbour{0, kLeft, true}));
  EXPECT_EQ(n[0][kLeft], (PatchNeighbour{2, kRight, true}));
}

TEST(BaseMesh, SharedTooOftenIsABorder) {
  BaseMesh m = twoPatches();
  m.corners.push_back({{1, 0, 1}, {0, 1, 0}});
  m.corners.push_back({{1, -1, 1}, {0, 1, 0}});
  m.patches.push_back({1, 6, 4, 7});  // a third patch at the side 1 - 4
  const auto n = patchNeighbours(m);
  EXPECT_EQ(n[0][kRight].patch, PatchNeighbour::kNone);
  EXPECT_EQ(n[1][kLeft].patch, PatchNeighbour::kNone);
  EXPECT_EQ(n[2][kLeft].patch, PatchNeighbour::kNone);
}

TEST(BaseMesh, ProblemsByName) {
  EXPECT_EQ(baseMeshProblem(twoPatches()), "");
  auto problem = [](auto&& spoil) {
    BaseMesh m = twoPatches();
    spoil(m);
    return baseMeshProblem(m);
  };
  auto contains = [](const std::string& text, const char* part) { return text.find(part) != std::string::npos; };
  EXPECT_TRUE(contains(problem([](BaseMesh& m) { m.patches.clear(); }), "no patch"));
  EXPECT_TRUE(contains(problem([](BaseMesh& m) { m.patches.resize(kMaxPatches + 1, m.patches[0]); }), "2^20"));
  EXPECT_TRUE(contains(problem([](BaseMesh& m) { m.origin_mm.z = INFINITY; }), "origin"));
  EXPECT_TRUE(contains(problem([](BaseMesh& m) { m.corners[2].position_mm.x = NAN; }), "corner 2"));
  EXPECT_TRUE(contains(problem([](BaseMesh& m) { m.corners[3].normal = {0, 0, 1.01f}; }), "normal of corner 3"));
  EXPECT_TRUE(contains(problem([](BaseMesh& m) { m.corners[3].normal.x = NAN; }), "normal of corner 3"));
  EXPECT_TRUE(contains(problem([](BaseMesh& m) { m.patches[1][2] = 6; }), "corner 6"));
  EXPECT_TRUE(contains(problem([](BaseMesh& m) { m.patches[1][2] = m.patches[1][1]; }), "twice"));
  EXPECT_EQ(problem([](BaseMesh& m) { m.corners[3].normal = {0, 0, 1.0005f}; }), "");
}

TEST(BaseMesh, StretchedIsWhatSpaceSeesAsLong) {
  auto scaled = [](float x, float y, float shear) {
    BaseMesh m = twoPatches();
    for (BaseCorner& c : m.corners) {
      glm::vec3& p = c.position_mm;
      p = {x * p.x + shear * p.y, y * p.y, p.x};  // that it leans changes nothing
    }
    return m;
  };
  EXPECT_FALSE(isStretched(scaled(1, 1, 0)));
  EXPECT_FALSE(isStretched(scaled(2.5f, 1, 0)));
  EXPECT_TRUE(isStretched(scaled(3.5f, 1, 0)));
  EXPECT_TRUE(isStretched(scaled(1, 10, 0)));
  EXPECT_TRUE(isStretched(scaled(1, 1, 6))) << "sides of one length, but along one another";
  // A patch counts by its area.
  for (const float right : {1.2f, 1.02f}) {
    BaseMesh m = twoPatches();
    for (size_t k : {2, 5}) m.corners[k].position_mm.x = right;
    EXPECT_EQ(isStretched(m), right > 1.1f);
  }
}

}  // namespace base_mesh_test
}  // namespace relievo
