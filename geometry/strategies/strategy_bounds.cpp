#include "geometry/strategies/strategy_bounds.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace relievo {
namespace {

Square squareOf(const NodeId& n) { return {n.patch, static_cast<int>(n.level), n.x, n.y}; }
double extentAlong(const glm::dvec4& row, const WorldBox& b) {
  return std::abs(row.x) * b.half.x + std::abs(row.y) * b.half.y + std::abs(row.z) * b.half.z;
}

}  // namespace

bool ViewBounds::culled(const WorldBox& b) const {
  if (!camera_.valid) return false;
  for (const glm::dvec4& plane : camera_.planes) {
    double middle = LodCamera::value(plane, b.centre), reach = extentAlong(plane, b);
    if (middle + reach < -1e-9 * (std::abs(middle) + reach)) return true;
  }
  return false;
}

// planar_lod.cpp derives it.
double ViewBounds::pxPerMm(const WorldBox& b) const {
  if (!camera_.valid) return 0;
  const glm::dvec3 forward = camera_.forward, up(0, 0, 1);
  if (camera_.orthographic)
    return camera_.scale * (b.any_direction ? 1 : std::max(kMinSine, glm::length(up - forward.z * forward)));
  // A movement anyhow: mesh_lod.cpp derives it.
  double centre_depth = LodCamera::value(camera_.depth_row, b.centre);
  double depth = std::max(camera_.near_mm, centre_depth - extentAlong(camera_.depth_row, b));
  glm::dvec3 d = b.centre - camera_.eye;
  double reach = glm::length(b.half);
  double aside = std::sqrt(std::max(0.0, glm::dot(d, d) - centre_depth * centre_depth)) + reach;
  double wholly = std::sqrt(1 + (aside / depth) * (aside / depth)), secant = std::min(camera_.max_secant, wholly);
  double factor = secant;
  if (centre_depth > camera_.near_mm && !b.any_direction) {
    double at_centre = glm::length(up - forward.z * d / centre_depth);
    factor = std::min(secant, std::max(kMinSine, at_centre + std::abs(forward.z) * reach * wholly / depth));
  }
  return camera_.scale / depth * factor;
}

double ViewBounds::nearestMm(const WorldBox& b) const {
  return camera_.orthographic ? kFarEyeMm
                              : glm::length(glm::max(glm::abs(camera_.eye - b.centre) - b.half, glm::dvec3(0)));
}
double ViewBounds::farthestMm(const WorldBox& b) const {
  return camera_.orthographic ? kFarEyeMm : glm::length(glm::abs(camera_.eye - b.centre) + b.half);
}

double ViewBounds::distanceFor(double mm, double px) const {
  if (camera_.orthographic) return mm * camera_.scale <= px ? 0 : std::numeric_limits<double>::infinity();
  // Depth is distance / secant of the angle off the axis, and a movement counts for another secant there.
  return mm * camera_.scale * camera_.max_secant * camera_.max_secant / px;
}

ReliefBounds3d::ReliefBounds3d(const StrategyScene& scene)
    : scene_(scene), unit_log2_(scene.domain.texture_depth + kPageLog2 + kUnitsPerTexelLog2) {
  if (!scene_.domain.isFlat()) {
    unit_log2_ = std::max(0, scene_.domain.relief_depth) + kPageLog2;
    forest_ =
        std::make_shared<MeshForest>(scene_.body->base, scene_.domain.relief_depth, scene_.domain.relief_offset_mm,
                                     scene_.domain.relief_scale_mm, scene_.oracle, scene_.coarse, false);
  }
  const PatchDomain& d = scene_.domain;
  typical_.assign(static_cast<size_t>(std::max(0, finestLevel())) + 1, 0);
  // What is coarser than the root pages is only known to lie within the range; over a base mesh by its table.
  for (int level = 0; level < kPageLog2 && level < finestLevel(); ++level)
    typical_[static_cast<size_t>(level)] = std::abs(65535 * d.relief_scale_mm);
  std::vector<double> pages(typical_.size(), 0);
  std::vector<NodeId> ordered(scene_.resident->begin(), scene_.resident->end());  // sums in the same order in every run
  std::sort(ordered.begin(), ordered.end());
  for (const NodeId& page : ordered) {
    if (static_cast<int>(page.level) >= d.relief_depth) continue;
    double error = heights(page).error_mm;
    typical_[page.level + kPageLog2] += error * error;
    ++pages[page.level + kPageLog2];
  }
  for (size_t level = 0; level < typical_.size(); ++level)
    if (pages[level] > 0) typical_[level] = std::sqrt(typical_[level] / pages[level]);
  for (int level = 0; forest_ && level < std::min(kPageLog2, finestLevel()); ++level) {
    double squares = 0;
    for (const CoarseErrors& of : scene_.coarse)
      squares += double{of[static_cast<size_t>(level)]} * of[static_cast<size_t>(level)];
    typical_[static_cast<size_t>(level)] =
        std::sqrt(squares / static_cast<double>(std::max<size_t>(1, scene_.coarse.size())));
  }
  for (int level = finestLevel() - 1; level > 0; --level)
    typical_[static_cast<size_t>(level - 1)] =
        std::max(typical_[static_cast<size_t>(level - 1)], typical_[static_cast<size_t>(level)]);
}

