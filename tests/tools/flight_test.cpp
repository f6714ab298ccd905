// Flights, the prediction of cameras, and flights streamed on a virtual clock.
#include "tools/bench/flight.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <set>

#include "src/engine/prefetch.h"
#include "tools/bench/flight_simulation.h"

namespace relievo {
namespace flight_test {

FlatDomain domainOf(uint64_t side) {
  FlatDomain d;
  d.width_px = d.height_px = side;
  d.mm_per_px = 0.1;
  d.texture_depth = FlatDomain::depthFor(side, side);
  return d;
}
class NoRelief final : public ReliefOracle {
 public:
  HeightBounds bounds(const NodeId&) const override { return {}; }
};

std::vector<Flight> allFlights(const FlatDomain& d) {
  return {orbitFlight(d, 640, 360), readingFlight(d, 640, 360), zoomFlight(d, 640, 360), wanderFlight(d, 640, 360)};
}

// The largest change of velocity between steps of a millisecond, relative to the largest velocity.
double worstJerk(const Flight& flight) {
  double fastest = 0, worst = 0;
  glm::dvec3 before{0};
  for (double t = 0.001; t < flight.duration_s(); t += 0.001) {
    OrbitCamera a = cameraAt(flight, t - 0.001), b = cameraAt(flight, t);
    glm::dvec3 v = (eyePosition(b) - eyePosition(a)) / 0.001;
    if (t > 0.0015) worst = std::max(worst, glm::length(v - before));
    fastest = std::max(fastest, glm::length(v));
    before = v;
  }
  return worst / fastest;
}

TEST(Flight, IsSmoothFiniteAndBeginsAndEndsAtRest) {
  for (const Flight& flight : allFlights(domainOf(4096))) {
    EXPECT_GT(flight.duration_s(), 5) << flight.name;
    EXPECT_LT(worstJerk(flight), 0.05) << flight.name;
    for (double t = -1; t < flight.duration_s() + 1; t += 0.01) {
      OrbitCamera c = cameraAt(flight, t);
      ASSERT_TRUE(std::isfinite(c.distance_mm) && c.distance_mm > 0 && std::abs(c.elevation_deg) <= 89)
          << flight.name << " at " << t;
    }
    for (double end : {0.0, flight.duration_s() - 0.4}) {
      OrbitCamera a = cameraAt(flight, end), b = cameraAt(flight, end + 0.3);
      EXPECT_EQ(a.distance_mm, b.distance_mm) << flight.name;
      EXPECT_EQ(a.target_mm, b.target_mm) << flight.name;
      EXPECT_EQ(a.azimuth_deg, b.azimuth_deg) << flight.name;
    }
  }
}

TEST(Flight, TheSmoothnessCheckSeesACorner) {
  Flight corner{"corner", {}};
  for (int i = 0; i <= 4; ++i) {
    OrbitCamera c;
    c.target_mm.x = i * 100;
    corner.keys.push_back({i * 1.0, c});
    if (i == 2) corner.keys.push_back({2.002, {.distance_mm = 1000, .target_mm = {201, 20, 0}}});
  }
  EXPECT_GT(worstJerk(corner), 0.3);
}

TEST(Flight, PassesThroughItsKeysAndOvershootsNothing) {
  for (const Flight& flight : allFlights(domainOf(1024))) {
    for (size_t i = 0; i + 1 < flight.keys.size(); ++i) {
      const auto &a = flight.keys[i], &b = flight.keys[i + 1];
      EXPECT_NEAR(cameraAt(flight, a.time_s).distance_mm / a.camera.distance_mm, 1, 1e-12);
      for (double s : {0.1, 0.35, 0.5, 0.8}) {
        OrbitCamera c = cameraAt(flight, a.time_s + s * (b.time_s - a.time_s));
        double low = std::min(a.camera.target_mm.x, b.camera.target_mm.x),
               high = std::max(a.camera.target_mm.x, b.camera.target_mm.x);
        EXPECT_GE(c.target_mm.x, low - 1e-9);
        EXPECT_LE(c.target_mm.x, high + 1e-9);
        EXPECT_GE(c.distance_mm, std::min(a.camera.distance_mm, b.camera.distance_mm) * (1 - 1e-12));
        EXPECT_LE(c.distance_mm, std::max(a.camera.distance_mm, b.camera.distance_mm) * (1 + 1e-12));
      }
    }
  }
}

TEST(Flight, TheReaderComesAsNearAsAskedAndSeesTheWholeBefore) {
  FlatDomain d = domainOf(8192);
  Flight flight = readingFlight(d, 1280, 720, {.close_px = 2});
  OrbitCamera whole = fitCamera(d, 1280, 720);
  EXPECT_EQ(cameraAt(flight, 0).distance_mm, whole.distance_mm);
  double nearest = 1e300;
  for (double t = 0; t < flight.duration_s(); t += 0.05) nearest = std::min(nearest, cameraAt(flight, t).distance_mm);
  double pixels_per_mm = 720 / (2 * std::tan(glm::radians(whole.fov_deg) / 2)) / nearest;
  EXPECT_NEAR(pixels_per_mm * d.mm_per_px, 2, 1e-6);
}

// --- prediction ---

CameraPredictor watching(const std::function<OrbitCamera(double)>& camera, double until_s, double dt = 1.0 / 60,
                         PredictorOptions options = {}) {
  CameraPredictor p(options);
  for (double t = until_s - 0.5; t <= until_s + 1e-9; t += dt) p.observe(camera(t), t);
  return p;
}

TEST(CameraPredictor, IsExactForSteadyMotion) {
  auto steady = [](double t) {
    OrbitCamera c;
    c.azimuth_deg = 10 + 30 * t;
    c.elevation_deg = -5 + 12 * t;
    c.target_mm = {40 * t, -25 * t, 3};
    return c;
  };
  for (double dt : {1.0 / 144, 1.0 / 60, 1.0 / 7}) {
    CameraPredictor p = watching(steady, 1.0, dt);
    double last = 0;
    for (double t = 0.5; t <= 1.0 + 1e-9; t += dt) last = t;
    OrbitCamera then = p.predict(0.6), truth = steady(last + 0.6);
    EXPECT_NEAR(then.azimuth_deg, truth.azimuth_deg, 1e-6);
    EXPECT_NEAR(then.elevation_deg, truth.elevation_deg, 1e-6);
    EXPECT_NEAR(glm::length(then.target_mm - truth.target_mm), 0, 1e-6);
  }
}

TEST(CameraPredictor, FollowsAZoomOntoAPlace) {
  // As a wheel over a place does: the distance shrinks by a factor over the time, and the target comes near in
  // proportion.
  auto zoom = [](double t) {
    OrbitCamera c;
    c.distance_mm = 1000 * std::exp(-1.5 * t);
    c.target_mm = glm::dvec3(300, -200, 0) * (1 - std::exp(-1.5 * t));
    return c;
  };
  CameraPredictor p = watching(zoom, 1.0, 1.0 / 240, {.window_s = 0.02});
  double last = 0;
  for (double t = 0.5; t <= 1.0 + 1e-9; t += 1.0 / 240) last = t;
  OrbitCamera then = p.predict(0.6), truth = zoom(last + 0.6), now = zoom(last);
  EXPECT_NEAR(then.distance_mm / truth.distance_mm, 1, 1e-6);
  double way = glm::length(truth.target_mm - now.target_mm);
  EXPECT_LT(glm::length(then.target_mm - truth.target_mm), 0.01 * way);
  // The control: the target at constant speed is off by a third of the way.
  double speed = glm::length(zoom(last).target_mm - zoom(last - 0.001).target_mm) / 0.001;
  EXPECT_GT(std::abs(speed * 0.6 - way), 0.3 * way);
}

TEST(CameraPredictor, StillCamerasAskForNothing) {
  OrbitCamera c;
  CameraPredictor p = watching([&](double) { return c; }, 1.0);
  EXPECT_FALSE(p.moves(720));
  EXPECT_EQ(p.predict(0.5).target_mm, c.target_mm);
  EXPECT_FALSE(CameraPredictor().moves(720));
  // It stops within the window after the camera did.
  p = watching(
      [&](double t) {
        OrbitCamera m;
        m.azimuth_deg = 40 * std::min(t, 0.8);
        return m;
      },
      1.0);
  EXPECT_FALSE(p.moves(720));
  p = watching(
      [&](double t) {
        OrbitCamera m;
        m.azimuth_deg = 40 * t;
        return m;
      },
      1.0);
  EXPECT_TRUE(p.moves(720));
  EXPECT_EQ(p.views(0.6).size(), 2u);
}

TEST(CameraPredictor, StartsAnewAfterAGapAndWhenTimeRunsBackwards) {
  OrbitCamera a, b;
  b.azimuth_deg = 60;
  for (double next : {100.0, 0.5, 1.0}) {
    CameraPredictor p;
    p.observe(a, 1.0);
    p.observe(b, next);
    EXPECT_FALSE(p.moves(720));
    EXPECT_EQ(p.predict(1).azimuth_deg, 60);
  }
}

// Another projection is another picture: what it moves by is not known yet. Orthographic cameras are predicted as
// others are, and stay so.
TEST(CameraPredictor, KeepsTheProjectionAndStartsAnewWithAnother) {
  CameraPredictor predictor;
  OrbitCamera c;
  c.orthographic = true;
  for (int k = 0; k < 4; ++k, c.azimuth_deg += 2) predictor.observe(c, 0.02 * k);
  EXPECT_TRUE(predictor.moves(720));
  EXPECT_TRUE(predictor.predict(0.1).orthographic);
  EXPECT_NEAR(predictor.predict(0.1).azimuth_deg, 16, 1e-9);
  c.orthographic = false;
  predictor.observe(c, 0.08);
  EXPECT_FALSE(predictor.moves(720));
  EXPECT_FALSE(predictor.predict(0.1).orthographic);
}

TEST(Flight, TheProjectionIsThatOfTheKeyBefore) {
  Flight flight;
  for (int k = 0; k < 3; ++k) flight.keys.push_back({static_cast<double>(k), {}});
  flight.keys[1].camera.orthographic = true;
  for (auto [time_s, orthographic] : {std::pair{-1.0, false}, {0.9, false}, {1.0, true}, {1.5, true}, {2.5, false}})
    EXPECT_EQ(cameraAt(flight, time_s).orthographic, orthographic);
}

TEST(CameraPredictor, ElevationStaysBelowThePole) {
  CameraPredictor p = watching(
      [](double t) {
        OrbitCamera c;
        c.elevation_deg = 80 * t;
        return c;
      },
      1.0);
  EXPECT_EQ(p.predict(5).elevation_deg, 89);
}

TEST(PrefetchHorizon, FollowsTheLatencyWithinBounds) {
  PredictorOptions o{.horizon_s = 0.6};
  EXPECT_EQ(prefetchHorizon(0, o), kShortestHorizon_s);
  EXPECT_EQ(prefetchHorizon(0.2, o), 0.4);
  EXPECT_EQ(prefetchHorizon(10, o), 0.6);
  EXPECT_EQ(prefetchHorizon(10, {.horizon_s = 0.1}), 0.1);
}

TEST(PredictedRequests, RemembersForAWhileBehindWhatIsPredictedNow) {
  NodeId a{0, 3, 1, 1}, b{0, 3, 2, 1};
  PredictedRequests requests;
  requests.begin(1.0);
  requests.add(a, 0.7f);
  requests.add(a, 0.2f);
  requests.add(a, 0.9f);
  ASSERT_EQ(requests.finish().size(), 1u);
  EXPECT_EQ(requests.finish()[0].centre_distance, 0.2f) << "as urgent as where it is nearest";
  requests.begin(1.0 + 0.8 * PredictedRequests::kRemember_s);
  requests.add(b, 0.5f);
  ASSERT_EQ(requests.finish().size(), 2u);
  for (const NodeRequest& w : requests.finish()) EXPECT_EQ(w.centre_distance, w.node == b ? 0.5f : 2.0f);
  requests.begin(1.0 + 1.1 * PredictedRequests::kRemember_s);
  ASSERT_EQ(requests.finish().size(), 1u);
  EXPECT_EQ(requests.finish()[0].node, b);
  requests.begin(0.5);
  EXPECT_TRUE(requests.finish().empty()) << "another clock";
}

// --- streaming on a virtual clock ---

struct Streamed {
  NoRelief oracle;
  FlightScene scene;
  FlightStreaming how;
  Streamed() {
    scene.domain = domainOf(2048);
    scene.oracle = &oracle;
    scene.texture_planes = {texturePlane(0)};
    scene.relief = false;
    scene.width_px = 320;
    scene.height_px = 180;
    scene.frames_per_s = 30;
    how.page_bytes = [](PageId) { return 20000u; };
    how.grid_columns = 32;
    how.grid_rows = 18;
    how.link.bytes_per_s = 4e6;
    how.slot_count = 600;
  }
};

TEST(StreamedFlight, AnInfiniteLinkShowsWhatIsWantedButForTheFramesThatRequestsTake) {
  Streamed s;
  s.how.link = {.bytes_per_s = 1e15, .latency_s = 0, .in_flight = 1000};
  Flight flight = wanderFlight(s.scene.domain, 320, 180, {.speed = 0.2});
  auto fast = streamFlight(s.scene, flight, s.how, {std::nullopt});
  // A request is a frame late and its page comes with the next: at 30 Hz a slow flight shows little of that.
  EXPECT_LT(fast[0].coarseShare(), 0.002);
  EXPECT_GT(fast[0].pages, 20u);
  EXPECT_EQ(fast[0].bytes, fast[0].pages * 20000);
  // The control: a link that answers half a second later leaves coarser pages in view.
  s.how.link = {.bytes_per_s = 1e15, .latency_s = 0.5, .in_flight = 1000};
  auto slow = streamFlight(s.scene, flight, s.how, {std::nullopt});
  EXPECT_GT(slow[0].coarse, 10 * fast[0].coarse);
}

TEST(StreamedFlight, PrefetchHelpsWhenThePredictionIsRightAndCostsBytesWhenItIsWrong) {
  Streamed s;
  Flight flight = readingFlight(s.scene.domain, 320, 180);
  PredictorOptions none{.still_px = 1e9}, sure{.window_s = 0.1, .horizon_s = 0.6, .steps = 2};
  auto r = streamFlight(s.scene, flight, s.how, {std::nullopt, sure, none});
  ASSERT_GT(r[0].coarse, 1000u);
  EXPECT_LT(static_cast<double>(r[1].coarse), 0.3 * static_cast<double>(r[0].coarse));
  EXPECT_GT(r[1].stats.prefetch_used, 10u);
  EXPECT_EQ(r[2].coarse, r[0].coarse) << "a predictor that never predicts is as none";
  EXPECT_EQ(r[2].bytes, r[0].bytes);
  // A camera that turns back as often as the horizon is long: predictions are wrong, and what they cost is seen.
  Flight zigzag{"zigzag", {}};
  OrbitCamera c = fitCamera(s.scene.domain, 320, 180);
  c.distance_mm /= 5;
  for (int i = 0; i < 30; ++i) {
    c.target_mm.x = i % 2 == 0 ? -20 : 20;
    zigzag.keys.push_back({i * 0.4, c});
  }
  auto z = streamFlight(s.scene, zigzag, s.how, {std::nullopt, PredictorOptions{.horizon_s = 2, .steps = 2}});
  EXPECT_GT(z[1].bytes, z[0].bytes);
}

TEST(StreamedFlight, IsDeterministic) {
  Streamed s;
  Flight flight = zoomFlight(s.scene.domain, 320, 180, {.speed = 2});
  auto a = streamFlight(s.scene, flight, s.how, {std::nullopt, PredictorOptions{}});
  auto b = streamFlight(s.scene, flight, s.how, {std::nullopt, PredictorOptions{}});
  for (int i : {0, 1}) {
    EXPECT_EQ(a[i].coarse, b[i].coarse);
    EXPECT_EQ(a[i].levels_missing, b[i].levels_missing);
    EXPECT_EQ(a[i].bytes, b[i].bytes);
  }
}

TEST(RecordFlight, NamesWhatTheViewsRequestAncestorsIncluded) {
  Streamed s;
  PageTrace trace = recordFlight(s.scene, readingFlight(s.scene.domain, 320, 180, {.speed = 4}));
  ASSERT_GT(trace.size(), 60u);
  for (const auto& frame : trace) {
    std::set<PageId> pages(frame.begin(), frame.end());
    ASSERT_TRUE(pages.contains(PageId(texturePlane(0), {0, 0, 0, 0})));
    for (PageId id : pages) ASSERT_TRUE(id.node().level == 0 || pages.contains(PageId(id.plane(), id.node().parent())));
  }
}

}  // namespace flight_test
}  // namespace relievo
