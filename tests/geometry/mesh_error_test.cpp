// The predicted error is an upper bound of the measured one, over base meshes: reliefs held in full with bounds computed from all of their
// samples, random views, residency, exaggeration; every finest vertex is projected in double precision, and so is the point of the drawn
// triangles at the same (u, v).
#include <gtest/gtest.h>

#include <cstdio>

#include "tests/geometry/mesh_fixture.h"

namespace relievo::test {
namespace {

constexpr uint64_t kSeed = 20260402;

// Heights of an artwork held in full, the oracle of its true errors, and its surface in double precision.
class TrueMeshRelief final : public ReliefOracle {
 public:
  // height: a value 0..1 at a place of the base and its name; shared places get one value.
  TrueMeshRelief(const BaseMesh& mesh, const MeshRelief& relief, const std::function<double(const glm::dvec3&, const Place&)>& height)
      : mesh_(mesh), relief_(relief), side_(int64_t{1} << relief.unitLog2()), patches_(mesh.patches.size()), coarse_(mesh.patches.size()), coarse_blocks_(mesh.patches.size()) {
    std::map<Place, uint16_t> shared;
    for (uint32_t p = 0; p < mesh.patches.size(); ++p) {
      auto& samples = patches_[p];
      samples.resize(static_cast<size_t>((side_ + 1) * (side_ + 1)));
      for (int64_t y = 0; y <= side_; ++y)
        for (int64_t x = 0; x <= side_; ++x) {
          Place place = placeOf(mesh, relief.unitLog2(), p, static_cast<uint32_t>(x), static_cast<uint32_t>(y));
          auto compute = [&] {
            double z = height(mesh.point(p, double(x) / double(side_), double(y) / double(side_)), place);
            return static_cast<uint16_t>(std::lround(65535 * std::clamp(z, 0.0, 1.0)));
          };
          uint16_t& q = samples[static_cast<size_t>(y * (side_ + 1) + x)];
          if (place.kind == 0) {
            q = compute();
          } else if (auto found = shared.find(place); found != shared.end()) {
            q = found->second;
          } else {
            q = shared[place] = compute();
          }
        }
    }
    for (uint32_t p = 0; p < mesh.patches.size(); ++p) measure(p);
  }
  HeightBounds bounds(const NodeId& page) const override { return pages_.at(page).bounds; }
  bool errorBlocks(const NodeId& page, std::span<float> error_mm) const override {
    const auto& blocks = pages_.at(page).blocks;
    std::copy(blocks.begin(), blocks.end(), error_mm.begin());
    return true;
  }
  bool coarseBlocks(uint32_t patch, int cells_log2, std::span<float> error_mm) const override {
    const auto& blocks = coarse_blocks_[patch][static_cast<size_t>(cells_log2 - 4)];
    if (parts_ == Parts::kTrue) std::copy(blocks.begin(), blocks.end(), error_mm.begin());
    if (parts_ == Parts::kMirrored) std::copy(blocks.rbegin(), blocks.rend(), error_mm.begin());
    return parts_ != Parts::kNone;
  }
  // What is told of the parts of coarse grids; kMirrored: what is true at the other end of the patch.
  enum class Parts { kNone, kTrue, kMirrored };
  void tell(Parts parts) { parts_ = parts; }
  const std::vector<CoarseErrors>& coarse() const { return coarse_; }
  int64_t side() const { return side_; }
  glm::dvec3 point(uint32_t patch, int64_t x, int64_t y, double exaggerate) const {
    double u = double(x) / double(side_), v = double(y) / double(side_);
    double mm = relief_.offset_mm + relief_.scale_mm * patches_[patch][static_cast<size_t>(y * (side_ + 1) + x)];
    return mesh_.point(patch, u, v) + exaggerate * mm * mesh_.normal(patch, u, v);
  }

