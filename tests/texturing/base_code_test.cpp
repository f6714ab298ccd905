// Sections of base meshes in few bytes: without loss whatever they hold, small where corners lie on lattices, refused
// where bytes are damaged, and as PACKAGE.md says, by a reader of its own.
#include "texturing/package/base_code.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <map>
#include <numbers>
#include <numeric>
#include <random>
#include <string>
#include <tuple>
#include <vector>

#include <gtest/gtest.h>

#include "tests/texturing/format_coder.h"
#include "tests/texturing/patch_fixture.h"
#include "texturing/package/package_layout.h"

namespace relievo::base_code_test {
namespace {

using format_coder::Coder;
using format_coder::Model;

constexpr uint32_t kSeed = 20261127;
constexpr double kStepMm = 0.003;

struct Contents {
  std::string name;
  BaseSection section;
  double step_mm = 0;
  uint32_t patches() const { return static_cast<uint32_t>(section.mesh.patches.size()); }
  bool cut() const { return section.mesh.cut; }
  BaseSectionEnd end() const {
    return section.texture_depths.empty() ? BaseSectionEnd::kShapes : BaseSectionEnd::kTextureDepths;
  }
};

float rounded(double v, int bits) {
  const auto mask = ~((1u << (23 - bits)) - 1);
  return std::bit_cast<float>(std::bit_cast<uint32_t>(static_cast<float>(v)) & mask);
}

// The next number that has so many bits behind the point, as a builder rounds bounds.
float roundedUp(double v, int bits) {
  const auto below = (1u << (23 - bits)) - 1;
  return std::bit_cast<float>((std::bit_cast<uint32_t>(static_cast<float>(v)) + below) & ~below);
}

// ---- meshes ----
// No symmetries, which zstd would find.
BaseMesh uneven(BaseMesh mesh) {
  std::mt19937 random(kSeed);
  for (BaseCorner& c : mesh.corners) {
    auto some = [&] { return 1e-3f * (static_cast<float>(random() % 1000) - 500); };
    c.position_mm += glm::vec3(some(), some(), some());
    c.normal = glm::normalize(c.normal + 0.05f * glm::vec3(some(), some(), some()));
  }
  return mesh;
}
BaseCorner cornerAt(double x, double y, double z) {
  return {glm::vec3(static_cast<float>(x), static_cast<float>(y), static_cast<float>(z)), {0, 0, 1}};
}
// All patches run alike; their numbers grow along x, then along y.
BaseMesh sheet(uint32_t nx, uint32_t ny) {
  BaseMesh mesh;
  for (uint32_t y = 0; y <= ny; ++y)
    for (uint32_t x = 0; x <= nx; ++x) mesh.corners.push_back(cornerAt(8 * x, -8.0 * y, 0));
  for (uint32_t y = 0; y < ny; ++y)
    for (uint32_t x = 0; x < nx; ++x) {
      const uint32_t first = y * (nx + 1) + x;
      mesh.patches.push_back({first, first + 1, first + nx + 1, first + nx + 2});
    }
  return mesh;
}
// n patches around corner 0.
BaseMesh pole(uint32_t n) {
  BaseMesh mesh;
  mesh.corners.push_back(cornerAt(0, 0, 10));
  for (uint32_t i = 0; i < 2 * n; ++i) {
    const double angle = std::numbers::pi * i / n, radius = i % 2 ? 55 : 50;
    mesh.corners.push_back(cornerAt(radius * std::cos(angle), radius * std::sin(angle), 0));
  }
  for (uint32_t i = 0; i < n; ++i) mesh.patches.push_back({0, 1 + 2 * i, 1 + 2 * (i + 1) % (2 * n), 2 + 2 * i});
  return mesh;
}
// Pages of 2 x n patches that all have the sides from corner 0 to corner n.
BaseMesh book(uint32_t pages, uint32_t n) {
  BaseMesh mesh;
  for (uint32_t y = 0; y <= n; ++y) mesh.corners.push_back(cornerAt(0, 8 * y, 0));
  for (uint32_t page = 0; page < pages; ++page) {
    const auto first = static_cast<uint32_t>(mesh.corners.size());
    for (uint32_t y = 0; y <= n; ++y)
      for (uint32_t x = 1; x <= 2; ++x) mesh.corners.push_back(cornerAt(8 * x, 8 * y, 5 * page));
    for (uint32_t y = 0; y < n; ++y) {
      mesh.patches.push_back({y, first + 2 * y, y + 1, first + 2 * y + 2});
      mesh.patches.push_back({first + 2 * y, first + 2 * y + 1, first + 2 * y + 2, first + 2 * y + 3});
    }
  }
  return mesh;
}
// A strip of n patches closed upside down.
BaseMesh moebius(uint32_t n) {
  BaseMesh mesh;
  for (uint32_t i = 0; i < n; ++i)
    for (int y = 0; y < 2; ++y) mesh.corners.push_back(cornerAt(8 * i, 8 * y, i % 3));
  for (uint32_t i = 0; i + 1 < n; ++i) mesh.patches.push_back({2 * i, 2 * i + 2, 2 * i + 1, 2 * i + 3});
  mesh.patches.push_back({2 * n - 2, 1, 2 * n - 1, 0});
  return mesh;
}
BaseMesh together(BaseMesh a, const BaseMesh& b) {
  const auto first = static_cast<uint32_t>(a.corners.size());
  a.corners.insert(a.corners.end(), b.corners.begin(), b.corners.end());
  for (auto patch : b.patches) {
    for (uint32_t& corner : patch) corner += first;
    a.patches.push_back(patch);
  }
  return a;
}
BaseMesh shuffled(BaseMesh mesh) {
  std::shuffle(mesh.patches.begin(), mesh.patches.end(), std::mt19937(kSeed));
  return mesh;
}
// Every n-th patch left for right, so that it faces the other way.
BaseMesh flipped(BaseMesh mesh, size_t n) {
  for (size_t p = 0; p < mesh.patches.size(); p += n) {
    auto& c = mesh.patches[p];
    std::swap(c[0], c[1]), std::swap(c[2], c[3]);
  }
  return mesh;
}
struct NamedMesh {
  std::string name;
  BaseMesh mesh;
};
std::vector<NamedMesh> meshes() {
  return {{"closed, each patch turned at random", testing_support::cubeSphere(4, 50, kSeed)},
          {"with a border", testing_support::cubeSphere(4, 50, kSeed, true)},
          {"sheet", sheet(9, 7)},
          {"sheet with flipped patches", flipped(sheet(9, 7), 3)},
          {"one patch", sheet(1, 1)},
          {"pole", pole(70)},
          {"side of three patches", book(3, 5)},
          {"side of four patches", book(4, 4)},
          {"Moebius strip", moebius(9)},
          {"pieces", together(together(sheet(3, 4), moebius(5)), flipped(pole(6), 2))}};
}

// As facesBase() (geometry/remesh/base_faces.h) leaves them: cut, with the mean normals of the triangles around
// corners.
BaseMesh ofTriangles(BaseMesh mesh, float sign = 1) {
  mesh.cut = true;
  std::vector<glm::dvec3> sum(mesh.corners.size(), glm::dvec3(0));
  for (const auto& patch : mesh.patches) {
    auto at = [&](size_t k) { return glm::dvec3(mesh.corners[patch[k]].position_mm); };
    for (const auto& t : {std::array<size_t, 3>{0, 1, 3}, {0, 3, 2}})
      for (size_t k = 0; k < 3; ++k) {
        const glm::dvec3 p = at(t[k]), a = at(t[(k + 1) % 3]) - p, b = at(t[(k + 2) % 3]) - p, n = glm::cross(a, b);
        sum[patch[t[k]]] += glm::normalize(n) * std::atan2(glm::length(n), glm::dot(a, b));
      }
  }
  for (size_t c = 0; c < sum.size(); ++c) mesh.corners[c].normal = sign * glm::vec3(glm::normalize(sum[c]));
  return mesh;
}

// ---- sections ----
constexpr std::array<uint8_t, 8> kSevenths{0, 37, 73, 110, 146, 183, 219, 255};
std::array<uint8_t*, 5> partsOf(DeviationShape& s) { return {&s.below, &s.above, &s.aside, &s.between, &s.apart}; }

// Errors that fall by four from grid to grid, as smooth surfaces' do, others random.
BaseSection over(BaseMesh mesh, bool depths) {
  std::mt19937 random(kSeed);
  BaseSection s;
  s.mesh = std::move(mesh);
  s.error_unit_mm = 1e-4;
  for (size_t p = 0; p < s.mesh.patches.size(); ++p) {
    CoarseErrors errors;
    double mm = 0.001 + 1e-6 * static_cast<double>(random() % 1000);
    for (size_t k = errors.size(); k-- > 0; mm *= 4) errors[k] = rounded(mm, 5);
    if (p % 3 == 0) errors[6] = 0;
    s.coarse_errors.push_back(errors);
    CoarseBlocks blocks;
    for (uint8_t& b : blocks) b = p % 5 == 0 ? 255 : static_cast<uint8_t>(17 * (random() % 16));
    s.coarse_blocks.push_back(blocks);
    const float slope = rounded(0.1 + 1e-4 * static_cast<double>(random() % 1000), 5);
    s.slopes.push_back({-slope, slope, 0, 2 * slope});
    CoarseShapes shapes;
    for (size_t i = 0; i < shapes.size(); ++i) {
      shapes[i] = {};
      if (i >= 24 || random() % 4 == 0) continue;
      for (uint8_t* part : partsOf(shapes[i])) *part = kSevenths[random() % 8];
    }
    s.shapes.push_back(shapes);
    if (depths) s.texture_depths.push_back(static_cast<int8_t>(random() % 4) - 1);
  }
  return s;
}
BaseSection sphere(int n, bool on_lattice, bool depths) {
  BaseMesh mesh = uneven(testing_support::cubeSphere(n, 50, kSeed));
  mesh.origin_mm = {1e7, -3, 0.1};
  return over(on_lattice ? onLattice(mesh, kStepMm) : mesh, depths);
}

// Nothing is known of blocks and shapes.
BaseSection withoutShares(BaseSection s) {
  for (size_t p = 0; p < s.shapes.size(); ++p) s.shapes[p] = {}, s.coarse_blocks[p].fill(255);
  return s;
}

// Errors of patches without heights: a quarter of |P0 - P1 - P2 + P3|, over 4^k.
struct ByTwist {
  int bits = 6;           // behind the point
  double least_mm = 0;    // the finest grid itself is off by so much, up to twice that, which adds to coarser ones
  bool farther = false;   // by up to twice as much as that says
  size_t only_every = 1;  // others stay as they are
};
BaseSection withErrors(BaseSection s, const ByTwist& by) {
  std::mt19937 random(kSeed);
  for (size_t p = 0; p < s.mesh.patches.size(); p += by.only_every) {
    auto at = [&](size_t k) { return glm::dvec3(s.mesh.corners[s.mesh.patches[p][k]].position_mm); };
    const double twist_mm = glm::length(at(0) - at(1) - at(2) + at(3)) / 4;
    const double least_mm = by.least_mm * (1 + static_cast<double>(random() % 1000) / 1000);
    const double times = by.farther ? 1 + std::ldexp(1, -static_cast<int>(random() % 9)) : 1;
    for (size_t k = 0; k < 7; ++k) {
      const double own_mm = std::ldexp(twist_mm, -2 * static_cast<int>(k));
      s.coarse_errors[p][k] = roundedUp(times * (own_mm > least_mm ? own_mm + least_mm : least_mm), by.bits);
    }
  }
  return s;
}

// Shapes of all grids. Whole grids are unknown, or blocks; others are at random, or as in the grid before.
BaseSection withShapes(BaseSection s) {
  std::mt19937 random(kSeed);
  for (CoarseShapes& shapes : s.shapes) {
    shapes = {};
    for (size_t grid = 0, first = 0, before = 0; grid < 7; ++grid) {
      const size_t side = grid < 4 ? 1 : size_t{2} << (grid - 4);
      const bool alike = random() % 2, unknown = random() % 3 == 0;
      for (size_t i = 0; i < side * side && !unknown; ++i) {
        DeviationShape& own = shapes[first + i];
        if (random() % 4 == 0) continue;
        if (alike && grid > 0) own = shapes[before + i / side / 2 * (side / 2) + i % side / 2];
        else
          for (uint8_t* part : partsOf(own)) *part = kSevenths[random() % 8];
      }
      before = first;
      first += side * side;
    }
  }
  return s;
}

std::vector<Contents> contents() {
  std::vector<Contents> all;
  all.push_back({"on lattices", sphere(4, true, true), kStepMm});
  all.push_back({"without texture depths", sphere(3, true, false), kStepMm});
  all.push_back({"off the lattices", sphere(3, false, true), kStepMm});
  all.push_back({"no lattice", sphere(2, false, false), 0});
  all.push_back({"shares of other kinds", sphere(3, true, true), kStepMm});
  all.back().section.coarse_blocks[7][3] = 100;
  all.back().section.shapes[2][11].aside = 100;
  all.push_back({"bounds of more bits", sphere(3, true, true), kStepMm});
  all.back().section.coarse_errors[5][2] = std::nextafter(all.back().section.coarse_errors[5][2], 0.0f);
  all.back().section.slopes[1].min_v = -0.0f;
  all.push_back({"corners in another order", sphere(3, true, true), kStepMm});
  all.back().section.mesh = shuffled(all.back().section.mesh);
  all.push_back({"far from each other", sphere(2, true, true), kStepMm});
  for (auto& corner : all.back().section.mesh.corners)
    corner.position_mm *= static_cast<float>(kMostPositionSteps) * kStepMm / 60;
  all.back().section.mesh = onLattice(all.back().section.mesh, kStepMm);
  for (const NamedMesh& m : meshes()) {
    const BaseMesh mesh = uneven(m.mesh);
    auto add = [&](const char* how, const BaseMesh& base) {
      all.push_back({m.name + how, withErrors(withoutShares(over(base, false)), {}), kStepMm});
    };
    add(", in sequence", onLattice(inSequence(mesh), kStepMm));
    add(", shuffled", onLattice(shuffled(mesh), kStepMm));
    add(", corners shuffled, too", shuffled(onLattice(mesh, kStepMm)));
  }
  auto addErrors = [&](const char* name, const ByTwist& by, bool on_lattice = true) {
    const BaseMesh mesh = uneven(inSequence(testing_support::cubeSphere(5, 50, kSeed)));
    all.push_back({name, withErrors(over(on_lattice ? onLattice(mesh, kStepMm) : mesh, true), by), kStepMm});
  };
  addErrors("the finest grid is off", {.least_mm = 0.0005});
  addErrors("the finest grid is off a little", {.least_mm = 1e-6});
  addErrors("errors of fewer bits", {.bits = 3, .least_mm = 0.0005});
  addErrors("errors of more bits", {.bits = 7, .least_mm = 0.0005});
  addErrors("errors larger than the twist", {.farther = true});
  addErrors("all larger, the finest grid off", {.least_mm = 0.0005, .farther = true, .only_every = 2});
  addErrors("some errors by twist", {.only_every = 3});
  addErrors("errors by a twist that is not known", {}, false);
  for (const float sign : {1.0f, -1.0f}) {
    const BaseMesh mesh = ofTriangles(uneven(inSequence(testing_support::cubeSphere(5, 50, kSeed))), sign);
    const std::string of = sign > 0 ? "normals of triangles" : "normals opposite to triangles'";
    all.push_back({of, withErrors(over(onLattice(mesh, kStepMm), false), {.only_every = 2}), kStepMm});
    all.push_back({of + ", off the lattice", over(mesh, false), kStepMm});
    all.push_back({of + ", of patches that are not cut", over(onLattice(mesh, kStepMm), false), kStepMm});
    all.back().section.mesh.cut = false;
    all.push_back({of + ", some of which have no area", over(onLattice(mesh, kStepMm), false), kStepMm});
    for (uint32_t c : all.back().section.mesh.patches[7])
      all.back().section.mesh.corners[c].position_mm = glm::vec3(0, 0, static_cast<float>(kStepMm * 5));
  }
  all.push_back({"shapes of all grids", withShapes(sphere(4, true, true)), kStepMm});
  return all;
}

struct Kind {
  const char* name;
  BaseCodeKind kind;
};
constexpr std::array kKinds{Kind{"by corners", BaseCodeKind::kByCorners}, Kind{"by sides", BaseCodeKind::kBySides},
                            Kind{"by the border", BaseCodeKind::kByBorder}};

TEST(BaseCode, IsWithoutLoss) {
  for (const auto& [kind_name, kind] : kKinds) {
    for (const Contents& c : contents()) {
      SCOPED_TRACE(c.name + ", " + kind_name);
      const std::vector<uint8_t> section = encodeBaseSection(c.section),
                                 code = encodeBaseCode(c.section, c.step_mm, kind, c.cut());
      EXPECT_LE(code.size(), mostCodedBaseBytes(section.size()));
      EXPECT_GE(code.size(), kLeastCodedBaseBytes);
      const auto back = decodeBaseCode(code, c.patches(), c.end(), kind, c.cut());
      ASSERT_TRUE(back.ok()) << back.error().text();
      EXPECT_TRUE(encodeBaseSection(*back) == section);
      EXPECT_FALSE(baseSectionFault(*back));
    }
  }
}

TEST(BaseCode, AnyBytesOfASectionComeBack) {
  for (const auto& [kind_name, kind] : kKinds) {
    std::mt19937 random(kSeed);
    for (int i = 0; i < 20; ++i) {
      BaseSection like = sphere(2, i % 2, i % 3 == 0);
      const auto patches = static_cast<uint32_t>(like.mesh.patches.size());
      std::vector<std::span<std::byte>> parts{std::as_writable_bytes(std::span(&like.mesh.origin_mm, 1)),
                                              std::as_writable_bytes(std::span(&like.error_unit_mm, 1))};
      auto add = [&](auto& of_section) { parts.push_back(std::as_writable_bytes(std::span(of_section))); };
      add(like.mesh.corners), add(like.coarse_errors), add(like.coarse_blocks), add(like.slopes), add(like.shapes);
      if (i % 3 == 0) add(like.texture_depths);
      size_t bytes = 0;
      for (const auto& part : parts) bytes += part.size();
      for (int n = 0; n < 200; ++n) {
        size_t at = random() % bytes, part = 0;
        for (; at >= parts[part].size(); ++part) at -= parts[part].size();
        parts[part][at] = static_cast<std::byte>(random());
      }
      const auto back = decodeBaseCode(encodeBaseCode(like, kStepMm, kind), patches,
                                       i % 3 == 0 ? BaseSectionEnd::kTextureDepths : BaseSectionEnd::kShapes, kind);
      ASSERT_TRUE(back.ok());
      EXPECT_TRUE(encodeBaseSection(*back) == encodeBaseSection(like)) << i << ", " << kind_name;
    }
  }
}

// Of any sign and size, infinite ones and what is no number, too.
TEST(BaseCode, AnyErrorsComeBack) {
  BaseSection section = sphere(3, true, false);
  const auto patches = static_cast<uint32_t>(section.mesh.patches.size());
  for (const auto& [kind_name, kind] : kKinds) {
    std::mt19937 random(kSeed);
    for (uint32_t spare = 0; spare <= 7; ++spare) {
      for (size_t i = 0; i < 7 * patches; ++i) {
        const auto bits = static_cast<uint32_t>(random() % 0x10000 >> spare << spare << 16);
        section.coarse_errors[i / 7][i % 7] = std::bit_cast<float>(bits == 0x80000000 ? 0 : bits);
      }
      const auto back = decodeBaseCode(encodeBaseCode(section, kStepMm, kind), patches, BaseSectionEnd::kShapes, kind);
      ASSERT_TRUE(back.ok());
      EXPECT_TRUE(encodeBaseSection(*back) == encodeBaseSection(section)) << spare << ", " << kind_name;
    }
  }
}

// What all patches have alike may be there once. Control: it is one of them that has another slope.
TEST(BaseCode, OneForAllIsWrittenAsOneForEach) {
  BaseSection once = sphere(3, true, true);
  const size_t patches = once.mesh.patches.size();
  once.coarse_errors.resize(1), once.coarse_blocks.resize(1), once.slopes.resize(1), once.shapes.resize(1);
  BaseSection each = once;
  each.coarse_errors.resize(patches, once.coarse_errors[0]);
  each.coarse_blocks.resize(patches, once.coarse_blocks[0]);
  each.slopes.resize(patches, once.slopes[0]);
  each.shapes.resize(patches, once.shapes[0]);
  BaseSection other = each;
  other.slopes.back().max_u *= 2;
  EXPECT_TRUE(encodeBaseSection(once) == encodeBaseSection(each));
  EXPECT_FALSE(encodeBaseSection(once) == encodeBaseSection(other));
  for (const auto& [kind_name, kind] : kKinds) {
    SCOPED_TRACE(kind_name);
    EXPECT_TRUE(encodeBaseCode(once, kStepMm, kind) == encodeBaseCode(each, kStepMm, kind));
    EXPECT_FALSE(encodeBaseCode(once, kStepMm, kind) == encodeBaseCode(other, kStepMm, kind));
  }
}

// Control: of a patch that has an error they come back, and of all others.
TEST(BaseCode, BlocksAndShapesOfNoErrorsAreLeftOut) {
  BaseSection section = withoutShares(sphere(3, true, true));
  const auto patches = static_cast<uint32_t>(section.mesh.patches.size());
  for (CoarseErrors& errors : section.coarse_errors) errors.fill(0);
  for (const auto& [kind_name, kind] : kKinds) {
    SCOPED_TRACE(kind_name);
    for (const bool any : {false, true}) {
      BaseSection of = section;
      if (any) of.coarse_errors[patches / 2][0] = 1;
      const auto back =
          decodeBaseCode(encodeBaseCode(of, kStepMm, kind), patches, BaseSectionEnd::kTextureDepths, kind);
      ASSERT_TRUE(back.ok());
      EXPECT_EQ(back->coarse_blocks.size(), any ? patches : 0);
      EXPECT_EQ(back->shapes.size(), any ? patches : 0);
      EXPECT_EQ(back->slopes, of.slopes);
      EXPECT_EQ(back->texture_depths, of.texture_depths);
      EXPECT_EQ(back->coarse_errors, of.coarse_errors);
      EXPECT_EQ(encodeBaseSection(*back) == encodeBaseSection(of), any);
    }
  }
}

// Shares at random take their bits in any code. Control: off the lattices corners alone take more than all does on
// them.
TEST(BaseCode, TakesFewBytesOnLattices) {
  const BaseSection on = withoutShares(sphere(12, true, true)), off = withoutShares(sphere(12, false, true));
  const std::vector<uint8_t> section = encodeBaseSection(on);
  const size_t packed = packBaseSection(section, 19).size();
  for (const auto& [kind_name, kind] : kKinds) {
    const size_t coded = encodeBaseCode(on, kStepMm, kind).size();
    EXPECT_LT(coded, 0.75 * static_cast<double>(packed)) << packed << ", " << kind_name;
    const size_t off_lattice = encodeBaseCode(off, kStepMm, kind).size();
    EXPECT_GT(off_lattice, coded + 16 * on.mesh.corners.size()) << kind_name;
  }
}

// What patches without heights take. Controls: they take more where patches are shuffled, or errors are not the
// twist's.
TEST(BaseCode, SidesTakeFewerBytesOfPatchesInSequence) {
  const BaseMesh mesh = uneven(testing_support::cubeSphere(12, 50, kSeed));
  auto shareOfBytes = [](const BaseMesh& base, bool by_twist, double least_mm = 0) {
    BaseSection s = withoutShares(over(onLattice(base, kStepMm), false));
    if (by_twist) s = withErrors(s, {.least_mm = least_mm});
    for (HeightSlopes& slopes : s.slopes) slopes = {};
    return static_cast<double>(encodeBaseCode(s, kStepMm, BaseCodeKind::kBySides).size()) /
           static_cast<double>(encodeBaseCode(s, kStepMm, BaseCodeKind::kByCorners).size());
  };
  const double in_sequence = shareOfBytes(inSequence(mesh), true), off = shareOfBytes(inSequence(mesh), true, 0.0005),
               in_shuffle = shareOfBytes(shuffled(mesh), true), other_errors = shareOfBytes(inSequence(mesh), false);
  EXPECT_LT(in_sequence, 0.6);
  EXPECT_LT(off, 0.7) << "the finest grid itself is off";
  EXPECT_GT(in_shuffle, in_sequence + 0.15);
  EXPECT_GT(other_errors, in_sequence + 0.25);
  EXPECT_LT(other_errors, 0.95) << "sides alone say corners in fewer bytes";
}

// A scan's own triangles, which have no heights. Controls: it is the normals that take fewer bytes, and the errors.
TEST(BaseCode, TheBorderTakesFewerBytesOfTriangles) {
  const BaseMesh mesh = onLattice(ofTriangles(uneven(inSequence(testing_support::cubeSphere(20, 50, kSeed)))), kStepMm);
  auto bytes = [&](BaseMesh of, BaseCodeKind kind, bool cut) {
    BaseSection s = withoutShares(over(std::move(of), false));
    for (CoarseErrors& errors : s.coarse_errors) errors.fill(0);
    for (HeightSlopes& slopes : s.slopes) slopes = {};
    return static_cast<double>(encodeBaseCode(s, kStepMm, kind, cut).size());
  };
  BaseMesh leaning = mesh;
  std::mt19937 random(kSeed);
  for (BaseCorner& c : leaning.corners) {
    auto some = [&] { return 1e-4f * (static_cast<float>(random() % 1000) - 500); };
    c.normal = glm::normalize(c.normal + glm::vec3(some(), some(), some()));
  }
  const double patches = static_cast<double>(mesh.patches.size()), sides = bytes(mesh, BaseCodeKind::kBySides, true),
               border = bytes(mesh, BaseCodeKind::kByBorder, true);
  EXPECT_LT(border, 0.75 * sides);
  EXPECT_GT(bytes(onLattice(leaning, kStepMm), BaseCodeKind::kByBorder, true), border + patches) << "other normals";
  EXPECT_GT(bytes(mesh, BaseCodeKind::kByBorder, false), border + patches / 8) << "errors 0 where patches twist";
  BaseMesh opposite = mesh;
  for (BaseCorner& c : opposite.corners) c.normal = -c.normal;
  EXPECT_LT(bytes(opposite, BaseCodeKind::kByBorder, true), border + patches / 8) << "normals to the other side";
}

// Rows beside one another, the second half of which meets the first: along a border that is far from where the patches
// before are. Control: by sides each such corner takes four bytes.
TEST(BaseCode, CornersOfOtherPartsOfTheBorderTakeFewBytes) {
  const uint32_t n = 200;
  BaseMesh rows = sheet(n, 3);
  std::vector<std::array<uint32_t, 4>> patches;
  for (const uint32_t row : {0u, 2u, 1u})
    patches.insert(patches.end(), rows.patches.begin() + row * n, rows.patches.begin() + (row + 1) * n);
  rows.patches = patches;
  rows = onLattice(rows, kStepMm);
  auto bytes = [&](BaseCodeKind kind) {
    return static_cast<double>(encodeBaseCode(withoutShares(over(rows, false)), kStepMm, kind).size());
  };
  EXPECT_LT(bytes(BaseCodeKind::kByBorder), bytes(BaseCodeKind::kBySides) - 3.0 * n);
}

TEST(BaseCode, DamagedBytesAreSectionsOrErrors) {
  const BaseSection good = sphere(2, true, true);
  const auto patches = static_cast<uint32_t>(good.mesh.patches.size());
  for (const auto& [kind_name, kind] : kKinds) {
    SCOPED_TRACE(kind_name);
    const std::vector<uint8_t> code = encodeBaseCode(good, kStepMm, kind);
    auto decoded = [&, of = kind](std::span<const uint8_t> bytes, uint32_t n) {
      return decodeBaseCode(bytes, n, BaseSectionEnd::kTextureDepths, of);
    };
    for (size_t n = 0; n < code.size(); ++n) EXPECT_FALSE(decoded(std::span(code).first(n), patches).ok()) << n;
    std::vector<uint8_t> longer = code;
    longer.push_back(0);
    EXPECT_FALSE(decoded(longer, patches).ok());
    EXPECT_FALSE(decoded(code, patches - 1).ok());
    EXPECT_FALSE(decoded(code, patches + 1).ok());
    EXPECT_FALSE(decodeBaseCode(code, patches, BaseSectionEnd::kShapes, kind).ok());
    std::mt19937 random(kSeed);
    int errors = 0;
    for (int i = 0; i < 3000; ++i) {
      std::vector<uint8_t> bytes = code;
      bytes[random() % bytes.size()] ^= static_cast<uint8_t>(1u << random() % 8);
      const auto back = decoded(bytes, patches);
      errors += !back.ok();
      if (back.ok()) (void)baseSectionFault(*back);
    }
    EXPECT_GT(errors, 2000) << "hardly any damage ends where the last bit does";
    std::vector<uint8_t> corners = code;
    storeLittle(corners.data(), 4 * patches + 1);
    EXPECT_NE(decoded(corners, patches).error().message.find("at most four corners a patch"), std::string::npos);
  }
}

TEST(BaseLattice, MovesCornersByHalfAStepAndKeepsNormalsOfLengthOne) {
  const BaseMesh mesh = testing_support::cubeSphere(6, 50, kSeed), on = onLattice(mesh, kStepMm);
  EXPECT_EQ(baseMeshProblem(on), "");
  ASSERT_EQ(on.patches.size(), mesh.patches.size());
  uint32_t named = 0;
  double moved = 0, turned = 0;
  for (size_t p = 0; p < on.patches.size(); ++p)
    for (size_t k = 0; k < 4; ++k) {
      EXPECT_LE(on.patches[p][k], named);
      named = std::max(named, on.patches[p][k] + 1);
      const BaseCorner &a = mesh.corners[mesh.patches[p][k]], &b = on.corners[on.patches[p][k]];
      for (int axis = 0; axis < 3; ++axis)
        moved = std::max(moved, std::abs(double{a.position_mm[axis]} - b.position_mm[axis]));
      turned = std::max(turned, double{glm::length(a.normal - b.normal)});
    }
  EXPECT_EQ(named, on.corners.size());
  EXPECT_LE(moved, kStepMm / 2 * (1 + 1e-4));
  EXPECT_GT(moved, kStepMm / 4) << "control: corners move";
  EXPECT_LE(turned, 2.0 / kNormalSteps);
  EXPECT_TRUE(onLattice(on, kStepMm) == on);
}

// Of each patch, the number of the part that it is connected with by sides.
std::vector<size_t> connectedParts(const BaseMesh& mesh) {
  const auto neighbours = patchNeighbours(mesh);
  std::vector<size_t> part(mesh.patches.size());
  std::iota(part.begin(), part.end(), size_t{0});
  for (bool changes = true; changes;) {
    changes = false;
    for (size_t p = 0; p < part.size(); ++p)
      for (const PatchNeighbour& n : neighbours[p])
        if (n.patch != PatchNeighbour::kNone && part[n.patch] < part[p]) part[p] = part[n.patch], changes = true;
  }
  return part;
}

TEST(BaseSequence, HasTheSamePatchesEachNextToOneBefore) {
  for (const NamedMesh& m : meshes()) {
    for (bool shuffle : {false, true}) {
      SCOPED_TRACE(m.name + (shuffle ? ", shuffled" : ""));
      const BaseMesh mesh = shuffle ? shuffled(m.mesh) : m.mesh, sequence = inSequence(mesh);
      EXPECT_TRUE(sequence.corners == mesh.corners);
      EXPECT_EQ(sequence.origin_mm, mesh.origin_mm);
      auto sorted = [](std::vector<std::array<uint32_t, 4>> patches) {
        std::sort(patches.begin(), patches.end());
        return patches;
      };
      ASSERT_EQ(sorted(sequence.patches), sorted(mesh.patches));
      EXPECT_EQ(sequence.patches[0], mesh.patches[0]);
      EXPECT_TRUE(inSequence(sequence) == sequence);

      const auto neighbours = patchNeighbours(sequence);
      const std::vector<size_t> part = connectedParts(sequence);
      for (size_t p = 0; p < part.size(); ++p) {
        bool next_to_one_before = false;
        for (const PatchNeighbour& n : neighbours[p]) next_to_one_before |= n.patch < p;
        EXPECT_EQ(next_to_one_before, part[p] != p) << p;
        EXPECT_TRUE(part[p] == p || part[p] == part[p - 1]) << p << ": one part after the other";
      }
    }
  }
}

// Control: of shuffled patches hardly any does.
TEST(BaseSequence, MostPatchesMeetTheOneDirectlyBefore) {
  auto share = [](const BaseMesh& mesh) {
    const auto neighbours = patchNeighbours(mesh);
    size_t n = 0;
    for (size_t p = 1; p < mesh.patches.size(); ++p)
      n += std::any_of(neighbours[p].begin(), neighbours[p].end(),
                       [&](const PatchNeighbour& beside) { return beside.patch == p - 1; });
    return static_cast<double>(n) / static_cast<double>(mesh.patches.size() - 1);
  };
  for (bool open : {false, true}) {
    const BaseMesh mesh = shuffled(testing_support::cubeSphere(12, 50, kSeed, open));
    EXPECT_GT(share(inSequence(mesh)), 0.9);
    EXPECT_LT(share(mesh), 0.05);
  }
}

// Inwards, clockwise as seen on the page, whichever way patches but the first are turned.
TEST(BaseSequence, WindsAroundASheet) {
  BaseMesh mesh = sheet(4, 4);
  for (size_t turns : {0, 1, 3}) {
    for (size_t p = 1; p < mesh.patches.size(); ++p)
      for (size_t n = 0; n < turns * p; ++n) {
        const auto c = mesh.patches[p];
        mesh.patches[p] = {c[1], c[3], c[0], c[2]};
      }
    std::vector<size_t> order;
    for (const auto& patch : inSequence(mesh).patches)
      order.push_back(
          static_cast<size_t>(std::find(mesh.patches.begin(), mesh.patches.end(), patch) - mesh.patches.begin()));
    EXPECT_EQ(order, (std::vector<size_t>{0, 1, 2, 3, 7, 11, 15, 14, 13, 12, 8, 4, 5, 6, 10, 9})) << turns;
  }
}

// ---- a reader by what PACKAGE.md says ----

// Throws where a code names what is not there.
class Reader {
 public:
  Reader(std::span<const uint8_t> code, uint32_t patches, bool depths, BaseCodeKind kind, bool cut)
      : corners_(static_cast<uint32_t>(code[0] | code[1] << 8 | code[2] << 16)),
        patches_(patches),
        by_sides_(kind != BaseCodeKind::kByCorners),
        by_border_(kind == BaseCodeKind::kByBorder),
        cut_(cut),
        coder_(code.subspan(4)) {
    put(corners_, 4), put(patches, 4);
    for (int i = 0; i < 32; ++i) put(coder_.plain(8), 1);
    places_.resize(corners_);
    if (by_border_) readQuadsByBorder();
    else if (by_sides_) readQuadsBySides();
    else readQuads();
    readCorners();
    const std::vector<uint8_t> errors = by_sides_ ? readErrorsByTwist() : readErrors(), blocks = readBlocks();
    const std::vector<uint8_t> slopes = words(
        4,
        [&](int k, const std::vector<int>& order, int) {
          return std::pair(k == 0 ? first_ : k == 2 ? order[0] : -order[static_cast<size_t>(k - 1)], 0);
        },
        's', false);
    const std::vector<uint8_t> shapes = readShapes();
    for (const auto* array : std::initializer_list<const std::vector<uint8_t>*>{&corner_bytes_, &quad_bytes_, &errors,
                                                                                &blocks, &slopes, &shapes})
      section.insert(section.end(), array->begin(), array->end());
    for (uint32_t p = 0; depths && p < patches; ++p) put(static_cast<uint32_t>(symbol('d', 0, 0, 8)), 1);
  }
  bool ended() const { return coder_.ended(); }
  std::vector<uint8_t> section;

