// mesh_repair.cpp - the order of diagnosis and repair, and its simple steps.
#include "geometry/scan/mesh_repair.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <optional>

#include "geometry/mesh/point_table.h"
#include "geometry/mesh/triangle_point.h"
#include "geometry/scan/mesh_sheets.h"
#include "geometry/scan/mesh_tjunction.h"
#include "src/base/parallel_for.h"

namespace relievo {
namespace {

constexpr uint32_t kNone = ~uint32_t{0};

class Repair {
 public:
  Repair(TriMesh& mesh, MeshDiagnosis& diagnosis, const std::string& name, const std::function<void(double)>& progress,
         const std::atomic<bool>* interrupted, int workers, size_t all_pieces_up_to)
      : mesh_(mesh),
        diagnosis_(diagnosis),
        name_(name),
        progress_(progress),
        interrupted_(interrupted),
        workers_(workerCount(workers)),
        all_pieces_up_to_(all_pieces_up_to) {}

  Result<void> run() {
    if (!step(0)) return stopped();
    for (glm::vec3& v : mesh_.positions_mm) v += 0.0f;  // -0 is 0
    // Whether a triangle is degenerate depends on its corners' places alone: that is found out beside the welding.
    BackgroundTask<std::vector<uint32_t>> degenerate(
        "relievo-mesh", [this] { return findDegenerate(); }, beside());
    std::vector<uint32_t> first;
    const bool welded = findSamePlaces(first);
    const std::vector<uint32_t> dropped = degenerate.get();
    if (!welded) return stopped();
    weld(first);
    drop(dropped);
    if (!step(0.25)) return stopped();
    if (mesh_.triangles.empty())
      return Error{ErrorKind::kInvalidData,
                   name_,
                   "expected a surface, found degenerate triangles only",
                   "see whether the export lost digits",
                   {}};
    double diagonal = measure();
    if (diagonal < kMinDiagonalMm)
      return Error{ErrorKind::kInvalidData,
                   name_,
                   "expected a mesh of more than a nanometre, found one of " + std::to_string(diagonal * 1e6) + " nm",
                   "set --unit",
                   {}};

    if (!step(0.3)) return stopped();
    EdgeCensus census = census_();
    if (!step(0.5)) return stopped();
    if (!closeTJunctions(census, kTJunctionTolerance * diagonal)) return stopped();
    // Beside the turning, which it does not depend on: most scans have nothing to split.
    std::optional<BackgroundTask<bool>> sound_fans;
    if (census.crowded.empty())
      sound_fans.emplace(
          "relievo-mesh", [&] { return oneFanAVertex(mesh_, census.mate, interrupted_); }, beside());
    Turned turned = findTurns(mesh_, census, interrupted_, workers_);
    const bool one_fan = sound_fans && sound_fans->get();
    turn(census, turned);
    Pieces pieces = std::move(turned.pieces);
    if (!step(0.7)) return stopped();
    if (!(one_fan && turned.cut.empty()) && !splitSheets(census, pieces, turned.cut)) {
      if (isStopped()) return stopped();
      return Error{ErrorKind::kInvalidData,
                   name_,
                   "non-manifold edges that touch one another beyond repair",
                   "clean the mesh in a mesh editor",
                   {}};
    }
    if (!step(0.9)) return stopped();
    dropDust(census, pieces, diagonal);
    if (isStopped()) return stopped();
    compact();
    if (!step(0.95)) return stopped();
    summarise(census.mate, pieces);
    step(1);
    return {};
  }

 private:
  static constexpr double kTJunctionTolerance =
      1e-7;  // of the diagonal: what floats from the origin can mean by "on the edge"
  static constexpr double kMinDiagonalMm = 1e-6;
  static constexpr double kMostDust = 0.01;  // of the area
  static constexpr double kNoArea = 1e-14;   // of the diagonal's square: no patch has so little

