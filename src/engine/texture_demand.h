// texture_demand.h - which texture pages the drawn view needs: from the feedback pass, from the geometry, or from both
// (request_source.h). Needs a current GL context.
//
// A feedback pass sees one pixel of each block of scale x scale; over scale^2 passes (times the phases of anisotropic
// taps) a still view has been seen as a whole. Results arrive frames later, without a wait; those of one view add up
// (texturing/stream/request_memory.h), and a still view asks for no more passes once it has been seen.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "geometry/lod/texture_select.h"
#include "src/engine/drawn_surface.h"
#include "src/engine/effect_plan.h"
#include "src/engine/request_source.h"
#include "src/render/feedback_pass.h"
#include "texturing/stream/feedback.h"
#include "texturing/stream/request_memory.h"

namespace relievo {

class TextureDemand {
 public:
  // Results of equal views add up; any difference makes it another view.
  struct View {
    DrawnSurface surface;
    double lod_bias = 0;
    Sampling sampling = Sampling::kTrilinear;
    int anisotropy = 1;
    friend bool operator==(const View&, const View&) = default;
  };
  // Draws the pixels that the grid picks; tap_phase: shaders/feedback.frag.
  using Draw = std::function<void(const FeedbackGrid& grid, int tap_phase)>;

  // domain outlives it.
  TextureDemand(RequestSource source, int scale, bool software_gl, const PatchDomain& domain)
      : source_(source), scale_(scale), pass_(software_gl), analyzer_(&domain) {}

  bool usesFeedback() const { return source_ != RequestSource::kGeometry; }
  bool usesGeometry() const { return source_ != RequestSource::kFeedback; }

  // The newest list: each node once, coarse before fine.
  const std::vector<NodeRequest>& requests() const { return requests_; }
  // The detail bias that the feedback's part was drawn with.
  double bias() const { return bias_; }

  // Forgets everything: other planes are shown.
  void reset();
  // Replaces the geometry's part of the list.
  void takeGeometry(std::span<const TextureRequest> requests);
  // Sets the whole list until the next result of feedback or geometry.
  void expect(std::span<const TextureRequest> requests);
  // Takes all finished feedback results. None is lost, so that a still view has seen every pixel after scale^2 passes.
  void takeFinished(int phases);
  // Issues one more pass, unless every pixel of the view was seen.
  void step(const View& view, int phases, const Draw& draw);
  // Issues passes over every pixel of the view and waits for them. meanwhile: called before each wait but the first,
  // while passes are drawn, with what those before ask for.
  using Meanwhile = std::function<void(std::span<const NodeRequest> so_far)>;
  void takeAll(const View& view, int phases, const Draw& draw, const Meanwhile& meanwhile);

 private:
  void follow(const View& view);
  uint64_t passesOfStillView(int phases) const;
  bool issue(int scale, const Draw& draw, int tap_phase);
  void unite();

  RequestSource source_;
  int scale_;
  FeedbackPass pass_;
  FeedbackAnalyzer analyzer_;
  RequestMemory memory_;
  View view_;
  uint64_t view_number_ = 0;
  uint64_t passes_ = 0;                    // of this view
  uint64_t turn_ = 0;                      // which pixel of each block is next
  std::array<double, 64> bias_of_view_{};  // the detail bias of the last 64 views, by view number
  double bias_ = 0;
  std::vector<NodeRequest> feedback_, geometry_, requests_;  // the third is the union of the others
};

}  // namespace relievo
