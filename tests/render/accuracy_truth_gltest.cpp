// The truth of `relievo accuracy` (tools/accuracy/truth.h): it agrees with the oracle of "virtual equals dense", which
// was written on its own, and with the renderer at its most accurate; and it sees what is a little wrong.
#include "tests/render/dense_pages.h"
#include "tests/render/gl_fixture.h"
#include "tests/render/test_artwork.h"
#include "tools/accuracy/accuracy_measure.h"
#include "tools/sample/sample_artwork.h"

namespace relievo {
namespace accuracy_truth_gltest {

constexpr int kWidth = 320, kHeight = 180;

struct Subject {
  test::TemporaryFolder folder;
  std::shared_ptr<const Package> package;
  std::shared_ptr<const DenseTexture> texture;
  std::shared_ptr<const DenseRelief> relief;
};

void makeSubject(Subject& s) {
  SampleArtwork sample({.kind = SampleKind::kCoin, .width = 300, .height = 260, .seed = 3});
  auto texture = sample.ptmSource(Basis::kPtmLrgb);
  auto heights = sample.heightSource();
  BuildOptions options;
  options.output = s.folder.file("coin.relievo");
  options.mm_per_px = sample.mmPerPx();
  auto built = buildPackage(*texture, heights.get(), options);
  ASSERT_TRUE(built.ok()) << built.error().text();
  auto package = Package::open(options.output);
  ASSERT_TRUE(package.ok()) << package.error().text();
  s.package = *package;
  const FlatDomain domain = s.package->manifest().domain.flat();
  auto dense = buildDenseTexture(*texture, domain);
  auto relief = buildDenseRelief(*heights, domain);
  ASSERT_TRUE(dense.ok() && relief.ok());
  s.texture = std::make_shared<DenseTexture>(std::move(*dense));
  s.relief = std::make_shared<DenseRelief>(std::move(*relief));
}

// Close enough that a cell of the relief is some pixels wide, where both oracles mean the same derivatives.
OrbitCamera closeCamera(const FlatDomain& d) {
  OrbitCamera c = fitCamera(d, kWidth, kHeight);
  c.distance_mm *= 0.3;
  c.azimuth_deg = 35;
  c.elevation_deg = -20;
  return c;
}

TruthOptions truthOptions(const Subject& s) {
  TruthOptions o;
  o.package = s.package;
  o.scene.light = {-0.6, 0.5, 0.6};
  o.width_px = kWidth;
  o.height_px = kHeight;
  return o;
}

// Of 1000 colours the largest 5 differ by more than what is returned.
double difference995(const ViewTruth& truth, const DenseImage& dense) {
  std::vector<double> off;
  for (size_t i = 0; i < truth.pixels.size(); ++i) {
    const int x = static_cast<int>(truth.pixels[i]) % kWidth, y = static_cast<int>(truth.pixels[i]) / kWidth;
    const DensePixel& p = dense.at(x, kHeight - 1 - y);
    if (!p.covered() || p.edge != 0) continue;
    const glm::dvec3 d = glm::abs(p.rgb - glm::dvec3(truth.colours[i]));
    off.push_back(std::max({d.x, d.y, d.z}));
  }
  EXPECT_GT(off.size(), truth.pixels.size() / 2);
  if (off.empty()) return 1e9;
  std::sort(off.begin(), off.end());
  return off[off.size() * 995 / 1000];
}

TEST(AccuracyTruth, AgreesWithTheDenseOracle) {
  Subject s;
  ASSERT_NO_FATAL_FAILURE(makeSubject(s));
  const TruthOptions o = truthOptions(s);
  auto truth = AccuracyTruth::create(o, gltest::api());
  ASSERT_TRUE(truth.ok()) << truth.error().text();
  auto view = (*truth)->of(closeCamera(s.package->manifest().domain.flat()));
  ASSERT_TRUE(view.ok()) << view.error().text();
  EXPECT_TRUE(view->whole);
  EXPECT_LT(view->unsolved, view->covered / 100);
  EXPECT_LT(view->edges, view->covered / 10);
  const FlatDomain domain = s.package->manifest().domain.flat();
  DenseView v;
  v.clip_from_world = view->view.clip_from_world;
  v.width_px = kWidth;
  v.height_px = kHeight;
  v.light = normalizedLight(o.scene.light);
  v.sampling = DenseSampling::kAnisotropic;
  v.anisotropy = kTruthTaps;
  const auto finest = uniformInstances(domain, domain.relief_depth + kPageCellsLog2 - 5, 5);
  EXPECT_LT(difference995(*view, renderDense(*s.texture, s.relief.get(), finest, v)), 0.5);
  // Controls: another light, by two degrees; flat geometry.
  v.light = normalizedLight({-0.57, 0.5, 0.62});
  EXPECT_GT(difference995(*view, renderDense(*s.texture, s.relief.get(), finest, v)), 2);
  v.light = normalizedLight(o.scene.light);
  EXPECT_GT(difference995(*view, renderDense(*s.texture, nullptr, finest, v)), 2);
}

// The picture of one setting against the truth of `of`.
PictureError errorOf(const Subject& s, const AccuracySetting& setting, const OrbitCamera& camera,
                     const ViewTruth& truth) {
  Scene scene = truthOptions(s).scene;
  EngineOptions options;
  applySetting(setting, scene, options);
  PictureError error;
  auto engine = Engine::create(artworkFromPackage(s.package), scene, options);
  EXPECT_TRUE(engine.ok());
  if (!engine.ok()) return error;
  (*engine)->resize(kWidth, kHeight);
  (*engine)->setCamera(camera);
  EXPECT_TRUE((*engine)->settle(60).ok());
  error.add(truth, (*engine)->readPixels(), kWidth, kHeight);
  return error;
}

TEST(AccuracyTruth, IsWhatTheRendererShowsAtItsMostAccurate) {
  Subject s;
  ASSERT_NO_FATAL_FAILURE(makeSubject(s));
  auto truth = AccuracyTruth::create(truthOptions(s), gltest::api());
  ASSERT_TRUE(truth.ok()) << truth.error().text();
  OrbitCamera camera = fitCamera(s.package->manifest().domain.flat(), kWidth, kHeight);
  camera.azimuth_deg = 30;
  auto view = (*truth)->of(camera);
  ASSERT_TRUE(view.ok()) << view.error().text();
  AccuracySetting finest = knobBase();
  finest.draw.error_px = finest.draw.least_cell = 0;
  const PictureError best = errorOf(s, finest, camera, *view);
  std::printf("[ truth ] the finest setting: %.2f dB, at most %.1f of 255\n", best.psnrDb(), best.largest);
  EXPECT_GT(best.psnrDb(), 48);
  EXPECT_EQ(best.missing, 0u);
  // Controls: less accurate by one knob each; and seen from a tenth of a degree aside.
  for (auto turn : {+[](DrawSettings& d) { d.error_px = 4, d.least_cell = 2; },
                    +[](DrawSettings& d) { d.detail_bias = 1; }, +[](DrawSettings& d) { d.sampling = "nearest"; }}) {
    AccuracySetting worse = finest;
    turn(worse.draw);
    EXPECT_LT(errorOf(s, worse, camera, *view).psnrDb(), best.psnrDb() - 3) << settingText(worse);
  }
  camera.azimuth_deg += 0.1;
  EXPECT_LT(errorOf(s, finest, camera, *view).psnrDb(), best.psnrDb() - 3);
}

}  // namespace accuracy_truth_gltest
}  // namespace relievo
