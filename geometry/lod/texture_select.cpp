// texture_select.cpp - see the header.
// What a pixel's footprint on the artwork is. With clip coordinates scaled to pixels, rows R, U (screen x, y) and F
// (w), a point P at d from the eye lies at s = (R.d, U.d) / F.d. Let qx, qy be the first two columns of [R; U; F]^-1,
// and o = -d_xy / d_z: where the line of sight goes sideways while it falls by 1. On the horizontal plane through P the
// pixel's footprint has the sides
//   c_i = w (q_i.xy + q_i.z o),   i = x, y   (w = F.d): (1)
// so the shader's gradient is max(|c_x|, |c_y|): exact for a flat artwork, where o is affine in P.
// Orthographic views have no F: w is the same everywhere, lines of sight are parallel (o is one for all, and so is the
// footprint on a plane), and q_i lie across them. On a surface of gradient g the sides are c_i' = c_i - o (g.c_i) / (1
// + g.o) (Sherman-Morrison). Their parts across o do not depend on g, and |c_i| <= (1 + |g||o|) |c_i'|: with a bound S
// of |g|,
//   |c_i'| >= max(part of c_i across o, |c_i| / (1 + S |o|)): (2)
// a slope that faces the viewer can undo the foreshortening along the line of sight, never what lies across it.
#include "geometry/lod/texture_select.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace relievo {
namespace {

constexpr int kFlatSplits = 3;  // a node that may be wanted is cut into quarters so often before it counts as wanted
constexpr int kReliefSplits = 2;

double cross(const glm::dvec2& a, const glm::dvec2& b) { return a.x * b.y - a.y * b.x; }
double norm2(const glm::dvec2& a) { return glm::dot(a, a); }

double distance2ToSegment(const glm::dvec2& p, const glm::dvec2& a, const glm::dvec2& b) {
  glm::dvec2 along = b - a;
  double length2 = norm2(along);
  double t = length2 > 0 ? std::clamp(glm::dot(p - a, along) / length2, 0.0, 1.0) : 0.0;
  return norm2(p - (a + along * t));
}

// A convex polygon: a rectangle cut by a few half planes.
struct Polygon {
  static constexpr int kMax = 12;
  std::array<glm::dvec2, kMax> at;
  int count = 0;
  void add(const glm::dvec2& p) {
    if (count < kMax) at[static_cast<size_t>(count++)] = p;
  }
};

// x, y in mm; heights in mm, exaggerated.
struct Region {
  double x0 = 0, x1 = 0, y0 = 0, y1 = 0, z0 = 0, z1 = 0;
};

class TextureSelection {
 public:
  TextureSelection(const FlatDomain& domain, const ReliefOracle& oracle, const TextureView& view)
      : domain_(domain), oracle_(oracle), view_(view) {
    flat_ = !view.relief || domain.relief_depth < 0 || view.exaggerate == 0;
    half_w_mm_ = 0.5 * static_cast<double>(domain.width_px) * domain.mm_per_px;
    half_h_mm_ = 0.5 * static_cast<double>(domain.height_px) * domain.mm_per_px;
    if (!flat_) {
      low_mm_ = domain.relief_offset_mm * view.exaggerate;
      high_mm_ = (domain.relief_offset_mm + 65535 * domain.relief_scale_mm) * view.exaggerate;
      if (low_mm_ > high_mm_) std::swap(low_mm_, high_mm_);
      int texels_log2 = domain.texture_depth - domain.relief_depth;  // between the finest samples
      slope_per_mm_ = std::sqrt(2.0) / std::ldexp(domain.mm_per_px, texels_log2);
    }
    valid_ = setView();
  }

