// engine.h - one artwork on screen: pages in, frames out, with or without a window. Needs a current GL context on the
// thread that calls it and always draws into its own framebuffer. A frame never waits for disk, decoder or LOD worker,
// but for the patch list where there is none to draw yet: the first frame, and the first one after a scene's other
// planes were gone over to.
//
// A frame: take the finished feedback; hand over requests; place decoded pages and upload them within the budget; take
// the newest LOD answer and post the camera to the LOD worker; draw the surface if it changed; shade it; issue the next
// feedback.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "geometry/lod/planar_lod.h"
#include "src/base/result.h"
#include "src/engine/effect_plan.h"
#include "src/engine/upload_choice.h"
#include "src/gl/context.h"
#include "src/render/camera.h"
#include "texturing/package/package.h"
#include "texturing/package/page_failures.h"
#include "texturing/package/patch_tails.h"
#include "texturing/stream/page_streamer.h"

namespace relievo {

// What the engine shows; a package fills it (artworkFromPackage), tests may use a procedural source.
struct Artwork {
  Manifest manifest;
  std::shared_ptr<const PageSource> source;
  std::shared_ptr<const ReliefOracle> oracle;
  // Over a base mesh: what of each patch needs no page, if the source has it at hand (else it is made of the root
  // pages, all of them). What had to be made up is named in problems.
  std::function<PatchTails(int workers, std::vector<std::string>* problems)> tails;
};
// Once *stop is set (it may be null), its tails are no longer read and not to be used.
Artwork artworkFromPackage(std::shared_ptr<const Package> package, const std::atomic<bool>* stop = nullptr);
// Of what is drawn, with heights times exaggerate; of a flat artwork its plane (min and max of z are 0).
Extent artworkExtent(const Manifest& manifest, double exaggerate = 1);

// How the texture pages that a view wants are found. kFeedback: a small picture of requests, read back
// (src/render/feedback_pass.h). kGeometry: from the view and the heights' bounds on the LOD worker, without a pass
// (geometry/lod/texture_select.h); exact for flat artworks, too fine at a slant with relief. kBoth: the union. Over a
// base mesh it is kFeedback, whatever is asked for.
enum class RequestSource { kFeedback, kGeometry, kBoth };

struct EngineOptions {
  double cache_mib = 256;  // all planes together, and the patches' tails
  // Artworks over a base mesh of more patches than this pin no page: their patches' tails do for the roots
  // (texturing/package/patch_tails.h).
  uint32_t most_pinned_patches = 64;
  // Over a base mesh: relief pages take less than half a slot where little is in them
  // (texturing/stream/relief_subslots.h). False: for comparison.
  bool small_relief = true;
  bool compact_relief =
      true;  // and their compact form where that takes less (texturing/codec/relief_compact.h); with small_relief
  int workers = 2;
  int feedback_scale = 8;  // 1..16: the feedback pass has 1/8 of the view's width and height
  RequestSource request_source = RequestSource::kFeedback;
  Upload upload = Upload::kAuto;
  bool hide_backs = true;  // patches of closed bodies that are seen from behind are left out
                           // (geometry/lod/facing_cone.h); the picture is the same
  bool prefetch = true;    // asks for what a moving camera is about to want (src/engine/prefetch.h); of flat artworks
  bool reversed_depth = true;  // where the context has clip control (src/render/depth.h)
  uint32_t uploads_per_frame = 64;
  const std::atomic<bool>* interrupted =
      nullptr;  // polled while starting and settling: set, create() and settle() give up
};

struct EngineStats {
  StreamerStats streamer;
  uint64_t frames = 0;
  uint32_t instances = 0, triangles = 0, draw_calls = 0;  // of the last frame
  uint32_t wanted_nodes = 0, missing_pages = 0;           // of the last request lists
  uint32_t slots = 0, resident = 0;
  PageCodec upload = PageCodec::kLossless;      // texture pages on the GPU now: a block codec, or any other for RGBA8
  std::string why_not_blocks;                   // empty: they are blocks, were not asked for, or the light is fixed
  uint64_t cache_bytes = 0, texture_bytes = 0;  // all slots together; what the GL was asked for, for them, by now
  uint64_t tail_bytes = 0;                      // on the GPU, besides the slots
  double predicted_error_px = 0;
  double detail_bias = 0;
  uint32_t edges_limited = 0;
  double lod_ms = 0;              // of the last LOD evaluation, on its worker
  LatencySummary lod_lag_frames;  // of frames that did not wait for their list: how many before it its patch list was
                                  // asked for; 1 at best
  double determine_ms = 0;        // the part of it that named texture pages; 0 with kFeedback
  double predict_ms =
      0;  // of the last predicted view's pages, on a worker of its own; 0: the camera never moved, or no prefetch
  bool switching = false;       // the scene asks for other planes, whose roots are still on the way
  bool reversed_depth = false;  // in use
  bool orthographic = false;    // the camera
  bool size_known = true;       // else mm_per_px counts the artwork's pixels
  double mm_per_px = 0;         // orthographic: everywhere in the picture; else on the plane through the target
  std::vector<std::string> passes, planes_read;
};

class Engine {
 public:
  static Result<std::unique_ptr<Engine>> create(Artwork artwork, const Scene& scene, const EngineOptions& options);
  ~Engine();

