// pixel_requests.h - what the pixels of a picture want of the texture, by rays in double precision: knows nothing of
// nodes, tiles or matrices but the view's. The oracle of page requests, on the CPU and by feedback.
#pragma once

#include <array>
#include <cmath>
#include <optional>
#include <set>

#include <glm/glm.hpp>

#include "geometry/lod/texture_select.h"
#include "tests/geometry/lod_fixture.h"

namespace relievo::test {

// orthographic: as high as the perspective picture is at the target.
inline TextureView textureView(const Camera& c, int height_px, bool relief, bool orthographic = false) {
  Camera sized = c;
  sized.viewport_height_px = height_px;
  LodView lod = orthographic ? orthographicView(sized, 2 * glm::length(c.eye - c.target) * std::tan(c.fov_y / 2), 1)
                             : makeView(sized);
  TextureView v;
  v.clip_from_world = lod.clip_from_world;
  v.eye_mm = lod.eye_mm;
  v.pixels_per_radian = lod.pixels_per_radian;
  v.near_mm = lod.near_mm;
  v.height_px = height_px;
  v.width_px = std::max(1, static_cast<int>(std::lround(height_px * c.aspect)));
  v.relief = relief;
  v.error_px = 0;
  return v;
}

// ---- a pixel's request
struct Footprint {
  glm::dvec2 texel{0};  // of the finest level, from the artwork's top left corner
  glm::dvec2 dx{0}, dy{0};
};

// By rays: from the eye through places of the screen, until they meet a plane.
class Rays {
 public:
  explicit Rays(const TextureView& v)
      : view_(v),
        world_from_clip_(glm::inverse(v.clip_from_world)),
        orthographic_(glm::length(glm::dvec3(glm::transpose(v.clip_from_world)[3])) == 0) {}
  // Of the line of sight there, of any length.
  glm::dvec3 direction(double x, double y) const { return at(x, y, 0.9) - from(x, y); }
  // x, y: px from the top left corner. The plane: (p - at) . normal = 0.
  std::optional<glm::dvec3> meet(double x, double y, const glm::dvec3& at, const glm::dvec3& normal) const {
    const glm::dvec3 way = direction(x, y), start = from(x, y);
    double along = glm::dot(way, normal);
    if (along == 0) return std::nullopt;
    double t = glm::dot(at - start, normal) / along;
    if (!(t > 0 || orthographic_) || !std::isfinite(t)) return std::nullopt;
    glm::dvec3 p = start + way * t;
    glm::dvec4 clip = view_.clip_from_world * glm::dvec4(p, 1);
    if (!(std::abs(clip.z) <= clip.w)) return std::nullopt;
    return p;
  }
  std::optional<Footprint> footprint(const FlatDomain& d, double x, double y, const glm::dvec3& at,
                                     const glm::dvec3& normal) const {
    constexpr double kStep = 1.0 / 1024;
    auto texel = [&](double sx, double sy) -> std::optional<glm::dvec2> {
      std::optional<glm::dvec3> p = meet(sx, sy, at, normal);
      if (!p) return std::nullopt;
      return glm::dvec2(p->x / d.mm_per_px + 0.5 * static_cast<double>(d.width_px),
                        0.5 * static_cast<double>(d.height_px) - p->y / d.mm_per_px);
    };
    auto centre = texel(x, y), right = texel(x + kStep, y), left = texel(x - kStep, y), down = texel(x, y + kStep),
         up = texel(x, y - kStep);
    if (!centre || !right || !left || !down || !up) return std::nullopt;
    return Footprint{*centre, (*right - *left) / (2 * kStep), (*down - *up) / (2 * kStep)};
  }

 private:
  glm::dvec3 at(double x, double y, double depth) const {
    const glm::dvec4 p =
        world_from_clip_ * glm::dvec4(2 * x / view_.width_px - 1, 1 - 2 * y / view_.height_px, depth, 1);
    return glm::dvec3(p) / p.w;
  }
  // Parallel ones are taken from amid the depths, both ways.
  glm::dvec3 from(double x, double y) const { return orthographic_ ? at(x, y, 0) : view_.eye_mm; }