  bool step(double done) {
    if (progress_) progress_(done);
    return !isStopped();
  }
  bool isStopped() const { return interrupted_ && *interrupted_; }
  Error stopped() const { return {ErrorKind::kInterrupted, name_, "interrupted", "", {}}; }
  glm::dvec3 place(uint32_t vertex) const { return mesh_.origin_mm + glm::dvec3(mesh_.positions_mm[vertex]); }
  void note(MeshFinding& finding, uint32_t vertex) const {
    if (++finding.count <= kMaxPlaces) finding.places_mm.push_back(place(vertex));
  }
  // Into the diagnosis, if there is anything; repeated findings add up.
  void report(MeshFinding finding) {
    if (finding.count == 0) return;
    for (MeshFinding& f : diagnosis_.findings)
      if (f.what == finding.what && f.done == finding.done) {
        f.count += finding.count;
        for (const glm::dvec3& p : finding.places_mm)
          if (f.places_mm.size() < kMaxPlaces) f.places_mm.push_back(p);
        return;
      }
    diagnosis_.findings.push_back(std::move(finding));
  }

  // Whether something is done beside something else; one worker does it after it.
  bool beside() const { return workers_ > 1; }

  // The first vertex at each vertex's place; empty where each is that itself. False: interrupted.
  bool findSamePlaces(std::vector<uint32_t>& first) {
    const std::vector<glm::vec3>& p = mesh_.positions_mm;
    constexpr size_t kAhead = 24, kPause = size_t{1} << 20;
    PointTable<glm::vec3> table(p.size());
    MeshFinding duplicates{"duplicate vertices", 0, {}, "welded"};
    for (size_t i = 0; i < p.size(); ++i) {
      if (i % kPause == 0 && !step(0.2 * static_cast<double>(i) / static_cast<double>(p.size()))) return false;
      if (i + kAhead < p.size()) table.prefetch(p[i + kAhead]);
      uint32_t same = table.findOrAdd(p, p[i], static_cast<uint32_t>(i));
      if (same == i) continue;
      if (first.empty()) {
        first.resize(p.size());
        for (size_t k = 0; k < p.size(); ++k) first[k] = static_cast<uint32_t>(k);
      }
      first[i] = same;
      note(duplicates, static_cast<uint32_t>(i));
    }
    explained_ = duplicates.count;
    report(std::move(duplicates));
    return step(0.2);
  }
  void weld(const std::vector<uint32_t>& first) {
    if (first.empty()) return;
    for (auto& t : mesh_.triangles)
      for (uint32_t& v : t) v = first[v];
  }

  // Keeps the triangles that keep(t) says, in their order. Interrupted: any.
  template <class Keep>
  void filterTriangles(Keep keep) {
    size_t to = 0;
    for (size_t t = 0; t < mesh_.triangles.size(); ++t) {
      if (stopAt(t, interrupted_)) return;
      if (!keep(t)) continue;
      if (to != t) {
        mesh_.triangles[to] = mesh_.triangles[t];
        if (!mesh_.corner_uv.empty()) mesh_.corner_uv[to] = mesh_.corner_uv[t];
        if (!mesh_.corner_normals.empty()) mesh_.corner_normals[to] = mesh_.corner_normals[t];
        if (!mesh_.image_of.empty()) mesh_.image_of[to] = mesh_.image_of[t];
      }
      ++to;
    }
    mesh_.triangles.resize(to);
    if (!mesh_.corner_uv.empty()) mesh_.corner_uv.resize(to);
    if (!mesh_.corner_normals.empty()) mesh_.corner_normals.resize(to);
    if (!mesh_.image_of.empty()) mesh_.image_of.resize(to);
  }

  // In ascending order.
  std::vector<uint32_t> findDegenerate() const {
    std::vector<uint32_t> found;
    for (size_t t = 0; t < mesh_.triangles.size() && !stopAt(t, interrupted_); ++t)
      if (isDegenerate(mesh_, mesh_.triangles[t])) found.push_back(static_cast<uint32_t>(t));
    return found;
  }
  void drop(const std::vector<uint32_t>& triangles) {
    MeshFinding degenerate{"degenerate triangles", 0, {}, "dropped"};
    dropTriangles(triangles, degenerate);
    report(std::move(degenerate));
  }
  // `triangles` ascend.
  void dropTriangles(const std::vector<uint32_t>& triangles, MeshFinding& finding) {
    if (triangles.empty()) return;
    size_t next = 0;
    filterTriangles([&](size_t t) {
      if (next == triangles.size() || triangles[next] != t) return true;
      ++next;
      note(finding, mesh_.triangles[t][0]);
      return false;
    });
  }

