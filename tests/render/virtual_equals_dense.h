// virtual_equals_dense.h - the comparison that the tests of "virtual equals dense" share: random views, the engine
// settled, the oracle's frame (dense_reference.h) of the same view and list of drawn nodes, and the sums over all
// views.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <random>

#include <epoxy/gl.h>

#include "src/engine/engine.h"
#include "src/engine/fault_injection.h"
#include "src/gl/context.h"
#include "tests/render/dense_pages.h"
#include "tests/render/dense_reference.h"
#include "tests/view_share.h"

namespace relievo::test {

static_assert(static_cast<int>(DenseSampling::kNearest) == static_cast<int>(Sampling::kNearest) &&
              static_cast<int>(DenseSampling::kBilinear) == static_cast<int>(Sampling::kBilinear) &&
              static_cast<int>(DenseSampling::kTrilinear) == static_cast<int>(Sampling::kTrilinear) &&
              static_cast<int>(DenseSampling::kAnisotropic) == static_cast<int>(Sampling::kAnisotropic));

inline constexpr uint32_t kSeed = 20261121;

// Both sides of the comparison: what the engine streams, and the oracle's dense textures.
struct Subject {
  Artwork artwork;
  std::shared_ptr<const DenseTexture> texture;
  std::shared_ptr<const DenseRelief> relief;
};

inline double uniform(std::mt19937& random, double a, double b) {
  return std::uniform_real_distribution<double>(a, b)(random);
}

// From close enough to see single texels to the whole artwork small, from the front to grazing, targets beyond the
// border.
inline OrbitCamera randomCamera(std::mt19937& random, const FlatDomain& d, int height_px) {
  const double w = static_cast<double>(d.width_px) * d.mm_per_px, h = static_cast<double>(d.height_px) * d.mm_per_px;
  OrbitCamera c;
  c.azimuth_deg = uniform(random, -75, 75);
  c.elevation_deg = uniform(random, -65, 65);
  c.fov_deg = uniform(random, 15, 70);
  // Where a texel is a pixel, seen from the front.
  const double one_to_one = d.mm_per_px * height_px / (2 * std::tan(c.fov_deg * 3.14159265358979 / 360));
  const double relief_mm = 65535 * d.relief_scale_mm * (d.relief_depth >= 0);
  const double nearest = std::max(one_to_one / 16, 0.7 * relief_mm),
               farthest = std::max(4 * std::max(w, h), 2 * nearest);
  c.distance_mm = std::exp(uniform(random, std::log(nearest), std::log(farthest)));
  c.target_mm = {uniform(random, -0.52, 0.52) * w, uniform(random, -0.52, 0.52) * h, 0};
  return c;
}

// On the artwork, at a distance of 2^lo ... 2^hi times the one at which a texel is a pixel.
inline OrbitCamera nearCamera(std::mt19937& random, const FlatDomain& d, int height_px, double lo, double hi) {
  OrbitCamera c = randomCamera(random, d, height_px);
  c.distance_mm =
      d.mm_per_px * height_px / (2 * std::tan(c.fov_deg * 3.14159265358979 / 360)) * std::exp2(uniform(random, lo, hi));
  c.target_mm *= 0.9;
  return c;
}

struct Totals {
  uint32_t seed = 0;
  int views = 0, seen = 0;
  int max_difference = 0;
  double max_exact = 0, worst_percentile = 0;
  size_t above_1 = 0, compared = 0, to_range = 0, edges = 0, holes = 0, extras = 0;
  double engine_s = 0, oracle_s = 0;
  void print(const char* what) const {
    std::printf(
        "[ dense ] %s: seed %u, %d views (%d see it), %zu pixels: max %d/255, exact %.3f, worst 99.9%% %.3f, %zu above "
        "1, %zu "
        "holes, "
        "%zu extras; %.3f%% edge pixels left out, %.3f%% compared to a range; engine %.1f s, oracle %.1f s\n",
        what, seed, views, seen, compared, max_difference, max_exact, worst_percentile, above_1, holes, extras,
        100.0 * static_cast<double>(edges) / static_cast<double>(std::max<size_t>(1, compared + edges)),
        100.0 * static_cast<double>(to_range) / static_cast<double>(std::max<size_t>(1, compared)), engine_s, oracle_s);
  }
};

struct Views {
  int views = 10;
  int width = 320, height = 180;
  uint32_t seed = kSeed;
  bool random_light = true;
  FaultInjection faults;
  std::function<void(DenseView&)> wrong_oracle;  // for negative controls
  std::function<OrbitCamera(std::mt19937&)> camera;
  int limit = 1;  // views above it are reported
};

inline double now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// GL moves corners to a grid of 2^-GL_SUBPIXEL_BITS px. GPUs interpolate between the moved ones; llvmpipe between the
// corners as they were. Half a step for that, and as much for what interpolation adds (on an H100 no pixel of 40
// million is off by more).
inline double snappedPx() {
  if (gl::currentContextInfo().software) return 0;
  GLint bits = 4;
  glGetIntegerv(GL_SUBPIXEL_BITS, &bits);
  return std::ldexp(1.0, -bits);
}

inline Totals compare(const Subject& subject, Scene scene, const Views& run, double cache_mib = 256) {
  Totals totals;
  totals.seed = run.seed;
  EngineOptions options;
  options.cache_mib = cache_mib;
  auto engine = Engine::create(subject.artwork, scene, options);
  EXPECT_TRUE(engine.ok()) << (engine.ok() ? "" : engine.error().text());
  if (!engine.ok()) return totals;
  Engine& e = **engine;
  e.resize(run.width, run.height);
  const bool with_faults = run.faults.no_borders || run.faults.one_lookup;
  if (with_faults) {
    EXPECT_TRUE(injectFaults(e, run.faults).ok());
  }
  std::mt19937 random(run.seed);
  DenseTexture with_normals;  // of the exaggeration
  double of_exaggeration = 0;
  const bool control = with_faults || run.wrong_oracle;
  const int views = control ? run.views : test::denseShare(run.views);
  for (int view = 0; view < views; ++view) {
    if (control && totals.above_1 > 100 && totals.max_difference > 3) break;  // more than any control asks for
    const OrbitCamera camera =
        run.camera ? run.camera(random) : randomCamera(random, subject.texture->domain, run.height);
    if (run.random_light) scene.light = {uniform(random, -0.7, 0.7), uniform(random, -0.7, 0.7), 1};
    const double start = now();
    EXPECT_TRUE(e.setScene(scene).ok());
    e.setCamera(camera);
    auto settled = e.settle(60);
    EXPECT_TRUE(settled.ok()) << (settled.ok() ? "" : settled.error().text());
    if (!settled.ok()) return totals;
    EXPECT_EQ(e.stats().detail_bias, 0) << "the cache is too small for this test";
    const auto pixels = e.readPixels();
    const double drawn = now();

    DenseView v;
    v.clip_from_world = e.view().clip_from_world;
    v.width_px = run.width;
    v.height_px = run.height;
    v.exaggerate = scene.exaggerate;
    v.light = normalizedLight(scene.light);
    if (e.plan().lights > 0) {
      std::vector<PlacedLight> lights;
      for (const SceneLight& light : shadedLights(scene.lights))
        lights.push_back(placedLight(light, glm::dmat3(1), artworkMiddle(e.manifest())));
      v.lit = [lights](const TextureFormat& format, const double* raw, const glm::dvec3& place_mm) {
        return litColour(format, raw, lights, place_mm);
      };
    }
    v.sampling = static_cast<DenseSampling>(scene.sampling);
    v.anisotropy = e.plan().anisotropy;
    v.resolved = e.plan().resolve;
    v.snapped_px = snappedPx();
    for (const EffectSetting& setting : scene.effects) {
      if (setting.effect->reference == nullptr) continue;
      v.tone = [before = v.tone, setting](const glm::dvec3& colour) {
        return setting.effect->reference(glm::max(before ? before(colour) : colour, 0.0), setting.values);
      };
    }
    if (run.wrong_oracle) run.wrong_oracle(v);
    const bool by_relief = e.plan().normals_exaggerate != 0;
    if (by_relief && of_exaggeration != scene.exaggerate) {
      with_normals = denseWithNormals(*subject.texture, *subject.relief, scene.exaggerate);
      of_exaggeration = scene.exaggerate;
    }
    const DenseImage reference = renderDense(by_relief ? with_normals : *subject.texture,
                                             e.plan().relief ? subject.relief.get() : nullptr, e.instances(), v);
    const ImageDifference d = compareImages(reference, pixels, false);
    totals.engine_s += drawn - start;
    totals.oracle_s += now() - drawn;
    ++totals.views;
    totals.seen += d.compared > 0;
    totals.max_difference = std::max(totals.max_difference, d.maxDifference());
    totals.max_exact = std::max(totals.max_exact, d.max_exact);
    totals.worst_percentile = std::max(totals.worst_percentile, d.percentile_999);
    totals.above_1 += d.count_above_1;
    totals.compared += d.compared;
    totals.to_range += d.compared_to_range;
    totals.edges += d.edge_pixels;
    totals.holes += d.holes;
    totals.extras += d.extras;
    if (!run.wrong_oracle && !with_faults && !d.within(run.limit)) {
      std::printf("  view %d of seed %u: azimuth %.3f elevation %.3f distance %.3f fov %.3f target %.3f %.3f: %s", view,
                  run.seed, camera.azimuth_deg, camera.elevation_deg, camera.distance_mm, camera.fov_deg,
                  camera.target_mm.x, camera.target_mm.y, d.text().c_str());
      if (d.worst.x >= 0) {
        const DensePixel& p = reference.at(d.worst.x, d.worst.y);
        std::printf("; texel %.4f %.4f, lambda %.4f, d/dx %.4f %.4f, d/dy %.4f %.4f", p.texel.x, p.texel.y, p.lambda,
                    p.texel_dx.x, p.texel_dx.y, p.texel_dy.x, p.texel_dy.y);
      }
      std::printf("\n");
    }
  }
  return totals;
}

inline void expectEqual(const Totals& t, const char* what) {
  t.print(what);
  EXPECT_LE(t.max_difference, 1);
  EXPECT_EQ(t.holes, 0u);
  EXPECT_EQ(t.extras, 0u);
  EXPECT_GT(t.seen, 0);
  // Edge pixels are left out of the comparison: they must stay few for it to mean anything.
  EXPECT_LT(static_cast<double>(t.edges), 0.03 * static_cast<double>(t.compared + t.edges) + 50);
}

}  // namespace relievo::test
