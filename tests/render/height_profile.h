// height_profile.h - white artworks whose relief a formula gives: for tests of shadows, whose truth is analytic.
#pragma once

#include <algorithm>
#include <functional>
#include <utility>

#include "texturing/package/raster_source.h"

namespace relievo::test {

// side x side texels of white.
class WhiteTexels final : public TextureSource {
 public:
  explicit WhiteTexels(int64_t side) : side_(side) {}
  int64_t width() const override { return side_; }
  int64_t height() const override { return side_; }
  TextureFormat format() const override { return {}; }
  Provenance provenance() const override { return {}; }
  Result<void> read(const Rect&, std::span<uint8_t> out) const override {
    std::fill(out.begin(), out.end(), uint8_t{255});
    return {};
  }

 private:
  int64_t side_;
};

// mm above the lowest place; x to the right and y up from the centre.
using HeightProfile = std::function<double(double x_mm, double y_mm)>;

// side x side samples of it, 0.1 mm apart as denseSubject() has them.
class HeightsOfProfile final : public HeightSource {
 public:
  HeightsOfProfile(int64_t side, double highest_mm, HeightProfile profile)
      : side_(side), highest_mm_(highest_mm), profile_(std::move(profile)) {}
  int64_t width() const override { return side_; }
  int64_t height() const override { return side_; }
  double minMm() const override { return 0; }
  double maxMm() const override { return highest_mm_; }
  Provenance provenance() const override { return {}; }
  Result<void> read(const Rect& r, std::span<float> out) const override {
    constexpr double kMmPerPx = 0.1;
    const double middle = 0.5 * static_cast<double>(side_) - 0.5;
    size_t at = 0;
    for (int64_t y = r.y; y < r.y + r.height; ++y)
      for (int64_t x = r.x; x < r.x + r.width; ++x)
        out[at++] = static_cast<float>(
            profile_((static_cast<double>(x) - middle) * kMmPerPx, (middle - static_cast<double>(y)) * kMmPerPx));
    return {};
  }

 private:
  int64_t side_;
  double highest_mm_;
  HeightProfile profile_;
};

}  // namespace relievo::test
