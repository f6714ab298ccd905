// relievo plan: what a scene calls for, and what each part of it costs.
#include <algorithm>
#include <cstdio>
#include <memory>
#include <optional>
#include <vector>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "src/base/progress.h"
#include "src/base/standard_output.h"
#include "src/engine/effects/soft_shadows.h"
#include "src/engine/light_shares.h"
#include "src/engine/stage.h"
#include "src/gl/context.h"
#include "tools/artwork_cache.h"
#include "tools/bench/frame_timing.h"
#include "tools/commands.h"
#include "tools/output_files.h"
#include "tools/scene/scene_plan.h"
#include "tools/scene_artworks.h"
#include "tools/scene_options.h"

namespace relievo {
namespace {

constexpr int kTimedRounds = 3, kTimedFrames = 5;

struct PlanOptions {
  std::string file, size, json_file;
  bool schema = false, measure = true;
  SceneOptions scene;
  ArtworkCache cache;
};

struct CostedPart {
  ScenePart part;
  PlannedScene without;
  std::optional<double> ms;  // a frame, above the scene without it
};

struct PlannedArtwork {
  std::string name;
  PlannedScene plan;
};

struct ScenePlan {
  Scene scene;
  PlannedScene whole;                    // of all artworks together
  std::vector<PlannedArtwork> artworks;  // each by itself, where there are several
  std::vector<CostedPart> parts;
  std::optional<double> frame_ms;    // of a moving camera, at the size
  std::optional<double> refined_ms;  // until a still picture has all its samples and directions, if it needs any
  std::vector<std::string> areas;    // what light comes from in more than one direction
  double shares_mib = 0;             // memory of the shares of light and sky
  std::string renderer;
  std::string shading;              // its scale; empty: there is none
  std::vector<std::string> lights;  // those that are evaluated for each pixel; none: one white light, or none
};

Result<double> movingFrameMs(Stage& stage, const Scene& scene, const OrbitCamera& camera) {
  if (auto set = stage.setScene(scene); !set) return set.error();
  if (auto settled = stage.settle(120, false); !settled) return settled.error();
  return medianOf(movingFramesMs(stage, camera, kTimedFrames));
}

// From the last frame on.
double refinedMs(Stage& stage) {
  const double start = steadyNow();
  while (!interruptedFlag() && stage.refine(steadyNow())) stage.readPixels();  // which waits for the picture
  return (steadyNow() - start) * 1000;
}

// What of the scene is the average of several directions, and the memory that shares of light take.
void noteShares(ScenePlan& plan, const EffectPlan& of, bool flat, std::pair<int, int> size) {
  if (!of.casts()) return;
  const auto note = [&plan](const char* area) {
    if (std::find(plan.areas.begin(), plan.areas.end(), area) == plan.areas.end()) plan.areas.emplace_back(area);
  };
  std::vector<SceneLight> casting;
  if (of.shadows && of.lights == 0) casting.push_back({.size_deg = singleLightSize(plan.scene)});
  if (of.shadows && of.lights > 0) casting = shadedLights(plan.scene.lights);
  size_t areas = of.ambient_occlusion ? 1 : 0;
  char text[120];
  for (const SceneLight& light : casting) {
    if (!light.isSoft()) continue;
    ++areas;
    std::snprintf(text, sizeof text,
                  light.near ? "a near light of %g mm: %d places, a moving camera draws 1"
                             : "a light of %g degrees: %d directions, a moving camera draws 1",
                  light.near ? light.size_mm : light.size_deg, kLightDirections);
    note(text);
  }
  if (of.ambient_occlusion) {
    std::snprintf(text, sizeof text, "the sky, strength %g: %d directions, a moving camera draws none",
                  plan.scene.ambient_occlusion.strength, flat ? kSkyDirectionsOfFlat : kSkyDirectionsOfScan);
    note(text);
  }
  plan.shares_mib +=
      static_cast<double>(ShadowPass::bytes(size.first, size.second, casting.size(), of.ambient_occlusion, areas)) /
      (1024 * 1024);
}

// In rounds, the scene with and without each part one after the other, so that what else the machine does meets all.
Result<void> measure(ScenePlan& plan, const SceneArtworks& artworks, const OrbitCamera& camera,
                     std::pair<int, int> size, const EngineOptions& options) {
  auto context = gl::HeadlessContext::create();
  if (!context) return context.error();
  plan.renderer = (*context)->info().renderer;
  auto made = Stage::create(
      artworks.staged([](const auto& package) { return artworkFromPackage(package, &interruptedFlag()); }), plan.scene,
      options);
  if (!made) return made.error();
  Stage& stage = **made;
  stage.resize(size.first, size.second);
  stage.setCamera(camera);
  std::vector<double> whole;
  std::vector<std::vector<double>> above(plan.parts.size());
  for (int round = 0; round < kTimedRounds; ++round)
    for (size_t k = 0; k < std::max<size_t>(1, plan.parts.size()); ++k) {
      auto with = movingFrameMs(stage, plan.scene, camera);
      if (!with) return with.error();
      whole.push_back(*with);
      if (k == plan.parts.size()) continue;
      auto without = movingFrameMs(stage, plan.parts[k].part.without, camera);
      if (!without) return without.error();
      above[k].push_back(*with - *without);
    }
  plan.frame_ms = medianOf(whole);
  if (!plan.areas.empty() || plan.whole.plan.samples > 1) {
    if (auto last = movingFrameMs(stage, plan.scene, camera); !last) return last.error();
    plan.refined_ms = refinedMs(stage);
  }
  for (size_t k = 0; k < plan.parts.size(); ++k) plan.parts[k].ms = medianOf(above[k]);
  return {};
}

std::string joined(const std::vector<std::string>& parts, const char* between) {
  std::string out;
  for (const std::string& part : parts) out += (out.empty() ? "" : between) + part;
  return out;
}

std::vector<std::string> planeNames(const PlannedScene& scene) {
  std::vector<std::string> names;
  for (const PlannedPlane& p : scene.planes) names.push_back(p.name);
  return names;
}

// Of "TRILINEAR 1" the name, of "PLANES 3" all, of a formula the name: --json has it whole.
std::vector<std::string> briefly(const std::vector<std::string>& defines) {
  constexpr size_t kLongest = 20;
  std::vector<std::string> out;
  for (const std::string& define : defines) {
    const size_t space = define.find(' ');
    const bool name_alone = define.ends_with(" 1") || define.size() > kLongest;
    out.push_back(name_alone ? define.substr(0, space) : define);
  }
  return out;
}

// Where gloss has its normals from.
const char* glossNormals(const EffectPlan& plan) {
  if (plan.shade != Basis::kAlbedoNormal) return "fitted to the drawn relief";
  return plan.mesh ? "the scan's" : "made of the relief";
}

void printWhatItTakes(const PlannedScene& scene) {
  printOutf("  passes    %s\n", joined(scene.passes, ", ").c_str());
  for (const PlannedPlane& p : scene.planes)
    printOutf("  plane     %-10s %7.1f KiB a page in the package, %5.1f KiB on the GPU\n", p.name.c_str(),
              p.stored_bytes / 1024, static_cast<double>(p.loaded_bytes) / 1024);
  printOutf("  shader    %s\n", joined(briefly(scene.defines), ", ").c_str());
}

void print(const PlanOptions& o, const ScenePlan& plan, std::pair<int, int> size) {
  const PlannedScene& whole = plan.whole;
  printOutf("%s, %d x %d px\n", o.file.c_str(), size.first, size.second);
  for (const std::string& light : plan.lights) printOutf("  light     %s\n", light.c_str());
  if (!plan.shading.empty()) printOutf("  shading   %s\n", plan.shading.c_str());
  if (whole.plan.gloss)
    printOutf("  gloss     reflectance %g, roughness %g, simulated; normals: %s\n", plan.scene.gloss.reflectance,
              plan.scene.gloss.roughness, glossNormals(whole.plan));
  for (const std::string& area : plan.areas) printOutf("  average   %s\n", area.c_str());
  if (plan.shares_mib > 0)
    printOutf("  shares    %.1f MiB on the GPU for shares of light and their maps\n", plan.shares_mib);
  if (plan.artworks.empty()) printWhatItTakes(whole);
  for (const PlannedArtwork& artwork : plan.artworks) {
    printOutf("%s\n", artwork.name.c_str());
    printWhatItTakes(artwork.plan);
  }
  if (!plan.artworks.empty()) printOutf("all of them\n  passes    composition, after those\n");
  if (plan.frame_ms)
    printOutf("  frame     %.1f ms while the camera moves (%s)\n", *plan.frame_ms, plan.renderer.c_str());
  if (plan.refined_ms)
    printOutf("  picture   %.0f ms more until it has all samples and directions, once the camera stands still\n",
              *plan.refined_ms);
  if (plan.parts.empty()) return printOutf("nothing in it can be left out\n");
  printOutf("%-17s %9s %9s %9s  %s\n", "what adds", "ms", "KiB read", "KiB GPU", "planes, passes and defines");
  for (const CostedPart& c : plan.parts) {
    std::vector<std::string> what = added(planeNames(whole), planeNames(c.without));
    for (const auto& list : {added(whole.passes, c.without.passes), briefly(added(whole.defines, c.without.defines))})
      what.insert(what.end(), list.begin(), list.end());
    char ms[24] = "-";
    if (c.ms) std::snprintf(ms, sizeof ms, "%.1f", *c.ms);
    printOutf("%-17s %9s %9.1f %9.1f  %s\n", c.part.name.c_str(), ms,
              (whole.storedBytes() - c.without.storedBytes()) / 1024,
              (static_cast<double>(whole.loadedBytes()) - static_cast<double>(c.without.loadedBytes())) / 1024,
              joined(what, ", ").c_str());
  }
}

nlohmann::ordered_json jsonOf(const PlannedScene& scene) {
  nlohmann::ordered_json planes = nlohmann::ordered_json::array();
  for (const PlannedPlane& p : scene.planes)
    planes.push_back({{"name", p.name}, {"stored_bytes_a_page", p.stored_bytes}, {"gpu_bytes_a_page", p.loaded_bytes}});
  return {{"passes", scene.passes}, {"planes", planes}, {"defines", scene.defines}};
}

std::string planJson(const PlanOptions& o, const ScenePlan& plan, std::pair<int, int> size) {
  nlohmann::ordered_json json = jsonOf(plan.whole);
  json["artwork"] = o.file;
  json["width_px"] = size.first;
  json["height_px"] = size.second;
  json["frame_ms"] = plan.frame_ms ? nlohmann::ordered_json(*plan.frame_ms) : nlohmann::ordered_json();
  json["refined_ms"] = plan.refined_ms ? nlohmann::ordered_json(*plan.refined_ms) : nlohmann::ordered_json();
  json["averages"] = plan.areas;
  json["shares_mib"] = plan.shares_mib;
  json["renderer"] = plan.renderer;
  json["lights"] = plan.lights;
  json["shading"] = plan.shading;
  for (const PlannedArtwork& artwork : plan.artworks) {
    nlohmann::ordered_json one = {{"artwork", artwork.name}};
    one.update(jsonOf(artwork.plan));
    json["artworks"].push_back(std::move(one));
  }
  json["parts"] = nlohmann::ordered_json::array();
  for (const CostedPart& c : plan.parts) {
    nlohmann::ordered_json part = {{"name", c.part.name}, {"meaning", c.part.meaning}};
    part["adds_ms"] = c.ms ? nlohmann::ordered_json(*c.ms) : nlohmann::ordered_json();
    part["without"] = jsonOf(c.without);
    json["parts"].push_back(std::move(part));
  }
  return json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

// Of the artworks as they stand, together.
Result<PlannedScene> plannedTogether(const Scene& scene, const SceneArtworks& artworks,
                                     std::vector<PlannedScene>* each = nullptr) {
  std::vector<PlannedScene> all;
  for (const OpenedArtwork& opened : artworks.opened) {
    auto one = planScene(scene, *opened.package);
    if (!one) return one.error();
    all.push_back(std::move(*one));
  }
  PlannedScene whole = together(all);
  if (each) *each = std::move(all);
  return whole;
}

// But for what is measured.
Result<ScenePlan> planOf(const Scene& scene, const SceneArtworks& artworks, std::pair<int, int> px) {
  std::vector<const Manifest*> manifests;
  std::vector<PlacedExtent> flat_extents;
  for (size_t i = 0; i < artworks.named.size(); ++i) {
    manifests.push_back(&artworks.package(i).manifest());
    flat_extents.push_back({artworkExtent(*manifests[i], 0), artworks.named[i].pose});
  }
  const glm::dvec3 middle = middleOf(flat_extents);
  const std::optional<glm::dvec3> of_all = artworks.several() ? std::optional(middle) : std::nullopt;
  if (const std::string problem = of_all ? stagedProblem(scene, middle) : ""; !problem.empty())
    return Error{ErrorKind::kUsage, "", problem, "", {}};
  for (size_t i = 0; i < artworks.named.size(); ++i)
    if (const std::string problem = sceneProblem(stagedScene(scene, artworks.named[i].pose, of_all), *manifests[i]);
        !problem.empty())
      return Error{ErrorKind::kUsage, artworks.named[i].file, problem, "", {}};
  ScenePlan plan;
  plan.scene = scene;
  std::vector<PlannedScene> each;
  auto whole = plannedTogether(scene, artworks, &each);
  if (!whole) return whole.error();
  plan.whole = std::move(*whole);
  // What is said of lights and gloss is of the first artwork that has them, whichever comes first in the scene.
  const auto lit = std::find_if(each.begin(), each.end(), [](const PlannedScene& p) { return p.plan.lights > 0; });
  if (lit != each.end()) plan.whole.plan = lit->plan;
  if (scene.shading.isOn()) plan.shading = shadingText(scene.shading, *manifests[0]);
  if (plan.whole.plan.lights > 0)
    for (const SceneLight& light : shadedLights(scene.lights))
      plan.lights.push_back(lightText(light, middle) + (plan.whole.plan.shadows ? ", shadows" : ""));
  for (ScenePart& part : partsOf(stagedScene(scene, scene.pose, of_all), manifests)) {
    auto without = plannedTogether(part.without, artworks);
    if (!without) return without.error();
    plan.parts.push_back({std::move(part), std::move(*without), {}});
  }
  for (size_t i = 0; i < each.size(); ++i) {
    noteShares(plan, each[i].plan, manifests[i]->domain.isFlat(), px);
    if (artworks.several()) plan.artworks.push_back({artworks.nameOf(i), std::move(each[i])});
  }
  return plan;
}

Result<void> plan(PlanOptions& o) {
  if (o.schema) return printOut(sceneSchema());
  if (o.file.empty()) return usageError("a scene or an artwork is missing", "see relievo plan --help");
  if (auto file = o.scene.takeScene(o.file, o.size); !file) return file.error();
  auto size = parseSize(o.size.empty() ? "1280x720" : o.size);
  if (!size) return size.error();
  if (size->first > kMaxScenePicturePx || size->second > kMaxScenePicturePx)
    return usageError("expected a --size of at most 16384x16384 px, found " + o.size);
  if (auto taken = o.scene.takeSettings(); !taken) return taken;
  auto scene = o.scene.scene();
  if (!scene) return scene.error();
  std::vector<NamedFile> inputs = inputsOf(o.scene.artworksOf(o.file));
  inputs.push_back({"the scene", o.scene.scene_file});
  if (auto good = checkOutputs({{"--json", o.json_file}}, inputs); !good) return good;
  auto artworks = openArtworks(o.scene.artworksOf(o.file), o.cache);
  if (!artworks) return artworks.error();
  const std::pair<int, int> px{static_cast<int>(size->first), static_cast<int>(size->second)};
  auto planned = planOf(*scene, *artworks, px);
  if (!planned) return planned.error();
  ScenePlan& plan = *planned;
  if (o.measure) {
    auto camera = o.scene.camera(artworks->placed(*scene), px.first, px.second);
    if (!camera) return camera.error();
    if (auto done = measure(plan, *artworks, *camera, px, o.scene.engineOptions()); !done) return done;
  }
  print(o, plan, px);
  return writeTextOutput(o.json_file, planJson(o, plan, px));
}

}  // namespace

void addPlanCommand(CLI::App& app, CommandContext& context) {
  auto o = std::make_shared<PlanOptions>();
  auto* c = app.add_subcommand("plan", "Tell what a scene calls for, and what each part of it costs");
  c->footer(
      "Of a scene: the planes that are read, the passes that run and the shader that is linked. Then, for each part of "
      "it that could be left out,\nwhat it adds: ms a frame of a moving camera, KiB of a page of all planes in the "
      "package and on the GPU, planes, passes, defines.\n\n"
      "Examples:\n  relievo plan scene.json\n  relievo plan inscription.relievo --exposure 1 --sampling anisotropic\n"
      "  relievo plan --schema");
  c->add_option("FILE", o->file, "Scene (.json), or an artwork as relievo render takes it");
  c->add_option("--size", o->size, "Picture that is timed, WIDTHxHEIGHT in px [the scene's, or 1280x720]");
  c->add_flag("--measure,!--no-measure", o->measure, "Time frames; without it no OpenGL is needed [on]");
  c->add_option("--json", o->json_file, "Write it as JSON to this file, too; - for standard output");
  c->add_flag("--schema", o->schema, "Print the JSON Schema of scenes, and nothing else");
  o->scene.addTo(*c);
  o->cache.addTo(*c);
  c->callback([o, &context] {
    if (auto done = plan(*o); !done) context.fail(done.error());
  });
}

}  // namespace relievo
