// What a body over a base mesh looks like, against analytic truth: a ball of one colour, lit by Lambert's law under a light that turns with the
// camera. Geometry (which pixels), texture look-up (normals, over patches of any orientation) and shading all have to be right. Controls:
// the same picture against a light that stays, and against a ball of another size.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "src/engine.h"
#include "src/gl/context.h"
#include "tests/geometry/mesh_fixture.h"
#include "texturing/page_codec.h"

namespace relievo {
namespace {

constexpr int kWidth = 320, kHeight = 180;
constexpr double kRadius = 50, kReliefMm = 12;
constexpr std::array<double, 3> kAlbedo{200, 150, 100};
constexpr uint64_t kSeed = 20261121;

// The ball over chords of it: heights along the base's normals, normals by direction.
class BallPages final : public PageSource {
 public:
  explicit BallPages(std::shared_ptr<const BaseMesh> base) : base_(std::move(base)) {}
  Result<EncodedPage> read(PageId id) const override {
    PageEncoder encoder(1);
    const NodeId n = id.node();
    const double nodes = std::ldexp(1.0, static_cast<int>(n.level));
    std::span<const uint8_t> bytes;
    if (id.plane() == Plane::kRelief) {
      std::vector<uint16_t> samples(kReliefPageSamples);
      for (size_t j = 0; j < kReliefSamples; ++j)
        for (size_t i = 0; i < kReliefSamples; ++i)
          samples[j * kReliefSamples + i] = static_cast<uint16_t>(std::lround(height(n.patch, (n.x + static_cast<double>(i) / kPagePx) / nodes, (n.y + static_cast<double>(j) / kPagePx) / nodes) / kReliefMm * 65535));
      bytes = encoder.encodeRelief(samples);
    } else {
      std::vector<uint8_t> channels(kTexturePageBytes);
      constexpr size_t plane = size_t{kPageFullPx} * kPageFullPx;
      for (size_t j = 0; j < kPageFullPx; ++j) {
        for (size_t i = 0; i < kPageFullPx; ++i) {
          const double u = (n.x + (static_cast<double>(i) + 0.5 - kPageBorderPx) / kPagePx) / nodes, v = (n.y + (static_cast<double>(j) + 0.5 - kPageBorderPx) / kPagePx) / nodes;
          const glm::dvec3 d = glm::normalize(base_->point(n.patch, u, v) + base_->normal(n.patch, u, v) * height(n.patch, u, v));
          for (size_t c = 0; c < 3; ++c)
            channels[c * plane + j * kPageFullPx + i] = static_cast<uint8_t>(std::lround(id.plane() == texturePlane(0) ? kAlbedo[c] : 127.5 * (d[static_cast<int>(c)] + 1)));
        }
      }
      bytes = encoder.encodeTexture(channels);
    }
    return EncodedPage{{bytes.begin(), bytes.end()}};
  }

 private:
  // |P + h N| = radius, h >= 0.
  double height(uint32_t patch, double u, double v) const {
    const glm::dvec3 p = base_->point(patch, u, v), n = base_->normal(patch, u, v);
    const double a = glm::dot(n, n), b = glm::dot(p, n), c = glm::dot(p, p) - kRadius * kRadius;
    return std::clamp((-b + std::sqrt(std::max(0.0, b * b - a * c))) / a, 0.0, kReliefMm);
  }
  std::shared_ptr<const BaseMesh> base_;
};

class MeshPicture : public ::testing::Test {
 protected:
  void SetUp() override {
    auto context = gl::HeadlessContext::create();
    if (!context) GTEST_SKIP() << context.error().text();
    context_ = std::move(*context);
    BaseMesh mesh = test::cubeSphere(2, kRadius);
    test::Random turns(kSeed);
    test::turnPatches(mesh, turns);
    base_ = std::make_shared<const BaseMesh>(std::move(mesh));
    Manifest& m = artwork_.manifest;
    m.base = base_;
    m.texture.basis = Basis::kAlbedoNormal;
    m.domain.texture_depth = m.domain.relief_depth = 1;
    m.domain.height_px = m.domain.patchPx();
    m.domain.width_px = base_->patches.size() * m.domain.patchPx();
    m.domain.mm_per_px = 0.15;
    m.domain.relief_scale_mm = kReliefMm / 65535;
    artwork_.source = std::make_shared<BallPages>(base_);
    test::MeshRelief relief{1, 0, kReliefMm / 65535};
    artwork_.oracle = std::make_shared<test::MadeUpMeshOracle>(relief, kSeed, 0.05);
  }

