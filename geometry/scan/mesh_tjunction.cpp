#include "geometry/scan/mesh_tjunction.h"

#include <algorithm>
#include <atomic>
#include <cmath>

#include "geometry/scan/mesh_repair.h"
#include "src/base/parallel_for.h"

namespace relievo {
namespace {

// A balanced k-d tree over points, by their indices in place: a node is a range, its middle element splits it.
class PointTree {
 public:
  PointTree(const TriMesh& mesh, std::vector<uint32_t> vertices) : mesh_(mesh), vertices_(std::move(vertices)) {
    build(0, vertices_.size(), 0);
  }

  // visit(vertex) for the points within distance of the segment, and some more; false stops.
  template <class Visit>
  bool near(const glm::dvec3& a, const glm::dvec3& b, double distance, Visit visit) const {
    return descend(0, vertices_.size(), 0, a, b, distance, visit);
  }

 private:
  static constexpr size_t kLeaf = 8;

  glm::dvec3 place(uint32_t v) const { return glm::dvec3(mesh_.positions_mm[v]); }

  void build(size_t begin, size_t end, int axis) {
    if (end - begin <= kLeaf) return;
    size_t middle = begin + (end - begin) / 2;
    std::nth_element(at(begin), at(middle), at(end), [&](uint32_t p, uint32_t q) {
      float x = mesh_.positions_mm[p][axis], y = mesh_.positions_mm[q][axis];
      return x != y ? x < y : p < q;
    });
    build(begin, middle, (axis + 1) % 3);
    build(middle + 1, end, (axis + 1) % 3);
  }
  std::vector<uint32_t>::iterator at(size_t i) { return vertices_.begin() + static_cast<std::ptrdiff_t>(i); }

  // Clips the segment at the splitting planes, widened by the distance.
  template <class Visit>
  bool descend(size_t begin, size_t end, int axis, const glm::dvec3& a, const glm::dvec3& b, double distance,
               Visit& visit) const {
    if (end - begin <= kLeaf) {
      for (size_t i = begin; i < end; ++i)
        if (!visit(vertices_[i])) return false;
      return true;
    }
    size_t middle = begin + (end - begin) / 2;
    if (!visit(vertices_[middle])) return false;
    double plane = place(vertices_[middle])[axis];
    auto clipped = [&](double limit, double sign, glm::dvec3& from, glm::dvec3& to) {  // sign * x <= sign * limit
      from = a;
      to = b;
      double da = sign * (a[axis] - limit), db = sign * (b[axis] - limit);
      if (da > 0 && db > 0) return false;
      if (da > 0) from = a + (b - a) * (da / (da - db));
      else if (db > 0) to = b + (a - b) * (db / (db - da));
      return true;
    };
    glm::dvec3 from, to;
    // Twice the distance: clipping rounds.
    if (clipped(plane + 2 * distance, 1, from, to) &&
        !descend(begin, middle, (axis + 1) % 3, from, to, distance, visit))
      return false;
    return !clipped(plane - 2 * distance, -1, from, to) ||
           descend(middle + 1, end, (axis + 1) % 3, from, to, distance, visit);
  }

  const TriMesh& mesh_;
  std::vector<uint32_t> vertices_;
};

// Which of a tree's vertices lie on an edge.
class EdgeSearch {
 public:
  EdgeSearch(const TriMesh& mesh, std::vector<uint32_t> vertices, double tolerance)
      : mesh_(mesh), tree_(mesh, std::move(vertices)), tolerance_(tolerance) {}

