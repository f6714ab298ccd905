#include "src/viewer/view_control.h"

#include <algorithm>
#include <cmath>
#include <iterator>

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

// The light that the mouse moves at first.
size_t firstHeld(const std::vector<SceneLight>& lights) {
  const SceneLight* far = firstFarLight(lights);
  return far ? static_cast<size_t>(far - lights.data()) : 0;
}

// A camera moved and scaled so that all of it is `scale` times as far from a point; its direction stays.
OrbitCamera scaledAbout(const OrbitCamera& camera, const glm::dvec3& point_mm, double scale) {
  OrbitCamera c = camera;
  c.target_mm = point_mm + (camera.target_mm - point_mm) * scale;
  c.distance_mm *= scale;
  return c;
}

// Between two cameras of the same direction: eye and target go along straight lines.
OrbitCamera between(const OrbitCamera& a, const OrbitCamera& b, double share) {
  OrbitCamera c = b;
  c.target_mm = a.target_mm + (b.target_mm - a.target_mm) * share;
  c.distance_mm = a.distance_mm + (b.distance_mm - a.distance_mm) * share;
  return c;
}

glm::dvec3 lineOfSight(const OrbitCamera& c) { return (c.target_mm - eyePosition(c)) / c.distance_mm; }

// The camera turned to these angles with the point fixed to it: it keeps its pixel.
OrbitCamera turnedAbout(const OrbitCamera& camera, const glm::dvec3& point_mm, double azimuth_deg,
                        double elevation_deg) {
  OrbitCamera c = camera;
  c.azimuth_deg = azimuth_deg;
  c.elevation_deg = elevation_deg;
  c.target_mm =
      point_mm + worldFromCamera(c) * (glm::transpose(worldFromCamera(camera)) * (camera.target_mm - point_mm));
  return c;
}

}  // namespace

ViewControl::ViewControl(const Extent& extent, const View& start, int width_px, int height_px, Surface surface)
    : extent_(extent),
      start_(start),
      view_(start),
      width_px_(std::max(1, width_px)),
      height_px_(std::max(1, height_px)),
      surface_(std::move(surface)) {
  const auto& l = start.light;
  const double length = std::hypot(l[0], l[1], l[2]);
  if (length > 0)
    start_.light = {l[0] / length, l[1] / length, l[2] / length};  // as it was asked for, behind the artwork or not
  const double fit_mm = fitCamera(extent, width_px_, height_px_, start.camera.fov_deg).distance_mm;
  // From eight texels across the window's height to the artwork as a stamp.
  min_distance_mm_ = std::min(fit_mm, 8 * extent.texel_mm / (2 * std::tan(glm::radians(start.camera.fov_deg) / 2)));
  max_distance_mm_ = std::max(20 * fit_mm, start.camera.distance_mm);
  min_distance_mm_ = std::min(min_distance_mm_, start.camera.distance_mm);
  // Less than the least distance to the point that is looked at, so that a surface at a slant beside it does not keep
  // the eye away.
  clear_mm_ = 0.25 * min_distance_mm_;
  start_.held = firstHeld(start_.lights);
  view_ = start_;
  setGuard(surface_.guard);
}

bool ViewControl::setGuard(const EyeGuard* guard) {
  surface_.guard = guard;
  if (!guard) return false;
  const double before_mm = view_.camera.distance_mm;
  for (OrbitCamera* c : {&start_.camera, &view_.camera})
    if (!c->orthographic && !isOutside(*c)) placeOutside(*c);
  keepNearPlane();
  return view_.camera.distance_mm != before_mm;
}

void ViewControl::keepAngles(OrbitCamera& c) const {
  const double tilt =
      std::max({kMaxTiltDeg, std::abs(start_.camera.azimuth_deg), std::abs(start_.camera.elevation_deg)});
  if (extent_.flat) {
    c.azimuth_deg = std::clamp(c.azimuth_deg, -tilt, tilt);
    c.elevation_deg = std::clamp(c.elevation_deg, -std::min(tilt, 89.0), std::min(tilt, 89.0));
  } else {
    c.azimuth_deg = std::remainder(c.azimuth_deg, 360.0);
    c.elevation_deg = std::clamp(c.elevation_deg, -89.0, 89.0);
  }
}

// On the artwork, or no farther beside it than it was: zooming to a point near the border, and turning about one, may
// leave it there.
void ViewControl::keepTarget(OrbitCamera& c, const glm::dvec3& before_mm) const {
  const double z = c.target_mm.z;
  c.target_mm = glm::clamp(c.target_mm, glm::min(extent_.min_mm, before_mm), glm::max(extent_.max_mm, before_mm));
  if (extent_.flat) c.target_mm.z = z;
}

