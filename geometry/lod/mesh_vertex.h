// mesh_vertex.h - the CPU reference of the vertex shader's geometry for artworks over a base mesh (shaders/patch.vert,
// MESH). Shared vertices get the same bits from every patch, node and level, also on a GPU that contracts a * b + c to
// fma, as long as it contracts alike for all vertices of a program:
// - Inside a patch, the same patch, (u, v) and height give the same operations on the same numbers.
// - On a side, the ends are ordered by their corner's index; one piece of code computes lo * (1 - t) + hi * t for all
//   four sides.
// - At a corner, t is 0 or 1, and x * 1 + y * 0 is x, contracted or not (but for the sign of a zero, which has no
//   effect).
// u, v and t are multiples of 2^-24, hence exact. Heights are samples: integers, the same in every page.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <utility>

#include <glm/glm.hpp>

#include "src/artwork/base_mesh.h"

namespace relievo {

// Corners as a frame's uniform data has them: positions from the eye, rounded to float once a corner and frame.
struct EyeCorner {
  glm::vec3 from_eye_mm{0};
  glm::vec3 normal{0};
};

// Ops: mulAdd(a, b, c) for a * b + c, mulMulAdd(a, b, c, d) for a * b + c * d; so that a test may model contraction, of
// either product. PlainOps: every operation rounds.
struct PlainOps {
  static float mulAdd(float a, float b, float c) {
    float product = a * b;
    return product + c;
  }
  static float mulMulAdd(float a, float b, float c, float d) {
    float product = a * b;
    return mulAdd(c, d, product);
  }
};

template <class Ops = PlainOps>
glm::vec3 lerpOrdered(const glm::vec3& lo, const glm::vec3& hi, float t) {
  float s = 1.0f - t;
  return {Ops::mulMulAdd(lo.x, s, hi.x, t), Ops::mulMulAdd(lo.y, s, hi.y, t), Ops::mulMulAdd(lo.z, s, hi.z, t)};
}

// A vertex on its way from the middle of two others to its own place (geometry/lod/morph.h).
template <class Ops = PlainOps>
glm::vec3 betweenVertices(const glm::vec3& a, const glm::vec3& b, const glm::vec3& own, float weight) {
  const glm::vec3 sum = a + b;
  return lerpOrdered<Ops>(0.5f * sum, own, weight);
}

// Vertex (x, y) in units of 1 / side (a power of two, at most 2^23) of a patch; height_mm as the shader computes it
// (exaggerated); cut: BaseMesh::cut.
template <class Ops = PlainOps>
glm::vec3 meshVertexFromEye(const std::array<uint32_t, 4>& index, const std::array<EyeCorner, 4>& corner, uint32_t x,
                            uint32_t y, uint32_t side, float height_mm, bool cut) {
  const float scale = 1.0f / static_cast<float>(side);
  float u = static_cast<float>(x) * scale, v = static_cast<float>(y) * scale;
  // A vertex on a side is that side's alone: between its ends a, b at t. Inside, rows first.
  int a = 0, b = 1;
  float t = u;
  if (x == 0 || x == side) {
    a = x == 0 ? 0 : 1;
    b = a + 2;
    t = v;
  } else if (y == side) {
    a = 2;
    b = 3;
  }
  if (index[a] > index[b]) {
    std::swap(a, b);
    t = 1.0f - t;
  }
  const bool inside = x != 0 && x != side && y != 0 && y != side;
  glm::vec3 p = lerpOrdered<Ops>(corner[a].from_eye_mm, corner[b].from_eye_mm, t);
  glm::vec3 n = lerpOrdered<Ops>(corner[a].normal, corner[b].normal, t);
  if (inside) {
    // The two triangles' corners but for (0, 0) and (1, 1): where v > u, the one on the left.
    const float low = std::min(u, v), high = std::max(u, v);
    const size_t third = v > u ? 2 : 1;
    auto across = [&](glm::vec3 EyeCorner::*field) {
      if (cut) {
        auto of = [&](int axis) {
          const float two =
              Ops::mulMulAdd((corner[0].*field)[axis], 1.0f - high, (corner[third].*field)[axis], high - low);
          return Ops::mulAdd((corner[3].*field)[axis], low, two);
        };
        return glm::vec3(of(0), of(1), of(2));
      }
      glm::vec3 top = lerpOrdered<Ops>(corner[0].*field, corner[1].*field, u);
      glm::vec3 bottom = lerpOrdered<Ops>(corner[2].*field, corner[3].*field, u);
      return lerpOrdered<Ops>(top, bottom, v);
    };
    p = across(&EyeCorner::from_eye_mm);
    n = across(&EyeCorner::normal);
  }
  return {Ops::mulAdd(n.x, height_mm, p.x), Ops::mulAdd(n.y, height_mm, p.y), Ops::mulAdd(n.z, height_mm, p.z)};
}

}  // namespace relievo
