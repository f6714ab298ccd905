// Encoded page, by its first byte (PACKAGE.md says the same in more words):
//   kRaw, kZstd                    the predictors (texture: 3, relief: 1), then the channels' residual streams
//   kQuantisedRaw, kQuantisedZstd  the bits, then the same, of levels instead of values
//   kJpegFile                      a JPEG
//   kBlocksRaw, kBlocksZstd        the PageCodec, then blocks of 4 x 4 texels
//   kCoarseRaw, kCoarseZstd        the factor, then as kRaw and kZstd, of so many times fewer texels a side
//   kHierarchical, kHierarchicalTexels  a code of the relief or the texture page (relief_code.h, texel_code.h)
// Texture stream: kPageFullPx^2 residual bytes, or for kConstant the one value. residual = value - prediction (mod
// 256). Relief stream: residual = value - prediction (mod 2^16), folded (r << 1) ^ (r >> 15, arithmetic) so that small
// residuals of either sign have a zero high byte; all low bytes, then all high bytes. For kConstant the value's low and
// high byte. Predictions see 0 beyond the page's left and upper border, so decoding is exact and vectorises:
//   kLeft and kGradient (left + up - upper left) are prefix sums along a row, the rest look at the row above only.
#include "texturing/codec/page_codec.h"

#define ZSTD_STATIC_LINKING_ONLY
#include <zstd.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <type_traits>

#if defined(__SSE2__)
#include <emmintrin.h>
#endif

#include "src/base/simd_dispatch.h"
#include "texturing/codec/page_block_codec.h"
#include "texturing/codec/page_jpeg_codec.h"
#include "texturing/codec/relief_code.h"
#include "texturing/codec/tail_code.h"
#include "texturing/codec/texel_code.h"

