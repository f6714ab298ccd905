#include "tests/render/dense_reference.h"

#include <algorithm>
#include <bit>
#include <cassert>
#include <cmath>
#include <cstdio>
#include <limits>

#include "geometry/lod/snap.h"

namespace relievo {

namespace {

// Half the side of the square around a pixel's centre in which triangles may be confused (the header says why).
constexpr double kBoxPx = 1.0 / 64.0;
// Two ends of a triangle's height, each snapped to 1/256 px: what the height may be off by.
constexpr double kSnapPx = 1.41421356 / 256.0;
// Depths closer than this may be taken in either order (the header derives it).
constexpr double kDepthSlack = 0x1p-21;
// Twice what snapping moves a place by, and what is left for single precision.
constexpr double kTexelTiePx = 1.0 / 128.0;
constexpr int kMaxChannels = 3 * kMaxTexturePlanes;

}  // namespace

// --- A. dense pyramid

FlatDomain denseDomain(const TextureSource& texture, const HeightSource* relief, double mm_per_px) {
  FlatDomain d;
  d.width_px = static_cast<uint64_t>(texture.width());
  d.height_px = static_cast<uint64_t>(texture.height());
  d.mm_per_px = mm_per_px;
  d.texture_depth = FlatDomain::depthFor(d.width_px, d.height_px);
  if (relief != nullptr) {
    d.relief_depth = d.texture_depth;
    d.relief_offset_mm = relief->minMm();
    d.relief_scale_mm = (relief->maxMm() - relief->minMm()) / 65535.0;
  }
  return d;
}

namespace {

// The sRGB transfer curve (IEC 61966-2-1) between 8.8 fixed point and 16-bit linear light.
int64_t linearFromLevel(int64_t v) {
  const double s = static_cast<double>(v) / 65280.0;
  return std::llround(65535.0 * (s <= 0.04045 ? s / 12.92 : std::pow((s + 0.055) / 1.055, 2.4)));
}
int64_t levelFromLinear(int64_t n) {
  const double l = static_cast<double>(n) / 65535.0;
  const double s = l <= 0.0031308 ? 12.92 * l : 1.055 * std::pow(l, 1.0 / 2.4) - 0.055;
  return std::llround(65280.0 * std::clamp(s, 0.0, 1.0));
}
// Every value once, since pow is slow.
std::vector<int64_t> tabulate(int64_t (*function)(int64_t), int64_t count) {
  std::vector<int64_t> table;
  for (int64_t v = 0; v < count; ++v) table.push_back(function(v));
  return table;
}

// The weight of the colour that a luminance multiplies: the luminance under diffuse light, in quarters. Of an LRGB PTM
// it is (a0 + a1) / 3 + a5.
struct LuminanceWeight {
  struct Term {
    int channel = 0;
    size_t coefficient = 0;
    double mean = 0;
    int64_t m = 0;
  };
  std::vector<Term> terms;
  int64_t c = 0;