  const TextureView& view_;
  glm::dmat4 world_from_clip_;
  bool orthographic_;
};

inline std::optional<NodeId> nodeAt(const FlatDomain& d, const glm::dvec2& texel, int level) {
  if (texel.x < 0 || texel.y < 0 || texel.x >= static_cast<double>(d.width_px) ||
      texel.y >= static_cast<double>(d.height_px))
    return std::nullopt;
  double side = static_cast<double>(d.patchPx());
  auto patch = static_cast<uint32_t>((d.alongX() ? texel.x : texel.y) / side);
  double cell = std::ldexp(side, -level);
  return NodeId{patch, static_cast<uint32_t>(level),
                static_cast<uint32_t>((texel.x - static_cast<double>(d.patchOriginX(patch))) / cell),
                static_cast<uint32_t>((texel.y - static_cast<double>(d.patchOriginY(patch))) / cell)};
}
inline int levelOf(const FlatDomain& d, const TextureView& v, const Footprint& f) {
  double major = std::sqrt(std::max(glm::dot(f.dx, f.dx), glm::dot(f.dy, f.dy)));
  if (v.anisotropy > 1) {
    double aa = glm::dot(f.dx, f.dx), bb = glm::dot(f.dy, f.dy), ab = glm::dot(f.dx, f.dy);
    double root = std::sqrt((aa - bb) * (aa - bb) + 4 * ab * ab);
    double longest = std::sqrt(0.5 * (aa + bb + root)),
           shortest = std::abs(f.dx.x * f.dy.y - f.dx.y * f.dy.x) / longest;
    major = std::max(shortest, longest / v.anisotropy);
  }
  double lod = std::clamp(std::log2(major) + v.lod_bias, 0.0, static_cast<double>(d.texture_depth));
  return d.texture_depth - static_cast<int>(std::floor(v.trilinear ? lod : lod + 0.5));
}
// From the pixel to the end of its footprint, or of as many steps as there are taps.
inline glm::dvec2 tapReach(const TextureView& v, const Footprint& f) {
  double angle = 0.5 * std::atan2(2 * glm::dot(f.dx, f.dy), glm::dot(f.dx, f.dx) - glm::dot(f.dy, f.dy));
  glm::dvec2 major = f.dx * std::cos(angle) + f.dy * std::sin(angle);
  double minor = std::abs(f.dx.x * f.dy.y - f.dx.y * f.dy.x) / glm::length(major);
  double step = std::max(1.0, std::max(minor, glm::length(major) / v.anisotropy) * std::exp2(v.lod_bias));
  return 0.5 * glm::normalize(major) * std::min(glm::length(major), step * v.anisotropy);
}
inline void addWithAncestors(NodeId node, std::set<NodeId>& out) {
  while (out.insert(node).second && node.level > 0) node = node.parent();
}

// What one pixel of a flat artwork wants: the node, and those that it may want instead, sampled up to kPixelSlack
// beside its centre and with levels off by kLodSlack, as a rasteriser and fp32 do.
struct PixelLevel {
  std::optional<NodeId> exact;
  std::vector<NodeId> alternatives;
  bool certain = true;
};
inline PixelLevel pixelLevel(const FlatDomain& d, const TextureView& v, const Rays& rays, int x, int y) {
  PixelLevel level;
  bool first = true;
  std::array<TextureView, 3> within_slack{v, v, v};
  within_slack[1].lod_bias -= kLodSlack;
  within_slack[2].lod_bias += kLodSlack;
  // The corners may lie off the artwork where places nearer to the centre do not.
  for (glm::dvec2 off : {glm::dvec2(0, 0), glm::dvec2(-1, -1), glm::dvec2(1, -1), glm::dvec2(-1, 1), glm::dvec2(1, 1),
                         glm::dvec2(-0.5, 0), glm::dvec2(0.5, 0), glm::dvec2(0, -0.5), glm::dvec2(0, 0.5)}) {
    auto f = rays.footprint(d, x + 0.5 + off.x * kPixelSlack, y + 0.5 + off.y * kPixelSlack, glm::dvec3(0),
                            glm::dvec3(0, 0, 1));
    std::optional<NodeId> last;
    for (const TextureView& shifted : within_slack) {
      std::optional<NodeId> node = f ? nodeAt(d, f->texel, levelOf(d, shifted, *f)) : std::nullopt;
      if (first) level.exact = node;
      first = false;
      if (node != level.exact) level.certain = false;
      if (node && node != last) level.alternatives.push_back(*node);
      last = node;
    }
  }
  return level;
}

}  // namespace relievo::test
