// effect_plan.h - a scene states its light, mode and effects; the plan derived from it names the planes that are
// streamed, the passes that run and the shader variant that is linked. What no effect needs is not read, decoded,
// uploaded, bound or computed.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "src/engine/effects/ambient_occlusion.h"
#include "src/engine/effects/gloss.h"
#include "src/engine/effects/lights.h"
#include "src/engine/effects/pixel_effect.h"
#include "src/engine/effects/relief_shading.h"
#include "src/gl/program.h"
#include "src/render/camera.h"
#include "texturing/codec/page_id.h"
#include "texturing/package/package.h"

namespace relievo {

// kExact: bilinear weights in full float precision (four fetches a plane). kFast: the texture unit's own filter, whose
// weights have 8 bits on most hardware; tools/README.md states the error it costs.
enum class Filter { kExact, kFast };
// How many texels and levels a pixel samples. kNearest: the nearest texel of the nearest level. kBilinear: four texels
// of it. kTrilinear: four texels of two levels, blended. kAnisotropic: up to Scene::anisotropy such taps along the
// major axis of the pixel's footprint, from levels that follow the minor one (shaders/texture_lookup.glsl). kAuto:
// kAnisotropic over a base mesh with stretched patches, along which trilinear taps would blur; else kTrilinear.
enum class Sampling { kNearest, kBilinear, kTrilinear, kAnisotropic, kAuto };
inline constexpr int kUsualAnisotropy = 8, kMaxAnisotropy = 32;
inline constexpr double kMaxSceneDetailBias = 6;

struct Scene {
  // The direction towards the light: x right, y up, z to the viewer of a flat artwork's front; normalised on use. Over
  // a base mesh the light turns with the camera if `relight` is set, and is fixed in the world if not.
  std::array<double, 3> light{0, 0, 1};
  double light_size_deg = 0;  // its angular diameter, for shadows (effects/soft_shadows.h); 0: they are hard
  // In the place of that one white light: up to kMaxLights, near or far away (effects/lights.h). Those far away turn as
  // `light` does; near ones stay where they are. Empty: `light` alone.
  std::vector<SceneLight> lights;
  bool relief = true;  // displaced geometry, where the package has relief
  // The stored colour is shown, without a light. This needs an image or a scan: a PTM has no colour without a light
  // (sceneProblem).
  bool unlit = false;
  // False: the light is fixed. One white light far away is then resolved once per page; others are evaluated for each
  // pixel all the same.
  bool relight = true;
  // The relief casts shadows on itself, where it is displaced and lit, in each light. Over a PTM they are simulated
  // beside those that were measured.
  bool shadows = false;
  // Highlights under its lights, simulated beside the artwork's own (effects/gloss.h), where there is light and, over a
  // PTM, relief.
  Gloss gloss;
  // Places of the relief that see little of the sky are darker (effects/ambient_occlusion.h), where it is displaced.
  AmbientOcclusion ambient_occlusion;
  // The relief's slope, curvature or depth, in the place of colour and light (effects/relief_shading.h): there is no
  // light then, and `unlit` changes nothing.
  ReliefShading shading;
  Sampling sampling = Sampling::kTrilinear;
  // Taps at most, 1 .. kMaxAnisotropy. 0: kUsualAnisotropy, but all where kAuto takes them for stretched patches, which
  // are stretched from all sides. Read where a plan is anisotropic only.
  int anisotropy = 0;
  Filter filter = Filter::kExact;
  double page_fade_s = 0;  // a new page blends in over this time; 0: at once
  double exaggerate = 1;   // heights times this
  double error_px = 1;     // geometric error allowed on screen
  bool geomorph = false;   // vertices slide to their places as levels change (geometry/lod/morph.h)
  // Cells of triangles are at least this many times error_px wide on screen (half or a quarter of it at walls). That
  // bounds a frame's cost by the screen's size, and leaves an error at steps and cracks
  // (EngineStats::predicted_error_px). 0: no such limit; the error stays within about twice error_px.
  double least_cell = 2;
  double hysteresis = 0;  // LodView::hysteresis; Engine::settle() does without
  // Texture levels that are coarser than a pixel asks for, 0..kMaxSceneDetailBias, besides those that the cache's size
  // takes (EngineStats::detail_bias). Geometry stays as fine as it is.
  double detail_bias = 0;
  bool wireframe = false;
  // A still picture is the average of so many, each seen through another place of its pixels: 1 (the centre), 4 or 8
  // (samplePattern() of src/render/sample_stack.h), other numbers as the next smaller one of these. Engine::settle()
  // draws all of them, Engine::refine() one more; Engine::frame() one alone.
  int samples = 1;
  std::vector<EffectSetting> effects;    // applied to the shaded colour; each at most once
  const PixelEffect* overlay = nullptr;  // drawn over the picture
  // Where the artwork stands; camera and lights are in the world. `shading` stays in the artwork's own space.
  Pose pose;
  friend bool operator==(const Scene&, const Scene&) = default;
};

struct EffectPlan {
  Basis stored = Basis::kColour;      // the basis of the artwork's planes
  Basis shade = Basis::kColour;       // what the fragment shader evaluates
  std::vector<Plane> texture_planes;  // streamed (or resolved), in the page table's order
  bool mesh = false;                  // over a base mesh
  bool relief = false;
  bool geomorph = false;
  bool relight = false;
  // How many lights are evaluated for each pixel, and how many of these are near; 0: one white light far away.
  int lights = 0, near_lights = 0;
  // If not 0, colour is lit by the normals of its relief, with heights times this (texturing/stream/relief_normals.h).
  // The normals are one more plane that is uploaded.
  double normals_exaggerate = 0;
  // Of a flat artwork its pages are made of the relief, and are the only ones of a texture plane (kNormalPlane); of a
  // scan kSlope and kCurvature take the stored normals alone, and kDepth no page.
  ReliefShading::Kind shading = ReliefShading::Kind::kNone;
  double curvature_radius_mm = 0;  // of kCurvature, of a flat artwork
  bool resolve = false;            // coefficient pages are resolved to colour under a fixed light, on the workers
  Sampling sampling = Sampling::kTrilinear;  // never kAuto
  int anisotropy = 1;
  bool fade = false, wireframe = false;
  // Shadows; does a light have a size, and a near one; is the share of sky computed?
  bool shadows = false, soft_shadows = false, soft_near = false, ambient_occlusion = false;
  bool gloss = false;  // each pixel's light is evaluated then, also where it is fixed
  int samples = 1;     // 1, 4 or 8; with 1 there is no pass that averages
  Filter filter = Filter::kExact;
  std::vector<const PixelEffect*> tones;  // the effects that change something, in the registry's order
  const PixelEffect* overlay = nullptr;

