#include "src/engine/effect_plan.h"

#include <algorithm>
#include <cmath>

#include "src/engine/artwork.h"
#include "src/render/picture_target.h"
#include "src/render/sample_stack.h"

namespace relievo {

namespace {

Sampling samplingOver(const BaseMesh* base, Sampling wanted) {
  if (wanted != Sampling::kAuto) return wanted;
  return base && isStretched(*base) ? Sampling::kAnisotropic : Sampling::kTrilinear;
}

}  // namespace

EffectPlan planEffects(const Scene& scene, const Manifest& manifest) {
  EffectPlan plan;
  plan.relief = scene.relief && manifest.domain.relief_depth >= 0 && scene.exaggerate != 0;
  plan.mesh = !manifest.domain.isFlat();
  if (shadingProblem(scene.shading, manifest).empty()) plan.shading = scene.shading.kind;
  const bool shaded = plan.shading != ReliefShading::Kind::kNone;
  if (plan.shading == ReliefShading::Kind::kCurvature && !plan.mesh)
    plan.curvature_radius_mm = curvatureRadius(scene.shading, manifest);
  if (!shaded && manifest.texture.basis == Basis::kColour && plan.relief && !plan.mesh && !scene.unlit)
    plan.normals_exaggerate = scene.exaggerate;
  plan.stored = manifest.texture.basis;
  const TextureFormat format = plan.format(manifest);
  const bool lit = !shaded && format.basis != Basis::kColour && !scene.unlit;
  if (lit) {
    const std::vector<SceneLight> lights = shadedLights(scene.lights);
    plan.lights = static_cast<int>(lights.size());
    plan.near_lights = nearCount(lights);
  }
  plan.gloss = scene.gloss.isOn() && lit && (plan.relief || format.basis == Basis::kAlbedoNormal);
  plan.relight = lit && (scene.relight || plan.lights > 0 || plan.gloss);
  plan.resolve = lit && !plan.relight;
  plan.shade = plan.relight ? format.basis : Basis::kColour;
  if (shaded) {
    if (!plan.placesAlone()) plan.texture_planes = {kNormalPlane};
  } else if (plan.resolve) {
    plan.texture_planes = {Plane::kResolved};
  } else {
    const int planes = lit ? format.planes() : TextureFormat{}.planes();  // unlit: the colour alone
    for (int k = 0; k < planes; ++k) plan.texture_planes.push_back(texturePlane(k));
  }
  plan.geomorph = scene.geomorph && (plan.mesh || plan.relief);
  // Without pages nothing is sampled: one variant serves all of these settings.
  plan.sampling = plan.readsTexture() ? samplingOver(manifest.base.get(), scene.sampling) : Sampling::kBilinear;
  if (plan.sampling == Sampling::kAnisotropic) {
    const int usual = scene.sampling == Sampling::kAuto ? kMaxAnisotropy : kUsualAnisotropy;
    plan.anisotropy = scene.anisotropy == 0 ? usual : std::clamp(scene.anisotropy, 1, kMaxAnisotropy);
  }
  plan.fade = scene.page_fade_s > 0 && plan.readsTexture();
  // The texture unit's weights of 8 bits are too coarse for numbers of 16.
  plan.filter = plan.madeOfRelief() || !plan.readsTexture() ? Filter::kExact : scene.filter;
  plan.wireframe = scene.wireframe;
  plan.samples = static_cast<int>(samplePattern(scene.samples).size());
  plan.shadows = scene.shadows && plan.relief && plan.lit();
  if (plan.shadows && plan.lights == 0) plan.soft_shadows = singleLightSize(scene) > 0;
  if (plan.shadows && plan.lights > 0)
    for (const SceneLight& light : shadedLights(scene.lights)) {
      plan.soft_shadows |= light.isSoft();
      plan.soft_near |= light.near && light.isSoft();
    }
  plan.ambient_occlusion = scene.ambient_occlusion.isOn() && plan.relief && !shaded;
  for (const PixelEffect* effect : pixelEffects())
    for (const EffectSetting& setting : scene.effects)
      if (setting.effect == effect && !setting.changesNothing()) plan.tones.push_back(effect);
  plan.overlay = scene.overlay;
  return plan;
}

TextureFormat EffectPlan::format(const Manifest& manifest) const {
  if (madeOfRelief()) return {};
  TextureFormat format = manifest.texture;
  if (normals_exaggerate != 0) format.basis = Basis::kAlbedoNormal;
  return format;
}

std::string sceneProblem(const Scene& scene, const Manifest& manifest) {
  const BasisDescription& basis = describe(manifest.texture.basis);
  const std::string title(basis.title);
  if (scene.shading.isOn()) return shadingProblem(scene.shading, manifest);
  if (scene.unlit) return basis.coefficients > 0 ? title + " has no colour without a light" : "";
  if (scene.lights.size() > kMaxLights)
    return "a scene has at most " + std::to_string(kMaxLights) + " lights, found " +
           std::to_string(scene.lights.size());
  for (const SceneLight& light : scene.lights) {
    if (!light.near) continue;
    if (basis.coefficients > 0 && basis.functions_file.empty())
      return title + " of the basis " + std::string(basis.name) + " can be lit from far away only, by no near light";
    const glm::dvec3 middle = placeInWorld(scene.pose, artworkMiddle(manifest));
    if (light.reference_mm == 0 && placedLight(light, glm::dmat3(1), middle).reference_mm == 0)
      return "a light in the middle of the artwork needs a distance at which its intensity is as stated (reference_mm)";
  }
  return "";
}

gl::Defines EffectPlan::defines() const {
  gl::Defines d;
  // GLSL has no arrays of no elements.
  d.emplace_back("PLANES", std::to_string(std::max<size_t>(texture_planes.size(), 1)));
  if (!readsTexture()) d.emplace_back("NO_PAGES", "1");
  for (auto& define : shadingDefines(shade)) d.push_back(std::move(define));
  if (mesh) d.emplace_back("MESH", "1");
  if (twoSided()) d.emplace_back("TWO_SIDED", "1");
  if (keepsDepth()) d.emplace_back("EYE_FILES", "\"eye.glsl\"");
  if (relief) d.emplace_back("RELIEF", "1");
  if (geomorph) d.emplace_back("MORPH", "1");
  if (sampling == Sampling::kNearest) d.emplace_back("NEAREST", "1");
  if (sampling >= Sampling::kTrilinear) d.emplace_back("TRILINEAR", "1");
  if (anisotropy > 1) d.emplace_back("ANISOTROPY", std::to_string(anisotropy));
  if (fade) d.emplace_back("FADE", "1");
  if (shadows) d.emplace_back("SHADOWS", "1");
  if (lights > 0) {
    d.emplace_back("LIGHTS", std::to_string(lights));
    d.emplace_back("LIGHT_FILES", "\"lights.glsl\"");
  }
  if (shading != ReliefShading::Kind::kNone) {
    static constexpr std::array kNames{"", "SHADING_SLOPE", "SHADING_CURVATURE", "SHADING_DEPTH"};
    d.emplace_back(kNames[static_cast<size_t>(shading)], "1");
    if (drawsNormals()) d.emplace_back("CURVATURE_FILES", "\"scan_curvature.glsl\"");
    d.emplace_back("SHADING_FILES", "\"relief_shading.glsl\"");
  }
  if (near_lights > 0) {
    d.emplace_back("NEAR_LIGHTS", std::to_string(near_lights));
    if (const std::string_view file = describe(shade).functions_file; !file.empty())
      d.emplace_back("BASIS_FILES", "\"" + std::string(file) + "\"");
  }
  if (gloss) d.emplace_back("GLOSS_FILES", "\"gloss.glsl\"");
  if (ambient_occlusion) d.emplace_back("OCCLUSION_FILES", "\"ambient_occlusion.glsl\"");
  if (filter == Filter::kFast) d.emplace_back("FAST_FILTER", "1");
  for (auto& define : effectDefines(tones, overlay)) d.push_back(std::move(define));
  return d;
}

std::vector<std::string> EffectPlan::passes() const {
  std::vector<std::string> names{"surface", "shade"};
  if (readsTexture()) names.emplace_back("feedback");
  if (samples > 1) names.insert(names.begin() + 2, "average");
  if (wireframe) names.insert(names.begin() + 2, "wireframe");
  if (drawsNormals()) names.insert(names.begin() + 1, "normals");
  if (keepsDepth()) names.insert(names.begin() + 1, "kept depth");
  if (ambient_occlusion) names.insert(names.begin() + 1, {"sky map", "sky"});
  if (soft_shadows) names.insert(names.begin() + 1, "soft shadow");
  if (shadows) names.insert(names.begin() + 1, {"shadow map", "shadow"});
  return names;
}

std::string planeName(Plane plane, Basis basis) {
  if (plane == Plane::kRelief) return "relief";
  if (plane == Plane::kResolved) return "resolved";
  if (basis == Basis::kColour) return plane == kNormalPlane ? "normal" : "colour";  // made of the relief
  return textureName(basis, texturePlaneIndex(plane));
}

std::string EffectPlan::nameOf(Plane plane) const {
  if (madeOfRelief() && plane == kNormalPlane) return std::string(shadingName(shading));
  return planeName(plane, stored);
}

std::vector<std::string> EffectPlan::planesRead() const {
  std::vector<std::string> names;
  for (Plane p : texture_planes) {
    if ((normals_exaggerate != 0 || madeOfRelief()) && p == kNormalPlane) continue;  // made of the relief
    names.push_back(planeName(p, stored));
  }
  if (relief || madeOfRelief()) names.push_back("relief");
  return names;
}

bool EffectPlan::samePages(const EffectPlan& other) const {
  return texture_planes == other.texture_planes && relief == other.relief && resolve == other.resolve &&
         normals_exaggerate == other.normals_exaggerate && madeOfRelief() == other.madeOfRelief() &&
         (!madeOfRelief() || (shading == other.shading && curvature_radius_mm == other.curvature_radius_mm));
}

std::array<double, 3> singleLight(const Scene& scene) {
  const SceneLight* far = firstFarLight(scene.lights);
  return normalizedLight(far ? far->place : scene.light);
}

std::array<double, 3> fixedLight(const Scene& scene) {
  const std::array<double, 3> light = singleLight(scene);
  if (!scene.pose.turns()) return light;
  const glm::dvec3 turned = artworkFromWorld(scene.pose) * glm::dvec3(light[0], light[1], light[2]);
  return {turned.x, turned.y, turned.z};
}

PlacedExtent placedExtent(const Scene& scene, const Manifest& manifest) {
  return {artworkExtent(manifest, scene.relief ? scene.exaggerate : 0), scene.pose};
}

double singleLightSize(const Scene& scene) {
  const SceneLight* far = firstFarLight(scene.lights);
  return far ? far->size_deg : scene.light_size_deg;
}

std::array<double, 3> normalizedLight(const std::array<double, 3>& light) {
  double length = std::sqrt(light[0] * light[0] + light[1] * light[1] + light[2] * light[2]);
  if (!(length > 0) || !std::isfinite(length)) return {0, 0, 1};
  return {light[0] / length, light[1] / length, light[2] / length};
}

}  // namespace relievo
