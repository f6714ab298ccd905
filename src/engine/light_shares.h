// light_shares.h - which share of each light, and of the sky, reaches every pixel of the surface: kept
// while the surface and the lights are the same, and refined direction by direction where a light has a size
// (effects/soft_shadows.h) and of the sky (effects/ambient_occlusion.h).
//
// While things move a light counts as its middle, whose shadow is hard, and all of the sky is seen from everywhere: a
// few directions of it would show as so many shadows. A view that stands still gets the directions of the settled
// picture, some at a time; the sky shows from kLeastSky of them on. The settled picture does not depend on what was
// drawn before. Needs a current GL context.
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include <glm/glm.hpp>

#include "src/engine/drawn_surface.h"
#include "src/engine/shading_programs.h"
#include "src/render/shadow_pass.h"

namespace relievo {

inline constexpr int kLeastSky = 32;          // directions
inline constexpr int kDirectionsAtATime = 8;  // of each caster, for a view that stands still

struct CastingLight {
  bool near = false;
  glm::dvec3 place{0, 0, 1};  // towards it, of length 1; of a near one where it is, mm
  double size = 0;            // degrees; of a near one mm; 0: hard shadows
  glm::dvec3 axis{0, 0, 1};   // of a near one's disc
  friend bool operator==(const CastingLight&, const CastingLight&) = default;
};

class LightShares {
 public:
  explicit LightShares(const DepthMode& depth) : pass_(depth) {}

  struct Wanted {
    DrawnSurface surface;                 // which is in the surface buffer
    const ViewTransform* view = nullptr;  // through the pixels' centres, whichever sample is drawn: maps follow it
    const Extent* extent = nullptr;       // of the artwork as it is drawn
    std::vector<CastingLight> lights;
    bool sky = false;
  };
  enum class Directions { kFew, kMore, kAll };
  // What it draws with. draw_map: draws the geometry into the map that is bound.
  struct Drawing {
    const ShadingPrograms* programs = nullptr;
    const SurfaceTarget* surface = nullptr;
    const ScreenPass* screen = nullptr;
    std::function<void(const ShadowView&)> draw_map;
  };
  // Makes the shares those of `wanted`. kFew: what was refined stays, and nothing is added. Returns how many passes it
  // drew over the pixels.
  uint32_t update(const Wanted& wanted, Directions directions, const Drawing& drawing);
  void forget() { casters_.clear(); }  // the next update() draws all anew
  bool whole() const;                  // no direction is missing
  int directions() const;              // so far, of all casters together
  const ShadowPass& pass() const { return pass_; }

 private:
  struct Key {
    DrawnSurface surface;
    CastingLight light;  // of the sky, as it is
    friend bool operator==(const Key&, const Key&) = default;
  };
  struct Caster {
    std::optional<Key> share, map;  // what they were drawn for; the map of a hard shadow alone
    std::vector<glm::dvec3> all;    // directions, of a near light places, of the settled picture; empty: it is hard
    int in = 0;                     // so many of them; 0: those of a moving picture
  };
  uint32_t hardShadow(size_t caster, const Key& key, const Wanted& wanted, const Drawing& drawing);
  uint32_t nearShadow(size_t caster, const Key& key, const Wanted& wanted, const Drawing& drawing);
  uint32_t addPlaces(size_t caster, std::span<const glm::dvec3> places, bool first, const Wanted& wanted,
                     const Drawing& drawing);
  uint32_t addDirections(size_t caster, std::span<const glm::dvec3> directions, bool first, const Wanted& wanted,
                         const Drawing& drawing);

  ShadowPass pass_;
  std::vector<Caster> casters_;  // the lights, then the sky
  size_t lights_ = 0;
};

}  // namespace relievo
