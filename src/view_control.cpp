#include "src/view_control.h"

#include <algorithm>
#include <cmath>

namespace relievo {
namespace {

// Beyond this a light grazes so much that nothing but the rims is lit.
constexpr double kMaxLightRadius = 0.985;

std::array<double, 3> lightAt(double x, double y) {
  const double radius = std::hypot(x, y);
  if (radius > kMaxLightRadius) {
    x *= kMaxLightRadius / radius;
    y *= kMaxLightRadius / radius;
  }
  return {x, y, std::sqrt(std::max(0.0, 1 - x * x - y * y))};
}

}  // namespace

ViewControl::ViewControl(const Extent& extent, const View& start, int width_px, int height_px)
    : extent_(extent), start_(start), view_(start), width_px_(std::max(1, width_px)), height_px_(std::max(1, height_px)) {
  const auto& l = start.light;
  const double length = std::hypot(l[0], l[1], l[2]);
  if (length > 0) start_.light = lightAt(l[0] / length, l[1] / length);
  const double fit_mm = fitCamera(extent, width_px_, height_px_, start.camera.fov_deg).distance_mm;
  // From eight texels across the window's height to the artwork as a stamp.
  min_distance_mm_ = std::min(fit_mm, 8 * extent.texel_mm / (2 * std::tan(glm::radians(start.camera.fov_deg) / 2)));
  max_distance_mm_ = std::max(20 * fit_mm, start.camera.distance_mm);
  min_distance_mm_ = std::min(min_distance_mm_, start.camera.distance_mm);
  view_ = start_;
}

void ViewControl::keepWithinBounds() {
  OrbitCamera& c = view_.camera;
  const double tilt = std::max({kMaxTiltDeg, std::abs(start_.camera.azimuth_deg), std::abs(start_.camera.elevation_deg)});
  if (extent_.flat) {
    c.azimuth_deg = std::clamp(c.azimuth_deg, -tilt, tilt);
    c.elevation_deg = std::clamp(c.elevation_deg, -std::min(tilt, 89.0), std::min(tilt, 89.0));
  } else {
    c.azimuth_deg = std::remainder(c.azimuth_deg, 360.0);
    c.elevation_deg = std::clamp(c.elevation_deg, -89.0, 89.0);
  }
  c.distance_mm = std::clamp(c.distance_mm, min_distance_mm_, max_distance_mm_);
  const double z = c.target_mm.z;
  c.target_mm = glm::clamp(c.target_mm, extent_.min_mm, extent_.max_mm);
  if (extent_.flat) c.target_mm.z = z;
}

bool ViewControl::pointUnder(double x, double y, glm::dvec3* point_mm) const {
  const OrbitCamera& c = view_.camera;
  if (extent_.flat) return pointOnPlane(c, width_px_, height_px_, x, y, point_mm);
  *point_mm = pointAtTarget(c, width_px_, height_px_, x, y);
  return true;
}

void ViewControl::beginDrag(Mode mode) {
  mode_ = mode;
  if (mode == Mode::kPan) grabbed_ = pointUnder(x_, y_, &grabbed_mm_);
}

void ViewControl::pan(double x, double y) {
  OrbitCamera& c = view_.camera;
  glm::dvec3 now_mm;
  // Near the horizon the plane runs away under the mouse: there, as outside it, pan by what a pixel is worth at the target.
  const double largest_mm = 4 * c.distance_mm;
  if (grabbed_ && pointUnder(x, y, &now_mm) && glm::length(now_mm - c.target_mm) < largest_mm &&
      glm::length(grabbed_mm_ - c.target_mm) < largest_mm) {
    c.target_mm += grabbed_mm_ - now_mm;
  } else {
    const double mm_per_px = mmPerPx(c, height_px_);
    const double azimuth = glm::radians(c.azimuth_deg);
    c.target_mm.x -= (x - x_) * mm_per_px * std::cos(azimuth);
    c.target_mm.y += (y - y_) * mm_per_px;
    grabbed_ = false;
  }
  keepWithinBounds();
}

void ViewControl::zoom(double steps) {
  OrbitCamera& c = view_.camera;
  glm::dvec3 fixed_mm;
  if (!pointUnder(x_, y_, &fixed_mm)) fixed_mm = c.target_mm;
  const double distance_mm = std::clamp(c.distance_mm * std::pow(kWheelFactor, steps), min_distance_mm_, max_distance_mm_);
  // Eye and target scale about the same point, so the ray through it stays.
  c.target_mm = fixed_mm + (c.target_mm - fixed_mm) * (distance_mm / c.distance_mm);
  c.distance_mm = distance_mm;
  keepWithinBounds();
}

void ViewControl::drag(double x, double y) {
  OrbitCamera& c = view_.camera;
  const double dx = x - x_, dy = y - y_;
  switch (mode_) {
    case Mode::kNone: break;
    case Mode::kOrbit:
      c.azimuth_deg -= dx * 180 / height_px_;
      c.elevation_deg += dy * 180 / height_px_;
      keepWithinBounds();
      break;
    case Mode::kPan: pan(x, y); break;
    case Mode::kLight: {
      const double radius_px = 0.5 * std::min(width_px_, height_px_);
      view_.light = lightAt(view_.light[0] + dx / radius_px, view_.light[1] - dy / radius_px);
      break;
    }
  }
}

bool ViewControl::handle(const gl::Event& e) {
  using gl::EventKind;
  switch (e.kind) {
    case EventKind::kMouseMove: {
      const bool moved = mode_ != Mode::kNone;
      drag(e.x, e.y);
      x_ = e.x;
      y_ = e.y;
      return moved;
    }
    case EventKind::kMouseDown:
      x_ = e.x;
      y_ = e.y;
      if (e.button == gl::MouseButton::kRight) beginDrag(Mode::kLight);
      else if (e.button == gl::MouseButton::kMiddle || e.shift) beginDrag(Mode::kPan);
      else beginDrag(light_key_ ? Mode::kLight : Mode::kOrbit);
      return true;
    case EventKind::kMouseUp: mode_ = light_key_ ? Mode::kLight : Mode::kNone; return true;
    case EventKind::kScroll: zoom(e.y); return true;
    case EventKind::kResize:
      width_px_ = std::max(1, static_cast<int>(e.x));
      height_px_ = std::max(1, static_cast<int>(e.y));
      return true;
    case EventKind::kClose: quit = true; return true;
    case EventKind::kKeyUp:
      if (e.key != "L") return false;
      light_key_ = false;
      if (mode_ == Mode::kLight) mode_ = Mode::kNone;
      return true;
    case EventKind::kKeyDown: break;
  }
  if (e.key == "L") {
    light_key_ = true;
    if (mode_ == Mode::kNone) mode_ = Mode::kLight;
  } else if (e.key == "W") {
    wireframe = !wireframe;
  } else if (e.key == "P") {
    show_pages = !show_pages;
  } else if (e.key == "O") {
    view_.camera.orthographic = !view_.camera.orthographic;
    grabbed_ = grabbed_ && pointUnder(x_, y_, &grabbed_mm_);
  } else if (e.key == "R") {
    view_ = start_;
    grabbed_ = false;
  } else if (e.key == "S") {
    snapshot_wished_ = true;
  } else if (e.key == "F1") {
    help = !help;
  } else if (e.key == "F2") {
    figures = !figures;
  } else if (e.key == "Escape") {
    quit = true;
  } else {
    return false;
  }
  return true;
}

}  // namespace relievo