  explicit LuminanceWeight(const TextureFormat& f) {
    if (f.basis == Basis::kPtmLrgb) {
      terms = {{0, 0, 1.0 / 3}, {1, 1, 1.0 / 3}, {5, 5, 1}};
    } else {
      const BasisDescription& d = describe(f.basis);
      for (int i = 0; i < 3 * d.planes; ++i) {
        const BasisChannel& channel = d.channels[static_cast<size_t>(i)];
        if (channel.holds == BasisChannel::Holds::kCoefficient && d.diffuse[channel.coefficient] != 0)
          terms.push_back({i, channel.coefficient, d.diffuse[channel.coefficient]});
      }
    }
    auto exact = [&](const Term& t) { return 4096.0 * t.mean * f.scale[t.coefficient]; };
    const double most = terms.size() <= 3 ? 65536 : std::floor(196608.0 / static_cast<double>(terms.size()));
    double divisor = 1, constant = 0;
    for (bool fits = false; !fits; divisor *= fits ? 1 : 2)
      fits =
          std::all_of(terms.begin(), terms.end(), [&](const Term& t) { return std::abs(exact(t)) / divisor <= most; });
    for (Term& t : terms) {
      t.m = std::llround(exact(t) / divisor);
      constant -= static_cast<double>(t.m) * std::round(16 * f.bias[t.coefficient]);
    }
    c = static_cast<int64_t>(std::clamp(constant, -8e8, 8e8));
  }
  int64_t operator()(const uint16_t* texel) const {
    int64_t sum = c;
    for (const Term& t : terms) sum += t.m * (texel[t.channel] >> 4);
    return std::clamp<int64_t>(sum >> 14, 1, 4095);
  }
};

enum class Mean { kNumbers, kLinearLight, kWeighted };
Mean meanOf(const TextureFormat& f, int channel) {
  if (f.basis == Basis::kColour) return Mean::kLinearLight;
  if (f.basis == Basis::kPtmLrgb) return channel < 6 ? Mean::kNumbers : Mean::kWeighted;
  const BasisDescription& d = describe(f.basis);
  return d.channels[static_cast<size_t>(channel)].holds == BasisChannel::Holds::kColour ? Mean::kWeighted
                                                                                        : Mean::kNumbers;
}

}  // namespace

std::vector<uint16_t> denseDownsample(const TextureFormat& format, const std::vector<uint16_t>& in, int64_t width,
                                      int64_t height) {
  static const std::vector<int64_t> to_linear = tabulate(linearFromLevel, 65281);
  static const std::vector<int64_t> from_linear = tabulate(levelFromLinear, 65536);
  const LuminanceWeight weight(format);
  const int channels = format.channels();
  const int64_t out_width = (width + 1) / 2, out_height = (height + 1) / 2;
  std::vector<uint16_t> out(static_cast<size_t>(out_width * out_height * channels));
  for (int64_t y = 0; y < out_height; ++y) {
    for (int64_t x = 0; x < out_width; ++x) {
      const int64_t x1 = std::min(2 * x + 1, width - 1), y1 = std::min(2 * y + 1, height - 1);
      const uint16_t* texel[4] = {&in[(2 * y * width + 2 * x) * channels], &in[(2 * y * width + x1) * channels],
                                  &in[(y1 * width + 2 * x) * channels], &in[(y1 * width + x1) * channels]};
      uint16_t* to = &out[(y * out_width + x) * channels];
      int64_t total = 0;
      for (const uint16_t* t : texel) total += weight(t);
      for (int c = 0; c < channels; ++c) {
        const Mean mean = meanOf(format, c);
        int64_t sum = mean == Mean::kWeighted ? total / 2 : 2;
        for (const uint16_t* t : texel)
          sum += mean == Mean::kNumbers ? t[c] : mean == Mean::kLinearLight ? to_linear[t[c]] : weight(t) * t[c];
        to[c] = static_cast<uint16_t>(mean == Mean::kNumbers       ? sum >> 2
                                      : mean == Mean::kLinearLight ? from_linear[sum >> 2]
                                                                   : sum / total);
      }
    }
  }
  return out;
}

namespace {

Result<DenseLevel> readFinest(const TextureSource& source) {
  const int channels = source.format().channels();
  DenseLevel finest;
  finest.width = finest.stored_width = source.width();
  finest.height = finest.stored_height = source.height();
  finest.texels.resize(static_cast<size_t>(finest.width * finest.height * channels));
  std::vector<uint8_t> band;
  constexpr int64_t kBandRows = 64;
  for (int64_t y0 = 0; y0 < finest.height; y0 += kBandRows) {
    const int64_t rows = std::min(kBandRows, finest.height - y0);
    band.resize(static_cast<size_t>(finest.width * rows * channels));
    auto read = source.read({0, y0, finest.width, rows}, band);
    if (!read.ok()) return read.error();
    for (int c = 0; c < channels; ++c)
      for (int64_t y = 0; y < rows; ++y)
        for (int64_t x = 0; x < finest.width; ++x)
          finest.texels[((y0 + y) * finest.width + x) * channels + c] = band[(c * rows + y) * finest.width + x];
  }
  return finest;
}

// The levels below the finest, from what is stored of it.
void addCoarserLevels(DenseTexture& t) {
  const DenseLevel& finest = t.levels.back();
  std::vector<uint16_t> fixed(finest.texels.size());
  for (size_t i = 0; i < fixed.size(); ++i) fixed[i] = static_cast<uint16_t>(finest.texels[i] << 8);
  for (int l = t.domain.texture_depth - 1; l >= 0; --l) {
    const DenseLevel& finer = t.levels[l + 1];
    DenseLevel& level = t.levels[l];
    fixed = denseDownsample(t.format, fixed, finer.stored_width, finer.stored_height);
    level.width = (finer.width + 1) / 2;
    level.height = (finer.height + 1) / 2;
    level.stored_width = (finer.stored_width + 1) / 2;
    level.stored_height = (finer.stored_height + 1) / 2;
    level.texels.resize(fixed.size());
    for (size_t i = 0; i < fixed.size(); ++i)
      level.texels[i] = static_cast<uint8_t>(std::min(255, (fixed[i] + 128) >> 8));
  }
}

}  // namespace

Result<DenseTexture> buildDenseTexture(const TextureSource& source, const FlatDomain& domain) {
  DenseTexture t{domain, source.format(), {}};
  t.levels.resize(static_cast<size_t>(domain.texture_depth) + 1);
  auto finest = readFinest(source);
  if (!finest.ok()) return finest.error();
  t.levels.back() = std::move(*finest);
  addCoarserLevels(t);
  return t;
}

Result<DenseTexture> buildPeriodicTexture(const TextureSource& period, const FlatDomain& domain) {
  assert(std::has_single_bit(static_cast<uint64_t>(period.width())) && domain.width_px % period.width() == 0);
  assert(std::has_single_bit(static_cast<uint64_t>(period.height())) && domain.height_px % period.height() == 0);
  auto t = DenseTexture{domain, period.format(), {}};
  t.levels.resize(static_cast<size_t>(domain.texture_depth) + 1);
  auto finest = readFinest(period);
  if (!finest.ok()) return finest.error();
  t.levels.back() = std::move(*finest);
  t.levels.back().width = static_cast<int64_t>(domain.width_px);
  t.levels.back().height = static_cast<int64_t>(domain.height_px);
  addCoarserLevels(t);
  return t;
}

// --- B. dense relief

Result<DenseRelief> buildDenseRelief(const HeightSource& source, const FlatDomain& domain) {
  DenseRelief r;
  r.samples_per_texel_log2 = domain.relief_depth - domain.texture_depth;
  r.offset_mm = source.minMm();
  r.scale_mm = (source.maxMm() - source.minMm()) / 65535.0;
  const double width_px = static_cast<double>(domain.width_px), height_px = static_cast<double>(domain.height_px);
  r.width = static_cast<int64_t>(std::ceil(std::ldexp(width_px, r.samples_per_texel_log2))) + 1;
  r.height = static_cast<int64_t>(std::ceil(std::ldexp(height_px, r.samples_per_texel_log2))) + 1;
  r.samples.resize(static_cast<size_t>(r.width * r.height));

  const int64_t map_width = source.width(), map_height = source.height();
  std::vector<float> map(static_cast<size_t>(map_width * map_height));
  auto read = source.read({0, 0, map_width, map_height}, map);
  if (!read.ok()) return read.error();

  struct Tap {
    int64_t a, b;
    double t;
  };
  auto tap = [&](int64_t i, double extent_px, int64_t map_extent) {
    const double x = std::min(std::ldexp(static_cast<double>(i), -r.samples_per_texel_log2), extent_px);
    const double p = x * static_cast<double>(map_extent) / extent_px - 0.5;
    const double cell = std::floor(p);
    auto clamped = [&](int64_t k) { return std::clamp<int64_t>(k, 0, map_extent - 1); };
    return Tap{clamped(static_cast<int64_t>(cell)), clamped(static_cast<int64_t>(cell) + 1), p - cell};
  };
  std::vector<Tap> columns(static_cast<size_t>(r.width));
  for (int64_t i = 0; i < r.width; ++i) columns[i] = tap(i, width_px, map_width);
  for (int64_t j = 0; j < r.height; ++j) {
    const Tap row = tap(j, height_px, map_height);
    for (int64_t i = 0; i < r.width; ++i) {
      const Tap& col = columns[i];
      const double top = map[row.a * map_width + col.a] * (1 - col.t) + map[row.a * map_width + col.b] * col.t;
      const double bottom = map[row.b * map_width + col.a] * (1 - col.t) + map[row.b * map_width + col.b] * col.t;
      const double mm = top * (1 - row.t) + bottom * row.t;
      const double q = r.scale_mm > 0 ? std::floor((mm - r.offset_mm) / r.scale_mm + 0.5) : 0.0;
      r.samples[j * r.width + i] = static_cast<uint16_t>(std::clamp(q, 0.0, 65535.0));
    }
  }
  return r;
}

namespace {

// Slopes (to the right, downwards) of a cell of relief level r: of the bilinear surface through its corners, at its
// middle.
glm::dvec2 denseCellSlope(const DenseRelief& relief, const FlatDomain& d, int r, int64_t x, int64_t y,
                          double exaggerate) {
  const int64_t apart = int64_t{1} << (d.relief_depth - r);
  const double side_px = std::ldexp(1.0, d.texture_depth - r);
  auto mm = [&](int64_t i, int64_t j) {
    return exaggerate * relief.scale_mm *
           relief.samples[static_cast<size_t>(std::min(j * apart, relief.height - 1) * relief.width +
                                              std::min(i * apart, relief.width - 1))];
  };
  auto placeMm = [&](int64_t i, uint64_t extent) {
    return d.mm_per_px * std::min(side_px * static_cast<double>(i), static_cast<double>(extent));
  };
  const double right = 0.5 * (mm(x + 1, y) - mm(x, y) + mm(x + 1, y + 1) - mm(x, y + 1)),
               down = 0.5 * (mm(x, y + 1) - mm(x, y) + mm(x + 1, y + 1) - mm(x + 1, y));
  return {right / (placeMm(x + 1, d.width_px) - placeMm(x, d.width_px)),
          down / (placeMm(y + 1, d.height_px) - placeMm(y, d.height_px))};
}

}  // namespace

glm::dvec3 denseNormal(const DenseRelief& relief, const FlatDomain& d, int k, int64_t x, int64_t y, double exaggerate) {
  const int r = std::min(k, d.relief_depth);
  glm::dvec2 slope{0};
  if (r == k) {
    slope = denseCellSlope(relief, d, r, x, y, exaggerate);
  } else {
    // Bilinear between the middles of the finest cells; those beyond the artwork are its last ones.
    const double texels = std::ldexp(1.0, k - r), px = (static_cast<double>(x) + 0.5) / texels - 0.5,
                 py = (static_cast<double>(y) + 0.5) / texels - 0.5;
    const auto cx = static_cast<int64_t>(std::floor(px)), cy = static_cast<int64_t>(std::floor(py));
    for (int64_t j = 0; j < 2; ++j) {
      for (int64_t i = 0; i < 2; ++i) {
        const double wx = 1 - std::abs(px - static_cast<double>(cx + i)),
                     wy = 1 - std::abs(py - static_cast<double>(cy + j));
        slope += wx * wy *
                 denseCellSlope(relief, d, r, std::clamp<int64_t>(cx + i, 0, static_cast<int64_t>(d.levelWidth(r)) - 1),
                                std::clamp<int64_t>(cy + j, 0, static_cast<int64_t>(d.levelHeight(r)) - 1), exaggerate);
      }
    }
  }
  return glm::normalize(glm::dvec3(-slope.x, slope.y, 1));
}

DenseTexture denseWithNormals(const DenseTexture& colour, const DenseRelief& relief, double exaggerate) {
  DenseTexture out = colour;
  out.format.basis = Basis::kAlbedoNormal;
  for (size_t k = 0; k < out.levels.size(); ++k) {
    DenseLevel& level = out.levels[k];
    const DenseLevel& from = colour.levels[k];
    level.stored_width = level.width;
    level.stored_height = level.height;
    level.texels.resize(static_cast<size_t>(level.width * level.height * 6));
    for (int64_t y = 0; y < level.height; ++y) {
      for (int64_t x = 0; x < level.width; ++x) {
        uint8_t* to = &level.texels[static_cast<size_t>((y * level.width + x) * 6)];
        const glm::dvec3 n = denseNormal(relief, colour.domain, static_cast<int>(k), x, y, exaggerate);
        for (int c = 0; c < 3; ++c) {
          to[c] = from.texel(x, y, 3)[c];
          to[3 + c] = static_cast<uint8_t>(std::floor(127.5 * (n[c] + 1) + 0.5));
        }
      }
    }
  }
  return out;
}

double denseHeightMm(const DenseRelief& relief, const FlatDomain& domain, int64_t x, int64_t y) {
  // Exact: a power of two times an integer of at most 53 bits.
  auto place = [&](int64_t units, uint64_t extent_px) {
    const double extent = std::ldexp(static_cast<double>(extent_px), relief.samples_per_texel_log2);
    const double p = std::ldexp(static_cast<double>(units), relief.samples_per_texel_log2 - kUnitsPerTexelLog2);
    return p >= extent ? std::ceil(extent) : p;
  };
  const double px = place(x, domain.width_px), py = place(y, domain.height_px);
  const int64_t i = std::min(static_cast<int64_t>(px), relief.width - 1),
                j = std::min(static_cast<int64_t>(py), relief.height - 1);
  const double fx = px - static_cast<double>(i), fy = py - static_cast<double>(j);
  auto q = [&](int64_t a, int64_t b) {
    return static_cast<double>(
        relief.samples[std::min(b, relief.height - 1) * relief.width + std::min(a, relief.width - 1)]);
  };
  const double q00 = q(i, j), q11 = q(i + 1, j + 1);
  double value = 0;
  if (fx >= fy) {
    const double q10 = q(i + 1, j);
    value = q00 + fx * (q10 - q00) + fy * (q11 - q10);
  } else {
    const double q01 = q(i, j + 1);
    value = q00 + fy * (q01 - q00) + fx * (q11 - q01);
  }
  return relief.offset_mm + value * relief.scale_mm;
}

// --- C. rasteriser

namespace {
uint8_t roundedByte(double v) { return static_cast<uint8_t>(std::floor(std::clamp(v, 0.0, 255.0) + 0.5)); }
}  // namespace

std::array<uint8_t, 3> DensePixel::bytes() const {
  return {roundedByte(rgb.x), roundedByte(rgb.y), roundedByte(rgb.z)};
}
size_t DenseImage::coveredPixels() const {
  return static_cast<size_t>(
      std::count_if(pixels.begin(), pixels.end(), [](const DensePixel& p) { return p.covered(); }));
}
size_t DenseImage::edgePixels() const {
  return static_cast<size_t>(
      std::count_if(pixels.begin(), pixels.end(), [](const DensePixel& p) { return p.edge != 0; }));
}
double DenseImage::edgeShare() const {
  size_t shown = 0;
  for (const DensePixel& p : pixels) shown += p.covered() || p.edge != 0;
  return shown == 0 ? 0.0 : static_cast<double>(edgePixels()) / static_cast<double>(shown);
}

namespace {

// value = at_origin + dx * x + dy * y, (x, y) in pixels, y downwards from the top left corner of the image.
struct Affine {
  double dx = 0, dy = 0, at_origin = 0;
  double operator()(double x, double y) const { return at_origin + dx * x + dy * y; }
};

// A triangle in the homogeneous form of Olano and Greer 1997: with M = (x, y, w) of its corners, b = M^-1 (x_ndc,
// y_ndc, 1) are the barycentric coordinates over w, affine on the screen. Their sum is 1/w. No clipping is needed for
// exact mappings.
struct Triangle {
  std::array<Affine, 3> b;
  Affine inv_w;         // sum of b
  Affine x_num, y_num;  // sum of b_i * (X_i - X_0)
  Affine depth;         // z/w
  double x0 = 0, y0 = 0;
  glm::dvec2 low{0}, high{0};  // extent on the screen, px
  double min_depth = -1;       // of the corners
  double height_px = 1e9;      // the smallest of its three heights on the screen
  int32_t id = -1;

