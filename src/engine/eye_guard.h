// eye_guard.h - how far a place is from an artwork's displaced surface, at least: what keeps a viewer's eye outside of
// it. Flat artworks: from the bounds of the heights that the relief's pages state, so that the surface counts for as
// high as the highest place of its finest page. Bodies: from a grid of each patch and the bound that the package states
// of its distance from the finest surface. So a place with a distance above 0 lies outside, whatever is resident; the
// true distance may be larger. Pure: no GL; const functions may be called from any thread. May read index blocks of a
// package (they are kept).
#pragma once

#include <memory>

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

}  // namespace relievo
