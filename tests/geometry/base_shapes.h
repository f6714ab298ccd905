// base_shapes.h - triangle meshes of shapes whose every property is known, for tests of what is built from scans.
#pragma once

#include <cmath>
#include <functional>
#include <map>
#include <numbers>
#include <string>
#include <utility>

#include "geometry/mesh/tri_mesh.h"

namespace relievo {

// A grid of n x m cells over [0, 1]^2, wrapped where it closes, less the cells that skip names; place(u, v). Outside is
// u x v.
inline TriMesh gridMesh(int n, int m, bool wrap_u, bool wrap_v, const std::function<glm::dvec3(double, double)>& place,
                        const std::function<bool(double, double)>& skip = {}) {
  TriMesh mesh;
  std::map<std::pair<int, int>, uint32_t> names;
  auto vertex = [&](int i, int j) {
    if (wrap_u) i %= n;
    if (wrap_v) j %= m;
    auto [it, fresh] = names.try_emplace({i, j}, static_cast<uint32_t>(mesh.positions_mm.size()));
    if (fresh) mesh.positions_mm.push_back(glm::vec3(place(double(i) / n, double(j) / m)));
    return it->second;
  };
  for (int j = 0; j < m; ++j) {
    for (int i = 0; i < n; ++i) {
      if (skip && skip((i + 0.5) / n, (j + 0.5) / m)) continue;
      const uint32_t a = vertex(i, j), b = vertex(i + 1, j), c = vertex(i + 1, j + 1), d = vertex(i, j + 1);
      if ((i + j) % 2) {
        mesh.triangles.push_back({a, b, c});
        mesh.triangles.push_back({a, c, d});
      } else {
        mesh.triangles.push_back({a, b, d});
        mesh.triangles.push_back({b, c, d});
      }
    }
  }
  return mesh;
}

// The six faces of a box of n cells a side, welded; place maps [-1, 1]^3's surface.
inline TriMesh cubeMesh(int n, const std::function<glm::dvec3(const glm::dvec3&)>& place) {
  TriMesh mesh;
  std::map<std::array<int, 3>, uint32_t> names;
  auto vertex = [&](std::array<int, 3> at) {
    auto [it, fresh] = names.try_emplace(at, static_cast<uint32_t>(mesh.positions_mm.size()));
    if (fresh) mesh.positions_mm.push_back(glm::vec3(place(glm::dvec3(at[0], at[1], at[2]) * (2.0 / n) - 1.0)));
    return it->second;
  };
  for (int axis = 0; axis < 3; ++axis) {
    for (int side = 0; side < 2; ++side) {
      for (int j = 0; j < n; ++j) {
        for (int i = 0; i < n; ++i) {
          auto at = [&](int x, int y) {
            std::array<int, 3> p{};
            p[axis] = side * n;
            p[(axis + 1) % 3] = x;
            p[(axis + 2) % 3] = y;
            return vertex(p);
          };
          uint32_t a = at(i, j), b = at(i + 1, j), c = at(i + 1, j + 1), d = at(i, j + 1);
          if (!side) std::swap(b, d);
          mesh.triangles.push_back({a, b, c});
          mesh.triangles.push_back({a, c, d});
        }
      }
    }
  }
  return mesh;
}

inline TriMesh ballMesh(int n = 40, double radius = 50) {
  return cubeMesh(n, [=](const glm::dvec3& p) {
    return radius * glm::normalize(glm::dvec3(std::tan(p.x * 0.78), std::tan(p.y * 0.78), std::tan(p.z * 0.78)));
  });
}
inline TriMesh torusMesh(int n = 120, int m = 50, double large = 50, double small = 18) {
  return gridMesh(n, m, true, true, [=](double u, double v) {
    const double a = 2 * std::numbers::pi * u, b = 2 * std::numbers::pi * v;
    return glm::dvec3((large + small * std::cos(b)) * std::cos(a), (large + small * std::cos(b)) * std::sin(a),
                      small * std::sin(b));
  });
}
// An open sheet of 100 x 100 with waves of +-5 and a round hole.
inline TriMesh wavySheet(int n = 100, double hole = 0.15) {
  return gridMesh(
      n, n, false, false,
      [](double u, double v) { return glm::dvec3(100 * u, 100 * v, 5 * std::sin(9 * u) * std::cos(7 * v)); },
      [=](double u, double v) { return std::hypot(u - 0.5, v - 0.45) < hole; });
}
inline TriMesh panelMesh(int n = 120, double width = 200, double height = 120) {
  return gridMesh(n, n, false, false, [=](double u, double v) {
    return glm::dvec3(width * u, height * v, 0.5 * std::sin(40 * u) * std::sin(30 * v));
  });
}
inline TriMesh boxMesh(int n, double x, double y, double z) {
  return cubeMesh(n, [=](const glm::dvec3& p) { return glm::dvec3(p.x * x / 2, p.y * y / 2, p.z * z / 2); });
}
// A coin's face: a disc with a shallow relief.
inline TriMesh discMesh(int n = 60, double radius = 15) {
  return gridMesh(n, n, false, false, [=](double u, double v) {
    const double x = 2 * u - 1, y = 2 * v - 1;
    const double px = x * std::sqrt(1 - y * y / 2), py = y * std::sqrt(1 - x * x / 2);
    return glm::dvec3(radius * px, radius * py, 0.4 * std::cos(6 * px) * std::cos(5 * py));
  });
}
// A ball with a nose, a neck and a foot: something like a bust.
inline TriMesh bustMesh(int n = 60) {
  return cubeMesh(n, [](const glm::dvec3& p) {
    const glm::dvec3 d = glm::normalize(p);
    double r = 40 * (1 + 0.1 * std::sin(3 * d.x) * std::cos(4 * d.z));
    r += 14 * std::exp(-30 * glm::dot(d - glm::dvec3(0, 0, 1), d - glm::dvec3(0, 0, 1)));
    glm::dvec3 q = r * d;
    const double low = std::max(0.0, -d.y - 0.2);
    q.y -= 60 * low;
    q.x *= 1 + 0.9 * low * low - 0.6 * std::exp(-30 * (low - 0.4) * (low - 0.4));
    q.z *= 1 + 0.3 * low * low - 0.5 * std::exp(-30 * (low - 0.4) * (low - 0.4));
    return q;
  });
}
inline TriMesh moebiusMesh(int n = 60, int m = 8) {
  TriMesh mesh = gridMesh(n, m, false, false, [](double u, double v) {
    const double a = 2 * std::numbers::pi * u, w = 20 * (v - 0.5);
    return glm::dvec3((50 + w * std::cos(a / 2)) * std::cos(a), (50 + w * std::cos(a / 2)) * std::sin(a),
                      w * std::sin(a / 2));
  });
  // The last column is the first one, upside down.
  std::map<uint32_t, uint32_t> weld;
  auto find = [&](const glm::vec3& p, uint32_t before) {
    for (uint32_t v = 0; v < before; ++v) {
      if (glm::length(mesh.positions_mm[v] - p) < 1e-3f) return v;
    }
    return before;
  };
  for (auto& t : mesh.triangles) {
    for (uint32_t& v : t) v = find(mesh.positions_mm[v], v);
  }
  return mesh;
}
inline TriMesh together(TriMesh a, const TriMesh& b, const glm::vec3& offset) {
  const auto first = static_cast<uint32_t>(a.positions_mm.size());
  for (const glm::vec3& p : b.positions_mm) a.positions_mm.push_back(p + offset);
  for (auto t : b.triangles) a.triangles.push_back({t[0] + first, t[1] + first, t[2] + first});
  return a;
}

}  // namespace relievo