  std::vector<TextureRequest> run() {
    if (!valid_) {
      for (uint32_t p = 0; p < std::min<size_t>(domain_.patchCount(), kMaxTextureRequests); ++p)
        requests_.push_back({{p, 0, 0, 0}, 1});
      return std::move(requests_);
    }
    std::vector<TextureRequest> level, next;
    addRoots(0, domain_.patchCount(), level);
    for (int l = 0; !level.empty(); ++l) {
      std::sort(level.begin(), level.end(), [](const TextureRequest& a, const TextureRequest& b) {
        return a.priority != b.priority ? a.priority < b.priority : a.node < b.node;
      });
      level.resize(std::min(level.size(), kMaxTextureRequests - requests_.size()));
      requests_.insert(requests_.end(), level.begin(), level.end());
      next.clear();
      if (l < domain_.texture_depth) {
        for (const TextureRequest& w : level) {
          for (uint32_t cy = 0; cy < 2; ++cy)
            for (uint32_t cx = 0; cx < 2; ++cx)
              if (NodeId c = w.node.child(cx, cy); domain_.nodeExists(c)) addIfWanted(c, next);
        }
      }
      level.swap(next);
    }
    return std::move(requests_);
  }

 private:
  bool setView() {
    const TextureView& v = view_;
    if (v.width_px <= 0 || v.height_px <= 0 || !std::isfinite(v.lod_bias) || !std::isfinite(v.near_mm)) return false;
    if (!std::isfinite(v.exaggerate) || !(v.anisotropy >= 1) || !std::isfinite(v.anisotropy)) return false;
    glm::dmat4 rows = glm::transpose(v.clip_from_world);
    for (int i = 0; i < 4; ++i)
      for (int j = 0; j < 4; ++j)
        if (!std::isfinite(rows[i][j])) return false;
    if (!std::isfinite(v.eye_mm.x) || !std::isfinite(v.eye_mm.y) || !std::isfinite(v.eye_mm.z)) return false;
    // Pixels from the view's centre.
    double half_w = 0.5 * v.width_px, half_h = 0.5 * v.height_px;
    glm::dvec3 r = glm::dvec3(rows[0]) * half_w, u = glm::dvec3(rows[1]) * half_h, f(rows[3]);
    orthographic_ = glm::length(f) <= 1e-12 * std::abs(rows[3].w);
    if (orthographic_ ? !(rows[3].w > 0) : !(v.near_mm > 0)) return false;
    if (orthographic_) f = glm::dvec3(0);
    const glm::dvec3 ahead = orthographic_ ? glm::cross(r, u) : f;
    glm::dmat3 screen_from_eye = glm::transpose(glm::dmat3(r, u, ahead));
    double det = glm::determinant(screen_from_eye);
    if (!(std::abs(det) > 1e-12 * glm::length(r) * glm::length(u) * glm::length(ahead))) return false;
    glm::dmat3 eye_from_screen = glm::inverse(screen_from_eye);
    q_ = {eye_from_screen[0], eye_from_screen[1]};
    q_w_ = eye_from_screen[2];
    if (!std::isfinite(q_[0].x + q_[0].y + q_[0].z + q_[1].x + q_[1].y + q_[1].z)) return false;
    depth_row_ = rows[3];
    x_row_ = rows[0] * half_w;
    y_row_ = rows[1] * half_h;
    near_w_ = v.near_mm * glm::length(f);
    // Between the outermost pixel centres: nothing beside them is ever sampled. Relief is drawn error_px off at most,
    // twice that where levels meet.
    double margin = kPixelSlack - 0.5;
    if (!flat_) margin += 2 * std::max(0.0, std::isfinite(v.error_px) ? v.error_px : 0.0);
    planes_ = {x_row_ + rows[3] * (half_w + margin), rows[3] * (half_w + margin) - x_row_,
               y_row_ + rows[3] * (half_h + margin), rows[3] * (half_h + margin) - y_row_,
               rows[3] * (1 + 1e-6) + rows[2],       rows[3] * (1 + 1e-6) - rows[2]};
    if (orthographic_) {
      edge_on_ = !(std::abs(q_w_.z) > 1e-12 * glm::length(q_w_));
      if (flat_ && edge_on_) return false;
      if (!edge_on_) sideways_ = glm::dvec2(q_w_) / -q_w_.z;
    } else if (flat_ && !(std::abs(v.eye_mm.z) > 0)) {
      return false;
    }
    // The largest that a horizontal millimetre at w = 1 can be on the screen: the norm of an affine function, so at a
    // corner.
    for (double sx : {-half_w, half_w}) {
      for (double sy : {-half_h, half_h}) {
        glm::dvec2 a = glm::dvec2(r - sx * f), b = glm::dvec2(u - sy * f);
        px_per_mm_ = std::max(px_per_mm_, largestSingular(glm::dvec2(a.x, b.x), glm::dvec2(a.y, b.y)));
      }
    }
    screen_x_ = {r.x, r.y};
    screen_y_ = {u.x, u.y};
    screen_w_ = {f.x, f.y};
    corner_px_ = std::hypot(half_w, half_h);
    return px_per_mm_ > 0;
  }
  // Of the 2x2 matrix with these columns.
  static double largestSingular(const glm::dvec2& a, const glm::dvec2& b) {
    double aa = norm2(a), bb = norm2(b), ab = glm::dot(a, b);
    return std::sqrt(0.5 * (aa + bb + std::sqrt((aa - bb) * (aa - bb) + 4 * ab * ab)));
  }
  static double value(const glm::dvec4& row, const glm::dvec3& p) {
    return row.x * p.x + row.y * p.y + row.z * p.z + row.w;
  }

