// bench_patches.cpp - a scene of 24,300 patches, drawn as one: a torus with bumps, its pages made when they are asked
// for.
#include <cmath>
#include <cstdio>
#include <numbers>

#include "src/engine/engine.h"
#include "src/engine/fault_injection.h"
#include "src/render/camera.h"
#include "tools/bench/bench_groups.h"

namespace relievo {
namespace {

constexpr double kRing = 100, kTube = 40;          // radii in mm
constexpr double kBumps[2] = {1.2, 0.5};           // amplitudes of the two waves in mm
constexpr int kWaves[2][2] = {{18, 54}, {9, 27}};  // how often around the ring and around the tube
constexpr int kSteps = 2 * kPagePx;  // a patch's side in steps: of samples, and of texel centres between them
constexpr double kOffsetMm = -(kBumps[0] + kBumps[1]), kScaleMm = -2 * kOffsetMm / 65535;

// Sine and cosine of a turn's angle and of the waves along it, at each step.
struct Turn {
  struct At {
    double s, c, wave_s[2], wave_c[2];
  };
  std::vector<At> at;
  Turn(int patches, double sign, const int (&waves)[2]) {
    const int steps = patches * kSteps;
    for (int i = 0; i < steps; ++i) {
      const double t = 2 * std::numbers::pi * i / steps;
      At& a = at.emplace_back(At{std::sin(sign * t), std::cos(t), {}, {}});
      for (size_t k = 0; k < 2; ++k) a.wave_s[k] = std::sin(waves[k] * t), a.wave_c[k] = std::cos(waves[k] * t);
    }
  }
};

class BumpyTorus final : public PageSource, public ReliefOracle {
 public:
  BumpyTorus(int columns, int rows)
      : columns_(columns), rows_(rows), ring_(columns, -1, kWaves[0]), tube_(rows, 1, kWaves[1]) {
    auto mesh = std::make_shared<BaseMesh>();
    for (int j = 0; j < rows; ++j)
      for (int i = 0; i < columns; ++i) {
        const glm::dvec3 n = normalOf(ringAt(i * kSteps), tubeAt(j * kSteps));
        mesh->corners.push_back({glm::vec3(pointOf(ringAt(i * kSteps), n)), glm::vec3(n)});
      }
    auto corner = [&](int i, int j) { return static_cast<uint32_t>((j % rows) * columns + i % columns); };
    for (int j = 0; j < rows; ++j)
      for (int i = 0; i < columns; ++i)
        mesh->patches.push_back({corner(i, j), corner(i + 1, j), corner(i, j + 1), corner(i + 1, j + 1)});
    base_ = mesh;
  }
  std::shared_ptr<const BaseMesh> base() const { return base_; }
  static TextureFormat format() {
    TextureFormat f;
    f.basis = Basis::kAlbedoNormal;
    return f;
  }

  Result<EncodedPage> read(PageId id) const override {
    const NodeId n = id.node();
    if (n.level != 0 || n.patch >= base_->patches.size())
      return Error{ErrorKind::kInvalidData, "", "there is no such page", "", {}};
    PageEncoder encoder(1);
    std::span<const uint8_t> bytes;
    if (id.plane() == Plane::kRelief) {
      std::vector<uint16_t> samples(kReliefPageSamples);
      for (int y = 0; y <= kPagePx; ++y)
        for (int x = 0; x <= kPagePx; ++x)
          samples[static_cast<size_t>(y * kReliefSamples + x)] = height(n.patch, 2 * x, 2 * y);
      bytes = encoder.encodeRelief(samples);
    } else {
      std::vector<uint8_t> channels(kTexturePageBytes);
      for (int y = 0; y < kPageFullPx; ++y)
        for (int x = 0; x < kPageFullPx; ++x) {
          const auto t = texel(n.patch, 2 * (x - kPageBorderPx) + 1, 2 * (y - kPageBorderPx) + 1);
          for (size_t c = 0; c < 3; ++c)
            channels[(c * kPageFullPx + static_cast<size_t>(y)) * kPageFullPx + static_cast<size_t>(x)] =
                t[3 * static_cast<size_t>(texturePlaneIndex(id.plane())) + c];
        }
      bytes = encoder.encodeTexture(channels);
    }
    return EncodedPage{{bytes.begin(), bytes.end()}};
  }
  // From cells of a 16th of a side: within one, a slope differs from the mean by no more than the second derivative
  // times its width.
  bool heightSlopes(uint32_t patch, HeightSlopes& slopes) const override {
    constexpr int kCells = 1 << kTailCellsLog2, kStep = kSteps / kCells;
    double most[2] = {-1e9, -1e9}, least[2] = {1e9, 1e9}, left_out[2] = {};
    for (int y = 0; y <= kCells; ++y)
      for (int x = 0; x <= kCells; ++x) {
        const double h = kScaleMm * height(patch, x * kStep, y * kStep);
        const double along[2] = {x < kCells ? kScaleMm * height(patch, (x + 1) * kStep, y * kStep) - h : 0,
                                 y < kCells ? kScaleMm * height(patch, x * kStep, (y + 1) * kStep) - h : 0};
        for (size_t k = 0; k < 2; ++k)
          if ((k == 0 ? x : y) < kCells)
            most[k] = std::max(most[k], along[k] * kCells), least[k] = std::min(least[k], along[k] * kCells);
      }
    for (size_t k = 0; k < 2; ++k) {
      for (size_t wave = 0; wave < 2; ++wave) {
        const double w = 2 * std::numbers::pi * kWaves[k][wave] / (k == 0 ? columns_ : rows_),
                     across = 2 * std::numbers::pi * kWaves[1 - k][wave] / (k == 0 ? rows_ : columns_);
        left_out[k] += kBumps[wave] * w * (w + across) / kCells;  // between the rows of the grid, too
      }
      left_out[k] += kScaleMm * (kPagePx + kCells);  // heights are rounded
    }
    slopes = {static_cast<float>(least[0] - left_out[0]), static_cast<float>(most[0] + left_out[0]),
              static_cast<float>(least[1] - left_out[1]), static_cast<float>(most[1] + left_out[1])};
    return true;
  }
  HeightBounds bounds(const NodeId&) const override {
    return {static_cast<float>(kOffsetMm), static_cast<float>(-kOffsetMm), 0};
  }

