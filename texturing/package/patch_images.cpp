#include "texturing/package/patch_images.h"

#include <zstd.h>

#include <algorithm>
#include <bit>
#include <cassert>
#include <cmath>
#include <cstring>
#include <memory>
#include <string>

#include "src/artwork/basis.h"
#include "src/base/parallel_for.h"
#include "texturing/codec/mip.h"
#include "texturing/codec/page_codec.h"
#include "texturing/package/image_fill.h"
#include "texturing/package/package_layout.h"
#include "texturing/package/patch_tails.h"

namespace relievo {
namespace {

constexpr int kZstdLevel = 19;
constexpr uint8_t kRepeats = 1, kIsJpeg = 2, kFill = 4, kIsNormals = 8, kDownwards = 16;  // of an image
constexpr uint8_t kInTail = 255;  // where others have the number of their levels
constexpr int kPlaceLog2 = 8;     // PatchImage::at counts 256ths of texels
constexpr size_t kImageHeadBytes = 9, kTileBytes = 12, kPatchBytes = 1, kHalvesBytes = 2 * 2, kByPlaneBytes = 2;
constexpr size_t kPlacesBytes = 3 * 8, kNormalsBytes = 3 * 3, kColoursBytes = 3 * 3;  // of a half

// n: below 2^32; most v are within.
int64_t modulo(int64_t v, int64_t n) {
  if (v >= 0 && v < n) return v;
  const int64_t rest = v % n;
  return rest < 0 ? rest + n : rest;
}

// n: above 0.
int64_t floorOf(int64_t v, int64_t n) { return (v - modulo(v, n)) / n; }

// Corner of the base mesh behind PatchImage::at[half][k].
uint32_t cornerAt(const std::array<uint32_t, 4>& patch, size_t half, size_t k) {
  return patch[k == 0 ? 0 : k == 2 ? 3 : half == 0 ? 1 : 2];
}

glm::u8vec3 normalBytes(const glm::dvec3& normal) {
  glm::u8vec3 out;
  for (int axis = 0; axis < 3; ++axis)
    out[axis] = static_cast<uint8_t>(std::clamp(std::floor(127.5 * normal[axis] + 128), 0.0, 255.0));
  return out;
}

// That of a half's plane, outwards; of none that of its first corner.
glm::dvec3 planeNormal(const BaseMesh& base, uint32_t patch, size_t half) {
  std::array<glm::dvec3, 3> at;
  for (size_t k = 0; k < 3; ++k) at[k] = base.corners[cornerAt(base.patches[patch], half, k)].position_mm;
  const glm::dvec3 first = at[1] - at[0], second = at[2] - at[1],
                   across = half == 0 ? glm::cross(second, first) : glm::cross(first, second);
  const double length = std::sqrt(across.x * across.x + across.y * across.y + across.z * across.z);
  return length > 0 ? across / length : glm::dvec3(base.corners[base.patches[patch][0]].normal);
}

// Places, colours and normals are predicted: by what the last half before has at this corner of the base mesh, places
// only if it shows the same image, colours only if it has any; else by the last place before in that image, at first 0,
// the last colour before, at first 0, and the last normal before, at first 0. From version 17 on normals by the
// corner's own instead of the last one; or all of a half by its plane.
class CornerPredictor {
 public:
  using Normals = std::array<glm::u8vec3, 3>;
  CornerPredictor(const BaseMesh& base, size_t images, bool by_base)
      : base_(base), by_base_(by_base), of_corner_(base.corners.size()), last_(images, glm::ivec2(0)) {
    for (size_t c = 0; by_base && c < of_corner_.size(); ++c)
      of_corner_[c].normal = normalBytes(base.corners[c].normal);
  }
  // Use: place(expected, there), colour(...) and normal(...) are told what is predicted and answer with what is there.
  // byPlane(by corners, by plane, there): whether it is the plane that says what is expected.
  // Patch: PatchImage, const where what is there is used only.
  template <class Patch, class Use>
  void run(std::span<Patch> patches, Use&& use) {
    for (uint32_t p = 0; p < patches.size(); ++p)
      for (size_t half = 0; patches[p].shows() && half < 2; ++half) runHalf(p, half, patches[p], use);
  }

