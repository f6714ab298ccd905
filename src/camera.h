// camera.h - an orbit camera around a point on the artwork, and the transforms that follow from it, in double precision.
// World: x right, y up, z towards the viewer, mm, origin at the artwork's centre on the plane of height 0.
// Azimuth turns the eye to the right, elevation lifts it; at 0, 0 the eye looks straight at the artwork (along -z).
#pragma once

#include <string>

#include <glm/glm.hpp>

#include "src/base/planar_domain.h"
#include "src/base/result.h"

namespace relievo {

struct OrbitCamera {
  double azimuth_deg = 0, elevation_deg = 0;  // elevation within -89..89
  double distance_mm = 1000;                  // from the target to the eye
  double fov_deg = 35;                        // vertical
  glm::dvec3 target_mm{0};
};

struct ViewTransform {
  glm::dmat4 clip_from_world{1.0};  // GL clip space, -w <= z <= w
  glm::dvec3 eye_mm{0};
  double near_mm = 1, far_mm = 1000;
  double pixels_per_radian = 1000;  // viewport height / (2 tan(fov / 2))
};

glm::dvec3 eyePosition(const OrbitCamera& camera);
// min_z_mm, max_z_mm: the (exaggerated) heights of the artwork; near and far are chosen around it.
ViewTransform viewTransform(const OrbitCamera& camera, const PlanarDomain& domain, double min_z_mm, double max_z_mm,
                            int width_px, int height_px);
// The smallest distance from which all of the artwork's plane is in view in the camera's direction, with a little margin, mm.
double fitDistance(const OrbitCamera& camera, const PlanarDomain& domain, int width_px, int height_px);
// Looks straight at the artwork from where all of it is in view.
OrbitCamera fitCamera(const PlanarDomain& domain, int width_px, int height_px, double fov_deg = 35);

// The point of the plane z = 0 under a pixel (origin top left); false when the ray misses it.
bool pointOnPlane(const OrbitCamera& camera, int width_px, int height_px, double x_px, double y_px, glm::dvec3* point_mm);

}  // namespace relievo
