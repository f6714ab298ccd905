#include "src/flight_simulation.h"

#include <algorithm>
#include <cmath>

namespace relievo {
namespace {

ViewTransform viewOf(const FlightScene& scene, const OrbitCamera& camera) {
  double low = 0, high = 0;
  if (scene.relief) {
    low = scene.domain.relief_offset_mm;
    high = scene.domain.relief_offset_mm + 65535 * scene.domain.relief_scale_mm;
  }
  return viewTransform(camera, scene.domain, std::min(low, high), std::max(low, high), scene.width_px, scene.height_px);
}

}  // namespace

TextureView textureViewOf(const FlightScene& scene, const OrbitCamera& camera, double lod_bias) {
  ViewTransform view = viewOf(scene, camera);
  TextureView t;
  t.clip_from_world = view.clip_from_world;
  t.eye_mm = view.eye_mm;
  t.pixels_per_radian = view.pixels_per_radian;
  t.near_mm = view.near_mm;
  t.width_px = scene.width_px;
  t.height_px = scene.height_px;
  t.lod_bias = lod_bias;
  t.relief = false;
  return t;
}

LodView lodViewOf(const FlightScene& scene, const OrbitCamera& camera, double lod_bias) {
  ViewTransform view = viewOf(scene, camera);
  LodView v;
  v.clip_from_world = view.clip_from_world;
  v.eye_mm = view.eye_mm;
  v.pixels_per_radian = view.pixels_per_radian;
  v.near_mm = view.near_mm;
  v.error_px = scene.error_px * std::exp2(lod_bias);
  v.min_cell_px = 2 * v.error_px;
  v.relief = scene.relief;
  return v;
}

PageTrace recordFlight(const FlightScene& scene, const Flight& flight) {
  PageTrace trace;
  ReliefSet known;
  for (uint32_t p = 0; p < scene.domain.patchCount(); ++p) known.insert({p, 0, 0, 0});
  auto frames = static_cast<size_t>(std::floor(flight.duration_s() * scene.frames_per_s)) + 1;
  for (size_t f = 0; f < frames; ++f) {
    OrbitCamera camera = cameraAt(flight, static_cast<double>(f) / scene.frames_per_s);
    auto& pages = trace.emplace_back();
    for (const TextureWant& w : selectTextureNodes(scene.domain, *scene.oracle, textureViewOf(scene, camera)))
      for (Plane plane : scene.texture_planes) pages.emplace_back(plane, w.node);
    if (!scene.relief) continue;
    for (const ReliefWant& w : selectPlanarLod(scene.domain, *scene.oracle, lodViewOf(scene, camera), known).wants) {
      pages.emplace_back(Plane::kRelief, w.page);
      known.insert(w.page);
    }
    // Coarse before fine, over both kinds.
    std::stable_sort(pages.begin(), pages.end(), [](PageId a, PageId b) { return a.node().level < b.node().level; });
  }
  return trace;
}

}  // namespace relievo
