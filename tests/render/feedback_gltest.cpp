// The feedback pass against an oracle that projects every pixel in double precision (tests/geometry/pixel_requests.h):
// which pixels it samples, what it asks for in one pass and in scale^2 passes of a still view, and what broken
// gradients ask for.
#include <gtest/gtest.h>

#include <chrono>
#include <cstdio>
#include <set>

#include "geometry/lod/planar_lod.h"
#include "shaders/embedded.h"
#include "src/engine/engine.h"
#include "src/engine/lod_views.h"
#include "src/render/feedback_pass.h"
#include "src/render/patch_pass.h"
#include "src/render/picture_target.h"
#include "src/render/surface_target.h"
#include "tests/geometry/pixel_requests.h"
#include "tests/render/gl_fixture.h"
#include "tests/render/made_engine.h"
#include "tests/render/test_artwork.h"
#include "tests/view_share.h"
#include "texturing/stream/page_sources.h"
#include "texturing/stream/request_memory.h"

namespace relievo::test {
namespace feedback_gltest {

constexpr uint64_t kSeed = 20261121;
using Pixels = std::vector<std::array<uint32_t, 4>>;

EffectPlan flatPlan(const Manifest& manifest, Sampling sampling = Sampling::kTrilinear) {
  Scene scene;
  scene.relief = false;
  scene.sampling = sampling;
  return planEffects(scene, manifest);
}

// Draws flat artworks into feedback pictures, without pages and an engine.
class FlatFeedback {
 public:
  // looks_at_depth: false for a negative control.
  explicit FlatFeedback(const FlatDomain& domain, const DepthMode& depth = depthMode(), bool looks_at_depth = true,
                        Sampling sampling = Sampling::kTrilinear)
      : sampling_(sampling), surface_(depth), pass_(gltest::context().info().software) {
    manifest_.domain = domain;
    link(surface_program_,
         {"patch.vert", "surface.frag", flatPlan(manifest_, sampling_).defines(), patchAttributes(), {}});
    std::string feedback(shaderSource("feedback.frag"));
    const std::string look = "if (depth <= u_seen.x || depth >= u_seen.y) return;";
    EXPECT_NE(feedback.find(look), std::string::npos);
    if (!looks_at_depth) feedback.replace(feedback.find(look), look.size(), "");
    auto linked = gl::Program::linkTexts(gltest::api(), {"screen.vert", std::string(shaderSource("screen.vert"))},
                                         {"feedback.frag", feedback},
                                         {"", "", flatPlan(manifest_, sampling_).defines(), {"a_corner"}, {}});
    EXPECT_TRUE(linked.ok()) << (linked.ok() ? "" : linked.error().text());
    if (linked.ok()) program_ = std::move(*linked);
  }
  // extra_bias: for a negative control.
  Pixels draw(const TextureView& v, const FeedbackGrid& grid, double extra_bias = 0) {
    drawSurface(v, grid.view_width_px, grid.view_height_px);
    return ask(v, grid, extra_bias);
  }
  void drawSurface(const TextureView& v, int width_px, int height_px) {
    const EyeFrame eye = setView(v);
    surface_.resize(width_px, height_px, false);
    surface_.begin();
    surface_program_.use();
    setShadingUniforms(surface_program_, {.format = &manifest_.texture, .domain = &manifest_.domain});
    patches_.draw(surface_program_, eye, PatchPass::Mesh::kFull);
  }
  // As the engine draws its wireframe: into a picture with the surface's depth.
  void drawOver(const TextureView& v, int width_px, int height_px, PatchPass::Mesh mesh) {
    if (wire_program_.id() == 0) {
      auto defines = flatPlan(manifest_, sampling_).defines();
      defines.emplace_back("WIREFRAME", "1");
      link(wire_program_, {"patch.vert", "lines.frag", defines, patchAttributes(), {}});
    }
    const EyeFrame eye = setView(v);
    PictureTarget target(surface_.depthMode());
    target.resize(width_px, height_px, surface_.depth());
    target.begin();
    wire_program_.use();
    patches_.draw(wire_program_, eye, mesh, 2e-5f);
  }
  Pixels ask(const TextureView& v, const FeedbackGrid& grid, double extra_bias = 0) {
    EXPECT_TRUE(pass_.issue(grid, ++tag_, [&] {
      program_.use();
      patches_.bindInstances(program_, 3);
      surface_.bind(program_, 4);
      setShadingUniforms(program_, {.format = &manifest_.texture,
                                    .domain = &manifest_.domain,
                                    .lod_bias = v.lod_bias + extra_bias,
                                    .sample = {grid.scale, grid.offset.x, grid.offset.y}});
      screen_.draw(false);
    }));
    auto pixels = pass_.wait();
    EXPECT_EQ(pass_.tag(), tag_);
    return {pixels.begin(), pixels.end()};
  }