  bool covers(double x, double y) const;
  glm::dvec2 texel(double x, double y) const {
    const double d = inv_w(x, y);
    return {x0 + x_num(x, y) / d, y0 + y_num(x, y) / d};
  }
  glm::dvec2 texelDx(double x, double y) const {
    const double d = inv_w(x, y);
    return {(x_num.dx - x_num(x, y) / d * inv_w.dx) / d, (y_num.dx - y_num(x, y) / d * inv_w.dx) / d};
  }
  glm::dvec2 texelDy(double x, double y) const {
    const double d = inv_w(x, y);
    return {(x_num.dy - x_num(x, y) / d * inv_w.dy) / d, (y_num.dy - y_num(x, y) / d * inv_w.dy) / d};
  }
};

struct Vertex {
  glm::dvec4 clip{0};
  double x = 0, y = 0;  // artwork texels
};

struct PixelBox {
  int x0 = 0, y0 = 0, x1 = -1, y1 = -1;  // inclusive
  bool empty() const { return x1 < x0 || y1 < y0; }
};

// The extent on the screen of the part of the triangle before the near plane. False: there is none.
bool screenExtent(const std::array<Vertex, 3>& v, int width, int height, Triangle& t) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  t.low = glm::dvec2(kInfinity);
  t.high = glm::dvec2(-kInfinity);
  std::array<glm::dvec2, 3> corner;
  auto onScreen = [&](const glm::dvec4& c) {
    return glm::dvec2((c.x / c.w * 0.5 + 0.5) * width, (0.5 - c.y / c.w * 0.5) * height);
  };
  auto add = [&](glm::dvec2 p) {
    t.low = glm::min(t.low, p);
    t.high = glm::max(t.high, p);
  };
  int before = 0;
  t.min_depth = 1;
  for (int i = 0; i < 3; ++i) {
    const glm::dvec4 &a = v[i].clip, &b = v[(i + 1) % 3].clip;
    const double da = a.z + a.w, db = b.z + b.w;
    if (da >= 0 && a.w > 0) {
      corner[i] = onScreen(a);
      add(corner[i]);
      t.min_depth = std::min(t.min_depth, a.z / a.w);
      ++before;
    }
    if ((da >= 0) != (db >= 0)) {
      const glm::dvec4 cut = a + (b - a) * (da / (da - db));
      t.min_depth = -1;
      if (cut.w > 0) {
        add(onScreen(cut));
      } else {
        t.low = glm::dvec2(-kInfinity);
        t.high = glm::dvec2(kInfinity);
      }
    }
  }
  if (before == 3) {
    const glm::dvec2 e0 = corner[1] - corner[0], e1 = corner[2] - corner[1], e2 = corner[0] - corner[2];
    const double longest = std::sqrt(std::max({glm::dot(e0, e0), glm::dot(e1, e1), glm::dot(e2, e2)}));
    t.height_px = std::abs(e0.x * e1.y - e0.y * e1.x) / std::max(longest, 1e-300);
  }
  return t.low.x <= t.high.x;
}

PixelBox pixelBox(const Triangle& t, int width, int height) {
  auto low = [](double p, int extent) {
    return static_cast<int>(std::clamp(std::floor(p - 0.6), 0.0, double(extent)));
  };
  auto high = [](double p, int extent) {
    return static_cast<int>(std::clamp(std::ceil(p - 0.4), -1.0, double(extent - 1)));
  };
  return {low(t.low.x, width), low(t.low.y, height), high(t.high.x, width), high(t.high.y, height)};
}

bool setUp(const std::array<Vertex, 3>& v, int width, int height, Triangle& t) {
  // Rows of M^-1 are cross products of M's columns (x_i, y_i, w_i) over its determinant.
  std::array<glm::dvec3, 3> p;
  for (int i = 0; i < 3; ++i) p[i] = {v[i].clip.x, v[i].clip.y, v[i].clip.w};
  const glm::dvec3 n0 = glm::cross(p[1], p[2]);
  const double det = glm::dot(p[0], n0);
  const double size = glm::length(p[0]) * glm::length(p[1]) * glm::length(p[2]);
  if (!(std::abs(det) > 1e-15 * size)) return false;  // seen edge on, or no area
  const std::array<glm::dvec3, 3> rows{n0 / det, glm::cross(p[2], p[0]) / det, glm::cross(p[0], p[1]) / det};
  t.inv_w = t.x_num = t.y_num = t.depth = {};
  t.x0 = v[0].x;
  t.y0 = v[0].y;
  auto accumulate = [](Affine& to, const Affine& from, double weight) {
    to.dx += from.dx * weight;
    to.dy += from.dy * weight;
    to.at_origin += from.at_origin * weight;
  };
  for (int i = 0; i < 3; ++i) {
    // x_ndc = 2 x / width - 1, y_ndc = 1 - 2 y / height
    t.b[i] = {rows[i].x * 2.0 / width, -rows[i].y * 2.0 / height, rows[i].z - rows[i].x + rows[i].y};
    accumulate(t.inv_w, t.b[i], 1.0);
    accumulate(t.x_num, t.b[i], v[i].x - v[0].x);
    accumulate(t.y_num, t.b[i], v[i].y - v[0].y);
    accumulate(t.depth, t.b[i], v[i].clip.z);
  }
  return true;
}

// A centre on an edge that two triangles share must not fall between them by rounding.
constexpr double kInsideTolerance = 1e-10;

bool Triangle::covers(double x, double y) const {
  const double b0 = b[0](x, y), b1 = b[1](x, y), b2 = b[2](x, y);
  const double tolerance = kInsideTolerance * (std::abs(b0) + std::abs(b1) + std::abs(b2));
  if (b0 < -tolerance || b1 < -tolerance || b2 < -tolerance || !(inv_w(x, y) > 0)) return false;
  const double z = depth(x, y);
  return z >= -1.0 && z <= 1.0;
}

// The nearest triangle that covers a pixel's whole box.
struct FullCover {
  double depth = std::numeric_limits<double>::infinity();
  int32_t triangle = -1;
};
// A triangle that touches a pixel's box or covers all of it.
struct Touch {
  int32_t pixel, triangle;
  friend bool operator<(const Touch& a, const Touch& b) {
    return a.pixel != b.pixel ? a.pixel < b.pixel : a.triangle < b.triangle;
  }
};

void rasterise(const Triangle& t, int32_t index, const PixelBox& box, int width, std::vector<FullCover>& full,
               std::vector<Touch>& touches, std::vector<Touch>& covers) {
  std::array<double, 3> margin;
  for (int k = 0; k < 3; ++k) margin[k] = (std::abs(t.b[k].dx) + std::abs(t.b[k].dy)) * kBoxPx;
  const double depth_margin = (std::abs(t.depth.dx) + std::abs(t.depth.dy)) * kBoxPx;
  for (int y = box.y0; y <= box.y1; ++y) {
    for (int x = box.x0; x <= box.x1; ++x) {
      const double cx = x + 0.5, cy = y + 0.5;
      const double b0 = t.b[0](cx, cy), b1 = t.b[1](cx, cy), b2 = t.b[2](cx, cy);
      const double tolerance = kInsideTolerance * (std::abs(b0) + std::abs(b1) + std::abs(b2));
      if (b0 < -margin[0] - tolerance || b1 < -margin[1] - tolerance || b2 < -margin[2] - tolerance) continue;
      if (cx + kBoxPx < t.low.x || cx - kBoxPx > t.high.x || cy + kBoxPx < t.low.y || cy - kBoxPx > t.high.y) continue;
      const double z = t.depth(cx, cy);
      if (z + depth_margin < -1.0 || z - depth_margin > 1.0) continue;
      FullCover& cover = full[static_cast<size_t>(y) * width + x];
      const bool covers_all =
          b0 >= margin[0] && b1 >= margin[1] && b2 >= margin[2] && z - depth_margin >= -1.0 && z + depth_margin <= 1.0;
      if (!covers_all) {
        touches.push_back({static_cast<int32_t>(y * width + x), index});
      } else {
        covers.push_back({static_cast<int32_t>(y * width + x), index});
        if (z < cover.depth) cover = {z, index};
      }
    }
  }
}

// What a pixel may show: the triangle at its centre (-1: background), and the others that snapping may put there or
// that lie too close behind.
struct Visible {
  int32_t centre = -1;
  bool background = false;  // somewhere in the box nothing is drawn
  std::vector<int32_t> others;
};

// touches: those that touch the box and do not cover it; covers: all that cover it, full the nearest of them.
Visible resolve(const std::vector<Triangle>& triangles, const FullCover& full, std::span<const Touch> touches,
                std::span<const Touch> covers, double cx, double cy) {
  Visible v;
  // Of those that cover the box, the ones whose distance behind the nearest falls to kDepthSlack somewhere in it.
  std::vector<int32_t> close;
  for (const Touch& cover : covers) {
    if (cover.triangle == full.triangle) continue;
    const Affine &near = triangles[full.triangle].depth, &far = triangles[cover.triangle].depth;
    const double least =
        far(cx, cy) - near(cx, cy) - (std::abs(far.dx - near.dx) + std::abs(far.dy - near.dy)) * kBoxPx;
    if (least <= kDepthSlack) close.push_back(cover.triangle);
  }
  if (touches.empty()) {
    v.centre = full.triangle;
    v.background = full.triangle < 0;
    v.others = std::move(close);
    return v;
  }
  // The farthest depth that is seen anywhere in the box: what lies behind it can't be drawn. By 5 x 5 samples.
  double farthest = -1;
  for (int sy = -2; sy <= 2; ++sy) {
    for (int sx = -2; sx <= 2; ++sx) {
      const double x = cx + sx * (kBoxPx / 2), y = cy + sy * (kBoxPx / 2);
      int32_t nearest = full.triangle;
      double depth = nearest >= 0 ? triangles[nearest].depth(x, y) : std::numeric_limits<double>::infinity();
      for (const Touch& touch : touches) {
        const Triangle& t = triangles[touch.triangle];
        if (t.depth(x, y) < depth && t.covers(x, y)) {
          nearest = touch.triangle;
          depth = t.depth(x, y);
        }
      }
      if (sx == 0 && sy == 0) v.centre = nearest;
      v.background = v.background || nearest < 0;
      farthest = std::max(farthest, depth);
    }
  }
  auto addIfSeen = [&](int32_t index) {
    if (index < 0 || index == v.centre) return;
    const Triangle& t = triangles[index];
    const double least = t.depth(cx, cy) - (std::abs(t.depth.dx) + std::abs(t.depth.dy)) * kBoxPx;
    if (std::max(least, t.min_depth) <= farthest + kDepthSlack) v.others.push_back(index);
  };
  addIfSeen(full.triangle);
  for (int32_t index : close) addIfSeen(index);
  for (const Touch& touch : touches) addIfSeen(touch.triangle);
  return v;
}

// Raw channels at a texel position of the finest level, on level k (0 coarsest): bilinear, or the texel there. Texel
// centres at +0.5, clamped.
void sampleLevel(const DenseTexture& t, int k, glm::dvec2 texel, const DenseView& view, double* out, int channels) {
  const DenseLevel& level = t.levels[k];
  const int shift = t.domain.texture_depth - k;
  const bool nearest = view.sampling == DenseSampling::kNearest;
  const double half = nearest ? 0.0 : 0.5;
  const double px = std::ldexp(texel.x, -shift) - half, py = std::ldexp(texel.y, -shift) - half;
  const double cell_x = std::floor(px), cell_y = std::floor(py);
  const double fx = nearest ? 0 : px - cell_x, fy = nearest ? 0 : py - cell_y;
  auto clampTo = [](double v, int64_t extent) {
    return static_cast<int64_t>(std::clamp(v, 0.0, static_cast<double>(extent - 1)));
  };
  const int64_t x0 = clampTo(cell_x, level.width), x1 = clampTo(cell_x + 1, level.width);
  const int64_t y0 = clampTo(cell_y, level.height), y1 = clampTo(cell_y + 1, level.height);
  const int raw_channels = t.format.channels();
  const std::array<const uint8_t*, 4> taps{level.texel(x0, y0, raw_channels), level.texel(x1, y0, raw_channels),
                                           level.texel(x0, y1, raw_channels), level.texel(x1, y1, raw_channels)};
  const std::array<double, 4> weights{(1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy};
  for (int c = 0; c < channels; ++c) out[c] = 0;
  for (int n = 0; n < 4; ++n) {
    if (view.resolved) {
      std::array<double, kMaxChannels> raw{};
      for (int c = 0; c < raw_channels; ++c) raw[c] = taps[n][c];
      const auto rgb = evaluatePixel(t.format, raw.data(), view.light);
      for (int c = 0; c < 3; ++c) out[c] += weights[n] * std::floor(rgb[c] + 0.5);
    } else {
      for (int c = 0; c < channels; ++c) out[c] += weights[n] * taps[n][c];
    }
  }
}

struct Tap {
  glm::dvec2 texel{0};
  double weight = 1;
};
// Where a pixel's channels come from: taps, each on the two levels around lambda. The weights add up to 1.
struct Taps {
  double lambda = 0;
  std::vector<Tap> taps;
};

Taps tapsOf(const DenseTexture& t, glm::dvec2 texel, glm::dvec2 dx, glm::dvec2 dy, const DenseView& view,
            double offset) {
  const double depth = t.domain.texture_depth;
  const double longer2 = std::max(glm::dot(dx, dx), glm::dot(dy, dy));
  auto level = [&](double size) {
    return std::clamp(size > 0 ? std::log2(size) + view.lod_bias + offset : 0.0, 0.0, depth);
  };
  if (view.sampling != DenseSampling::kAnisotropic || view.anisotropy == 1)
    return {level(std::sqrt(longer2)), {{texel, 1}}};
  // The derivatives J take the unit circle to the ellipse. Half the angle of the double-angle vector of J J^T is the
  // major axis' direction; the extents along it and across it are the singular values.
  const double xx = dx.x * dx.x + dy.x * dy.x, yy = dx.y * dx.y + dy.y * dy.y, xy = dx.x * dx.y + dy.x * dy.y;
  const double angle = 0.5 * std::atan2(2 * xy, xx - yy);
  const glm::dvec2 along{std::cos(angle), std::sin(angle)}, across{-along.y, along.x};
  const double major = std::hypot(glm::dot(dx, along), glm::dot(dy, along));
  const double minor = std::hypot(glm::dot(dx, across), glm::dot(dy, across));
  const int n = view.anisotropy;
  const double wanted = std::max(minor, major / n);
  const double size = std::max(wanted * std::exp2(view.lod_bias + offset), 1.0);
  const double ratio = std::clamp(major / size, 1.0, static_cast<double>(n));
  Taps out{level(wanted), {}};
  auto add = [&](double place, double weight) {
    if (!(weight > 0)) return;
    const glm::dvec2 at = texel + along * (place * size);
    out.taps.push_back({{std::clamp(at.x, 0.0, static_cast<double>(t.domain.width_px)),
                         std::clamp(at.y, 0.0, static_cast<double>(t.domain.height_px))},
                        weight / ratio});
  };
  if (n % 2 == 0 && ratio <= 2) {
    add(-0.5 * (ratio - 1), 0.5 * ratio);
    add(0.5 * (ratio - 1), 0.5 * ratio);
    return out;
  }
  for (double place = -0.5 * (n - 1); place <= 0.5 * (n - 1); ++place) {
    const double low = std::max(place - 0.5, -0.5 * ratio), high = std::min(place + 0.5, 0.5 * ratio);
    add(place, high - low);
  }
  return out;
}

glm::dvec3 shadeTaps(const DenseTexture& t, const Taps& from, const DenseView& view, const glm::dvec3& place_mm) {
  const int channels = view.resolved ? 3 : t.format.channels();
  const int depth = t.domain.texture_depth;
  const double lambda = std::clamp(from.lambda, 0.0, static_cast<double>(depth));
  const bool one_level = view.sampling == DenseSampling::kNearest || view.sampling == DenseSampling::kBilinear;
  const int finer = std::min(depth, static_cast<int>(std::floor(one_level ? lambda + 0.5 : lambda)));
  const double coarser_share = one_level ? 0 : lambda - finer;
  std::array<double, kMaxChannels> sum{}, a{}, b{};
  for (const Tap& tap : from.taps) {
    sampleLevel(t, depth - finer, tap.texel, view, a.data(), channels);
    if (coarser_share > 0) sampleLevel(t, depth - finer - 1, tap.texel, view, b.data(), channels);
    for (int c = 0; c < channels; ++c) sum[c] += tap.weight * (a[c] * (1 - coarser_share) + b[c] * coarser_share);
  }
  glm::dvec3 rgb{sum[0], sum[1], sum[2]};
  if (view.lit) {
    rgb = view.lit(t.format, sum.data(), place_mm) * 255.0;
  } else if (!view.resolved) {
    const auto e = evaluateUnclamped(t.format, sum.data(), view.light);
    rgb = {e[0], e[1], e[2]};
  }
  if (view.tone) rgb = view.tone(rgb / 255.0) * 255.0;
  return glm::clamp(rgb, 0.0, 255.0);
}

struct Mapping {
  glm::dvec2 texel, dx, dy;
};
// The triangle's mapping at the centre of pixel (x, y), whether or not the triangle covers it.
Mapping mappingAt(const Triangle& t, int x, int y, const DenseView& view) {
  const double cx = x + 0.5, cy = y + 0.5;
  Mapping m{t.texel(cx, cy), {}, {}};
  if (view.derivatives == DenseDerivatives::kExact) {
    m.dx = t.texelDx(cx, cy);
    m.dy = t.texelDy(cx, cy);
    return m;
  }
  // Quads are aligned to GL's origin, the bottom left corner.
  const double left = (x & ~1) + 0.5;
  const int up = view.height_px - 1 - y;
  const double bottom = view.height_px - 1 - (up & ~1) + 0.5;
  m.dx = t.texel(left + 1, cy) - t.texel(left, cy);
  m.dy = t.texel(cx, bottom) - t.texel(cx, bottom - 1);
  return m;
}

bool coloursDiffer(glm::dvec3 a, glm::dvec3 b) {
  return std::abs(a.x - b.x) > 0.5 || std::abs(a.y - b.y) > 0.5 || std::abs(a.z - b.z) > 0.5;
}

}  // namespace

glm::dvec3 shadeDense(const DenseTexture& texture, glm::dvec2 texel, double lambda, const DenseView& view,
                      const glm::dvec3& place_mm) {
  return shadeTaps(texture, {lambda, {{texel, 1}}}, view, place_mm);
}
glm::dvec3 shadeDense(const DenseTexture& texture, glm::dvec2 texel, glm::dvec2 dx, glm::dvec2 dy,
                      const DenseView& view, double lambda_offset, const glm::dvec3& place_mm) {
  return shadeTaps(texture, tapsOf(texture, texel, dx, dy, view, lambda_offset), view, place_mm);
}

DenseImage renderDense(const DenseTexture& texture, const DenseRelief* relief, std::span<const PatchInstance> instances,
                       const DenseView& view) {
  const FlatDomain& domain = texture.domain;
  const int width = view.width_px, height = view.height_px;
  const int64_t last_x = static_cast<int64_t>(domain.width_px) << kUnitsPerTexelLog2;
  const int64_t last_y = static_cast<int64_t>(domain.height_px) << kUnitsPerTexelLog2;
  assert(instances.size() < (size_t{1} << 20));

  std::vector<FullCover> full(static_cast<size_t>(width) * height);
  std::vector<Touch> touches, covers;
  std::vector<Triangle> triangles;
  std::vector<Vertex> grid;
  for (size_t n = 0; n < instances.size(); ++n) {
    const PatchInstance& p = instances[n];
    const uint32_t cells = 1u << p.grid_level, side = cells + 1;
    grid.resize(static_cast<size_t>(side) * side);
    for (uint32_t j = 0; j < side; ++j) {
      for (uint32_t i = 0; i < side; ++i) {
        const auto snapped = snapVertex(i, j, p);
        const int64_t x = p.x0 + (static_cast<int64_t>(snapped[0]) << p.step_log2);
        const int64_t y = p.y0 + (static_cast<int64_t>(snapped[1]) << p.step_log2);
        Vertex& v = grid[static_cast<size_t>(j) * side + i];
        v.x = std::ldexp(static_cast<double>(std::min(x, last_x)), -kUnitsPerTexelLog2);
        v.y = std::ldexp(static_cast<double>(std::min(y, last_y)), -kUnitsPerTexelLog2);
        const double height_mm = relief != nullptr ? denseHeightMm(*relief, domain, x, y) : 0.0;
        v.clip =
            view.clip_from_world * glm::dvec4((v.x - 0.5 * static_cast<double>(domain.width_px)) * domain.mm_per_px,
                                              (0.5 * static_cast<double>(domain.height_px) - v.y) * domain.mm_per_px,
                                              height_mm * view.exaggerate, 1.0);
      }
    }
    for (uint32_t j = 0; j < cells; ++j) {
      for (uint32_t i = 0; i < cells; ++i) {
        const Vertex &v00 = grid[j * side + i], &v10 = grid[j * side + i + 1];
        const Vertex &v01 = grid[(j + 1) * side + i], &v11 = grid[(j + 1) * side + i + 1];
        for (int half = 0; half < 2; ++half) {
          const std::array<Vertex, 3> corners = half == 0 ? std::array{v00, v10, v11} : std::array{v00, v11, v01};
          // Cells beyond the border and snapped away: the same integers gave the same bits. (Where the border's own
          // edge is coarser than the grid, upright slivers between the two remain and are drawn.)
          if (corners[0].clip == corners[1].clip || corners[1].clip == corners[2].clip ||
              corners[2].clip == corners[0].clip)
            continue;
          Triangle t;
          if (!screenExtent(corners, width, height, t)) continue;
          const PixelBox box = pixelBox(t, width, height);
          if (box.empty() || !setUp(corners, width, height, t)) continue;
          t.id = static_cast<int32_t>(n << 11 | (j * cells + i) << 1 | static_cast<uint32_t>(half));
          rasterise(t, static_cast<int32_t>(triangles.size()), box, width, full, touches, covers);
          triangles.push_back(t);
        }
      }
    }
  }

  std::sort(touches.begin(), touches.end());
  std::sort(covers.begin(), covers.end());

  const glm::dmat4 world_from_clip = glm::inverse(view.clip_from_world);
  DenseImage image{width, height, std::vector<DensePixel>(static_cast<size_t>(width) * height)};
  auto touch = touches.begin(), cover = covers.begin();
  for (int32_t index = 0; index < width * height; ++index) {
    const int x = index % width, y = index / width;
    const auto first_touch = touch, first_cover = cover;
    while (touch != touches.end() && touch->pixel == index) ++touch;
    while (cover != covers.end() && cover->pixel == index) ++cover;
    const Visible visible =
        resolve(triangles, full[index], {first_touch, touch}, {first_cover, cover}, x + 0.5, y + 0.5);
    DensePixel& pixel = image.pixels[index];
    if (visible.centre < 0) {
      if (!visible.others.empty()) pixel.edge |= kEdgeSilhouette;
      continue;
    }
    const Triangle& centre = triangles[visible.centre];
    const Mapping m = mappingAt(centre, x, y, view);
    pixel.triangle = centre.id;
    pixel.depth = centre.depth(x + 0.5, y + 0.5);
    pixel.texel = m.texel;
    pixel.texel_dx = m.dx;
    pixel.texel_dy = m.dy;
    const Taps taps = tapsOf(texture, m.texel, m.dx, m.dy, view, 0);
    pixel.lambda = taps.lambda;
    glm::dvec3 place(0);
    if (view.lit) {
      const glm::dvec4 p =
          world_from_clip * glm::dvec4((x + 0.5) / width * 2 - 1, 1 - (y + 0.5) / height * 2, pixel.depth, 1);
      place = glm::dvec3(p) / p.w;
    }
    pixel.rgb = pixel.low = pixel.high = shadeTaps(texture, taps, view, place);
    if (visible.background) pixel.edge |= kEdgeSilhouette;

    auto mayAlsoBe = [&](glm::dvec3 rgb, EdgeReason reason) {
      if (!coloursDiffer(pixel.rgb, rgb)) return;
      pixel.edge |= reason;
      pixel.low = glm::min(pixel.low, rgb);
      pixel.high = glm::max(pixel.high, rgb);
    };
    // Everything that a triangle of this height may show here, once its corners are snapped.
    auto mayShow = [&](const Triangle& t, const Mapping& at) {
      const double off = t.height_px > kSnapPx ? -std::log2(1 - kSnapPx / t.height_px) : 1e9;
      const double own = tapsOf(texture, at.texel, at.dx, at.dy, view, 0).lambda;
      const double depth = domain.texture_depth;
      const double lowest = std::max(own - off, 0.0), highest = std::min(own + off, depth);
      const EdgeReason reason = &t == &centre ? kEdgeThin : kEdgeColour;
      auto shadeAt = [&](double lambda) {
        mayAlsoBe(shadeDense(texture, at.texel, at.dx, at.dy, view, lambda - own, place), reason);
      };
      shadeAt(lowest);
      shadeAt(highest);
      for (double level = std::floor(lowest) + 1; level < highest; ++level) shadeAt(level);
    };
    if (centre.height_px < 4) mayShow(centre, m);  // of a taller one lambda is off by less than 0.002

    const double footprint = std::sqrt(std::max(glm::dot(m.dx, m.dx), glm::dot(m.dy, m.dy)));
    for (int32_t other : visible.others) {
      const Mapping o = mappingAt(triangles[other], x, y, view);
      if (glm::length(o.texel - m.texel) > 0.5 * footprint) {
        pixel.edge |= kEdgeOcclusion;
        continue;
      }
      mayShow(triangles[other], o);
    }
    if (view.sampling == DenseSampling::kNearest || view.sampling == DenseSampling::kBilinear) {
      constexpr double kTie = 1.0 / 256.0;
      const double from_change = pixel.lambda + 0.5 - std::floor(pixel.lambda + 0.5);
      const double nudge = from_change < kTie ? -2 * kTie : from_change > 1 - kTie ? 2 * kTie : 0.0;
      if (nudge != 0) mayAlsoBe(shadeDense(texture, m.texel, pixel.lambda + nudge, view, place), kEdgeLevelTie);
    }
    if (view.snapped_px > 0) {
      if (view.sampling == DenseSampling::kAnisotropic && centre.height_px < 16 * view.snapped_px)
        pixel.edge |= kEdgeOcclusion;
      for (int k = 0; k < 25; ++k) {  // five by five, as the colour need not be largest at a corner of the square
        const double x_px = (k % 5 - 2) * 0.5 * view.snapped_px, y_px = (k / 5 - 2) * 0.5 * view.snapped_px;
        mayAlsoBe(shadeDense(texture, m.texel + m.dx * x_px + m.dy * y_px, m.dx, m.dy, view, 0, place), kEdgePlace);
      }
    }
    if (view.sampling == DenseSampling::kNearest) {
      for (int corner = 0; corner < 9; ++corner) {
        const double x_px = (corner % 3 - 1) * kTexelTiePx, y_px = (corner / 3 - 1) * kTexelTiePx;
        mayAlsoBe(shadeDense(texture, m.texel + m.dx * x_px + m.dy * y_px, pixel.lambda, view, place), kEdgeTexelTie);
      }
    }
  }
  return image;
}

std::vector<PatchInstance> uniformInstances(const FlatDomain& domain, int level, int grid_level) {
  std::vector<PatchInstance> out;
  const int node_units_log2 = std::bit_width(domain.patchPx()) - 1 + kUnitsPerTexelLog2 - level;
  assert(node_units_log2 >= grid_level);
  for (uint32_t patch = 0; patch < domain.patchCount(); ++patch) {
    for (uint32_t y = 0; y < 1u << level; ++y) {
      for (uint32_t x = 0; x < 1u << level; ++x) {
        const NodeId node{patch, static_cast<uint32_t>(level), x, y};
        if (!domain.nodeExists(node)) continue;
        PatchInstance p;
        p.node = node;
        p.x0 =
            static_cast<int32_t>((domain.patchOriginX(patch) << kUnitsPerTexelLog2) + (uint64_t{x} << node_units_log2));
        p.y0 =
            static_cast<int32_t>((domain.patchOriginY(patch) << kUnitsPerTexelLog2) + (uint64_t{y} << node_units_log2));
        p.grid_level = static_cast<uint8_t>(grid_level);
        p.step_log2 = static_cast<uint8_t>(node_units_log2 - grid_level);
        for (auto& side : p.edges) side = {static_cast<uint8_t>(grid_level), PatchInstance::kWholeEdge};
        p.relief_page = node.ancestor(static_cast<uint32_t>(std::clamp(level, 0, std::max(0, domain.relief_depth))));
        out.push_back(p);
      }
    }
  }
  return out;
}

// --- D. comparison

ImageDifference compareImages(const DenseImage& reference, std::span<const uint8_t> rgba, bool bottom_up) {
  assert(rgba.size() >= size_t(reference.width) * reference.height * 4);
  ImageDifference d;
  std::vector<double> per_pixel;
  double worst = -1;
  for (int y = 0; y < reference.height; ++y) {
    const int row = bottom_up ? reference.height - 1 - y : y;
    for (int x = 0; x < reference.width; ++x) {
      const DensePixel& expected = reference.at(x, y);
      const uint8_t* found = &rgba[(static_cast<size_t>(row) * reference.width + x) * 4];
      auto note = [&](double badness, int channel) {
        if (badness <= worst) return;
        worst = badness;
        d.worst = {x, y, channel, expected.rgb, {found[0], found[1], found[2], found[3]}};
      };
      const bool silhouette = (expected.edge & kEdgeSilhouette) != 0;
      if (!silhouette && expected.covered() && found[3] == 0) {
        ++d.holes;
        note(2000, 3);
        continue;
      }
      if (!silhouette && !expected.covered() && found[3] != 0) {
        ++d.extras;
        note(1000, 3);
        continue;
      }
      if ((expected.edge & (kEdgeSilhouette | kEdgeOcclusion)) != 0) {
        ++d.edge_pixels;
        continue;
      }
      if (!expected.covered()) continue;
      ++d.compared;
      d.compared_to_range += expected.edge != 0;
      int byte_max = 0;
      double exact_max = 0;
      for (int c = 0; c < 3; ++c) {
        const double nearest = std::clamp(double(found[c]), expected.low[c], expected.high[c]);
        const double exact = std::abs(nearest - found[c]);
        const int byte_difference = std::abs(int{roundedByte(nearest)} - int{found[c]});
        d.max_difference[c] = std::max(d.max_difference[c], byte_difference);
        byte_max = std::max(byte_max, byte_difference);
        exact_max = std::max(exact_max, exact);
        note(exact, c);
      }
      d.count_above_1 += byte_max > 1;
      d.max_exact = std::max(d.max_exact, exact_max);
      per_pixel.push_back(exact_max);
    }
  }
  if (!per_pixel.empty()) {
    auto at = per_pixel.begin() + static_cast<ptrdiff_t>((per_pixel.size() - 1) * 999 / 1000);
    std::nth_element(per_pixel.begin(), at, per_pixel.end());
    d.percentile_999 = *at;
  }
  return d;
}

std::string ImageDifference::text() const {
  char line[400];
  std::snprintf(line, sizeof line,
                "max %d %d %d (exact %.3f, 99.9%% %.3f), %zu above 1, %zu holes, %zu extras, %zu compared (%zu to a "
                "range), %zu edge; worst at "
                "(%d, %d) channel %d: expected %.3f %.3f %.3f, found %d %d %d alpha %d",
                max_difference[0], max_difference[1], max_difference[2], max_exact, percentile_999, count_above_1,
                holes, extras, compared, compared_to_range, edge_pixels, worst.x, worst.y, worst.channel,
                worst.expected.x, worst.expected.y, worst.expected.z, worst.found[0], worst.found[1], worst.found[2],
                worst.found[3]);
  return line;
}

}  // namespace relievo
