// view_control.h - what the mouse and the keys do to camera, light and display; no window, no GL.
//   left drag           orbits about the surface point under the mouse, which stays there; else about the target
//   middle, shift+left  pans: the grabbed point stays under the mouse
//   wheel               zooms: the point under the mouse stays there
//   right drag, L+move  moves the light
//   Space               plays or pauses what moves by itself; a hand on camera or light pauses it
//   O                   switches between perspective and orthographic; the target keeps its size and place
//   N                   chooses the next of several lights to move; a near one moves across the line of sight
//   M                   shows the next shading in the place of colour and light, at last these again
//   H, A, G             switch shadows, ambient occlusion, gloss
//   W, P                switch the wireframe and the page overlay
//   R, S                reset the view; save a snapshot
//   F1, F2, Esc         show help; show figures; quit
// A flat artwork is only seen from its front; a body can be turned all around. The target stays on the artwork and the
// distance within bounds. A perspective eye stays outside of the surface (eye_guard.h): a zoom that would enter it
// stops before it; orbiting and panning move the eye away where that lets them go on. To orbit or zoom about a point of
// the surface moves the target to that point's distance, so that zooming in ends at the surface.
#pragma once

#include <array>
#include <functional>
#include <optional>
#include <utility>
#include <vector>

#include "src/engine/effects/lights.h"
#include "src/engine/effects/relief_shading.h"
#include "src/engine/eye_guard.h"
#include "src/gl/window.h"
#include "src/render/camera.h"

namespace relievo {

class ViewControl {
 public:
  struct View {
    OrbitCamera camera;
    std::array<double, 3> light{0, 0, 1};  // unit, z > 0
    // The scene's, in its place. The mouse moves the one with the number `held`, at first the first that is far away;
    // if that is far away it is at `light`.
    std::vector<SceneLight> lights;
    size_t held = 0;
  };
  static constexpr double kMaxTiltDeg = 85;
  static constexpr double kWheelFactor = 0.85;  // of the distance, a step

  // Default: points lie on a flat artwork's plane, or on the plane through a body's target, and nothing guards the eye.
  struct Surface {
    // The point of it that a pixel (origin top left) of the picture on the screen shows; nothing over the background.
    std::function<std::optional<glm::dvec3>(double x_px, double y_px)> under;
    const EyeGuard* guard;  // outlives the control; may be null
  };

  ViewControl(const Extent& extent, const View& start, int width_px, int height_px, Surface surface = {});

  // True when it changed what is shown.
  bool handle(const gl::Event& event);
  // Replaces the guard, and moves the eye outside of the guard's surface if it is inside. True when that changed what
  // is shown.
  bool setGuard(const EyeGuard* guard);

  const View& view() const { return view_; }
  // The view of a moment of what moves by itself, as it is.
  void show(const OrbitCamera& camera, const std::vector<SceneLight>& lights);
  bool draggingLight() const { return mode_ == Mode::kLight; }
  bool shadows = false, gloss = false;
  ReliefShading::Kind shading = ReliefShading::Kind::kNone;
  std::vector<ReliefShading::Kind> shadings;  // that the artwork can be shown with, besides kNone
  bool occlusion = false, wireframe = false, show_pages = false, help = false, figures = false;
  bool animated = false, playing = false;  // does anything move by itself; is it moving
  bool quit = false;
  bool wantsSnapshot() const { return snapshot_requested_; }
  bool takeSnapshotRequest() { return std::exchange(snapshot_requested_, false); }

 private:
  enum class Mode { kNone, kOrbit, kPan, kLight };
  // The one of view().lights that the mouse moves; null: view().light alone.
  SceneLight* heldLight() { return view_.held < view_.lights.size() ? &view_.lights[view_.held] : nullptr; }
  void takeHeldDirection();
  void moveLight(double dx, double dy);
  void beginDrag(Mode mode);
  void drag(double x, double y);
  void turn(double azimuth_deg, double elevation_deg);
  void pan(double x, double y);
  OrbitCamera panned(const OrbitCamera& from, double x, double y);
  void zoom(double steps);
  void keepAngles(OrbitCamera& camera) const;
  void keepTarget(OrbitCamera& camera, const glm::dvec3& before_mm) const;

  // ---- the surface
  // Moves the target along the line of sight to the point's distance. The picture stays the same.
  void anchor(const glm::dvec3& point_mm);
  // Moves towards a camera of the same direction and projection, as far as the eye stays outside of the surface. False:
  // it did not get there.
  bool moveTo(const OrbitCamera& wanted);
  bool wayIsFree(const OrbitCamera& from, const OrbitCamera& to) const;
  bool isOutside(const OrbitCamera& camera) const;
  void placeOutside(OrbitCamera& camera) const;
  void keepNearPlane();

  // The point under a pixel: for a flat artwork on the plane of height z_mm, for a body on the plane through the target
  // that faces the eye.
  bool pointUnder(const OrbitCamera& camera, double x, double y, double z_mm, glm::dvec3* point_mm) const;

  Extent extent_;
  View start_, view_;
  int width_px_, height_px_;
  double min_distance_mm_, max_distance_mm_, clear_mm_ = 0;
  Surface surface_;
  Mode mode_ = Mode::kNone;
  bool light_key_ = false, grabbed_ = false, snapshot_requested_ = false;
  double x_ = 0, y_ = 0;                // the mouse
  glm::dvec3 grabbed_mm_{0};            // the point that pan holds
  std::optional<glm::dvec3> pivot_mm_;  // the point that a drag turns about; none: the target
};

}  // namespace relievo
