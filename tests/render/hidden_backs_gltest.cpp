// Pictures of closed bodies with and without the patches that are seen from behind (geometry/lod/facing_cone.h) are
// equal, bit for bit. Those of a third engine, which draws both sides of all triangles, differ from them in single
// pixels on outlines, where a front and a back have one depth; no pixel is covered in one alone. Controls: heights
// steeper than the artwork says they are, whose patches are then missed.
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <mutex>
#include <random>

#include "src/engine/engine.h"
#include "src/engine/fault_injection.h"
#include "tests/geometry/mesh_fixture.h"
#include "tests/render/made_pages.h"
#include "tests/view_share.h"

namespace relievo {
namespace hidden_backs_gltest {

constexpr int kWidth = 320, kHeight = 180;
constexpr double kReliefMm = 6;
constexpr uint64_t kSeed = 20261121;

// Bumps as a function of the place in space, deep enough to hide one another; every texel another colour.
class BumpyPages final : public PageSource, public ReliefOracle {
 public:
  BumpyPages(std::shared_ptr<const BaseMesh> base, int depth, double wave_mm, bool true_slopes)
      : base_(std::move(base)), depth_(depth), wave_mm_(wave_mm) {
    const int n = kPagePx << depth;
    const auto width = static_cast<size_t>(n) + 1;
    std::vector<int> samples(width * width);
    for (uint32_t p = 0; p < base_->patches.size(); ++p) {
      HeightSlopes s;
      for (size_t at = 0; at < samples.size() && true_slopes; ++at)
        samples[at] = sample(p, static_cast<double>(at % width) / n, static_cast<double>(at / width) / n);
      for (size_t at = 0; at < samples.size() && true_slopes; ++at) {
        auto step = [&](size_t next, float& least, float& most) {
          const auto slope = static_cast<float>((samples[next] - samples[at]) * kReliefMm / 65535 * n);
          least = std::min(least, slope * 1.0001f - 1e-4f), most = std::max(most, slope * 1.0001f + 1e-4f);
        };
        if (at % width + 1 < width) step(at + 1, s.min_u, s.max_u);
        if (at / width + 1 < width) step(at + width, s.min_v, s.max_v);
      }
      slopes_.push_back(s);
    }
  }
  // Every page is made once, for all engines.
  Result<EncodedPage> read(PageId id) const override {
    std::lock_guard lock(mutex_);
    const auto made = pages_.find(id);
    if (made != pages_.end()) return EncodedPage{made->second};
    auto page = make(id);
    if (page) pages_.emplace(id, std::vector<uint8_t>(page->bytes.begin(), page->bytes.end()));
    return page;
  }
  HeightBounds bounds(const NodeId& page) const override {
    return {0, static_cast<float>(kReliefMm), static_cast<int>(page.level) < depth_ ? 0.02f : 0.0f};
  }
  bool heightSlopes(uint32_t patch, HeightSlopes& slopes) const override {
    slopes = slopes_[patch];
    return true;
  }

