// camera.h - an orbit camera around a point on the artwork, and the transforms that follow from it, in double
// precision. World: x right, y up, z towards the viewer, mm. Flat artworks: origin at the artwork's centre on the plane
// of height 0. Others: the base mesh's origin. Azimuth turns the eye to the right, elevation lifts it; at 0, 0 the eye
// looks along -z. Orthographic: all lines of sight are parallel, a millimetre is as many pixels everywhere. The picture
// is as high and wide as what perspective shows of the plane through the target, so that the target keeps its size when
// the projection changes, and the distance zooms in both. Functions that take a domain are for flat artworks and use
// the domain's extent. An artwork with a pose (pose.h) is seen through viewTransform() with that pose.
#pragma once

#include <span>
#include <string>

#include <glm/glm.hpp>

#include "src/artwork/base_mesh.h"
#include "src/artwork/patch_domain.h"
#include "src/base/result.h"
#include "src/render/pose.h"

namespace relievo {

struct OrbitCamera {
  double azimuth_deg = 0, elevation_deg = 0;  // elevation within -89..89
  double distance_mm = 1000;                  // from the target to the eye
  double fov_deg = 35;                        // vertical
  glm::dvec3 target_mm{0};
  bool orthographic = false;
  friend bool operator==(const OrbitCamera&, const OrbitCamera&) = default;
};
inline constexpr double kMinFovDeg = 1, kMaxFovDeg = 170;

// Millimetres a pixel on the plane through the target that faces the eye; orthographic: everywhere, across the lines of
// sight.
double mmPerPx(const OrbitCamera& camera, int height_px);
// The distance_mm at which mmPerPx() is mm_per_px.
double distanceForScale(const OrbitCamera& camera, double mm_per_px, int height_px);

// Where the artwork lies in space.
struct Extent {
  glm::dvec3 min_mm{0}, max_mm{0};  // a box around it
  double texel_mm = 1;
  bool flat = true;        // a plane of heights, seen from the front; else a body, seen from everywhere
  bool size_known = true;  // false: what is said in mm counts the artwork's pixels
  glm::dvec3 centre() const { return (min_mm + max_mm) / 2.0; }
};
Extent extentOf(const FlatDomain& domain, double min_z_mm = 0, double max_z_mm = 0);
Extent extentOf(const BaseMesh& base, double min_height_mm, double max_height_mm, double texel_mm);

// An artwork's extent, in its own space, and where it stands.
struct PlacedExtent {
  Extent extent;
  Pose pose;
};
// The box around all of them, in the world. It is flat where all are, and none is turned or lies before another.
Extent worldExtent(std::span<const PlacedExtent> placed);

struct ViewTransform {
  glm::dmat4 clip_from_world{1.0};  // GL clip space, -w <= z <= w
  glm::dvec3 eye_mm{0};
  double near_mm = 1, far_mm = 1000;  // from the eye; orthographic: from eye_mm, which is the target, so that near lies
                                      // behind it (below 0) mostly
  double pixels_per_radian = 1000;    // viewport height / (2 tan(fov / 2)); orthographic: pixels per mm
  glm::dmat3 world_from_camera{1.0};  // camera: x right, y up, z towards the viewer
  bool orthographic = false;
};

glm::dvec3 eyePosition(const OrbitCamera& camera);
glm::dmat3 worldFromCamera(const OrbitCamera& camera);  // camera axes: x right, y up, z towards the viewer
// Near and far are chosen around the extent (of the exaggerated heights: min_z_mm, max_z_mm).
ViewTransform viewTransform(const OrbitCamera& camera, const Extent& extent, int width_px, int height_px);
ViewTransform viewTransform(const OrbitCamera& camera, const FlatDomain& domain, double min_z_mm, double max_z_mm,
                            int width_px, int height_px);
// The view of an artwork that stands elsewhere, in the artwork's space: what is named world there is the artwork's own.
ViewTransform viewTransform(const OrbitCamera& camera, const PlacedExtent& placed, int width_px, int height_px);
// The same view, its pixels seen through the places `offset_px` from their centres (x right, y down) in place of the
// centres. An offset of 0 changes no bit.
ViewTransform throughOffset(const ViewTransform& view, const glm::dvec2& offset_px, int width_px, int height_px);
// The smallest distance from which all of the extent is in view in the camera's direction and projection, mm: with a
// little margin; of a flat one its plane with the margin and its displaced box within it. The plane is that of height
// 0, or of the height nearest to it that there is.
double fitDistance(const OrbitCamera& camera, const Extent& extent, int width_px, int height_px);
double fitDistance(const OrbitCamera& camera, const FlatDomain& domain, int width_px, int height_px);
double fitDistance(const OrbitCamera& camera, std::span<const PlacedExtent> placed, int width_px, int height_px);
// Looks straight at the extent's centre (of a flat one: of its plane) from where all of it is in view.
OrbitCamera fitCamera(const Extent& extent, int width_px, int height_px, double fov_deg = 35);
OrbitCamera fitCamera(const FlatDomain& domain, int width_px, int height_px, double fov_deg = 35);
OrbitCamera fitCamera(std::span<const PlacedExtent> placed, int width_px, int height_px, double fov_deg = 35);
// How wide and high, in mm, the orthographic picture around the camera's target must be to hold all of the extent; no
// margin.
glm::dvec2 orthographicSize(const OrbitCamera& camera, std::span<const PlacedExtent> placed);
glm::dvec2 orthographicSize(const OrbitCamera& camera, const Extent& extent);

// The point under a pixel (origin top left) of the plane through the target that faces the eye.
glm::dvec3 pointAtTarget(const OrbitCamera& camera, int width_px, int height_px, double x_px, double y_px);
// The point of the plane z = 0 under a pixel (origin top left); false when the ray misses it.
bool pointOnPlane(const OrbitCamera& camera, int width_px, int height_px, double x_px, double y_px,
                  glm::dvec3* point_mm);

}  // namespace relievo