 private:
  static void append(std::vector<uint8_t>& to, uint64_t v, int bytes) {
    for (int i = 0; i < bytes; ++i) to.push_back(static_cast<uint8_t>(v >> 8 * i));
  }
  void put(uint64_t v, int bytes) { append(section, v, bytes); }
  int modelled(char name, int a, int b, int node) { return coder_.bit(models_[{name, a, b, node}]); }
  int symbol(char name, int a, int b, int bits) {
    int node = 1;
    for (int i = 0; i < bits; ++i) node = 2 * node + modelled(name, a, b, node);
    return node - (1 << bits);
  }
  int number(char name, int a, int b) {
    const int width = symbol(name, a, b, 6);
    if (width == 0) return 0;
    uint64_t n = 1;
    for (int i = 0; i < width - 1; ++i)
      n = 2 * n + (i < 2 ? static_cast<uint64_t>(modelled(name, a, b, 1000 + 10 * width + i)) : coder_.plain(1));
    return n % 2 ? -static_cast<int>((n + 1) / 2) : static_cast<int>(n / 2);
  }

  // As "corners of patches" says it of place k.
  uint32_t corner(size_t k) {
    const int rank = symbol('q', static_cast<int>(k), was_new_, 6);
    was_new_ = rank == 0;
    return rank == 0 ? next_ : rank == 63 ? coder_.plain(32) : recent_.at(recent_.size() - static_cast<size_t>(rank));
  }
  void named(uint32_t corner) {
    if (corner == next_) ++next_;
    std::erase(recent_, corner);
    recent_.push_back(corner);
    if (recent_.size() > 62) recent_.erase(recent_.begin());
    places_.at(corner).push_back(static_cast<uint32_t>(quads_.size()));
    quads_.push_back(corner);
    append(quad_bytes_, corner, 4);
  }
  void readQuads() {
    for (uint32_t i = 0; i < 4 * patches_; ++i) named(corner(i % 4));
  }
  void readQuadsBySides() {
    using Side = std::array<uint32_t, 2>;
    constexpr uint32_t kUnknown = ~uint32_t{0};
    constexpr std::array<size_t, 4> kLoop{0, 1, 3, 2};
    std::vector<Side> open;  // the newest last
    int last_i = 0, was_expected = 0;
    for (uint32_t p = 0; p < patches_; ++p) {
      std::array<uint32_t, 4> quad;
      quad.fill(kUnknown);
      size_t i = 0;
      if (const int s = symbol('o', 0, 0, 6); s == 63) {
        for (size_t k = 0; k < 4; ++k) named(quad[k] = corner(k));
      } else {
        const auto [from, to] = open.at(open.size() - 1 - static_cast<size_t>(s));
        open.resize(open.size() - static_cast<size_t>(s));
        last_i = symbol('i', last_i, 0, 2);
        i = static_cast<size_t>(last_i);
        const bool backwards = modelled('r', 0, 0, 0);
        const size_t begin = kLoop[i], end = kLoop[(i + 1) % 4];
        quad[begin] = backwards ? to : from;
        quad[end] = backwards ? from : to;
        for (size_t k = 0; k < 4; ++k) {
          if (k != begin && k != end) {
            const uint32_t beside = quad[(k ^ 1) == begin || (k ^ 1) == end ? k ^ 1 : k ^ 2];
            uint32_t expected = kUnknown;
            for (const Side& side : open) {
              if (side[0] != beside && side[1] != beside) continue;
              const uint32_t far = side[0] == beside ? side[1] : side[0];
              if (std::find(quad.begin(), quad.end(), far) == quad.end()) expected = far;
            }
            const bool known = expected != kUnknown;
            if (known) was_expected = modelled('x', was_expected, 0, 0);
            if (known && was_expected) quad[k] = expected;
            else quad[k] = modelled('y', known, 0, 0) ? next_ : corner(k);
          }
          named(quad[k]);
        }
      }
      for (size_t n = 4; n > 0; --n) {
        const Side side{quad[kLoop[(i + n) % 4]], quad[kLoop[(i + n + 1) % 4]]};
        const auto same = std::find_if(open.begin(), open.end(), [&](const Side& other) {
          return std::minmax(other[0], other[1]) == std::minmax(side[0], side[1]);
        });
        if (same == open.end()) open.push_back(side);
        else open.erase(same);
      }
    }
  }