  // A pixel with a gradient below this (mm) wants the level, or a finer one.
  double thresholdMm(int level) const {
    if (level == 0) return std::numeric_limits<double>::infinity();  // the shader clamps
    double lod = domain_.texture_depth - level + (view_.trilinear ? 1.0 : 0.5) - view_.lod_bias + kLodSlack;
    return std::exp2(lod) * domain_.mm_per_px;
  }

  // Heights are left to the caller.
  Region regionOf(const NodeId& n) const {
    double side = std::ldexp(static_cast<double>(domain_.patchPx()), -static_cast<int>(n.level));
    double left = static_cast<double>(domain_.patchOriginX(n.patch)) + side * n.x;
    double top = static_cast<double>(domain_.patchOriginY(n.patch)) + side * n.y;
    // The taps of an anisotropic look-up lie up to half the ratio beside the pixel, in steps of less than two texels of
    // the level.
    double reach = view_.anisotropy > 1 ? view_.anisotropy * side / kPagePx : 0;
    return rectangle(left - reach, top - reach, left + side + reach, top + side + reach);
  }
  Region rectangle(double left, double top, double right, double bottom) const {
    auto width = static_cast<double>(domain_.width_px), height = static_cast<double>(domain_.height_px);
    double mm = domain_.mm_per_px;
    return {std::max(left, 0.0) * mm - half_w_mm_,
            std::min(right, width) * mm - half_w_mm_,
            half_h_mm_ - std::min(bottom, height) * mm,
            half_h_mm_ - std::max(top, 0.0) * mm,
            0,
            0};
  }
  void setHeights(const NodeId& node, Region& r) const {
    if (flat_) return;
    r.z0 = low_mm_;
    r.z1 = high_mm_;
    // Beside the page lie pixels whose taps reach into it: their heights are anyone's guess.
    if (view_.anisotropy > 1) return;
    HeightBounds b =
        oracle_.bounds(node.ancestor(std::min<uint32_t>(node.level, static_cast<uint32_t>(domain_.relief_depth))));
    if (!std::isfinite(b.min_mm) || !std::isfinite(b.max_mm) || !(b.min_mm <= b.max_mm)) return;
    r.z0 = b.min_mm * view_.exaggerate;
    r.z1 = b.max_mm * view_.exaggerate;
    if (r.z0 > r.z1) std::swap(r.z0, r.z1);
  }