 private:
  struct Page {
    HeightBounds bounds;
    std::array<float, 256> blocks{};
  };
  void measure(uint32_t p) {
    const int unit = relief_.unitLog2();
    std::vector<glm::dvec3> s;
    for (int64_t y = 0; y <= side_; ++y)
      for (int64_t x = 0; x <= side_; ++x) s.push_back(point(p, x, y, 1));
    auto at = [&](int64_t x, int64_t y) -> const glm::dvec3& { return s[static_cast<size_t>(y * (side_ + 1) + x)]; };
    // By cells of level L: the largest deviation in it, or of finer levels.
    std::vector<float> finer;
    for (int level = unit - 1; level >= 0; --level) {
      const int64_t cells = int64_t{1} << level, step = side_ >> level;
      std::vector<float> cell(static_cast<size_t>(cells * cells));
      for (int64_t cy = 0; cy < cells; ++cy)
        for (int64_t cx = 0; cx < cells; ++cx) {
          const glm::dvec3 &c00 = at(cx * step, cy * step), &c10 = at((cx + 1) * step, cy * step), &c01 = at(cx * step, (cy + 1) * step),
                           &c11 = at((cx + 1) * step, (cy + 1) * step);
          double most = 0;
          for (int64_t j = 0; j <= step; ++j)
            for (int64_t i = 0; i <= step; ++i) {
              double u = double(i) / double(step), v = double(j) / double(step);
              glm::dvec3 drawn = u >= v ? c00 + u * (c10 - c00) + v * (c11 - c10) : c00 + v * (c01 - c00) + u * (c11 - c01);
              most = std::max(most, glm::length(drawn - at(cx * step + i, cy * step + j)));
            }
          auto& e = cell[static_cast<size_t>(cy * cells + cx)];
          e = most > 0 ? std::nextafter(static_cast<float>(most), 1e30f) : 0;
          if (!finer.empty())
            for (int k = 0; k < 4; ++k) e = std::max(e, finer[static_cast<size_t>((2 * cy + (k >> 1)) * 2 * cells + 2 * cx + (k & 1))]);
        }
      if (level < 7) coarse_[p][static_cast<size_t>(level)] = *std::max_element(cell.begin(), cell.end());
      if (level >= 4 && level < 7) {
        auto& blocks = coarse_blocks_[p][static_cast<size_t>(level - 4)];
        blocks.assign(static_cast<size_t>(cells / 8 * cells / 8), 0);
        for (int64_t j = 0; j < cells; ++j)
          for (int64_t i = 0; i < cells; ++i) {
            float& block = blocks[static_cast<size_t>(j / 8 * (cells / 8) + i / 8)];
            block = std::max(block, cell[static_cast<size_t>(j * cells + i)]);
          }
      }
      if (level >= 7) addPages(p, level - 7, cell);
      finer = std::move(cell);
    }
    addPages(p, unit - 7, {});
  }
  // cell: the errors of this level's cells; empty: none.
  void addPages(uint32_t p, int level, const std::vector<float>& cell) {
    const int64_t pages = int64_t{1} << level, size = side_ >> level, cells = pages * 128;
    for (int64_t y = 0; y < pages; ++y)
      for (int64_t x = 0; x < pages; ++x) {
        Page& page = pages_[{p, static_cast<uint32_t>(level), static_cast<uint32_t>(x), static_cast<uint32_t>(y)}];
        uint16_t low = 65535, high = 0;
        for (int64_t j = y * size; j <= (y + 1) * size; ++j)
          for (int64_t i = x * size; i <= (x + 1) * size; ++i) {
            uint16_t q = patches_[p][static_cast<size_t>(j * (side_ + 1) + i)];
            low = std::min(low, q), high = std::max(high, q);
          }
        page.bounds.min_mm = std::nextafter(static_cast<float>(relief_.offset_mm + relief_.scale_mm * low), -1e30f);
        page.bounds.max_mm = std::nextafter(static_cast<float>(relief_.offset_mm + relief_.scale_mm * high), 1e30f);
        if (cell.empty()) continue;
        for (int64_t j = 0; j < 128; ++j)
          for (int64_t i = 0; i < 128; ++i) {
            float& block = page.blocks[static_cast<size_t>(j / 8 * 16 + i / 8)];
            block = std::max(block, cell[static_cast<size_t>((y * 128 + j) * cells + x * 128 + i)]);
          }
        page.bounds.error_mm = *std::max_element(page.blocks.begin(), page.blocks.end());
      }
  }