 private:
  struct Known {
    int32_t image = -1;
    glm::ivec2 at{0};
    glm::u8vec3 normal{0}, colour{0};
  };
  template <class T>
  static const T& set(T& there, const T& found) {
    return there = found;
  }
  template <class T>
  static const T& set(const T& there, const T&) {
    return there;
  }
  template <class Patch, class Use>
  void runHalf(uint32_t p, size_t half, Patch& patch, Use&& use) {
    Normals by_corners{}, of_plane{};
    if (by_base_) {
      for (size_t k = 0; k < 3; ++k) by_corners[k] = of_corner_[cornerAt(base_.patches[p], half, k)].normal;
      of_plane.fill(normalBytes(planeNormal(base_, p, half)));
    }
    const bool plane = by_base_ && use.byPlane(by_corners, of_plane, patch.normal[half]);
    for (size_t k = 0; k < 3; ++k) {
      Known& known = of_corner_[cornerAt(base_.patches[p], half, k)];
      const bool is_known = known.image == patch.image[half];
      if (patch.hasColours(half)) {
        auto& colour = patch.colour[half][k];
        known.colour = last_colour_ = set(colour, use.colour(is_known ? known.colour : last_colour_, colour));
      } else {
        glm::ivec2& last = last_[patch.image[half]];
        auto& at = patch.at[half][k];
        known.at = last = set(at, use.place(is_known ? known.at : last, at));
      }
      const glm::u8vec3 expected = plane ? of_plane[k] : by_base_ || known.image >= 0 ? known.normal : last_normal_;
      auto& normal = patch.normal[half][k];
      known.normal = last_normal_ = set(normal, use.normal(expected, normal));
      known.image = patch.image[half];
    }
  }
  const BaseMesh& base_;
  bool by_base_;
  std::vector<Known> of_corner_;
  glm::u8vec3 last_normal_{0}, last_colour_{0};
  std::vector<glm::ivec2> last_;  // by image
};

// How far normals are off, as bytes have it.
int offBy(const CornerPredictor::Normals& expected, const CornerPredictor::Normals& there) {
  int sum = 0;
  for (size_t k = 0; k < 3; ++k)
    for (int axis = 0; axis < 3; ++axis)
      sum += std::abs(static_cast<int8_t>(static_cast<uint8_t>(there[k][axis] - expected[k][axis])));
  return sum;
}

uint32_t folded(int32_t v) { return (static_cast<uint32_t>(v) << 1) ^ static_cast<uint32_t>(v >> 31); }
int32_t unfolded(uint32_t v) { return static_cast<int32_t>(v >> 1) ^ -static_cast<int32_t>(v & 1); }
// Modulo 2^32.
int32_t plus(int32_t a, int32_t b) { return static_cast<int32_t>(static_cast<uint32_t>(a) + static_cast<uint32_t>(b)); }
int32_t minus(int32_t a, int32_t b) {
  return static_cast<int32_t>(static_cast<uint32_t>(a) - static_cast<uint32_t>(b));
}

Error damaged(const std::string& what) {
  return {ErrorKind::kInvalidData,
          "",
          "the images that patches show are damaged: " + what,
          "rebuild the package, or get a whole copy",
          {}};
}

}  // namespace

std::array<glm::ivec2, 3> placesIn(const glm::ivec2& size, const glm::ivec2& place_size,
                                   const std::array<glm::ivec2, 3>& at) {
  if (size == place_size) return at;
  std::array<glm::ivec2, 3> out;
  for (size_t k = 0; k < 3; ++k)
    for (int axis = 0; axis < 2; ++axis)
      out[k][axis] = static_cast<int>(floorOf(int64_t{at[k][axis]} * size[axis], place_size[axis]));
  return out;
}

ShownImage::ShownImage(const SourceImage& image, const glm::ivec2& place_size)
    : ShownImage(image, place_size, withRoom(image.rgb)) {}

ShownImage::ShownImage(const SourceImage& image, const glm::ivec2& place_size, std::vector<uint8_t> rgb)
    : width_(image.width), height_(image.height), place_size_(place_size), repeats_(image.repeats) {
  const MipFilter mip = image.is_normals ? MipFilter::ofNumbers(3) : MipFilter(TextureFormat{.basis = Basis::kColour});
  rgb.push_back(0);
  levels_.push_back({width_, height_, std::move(rgb)});
  const std::span<const uint8_t> finest = texels();
  std::vector<uint16_t> fine, coarse;  // channel after channel
  // from(channel, texel): of the level so far.
  auto halve = [&](auto from) {
    constexpr int64_t kRowsAJob = 32;
    using Texel = decltype(from(0, 0));
    const int64_t width = levels_.back().width, height = levels_.back().height;
    Level level{(width + 1) / 2, (height + 1) / 2, {}};
    const auto texels = static_cast<size_t>(level.width * level.height);
    coarse.resize(3 * texels);
    level.rgb.resize(3 * texels + 1);
    parallelFor(static_cast<size_t>((level.height + kRowsAJob - 1) / kRowsAJob), 0, nullptr, [&](size_t job) {
      const int64_t first = static_cast<int64_t>(job) * kRowsAJob, rows = std::min(kRowsAJob, level.height - first),
                    even_width = 2 * level.width;
      std::vector<Texel> even;  // the last row and column are repeated
      even.reserve(static_cast<size_t>(3 * even_width * 2 * rows));
      for (int64_t c = 0; c < 3; ++c)
        for (int64_t y = 2 * first; y < 2 * (first + rows); ++y)
          for (int64_t x = 0; x < even_width; ++x)
            even.push_back(from(c, std::min(y, height - 1) * width + std::min(x, width - 1)));
      const auto count = static_cast<size_t>(rows * level.width), begin = static_cast<size_t>(first * level.width);
      std::vector<uint16_t> halved(3 * count);
      mip.downsample(even.data(), static_cast<int>(even_width), static_cast<int>(2 * rows), halved.data());
      for (size_t c = 0; c < 3; ++c)
        for (size_t i = 0; i < count; ++i) {
          coarse[c * texels + begin + i] = halved[c * count + i];
          level.rgb[3 * (begin + i) + c] = byteFromLevel(halved[c * count + i]);
        }
    });
    levels_.push_back(std::move(level));
    fine.swap(coarse);
  };
  while (levels_.back().width > 1 || levels_.back().height > 1) {
    const Level& last = levels_.back();
    const int64_t texels = last.width * last.height;
    if (fine.empty()) halve([&](int64_t c, int64_t texel) { return finest[static_cast<size_t>(3 * texel + c)]; });
    else halve([&](int64_t c, int64_t texel) { return fine[static_cast<size_t>(c * texels + texel)]; });
  }
}

std::vector<uint8_t> ShownImage::withRoom(std::span<const uint8_t> rgb) {
  std::vector<uint8_t> out;
  out.reserve(rgb.size() + 1);
  out.assign(rgb.begin(), rgb.end());
  return out;
}

std::span<const uint8_t> ShownImage::texels() const {
  return std::span(levels_[0].rgb).first(levels_[0].rgb.size() - 1);
}

std::array<glm::ivec2, 3> ShownImage::placesOf(const PatchImage& patch, size_t half) const {
  return placesIn({width_, height_}, place_size_, patch.at[half]);
}

ShownImage::Repetition ShownImage::repetitionOf(const std::array<glm::ivec2, 3>& places) const {
  constexpr int64_t kHalfTexel = int64_t{1} << (kPlaceLog2 - 1);
  Repetition out;
  if (!repeats_) return out;
  for (int axis = 0; axis < 2; ++axis) {
    const auto i = static_cast<size_t>(axis);
    const int64_t extent = (axis == 0 ? width_ : height_) << kPlaceLog2;
    const auto [low, high] = std::minmax({places[0][axis], places[1][axis], places[2][axis]});
    const int64_t begin = low + kHalfTexel;
    out.from[i] = begin - modulo(begin, extent);
    out.repeats[i] = high > out.from[i] + extent + kHalfTexel;
  }
  return out;
}

std::array<uint8_t, 3> ShownImage::sample(int64_t x, int64_t y, int level, const Repetition& repetition) const {
  std::array<uint8_t, 3> out;
  sampleLine({.from = {x, y}, .count = 1}, level, repetition, {&out[0], &out[1], &out[2]});
  return out;
}

void ShownImage::sampleLine(const Line& line, int level, const Repetition& repetition,
                            const std::array<uint8_t*, 3>& out) const {
  if (levels_.size() == 1) {  // of one texel
    for (size_t c = 0; c < 3; ++c) std::fill_n(out[c], line.count, levels_[0].rgb[c]);
    return;
  }
  const auto k = std::min(static_cast<size_t>(level), levels_.size() - 1);
  const Level& l = levels_[k];
  constexpr int64_t kWhole = int64_t{1} << kPlaceLog2;
  struct Axis {
    bool repeats;
    int64_t from, extent, last;  // from and extent in 256ths of a texel
  };
  auto axisOf = [&](size_t i, int64_t extent, int64_t of_level) {
    return Axis{repetition.repeats[i], line.from[i] - repetition.from[i], extent << kPlaceLog2, of_level - 1};
  };
  const std::array<Axis, 2> axes{axisOf(0, width_, l.width), axisOf(1, height_, l.height)};
  struct Between {
    int64_t low, high;
    uint64_t to_high;
  };
  auto between = [k](const Axis& axis, int64_t moved) {
    int64_t at = axis.from + moved;
    if (axis.repeats) at = modulo(at, axis.extent);
    const int64_t middle = (at >> k) - kWhole / 2, low = middle >> kPlaceLog2;
    const auto to_high = static_cast<uint64_t>(middle & (kWhole - 1));
    // One that repeats lies within the image.
    if (axis.repeats) return Between{low < 0 ? axis.last : low, low >= axis.last ? 0 : low + 1, to_high};
    return Between{std::clamp<int64_t>(low, 0, axis.last), std::clamp<int64_t>(low + 1, 0, axis.last), to_high};
  };
  // Red and blue of a texel lie 32 bits apart, so that one product weighs both: sums have 24 bits.
  auto redBlue = [](uint32_t texel) { return uint64_t{texel & 0xFFu} | uint64_t{texel & 0xFF0000u} << 16; };
  auto green = [](uint32_t texel) { return uint64_t{texel >> 8 & 0xFFu}; };
  std::array<int64_t, 2> at = line.begin;
  for (size_t i = 0; i < line.count; ++i) {
    const Between u = between(axes[0], at[0] >> line.shift), v = between(axes[1], at[1] >> line.shift);
    const uint8_t *above = l.rgb.data() + 3 * v.low * l.width, *below = l.rgb.data() + 3 * v.high * l.width;
    const std::array<uint32_t, 4> texels{
        loadLittle<uint32_t>(above + 3 * u.low), loadLittle<uint32_t>(above + 3 * u.high),
        loadLittle<uint32_t>(below + 3 * u.low), loadLittle<uint32_t>(below + 3 * u.high)};
    constexpr uint64_t kUnit = kWhole;
    const std::array<uint64_t, 4> weights{(kUnit - u.to_high) * (kUnit - v.to_high), u.to_high * (kUnit - v.to_high),
                                          (kUnit - u.to_high) * v.to_high, u.to_high * v.to_high};
    constexpr uint64_t kHalf = kUnit * kUnit / 2;
    uint64_t red_blue = kHalf | kHalf << 32, of_green = kHalf;
    for (size_t n = 0; n < 4; ++n) {
      red_blue += weights[n] * redBlue(texels[n]);
      of_green += weights[n] * green(texels[n]);
    }
    out[0][i] = static_cast<uint8_t>(red_blue >> (2 * kPlaceLog2));
    out[1][i] = static_cast<uint8_t>(of_green >> (2 * kPlaceLog2));
    out[2][i] = static_cast<uint8_t>(red_blue >> (2 * kPlaceLog2 + 32));
    for (size_t axis = 0; axis < 2; ++axis) at[axis] += line.step[axis];
  }
}

int shownLevel(const std::array<glm::ivec2, 3>& at, int side_log2) {
  uint64_t longest = 0;  // squared, of a patch's side, in 256ths of a texel
  for (const auto& [from, to] : {std::pair{0, 1}, {1, 2}}) {
    const int64_t x = int64_t{at[to].x} - at[from].x, y = int64_t{at[to].y} - at[from].y;
    longest = std::max(longest, static_cast<uint64_t>(x * x) + static_cast<uint64_t>(y * y));
  }
  // (3/2)^2 (256 2^side_log2)^2 at level 0.
  int level = 0;
  for (int bits = 2 * (kPlaceLog2 - 1 + side_log2); bits < 60 && longest > uint64_t{9} << bits; bits += 2) ++level;
  return level;
}

namespace {

// Calls use(first, count, half, along, across) for each row's texels of a half, which lie side by side, the first one
// at texel `first`: twice its distance, in texels, from the half's corner (0,0) towards its next one, and from there
// towards (1,1). Of the texels after it the one along u grows by 2: `along` in half 0, `across` in half 1.
template <class Use>
void forEachLine(const ShownTexels& which, Use&& use) {
  for (size_t j = 0; j < which.count; ++j) {
    const int64_t y = which.y0 + static_cast<int64_t>(j), u = 2 * which.x0 + 1, v = 2 * y + 1;
    const auto split = static_cast<size_t>(std::clamp<int64_t>(y - which.x0, 0, static_cast<int64_t>(which.count)));
    if (split > 0) use(j * which.count, split, size_t{1}, v, u);
    if (split < which.count)
      use(j * which.count + split, which.count - split, size_t{0}, u + 2 * static_cast<int64_t>(split), v);
  }
}

// Where the texels of a half's part of a row lie in an image. along, across: as forEachLine() has them.
ShownImage::Line lineIn(const std::array<glm::ivec2, 3>& places, size_t half, int side_log2, int64_t along,
                        int64_t across, size_t count) {
  ShownImage::Line line{.shift = side_log2 + 1, .count = count};
  for (int axis = 0; axis < 2; ++axis) {
    const int64_t a = places[0][axis], b = places[1][axis], c = places[2][axis];
    const auto i = static_cast<size_t>(axis);
    line.from[i] = a;
    line.begin[i] = (b - a) * along + (c - b) * across;
    line.step[i] = 2 * (half == 0 ? b - a : c - b);
  }
  return line;
}

// An image as a half of a patch shows it.
struct HalfOfImage {
  const ShownImage* image = nullptr;
  std::array<glm::ivec2, 3> places;
  int level = 0;
  ShownImage::Repetition repetition;
  HalfOfImage() = default;
  HalfOfImage(const ShownImage& shown, const PatchImage& patch, size_t half, int side_log2)
      : image(&shown),
        places(shown.placesOf(patch, half)),
        level(shownLevel(places, side_log2)),
        repetition(shown.repetitionOf(places)) {}
  void show(size_t half, int side_log2, int64_t along, int64_t across, size_t count,
            const std::array<uint8_t*, 3>& to) const {
    image->sampleLine(lineIn(places, half, side_log2, along, across, count), level, repetition, to);
  }
};

// A half's corner colours, linear between them; what lies beyond the half goes on as far as bytes do. along, across: as
// forEachLine() has them. to: a channel's each.
void showColours(const std::array<glm::u8vec3, 3>& colours, size_t half, int shift, int64_t along, int64_t across,
                 size_t count, const std::array<uint8_t*, 3>& to) {
  for (int c = 0; c < 3; ++c) {
    const int64_t p = colours[0][c], q = colours[1][c], r = colours[2][c], step = 2 * (half == 0 ? q - p : r - q);
    int64_t sum = (p << shift) + (q - p) * along + (r - q) * across + (int64_t{1} << (shift - 1));
    for (size_t i = 0; i < count; ++i, sum += step)
      to[static_cast<size_t>(c)][i] = static_cast<uint8_t>(std::clamp<int64_t>(sum >> shift, 0, 255));
  }
}

}  // namespace

void showImages(const PatchImage& patch, const std::array<const ShownImage*, 2>& images, const ShownTexels& which,
                std::span<uint8_t> out) {
  const size_t plane = which.count * which.count;
  assert(out.size() >= 3 * plane);
  std::array<HalfOfImage, 2> shown;
  for (size_t half = 0; half < 2; ++half)
    if (!patch.hasColours(half)) shown[half] = HalfOfImage(*images[half], patch, half, which.side_log2);
  forEachLine(which, [&](size_t first, size_t count, size_t half, int64_t along, int64_t across) {
    uint8_t* to = out.data() + first;
    const std::array<uint8_t*, 3> channels{to, to + plane, to + 2 * plane};
    if (patch.hasColours(half))
      showColours(patch.colour[half], half, which.side_log2 + 1, along, across, count, channels);
    else shown[half].show(half, which.side_log2, along, across, count, channels);
  });
}

namespace {

// What is linear on a half, along a part of a row: at its texel k begin + k step.
struct LinearVector {
  std::array<double, 3> begin, step;
  glm::dvec3 at(double k) const { return {begin[0] + k * step[0], begin[1] + k * step[1], begin[2] + k * step[2]}; }
};

// Twice the corners' bytes less 255, times 2^(side_log2 + 1): whole numbers below 2^26, sums of whose squares are
// exact.
LinearVector normalsAlong(const std::array<glm::u8vec3, 3>& at, size_t half, int side_log2, int64_t along,
                          int64_t across) {
  LinearVector out;
  for (int axis = 0; axis < 3; ++axis) {
    auto twice = [&](size_t k) { return 2 * int64_t{at[k][axis]} - 255; };
    const auto i = static_cast<size_t>(axis);
    out.begin[i] = static_cast<double>((twice(0) << (side_log2 + 1)) + (twice(1) - twice(0)) * along +
                                       (twice(2) - twice(1)) * across);
    out.step[i] = static_cast<double>(2 * (half == 0 ? twice(1) - twice(0) : twice(2) - twice(1)));
  }
  return out;
}

// The corners' vectors times 255 * 2^(side_log2 + 1), as normalsAlong() has theirs.
LinearVector vectorsAlong(const std::array<glm::vec3, 3>& at, size_t half, int side_log2, int64_t along,
                          int64_t across) {
  LinearVector out;
  for (int axis = 0; axis < 3; ++axis) {
    auto of = [&](size_t k) { return 255 * double{at[k][axis]}; };
    const auto i = static_cast<size_t>(axis);
    out.begin[i] = std::ldexp(of(0), side_log2 + 1) + (of(1) - of(0)) * static_cast<double>(along) +
                   (of(2) - of(1)) * static_cast<double>(across);
    out.step[i] = 2 * (half == 0 ? of(1) - of(0) : of(2) - of(1));
  }
  return out;
}

// Made as long as 127.5, plus 128, rounded down.
void putNormal(const glm::dvec3& n, const std::array<uint8_t*, 3>& to, size_t i) {
  const double length = std::sqrt(n.x * n.x + n.y * n.y + n.z * n.z), divisor = length > 0 ? length : 1;
  for (int axis = 0; axis < 3; ++axis)
    to[static_cast<size_t>(axis)][i] = static_cast<uint8_t>(static_cast<int>(127.5 * (n[axis] / divisor) + 128));
}

}  // namespace

void showNormals(const PatchImage& patch, const ShownTexels& which, std::span<uint8_t> out,
                 const NormalsOfHalves& maps) {
  const size_t plane = which.count * which.count;
  const int log2 = which.side_log2;
  assert(out.size() >= 3 * plane);
  struct Mapped {
    HalfOfImage shown;
    std::array<glm::vec3, 3> upwards;
  };
  std::array<Mapped, 2> mapped;
  for (size_t half = 0; half < 2; ++half) {
    if (!maps[half].map) continue;
    mapped[half].shown = HalfOfImage(*maps[half].map, patch, half, log2);
    for (size_t k = 0; k < 3; ++k)
      mapped[half].upwards[k] = maps[half].frame.bitangent(glm::vec3(patch.normal[half][k]) / 127.5f - 1.0f, k);
  }
  forEachLine(which, [&](size_t first, size_t count, size_t half, int64_t along, int64_t across) {
    uint8_t* begin = out.data() + first;
    const std::array<uint8_t*, 3> to{begin, begin + plane, begin + 2 * plane};
    const LinearVector normals = normalsAlong(patch.normal[half], half, log2, along, across);
    if (!maps[half].map) {
      for (size_t i = 0; i < count; ++i) putNormal(normals.at(static_cast<double>(i)), to, i);
      return;
    }
    const LinearVector tangents = vectorsAlong(maps[half].frame.tangent, half, log2, along, across),
                       upwards = vectorsAlong(mapped[half].upwards, half, log2, along, across);
    mapped[half].shown.show(half, log2, along, across, count, to);
    for (size_t i = 0; i < count; ++i) {
      const auto k = static_cast<double>(i);
      auto of = [&](size_t axis) { return static_cast<double>(2 * int{to[axis][i]} - 255); };
      putNormal(of(0) * tangents.at(k) + of(1) * upwards.at(k) + of(2) * normals.at(k), to, i);
    }
  });
}

void tailOfImages(const PatchImage& patch, const std::array<const ShownImage*, 2>& images, const MipFilter& mip,
                  std::span<uint8_t> out, const NormalsOfHalves& maps) {
  constexpr int kSideLog2 = std::countr_zero(unsigned{kTailTexels});
  constexpr size_t kPlane = size_t{kTailTexels} * kTailTexels;
  const ShownTexels whole{.side_log2 = kSideLog2, .count = kTailTexels},
      finer{.side_log2 = kSideLog2 + 1, .count = 2 * kTailTexels};
  std::array<uint8_t, 6 * kPlane> texels;
  const std::span<uint8_t> normals = std::span(texels).subspan(3 * kPlane);
  std::array<uint8_t, 4 * 3 * kPlane> twice;
  auto showHalved = [&](const MipFilter& filter, std::span<uint8_t> to) {
    std::array<uint16_t, 3 * kPlane> halved;
    filter.downsample(twice.data(), 2 * kTailTexels, 2 * kTailTexels, halved.data());
    std::transform(halved.begin(), halved.end(), to.begin(), byteFromLevel);
  };
  // Of twice as many texels, as a coarser level of the image shows what lies beside a needle.
  const auto isCoarser = [&](const ShownImage* image, size_t half) {
    return image && shownLevel(image->placesOf(patch, half), kSideLog2) > 0;
  };
  if (isCoarser(images[0], 0) || isCoarser(images[1], 1)) {
    static const MipFilter colours(TextureFormat{.basis = Basis::kColour});
    showImages(patch, images, finer, twice);
    showHalved(colours, texels);
  } else {
    showImages(patch, images, whole, texels);
  }
  if (isCoarser(maps[0].map, 0) || isCoarser(maps[1].map, 1)) {
    static const MipFilter numbers = MipFilter::ofNumbers(3);
    showNormals(patch, finer, twice, maps);
    showHalved(numbers, normals);
  } else {
    showNormals(patch, whole, normals, maps);
  }
  tailTexels(mip, texels, out);
}

std::vector<TangentFrame> framesOfHalves(const std::vector<HasNormals>& of_images, std::span<const PatchImage> patches,
                                         const BaseMesh& base) {
  const auto hasNone = [](HasNormals has) { return has == HasNormals::kNo; };
  if (std::all_of(of_images.begin(), of_images.end(), hasNone)) return {};
  TangentFrames frames;
  for (uint32_t p = 0; p < patches.size(); ++p)
    for (size_t half = 0; half < 2; ++half) {
      const PatchImage& patch = patches[p];
      if (!patch.shows() || patch.hasColours(half) || hasNone(of_images[patch.image[half]])) {
        frames.addNone();
        continue;
      }
      MappedTriangle triangle;
      triangle.clockwise = half == 0;
      triangle.downwards = of_images[patch.image[half]] == HasNormals::kDownwards;
      for (size_t k = 0; k < 3; ++k) {
        const uint32_t corner = cornerAt(base.patches[p], half, k);
        const glm::ivec2& at = patch.at[half][k];
        const glm::u8vec3& n = patch.normal[half][k];
        triangle.position[k] = base.corners[corner].position_mm;
        triangle.normal[k] = glm::vec3(n) / 127.5f - 1.0f;
        triangle.place[k] = {at.x, -double(at.y)};
        triangle.corner[k] = {corner, static_cast<uint32_t>(at.x), static_cast<uint32_t>(at.y), patch.image[half],
                              uint32_t{n.x} << 16 | uint32_t{n.y} << 8 | n.z};
      }
      frames.add(triangle);
    }
  return std::move(frames).finish();
}

void cutTile(const SourceImage& image, uint32_t column, uint32_t row, std::span<uint8_t> channels) {
  assert(channels.size() == kTexturePageBytes);
  auto inside = [](int texel, uint32_t tile, int extent) {
    const int in_tile = std::clamp(texel - kPageBorderPx, 0, kPagePx - 1);
    return std::min(static_cast<int>(tile) * kPagePx + in_tile, extent - 1);
  };
  uint8_t* to = channels.data();
  for (size_t c = 0; c < 3; ++c)
    for (int y = 0; y < kPageFullPx; ++y) {
      const uint8_t* from =
          image.rgb.data() + static_cast<size_t>(inside(y, row, image.height)) * static_cast<size_t>(image.width) * 3;
      for (int x = 0; x < kPageFullPx; ++x) *to++ = from[3 * static_cast<size_t>(inside(x, column, image.width)) + c];
    }
}

void pasteTile(const StoredImage& image, uint32_t column, uint32_t row, std::span<const uint8_t> channels,
               std::span<uint8_t> rgb) {
  const size_t x0 = size_t{column} * kPagePx, y0 = size_t{row} * kPagePx;
  for (size_t y = y0; y < std::min<size_t>(image.height, y0 + kPagePx); ++y)
    for (size_t x = x0; x < std::min<size_t>(image.width, x0 + kPagePx); ++x)
      for (size_t c = 0; c < 3; ++c)
        rgb[3 * (y * image.width + x) + c] =
            channels[(c * kPageFullPx + kPageBorderPx + y - y0) * kPageFullPx + kPageBorderPx + x - x0];
}

// A JPEG has hardly more than its texels, but for its tables.
uint64_t StoredImage::mostTileBytes() const {
  constexpr uint64_t kTables = 64 << 10;
  return is_jpeg ? uint64_t{3} * width * height + kTables : kMaxEncodedPageBytes;
}

bool PatchImages::anyColours() const {
  return std::any_of(of_patch.begin(), of_patch.end(),
                     [](const PatchImage& patch) { return patch.shows() && patch.hasColours(); });
}

void fillImage(const SourceImage& image, size_t number, const glm::ivec2& place_size,
               std::span<const PatchImage> patches, std::span<uint8_t> rgb) {
  ShownMarks marks(image.width, image.height, image.repeats);
  for (const PatchImage& patch : patches)
    for (size_t half = 0; half < 2; ++half)
      if (patch.shows() && patch.image[half] == number)
        marks.add(placesIn({image.width, image.height}, place_size, patch.at[half]));
  std::move(marks).fillRest(rgb);
}

namespace {

// What is stored of the corners of halves: as a place, a colour and a normal differ from what is predicted.
struct CodedCorners {
  std::array<std::vector<uint32_t>, 2> places;
  std::array<std::vector<uint8_t>, 3> normals, colours;
  std::vector<uint8_t> by_plane;

