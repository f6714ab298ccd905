// engine.h - one artwork on screen: pages in, frames out, with or without a window. Needs a current GL context on the
// thread that calls it and always draws into its own framebuffer. A frame never waits for disk, decoder or LOD worker.
// It waits for a patch list only where there is none to draw yet: in the first frame, and in the first one after a
// change to other planes. Of a flat artwork that frame requests what the view's geometry suggests, before it draws, and
// issues no feedback: so its picture, of the roots, comes sooner, and so do the pages.
//
// A frame: take the finished feedback; hand over requests; place decoded pages and upload them within the budget; take
// the newest LOD answer and post the camera to the LOD worker; draw the surface if it changed; issue the next feedback;
// shade the surface, unless the picture is the average of several samples and still shows the same.
//
// Camera, lights and surfacePoint() are in the world; everything else of the engine is in the artwork's own space
// (src/render/pose.h), which is the world where Scene::pose is off.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "geometry/lod/lod.h"
#include "src/base/result.h"
#include "src/engine/artwork.h"
#include "src/engine/effect_plan.h"
#include "src/engine/engine_stats.h"
#include "src/engine/request_source.h"
#include "src/engine/upload_choice.h"
#include "src/gl/context.h"
#include "src/render/camera.h"
#include "src/render/picture_target.h"
#include "texturing/package/package.h"
#include "texturing/package/page_failures.h"
#include "texturing/stream/feedback.h"

namespace relievo {

inline constexpr int kMaxFeedbackInterval = 16;
inline constexpr double kSpareCacheMib = 64;

inline constexpr double kMostCacheMib = 1280;  // of programs where nobody named a size

struct EngineOptions {
  double cache_mib = 256;  // all planes together, and the patches' tails
  // An artwork that needs more than cache_mib, as those of many patches do, gets what it needs and kSpareCacheMib, up
  // to so many; at most cache_mib: none does.
  double most_cache_mib = 0;
  // Artworks over a base mesh of more patches than this pin no page: the patches' tails take the place of their root
  // pages (texturing/package/patch_tails.h). So do those with patches that have no root page.
  uint32_t most_pinned_patches = 64;
  // Over a base mesh: relief pages of few samples take less than half a slot (texturing/stream/relief_subslots.h).
  // False serves for comparison.
  bool small_relief = true;
  // With small_relief: relief pages take their compact form where that is smaller (texturing/codec/relief_compact.h).
  bool compact_relief = true;
  int workers = 2;
  int feedback_scale = 8;  // 1..16: the feedback pass has 1/8 of the view's width and height
  int feedback_interval =
      1;  // frames from one feedback pass to the next, 1..kMaxFeedbackInterval; settle() waits for none
  RequestSource request_source = RequestSource::kFeedback;
  Upload upload = Upload::kAuto;
  // Back-facing patches of closed bodies are left out (geometry/lod/facing_cone.h); the picture is the same.
  bool hide_backs = true;
  bool prefetch = true;  // requests what a moving camera will show next (src/engine/prefetch.h); flat artworks only
  bool reversed_depth = true;  // where the context has clip control (src/render/depth.h)
  uint32_t uploads_per_frame = 64;
  // The nearest depth of a picture's samples is kept, for Layer::depth.
  bool keep_depth = false;
  const std::atomic<bool>* interrupted = nullptr;  // polled: once set, create() and settle() give up
};

inline bool drawnWithTails(const PatchDomain& domain, uint32_t most_pinned_patches) {
  return !domain.isFlat() && (domain.patchCount() > most_pinned_patches || domain.hasUntexturedPatch());
}

struct FaultInjection;

// Bytes of the page cache: the least that an engine can be made with, and what all pages of the artwork take. Tails
// count with what they take at most, as long as they are not read.
struct CacheNeed {
  uint64_t least_bytes = 0, most_bytes = 0;
};
// options.cache_mib, or where more is needed that and kSpareCacheMib, which the notice tells of. kUsage: that is beyond
// options.most_cache_mib. several: what needs it are artworks.
Result<double> cacheMibFor(uint64_t least_bytes, const EngineOptions& options, bool several,
                           std::vector<std::string>& notices);

class Engine {
 public:
  // Of an engine of this artwork and scene. Needs a current GL context.
  static Result<CacheNeed> cacheNeed(const Artwork& artwork, const Scene& scene, const EngineOptions& options);
  static Result<std::unique_ptr<Engine>> create(Artwork artwork, const Scene& scene, const EngineOptions& options);
  ~Engine();