namespace relievo {
namespace {

enum Predictor : uint8_t {
  kNone = 0,
  kLeft = 1,
  kUp = 2,
  kGradient = 3,
  kSmoothUp = 4,
  kConstant = 5,
  kPredictorCount = 6
};
// The first byte of a page. The odd ones are a zstd frame of what the even ones hold.
enum Packing : uint8_t {
  kRaw = 0,
  kZstd = 1,
  kQuantisedRaw = 2,
  kQuantisedZstd = 3,
  kJpegFile = 4,
  kBlocksRaw = 6,
  kBlocksZstd = 7,
  kHierarchical = 8,  // relief_code.h
  kCoarseRaw = 10,    // coarse_page.h
  kCoarseZstd = 11,
  kHierarchicalTexels = 12,  // texel_code.h
  kOverTail = 14,            // relief_code.h: its tail's heights, then the code
  kOfTail = 16               // its tail's heights; stands for a page that has no bytes, and is never stored
};

constexpr bool isCoarse(uint8_t packing) { return packing == kCoarseRaw || packing == kCoarseZstd; }

constexpr int kSide = kPageFullPx;
constexpr size_t kChannelBytes = size_t{kSide} * kSide;
constexpr size_t kTextureHeadBytes = 4, kQuantisedHeadBytes = 5, kJpegHeadBytes = 1, kBlocksHeadBytes = 2,
                 kReliefHeadBytes = 2, kCoarseHeadBytes = 5;
constexpr size_t kReliefBytes = kReliefPageSamples * 2;

// The row above, smoothed: (1 2 1) / 4 with the ends repeated. Averages noise away and needs nothing of the row itself.
template <class T>
void smoothRow(const T* __restrict above, int width, T* __restrict out) {
  out[0] = static_cast<T>((3 * above[0] + above[1] + 2) >> 2);
  for (int x = 1; x + 1 < width; ++x) out[x] = static_cast<T>((above[x - 1] + 2 * above[x] + above[x + 1] + 2) >> 2);
  out[width - 1] = static_cast<T>((above[width - 2] + 3 * above[width - 1] + 2) >> 2);
}

// Residuals of one row. above: the row above, zeros for the first.
template <class T, int kWidth>
void predictRow(Predictor p, const T* __restrict row, const T* __restrict above, T* __restrict out) {
  switch (p) {
    case kLeft:
      out[0] = row[0];
      for (int x = 1; x < kWidth; ++x) out[x] = static_cast<T>(row[x] - row[x - 1]);
      break;
    case kUp:
      for (int x = 0; x < kWidth; ++x) out[x] = static_cast<T>(row[x] - above[x]);
      break;
    case kGradient:
      out[0] = static_cast<T>(row[0] - above[0]);
      for (int x = 1; x < kWidth; ++x) out[x] = static_cast<T>(row[x] - row[x - 1] - above[x] + above[x - 1]);
      break;
    case kSmoothUp: {
      T smooth[kWidth];
      smoothRow(above, kWidth, smooth);
      for (int x = 0; x < kWidth; ++x) out[x] = static_cast<T>(row[x] - smooth[x]);
      break;
    }
    default:
      std::memcpy(out, row, kWidth * sizeof(T));
  }
}

// In place: running sums of the row's bytes (mod 256).
void prefixSum(uint8_t* row, int width) {
  int x = 0;
  uint8_t sum = 0;
#if defined(__SSE2__)
  __m128i carry = _mm_setzero_si128();  // the sum so far, in every byte
  for (; x + 16 <= width; x += 16) {
    __m128i v = _mm_loadu_si128(reinterpret_cast<const __m128i*>(row + x));
    v = _mm_add_epi8(v, _mm_slli_si128(v, 1));
    v = _mm_add_epi8(v, _mm_slli_si128(v, 2));
    v = _mm_add_epi8(v, _mm_slli_si128(v, 4));
    v = _mm_add_epi8(v, _mm_slli_si128(v, 8));
    _mm_storeu_si128(reinterpret_cast<__m128i*>(row + x), _mm_add_epi8(v, carry));
    // The last byte, in every byte.
    v = _mm_unpackhi_epi8(v, v);
    v = _mm_shufflehi_epi16(v, 0xFF);
    carry = _mm_add_epi8(carry, _mm_unpackhi_epi64(v, v));
  }
  sum = static_cast<uint8_t>(_mm_cvtsi128_si32(carry));
#endif
  for (; x < width; ++x) row[x] = sum = static_cast<uint8_t>(sum + row[x]);
}

void prefixSum(uint16_t* row, int width) {
  int x = 0;
  uint16_t sum = 0;
#if defined(__SSE2__)
  __m128i carry = _mm_setzero_si128();
  for (; x + 8 <= width; x += 8) {
    __m128i v = _mm_loadu_si128(reinterpret_cast<const __m128i*>(row + x));
    v = _mm_add_epi16(v, _mm_slli_si128(v, 2));
    v = _mm_add_epi16(v, _mm_slli_si128(v, 4));
    v = _mm_add_epi16(v, _mm_slli_si128(v, 8));
    _mm_storeu_si128(reinterpret_cast<__m128i*>(row + x), _mm_add_epi16(v, carry));
    v = _mm_shufflehi_epi16(v, 0xFF);
    carry = _mm_add_epi16(carry, _mm_unpackhi_epi64(v, v));
  }
  sum = static_cast<uint16_t>(_mm_cvtsi128_si32(carry));
#endif
  for (; x < width; ++x) row[x] = sum = static_cast<uint16_t>(sum + row[x]);
}

// In place: residuals to values, row by row.
template <class T, int kWidth>
RELIEVO_SIMD_CLONES void unpredict(Predictor p, T* data, int height) noexcept {
  static constexpr T kZeros[kWidth] = {};
  for (int y = 0; y < height; ++y) {
    T* __restrict row = data + static_cast<size_t>(y) * kWidth;
    const T* __restrict above = y == 0 ? kZeros : row - kWidth;
    switch (p) {
      case kLeft:
        prefixSum(row, kWidth);
        break;
      case kUp:
        for (int x = 0; x < kWidth; ++x) row[x] = static_cast<T>(row[x] + above[x]);
        break;
      case kGradient:
        prefixSum(row, kWidth);
        for (int x = 0; x < kWidth; ++x) row[x] = static_cast<T>(row[x] + above[x]);
        break;
      case kSmoothUp: {
        T smooth[kWidth];
        smoothRow(above, kWidth, smooth);
        for (int x = 0; x < kWidth; ++x) row[x] = static_cast<T>(row[x] + smooth[x]);
        break;
      }
      default:
        return;
    }
  }
}

// How many bits a residual costs, roughly, summed: what the entropy coder will make of it.
uint32_t magnitude(const uint8_t* r, int n) {
  uint32_t sum = 0;
  for (int x = 0; x < n; ++x) sum += static_cast<uint32_t>(std::abs(static_cast<int>(static_cast<int8_t>(r[x]))));
  return sum;
}
uint32_t magnitude(const uint16_t* r, int n) {
  uint32_t sum = 0;
  for (int x = 0; x < n; ++x) sum += static_cast<uint32_t>(std::abs(static_cast<int>(static_cast<int16_t>(r[x]))));
  return sum;
}

// The predictor with the smallest residuals on every fourth row. kNone is judged by the distance from the mean, in
// which a channel of plain noise wins (differences double its variance).
template <class T, int kWidth>
RELIEVO_SIMD_CLONES Predictor choosePredictor(const T* data, int height) noexcept {
  if (std::memcmp(data, data + 1, (static_cast<size_t>(kWidth) * height - 1) * sizeof(T)) == 0) return kConstant;
  uint64_t cost[kConstant] = {};
  uint64_t total = 0, rows = 0;
  for (int y = 2; y < height; y += 4, ++rows)
    for (int x = 0; x < kWidth; ++x) total += data[static_cast<size_t>(y) * kWidth + x];
  T mean_row[kWidth];
  std::fill(mean_row, mean_row + kWidth, static_cast<T>(total / (rows * kWidth)));
  T residuals[kWidth];
  for (int y = 2; y < height; y += 4) {
    const T* row = data + static_cast<size_t>(y) * kWidth;
    predictRow<T, kWidth>(kUp, row, mean_row, residuals);
    cost[kNone] += magnitude(residuals, kWidth);
    for (Predictor p : {kLeft, kUp, kGradient, kSmoothUp}) {
      predictRow<T, kWidth>(p, row, row - kWidth, residuals);
      cost[p] += magnitude(residuals + 1, kWidth - 1);
    }
  }
  return static_cast<Predictor>(std::min_element(cost, cost + kConstant) - cost);
}

// Levels back to values: round(255 level / (2^bits - 1)), in 16-bit arithmetic so that it vectorises; the constants are
// the smallest that are exact for all levels. Levels that cannot be (from a damaged page) count as the largest.
struct Expansion {
  uint16_t factor, half;
  int shift;
};
constexpr Expansion kExpansions[] = {{272, 0, 4}, {527, 23, 6}, {259, 33, 6}, {257, 64, 7}};
RELIEVO_SIMD_CLONES void expandLevels(uint8_t* data, size_t n, int bits) noexcept {
  const Expansion e = kExpansions[bits - kMinQuantisedBits];
  const uint8_t top = static_cast<uint8_t>((1 << bits) - 1);
  for (size_t i = 0; i < n; ++i) {
    uint16_t level = std::min(data[i], top);
    data[i] = static_cast<uint8_t>(static_cast<uint16_t>(level * e.factor + e.half) >> e.shift);
  }
}

// Three channels <-> RGBA8 texels, alpha 255.
RELIEVO_SIMD_CLONES void interleave(const uint8_t* __restrict channels, uint8_t* __restrict texels) noexcept {
  const uint8_t *r = channels, *g = r + kChannelBytes, *b = g + kChannelBytes;
#if defined(__SSE2__)
  static_assert(kChannelBytes % 16 == 0);
  const __m128i opaque = _mm_set1_epi8(-1);
  for (size_t i = 0; i < kChannelBytes; i += 16) {
    auto load = [&](const uint8_t* p) { return _mm_loadu_si128(reinterpret_cast<const __m128i*>(p + i)); };
    auto store = [&](int k, __m128i v) { _mm_storeu_si128(reinterpret_cast<__m128i*>(texels + 4 * i + 16 * k), v); };
    __m128i red = load(r), green = load(g), blue = load(b);
    __m128i rg = _mm_unpacklo_epi8(red, green), ba = _mm_unpacklo_epi8(blue, opaque);
    store(0, _mm_unpacklo_epi16(rg, ba));
    store(1, _mm_unpackhi_epi16(rg, ba));
    rg = _mm_unpackhi_epi8(red, green), ba = _mm_unpackhi_epi8(blue, opaque);
    store(2, _mm_unpacklo_epi16(rg, ba));
    store(3, _mm_unpackhi_epi16(rg, ba));
  }
#else
  for (size_t i = 0; i < kChannelBytes; ++i) {
    texels[4 * i] = r[i];
    texels[4 * i + 1] = g[i];
    texels[4 * i + 2] = b[i];
    texels[4 * i + 3] = 255;
  }
#endif
}

RELIEVO_SIMD_CLONES void separate(const uint8_t* __restrict texels, uint8_t* __restrict channels) noexcept {
  uint8_t *r = channels, *g = r + kChannelBytes, *b = g + kChannelBytes;
  for (size_t i = 0; i < kChannelBytes; ++i) r[i] = texels[4 * i], g[i] = texels[4 * i + 1], b[i] = texels[4 * i + 2];
}

Error damaged(const char* what) {
  return {ErrorKind::kInvalidData, "", what, "rebuild the package, or get a whole copy", {}};
}

}  // namespace

struct PageEncoder::Impl {
  ZSTD_CCtx* context = nullptr;
  std::array<uint8_t, std::max(kTexturePageBytes, kReliefBytes)> streams;
  std::array<uint8_t, kTexturePageBytes> levels;
  std::array<uint8_t, kSlotBytes> texels;
  std::vector<uint8_t> out, hierarchical, kept;
  JpegPageEncoder jpeg;
  ReliefCodeScratch relief;
  TexelCodeScratch texel_code;

