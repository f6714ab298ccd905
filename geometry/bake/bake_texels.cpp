#include "geometry/bake/bake_texels.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <utility>
#include <vector>

#include "geometry/bake/mesh_bake.h"
#include "geometry/mesh/triangle_point.h"
#include "src/artwork/patch_domain.h"
#include "src/base/simd_dispatch.h"

namespace relievo {
namespace {

constexpr int kTexelChannels = 6, kFirstOfNormal = 3;
using ColourNormal = std::array<float, kTexelChannels>;  // colour, 0 to 255, then the normal's x, y, z

// Where colours and normals of a patch are sampled: at texel centres, or at the vertices of a coarser grid.
struct SampleGrid {
  size_t side;  // texels
  bool per_texel;
  size_t cells, row;
  SampleGrid(const PatchResolution& resolution)
      : side(texelsASide(resolution.depth)),
        per_texel((size_t{1} << resolution.sample_grid_log2) >= side),
        cells(per_texel ? side : size_t{1} << resolution.sample_grid_log2),
        row(per_texel ? side : cells + 1) {}
};

// The rows of samples that texels are interpolated from at a time: those of a row of tiles, and the last one before
// them.
class SampleBand {
 public:
  explicit SampleBand(size_t row) : row_(row) {}
  // Makes room for the rows [first, end), of which the row before is kept.
  void advance(size_t first, size_t end) {
    const size_t kept = first > 0 ? 1 : 0;
    if (kept) {
      std::copy_n(row(first - 1), row_, samples_.begin());
      std::copy_n(creased(first - 1), row_, creased_.begin());
    }
    first_ = first - kept;
    end_ = end;
    samples_.resize((end_ - first_) * row_);
    creased_.resize(samples_.size());
  }
  size_t end() const { return end_; }
  ColourNormal* row(size_t y) { return samples_.data() + (y - first_) * row_; }
  const ColourNormal* row(size_t y) const { return samples_.data() + (y - first_) * row_; }
  // Does a sample lie on a triangle beside a crease? 1 or 0.
  uint8_t* creased(size_t y) { return creased_.data() + (y - first_) * row_; }
  const uint8_t* creased(size_t y) const { return creased_.data() + (y - first_) * row_; }

 private:
  size_t row_, first_ = 0, end_ = 0;
  std::vector<ColourNormal> samples_;
  std::vector<uint8_t> creased_;
};

// The lines through a patch's drawn surface, on which texels look for the scan.
class PatchLines {
 public:
  // deviation_mm: bakeTexels()
  PatchLines(const BakeContext& context, const BakedHeights& baked, double deviation_mm, uint32_t patch)
      : context_(&context),
        baked_(&baked),
        patch_(patch),
        likely_(4 * deviation_mm + baked.step * baked.scale_mm),
        cells_(size_t{1} << baked.cells_log2),
        q_((cells_ + 1) * (cells_ + 1)) {
    baked.gather(context, patch, q_);
  }
  uint32_t patch() const { return patch_; }
  // f: the base at (u, v). The line starts on the drawn surface, so that the texel shows what lies nearest to it.
  void add(LineBatch& batch, const BasePoint& f, double u, double v) const {
    const double h = baked_->offset_mm + baked_->scale_mm * interpolateOnGrid(q_, cells_, u, v);
    batch.add(lineThrough({f.position + h * f.normal, f.normal}, context_->patch_reach[patch_]), u, v, h);
    // Rays are faster if they are short; the rasteriser takes no longer for what is a little further away.
    batch.lines.back().likely = context_->rasteriser ? std::max(likely_, 0.02 * batch.lines.back().reach) : likely_;
  }

 private:
  const BakeContext* context_;
  const BakedHeights* baked_;
  uint32_t patch_;
  double likely_;  // the drawn surface is seldom further from the scan
  size_t cells_;
  std::vector<uint16_t> q_;
};

struct TexelBaker {
  const BakeContext& context;
  const BakeTexture& texture;

