// Sections of base meshes in few bytes: without loss whatever they hold, small where corners lie on lattices, refused
// where bytes are damaged, and as PACKAGE.md says, by a reader of its own.
#include "texturing/package/base_code.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <map>
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
  BaseSectionEnd end() const {
    return section.texture_depths.empty() ? BaseSectionEnd::kShapes : BaseSectionEnd::kTextureDepths;
  }
};

float rounded(double v, int bits) {
  const auto mask = ~((1u << (23 - bits)) - 1);
  return std::bit_cast<float>(std::bit_cast<uint32_t>(static_cast<float>(v)) & mask);
}

// Of a sphere of patches: errors that fall by four from grid to grid, as smooth surfaces' do, others random.
BaseSection sphere(int n, bool on_lattice, bool depths) {
  std::mt19937 random(kSeed);
  BaseSection s;
  s.mesh = testing_support::cubeSphere(n, 50, kSeed);
  s.mesh.origin_mm = {1e7, -3, 0.1};
  for (BaseCorner& c : s.mesh.corners) {  // no symmetries, which zstd would find
    auto some = [&] { return 1e-3f * (static_cast<float>(random() % 1000) - 500); };
    c.position_mm += glm::vec3(some(), some(), some());
    c.normal = glm::normalize(c.normal + 0.05f * glm::vec3(some(), some(), some()));
  }
  if (on_lattice) s.mesh = onLattice(s.mesh, kStepMm);
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
      static constexpr std::array<uint8_t, 8> kSevenths{0, 37, 73, 110, 146, 183, 219, 255};
      for (uint8_t* part : {&shapes[i].below, &shapes[i].above, &shapes[i].aside, &shapes[i].between, &shapes[i].apart})
        *part = kSevenths[random() % 8];
    }
    s.shapes.push_back(shapes);
    if (depths) s.texture_depths.push_back(static_cast<int8_t>(random() % 4) - 1);
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
  std::shuffle(all.back().section.mesh.patches.begin(), all.back().section.mesh.patches.end(), std::mt19937(kSeed));
  all.push_back({"far from each other", sphere(2, true, true), kStepMm});
  for (auto& corner : all.back().section.mesh.corners)
    corner.position_mm *= static_cast<float>(kMostPositionSteps) * kStepMm / 60;
  all.back().section.mesh = onLattice(all.back().section.mesh, kStepMm);
  return all;
}

TEST(BaseCode, IsWithoutLoss) {
  for (const Contents& c : contents()) {
    const std::vector<uint8_t> section = encodeBaseSection(c.section), code = encodeBaseCode(section, c.step_mm);
    EXPECT_LE(code.size(), mostCodedBaseBytes(section.size())) << c.name;
    EXPECT_GE(code.size(), kLeastCodedBaseBytes) << c.name;
    const auto back = decodeBaseCode(code, c.patches(), c.end());
    ASSERT_TRUE(back.ok()) << c.name << ": " << back.error().text();
    EXPECT_TRUE(*back == section) << c.name;
    EXPECT_TRUE(decodeBaseSection(*back, c.patches()).ok()) << c.name;
  }
}

TEST(BaseCode, AnyBytesOfASectionComeBack) {
  std::mt19937 random(kSeed);
  for (int i = 0; i < 20; ++i) {
    BaseSection like = sphere(2, i % 2, i % 3 == 0);
    const auto patches = static_cast<uint32_t>(like.mesh.patches.size());
    std::vector<uint8_t> section = encodeBaseSection(like);
    const size_t first_quad = kBaseHeadBytes + kBaseCornerBytes * like.mesh.corners.size(),
                 behind = first_quad + 16 * patches;
    for (int n = 0; n < 200; ++n) {
      const size_t at = 8 + random() % (section.size() - 8);
      if (at < first_quad || at >= behind) section[at] = static_cast<uint8_t>(random());
    }
    const auto back = decodeBaseCode(encodeBaseCode(section, kStepMm), patches,
                                     i % 3 == 0 ? BaseSectionEnd::kTextureDepths : BaseSectionEnd::kShapes);
    ASSERT_TRUE(back.ok());
    EXPECT_TRUE(*back == section) << i;
  }
}