  // The streams behind the head, packed if that makes them smaller.
  std::span<const uint8_t> pack(Packing raw, size_t head_bytes, size_t stream_bytes) {
    size_t packed =
        ZSTD_compress2(context, out.data() + head_bytes, out.size() - head_bytes, streams.data(), stream_bytes);
    out[0] = raw;
    if (ZSTD_isError(packed) || packed >= stream_bytes) {
      std::memcpy(out.data() + head_bytes, streams.data(), stream_bytes);
      packed = stream_bytes;
    } else {
      ++out[0];
    }
    return {out.data(), head_bytes + packed};
  }

  // Predictors and residual streams of three channels of kWidth^2; the predictors' numbers end the head.
  template <int kWidth = kSide>
  std::span<const uint8_t> encodeChannels(Packing raw, size_t head_bytes, const uint8_t* channels) {
    static constexpr uint8_t kZeros[kWidth] = {};
    uint8_t* stream = streams.data();
    for (int c = 0; c < 3; ++c) {
      const uint8_t* data = channels + c * kWidth * kWidth;
      Predictor p = choosePredictor<uint8_t, kWidth>(data, kWidth);
      out[head_bytes - 3 + c] = p;
      if (p == kConstant) {
        *stream++ = data[0];
        continue;
      }
      for (int y = 0; y < kWidth; ++y, stream += kWidth)
        predictRow<uint8_t, kWidth>(p, data + y * kWidth, y == 0 ? kZeros : data + (y - 1) * kWidth, stream);
    }
    return pack(raw, head_bytes, stream - streams.data());
  }

