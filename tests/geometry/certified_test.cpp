// The predicted error is an upper bound of a picture's: random views of real and of hard artworks; through every pixel
// of a small picture a ray is cast at the finest surface (Embree, independent triangles), and the point that is drawn
// in place of the one it meets is projected in double precision: the two may not lie further apart than MeshLod or
// selectPlanarLod foresaw. Pixels are few and miss the worst places, so rays are aimed at these, too: both surfaces are
// flat between the finest vertices but where drawn triangles cross them, so the finest vertices that lie furthest from
// what is drawn in their place come first, until one of them is what its ray meets: that is the largest to be seen.
// RELIEVO_LONG_TESTS=1: 1,000 views an artwork, else a share of them; and 12 in pictures of a screen's size, whose
// pixels meet the worst places.
#include <gtest/gtest.h>

#include <cstdio>
#include <limits>

#include "geometry/bake/mesh_bake.h"
#include "geometry/mesh/ray_scene.h"
#include "geometry/remesh/base_domain.h"
#include "geometry/strategies/strategy_field.h"
#include "tests/geometry/base_shapes.h"
#include "tests/geometry/cell_ranges.h"
#include "tests/geometry/true_mesh_relief.h"
#include "tests/view_share.h"
#include "tools/sample/sample_artwork.h"

namespace relievo::test {
namespace certified_test {

constexpr uint64_t kSeed = 20261122;
struct Picture {
  int width, height;  // px
};
constexpr Picture kSmall{72, 54}, kLarge{1152, 864};

// A finest surface: rectangles of cells (a flat artwork is one), each cut along (i, j) - (i + 1, j + 1).
struct Artwork {
  std::string name;
  uint32_t patches = 1;
  int64_t columns = 0, rows = 0;  // cells
  int units_log2 = 0;             // of a cell's side, in the LOD's units
  std::function<glm::dvec3(uint32_t patch, int64_t i, int64_t j)> make_vertex;
  std::vector<glm::dvec3> vertices;  // all of them, in its order
  std::function<LodResult(const LodView&, const ReliefSet&)> select;
  std::function<Camera(Random&)> camera;
  std::shared_ptr<void> kept;  // what the functions use

