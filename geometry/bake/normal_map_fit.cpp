#include "geometry/bake/normal_map_fit.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "geometry/bake/mip_image.h"

namespace relievo {
namespace {

constexpr size_t kLooks = size_t{1} << 16;  // triangles
// How much nearer the other way must be. Of 16 maps of scans whose files say it, or that were seen to be so, the right
// way was 1.3 to 4.2 times nearer; where a map only has what is finer than triangles, both are within a hundredth.
constexpr double kClearly = 0.8;
// No normal in tangent space points inwards, z below 0; few do by rounding, or where a map has none.
constexpr double kInwards = -0.1, kMostInwards = 0.01;

// How far from the triangles' planes the normals of a map are, whichever way its y counts: the mean over the surface
// of 1 less the cosine. And the share of the surface where they point inwards.
struct Off {
  double upwards = 0, downwards = 0, inwards = 0;
};
Off normalsOff(const TriMesh& mesh, uint16_t number, const MeshBake::Image& image,
               std::span<const glm::vec3> vertex_normals) {
  const MipImage map(image.normals_width, image.normals_height, 3, image.normals, 0, image.repeats);
  const auto shows = [&](size_t t) { return mesh.image_of.empty() ? number == 0 : mesh.image_of[t] == number; };
  size_t shown = 0;
  for (size_t t = 0; t < mesh.triangles.size(); ++t) shown += shows(t);
  const size_t step = shown / kLooks + 1;
  size_t next = 0;
  Off sum;
  double all = 0;
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    if (!shows(t) || next++ % step != 0) continue;
    const auto& corners = mesh.triangles[t];
    const auto& uv = mesh.corner_uv[t];
    const glm::dvec3 p(mesh.positions_mm[corners[0]]), e = glm::dvec3(mesh.positions_mm[corners[1]]) - p,
                                                       f = glm::dvec3(mesh.positions_mm[corners[2]]) - p;
    const glm::dvec2 i(uv[1] - uv[0]), j(uv[2] - uv[0]);
    const double area = i.x * j.y - i.y * j.x, size = glm::length(glm::cross(e, f));
    if (area == 0 || !(size > 0)) continue;
    const glm::dvec3 face = glm::cross(e, f) / size,
                     along = glm::normalize((area > 0 ? 1.0 : -1.0) * (e * j.y - f * i.y));
    constexpr std::array<std::array<double, 3>, 3> kPlaces{{{0.6, 0.2, 0.2}, {0.2, 0.6, 0.2}, {0.2, 0.2, 0.6}}};
    for (const auto& w : kPlaces) {
      glm::dvec3 smooth(0);
      glm::vec2 at(0);
      for (size_t k = 0; k < 3; ++k) {
        glm::vec3 own(0);
        if (!mesh.corner_normals.empty()) own = mesh.corner_normals[t][k];
        if (own == glm::vec3(0) && !vertex_normals.empty()) own = vertex_normals[corners[k]];
        smooth += w[k] * glm::dvec3(own);
        at += static_cast<float>(w[k]) * uv[k];
      }
      if (!(glm::length(smooth) > 1e-3)) continue;
      smooth = glm::normalize(smooth);
      const glm::dvec3 across = along - glm::dot(along, smooth) * smooth;
      if (!(glm::length(across) > 1e-3)) continue;
      std::array<float, 3> texel{};
      map.sample(at, 0, texel);
      const glm::dvec3 n(texel[0] / 127.5 - 1, texel[1] / 127.5 - 1, texel[2] / 127.5 - 1),
          tangent = glm::normalize(across), up = (area > 0 ? 1.0 : -1.0) * glm::cross(smooth, tangent);
      const auto off = [&](double y) {
        const glm::dvec3 mapped = n.x * tangent + y * up + n.z * smooth;
        const double length = glm::length(mapped);
        return length > 0 ? 1 - glm::dot(mapped, face) / length : 0;
      };
      sum.upwards += size * off(n.y);
      sum.downwards += size * off(-n.y);
      sum.inwards += n.z < kInwards ? size : 0;
      all += size;
    }
  }
  return all > 0 ? Off{sum.upwards / all, sum.downwards / all, sum.inwards / all} : Off{};
}

}  // namespace

NormalMapFit normalMapFit(const TriMesh& mesh, uint16_t number, const MeshBake::Image& image, NormalMap::Y y,
                          std::span<const glm::vec3> vertex_normals) {
  if (image.normals.empty() || mesh.corner_uv.empty()) return NormalMapFit::kNone;
  const Off off = normalsOff(mesh, number, image, vertex_normals);
  const bool downwards =
      y == NormalMap::Y::kUnknown ? off.downwards < kClearly * off.upwards : y == NormalMap::Y::kDownwards;
  if (off.inwards > kMostInwards) return NormalMapFit::kNone;
  return downwards ? NormalMapFit::kDownwards : NormalMapFit::kUpwards;
}

}  // namespace relievo
