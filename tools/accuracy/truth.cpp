#include "tools/accuracy/truth.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <random>

#include "src/base/parallel_for.h"
#include "src/engine/lod_views.h"

namespace relievo {
namespace {

constexpr double kSolvedPx = 1.0 / 64, kExactPx = 1e-4;
constexpr double kTriangleReach = 1e-3;  // pixels: within a triangle of the surface, nearly always
constexpr int kSteps = 12;

}  // namespace

Result<std::unique_ptr<AccuracyTruth>> AccuracyTruth::create(const TruthOptions& o, gl::Api api) {
  auto truth = std::unique_ptr<AccuracyTruth>(new AccuracyTruth(o));
  auto scene = loadCompareScene(o.package, o.memory_bytes, api, &truth->pass_, o.interrupted);
  if (!scene) return scene.error();
  truth->scene_ = std::move(*scene);
  const StrategyScene& s = truth->scene_.strategy;
  truth->bounds_ = std::make_unique<ReliefBounds3d>(s);
  if (s.domain.isFlat()) truth->surface_ = std::make_unique<PlanarSurface>(*s.field, o.scene.exaggerate);
  else truth->surface_ = std::make_unique<BodySurface>(*s.body, o.scene.exaggerate);
  truth->texture_ = std::make_unique<TruthTexture>(o.package, planEffects(o.scene, o.package->manifest()),
                                                   o.scene.exaggerate, o.memory_bytes);
  truth->pass_->resize(o.width_px, o.height_px);
  return truth;
}

TexelFootprint AccuracyTruth::footprintOf(const PatchInstance& p, double u, double v,
                                          const glm::dmat2& uv_by_px) const {
  const PatchDomain& d = scene_.strategy.domain;
  const double size = std::ldexp(1.0, p.step_log2 + p.grid_level);
  const double texels_per_unit = static_cast<double>(d.patchPx()) * std::ldexp(1.0, -bounds_->unitLog2());
  TexelFootprint out;
  out.patch = p.node.patch;
  out.texel = glm::dvec2(p.x0 + u * size, p.y0 + v * size) * texels_per_unit;
  out.dx = uv_by_px[0] * (size * texels_per_unit);
  out.dy = uv_by_px[1] * (size * texels_per_unit);
  return out;
}

// About a place of an instance: differences over `reach` to each side of it, in the instance's units.
struct AccuracyTruth::Slope {
  glm::dvec3 point_mm{0}, du_mm{0}, dv_mm{0};
  glm::dvec2 px{0};
  glm::dmat2 uv_by_px{1.0};
  bool good = false;  // before the eye, and not seen edge-on
};

AccuracyTruth::Slope AccuracyTruth::slopeAt(const Frame& frame, const PatchInstance& instance, double u, double v,
                                            double reach) const {
  Slope out;
  bool good = true;
  auto pictureOf = [&](const glm::dvec3& p) {
    bool in_front = false;
    const glm::dvec2 px = frame.pixelOf(p, &in_front);
    good = good && in_front;
    return px;
  };
  out.point_mm = surface_->finestPointMm(instance, u, v);
  const glm::dvec3 left = surface_->finestPointMm(instance, u - reach, v),
                   right = surface_->finestPointMm(instance, u + reach, v),
                   up = surface_->finestPointMm(instance, u, v - reach),
                   down = surface_->finestPointMm(instance, u, v + reach);
  out.px = pictureOf(out.point_mm);
  out.du_mm = (right - left) / (2 * reach);
  out.dv_mm = (down - up) / (2 * reach);
  const glm::dmat2 px_by_uv((pictureOf(right) - pictureOf(left)) / (2 * reach),
                            (pictureOf(down) - pictureOf(up)) / (2 * reach));
  const double size = glm::dot(px_by_uv[0], px_by_uv[0]) + glm::dot(px_by_uv[1], px_by_uv[1]);
  out.good = good && std::abs(glm::determinant(px_by_uv)) > 1e-12 * size;
  if (out.good) out.uv_by_px = glm::inverse(px_by_uv);
  return out;
}

// Newton's method with differences over a pixel, which cross the surface's folds.
AccuracyTruth::Place AccuracyTruth::solve(const Frame& frame, const PatchInstance& instance,
                                          const std::array<uint32_t, 4>& drawn, int x, int y) const {
  Place out;
  out.there = true;
  double u = std::bit_cast<float>(drawn[0]), v = std::bit_cast<float>(drawn[1]);
  const double pixel = std::bit_cast<float>(drawn[3]);
  const double cell = std::ldexp(1.0, -instance.grid_level);
  if (!(pixel > 0) || pixel > kMostCellsAPixel * cell || !std::isfinite(u + v)) return out;
  for (int step = 0; step < kSteps; ++step) {
    const Slope wide = slopeAt(frame, instance, u, v, 0.5 * pixel);
    if (!wide.good) return out;
    const glm::dvec2 off = glm::dvec2(x + 0.5, y + 0.5) - wide.px;
    const double length = glm::length(off);
    if (length <= kExactPx || (step + 1 == kSteps && length <= kSolvedPx)) {
      const Slope exact = slopeAt(frame, instance, u, v, kTriangleReach * pixel);
      if (!exact.good) return out;
      out.solved = true;
      out.point_mm = wide.point_mm;
      // Rows of pixels count upwards here and downwards in a picture; a footprint has no sense of direction.
      out.footprint = footprintOf(instance, u, v, exact.uv_by_px);
      // From the front u runs to the right and v downwards.
      out.from_behind = !scene_.strategy.domain.isFlat() && glm::determinant(exact.uv_by_px) > 0;
      out.dx_mm = wide.du_mm * wide.uv_by_px[0].x + wide.dv_mm * wide.uv_by_px[0].y;
      out.dy_mm = wide.du_mm * wide.uv_by_px[1].x + wide.dv_mm * wide.uv_by_px[1].y;
      return out;
    }
    // Half a step where the last ones went to and fro.
    glm::dvec2 move = wide.uv_by_px * off * (step < kSteps / 2 ? 1.0 : 0.5);
    const double most = 4 * pixel, moved = std::max(std::abs(move.x), std::abs(move.y));
    if (moved > most) move *= most / moved;
    u += move.x;
    v += move.y;
  }
  return out;
}

// Does a neighbour show something else than the surface's way on from here?
bool AccuracyTruth::atEdge(const std::vector<Place>& places, int x, int y) const {
  const Place& p = places[static_cast<size_t>(y * o_.width_px + x)];
  const double reach = 1.5 * std::max(glm::length(p.dx_mm), glm::length(p.dy_mm));
  for (const auto& [i, j] : {std::pair{-1, 0}, {1, 0}, {0, -1}, {0, 1}}) {
    if (x + i < 0 || y + j < 0 || x + i >= o_.width_px || y + j >= o_.height_px) continue;
    const Place& q = places[static_cast<size_t>((y + j) * o_.width_px + x + i)];
    if (!q.there || !q.solved) return true;
    if (glm::length(q.point_mm - p.point_mm - static_cast<double>(i) * p.dx_mm - static_cast<double>(j) * p.dy_mm) >
        reach)
      return true;
  }
  return false;
}

void AccuracyTruth::chooseAndShade(const std::vector<Place>& places, const ViewTransform& view, ViewTruth& out) const {
  std::mt19937 random(o_.seed);
  const int step = o_.one_of;
  for (int y0 = 0; y0 < o_.height_px; y0 += step)
    for (int x0 = 0; x0 < o_.width_px; x0 += step) {
      const int x = x0 + static_cast<int>(random() % static_cast<uint32_t>(step)),
                y = y0 + static_cast<int>(random() % static_cast<uint32_t>(step));
      if (x >= o_.width_px || y >= o_.height_px) continue;
      const size_t at = static_cast<size_t>(y * o_.width_px + x);
      if (places[at].solved && !atEdge(places, x, y)) out.pixels.push_back(static_cast<uint32_t>(at));
    }
  out.colours.resize(out.pixels.size());
  glm::dvec3 light = glm::normalize(glm::dvec3(o_.scene.light[0], o_.scene.light[1], o_.scene.light[2]));
  if (!scene_.strategy.domain.isFlat()) light = view.world_from_camera * light;
  constexpr size_t kBlock = 1024;
  parallelFor((out.pixels.size() + kBlock - 1) / kBlock, o_.workers, o_.interrupted, [&](size_t block) {
    std::vector<double> channels(static_cast<size_t>(texture_->format().channels()));
    for (size_t i = block * kBlock; i < std::min(out.pixels.size(), (block + 1) * kBlock); ++i) {
      const Place& place = places[out.pixels[i]];
      texture_->filter(place.footprint, channels);
      if (place.from_behind && texture_->format().basis == Basis::kAlbedoNormal)
        for (size_t c = 3; c < 6; ++c) channels[c] = 2 * shader::kNormalUnit - channels[c];
      const auto rgb = evaluatePixel(texture_->format(), channels.data(), {light.x, light.y, light.z});
      out.colours[i] = glm::vec3(rgb[0], rgb[1], rgb[2]);
    }
  });
}

Result<ViewTruth> AccuracyTruth::of(const OrbitCamera& camera) {
  ViewTruth out;
  const double exaggerate = o_.scene.exaggerate;
  out.view = viewTransform(camera, artworkExtent(o_.package->manifest(), exaggerate), o_.width_px, o_.height_px);
  const Frame frame{out.view, o_.width_px, o_.height_px};
  const ReferenceGrid grid =
      referenceGrid(*bounds_, ViewBounds(lodViewFrom(out.view)), exaggerate, o_.reference_triangles);
  out.whole = grid.whole;
  if (auto drawn = pass_->draw(grid.drawn, out.view, exaggerate); !drawn) return drawn.error();
  PlacePixels drawn;
  pass_->read(drawn);
  std::vector<Place> places(drawn.size());
  parallelFor(static_cast<size_t>(o_.height_px), o_.workers, o_.interrupted, [&](size_t row) {
    for (int x = 0; x < o_.width_px; ++x) {
      const size_t at = row * static_cast<size_t>(o_.width_px) + static_cast<size_t>(x);
      const uint32_t instance = drawn[at][2];
      if (instance == 0 || instance > grid.drawn.instances.size()) continue;
      places[at] = solve(frame, grid.drawn.instances[instance - 1], drawn[at], x, static_cast<int>(row));
    }
  });
  out.mm_per_px.assign(drawn.size(), 0);
  for (size_t at = 0; at < places.size(); ++at) {
    if (!places[at].there) continue;
    ++out.covered;
    out.unsolved += !places[at].solved;
    const double mm = out.view.orthographic ? 1 : glm::length(places[at].point_mm - out.view.eye_mm);
    out.mm_per_px[at] = static_cast<float>(mm / out.view.pixels_per_radian);
    const int x = static_cast<int>(at % static_cast<size_t>(o_.width_px)),
              y = static_cast<int>(at / static_cast<size_t>(o_.width_px));
    out.edges += places[at].solved && atEdge(places, x, y);
  }
  chooseAndShade(places, out.view, out);
  if (o_.interrupted && *o_.interrupted) return Error{ErrorKind::kInterrupted, "", "interrupted", "", {}};
  if (auto good = texture_->problem(); !good) return good.error();
  return out;
}

}  // namespace relievo