bool ViewControl::pointUnder(const OrbitCamera& c, double x, double y, double z_mm, glm::dvec3* point_mm) const {
  if (!extent_.flat) {
    *point_mm = pointAtTarget(c, width_px_, height_px_, x, y);
    return true;
  }
  OrbitCamera lowered = c;
  lowered.target_mm.z -= z_mm;
  if (!pointOnPlane(lowered, width_px_, height_px_, x, y, point_mm)) return false;
  point_mm->z += z_mm;
  return true;
}

void ViewControl::anchor(const glm::dvec3& point_mm) {
  OrbitCamera& c = view_.camera;
  const glm::dvec3 forward = lineOfSight(c);
  if (c.orthographic) {
    c.target_mm += forward * glm::dot(point_mm - c.target_mm, forward);
    return;
  }
  const glm::dvec3 eye = eyePosition(c);
  const double ahead_mm = glm::dot(point_mm - eye, forward);
  if (!(ahead_mm > 0) || !std::isfinite(ahead_mm)) return;
  c.distance_mm = ahead_mm;
  c.target_mm = eye + forward * ahead_mm;
}

bool ViewControl::wayIsFree(const OrbitCamera& from, const OrbitCamera& to) const {
  return !surface_.guard || to.orthographic ||
         surface_.guard->freeShare(eyePosition(from), eyePosition(to), clear_mm_) == 1;
}

bool ViewControl::isOutside(const OrbitCamera& c) const {
  const glm::dvec3 eye = eyePosition(c);
  return !surface_.guard || (surface_.guard->distance(eye) >= clear_mm_ && !surface_.guard->behind(eye));
}

// From afar towards where the eye is, until the surface is in the way.
void ViewControl::placeOutside(OrbitCamera& c) const {
  const double far_mm = c.distance_mm + 2 * glm::length(extent_.max_mm - extent_.min_mm) +
                        glm::length(c.target_mm - extent_.centre()) + clear_mm_;
  const glm::dvec3 back = -lineOfSight(c), from = c.target_mm + back * far_mm, eye = eyePosition(c);
  c.distance_mm = far_mm - (far_mm - c.distance_mm) * surface_.guard->freeShare(from, eye, clear_mm_);
}

// The near plane lies a thousandth of the distance to the target before the eye (camera.cpp), and nothing may come
// between.
void ViewControl::keepNearPlane() {
  OrbitCamera& c = view_.camera;
  if (!surface_.guard || c.orthographic) return;
  const double most_mm = 500 * surface_.guard->distance(eyePosition(c));
  if (most_mm > 0 && c.distance_mm > most_mm) anchor(eyePosition(c) + lineOfSight(c) * most_mm);
}

bool ViewControl::moveTo(const OrbitCamera& wanted) {
  OrbitCamera& c = view_.camera;
  const double share =
      surface_.guard && !c.orthographic ? surface_.guard->freeShare(eyePosition(c), eyePosition(wanted), clear_mm_) : 1;
  c = share == 1 ? wanted : between(c, wanted, share);
  keepNearPlane();
  return share == 1;
}

void ViewControl::beginDrag(Mode mode) {
  mode_ = mode;
  const auto seen = surface_.under && mode != Mode::kLight ? surface_.under(x_, y_) : std::nullopt;
  if (seen) anchor(*seen);
  pivot_mm_ = seen;
  if (mode != Mode::kPan) return;
  grabbed_ = seen || pointUnder(view_.camera, x_, y_, 0, &grabbed_mm_);
  if (seen) grabbed_mm_ = *seen;
}

// The camera that holds the grabbed point under the mouse.
OrbitCamera ViewControl::panned(const OrbitCamera& from, double x, double y) {
  OrbitCamera c = from;
  glm::dvec3 now_mm;
  // Near the horizon the plane runs away under the mouse: there, as outside it, pan by what a pixel is worth at the
  // target.
  const double largest_mm = 4 * c.distance_mm;
  if (grabbed_ && pointUnder(c, x, y, grabbed_mm_.z, &now_mm) && glm::length(now_mm - c.target_mm) < largest_mm &&
      glm::length(grabbed_mm_ - c.target_mm) < largest_mm) {
    c.target_mm += grabbed_mm_ - now_mm;
  } else {
    const double mm_per_px = mmPerPx(c, height_px_);
    const double azimuth = glm::radians(c.azimuth_deg);
    c.target_mm.x -= (x - x_) * mm_per_px * std::cos(azimuth);
    c.target_mm.y += (y - y_) * mm_per_px;
    grabbed_ = false;
  }
  keepTarget(c, from.target_mm);
  return c;
}