  void readQuadsByBorder() {
    struct Side {
      uint32_t from, to;
      int number;
    };
    constexpr uint32_t kUnknown = ~uint32_t{0};
    constexpr std::array<size_t, 4> kLoop{0, 1, 3, 2};
    std::vector<Side> open;               // the newest last
    std::map<uint32_t, int> newest_from;  // by corner, open or not
    int numbers = 0, met = -1;
    std::array<int, 2> before{0, 0};  // of the patches before, the last one first
    auto bit = [&](int decision) {
      Model &two = models_[{'2', before[1], before[0], decision}], &one = models_[{'1', 0, before[0], decision}];
      const bool rare = two.seen < 5;
      const int b = coder_.bit(rare ? one : two);
      Model& other = rare ? two : one;
      other.zero += ((b ? 48 : 65488) - other.zero) * (131072 / (2 * other.seen + 3) >> 1) >> 15;
      other.seen = std::min<int64_t>(other.seen + 1, 90);
      return b;
    };
    auto index = [&] {
      const uint32_t c = coder_.plain(std::bit_width(corners_));
      const auto begins = newest_from.find(c);
      if (begins == newest_from.end()) return c;
      for (const Side& s : open)
        if (s.number == begins->second) met = s.number;
      return c;
    };
    auto along = [&] {
      auto at = std::find_if(open.begin(), open.end(), [&](const Side& s) { return s.number >= met; });
      if (met < 0 || at == open.end()) at = open.end() - 1;
      met = at->number;
      const int n = symbol('m', 0, 0, 4);
      if (n == 15) return index();
      const auto place = (at - open.begin()) + (n % 2 ? (n + 1) / 2 : -n / 2);
      const Side& s = open.at(static_cast<size_t>(place));
      met = s.number;
      return s.from;
    };
    for (uint32_t p = 0; p < patches_; ++p) {
      std::array<uint32_t, 4> quad;
      quad.fill(kUnknown);
      size_t i = 0;
      int pattern = 0;
      if (const int s = bit(0) ? symbol('o', 0, 0, 6) : 0; s == 63) {
        for (uint32_t& c : quad) named(c = modelled('f', 0, 0, 0) ? next_ : index());
      } else {
        open.resize(open.size() - static_cast<size_t>(s));
        const Side newest = open.back();
        const int high = bit(1), low = bit(2 + high);
        i = static_cast<size_t>(2 * high + low);
        const bool backwards = modelled('r', 0, 0, 0);
        const size_t begin = kLoop[i], end = kLoop[(i + 1) % 4];
        quad[begin] = backwards ? newest.to : newest.from;
        quad[end] = backwards ? newest.from : newest.to;
        int k_known = static_cast<int>(i), kinds = 0;
        for (size_t k = 0; k < 4; ++k) {
          if (k != begin && k != end) {
            const uint32_t beside = quad[(k ^ 1) == begin || (k ^ 1) == end ? k ^ 1 : k ^ 2];
            uint32_t expected = kUnknown;
            for (const Side& side : open) {
              if (side.from != beside && side.to != beside) continue;
              const uint32_t far = side.from == beside ? side.to : side.from;
              if (std::find(quad.begin(), quad.end(), far) == quad.end()) expected = far;
            }
            const bool known = expected != kUnknown;
            const int first = 4 + 3 * k_known;
            int kind = 0;
            if (known && bit(first)) quad[k] = expected;
            else if (bit(first + 1 + known)) quad[k] = next_, kind = 1;
            else quad[k] = along(), kind = 2;
            kinds = 3 * kinds + kind;
            k_known = 4 + 3 * static_cast<int>(i) + kind;
          }
          named(quad[k]);
        }
        pattern = 1 + 9 * static_cast<int>(i) + kinds;
      }
      before = {pattern, before[0]};
      for (size_t n = 4; n > 0; --n) {
        const Side side{quad[kLoop[(i + n) % 4]], quad[kLoop[(i + n + 1) % 4]], numbers};
        const auto same = std::find_if(open.begin(), open.end(), [&](const Side& other) {
          return std::minmax(other.from, other.to) == std::minmax(side.from, side.to);
        });
        if (same != open.end()) {
          open.erase(same);
          continue;
        }
        open.push_back(side);
        newest_from[side.from] = numbers++;
      }
    }
  }

