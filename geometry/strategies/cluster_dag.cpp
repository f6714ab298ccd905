#include "geometry/strategies/cluster_dag.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "geometry/strategies/encoded_parts.h"
#include "geometry/strategies/surface_simplify.h"
#include "src/base/parallel_for.h"

namespace relievo {
namespace {

using Triangles = std::vector<uint32_t>;

// Halves along the longest extent of the triangles' middles, until each part is a cluster.
void splitTriangles(const std::vector<glm::vec3>& positions, std::span<std::array<uint32_t, 3>> triangles,
                    std::vector<Triangles>& out) {
  const size_t parts = (triangles.size() + kClusterTriangles - 1) / kClusterTriangles;
  if (parts <= 1) {
    Triangles& cluster = out.emplace_back();
    for (const auto& t : triangles) cluster.insert(cluster.end(), t.begin(), t.end());
    return;
  }
  auto middle = [&](const std::array<uint32_t, 3>& t) { return positions[t[0]] + positions[t[1]] + positions[t[2]]; };
  glm::vec3 low = middle(triangles[0]), high = low;
  for (const auto& t : triangles) low = glm::min(low, middle(t)), high = glm::max(high, middle(t));
  const glm::vec3 extent = high - low;
  const int axis = extent.x >= extent.y && extent.x >= extent.z ? 0 : extent.y >= extent.z ? 1 : 2;
  const size_t first = triangles.size() * (parts / 2) / parts;
  std::nth_element(triangles.begin(), triangles.begin() + static_cast<std::ptrdiff_t>(first), triangles.end(),
                   [&](const auto& a, const auto& b) {
                     const float x = middle(a)[axis], y = middle(b)[axis];
                     return x < y || (x == y && a < b);
                   });
  splitTriangles(positions, triangles.first(first), out);
  splitTriangles(positions, triangles.subspan(first), out);
}

WorldBox unitedBox(const WorldBox& a, const WorldBox& b) {
  const glm::dvec3 low = glm::min(a.centre - a.half, b.centre - b.half),
                   high = glm::max(a.centre + a.half, b.centre + b.half);
  return {0.5 * (low + high), 0.5 * (high - low), a.any_direction};
}

// How many edges each pair of clusters shares: by cluster, its neighbours.
using SharedEdges = std::vector<std::vector<std::pair<uint32_t, uint32_t>>>;

SharedEdges sharedEdges(const FineSurface& surface, const std::vector<Triangles>& clusters) {
  std::vector<std::pair<uint64_t, uint32_t>> borders;
  std::vector<uint64_t> own;
  for (uint32_t c = 0; c < clusters.size(); ++c) {
    own.clear();
    for (size_t k = 0; k < clusters[c].size(); ++k) {
      const uint64_t a = surface.weld(clusters[c][k]), b = surface.weld(clusters[c][k % 3 == 2 ? k - 2 : k + 1]);
      own.push_back(std::min(a, b) << 32 | std::max(a, b));
    }
    std::sort(own.begin(), own.end());
    for (size_t k = 0; k < own.size(); ++k)
      if ((k == 0 || own[k - 1] != own[k]) && (k + 1 == own.size() || own[k + 1] != own[k]))
        borders.emplace_back(own[k], c);
  }
  std::sort(borders.begin(), borders.end());
  SharedEdges shared(clusters.size());
  for (size_t k = 1; k < borders.size(); ++k) {
    if (borders[k - 1].first != borders[k].first) continue;
    const uint32_t a = borders[k - 1].second, b = borders[k].second;
    for (const auto& [from, to] : {std::pair{a, b}, std::pair{b, a}}) {
      auto at = std::find_if(shared[from].begin(), shared[from].end(),
                             [&, other = to](const auto& s) { return s.first == other; });
      if (at == shared[from].end()) shared[from].emplace_back(to, 1);
      else ++at->second;
    }
  }
  return shared;
}

// Groups grow from one cluster by the neighbour that shares most edges with them. Borders between groups of the level
// before have more edges than others, since they were kept: so they come to lie inside. By cluster: its group.
std::vector<uint32_t> groupClusters(const SharedEdges& shared, size_t group_clusters) {
  const uint32_t none = Cluster::kNone;
  std::vector<uint32_t> group(shared.size(), none), sizes, edges(shared.size(), 0), touched;
  for (uint32_t seed = 0; seed < shared.size(); ++seed) {
    if (group[seed] != none) continue;
    const auto own = static_cast<uint32_t>(sizes.size());
    sizes.push_back(0);
    touched.clear();
    for (uint32_t next = seed; next != none;) {
      group[next] = own;
      ++sizes[own];
      for (const auto& [other, count] : shared[next]) {
        if (edges[other] == 0) touched.push_back(other);
        edges[other] += count;
      }
      next = none;
      if (sizes[own] == group_clusters) break;
      for (const uint32_t t : touched)
        if (group[t] == none && (next == none || edges[t] > edges[next] || (edges[t] == edges[next] && t < next)))
          next = t;
    }
    for (const uint32_t t : touched) edges[t] = 0;
  }
  // What was left over between groups joins the one that it shares most edges with.
  for (uint32_t c = 0; c < shared.size(); ++c) {
    if (2 * sizes[group[c]] >= group_clusters) continue;
    std::vector<std::pair<uint32_t, uint32_t>> with;  // group, edges
    for (const auto& [other, count] : shared[c]) {
      if (group[other] == group[c]) continue;
      auto at = std::find_if(with.begin(), with.end(), [&, g = group[other]](const auto& w) { return w.first == g; });
      if (at == with.end()) with.emplace_back(group[other], count);
      else at->second += count;
    }
    const auto most =
        std::max_element(with.begin(), with.end(), [](const auto& a, const auto& b) { return a.second < b.second; });
    if (most == with.end() || sizes[most->first] >= 2 * group_clusters) continue;
    --sizes[group[c]];
    group[c] = most->first;
    ++sizes[group[c]];
  }
  return group;
}

struct Simplified {
  std::vector<Triangles> clusters;  // empty: it could not be made much simpler
  double error_mm = 0;
};

class DagBuilder {
 public:
  DagBuilder(const FineSurface& surface, double exaggerate, size_t group_clusters, int workers)
      : surface_(surface), exaggerate_(exaggerate), group_clusters_(group_clusters), workers_(workers) {
    dag_.mesh = std::make_shared<StrategyMesh>();
    owner_.assign(surface.positions().size(), Cluster::kNone);
    kept_.assign(surface.positions().size(), 0);
  }
  ClusterDag build() {
    addLeaves();
    while (level_.size() > 1)
      if (!addLevel()) break;
    for (ClusterGroup& g : dag_.groups) {
      std::sort(g.producers.begin(), g.producers.end());
      g.producers.erase(std::unique(g.producers.begin(), g.producers.end()), g.producers.end());
      for (const uint32_t p : g.producers) ++dag_.groups[p].consumers;
    }
    std::vector<uint8_t> at_top(dag_.groups.size(), 0);
    for (const Cluster& c : dag_.clusters)
      if (c.producer != Cluster::kNone && c.consumer == Cluster::kNone) at_top[c.producer] = 1;
    for (size_t g = 0; g < at_top.size(); ++g) dag_.groups[g].consumers += at_top[g];
    encodeGroups();
    return std::move(dag_);
  }