  glm::ivec2 place(const glm::ivec2& expected, const glm::ivec2& there) {
    for (int axis = 0; axis < 2; ++axis)
      places[static_cast<size_t>(axis)].push_back(folded(minus(there[axis], expected[axis])));
    return there;
  }
  // Red and blue mostly differ as green does.
  glm::u8vec3 colour(const glm::u8vec3& expected, const glm::u8vec3& there) {
    const glm::u8vec3 off = there - expected;
    for (int c = 0; c < 3; ++c)
      colours[static_cast<size_t>(c)].push_back(static_cast<uint8_t>(c == 1 ? off.g : off[c] - off.g));
    return there;
  }
  bool byPlane(const CornerPredictor::Normals& by_corners, const CornerPredictor::Normals& of_plane,
               const CornerPredictor::Normals& there) {
    by_plane.push_back(offBy(of_plane, there) < offBy(by_corners, there));
    return by_plane.back() != 0;
  }
  glm::u8vec3 normal(const glm::u8vec3& expected, const glm::u8vec3& there) {
    for (int axis = 0; axis < 3; ++axis)
      normals[static_cast<size_t>(axis)].push_back(static_cast<uint8_t>(there[axis] - expected[axis]));
    return there;
  }
};

}  // namespace

std::vector<uint8_t> encodePatchImages(std::span<const StoredImage> images, std::span<const PatchImage> of_patch,
                                       const BaseMesh& base, bool by_base) {
  std::vector<uint8_t> raw;
  auto put = [&](auto v) {
    raw.resize(raw.size() + sizeof v);
    storeLittle(raw.data() + raw.size() - sizeof v, v);
  };
  put(static_cast<uint32_t>(images.size()));
  for (const StoredImage& image : images) {
    put(image.width);
    put(image.height);
    put(static_cast<uint8_t>((image.repeats ? kRepeats : 0) | (image.is_jpeg ? kIsJpeg : 0) | (image.fill ? kFill : 0) |
                             (image.is_normals ? kIsNormals : 0) | (image.normals_downwards ? kDownwards : 0)));
  }
  for (const StoredImage& image : images)
    for (const ImageTile& tile : image.tiles) put(tile.size);
  for (const StoredImage& image : images)
    for (const ImageTile& tile : image.tiles) put(tile.hash);
  for (const PatchImage& patch : of_patch) put(patch.in_tail ? kInTail : static_cast<uint8_t>(patch.depth + 1));
  for (const PatchImage& patch : of_patch)
    if (patch.shows())
      for (const uint16_t image : patch.image) put(image);
  CodedCorners corners;
  CornerPredictor(base, images.size(), by_base).run(of_patch, corners);
  raw.insert(raw.end(), corners.by_plane.begin(), corners.by_plane.end());
  for (const auto& of_axis : corners.places)
    for (int byte = 0; byte < 4; ++byte)
      for (const uint32_t v : of_axis) raw.push_back(static_cast<uint8_t>(v >> (8 * byte)));
  for (const auto& of_axis : corners.normals) raw.insert(raw.end(), of_axis.begin(), of_axis.end());
  for (const auto& of_channel : corners.colours) raw.insert(raw.end(), of_channel.begin(), of_channel.end());
  std::vector<uint8_t> out(ZSTD_compressBound(raw.size()));
  const std::unique_ptr<ZSTD_CCtx, size_t (*)(ZSTD_CCtx*)> context(ZSTD_createCCtx(), ZSTD_freeCCtx);
  ZSTD_CCtx_setParameter(context.get(), ZSTD_c_compressionLevel, kZstdLevel);
  // With a window as large as the directory its tables would take up to 85 MiB, and save nothing: what repeats is near.
  constexpr int kWindowLog = 18;
  if (raw.size() > size_t{1} << kWindowLog) {
    ZSTD_CCtx_setParameter(context.get(), ZSTD_c_windowLog, kWindowLog);
    ZSTD_CCtx_setParameter(context.get(), ZSTD_c_chainLog, kWindowLog + 1);
    ZSTD_CCtx_setParameter(context.get(), ZSTD_c_hashLog, kWindowLog);
  }
  const size_t size = ZSTD_compress2(context.get(), out.data(), out.size(), raw.data(), raw.size());
  out.resize(ZSTD_isError(size) ? 0 : size);  // it cannot be: there is room
  return out;
}

namespace {

// How many halves show images, and how many colours of corners.
struct ShownHalves {
  size_t images = 0, colours = 0;
  size_t all() const { return images + colours; }
  size_t planeBytes(bool by_base) const { return by_base ? all() : 0; }
  size_t bytes(bool by_base) const {
    return planeBytes(by_base) + images * kPlacesBytes + all() * kNormalsBytes + colours * kColoursBytes;
  }
};

// What CodedCorners made, of so many halves.
struct DecodedCorners {
  DecodedCorners(std::span<const uint8_t> coded, const ShownHalves& shown, bool by_base)
      : places(3 * shown.images),
        normals(3 * shown.all()),
        colours(3 * shown.colours),
        by_plane(coded),
        of_places(coded.subspan(shown.planeBytes(by_base))),
        of_normals(of_places.subspan(8 * places)),
        of_colours(of_normals.subspan(3 * normals)) {}