  // Empty: fewer texels do not show the page.
  template <int kFactor>
  std::span<const uint8_t> encodeCoarse(std::span<const uint8_t> channels,
                                        std::span<const ChannelTolerance> tolerances) {
    constexpr int kWidth = coarseSide(kFactor);
    const std::span coarse(levels.data(), size_t{3} * kWidth * kWidth);
    if (!reducePage(channels, kFactor, tolerances, coarse)) return {};
    out[1] = kFactor;
    return encodeChannels<kWidth>(kCoarseRaw, kCoarseHeadBytes, coarse.data());
  }

  std::span<const uint8_t> encodeQuantised(const uint8_t* channels, int bits) {
    const int top = (1 << bits) - 1;
    // 2 v top is even and 255 odd: no value lies halfway between two levels.
    for (size_t i = 0; i < kTexturePageBytes; ++i)
      levels[i] = static_cast<uint8_t>((2 * channels[i] * top + 255) / 510);
    out[1] = static_cast<uint8_t>(bits);
    return encodeChannels(kQuantisedRaw, kQuantisedHeadBytes, levels.data());
  }

  std::span<const uint8_t> encodeJpeg(const uint8_t* channels, PageEncoding encoding) {
    interleave(channels, texels.data());
    const bool ycc = encoding.codec == PageCodec::kJpegYcc;
    size_t n = jpeg.encode(texels.data(), encoding.parameter, ycc, {out.data() + kJpegHeadBytes, kTexturePageBytes});
    if (n == 0) return encodeChannels(kRaw, kTextureHeadBytes, channels);  // noise, and a quality near 100
    out[0] = kJpegFile;
    return {out.data(), kJpegHeadBytes + n};
  }