  void addRoots(uint32_t first, uint32_t last, std::vector<TextureRequest>& out) {
    if (last - first > 1) {  // the strip as a binary tree of ranges
      uint32_t end = last - 1;
      auto side = static_cast<double>(domain_.patchPx());
      Region r = rectangle(
          static_cast<double>(domain_.patchOriginX(first)), static_cast<double>(domain_.patchOriginY(first)),
          static_cast<double>(domain_.patchOriginX(end)) + side, static_cast<double>(domain_.patchOriginY(end)) + side);
      r.z0 = low_mm_;
      r.z1 = high_mm_;
      if (culled(r)) return;
      uint32_t middle = first + (last - first) / 2;
      addRoots(first, middle, out);
      addRoots(middle, last, out);
      return;
    }
    addIfWanted({first, 0, 0, 0}, out);
  }
  void addIfWanted(const NodeId& node, std::vector<TextureRequest>& out) {
    Region r = regionOf(node);
    setHeights(node, r);
    double threshold = thresholdMm(static_cast<int>(node.level));
    bool wanted = flat_ ? flatWanted(r, threshold, kFlatSplits) : reliefWanted(node, r, threshold, kReliefSplits);
    if (wanted) out.push_back({node, priority(r)});
  }

  bool culled(const Region& r) const {
    glm::dvec3 centre{0.5 * (r.x0 + r.x1), 0.5 * (r.y0 + r.y1), 0.5 * (r.z0 + r.z1)};
    glm::dvec3 half{0.5 * (r.x1 - r.x0), 0.5 * (r.y1 - r.y0), 0.5 * (r.z1 - r.z0)};
    for (const glm::dvec4& p : planes_) {
      double reach = std::abs(p.x) * half.x + std::abs(p.y) * half.y + std::abs(p.z) * half.z,
             middle = value(p, centre);
      if (middle + reach < -1e-12 * (std::abs(middle) + reach)) return true;
    }
    return false;
  }