 private:
  EyeFrame setView(const TextureView& v) {
    ViewTransform view;
    view.clip_from_world = v.clip_from_world;
    view.eye_mm = v.eye_mm;
    view.pixels_per_radian = v.pixels_per_radian;
    view.near_mm = v.near_mm;
    LodView lod = lodViewFrom(view);
    lod.relief = false;
    MadeUpOracle oracle(manifest_.domain.flat(), 1);
    auto instances = selectPlanarLod(manifest_.domain.flat(), oracle, lod, {}).instances;
    const EyeFrame eye = eyeFrame(view, manifest_.domain, 1, false, surface_.depthMode());
    patches_.setInstances(instances, eye, false, [](const NodeId&) { return kNoSlot; });
    return eye;
  }
  void link(gl::Program& program, const gl::Program::Source& source) {
    auto linked = gl::Program::link(gltest::api(), source);
    EXPECT_TRUE(linked.ok()) << (linked.ok() ? "" : linked.error().text());
    if (linked.ok()) program = std::move(*linked);
  }

  const Sampling sampling_;
  Manifest manifest_;
  gl::Program surface_program_, program_, wire_program_;
  PatchPass patches_;
  SurfaceTarget surface_;
  ScreenPass screen_;
  FeedbackPass pass_;
  uint64_t tag_ = 0;
};

struct View {
  FlatDomain domain;
  TextureView texture;
};
View randomView(Random& random, int height_px, bool orthographic = false) {
  View view;
  view.domain = randomDomain(random);
  Camera c = randomCamera(view.domain, random);
  c.aspect = 1.6;
  view.texture = textureView(c, height_px, false, orthographic);
  return view;
}

// What the pixels want, row by row from the top.
struct Truth {
  std::vector<PixelLevel> requested;
  std::set<NodeId> certain;   // some pixel wants it for sure; with ancestors
  std::set<NodeId> possible;  // some pixel may want it
  std::set<NodeId> large;     // 8 x 8 px and more want it for sure
};
Truth truthOf(const View& view) {
  const TextureView& v = view.texture;
  Rays rays(v);
  Truth t;
  std::vector<int> square(static_cast<size_t>(v.width_px), 0), above(static_cast<size_t>(v.width_px), 0);
  for (int y = 0; y < v.height_px; ++y) {
    square.swap(above);
    for (int x = 0; x < v.width_px; ++x) {
      PixelLevel node = pixelLevel(view.domain, v, rays, x, y);
      for (const NodeId& n : node.alternatives) addWithAncestors(n, t.possible);
      auto column = static_cast<size_t>(x);
      square[column] = 0;
      if (node.exact && node.certain) {
        addWithAncestors(*node.exact, t.certain);
        // The largest square of pixels that ends here and wants the same node.
        auto same = [&](size_t at) { return t.requested[at].certain && t.requested[at].exact == node.exact; };
        size_t here = t.requested.size(), width = static_cast<size_t>(v.width_px);
        square[column] = 1;
        if (x > 0 && y > 0 && same(here - 1) && same(here - width) && same(here - width - 1))
          square[column] = 1 + std::min({square[column - 1], above[column], above[column - 1]});
        if (square[column] >= 8) addWithAncestors(*node.exact, t.large);
      }
      t.requested.push_back(std::move(node));
    }
  }
  return t;
}

std::set<NodeId> nodesOf(std::span<const NodeRequest> requests) {
  std::set<NodeId> nodes;
  for (const NodeRequest& w : requests) nodes.insert(w.node);
  return nodes;
}
size_t missing(const std::set<NodeId>& wanted, const std::set<NodeId>& named) {
  size_t count = 0;
  for (const NodeId& n : wanted) count += !named.contains(n);
  return count;
}

TEST(FeedbackPass, APixelSamplesExactlyThatPixelOfThePicture) {
  Random random(kSeed);
  int certain = 0, certain_orthographic = 0, wrong = 0, wrong_unjittered = 0, wrong_bias = 0, outside = 0;
  for (int i = 0; i < 15; ++i) {
    const bool orthographic = i >= 12;  // all pixels of a flat artwork want one level: no part of the controls
    View view = randomView(random, 75 + i, orthographic);  // sizes that no scale divides
    view.texture.trilinear = i % 3 != 1;                   // else the nearest level
    FlatFeedback feedback(view.domain, depthMode(), true,
                          view.texture.trilinear ? Sampling::kTrilinear : Sampling::kBilinear);
    Truth truth = truthOf(view);
    for (int scale : {1, 3, 8, 16}) {
      for (int turn = 0; turn < scale * scale; turn += std::max(1, scale * scale / 5)) {
        FeedbackGrid grid =
            feedbackGrid(view.texture.width_px, view.texture.height_px, scale, static_cast<uint64_t>(turn));
        FeedbackGrid fixed = grid;
        fixed.offset = {};
        Pixels pixels = feedback.draw(view.texture, grid), unjittered = feedback.draw(view.texture, fixed), biased;
        if (scale == 8) biased = feedback.draw(view.texture, grid, 0.5);
        for (int row = 0; row < grid.height(); ++row) {
          for (int column = 0; column < grid.width(); ++column) {
            size_t at = static_cast<size_t>(row * grid.width() + column);
            int x = column * scale + grid.offset.x, y = view.texture.height_px - 1 - (row * scale + grid.offset.y);
            if (column >= grid.columns() || row >= grid.rows()) {
              outside += pixels[at][0] != 0;
              continue;
            }
            const PixelLevel& node = truth.requested[static_cast<size_t>(y * view.texture.width_px + x)];
            if (!node.certain) continue;
            auto agrees = [&](const std::array<uint32_t, 4>& p) {
              if (!node.exact) return p[0] == 0;
              return p == std::array<uint32_t, 4>{1u | node.exact->level << 8, node.exact->patch, node.exact->x,
                                                  node.exact->y};
            };
            ++(orthographic ? certain_orthographic : certain);
            if (!agrees(pixels[at])) {
              ++wrong;
              if (wrong < 5) ADD_FAILURE() << "view " << i << " scale " << scale << " pixel " << x << ", " << y;
            }
            wrong_unjittered += !orthographic && !agrees(unjittered[at]);
            if (!orthographic && !biased.empty()) wrong_bias += !agrees(biased[at]);
          }
        }
      }
    }
  }
  std::printf("[ feedback ] seed %llu: %d pixels compared, %d wrong; without the offset %d, half a level off %d\n",
              static_cast<unsigned long long>(kSeed), certain, wrong, wrong_unjittered, wrong_bias);
  EXPECT_EQ(wrong, 0);
  EXPECT_EQ(outside, 0) << "pixels beyond the picture ask for nothing";
  EXPECT_GT(certain, 20000);
  EXPECT_GT(certain_orthographic, 5000);
  EXPECT_GT(wrong_unjittered, certain / 100) << "negative control: always the same offset";
  EXPECT_GT(wrong_bias, 100) << "negative control: half a level too coarse";
}

// Pages of 8 x 8 px are found in one pass at 1/8, pages of one pixel in 64 passes.
TEST(FeedbackPass, OnePassFindsLargePagesAndAStillViewAll) {
  Random random(kSeed + 1);
  size_t large = 0, large_missed = 0, certain = 0, missed = 0, named = 0, needless = 0, strict_needless = 0;
  size_t unjittered_missed = 0, first_pass_missed = 0;
  const int views = longTests() ? 24 : 12;
  for (int i = 0; i < views; ++i) {
    View view = randomView(random, 180);
    view.texture.lod_bias = -1.5;  // as many pages as three times the size would have
    FlatFeedback feedback(view.domain);
    Truth truth = truthOf(view);
    FeedbackAnalyzer analyzer;
    RequestMemory memory, fixed_memory;
    std::set<NodeId> seen, fixed;
    for (uint64_t turn = 0; turn < 64; ++turn) {
      FeedbackGrid grid = feedbackGrid(view.texture.width_px, view.texture.height_px, 8, turn);
      auto requests = analyzer.analyze(feedback.draw(view.texture, grid), grid.width(), grid.height());
      if (turn % 21 == 0) {  // any one pass
        large += truth.large.size();
        large_missed += missing(truth.large, nodesOf(requests));
        first_pass_missed += missing(truth.certain, nodesOf(requests));
      }
      seen = nodesOf(memory.add(requests, 1, 64));
      if (turn % 16 == 0)
        fixed.merge(nodesOf(analyzer.analyze(
            feedback.draw(view.texture, feedbackGrid(view.texture.width_px, view.texture.height_px, 8, 0)),
            grid.width(), grid.height())));
    }
    certain += truth.certain.size();
    size_t here = missing(truth.certain, seen);
    missed += here;
    EXPECT_EQ(here, 0u) << "view " << i << " of seed " << kSeed + 1;
    unjittered_missed += missing(truth.certain, fixed);
    named += seen.size();
    needless += missing(seen, truth.possible);
    strict_needless += missing(seen, truth.certain);
  }
  std::printf(
      "[ feedback ] seed %llu, %d views: of %zu pages of 8x8 px and more one pass missed %zu; of %zu pages 64 passes "
      "missed %zu, "
      "named %zu, needless %zu (%zu within the slack): precision %.2f %%; one pass missed %zu of %zu, 64 passes "
      "without jitter %zu\n",
      static_cast<unsigned long long>(kSeed + 1), views, large, large_missed, certain, missed, named, needless,
      strict_needless - needless, 100 - 100.0 * static_cast<double>(strict_needless) / static_cast<double>(named),
      first_pass_missed, 4 * certain, unjittered_missed);
  EXPECT_EQ(large_missed, 0u);
  EXPECT_GT(large, 500u * static_cast<unsigned>(views) / 24);
  EXPECT_EQ(missed, 0u);
  EXPECT_EQ(needless, 0u);
  EXPECT_LE(static_cast<double>(strict_needless), 0.01 * static_cast<double>(named)) << "precision of 99 %";
  EXPECT_GT(first_pass_missed, 20u) << "negative control: one pass does not see small pages";
  EXPECT_GT(unjittered_missed, 5u) << "negative control: nor do 64 passes without jitter";
}

// ---- gradients that are none
// A full-screen triangle whose texture coordinates are what a test says, seen by the surface and feedback shaders.
struct BrokenGradient {
  const char* name;
  const char* uv;  // GLSL: of the corner p, 0..2
};
uint32_t askedLevel(const BrokenGradient& g, bool guarded, bool anisotropic, bool* drawn) {
  const std::string vertex = std::string(
                                 "out vec2 v_uv;\nflat out uvec2 v_instance;\nuniform vec4 u_value;\n"
                                 "void main() {\n"
                                 "  vec2 p = vec2(float((gl_VertexID & 1) << 1), float(gl_VertexID & 2));\n"
                                 "  v_instance = uvec2(1u | (1u << 28u), 0u);\n"
                                 "  gl_Position = vec4(p * 2.0 - 1.0, 0.5, 1.0);\n  ") +
                             g.uv + "\n}\n";
  std::string gradient(shaderSource("gradient.glsl")), surface_shader(shaderSource("surface.frag"));
  std::string lookup(shaderSource("texture_lookup.glsl")), feedback_shader(shaderSource("feedback.frag"));
  if (!guarded) {
    const std::string guard = "squared > 1e-12 && squared < 1e24";
    size_t at = gradient.find(guard);
    EXPECT_NE(at, std::string::npos);
    gradient.replace(at, guard.size(), "true");
  }
  auto paste = [](std::string& text, const std::string& file, const std::string& in_its_place) {
    const std::string include = "#include \"" + file + "\"";
    text.replace(text.find(include), include.size(), in_its_place);
  };
  paste(surface_shader, "gradient.glsl", gradient);
  paste(lookup, "gradient.glsl", gradient);
  paste(feedback_shader, "texture_lookup.glsl", lookup);
  FlatDomain domain;
  domain.width_px = domain.height_px = 1 << 20;
  domain.texture_depth = 13;
  Manifest manifest;
  manifest.domain = domain;
  Scene scene;
  scene.relief = false;
  scene.sampling = anisotropic ? Sampling::kAnisotropic : Sampling::kTrilinear;
  const auto defines = planEffects(scene, manifest).defines();
  auto surface_program = gl::Program::linkTexts(gltest::api(), {"broken.vert", vertex},
                                                {"surface.frag", surface_shader}, {"", "", defines, {}, {}});
  auto program = gl::Program::linkTexts(gltest::api(), {"screen.vert", std::string(shaderSource("screen.vert"))},
                                        {"feedback.frag", feedback_shader}, {"", "", defines, {"a_corner"}, {}});
  EXPECT_TRUE(surface_program.ok()) << (surface_program.ok() ? "" : surface_program.error().text());
  EXPECT_TRUE(program.ok()) << (program.ok() ? "" : program.error().text());
  if (!program.ok() || !surface_program.ok()) return 0;
  gl::VertexArray none = gl::VertexArray::create();
  SurfaceTarget surface;
  surface.resize(16, 16, anisotropic);
  surface.begin();
  surface_program->use();
  setShadingUniforms(*surface_program, {.format = &manifest.texture, .domain = &manifest.domain});
  glUniform4f(surface_program->uniform("u_value"), 0.0f, 3e38f, std::numeric_limits<float>::infinity(),
              std::numeric_limits<float>::quiet_NaN());
  glBindVertexArray(none.id());
  glDrawArrays(GL_TRIANGLES, 0, 3);
  glBindVertexArray(0);
  PatchPass nodes;  // of an empty list: node 0, level 0
  nodes.setInstances({}, {}, false, [](const NodeId&) { return kNoSlot; });
  ScreenPass screen;
  FeedbackPass pass(gltest::context().info().software);
  FeedbackGrid grid = feedbackGrid(16, 16, 1, 0);
  EXPECT_TRUE(pass.issue(grid, 0, [&] {
    program->use();
    nodes.bindInstances(*program, 3);
    surface.bind(*program, 4);
    setShadingUniforms(*program, {.format = &manifest.texture, .domain = &manifest.domain});
    screen.draw(false);
  }));
  auto pixels = pass.wait();
  uint32_t finest = 0;
  *drawn = true;
  for (const auto& p : pixels) {
    *drawn = *drawn && p[0] != 0;
    finest = std::max(finest, p[0] >> 8 & 0xFFu);
  }
  return finest;
}

constexpr BrokenGradient kBroken[] = {
    {"zero", "v_uv = vec2(0.25);"},
    {"zero, on a corner", "v_uv = vec2(0.0);"},
    {"overflowing", "v_uv = p * u_value.y;"},
    {"infinite", "v_uv = p * u_value.z;"},
    {"not a number", "v_uv = vec2(u_value.w);"},
    {"a corner at infinity", "v_uv = gl_VertexID == 1 ? vec2(u_value.z) : p;"},
    {"a corner that is not a number", "v_uv = gl_VertexID == 1 ? vec2(u_value.w) : p;"},
    {"collapsed along both axes but for rounding", "v_uv = vec2(0.3) + p * 1e-20;"},
};

TEST(FeedbackPass, BrokenGradientsNeverAskForTheFinestLevel) {
  for (bool anisotropic : {false, true}) {
    for (const BrokenGradient& g : kBroken) {
      bool drawn = false;
      EXPECT_EQ(askedLevel(g, true, anisotropic, &drawn), 0u)
          << g.name << (anisotropic ? ", anisotropic" : "") << " asks for the coarsest level";
      EXPECT_TRUE(drawn) << g.name;
    }
    bool drawn = false;
    EXPECT_EQ(askedLevel({"fine", "v_uv = p * 1e-5;"}, true, anisotropic, &drawn), 13u)
        << "a sound gradient may ask for the finest level";
  }
}

TEST(FeedbackPass, NegativeControlWithoutTheGuardAZeroGradientAsksForTheFinest) {
  bool drawn = false;
  EXPECT_EQ(askedLevel(kBroken[0], false, false, &drawn), 13u);
}

// Geometry that is degenerate as a whole: no view of any kind may make the pass name what is not there, or hang.
TEST(FeedbackPass, DegenerateViewsNameNothingThatIsNotThere) {
  Random random(kSeed);
  View good = randomView(random, 60);
  const FlatDomain& d = good.domain;
  FlatFeedback feedback(d);
  FeedbackAnalyzer analyzer;
  FeedbackGrid whole = feedbackGrid(good.texture.width_px, good.texture.height_px, 1, 0);
  EXPECT_FALSE(analyzer.analyze(feedback.draw(good.texture, whole), whole.width(), whole.height()).empty())
      << "does the sound view name any?";
  const double nan = std::nan("");
  std::vector<std::function<void(TextureView&)>> bad = {
      [&](TextureView& v) { v.clip_from_world = glm::dmat4(0); },            // w = 0 everywhere
      [&](TextureView& v) { v.clip_from_world[3] = v.clip_from_world[2]; },  // singular
      [&](TextureView& v) { v.clip_from_world[0] = glm::dvec4(0); },         // collapsed to a line
      [&](TextureView& v) { v.clip_from_world[1][3] = nan; },
      [&](TextureView& v) { v.clip_from_world *= 1e30; },
      [&](TextureView& v) { v.eye_mm.z = 0; },
  };
  for (size_t i = 0; i < bad.size(); ++i) {
    TextureView v = good.texture;
    bad[i](v);
    FeedbackGrid grid = feedbackGrid(v.width_px, v.height_px, 8, i);
    for (const NodeRequest& w : analyzer.analyze(feedback.draw(v, grid), grid.width(), grid.height()))
      EXPECT_TRUE(d.nodeExists(w.node)) << i;
  }
}

// The surface buffer is not cleared: what an earlier view left there is not seen.
TEST(FeedbackPass, AsksForNothingWhereNothingIsSeen) {
  Random random(kSeed);
  const View good = randomView(random, 60);
  View nothing = good;
  nothing.texture.clip_from_world = glm::dmat4(0);
  const int width_px = good.texture.width_px, height_px = good.texture.height_px;
  const FeedbackGrid whole = feedbackGrid(width_px, height_px, 1, 0);
  auto count = [](const Pixels& pixels) {
    return std::count_if(pixels.begin(), pixels.end(), [](const auto& p) { return p[0] != 0; });
  };
  auto asked = [&](FlatFeedback& feedback, const View& view) { return count(feedback.draw(view.texture, whole)); };
  for (bool reversed : {true, false}) {
    FlatFeedback feedback(good.domain, depthMode(reversed));
    EXPECT_GT(asked(feedback, good), 0);
    EXPECT_EQ(asked(feedback, nothing), 0) << depthName(reversed);
    feedback.drawOver(good.texture, width_px, height_px, PatchPass::Mesh::kLines);
    EXPECT_EQ(count(feedback.ask(good.texture, whole)), 0) << "a wireframe over the picture is not the surface";
    feedback.drawOver(good.texture, width_px, height_px, PatchPass::Mesh::kFull);
    EXPECT_GT(count(feedback.ask(good.texture, whole)), 0) << "negative control: what writes depth is seen";
  }
  FlatFeedback blind(good.domain, depthMode(), false);
  EXPECT_GT(asked(blind, good), 0);
  EXPECT_GT(asked(blind, nothing), 0) << "negative control: without a look at depth the earlier view is still there";
}

// ---- the engine
std::unique_ptr<Engine> engineFor(const Artwork& artwork, const OrbitCamera& camera, RequestSource how, bool relief) {
  Scene scene;
  scene.relief = relief;
  EngineOptions options;
  options.request_source = how;
  options.cache_mib = 64;
  auto engine = test::makeEngine(artwork, scene, options, 240, 135);
  if (engine) engine->setCamera(camera);
  return engine;
}
OrbitCamera cameraAt(int place, const Artwork& artwork) {
  OrbitCamera camera = fitCamera(artwork.manifest.domain.flat(), 240, 135);
  camera.azimuth_deg = -80 + 65 * place;
  camera.elevation_deg = 20 * place - 30;
  camera.distance_mm *= 0.1 + 0.15 * place;
  return camera;
}
std::set<NodeId> settledRequests(Engine& e) {
  EXPECT_TRUE(e.settle(60).ok());
  return nodesOf(e.textureRequests());
}
// Frames until all relief has come and `frames` more were seen.
std::set<NodeId> stillRequests(Engine& e, int frames) {
  int k = 0;
  auto frame = [&] {
    e.frame(++k * 0.016);
    e.readPixels();  // waits for the picture, so that every frame's feedback counts
  };
  do frame();
  while (k < 2000 && e.stats().missing_pages > 0);
  for (int i = 0; i < frames; ++i) frame();
  return nodesOf(e.textureRequests());
}

// Of the first frame after settling; of a GPU, which answers late, of one of the next hundred.
uint32_t drawCallsOnceSettled(Engine& e) {
  const int most = gl::currentContextInfo().software ? 1 : 100;
  e.frame(100);
  for (int more = 1; more < most && e.stats().draw_calls != 1; ++more) e.frame(100 + more);
  return e.stats().draw_calls;
}

TEST(EngineRequestSource, AStillCameraFindsWhatSettlingFinds) {
  TemporaryFolder folder;
  std::string why;
  auto package = noisePackage(folder, 1500, 1000, Basis::kColour, 8, 5, &why);
  ASSERT_TRUE(package) << why;
  Artwork artwork = artworkFromPackage(package);
  for (bool relief : {false, true}) {
    size_t full = 0, missed = 0, extra = 0, early = 0;
    for (int i = 0; i < 3; ++i) {
      const OrbitCamera camera = cameraAt(i, artwork);
      auto settled = engineFor(artwork, camera, RequestSource::kFeedback, relief),
           still = engineFor(artwork, camera, RequestSource::kFeedback, relief);
      ASSERT_TRUE(settled && still);
      std::set<NodeId> wanted = settledRequests(*settled), seen = stillRequests(*still, 4);
      early += missing(wanted, seen);
      // The first is not known to be still, the last three are under way; a GPU that others use is late with some.
      const bool late = !gl::currentContextInfo().software;
      seen = stillRequests(*still, (late ? 2 * 64 : 64) + 4);
      full += wanted.size();
      missed += missing(wanted, seen);
      extra += missing(seen, wanted);
      EXPECT_EQ(drawCallsOnceSettled(*settled), 1u) << "a settled view is shaded: neither geometry nor feedback";
      EXPECT_EQ(nodesOf(settled->textureRequests()), wanted) << "nor forgets what it wants";
      auto geometry = engineFor(artwork, camera, RequestSource::kGeometry, relief),
           both = engineFor(artwork, camera, RequestSource::kBoth, relief);
      std::set<NodeId> named = settledRequests(*geometry);
      EXPECT_EQ(missing(wanted, named), 0u) << "geometry never misses a page";
      EXPECT_EQ(settledRequests(*both), named) << "a superset of the feedback's";
      auto has = [](const Engine& e) {
        auto p = e.stats().passes;
        return std::count(p.begin(), p.end(), "feedback");
      };
      EXPECT_EQ(has(*geometry), 0);
      EXPECT_EQ(has(*both), 1);
      EXPECT_TRUE(relief || static_cast<double>(missing(named, wanted)) <= 0.03 * static_cast<double>(named.size()));
    }
    std::printf(
        "[ feedback ] %s: of %zu pages that the full size wants, frames at 1/8 miss %zu and name %zu more; the "
        "first frames miss %zu\n",
        relief ? "relief" : "flat", full, missed, extra, early);
    EXPECT_EQ(missed, 0u);
    EXPECT_EQ(extra, 0u);
  }
}

TEST(EngineRequestSource, WhatIsSettledDoesNotDependOnTheOrderOfPages) {
  TemporaryFolder folder;
  std::string why;
  auto package = noisePackage(folder, 1500, 1000, Basis::kColour, 8, 5, &why);
  ASSERT_TRUE(package) << why;
  const Artwork artwork = artworkFromPackage(package);
  for (int i = 0; i < 3; ++i) {
    const OrbitCamera camera = cameraAt(i, artwork);
    auto first = engineFor(artwork, camera, RequestSource::kFeedback, true);
    ASSERT_TRUE(first);
    const std::set<NodeId> wanted = settledRequests(*first);
    for (uint64_t seed = kSeed; seed < kSeed + 8; ++seed) {
      Artwork slow = artwork;
      slow.source = std::make_shared<RateLimitedSource>(artwork.source, RateLimitedSource::Limits{0, 0, 10}, seed);
      auto engine = engineFor(slow, camera, RequestSource::kFeedback, true);
      ASSERT_TRUE(engine);
      EXPECT_EQ(settledRequests(*engine), wanted) << "seed " << seed;
      EXPECT_EQ(engine->instances(), first->instances()) << "seed " << seed;
      EXPECT_EQ(drawCallsOnceSettled(*engine), 1u) << "what was asked for is what is drawn";
    }
  }
}

TEST(EngineRequestSource, PicturesAreTheSameWhateverTheMethod) {
  TemporaryFolder folder;
  std::string why;
  auto package = noisePackage(folder, 1500, 1000, Basis::kColour, 8, 6, &why);
  ASSERT_TRUE(package) << why;
  Artwork artwork = artworkFromPackage(package);
  OrbitCamera camera = fitCamera(artwork.manifest.domain.flat(), 320, 180);
  camera.azimuth_deg = 60;
  camera.distance_mm *= 0.5;
  std::vector<uint8_t> first;
  for (RequestSource how : {RequestSource::kFeedback, RequestSource::kGeometry, RequestSource::kBoth}) {
    EngineOptions options;
    options.request_source = how;
    options.cache_mib = 64;
    auto engine = Engine::create(artwork, {}, options);
    ASSERT_TRUE(engine.ok());
    (*engine)->resize(320, 180);
    (*engine)->setCamera(camera);
    ASSERT_TRUE((*engine)->settle(60).ok());
    std::vector<uint8_t> picture = (*engine)->readPixels();
    if (first.empty()) first = picture;
    size_t different = 0;
    int most = 0;
    for (size_t k = 0; k < picture.size(); ++k) {
      different += picture[k] != first[k];
      most = std::max(most, std::abs(picture[k] - first[k]));
    }
    EXPECT_EQ(different, 0u) << "up to " << most << "/255";
  }
}

}  // namespace feedback_gltest
}  // namespace relievo::test