// How much farther away to go where the surface is in the way: first a little.
constexpr double kFarther[] = {1.01, 1.02, 1.04, 1.08, 1.16, 1.32, 1.64, 2.28, 3.56, 6.12};

void ViewControl::pan(double x, double y) {
  OrbitCamera& c = view_.camera;
  const OrbitCamera wanted = panned(c, x, y);
  if (!wayIsFree(c, wanted)) {
    for (double farther : kFarther) {
      const OrbitCamera away = scaledAbout(c, c.target_mm, farther), beside = panned(away, x, y);
      if (away.distance_mm > max_distance_mm_ || !wayIsFree(c, away)) break;
      if (!wayIsFree(away, beside)) continue;
      c = beside;
      keepNearPlane();
      return;
    }
  }
  moveTo(wanted);
}

void ViewControl::zoom(double steps) {
  OrbitCamera& c = view_.camera;
  // Over the background: towards the picture's middle.
  auto seen = surface_.under ? surface_.under(x_, y_) : std::nullopt;
  if (surface_.under && !seen) seen = surface_.under(0.5 * width_px_, 0.5 * height_px_);
  if (seen) anchor(*seen);
  glm::dvec3 fixed_mm = seen.value_or(c.target_mm);
  if (!surface_.under && !pointUnder(c, x_, y_, 0, &fixed_mm)) fixed_mm = c.target_mm;
  // Beyond its bounds already, the distance stays rather than go back.
  const double least_mm = std::min(min_distance_mm_, c.distance_mm),
               most_mm = std::max(max_distance_mm_, c.distance_mm);
  const double distance_mm = std::clamp(c.distance_mm * std::pow(kWheelFactor, steps), least_mm, most_mm);
  // Eye and target scale about the same point, so the ray through it stays.
  OrbitCamera wanted = scaledAbout(c, fixed_mm, distance_mm / c.distance_mm);
  if (!seen || steps < 0) keepTarget(wanted, c.target_mm);
  moveTo(wanted);
}

void ViewControl::turn(double azimuth_deg, double elevation_deg) {
  OrbitCamera& c = view_.camera;
  OrbitCamera wanted = c;
  wanted.azimuth_deg = azimuth_deg;
  wanted.elevation_deg = elevation_deg;
  keepAngles(wanted);
  if (!surface_.guard || c.orthographic) {
    c = turnedAbout(c, pivot_mm_.value_or(c.target_mm), wanted.azimuth_deg, wanted.elevation_deg);
    return;
  }
  // In steps, each so small that the arc is a straight line.
  constexpr double kStepDeg = 2;
  const double azimuth_way =
      extent_.flat ? wanted.azimuth_deg - c.azimuth_deg : std::remainder(wanted.azimuth_deg - c.azimuth_deg, 360.0);
  const double elevation_way = wanted.elevation_deg - c.elevation_deg;
  const double way = std::max(std::abs(azimuth_way), std::abs(elevation_way));
  if (!(way > 0) || !std::isfinite(way)) return;
  const int steps = static_cast<int>(std::ceil(way / kStepDeg));
  for (int i = 0; i < steps; ++i) {
    auto next = [&](const OrbitCamera& from) {
      OrbitCamera to = from;
      to.azimuth_deg += azimuth_way / steps;
      to.elevation_deg += elevation_way / steps;
      keepAngles(to);
      return turnedAbout(from, pivot_mm_.value_or(from.target_mm), to.azimuth_deg, to.elevation_deg);
    };
    OrbitCamera to = next(c);
    bool free = wayIsFree(c, to);
    for (size_t k = 0; k < std::size(kFarther) && !free; ++k) {
      const OrbitCamera away = scaledAbout(c, pivot_mm_.value_or(c.target_mm), kFarther[k]);
      if (away.distance_mm > max_distance_mm_ || !wayIsFree(c, away)) break;
      to = next(away);
      free = wayIsFree(away, to);
    }
    if (!free) break;
    c = to;
  }
  keepNearPlane();
}

void ViewControl::show(const OrbitCamera& camera, const std::vector<SceneLight>& lights) {
  view_.camera = camera;
  if (lights.size() != view_.lights.size()) view_.held = firstHeld(lights);
  view_.lights = lights;
  takeHeldDirection();
}