  int prediction(const std::vector<int>& k, uint32_t c) const {
    int64_t around = 0, arounds = 0, beside = 0, besides = 0;
    for (uint32_t i : places_[c]) {
      const uint32_t first = i - i % 4;
      const uint32_t a = quads_[first + (i % 4 ^ 1)], b = quads_[first + (i % 4 ^ 2)], d = quads_[first + (3 - i % 4)];
      if (std::max({a, b, d}) < c) around += int64_t{k[a]} + k[b] - k[d], ++arounds;
      if (a < c) beside += k[a], ++besides;
      if (b < c) beside += k[b], ++besides;
    }
    const int64_t p = arounds ? around / arounds : besides ? beside / besides : c ? k[c - 1] : 0;
    return static_cast<int>(std::clamp<int64_t>(p, -(1 << 23), 1 << 23));
  }
  void readCorners() {
    std::vector<float> v(6 * corners_);
    auto plain = [&](uint32_t first) {
      for (uint32_t c = 0; c < corners_; ++c)
        for (uint32_t axis = first; axis < first + 3; ++axis) v[6 * c + axis] = std::bit_cast<float>(coder_.plain(32));
    };
    if (coder_.plain(1)) {
      const uint64_t high = coder_.plain(32);
      const double step = step_ = std::bit_cast<double>(high << 32 | coder_.plain(32));
      std::vector<int> off(corners_);  // the most, along the axes so far
      for (uint32_t axis = 0; axis < 3; ++axis) {
        std::vector<int> k(corners_);
        for (uint32_t c = 0; c < corners_; ++c) {
          const int like = axis > 0 ? off[c] : c > 0 ? off[c - 1] : 0;
          const int e = number('p', static_cast<int>(axis),
                               by_border_ ? static_cast<int>(std::bit_width(static_cast<unsigned>(like))) : 0);
          off[c] = std::max(off[c], std::abs(e));
          k[c] = prediction(k, c) + e;
          v[6 * c + axis] = static_cast<float>(k[c] * step);
        }
        positions_.push_back(k);
      }
    } else {
      plain(0);
    }
    if (coder_.plain(1)) {
      std::array<std::vector<int>, 3> k;
      for (auto& of_axis : k) of_axis.resize(corners_);
      const int sign = by_border_ && !positions_.empty() ? std::array{0, 1, -1, 0}[coder_.plain(2)] : 0;
      for (uint32_t c = 0; c < corners_; ++c) {
        std::array<int, 3> p{};
        const glm::dvec3 sum = sign != 0 ? sumOfNormals(c) : glm::dvec3(0);
        const double long_as = std::sqrt(sum.x * sum.x + sum.y * sum.y + sum.z * sum.z);
        for (size_t axis = 0; axis < 3; ++axis)
          p[axis] = long_as > 0
                        ? static_cast<int>(std::floor(sign * 1024.0 / long_as * sum[static_cast<int>(axis)] + 0.5))
                        : prediction(k[axis], c);
        size_t m = 0;
        for (size_t axis = 1; axis < 3; ++axis)
          if (std::abs(p[axis]) > std::abs(p[m])) m = axis;
        const size_t a = (m + 1) % 3, b = (m + 2) % 3;
        k[a][c] = p[a] + number('n', 0, 0);
        k[b][c] = p[b] + number('n', 0, 0);
        const double left = std::max(0.0, 1048576.0 - double(k[a][c]) * k[a][c] - double(k[b][c]) * k[b][c]);
        const int length = static_cast<int>(std::sqrt(left) + 0.5);
        k[m][c] = (p[m] < 0 ? -length : length) + number('n', 1, 0);
        for (size_t axis = 0; axis < 3; ++axis) v[6 * c + 3 + axis] = static_cast<float>(k[axis][c] / 1024.0);
      }
    } else {
      plain(3);
    }
    for (float f : v) append(corner_bytes_, std::bit_cast<uint32_t>(f), 4);
  }