  // Without triangles that repeat an earlier one.
  EdgeCensus census_() {
    EdgeCensus census = takeCensus(mesh_, interrupted_, workers_);
    if (census.duplicates.empty() || !step(0.4)) return census;
    MeshFinding duplicates{"duplicate triangles", 0, {}, "dropped"};
    dropTriangles(census.duplicates, duplicates);
    report(std::move(duplicates));
    census = {};
    return takeCensus(mesh_, interrupted_, workers_);
  }

  // False: interrupted. A split makes new edges, on which further vertices may lie: a second round finds them.
  bool closeTJunctions(EdgeCensus& census, double tolerance) {
    constexpr int kRounds = 3;
    MeshFinding kept{"T-junctions at slivers", 0, {}, ""};
    // Each splits a triangle: memory stays bounded by the file, and half-edges keep 32-bit names.
    size_t most = std::min(mesh_.triangles.size() + 1000, kMaxTriangles - mesh_.triangles.size());
    for (int round = 0; round < kRounds && !census.open.empty(); ++round) {
      if (!step(0.5 + 0.05 * round)) return false;
      bool complete = true;
      std::vector<TJunction> found = findTJunctions(mesh_, census.open, tolerance, most, workers_, &complete);
      if (!complete) {
        MeshFinding many{"T-junctions, too many to repair", 0, {}, ""};
        for (const TJunction& j : found) note(many, j.vertex);
        many.count = std::max<uint64_t>(many.count, 1);
        report(std::move(many));
        return true;
      }
      if (found.empty()) break;
      std::vector<TJunction> left = splitAtTJunctions(mesh_, found);
      kept = {"T-junctions at slivers", 0, {}, ""};
      for (const TJunction& j : left) note(kept, j.vertex);
      MeshFinding split{"T-junctions", 0, {}, "triangles split there"};
      size_t next = 0;
      for (const TJunction& j : found) {
        if (next < left.size() && left[next].half_edge == j.half_edge && left[next].vertex == j.vertex) ++next;
        else note(split, j.vertex);
      }
      bool any = split.count > 0;
      most -= std::min<size_t>(most, split.count);
      report(std::move(split));
      if (!any) break;
      census = census_();
      if (!step(0.5 + 0.05 * round)) return false;
    }
    report(std::move(kept));
    return true;
  }

  void turn(EdgeCensus& census, Turned& turned) {
    turnOver(mesh_, census, turned);
    auto tell = [&](const char* what, const char* done, const std::vector<uint32_t>& triangles) {
      MeshFinding finding{what, 0, {}, done};
      for (uint32_t t : triangles) note(finding, mesh_.triangles[t][0]);
      report(std::move(finding));
    };
    tell("flipped triangles", "turned as their piece", turned.triangles);
    tell("closed pieces inside out", "turned", turned.inside_out);
    tell("pieces inside out that are closed but for small holes", "turned", turned.inside_out_with_holes);
    MeshFinding one_sided{"pieces with one side only, as a Moebius strip has",
                          0,
                          {},
                          "cut open along " + std::to_string(turned.cut.size()) + " edges"};
    for (uint32_t h : turned.cut) note(one_sided, fromVertex(mesh_.triangles, h));
    one_sided.count = turned.cut_pieces;
    report(std::move(one_sided));
  }

  // cut: a half-edge of each edge that was cut open.
  bool splitSheets(EdgeCensus& census, Pieces& pieces, std::span<const uint32_t> cut) {
    std::vector<bool> told(census.crowded.empty() && cut.empty() ? 0 : mesh_.positions_mm.size());
    for (uint32_t h : cut) told[fromVertex(mesh_.triangles, h)] = told[toVertex(mesh_.triangles, h)] = true;
    MeshFinding edges{"non-manifold edges", 0, {}, "split into sheets"};
    for (size_t i = 0, begin = 0; i < census.crowded_end.size(); begin = census.crowded_end[i++]) {
      uint32_t a = fromVertex(mesh_.triangles, census.crowded[begin]),
               b = toVertex(mesh_.triangles, census.crowded[begin]);
      told[a] = told[b] = true;
      if (++edges.count <= kMaxPlaces) edges.places_mm.push_back(0.5 * (place(a) + place(b)));
    }
    report(std::move(edges));
    pairCrowded(mesh_, census);
    std::vector<uint32_t> split;
    if (!splitFans(mesh_, census, split, interrupted_)) return false;
    MeshFinding vertices{"non-manifold vertices", 0, {}, "split, one for each fan of triangles"};
    for (uint32_t v : split)
      if (told.empty() || (v < told.size() && !told[v])) note(vertices, v);
    report(std::move(vertices));
    if (!census.crowded.empty()) pieces = findPieces(mesh_, census.mate, interrupted_);
    return true;
  }

