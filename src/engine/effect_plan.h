// effect_plan.h - a scene states its light, mode and effects; the plan derived from it names the planes that are
// streamed, the passes that run and the shader variant that is linked. What no effect needs is not read, decoded,
// uploaded, bound or computed.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "src/engine/effects/pixel_effect.h"
#include "src/gl/program.h"
#include "texturing/codec/page_id.h"
#include "texturing/package/package.h"

namespace relievo {

// kExact: bilinear weights in full float precision (four fetches a plane). kFast: the texture unit's own filter, whose
// weights have 8 bits on most hardware; the error it costs is measured in the README.
enum class Filter { kExact, kFast };
// Texels of a level and levels. kNearest: the nearest texel of the nearest level. kBilinear: four texels of it.
// kTrilinear: four texels of two levels, blended. kAnisotropic: up to Scene::anisotropy such taps along the major axis
// of the pixel's footprint, from levels that follow the minor one (shaders/texture_lookup.glsl).
enum class Sampling { kNearest, kBilinear, kTrilinear, kAnisotropic };
inline constexpr int kMaxAnisotropy = 8;

struct Scene {
  // Towards the light; x right, y up, z to the viewer; normalised on use. Of flat artworks seen from the front. Over a
  // base mesh it turns with the camera while it is relit, and stays with the artwork where it is fixed.
  std::array<double, 3> light{0, 0, 1};
  bool relief = true;  // displaced geometry, where the package has relief
  // Colour as it is, without a light. Of images with relief and of scans; a PTM has no colour without a light
  // (sceneProblem).
  bool unlit = false;
  bool relight = true;  // false: the light is fixed and resolved once per page
  Sampling sampling = Sampling::kTrilinear;
  int anisotropy = kMaxAnisotropy;  // taps at most, 1 .. kMaxAnisotropy; read by kAnisotropic only
  Filter filter = Filter::kExact;
  double page_fade_s = 0;  // a new page blends in over this time; 0: at once
  double exaggerate = 1;   // heights times this
  double error_px = 1;     // geometric error allowed on screen
  bool geomorph = false;   // vertices slide to their places as levels change (geometry/lod/morph.h)
  // Of error_px: cells of triangles are no narrower on screen (half and a quarter of it at walls), which bounds a
  // frame's cost by the screen's size and leaves an error at steps and cracks (EngineStats::predicted_error_px). 0: the
  // error stays within about twice error_px.
  double least_cell = 2;
  double hysteresis = 0;  // of error_px: what a level stays beyond its need (LodView); pictures that settle know none
  bool wireframe = false;
  std::vector<EffectSetting> effects;    // of the shaded colour, each at most once
  const PixelEffect* overlay = nullptr;  // drawn over the picture
};

struct EffectPlan {
  Basis stored = Basis::kColour;      // of the artwork's planes
  Basis shade = Basis::kColour;       // what the fragment shader evaluates
  std::vector<Plane> texture_planes;  // streamed (or resolved), in the page table's order
  bool mesh = false;                  // over a base mesh
  bool relief = false;
  bool geomorph = false;
  bool relight = false;
  // Not 0: colour is lit by the normals of its relief, heights times this (texturing/stream/relief_normals.h). Those
  // are another plane that is uploaded.
  double normals_exaggerate = 0;
  bool resolve = false;  // coefficient pages are resolved to colour under a fixed light, on the workers
  Sampling sampling = Sampling::kTrilinear;
  int anisotropy = 1;
  bool fade = false, wireframe = false;
  Filter filter = Filter::kExact;
  std::vector<const PixelEffect*> tones;  // those of Scene::effects that change something, in the registry's order
  const PixelEffect* overlay = nullptr;

  bool lit() const { return relight || resolve; }  // does the light change the picture?
  // Of the planes that are uploaded, or resolved: the manifest's, or colour with the normals of its relief.
  TextureFormat format(const Manifest& manifest) const;
  gl::Defines defines() const;              // of every program
  std::vector<std::string> passes() const;  // names, in order
  // Feedback passes after which a still view has asked for every node that it reads: taps reach into other nodes.
  int feedbackPhases() const { return anisotropy > 1 ? 7 : 1; }
  std::vector<std::string> planesRead() const;  // names of the stored planes that are read
  // Does going from one to the other need other pages (not only another shader)?
  bool samePages(const EffectPlan& other) const;
  friend bool operator==(const EffectPlan&, const EffectPlan&) = default;
};

EffectPlan planEffects(const Scene& scene, const Manifest& manifest);
// Why the artwork cannot be shown as the scene asks; empty: it can.
std::string sceneProblem(const Scene& scene, const Manifest& manifest);
std::string planeName(Plane plane, Basis basis);
std::array<double, 3> normalizedLight(const std::array<double, 3>& light);

}  // namespace relievo