  std::span<const uint8_t> encodeBlocks(const uint8_t* channels, PageCodec codec) {
    interleave(channels, texels.data());
    encodePageBlocks(codec, texels.data(), {streams.data(), pageBlockBytes(codec)});
    out[1] = static_cast<uint8_t>(codec);
    return pack(kBlocksRaw, kBlocksHeadBytes, pageBlockBytes(codec));
  }
};

PageEncoder::PageEncoder(int zstd_level) : impl_(new Impl) {
  impl_->context = ZSTD_createCCtx();
  ZSTD_CCtx_setParameter(impl_->context, ZSTD_c_compressionLevel, zstd_level);
  ZSTD_CCtx_setParameter(impl_->context, ZSTD_c_contentSizeFlag, 0);  // known from the page's kind
  // Residuals are noise with a narrow histogram: nearly all of the gain is in the entropy coder, which zstd leaves out
  // at negative levels unless told otherwise.
  if (zstd_level < 0) ZSTD_CCtx_setParameter(impl_->context, ZSTD_c_literalCompressionMode, ZSTD_ps_enable);
  impl_->out.resize(kQuantisedHeadBytes +
                    std::max(ZSTD_compressBound(kTexturePageBytes), ZSTD_compressBound(kReliefBytes)));
}

std::vector<uint8_t> plainTexturePage(std::span<const uint8_t> channels) {
  assert(channels.size() == kTexturePageBytes);
  std::vector<uint8_t> out(kTextureHeadBytes + channels.size());
  out[0] = kRaw;
  std::fill(out.begin() + 1, out.begin() + kTextureHeadBytes, uint8_t{kNone});
  std::copy(channels.begin(), channels.end(), out.begin() + kTextureHeadBytes);
  return out;
}

PageEncoder::~PageEncoder() {
  ZSTD_freeCCtx(impl_->context);
  delete impl_;
}

std::span<const uint8_t> PageEncoder::encodeTexture(std::span<const uint8_t> channels, PageEncoding encoding) {
  assert(channels.size() == kTexturePageBytes);
  switch (encoding.codec) {
    case PageCodec::kLossless:
      break;
    case PageCodec::kQuantised:
      return impl_->encodeQuantised(channels.data(), encoding.parameter);
    case PageCodec::kJpeg:
    case PageCodec::kJpegYcc:
      return impl_->encodeJpeg(channels.data(), encoding);
    case PageCodec::kBc1:
    case PageCodec::kBc4:
    case PageCodec::kBc5:
    case PageCodec::kBc7:
      return impl_->encodeBlocks(channels.data(), encoding.codec);
  }
  return impl_->encodeChannels(kRaw, kTextureHeadBytes, channels.data());
}

std::span<const uint8_t> PageEncoder::encodeTextureWithin(std::span<const uint8_t> channels,
                                                          std::span<const ChannelTolerance> tolerances,
                                                          bool hierarchical) {
  constexpr size_t kSmall = 256;     // bytes: not worth the search
  constexpr size_t kFarSmaller = 2;  // fewer texels are seldom smaller still
  const auto lossless = encodeTexture(channels);
  if (lossless.size() <= kSmall) return lossless;
  std::vector<uint8_t>& kept = impl_->kept;
  kept.assign(lossless.begin(), lossless.end());
  if (hierarchical) {
    std::vector<uint8_t>& code = impl_->hierarchical;
    code.assign(1, kHierarchicalTexels);
    encodeTexelCode(channels, tolerances, impl_->texel_code, code);
    if (code.size() < kept.size()) {
      const bool far_smaller = kFarSmaller * code.size() < kept.size();
      kept.swap(code);
      if (far_smaller) return kept;
    }
  }
  static_assert(kCoarseFactors == std::array{4, 2});
  auto coarse = impl_->encodeCoarse<4>(channels, tolerances);
  if (coarse.empty()) coarse = impl_->encodeCoarse<2>(channels, tolerances);
  return coarse.empty() || coarse.size() >= kept.size() ? kept : coarse;
}

std::span<const uint8_t> PageEncoder::encodeRelief(std::span<const uint16_t> samples, ReliefEncoding encoding) {
  assert(samples.size() == kReliefPageSamples);
  if (encoding != ReliefEncoding::kRows) {
    if (encoding == ReliefEncoding::kBeyondTail && isAsItsTailShows(samples)) return {};
    const bool over_tail = encoding != ReliefEncoding::kHierarchical;
    impl_->hierarchical.assign(1, over_tail ? kOverTail : kHierarchical);
    if (over_tail) encodeReliefCodeOverTail(samples, impl_->relief, impl_->hierarchical);
    else encodeReliefCode(samples, impl_->relief, impl_->hierarchical);
    if (impl_->hierarchical.size() < kReliefBytes) return impl_->hierarchical;
  }
  static constexpr uint16_t kZeros[kReliefSamples] = {};
  uint8_t* stream = impl_->streams.data();
  Predictor p = choosePredictor<uint16_t, kReliefSamples>(samples.data(), kReliefSamples);
  impl_->out[1] = p;
  if (p == kConstant) {
    stream[0] = static_cast<uint8_t>(samples[0]);
    stream[1] = static_cast<uint8_t>(samples[0] >> 8);
    return impl_->pack(kRaw, kReliefHeadBytes, 2);
  }
  uint8_t *low = stream, *high = stream + kReliefPageSamples;
  for (int y = 0; y < kReliefSamples; ++y) {
    uint16_t residuals[kReliefSamples];
    const uint16_t* row = samples.data() + static_cast<size_t>(y) * kReliefSamples;
    predictRow<uint16_t, kReliefSamples>(p, row, y == 0 ? kZeros : row - kReliefSamples, residuals);
    for (int x = 0; x < kReliefSamples; ++x) {
      uint16_t folded = static_cast<uint16_t>((residuals[x] << 1) ^ (static_cast<int16_t>(residuals[x]) >> 15));
      low[x] = static_cast<uint8_t>(folded);
      high[x] = static_cast<uint8_t>(folded >> 8);
    }
    low += kReliefSamples;
    high += kReliefSamples;
  }
  return impl_->pack(kRaw, kReliefHeadBytes, kReliefBytes);
}

struct PageDecoder::Impl {
  ZSTD_DCtx* context = nullptr;
  std::array<uint8_t, std::max(kTexturePageBytes, kReliefBytes)> streams;
  std::array<uint8_t, kTexturePageBytes> channels;
  std::array<uint16_t, kReliefPageSamples> samples;
  std::array<uint8_t, kSlotBytes> texels;
  JpegPageDecoder jpeg;
  ReliefCodeScratch relief;
  TexelCodeScratch texel_code;