  PatchTails tails() const {
    PatchTails out(static_cast<uint32_t>(base_->patches.size()), format().channels());
    for (uint32_t p = 0; p < out.patches; ++p) {
      constexpr int kStep = kSteps >> kTailCellsLog2;
      for (int k = 0; k < static_cast<int>(kTailHeights); ++k)
        out.heightsOf(p)[static_cast<size_t>(k)] = height(p, k % kTailSamples * kStep, k / kTailSamples * kStep);
      for (int level = 0; level < kTailLevels; ++level) {
        const int side = PatchTails::side(level), step = kSteps / side;
        for (int i = 0; i < side * side; ++i) {
          const auto t = texel(p, i % side * step + step / 2, i / side * step + step / 2);
          for (int c = 0; c < out.channels; ++c)
            out.texelsOf(p)[static_cast<size_t>(out.level(p, level, c) - out.texelsOf(p).data() + i)] =
                t[static_cast<size_t>(c)];
        }
      }
    }
    return out;
  }

  // Of grids of 2^k cells against that of 16: exact, since the difference of two surfaces of triangles, one cut finer
  // than the other, is largest at a vertex; and of that against the page's: a surface of second derivatives D along and
  // across lies within w^2 / 4 (D_along + D_across) of its triangles with legs w, and so do the finest triangles.
  std::vector<CoarseErrors> coarseErrors() const {
    const double step = 1.0 / (1 << kTailCellsLog2);
    std::vector<CoarseErrors> out(base_->patches.size());
    std::vector<glm::dvec3> s(kTailHeights);
    const double left_out = 2 * step * step / 4 * secondDerivatives();
    for (uint32_t p = 0; p < out.size(); ++p) {
      constexpr int kCells = 1 << kTailCellsLog2;
      for (int y = 0; y <= kCells; ++y)
        for (int x = 0; x <= kCells; ++x) {
          const double h = kOffsetMm + kScaleMm * height(p, x * (kSteps / kCells), y * (kSteps / kCells));
          s[static_cast<size_t>(y * kTailSamples + x)] =
              base_->point(p, x * step, y * step) + h * base_->normal(p, x * step, y * step);
        }
      auto at = [&](int x, int y) { return s[static_cast<size_t>(y * kTailSamples + x)]; };
      for (int k = 0; k < 7; ++k) {
        double worst = 0;
        const int cell = k < kTailCellsLog2 ? kCells >> k : 1;
        for (int y = 0; y <= kCells && cell > 1; ++y)
          for (int x = 0; x <= kCells; ++x) {
            const int x0 = std::min(x / cell * cell, kCells - cell), y0 = std::min(y / cell * cell, kCells - cell);
            const double fx = double(x - x0) / cell, fy = double(y - y0) / cell;
            const glm::dvec3 a = at(x0, y0), d = at(x0 + cell, y0 + cell);
            const glm::dvec3 drawn = fx >= fy ? a + fx * (at(x0 + cell, y0) - a) + fy * (d - at(x0 + cell, y0))
                                              : a + fy * (at(x0, y0 + cell) - a) + fx * (d - at(x0, y0 + cell));
            worst = std::max(worst, glm::length(drawn - at(x, y)));
          }
        out[p][static_cast<size_t>(k)] = static_cast<float>((worst + left_out) * 1.0001);
      }
    }
    return out;
  }

