// cluster_dag.h - a relief as clusters of about 128 triangles, and coarser ones for groups of them, up to a few that
// stand for everything: a directed acyclic graph. What strategy_clusters.cpp draws for a view is a cut through it.
//
// Groups of neighbouring clusters are simplified together to half of their triangles; only vertices that two groups
// share stay where they are. The result is cut into clusters anew, and these are grouped anew, so that no border
// between groups stays for long. A group is drawn as it was or as it became, as a whole: what two groups share is the
// same either way, so no cut has cracks.
//
// Sources: Cignoni et al. 2005, "Batched Multi Triangulation" (cuts through a graph of patches whose borders stay);
// Ponchio 2009 (Nexus); Karis, Stubbe, Wihlidal 2021, "A Deep Dive into Nanite Virtualized Geometry" (groups of
// clusters, errors and bounds that only grow towards the root).
//
// Errors: mm from the finest relief above the same places, measured, and never less than those of what a group was made
// from. Boxes hold the boxes below and the relief. Deterministic, whatever the number of threads. Memory: about 350
// bytes a vertex of the surface while it is made, 100 after.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "geometry/strategies/strategy_surface.h"

namespace relievo {

inline constexpr size_t kClusterTriangles = 128;  // at most

struct Cluster {
  static constexpr uint32_t kNone = ~uint32_t{0};
  IndexRange range;  // of ClusterDag::mesh
  WorldBox box;
  uint32_t producer = kNone;  // the group whose simplification it is part of; none: it is part of the finest mesh
  uint32_t consumer = kNone;  // the group that it was simplified in; none: there is nothing coarser
};
struct ClusterGroup {
  std::vector<uint32_t> inputs;     // clusters, finer
  std::vector<uint32_t> producers;  // the groups that they are of, each once
  uint32_t consumers = 0;           // groups that have one of its results as input, and one more if one has none
  double error_mm = 0;              // of the results
  WorldBox box;
};
struct ClusterDag {
  std::shared_ptr<StrategyMesh> mesh;
  std::vector<Cluster> clusters;  // fine to coarse
  std::vector<ClusterGroup> groups;
  double leaf_error_mm = 0;  // of the finest mesh
};

// group_clusters: how many are simplified together. workers: threads; 0: as many as there are cores.
ClusterDag clusterDag(const FineSurface& surface, double exaggerate, size_t group_clusters, int workers);

}  // namespace relievo