  // The streams, of exactly the size expected, into `out`.
  Result<void> unpack(bool zstd, std::span<const uint8_t> packed, std::span<uint8_t> out) {
    if (!zstd) {
      if (packed.size() != out.size()) return damaged("an encoded page has the wrong size");
      std::memcpy(out.data(), packed.data(), packed.size());
      return {};
    }
    size_t n = ZSTD_decompressDCtx(context, out.data(), out.size(), packed.data(), packed.size());
    if (ZSTD_isError(n)) return damaged("an encoded page does not decompress");
    if (n != out.size()) return damaged("an encoded page decompresses to the wrong size");
    return {};
  }
  template <int kWidth = kSide>
  Result<void> decodeChannels(bool zstd, std::span<const uint8_t> predictors, std::span<const uint8_t> packed,
                              uint8_t* out_channels);
  Result<void> decodeCoarse(std::span<const uint8_t> encoded, std::span<uint8_t> out_channels);
  Result<void> decodeBlocks(std::span<const uint8_t> encoded, uint8_t* out_texels);
};

PageDecoder::PageDecoder() : impl_(new Impl) { impl_->context = ZSTD_createDCtx(); }

PageDecoder::~PageDecoder() {
  ZSTD_freeDCtx(impl_->context);
  delete impl_;
}

template <int kWidth>
Result<void> PageDecoder::Impl::decodeChannels(bool zstd, std::span<const uint8_t> predictors,
                                               std::span<const uint8_t> packed, uint8_t* out_channels) {
  constexpr size_t kBytes = size_t{kWidth} * kWidth;
  size_t stream_bytes = 0;
  bool any_constant = false;
  for (int c = 0; c < 3; ++c) {
    if (predictors[c] >= kPredictorCount) return damaged("an encoded page names an unknown predictor");
    bool constant = predictors[c] == kConstant;
    any_constant |= constant;
    stream_bytes += constant ? 1 : kBytes;
  }
  // Without constant channels the streams have the channels' places: no copy.
  std::span<uint8_t> out(any_constant ? streams.data() : out_channels, stream_bytes);
  if (auto unpacked = unpack(zstd, packed, out); !unpacked) return unpacked;
  const uint8_t* stream = out.data();
  for (int c = 0; c < 3; ++c) {
    Predictor p = static_cast<Predictor>(predictors[c]);
    uint8_t* channel = out_channels + c * kBytes;
    if (p == kConstant) {
      std::memset(channel, *stream++, kBytes);
      continue;
    }
    if (any_constant) std::memcpy(channel, stream, kBytes);
    stream += kBytes;
    unpredict<uint8_t, kWidth>(p, channel, kWidth);
  }
  return {};
}

Result<void> PageDecoder::Impl::decodeCoarse(std::span<const uint8_t> encoded, std::span<uint8_t> out_channels) {
  if (encoded.size() < kCoarseHeadBytes) return damaged("an encoded page is too short");
  const int factor = encoded[1];
  if (std::find(kCoarseFactors.begin(), kCoarseFactors.end(), factor) == kCoarseFactors.end())
    return damaged("an encoded page has an unknown number of texels");
  auto decode = [&]<int kFactor>(std::integral_constant<int, kFactor>) -> Result<void> {
    constexpr int kWidth = coarseSide(kFactor);
    const std::span coarse(texels.data(), size_t{3} * kWidth * kWidth);
    if (auto decoded = decodeChannels<kWidth>(encoded[0] == kCoarseZstd, encoded.subspan(2, 3),
                                              encoded.subspan(kCoarseHeadBytes), coarse.data());
        !decoded)
      return decoded;
    enlargePage(coarse, kFactor, out_channels);
    return {};
  };
  return factor == 2 ? decode(std::integral_constant<int, 2>()) : decode(std::integral_constant<int, 4>());
}

Result<void> PageDecoder::Impl::decodeBlocks(std::span<const uint8_t> encoded, uint8_t* out_texels) {
  if (encoded.size() < kBlocksHeadBytes) return damaged("an encoded page is too short");
  const PageCodec codec = static_cast<PageCodec>(encoded[1]);
  const size_t bytes = pageBlockBytes(codec);
  if (bytes == 0) return damaged("an encoded page has blocks of an unknown kind");
  if (auto unpacked = unpack(encoded[0] == kBlocksZstd, encoded.subspan(kBlocksHeadBytes), {streams.data(), bytes});
      !unpacked)
    return unpacked;
  decodePageBlocks(codec, {streams.data(), bytes}, out_texels);
  return {};
}

Result<void> PageDecoder::decodeTexture(std::span<const uint8_t> encoded, std::span<uint8_t> channels) {
  assert(channels.size() == kTexturePageBytes);
  if (encoded.empty()) return damaged("an encoded page is empty");
  const uint8_t packing = encoded[0];
  if (isCoarse(packing)) return impl_->decodeCoarse(encoded, channels);
  if (packing == kHierarchicalTexels) {
    if (decodeTexelCode(encoded.subspan(1), impl_->texel_code, channels)) return {};
    return damaged("an encoded page of hierarchical texels has too few bytes or too many");
  }
  const bool quantised = packing == kQuantisedRaw || packing == kQuantisedZstd;
  if (packing > kQuantisedZstd) {  // those decode to texels
    if (auto decoded = decodeToSlot(Plane::kTexture0, encoded, impl_->texels); !decoded) return decoded;
    separate(impl_->texels.data(), channels.data());
    return {};
  }
  const size_t head = quantised ? kQuantisedHeadBytes : kTextureHeadBytes;
  if (encoded.size() < head) return damaged("an encoded page is too short");
  const int bits = quantised ? encoded[1] : 8;
  if (quantised && (bits < kMinQuantisedBits || bits > kMaxQuantisedBits))
    return damaged("an encoded page has an unknown number of bits");
  if (auto decoded =
          impl_->decodeChannels(packing & 1, encoded.subspan(head - 3, 3), encoded.subspan(head), channels.data());
      !decoded)
    return decoded;
  if (quantised) expandLevels(channels.data(), channels.size(), bits);
  return {};
}

bool needsTailHeights(std::span<const uint8_t> stored) {
  return !stored.empty() && (stored[0] == kOverTail || stored[0] == kOfTail);
}

std::vector<uint8_t> emptyReliefPage() { return {kOfTail}; }

void addTailHeights(std::span<const uint16_t> heights, std::vector<uint8_t>& stored) {
  assert(2 * heights.size() == kTailHeightsBytes && needsTailHeights(stored));
  stored.insert(stored.begin() + 1, kTailHeightsBytes, uint8_t{0});
  uint8_t* p = stored.data() + 1;
  for (const uint16_t h : heights) *p++ = static_cast<uint8_t>(h), *p++ = static_cast<uint8_t>(h >> 8);
}

Result<void> PageDecoder::decodeRelief(std::span<const uint8_t> encoded, std::span<uint16_t> samples) {
  assert(samples.size() == kReliefPageSamples);
  if (encoded.size() < kReliefHeadBytes) return damaged("an encoded page is too short");
  if (encoded[0] == kHierarchical) {
    if (decodeReliefCode(encoded.subspan(1), impl_->relief, samples)) return {};
    return damaged("an encoded page of hierarchical relief has too few bytes or too many");
  }
  if (encoded[0] == kOverTail || encoded[0] == kOfTail) {
    constexpr size_t kSamples = (1 << kTailCodeCellsLog2) + 1, kStep = kPagePx >> kTailCodeCellsLog2;
    static_assert(2 * kSamples * kSamples == kTailHeightsBytes);
    const uint8_t* p = encoded.data() + 1;
    if (encoded.size() < 1 + kTailHeightsBytes) return damaged("an encoded page lacks the heights of its tail");
    if (encoded[0] == kOfTail && encoded.size() == 1 + kTailHeightsBytes &&
        std::equal(p + 2, p + kTailHeightsBytes, p)) {  // all heights are the first
      std::fill(samples.begin(), samples.end(), static_cast<uint16_t>(p[0] | p[1] << 8));
      return {};
    }
    for (size_t y = 0; y < kSamples; ++y)
      for (size_t x = 0; x < kSamples; ++x, p += 2)
        samples[kStep * (y * kReliefSamples + x)] = static_cast<uint16_t>(p[0] | p[1] << 8);
    if (encoded[0] == kOfTail && encoded.size() == 1 + kTailHeightsBytes) {
      showTail(impl_->relief, samples);
      return {};
    }
    if (encoded[0] == kOverTail &&
        decodeReliefCodeOverTail(encoded.subspan(1 + kTailHeightsBytes), impl_->relief, samples))
      return {};
    return damaged("an encoded page over its tail has too few bytes or too many");
  }
  if (encoded[1] >= kPredictorCount) return damaged("an encoded page names an unknown predictor");
  if (encoded[0] > kZstd) return damaged("an encoded page is packed in an unknown way");
  Predictor p = static_cast<Predictor>(encoded[1]);
  std::span<uint8_t> streams(impl_->streams.data(), p == kConstant ? 2 : kReliefBytes);
  if (auto unpacked = impl_->unpack(encoded[0] == kZstd, encoded.subspan(kReliefHeadBytes), streams); !unpacked)
    return unpacked;
  if (p == kConstant) {
    std::fill(samples.begin(), samples.end(), static_cast<uint16_t>(streams[0] | streams[1] << 8));
    return {};
  }
  const uint8_t* __restrict low = streams.data(), * __restrict high = low + kReliefPageSamples;
  uint16_t* __restrict out = samples.data();
  for (size_t i = 0; i < kReliefPageSamples; ++i) {
    uint16_t folded = static_cast<uint16_t>(low[i] | high[i] << 8);
    out[i] = static_cast<uint16_t>((folded >> 1) ^ -(folded & 1));
  }
  unpredict<uint16_t, kReliefSamples>(p, out, kReliefSamples);
  return {};
}

void reliefSamples(std::span<const uint8_t> texels, std::span<uint16_t> samples) {
  assert(texels.size() == kSlotBytes && samples.size() == kReliefPageSamples);
  for (size_t j = 0; j < kReliefSamples; ++j) {
    const uint8_t* row = texels.data() + j * kPageFullPx * 4;
    for (size_t i = 0; i < kReliefSamples; ++i)
      samples[j * kReliefSamples + i] = static_cast<uint16_t>(row[4 * i] << 8 | row[4 * i + 1]);
  }
}

Result<void> PageDecoder::decodeToSlot(Plane plane, std::span<const uint8_t> encoded, std::span<uint8_t> texels) {
  assert(texels.size() == kSlotBytes);
  if (isTexturePlane(plane)) {
    if (encoded.empty()) return damaged("an encoded page is empty");
    if (encoded[0] == kJpegFile) return impl_->jpeg.decode(encoded.subspan(kJpegHeadBytes), texels.data());
    if (encoded[0] == kBlocksRaw || encoded[0] == kBlocksZstd) return impl_->decodeBlocks(encoded, texels.data());
    if (encoded[0] > kQuantisedZstd && !isCoarse(encoded[0]) && encoded[0] != kHierarchicalTexels)
      return damaged("an encoded page is packed in an unknown way");
    if (auto decoded = decodeTexture(encoded, impl_->channels); !decoded) return decoded;
    interleave(impl_->channels.data(), texels.data());
    return {};
  }
  assert(plane == Plane::kRelief);
  if (auto decoded = decodeRelief(encoded, impl_->samples); !decoded) return decoded;
  for (int j = 0; j < kSide; ++j) {
    uint8_t* row = texels.data() + static_cast<size_t>(j) * kSide * 4;
    int valid = j < kReliefSamples ? kReliefSamples : 0;
    const uint16_t* in = impl_->samples.data() + static_cast<size_t>(j) * kReliefSamples;
    for (int i = 0; i < valid; ++i) {
      uint32_t texel = static_cast<uint32_t>(in[i] >> 8) | static_cast<uint32_t>(in[i] & 0xFF) << 8;
      row[4 * i] = static_cast<uint8_t>(texel);
      row[4 * i + 1] = static_cast<uint8_t>(texel >> 8);
      row[4 * i + 2] = row[4 * i + 3] = 0;
    }
    std::memset(row + 4 * valid, 0, static_cast<size_t>(kSide - valid) * 4);
  }
  return {};
}

Result<void> PageDecoder::decodeToBlocks(PageCodec codec, std::span<const uint8_t> encoded, std::span<uint8_t> blocks) {
  assert(isBlockCodec(codec) && blocks.size() == pageBlockBytes(codec));
  if (encoded.size() < kBlocksHeadBytes || (encoded[0] != kBlocksRaw && encoded[0] != kBlocksZstd) ||
      encoded[1] != static_cast<uint8_t>(codec))
    return damaged("an encoded page does not hold the blocks that its plane should have");
  return impl_->unpack(encoded[0] == kBlocksZstd, encoded.subspan(kBlocksHeadBytes), blocks);
}

}  // namespace relievo
