#include "src/engine/texture_demand.h"

#include <algorithm>
#include <utility>

namespace relievo {
namespace {

// The requests of several feedbacks of one view as one list: each node once, in the order of FeedbackAnalyzer.
std::vector<NodeRequest> unionOfRequests(std::vector<NodeRequest> requests) {
  std::sort(requests.begin(), requests.end(), [](const NodeRequest& a, const NodeRequest& b) {
    return a.node != b.node ? a.node < b.node : a.centre_distance < b.centre_distance;
  });
  requests.erase(std::unique(requests.begin(), requests.end(),
                             [](const NodeRequest& a, const NodeRequest& b) { return a.node == b.node; }),
                 requests.end());
  std::stable_sort(requests.begin(), requests.end(), [](const NodeRequest& a, const NodeRequest& b) {
    return a.node.level != b.node.level ? a.node.level < b.node.level : a.centre_distance < b.centre_distance;
  });
  return requests;
}

std::vector<NodeRequest> asNodeRequests(std::span<const TextureRequest> requests) {
  std::vector<NodeRequest> nodes;
  nodes.reserve(requests.size());
  for (const TextureRequest& r : requests) nodes.push_back({r.node, 1, r.priority});
  return nodes;
}

}  // namespace

void TextureDemand::reset() {
  memory_.clear();
  view_ = {};
  feedback_.clear();
  geometry_.clear();
  requests_.clear();
}

void TextureDemand::takeGeometry(std::span<const TextureRequest> requests) {
  geometry_ = asNodeRequests(requests);
  unite();
}

void TextureDemand::expect(std::span<const TextureRequest> requests) { requests_ = asNodeRequests(requests); }

void TextureDemand::follow(const View& view) {
  if (view == view_) return;
  view_ = view;
  passes_ = 0;
  ++view_number_;
  bias_of_view_[view_number_ % bias_of_view_.size()] = view.lod_bias;
}

uint64_t TextureDemand::passesOfStillView(int phases) const {
  const auto scale = static_cast<uint64_t>(scale_);
  return std::max<uint64_t>(scale * scale * static_cast<uint64_t>(phases), kMovingResults);
}

bool TextureDemand::issue(int scale, const Draw& draw, int tap_phase) {
  const FeedbackGrid grid = feedbackGrid(view_.surface.width, view_.surface.height, scale, turn_);
  return pass_.issue(grid, view_number_, [&] { draw(grid, tap_phase); });
}

void TextureDemand::unite() {
  if (!usesGeometry()) {
    requests_ = feedback_;
  } else if (!usesFeedback()) {
    requests_ = geometry_;
  } else {
    std::vector<NodeRequest> both = feedback_;
    both.insert(both.end(), geometry_.begin(), geometry_.end());
    requests_ = unionOfRequests(std::move(both));
  }
}

void TextureDemand::takeFinished(int phases) {
  bool any = false;
  for (auto pixels = pass_.poll(); !pixels.empty(); pixels = pass_.poll()) {
    const auto results = static_cast<uint32_t>(passesOfStillView(phases) + 1);
    const double bias = bias_of_view_[pass_.tag() % bias_of_view_.size()];
    // The streamer would judge a bias by what another one asked for.
    if (bias != bias_) memory_.clear();
    bias_ = bias;
    const auto found = memory_.add(analyzer_.analyze(pixels, pass_.width(), pass_.height()), pass_.tag(), results);
    feedback_.assign(found.begin(), found.end());
    any = true;
  }
  if (any) unite();
}

void TextureDemand::step(const View& view, int phases, const Draw& draw) {
  follow(view);
  if (passes_ >= passesOfStillView(phases)) return;
  const auto scale = static_cast<uint64_t>(scale_);
  if (!issue(scale_, draw, static_cast<int>(turn_ / (scale * scale) % static_cast<uint64_t>(phases)))) return;
  ++turn_;
  ++passes_;
}

void TextureDemand::takeAll(const View& view, int phases, const Draw& draw, const Meanwhile& meanwhile) {
  constexpr int kBlock = 2, kTurns = kBlock * kBlock;  // in quarters: smaller buffers stay in the processor's caches
  std::vector<NodeRequest> found;
  follow(view);
  pass_.wait();  // all targets are free
  // While one is read, the next ones are drawn.
  auto issueNext = [&](int pass) {
    turn_ = static_cast<uint64_t>(pass % kTurns);
    return issue(kBlock, draw, pass / kTurns);
  };
  const int passes = kTurns * phases;
  for (int issued = 0, taken = 0; taken < passes; ++taken) {
    while (issued < passes && issueNext(issued)) ++issued;
    if (taken > 0) meanwhile(found);
    const auto part = analyzer_.analyze(pass_.waitForNext(), pass_.width(), pass_.height());
    found.insert(found.end(), part.begin(), part.end());
  }
  turn_ = kTurns;
  feedback_ = unionOfRequests(std::move(found));
  memory_.clear();
  memory_.add(feedback_, view_number_, 1);
  passes_ = passesOfStillView(phases);  // frames of this view have nothing to add
  bias_ = view.lod_bias;
  unite();
}

}  // namespace relievo
