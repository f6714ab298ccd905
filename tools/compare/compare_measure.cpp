#include "tools/compare/compare_measure.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <map>
#include <tuple>

namespace relievo {

glm::dvec3 PlanarSurface::finestPointMm(const PatchInstance& p, double u, double v) const {
  double size = std::ldexp(1.0, p.step_log2 + p.grid_level);
  double x = std::clamp(p.x0 + u * size, 0.0, static_cast<double>(field_.widthUnits()));
  double y = std::clamp(p.y0 + v * size, 0.0, static_cast<double>(field_.heightUnits()));
  return field_.worldMm(x, y, field_.heightMm(x, y) * exaggerate_);
}

glm::dvec3 BodySurface::finestPointMm(const PatchInstance& p, double u, double v) const {
  const double size = std::ldexp(1.0, p.step_log2 + p.grid_level), side = static_cast<double>(field_.side);
  return field_.pointMm(p.node.patch, std::clamp(p.x0 + u * size, 0.0, side), std::clamp(p.y0 + v * size, 0.0, side),
                        exaggerate_);
}
double BodySurface::mmPerUnit(const PatchInstance& p) const {
  const uint32_t patch = p.node.patch;
  const double diagonals = glm::length(field_.base->point(patch, 1, 1) - field_.base->point(patch, 0, 0)) +
                           glm::length(field_.base->point(patch, 1, 0) - field_.base->point(patch, 0, 1));
  return std::max(diagonals / std::sqrt(8.0), 1e-12) / static_cast<double>(field_.side);
}

glm::dvec2 Frame::pixelOf(const glm::dvec3& point_mm, bool* in_front) const {
  glm::dvec4 clip = view.clip_from_world * glm::dvec4(point_mm, 1);
  *in_front = view.orthographic || clip.w >= view.near_mm;
  return {(clip.x / clip.w * 0.5 + 0.5) * width_px, (clip.y / clip.w * 0.5 + 0.5) * height_px};
}

uint64_t errorVectors(const CompareSurface& surface, const std::vector<PatchInstance>& instances, const Frame& frame,
                      const PlacePixels& pixels, ErrorVectors& errors_px) {
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
      double u = std::bit_cast<float>(p[0]), v = std::bit_cast<float>(p[1]),
             cell = std::ldexp(1.0, -instance.grid_level);
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
    if (!std::isnan(before[i].x) && !std::isnan(after[i].x))
      largest = std::max<double>(largest, glm::length(after[i] - before[i]));
  return largest;
}

std::vector<uint8_t> coverage(const PlacePixels& pixels) {
  std::vector<uint8_t> out(pixels.size());
  for (size_t i = 0; i < pixels.size(); ++i) out[i] = pixels[i][2] != 0;
  return out;
}

namespace {

// 1 where everything within `margin` pixels, along rows or columns and diagonally, is 1; beyond the picture counts
// as 1.
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
  for (int y = 0; y < height; ++y)
    pass(&mask[static_cast<size_t>(y * width)], &rows[static_cast<size_t>(y * width)], width, 1);
  for (int x = 0; x < width; ++x) pass(&rows[static_cast<size_t>(x)], &out[static_cast<size_t>(x)], height, width);
  return out;
}

}  // namespace

CoverageFigures compareCoverage(const std::vector<uint8_t>& drawn, const std::vector<uint8_t>& reference, int width_px,
                                int height_px, int margin_px) {
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

// Those of either side that the other one lacks; one at least where they differ.
void compareRuns(std::vector<Bits> a, std::vector<Bits> b, SeamFigures& figures) {
  figures.compared += std::max(a.size(), b.size());
  if (a == b) return;
  std::sort(a.begin(), a.end());
  std::sort(b.begin(), b.end());
  std::vector<Bits> alone;
  std::set_symmetric_difference(a.begin(), a.end(), b.begin(), b.end(), std::back_inserter(alone));
  figures.mismatched += std::max<uint64_t>(1, alone.size());
}

// Distinct vertices of the part of a side from `from` to `to` (units along it), in order.
std::vector<Bits> alongSide(const Placed& p, int side, int64_t from, int64_t to) {
  std::vector<Bits> out;
  bool upright = side == kLeft || side == kRight;
  int64_t last = int64_t{1} << p.instance->grid_level, start = upright ? p.y0 : p.x0;
  int64_t first_k = (from - start) * last / p.size, last_k = ((to - start) * last + p.size - 1) / p.size;
  for (int64_t k = first_k; k <= last_k; ++k) {
    int64_t i = side == kLeft ? 0 : side == kRight ? last : k, j = side == kTop ? 0 : side == kBottom ? last : k;
    Bits bits;
    // -0 is 0: at a corner of a base mesh they may differ in that, which no picture shows.
    for (size_t n = 0; n < 4; ++n)
      bits[n] = std::bit_cast<uint32_t>(p.vertices[4 * (j * (last + 1) + i) + static_cast<int64_t>(n)] + 0.0f);
    if (out.empty() || out.back() != bits) out.push_back(bits);
  }
  return out;
}

}  // namespace

