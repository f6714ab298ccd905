// mesh_repair.cpp - the order of diagnosis and repair, and its simple steps.
#include "geometry/mesh_repair.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>

namespace relievo {
namespace {

constexpr uint32_t kNone = ~uint32_t{0};
constexpr size_t kMaxPlaces = 8;

class Repair {
 public:
  Repair(TriMesh& mesh, MeshDiagnosis& diagnosis, const std::string& name) : mesh_(mesh), diagnosis_(diagnosis), name_(name) {}

  Result<void> run() {
    weld();
    dropDegenerate();
    if (mesh_.triangles.empty())
      return Error{ErrorKind::kInvalidData, name_, "expected a surface, found degenerate triangles only", "see whether the export lost digits", {}};
    compact();
    summarise();
    return {};
  }

 private:
  glm::dvec3 place(uint32_t vertex) const { return mesh_.origin_mm + glm::dvec3(mesh_.positions_mm[vertex]); }
  MeshFinding& find(const char* what, const char* done) {
    for (MeshFinding& f : diagnosis_.findings)
      if (f.what == what) return f;
    diagnosis_.findings.push_back({what, 0, {}, done});
    return diagnosis_.findings.back();
  }
  void note(MeshFinding& finding, uint32_t vertex) {
    ++finding.count;
    if (finding.places_mm.size() < kMaxPlaces) finding.places_mm.push_back(place(vertex));
  }

  // Vertices at the same place become the first of them: in an open hash table, as the order of the vertices has it.
  void weld() {
    std::vector<glm::vec3>& p = mesh_.positions_mm;
    for (glm::vec3& v : p) v += 0.0f;  // -0 is 0
    size_t size = std::bit_ceil(p.size() + p.size() / 2 + 1);
    int shift = 64 - std::countr_zero(size);
    std::vector<uint32_t> table(size, kNone);
    auto slot = [&](const glm::vec3& v) {
      uint64_t bits[2] = {0, 0};
      std::memcpy(bits, &v, 12);
      uint64_t h = (bits[0] ^ (bits[0] >> 29)) * 0x9E3779B97F4A7C15ull + bits[1];
      h = (h ^ (h >> 32)) * 0xD6E8FEB86659FD93ull;
      return static_cast<size_t>((h ^ (h >> 29)) * 0x9E3779B97F4A7C15ull >> shift);
    };
    std::vector<uint32_t> first;  // of each vertex; empty as long as each is itself
    for (size_t i = 0; i < p.size(); ++i) {
      size_t s = slot(p[i]);
      while (table[s] != kNone && p[table[s]] != p[i]) s = (s + 1) & (size - 1);
      if (table[s] == kNone) {
        table[s] = static_cast<uint32_t>(i);
        continue;
      }
      if (first.empty()) {
        first.resize(p.size());
        for (size_t k = 0; k < p.size(); ++k) first[k] = static_cast<uint32_t>(k);
      }
      first[i] = table[s];
      note(find("duplicate vertices", "welded"), static_cast<uint32_t>(i));
    }
    if (first.empty()) return;
    for (auto& t : mesh_.triangles)
      for (uint32_t& v : t) v = first[v];
  }

  // Keeps the triangles that keep(t) says, in their order.
  template <class Keep>
  void filterTriangles(Keep keep) {
    size_t to = 0;
    for (size_t t = 0; t < mesh_.triangles.size(); ++t) {
      if (!keep(t)) continue;
      if (to != t) {
        mesh_.triangles[to] = mesh_.triangles[t];
        if (!mesh_.corner_uv.empty()) mesh_.corner_uv[to] = mesh_.corner_uv[t];
      }
      ++to;
    }
    mesh_.triangles.resize(to);
    if (!mesh_.corner_uv.empty()) mesh_.corner_uv.resize(to);
  }

  void dropDegenerate() {
    filterTriangles([&](size_t t) {
      if (!isDegenerate(mesh_, mesh_.triangles[t])) return true;
      note(find("degenerate triangles", "dropped"), mesh_.triangles[t][0]);
      return false;
    });
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
    mesh_.positions_mm.resize(n);
    if (!mesh_.colours.empty()) mesh_.colours.resize(n);
    for (auto& t : mesh_.triangles)
      for (uint32_t& v : t) v = to[v];
  }

  void summarise() {
    diagnosis_.vertices = mesh_.positions_mm.size();
    diagnosis_.triangles = mesh_.triangles.size();
    glm::vec3 low(mesh_.positions_mm[0]), high(low);
    for (const glm::vec3& p : mesh_.positions_mm) {
      low = glm::min(low, p);
      high = glm::max(high, p);
    }
    diagnosis_.min_mm = mesh_.origin_mm + glm::dvec3(low);
    diagnosis_.max_mm = mesh_.origin_mm + glm::dvec3(high);
  }

  TriMesh& mesh_;
  MeshDiagnosis& diagnosis_;
  const std::string& name_;
};

}  // namespace

bool isDegenerate(const TriMesh& mesh, const std::array<uint32_t, 3>& t) {
  if (t[0] == t[1] || t[1] == t[2] || t[2] == t[0]) return true;
  glm::dvec3 a(mesh.positions_mm[t[0]]), b(mesh.positions_mm[t[1]]), c(mesh.positions_mm[t[2]]);
  glm::dvec3 ab = b - a, ac = c - a, bc = c - b, normal = glm::cross(ab, ac);
  double longest = std::max({glm::dot(ab, ab), glm::dot(ac, ac), glm::dot(bc, bc)});
  return !(glm::dot(normal, normal) > kDegenerate * kDegenerate * longest * longest);
}

Result<void> repairTriangles(TriMesh& mesh, MeshDiagnosis& diagnosis, const std::string& name, const std::function<void(double)>& progress,
                             const std::atomic<bool>* interrupted) {
  (void)progress;
  (void)interrupted;
  return Repair(mesh, diagnosis, name).run();
}

}  // namespace relievo
