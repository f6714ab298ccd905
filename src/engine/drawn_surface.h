// drawn_surface.h - what a surface buffer shows: equal values, equal pixels.
#pragma once

#include <cstdint>

#include <glm/glm.hpp>

namespace relievo {

struct DrawnSurface {
  uint64_t list_number = 0;  // differs whenever the patch list does
  glm::dmat4 clip_from_world{0.0};
  double exaggerate = 1;
  int width = 0, height = 0;  // px
  friend bool operator==(const DrawnSurface&, const DrawnSurface&) = default;
};

}  // namespace relievo
