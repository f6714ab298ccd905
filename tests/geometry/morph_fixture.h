// morph_fixture.h - what of a drawn list shows on the screen, place by place, and how it moves from picture to picture.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "geometry/lod/morph.h"
#include "tests/geometry/lod_fixture.h"

namespace relievo::test {

struct DrawnPoint {
  glm::dvec2 place{0};  // units
  glm::dvec3 at{0};     // mm
};
inline DrawnPoint operator+(const DrawnPoint& a, const DrawnPoint& b) { return {a.place + b.place, a.at + b.at}; }
inline DrawnPoint operator*(double k, const DrawnPoint& a) { return {k * a.place, k * a.at}; }

// The finest surface: grids of samples, one a patch.
struct TrueSurface {
  size_t patches = 1;
  int64_t columns = 0, rows = 0, spacing = 1;  // samples; units between them
  int64_t width = 0, height = 0;               // units: samples beyond lie on the border
  std::function<glm::dvec3(uint32_t patch, int64_t i, int64_t j)> truth;
  // A vertex of an instance's grid in its place.
  std::function<DrawnPoint(const PatchInstance&, uint32_t i, uint32_t j)> vertex;
  std::function<uint32_t(const PatchInstance&)> patchOf;
};

struct Screen {
  glm::dmat4 clip_from_world;
  double half_height_px, aspect, near_mm;
  bool orthographic;
  Screen(const LodView& view, const Camera& camera)
      : clip_from_world(view.clip_from_world),
        half_height_px(0.5 * camera.viewport_height_px),
        aspect(camera.aspect),
        near_mm(camera.near_mm),
        orthographic(glm::length(glm::dvec3(glm::transpose(view.clip_from_world)[3])) == 0) {}
  // -1: no picture, 0: beside it, 1: in it.
  int project(const glm::dvec3& at, glm::dvec2& px) const {
    glm::dvec4 p = clip_from_world * glm::dvec4(at, 1);
    if (!orthographic && p.w < near_mm) return -1;
    px = glm::dvec2(p.x * aspect, p.y) / p.w * half_height_px;
    return std::abs(p.x) <= p.w && std::abs(p.y) <= p.w ? 1 : 0;
  }
};

constexpr int64_t kSampled = 3;  // every third finest sample either way: prime to all levels' steps

// By finest sample of a patch (rows of v): how far the picture of the drawn point lies from that of the finest
// surface's, px. Not a number: not drawn, or out of the picture.
using Offsets = std::vector<std::vector<glm::dvec2>>;
// flipped: of triangles turned over, where any is.
inline Offsets offsetsOf(const TrueSurface& surface, const LodView& view, const Camera& camera,
                         const std::vector<PatchInstance>& instances, uint64_t& flipped) {
  Offsets all(surface.patches);
  const double none = std::numeric_limits<double>::quiet_NaN();
  const Screen screen(view, camera);
  std::vector<DrawnPoint> grid;
  for (const PatchInstance& p : instances) {
    const uint32_t patch = surface.patchOf(p), size = 1u << p.grid_level;
    auto& of_patch = all[patch];
    if (of_patch.empty()) of_patch.assign(static_cast<size_t>(surface.columns * surface.rows), glm::dvec2(none));
    grid.clear();
    for (uint32_t j = 0; j <= size; ++j)
      for (uint32_t i = 0; i <= size; ++i)
        grid.push_back(drawnVertex(
            p, i, j, [&](uint32_t x, uint32_t y) { return surface.vertex(p, x, y); },
            [](const DrawnPoint& a, const DrawnPoint& b, const DrawnPoint& own, float w) {
              return b.place == own.place ? own : (0.5 - 0.5 * w) * (a + b) + double{w} * own;
            }));
    auto triangle = [&](const DrawnPoint& a, const DrawnPoint& b, const DrawnPoint& c) {
      const double area =
          (b.place.x - a.place.x) * (c.place.y - a.place.y) - (b.place.y - a.place.y) * (c.place.x - a.place.x);
      flipped += area < -1e-9;
      if (area < 1e-9) return;
      auto first = [&](double u, double v, double w) {
        const auto at =
            static_cast<int64_t>(std::ceil(std::min({u, v, w}) / static_cast<double>(surface.spacing) - 1e-9));
        return (at + kSampled - 1) / kSampled * kSampled;
      };
      auto last = [&](double u, double v, double w, int64_t count) {
        return std::min(count - 1, static_cast<int64_t>(
                                       std::ceil(std::max({u, v, w}) / static_cast<double>(surface.spacing) + 1e-9)));
      };
      for (int64_t j = first(a.place.y, b.place.y, c.place.y); j <= last(a.place.y, b.place.y, c.place.y, surface.rows);
           j += kSampled)
        for (int64_t i = first(a.place.x, b.place.x, c.place.x);
             i <= last(a.place.x, b.place.x, c.place.x, surface.columns); i += kSampled) {
          const auto x = static_cast<double>(std::min(i * surface.spacing, surface.width)),
                     y = static_cast<double>(std::min(j * surface.spacing, surface.height));
          const double wb =
              ((x - a.place.x) * (c.place.y - a.place.y) - (y - a.place.y) * (c.place.x - a.place.x)) / area;
          const double wc =
              ((b.place.x - a.place.x) * (y - a.place.y) - (b.place.y - a.place.y) * (x - a.place.x)) / area;
          if (wb < -1e-9 || wc < -1e-9 || wb + wc > 1 + 1e-9) continue;
          glm::dvec2 seen(0), truth(0);
          const int in_truth = screen.project(surface.truth(patch, i, j), truth);
          if (in_truth < 0) continue;
          const int in = screen.project(a.at + wb * (b.at - a.at) + wc * (c.at - a.at), seen);
          if (in >= 0 && (in || in_truth)) of_patch[static_cast<size_t>(j * surface.columns + i)] = seen - truth;
        }
    };
    for (uint32_t j = 0; j < size; ++j)
      for (uint32_t i = 0; i < size; ++i) {
        const DrawnPoint *top = &grid[j * (size + 1) + i], *bottom = top + size + 1;
        triangle(top[0], top[1], bottom[1]);
        triangle(top[0], bottom[1], bottom[0]);
      }
  }
  return all;
}
inline double largest(const Offsets& offsets) {
  double most = 0;
  for (const auto& patch : offsets)
    for (const glm::dvec2& o : patch) most = std::max(most, std::isnan(o.x) ? 0 : glm::length(o));
  return most;
}
// Of what moves relative to the finest surface from one picture to the next.
inline double largestMove(const Offsets& before, const Offsets& after) {
  double most = 0;
  for (size_t p = 0; p < before.size(); ++p)
    for (size_t k = 0; k < std::min(before[p].size(), after[p].size()); ++k) {
      const glm::dvec2 d = after[p][k] - before[p][k];
      if (!std::isnan(d.x)) most = std::max(most, glm::length(d));
    }
  return most;
}

// A path: its camera at 0 .. 1.
struct Path {
  std::string name;
  int steps;
  std::function<Camera(double)> at;
};
// The address sanitizer sees a share of the frames, as far apart as they are in the whole.
inline Path shareOf(const Path& path) {
  return {path.name, share(path.steps), [at = path.at, of_all = double(share(path.steps)) / path.steps](double t) {
            return at((kSanitized ? 0.8 : 0) + of_all * t);
          }};
}
enum class How { kMorph, kStill, kRounded };  // kRounded: weights rounded to all or nothing, a control
struct Pops {
  double largest_px = 0, error_px = 0, over_bound = 0;
  int frames = 0, above_half = 0;
  uint64_t cells = 0, flipped = 0;
};
inline Pops fly(const TrueSurface& surface, const Path& path, double error_px, double min_cell_px, How how,
                const std::function<LodResult(const LodView&)>& select) {
  Pops pops;
  Offsets before;
  for (int k = 0; k <= path.steps; ++k) {
    const Camera camera = path.at(double(k) / path.steps);
    LodView view = makeView(camera, error_px);
    view.min_cell_px = min_cell_px;
    view.morph = how != How::kStill;
    LodResult lod = select(view);
    if (how == How::kRounded)
      for (PatchInstance& p : lod.instances) {
        auto rounded = [](uint8_t& w) { w = w < 128 ? 0 : 255; };
        rounded(p.morph);
        for (auto& side : p.edge_morph) rounded(side[0]), rounded(side[1]);
      }
    Offsets now = offsetsOf(surface, view, camera, lod.instances, pops.flipped);
    const double error = largest(now);
    pops.error_px = std::max(pops.error_px, error);
    if (error > 1e-6) pops.over_bound = std::max(pops.over_bound, error / lod.max_error_px);
    if (k > 0) {
      const double move = largestMove(before, now);
      pops.largest_px = std::max(pops.largest_px, move);
      pops.above_half += move > 0.5;
      ++pops.frames;
    }
    for (const PatchInstance& p : lod.instances) pops.cells += uint64_t{1} << (2 * p.grid_level);
    before = std::move(now);
  }
  return pops;
}
inline std::string describe(const Pops& p) {
  char text[200];
  std::snprintf(text, sizeof text,
                "largest pop %.3f px (%d of %d frames above 0.5), error %.2f px, %.2f of the bound, %llu cells",
                p.largest_px, p.above_half, p.frames, p.error_px, p.over_bound,
                static_cast<unsigned long long>(p.cells));
  return text;
}

}  // namespace relievo::test
