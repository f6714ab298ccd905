#include <array>
#include <random>
#include <vector>

#include <glm/glm.hpp>
#include <glm/gtc/matrix_transform.hpp>

#include "geometry/lod/mesh_vertex.h"
#include "geometry/lod/patch_vertex.h"
#include "geometry/mesh/triangle_point.h"
#include "src/render/camera.h"
#include "src/render/depth.h"
#include "tools/stability/stability.h"

namespace relievo {
namespace {

constexpr int kWidthPx = 1280, kHeightPx = 720;

// The pixel of a place that is given in floats to a matrix of floats, as a GPU computes it.
glm::dvec2 pixelOf(const std::array<float, 16>& clip_from, const glm::vec3& at) {
  std::array<float, 4> clip;
  for (size_t r = 0; r < 4; ++r)
    clip[r] = clip_from[r] * at.x + clip_from[4 + r] * at.y + clip_from[8 + r] * at.z + clip_from[12 + r];
  return {(0.5 + 0.5 * double{clip[0]} / double{clip[3]}) * kWidthPx,
          (0.5 + 0.5 * double{clip[1]} / double{clip[3]}) * kHeightPx};
}

// A scan of 100 mm that lies 10 km from the origin of its coordinates, as those of surveys do.
StabilityErrors farFromTheOrigin() {
  const glm::dvec3 origin(1e7, -1e7, 1e7);
  OrbitCamera camera;
  camera.azimuth_deg = 37, camera.elevation_deg = 21, camera.distance_mm = 300, camera.target_mm = origin;
  Extent extent;
  extent.flat = false;
  extent.min_mm = origin - 50.0, extent.max_mm = origin + 50.0;
  const glm::dmat4 clip_from_world = viewTransform(camera, extent, kWidthPx, kHeightPx).clip_from_world;
  camera.target_mm = {};
  extent.min_mm = glm::dvec3(-50), extent.max_mm = glm::dvec3(50);
  const glm::dmat4 at_origin = viewTransform(camera, extent, kWidthPx, kHeightPx).clip_from_world;
  const std::array<float, 16> from_local = glClipFrom(clip_from_world, origin, {}),
                              from_world = glClipFrom(clip_from_world, {}, {});
  std::mt19937 random(1);
  std::uniform_real_distribution<float> place(-50, 50);
  StabilityErrors out;
  for (int k = 0; k < 1000; ++k) {
    const glm::vec3 local(place(random), place(random), place(random));
    const glm::dvec4 clip = at_origin * glm::dvec4(glm::dvec3(local), 1);
    const glm::dvec2 truth = glm::dvec2(kWidthPx, kHeightPx) * (0.5 + 0.5 * glm::dvec2(clip) / clip.w);
    out.add(glm::length(pixelOf(from_local, local) - truth),
            glm::length(pixelOf(from_world, glm::vec3(origin + glm::dvec3(local))) - truth));
  }
  return out;
}

float reversedDepth(const std::array<float, 16>& clip_from, float z) {
  return (clip_from[10] * z + clip_from[14]) / (clip_from[11] * z + clip_from[15]);
}
// How far behind another surface one must lie to be told from it, as a share of the distance.
template <class Depth>
double toldApartFrom(double distance_mm, const Depth& depth) {
  double share = 1e-9;
  while (share < 1 && !(depth(-distance_mm * (1 + share)) < depth(-distance_mm))) share *= 1.1;
  return share;
}

// A near plane at 1 mm and a far one at 10 km.
StabilityErrors depthOverTenKilometres() {
  constexpr double kNear = 1, kFar = 1e7;
  const glm::dmat4 clip = glm::perspective(0.8, 16.0 / 9, kNear, kFar);
  const auto reversed = glClipFrom(clip, {}, {.reversed = true, .clip_control = true});
  StabilityErrors out;
  for (double distance_mm = 2; distance_mm < 5e6; distance_mm *= 1.7) {
    const double told =
        toldApartFrom(distance_mm, [&](double z) { return reversedDepth(reversed, static_cast<float>(z)); });
    const double naive = toldApartFrom(distance_mm, [&](double z) {
      const double depth = 0.5 + 0.5 * (clip[2][2] * z + clip[3][2]) / (clip[2][3] * z);
      return -std::round(depth * 16777215);  // 24 bits, the nearer the smaller
    });
    out.add(1e6 * told, 1e6 * naive);
  }
  return out;
}

// Heights of 10 um on a panel that is 10 m wide, and so far from the eye.
StabilityErrors tenMicrometresOnTenMetres() {
  constexpr double kRange = 0.01, kEye = 10'000;
  std::vector<uint16_t> page(size_t{kReliefSamples} * kReliefSamples);
  std::mt19937 random(2);
  for (uint16_t& h : page) h = static_cast<uint16_t>(random());
  const auto offset = static_cast<float>(-kRange / 2), scale = static_cast<float>(kRange / 65535);
  StabilityErrors out;
  for (int32_t y = 0; y < 128; ++y)
    for (int32_t x = 0; x < 128; ++x) {
      const double truth = -kRange / 2 + kRange / 65535 * page[static_cast<size_t>(y * kReliefSamples + x)];
      const float h = static_cast<float>(sampleHeightQ8(page, x << 4, y << 4, 4)) / 256.0f;
      const float height_mm = offset + scale * h;
      const float from_eye = static_cast<float>(-kEye) + height_mm;  // then taken back from where it was added
      out.add(1e3 * (double{height_mm} - truth), 1e3 * (double{from_eye} + kEye - truth));
    }
  return out;
}

// The side of two patches that run along it in opposite directions.
StabilityErrors sharedSides() {
  std::mt19937 random(3);
  std::uniform_real_distribution<float> place(-3000, 3000), part(-1, 1);
  double measured = 0, naive = 0;
  for (int k = 0; k < 200; ++k) {
    std::array<EyeCorner, 6> corner;
    for (EyeCorner& c : corner)
      c = {{place(random), place(random), place(random)},
           glm::normalize(glm::vec3(part(random), part(random), 2 + part(random)))};
    // Patch a has the side 1-3 on its right, patch b the same corners on its left, upside down.
    const std::array<uint32_t, 4> a{0, 1, 2, 3}, b{3, 4, 1, 5};
    const auto of = [&](const std::array<uint32_t, 4>& index) {
      return std::array<EyeCorner, 4>{corner[index[0]], corner[index[1]], corner[index[2]], corner[index[3]]};
    };
    constexpr uint32_t kSide = 1024;
    for (uint32_t v = 1; v < kSide; v += 7) {
      const auto height_mm = static_cast<float>(0.01 * static_cast<double>(random() % 1000));
      for (const bool cut : {false, true})
        measured += meshVertexFromEye(a, of(a), kSide, v, kSide, height_mm, cut) !=
                    meshVertexFromEye(b, of(b), 0, kSide - v, kSide, height_mm, cut);
      const float t = static_cast<float>(v) / kSide;
      const auto along = [&](uint32_t from, uint32_t to, float at) {
        const glm::vec3 p = corner[from].from_eye_mm + at * (corner[to].from_eye_mm - corner[from].from_eye_mm);
        const glm::vec3 n = corner[from].normal + at * (corner[to].normal - corner[from].normal);
        return p + height_mm * n;
      };
      naive += along(1, 3, t) != along(3, 1, 1 - t);
    }
  }
  StabilityErrors out;
  out.add(measured, naive);
  return out;
}

// Needles: a millionth, then a thousand millionth as high as they are long, in any attitude, 100 m from the origin. The
// truth is where the place was lifted from.
StabilityErrors closestPointOfNeedles() {
  std::mt19937 random(4);
  std::uniform_real_distribution<double> part(-1, 1);
  StabilityErrors out;
  for (const double height : {1e-4, 1e-7})
    for (int k = 0; k < 500; ++k) {
      const glm::dvec3 x = glm::normalize(glm::dvec3(part(random), part(random), part(random) + 1.5)),
                       y = glm::normalize(glm::cross(x, glm::dvec3(0.3, part(random), 1.1))), z = glm::cross(x, y);
      const glm::dvec3 a(1e5 * part(random), 1e5, -1e5);
      const TriangleCorners needle{a, a + 100.0 * x, a + 50.0 * x + height * y};
      const double lift = 5 + part(random);
      const glm::dvec3 foot = a + (50 + 40 * part(random)) * x;  // on the long side
      const glm::dvec3 p = foot + lift * z;
      const glm::dvec3 ab = needle.b - a, ac = needle.c - a, ap = p - a;
      const double aa = glm::dot(ab, ab), am = glm::dot(ab, ac), mm = glm::dot(ac, ac);
      const double b1 = (mm * glm::dot(ab, ap) - am * glm::dot(ac, ap)) / (aa * mm - am * am);
      const double b2 = (aa * glm::dot(ac, ap) - am * glm::dot(ab, ap)) / (aa * mm - am * am);
      out.add(closestOnTriangle(needle, p).distance - lift,
              glm::length(ap - std::clamp(b1, 0.0, 1.0) * ab - std::clamp(b2, 0.0, 1.0) * ac) - lift);
    }
  return out;
}

// From a place to its pixel and back, with the narrowest and the widest lens, at right angles and grazing.
StabilityErrors pixelsAtBothEndsOfTheLens() {
  StabilityErrors out;
  FlatDomain d;
  d.width_px = d.height_px = 4096;
  d.texture_depth = FlatDomain::depthFor(4096, 4096);
  d.mm_per_px = 0.1;
  for (const double fov_deg : {kMinFovDeg, 35.0, kMaxFovDeg})
    for (const double elevation_deg : {0.0, 60.0, 89.0}) {
      OrbitCamera camera;
      camera.fov_deg = fov_deg, camera.elevation_deg = elevation_deg;
      camera.distance_mm = 200 / std::tan(0.5 * glm::radians(fov_deg));
      const glm::dmat4 clip = viewTransform(camera, d, -1, 1, kWidthPx, kHeightPx).clip_from_world;
      const glm::mat4 single(clip), back(glm::inverse(single));
      for (int k = 0; k < 100; ++k) {
        const glm::dvec2 pixel(kWidthPx * (0.3 + 0.004 * k), kHeightPx * (0.45 + 0.002 * k));
        glm::dvec3 place;
        if (!pointOnPlane(camera, kWidthPx, kHeightPx, pixel.x, pixel.y, &place)) continue;
        const glm::dvec4 c = clip * glm::dvec4(place, 1);
        const glm::dvec2 ndc = 2.0 * pixel / glm::dvec2(kWidthPx, kHeightPx) - 1.0;
        const glm::dvec2 again(kWidthPx * (0.5 + 0.5 * c.x / c.w), kHeightPx * (0.5 - 0.5 * c.y / c.w));
        const glm::vec4 near = back * glm::vec4(ndc.x, -ndc.y, -1, 1), far = back * glm::vec4(ndc.x, -ndc.y, 1, 1);
        const glm::vec3 from = glm::vec3(near) / near.w, to = glm::vec3(far) / far.w;
        const glm::vec3 met = from + from.z / (from.z - to.z) * (to - from);
        const glm::dvec4 m = clip * glm::dvec4(glm::dvec3(met), 1);
        const glm::dvec2 naive(kWidthPx * (0.5 + 0.5 * m.x / m.w), kHeightPx * (0.5 - 0.5 * m.y / m.w));
        out.add(glm::length(again - pixel), glm::length(naive - pixel));
      }
    }
  return out;
}

// Orthographic pictures from 10 nm to 1 m a pixel: the distance for a scale gives that scale.
StabilityErrors orthographicScales() {
  StabilityErrors out;
  for (double mm_per_px = 1e-5; mm_per_px < 2e3; mm_per_px *= 10)
    for (const double fov_deg : {kMinFovDeg, 35.0, kMaxFovDeg}) {
      OrbitCamera camera;
      camera.orthographic = true, camera.fov_deg = fov_deg;
      camera.distance_mm = distanceForScale(camera, mm_per_px, kHeightPx);
      const float half = std::tan(0.5f * glm::radians(static_cast<float>(fov_deg)));
      const float distance = static_cast<float>(mm_per_px * kHeightPx) / (2 * half);
      out.add(mmPerPx(camera, kHeightPx) / mm_per_px - 1,
              2 * static_cast<double>(distance) * std::tan(0.5 * glm::radians(fov_deg)) / kHeightPx / mm_per_px - 1);
    }
  return out;
}

constexpr StabilityCase kGeometryCases[] = {
    {"a scan of 100 mm that lies 10 km from its origin", "the pixel of the same scan at the origin",
     "coordinates of the file in floats", "px", 0.01, farFromTheOrigin},
    {"depth with the near plane at 1 mm and the far one at 10 km", "surfaces are told apart at every distance alike",
     "conventional depth of 24 bits", "millionths", 0.5, depthOverTenKilometres},
    {"relief of 10 um on a panel of 10 m", "height = offset + scale x sample", "heights added to places from the eye",
     "um", 1e-5, tenMicrometresOnTenMetres},
    {"sides that two patches run along in opposite directions", "the same bits from both",
     "start + t x (end - start) from either end", "vertices apart", 0.5, sharedSides},
    {"needles of 100 mm x 100 pm to 100 nm, 100 m from the origin", "the distance that a place was lifted by",
     "barycentric weights from dot products, clamped", "mm", 1e-6, closestPointOfNeedles},
    {"lenses of 1 and 170 degrees, at right angles to grazing", "a pixel's place on the plane shows at the pixel",
     "unprojecting with a matrix of floats", "px", 1e-5, pixelsAtBothEndsOfTheLens},
    {"orthographic pictures of 10 nm to 1 m a pixel", "the scale that was asked for", "the distance in floats", "of it",
     1e-12, orthographicScales},
};

}  // namespace

std::span<const StabilityCase> geometryStability() { return kGeometryCases; }

}  // namespace relievo