SeamFigures compareSeams(const FlatDomain& domain, const std::vector<PatchInstance>& instances,
                         std::span<const float> captured) {
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
    compareRuns(alongSide(a, side_a, from, to), alongSide(b, side_b, from, to), figures);
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

// A line is what nodes can meet at: a side that two patches share, or a line of units inside a patch. Nodes on either
// hand of it never overlap one another along it.
SeamFigures compareSeams(const BaseMesh& mesh, int unit_log2, const std::vector<PatchInstance>& instances,
                         std::span<const float> captured) {
  struct Entry {
    std::array<uint32_t, 4>
        line;           // 1, patch, upright, across; or 0, patch, side, 0: of the two patches the first one's name
    bool second, flip;  // hand; runs the other way than the line
    int64_t from, to;   // along the line
    Placed placed;
    int side;
  };
  SeamFigures figures;
  const std::vector<PatchNeighbours> neighbours = patchNeighbours(mesh);
  const int64_t whole = int64_t{1} << unit_log2;
  std::vector<Entry> entries;
  size_t at = 0;
  for (const PatchInstance& p : instances) {
    size_t vertices = (size_t{1} << p.grid_level) + 1;
    vertices *= vertices;
    if (4 * (at + vertices) > captured.size()) return figures;
    const int64_t size = whole >> p.node.level;
    const Placed placed{&p, captured.data() + 4 * at, p.x0, p.y0, size};
    at += vertices;
    for (int side = 0; side < 4; ++side) {
      const bool upright = side == kLeft || side == kRight, far = side == kRight || side == kBottom;
      const int64_t across = (upright ? p.x0 : p.y0) + (far ? size : 0), along = upright ? p.y0 : p.x0;
      Entry e{{1, p.node.patch, upright, static_cast<uint32_t>(across)}, far, false, along, along + size, placed, side};
      if (across == 0 || across == whole) {
        const PatchNeighbour& n = neighbours[p.node.patch][static_cast<size_t>(side)];
        if (n.patch == PatchNeighbour::kNone) continue;
        const std::array<uint32_t, 2> own{p.node.patch, static_cast<uint32_t>(side)},
            other{n.patch, static_cast<uint32_t>(n.side)};
        const auto& first = std::min(own, other);
        e.line = {0, first[0], first[1], 0};
        e.second = other < own;
        e.flip = e.second && n.reversed;
        if (e.flip) std::tie(e.from, e.to) = std::pair{whole - e.to, whole - e.from};
      }
      entries.push_back(e);
    }
  }
  std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) {
    return std::tie(a.line, a.second, a.from) < std::tie(b.line, b.second, b.from);
  });
  auto run = [&](const Entry& e, int64_t from, int64_t to) {
    if (!e.flip) return alongSide(e.placed, e.side, from, to);
    std::vector<Bits> bits = alongSide(e.placed, e.side, whole - to, whole - from);
    std::reverse(bits.begin(), bits.end());
    return bits;
  };
  for (size_t first = 0, end = 0; first < entries.size(); first = end) {
    size_t middle = first;
    while (middle < entries.size() && entries[middle].line == entries[first].line && !entries[middle].second) ++middle;
    end = middle;
    while (end < entries.size() && entries[end].line == entries[first].line) ++end;
    for (size_t a = first, b = middle; a < middle && b < end;) {
      const int64_t from = std::max(entries[a].from, entries[b].from), to = std::min(entries[a].to, entries[b].to);
      if (from < to) compareRuns(run(entries[a], from, to), run(entries[b], from, to), figures);
      if (entries[a].to <= entries[b].to) ++a;
      else ++b;
    }
  }
  return figures;
}

}  // namespace relievo
