// lit_ball.h - a ball of one colour over a base mesh, its pages made when they are asked for, and what a picture of it
// must show: Lambert's law.
#pragma once

#include <cmath>
#include <functional>
#include <optional>

#include "src/engine/engine.h"
#include "tests/geometry/mesh_fixture.h"
#include "tests/render/made_pages.h"

namespace relievo::test {

inline constexpr int kWidth = 320, kHeight = 180;
inline constexpr double kRadius = 50, kReliefMm = 12;
inline constexpr std::array<double, 3> kAlbedo{200, 150, 100};

// The ball over chords of it: heights along the base's normals, normals by direction.
class BallPages final : public PageSource {
 public:
  explicit BallPages(std::shared_ptr<const BaseMesh> base) : base_(std::move(base)) {}
  Result<EncodedPage> read(PageId id) const override {
    const NodeId n = id.node();
    if (id.plane() == Plane::kRelief)
      return madeReliefPage(n, [&](double u, double v) {
        return static_cast<uint16_t>(std::lround(height(n.patch, u, v) / kReliefMm * 65535));
      });
    const double nodes = std::ldexp(1.0, static_cast<int>(n.level));
    std::vector<uint8_t> channels(kTexturePageBytes);
    constexpr size_t plane = size_t{kPageFullPx} * kPageFullPx;
    for (size_t j = 0; j < kPageFullPx; ++j) {
      for (size_t i = 0; i < kPageFullPx; ++i) {
        const double u = (n.x + (static_cast<double>(i) + 0.5 - kPageBorderPx) / kPagePx) / nodes,
                     v = (n.y + (static_cast<double>(j) + 0.5 - kPageBorderPx) / kPagePx) / nodes;
        const glm::dvec3 d =
            glm::normalize(base_->point(n.patch, u, v) + base_->normal(n.patch, u, v) * height(n.patch, u, v));
        for (size_t c = 0; c < 3; ++c)
          channels[c * plane + j * kPageFullPx + i] = static_cast<uint8_t>(
              std::lround(id.plane() == texturePlane(0) ? kAlbedo[c] : 127.5 * (d[static_cast<int>(c)] + 1)));
      }
    }
    return madeTexturePage(channels);
  }

 private:
  // |P + h N| = radius, h >= 0.
  double height(uint32_t patch, double u, double v) const {
    const glm::dvec3 p = base_->point(patch, u, v), n = base_->normal(patch, u, v);
    const double a = glm::dot(n, n), b = glm::dot(p, n), c = glm::dot(p, p) - kRadius * kRadius;
    return std::clamp((-b + std::sqrt(std::max(0.0, b * b - a * c))) / a, 0.0, kReliefMm);
  }
  std::shared_ptr<const BaseMesh> base_;
};

// The ball over a base mesh of chords.
inline Artwork ballArtwork(std::shared_ptr<const BaseMesh> base, int depth, uint64_t seed) {
  Artwork artwork;
  artwork.manifest = madeManifest(base, depth, depth, kReliefMm);
  artwork.source = std::make_shared<BallPages>(base);
  test::MeshRelief relief{depth, 0, kReliefMm / 65535};
  artwork.oracle = std::make_shared<test::MadeUpMeshOracle>(relief, seed, 0.05);
  return artwork;
}

// Of a pixel, past a ball around the origin.
struct BallRay {
  glm::dvec3 from, way;
  double along, aside, pixel_mm;  // to the ray's nearest place to the ball's middle; how far that is from it
  // For sure, with its neighbourhood.
  bool misses(double radius) const { return aside > radius + 2 * pixel_mm; }
  bool hits(double radius) const { return aside < radius - 4 * pixel_mm; }
  // end -1: where it enters; 1: where it leaves.
  glm::dvec3 place(double radius, int end) const {
    return from + (along + end * std::sqrt(radius * radius - aside * aside)) * way;
  }
};
// use(index of the pixel's first byte, ray).
inline void eachRay(const ViewTransform& view, const std::function<void(size_t, const BallRay&)>& use) {
  const glm::dmat4 world_from_clip = glm::inverse(view.clip_from_world);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      auto at = [&](double depth) {
        const glm::dvec4 p =
            world_from_clip * glm::dvec4((x + 0.5) / kWidth * 2 - 1, 1 - (y + 0.5) / kHeight * 2, depth, 1);
        return glm::dvec3(p) / p.w;
      };
      BallRay ray;
      ray.from = view.orthographic ? at(-1) : view.eye_mm;
      ray.way = glm::normalize(at(0.5) - ray.from);
      ray.along = -glm::dot(ray.from, ray.way);
      ray.aside = glm::length(ray.from + ray.along * ray.way);
      ray.pixel_mm = (view.orthographic ? 1 : ray.along) / view.pixels_per_radian;
      use(static_cast<size_t>(y * kWidth + x) * 4, ray);
    }
  }
}

struct BallDifference {
  uint64_t inside = 0, outside = 0, holes = 0, strays = 0;
  double largest = 0;  // of 255
};
// Pixels whose place and neighbourhood of a pixel are certain. expected: the colour, 0..255, where the ball's normal is
// this; nothing where it is not sure.
inline BallDifference compareWithBall(const std::vector<uint8_t>& pixels, const ViewTransform& view, double radius,
                                      const std::function<std::optional<glm::dvec3>(const glm::dvec3&)>& expected) {
  BallDifference d;
  eachRay(view, [&](size_t at, const BallRay& ray) {
    const uint8_t* p = &pixels[at];
    if (ray.misses(radius)) {
      ++d.outside;
      d.strays += p[3] != 0;
    } else if (ray.hits(radius)) {
      ++d.inside;
      d.holes += p[3] == 0;
      if (const auto colour = expected(glm::normalize(ray.place(radius, -1))))
        for (int c = 0; c < 3; ++c) d.largest = std::max(d.largest, std::abs(p[c] - (*colour)[c]));
    }
  });
  return d;
}

inline BallDifference compareWithBall(const std::vector<uint8_t>& pixels, const ViewTransform& view,
                                      const glm::dvec3& light, double radius) {
  return compareWithBall(pixels, view, radius, [&](const glm::dvec3& n) -> std::optional<glm::dvec3> {
    const double lit = std::max(glm::dot(n, light), 0.0);
    if (lit < 0.02) return std::nullopt;  // near the terminator a normal's last bit is many grey levels
    return glm::dvec3(kAlbedo[0], kAlbedo[1], kAlbedo[2]) * std::pow(0.04 + 0.96 * lit, 1 / 2.2);
  });
}

}  // namespace relievo::test
