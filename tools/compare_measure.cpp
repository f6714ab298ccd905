#include "tools/compare_measure.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>

namespace relievo {

glm::dvec3 PlanarSurface::finestPointMm(const PatchInstance& p, double u, double v) const {
  double size = std::ldexp(1.0, p.step_log2 + p.grid_level);
  double x = std::clamp(p.x0 + u * size, 0.0, static_cast<double>(field_.widthUnits()));
  double y = std::clamp(p.y0 + v * size, 0.0, static_cast<double>(field_.heightUnits()));
  return field_.worldMm(x, y, field_.heightMm(x, y) * exaggerate_);
}

glm::dvec2 Frame::pixelOf(const glm::dvec3& point_mm, bool* in_front) const {
  glm::dvec4 clip = view.clip_from_world * glm::dvec4(point_mm, 1);
  *in_front = clip.w >= view.near_mm;
  return {(clip.x / clip.w * 0.5 + 0.5) * width_px, (clip.y / clip.w * 0.5 + 0.5) * height_px};
}

uint64_t errorVectors(const CompareSurface& surface, const std::vector<PatchInstance>& instances, const Frame& frame, const PlacePixels& pixels,
                  ErrorVectors& errors_px) {
  const float none = std::numeric_limits<float>::quiet_NaN();
  errors_px.resize(pixels.size());
  size_t at = 0;
  uint64_t edge_on = 0;
  for (int y = 0; y < frame.height_px; ++y)
    for (int x = 0; x < frame.width_px; ++x, ++at) {
      errors_px[at] = {none, none};
      const auto& p = pixels[at];
      if (p[2] == 0 || p[2] > instances.size()) continue;
      const PatchInstance& instance = instances[p[2] - 1];
      double u = std::bit_cast<float>(p[0]), v = std::bit_cast<float>(p[1]), cell = std::ldexp(1.0, -instance.grid_level);
      auto outside = [cell](double place) { return !(place >= -cell && place <= 1 + cell); };
      if (outside(u) || outside(v) || !(std::bit_cast<float>(p[3]) <= kMostCellsAPixel * cell)) {
        ++edge_on;
        continue;
      }
      bool in_front = false;
      glm::dvec2 px = frame.pixelOf(surface.finestPointMm(instance, u, v), &in_front);
      if (in_front) errors_px[at] = glm::vec2(glm::dvec2(x + 0.5, y + 0.5) - px);
    }
  return edge_on;
}

ErrorFigures figuresOf(const ErrorVectors& errors_px) {
  std::vector<float> lengths;
  lengths.reserve(errors_px.size());
  double squares = 0;
  for (const glm::vec2& e : errors_px) {
    if (std::isnan(e.x)) continue;
    lengths.push_back(glm::length(e));
    squares += static_cast<double>(glm::dot(e, e));
  }
  ErrorFigures f;
  f.pixels = lengths.size();
  if (lengths.empty()) return f;
  f.rms_px = std::sqrt(squares / static_cast<double>(lengths.size()));
  f.max_px = *std::max_element(lengths.begin(), lengths.end());
  auto rank = lengths.begin() + static_cast<std::ptrdiff_t>(std::ceil(0.99 * static_cast<double>(lengths.size()))) - 1;
  std::nth_element(lengths.begin(), rank, lengths.end());
  f.p99_px = *rank;
  return f;
}

double largestChangePx(const ErrorVectors& before, const ErrorVectors& after) {
  double largest = 0;
  for (size_t i = 0; i < before.size() && i < after.size(); ++i)
    if (!std::isnan(before[i].x) && !std::isnan(after[i].x)) largest = std::max<double>(largest, glm::length(after[i] - before[i]));
  return largest;
}

std::vector<uint8_t> coverage(const PlacePixels& pixels) {
  std::vector<uint8_t> out(pixels.size());
  for (size_t i = 0; i < pixels.size(); ++i) out[i] = pixels[i][2] != 0;
  return out;
}

namespace {

// 1 where everything within `margin` pixels, along rows or columns and diagonally, is 1; beyond the picture counts as 1.
std::vector<uint8_t> eroded(const std::vector<uint8_t>& mask, int width, int height, int margin) {
  std::vector<uint8_t> rows(mask.size()), out(mask.size());
  auto pass = [margin](const uint8_t* from, uint8_t* to, int count, int stride) {
    int last_empty = -margin - 1;
    for (int i = 0; i < count; ++i) {
      if (!from[i * stride]) last_empty = i;
      to[i * stride] = i - last_empty > margin;
    }
    last_empty = count + margin;
    for (int i = count - 1; i >= 0; --i) {
      if (!from[i * stride]) last_empty = i;
      if (last_empty - i <= margin) to[i * stride] = 0;
    }
  };
  for (int y = 0; y < height; ++y) pass(&mask[static_cast<size_t>(y * width)], &rows[static_cast<size_t>(y * width)], width, 1);
  for (int x = 0; x < width; ++x) pass(&rows[static_cast<size_t>(x)], &out[static_cast<size_t>(x)], height, width);
  return out;
}

}  // namespace

CoverageFigures compareCoverage(const std::vector<uint8_t>& drawn, const std::vector<uint8_t>& reference, int width_px, int height_px, int margin_px) {
  CoverageFigures f;
  std::vector<uint8_t> inside = eroded(reference, width_px, height_px, margin_px);
  for (size_t i = 0; i < drawn.size(); ++i) {
    f.silhouette_pixels += drawn[i] != reference[i];
    f.crack_pixels += !drawn[i] && inside[i];
  }
  return f;
}

namespace {

using Bits = std::array<uint32_t, 4>;

struct Placed {
  const PatchInstance* instance = nullptr;
  const float* vertices = nullptr;
  int64_t x0 = 0, y0 = 0, size = 0;
};

// Distinct vertices of the part of a side from `from` to `to` (units along it), in order.
std::vector<Bits> alongSide(const Placed& p, int side, int64_t from, int64_t to) {
  std::vector<Bits> out;
  bool upright = side == kLeft || side == kRight;
  int64_t last = int64_t{1} << p.instance->grid_level, start = upright ? p.y0 : p.x0;
  int64_t first_k = (from - start) * last / p.size, last_k = ((to - start) * last + p.size - 1) / p.size;
  for (int64_t k = first_k; k <= last_k; ++k) {
    int64_t i = side == kLeft ? 0 : side == kRight ? last : k, j = side == kTop ? 0 : side == kBottom ? last : k;
    Bits bits;
    std::memcpy(bits.data(), p.vertices + 4 * (j * (last + 1) + i), sizeof bits);
    if (out.empty() || out.back() != bits) out.push_back(bits);
  }
  return out;
}

}  // namespace

SeamFigures compareSeams(const PlanarDomain& domain, const std::vector<PatchInstance>& instances, std::span<const float> captured) {
  SeamFigures figures;
  int unit_log2 = domain.texture_depth + 7 + kUnitsPerTexelLog2;
  std::map<std::array<int64_t, 3>, Placed> placed;  // level, x, y along the strip
  size_t at = 0;
  for (const PatchInstance& p : instances) {
    size_t vertices = (size_t{1} << p.grid_level) + 1;
    vertices *= vertices;
    if (4 * (at + vertices) > captured.size()) return figures;
    int64_t size = int64_t{1} << (unit_log2 - static_cast<int>(p.node.level));
    placed[{p.node.level, p.x0 / size, p.y0 / size}] = {&p, captured.data() + 4 * at, p.x0, p.y0, size};
    at += vertices;
  }
  auto compare = [&](const Placed& a, int side_a, const Placed& b, int side_b) {
    bool upright = side_a == kLeft || side_a == kRight;
    int64_t from = upright ? std::max(a.y0, b.y0) : std::max(a.x0, b.x0), to = from + std::min(a.size, b.size);
    std::vector<Bits> va = alongSide(a, side_a, from, to), vb = alongSide(b, side_b, from, to);
    figures.compared += std::max(va.size(), vb.size());
    if (va == vb) return;
    // Those of either side that the other one lacks.
    std::sort(va.begin(), va.end());
    std::sort(vb.begin(), vb.end());
    std::vector<Bits> alone;
    std::set_symmetric_difference(va.begin(), va.end(), vb.begin(), vb.end(), std::back_inserter(alone));
    figures.mismatched += std::max<uint64_t>(1, alone.size());
  };
  static constexpr int kDx[4] = {-1, 1, 0, 0}, kDy[4] = {0, 0, -1, 1}, kOpposite[4] = {kRight, kLeft, kBottom, kTop};
  for (const auto& [place, p] : placed)
    for (int side = 0; side < 4; ++side) {
      int64_t x = place[1] + kDx[side], y = place[2] + kDy[side];
      if (x < 0 || y < 0) continue;
      if (auto same = placed.find({place[0], x, y}); same != placed.end()) {
        if (side == kRight || side == kBottom) compare(p, side, same->second, kOpposite[side]);
        continue;
      }
      for (int64_t up = 1; up <= place[0]; ++up)
        if (auto coarser = placed.find({place[0] - up, x >> up, y >> up}); coarser != placed.end()) {
          compare(p, side, coarser->second, kOpposite[side]);
          break;
        }
    }
  return figures;
}

}  // namespace relievo