  // Of more than kManyPieces the smallest leave, up to kMostDust of the area, if the mesh has more triangles than
  // all_pieces_up_to_; and pieces that have no area.
  void dropDust(EdgeCensus& census, Pieces& pieces, double diagonal) {
    if (pieces.count() < 2) return;
    std::vector<double> area(pieces.count());
    double whole = 0;
    for (size_t p = 0; p < pieces.count(); ++p) {
      for (uint32_t t : pieces.triangles(p)) area[p] += 0.5 * doubleAreaOf(cornersOf(mesh_, t));
      whole += area[p];
    }
    std::vector<size_t> by_area(pieces.count());
    for (size_t p = 0; p < by_area.size(); ++p) by_area[p] = p;
    std::stable_sort(by_area.begin(), by_area.end(), [&](size_t a, size_t b) { return area[a] < area[b]; });
    const double no_area = kNoArea * diagonal * diagonal;
    std::vector<uint32_t> dust;
    double lost = 0;
    size_t left = pieces.count();
    const bool keeps_all = mesh_.triangles.size() <= all_pieces_up_to_;
    for (size_t p : by_area) {
      const bool many = !keeps_all && left > kManyPieces && lost + area[p] <= kMostDust * whole;
      if (left == 1 || !(many || area[p] <= no_area)) break;
      const auto triangles = pieces.triangles(p);
      dust.insert(dust.end(), triangles.begin(), triangles.end());
      lost += area[p];
      --left;
    }
    if (dust.empty()) return;
    char done[80];
    std::snprintf(done, sizeof done, "dropped, %.2g %% of the area", 100 * lost / whole);
    MeshFinding finding{"smallest of " + std::to_string(pieces.count()) + " pieces", 0, {}, done};
    for (size_t k = 0; k < pieces.count() - left; ++k)
      note(finding, mesh_.triangles[pieces.triangles(by_area[k])[0]][0]);
    report(std::move(finding));
    std::sort(dust.begin(), dust.end());
    std::vector<uint32_t> corners;
    for (uint32_t t : dust) corners.insert(corners.end(), mesh_.triangles[t].begin(), mesh_.triangles[t].end());
    std::sort(corners.begin(), corners.end());
    explained_ += static_cast<uint64_t>(std::unique(corners.begin(), corners.end()) - corners.begin());
    MeshFinding each_triangle;
    dropTriangles(dust, each_triangle);
    measure();
    census = census_();
    pieces = findPieces(mesh_, census.mate, interrupted_);
  }

  // Vertices of no triangle leave; the others keep their order.
  void compact() {
    std::vector<uint32_t> to(mesh_.positions_mm.size(), kNone);
    for (const auto& t : mesh_.triangles)
      for (uint32_t v : t) to[v] = 0;
    uint32_t n = 0;
    for (size_t i = 0; i < to.size(); ++i) {
      if (to[i] == kNone) continue;
      mesh_.positions_mm[n] = mesh_.positions_mm[i];
      if (!mesh_.colours.empty()) mesh_.colours[n] = mesh_.colours[i];
      to[i] = n++;
    }
    if (n == to.size()) return;
    if (uint64_t unused = to.size() - n; unused > explained_)
      report({"vertices of no triangle", unused - explained_, {}, "dropped"});
    mesh_.positions_mm.resize(n);
    if (!mesh_.colours.empty()) mesh_.colours.resize(n);
    for (auto& t : mesh_.triangles)
      for (uint32_t& v : t) v = to[v];
  }