  // ---- flat
  Polygon visiblePart(const Region& r) const {
    Polygon p;
    for (const glm::dvec2& c :
         {glm::dvec2(r.x0, r.y0), glm::dvec2(r.x1, r.y0), glm::dvec2(r.x1, r.y1), glm::dvec2(r.x0, r.y1)})
      p.add(c);
    for (const glm::dvec4& plane : planes_) {
      std::array<double, Polygon::kMax> side{};
      bool all = true;
      for (int i = 0; i < p.count; ++i) {
        const glm::dvec2& at = p.at[static_cast<size_t>(i)];
        side[static_cast<size_t>(i)] = plane.x * at.x + plane.y * at.y + plane.w;
        all = all && side[static_cast<size_t>(i)] >= 0;
      }
      if (all) continue;
      Polygon cut;
      for (int i = 0; i < p.count; ++i) {
        auto a = static_cast<size_t>(i), b = static_cast<size_t>((i + 1) % p.count);
        if (side[a] >= 0) cut.add(p.at[a]);
        if ((side[a] >= 0) != (side[b] >= 0)) cut.add(p.at[a] + (p.at[b] - p.at[a]) * (side[a] / (side[a] - side[b])));
      }
      p = cut;
      if (p.count == 0) break;
    }
    return p;
  }
  // The gradient that decides the level, at a visible point: (1).
  double footprint(const std::array<glm::dvec2, 2>& c) const {
    double longest = std::sqrt(std::max(norm2(c[0]), norm2(c[1])));
    if (view_.anisotropy <= 1) return longest;
    double major = largestSingular(c[0], c[1]);
    double minor = major > 0 ? std::abs(cross(c[0], c[1])) / major : 0;
    return std::max(minor, major / view_.anisotropy);
  }
  bool flatWanted(const Region& r, double threshold, int splits) const {
    Polygon p = visiblePart(r);
    if (p.count < 3) return false;
    if (orthographic_) return flatWantedFromAfar(p, threshold);
    double w_min = std::numeric_limits<double>::infinity(), stretch = 0;
    Polygon o, screen;
    for (int i = 0; i < p.count; ++i) {
      const glm::dvec2& at = p.at[static_cast<size_t>(i)];
      glm::dvec3 world(at, 0);
      double w = value(depth_row_, world);
      if (!(w > 0)) return true;  // cannot tell
      o.add((at - glm::dvec2(view_.eye_mm)) / view_.eye_mm.z);
      glm::dvec2 s = glm::dvec2(value(x_row_, world), value(y_row_, world)) / w;
      screen.add(s);
      w_min = std::min(w_min, w);
      if (view_.anisotropy > 1) {
        glm::dvec2 a = screen_x_ - s.x * screen_w_, b = screen_y_ - s.y * screen_w_;
        stretch = std::max(stretch, largestSingular(glm::dvec2(a.x, b.x), glm::dvec2(a.y, b.y)));
      }
    }
    if (!std::isinf(threshold) && w_min * leastAtUnitDepth(o, stretch) >= threshold) return false;
    glm::dvec2 pixel;
    if (!findPixelCentre(screen, &pixel)) return false;
    if (std::isinf(threshold) || splits == 0) return true;
    // The line of sight of that pixel, and its footprint: (1).
    glm::dvec3 ray = q_[0] * pixel.x + q_[1] * pixel.y + q_w_;
    double w = -view_.eye_mm.z / ray.z;
    glm::dvec2 sideways = glm::dvec2(ray) / -ray.z;
    std::array<glm::dvec2, 2> c;
    for (size_t k = 0; k < 2; ++k) c[k] = w * (glm::dvec2(q_[k]) + q_[k].z * sideways);
    if (footprint(c) < threshold) return true;
    return anyQuarter(r, [&](const Region& quarter) { return flatWanted(quarter, threshold, splits - 1); });
  }
  bool flatWantedFromAfar(const Polygon& visible, double threshold) const {
    const double w = depth_row_.w;
    std::array<glm::dvec2, 2> c;
    for (size_t k = 0; k < 2; ++k) c[k] = w * (glm::dvec2(q_[k]) + q_[k].z * sideways_);
    if (!(footprint(c) < threshold)) return false;
    Polygon screen;
    for (int i = 0; i < visible.count; ++i) {
      const glm::dvec3 world(visible.at[static_cast<size_t>(i)], 0);
      screen.add(glm::dvec2(value(x_row_, world), value(y_row_, world)) / w);
    }
    glm::dvec2 pixel;
    return findPixelCentre(screen, &pixel);
  }
  // Over a convex part of the plane, given by its o, at w = 1.
  double leastAtUnitDepth(const Polygon& o, double stretch) const {
    double longest = 0;
    for (const glm::dvec3& q : q_) {
      double least = glm::length(glm::dvec2(q));
      if (std::abs(q.z) > 1e-12 * glm::length(q)) least = std::abs(q.z) * distance(glm::dvec2(q) / -q.z, o);
      longest = std::max(longest, least);
    }
    return view_.anisotropy > 1 ? std::max(1 / stretch, longest / view_.anisotropy) : longest;
  }
  static double distance(const glm::dvec2& from, const Polygon& p) {
    double best = 1e300;
    bool left = false, right = false;
    for (int i = 0; i < p.count; ++i) {
      const glm::dvec2 &a = p.at[static_cast<size_t>(i)], &b = p.at[static_cast<size_t>((i + 1) % p.count)];
      best = std::min(best, distance2ToSegment(from, a, b));
      double side = cross(b - a, from - a);
      left = left || side > 0;
      right = right || side < 0;
    }
    return left && right ? std::sqrt(best) : 0;  // inside: nothing between
  }
  template <class F>
  static bool anyQuarter(const Region& r, F&& f) {
    double xm = 0.5 * (r.x0 + r.x1), ym = 0.5 * (r.y0 + r.y1);
    for (int k = 0; k < 4; ++k) {
      Region quarter = r;
      (k & 1 ? quarter.x0 : quarter.x1) = xm;
      (k & 2 ? quarter.y0 : quarter.y1) = ym;
      if (f(quarter)) return true;
    }
    return false;
  }
  // A pixel's centre in the polygon (or up to kPixelSlack beside it), from the middle rows outwards: large pages have
  // one there.
  bool findPixelCentre(const Polygon& screen, glm::dvec2* pixel) const {
    // Pixel centres from the view's centre: k + 0.5 - half the size.
    const double x_shift = 0.5 * view_.width_px - 0.5, y_shift = 0.5 * view_.height_px - 0.5;
    double low = 1e300, high = -1e300;
    for (int i = 0; i < screen.count; ++i) {
      low = std::min(low, screen.at[static_cast<size_t>(i)].y);
      high = std::max(high, screen.at[static_cast<size_t>(i)].y);
    }
    const double first = std::ceil(low + y_shift - kPixelSlack), last = std::floor(high + y_shift + kPixelSlack);
    const double middle = std::floor(0.5 * (first + last));
    for (double step = 0; step <= last - first + 1; ++step) {
      double row = std::fmod(step, 2) == 0 ? middle - 0.5 * step : middle + 0.5 * (step + 1);
      if (row < first || row > last) continue;
      double left = 1e300, right = -1e300;  // of the polygon within kPixelSlack of the row
      for (int i = 0; i < screen.count; ++i) {
        const glm::dvec2 &a = screen.at[static_cast<size_t>(i)],
                         &b = screen.at[static_cast<size_t>((i + 1) % screen.count)];
        double y0 = row - y_shift - kPixelSlack, y1 = row - y_shift + kPixelSlack;
        if (std::max(a.y, b.y) < y0 || std::min(a.y, b.y) > y1) continue;
        for (double y : {y0, y1}) {
          double t = a.y != b.y ? std::clamp((y - a.y) / (b.y - a.y), 0.0, 1.0) : y == y0 ? 0.0 : 1.0;
          double x = a.x + (b.x - a.x) * t;
          left = std::min(left, x);
          right = std::max(right, x);
        }
      }
      double column = std::round(0.5 * (left + right) + x_shift);
      if (std::abs(column - (0.5 * (left + right) + x_shift)) > 0.5 * (right - left) + kPixelSlack) continue;
      *pixel = {column - x_shift, row - y_shift};
      return true;
    }
    return false;
  }