  bool casts() const { return shadows || ambient_occlusion; }  // the geometry is drawn as something else sees it, too
  bool madeOfRelief() const { return shading != ReliefShading::Kind::kNone && !mesh; }  // the one texture plane
  // The shading needs a copy of the surface's depth: each pixel's place.
  bool keepsDepth() const { return near_lights > 0 || gloss || drawsNormals() || placesAlone(); }
  // The light falls on either side of a scan's surface, whichever is seen by its triangles' orientation. (Not where it
  // is fixed and resolved once a page: there the front's colour shows from behind, too.)
  bool twoSided() const { return mesh && shade == Basis::kAlbedoNormal; }
  bool drawsNormals() const { return mesh && shading == ReliefShading::Kind::kCurvature; }  // before it shades
  bool placesAlone() const { return mesh && shading == ReliefShading::Kind::kDepth; }       // no page of a texture
  bool lit() const { return relight || resolve; }  // does the light change the picture?
  // The format of the planes that are uploaded or resolved: the manifest's, colour with the normals of its relief, or
  // one plane of three channels that is made of the relief.
  TextureFormat format(const Manifest& manifest) const;
  gl::Defines defines() const;                                   // for every program
  std::vector<std::string> passes() const;                       // names, in order
  bool readsTexture() const { return !texture_planes.empty(); }  // else there is no page to ask for
  // How many feedback passes over every pixel it takes until a still view has requested every node that it reads:
  // anisotropic taps reach into other nodes.
  int feedbackPhases() const { return anisotropy > 1 ? 7 : 1; }
  std::vector<std::string> planesRead() const;  // names of the stored planes that are read
  std::string nameOf(Plane plane) const;        // of a plane that is read or made
  // False: to change from one plan to the other needs other pages, not only another shader.
  bool samePages(const EffectPlan& other) const;
  friend bool operator==(const EffectPlan&, const EffectPlan&) = default;
};

EffectPlan planEffects(const Scene& scene, const Manifest& manifest);
// Why the artwork cannot be shown as the scene asks; empty: it can.
std::string sceneProblem(const Scene& scene, const Manifest& manifest);
// What is drawn of it, and where it stands.
PlacedExtent placedExtent(const Scene& scene, const Manifest& manifest);
std::string planeName(Plane plane, Basis basis);
// Towards the first light that is far away; Scene::light where `lights` has none.
std::array<double, 3> singleLight(const Scene& scene);
// The same in the artwork's space, for a light that stays as the camera moves.
std::array<double, 3> fixedLight(const Scene& scene);
double singleLightSize(const Scene& scene);  // of that one, degrees
std::array<double, 3> normalizedLight(const std::array<double, 3>& light);

}  // namespace relievo
