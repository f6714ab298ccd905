// The rules, on texels in 8.8 fixed point (v = 256 * byte at the finest level); a b / c d is the 2 x 2 square:
//   number  (a + b + c + d + 2) >> 2
//   linear  with lin(v) = round(65535 * f(v / 65280)), f the sRGB decoding curve (IEC 61966-2-1), and
//           enc(n) = round(65280 * f^-1(n / 65535)):  enc((lin(a) + lin(b) + lin(c) + lin(d) + 2) >> 2)
//   colour that a luminance multiplies: a texel's weight, from those n coefficients of the luminance whose function
//           has a mean f_k over diffuse light that is not 0, with t_k = v_k >> 4:
//             w = clamp((sum M_k t_k + C) >> 14, 1, 4095)          (in quarters of a unit of display intensity)
//             M_k = round(4096 f_k scale_k / 2^s); s >= 0 the smallest with all |M_k| <= min(65536, 3 * 65536 / n)
//             C = clamp(-sum M_k round(16 bias_k), +-8e8)
//           (LRGB PTM: k = 0, 1 and 5, f = 1/3, 1/3, 1)
//           colour (wa a + wb b + wc c + wd d + floor(W / 2)) / W, rounded down, W = wa + wb + wc + wd
// Weights stay below 2^12 so that the sums fit 32 bits: 4 * 4095 * 65280 < 2^31; and so do those of the weights,
// 3 * 65536 * 4080 + 8e8 < 2^31.
#include "texturing/codec/mip.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstring>

#include "src/base/simd_dispatch.h"
#include "src/base/srgb.h"