void ViewControl::takeHeldDirection() {
  const SceneLight* held = heldLight();
  if (!held || held->near) return;
  const auto& [x, y, z] = held->place;
  const double length = std::hypot(x, y, z);
  view_.light = {x / length, y / length, z / length};
}

void ViewControl::moveLight(double dx, double dy) {
  if (SceneLight* held = heldLight(); held && held->near) {
    const glm::dvec3 way = worldFromCamera(view_.camera) * glm::dvec3(dx, -dy, 0) * mmPerPx(view_.camera, height_px_);
    held->place = {held->place[0] + way.x, held->place[1] + way.y, held->place[2] + way.z};
    return;
  }
  const double radius_px = 0.5 * std::min(width_px_, height_px_);
  view_.light = lightAt(view_.light[0] + dx / radius_px, view_.light[1] - dy / radius_px);
  if (SceneLight* held = heldLight()) held->place = view_.light;
}

void ViewControl::drag(double x, double y) {
  const double dx = x - x_, dy = y - y_;
  switch (mode_) {
    case Mode::kNone:
      break;
    case Mode::kOrbit:
      turn(view_.camera.azimuth_deg - dx * 180 / height_px_, view_.camera.elevation_deg + dy * 180 / height_px_);
      break;
    case Mode::kPan:
      pan(x, y);
      break;
    case Mode::kLight:
      moveLight(dx, dy);
      break;
  }
}

bool ViewControl::handle(const gl::Event& e) {
  using gl::EventKind;
  switch (e.kind) {
    case EventKind::kMouseMove: {
      const bool moved = mode_ != Mode::kNone;
      if (moved) playing = false;
      drag(e.x, e.y);
      x_ = e.x;
      y_ = e.y;
      return moved;
    }
    case EventKind::kMouseDown:
      playing = false;
      x_ = e.x;
      y_ = e.y;
      if (e.button == gl::MouseButton::kRight) beginDrag(Mode::kLight);
      else if (e.button == gl::MouseButton::kMiddle || e.shift) beginDrag(Mode::kPan);
      else beginDrag(light_key_ ? Mode::kLight : Mode::kOrbit);
      return true;
    case EventKind::kMouseUp:
      mode_ = light_key_ ? Mode::kLight : Mode::kNone;
      return true;
    case EventKind::kScroll:
      playing = false;
      zoom(e.y);
      return true;
    case EventKind::kResize:
      width_px_ = std::max(1, static_cast<int>(e.x));
      height_px_ = std::max(1, static_cast<int>(e.y));
      return true;
    case EventKind::kClose:
      quit = true;
      return true;
    case EventKind::kKeyUp:
      if (e.key != "L") return false;
      light_key_ = false;
      if (mode_ == Mode::kLight) mode_ = Mode::kNone;
      return true;
    case EventKind::kKeyDown:
      break;
  }
  if (e.key == "L") {
    light_key_ = true;
    if (mode_ == Mode::kNone) mode_ = Mode::kLight;
  } else if (e.key == "W") {
    wireframe = !wireframe;
  } else if (e.key == "P") {
    show_pages = !show_pages;
  } else if (e.key == "A") {
    occlusion = !occlusion;
  } else if (e.key == "N") {
    if (!view_.lights.empty()) view_.held = (view_.held + 1) % view_.lights.size();
    takeHeldDirection();
  } else if (e.key == "M") {
    const auto now = std::find(shadings.begin(), shadings.end(), shading);
    const auto next = now == shadings.end() ? shadings.begin() : now + 1;
    shading = next == shadings.end() ? ReliefShading::Kind::kNone : *next;
  } else if (e.key == "H") {
    shadows = !shadows;
  } else if (e.key == "G") {
    gloss = !gloss;
  } else if (e.key == "Space") {
    playing = animated && !playing;
  } else if (e.key == "O") {
    playing = false;
    OrbitCamera& c = view_.camera;
    c.orthographic = !c.orthographic;
    // Orthographic views zoom in without moving an eye, which may be anywhere.
    if (!c.orthographic && !isOutside(c)) placeOutside(c);
    keepNearPlane();
    grabbed_ = grabbed_ && pointUnder(c, x_, y_, grabbed_mm_.z, &grabbed_mm_);
  } else if (e.key == "R") {
    playing = false;
    view_ = start_;
    keepNearPlane();
    grabbed_ = false;
    pivot_mm_.reset();
  } else if (e.key == "S") {
    snapshot_requested_ = true;
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