 private:
  const Turn::At& ringAt(int step) const {
    return ring_.at[static_cast<size_t>((step + columns_ * kSteps) % (columns_ * kSteps))];
  }
  const Turn::At& tubeAt(int step) const {
    return tube_.at[static_cast<size_t>((step + rows_ * kSteps) % (rows_ * kSteps))];
  }
  int ringStep(uint32_t patch, int x) const {
    return static_cast<int>(patch % static_cast<uint32_t>(columns_)) * kSteps + x;
  }
  int tubeStep(uint32_t patch, int y) const {
    return static_cast<int>(patch / static_cast<uint32_t>(columns_)) * kSteps + y;
  }
  static glm::dvec3 normalOf(const Turn::At& a, const Turn::At& b) { return {b.c * a.c, b.c * a.s, b.s}; }
  static glm::dvec3 pointOf(const Turn::At& a, const glm::dvec3& normal) {
    return kRing * glm::dvec3(a.c, a.s, 0) + kTube * normal;
  }
  static double bump(const Turn::At& a, const Turn::At& b) {
    return kBumps[0] * a.wave_s[0] * b.wave_c[0] + kBumps[1] * a.wave_s[1] * b.wave_s[1];
  }
  uint16_t height(uint32_t patch, int x, int y) const {
    return static_cast<uint16_t>(
        std::lround((bump(ringAt(ringStep(patch, x)), tubeAt(tubeStep(patch, y))) - kOffsetMm) / kScaleMm));
  }
  // Albedo, then normal.
  std::array<uint8_t, 6> texel(uint32_t patch, int x, int y) const {
    const Turn::At &a = ringAt(ringStep(patch, x)), &b = tubeAt(tubeStep(patch, y));
    const double along =
        (kWaves[0][0] * kBumps[0] * a.wave_c[0] * b.wave_c[0] + kWaves[0][1] * kBumps[1] * a.wave_c[1] * b.wave_s[1]) /
        (kRing + kTube * b.c);
    const double around =
        (-kWaves[1][0] * kBumps[0] * a.wave_s[0] * b.wave_s[0] + kWaves[1][1] * kBumps[1] * a.wave_s[1] * b.wave_c[1]) /
        kTube;
    const glm::dvec3 n = glm::normalize(normalOf(a, b) - along * glm::dvec3(a.s, -a.c, 0) -
                                        around * glm::dvec3(-b.s * a.c, -b.s * a.s, b.c));
    auto byte = [](double v) { return static_cast<uint8_t>(std::clamp(std::lround(v), 0l, 255l)); };
    const double shade = 150 + 50 * a.wave_s[1] * b.wave_c[1];
    return {byte(shade + 30),          byte(shade),
            byte(shade - 40),          byte(127.5 * n.x + 127.5),
            byte(127.5 * n.y + 127.5), byte(127.5 * n.z + 127.5)};
  }
  // Bounds of |S_uu| + |S_uv| and the like over a patch, u and v 0..1 in it: S = P + h N, P and N bilinear.
  double secondDerivatives() const {
    double u[3] = {}, v[3] = {};  // of h: value, first, second, along the ring and the tube
    double mixed = 0;
    for (size_t k = 0; k < 2; ++k) {
      const double wu = 2 * std::numbers::pi * kWaves[0][k] / columns_,
                   wv = 2 * std::numbers::pi * kWaves[1][k] / rows_;
      u[1] += kBumps[k] * wu, u[2] += kBumps[k] * wu * wu;
      v[1] += kBumps[k] * wv, v[2] += kBumps[k] * wv * wv;
      mixed += kBumps[k] * wu * wv;
    }
    const double nu = 2 * std::numbers::pi / columns_, nv = 2 * std::numbers::pi / rows_, nuv = nu * nv;
    mixed += kTube * nuv + u[1] * nv + v[1] * nu - kOffsetMm * nuv;
    return std::max(u[2] + 2 * u[1] * nu, v[2] + 2 * v[1] * nv) + mixed;
  }