namespace relievo {
namespace {

constexpr int kMaxLevelValue = 255 * 256;
constexpr int kMaxWeight = 4095;

struct TransferTables {
  // Not vectors: the first one to ask may be a function that may not allocate (src/base/simd_dispatch.h).
  std::array<uint16_t, kMaxLevelValue + 1> linear_from_level;
  std::array<uint16_t, 65536> level_from_linear;
  TransferTables() {
    for (int v = 0; v <= kMaxLevelValue; ++v) {
      linear_from_level[v] = static_cast<uint16_t>(std::lround(65535 * linearFromSrgb(v / double{kMaxLevelValue})));
    }
    for (int n = 0; n <= 65535; ++n) {
      const double s = srgbFromLinear(n / 65535.0);
      level_from_linear[n] = static_cast<uint16_t>(std::lround(std::clamp(s, 0.0, 1.0) * kMaxLevelValue));
    }
  }
};

const TransferTables& transferTables() {
  static const TransferTables tables;
  return tables;
}

inline int levelValue(uint8_t b) { return b << 8; }
inline int levelValue(uint16_t v) { return v; }

void averageNumbers(const uint8_t* __restrict top, const uint8_t* __restrict bottom, int out_width,
                    uint16_t* __restrict out) {
  // (256 (a + b + c + d) + 2) >> 2 = 64 (a + b + c + d)
  for (int x = 0; x < out_width; ++x)
    out[x] = static_cast<uint16_t>((top[2 * x] + top[2 * x + 1] + bottom[2 * x] + bottom[2 * x + 1]) << 6);
}

void averageNumbers(const uint16_t* __restrict top, const uint16_t* __restrict bottom, int out_width,
                    uint16_t* __restrict out) {
  for (int x = 0; x < out_width; ++x)
    out[x] =
        static_cast<uint16_t>((uint32_t{top[2 * x]} + top[2 * x + 1] + bottom[2 * x] + bottom[2 * x + 1] + 2u) >> 2);
}

template <class T>
void averageLinear(const T* top, const T* bottom, int out_width, uint16_t* out) {
  const uint16_t* lin = transferTables().linear_from_level.data();
  const uint16_t* enc = transferTables().level_from_linear.data();
  auto l = [&](T v) -> uint32_t { return lin[levelValue(v)]; };
  for (int x = 0; x < out_width; ++x)
    out[x] = enc[(l(top[2 * x]) + l(top[2 * x + 1]) + l(bottom[2 * x]) + l(bottom[2 * x + 1]) + 2) >> 2];
}

// Weighted texels of one output row; the quotient by doubles is exact: N / W lies at least 1 / W >= 2^-14 below the
// next integer, and below 2^16 doubles are spaced 2^-37.
template <class T>
void averageWeighted(const T* __restrict top, const T* __restrict bottom, const int32_t* __restrict top_w,
                     const int32_t* __restrict bottom_w, int out_width, uint16_t* __restrict out) {
  for (int x = 0; x < out_width; ++x) {
    int32_t wa = top_w[2 * x], wb = top_w[2 * x + 1], wc = bottom_w[2 * x], wd = bottom_w[2 * x + 1];
    int32_t w = wa + wb + wc + wd;
    int32_t n = wa * levelValue(top[2 * x]) + wb * levelValue(top[2 * x + 1]) + wc * levelValue(bottom[2 * x]) +
                wd * levelValue(bottom[2 * x + 1]) + (w >> 1);
    out[x] = static_cast<uint16_t>(static_cast<int32_t>(static_cast<double>(n) / static_cast<double>(w)));
  }
}

template <class T>
void repeatBorderAny(T* data, int width, int height, int channels, int x0, int y0, int x1, int y1) {
  assert(0 <= x0 && x0 < x1 && x1 <= width && 0 <= y0 && y0 < y1 && y1 <= height);
  for (int c = 0; c < channels; ++c) {
    T* plane = data + static_cast<size_t>(c) * width * height;
    if (x0 > 0 || x1 < width) {
      for (int y = y0; y < y1; ++y) {
        T* row = plane + static_cast<size_t>(y) * width;
        std::fill(row, row + x0, row[x0]);
        std::fill(row + x1, row + width, row[x1 - 1]);
      }
    }
    auto copyRow = [&](int from, int to) {
      std::memcpy(plane + static_cast<size_t>(to) * width, plane + static_cast<size_t>(from) * width,
                  width * sizeof(T));
    };
    for (int y = 0; y < y0; ++y) copyRow(y0, y);
    for (int y = y1; y < height; ++y) copyRow(y1 - 1, y);
  }
}

}  // namespace

MipFilter::MipFilter(const TextureFormat& format) {
  const BasisDescription& basis = describe(format.basis);
  for (int i = 0; i < 3 * basis.planes; ++i) {
    const BasisChannel& c = basis.channels[static_cast<size_t>(i)];
    if (c.holds != BasisChannel::Holds::kColour) numbers_.push_back(i);
    else if (basis.shading == Shading::kLuminance) weighted_.push_back(i);
    else linear_.push_back(i);
    if (c.holds == BasisChannel::Holds::kCoefficient && c.of == BasisChannel::kLuminance &&
        basis.diffuse[c.coefficient] != 0)
      weights_.push_back({i, 0});
  }
  if (weighted_.empty()) return;
  auto exact = [&](const Weight& w) {
    const size_t k = basis.channels[static_cast<size_t>(w.channel)].coefficient;
    return format.scale[k] * basis.diffuse[k] * 4096;
  };
  const double most = std::floor(std::min(65536.0, 3 * 65536.0 / static_cast<double>(weights_.size())));
  double largest = 0;
  for (const Weight& w : weights_) largest = std::max(largest, std::abs(exact(w)));
  double shrink = 1;
  while (largest / shrink > most && shrink < 1e300) shrink *= 2;
  double offset = 0;
  for (Weight& w : weights_) {
    w.factor = static_cast<int32_t>(std::lround(std::clamp(exact(w) / shrink, -most, most)));
    offset -= w.factor * std::round(16 * format.bias[basis.channels[static_cast<size_t>(w.channel)].coefficient]);
  }
  weight_offset_ = static_cast<int32_t>(std::clamp(offset, -8e8, 8e8));
}

MipFilter MipFilter::ofNumbers(int channels) {
  MipFilter filter;
  for (int c = 0; c < channels; ++c) filter.numbers_.push_back(c);
  return filter;
}

// Two rows one after the other, each `width` texels.
template <class T>
void MipFilter::weightsOf(const T* rows, size_t plane, int width, int32_t* out) const noexcept {
  std::fill(out, out + 2 * width, weight_offset_);
  for (const Weight& w : weights_) {
    const T* in = rows + static_cast<size_t>(w.channel) * plane;
    for (int x = 0; x < 2 * width; ++x) out[x] += w.factor * (levelValue(in[x]) >> 4);
  }
  for (int x = 0; x < 2 * width; ++x) out[x] = std::clamp(out[x] >> 14, 1, kMaxWeight);
}

template <class T>
RELIEVO_SIMD_CLONES void MipFilter::downsampleAny(const T* in, int width, int height, std::span<int32_t> weights,
                                                  uint16_t* out) const noexcept {
  assert(width % 2 == 0 && height % 2 == 0);
  const int out_width = width / 2, out_height = height / 2;
  const size_t plane = static_cast<size_t>(width) * height, out_plane = plane / 4;
  auto forRows = [&](int channel, auto&& average) {
    const size_t c = static_cast<size_t>(channel);
    for (int y = 0; y < out_height; ++y) {
      const T* top = in + c * plane + static_cast<size_t>(2 * y) * width;
      average(top, top + width, out_width, out + c * out_plane + static_cast<size_t>(y) * out_width);
    }
  };
  for (int c : numbers_) forRows(c, [](auto... row) { averageNumbers(row...); });
  for (int c : linear_) forRows(c, [](auto... row) { averageLinear(row...); });
  if (weighted_.empty()) return;
  for (int y = 0; y < out_height; ++y) {
    const T* rows = in + static_cast<size_t>(2 * y) * width;
    weightsOf(rows, plane, width, weights.data());
    for (int channel : weighted_) {
      const size_t c = static_cast<size_t>(channel);
      const T* top = rows + c * plane;
      averageWeighted(top, top + width, weights.data(), weights.data() + width, out_width,
                      out + c * out_plane + static_cast<size_t>(y) * out_width);
    }
  }
}

std::vector<int32_t> MipFilter::weightRows(int width) const {
  return std::vector<int32_t>(weighted_.empty() ? 0 : static_cast<size_t>(width) * 2);
}

void MipFilter::downsample(const uint16_t* in, int width, int height, uint16_t* out) const {
  std::vector<int32_t> weights = weightRows(width);
  downsampleAny(in, width, height, std::span(weights), out);
}
void MipFilter::downsample(const uint8_t* in, int width, int height, uint16_t* out) const {
  std::vector<int32_t> weights = weightRows(width);
  downsampleAny(in, width, height, std::span(weights), out);
}

void repeatBorder(uint8_t* data, int width, int height, int channels, int x0, int y0, int x1, int y1) {
  repeatBorderAny(data, width, height, channels, x0, y0, x1, y1);
}
void repeatBorder(uint16_t* data, int width, int height, int channels, int x0, int y0, int x1, int y1) {
  repeatBorderAny(data, width, height, channels, x0, y0, x1, y1);
}

}  // namespace relievo
