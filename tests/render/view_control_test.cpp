// What mouse and keys do: the point that is grabbed or zoomed at stays under the mouse, whatever the view.
#include <cmath>
#include <random>

#include <gtest/gtest.h>

#include "src/view_control.h"

namespace relievo {
namespace {

using gl::Event;
using gl::EventKind;
using gl::MouseButton;

constexpr int kWidth = 1280, kHeight = 800;

PlanarDomain artwork() {
  PlanarDomain d;
  d.width_px = 3000;
  d.height_px = 2000;
  d.mm_per_px = 0.1;
  d.texture_depth = PlanarDomain::depthFor(d.width_px, d.height_px);
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
  void up(MouseButton b, double x, double y) { control.handle({.kind = EventKind::kMouseUp, .x = x, .y = y, .button = b}); }
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
      const glm::dvec4 clip = viewTransform(control.view().camera, extent, kWidth, kHeight).clip_from_world * glm::dvec4(p, 1);
      return glm::dvec2(clip.x, clip.y) / clip.w * glm::dvec2(kWidth, kHeight) / 2.0;
    };
    const glm::dvec3 left = pointAtTarget(before, kWidth, kHeight, 100, 200), right = pointAtTarget(before, kWidth, kHeight, 900, 650);
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
  EXPECT_FALSE(control.wireframe || control.show_pages || control.help || control.figures || control.quit);
  for (const char* key : {"W", "P", "F1", "F2"}) hand.press(key);
  EXPECT_TRUE(control.wireframe && control.show_pages && control.help && control.figures);
  for (const char* key : {"W", "P", "F1", "F2"}) hand.press(key);
  EXPECT_FALSE(control.wireframe || control.show_pages || control.help || control.figures);
  hand.press("S");
  EXPECT_TRUE(control.takeSnapshotWish());
  EXPECT_FALSE(control.takeSnapshotWish());
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

}  // namespace
}  // namespace relievo