  static float angle(float y, float x) {
    const float w = std::abs(x), t = std::min(w, y) / std::max(w, y), s = t * t;
    float a = -0.01172120f;
    for (const float c : {0.05265332f, -0.11643287f, 0.19354346f, -0.33262347f, 0.99997726f}) a = c + s * a;
    a = t * a;
    constexpr float kPi = 3.14159274f;
    if (y > w) a = kPi / 2 - a;
    return x < 0 ? kPi - a : a;
  }
  glm::dvec3 sumOfNormals(uint32_t c) const {
    constexpr std::array<uint32_t, 4> kNext{1, 3, 0, 2}, kBefore{2, 0, 3, 1};
    auto at = [&](uint32_t corner) {
      return glm::dvec3(positions_[0][corner], positions_[1][corner], positions_[2][corner]);
    };
    glm::dvec3 sum(0);
    for (uint32_t place : places_[c]) {
      const uint32_t k = place % 4, first = place - k;
      std::vector<std::array<uint32_t, 2>> triangles{{kNext[k], kBefore[k]}};
      if (cut_ && (k == 0 || k == 3)) triangles = {{kNext[k], 3 - k}, {3 - k, kBefore[k]}};
      for (const auto& [i, j] : triangles) {
        const glm::dvec3 a = at(quads_[first + i]) - at(c), b = at(quads_[first + j]) - at(c);
        const glm::dvec3 n(a.y * b.z - b.y * a.z, a.z * b.x - b.z * a.x, a.x * b.y - b.x * a.y);
        const double area = std::sqrt(n.x * n.x + n.y * n.y + n.z * n.z), dot = a.x * b.x + a.y * b.y + a.z * b.z;
        if (area > 0) sum += n * (double{angle(static_cast<float>(area), static_cast<float>(dot))} / area);
      }
    }
    return sum;
  }