  // look(): before each vertex that is looked at; false stops. Appends to found; false: stopped.
  template <class Look>
  bool at(uint32_t h, Look look, std::vector<TJunction>& found) const {
    const Triangles& triangles = mesh_.triangles;
    const uint32_t from = fromVertex(triangles, h), to = toVertex(triangles, h),
                   third = fromVertex(triangles, previousInTriangle(h));
    const glm::dvec3 a(mesh_.positions_mm[from]), ab = glm::dvec3(mesh_.positions_mm[to]) - a;
    const double length2 = glm::dot(ab, ab), tolerance2 = tolerance_ * tolerance_;
    return tree_.near(a, a + ab, tolerance_, [&](uint32_t v) {
      if (!look()) return false;
      if (v == from || v == to || v == third) return true;
      const glm::dvec3 av = glm::dvec3(mesh_.positions_mm[v]) - a;
      const double along = glm::dot(av, ab) / length2;
      const glm::dvec3 off = av - ab * along;
      if (!(along > 0 && along < 1) || glm::dot(off, off) > tolerance2) return true;
      if (along * along * length2 <= tolerance2 || (1 - along) * (1 - along) * length2 <= tolerance2) return true;
      found.push_back({h, v, along});
      return true;
    });
  }

 private:
  const TriMesh& mesh_;
  PointTree tree_;
  double tolerance_;
};

}  // namespace

std::vector<TJunction> findTJunctions(const TriMesh& mesh, std::span<const uint32_t> open, double tolerance,
                                      size_t max_count, int workers, bool* complete) {
  std::vector<uint32_t> border;
  for (uint32_t h : open) {
    border.push_back(fromVertex(mesh.triangles, h));
    border.push_back(toVertex(mesh.triangles, h));
  }
  std::sort(border.begin(), border.end());
  border.erase(std::unique(border.begin(), border.end()), border.end());
  const EdgeSearch search(mesh, std::move(border), tolerance);
  // An edge meets some 30 vertices of the tree in sound meshes. All of them within the tolerance of one another would
  // take a square of time.
  const uint64_t most_looks = uint64_t{1000} * open.size() + 1000000;
  constexpr size_t kEdgesAJob = 256;
  const size_t jobs = (open.size() + kEdgesAJob - 1) / kEdgesAJob;
  std::vector<std::vector<TJunction>> of_job(jobs);
  std::atomic<uint64_t> looks = 0, count = 0;
  auto tooMany = [&] { return looks >= most_looks || count > max_count; };
  parallelFor(jobs, workers, nullptr, [&](size_t job) {
    for (size_t i = job * kEdgesAJob; i < std::min(open.size(), (job + 1) * kEdgesAJob) && !tooMany(); ++i) {
      uint64_t of_edge = 0;
      const size_t before = of_job[job].size();
      search.at(
          open[i], [&] { return ++of_edge < most_looks; }, of_job[job]);
      looks += of_edge;
      count += of_job[job].size() - before;
    }
  });
  std::vector<TJunction> found;
  *complete = !tooMany();
  if (*complete) {
    for (const auto& some : of_job) found.insert(found.end(), some.begin(), some.end());
  } else {  // those of the first edges, whichever threads looked where
    uint64_t left = most_looks;
    for (size_t i = 0; i < open.size() && left > 0 && found.size() <= max_count; ++i)
      search.at(
          open[i], [&] { return --left > 0 && found.size() <= max_count; }, found);
  }
  std::sort(found.begin(), found.end(), [](const TJunction& p, const TJunction& q) {
    if (p.half_edge != q.half_edge) return p.half_edge < q.half_edge;
    return p.along != q.along ? p.along < q.along : p.vertex < q.vertex;
  });
  return found;
}

namespace {

struct Cut {
  std::array<uint32_t, 3> corners;
  std::array<glm::vec2, 3> uv;
  std::array<glm::vec3, 3> normals;
  std::array<std::span<const TJunction>, 3> sides;  // junctions on the side from corner k to the next
};

// Of length 1, or 0: one of them is.
glm::vec3 between(const glm::vec3& a, const glm::vec3& b, float t) {
  const glm::vec3 sum = a * (1 - t) + b * t;
  const float length = glm::length(sum);
  return a == glm::vec3(0) || b == glm::vec3(0) || !(length > 0) ? glm::vec3(0) : sum / length;
}

// One side after the other: a fan from the corner opposite; its first and last triangle have the other sides'
// junctions.
void cut(const Cut& c, std::vector<Cut>& out) {
  size_t side = 0;
  while (side < 3 && c.sides[side].empty()) ++side;
  if (side == 3) {
    out.push_back(c);
    return;
  }
  const size_t a = side, b = (side + 1) % 3, top = (side + 2) % 3;
  uint32_t from = c.corners[a];
  glm::vec2 from_uv = c.uv[a];
  glm::vec3 from_normal = c.normals[a];
  std::span<const TJunction> points = c.sides[side];
  for (size_t i = 0; i <= points.size(); ++i) {
    const bool last = i == points.size();
    uint32_t to = last ? c.corners[b] : points[i].vertex;
    float t = last ? 1 : static_cast<float>(points[i].along);
    glm::vec2 to_uv = last ? c.uv[b] : c.uv[a] * (1 - t) + c.uv[b] * t;
    glm::vec3 to_normal = last ? c.normals[b] : between(c.normals[a], c.normals[b], t);
    Cut part{{from, to, c.corners[top]}, {from_uv, to_uv, c.uv[top]}, {from_normal, to_normal, c.normals[top]}, {}};
    if (last) part.sides[1] = c.sides[b];
    if (i == 0) part.sides[2] = c.sides[top];
    cut(part, out);
    from = to;
    from_uv = to_uv;
    from_normal = to_normal;
  }
}

}  // namespace

std::vector<TJunction> splitAtTJunctions(TriMesh& mesh, std::span<const TJunction> junctions) {
  std::vector<TJunction> left;
  std::vector<Cut> parts;
  auto normal = [&](const std::array<uint32_t, 3>& t) {
    glm::dvec3 a(mesh.positions_mm[t[0]]);
    return glm::cross(glm::dvec3(mesh.positions_mm[t[1]]) - a, glm::dvec3(mesh.positions_mm[t[2]]) - a);
  };
  for (size_t begin = 0; begin < junctions.size();) {
    const uint32_t t = junctions[begin].half_edge / 3;
    size_t end = begin;
    Cut whole{mesh.triangles[t], {}, {}, {}};
    if (!mesh.corner_uv.empty()) whole.uv = mesh.corner_uv[t];
    if (!mesh.corner_normals.empty()) whole.normals = mesh.corner_normals[t];
    for (uint32_t k = 0; k < 3; ++k) {
      size_t first = end;
      while (end < junctions.size() && junctions[end].half_edge == 3 * t + k) ++end;
      whole.sides[k] = junctions.subspan(first, end - first);
    }
    parts.clear();
    cut(whole, parts);
    const glm::dvec3 before = normal(whole.corners);
    bool sound = std::all_of(parts.begin(), parts.end(), [&](const Cut& c) {
      return !isDegenerate(mesh, c.corners) && glm::dot(normal(c.corners), before) > 0;
    });
    if (!sound) {
      left.insert(left.end(), junctions.begin() + static_cast<std::ptrdiff_t>(begin),
                  junctions.begin() + static_cast<std::ptrdiff_t>(end));
    } else {
      for (size_t i = 0; i < parts.size(); ++i) {
        if (i == 0) mesh.triangles[t] = parts[i].corners;
        else mesh.triangles.push_back(parts[i].corners);
        if (i > 0 && !mesh.image_of.empty()) mesh.image_of.push_back(mesh.image_of[t]);
        const auto put = [&](auto& of_mesh, const auto& of_part) {
          if (of_mesh.empty()) return;
          if (i == 0) of_mesh[t] = of_part;
          else of_mesh.push_back(of_part);
        };
        put(mesh.corner_uv, parts[i].uv);
        put(mesh.corner_normals, parts[i].normals);
      }
    }
    begin = end;
  }
  return left;
}

}  // namespace relievo
