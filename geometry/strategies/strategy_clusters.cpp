// strategy_clusters.cpp - a cut through a graph of clusters of triangles (cluster_dag.h): for each group of clusters,
// its own triangles or, where the error of their simplification is within the budget, those of the coarser clusters
// that it became. Nanite chooses so on the GPU, cluster by cluster; here the CPU walks down from the coarsest groups.
//
// A group is refined if its error, projected where its box is nearest, exceeds the budget, and every group that
// simplified one of its results was refined. Errors and boxes only grow towards the coarse end, so what is drawn keeps
// the budget: its own group's error does, or that of a group above, which is no less. Every group is drawn in one
// state, so that there are no cracks.
//
// Made when the first view asks, for all budgets at once. The finest mesh has at most kMostVertices vertices,
// else every second sample, and so on: error_px says where it is not fine enough.
#include <algorithm>
#include <string>

#include "geometry/strategies/cluster_dag.h"
#include "geometry/strategies/strategy_list.h"

namespace relievo {
namespace {

constexpr size_t kGroupClusters = 24;  // 3,000 triangles; Nanite has 8 to 32

class Clusters final : public LodStrategy {
 public:
  explicit Clusters(const StrategyScene& scene) : scene_(scene) {}

  StrategyResult select(const LodView& view) override {
    prepare(view.exaggerate);
    const ViewBounds screen(view);
    StrategyResult out;
    out.rule = GridRule::kTrianglesOnly;
    out.mesh = dag_->mesh;
    out.instances = dag_->mesh->instances;
    out.predicted_px = 0;
    refineGroups(screen, view.error_px);
    auto draw = [&](uint32_t index) {
      const Cluster& c = dag_->clusters[index];
      if ((c.producer != Cluster::kNone && refined_[c.producer]) || screen.culled(c.box)) return;
      const bool leaf = c.producer == Cluster::kNone;
      const double px = (leaf ? dag_->leaf_error_mm : dag_->groups[c.producer].error_mm) * screen.pxPerMm(c.box);
      // That of a group above is within the budget, and no less.
      out.predicted_px = std::max(out.predicted_px, leaf ? px : std::min(px, view.error_px));
      out.ranges.push_back(c.range);
    };
    for (const uint32_t c : top_) draw(c);
    for (const uint32_t g : refined_list_)
      for (const uint32_t c : dag_->groups[g].inputs) draw(c);
    joinRanges(out.ranges);
    out.error_px = std::max(view.error_px, out.predicted_px);
    return out;
  }

 private:
  void prepare(double exaggerate) {
    if (dag_ && exaggerate == exaggerate_) return;
    exaggerate_ = exaggerate;
    dag_ = scene_.preparedOnce<ClusterDag>("cluster graph", exaggerate, [&] {
      return clusterDag(FineSurface(scene_, exaggerate, kMostVertices), exaggerate, kGroupClusters, 0);
    });
    refined_.assign(dag_->groups.size(), 0);
    waiting_.resize(dag_->groups.size());
    for (size_t g = 0; g < waiting_.size(); ++g) waiting_[g] = dag_->groups[g].consumers;
    refined_list_.clear();
    top_.clear();
    for (uint32_t c = 0; c < dag_->clusters.size(); ++c)
      if (dag_->clusters[c].consumer == Cluster::kNone) top_.push_back(c);
  }
  // From the top down: a group's turn comes when all that simplified its results are refined.
  void refineGroups(const ViewBounds& screen, double budget_px) {
    for (const uint32_t g : asked_) waiting_[g] = dag_->groups[g].consumers;
    for (const uint32_t g : refined_list_) refined_[g] = 0;
    asked_.clear();
    refined_list_.clear();
    auto ask = [&](uint32_t g) {
      asked_.push_back(g);
      if (--waiting_[g] > 0) return;
      const ClusterGroup& group = dag_->groups[g];
      if (screen.culled(group.box) || group.error_mm * screen.pxPerMm(group.box) <= budget_px) return;
      refined_[g] = 1;
      refined_list_.push_back(g);
    };
    std::vector<uint32_t> tops;
    for (const uint32_t c : top_)
      if (dag_->clusters[c].producer != Cluster::kNone) tops.push_back(dag_->clusters[c].producer);
    std::sort(tops.begin(), tops.end());
    tops.erase(std::unique(tops.begin(), tops.end()), tops.end());
    for (const uint32_t g : tops) ask(g);
    for (size_t k = 0; k < refined_list_.size(); ++k)
      for (const uint32_t p : dag_->groups[refined_list_[k]].producers) ask(p);
  }
  static void joinRanges(std::vector<IndexRange>& ranges) {
    std::sort(ranges.begin(), ranges.end(), [](const IndexRange& a, const IndexRange& b) { return a.first < b.first; });
    size_t kept = 0;
    for (const IndexRange& r : ranges) {
      if (kept > 0 && ranges[kept - 1].first + ranges[kept - 1].count == r.first) ranges[kept - 1].count += r.count;
      else ranges[kept++] = r;
    }
    ranges.resize(kept);
  }

  StrategyScene scene_;
  std::shared_ptr<const ClusterDag> dag_;
  double exaggerate_ = 0;
  std::vector<uint32_t> top_;                   // clusters of which there is nothing coarser
  std::vector<uint8_t> refined_;                // by group
  std::vector<uint32_t> waiting_;               // by group: for how many above it
  std::vector<uint32_t> asked_, refined_list_;  // of the last view
};

}  // namespace

StrategyEntry clustersStrategy() {
  StrategyEntry e;
  e.name = "clusters";
  e.title = "Cluster graph";
  e.purpose =
      "clusters of 128 triangles, simplified in groups whose borders stay (Batched Multi-Triangulations, Nexus, "
      "Nanite); for each group the coarsest that keeps the budget";
  e.keeps_budget = true;
  e.make = [](const StrategyScene& scene) { return std::make_unique<Clusters>(scene); };
  return e;
}

}  // namespace relievo
