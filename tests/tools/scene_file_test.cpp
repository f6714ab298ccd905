// Scenes as files: read, refused, written and come back; what their parts cost.
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <random>

#include <nlohmann/json.hpp>

#include "tools/scene/scene_file.h"
#include "tools/scene/scene_plan.h"

namespace relievo {
namespace scene_file_test {

using Json = nlohmann::ordered_json;

const std::string kHead = R"({"format": "relievo-scene", "version": 1, "artwork": "a.relievo")";
const std::string kSeveral = R"({"format": "relievo-scene", "version": 1, "artworks": [)";

TEST(SceneFiles, ComeBackAsTheyWereWritten) {
  std::mt19937 random(5);
  const auto some = [&] { return random() % 2 == 0; };
  const auto number = [&](double low, double high) { return low + (high - low) * (random() % 1001) / 1000.0; };
  for (int run = 0; run < 200; ++run) {
    SceneFile s;
    s.artwork = "folder/\"quoted\" näme.relievo";
    if (some()) s.camera.azimuth_deg = number(-360, 360);
    if (some()) s.camera.elevation_deg = number(-89, 89);
    if (some()) s.camera.distance_mm = number(0.1, 1e6);
    if (some()) s.camera.fov_deg = number(1, 170);
    if (some()) s.camera.orthographic = some();
    if (some()) s.camera.target_mm = {number(-10, 10), 1.0 / 3, 1e-300};
    if (some()) s.light = {number(-1, 1), number(-1, 1), 0.1};
    while (!s.light && s.lights.size() < 4 && some()) {
      SceneLight light;
      light.near = some();
      light.place = {number(-1e6, 1e6), number(-9, 9), 1.0 / 3};
      if (some()) light.intensity = number(0, 1000);
      if (some()) light.color = {number(0, 1), 0.1, 1};
      if (light.near && some()) light.reference_mm = number(1e-3, 1e6);
      if (!light.near && some()) light.size_deg = number(0, 90);
      if (light.near && some()) light.size_mm = number(0, 90);
      s.lights.push_back(light);
    }
    if (some()) {
      s.animation.duration_s = 10;
      for (double t = number(0, 1); t < 8; t += number(1, 4)) {
        CameraKey key{.time_s = t, .elevation_deg = number(-89, 89)};
        if (some()) key.azimuth_deg = number(-1000, 1000);
        if (some()) key.target_mm = {1.0 / 3, 0, number(-9, 9)};
        s.animation.camera.push_back(key);
      }
      for (const SceneLight& light : s.lights) {
        auto& keys = s.animation.lights.emplace_back();
        for (double t = 0; t < 10 && (!light.near || light.reference_mm > 0); t += number(1, 4))
          keys.push_back(
              {.time_s = t, .place = std::array{number(1, 2), number(1, 2), 1.0}, .intensity = number(0, 9)});
      }
      if (std::all_of(s.animation.lights.begin(), s.animation.lights.end(), [](const auto& k) { return k.empty(); }))
        s.animation.lights.clear();
    }
    if (some()) {
      s.shading.kind = std::array{ReliefShading::Kind::kSlope, ReliefShading::Kind::kCurvature,
                                  ReliefShading::Kind::kDepth}[static_cast<size_t>(number(0, 2.99))];
      if (some()) s.shading.map = ReliefShading::Map::kColour;
      if (some()) s.shading.full_deg = number(1, 90);
      if (some()) s.shading.radius_mm = number(0.1, 3);
      if (some()) s.shading.full_per_mm = number(0.1, 3);
      if (some()) s.shading.low_mm = number(-3, -1);
      if (some()) s.shading.high_mm = number(0, 3);
      if (some()) s.shading.up = {number(-1, 1), 1.0 / 3, 1};
    }
    const auto somePose = [&] {
      Pose pose;
      if (some()) pose.position_mm = {number(-1e6, 1e6), 1.0 / 3, 0};
      if (some()) pose.rotate_deg = {number(-360, 360), 0, 1.0 / 3};
      return pose;
    };
    if (some()) {
      s.pose = somePose();
    } else {
      s.artwork.clear();
      for (size_t i = 2 + random() % 15; i > 0; --i) s.artworks.push_back({"a" + std::to_string(i), somePose()});
    }
    if (some()) s.light_fixed = some();
    if (some()) s.shadows = some();
    if (s.lights.empty() && some()) s.light_size_deg = number(0, 90);
    if (some()) s.ambient_occlusion = number(0, 1);
    if (some()) s.gloss = {number(0.01, 1), number(0.05, 1)};
    if (some()) s.relief = some();
    if (some()) s.unlit = some();
    if (some()) s.exaggerate = number(-1e4, 1e4);
    for (EffectSetting& e : s.effects)
      if (some()) e.values[0] = number(e.effect->parameters[0].low, e.effect->parameters[0].high);
    if (some()) s.show = some() ? "pages" : "none";
    if (some()) s.wireframe = some();
    if (some()) s.size_px = {1 + static_cast<int>(random() % 16384), 7};
    if (some()) s.samples = some() ? 4 : 8;
    if (some()) s.background = {number(0, 255), 0, 255};
    if (some()) s.settings.error_px = number(0, 10);
    if (some()) s.settings.sampling = "nearest";
    const auto back = parseScene(sceneText(s), "scene.json");
    ASSERT_TRUE(back) << back.error().text() << sceneText(s);
    EXPECT_EQ(*back, s) << sceneText(s);
    SceneFile other = s;
    other.exaggerate = s.exaggerate.value_or(0) + 1;
    EXPECT_FALSE(*back == other) << "the control";
  }
}

TEST(SceneFiles, AreRefusedNamingWhatIsWrong) {
  const struct {
    std::string text, named;
    ErrorKind kind = ErrorKind::kInvalidData;
  } cases[] = {
      {R"({"format": "relievo-scene", "version": 1})", "'artwork' is missing"},
      {R"({"format": "relievo-scene", "version": 1, "artwork": ""})", "artwork"},
      {R"({"format": "relievo-scene", "version": 2, "artwork": "a"})", "version 2", ErrorKind::kUnsupported},
      {R"({"format": "relievo-settings", "version": 1, "artwork": "a"})", "relievo-scene"},
      {"[]", "relievo-scene"},
      {"{", "JSON"},
      {kHead + R"(, "lights": []})", "a list of 1 to 4 objects for 'lights'"},
      {kHead + R"(, "lights": [{},{},{},{},{}]})", "a list of 1 to 4 objects for 'lights'"},
      {kHead + R"(, "lights": [{}, 3]})", "expected an object for 'lights[1]'"},
      {kHead + R"(, "lights": [{}, {"colour": [1, 1, 1]}]})",
       "there is no 'lights[1].colour'; known are towards, size_deg, position_mm, size_mm, reference_mm, intensity, "
       "color, "
       "keys"},
      {kHead + R"(, "lights": [{"position_mm": [0, 0, 1], "size_deg": 1}]})", "'lights[0].size_deg' needs"},
      {kHead + R"(, "light": {"size_deg": 91}})", "from 0 to 90 for 'light.size_deg'"},
      {kHead + R"(, "light": {"size_deg": 1}, "lights": [{}]})", "give each of them a size_deg"},
      {kHead + R"(, "gloss": {"roughness": 0.5}})", "'gloss.roughness' needs 'gloss.reflectance'"},
      {kHead + R"(, "gloss": {"reflectance": 1, "roughness": 0}})", "from 0.05 to 1 for 'gloss.roughness'"},
      {kHead + R"(, "effects": {"ambient_occlusion": 2}})", "from 0 to 1 for 'effects.ambient_occlusion'"},
      {kHead + R"(, "lights": [{"intensity": -1}]})", "from 0 to 1000 for 'lights[0].intensity'"},
      {kHead + R"(, "lights": [{"towards": [0, 0, 0]}]})", "direction is zero in 'lights[0]'"},
      {kHead + R"(, "lights": [{}, {"towards": [0, 0, 1], "position_mm": [0, 0, 1]}]})", "'lights[1]' has both"},
      {kHead + R"(, "lights": [{"reference_mm": 3}]})", "'lights[0].reference_mm' needs"},
      {kHead + R"(, "light": {"towards": [0, 0, 1]}, "lights": [{}]})", "leave out one of them"},
      {kHead + R"(, "camera_path": [{"time_s": 0}]})", "a list of 2 to 1000 objects for 'camera_path'"},
      {kHead + R"(, "camera_path": [{"time_s": 0}, {}]})", "'camera_path[1].time_s' is missing"},
      {kHead + R"(, "camera_path": [{"time_s": 1}, {"time_s": 1}]})", "'camera_path[1].time_s' is not after"},
      {kHead + R"(, "camera_path": [{"time_s": 0}, {"time_s": 3}], "duration_s": 2})",
       "'camera_path[1].time_s' is after 'duration_s'"},
      {kHead + R"(, "camera_path": [{"time_s": 0, "orthographic": true}, {"time_s": 1}]})",
       "there is no 'camera_path[0].orthographic'"},
      {kHead + R"(, "camera_path": [{"time_s": 0, "mm_per_px": 1}, {"time_s": 1, "distance_mm": 3}]})",
       "'camera_path' has both distance_mm and mm_per_px"},
      {kHead + R"(, "camera_path": [{"time_s": 0, "mm_per_px": 1}, {"time_s": 1, "fov_deg": 30}]})",
       "'camera_path' has both fov_deg and mm_per_px"},
      {kHead + R"(, "camera": {"orthographic": true}, "camera_path": [{"time_s": 0}, {"time_s": 1, "fov_deg": 30}]})",
       "'camera_path' has fov_deg, and the camera is orthographic"},
      {kHead + R"(, "camera": {"fov_deg": 30}, "camera_path": [{"time_s": 0}, {"time_s": 1, "mm_per_px": 1}]})",
       "'camera_path' has mm_per_px"},
      {kHead + R"(, "camera": {"mm_per_px": 1}, "camera_path": [{"time_s": 0}, {"time_s": 1, "distance_mm": 1}]})",
       "'camera_path' has distance_mm"},
      {kHead + R"(, "lights": [{}, {"keys": [{"time_s": 1}, {"time_s": 0}]}]})",
       "'lights[1].keys[1].time_s' is not after"},
      {kHead + R"(, "lights": [{"keys": [{"time_s": 1}, {"time_s": 2, "position_mm": [0, 0, 1]}]}]})",
       "'lights[0].keys[1].position_mm' is of a near light"},
      {kHead +
           R"(, "lights": [{"position_mm": [0, 0, 1], "keys": [{"time_s": 1, "towards": [0, 0, 1]}, {"time_s": 2}]}]})",
       "'lights[0].keys[0].towards' is of a light far away"},
      {kHead +
           R"(, "lights": [{"position_mm": [0, 0, 1], "keys": [{"time_s": 1, "position_mm": [0, 0, 1]}, {"time_s": 2}]}]})",
       "'lights[0]' moves and has no reference_mm"},
      {kHead + R"(, "lights": [{"keys": [{"time_s": 1, "towards": [0, 0, 0]}, {"time_s": 2}]}]})",
       "direction is zero in 'lights[0].keys[0]'"},
      {kHead +
           R"(, "lights": [{"keys": [{"time_s": 1, "towards": [1, 0, 0]}, {"time_s": 2, "towards": [-3, 0, 0]}]}]})",
       "'lights[0].keys[1].towards' is opposite"},
      {kHead + R"(, "shading": {"kind": "height"}})", "one of slope, curvature, depth for 'shading.kind'"},
      {kHead + R"(, "shading": {"radius_mm": 1}})", "'shading.radius_mm' needs 'shading.kind'"},
      {kHead + R"(, "shading": {"kind": "slope", "full_deg": 91}})", "from 0.01 to 90 for 'shading.full_deg'"},
      {kHead + R"(, "shading": {"kind": "depth", "low_mm": 1, "high_mm": 1}})", "are the same"},
      {kHead + R"(, "shading": {"kind": "slope", "up": [0, 0, 0]}})", "'shading.up' is zero"},
      {kHead + R"(, "pose": {"scale": 2}})", "there is no 'pose.scale'; known are position_mm, rotate_deg"},
      {kHead + R"(, "pose": {"rotate_deg": [0, 90]}})", "3 numbers"},
      {kHead + R"(, "artworks": [{"file": "b"}]})", "'artworks' takes the place of 'artwork': leave out one of them"},
      {kSeveral + R"({"file": "a"}], "pose": {"position_mm": [0, 0, 1]}})", "each of 'artworks' has its own"},
      {kSeveral + R"({"file": ""}]})", "a file's name for 'artworks[0].file'"},
      {kSeveral + R"({"pose": {}}]})", "'artworks[0].file' is missing"},
      {kSeveral + R"({"file": "a", "scale": 2}]})", "there is no 'artworks[0].scale'; known are file, pose"},
      {kSeveral + "]}", "a list of 1 to 16 objects for 'artworks'"},
      {kHead + R"(, "camera": []})", "expected an object for 'camera'"},
      {kHead + R"(, "camera": {"fov": 3}})", "'camera.fov'"},
      {kHead + R"(, "camera": {"fov_deg": 171}})", "from 1 to 170 for 'camera.fov_deg'"},
      {kHead + R"(, "camera": {"target_mm": [1, 2]}})", "3 numbers"},
      {kHead + R"(, "camera": {"mm_per_px": 1, "distance_mm": 3}})", "camera.mm_per_px"},
      {kHead + R"(, "light": {"towards": [0, 0, 0]}})", "direction is zero"},
      {kHead + R"(, "effects": {"exposure": "1"}})", "effects.exposure"},
      {kHead + R"(, "effects": {"show": "nothing"}})", "one of none"},
      {kHead + R"(, "picture": {"size_px": [1.5, 2]}})", "2 whole numbers"},
      {kHead + R"(, "picture": {"samples": 3}})", "one of [1,4,8] for 'picture.samples'"},
      {kHead + R"(, "settings": {"version": 1}})", "'settings.version'"},
      {kHead + R"(, "settings": {"error_px": -1}})", "settings.error_px"}};
  for (const auto& c : cases) {
    const auto r = parseScene(c.text, "scene.json");
    ASSERT_FALSE(r) << c.text;
    EXPECT_EQ(r.error().kind, c.kind) << c.text;
    EXPECT_NE(r.error().text().find("scene.json"), std::string::npos) << r.error().text();
    EXPECT_NE(r.error().text().find(c.named), std::string::npos) << r.error().text();
  }
  EXPECT_TRUE(parseScene(kHead + "}", "scene.json")) << "the control";
}

// A value that a member's schema allows; or, if not `good`, one that it does not.
Json valueFor(const Json& schema, bool good) {
  if (schema.contains("enum")) return good ? schema["enum"][0] : Json("no such choice");
  const std::string type = schema["type"];
  if (type == "object") {
    if (!good) return Json("no object");
    Json object = Json::object();
    for (const Json& name : schema.value("required", Json::array()))
      object[name.get<std::string>()] = valueFor(schema["properties"][name.get<std::string>()], true);
    return object;
  }
  if (type == "array") {
    Json list = Json::array();
    for (size_t i = 0; i < schema["minItems"].get<size_t>(); ++i) list.push_back(valueFor(schema["items"], good));
    // Keys follow one another.
    for (size_t i = 0; i < list.size() && list[i].contains("time_s"); ++i) list[i]["time_s"] = i;
    return list;
  }
  if (type == "string") return good ? Json("a.relievo") : Json(3);
  if (type == "boolean") return good ? Json(true) : Json(1);
  const double beyond = schema["maximum"].get<double>() * 2 + 1;
  if (type == "integer") return good ? schema["maximum"] : Json(schema["minimum"].get<double>() + 0.5);
  return good ? schema["maximum"] : Json(beyond);
}

constexpr const char* kFirst = "[0]";  // in a path: the first of a list

// Each member below `schema` by itself, in a scene that is otherwise sound.
void tryMembers(const Json& schema, const std::vector<std::string>& within, int& tried) {
  for (const auto& [name, member] : schema["properties"].items()) {
    if (within.empty() && (name == "format" || name == "version")) continue;
    std::vector<std::string> path = within;
    for (const bool good : {true, false}) {
      Json scene = Json::parse(kHead + "}");
      if (name == "artworks" || (!within.empty() && within[0] == "artworks")) scene.erase("artwork");
      Json* at = &scene;
      for (const std::string& part : path) {
        // Keys are two or more, one after the other, and those with a position belong to a near light.
        if (part == "keys" && name == "position_mm") at->update(Json{{"position_mm", {0, 0, 1}}, {"reference_mm", 1}});
        if (part == "keys" || part == "camera_path") (*at)[part] = {{{"time_s", 1}}, {{"time_s", 2}}};
        if (part == "artworks") (*at)[part] = {{{"file", "a.relievo"}}};
        at = part == kFirst ? &(*at)[0] : &(*at)[part];
      }
      if (schema.contains("dependentRequired") && schema["dependentRequired"].contains(name)) {
        const std::string beside = schema["dependentRequired"][name][0];
        (*at)[beside] = valueFor(schema["properties"][beside], true);
      }
      (*at)[name] = good && name == "time_s" ? member["minimum"] : valueFor(member, good);
      const auto read = parseScene(scene.dump(), "scene.json");
      EXPECT_EQ(read.ok(), good) << scene.dump() << (read ? "" : read.error().text());
    }
    ++tried;
    path.push_back(name);
    if (member.contains("properties")) tryMembers(member, path, tried);
    if (member.contains("items") && member["items"].contains("properties")) {
      path.emplace_back(kFirst);
      tryMembers(member["items"], path, tried);
    }
  }
}

TEST(SceneFiles, AreReadAsTheirSchemaSays) {
  const Json schema = Json::parse(sceneSchema());
  EXPECT_EQ(schema["required"], Json({"format", "version"}));
  const Json one_of{{{"required", {"artwork"}}}, {{"required", {"artworks"}}}};
  EXPECT_EQ(schema["oneOf"], one_of) << "the one artwork or several";
  EXPECT_EQ(schema["additionalProperties"], false);
  int tried = 0;
  tryMembers(schema, {}, tried);
  EXPECT_GT(tried, 30);
  for (const EffectSetting& e : SceneFile().effects)
    EXPECT_TRUE(schema["properties"]["effects"]["properties"].contains(std::string(e.effect->parameters[0].name)));
}

TEST(SceneFiles, ExamplesAreReadAndSayWhatTheyAreFor) {
  int examples = 0;
  for (const auto& entry : std::filesystem::directory_iterator(RELIEVO_SOURCE_DIR "/tools/scene/examples")) {
    const auto scene = readScene(entry.path().string());
    EXPECT_TRUE(scene) << scene.error().text();
    std::ifstream in(entry.path());
    const Json json = Json::parse(in);
    EXPECT_GT(json.value("about", "").size(), 20u) << entry.path();
    ++examples;
  }
  EXPECT_EQ(examples, 11);
}

TEST(SceneFiles, OfOneArtworkInAListAreThoseOfThatArtwork) {
  const auto listed =
                 parseScene(kSeveral + R"({"file": "a.relievo", "pose": {"rotate_deg": [1, 2, 3]}}]})", "scene.json"),
             alone = parseScene(kHead + R"(, "pose": {"rotate_deg": [1, 2, 3]}})", "scene.json"),
             two = parseScene(kSeveral + R"({"file": "a.relievo"}, {"file": "b.relievo"}]})", "scene.json");
  ASSERT_TRUE(listed && alone && two);
  EXPECT_EQ(*listed, *alone);
  EXPECT_EQ(onlyArtwork(*listed, "scene.json").value(), "a.relievo");
  const auto refused = onlyArtwork(*two, "scene.json");
  ASSERT_FALSE(refused);
  EXPECT_EQ(
      refused.error().text(),
      "scene.json: the scene has 2 artworks, and this command takes one (give it an artwork: a.relievo, b.relievo)");
}

TEST(SceneFiles, HoldLightsThatAnOptionGives) {
  const auto lights = parseLights(R"([{"towards": [-1, 0, 0.5], "color": [1, 0.5, 0.25]},
                                      {"position_mm": [1, 2, 3], "intensity": 0.5}])");
  ASSERT_TRUE(lights) << lights.error().text();
  const SceneLight far{.place = {-1, 0, 0.5}, .color = {1, 0.5, 0.25}},
      near{.near = true, .place = {1, 2, 3}, .intensity = 0.5};
  EXPECT_EQ(*lights, (std::vector{far, near}));
  for (const char* wrong : {"", "[", "{}", "[]", R"([{"toward": [0, 0, 1]}])", R"([{"reference_mm": 1}])"})
    EXPECT_FALSE(parseLights(wrong)) << wrong;
}

TEST(SceneFiles, HoldAShadingThatAnOptionGives) {
  const auto slope = parseShading("slope"),
             bent = parseShading(R"({"kind": "curvature", "map": "color", "radius_mm": 0.5})");
  ASSERT_TRUE(slope && bent);
  EXPECT_EQ(*slope, (ReliefShading{.kind = ReliefShading::Kind::kSlope}));
  EXPECT_EQ(*bent, (ReliefShading{
                       .kind = ReliefShading::Kind::kCurvature, .map = ReliefShading::Map::kColour, .radius_mm = 0.5}));
  for (const char* wrong : {"", "height", "none", "{}", "[]", R"({"map": "color"})", R"({"kind": "slope", "deg": 1})"})
    EXPECT_FALSE(parseShading(wrong)) << wrong;
}

Manifest manifestOf(Basis basis, int relief_depth) {
  Manifest m;
  m.texture.basis = basis;
  m.domain.relief_depth = relief_depth;
  return m;
}

std::vector<std::string> partNames(const Scene& scene, const Manifest& manifest) {
  std::vector<std::string> names;
  for (const ScenePart& part : partsOf(scene, manifest)) names.push_back(part.name);
  return names;
}

// What is off is no part, and each part is one that can be left out: without it the plan is another one.
TEST(ScenePlan, NamesWhatIsOnAndNothingElse) {
  Scene plain;
  plain.relief = false;
  plain.sampling = Sampling::kNearest;
  plain.filter = Filter::kFast;
  EXPECT_EQ(partNames(plain, manifestOf(Basis::kColour, 3)), std::vector<std::string>{});
  Scene rich;
  rich.sampling = Sampling::kAnisotropic;
  rich.wireframe = true;
  rich.overlay = findEffect("pages");
  rich.effects = SceneFile().effects;
  EXPECT_EQ(partNames(rich, manifestOf(Basis::kPtmLrgb, 3)),
            (std::vector<std::string>{"relief", "light", "anisotropic", "exact filter", "wireframe", "pages"}));
  rich.effects[0].values[0] = 1;
  const Manifest ptm = manifestOf(Basis::kPtmLrgb, -1);
  EXPECT_EQ(partNames(rich, ptm),
            (std::vector<std::string>{"light", "anisotropic", "exact filter", "wireframe", "exposure", "pages"}));
  // Lights: what more than a white one adds, and near ones.
  Scene lit = plain;
  lit.lights = {{.place = {1, 0, 1}, .color = {1, 0.5, 0.5}}, {.near = true, .place = {0, 0, 9}}};
  EXPECT_EQ(partNames(lit, ptm), (std::vector<std::string>{"light", "lights", "near lights"}));
  lit.lights.pop_back();
  EXPECT_EQ(partNames(lit, ptm), (std::vector<std::string>{"light", "lights"}));
  lit.lights[0].color = {1, 1, 1};
  EXPECT_EQ(partNames(lit, ptm), (std::vector<std::string>{"light"}));
  // What is anisotropic where patches are stretched costs that there.
  Scene usual = plain;
  usual.sampling = Sampling::kAuto;
  EXPECT_EQ(partNames(usual, ptm), (std::vector<std::string>{"light", "trilinear"}));
  for (const float length : {2.0f, 4.0f}) {
    Manifest scan = manifestOf(Basis::kAlbedoNormal, 2);
    BaseMesh base;
    for (float y : {0.0f, -1.0f})
      for (float x : {0.0f, length}) base.corners.push_back({{x, y, 0}, {0, 0, 1}});
    base.patches = {{0, 1, 2, 3}};
    scan.base = std::make_shared<const BaseMesh>(base);
    scan.domain = PatchDomain::overMesh(1, {});
    EXPECT_EQ(planEffects(usual, scan).sampling, length > 3 ? Sampling::kAnisotropic : Sampling::kTrilinear);
    EXPECT_EQ(partNames(usual, scan).back(), length > 3 ? "anisotropic" : "trilinear");
    EXPECT_EQ(planEffects(usual, scan).anisotropy, length > 3 ? 32 : 1);
    Scene asked = usual;
    asked.anisotropy = 3;
    EXPECT_EQ(planEffects(asked, scan).anisotropy, length > 3 ? 3 : 1);
    asked.sampling = Sampling::kAnisotropic;
    EXPECT_EQ(planEffects(asked, scan).anisotropy, 3);
    asked.anisotropy = 0;
    EXPECT_EQ(planEffects(asked, scan).anisotropy, 8);
    EXPECT_EQ(planEffects(Scene{}, scan).sampling, Sampling::kTrilinear) << "as asked for";
  }
  // Shadows of a light with a size cost more than hard ones.
  const Manifest raised = manifestOf(Basis::kPtmLrgb, 2);
  lit.relief = lit.shadows = true;
  lit.lights[0].size_deg = 2;
  lit.ambient_occlusion.strength = 0.5;
  lit.gloss.reflectance = 0.1;
  EXPECT_EQ(partNames(lit, raised),
            (std::vector<std::string>{"relief", "light", "shadows", "soft shadows", "gloss", "ambient occlusion"}));
  // A shading stands in the place of light, and is one part.
  Scene shaded = plain;
  shaded.shading.kind = ReliefShading::Kind::kSlope;
  EXPECT_EQ(partNames(shaded, manifestOf(Basis::kPtmLrgb, 2)), (std::vector<std::string>{"shading"}));
  for (const ScenePart& part : partsOf(rich, ptm))
    EXPECT_FALSE(planEffects(part.without, ptm) == planEffects(rich, ptm)) << part.name;
}

}  // namespace scene_file_test
}  // namespace relievo