  const BaseMesh& mesh_;
  MeshRelief relief_;
  int64_t side_;
  std::vector<std::vector<uint16_t>> patches_;
  std::vector<CoarseErrors> coarse_;
  std::vector<std::array<std::vector<float>, 3>> coarse_blocks_;
  std::map<NodeId, Page> pages_;
  Parts parts_ = Parts::kTrue;
};

struct Measured {
  double max_px = 0;
  uint64_t samples = 0;
};
// Both points must lie in front of the near plane, else there is no picture, and one of them in the picture.
Measured measure(const TrueMeshRelief& relief, int unit_log2, const LodView& view, const Camera& camera, const std::vector<PatchInstance>& instances) {
  Measured m;
  const double exaggerate = view.relief ? view.exaggerate : 0;
  const bool orthographic = glm::length(glm::dvec3(glm::transpose(view.clip_from_world)[3])) == 0;
  auto project = [&](const glm::dvec3& at, glm::dvec2& px) {
    glm::dvec4 p = view.clip_from_world * glm::dvec4(at, 1);
    if (!orthographic && p.w < camera.near_mm) return -1;
    px = glm::dvec2(p.x * camera.aspect, p.y) / p.w * 0.5 * camera.viewport_height_px;
    return std::abs(p.x) <= p.w && std::abs(p.y) <= p.w ? 1 : 0;
  };
  struct Vertex {
    int64_t x, y;
    glm::dvec3 at;
  };
  std::vector<Vertex> grid;
  std::vector<glm::dvec3> fine;
  std::vector<glm::dvec2> fine_px;
  std::vector<int> fine_in;
  for (const PatchInstance& p : instances) {
    const uint32_t size = 1u << p.grid_level;
    const int64_t width = int64_t{1} << (unit_log2 - static_cast<int>(p.node.level));
    grid.clear(), fine_px.clear(), fine_in.clear();
    for (uint32_t j = 0; j <= size; ++j)
      for (uint32_t i = 0; i <= size; ++i) {
        auto g = snapVertex(i, j, p);
        int64_t x = p.x0 + (int64_t{g[0]} << p.step_log2), y = p.y0 + (int64_t{g[1]} << p.step_log2);
        grid.push_back({x, y, relief.point(p.node.patch, x, y, exaggerate)});
      }
    for (int64_t y = 0; y <= width; ++y)
      for (int64_t x = 0; x <= width; ++x) {
        glm::dvec2 px(0);
        fine_in.push_back(project(relief.point(p.node.patch, p.x0 + x, p.y0 + y, exaggerate), px));
        fine_px.push_back(px);
      }
    auto triangle = [&](const Vertex& a, const Vertex& b, const Vertex& c) {
      int64_t area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
      if (area == 0) return;
      ASSERT_GT(area, 0);
      for (int64_t y = std::min({a.y, b.y, c.y}); y <= std::max({a.y, b.y, c.y}); ++y)
        for (int64_t x = std::min({a.x, b.x, c.x}); x <= std::max({a.x, b.x, c.x}); ++x) {
          int64_t wb = (x - a.x) * (c.y - a.y) - (y - a.y) * (c.x - a.x), wc = (b.x - a.x) * (y - a.y) - (b.y - a.y) * (x - a.x);
          if (wb < 0 || wc < 0 || wb + wc > area) continue;
          auto k = static_cast<size_t>((y - p.y0) * (width + 1) + x - p.x0);
          if (fine_in[k] < 0) continue;
          glm::dvec3 drawn = a.at + (double(wb) / double(area)) * (b.at - a.at) + (double(wc) / double(area)) * (c.at - a.at);
          glm::dvec2 px(0);
          int in = project(drawn, px);
          if (in < 0 || (!in && !fine_in[k])) continue;
          m.max_px = std::max(m.max_px, glm::length(px - fine_px[k]));
          ++m.samples;
        }
    };
    for (uint32_t j = 0; j < size; ++j)
      for (uint32_t i = 0; i < size; ++i) {
        const Vertex *top = &grid[j * (size + 1) + i], *bottom = top + size + 1;
        triangle(top[0], top[1], bottom[1]);
        triangle(top[0], bottom[1], bottom[0]);
      }
  }
  return m;
}

// What an artwork's heights are, 0..1.
using Heights = std::function<double(const glm::dvec3&, const Place&)>;
struct NamedHeights {
  const char* name;
  Heights at;
};
std::vector<NamedHeights> heightKinds() {
  auto waves = [](const glm::dvec3& p, double f) { return 0.5 + 0.2 * std::sin(f * p.x + 1) * std::cos(f * p.y) + 0.1 * std::sin(2.7 * f * (p.z + 0.3 * p.x)); };
  return {{"smooth", [=](const glm::dvec3& p, const Place&) { return waves(p, 0.05); }},
          {"waves, pits and a rough part",
           [=](const glm::dvec3& p, const Place& place) {
             uint64_t h = hashOf(place, 5);
             return waves(p, 0.15) + (p.x > 0 && p.y > 0 ? 0.05 * static_cast<double>(h & 1023) / 1023 : 0) + ((h >> 20) % 3000 == 0 ? 0.2 : 0);
           }},
          {"noise over the full 16 bits", [](const glm::dvec3&, const Place& place) { return static_cast<double>(hashOf(place, 9) >> 48) / 65535; }},
          {"zero range", [](const glm::dvec3&, const Place&) { return 0.0; }}};
}

struct Figures {
  int views = 0, above = 0;
  uint64_t samples = 0, nodes = 0, cells = 0;
  std::vector<double> tightness;  // predicted / measured
  double worst = 0;               // measured / asked for, where nothing was missing
};
// believe: the part of the prediction that is taken for the bound.
void study(Figures& f, const std::string& name, const BaseMesh& mesh, const MeshRelief& relief, const TrueMeshRelief& truth, int views, uint64_t seed,
           double believe) {
  auto shared_mesh = std::make_shared<BaseMesh>(mesh);
  auto oracle = std::shared_ptr<const ReliefOracle>(std::shared_ptr<void>(), &truth);
  MeshLod selection(shared_mesh, relief.depth, relief.offset_mm, relief.scale_mm, oracle, truth.coarse());
  for (int k = 0; k < views; ++k) {
    Random random(seed + static_cast<uint64_t>(k));
    Camera camera = randomMeshCamera(mesh, relief.unitLog2(), random);
    double error_px = std::exp(random.real(-0.7, 2.5));
    LodView view = random.chance(0.15) ? orthographicView(camera, glm::length(camera.eye - camera.target), error_px) : makeView(camera, error_px);
    if (random.chance(0.3)) view.exaggerate = random.real(-1, 4);
    view.relief = !random.chance(0.1);
    ReliefSet resident;
    int rounds = random.integer(0, 7);
    for (int round = 0; round < rounds; ++round)
      for (const ReliefWant& w : selection.select(view, resident).wants)
        if (rounds > 4 || random.chance(0.7)) resident.insert(w.page);
    PlanarLodResult lod = selection.select(view, resident);
    ASSERT_TRUE(std::isfinite(lod.max_error_px));
    Measured m = measure(truth, relief.unitLog2(), view, camera, lod.instances);
    ++f.views;
    f.samples += m.samples;
    f.nodes += lod.instances.size();
    for (const PatchInstance& p : lod.instances) f.cells += uint64_t{1} << (2 * p.grid_level);
    if (m.max_px > lod.max_error_px * believe * (1 + 1e-6) + 1e-6) {
      ++f.above;
      if (believe == 1)
        std::printf("[ above    ] %s, seed %llu: measured %.6g px, predicted %.6g px, asked %.3g px\n", name.c_str(),
                    static_cast<unsigned long long>(seed) + static_cast<unsigned long long>(k), m.max_px, lod.max_error_px, view.error_px);
    }
    if (m.max_px > 0.01 && m.samples > 0) f.tightness.push_back(lod.max_error_px / m.max_px);
    if (lod.limited_by_residency == 0) f.worst = std::max(f.worst, m.max_px / lod.error_px);
  }
}

TEST(MeshError, PredictedIsAnUpperBoundOfMeasured) {
  std::vector<NamedMesh> meshes = allMeshes();
  Figures all;
  int halved_above = 0;
  for (size_t k = 0; k < meshes.size(); ++k) {
    const NamedMesh& named = meshes[k];
    auto kinds = heightKinds();
    const NamedHeights& heights = kinds[k % kinds.size()];
    auto [low, high] = boxOf(named.mesh);
    MeshRelief relief;
    relief.depth = named.mesh.patches.size() < 10 ? static_cast<int>(k % 2) : 0;
    relief.scale_mm = 0.05 * std::max(glm::length(high - low), 0.1) / 65535;
    relief.offset_mm = -0.4 * 65535 * relief.scale_mm;
    TrueMeshRelief truth(named.mesh, relief, heights.at);
    Figures f;
    study(f, named.name, named.mesh, relief, truth, 12 / kViewShare, kSeed + 100 * k, 1);
    EXPECT_EQ(f.above, 0) << named.name << ", " << heights.name;
    EXPECT_LE(f.worst, 2) << named.name;  // with all pages it also keeps what was asked for, but for the factor where levels meet
    Figures halved;
    study(halved, named.name, named.mesh, relief, truth, 12 / kViewShare, kSeed + 100 * k, 0.5);
    halved_above += halved.above;
    all.views += f.views, all.samples += f.samples, all.nodes += f.nodes;
    all.tightness.insert(all.tightness.end(), f.tightness.begin(), f.tightness.end());
    std::sort(f.tightness.begin(), f.tightness.end());
    if (!f.tightness.empty())
      std::printf("[ figures  ] %-24s %-28s %7llu nodes %9llu samples; predicted / measured: median %.2f, least %.2f; measured / asked for %.2f\n",
                  named.name.c_str(), heights.name, static_cast<unsigned long long>(f.nodes), static_cast<unsigned long long>(f.samples),
                  f.tightness[f.tightness.size() / 2], f.tightness[0], f.worst);
  }
  std::sort(all.tightness.begin(), all.tightness.end());
  std::printf("[ figures  ] seed %llu: %d views, %llu samples; predicted / measured: median %.2f; half the prediction is exceeded in %d views\n",
              static_cast<unsigned long long>(kSeed), all.views, static_cast<unsigned long long>(all.samples), all.tightness[all.tightness.size() / 2],
              halved_above);
  EXPECT_GT(halved_above, 0);
}

// How near the prediction comes where artworks are looked at as a whole, with all pages: reported, and no more than what levels that meet
// and foreshortening explain.
TEST(MeshError, TightnessOfTheWholeInView) {
  std::vector<double> ratios;
  for (const NamedMesh& named : {NamedMesh{"cube sphere of 54", cubeSphere(3, 60)}, NamedMesh{"torus", torus(9, 5, 80, 25)}, NamedMesh{"open sheet", openSheet(3, 4, 30)}}) {
    for (size_t kind : {size_t{0}, size_t{1}}) {
      auto [low, high] = boxOf(named.mesh);
      const double size = glm::length(high - low);
      MeshRelief relief{0, -0.02 * size, 0.05 * size / 65535};
      auto kinds = heightKinds();
      TrueMeshRelief truth(named.mesh, relief, kinds[kind].at);
      MeshLod selection(std::make_shared<BaseMesh>(named.mesh), relief.depth, relief.offset_mm, relief.scale_mm,
                        std::shared_ptr<const ReliefOracle>(std::shared_ptr<void>(), &truth), truth.coarse());
      std::vector<double> here;
      for (int k = 0; k < 12 / kViewShare; ++k) {
        Random random(kSeed + static_cast<uint64_t>(k));
        Camera camera;
        double turn = random.real(0, 6.28), tilt = random.real(-1, 1), distance = size * random.real(0.9, 2.5);
        camera.target = 0.5 * (low + high);
        camera.eye = camera.target + distance * glm::dvec3(std::cos(turn) * std::cos(tilt), std::sin(turn) * std::cos(tilt), std::sin(tilt));
        camera.near_mm = 0.01 * size, camera.far_mm = 10 * size;
        LodView view = makeView(camera, std::exp(random.real(-1, 1.5)));
        PlanarLodResult lod = selection.select(view, {});
        Measured m = measure(truth, relief.unitLog2(), view, camera, lod.instances);
        ASSERT_LE(m.max_px, lod.max_error_px * (1 + 1e-6) + 1e-6);
        if (m.max_px > 0.01) here.push_back(lod.max_error_px / m.max_px);
      }
      std::sort(here.begin(), here.end());
      if (here.empty()) continue;
      std::printf("[ figures  ] %-20s %-30s predicted / measured: median %.2f, %.2f to %.2f\n", named.name.c_str(), kinds[kind].name, here[here.size() / 2], here.front(),
                  here.back());
      ratios.insert(ratios.end(), here.begin(), here.end());
    }
  }
  std::sort(ratios.begin(), ratios.end());
  ASSERT_FALSE(ratios.empty());
  std::printf("[ figures  ] all: median %.2f\n", ratios[ratios.size() / 2]);
}

// What is known of the parts of grids coarser than a page saves cells, and costs no truth; what is true of other parts is no bound.
TEST(MeshError, PartsOfCoarseGrids) {
  const BaseMesh mesh = cubeSphere(1, 60);
  MeshRelief relief{0, -2, 5.0 / 65535};
  TrueMeshRelief truth(mesh, relief, [](const glm::dvec3& p, const Place& place) {
    return 0.3 + (p.x > 10 && p.y > 15 && p.z > -20 ? 0.5 * static_cast<double>(hashOf(place, 4) >> 40) * 0x1p-24 : 0.05 * std::sin(p.x * 0.05));
  });
  std::array<Figures, 3> figures;
  for (size_t k = 0; k < 3; ++k) {
    truth.tell(static_cast<TrueMeshRelief::Parts>(k));
    study(figures[k], "parts", mesh, relief, truth, 40 / kViewShare, kSeed + 9000, k == 2 ? 0.999 : 1);
  }
  std::printf("[ figures  ] cells by whole patches %llu, by parts %llu; predictions from other parts' errors are exceeded in %d of %d views\n",
              static_cast<unsigned long long>(figures[0].cells), static_cast<unsigned long long>(figures[1].cells), figures[2].above, figures[2].views);
  EXPECT_EQ(figures[0].above, 0);
  EXPECT_EQ(figures[1].above, 0);
  EXPECT_LT(figures[1].cells, figures[0].cells);
  EXPECT_GT(figures[2].above, 0);
}

}  // namespace
}  // namespace relievo::test