  // Before anything below is asked.
  void hold() {
    vertices.reserve(patches * static_cast<size_t>((columns + 1) * (rows + 1)));
    for (uint32_t p = 0; p < patches; ++p)
      for (int64_t j = 0; j <= rows; ++j)
        for (int64_t i = 0; i <= columns; ++i) vertices.push_back(make_vertex(p, i, j));
  }
  const glm::dvec3& vertex(uint32_t patch, int64_t i, int64_t j) const {
    return vertices[static_cast<size_t>((patch * (rows + 1) + j) * (columns + 1) + i)];
  }
  glm::dvec3 point(uint32_t patch, double x, double y) const {
    const int64_t i = std::clamp<int64_t>(static_cast<int64_t>(x), 0, columns - 1),
                  j = std::clamp<int64_t>(static_cast<int64_t>(y), 0, rows - 1);
    const double u = x - static_cast<double>(i), v = y - static_cast<double>(j);
    const glm::dvec3 a = vertex(patch, i, j), d = vertex(patch, i + 1, j + 1);
    if (u >= v) {
      const glm::dvec3 b = vertex(patch, i + 1, j);
      return a + u * (b - a) + v * (d - b);
    }
    const glm::dvec3 c = vertex(patch, i, j + 1);
    return a + v * (c - a) + u * (d - c);
  }
  TriMesh triangles() const {
    TriMesh mesh;
    for (uint32_t p = 0; p < patches; ++p) {
      const auto first = static_cast<uint32_t>(mesh.positions_mm.size()), row = static_cast<uint32_t>(columns + 1);
      for (int64_t j = 0; j <= rows; ++j)
        for (int64_t i = 0; i <= columns; ++i) mesh.positions_mm.push_back(glm::vec3(vertex(p, i, j)));
      for (uint32_t j = 0; j < rows; ++j)
        for (uint32_t i = 0; i < columns; ++i) {
          const uint32_t a = first + j * row + i;
          mesh.triangles.push_back({a, a + row + 1, a + 1});
          mesh.triangles.push_back({a, a + row, a + row + 1});
        }
    }
    return mesh;
  }
  // The place of a hit, in cells.
  glm::dvec2 placeOf(const SurfacePoint& hit, uint32_t* patch) const {
    const auto cells = static_cast<uint32_t>(columns * rows), cell = hit.triangle / 2 % cells;
    *patch = hit.triangle / 2 / cells;
    const glm::dvec2 corner(cell % static_cast<uint32_t>(columns), cell / static_cast<uint32_t>(columns));
    return corner + (hit.triangle % 2 == 0 ? glm::dvec2(hit.b1 + hit.b2, hit.b1) : glm::dvec2(hit.b2, hit.b1 + hit.b2));
  }
};

// The drawn surface of a list, asked place by place.
class Drawn {
 public:
  Drawn(const Artwork& artwork, const std::vector<PatchInstance>& instances)
      : artwork_(artwork), instances_(instances), by_patch_(artwork.patches), grids_(instances.size()) {
    for (size_t k = 0; k < instances.size(); ++k)
      by_patch_[artwork.patches == 1 ? 0 : instances[k].node.patch].push_back(k);
  }
  // False: nothing is drawn there.
  bool at(uint32_t patch, const glm::dvec2& place, glm::dvec3* out) {
    const glm::dvec2 units = place * std::ldexp(1.0, artwork_.units_log2);
    for (size_t k : by_patch_[patch]) {
      const PatchInstance& p = instances_[k];
      const glm::dvec2 in = (units - glm::dvec2(p.x0, p.y0)) / std::ldexp(1.0, p.step_log2);
      const int last = 1 << p.grid_level;
      if (!(in.x >= 0 && in.y >= 0 && in.x <= last && in.y <= last)) continue;
      const int ci = std::min(static_cast<int>(in.x), last - 1), cj = std::min(static_cast<int>(in.y), last - 1);
      if (inCell(k, ci, cj, in, out)) return true;
      // Where vertices snapped, triangles reach along the grid's outermost row or column.
      for (int c = 0; c < last; ++c) {
        if ((cj == 0 || cj == last - 1) && inCell(k, c, cj, in, out)) return true;
        if ((ci == 0 || ci == last - 1) && inCell(k, ci, c, in, out)) return true;
      }
    }
    return false;
  }
  // act(patch, i, j, drawn): every finest vertex; drawn() is the point that is drawn in its place. Again for each
  // triangle that it lies in.
  template <class Do>
  void forEachFinestVertex(Do&& act) {
    for (size_t k = 0; k < instances_.size(); ++k) {
      const PatchInstance& p = instances_[k];
      const size_t last = size_t{1} << p.grid_level, row = last + 1;
      const std::vector<Vertex>& v = grid(k);
      const glm::dvec2 corner = glm::dvec2(p.x0, p.y0) / std::ldexp(1.0, artwork_.units_log2);
      const double step = std::ldexp(1.0, p.step_log2 - artwork_.units_log2);
      auto triangle = [&](const Vertex& a, const Vertex& b, const Vertex& c) {
        const glm::dvec2 ab = b.at - a.at, ac = c.at - a.at;
        const double area = cross(ab, ac);
        if (!(area > 0)) return;
        const double top = corner.y + step * std::min({a.at.y, b.at.y, c.at.y}),
                     bottom = corner.y + step * std::max({a.at.y, b.at.y, c.at.y});
        for (auto j = static_cast<int64_t>(std::ceil(top)); static_cast<double>(j) <= bottom; ++j) {
          // Weights of the corners, at a.at.x and by grid steps along the row; each is 0 or more between left and
          // right.
          const double down = (static_cast<double>(j) - corner.y) / step - a.at.y;
          const double b0 = -down * ac.x / area, b1 = ac.y / area, c0 = ab.x * down / area, c1 = -ab.y / area;
          double left = -std::numeric_limits<double>::infinity(), right = -left;
          for (const auto& [at, by] : {std::array{b0, b1}, std::array{c0, c1}, std::array{1 - b0 - c0, -b1 - c1}}) {
            if (by > 0) left = std::max(left, -at / by);
            if (by < 0) right = std::min(right, -at / by);
            if (by == 0 && at < -1e-9) right = -std::numeric_limits<double>::infinity();
          }
          const double origin = corner.x + step * a.at.x;
          if (!(left <= right + 1e-9)) continue;
          for (auto i = static_cast<int64_t>(std::ceil(origin + step * left - 1e-9));
               static_cast<double>(i) <= origin + step * right + 1e-9; ++i) {
            const double t = (static_cast<double>(i) - origin) / step;
            act(artwork_.patches == 1 ? 0 : p.node.patch, i, j,
                [&] { return a.point + (b0 + t * b1) * (b.point - a.point) + (c0 + t * c1) * (c.point - a.point); });
          }
        }
      };
      for (size_t y = 0; y < last; ++y)
        for (size_t x = 0; x < last; ++x) {
          const Vertex *top = &v[y * row + x], *bottom = top + row;
          triangle(top[0], top[1], bottom[1]);
          triangle(top[0], bottom[1], bottom[0]);
        }
    }
  }

