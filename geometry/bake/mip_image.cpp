#include "geometry/bake/mip_image.h"

#include <algorithm>
#include <cmath>

namespace relievo {

std::vector<uint8_t> halvedTexels(int width, int height, int channels, std::span<const uint8_t> texels) {
  const int half_width = (width + 1) / 2, half_height = (height + 1) / 2;
  const auto row = static_cast<size_t>(width) * static_cast<size_t>(channels);
  std::vector<uint8_t> half(static_cast<size_t>(half_width) * static_cast<size_t>(half_height) *
                            static_cast<size_t>(channels));
  uint8_t* out = half.data();
  for (int y = 0; y < half_height; ++y) {
    const uint8_t* a = texels.data() + static_cast<size_t>(2 * y) * row;
    const uint8_t* b = 2 * y + 1 < height ? a + row : a;
    for (int x = 0; x < half_width; ++x) {
      const size_t left = static_cast<size_t>(2 * x) * static_cast<size_t>(channels);
      const size_t right = 2 * x + 1 < width ? left + static_cast<size_t>(channels) : left;
      for (size_t c = 0; c < static_cast<size_t>(channels); ++c)
        *out++ = static_cast<uint8_t>((a[left + c] + a[right + c] + b[left + c] + b[right + c] + 2) >> 2);
    }
  }
  return half;
}

MipImage::MipImage(int width, int height, int channels, std::span<const uint8_t> texels, int levels, bool repeats)
    : channels_(channels), repeats_(repeats) {
  levels_.reserve(static_cast<size_t>(levels) + 1);
  levels_.push_back({width, height, texels, {}});
  while (static_cast<int>(levels_.size()) <= levels && (levels_.back().width > 1 || levels_.back().height > 1)) {
    const Level& fine = levels_.back();
    Level coarse{
        (fine.width + 1) / 2, (fine.height + 1) / 2, {}, halvedTexels(fine.width, fine.height, channels, fine.texels)};
    coarse.texels = coarse.own;
    levels_.push_back(std::move(coarse));
  }
}

void MipImage::add(const Level& level, float scale, const glm::vec2& position, float weight,
                   std::span<float> out) const {
  const float x = std::clamp(position.x * scale - 0.5f, 0.0f, static_cast<float>(level.width - 1));
  const float y = std::clamp(position.y * scale - 0.5f, 0.0f, static_cast<float>(level.height - 1));
  const int x0 = static_cast<int>(x), y0 = static_cast<int>(y), x1 = std::min(x0 + 1, level.width - 1),
            y1 = std::min(y0 + 1, level.height - 1);
  const float fx = x - static_cast<float>(x0), fy = y - static_cast<float>(y0);
  auto texel = [&](int i, int j) {
    return level.texels.data() + (static_cast<size_t>(j) * static_cast<size_t>(level.width) + static_cast<size_t>(i)) *
                                     static_cast<size_t>(channels_);
  };
  const uint8_t *a = texel(x0, y0), *b = texel(x1, y0), *c = texel(x0, y1), *d = texel(x1, y1);
  for (size_t k = 0; k < static_cast<size_t>(channels_); ++k)
    out[k] += weight * ((static_cast<float>(a[k]) * (1 - fx) + static_cast<float>(b[k]) * fx) * (1 - fy) +
                        (static_cast<float>(c[k]) * (1 - fx) + static_cast<float>(d[k]) * fx) * fy);
}

void MipImage::sample(const glm::vec2& uv, float lod, std::span<float> out) const {
  std::fill_n(out.begin(), channels_, 0.0f);
  auto within = [this](float x, int texels) {
    const float half = 0.5f / static_cast<float>(texels);
    return repeats_ && (x < -half || x > 1 + half) ? x - std::floor(x) : x;
  };
  const glm::vec2 position(within(uv.x, width()) * static_cast<float>(width()),
                           (1 - within(uv.y, height())) * static_cast<float>(height()));
  lod = std::clamp(std::isfinite(lod) ? lod : 0.0f, 0.0f, static_cast<float>(levels_.size() - 1));
  const int fine = static_cast<int>(lod);
  const float blend = lod - static_cast<float>(fine);
  add(levels_[static_cast<size_t>(fine)], std::ldexp(1.0f, -fine), position, 1 - blend, out);
  if (blend > 0) add(levels_[static_cast<size_t>(fine) + 1], std::ldexp(1.0f, -fine - 1), position, blend, out);
}

}  // namespace relievo
