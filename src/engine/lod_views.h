// lod_views.h - a camera's view as the LOD evaluations of geometry/ take it. All other members keep their defaults.
#pragma once

#include "geometry/lod/lod.h"
#include "geometry/lod/texture_select.h"
#include "src/render/camera.h"

namespace relievo {

inline LodView lodViewFrom(const ViewTransform& view) {
  LodView v;
  v.clip_from_world = view.clip_from_world;
  v.eye_mm = view.eye_mm;
  v.pixels_per_radian = view.pixels_per_radian;
  v.near_mm = view.near_mm;
  return v;
}

inline TextureView textureViewFrom(const ViewTransform& view, int width_px, int height_px) {
  TextureView v;
  v.clip_from_world = view.clip_from_world;
  v.eye_mm = view.eye_mm;
  v.pixels_per_radian = view.pixels_per_radian;
  v.near_mm = view.near_mm;
  v.width_px = width_px;
  v.height_px = height_px;
  return v;
}

}  // namespace relievo