  void resize(int width_px, int height_px);
  int width() const;
  int height() const;
  void setCamera(const OrbitCamera& camera);
  const OrbitCamera& camera() const;
  // Links another shader or streams other planes where the effect plan asks for it. Never waits: relief, relight and
  // exaggerate of a scene that needs other planes show from the frame on in which those planes' roots have come
  // (settle() waits for it).
  Result<void> setScene(const Scene& scene);
  const Scene& scene() const;
  const EffectPlan& plan() const;
  const Manifest& manifest() const;

  // Draws one frame into the engine's framebuffer; now_s: seconds of a steady clock.
  void frame(double now_s);
  // Streams until every page that the view wants (by full-size feedback) is resident and the patch list is final; then
  // draws it. The picture depends on the artwork, camera and scene only. Fails after timeout_s, naming what is missing.
  Result<void> settle(double timeout_s);

  // RGBA, rows top first; alpha 0 where the artwork is not.
  std::vector<uint8_t> readPixels();
  // Copies the picture to the framebuffer that the window shows (0); dark grey beside the artwork.
  void present(int window_width_px, int window_height_px);
  // The place on the surface that a pixel (origin top left) of the last picture shows; nothing over the background.
  // Waits for that picture.
  std::optional<glm::dvec3> surfacePoint(double x_px, double y_px);
  EngineStats stats() const;
  std::vector<std::string> takeMessages();
  // Pages that pictures were drawn without since the start; takeMessages() names each of them, too.
  PageFailures failures() const;
  // What takeMessages() would say, but for those pages; cleared by the call.
  std::vector<std::string> takeNotices();
  // The list being drawn; for the reference renderer in tests.
  const std::vector<PatchInstance>& instances() const;
  const std::vector<NodeRequest>& textureRequests() const;  // the newest request list
  ViewTransform view() const;  // that the last picture was drawn with: a frame behind setCamera at most times
  // Vertices of the drawn list by transform feedback, 4 floats each (clip position), instance by instance; for the
  // watertight test.
  std::vector<float> captureVertices(uint32_t max_vertices);

  // For negative controls in tests: breaks one thing on purpose.
  struct FaultInjection {
    bool no_borders = false;  // samples are clamped to the page's payload
    bool no_snapping = false;
    bool unordered_ends = false;         // over a base mesh: a side's points are interpolated in the patch's direction
    bool draw_backs = false;             // of closed bodies, too
    bool one_lookup = false;             // taps beyond a page's border are clamped to it
    bool one_sample_a_texel = false;     // relief is read as if a texel held one sample
    bool cells_without_heights = false;  // patches that a program of their own draws as one cell
    bool narrow_residuals = false,
         flat_blocks = false;   // of relief in compact form: a bit less than there is; slopes left out
    bool call_a_patch = false;  // each instance by a draw call of its own, for comparison
  };
  Result<void> injectFaults(const FaultInjection& what);

 private:
  struct Impl;
  explicit Engine(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

std::string engineStatsJson(const EngineStats& stats, const Manifest& manifest);

}  // namespace relievo
