#include "src/artwork/tangent_frames.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "src/base/angle_of.h"

namespace relievo {
namespace {

double lengthOf(const glm::dvec3& v) { return std::sqrt(v.x * v.x + v.y * v.y + v.z * v.z); }
double dot(const glm::dvec3& a, const glm::dvec3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
glm::dvec3 unit(const glm::dvec3& v) {
  const double length = lengthOf(v);
  return length > 0 ? v / length : glm::dvec3(0);
}
// Across the normal.
glm::dvec3 across(const glm::dvec3& v, const glm::dvec3& normal) { return unit(v - dot(v, normal) * normal); }

}  // namespace

void TangentFrames::reserve(size_t triangles) {
  frames_.reserve(triangles);
  corners_.reserve(3 * triangles);
}

void TangentFrames::add(const MappedTriangle& t) {
  TangentFrame& frame = frames_.emplace_back();
  const glm::dvec3 e = t.position[1] - t.position[0], f = t.position[2] - t.position[0];
  const glm::dvec2 i = t.place[1] - t.place[0], j = t.place[2] - t.place[0];
  const double area = i.x * j.y - i.y * j.x;
  if (area == 0 || !std::isfinite(area)) return;
  const glm::dvec3 along = (area > 0 ? 1.0 : -1.0) * (e * j.y - f * i.y);
  std::array<glm::dvec3, 3> tangents;
  for (size_t k = 0; k < 3; ++k) {
    tangents[k] = across(along, unit(glm::dvec3(t.normal[k])));
    if (tangents[k] == glm::dvec3(0)) return;
  }
  frame.hand = (area > 0) != (t.clockwise != t.downwards) ? 1.0f : -1.0f;
  for (size_t k = 0; k < 3; ++k) {
    const glm::dvec3 a = unit(t.position[(k + 1) % 3] - t.position[k]),
                     b = unit(t.position[(k + 2) % 3] - t.position[k]);
    const glm::dvec3 turn = glm::cross(a, b);
    const auto sine = static_cast<float>(lengthOf(turn)), cosine = static_cast<float>(dot(a, b));
    // One that is nearly a line still has a tangent.
    const float angle = sine > 0 || cosine != 0 ? std::max(angleOf(sine, cosine), 1e-3f) : 1e-3f;
    frame.tangent[k] = glm::vec3(tangents[k] * double{angle});
    Corner corner{t.corner[k], static_cast<uint32_t>(3 * (frames_.size() - 1) + k)};
    corners_.push_back(corner);
  }
}

std::vector<TangentFrame> TangentFrames::finish() && {
  const auto handOf = [&](const Corner& c) { return frames_[c.at / 3].hand > 0; };
  std::sort(corners_.begin(), corners_.end(), [&](const Corner& a, const Corner& b) {
    if (a.is != b.is) return a.is < b.is;
    return std::pair(handOf(a), a.at) < std::pair(handOf(b), b.at);
  });
  for (size_t first = 0, end = 0; first < corners_.size(); first = end) {
    glm::dvec3 sum(0);
    for (end = first; end < corners_.size() && corners_[end].is == corners_[first].is &&
                      handOf(corners_[end]) == handOf(corners_[first]);
         ++end)
      sum += glm::dvec3(frames_[corners_[end].at / 3].tangent[corners_[end].at % 3]);
    const glm::dvec3 mean = unit(sum);
    constexpr double kOpposed = 1e-6;  // those of a corner cancel out: each keeps its own
    const bool any = lengthOf(sum) > kOpposed;
    for (size_t c = first; c < end; ++c) {
      glm::vec3& tangent = frames_[corners_[c].at / 3].tangent[corners_[c].at % 3];
      tangent = glm::vec3(any ? mean : unit(glm::dvec3(tangent)));
    }
  }
  return std::move(frames_);
}

}  // namespace relievo