const HeightBounds& ReliefBounds3d::heights(const NodeId& page) {
  auto [at, fresh] = heights_.try_emplace(page);
  if (!fresh) return at->second;
  HeightBounds b = scene_.oracle->bounds(page);
  if (!(b.min_mm <= b.max_mm) || !std::isfinite(b.min_mm) || !std::isfinite(b.max_mm)) {
    b.min_mm = static_cast<float>(scene_.domain.relief_offset_mm);
    b.max_mm = static_cast<float>(scene_.domain.relief_offset_mm + 65535 * scene_.domain.relief_scale_mm);
    if (b.min_mm > b.max_mm) std::swap(b.min_mm, b.max_mm);
  }
  if (!(b.error_mm >= 0 && (forest_ || b.error_mm <= b.max_mm - b.min_mm))) b.error_mm = b.max_mm - b.min_mm;
  return at->second = b;
}

double ReliefBounds3d::rangeMm(const NodeId& node) {
  const HeightBounds& h = heights(
      node.ancestor(std::min<uint32_t>(node.level, static_cast<uint32_t>(std::max(0, scene_.domain.relief_depth)))));
  return double{h.max_mm} - h.min_mm;
}

double ReliefBounds3d::largestMm(const NodeId& node, double exaggerate) {
  return forest_ ? 2 * glm::length(box(node, exaggerate).half) : rangeMm(node) * std::abs(exaggerate);
}

WorldBox ReliefBounds3d::box(const NodeId& node, double exaggerate) {
  if (forest_) {
    const SquareHull hull = forest_->hull(squareOf(node), exaggerate);
    glm::dvec3 low = hull[0], high = low;
    for (const glm::dvec3& p : hull) low = glm::min(low, p), high = glm::max(high, p);
    return {0.5 * (low + high), 0.5 * (high - low), true};
  }
  const FlatDomain d = scene_.domain.flat();
  const HeightBounds& h =
      heights(node.ancestor(std::min<uint32_t>(node.level, static_cast<uint32_t>(std::max(0, d.relief_depth)))));
  int shift = unit_log2_ - static_cast<int>(node.level);
  int64_t x0 = (static_cast<int64_t>(d.patchOriginX(node.patch)) << kUnitsPerTexelLog2) + (int64_t{node.x} << shift);
  int64_t y0 = (static_cast<int64_t>(d.patchOriginY(node.patch)) << kUnitsPerTexelLog2) + (int64_t{node.y} << shift);
  auto width = static_cast<int64_t>(d.width_px) << kUnitsPerTexelLog2, height = static_cast<int64_t>(d.height_px)
                                                                                << kUnitsPerTexelLog2;
  int64_t x1 = std::min(x0 + (int64_t{1} << shift), width), y1 = std::min(y0 + (int64_t{1} << shift), height);
  double mm = d.mm_per_px / (1 << kUnitsPerTexelLog2);
  double left = (static_cast<double>(x0) - 0.5 * static_cast<double>(width)) * mm,
         right = (static_cast<double>(x1) - 0.5 * static_cast<double>(width)) * mm;
  double top = (0.5 * static_cast<double>(height) - static_cast<double>(y0)) * mm,
         bottom = (0.5 * static_cast<double>(height) - static_cast<double>(y1)) * mm;
  double z0 = h.min_mm * exaggerate, z1 = h.max_mm * exaggerate;
  return {{0.5 * (left + right), 0.5 * (top + bottom), 0.5 * (z0 + z1)},
          {0.5 * (right - left), 0.5 * (top - bottom), 0.5 * std::abs(z1 - z0)}};
}

Deviation ReliefBounds3d::deviation(const NodeId& node, int level, double exaggerate) {
  Deviation d =
      forest_ ? forest_->deviation(squareOf(node), level, exaggerate) : exaggerate * heightDeviation(node, level);
  d.mm = std::min(d.mm, largestMm(node, exaggerate));
  return d;
}

double ReliefBounds3d::betweenMm(const NodeId& node, int level, double exaggerate) {
  PxPerMm any_view{1};
  if (forest_) any_view.turn = forest_->normals(squareOf(node)).turn;
  else any_view.turn = 0;
  return std::min(any_view.between(deviation(node, level, exaggerate)), largestMm(node, exaggerate));
}