  glm::ivec2 place(const glm::ivec2& expected, const glm::ivec2&) {
    glm::ivec2 there(0);
    for (int axis = 0; axis < 2; ++axis) {
      uint32_t v = 0;
      for (size_t byte = 0; byte < 4; ++byte)
        v |= uint32_t{of_places[(static_cast<size_t>(4 * axis) + byte) * places + next_place]} << (8 * byte);
      there[axis] = plus(expected[axis], unfolded(v));
      inside = inside && std::abs(int64_t{there[axis]}) <= kMostShownPlace;
    }
    ++next_place;
    return there;
  }
  glm::u8vec3 colour(const glm::u8vec3& expected, const glm::u8vec3&) {
    const auto stored = [&](size_t c) { return of_colours[c * colours + next_colour]; };
    const glm::u8vec3 off(stored(0) + stored(1), stored(1), stored(2) + stored(1));
    ++next_colour;
    return expected + off;
  }
  bool byPlane(const CornerPredictor::Normals&, const CornerPredictor::Normals&, const CornerPredictor::Normals&) {
    return by_plane[next_half++] != 0;
  }
  glm::u8vec3 normal(const glm::u8vec3& expected, const glm::u8vec3&) {
    glm::u8vec3 there(0);
    for (int axis = 0; axis < 3; ++axis)
      there[axis] =
          static_cast<uint8_t>(expected[axis] + of_normals[static_cast<size_t>(axis) * normals + next_normal]);
    ++next_normal;
    return there;
  }

