// scan_shapes.h - shapes that artworks are scanned as, each with something that is hard for a base mesh: many pieces,
// folds, thin walls, holes, undercuts, open borders. finer: how many times as many cells a side, at least 1.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>

#include <glm/glm.hpp>

#include "tests/geometry/base_shapes.h"

namespace relievo {

// A body and eyes, buttons and teeth: of 24 pieces one has nine tenths of the area.
inline TriMesh figure(int finer) {
  TriMesh all = bustMesh(24 * finer);
  for (int k = 0; k < 23; ++k) {
    const double turn = 2 * std::numbers::pi * k / 23;
    all = together(all, ballMesh(6 * finer, 2.5), glm::vec3(90 * std::cos(turn), 90 * std::sin(turn), 10.0 * (k % 3)));
  }
  return all;
}
// A tube whose wall folds seven times around.
inline TriMesh foldedBody(int finer) {
  return gridMesh(120 * finer, 60 * finer, true, true, [](double u, double v) {
    const double a = 2 * std::numbers::pi * u, b = 2 * std::numbers::pi * v, r = 18 + 5 * std::cos(7 * b);
    return glm::dvec3((50 + r * std::cos(b)) * std::cos(a), (50 + r * std::cos(b)) * std::sin(a), r * std::sin(b));
  });
}
// Half a ball with an inside, 3 mm apart, joined at the rim.
inline TriMesh helmet(int finer) {
  return gridMesh(96 * finer, 72 * finer, true, false, [](double u, double v) {
    const double a = 2 * std::numbers::pi * u, r = v < 0.5 ? 50 : 47,
                 down = (v < 0.5 ? v : 1 - v) * 2 * 0.5 * std::numbers::pi;
    const double tilt = std::max(down, 0.03);
    return glm::dvec3(r * std::sin(tilt) * std::cos(a), r * std::sin(tilt) * std::sin(a), r * std::cos(tilt));
  });
}
inline TriMesh plateOfHoles(int finer) {
  return gridMesh(
      96 * finer, 96 * finer, false, false,
      [](double u, double v) { return glm::dvec3(200 * u, -200 * v, 4 * std::sin(9 * u) * std::cos(7 * v)); },
      [](double u, double v) {
        const double x = std::abs(std::fmod(4 * u, 1.0) - 0.5), y = std::abs(std::fmod(4 * v, 1.0) - 0.5);
        return std::max(x, y) < 0.16;
      });
}
inline TriMesh chain(int finer) {
  TriMesh all = torusMesh(48 * finer, 20 * finer, 30, 6);
  for (int k = 1; k < 4; ++k) {
    TriMesh link = torusMesh(48 * finer, 20 * finer, 30, 6);
    if (k % 2)
      for (glm::vec3& p : link.positions_mm) p = {p.x, -p.z, p.y};
    all = together(all, link, glm::vec3(44.0f * static_cast<float>(k), 0, 0));
  }
  return all;
}
// Turned, its wall 2 mm thick at the lip, the inside drawn, too.
inline TriMesh vase(int finer) {
  return gridMesh(96 * finer, 96 * finer, true, false, [](double u, double v) {
    const double a = 2 * std::numbers::pi * u, t = v < 0.5 ? 2 * v : 2 - 2 * v, height = 100 * t;
    const double wall = v < 0.5 ? 0.0 : 4 - 2 * t, r = 30 + 12 * std::sin(3 * t) - wall;
    return glm::dvec3(r * std::cos(a), r * std::sin(a), height + (v < 0.5 ? 0 : 4 * (1 - t)));
  });
}
// H, L and T raised by 8 mm on a plate of 160 x 80 mm; their sides lean outwards by 2 mm.
inline TriMesh undercutLetters(int finer) {
  static constexpr std::array<std::array<double, 4>, 7> kStrokes{{{20, 15, 20, 65},
                                                                  {50, 15, 50, 65},
                                                                  {20, 40, 50, 40},
                                                                  {75, 65, 75, 15},
                                                                  {75, 15, 98, 15},
                                                                  {115, 65, 149, 65},
                                                                  {132, 65, 132, 15}}};  // x, y to x, y
  constexpr double kHalfWidth = 6, kRounding = 1, kFlank = 1.5, kLean = 1, kBlend = 3, kHeight = 8;
  // Signed distance from the letters' outline, positive outside; rounded where strokes meet.
  auto outline = [](const glm::dvec2& p) {
    double sum = 0;
    for (const auto& s : kStrokes) {
      const glm::dvec2 from(s[0], s[1]), along(s[2] - s[0], s[3] - s[1]);
      const double t = std::clamp(glm::dot(p - from, along) / glm::dot(along, along), 0.0, 1.0);
      sum += std::exp((kHalfWidth - glm::length(p - from - t * along)) / kRounding);
    }
    return -kRounding * std::log(sum);
  };
  return gridMesh(120 * finer, 60 * finer, false, false, [=](double u, double v) {
    const glm::dvec2 p(160 * u, 80 * v);
    const double d = outline(p), step = 1e-4;
    glm::dvec2 outwards(outline({p.x + step, p.y}) - outline({p.x - step, p.y}),
                        outline({p.x, p.y + step}) - outline({p.x, p.y - step}));
    outwards /= std::max(glm::length(outwards), 1e-9);
    // Over the flank, from its top inside to its foot outside, the outline's distance runs backwards.
    const double inside = std::abs(d);
    double to = d;
    if (inside < kFlank) to = -kLean * d / kFlank;
    else if (inside < kFlank + kBlend)
      to = std::copysign((inside - kFlank) / kBlend * (kFlank + kBlend + kLean) - kLean, d);
    const glm::dvec2 at = p + (to - d) * outwards;
    return glm::dvec3(at, kHeight * std::clamp((kFlank - d) / (2 * kFlank), 0.0, 1.0));
  });
}
// A ball of 50 mm under waves of three lengths, the shortest 4 mm.
inline TriMesh bumpyBall(int finer) {
  return cubeMesh(40 * finer, [](const glm::dvec3& p) {
    const glm::dvec3 d =
        glm::normalize(glm::dvec3(std::tan(p.x * 0.7854), std::tan(p.y * 0.7854), std::tan(p.z * 0.7854)));
    auto waves = [&](double k) { return std::sin(k * d.x) * std::sin(k * d.y + 1) * std::sin(k * d.z + 2); };
    return (50 + 3 * waves(7) + 0.8 * waves(23) + 0.2 * waves(78)) * d;
  });
}
// What one shot of a scanner sees of a relief: a sheet whose border waves, with a step where the depth jumps.
inline TriMesh rangeMap(int finer) {
  return gridMesh(90 * finer, 90 * finer, false, false, [](double u, double v) {
    const double x = 2 * u - 1, y = 2 * v - 1;
    const double px = x * std::sqrt(1 - y * y / 2), py = y * std::sqrt(1 - x * x / 2), turn = std::atan2(py, px);
    const double out = 60 * (1 + 0.06 * std::sin(13 * turn) * (px * px + py * py));
    const double step = 6 / (1 + std::exp(40 * (px - 0.3 * std::sin(3 * py) - 0.2)));
    return glm::dvec3(out * px, out * py,
                      step + 5 * std::cos(2 * px + py) + 0.3 * std::sin(30 * px) * std::cos(27 * py));
  });
}
inline TriMesh bust(int finer) { return bustMesh(40 * finer); }

struct ScanShape {
  const char* name;
  TriMesh (*make)(int finer);
};
inline constexpr std::array<ScanShape, 10> kScanShapes{{{"figure", figure},
                                                        {"foldedBody", foldedBody},
                                                        {"helmet", helmet},
                                                        {"plateOfHoles", plateOfHoles},
                                                        {"chain", chain},
                                                        {"vase", vase},
                                                        {"undercutLetters", undercutLetters},
                                                        {"bumpyBall", bumpyBall},
                                                        {"rangeMap", rangeMap},
                                                        {"bust", bust}}};

}  // namespace relievo