  glm::vec2 textureCoordinatesAt(const SurfacePoint& at) const;
  ColourNormal colourNormalAt(const SurfacePoint& at) const;
  // False: the bake was interrupted.
  bool bakePlanes(const PatchLines& lines, std::span<uint8_t> out) const;
  template <class Use>
  bool sampleSurface(const PatchLines& lines, const SampleGrid& grid, Use use) const;
  // Moves samples on the patch's sides beside a crease into the patch. tile: the samples [x0, x1) x [y0, y1).
  void sampleInside(const PatchLines& lines, const SampleGrid& grid, const std::array<size_t, 4>& tile,
                    LineBatch& batch, SampleBand& band) const;
  // Bakes the texels of those cells of the rows [first, end) each by itself that a crease crosses, or the border
  // between two plain colours.
  bool sharpenCells(const PatchLines& lines, const SampleGrid& grid, const SampleBand& samples, size_t first,
                    size_t end, std::span<uint8_t> out) const;
  SurfacePoint pointOf(const LineBatch& batch, size_t line) const;
};

// Where corners' normals oppose one another, as at a sheet that folds back on itself, lines between them run along the
// patch, or through it from behind, and meet another sheet: far away, or one that faces opposite to the base. There the
// line through the patch itself is taken, if it meets the scan where the drawn surface is likely to be.
SurfacePoint TexelBaker::pointOf(const LineBatch& batch, size_t i) const {
  constexpr double kOpposite = -0.5;  // as BakeContext::touchingPoint()
  if (batch.on_own_triangles) return batch.hits[i];
  const Line& line = batch.lines[i];
  const SurfacePoint found = batch.hits[i] ? batch.hits[i] : context.scene->closestPoint(line.at);
  const TriangleCorners t = cornersOf(*context.mesh, found.triangle);
  const glm::dvec3 up = batch.baseNormal(i), normal = glm::cross(t.b - t.a, t.c - t.a);
  const bool near = batch.hits[i] && std::abs(found.along) <= line.likely;
  if (near && !(glm::dot(normal, up) < kOpposite * glm::length(normal))) return found;
  const SurfacePoint own = context.scene->nearestOnLine({line.at, up, line.likely, line.likely}, Facing::kAlong);
  return own ? own : found;
}

glm::vec2 TexelBaker::textureCoordinatesAt(const SurfacePoint& at) const {
  const auto uv = texture.coordinates(*context.mesh, at.triangle);
  return uv[0] * static_cast<float>(1 - at.b1 - at.b2) + uv[1] * static_cast<float>(at.b1) +
         uv[2] * static_cast<float>(at.b2);
}

// Samples the image at each texel. Image detail finer than a texel is averaged by its mip levels. The level follows
// from the number of image texels for each mm of the triangle, since (u, v) of neighbouring texels may lie in different
// parts of the image.
bool TexelBaker::bakePlanes(const PatchLines& lines, std::span<uint8_t> out) const {
  const uint32_t patch = lines.patch();
  const size_t side = texelsASide(texture.of_patch[patch].depth);
  const MipImage& image = texture.images[0].texels;
  const auto channels = static_cast<size_t>(image.channels());
  const auto& c = context.base.patches[patch];
  double perimeter_mm = 0;
  for (const auto& [a, b] : kSideCorners)
    perimeter_mm += glm::length(context.cornerPoint(c[static_cast<size_t>(a)]).position -
                                context.cornerPoint(c[static_cast<size_t>(b)]).position);
  const double texel_mm = perimeter_mm / (4.0 * static_cast<double>(side));
  LineBatch batch;
  std::vector<float> values(channels);
  return Tiles(side, context.tileSize()).forEach([&](size_t x0, size_t y0, size_t x1, size_t y1) {
    auto fraction = [&](size_t x) { return static_cast<double>(x) / static_cast<double>(side); };
    context.beginBatch(batch, patch, fraction(x0), fraction(y0), fraction(x1), fraction(y1));
    for (size_t i = 0; i < (x1 - x0) * (y1 - y0); ++i) {
      const size_t x = x0 + i % (x1 - x0), y = y0 + i / (x1 - x0);
      const double u = (static_cast<double>(x) + 0.5) / static_cast<double>(side),
                   v = (static_cast<double>(y) + 0.5) / static_cast<double>(side);
      lines.add(batch, context.patchPoint(patch, u, v), u, v);
    }
    context.intersect(batch);
    for (size_t l = 0; l < batch.lines.size(); ++l) {
      const size_t x = x0 + l % (x1 - x0), y = y0 + l / (x1 - x0);
      const SurfacePoint at = pointOf(batch, l);
      const auto& t = context.mesh->triangles[at.triangle];
      const auto& uv = context.mesh->corner_uv[at.triangle];
      const glm::vec3 &p = context.mesh->positions_mm[t[0]], e = context.mesh->positions_mm[t[1]] - p,
                      g = context.mesh->positions_mm[t[2]] - p;
      const glm::vec2 i = uv[1] - uv[0], j = uv[2] - uv[0];
      const double image_area = std::abs(double{i.x} * j.y - double{i.y} * j.x) * image.width() * image.height(),
                   area = glm::length(glm::cross(e, g));
      const double lod = area > 0 ? 0.5 * std::log2(texel_mm * texel_mm * image_area / area) : 0.0;
      image.sample(textureCoordinatesAt(at), static_cast<float>(lod), values);
      for (size_t k = 0; k < channels; ++k)
        out[(k * side + y) * side + x] = static_cast<uint8_t>(std::clamp(values[k] + 0.5f, 0.0f, 255.0f));
    }
    return !context.stopped();
  });
}

ColourNormal TexelBaker::colourNormalAt(const SurfacePoint& at) const {
  const auto& t = context.mesh->triangles[at.triangle];
  const std::array<float, 3> w{static_cast<float>(1 - at.b1 - at.b2), static_cast<float>(at.b1),
                               static_cast<float>(at.b2)};
  ColourNormal out{kPlainGrey, kPlainGrey, kPlainGrey, 0, 0, 0};
  if (const BakeTexture::Image* image = texture.imageOf(*context.mesh, at.triangle)) {
    image->texels.sample(textureCoordinatesAt(at), 0, out);
  } else if (!context.mesh->colours.empty()) {
    for (size_t c = 0; c < 3; ++c) {
      out[c] = 0;
      for (size_t k = 0; k < 3; ++k)
        out[c] += w[k] * static_cast<float>(context.mesh->colours[t[k]][static_cast<int>(c)]);
    }
  }
  glm::vec3 n(0);
  const auto normals = shadingNormals(*context.mesh, *context.normals, at.triangle);
  if (!texture.frames.empty() && texture.frames[at.triangle].isKnown()) {
    const TangentFrame& frame = texture.frames[at.triangle];
    std::array<float, 3> m{};  // x, y, z in that frame
    texture.imageOf(*context.mesh, at.triangle)->normals.sample(textureCoordinatesAt(at), 0, m);
    for (float& v : m) v = v / 127.5f - 1;
    for (size_t k = 0; k < 3; ++k)
      n += w[k] * (m[0] * frame.tangent[k] + m[1] * frame.bitangent(normals[k], k) + m[2] * normals[k]);
  } else {
    for (size_t k = 0; k < 3; ++k) n += w[k] * normals[k];
  }
  if (!(glm::length(n) > 1e-3f))
    n = glm::cross(context.mesh->positions_mm[t[1]] - context.mesh->positions_mm[t[0]],
                   context.mesh->positions_mm[t[2]] - context.mesh->positions_mm[t[0]]);
  const float length = glm::length(n);
  if (length > 0) n /= length;
  out[3] = n.x;
  out[4] = n.y;
  out[5] = n.z;
  return out;
}

// Where patches meet along a crease, a sample on their common side has the normal of either. Half a texel further in,
// each patch has its own.
void TexelBaker::sampleInside(const PatchLines& lines, const SampleGrid& grid, const std::array<size_t, 4>& tile,
                              LineBatch& batch, SampleBand& band) const {
  const size_t x0 = tile[0], y0 = tile[1], x1 = tile[2], y1 = tile[3];
  const auto cells = static_cast<double>(grid.cells);
  const double inset = 0.5 / static_cast<double>(grid.side);
  auto fraction = [&](size_t x) { return std::min(static_cast<double>(x) / cells, 1.0); };
  std::vector<std::array<size_t, 2>> samples;
  for (size_t y = y0; y < y1; ++y)
    for (size_t x = x0; x < x1; ++x)
      if (band.creased(y)[x] && (x == 0 || y == 0 || x == grid.cells || y == grid.cells)) samples.push_back({x, y});
  if (samples.empty()) return;
  context.beginBatch(batch, lines.patch(), fraction(x0), fraction(y0), fraction(x1), fraction(y1));
  for (const auto& sample : samples) {
    const double u = std::clamp(fraction(sample[0]), inset, 1 - inset),
                 v = std::clamp(fraction(sample[1]), inset, 1 - inset);
    lines.add(batch, context.patchPoint(lines.patch(), u, v), u, v);
  }
  context.intersect(batch);
  for (size_t i = 0; i < samples.size(); ++i)
    band.row(samples[i][1])[samples[i][0]] = colourNormalAt(pointOf(batch, i));
}

// Calls use(band) after each row of tiles.
template <class Use>
bool TexelBaker::sampleSurface(const PatchLines& lines, const SampleGrid& grid, Use use) const {
  const bool per_texel = grid.per_texel;
  const size_t cells = grid.cells, row = grid.row;
  const uint32_t patch = lines.patch();
  SampleBand band(row);
  LineBatch batch;
  std::array<BasePoint, 4> corners;
  for (size_t k = 0; k < 4; ++k) corners[k] = context.cornerPoint(context.base.patches[patch][k]);
  return Tiles(row, context.tileSize()).forEach([&](size_t x0, size_t y0, size_t x1, size_t y1) {
    if (x0 == 0) band.advance(y0, y1);
    auto fraction = [&](size_t x) { return std::min(static_cast<double>(x) / static_cast<double>(cells), 1.0); };
    context.beginBatch(batch, patch, fraction(x0), fraction(y0), fraction(x1), fraction(y1));
    const double half = per_texel ? 0.5 : 0;
    auto place = [&](size_t x) { return (static_cast<double>(x) + half) / static_cast<double>(cells); };
    for (size_t y = y0; y < y1; ++y) {
      const double v = place(y);
      // Texels are not shared with other patches, so that a row needs two interpolations only.
      const BasePoint left = lerp(corners[0], corners[2], v), right = lerp(corners[1], corners[3], v);
      for (size_t x = x0; x < x1; ++x) {
        const double u = place(x);
        const BasePoint at = !per_texel         ? context.gridPoint(patch, x, y, cells)
                             : context.base.cut ? context.patchPoint(patch, u, v)
                                                : lerp(left, right, u);
        lines.add(batch, at, u, v);
      }
    }
    context.intersect(batch);
    for (size_t i = 0; i < batch.lines.size(); ++i) {
      const size_t x = x0 + i % (x1 - x0), y = y0 + i / (x1 - x0);
      const SurfacePoint at = pointOf(batch, i);
      band.row(y)[x] = colourNormalAt(at);
      band.creased(y)[x] = context.normals->isSplit(at.triangle);
    }
    if (!per_texel && context.normals->hasCreases() && !batch.on_own_triangles)
      sampleInside(lines, grid, {x0, y0, x1, y1}, batch, band);
    if (x1 == row) use(std::as_const(band));
    return !context.stopped();
  });
}

// The last row of samples that row y of the texels is interpolated from.
size_t lastSampleRow(const SampleGrid& grid, size_t y) { return grid.per_texel ? y : y / (grid.side / grid.cells) + 1; }

// Texels of a row between samples, `run` for each cell; kRun: where that is known beforehand.
template <size_t kRun>
inline void interpolateCells(const float* samples, size_t cells, size_t run, float* values) noexcept {
  const size_t steps = kRun > 0 ? kRun : run;
  for (size_t cell = 0; cell < cells; ++cell) {
    const float start = samples[cell], step = (samples[cell + 1] - samples[cell]) / static_cast<float>(steps);
    for (size_t i = 0; i < steps; ++i)
      values[cell * steps + i] = start + step * (static_cast<float>(static_cast<int>(i)) + 0.5f);
  }
}

// Interpolates row y of the texels into values, one array for each channel from `first` on. above, below: the rows of
// samples around it. row_samples: scratch memory for a row of samples, and one of their channels.
RELIEVO_SIMD_CLONES void interpolateRow(const SampleGrid& grid, const float* above, const float* below, size_t y,
                                        size_t first, float* row_samples, float* values) noexcept {
  const auto [side, per_texel, cells, row] = grid;
  if (per_texel) {
    for (size_t k = first; k < kTexelChannels; ++k)
      for (size_t x = 0; x < side; ++x) values[k * side + x] = above[x * kTexelChannels + k];
    return;
  }
  const size_t run = side / cells;  // texels for each cell
  const float fy = (static_cast<float>(y % run) + 0.5f) / static_cast<float>(run);
  float *mixed = row_samples, *m = row_samples + row * kTexelChannels;
  for (size_t i = 0; i < row * kTexelChannels; ++i) mixed[i] = above[i] * (1 - fy) + below[i] * fy;
  for (size_t k = first; k < kTexelChannels; ++k) {
    for (size_t x = 0; x < row; ++x) m[x] = mixed[x * kTexelChannels + k];
    float* v = values + k * side;
    if (run == 2) interpolateCells<2>(m, cells, run, v);
    else if (run == 4) interpolateCells<4>(m, cells, run, v);
    else interpolateCells<0>(m, cells, run, v);
  }
}

// As bytes: below 0 and above 255 the nearest.
inline uint8_t byteOf(float value) {
  return static_cast<uint8_t>(static_cast<int>(std::min(std::max(value + 0.5f, 0.0f), 255.0f)));
}

// Writes row y as bytes, channels from `first` on, with normals scaled to length 1.
RELIEVO_SIMD_CLONES void quantiseRow(size_t side, size_t y, size_t first, float* values, uint8_t* out) noexcept {
  const size_t plane = side * side;
  float *nx = values + 3 * side, *ny = nx + side, *nz = ny + side;
#pragma GCC ivdep
  for (size_t x = 0; x < side; ++x) {
    // Interpolated normals vanish where opposite ones meet; the lower bound avoids a division by 0.
    const float squared = nx[x] * nx[x] + ny[x] * ny[x] + nz[x] * nz[x],
                scale = 127.5f / std::sqrt(squared > 1e-12f ? squared : 1e-12f);
    nx[x] = nx[x] * scale + 127.5f;
    ny[x] = ny[x] * scale + 127.5f;
    nz[x] = nz[x] * scale + 127.5f;
  }
  for (size_t k = first; k < kTexelChannels; ++k) {
    const float* v = values + k * side;
    uint8_t* to = out + k * plane + y * side;
#pragma GCC ivdep
    for (size_t x = 0; x < side; ++x) to[x] = byteOf(v[x]);
  }
}

// Do a cell's corners have different colours?
bool isColoured(const SampleBand& samples, size_t x, size_t y) {
  constexpr float kRounding = 0.5f;  // of what is interpolated between three times the same texel
  const ColourNormal& first = samples.row(y)[x];
  for (size_t k = 1; k < 4; ++k)
    for (size_t c = 0; c < 3; ++c)
      if (std::abs(samples.row(y + k / 2)[x + k % 2][c] - first[c]) > kRounding) return true;
  return false;
}

// Is there a crease between a cell's corners? On a smooth surface their normals differ by less.
bool isCreased(const SampleBand& samples, size_t x, size_t y) {
  constexpr float kCosine = 0.9659f;  // 15 degrees
  bool beside = false;
  std::array<glm::vec3, 4> normals;
  for (size_t k = 0; k < 4; ++k) {
    const ColourNormal& s = samples.row(y + k / 2)[x + k % 2];
    normals[k] = {s[3], s[4], s[5]};
    beside |= samples.creased(y + k / 2)[x + k % 2] != 0;
  }
  if (!beside) return false;
  for (size_t a = 0; a < 4; ++a)
    for (size_t b = a + 1; b < 4; ++b)
      if (glm::dot(normals[a], normals[b]) < kCosine) return true;
  return false;
}

bool TexelBaker::sharpenCells(const PatchLines& lines, const SampleGrid& grid, const SampleBand& samples, size_t first,
                              size_t end, std::span<uint8_t> out) const {
  const bool plain = texture.of_patch[lines.patch()].plain;
  const size_t run = grid.side / grid.cells, tile = std::max<size_t>(1, context.tileSize() / run);
  const auto side = static_cast<double>(grid.side), cells = static_cast<double>(grid.cells);
  auto texelCentre = [&](size_t x) { return (static_cast<double>(x) + 0.5) / side; };
  LineBatch batch;
  std::vector<std::array<size_t, 2>> texels;
  for (size_t y0 = first; y0 < end; y0 += tile) {
    const size_t y1 = std::min(y0 + tile, end);
    for (size_t x0 = 0; x0 < grid.cells; x0 += tile) {
      const size_t x1 = std::min(x0 + tile, grid.cells);
      texels.clear();
      for (size_t y = y0; y < y1; ++y)
        for (size_t x = x0; x < x1; ++x)
          if (isCreased(samples, x, y) || (plain && isColoured(samples, x, y)))
            for (size_t i = 0; i < run * run; ++i) texels.push_back({x * run + i % run, y * run + i / run});
      if (texels.empty()) continue;
      context.beginBatch(batch, lines.patch(), static_cast<double>(x0) / cells, static_cast<double>(y0) / cells,
                         static_cast<double>(x1) / cells, static_cast<double>(y1) / cells);
      for (const auto& [x, y] : texels) {
        const double u = texelCentre(x), v = texelCentre(y);
        lines.add(batch, context.patchPoint(lines.patch(), u, v), u, v);
      }
      context.intersect(batch);
      for (size_t i = 0; i < texels.size(); ++i) {
        ColourNormal texel = colourNormalAt(pointOf(batch, i));
        for (size_t k = 3; k < kTexelChannels; ++k) texel[k] = texel[k] * 127.5f + 127.5f;
        for (size_t k = 0; k < kTexelChannels; ++k)
          out[(k * grid.side + texels[i][1]) * grid.side + texels[i][0]] = byteOf(texel[k]);
      }
      if (context.stopped()) return false;
    }
  }
  return true;
}

// Hardly ever the same for two.
uint32_t numberOf(const glm::vec3& normal) {
  uint32_t number = 0;
  for (int axis = 0; axis < 3; ++axis) number = number * 0x9E3779B1u ^ std::bit_cast<uint32_t>(normal[axis]);
  return number;
}

}  // namespace

std::vector<TangentFrame> tangentFrames(const BakeContext& context, const BakeTexture& texture) {
  const auto hasNormals = [](const BakeTexture::Image& image) { return !image.normals.empty(); };
  if (std::none_of(texture.images.begin(), texture.images.end(), hasNormals)) return {};
  const TriMesh& mesh = *context.mesh;
  TangentFrames frames;
  frames.reserve(mesh.triangles.size());
  for (uint32_t t = 0; t < mesh.triangles.size(); ++t) {
    const BakeTexture::Image* image = texture.imageOf(mesh, t);
    if (!image || !hasNormals(*image)) {
      frames.addNone();
      continue;
    }
    const auto number = static_cast<uint32_t>(image - texture.images.data());
    const auto normals = shadingNormals(mesh, *context.normals, t);
    MappedTriangle triangle;
    triangle.downwards = image->normals_downwards;
    for (size_t k = 0; k < 3; ++k) {
      const uint32_t vertex = mesh.triangles[t][k];
      const glm::vec2& uv = mesh.corner_uv[t][k];
      triangle.position[k] = glm::dvec3(mesh.positions_mm[vertex]);
      triangle.normal[k] = normals[k];
      triangle.place[k] = glm::dvec2(uv) * glm::dvec2(image->places);
      triangle.corner[k] = {vertex, std::bit_cast<uint32_t>(uv.x), std::bit_cast<uint32_t>(uv.y), number,
                            numberOf(normals[k])};
    }
    frames.add(triangle);
  }
  return std::move(frames).finish();
}

bool bakeTexels(const BakeContext& context, const BakedHeights& baked, const BakeTexture& texture, double deviation_mm,
                uint32_t patch, std::span<uint8_t> out) {
  const TexelBaker baker{context, texture};
  const PatchLines lines(context, baked, deviation_mm, patch);
  if (texture.planes) return baker.bakePlanes(lines, out);
  const SampleGrid grid(texture.of_patch[patch]);
  std::vector<float> row_samples(grid.row * (kTexelChannels + 1)), values(grid.side * kTexelChannels);
  const bool coloured = texture.images.empty() ? !context.mesh->colours.empty() : !texture.one_colour;
  const size_t first = coloured ? 0 : kFirstOfNormal;
  ColourNormal plain{kPlainGrey, kPlainGrey, kPlainGrey};
  if (texture.one_colour) texture.images[0].texels.sample(glm::vec2(0), 0, plain);
  for (size_t k = 0; k < first; ++k)
    std::fill_n(out.begin() + static_cast<std::ptrdiff_t>(k * grid.side * grid.side), grid.side * grid.side,
                byteOf(plain[k]));
  // Interpolation blurs a crease, or a border of colours, over a cell.
  const bool sharpen = !grid.per_texel && (context.normals->hasCreases() || texture.of_patch[patch].plain);
  size_t y = 0, sharpened = 0;  // rows of texels, of cells
  bool whole = true;
  const bool sampled = baker.sampleSurface(lines, grid, [&](const SampleBand& samples) {
    for (; y < grid.side && lastSampleRow(grid, y) < samples.end(); ++y) {
      const size_t above = grid.per_texel ? y : y / (grid.side / grid.cells);
      interpolateRow(grid, samples.row(above)->data(), samples.row(grid.per_texel ? y : above + 1)->data(), y, first,
                     row_samples.data(), values.data());
      quantiseRow(grid.side, y, first, values.data(), out.data());
    }
    if (!sharpen) return;
    whole = whole && baker.sharpenCells(lines, grid, samples, sharpened, samples.end() - 1, out);
    sharpened = samples.end() - 1;
  });
  return sampled && whole;
}

}  // namespace relievo
