// view_control.h - what the mouse and the keys do to camera, light and display; no window, no GL.
//   left drag             orbit: the artwork follows the hand
//   middle drag, shift+left   pan: the point that was grabbed stays under the mouse
//   wheel                 zoom: the point under the mouse stays there
//   right drag, L + move  light
//   O                     perspective or orthographic: what is at the target keeps its size and place
//   W P R S F1 F2 Esc     wireframe, page overlay, reset, snapshot, help, figures, quit
// Angles are kept where a flat artwork is seen from the front (a body turns all around), the target on the artwork, the distance
// within bounds.
#pragma once

#include <array>
#include <utility>

#include "src/camera.h"
#include "src/gl/window.h"

namespace relievo {

class ViewControl {
 public:
  struct View {
    OrbitCamera camera;
    std::array<double, 3> light{0, 0, 1};  // unit, z > 0
  };
  static constexpr double kMaxTiltDeg = 85;
  static constexpr double kWheelFactor = 0.85;  // of the distance, a step

  ViewControl(const Extent& extent, const View& start, int width_px, int height_px);

  // True when it changed what is shown.
  bool handle(const gl::Event& event);

  const View& view() const { return view_; }
  bool draggingLight() const { return mode_ == Mode::kLight; }
  bool wireframe = false, show_pages = false, help = false, figures = false;
  bool quit = false;
  bool takeSnapshotWish() { return std::exchange(snapshot_wished_, false); }

 private:
  enum class Mode { kNone, kOrbit, kPan, kLight };
  void beginDrag(Mode mode);
  void drag(double x, double y);
  void pan(double x, double y);
  void zoom(double steps);
  void keepWithinBounds();

  // The point under a pixel: of a flat artwork's plane, else of the plane through the target that faces the eye.
  bool pointUnder(double x, double y, glm::dvec3* point_mm) const;

  Extent extent_;
  View start_, view_;
  int width_px_, height_px_;
  double min_distance_mm_, max_distance_mm_;
  Mode mode_ = Mode::kNone;
  bool light_key_ = false, grabbed_ = false, snapshot_wished_ = false;
  double x_ = 0, y_ = 0;       // the mouse
  glm::dvec3 grabbed_mm_{0};   // the point of the plane that pan holds
};

}  // namespace relievo