  // ---- relief
  bool reliefWanted(const NodeId& node, const Region& r, double threshold, int splits) const {
    if (culled(r)) return false;
    if (std::isinf(threshold)) return true;
    if (leastFootprint(r) >= threshold) return false;
    if (splits == 0) return true;
    // Quarters have heights of their own as long as pages are that fine.
    for (uint32_t cy = 0; cy < 2; ++cy) {
      for (uint32_t cx = 0; cx < 2; ++cx) {
        Region quarter = r;
        double xm = 0.5 * (r.x0 + r.x1), ym = 0.5 * (r.y0 + r.y1);
        NodeId child = node.child(cx, cy);
        if (view_.anisotropy > 1 || node.level >= kMaxNodeLevel) {
          (cx ? quarter.x0 : quarter.x1) = xm;
          (cy ? quarter.y1 : quarter.y0) = ym;
        } else {
          if (!domain_.nodeExists(child)) continue;
          quarter = regionOf(child);
          setHeights(child, quarter);
        }
        if (reliefWanted(child, quarter, threshold, node.level >= kMaxNodeLevel ? 0 : splits - 1)) return true;
      }
    }
    return false;
  }
  // A lower bound of the gradient over a box: (2).
  double leastFootprint(const Region& r) const {
    const glm::dvec3& eye = view_.eye_mm;
    glm::dvec3 centre{0.5 * (r.x0 + r.x1), 0.5 * (r.y0 + r.y1), 0.5 * (r.z0 + r.z1)};
    double w = value(depth_row_, centre) - std::abs(depth_row_.x) * 0.5 * (r.x1 - r.x0) -
               std::abs(depth_row_.y) * 0.5 * (r.y1 - r.y0) - std::abs(depth_row_.z) * 0.5 * (r.z1 - r.z0);
    w = orthographic_ ? depth_row_.w : std::max(w, near_w_);
    // Some horizontal direction lies in the surface, and moves that far on the screen at most.
    double least = 1 / (std::sqrt(2.0) * px_per_mm_);
    double drop0 = eye.z - r.z1, drop1 = eye.z - r.z0;  // how far the eye is above the highest, the lowest point
    if (orthographic_ ? !edge_on_ : drop0 * drop1 > 0) {
      glm::dvec2 low{1e300}, high{-1e300};
      for (double x : {r.x0, r.x1}) {
        for (double y : {r.y0, r.y1}) {
          for (double drop : {drop0, drop1}) {
            glm::dvec2 o = orthographic_ ? sideways_ : (glm::dvec2(x, y) - glm::dvec2(eye)) / drop;
            low = glm::min(low, o);
            high = glm::max(high, o);
          }
        }
      }
      glm::dvec2 far = glm::max(glm::abs(low), glm::abs(high));
      double slope = slope_per_mm_ * (r.z1 - r.z0), undo = 1 / (1 + slope * glm::length(far));
      bool above = low.x <= 0 && high.x >= 0 && low.y <= 0 && high.y >= 0;  // some line of sight is vertical
      for (size_t k = 0; k < 2; ++k) {
        glm::dvec2 q(q_[k]);
        // |q + q_z o| over the rectangle of o.
        glm::dvec2 a = q + q_[k].z * low, b = q + q_[k].z * high;
        glm::dvec2 outside = glm::max(glm::max(glm::min(a, b), -glm::max(a, b)), glm::dvec2(0));
        least = std::max(least, undo * glm::length(outside));
        if (above) continue;
        double across_min = 1e300, across_max = -1e300;
        for (const glm::dvec2& o : {low, glm::dvec2(high.x, low.y), high, glm::dvec2(low.x, high.y)}) {
          double across = cross(q, o) / glm::length(o);
          across_min = std::min(across_min, across);
          across_max = std::max(across_max, across);
        }
        least = std::max(least, std::max(across_min, -across_max));
      }
    }
    return w * least / view_.anisotropy;
  }

