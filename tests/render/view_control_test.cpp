// What mouse and keys do: the point that is grabbed or zoomed at stays under the mouse, whatever the view.
#include <cmath>
#include <optional>
#include <random>

#include <gtest/gtest.h>

#include "src/viewer/view_control.h"

namespace relievo {
namespace view_control_test {

using gl::Event;
using gl::EventKind;
using gl::MouseButton;

constexpr int kWidth = 1280, kHeight = 800;

FlatDomain artwork() {
  FlatDomain d;
  d.width_px = 3000;
  d.height_px = 2000;
  d.mm_per_px = 0.1;
  d.texture_depth = FlatDomain::depthFor(d.width_px, d.height_px);
  return d;
}

ViewControl::View startView() { return {fitCamera(artwork(), kWidth, kHeight), {0, 0, 1}}; }

struct Hand {
  ViewControl& control;
  bool shift = false;
  void to(double x, double y) { control.handle({.kind = EventKind::kMouseMove, .x = x, .y = y}); }
  void down(MouseButton b, double x, double y) {
    to(x, y);
    control.handle({.kind = EventKind::kMouseDown, .x = x, .y = y, .button = b, .shift = shift});
  }
  void up(MouseButton b, double x, double y) {
    control.handle({.kind = EventKind::kMouseUp, .x = x, .y = y, .button = b});
  }
  void drag(MouseButton b, double x0, double y0, double x1, double y1) {
    down(b, x0, y0);
    for (int i = 1; i <= 10; ++i) to(x0 + (x1 - x0) * i / 10, y0 + (y1 - y0) * i / 10);
    up(b, x1, y1);
  }
  void wheel(double steps) { control.handle({.kind = EventKind::kScroll, .y = steps}); }
  void press(const char* key) { control.handle({.kind = EventKind::kKeyDown, .key = key}); }
  void release(const char* key) { control.handle({.kind = EventKind::kKeyUp, .key = key}); }
};

glm::dvec3 under(const ViewControl& control, double x, double y) {
  glm::dvec3 p{NAN};
  EXPECT_TRUE(pointOnPlane(control.view().camera, kWidth, kHeight, x, y, &p));
  return p;
}

TEST(ViewControl, ZoomKeepsThePointUnderTheMouse) {
  std::mt19937 random(5);
  for (int i = 0; i < 200; ++i) {
    ViewControl::View start = startView();
    start.camera.orthographic = i % 2 != 0;
    start.camera.azimuth_deg = int(random() % 100) - 50;
    start.camera.elevation_deg = int(random() % 100) - 50;
    ViewControl control(extentOf(artwork()), start, kWidth, kHeight);
    Hand hand{control};
    const double x = kWidth * 0.3 + random() % int(kWidth * 0.4), y = kHeight * 0.3 + random() % int(kHeight * 0.4);
    hand.to(x, y);
    const glm::dvec3 before = under(control, x, y);
    const double distance_before = control.view().camera.distance_mm;
    hand.wheel(1 + random() % 5);
    EXPECT_LT(control.view().camera.distance_mm, distance_before);
    EXPECT_LT(glm::length(under(control, x, y) - before), 1e-6 * distance_before) << "seed 5, round " << i;
    // Negative control: elsewhere in the picture points do move.
    EXPECT_GT(glm::length(under(control, x + 100, y) - before - glm::dvec3(0)), 1e-3);
  }
}

TEST(ViewControl, ZoomThereAndBackIsWhereItWas) {
  ViewControl control(extentOf(artwork()), startView(), kWidth, kHeight);
  Hand hand{control};
  hand.to(400, 300);
  for (int i = 0; i < 10; ++i) hand.wheel(1);
  for (int i = 0; i < 10; ++i) hand.wheel(-1);
  EXPECT_NEAR(control.view().camera.distance_mm, startView().camera.distance_mm, 1e-6);
  EXPECT_LT(glm::length(control.view().camera.target_mm), 1e-6);
}

TEST(ViewControl, ZoomEndsAtItsBounds) {
  ViewControl control(extentOf(artwork()), startView(), kWidth, kHeight);
  Hand hand{control};
  for (double steps : {+1000.0, -2000.0, +1e9, -1e9}) {
    hand.to(700, 500);
    hand.wheel(steps);
    const OrbitCamera& c = control.view().camera;
    EXPECT_TRUE(std::isfinite(c.distance_mm) && c.distance_mm > 0);
    EXPECT_TRUE(std::isfinite(c.target_mm.x) && std::abs(c.target_mm.x) <= 150.0);
  }
}

TEST(ViewControl, PanHoldsTheGrabbedPoint) {
  for (bool shift : {false, true}) {
    ViewControl::View start = startView();
    start.camera.orthographic = shift;
    start.camera.azimuth_deg = 35;
    start.camera.elevation_deg = -20;
    start.camera.distance_mm /= 3;
    ViewControl control(extentOf(artwork()), start, kWidth, kHeight);
    Hand hand{control, shift};
    const glm::dvec3 grabbed = under(control, 600, 400);
    hand.drag(shift ? MouseButton::kLeft : MouseButton::kMiddle, 600, 400, 650, 300);
    EXPECT_LT(glm::length(under(control, 650, 300) - grabbed), 1e-6);
    EXPECT_EQ(control.view().camera.azimuth_deg, 35) << "a pan does not turn";
  }
}

TEST(ViewControl, PanNeverLosesTheArtwork) {
  ViewControl control(extentOf(artwork()), startView(), kWidth, kHeight);
  Hand hand{control};
  for (int i = 0; i < 50; ++i) hand.drag(MouseButton::kMiddle, 100, 700, 1200, 50);
  EXPECT_LE(std::abs(control.view().camera.target_mm.x), 150.0);
  EXPECT_LE(std::abs(control.view().camera.target_mm.y), 100.0);
}

TEST(ViewControl, OrbitFollowsTheHandAndStaysInFront) {
  ViewControl control(extentOf(artwork()), startView(), kWidth, kHeight);
  Hand hand{control};
  hand.drag(MouseButton::kLeft, 600, 400, 700, 400);
  EXPECT_NEAR(control.view().camera.azimuth_deg, -100 * 180.0 / kHeight, 1e-9) << "dragging right turns the eye left";
  hand.drag(MouseButton::kLeft, 600, 400, 600, 450);
  EXPECT_NEAR(control.view().camera.elevation_deg, 50 * 180.0 / kHeight, 1e-9) << "dragging down lifts the eye";
  hand.drag(MouseButton::kLeft, 0, 0, 5000, 9000);
  EXPECT_LE(std::abs(control.view().camera.azimuth_deg), ViewControl::kMaxTiltDeg);
  EXPECT_LE(std::abs(control.view().camera.elevation_deg), ViewControl::kMaxTiltDeg);
}

TEST(ViewControl, LightFollowsTheHandAndStaysAUnitVectorAboveTheSurface) {
  ViewControl control(extentOf(artwork()), startView(), kWidth, kHeight);
  Hand hand{control};
  hand.down(MouseButton::kRight, 640, 400);
  EXPECT_TRUE(control.draggingLight());
  hand.to(740, 350);
  EXPECT_GT(control.view().light[0], 0);
  EXPECT_GT(control.view().light[1], 0) << "up in the picture is +y";
  for (double x : {5000.0, -7000.0, 640.0})
    for (double y : {-4000.0, 9000.0, 400.0}) {
      hand.to(x, y);
      const auto& l = control.view().light;
      EXPECT_NEAR(std::hypot(l[0], l[1], l[2]), 1, 1e-12);
      EXPECT_GT(l[2], 0.1);
    }
  hand.up(MouseButton::kRight, 640, 400);
  EXPECT_FALSE(control.draggingLight());
  const auto light = control.view().light;
  hand.to(100, 100);
  EXPECT_EQ(control.view().light, light);
  EXPECT_EQ(control.view().camera.azimuth_deg, 0);
}

TEST(ViewControl, TheLightOfTheStartKeepsItsDirection) {
  for (const std::array<double, 3>& light : {std::array<double, 3>{0.1, 0, -1}, {1, 0, 0}, {0, 0, -2}}) {
    ViewControl::View start = startView();
    start.light = light;
    const ViewControl control(extentOf(artwork()), start, kWidth, kHeight);
    const double length = std::hypot(light[0], light[1], light[2]);
    for (size_t i = 0; i < 3; ++i) EXPECT_NEAR(control.view().light[i], light[i] / length, 1e-12);
  }
}

TEST(ViewControl, HoldingLMovesTheLightWithoutAButton) {
  ViewControl control(extentOf(artwork()), startView(), kWidth, kHeight);
  Hand hand{control};
  hand.to(640, 400);
  hand.press("L");
  hand.to(500, 400);
  EXPECT_LT(control.view().light[0], -0.2);
  hand.release("L");
  const auto light = control.view().light;
  hand.to(900, 100);
  EXPECT_EQ(control.view().light, light);
  EXPECT_EQ(control.view().camera.azimuth_deg, 0);
}

// What lies in the plane through the target keeps its pixel, and so its size; what lies nearer moves.
TEST(ViewControl, TheProjectionSwitchesAroundTheTarget) {
  const Extent body{{-80, -60, -50}, {80, 60, 50}, 0.1, false};
  for (const Extent& extent : {extentOf(artwork()), body}) {
    ViewControl::View start{fitCamera(extent, kWidth, kHeight), {0, 0, 1}};
    start.camera.azimuth_deg = 25;
    start.camera.elevation_deg = -15;
    ViewControl control(extent, start, kWidth, kHeight);
    Hand hand{control};
    hand.to(500, 300);
    hand.wheel(4);
    const OrbitCamera before = control.view().camera;
    auto pixelOf = [&](const glm::dvec3& p) {
      const glm::dvec4 clip =
          viewTransform(control.view().camera, extent, kWidth, kHeight).clip_from_world * glm::dvec4(p, 1);
      return glm::dvec2(clip.x, clip.y) / clip.w * glm::dvec2(kWidth, kHeight) / 2.0;
    };
    const glm::dvec3 left = pointAtTarget(before, kWidth, kHeight, 100, 200),
                     right = pointAtTarget(before, kWidth, kHeight, 900, 650);
    const glm::dvec3 nearer = right + 0.2 * (eyePosition(before) - before.target_mm);
    const glm::dvec2 left_px = pixelOf(left), right_px = pixelOf(right), nearer_px = pixelOf(nearer);
    hand.press("O");
    EXPECT_TRUE(control.view().camera.orthographic);
    EXPECT_EQ(mmPerPx(control.view().camera, kHeight), mmPerPx(before, kHeight));
    EXPECT_LT(glm::length(pixelOf(left) - left_px), 1e-6);
    EXPECT_LT(glm::length(pixelOf(right) - right_px), 1e-6);
    EXPECT_GT(glm::length(pixelOf(nearer) - nearer_px), 10) << "control";
    hand.press("O");
    EXPECT_FALSE(control.view().camera.orthographic);
    EXPECT_EQ(control.view().camera.distance_mm, before.distance_mm);
    EXPECT_EQ(control.view().camera.target_mm, before.target_mm);
    hand.press("O");
    hand.press("R");
    EXPECT_FALSE(control.view().camera.orthographic) << "as at the start";
  }
}

// In the middle of a pan, the point under the mouse is the one that is held from then on.
TEST(ViewControl, TheProjectionSwitchesWithinAPan) {
  ViewControl::View start = startView();
  start.camera.azimuth_deg = 50;
  ViewControl control(extentOf(artwork()), start, kWidth, kHeight);
  Hand hand{control};
  hand.down(MouseButton::kMiddle, 300, 250);
  hand.to(330, 260);
  hand.press("O");
  const glm::dvec3 held = under(control, 330, 260);
  const glm::dvec3 target = control.view().camera.target_mm;
  hand.to(330, 260);
  EXPECT_LT(glm::length(control.view().camera.target_mm - target), 1e-9) << "it does not jump";
  hand.to(420, 300);
  EXPECT_LT(glm::length(under(control, 420, 300) - held), 1e-6);
}

TEST(ViewControl, KeysToggleResetAndQuit) {
  ViewControl control(extentOf(artwork()), startView(), kWidth, kHeight);
  Hand hand{control};
  const auto any = [&] {
    return control.occlusion || control.wireframe || control.show_pages || control.help || control.figures;
  };
  EXPECT_FALSE(any() || control.quit);
  for (const char* key : {"A", "W", "P", "F1", "F2"}) hand.press(key);
  EXPECT_TRUE(control.occlusion && control.wireframe && control.show_pages && control.help && control.figures);
  for (const char* key : {"A", "W", "P", "F1", "F2"}) hand.press(key);
  EXPECT_FALSE(any());
  hand.press("S");
  EXPECT_TRUE(control.takeSnapshotRequest());
  EXPECT_FALSE(control.takeSnapshotRequest());
  hand.drag(MouseButton::kLeft, 0, 0, 100, 100);
  hand.drag(MouseButton::kRight, 0, 0, 100, 100);
  hand.wheel(3);
  hand.press("R");
  EXPECT_EQ(control.view().camera.azimuth_deg, 0);
  EXPECT_EQ(control.view().camera.distance_mm, startView().camera.distance_mm);
  EXPECT_EQ(control.view().light, startView().light);
  EXPECT_FALSE(control.handle({.kind = EventKind::kKeyDown, .key = "Q"}));
  EXPECT_FALSE(control.quit);
  hand.press("Escape");
  EXPECT_TRUE(control.quit);
}

TEST(ViewControl, AHandStopsWhatMovesByItself) {
  ViewControl control(extentOf(artwork()), startView(), kWidth, kHeight);
  Hand hand{control};
  hand.press("Space");
  EXPECT_FALSE(control.playing) << "nothing moves";
  control.animated = true;
  const auto stops = [&](auto&& act) {
    hand.press("Space");
    EXPECT_TRUE(control.playing);
    hand.to(10, 10);
    hand.press("W");
    EXPECT_TRUE(control.playing) << "that is no hand on camera or light";
    act();
    EXPECT_FALSE(control.playing);
  };
  stops([&] { hand.press("Space"); });
  stops([&] { hand.wheel(1); });
  stops([&] { hand.drag(MouseButton::kLeft, 10, 10, 50, 50); });
  stops([&] { hand.drag(MouseButton::kRight, 10, 10, 50, 50); });
  stops([&] { hand.press("O"); });
  stops([&] { hand.press("R"); });
  stops([&] { hand.press("L"), hand.to(60, 60), hand.release("L"); });
  OrbitCamera camera = startView().camera;
  camera.azimuth_deg = 200;
  SceneLight near{.near = true, .place = {1, 2, 3}}, far{.place = {0, 3, 4}};
  control.show(camera, {near, far});
  EXPECT_EQ(control.view().camera, camera) << "as it is";
  EXPECT_EQ(control.view().light, (std::array{0.0, 0.6, 0.8}));
  hand.drag(MouseButton::kRight, 10, 10, 50, 10);
  EXPECT_EQ(control.view().lights[0], near);
  EXPECT_NEAR(control.view().lights[1].place[0], 0.1, 1e-12);
  EXPECT_EQ(control.view().lights[1].place, control.view().light);
}

TEST(ViewControl, KeysChooseShadingEffectsAndTheLightToMove) {
  using Kind = ReliefShading::Kind;
  ViewControl::View start = startView();
  start.lights = {{.near = true, .place = {1, 2, 30}}, {.place = {0, 3, 4}, .intensity = 0}, {.place = {3, 0, 4}}};
  ViewControl control(extentOf(artwork()), start, kWidth, kHeight);
  Hand hand{control};
  hand.press("M");
  EXPECT_EQ(control.shading, Kind::kNone) << "there is none to show";
  control.shadings = {Kind::kSlope, Kind::kDepth};
  for (const Kind expected : {Kind::kSlope, Kind::kDepth, Kind::kNone, Kind::kSlope}) {
    hand.press("M");
    EXPECT_EQ(control.shading, expected);
  }
  for (const bool on : {true, false}) {
    hand.press("H"), hand.press("G");
    EXPECT_EQ(control.shadows, on);
    EXPECT_EQ(control.gloss, on);
  }
  // At first the first that is far away and on; then one after the other.
  EXPECT_EQ(control.view().held, 2u);
  const auto dragged = [&] {
    const auto before = control.view().lights;
    hand.drag(MouseButton::kRight, 600, 400, 680, 360);
    std::vector<size_t> moved;
    for (size_t i = 0; i < before.size(); ++i)
      if (control.view().lights[i].place != before[i].place) moved.push_back(i);
    return moved;
  };
  EXPECT_EQ(dragged(), (std::vector<size_t>{2}));
  EXPECT_EQ(control.view().lights[2].place, control.view().light);
  hand.press("N");
  EXPECT_EQ(dragged(), (std::vector<size_t>{0}));
  // A near one goes with the mouse, by what a pixel is worth.
  const double mm = mmPerPx(control.view().camera, kHeight);
  EXPECT_NEAR(control.view().lights[0].place[0], 1 + 80 * mm, 1e-9);
  EXPECT_NEAR(control.view().lights[0].place[1], 2 + 40 * mm, 1e-9);
  EXPECT_NEAR(control.view().lights[0].place[2], 30, 1e-9);
  hand.press("N");
  EXPECT_NEAR(control.view().light[1], 0.6, 1e-12) << "where the next one stands";
  EXPECT_EQ(dragged(), (std::vector<size_t>{1}));
  hand.press("R");
  EXPECT_EQ(control.view().lights, start.lights);
  EXPECT_EQ(control.view().held, 2u);
}

// ---- surfaces: what is known of them analytically, seen along exact rays

// Of a place of the picture on the screen: the ray's origin and direction.
struct Ray {
  glm::dvec3 from, along;
};
Ray rayUnder(const OrbitCamera& c, double x, double y) {
  const glm::dvec3 on_target = pointAtTarget(c, kWidth, kHeight, x, y), eye = eyePosition(c),
                   forward = (c.target_mm - eye) / c.distance_mm;
  if (c.orthographic) return {on_target - forward * 2000.0, forward};
  return {eye, glm::normalize(on_target - eye)};
}

struct TestSurface : EyeGuard {
  virtual std::optional<glm::dvec3> hit(const Ray& ray) const = 0;
  virtual double outside(const glm::dvec3& p) const = 0;  // above 0 exactly where a place is outside
  virtual Extent extent() const = 0;
  virtual Extent whole() const { return extent(); }  // with its heights
};

// A flat artwork of tall relief: bumps of 60 mm on a panel of 300 x 200 mm.
struct Bumps final : TestSurface {
  static double height(double x, double y) {
    if (std::abs(x) > 150 || std::abs(y) > 100) return -1e9;
    return 30 * (std::sin(x / 17) * std::cos(y / 13 + 0.3 * std::sin(x / 29)) + 1);
  }
  // No steeper than 1 in 0.4 or so: a height above ground is at least so much of a distance.
  double distance(const glm::dvec3& p) const override {
    const glm::dvec2 beside = glm::max(glm::abs(glm::dvec2(p)) - glm::dvec2(150, 100), glm::dvec2(0));
    if (beside.x > 0 || beside.y > 0) return glm::length(glm::dvec3(beside, std::max(0.0, p.z - 60)));
    return std::min((p.z - height(p.x, p.y)) * 0.25, std::max(1.0, p.z - 60));
  }
  bool behind(const glm::dvec3&) const override { return false; }
  std::optional<glm::dvec3> hit(const Ray& ray) const override {
    for (double t = 0; t < 8000; t += 0.05) {
      const glm::dvec3 p = ray.from + ray.along * t;
      if (p.z > 61) {  // nothing is so high
        if (ray.along.z >= 0) return std::nullopt;
        t = std::max(t, (60.5 - ray.from.z) / ray.along.z);
        continue;
      }
      if (p.z < -1) return std::nullopt;
      if (p.z <= height(p.x, p.y)) return p;
    }
    return std::nullopt;
  }
  double outside(const glm::dvec3& p) const override { return p.z - height(p.x, p.y); }
  Extent extent() const override { return extentOf(artwork()); }
  Extent whole() const override { return extentOf(artwork(), 0, 60); }
};

struct Ball final : TestSurface {
  double distance(const glm::dvec3& p) const override { return std::abs(glm::length(p) - 50); }
  bool behind(const glm::dvec3& p) const override { return glm::length(p) < 50; }
  std::optional<glm::dvec3> hit(const Ray& ray) const override {
    const double b = glm::dot(ray.from, ray.along), c = glm::dot(ray.from, ray.from) - 2500, d = b * b - c;
    if (d < 0 || -b - std::sqrt(d) < 0) return std::nullopt;
    return ray.from + ray.along * (-b - std::sqrt(d));
  }
  double outside(const glm::dvec3& p) const override { return glm::length(p) - 50; }
  Extent extent() const override { return {glm::dvec3(-50), glm::dvec3(50), 0.1, false}; }
};

// A control of what is seen of a surface. guarded: the eye is kept outside; else as a control that knows no surface.
struct Seen {
  const TestSurface& surface;
  ViewControl control;
  Seen(const TestSurface& of, bool guarded, ViewControl::View start)
      : surface(of),
        control(of.extent(), start, kWidth, kHeight,
                guarded ? ViewControl::Surface{[this](double x, double y) { return under(x, y); }, &of}
                        : ViewControl::Surface{}) {}
  Seen(const TestSurface& of, bool guarded) : Seen(of, guarded, {fitCamera(of.extent(), kWidth, kHeight), {0, 0, 1}}) {}
  std::optional<glm::dvec3> under(double x, double y) const {
    return surface.hit(rayUnder(control.view().camera, x, y));
  }
  double eyeOutside() const { return surface.outside(eyePosition(control.view().camera)); }
  glm::dvec2 pixelOf(const glm::dvec3& p) const {
    const glm::dvec4 clip =
        viewTransform(control.view().camera, surface.extent(), kWidth, kHeight).clip_from_world * glm::dvec4(p, 1);
    return {(clip.x / clip.w + 1) * kWidth / 2, (1 - clip.y / clip.w) * kHeight / 2};
  }
};

const Bumps kBumps;
const Ball kBall;

TEST(ViewControlSurface, AHundredNotchesEndAtTheSurface) {
  for (const TestSurface* surface : std::initializer_list<const TestSurface*>{&kBumps, &kBall}) {
    for (glm::dvec2 mouse : {glm::dvec2(640, 400), glm::dvec2(500, 330), glm::dvec2(760, 520)}) {
      for (bool guarded : {true, false}) {
        Seen seen(*surface, guarded);
        Hand hand{seen.control};
        hand.drag(MouseButton::kLeft, 640, 400, 700, 450);
        hand.to(mouse.x, mouse.y);
        const auto point = seen.under(mouse.x, mouse.y);
        ASSERT_TRUE(point);
        double least = 1e300;
        for (int notch = 0; notch < 100; ++notch) {
          hand.wheel(1);
          least = std::min(least, seen.eyeOutside());
          if (guarded) {
            ASSERT_LT(glm::length(seen.pixelOf(*point) - mouse), 0.01) << "notch " << notch;
          }
        }
        if (guarded) {
          EXPECT_GT(least, 0);
          const auto middle = seen.under(640, 400);
          ASSERT_TRUE(middle) << "the artwork fills the window";
          const ViewTransform view = viewTransform(seen.control.view().camera, surface->whole(), kWidth, kHeight);
          EXPECT_LT(view.near_mm, glm::length(*middle - view.eye_mm)) << "the near plane lies before it";
          EXPECT_LT(glm::length(*middle - view.eye_mm), 5) << "and it is near";
        } else if (mouse.x == 640) {
          EXPECT_LT(least, 0) << "control: without a surface the eye goes through";
        }
      }
    }
  }
}

TEST(ViewControlSurface, AnOrbitKeepsThePointUnderTheMouse) {
  for (const TestSurface* surface : std::initializer_list<const TestSurface*>{&kBumps, &kBall}) {
    for (bool orthographic : {false, true}) {
      ViewControl::View start{fitCamera(surface->extent(), kWidth, kHeight), {0, 0, 1}};
      start.camera.orthographic = orthographic;
      Seen seen(*surface, true, start);
      Hand hand{seen.control};
      const glm::dvec2 mouse(560, 350);
      const auto point = seen.under(mouse.x, mouse.y);
      ASSERT_TRUE(point);
      hand.down(MouseButton::kLeft, mouse.x, mouse.y);
      for (int i = 1; i <= 20; ++i) {
        hand.to(mouse.x + 12 * i, mouse.y + 5 * i);
        ASSERT_LT(glm::length(seen.pixelOf(*point) - mouse), 0.01) << i;
        if (!orthographic) {
          ASSERT_GT(seen.eyeOutside(), 0);
        }
      }
      EXPECT_LT(seen.control.view().camera.azimuth_deg, -50) << "it did turn";
      hand.up(MouseButton::kLeft, 0, 0);
    }
  }
}

// Over the background a body turns about the target.
TEST(ViewControlSurface, AnOrbitOverTheBackgroundKeepsTheTarget) {
  Seen seen(kBall, true);
  Hand hand{seen.control};
  ASSERT_FALSE(seen.under(20, 20));
  const glm::dvec3 target = seen.control.view().camera.target_mm;
  hand.drag(MouseButton::kLeft, 20, 20, 300, 100);
  EXPECT_EQ(seen.control.view().camera.target_mm, target);
  EXPECT_NEAR(seen.control.view().camera.azimuth_deg, -280 * 180.0 / kHeight, 1e-9);
}

TEST(ViewControlSurface, PanHoldsThePointOfTheSurface) {
  for (const TestSurface* surface : std::initializer_list<const TestSurface*>{&kBumps, &kBall}) {
    Seen seen(*surface, true);
    Hand hand{seen.control};
    hand.to(600, 380);
    hand.wheel(3);
    const auto point = seen.under(600, 380);
    ASSERT_TRUE(point);
    hand.drag(MouseButton::kMiddle, 600, 380, 660, 350);
    EXPECT_LT(glm::length(seen.pixelOf(*point) - glm::dvec2(660, 350)), 0.01);
    EXPECT_GT(seen.eyeOutside(), 0);
  }
}

// Whatever a hand does, a perspective eye is outside after each event. The control knows no surface.
TEST(ViewControlSurface, NothingAHandDoesPutsTheEyeInside) {
  for (const TestSurface* surface : std::initializer_list<const TestSurface*>{&kBumps, &kBall}) {
    for (bool guarded : {true, false}) {
      Seen seen(*surface, guarded);
      Hand hand{seen.control};
      std::mt19937 random(11);
      std::uniform_real_distribution<double> x(0, kWidth), y(0, kHeight), uniform(0, 1);
      int inside = 0, moved = 0;
      for (int i = 0; i < 1500; ++i) {
        const glm::dvec3 before = eyePosition(seen.control.view().camera);
        switch (random() % 8) {
          case 0:
          case 1:
          case 2:
            hand.to(x(random), y(random)),
                hand.wheel(uniform(random) < 0.75 ? 1 + 5 * uniform(random) : -4 * uniform(random));
            break;
          case 3:
          case 4:
            hand.drag(MouseButton::kLeft, x(random), y(random), x(random), y(random));
            break;
          case 5:
            hand.drag(MouseButton::kMiddle, x(random), y(random), x(random), y(random));
            break;
          case 6:
            hand.press("O");
            break;
          case 7:
            if (random() % 8 == 0) hand.press("R");
            break;
        }
        const OrbitCamera& c = seen.control.view().camera;
        ASSERT_TRUE(std::isfinite(c.distance_mm) && c.distance_mm > 0 &&
                    std::isfinite(c.target_mm.x + c.target_mm.y + c.target_mm.z));
        inside += !c.orthographic && seen.eyeOutside() <= 0;
        moved += eyePosition(c) != before;
      }
      EXPECT_TRUE(guarded ? inside == 0 : inside > 10) << inside << " inside, seed 11; without a surface: the control";
      EXPECT_GT(moved, 700);
    }
  }
}

// A start inside, as a file or an option may say, is moved out along the line of sight; and so is what reset goes back
// to.
TEST(ViewControlSurface, AStartInsideIsMovedOut) {
  for (const TestSurface* surface : std::initializer_list<const TestSurface*>{&kBumps, &kBall}) {
    ViewControl::View start{fitCamera(surface->extent(), kWidth, kHeight), {0, 0, 1}};
    start.camera.distance_mm = 3;
    start.camera.target_mm = {2, 3, 0};
    Seen free(*surface, false, start), seen(*surface, true, start);
    EXPECT_LT(free.eyeOutside(), 0) << "control";
    EXPECT_GT(seen.eyeOutside(), 0);
    EXPECT_EQ(seen.control.view().camera.target_mm, start.camera.target_mm);
    Hand hand{seen.control};
    hand.drag(MouseButton::kLeft, 640, 400, 700, 450);
    hand.press("R");
    EXPECT_GT(seen.eyeOutside(), 0);
    // One that is outside stays as it is.
    ViewControl::View near{fitCamera(surface->extent(), kWidth, kHeight), {0, 0, 1}};
    near.camera.distance_mm = 90;
    EXPECT_EQ(Seen(*surface, true, near).control.view().camera.distance_mm, 90);
  }
}

}  // namespace view_control_test
}  // namespace relievo