 private:
  Result<EncodedPage> make(PageId id) const {
    const NodeId n = id.node();
    if (id.plane() == Plane::kRelief)
      return test::madeReliefPage(n, [&](double u, double v) { return sample(n.patch, u, v); });
    std::vector<uint8_t> channels(kTexturePageBytes);
    for (size_t i = 0; i < channels.size(); ++i)
      channels[i] = static_cast<uint8_t>(test::mix(packNode(n) * 31 + i) % 251);
    return test::madeTexturePage(channels);
  }
  uint16_t sample(uint32_t patch, double u, double v) const {
    const glm::dvec3 q = base_->point(patch, u, v) * (2 * std::numbers::pi / wave_mm_);
    return static_cast<uint16_t>(std::lround(
        32767.5 * (1 + std::sin(q.x + 0.7 * std::sin(q.y)) * std::cos(1.3 * q.y + 0.4 * q.z) * std::cos(0.6 * q.z))));
  }
  std::shared_ptr<const BaseMesh> base_;
  int depth_;
  double wave_mm_;
  std::vector<HeightSlopes> slopes_;
  mutable std::mutex mutex_;
  mutable std::map<PageId, std::vector<uint8_t>> pages_;
};

class HiddenBacksPicture : public ::testing::Test {
 protected:
  static Artwork bumpy(BaseMesh mesh, int depth, double wave_mm, bool true_slopes) {
    Artwork artwork;
    Manifest& m = artwork.manifest;
    m = test::madeManifest(std::make_shared<const BaseMesh>(std::move(mesh)), 0, depth, kReliefMm);
    m.coarse_errors.resize(m.base->patches.size());
    for (CoarseErrors& e : m.coarse_errors)
      for (int k = 0; k < 7; ++k)
        e[static_cast<size_t>(k)] = static_cast<float>(std::max(0.02, kReliefMm * std::ldexp(1.0, -2 * k)));
    auto pages = std::make_shared<BumpyPages>(m.base, depth, wave_mm, true_slopes);
    artwork.source = pages;
    artwork.oracle = pages;
    return artwork;
  }
  struct Totals {
    int views = 0;
    uint64_t different = 0, seen = 0, with_backs = 0, without = 0;
    uint64_t ties = 0, uncovered = 0;  // against both sides
  };
  // A control ends once it has shown a difference.
  static Totals compare(const Artwork& artwork, int views, bool from_inside = false, bool control = false) {
    std::mt19937 random(static_cast<uint32_t>(kSeed));
    std::uniform_real_distribution<double> uniform(0, 1);
    std::array<std::unique_ptr<Engine>, 3> engines;
    for (size_t k = 0; k < engines.size(); ++k) {
      EngineOptions options;
      options.hide_backs = k == 1;
      auto made = Engine::create(artwork, Scene{}, options);
      EXPECT_TRUE(made.ok()) << made.error().text();
      engines[k] = std::move(*made);
      engines[k]->resize(kWidth, kHeight);
      EXPECT_TRUE(injectFaults(*engines[k], {.draw_backs = k == 2}).ok());
    }
    Totals t;
    for (; t.views < views && !(control && t.different > 0); ++t.views) {
      OrbitCamera c;
      c.azimuth_deg = 360 * uniform(random) - 180;
      c.elevation_deg = 170 * uniform(random) - 85;
      c.distance_mm = from_inside ? 5 + 20 * uniform(random) : 80 + 250 * uniform(random);
      c.fov_deg = 20 + 50 * uniform(random);
      c.orthographic = !from_inside && t.views % 4 == 3;
      if (!from_inside)
        c.target_mm = glm::dvec3(uniform(random) - 0.5, uniform(random) - 0.5, uniform(random) - 0.5) * 40.0;
      std::array<std::vector<uint8_t>, 3> pixels;
      for (size_t k = 0; k < engines.size(); ++k) {
        engines[k]->setCamera(c);
        auto settled = engines[k]->settle(60);
        EXPECT_TRUE(settled.ok()) << settled.error().text();
        pixels[k] = engines[k]->readPixels();
      }
      t.with_backs += engines[0]->instances().size(), t.without += engines[1]->instances().size();
      for (size_t i = 0; i < pixels[0].size(); i += 4) {
        t.seen += pixels[0][i + 3] != 0;
        t.different += !std::equal(&pixels[0][i], &pixels[0][i] + 4, &pixels[1][i]);
        t.ties += !std::equal(&pixels[0][i], &pixels[0][i] + 4, &pixels[2][i]);
        t.uncovered += pixels[0][i + 3] != pixels[2][i + 3];
      }
    }
    return t;
  }
};

TEST_F(HiddenBacksPicture, AreNotMissed) {
  Totals all;
  const int views = test::longTests() ? 16 : 6;
  for (const Artwork& artwork :
       {bumpy(test::cubeSphere(5, 60), 0, 60, true), bumpy(test::torus(20, 10, 55, 22), 0, 60, true),
        bumpy(test::cubeSphere(2, 60), 2, 45, true)}) {
    const Totals t = compare(artwork, views);
    EXPECT_EQ(t.different, 0u);
    EXPECT_EQ(t.uncovered, 0u);
    all.ties += t.ties, all.views += t.views, all.seen += t.seen, all.with_backs += t.with_backs,
        all.without += t.without;
  }
  const Totals false_slopes = compare(bumpy(test::cubeSphere(5, 60), 0, 25, false), 10, false, true);
  std::printf(
      "[ picture  ] seed %llu: %d views, %llu pixels, none different, %llu from those of both sides; %llu of %llu "
      "instances drawn; slopes that are not true: %llu pixels different\n",
      (unsigned long long)kSeed, all.views, (unsigned long long)all.seen, (unsigned long long)all.ties,
      (unsigned long long)all.without, (unsigned long long)all.with_backs, (unsigned long long)false_slopes.different);
  EXPECT_GT(all.seen, 200'000u * static_cast<unsigned>(views) / 16);
  EXPECT_LT(all.ties, all.seen / 50'000);
  EXPECT_LT(all.without, all.with_backs * 9 / 10);
  EXPECT_GT(false_slopes.different, 0u) << "control";
}

TEST_F(HiddenBacksPicture, FromInsideAreAllThereIs) {
  const Totals t = compare(bumpy(test::cubeSphere(5, 60), 0, 60, true), 6, true);
  EXPECT_EQ(t.different, 0u);
  EXPECT_EQ(t.seen, uint64_t{6} * kWidth * kHeight);
  EXPECT_EQ(t.without, t.with_backs);
}

}  // namespace hidden_backs_gltest
}  // namespace relievo