// Shares at random take their bits in any code. Control: off the lattices corners alone take more than all does on
// them.
TEST(BaseCode, TakesFewBytesOnLattices) {
  BaseSection on = sphere(12, true, true), off = sphere(12, false, true);
  for (BaseSection* s : {&on, &off})
    for (size_t p = 0; p < s->shapes.size(); ++p) s->shapes[p] = {}, s->coarse_blocks[p].fill(255);
  const std::vector<uint8_t> section = encodeBaseSection(on);
  const size_t coded = encodeBaseCode(section, kStepMm).size(), packed = packBaseSection(section, 19).size();
  EXPECT_LT(coded, 0.75 * static_cast<double>(packed)) << packed;
  const size_t off_lattice = encodeBaseCode(encodeBaseSection(off), kStepMm).size();
  EXPECT_GT(off_lattice, coded + 16 * on.mesh.corners.size());
}

TEST(BaseCode, DamagedBytesAreSectionsOrErrors) {
  const BaseSection good = sphere(2, true, true);
  const auto patches = static_cast<uint32_t>(good.mesh.patches.size());
  const std::vector<uint8_t> section = encodeBaseSection(good), code = encodeBaseCode(section, kStepMm);
  auto decoded = [&](std::span<const uint8_t> bytes, uint32_t n) {
    return decodeBaseCode(bytes, n, BaseSectionEnd::kTextureDepths);
  };
  for (size_t n = 0; n < code.size(); ++n) EXPECT_FALSE(decoded(std::span(code).first(n), patches).ok()) << n;
  std::vector<uint8_t> longer = code;
  longer.push_back(0);
  EXPECT_FALSE(decoded(longer, patches).ok());
  EXPECT_FALSE(decoded(code, patches - 1).ok());
  EXPECT_FALSE(decoded(code, patches + 1).ok());
  EXPECT_FALSE(decodeBaseCode(code, patches, BaseSectionEnd::kShapes).ok());
  std::mt19937 random(kSeed);
  int errors = 0, changed = 0;
  for (int i = 0; i < 3000; ++i) {
    std::vector<uint8_t> bytes = code;
    bytes[random() % bytes.size()] ^= static_cast<uint8_t>(1u << random() % 8);
    const auto back = decoded(bytes, patches);
    errors += !back.ok();
    changed += back.ok() && *back != section;
    if (back.ok()) (void)decodeBaseSection(*back, patches);
  }
  EXPECT_GT(errors, 2000) << "hardly any damage ends where the last bit does";
  std::vector<uint8_t> corners = code;
  storeLittle(corners.data(), 4 * patches + 1);
  EXPECT_NE(decoded(corners, patches).error().message.find("at most four corners a patch"), std::string::npos);
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

// ---- a reader by what PACKAGE.md says ----

class Reader {
 public:
  Reader(std::span<const uint8_t> code, uint32_t patches, bool depths)
      : corners_(static_cast<uint32_t>(code[0] | code[1] << 8 | code[2] << 16)),
        patches_(patches),
        coder_(code.subspan(4)) {
    put(corners_, 4), put(patches, 4);
    for (int i = 0; i < 32; ++i) put(coder_.plain(8), 1);
    readQuads();
    readCorners();
    std::vector<uint8_t> blocks, errors = words(
                                     7,
                                     [&](int k, const std::vector<int>&order, int s) {
                                       const int last = k == 6 ? 0 : order[static_cast<size_t>(k + 1)],
                                                 before = k >= 5 ? 0 : order[static_cast<size_t>(k + 2)];
                                       const int step = last - before,
                                                 bits = std::bit_width(static_cast<unsigned>(std::abs(step))) + s;
                                       return std::pair(last, last == 0 ? 0 : 1 + std::clamp(bits - 5, 0, 3));
                                     },
                                     'e', true);
    blocks = readBlocks();
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

  void readQuads() {
    std::vector<uint32_t> recent;
    uint32_t next = 0;
    int was_new = 0;
    for (uint32_t i = 0; i < 4 * patches_; ++i) {
      const int rank = symbol('q', static_cast<int>(i % 4), was_new, 6);
      const uint32_t corner = rank == 0    ? next
                              : rank == 63 ? coder_.plain(32)
                                           : recent[recent.size() - static_cast<size_t>(rank)];
      was_new = rank == 0;
      if (corner == next) ++next;
      std::erase(recent, corner);
      recent.push_back(corner);
      if (recent.size() > 62) recent.erase(recent.begin());
      quads_.push_back(corner);
      append(quad_bytes_, corner, 4);
    }
  }

  int prediction(const std::vector<int>& k, uint32_t c) const {
    int64_t around = 0, arounds = 0, beside = 0, besides = 0;
    for (uint32_t i = 0; i < quads_.size(); ++i) {
      if (quads_[i] != c) continue;
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
      const double step = std::bit_cast<double>(high << 32 | coder_.plain(32));
      for (uint32_t axis = 0; axis < 3; ++axis) {
        std::vector<int> k(corners_);
        for (uint32_t c = 0; c < corners_; ++c) {
          k[c] = prediction(k, c) + number('p', static_cast<int>(axis), 0);
          v[6 * c + axis] = static_cast<float>(k[c] * step);
        }
      }
    } else {
      plain(0);
    }
    if (coder_.plain(1)) {
      std::array<std::vector<int>, 3> k;
      for (auto& of_axis : k) of_axis.resize(corners_);
      for (uint32_t c = 0; c < corners_; ++c) {
        std::array<int, 3> p{};
        for (size_t axis = 0; axis < 3; ++axis) p[axis] = prediction(k[axis], c);
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
      for (int o : order) append(out, static_cast<uint64_t>(o < 0 ? 0x8000 | -o << s : o << s) << 16, 4);
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
    std::vector<uint8_t> out;
    int before_unknown = 0;
    for (uint32_t p = 0; p < patches_; ++p)
      for (int grid = 0; grid < 7; ++grid) {
        const int side = grid < 4 ? 1 : 2 << (grid - 4);
        before_unknown = modelled('U', grid, before_unknown, 0);
        std::vector<std::array<int, 5>> shapes(static_cast<size_t>(side * side), {7, 7, 7, 7, 7});
        for (int i = 0; !before_unknown && i < side * side; ++i) {
          const auto* left = i % side ? &shapes[static_cast<size_t>(i - 1)]
                             : i      ? &shapes[static_cast<size_t>(i - side)]
                                      : nullptr;
          const bool left_unknown = left && *left == std::array{7, 7, 7, 7, 7};
          if (modelled('V', left ? left_unknown : 2, 0, 0)) continue;
          std::array<int, 5> own{};
          for (int k = 0; k < 5; ++k)
            own[static_cast<size_t>(k)] = symbol('W', 8 * k + (k ? own[static_cast<size_t>(k - 1)] : 0),
                                                 left && !left_unknown ? (*left)[static_cast<size_t>(k)] : 8, 3);
          shapes[static_cast<size_t>(i)] = own;
        }
        for (const auto& s : shapes)
          for (int i : s) out.push_back(static_cast<uint8_t>(shareOf(i, 7)));
      }
    return out;
  }

  uint32_t corners_, patches_;
  Coder coder_;
  std::map<std::tuple<char, int, int, int>, Model> models_;
  std::vector<uint32_t> quads_;
  std::vector<uint8_t> corner_bytes_, quad_bytes_;
  int first_ = 0;  // of the patch before
};

TEST(BaseCode, IsAsThePackageFormatSays) {
  for (const Contents& c : contents()) {
    const std::vector<uint8_t> section = encodeBaseSection(c.section), code = encodeBaseCode(section, c.step_mm);
    const Reader reader(code, c.patches(), c.end() == BaseSectionEnd::kTextureDepths);
    EXPECT_TRUE(reader.ended()) << c.name;
    EXPECT_TRUE(reader.section == section) << c.name;
  }
}

}  // namespace
}  // namespace relievo::base_code_test