 private:
  struct Vertex {
    glm::dvec2 at{0};  // in grid steps
    glm::dvec3 point{0};
  };
  static double cross(const glm::dvec2& m, const glm::dvec2& n) { return m.x * n.y - m.y * n.x; }
  const std::vector<Vertex>& grid(size_t k) {
    std::vector<Vertex>& vertices = grids_[k];
    if (!vertices.empty()) return vertices;
    const PatchInstance& p = instances_[k];
    const uint32_t last = 1u << p.grid_level;
    const double step = std::ldexp(1.0, p.step_log2 - artwork_.units_log2);
    for (uint32_t j = 0; j <= last; ++j)
      for (uint32_t i = 0; i <= last; ++i) {
        const auto g = snapVertex(i, j, p);
        const glm::dvec2 corner = glm::dvec2(p.x0, p.y0) / std::ldexp(1.0, artwork_.units_log2);
        // A flat artwork's grid may reach beyond its border: what lies there is drawn on it.
        const glm::dvec2 place =
            glm::min(corner + step * glm::dvec2(g[0], g[1]), glm::dvec2(artwork_.columns, artwork_.rows));
        vertices.push_back(
            {(place - corner) / step, artwork_.point(artwork_.patches == 1 ? 0 : p.node.patch, place.x, place.y)});
      }
    return vertices;
  }
  bool inCell(size_t k, int ci, int cj, const glm::dvec2& in, glm::dvec3* out) {
    const std::vector<Vertex>& v = grid(k);
    const size_t row = (size_t{1} << instances_[k].grid_level) + 1,
                 a = static_cast<size_t>(cj) * row + static_cast<size_t>(ci);
    for (const auto& t :
         {std::array<size_t, 3>{a, a + 1, a + row + 1}, std::array<size_t, 3>{a, a + row + 1, a + row}}) {
      const Vertex &p = v[t[0]], &q = v[t[1]], &r = v[t[2]];
      const double area = cross(q.at - p.at, r.at - p.at);
      if (!(area > 0)) continue;
      const double b = cross(in - p.at, r.at - p.at) / area, c = cross(q.at - p.at, in - p.at) / area;
      if (b < -1e-9 || c < -1e-9 || b + c > 1 + 1e-9) continue;
      *out = p.point + b * (q.point - p.point) + c * (r.point - p.point);
      return true;
    }
    return false;
  }
  const Artwork& artwork_;
  const std::vector<PatchInstance>& instances_;
  std::vector<std::vector<size_t>> by_patch_;
  std::vector<std::vector<Vertex>> grids_;
};

// The first hit beyond `from`, within `length`. RayScene answers with the nearest on either side.
SurfacePoint firstHit(const RayScene& scene, const glm::dvec3& from, const glm::dvec3& direction, double length) {
  SurfacePoint hit = scene.nearestOnLine({from, direction, length}, Facing::kAny);
  if (!hit || hit.along >= 0) return hit;
  // Something lies closer behind. Ever longer stretches ahead, each asked from its middle; then what is nearer in the
  // one that has any.
  for (double reach = std::max(-hit.along / 2, 1e-6 * length); reach <= length; reach *= 2) {
    auto within = [&](double limit) {
      SurfacePoint p = scene.nearestOnLine({from + limit * direction, direction, limit}, Facing::kAny);
      p.along += limit;
      return p;
    };
    SurfacePoint found = within(reach);
    if (!found) continue;
    for (;;) {
      const SurfacePoint nearer = within(0.5 * found.along);
      if (!nearer || !(nearer.along < found.along * (1 - 1e-6))) return found;  // the same again
      found = nearer;
    }
  }
  return {};
}

struct Figures {
  int views = 0, above = 0, above_part = 0, missed = 0, unfound = 0;
  uint64_t rays = 0, aimed = 0, measured = 0, undrawn = 0;
  std::vector<double> tightness, of_pixels;  // bound over what all rays met, over what those through pixels met
  static double percentile(std::vector<double> of, double part) {
    if (of.empty()) return 0;
    std::sort(of.begin(), of.end());
    return of[static_cast<size_t>(part * static_cast<double>(of.size() - 1))];
  }
};

// part: of the bound, the negative control.
Figures study(const Artwork& artwork, int views, const Picture& picture, double part) {
  Figures f;
  const TriMesh mesh = artwork.triangles();
  auto scene = RayScene::create(mesh);
  EXPECT_TRUE(scene.ok());
  for (int k = 0; k < views; ++k) {
    Random random(kSeed + static_cast<uint64_t>(k));
    Camera camera = artwork.camera(random);
    camera.aspect = static_cast<double>(picture.width) / picture.height;
    camera.viewport_height_px = picture.height;
    const double error_px = std::exp(random.real(-2, 1));
    const bool orthographic = random.chance(0.1);
    LodView view = orthographic ? orthographicView(camera, glm::length(camera.eye - camera.target), error_px)
                                : makeView(camera, error_px);
    if (random.chance(0.3)) view.min_cell_px = 2 * error_px;
    // Pages as they may have arrived: all that is wanted, or some of it.
    ReliefSet resident;
    const double granted = random.chance(0.7) ? 1 : random.real(0.3, 0.9);
    for (int round = 0; round < 6; ++round)
      for (const ReliefRequest& request : artwork.select(view, resident).requests)
        if (random.chance(granted)) resident.insert(request.page);
    const LodResult lod = artwork.select(view, resident);
    Drawn drawn(artwork, lod.instances);
    const glm::dmat4 world_from_clip = glm::inverse(view.clip_from_world);
    auto project = [&](const glm::dvec3& at, glm::dvec2* px) {
      const glm::dvec4 c = view.clip_from_world * glm::dvec4(at, 1);
      *px = 0.5 * glm::dvec2(c.x * picture.width, c.y * picture.height) / c.w;
      return orthographic || c.w >= camera.near_mm * (1 - 1e-9);
    };
    double most = 0;
    uint64_t measured = 0;
    // How far the ray got, as a share of the way to the far plane; 1: it met nothing.
    auto cast = [&](const glm::dvec2& ndc) {
      const glm::dvec4 n4 = world_from_clip * glm::dvec4(ndc, -1, 1), f4 = world_from_clip * glm::dvec4(ndc, 1, 1);
      const glm::dvec3 from = glm::dvec3(n4) / n4.w, way = glm::dvec3(f4) / f4.w - from;
      const double length = glm::length(way);
      const SurfacePoint hit = firstHit(**scene, from, way / length, length);
      if (!hit) return 1.0;
      const double share = hit.along / length;
      uint32_t patch = 0;
      const glm::dvec2 place = artwork.placeOf(hit, &patch);
      glm::dvec3 seen;
      glm::dvec2 true_px, drawn_px;
      if (!drawn.at(patch, place, &seen)) {
        ++f.undrawn;
        return share;
      }
      // In front of the near plane there is no picture of it.
      if (!project(artwork.point(patch, place.x, place.y), &true_px) || !project(seen, &drawn_px)) return share;
      most = std::max(most, glm::length(true_px - drawn_px));
      ++measured;
      return share;
    };
    const auto width = static_cast<size_t>(picture.width), height = static_cast<size_t>(picture.height);
    std::vector<double> reached(width * height);
    for (size_t y = 0; y < height; ++y)
      for (size_t x = 0; x < width; ++x)
        reached[y * width + x] = cast(2.0 * (glm::dvec2(x, y) + 0.5) / glm::dvec2(width, height) - 1.0);
    f.rays += static_cast<uint64_t>(picture.width) * static_cast<uint64_t>(picture.height);
    const double by_pixels = most;
    struct Worst {
      bool behind;  // all that was met around it
      double px;
      glm::dvec2 ndc;
    };
    auto isBehind = [&](const glm::dvec2& ndc, const glm::dvec3& at) {
      const glm::dvec4 n4 = world_from_clip * glm::dvec4(ndc, -1, 1), f4 = world_from_clip * glm::dvec4(ndc, 1, 1);
      const double share =
          glm::length(at - glm::dvec3(n4) / n4.w) / glm::length(glm::dvec3(f4) / f4.w - glm::dvec3(n4) / n4.w);
      const auto x = static_cast<size_t>((ndc.x + 1) / 2 * static_cast<double>(width)),
                 y = static_cast<size_t>((ndc.y + 1) / 2 * static_cast<double>(height));
      for (size_t j = y > 0 ? y - 1 : 0; j <= std::min(y + 1, height - 1); ++j)
        for (size_t i = x > 0 ? x - 1 : 0; i <= std::min(x + 1, width - 1); ++i)
          if (reached[j * width + i] >= share) return false;
      return true;
    };
    std::vector<Worst> worst;
    // Of a closed body seen from outside, fronts hide the backs. A side's vertices come again with the patch across it.
    auto faces = [&](uint32_t patch, int64_t i, int64_t j, const glm::dvec3& at) {
      const glm::dvec3 sight = orthographic ? camera.target - camera.eye : at - view.eye_mm;
      auto front = [&](int64_t x0, int64_t y0, int64_t x1, int64_t y1) {
        if (std::min(x0, x1) < 0 || std::min(y0, y1) < 0 || std::max(x0, x1) > artwork.columns ||
            std::max(y0, y1) > artwork.rows)
          return false;
        return glm::dot(glm::cross(artwork.vertex(patch, x0, y0) - at, artwork.vertex(patch, x1, y1) - at), sight) > 0;
      };
      return front(i + 1, j, i + 1, j + 1) || front(i + 1, j + 1, i, j + 1) || front(i, j + 1, i - 1, j) ||
             front(i - 1, j, i - 1, j - 1) || front(i - 1, j - 1, i, j - 1) || front(i, j - 1, i + 1, j);
    };
    drawn.forEachFinestVertex([&](uint32_t patch, int64_t i, int64_t j, auto&& instead) {
      glm::dvec2 true_px, drawn_px;
      if (!project(artwork.vertex(patch, i, j), &true_px) ||
          !(2 * std::abs(true_px.x) < picture.width && 2 * std::abs(true_px.y) < picture.height))
        return;
      if (!project(instead(), &drawn_px) || !(glm::length(true_px - drawn_px) > most)) return;
      if (lod.backs_are_hidden && !faces(patch, i, j, artwork.vertex(patch, i, j))) return;
      const glm::dvec2 ndc = 2.0 * true_px / glm::dvec2(width, height);
      worst.push_back({isBehind(ndc, artwork.vertex(patch, i, j)), glm::length(true_px - drawn_px), ndc});
    });
    std::sort(worst.begin(), worst.end(),
              [](const Worst& a, const Worst& b) { return a.behind != b.behind ? b.behind : a.px > b.px; });
    // Of those that lie behind what pixels met most are hidden: where they are too many, the largest found stands for
    // the largest there is.
    constexpr size_t kMostBehind = 4000;
    size_t behind = 0;
    for (const Worst& w : worst) {
      if (!(w.px > most * (1 + 1e-6))) continue;
      if (w.behind && ++behind > kMostBehind) break;
      cast(w.ndc);
      ++f.aimed;
    }
    f.unfound += behind > kMostBehind;
    f.measured += measured;
    ++f.views;
    const double slack = 1e-6 + 1e-6 * lod.max_error_px;
    if (most > lod.max_error_px + slack) {
      ++f.above;
      std::printf("[ above    ] %s, seed %llu: measured %.6g px, predicted %.6g px\n", artwork.name.c_str(),
                  static_cast<unsigned long long>(kSeed) + static_cast<unsigned long long>(k), most, lod.max_error_px);
    }
    f.missed += most > 1.1 * by_pixels + slack;
    f.above_part += most > part * lod.max_error_px + slack;
    if (most > 0.01) f.tightness.push_back(lod.max_error_px / most);
    if (by_pixels > 0.01) f.of_pixels.push_back(lod.max_error_px / by_pixels);
  }
  return f;
}

// ---- artworks
Artwork overMesh(std::string name, const BaseMesh& mesh, const MeshRelief& relief,
                 std::shared_ptr<const ReliefOracle> oracle, std::vector<CoarseErrors> coarse) {
  Artwork a;
  a.name = std::move(name);
  a.patches = static_cast<uint32_t>(mesh.patches.size());
  a.columns = a.rows = int64_t{1} << relief.unitLog2();
  auto shared = std::make_shared<BaseMesh>(mesh);
  auto lod =
      std::make_shared<MeshLod>(shared, relief.depth, relief.offset_mm, relief.scale_mm, oracle, std::move(coarse));
  a.select = [lod](const LodView& view, const ReliefSet& resident) { return lod->select(view, resident); };
  a.camera = [shared, unit = relief.unitLog2()](Random& random) { return randomMeshCamera(*shared, unit, random); };
  return a;
}

// A scan through base domain and bake; its errors are those that the bake says.
struct Baked final : ReliefOracle {
  TriMesh mesh;
  std::unique_ptr<MeshBake> bake;
  std::vector<std::vector<uint16_t>> heights;
  MeshRelief relief;
  HeightBounds bounds(const NodeId& page) const override {
    const int64_t side = int64_t{1} << relief.unitLog2(), size = side >> page.level;
    uint16_t low = 65535, high = 0;
    for (int64_t y = page.y * size; y <= (page.y + 1) * size; ++y)
      for (int64_t x = page.x * size; x <= (page.x + 1) * size; ++x) {
        const uint16_t q = heights[page.patch][static_cast<size_t>(y * (side + 1) + x)];
        low = std::min(low, q), high = std::max(high, q);
      }
    std::array<float, 256> blocks{};
    errorBlocks(page, blocks);
    auto mm = [&](uint16_t q) { return relief.offset_mm + relief.scale_mm * q; };
    return {std::nextafter(static_cast<float>(mm(low)), -1e30f), std::nextafter(static_cast<float>(mm(high)), 1e30f),
            *std::max_element(blocks.begin(), blocks.end())};
  }
  GridErrors of(const NodeId& page) const { return bake->errorsOfGrid(page.patch, 7 + static_cast<int>(page.level)); }
  // A page's blocks, of those of all pages of its level.
  template <class T>
  static bool pick(const std::vector<T>& all, const NodeId& page, std::span<T> out) {
    const auto row = static_cast<size_t>(16 << page.level);
    for (size_t y = 0; y < 16; ++y)
      std::copy_n(all.begin() + static_cast<std::ptrdiff_t>((page.y * 16 + y) * row + page.x * 16), 16,
                  out.begin() + static_cast<std::ptrdiff_t>(16 * y));
    return true;
  }
  template <class T>
  static bool copy(const std::vector<T>& all, std::span<T> out) {
    std::copy(all.begin(), all.end(), out.begin());
    return true;
  }
  bool errorBlocks(const NodeId& page, std::span<float> out) const override { return pick(of(page).mm, page, out); }
  bool errorShapes(const NodeId& page, std::span<DeviationShape> out) const override {
    return pick(of(page).shapes, page, out);
  }
  bool coarseBlocks(uint32_t patch, int cells_log2, std::span<float> out) const override {
    return copy(bake->errorsOfGrid(patch, cells_log2).mm, out);
  }
  bool coarseShapes(uint32_t patch, int cells_log2, std::span<DeviationShape> out) const override {
    return copy(bake->errorsOfGrid(patch, cells_log2).shapes, out);
  }
};
Artwork scan(std::string name, TriMesh mesh, uint32_t patches, int cells_log2) {
  auto baked = std::make_shared<Baked>();
  baked->mesh = std::move(mesh);
  BaseDomainOptions domain;
  domain.patches = patches;
  auto base = makeBaseMesh(baked->mesh, domain);
  EXPECT_TRUE(base.ok()) << name << (base.ok() ? "" : base.error().text());
  BakeOptions options;
  options.cells_log2 = cells_log2;
  options.texture_depth = 0;
  auto bake = MeshBake::create(baked->mesh, {}, *base, options);
  EXPECT_TRUE(bake.ok()) << name << (bake.ok() ? "" : bake.error().text());
  baked->bake = std::move(*bake);
  baked->relief = {baked->bake->reliefDepth(), baked->bake->reliefOffsetMm(), baked->bake->reliefScaleMm()};
  const int64_t side = int64_t{1} << baked->relief.unitLog2();
  std::vector<CoarseErrors> coarse(base->patches.size());
  baked->heights.resize(base->patches.size());
  for (uint32_t p = 0; p < base->patches.size(); ++p) {
    baked->heights[p].resize(static_cast<size_t>((side + 1) * (side + 1)));
    EXPECT_TRUE(baked->bake->heights(p, baked->heights[p]).ok());
    for (int k = 0; k < 7; ++k) coarse[p][static_cast<size_t>(k)] = baked->bake->errorOfGrid(p, k);
  }
  Artwork a = overMesh(std::move(name), *base, baked->relief, baked, std::move(coarse));
  a.make_vertex = [baked, side, mesh = std::make_shared<BaseMesh>(*base)](uint32_t patch, int64_t i, int64_t j) {
    const double u = double(i) / double(side), v = double(j) / double(side);
    const double mm = baked->relief.offset_mm +
                      baked->relief.scale_mm * baked->heights[patch][static_cast<size_t>(j * (side + 1) + i)];
    return mesh->point(patch, u, v) + mm * mesh->normal(patch, u, v);
  };
  return a;
}

// The sample coin as `relievo sample --write mesh` writes it: its heights, a vertex a pixel.
TriMesh coinScan(int64_t side) {
  SampleArtwork coin({.kind = SampleKind::kCoin, .width = side, .height = side});
  std::vector<float> heights(static_cast<size_t>(side * side));
  coin.heights({0, 0, side, side}, heights);
  TriMesh mesh;
  for (int64_t y = 0; y < side; ++y)
    for (int64_t x = 0; x < side; ++x)
      mesh.positions_mm.push_back({coin.mmPerPx() * (double(x) - 0.5 * double(side)),
                                   coin.mmPerPx() * (0.5 * double(side) - double(y)),
                                   heights[static_cast<size_t>(y * side + x)]});
  for (uint32_t y = 0; y + 1 < side; ++y)
    for (uint32_t x = 0; x + 1 < side; ++x) {
      const auto row = static_cast<uint32_t>(side), a = y * row + x;
      mesh.triangles.push_back({a, a + row, a + row + 1});
      mesh.triangles.push_back({a, a + row + 1, a + 1});
    }
  return mesh;
}

// Corners that 3 patches share (a cube's) and one that 8 do, apart from one another; waves, pits and a rough part.
Artwork hardShape() {
  BaseMesh mesh = cubeSphere(1, 30);
  BaseMesh second = fan(8, 40);
  const auto first = static_cast<uint32_t>(mesh.corners.size());
  for (BaseCorner c : second.corners) {
    c.position_mm.x += 90;
    mesh.corners.push_back(c);
  }
  for (auto c : second.patches) {
    for (uint32_t& k : c) k += first;
    mesh.patches.push_back(c);
  }
  Random turns(kSeed);
  turnPatches(mesh, turns);
  MeshRelief relief{1, -2, 6.0 / 65535};
  struct Held {
    BaseMesh mesh;
    std::unique_ptr<TrueMeshRelief> truth;
  };
  auto held = std::make_shared<Held>();
  held->mesh = mesh;
  held->truth = std::make_unique<TrueMeshRelief>(held->mesh, relief, [](const glm::dvec3& p, const Place& place) {
    const uint64_t h = hashOf(place, 5);
    const double waves =
        0.5 + 0.2 * std::sin(0.15 * p.x + 1) * std::cos(0.15 * p.y) + 0.1 * std::sin(0.4 * (p.z + 0.3 * p.x));
    return waves + (p.x > 0 && p.y > 0 ? 0.05 * static_cast<double>(h & 1023) / 1023 : 0) +
           ((h >> 20) % 3000 == 0 ? 0.2 : 0);
  });
  Artwork a = overMesh("corners of 3 and 8, pits", mesh, relief,
                       std::shared_ptr<const ReliefOracle>(held, held->truth.get()), held->truth->coarse());
  a.make_vertex = [held](uint32_t patch, int64_t i, int64_t j) { return held->truth->point(patch, i, j, 1); };
  return a;
}

// The sample inscription, flat: selectPlanarLod.
struct FlatOracle final : ReliefOracle {
  const ReliefField& field;
  explicit FlatOracle(const ReliefField& f) : field(f) {}
  HeightBounds bounds(const NodeId& page) const override {
    const FlatDomain& d = field.domain;
    const int64_t size = int64_t{kPagePx} << (d.relief_depth - static_cast<int>(page.level));
    uint16_t low = 65535, high = 0;
    for (int64_t j = page.y * size; j <= std::min<int64_t>((page.y + 1) * size, field.rows - 1); ++j)
      for (int64_t i = page.x * size; i <= std::min<int64_t>((page.x + 1) * size, field.columns - 1); ++i)
        low = std::min(low, field.at(i, j)), high = std::max(high, field.at(i, j));
    std::array<float, 256> blocks{};
    errorBlocks(page, blocks);
    auto mm = [&](uint16_t q) { return d.relief_offset_mm + d.relief_scale_mm * q; };
    return {std::nextafter(static_cast<float>(mm(low)), -1e30f), std::nextafter(static_cast<float>(mm(high)), 1e30f),
            *std::max_element(blocks.begin(), blocks.end())};
  }
  bool errorBlocks(const NodeId& page, std::span<float> out) const override {
    const auto blocks = measure(page);
    for (size_t k = 0; k < blocks.size(); ++k) out[k] = std::nextafter(static_cast<float>(blocks[k].mm), 1e30f);
    return true;
  }
  bool errorShapes(const NodeId& page, std::span<DeviationShape> out) const override {
    const auto blocks = measure(page);
    for (size_t k = 0; k < blocks.size(); ++k) out[k] = shapeOf(blocks[k]);
    return true;
  }
  // Of this level's triangles and of all finer ones: both surfaces are furthest apart at the finest samples.
  std::array<Deviation, 256> measure(const NodeId& page) const {
    const FlatDomain& d = field.domain;
    std::array<Deviation, 256> out{};
    const int64_t size = int64_t{kPagePx} << (d.relief_depth - static_cast<int>(page.level)), block = size / 16;
    for (int level = static_cast<int>(page.level); level < d.relief_depth; ++level) {
      const int64_t step = int64_t{1} << (d.relief_depth - level);
      CellRanges apart(size / step, step);
      for (int64_t j = page.y * size; j <= (page.y + 1) * size; ++j)
        for (int64_t i = page.x * size; i <= (page.x + 1) * size; ++i) {
          if (i >= field.columns || j >= field.rows) continue;
          const int64_t a = std::min(i, (page.x + 1) * size - 1) / step * step,
                        b = std::min(j, (page.y + 1) * size - 1) / step * step;
          const double u = double(i - a) / double(step), v = double(j - b) / double(step);
          auto z = [&](int64_t x, int64_t y) {
            return double{1} * field.at(std::min(x, field.columns - 1), std::min(y, field.rows - 1));
          };
          const double z00 = z(a, b), z10 = z(a + step, b), z01 = z(a, b + step), z11 = z(a + step, b + step);
          const double drawn =
              u >= v ? z00 + u * (z10 - z00) + v * (z11 - z10) : z00 + v * (z01 - z00) + u * (z11 - z01);
          const double off = (z(i, j) - drawn) * d.relief_scale_mm;
          const int64_t x = i - page.x * size, y = j - page.y * size;
          for (int64_t by = std::max<int64_t>(0, y - 1) / block; by <= std::min<int64_t>(15, y / block); ++by)
            for (int64_t bx = std::max<int64_t>(0, x - 1) / block; bx <= std::min<int64_t>(15, x / block); ++bx) {
              Deviation& most = out[static_cast<size_t>(by * 16 + bx)];
              most = joined(most, {std::abs(off), -off, off, 0, 0, 0});
            }
          apart.note(x, y, off);
        }
      for (int64_t k = 0; k < 256; ++k) {
        Deviation& most = out[static_cast<size_t>(k)];
        most.between_mm = most.apart_mm =
            std::max(most.apart_mm, apart.largest(k % 16 * (block / step), k / 16 * (block / step), block / step));
      }
    }
    return out;
  }
};
// Asks another oracle once a page.
struct Remembering final : ReliefOracle {
  std::shared_ptr<const ReliefOracle> truth;
  struct Page {
    HeightBounds bounds;
    std::array<float, 256> mm;
    std::array<DeviationShape, 256> shapes;
  };
  mutable std::map<NodeId, Page> known;
  explicit Remembering(std::shared_ptr<const ReliefOracle> t) : truth(std::move(t)) {}
  const Page& of(const NodeId& page) const {
    auto [at, fresh] = known.try_emplace(page);
    Page& p = at->second;
    if (fresh) {
      p.bounds = truth->bounds(page);
      truth->errorBlocks(page, p.mm);
      truth->errorShapes(page, p.shapes);
    }
    return p;
  }
  HeightBounds bounds(const NodeId& page) const override { return of(page).bounds; }
  bool errorBlocks(const NodeId& page, std::span<float> out) const override {
    std::copy(of(page).mm.begin(), of(page).mm.end(), out.begin());
    return true;
  }
  bool errorShapes(const NodeId& page, std::span<DeviationShape> out) const override {
    std::copy(of(page).shapes.begin(), of(page).shapes.end(), out.begin());
    return true;
  }
};
Artwork flatSample() {
  struct Held {
    std::unique_ptr<ReliefField> field;
    std::shared_ptr<Remembering> oracle;
  };
  // A whole patch of the strip, so that every page is square: borders in its middle are planar_lod_test's.
  constexpr int64_t kSide = 512;
  SampleArtwork sample({.kind = SampleKind::kInscription, .width = kSide + 1, .height = kSide + 1});
  FlatDomain d;
  d.width_px = d.height_px = kSide;
  d.mm_per_px = sample.mmPerPx();
  d.texture_depth = d.relief_depth = FlatDomain::depthFor(kSide, kSide);
  d.relief_offset_mm = sample.minMm();
  d.relief_scale_mm = (sample.maxMm() - sample.minMm()) / 65535;
  auto held = std::make_shared<Held>();
  held->field = std::make_unique<ReliefField>(d);
  std::vector<float> heights(static_cast<size_t>((kSide + 1) * (kSide + 1)));
  sample.heights({0, 0, kSide + 1, kSide + 1}, heights);
  for (size_t i = 0; i < heights.size(); ++i)
    held->field->samples[i] = static_cast<uint16_t>(std::lround((heights[i] - d.relief_offset_mm) / d.relief_scale_mm));
  held->oracle = std::make_shared<Remembering>(std::make_shared<FlatOracle>(*held->field));
  Artwork a;
  a.name = "sample inscription, flat";
  a.columns = a.rows = kSide;
  a.units_log2 = held->field->spacing_log2;
  a.make_vertex = [held](uint32_t, int64_t i, int64_t j) {
    const ReliefField& f = *held->field;
    return f.worldMm(static_cast<double>(i << f.spacing_log2), static_cast<double>(j << f.spacing_log2),
                     f.domain.relief_offset_mm + f.domain.relief_scale_mm * f.at(i, j));
  };
  a.select = [held, d](const LodView& view, const ReliefSet& resident) {
    ReliefSet with_roots = resident;
    with_roots.insert({0, 0, 0, 0});
    return selectPlanarLod(d, *held->oracle, view, with_roots);
  };
  a.camera = [d](Random& random) { return randomCamera(d, random); };
  return a;
}

void expectCertified(const Artwork& artwork, int views, const Picture& picture, double part) {
  Figures f = study(artwork, views, picture, part);
  std::printf(
      "[ figures  ] %-26s seed %llu: %d views of %d x %d px, %llu rays through pixels, %llu aimed at what is worst (in "
      "%d views more that is hidden than could be tried), %llu met the surface and "
      "are measured, %llu more where nothing is drawn; above the bound: %d views, above %.2g of it: %d; bound / "
      "measured: median %.2f, least %.2f, 90 %% below %.2f; of pixels alone: median %.2f\n",
      artwork.name.c_str(), static_cast<unsigned long long>(kSeed), f.views, picture.width, picture.height,
      static_cast<unsigned long long>(f.rays), static_cast<unsigned long long>(f.aimed), f.unfound,
      static_cast<unsigned long long>(f.measured), static_cast<unsigned long long>(f.undrawn), f.above, part,
      f.above_part, f.percentile(f.tightness, 0.5), f.percentile(f.tightness, 0), f.percentile(f.tightness, 0.9),
      f.percentile(f.of_pixels, 0.5));
  EXPECT_EQ(f.above, 0);
  EXPECT_GT(f.above_part, 0) << "a part of the bound would do, too: nothing is shown";
  if (picture.width == kSmall.width) {
    EXPECT_GT(f.missed, 0) << "pixels alone would do: rays aimed at the worst places find nothing worse";
  }
  EXPECT_GT(f.measured, 200u * static_cast<uint64_t>(f.views));
  // What is met is drawn, but for what only the picture's very border shows.
  EXPECT_LE(f.undrawn, f.measured / 1000);
}
// few: the part of the bound that one of a few views is above.
void expectCertified(Artwork artwork, double few = 0.5) {
  artwork.hold();
  expectCertified(artwork, longTests() ? 1000 : kSanitized ? 20 : 60, kSmall, 0.8);
  if (longTests()) expectCertified(artwork, 12, kLarge, few);
}

TEST(Certified, CoinScan) { expectCertified(scan("sample coin scan", coinScan(kSanitized ? 128 : 256), 0, -1)); }
TEST(Certified, SmoothBall) { expectCertified(scan("smooth ball", ballMesh(40), 0, -1)); }
TEST(Certified, Bust) { expectCertified(scan("bust with undercuts", bustMesh(kSanitized ? 40 : 60), 0, -1)); }
TEST(Certified, CornersOfManyPatches) { expectCertified(hardShape()); }
TEST(Certified, FlatInscription) {
  expectCertified(flatSample(), 0.35);
}  // at a slant heights are seen shortened, and its bound is looser

}  // namespace certified_test
}  // namespace relievo::test