  int columns_, rows_;
  Turn ring_, tube_;
  std::shared_ptr<const BaseMesh> base_;
};

Artwork torusArtwork(int columns, int rows) {
  auto torus = std::make_shared<BumpyTorus>(columns, rows);
  Artwork artwork;
  Manifest& m = artwork.manifest;
  m.base = torus->base();
  m.texture = BumpyTorus::format();
  m.coarse_errors = torus->coarseErrors();
  m.domain = PatchDomain::overMesh(static_cast<uint32_t>(m.base->patches.size()));
  m.domain.relief_depth = 0;
  m.domain.mm_per_px = 2 * std::numbers::pi * kRing / columns / kPagePx;
  m.domain.relief_offset_mm = kOffsetMm;
  m.domain.relief_scale_mm = kScaleMm;
  artwork.source = torus;
  artwork.oracle = torus;
  artwork.tails = [torus](int, std::vector<std::string>*) { return torus->tails(); };
  return artwork;
}

}  // namespace

Result<void> patchesBench(BenchContext& context) {
  const Artwork artwork = torusArtwork(270, 90);
  const EngineOptions options;  // 256 MiB
  OrbitCamera camera = fitCamera(artworkExtent(artwork.manifest), kBenchWidth, kBenchHeight);
  camera.elevation_deg = 40;
  auto settled = [&](const Scene& scene) -> Result<std::unique_ptr<Engine>> {
    auto engine = Engine::create(artwork, scene, options);
    if (!engine) return engine;
    (*engine)->resize(kBenchWidth, kBenchHeight);
    (*engine)->setCamera(camera);
    if (auto done = (*engine)->settle(120); !done) return done.error();
    return engine;
  };
  double start = benchSeconds();
  auto engine = settled(Scene{});
  if (!engine) return engine.error();
  const double opened_s = benchSeconds() - start;
  const double first_azimuth_deg = camera.azimuth_deg;
  double largest_error_px = 0;
  uint32_t most_triangles = 0;
  auto turn = [&](int frames, std::vector<double>& ms, std::vector<double>& submit_ms) {
    for (int i = 0; i < frames && !context.stopped(); ++i) {
      camera.azimuth_deg += 0.37;
      (*engine)->setCamera(camera);
      start = benchSeconds();
      (*engine)->frame(benchSeconds());
      submit_ms.push_back((benchSeconds() - start) * 1000);
      (*engine)->readPixels();
      ms.push_back((benchSeconds() - start) * 1000);
      const EngineStats stats = (*engine)->stats();
      largest_error_px = std::max(largest_error_px, stats.predicted_error_px);
      most_triangles = std::max(most_triangles, stats.triangles);
    }
  };
  std::vector<double> frame_ms, submit_ms, one_by_one_ms, one_by_one_submit_ms;
  turn(context.quick ? 15 : 60, frame_ms, submit_ms);
  const EngineStats stats = (*engine)->stats();
  if (auto broken = injectFaults(**engine, {.call_a_patch = true}); !broken) return broken;
  turn(context.quick ? 3 : 10, one_by_one_ms, one_by_one_submit_ms);
  const EngineStats slow = (*engine)->stats();
  if (context.stopped()) return {};
  char note[240];
  std::snprintf(note, sizeof note,
                "slowest %.1f ms, %.1f ms of it until submitted; predicted error up to %.2f px within %.0f degrees, %u "
                "instances; %.0f MiB of tails, %u pages, none pinned; %.1f s to the first picture",
                quantile(frame_ms, 1), median(submit_ms), largest_error_px, camera.azimuth_deg - first_azimuth_deg,
                stats.instances, static_cast<double>(stats.tail_bytes) / (1 << 20), stats.resident, opened_s);
  context.row({.what = "24,300 patches as one scene at 1280x720, error 1 px, turning: a frame",
               .measured = median(frame_ms),
               .unit = "ms",
               .goal = 1000.0 / 30,
               .baseline_name = "one draw call and its uniforms a patch",
               .baseline = median(one_by_one_ms),
               .note = note});
  context.row({.what = "triangles drawn in it, at most",
               .measured = static_cast<double>(most_triangles),
               .unit = "",
               .goal = 60000});
  context.row({.what = "draw calls, shading and feedback included",
               .measured = static_cast<double>(stats.draw_calls),
               .unit = "",
               .goal = 8,
               .baseline_name = "one draw call a patch",
               .baseline = static_cast<double>(slow.draw_calls)});
  auto lagRow = [&](const char* what, const EngineStats& of) {
    context.row({.what = what + std::string(", p99 of ") + std::to_string(of.lod_lag_frames.count) + " frames",
                 .measured = of.lod_lag_frames.p99,
                 .unit = "frames",
                 .goal = 1});
  };
  lagRow("its patch list behind the frame", stats);
  // As in a window.
  Scene viewed;
  viewed.geomorph = true;
  viewed.hysteresis = 0.1;
  engine->reset();
  engine = settled(viewed);
  if (!engine) return engine.error();
  frame_ms.clear();
  turn(context.quick ? 15 : 60, frame_ms, submit_ms);
  lagRow("with geomorph and hysteresis, as in a window", (*engine)->stats());
  return {};
}

}  // namespace relievo
