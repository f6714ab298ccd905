// relief_shading.h - the relief itself as a picture, in the place of the artwork's colour and light: its slope, its
// curvature or its depth, by a scale of colours. Those who read worn inscriptions and coins know these pictures:
//
//   slope      CloudCompare's "dip" (angle of the normal from the vertical); the slope of archaeology's Relief
//              Visualization Toolbox (Kokalj, Somrak 2019, Remote Sensing 11): flat is light, steep dark
//   curvature  GigaMesh's multi-scale integral invariants (Mara, Kroemker, Jakob, Breuckmann 2010, VAST), which
//              measure how a surface bends within a sphere of a stated radius; CloudCompare's mean curvature within
//              one; Radiance Scaling (Vergne, Pacanowski, Barla, Granier, Schlick 2010, I3D; in MeshLab) and
//              RTIViewer's enhancements weigh light by it, so that no number can be read from their pictures. Here as
//              in GigaMesh a colour is a number: ridges are light, valleys dark
//   depth      CloudCompare's and GigaMesh's distance from a plane along its normal: high is light, low dark
//
// Flat artworks are measured on their own heights, whatever Scene::exaggerate and Scene::relief show, against their
// plane, whose normal is z. The numbers are pages made of relief pages (texturing/stream/relief_normals.h, which states
// the formulas), with mip levels as the texture has, so no page of the texture is read. Where a picture is so small
// that a pixel holds several cells of the relief, it shows the slope and curvature of the coarser relief.
//
// Scans are measured against a direction `up` of their own space, z unless it is stated: it is the artwork's, not the
// camera's, so that a place has the same colour in every view. Slope is the angle of the stored normal from it; of the
// texture the normals alone are read. Depth is the drawn surface's height along it, from the scan's origin, as it is
// exaggerated; no texture is read at all. Curvature needs no direction. At a place p with the normal n let p_i and n_i
// be those of the pixels that show the surface around p, evenly within the radius r in the plane through p with the
// normal n. In that plane's coordinates the map from p_i to n_i is fitted by least squares, with a constant, and H is
// half its trace (scanCurvature()): the fit does not ask how the places are spread, as at the picture's border. Left
// out are pixels of the background, those outside of the picture, and those farther than 1.5 r, where another part of
// the surface stands before it. A radius below 1.5 pixels counts as that many. The normals alone are read.
//
// A value's place on the scale is t = (value - from) / (to - from), 0..1 (scaleOf()), and its colour lies between the
// two of kShadingStops colours next to it, linearly in sRGB. Grey is linear in sRGB. The colours are viridis (van der
// Walt, Smith 2015), whose lightness rises evenly, and for curvature, which has a middle, the cool-warm map of Moreland
// 2009 (Diverging Color Maps for Scientific Visualization).
//
// Pure; double precision; shadedColour() is the CPU reference of shaders/relief_shading.glsl.
#pragma once

#include <array>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <glm/glm.hpp>

#include "shaders/shading.h"
#include "src/render/camera.h"
#include "src/render/picture_target.h"
#include "texturing/package/package.h"
#include "texturing/stream/relief_normals.h"

namespace relievo {

inline constexpr size_t kShadingStops = RV_SHADING_STOPS;
inline constexpr double kMostFullCurvature = kMostCurvature;  // times the radius

struct ReliefShading {
  enum class Kind { kNone, kSlope, kCurvature, kDepth };
  enum class Map { kGrey, kColour };
  Kind kind = Kind::kNone;
  Map map = Map::kGrey;
  double full_deg = 60;             // slope: the end of the scale, up to 90 degrees
  std::optional<double> radius_mm;  // curvature: the scale that it is measured at; else a hundredth of the shorter
                                    // side, of a scan of the longest
  // Curvature: the ends of the scale, 1/mm; else kUsualCurvature / radius. At most kMostFullCurvature / radius counts.
  std::optional<double> full_per_mm;
  // Depth: the heights at the ends of the scale, mm; else the lowest and the highest that the artwork may have. The
  // first may be the higher one, which turns the scale around.
  std::optional<double> low_mm, high_mm;
  std::array<double, 3> up{0, 0, 1};  // of scans, any length above 0
  bool isOn() const { return kind != Kind::kNone; }
  friend bool operator==(const ReliefShading&, const ReliefShading&) = default;
};
inline constexpr double kUsualCurvature = 0.3;  // times the radius

std::string_view shadingName(ReliefShading::Kind kind);
// Why the artwork cannot be shown so; empty: it can.
std::string shadingProblem(const ReliefShading& shading, const Manifest& manifest);
// The radius of curvature of this artwork, mm.
double curvatureRadius(const ReliefShading& shading, const Manifest& manifest);
// What pages of a flat artwork hold.
ReliefSurface shadedSurface(const ReliefShading& shading, const Manifest& manifest);

// The same with numbers for all that its kind leaves to the artwork. Of a scan that takes a walk over its corners.
ReliefShading completed(ReliefShading shading, const Manifest& manifest);

// The scale: the value at its ends, and in what unit.
struct ShadingScale {
  double from = 0, to = 1;
  const char* unit = "";
  // Of t = k / (kShadingStops - 1); sRGB, 0..1.
  std::array<glm::dvec3, kShadingStops> colours{};
};
ShadingScale scaleOf(const ReliefShading& shading, const Manifest& manifest);
// The colour of a value, sRGB, 0..1.
glm::dvec3 shadedColour(const ShadingScale& scale, double value);
// "slope: 0 degrees is 255 255 255, ..." for people: the scale's ends and middle.
std::string shadingText(const ReliefShading& shading, const Manifest& manifest);

// The value of a scan's place: its normal of any length, where it is.
double scanSlope(const ReliefShading& shading, const glm::dvec3& normal);
double scanCurvature(const glm::dvec3& normal, const glm::dvec3& place_mm, std::span<const glm::dvec3> normals,
                     std::span<const glm::dvec3> places_mm);
double scanDepth(const ReliefShading& shading, const glm::dvec3& place_mm);

// Of relief_shading.glsl; shading is completed(). Places there count from eye_mm; eye_from_pixel: from a
// pixel's place and depth, 0..1, to mm from the eye. far_depth: where there is no surface.
std::vector<NamedUniform> shadingUniforms(const ReliefShading& shading, const Manifest& manifest,
                                          const glm::dvec3& eye_mm, const glm::dmat4& eye_from_pixel, double far_depth);

}  // namespace relievo