  // n numbers a patch, from the last one down or from the first up; from() says the prediction and the models.
  template <class From>
  std::vector<uint8_t> words(int n, From&& from, char name, bool down) {
    std::vector<uint8_t> out;
    const auto s = static_cast<int>(coder_.plain(4));
    if (s == 15) {
      for (uint32_t i = 0; i < static_cast<uint32_t>(n) * patches_; ++i) append(out, coder_.plain(32), 4);
      return out;
    }
    first_ = 0;
    for (uint32_t p = 0; p < patches_; ++p) {
      std::vector<int> order(static_cast<size_t>(n));
      for (int i = 0; i < n; ++i) {
        const int k = down ? n - 1 - i : i;
        const auto [last, of] = from(k, order, s);
        order[static_cast<size_t>(k)] = last + number(name, k, of);
      }
      first_ = order[0];
      for (int o : order) append(out, wordOf(o, s), 4);
    }
    return out;
  }

  static uint64_t wordOf(int o, int s) { return static_cast<uint64_t>(o < 0 ? 0x8000 | -o << s : o << s) << 16; }
  std::vector<uint8_t> readErrors() {
    return words(
        7,
        [&](int k, const std::vector<int>& order, int s) {
          const int last = k == 6 ? 0 : order[static_cast<size_t>(k + 1)],
                    before = k >= 5 ? 0 : order[static_cast<size_t>(k + 2)];
          const int bits = std::bit_width(static_cast<unsigned>(std::abs(last - before))) + s;
          return std::pair(last, last == 0 ? 0 : 1 + std::clamp(bits - 5, 0, 3));
        },
        'e', true);
  }
  double twistOf(uint32_t p) const {
    if (positions_.empty() || (by_border_ && cut_)) return 0;
    double squares = 0;
    for (const auto& of : positions_) {
      auto at = [&](uint32_t k) { return static_cast<double>(of[quads_[4 * p + k]]); };
      squares += std::pow(at(0) - at(1) - at(2) + at(3), 2);
    }
    return std::sqrt(squares) * (step_ / 4);
  }
  std::vector<uint8_t> readErrorsByTwist() {
    std::vector<uint8_t> out;
    const auto s = static_cast<int>(coder_.plain(4));
    if (s == 15) {
      for (uint32_t i = 0; i < 7 * patches_; ++i) append(out, coder_.plain(32), 4);
      return out;
    }
    auto orderOf = [&](double x) {
      return static_cast<int>(std::bit_cast<uint32_t>(static_cast<float>(x)) >> (16 + s));
    };
    int m = 0;
    for (uint32_t p = 0; p < patches_; ++p) {
      const double t = twistOf(p);
      double r = 0;
      bool f = false;
      std::array<int, 7> order{};
      for (size_t k = 7; k-- > 0;) {
        const double own = t / std::pow(4, k);
        const int expected = orderOf(!f ? own : own > r ? own + r : r);
        const int x = m > 2 && k < 6 ? order[k + 1] : expected;
        const int o = order[k] = x + number('E', static_cast<int>(k), 8 * f + m);
        if (k == 6 && o > expected + 1) {
          f = true;
          r = std::bit_cast<float>(static_cast<uint32_t>(wordOf(o, s)));
        }
        const int off = std::abs(o - expected), size = std::bit_width(static_cast<unsigned>(off)) + s;
        m = off <= 1 || (k == 6 && f) ? 0 : size <= 3 ? 1 : size <= 5 ? 2 : size <= 7 ? 3 : 4;
      }
      for (int o : order) append(out, wordOf(o, s), 4);
    }
    return out;
  }