  // Of the triangles' bounding box, which goes to the diagnosis.
  double measure() {
    glm::vec3 low(mesh_.positions_mm[mesh_.triangles[0][0]]), high(low);
    for (const auto& t : mesh_.triangles)
      for (uint32_t v : t) {
        low = glm::min(low, mesh_.positions_mm[v]);
        high = glm::max(high, mesh_.positions_mm[v]);
      }
    diagnosis_.min_mm = mesh_.origin_mm + glm::dvec3(low);
    diagnosis_.max_mm = mesh_.origin_mm + glm::dvec3(high);
    return glm::length(glm::dvec3(high) - glm::dvec3(low));
  }

  void summarise(const std::vector<uint32_t>& mate, const Pieces& pieces) {
    diagnosis_.vertices = mesh_.positions_mm.size();
    diagnosis_.triangles = mesh_.triangles.size();
    diagnosis_.pieces = pieces.count();
    size_t largest = 0;
    for (size_t p = 1; p < pieces.count(); ++p)
      if (pieces.triangles(p).size() > pieces.triangles(largest).size()) largest = p;
    MeshFinding isolated{"isolated pieces", 0, {}, ""};
    for (size_t p = 0; p < pieces.count(); ++p)
      if (p != largest) note(isolated, mesh_.triangles[pieces.triangles(p)[0]][0]);
    report(std::move(isolated));

    // A border vertex has two open half-edges (splitFans saw to it): loops are what hangs together.
    std::vector<std::pair<uint32_t, uint32_t>> ends;  // vertex, number of its open half-edge
    uint32_t open = 0;
    for (uint32_t h = 0; h < mate.size(); ++h)
      if (mate[h] == kNoHalfEdge) {
        ends.emplace_back(fromVertex(mesh_.triangles, h), open);
        ends.emplace_back(toVertex(mesh_.triangles, h), open++);
      }
    std::vector<uint32_t> loop(open);
    for (uint32_t i = 0; i < open; ++i) loop[i] = i;
    auto root = [&](uint32_t i) {
      while (loop[i] != i) i = loop[i] = loop[loop[i]];
      return i;
    };
    std::sort(ends.begin(), ends.end());
    for (size_t i = 1; i < ends.size(); ++i)
      if (ends[i].first == ends[i - 1].first) loop[root(ends[i].second)] = root(ends[i - 1].second);
    MeshFinding borders{"open borders", 0, {}, ""};
    std::vector<bool> seen(open);
    for (const auto& [vertex, edge] : ends) {
      uint32_t r = root(edge);
      if (!seen[r]) note(borders, vertex);
      seen[r] = true;
    }
    diagnosis_.border_loops = borders.count;
    report(std::move(borders));
  }

  TriMesh& mesh_;
  MeshDiagnosis& diagnosis_;
  const std::string& name_;
  const std::function<void(double)>& progress_;
  const std::atomic<bool>* interrupted_;
  int workers_;
  size_t all_pieces_up_to_;
  uint64_t explained_ = 0;  // vertices of no triangle that other findings tell of
};

}  // namespace

bool isDegenerate(const TriMesh& mesh, const std::array<uint32_t, 3>& t) {
  if (t[0] == t[1] || t[1] == t[2] || t[2] == t[0]) return true;
  glm::dvec3 a(mesh.positions_mm[t[0]]), b(mesh.positions_mm[t[1]]), c(mesh.positions_mm[t[2]]);
  glm::dvec3 ab = b - a, ac = c - a, bc = c - b, normal = glm::cross(ab, ac);
  double longest = std::max({glm::dot(ab, ab), glm::dot(ac, ac), glm::dot(bc, bc)});
  return !(glm::dot(normal, normal) > kDegenerate * kDegenerate * longest * longest);
}

Result<void> repairTriangles(TriMesh& mesh, MeshDiagnosis& diagnosis, const std::string& name,
                             const std::function<void(double)>& progress, const std::atomic<bool>* interrupted,
                             int workers, size_t all_pieces_up_to) {
  return Repair(mesh, diagnosis, name, progress, interrupted, workers, all_pieces_up_to).run();
}

}  // namespace relievo
