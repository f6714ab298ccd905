// mesh_shapes.h - scans whose shape is known: cubes blown up to spheres, sheets, with a given height over them; and
// base meshes for them.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <map>
#include <vector>

#include <glm/glm.hpp>

#include "geometry/mesh/tri_mesh.h"
#include "src/artwork/base_mesh.h"

namespace relievo {

// A cube's surface as quads: n x n a face, corners welded; seen from outside u x v as base_mesh.h wants them.
struct CubeQuads {
  std::vector<glm::dvec3> corners;  // in [-1, 1]^3, on the surface
  std::vector<std::array<uint32_t, 4>> quads;
};
inline CubeQuads cubeQuads(int n) {
  CubeQuads out;
  std::map<std::array<int, 3>, uint32_t> index;
  auto corner = [&](std::array<int, 3> p) {
    auto [at, fresh] = index.try_emplace(p, static_cast<uint32_t>(out.corners.size()));
    if (fresh) out.corners.push_back(glm::dvec3(p[0], p[1], p[2]) * (2.0 / n) - 1.0);
    return at->second;
  };
  for (int axis = 0; axis < 3; ++axis) {
    for (int side : {0, n}) {
      for (int j = 0; j < n; ++j) {
        for (int i = 0; i < n; ++i) {
          auto at = [&](int u, int v) {
            std::array<int, 3> p{};
            p[static_cast<size_t>(axis)] = side;
            // P_v x P_u points outwards: on the upper side of an axis v, u run as the next two axes do.
            p[static_cast<size_t>((axis + 1) % 3)] = side ? v : u;
            p[static_cast<size_t>((axis + 2) % 3)] = side ? u : v;
            return corner(p);
          };
          out.quads.push_back({at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)});
        }
      }
    }
  }
  return out;
}

// Triangles of quads, outside kept: (u, v) corners 0 1 / 2 3 are clockwise seen from outside.
inline std::vector<std::array<uint32_t, 3>> trianglesOf(const std::vector<std::array<uint32_t, 4>>& quads) {
  std::vector<std::array<uint32_t, 3>> out;
  for (const auto& q : quads) {
    out.push_back({q[0], q[3], q[1]});
    out.push_back({q[0], q[2], q[3]});
  }
  return out;
}

// Vertices exactly (to float) at radius(direction) mm from the origin.
inline TriMesh starMesh(const std::function<double(const glm::dvec3&)>& radius, int n) {
  const CubeQuads cube = cubeQuads(n);
  TriMesh mesh;
  for (const glm::dvec3& c : cube.corners) {
    const glm::dvec3 direction = glm::normalize(c);
    mesh.positions_mm.push_back(glm::vec3(radius(direction) * direction));
  }
  mesh.triangles = trianglesOf(cube.quads);
  return mesh;
}
inline TriMesh sphereMesh(double radius, int n) {
  return starMesh([=](const glm::dvec3&) { return radius; }, n);
}

// Patches over a sphere; normals point away from its centre.
inline BaseMesh sphereBase(double radius, int n) {
  const CubeQuads cube = cubeQuads(n);
  BaseMesh base;
  for (const glm::dvec3& c : cube.corners) {
    const glm::dvec3 direction = glm::normalize(c);
    base.corners.push_back({glm::vec3(radius * direction), glm::vec3(direction)});
  }
  base.patches = cube.quads;
  return base;
}

// A sheet of nx x ny quads over [0, width] x [-height, 0], z = z(x, y), outside towards +z. u is +x, v is -y.
inline TriMesh sheetMesh(double width, double height, int nx, int ny, const std::function<double(double, double)>& z) {
  TriMesh mesh;
  for (int j = 0; j <= ny; ++j) {
    for (int i = 0; i <= nx; ++i) {
      const double x = width * i / nx, y = -height * j / ny;
      mesh.positions_mm.push_back(glm::vec3(x, y, z(x, y)));
    }
  }
  std::vector<std::array<uint32_t, 4>> quads;
  for (int j = 0; j < ny; ++j) {
    for (int i = 0; i < nx; ++i) {
      const auto at = static_cast<uint32_t>(j * (nx + 1) + i), row = static_cast<uint32_t>(nx + 1);
      quads.push_back({at, at + 1, at + row, at + row + 1});
    }
  }
  mesh.triangles = trianglesOf(quads);
  return mesh;
}
// Flat patches at z = 0 under it.
inline BaseMesh sheetBase(double width, double height, int nx, int ny) {
  const TriMesh corners = sheetMesh(width, height, nx, ny, [](double, double) { return 0.0; });
  BaseMesh base;
  for (const glm::vec3& p : corners.positions_mm) base.corners.push_back({p, glm::vec3(0, 0, 1)});
  for (int j = 0; j < ny; ++j) {
    for (int i = 0; i < nx; ++i) {
      const auto at = static_cast<uint32_t>(j * (nx + 1) + i), row = static_cast<uint32_t>(nx + 1);
      base.patches.push_back({at, at + 1, at + row, at + row + 1});
    }
  }
  return base;
}

}  // namespace relievo