  size_t places, normals, colours;  // how many there are
  std::span<const uint8_t> by_plane, of_places, of_normals, of_colours;
  size_t next_half = 0, next_place = 0, next_normal = 0, next_colour = 0;
  bool inside = true;  // all places so far
};

}  // namespace

Result<PatchImages> decodePatchImages(std::span<const uint8_t> bytes, const BaseMesh& base, uint64_t tile_bytes,
                                      KindsOfImages kinds) {
  // A tile takes a byte, and an image a tile.
  const uint64_t most = sizeof(uint32_t) + tile_bytes * (kImageHeadBytes + kTileBytes) +
                        base.patches.size() * (kPatchBytes + kHalvesBytes + kByPlaneBytes +
                                               2 * (kPlacesBytes + kNormalsBytes + kColoursBytes));
  const unsigned long long stated = ZSTD_getFrameContentSize(bytes.data(), bytes.size());
  if (stated == ZSTD_CONTENTSIZE_ERROR || stated == ZSTD_CONTENTSIZE_UNKNOWN || stated > most)
    return damaged("their directory is no zstd frame of at most " + std::to_string(most) + " bytes");
  std::vector<uint8_t> raw(stated);
  if (const size_t size = ZSTD_decompress(raw.data(), raw.size(), bytes.data(), bytes.size()); size != stated)
    return damaged("their directory is no zstd frame");
  size_t at = 0;
  bool whole = true;
  auto take = [&]<class T>(T& v) {
    whole = whole && raw.size() - at >= sizeof v;
    if (!whole) return;
    v = loadLittle<T>(raw.data() + at);
    at += sizeof v;
  };
  const Error cut = damaged("their directory ends too soon");
  PatchImages out;
  uint32_t images = 0;
  take(images);
  if (!whole || images > tile_bytes || images > kMostShownImages) return damaged("there are too many");
  uint64_t texels = 0, tiles = 0;
  out.images.resize(images);
  const StoredImage* before = nullptr;
  for (StoredImage& image : out.images) {
    uint8_t kind = 0;
    take(image.width);
    take(image.height);
    take(kind);
    if (!whole) return cut;
    if (image.width < 1 || image.height < 1 || image.width > kMostShownSide || image.height > kMostShownSide)
      return damaged("an image has no size of 1 to " + std::to_string(kMostShownSide) + " texels");
    image.repeats = (kind & kRepeats) != 0;
    image.is_jpeg = (kind & kIsJpeg) != 0;
    image.fill = (kind & kFill) != 0;
    image.is_normals = (kind & kIsNormals) != 0;
    image.normals_downwards = (kind & kDownwards) != 0;
    if (kind > (kRepeats | kIsJpeg | kFill | kIsNormals | kDownwards) || (image.fill && !image.is_jpeg) ||
        (image.is_jpeg && !kinds.jpegs) || (image.is_normals && !kinds.richer) ||
        (image.normals_downwards && !image.is_normals))
      return damaged("an image is of an unknown kind");
    if (image.is_normals && (before == nullptr || before->is_normals)) return damaged("normals belong to no image");
    before = &image;
    texels += uint64_t{image.width} * image.height;
    tiles += image.tileCount();
    if (texels > (kinds.richer ? kMostShownTexels : kMostTexelsBefore19) || tiles > tile_bytes)
      return damaged("they have too many texels");
  }
  uint64_t sum = 0;
  for (StoredImage& image : out.images) {
    image.tiles.resize(image.tileCount());
    for (ImageTile& tile : image.tiles) {
      take(tile.size);
      sum += tile.size;
      if (tile.size == 0 || tile.size > image.mostTileBytes()) return damaged("a tile has no size of a page");
    }
  }
  for (StoredImage& image : out.images)
    for (ImageTile& tile : image.tiles) take(tile.hash);
  if (!whole) return cut;
  if (sum != tile_bytes)
    return damaged("expected tiles of " + std::to_string(tile_bytes) + " bytes, found " + std::to_string(sum));
  out.of_patch.resize(base.patches.size());
  for (PatchImage& patch : out.of_patch) {
    uint8_t levels = 0;
    take(levels);
    patch.in_tail = kinds.in_tails && levels == kInTail;
    if (!patch.in_tail && levels > kMostShownDepth + 1) return damaged("a patch has too many texture levels");
    if (!patch.in_tail) patch.depth = static_cast<int8_t>(levels - 1);
  }
  ShownHalves shown;
  for (PatchImage& patch : out.of_patch)
    if (patch.shows())
      for (uint16_t& image : patch.image) {
        take(image);
        const bool colours = kinds.colours && image == kCornerColours;
        if (!colours && (image >= images || out.images[image].is_normals))
          return damaged("a patch shows an image that is not there");
        ++(colours ? shown.colours : shown.images);
      }
  if (!whole || raw.size() - at != shown.bytes(kinds.by_base)) return cut;
  DecodedCorners corners{std::span(raw).subspan(at), shown, kinds.by_base};
  CornerPredictor(base, out.images.size(), kinds.by_base).run(std::span(out.of_patch), corners);
  if (!corners.inside) return damaged("a patch lies too far outside of its image");
  return out;
}

}  // namespace relievo
