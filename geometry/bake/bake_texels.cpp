#include "geometry/bake/bake_texels.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "src/artwork/patch_domain.h"

namespace relievo {
namespace {

constexpr uint64_t kMaxTexels = uint64_t{64} << 20;
constexpr int kTexelChannels = 6;
constexpr uint8_t kGrey = 200;
using Tone = std::array<float, kTexelChannels>;  // colour, 0 to 255, and normal

// Places of a patch that are looked up: texel centres, or the vertices of a coarser grid.
struct ToneGrid {
  size_t side;  // texels
  bool direct;
  size_t cells, row;
  ToneGrid(const BakeTexture& texture)
      : side(size_t{kPagePx} << texture.depth),
        direct((size_t{1} << texture.tone_log2) >= side),
        cells(direct ? side : size_t{1} << texture.tone_log2),
        row(direct ? side : cells + 1) {}
};

struct TexelBaker {
  const BakeGround& ground;
  const BakedHeights& baked;
  const BakeTexture& texture;

  glm::vec2 uvAt(const SurfacePoint& at) const;
  Tone tone(const SurfacePoint& at) const;
  // False: interrupted.
  bool planeTexels(uint32_t patch, std::span<uint8_t> out) const;
  bool lookUpTones(uint32_t patch, double deviation_mm, const ToneGrid& grid, std::vector<Tone>& tones) const;
};

glm::vec2 TexelBaker::uvAt(const SurfacePoint& at) const {
  const auto& uv = ground.mesh->corner_uv[at.triangle];
  return uv[0] * static_cast<float>(1 - at.b1 - at.b2) + uv[1] * static_cast<float>(at.b1) +
         uv[2] * static_cast<float>(at.b2);
}

// Texel by texel. What is finer than the patch's texels is averaged: by the image's texels a millimetre of the
// triangle, since (u, v) of neighbouring texels may lie in different parts of the image.
bool TexelBaker::planeTexels(uint32_t patch, std::span<uint8_t> out) const {
  const size_t side = size_t{kPagePx} << texture.depth, n = size_t{1} << baked.cells_log2;
  const auto channels = static_cast<size_t>(texture.image.channels());
  std::vector<uint16_t> q((n + 1) * (n + 1));
  baked.gather(ground, patch, q);
  const auto& c = ground.base.patches[patch];
  double around = 0;
  for (const auto& [a, b] : kSideCorners)
    around +=
        glm::length(ground.corner(c[static_cast<size_t>(a)]).point - ground.corner(c[static_cast<size_t>(b)]).point);
  const double texel_mm = around / (4.0 * static_cast<double>(side));
  LineLookup look;
  std::vector<float> values(channels);
  return Tiles(side, ground.tile()).forEach([&](size_t x0, size_t y0, size_t x1, size_t y1) {
    auto share = [&](size_t x) { return static_cast<double>(x) / static_cast<double>(side); };
    ground.begin(look, patch, share(x0), share(y0), share(x1), share(y1));
    for (size_t i = 0; i < (x1 - x0) * (y1 - y0); ++i) {
      const size_t x = x0 + i % (x1 - x0), y = y0 + i / (x1 - x0);
      const double u = (static_cast<double>(x) + 0.5) / static_cast<double>(side),
                   v = (static_cast<double>(y) + 0.5) / static_cast<double>(side);
      const LineFrame f = ground.inside(patch, u, v);
      const double height = baked.offset_mm + baked.scale_mm * onGrid(q, n, u, v);
      look.add(lineOf({f.point + height * f.normal, f.normal}, ground.patch_reach[patch]), u, v, height);
    }
    ground.find(look);
    for (size_t l = 0; l < look.lines.size(); ++l) {
      const size_t x = x0 + l % (x1 - x0), y = y0 + l / (x1 - x0);
      const SurfacePoint at = look.hits[l] ? look.hits[l] : ground.scene->closestPoint(look.lines[l].at);
      const auto& t = ground.mesh->triangles[at.triangle];
      const auto& uv = ground.mesh->corner_uv[at.triangle];
      const glm::vec3 &p = ground.mesh->positions_mm[t[0]], e = ground.mesh->positions_mm[t[1]] - p,
                      g = ground.mesh->positions_mm[t[2]] - p;
      const glm::vec2 i = uv[1] - uv[0], j = uv[2] - uv[0];
      const double image_area =
                       std::abs(double{i.x} * j.y - double{i.y} * j.x) * texture.image.width() * texture.image.height(),
                   area = glm::length(glm::cross(e, g));
      const double lod = area > 0 ? 0.5 * std::log2(texel_mm * texel_mm * image_area / area) : 0.0;
      texture.image.sample(uvAt(at), static_cast<float>(lod), values);
      for (size_t k = 0; k < channels; ++k)
        out[(k * side + y) * side + x] = static_cast<uint8_t>(std::clamp(values[k] + 0.5f, 0.0f, 255.0f));
    }
    return !ground.stopped();
  });
}

Tone TexelBaker::tone(const SurfacePoint& at) const {
  const auto& t = ground.mesh->triangles[at.triangle];
  const std::array<float, 3> w{static_cast<float>(1 - at.b1 - at.b2), static_cast<float>(at.b1),
                               static_cast<float>(at.b2)};
  Tone out{kGrey, kGrey, kGrey, 0, 0, 0};
  if (!texture.image.empty()) {
    texture.image.sample(uvAt(at), 0, out);
  } else if (!ground.mesh->colours.empty()) {
    for (size_t c = 0; c < 3; ++c) {
      out[c] = 0;
      for (size_t k = 0; k < 3; ++k)
        out[c] += w[k] * static_cast<float>(ground.mesh->colours[t[k]][static_cast<int>(c)]);
    }
  }
  glm::vec3 n(0);
  for (size_t k = 0; k < 3; ++k) n += w[k] * (*ground.normals)[t[k]];
  if (!(glm::length(n) > 1e-3f))
    n = glm::cross(ground.mesh->positions_mm[t[1]] - ground.mesh->positions_mm[t[0]],
                   ground.mesh->positions_mm[t[2]] - ground.mesh->positions_mm[t[0]]);
  const float length = glm::length(n);
  if (length > 0) n /= length;
  out[3] = n.x;
  out[4] = n.y;
  out[5] = n.z;
  return out;
}

bool TexelBaker::lookUpTones(uint32_t patch, double deviation_mm, const ToneGrid& grid,
                             std::vector<Tone>& tones) const {
  const bool direct = grid.direct;
  const size_t cells = grid.cells, row = grid.row;
  const size_t n = size_t{1} << baked.cells_log2;
  std::vector<uint16_t> q((n + 1) * (n + 1));
  baked.gather(ground, patch, q);
  auto height = [&](double u, double v) { return baked.offset_mm + baked.scale_mm * onGrid(q, n, u, v); };
  const double likely = 4 * deviation_mm + baked.scale_mm;  // how far the surface drawn is from the scan
  tones.resize(row * row);
  LineLookup look;
  std::array<LineFrame, 4> corners;
  for (size_t k = 0; k < 4; ++k) corners[k] = ground.corner(ground.base.patches[patch][k]);
  return Tiles(row, ground.tile()).forEach([&](size_t x0, size_t y0, size_t x1, size_t y1) {
    auto share = [&](size_t x) { return std::min(static_cast<double>(x) / static_cast<double>(cells), 1.0); };
    ground.begin(look, patch, share(x0), share(y0), share(x1), share(y1));
    const double half = direct ? 0.5 : 0;
    for (size_t y = y0; y < y1; ++y) {
      const double v = (static_cast<double>(y) + half) / static_cast<double>(cells);
      // Of texels, which no other patch has, along rows: sooner.
      const LineFrame left = lerp(corners[0], corners[2], v), right = lerp(corners[1], corners[3], v);
      for (size_t x = x0; x < x1; ++x) {
        const double u = (static_cast<double>(x) + half) / static_cast<double>(cells);
        const LineFrame f = direct ? lerp(left, right, u) : ground.at(patch, x, y, cells);
        // From the surface that is drawn: what lies on it is what it shows.
        const double h = height(u, v);
        look.add(lineOf({f.point + h * f.normal, f.normal}, ground.patch_reach[patch]), u, v, h);
        // Short rays are faster ones; a sweep sees all that is near at once.
        look.lines.back().likely = ground.sweep ? std::max(likely, 0.02 * look.lines.back().reach) : likely;
      }
    }
    ground.find(look);
    for (size_t i = 0; i < look.lines.size(); ++i) {
      const size_t x = x0 + i % (x1 - x0), y = y0 + i / (x1 - x0);
      tones[y * row + x] = tone(look.hits[i] ? look.hits[i] : ground.scene->closestPoint(look.lines[i].at));
    }
    return !ground.stopped();
  });
}

// A row of texels, each channel in an array of its own. mixed: scratch.
void mixRow(const ToneGrid& grid, const std::vector<Tone>& tones, size_t y, std::vector<float>& mixed,
            std::vector<float>& values) {
  const auto [side, direct, cells, row] = grid;
  const size_t run = side / cells;  // texels a cell
  if (direct) {
    for (size_t k = 0; k < kTexelChannels; ++k)
      for (size_t x = 0; x < side; ++x) values[k * side + x] = tones[y * row + x][k];
  } else {
    const float fy = (static_cast<float>(y % run) + 0.5f) / static_cast<float>(run);
    const auto *above = tones.data() + y / run * row, *below = above + row;
    for (size_t k = 0; k < kTexelChannels; ++k) {
      float* m = mixed.data() + k * row;
      for (size_t x = 0; x < row; ++x) m[x] = above[x][k] * (1 - fy) + below[x][k] * fy;
      for (size_t cell = 0; cell < cells; ++cell) {
        const float start = m[cell], step = (m[cell + 1] - m[cell]) / static_cast<float>(run);
        float* v = values.data() + k * side + cell * run;
        for (size_t i = 0; i < run; ++i) v[i] = start + step * (static_cast<float>(static_cast<int>(i)) + 0.5f);
      }
    }
  }
}

// Normals of length 1 as bytes, too.
void packRow(size_t side, size_t y, std::vector<float>& values, std::span<uint8_t> out) {
  const size_t plane = side * side;
  float *nx = values.data() + 3 * side, *ny = nx + side, *nz = ny + side;
  for (size_t x = 0; x < side; ++x) {
    // Where opposite normals meet, none is right.
    const float scale = 127.5f / std::sqrt(std::max(nx[x] * nx[x] + ny[x] * ny[x] + nz[x] * nz[x], 1e-12f));
    nx[x] = nx[x] * scale + 127.5f;
    ny[x] = ny[x] * scale + 127.5f;
    nz[x] = nz[x] * scale + 127.5f;
  }
  for (size_t k = 0; k < kTexelChannels; ++k) {
    const float* v = values.data() + k * side;
    uint8_t* to = out.data() + k * plane + y * side;
    for (size_t x = 0; x < side; ++x)
      to[x] = static_cast<uint8_t>(static_cast<int>(std::min(std::max(v[x] + 0.5f, 0.0f), 255.0f)));
  }
}

}  // namespace

void chooseTexelSize(const BakeGround& ground, int wanted_depth, BakeTexture& texture) {
  const bool from_image = !texture.image.empty();
  const double vertices = static_cast<double>(ground.mesh->positions_mm.size()),
               patches = static_cast<double>(ground.layout.patches);
  // Texels: twice as dense as what they are taken from, along u and v.
  double tones = 4 * vertices;
  if (from_image) {
    double used = 0;
    for (const auto& uv : ground.mesh->corner_uv) {
      const glm::dvec2 a = uv[1] - uv[0], b = uv[2] - uv[0];
      used += 0.5 * std::abs(a.x * b.y - a.y * b.x);
    }
    if (used > 0)
      tones = used * texture.image.width() * texture.image.height();  // else a colour a triangle: as of vertices
  }
  int& depth = texture.depth = wanted_depth;
  if (depth < 0) {
    depth = 0;
    auto texels = [&](int d) { return std::ldexp(patches, 2 * (kPageCellsLog2 + d)); };
    while (texels(depth) < tones && texels(depth + 1) < static_cast<double>(kMaxTexels)) ++depth;
  }
  // Vertex colours are linear over the scan's triangles: a grid somewhat finer than these knows all of them. Creases
  // show where it is not much finer; half a million places are looked up in a quarter of a second.
  const double places = std::max(2 * vertices, std::min(16 * vertices, 524'288.0));
  const int texels_log2 = kPageCellsLog2 + depth;
  texture.tone_log2 = 1;
  while (texture.tone_log2 < texels_log2 && std::ldexp(patches, 2 * texture.tone_log2) < places) ++texture.tone_log2;
  if (from_image) texture.tone_log2 = texels_log2;
}

bool bakeTexels(const BakeGround& ground, const BakedHeights& baked, const BakeTexture& texture, double deviation_mm,
                uint32_t patch, std::span<uint8_t> out) {
  const TexelBaker baker{ground, baked, texture};
  if (texture.planes) return baker.planeTexels(patch, out);
  const ToneGrid grid(texture);
  std::vector<Tone> tones;
  if (!baker.lookUpTones(patch, deviation_mm, grid, tones)) return false;
  std::vector<float> mixed(grid.row * kTexelChannels), values(grid.side * kTexelChannels);
  for (size_t y = 0; y < grid.side; ++y) {
    mixRow(grid, tones, y, mixed, values);
    packRow(grid.side, y, values, out);
  }
  return true;
}

}  // namespace relievo
