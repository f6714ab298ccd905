// eye_guard.h - a lower bound of a place's distance from an artwork's displaced surface; it keeps the viewer's eye
// outside of that surface. For flat artworks the bound comes from the height ranges that relief pages state: within a
// page of the finest level the surface counts as high as its highest place. For bodies it comes from a grid of each
// patch and the package's bound of that grid's distance from the finest surface. So a place with a distance above 0
// lies outside, whatever is resident. Pure: no GL; const functions may be called from any thread. May read index
// blocks of a package, which keeps them.
#pragma once

#include <memory>
#include <vector>

#include <glm/glm.hpp>

#include "src/engine/engine.h"
#include "src/render/camera.h"

namespace relievo {

class EyeGuard {
 public:
  virtual ~EyeGuard() = default;
  // At most the distance to the finest displaced surface, mm. 0 or below: the place may lie on it, or behind it. Where
  // it is above 0 it never changes faster than the place moves.
  virtual double distance(const glm::dvec3& place_mm) const = 0;
  // Does the place see the surface from behind? Of places with a distance above 0.
  virtual bool behind(const glm::dvec3& place_mm) const = 0;

  // How much of the way from one place to another, 0 to 1, keeps a distance of at least clear_mm. The way from a place
  // that is too near already goes on for as long as it leads away.
  double freeShare(const glm::dvec3& from_mm, const glm::dvec3& to_mm, double clear_mm) const;
};

// Heights are multiplied by exaggerate; 0: without relief. Of a body it reads the tails of its patches or, where it has
// few, their root pages.
std::unique_ptr<const EyeGuard> makeEyeGuard(const Artwork& artwork, double exaggerate, int workers);
// The same for places in the world, of an artwork that stands there. Behind a flat one that is turned there is room
// again, from its lowest place on.
std::unique_ptr<const EyeGuard> placedGuard(std::unique_ptr<const EyeGuard> guard, const PlacedExtent& placed);

// Of several artworks: the nearest counts.
std::unique_ptr<const EyeGuard> guardOfAll(std::vector<std::unique_ptr<const EyeGuard>> guards);

}  // namespace relievo