  struct Difference {
    uint64_t inside = 0, outside = 0, holes = 0, strays = 0;
    double largest = 0;  // of 255
  };
  // Pixels whose place and neighbourhood of a pixel are certain.
  Difference compare(const std::vector<uint8_t>& pixels, const ViewTransform& view, const glm::dvec3& light, double radius) const {
    Difference d;
    const glm::dmat4 world_from_clip = glm::inverse(view.clip_from_world);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const glm::dvec4 far_point = world_from_clip * glm::dvec4((x + 0.5) / kWidth * 2 - 1, 1 - (y + 0.5) / kHeight * 2, 0.5, 1);
        const glm::dvec3 ray = glm::normalize(glm::dvec3(far_point) / far_point.w - view.eye_mm);
        const double along = -glm::dot(view.eye_mm, ray), aside = glm::length(view.eye_mm + along * ray);
        const double pixel_mm = along / view.pixels_per_radian;
        const uint8_t* p = &pixels[static_cast<size_t>(y * kWidth + x) * 4];
        if (aside > radius + 2 * pixel_mm) {
          ++d.outside;
          d.strays += p[3] != 0;
        } else if (aside < radius - 4 * pixel_mm) {
          ++d.inside;
          d.holes += p[3] == 0;
          const glm::dvec3 n = glm::normalize(view.eye_mm + (along - std::sqrt(radius * radius - aside * aside)) * ray);
          const double lit = std::max(glm::dot(n, light), 0.0);
          if (lit < 0.02) continue;  // near the terminator a normal's last bit is many grey levels
          for (int c = 0; c < 3; ++c)
            d.largest = std::max(d.largest, std::abs(p[c] - kAlbedo[static_cast<size_t>(c)] * std::pow(0.04 + 0.96 * lit, 1 / 2.2)));
        }
      }
    }
    return d;
  }

  std::unique_ptr<gl::HeadlessContext> context_;
  std::shared_ptr<const BaseMesh> base_;
  Artwork artwork_;
};

TEST_F(MeshPicture, IsThatOfALitBall) {
  std::mt19937 random(static_cast<uint32_t>(kSeed));
  std::uniform_real_distribution<double> uniform(0, 1);
  Scene scene;
  scene.error_px = 0.1;
  auto made = Engine::create(artwork_, scene, {});
  ASSERT_TRUE(made.ok()) << made.error().text();
  Engine& engine = **made;
  engine.resize(kWidth, kHeight);
  Difference total;
  double still_light = 0, other_size = 0;
  for (int view = 0; view < 12; ++view) {
    OrbitCamera c;
    c.azimuth_deg = 360 * uniform(random) - 180;
    c.elevation_deg = 170 * uniform(random) - 85;
    c.distance_mm = kRadius * (1.5 + 3 * uniform(random));
    c.fov_deg = 20 + 40 * uniform(random);
    engine.setCamera(c);
    scene.light = {uniform(random) - 0.5, uniform(random) - 0.5, 0.3 + uniform(random)};
    ASSERT_TRUE(engine.setScene(scene).ok());
    auto settled = engine.settle(60);
    ASSERT_TRUE(settled.ok()) << settled.error().text();
    const auto light = normalizedLight(scene.light);
    const glm::dvec3 to_light(light[0], light[1], light[2]);
    const ViewTransform view_now = engine.view();
    const auto pixels = engine.readPixels();
    const Difference d = compare(pixels, view_now, view_now.world_from_camera * to_light, kRadius);
    total.inside += d.inside, total.outside += d.outside, total.holes += d.holes, total.strays += d.strays;
    total.largest = std::max(total.largest, d.largest);
    still_light = std::max(still_light, compare(pixels, view_now, to_light, kRadius).largest);
    other_size = std::max(other_size, compare(pixels, view_now, view_now.world_from_camera * to_light, 0.97 * kRadius).largest);
  }
  std::printf("[ picture  ] seed %llu: %llu pixels inside, %llu outside; off by at most %.2f of 255 (%.0f with a light that stays, %.1f for a ball 3 %% smaller)\n",
              (unsigned long long)kSeed, (unsigned long long)total.inside, (unsigned long long)total.outside, total.largest, still_light, other_size);
  EXPECT_GT(total.inside, 50'000u);
  EXPECT_GT(total.outside, 50'000u);
  EXPECT_EQ(total.holes, 0u);
  EXPECT_EQ(total.strays, 0u);
  // A normal byte is off by half a step, a pixel by half a level; the power curve is steepest in the dark.
  EXPECT_LE(total.largest, 2.5);
  EXPECT_GT(still_light, 20) << "control";
  EXPECT_GT(other_size, 8) << "control";
}

}  // namespace
}  // namespace relievo