  void resize(int width_px, int height_px);
  int width() const;
  int height() const;
  void setCamera(const OrbitCamera& camera);
  const OrbitCamera& camera() const;
  // Links another shader or streams other planes where the effect plan asks for it. Never waits: where a scene needs
  // other planes, its relief, relight, lights, gloss, exaggerate and shading show as soon as the roots of those planes
  // are resident (settle() waits for them).
  Result<void> setScene(const Scene& scene);
  const Scene& scene() const;
  const EffectPlan& plan() const;
  const Manifest& manifest() const;
  PlacedExtent placed() const;  // what is drawn, and where it stands

  // Draws one frame into the engine's framebuffer; now_s: seconds of a steady clock. One sample a pixel; but what
  // settle() or refine() averaged stays while it shows the same view, scene and pages.
  void frame(double now_s);
  // With lights that have a size or ambient occlusion: draws the last frame's picture once more, with some more of the
  // directions that light comes from. With Scene::samples above 1 through the next sample of its pixels, once the one
  // before has all directions, and shows the average of the samples so far. Pages that are blending in show whole.
  // False: nothing was drawn, since all samples and directions are in. Call it in place of frame() while nothing
  // changes: it streams nothing.
  bool refine(double now_s);
  // Streams until every page that the view wants (by full-size feedback) is resident and the patch list is final; then
  // draws it, with all samples of the scene and all directions of its light. The picture depends on the artwork, camera
  // and scene only. Samples ask for no further page: where one needs a page that no pixel's centre does, its ancestor
  // shows. refined false: draws it as frame() does, which is quicker. Fails after timeout_s, naming what is missing; at
  // once where even the coarsest view that the cache can be given wants pages without a place in it.
  Result<void> settle(double timeout_s, bool refined = true);

  // RGBA, sRGB, rows top first; alpha 0 where the artwork is not. With several samples alpha is the share of them that
  // show the artwork, and the colour is their average (not multiplied by alpha).
  std::vector<uint8_t> readPixels();
  // Copies the picture to the framebuffer that the window shows (0); dark grey beside the artwork.
  void present(int window_width_px, int window_height_px);
  // The place on the surface that a pixel (origin top left) of the last picture shows, of several samples the last one;
  // nothing over the background. In the world, mm. Waits for that picture.
  std::optional<glm::dvec3> surfacePoint(double x_px, double y_px);
  // The last picture as readPixels() has it, on the GPU, to be put together with others (src/render/composition.h).
  // Valid until the next call of a function that draws. With several samples it needs EngineOptions::keep_depth.
  struct Layer {
    const PictureTarget& picture;
    GLuint depth;  // a texture
    DepthMode depth_mode;
    ViewTransform view;  // its near and far planes
  };
  Layer layer();
  EngineStats stats() const;
  std::vector<std::string> takeMessages();
  // Pages that pictures were drawn without since the start; takeMessages() names each of them, too.
  PageFailures failures() const;
  // What takeMessages() would say, without those pages; cleared by the call.
  std::vector<std::string> takeNotices();
  // The list being drawn; for the reference renderer in tests.
  const std::vector<PatchInstance>& instances() const;
  const std::vector<NodeRequest>& textureRequests() const;  // the newest request list
  // The one the last picture was drawn with, through the pixels' centres and in the artwork's space: mostly a frame
  // behind setCamera.
  ViewTransform view() const;
  // Vertices of the drawn list by transform feedback, 4 floats each (clip position), instance by instance; for the
  // watertight test.
  std::vector<float> captureVertices(uint32_t max_vertices);

 private:
  friend Result<void> injectFaults(Engine& engine, const FaultInjection& what);  // fault_injection.h
  struct Impl;
  explicit Engine(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace relievo