  static int shareOf(int i, int n) { return (255 * i + n - 1) / n; }
  static int stepOf(int share, int n) { return share * n / 255; }
  std::vector<uint8_t> plainBytes(size_t n) {
    std::vector<uint8_t> out(n);
    for (uint8_t& b : out) b = static_cast<uint8_t>(coder_.plain(8));
    return out;
  }
  std::vector<uint8_t> readBlocks() {
    if (!coder_.plain(1)) return plainBytes(size_t{84} * patches_);
    std::vector<uint8_t> out;
    for (uint32_t p = 0; p < patches_; ++p)
      for (int grid = 0; grid < 3; ++grid) {
        const int side = 2 << grid;
        std::vector<int> b(static_cast<size_t>(side * side));
        if (modelled('S', grid, 0, 0)) {
          std::fill(b.begin(), b.end(), symbol('T', grid, 0, 4));
        } else {
          for (int y = 0; y < side; ++y)
            for (int x = 0; x < side; ++x) {
              auto at = [&](int i, int j) -> int& { return b[static_cast<size_t>(j * side + i)]; };
              const int around = x && y ? (at(x - 1, y) + at(x, y - 1) + 1) / 2
                                 : x    ? at(x - 1, y)
                                 : y    ? at(x, y - 1)
                                        : 16;
              at(x, y) = symbol('B', grid, around, 4);
            }
        }
        for (int i : b) out.push_back(static_cast<uint8_t>(shareOf(i, 15)));
      }
    return out;
  }
  std::vector<uint8_t> readShapes() {
    if (!coder_.plain(1)) return plainBytes(size_t{440} * patches_);
    using Shape = std::array<int, 5>;
    constexpr Shape kUnknown{7, 7, 7, 7, 7};
    std::vector<uint8_t> out;
    int before_unknown = 0;
    for (uint32_t p = 0; p < patches_; ++p) {
      std::vector<Shape> coarser;
      for (int grid = 0; grid < 7; ++grid) {
        const int side = grid < 4 ? 1 : 2 << (grid - 4);
        before_unknown = modelled('U', grid, before_unknown, 0);
        std::vector<Shape> shapes(static_cast<size_t>(side * side), kUnknown);
        for (int i = 0; !before_unknown && i < side * side; ++i) {
          const Shape* left = i % side ? &shapes[static_cast<size_t>(i - 1)]
                              : i      ? &shapes[static_cast<size_t>(i - side)]
                                       : nullptr;
          const bool left_unknown = left && *left == kUnknown;
          if (modelled('V', left ? left_unknown : 2, 0, 0)) continue;
          const Shape* like = left_unknown ? nullptr : left;
          char models = 'W';
          if (by_sides_ && !like && grid > 0) {
            const Shape& holds = coarser[static_cast<size_t>(i / side / 2 * (side / 2) + i % side / 2)];
            if (holds != kUnknown) like = &holds, models = 'X';
          }
          Shape own{};
          for (int k = 0; k < 5; ++k)
            own[static_cast<size_t>(k)] = symbol(models, 8 * k + (k ? own[static_cast<size_t>(k - 1)] : 0),
                                                 like ? (*like)[static_cast<size_t>(k)] : 8, 3);
          shapes[static_cast<size_t>(i)] = own;
        }
        for (const Shape& s : shapes)
          for (int i : s) out.push_back(static_cast<uint8_t>(shareOf(i, 7)));
        coarser = shapes;
      }
    }
    return out;
  }

  uint32_t corners_, patches_;
  bool by_sides_, by_border_, cut_;
  Coder coder_;
  std::map<std::tuple<char, int, int, int>, Model> models_;
  std::vector<uint32_t> recent_, quads_;
  std::vector<std::vector<uint32_t>> places_;  // in quads_, by corner
  uint32_t next_ = 0;
  int was_new_ = 0;
  double step_ = 0;
  std::vector<std::vector<int>> positions_;  // in steps, by axis
  std::vector<uint8_t> corner_bytes_, quad_bytes_;
  int first_ = 0;  // of the patch before
};

TEST(BaseCode, IsAsThePackageFormatSays) {
  for (const auto& [kind_name, kind] : kKinds) {
    for (const Contents& c : contents()) {
      const std::vector<uint8_t> section = encodeBaseSection(c.section),
                                 code = encodeBaseCode(c.section, c.step_mm, kind, c.cut());
      SCOPED_TRACE(c.name + ", " + kind_name);
      const Reader reader(code, c.patches(), c.end() == BaseSectionEnd::kTextureDepths, kind, c.cut());
      EXPECT_TRUE(reader.ended());
      EXPECT_TRUE(reader.section == section);
    }
  }
}

}  // namespace
}  // namespace relievo::base_code_test