  // The smallest distance of the region's picture (its bounding rectangle) from the view's centre.
  float priority(const Region& r) const {
    glm::dvec2 low{1e300}, high{-1e300};
    for (double x : {r.x0, r.x1}) {
      for (double y : {r.y0, r.y1}) {
        for (double z : {r.z0, r.z1}) {
          glm::dvec3 p(x, y, z);
          double w = value(depth_row_, p);
          if (!(w > 0)) return 0;
          glm::dvec2 s = glm::dvec2(value(x_row_, p), value(y_row_, p)) / w;
          low = glm::min(low, s);
          high = glm::max(high, s);
        }
      }
    }
    glm::dvec2 d = glm::max(glm::max(low, -high), glm::dvec2(0));
    return static_cast<float>(std::min(1.0, glm::length(d) / corner_px_));
  }

  const FlatDomain& domain_;
  const ReliefOracle& oracle_;
  const TextureView& view_;
  bool flat_ = false, valid_ = false, orthographic_ = false, edge_on_ = false;
  double half_w_mm_ = 0, half_h_mm_ = 0, low_mm_ = 0, high_mm_ = 0;
  double slope_per_mm_ = 0;        // steepest slope for a range of heights of 1 mm
  std::array<glm::dvec3, 2> q_{};  // see (1)
  glm::dvec3 q_w_{0};              // the line of sight in the middle
  glm::dvec2 sideways_{0};         // orthographic: o
  glm::dvec4 x_row_{0}, y_row_{0}, depth_row_{0};
  glm::dvec2 screen_x_{0}, screen_y_{0}, screen_w_{0};
  std::array<glm::dvec4, 6> planes_{};
  double near_w_ = 1, px_per_mm_ = 0, corner_px_ = 1;
  std::vector<TextureRequest> requests_;
};

}  // namespace

std::vector<TextureRequest> selectTextureNodes(const FlatDomain& domain, const ReliefOracle& oracle,
                                               const TextureView& view) {
  return TextureSelection(domain, oracle, view).run();
}

}  // namespace relievo
