#include "src/engine/effects/relief_shading.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>

namespace relievo {
namespace {

using Kind = ReliefShading::Kind;
using StopBytes = std::array<std::array<uint8_t, 3>, kShadingStops>;

constexpr StopBytes kViridis{{{68, 1, 84},
                              {71, 44, 122},
                              {59, 81, 139},
                              {44, 113, 142},
                              {33, 144, 141},
                              {39, 173, 129},
                              {92, 200, 99},
                              {170, 220, 50},
                              {253, 231, 37}}};
constexpr StopBytes kCoolWarm{{{59, 76, 192},
                               {98, 130, 234},
                               {141, 176, 254},
                               {184, 208, 249},
                               {221, 221, 221},
                               {245, 196, 173},
                               {244, 154, 123},
                               {222, 96, 77},
                               {180, 4, 38}}};

std::array<glm::dvec3, kShadingStops> coloursOf(const ReliefShading& shading) {
  std::array<glm::dvec3, kShadingStops> colours{};
  for (size_t k = 0; k < kShadingStops; ++k) {
    const double t = static_cast<double>(k) / (kShadingStops - 1);
    const StopBytes& map = shading.kind == Kind::kCurvature ? kCoolWarm : kViridis;
    if (shading.map == ReliefShading::Map::kColour) colours[k] = glm::dvec3(map[k][0], map[k][1], map[k][2]) / 255.0;
    else colours[k] = glm::dvec3(shading.kind == Kind::kSlope ? 1 - t : t);
  }
  return colours;
}

glm::dvec3 unitUp(const ReliefShading& shading) {
  const glm::dvec3 up(shading.up[0], shading.up[1], shading.up[2]);
  const double length = glm::length(up);
  return length > 0 && std::isfinite(length) ? up / length : glm::dvec3(0, 0, 1);
}

// Around a scan.
Extent scanBox(const Manifest& manifest) {
  const PatchDomain& d = manifest.domain;
  const double low = d.relief_depth < 0 ? 0 : d.relief_offset_mm, high = low + 65535 * d.relief_scale_mm;
  return extentOf(*manifest.base, std::min(low, high), std::max(low, high), d.mm_per_px);
}

// The lowest and highest that the artwork may be.
std::array<double, 2> heightsOf(const ReliefShading& shading, const Manifest& manifest) {
  if (manifest.domain.isFlat()) {
    const double low = manifest.domain.relief_offset_mm;
    return {low, low + 65535 * manifest.domain.relief_scale_mm};
  }
  const Extent box = scanBox(manifest);
  const glm::dvec3 up = unitUp(shading), middle = box.centre(), half = (box.max_mm - box.min_mm) / 2.0;
  const double reach = glm::dot(glm::abs(up), half);
  return {glm::dot(up, middle) - reach, glm::dot(up, middle) + reach};
}

}  // namespace

std::string_view shadingName(Kind kind) {
  static constexpr std::array<std::string_view, 4> kNames{"none", "slope", "curvature", "depth"};
  return kNames[static_cast<size_t>(kind)];
}

std::string shadingProblem(const ReliefShading& shading, const Manifest& manifest) {
  if (!shading.isOn()) return "";
  const std::string name(shadingName(shading.kind));
  if (manifest.domain.isFlat())
    return manifest.domain.relief_depth >= 0
               ? ""
               : "there is no " + name + " to show: the artwork has no relief (relievo build --relief gives it one)";
  if (shading.kind != Kind::kDepth && manifest.texture.basis != Basis::kAlbedoNormal)
    return "there is no " + name + " to show: " + std::string(describe(manifest.texture.basis).title) +
           " over a mesh comes without normals";
  return "";
}

double curvatureRadius(const ReliefShading& shading, const Manifest& manifest) {
  if (shading.radius_mm) return *shading.radius_mm;
  if (!manifest.domain.isFlat()) {
    const Extent box = scanBox(manifest);
    const glm::dvec3 size = box.max_mm - box.min_mm;
    return 0.01 * std::max({size.x, size.y, size.z});
  }
  const FlatDomain d = manifest.domain.flat();
  return 0.01 * d.mm_per_px * static_cast<double>(std::min(d.width_px, d.height_px));
}

ReliefSurface shadedSurface(const ReliefShading& shading, const Manifest& manifest) {
  ReliefSurface surface{.domain = manifest.domain.flat()};
  if (shading.kind == Kind::kSlope) surface.quantity = ReliefQuantity::kSlope;
  if (shading.kind == Kind::kDepth) surface.quantity = ReliefQuantity::kHeight;
  if (shading.kind != Kind::kCurvature) return surface;
  surface.quantity = ReliefQuantity::kCurvature;
  surface.radius_mm = curvatureRadius(shading, manifest);
  return surface;
}

ReliefShading completed(ReliefShading shading, const Manifest& manifest) {
  if (shading.kind == Kind::kCurvature) shading.radius_mm = curvatureRadius(shading, manifest);
  if (shading.kind == Kind::kDepth && !(shading.low_mm && shading.high_mm)) {
    const auto heights = heightsOf(shading, manifest);
    shading.low_mm = shading.low_mm.value_or(heights[0]);
    shading.high_mm = shading.high_mm.value_or(heights[1]);
  }
  return shading;
}

ShadingScale scaleOf(const ReliefShading& asked, const Manifest& manifest) {
  const ReliefShading shading = completed(asked, manifest);
  ShadingScale scale{.colours = coloursOf(shading)};
  if (shading.kind == Kind::kSlope) {
    scale.to = shading.full_deg;
    scale.unit = "degrees";
  } else if (shading.kind == Kind::kCurvature) {
    const double radius = *shading.radius_mm;
    scale.to = std::min(shading.full_per_mm.value_or(kUsualCurvature / radius), kMostFullCurvature / radius);
    scale.from = -scale.to;
    scale.unit = manifest.size_known ? "1/mm" : "1/px";
  } else {
    scale.from = *shading.low_mm;
    scale.to = *shading.high_mm;
    if (scale.to == scale.from) scale.to = scale.from + 1;  // a plane: any scale shows it
    scale.unit = manifest.size_known ? "mm" : "px";
  }
  return scale;
}

glm::dvec3 shadedColour(const ShadingScale& scale, double value) {
  const double t = std::clamp((value - scale.from) / (scale.to - scale.from), 0.0, 1.0), at = t * (kShadingStops - 1);
  const size_t stop = std::min(static_cast<size_t>(at), kShadingStops - 2);
  return glm::mix(scale.colours[stop], scale.colours[stop + 1], at - static_cast<double>(stop));
}

std::string shadingText(const ReliefShading& shading, const Manifest& manifest) {
  const ShadingScale scale = scaleOf(shading, manifest);
  std::string text(shadingName(shading.kind));
  char part[120];
  if (shading.kind == Kind::kCurvature) {
    std::snprintf(part, sizeof part, " within %.4g %s", curvatureRadius(shading, manifest),
                  manifest.size_known ? "mm" : "px");
    text += part;
  }
  for (const size_t k : {size_t{0}, (kShadingStops - 1) / 2, kShadingStops - 1}) {
    const double value = scale.from + (scale.to - scale.from) * static_cast<double>(k) / (kShadingStops - 1);
    const glm::dvec3 bytes = glm::round(255.0 * scale.colours[k]);
    std::snprintf(part, sizeof part, "%s %.4g %s is RGB %g %g %g", k == 0 ? ":" : ",", value, scale.unit, bytes.x,
                  bytes.y, bytes.z);
    text += part;
  }
  return text;
}

double scanSlope(const ReliefShading& shading, const glm::dvec3& normal) {
  const glm::dvec3 up = unitUp(shading);
  return std::atan2(glm::length(glm::cross(normal, up)), glm::dot(normal, up)) * 180 / std::numbers::pi;
}

double scanCurvature(const glm::dvec3& normal, const glm::dvec3& place_mm, std::span<const glm::dvec3> normals,
                     std::span<const glm::dvec3> places_mm) {
  const glm::dvec3 n = glm::normalize(normal);
  const glm::dvec3 side =
      glm::normalize(glm::cross(n, std::abs(n.x) < 0.7 ? glm::dvec3(1, 0, 0) : glm::dvec3(0, 1, 0)));
  const glm::dvec3 other = glm::cross(n, side);
  const auto flat = [&](const glm::dvec3& v) { return glm::dvec2(glm::dot(v, side), glm::dot(v, other)); };
  const double count = static_cast<double>(places_mm.size()) + 1;  // with the place itself
  glm::dvec2 turned_mean(0), moved_mean(0);
  for (size_t i = 0; i < places_mm.size(); ++i) {
    turned_mean += flat(glm::normalize(normals[i]) - n) / count;
    moved_mean += flat(places_mm[i] - place_mm) / count;
  }
  glm::dmat2 products = glm::outerProduct(-turned_mean, -moved_mean),
             squares = glm::outerProduct(moved_mean, moved_mean);
  for (size_t i = 0; i < places_mm.size(); ++i) {
    const glm::dvec2 turned = flat(glm::normalize(normals[i]) - n) - turned_mean,
                     moved = flat(places_mm[i] - place_mm) - moved_mean;
    products += glm::outerProduct(turned, moved);
    squares += glm::outerProduct(moved, moved);
  }
  const double trace = squares[0][0] + squares[1][1];
  if (glm::determinant(squares) <= 1e-4 * trace * trace) return 0;
  const glm::dmat2 gradient = products * glm::inverse(squares);
  return (gradient[0][0] + gradient[1][1]) / 2;
}

double scanDepth(const ReliefShading& shading, const glm::dvec3& place_mm) {
  return glm::dot(unitUp(shading), place_mm);
}

std::vector<NamedUniform> shadingUniforms(const ReliefShading& shading, const Manifest& manifest,
                                          const glm::dvec3& eye_mm, const glm::dmat4& eye_from_pixel,
                                          double far_depth) {
  const ShadingScale scale = scaleOf(shading, manifest);
  const bool flat = manifest.domain.isFlat(), curved = shading.kind == Kind::kCurvature;
  const double radius = curved ? *shading.radius_mm : 0;
  // What a page's number of 16 bits stands for: first + number * per_unit.
  double first = 0, per_unit = 1;
  if (flat) {
    const ReliefQuantity quantity = shadedSurface(shading, manifest).quantity;
    const auto valueOf = [&](double number) {
      if (shading.kind == Kind::kDepth)
        return manifest.domain.relief_offset_mm + manifest.domain.relief_scale_mm * number;
      return curved ? number / radius : number;
    };
    first = valueOf(reliefNumber(quantity, 0, 0));
    per_unit = (valueOf(reliefNumber(quantity, 255, 255)) - first) / 65535;
  }
  const double range = scale.to - scale.from;
  std::vector<NamedUniform> uniforms{
      {"u_shading", glm::vec4(per_unit / range, (first - scale.from) / range, far_depth, radius)}};
  for (size_t k = 0; k < kShadingStops; ++k)
    uniforms.push_back({"u_shading_colours[" + std::to_string(k) + "]", glm::vec4(scale.colours[k], 1)});
  if (flat) return uniforms;
  const glm::dvec3 up = unitUp(shading);
  uniforms.push_back({"u_shading_up", glm::vec4(glm::dvec4(up, glm::dot(up, eye_mm)))});
  if (curved) addColumns("u_pixel_from_eye", glm::inverse(eye_from_pixel), uniforms);
  return uniforms;
}

}  // namespace relievo