Deviation ReliefBounds3d::heightDeviation(const NodeId& node, int level) {
  const PatchDomain& d = scene_.domain;
  int page_level = level - kPageLog2;
  if (page_level >= d.relief_depth) return {};
  const double range = rangeMm(node);
  if (page_level < 0) return Deviation::eitherSide(range);
  NodeId page = node.ancestor(std::min<uint32_t>(static_cast<uint32_t>(page_level), node.level));
  double whole = heights(page).error_mm;
  auto depth = std::min<uint32_t>(node.level - page.level, kErrorBlocksLog2);
  if (depth == 0 || whole == 0) return Deviation::eitherSide(std::min(whole, range));
  auto [found, fresh] = parts_.try_emplace(page);
  if (fresh) found->second.read(*scene_.oracle, page, static_cast<float>(whole));
  NodeId part = node.ancestor(page.level + depth);
  Deviation out = found->second.at(static_cast<int>(depth), part.x - (page.x << depth), part.y - (page.y << depth))
                      .deviation()
                      .atMost(range);
  out.aside_mm = 0;
  return out;
}

PatchInstance ReliefBounds3d::instance(const NodeId& node, int grid_level) const {
  const PatchDomain& d = scene_.domain;
  PatchInstance p;
  p.node = node;
  int shift = unit_log2_ - static_cast<int>(node.level);
  int64_t left = 0, top = 0;  // of the patch; over a base mesh units count within it
  if (d.isFlat()) {
    left = static_cast<int64_t>(d.flat().patchOriginX(node.patch)) << kUnitsPerTexelLog2;
    top = static_cast<int64_t>(d.flat().patchOriginY(node.patch)) << kUnitsPerTexelLog2;
  }
  p.x0 = static_cast<int32_t>(left + (int64_t{node.x} << shift));
  p.y0 = static_cast<int32_t>(top + (int64_t{node.y} << shift));
  p.grid_level = static_cast<uint8_t>(grid_level);
  p.step_log2 = static_cast<uint8_t>(shift - grid_level);
  p.edges.fill({static_cast<uint8_t>(grid_level), PatchInstance::kWholeEdge});
  int page_level = std::clamp(static_cast<int>(node.level) + grid_level - kPageLog2, 0, std::max(0, d.relief_depth));
  p.relief_page = node.ancestor(std::min<uint32_t>(static_cast<uint32_t>(page_level), node.level));
  return p;
}

void ReliefBounds3d::descend(const ViewBounds& view, const NodeId& node, int level, double exaggerate,
                             std::vector<NodeId>& out) {
  if (!scene_.domain.nodeExists(node) || view.culled(box(node, exaggerate))) return;
  if (static_cast<int>(node.level) == level) {
    out.push_back(node);
    return;
  }
  for (uint32_t k = 0; k < 4; ++k) descend(view, node.child(k & 1, k >> 1), level, exaggerate, out);
}

std::vector<NodeId> ReliefBounds3d::nodesInView(const ViewBounds& view, int level, double exaggerate) {
  std::vector<NodeId> out;
  for (uint32_t p = 0; p < scene_.domain.patchCount(); ++p) descend(view, {p, 0, 0, 0}, level, exaggerate, out);
  return out;
}

double ReliefBounds3d::boundPx(const ViewBounds& view, const std::vector<PatchInstance>& instances, double exaggerate) {
  double bound = 0;
  for (const PatchInstance& p : instances) {
    int fine = static_cast<int>(p.node.level) + p.grid_level, coarse = fine;
    for (const auto& side : p.edges) {
      bool halves = side[1] != PatchInstance::kWholeEdge;
      coarse =
          std::min<int>(coarse, static_cast<int>(p.node.level) + (halves ? 1 + std::min(side[0], side[1]) : side[0]));
    }
    double error = coarse < fine ? betweenMm(p.node, coarse, exaggerate) : errorMm(p.node, fine, exaggerate);
    if (error > 0) bound = std::max(bound, error * view.pxPerMm(box(p.node, exaggerate)));
  }
  return bound;
}

bool ReliefBounds3d::neighbour(const NodeId& node, int side, NodeId* out) const {
  if (forest_) {
    Square other;
    if (!forest_->neighbour(squareOf(node), side, other)) return false;
    *out = other.id();
    return true;
  }
  const FlatDomain d = scene_.domain.flat();
  int64_t size = int64_t{1} << node.level;
  int64_t x = node.x + (d.alongX() ? node.patch * size : 0), y = node.y + (d.alongX() ? 0 : node.patch * size);
  x += side == kRight ? 1 : side == kLeft ? -1 : 0;
  y += side == kBottom ? 1 : side == kTop ? -1 : 0;
  if (x < 0 || y < 0) return false;
  int64_t patch = d.alongX() ? x / size : y / size;
  *out = {static_cast<uint32_t>(patch), node.level, static_cast<uint32_t>(d.alongX() ? x % size : x),
          static_cast<uint32_t>(d.alongX() ? y : y % size)};
  return d.nodeExists(*out);
}

}  // namespace relievo