 private:
  // A group's clusters are read together, as in Nexus and Nanite; so are those of which there is nothing coarser.
  void encodeGroups() {
    std::vector<std::vector<IndexRange>> parts(dag_.groups.size() + 1);
    for (size_t g = 0; g < dag_.groups.size(); ++g)
      for (const uint32_t c : dag_.groups[g].inputs) parts[g].push_back(dag_.clusters[c].range);
    for (const Cluster& c : dag_.clusters)
      if (c.consumer == Cluster::kNone) parts.back().push_back(c.range);
    encodeParts(*dag_.mesh, std::move(parts), workers_);
  }

  // Of the level that is grouped next.
  struct Open {
    uint32_t cluster = 0;
    Triangles triangles;
  };
  void add(Triangles triangles, uint32_t producer, double error_mm, const WorldBox* around) {
    Cluster c;
    double samples = 0;
    for (size_t k = 0; k < triangles.size(); k += 3) samples += surface_.samplesOf(&triangles[k]);
    c.range = {static_cast<uint32_t>(dag_.mesh->indices.size()), static_cast<uint32_t>(triangles.size())};
    c.box = surface_.box(triangles, exaggerate_, error_mm);
    c.producer = producer;
    if (around) dag_.groups[producer].box = unitedBox(*around, c.box);
    surface_.append(triangles, std::sqrt(6 * samples / static_cast<double>(triangles.size())), *dag_.mesh);
    level_.push_back({static_cast<uint32_t>(dag_.clusters.size()), std::move(triangles)});
    dag_.clusters.push_back(c);
  }
  // Squares of 8 x 8 cells.
  void addLeaves() {
    const Triangles all = surface_.triangles(3);
    if (!surface_.whole()) dag_.leaf_error_mm = surface_.mmFor(surface_.deviationMm(all), exaggerate_);
    for (size_t first = 0, end = 0; first < all.size(); first = end) {
      const auto block = surface_.block(all[first], 3);
      while (end < all.size() && surface_.block(all[end], 3) == block) end += 3;
      add({all.begin() + static_cast<std::ptrdiff_t>(first), all.begin() + static_cast<std::ptrdiff_t>(end)},
          Cluster::kNone, dag_.leaf_error_mm, nullptr);
    }
  }
  // False: nothing could be made simpler.
  bool addLevel() {
    std::vector<Triangles> triangles;
    for (const Open& o : level_) triangles.push_back(o.triangles);
    const std::vector<uint32_t> group = groupClusters(sharedEdges(surface_, triangles), group_clusters_);
    std::vector<std::vector<uint32_t>> members(*std::max_element(group.begin(), group.end()) + 1);
    for (uint32_t c = 0; c < group.size(); ++c) members[group[c]].push_back(c);
    keepBorders(group, triangles);
    std::vector<Simplified> results(members.size());
    parallelFor(members.size(), workers_, nullptr, [&](size_t g) { results[g] = simplified(members[g], triangles); });
    std::vector<Open> before = std::move(level_);
    level_.clear();
    bool any = false;
    for (size_t g = 0; g < members.size(); ++g) {
      if (results[g].clusters.empty()) {  // perhaps among other neighbours
        for (const uint32_t c : members[g]) level_.push_back(std::move(before[c]));
        continue;
      }
      any = true;
      const auto own = static_cast<uint32_t>(dag_.groups.size());
      ClusterGroup& made = dag_.groups.emplace_back();
      made.error_mm = results[g].error_mm;
      made.box = dag_.clusters[before[members[g][0]].cluster].box;
      for (const uint32_t c : members[g]) {
        Cluster& input = dag_.clusters[before[c].cluster];
        input.consumer = own;
        made.inputs.push_back(before[c].cluster);
        made.box = unitedBox(made.box, input.box);
        if (input.producer == Cluster::kNone) continue;
        made.producers.push_back(input.producer);
        made.box = unitedBox(made.box, dag_.groups[input.producer].box);
        made.error_mm = std::max(made.error_mm, dag_.groups[input.producer].error_mm);
      }
      for (Triangles& t : results[g].clusters) {
        const WorldBox around = dag_.groups[own].box;
        add(std::move(t), own, dag_.groups[own].error_mm, &around);
      }
    }
    return any;
  }
  // Vertices of more than one group.
  void keepBorders(const std::vector<uint32_t>& group, const std::vector<Triangles>& triangles) {
    for (const Triangles& t : triangles)
      for (const uint32_t v : t) owner_[surface_.weld(v)] = Cluster::kNone, kept_[surface_.weld(v)] = 0;
    for (size_t c = 0; c < triangles.size(); ++c)
      for (const uint32_t v : triangles[c]) {
        uint32_t& owner = owner_[surface_.weld(v)];
        if (owner == Cluster::kNone) owner = group[c];
        else if (owner != group[c]) kept_[surface_.weld(v)] = 1;
      }
  }
  Simplified simplified(const std::vector<uint32_t>& members, const std::vector<Triangles>& triangles) const {
    Triangles all;
    for (const uint32_t c : members) all.insert(all.end(), triangles[c].begin(), triangles[c].end());
    const size_t count = all.size() / 3;
    SurfaceSimplifier simplifier(surface_, all, kept_);
    simplifier.reduce(count / 2);
    Simplified out;
    if (count == 0 || simplifier.count() > count * 4 / 5) return out;
    all = simplifier.triangles();
    out.error_mm = surface_.mmFor(surface_.deviationMm(all), exaggerate_);
    std::vector<std::array<uint32_t, 3>> left;
    for (size_t k = 0; k < all.size(); k += 3) left.push_back({all[k], all[k + 1], all[k + 2]});
    splitTriangles(surface_.positions(), left, out.clusters);
    return out;
  }

  const FineSurface& surface_;
  double exaggerate_;
  size_t group_clusters_;
  int workers_;
  ClusterDag dag_;
  std::vector<Open> level_;
  std::vector<uint32_t> owner_;  // by welded vertex: the group that has it
  std::vector<uint8_t> kept_;
};

}  // namespace

ClusterDag clusterDag(const FineSurface& surface, double exaggerate, size_t group_clusters, int workers) {
  return DagBuilder(surface, exaggerate, group_clusters, workers).build();
}

}  // namespace relievo
