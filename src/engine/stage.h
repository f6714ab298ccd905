// stage.h - the artworks of a scene in one picture: an engine each, which draws its artwork in its own pose with its
// own near and far plane, and a composition of their pictures by distance from the eye (src/render/composition.h). They
// share camera, lights and effects, and the budget of the page cache. What one hides of another is decided pixel by
// pixel; no artwork casts a shadow on another one, or hides sky from it.
//
// While the camera moves each engine shows the newest patch list that it has, so that one may be a frame behind
// another.
//
// A stage of one artwork is its engine: it draws, allocates and links nothing else. So does one of several of which
// only one is in view. An artwork that is out of view is neither streamed nor drawn.
//
// Needs a current GL context on the thread that calls it, as Engine does; functions of the same name mean the same.
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "src/engine/engine.h"

namespace relievo {

inline constexpr size_t kMostArtworks = 16;

struct StagedArtwork {
  Artwork artwork;
  Pose pose;
  std::string name;  // for messages
};

// Divides a budget, which is no smaller than what all need at least: each gets that and the same part of the rest, but
// no more than it has use for while another one has; the sum is at most the budget.
std::vector<uint64_t> shareCache(std::span<const CacheNeed> needs, uint64_t budget_bytes);
// The middle of all artworks without heights, from which near lights have their distance.
glm::dvec3 middleOf(std::span<const PlacedExtent> flat_extents);
// A scene as one of several artworks is drawn in it: in its pose, with near lights' distances from the middle of all,
// where that is given.
Scene stagedScene(const Scene& scene, const Pose& pose, const std::optional<glm::dvec3>& middle_mm);
// What is wrong with a scene of several artworks beside what sceneProblem() says of each; empty: nothing.
std::string stagedProblem(const Scene& scene, const glm::dvec3& middle_mm);
// Can the camera see any of the box that the artwork lies in?
bool isInView(const OrbitCamera& camera, const PlacedExtent& placed, int width_px, int height_px);

class Stage {
 public:
  // 1 to kMostArtworks of them. Scene::pose does not count. Errors name the artwork, where there are several.
  static Result<std::unique_ptr<Stage>> create(std::vector<StagedArtwork> artworks, const Scene& scene,
                                               const EngineOptions& options);
  ~Stage();

  size_t size() const;
  const Engine& engine(size_t i) const;
  const std::string& name(size_t i) const;
  const Pose& pose(size_t i) const;
  bool inView(size_t i) const;  // by the camera as it is
  // What is drawn of each, and where it stands.
  std::vector<PlacedExtent> placed() const;

  void resize(int width_px, int height_px);
  int width() const;
  int height() const;
  void setCamera(const OrbitCamera& camera);
  const OrbitCamera& camera() const;
  // A near light without a reference_mm has its distance from the middle of all artworks.
  Result<void> setScene(const Scene& scene);
  const Scene& scene() const;  // the last one set

  void frame(double now_s);
  bool refine(double now_s);
  // timeout_s: of each artwork.
  Result<void> settle(double timeout_s, bool refined = true);
  std::vector<uint8_t> readPixels();
  void present(int window_width_px, int window_height_px);
  // Of the artwork that is nearest to the eye at the pixel.
  std::optional<glm::dvec3> surfacePoint(double x_px, double y_px);

  // Counters and times are sums, bounds are the largest. What is of the last picture is of artworks in view alone.
  EngineStats stats() const;
  // engineStatsJson(), of several artworks with planes by name, and all of each under "artworks".
  std::string statsJson() const;
  std::vector<std::string> takeMessages();
  PageFailures failures() const;
  std::vector<std::string> takeNotices();
  uint64_t compositionBytes() const;  // on the GPU; 0 where nothing was put together

 private:
  struct Impl;
  explicit Stage(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// Of several artworks.
EngineStats sumOf(std::span<const EngineStats> all);

}  // namespace relievo
