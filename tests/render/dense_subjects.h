// dense_subjects.h - artworks for the tests of "virtual equals dense": the oracle's own pages, at any size, without
// builder and file.
#pragma once

#include "tests/render/test_artwork.h"
#include "tests/render/virtual_equals_dense.h"

namespace relievo::test {

// finer: levels that the relief has beyond the texture's.
inline Subject denseSubject(const TextureSource& texture, const HeightSource* heights, int finer = 0) {
  FlatDomain domain = denseDomain(texture, heights, 0.1);
  if (heights != nullptr) domain.relief_depth += finer;
  Subject s;
  auto dense = buildDenseTexture(texture, domain);
  EXPECT_TRUE(dense.ok());
  s.texture = std::make_shared<DenseTexture>(std::move(*dense));
  s.artwork.manifest.domain = domain;
  s.artwork.manifest.texture = texture.format();
  if (heights != nullptr) {
    auto relief = buildDenseRelief(*heights, domain);
    EXPECT_TRUE(relief.ok());
    s.relief = std::make_shared<DenseRelief>(std::move(*relief));
    s.artwork.oracle = denseReliefBounds(*s.relief, domain);
  }
  s.artwork.source = densePages(s.texture, s.relief);
  return s;
}

// Noise whose channels another format reads.
class FormattedNoise final : public TextureSource {
 public:
  FormattedNoise(int64_t w, int64_t h, const TextureFormat& format, uint32_t seed)
      : noise_(w, h, format.basis, seed), format_(format) {}
  int64_t width() const override { return noise_.width(); }
  int64_t height() const override { return noise_.height(); }
  TextureFormat format() const override { return format_; }
  Provenance provenance() const override { return noise_.provenance(); }
  Result<void> read(const Rect& r, std::span<uint8_t> out) const override { return noise_.read(r, out); }

 private:
  NoiseTexture noise_;
  TextureFormat format_;
};

// range_mm 0: no relief.
inline Subject noiseSubject(int64_t w, int64_t h, Basis basis, double range_mm, uint32_t seed) {
  NoiseHeight heights(w, h, range_mm, seed + 100);
  return denseSubject(NoiseTexture(w, h, basis, seed), range_mm > 0 ? &heights : nullptr);
}

// The same, made once a program.
inline const Subject& noiseSubjectOnce(int64_t w, int64_t h, Basis basis, double range_mm, uint32_t seed) {
  static std::map<std::tuple<int64_t, int64_t, Basis, double, uint32_t>, Subject> all;
  Subject& made = all[{w, h, basis, range_mm, seed}];
  if (!made.texture) made = noiseSubject(w, h, basis, range_mm, seed);
  return made;
}

// Sizes that no memory holds: the texture repeats, its pages are made when asked for.
inline Subject periodicSubject(int64_t w, int64_t h, Basis basis) {
  NoiseTexture period(512, 512, basis, 77);
  const auto width = static_cast<uint64_t>(w), height = static_cast<uint64_t>(h);
  FlatDomain domain;
  domain.width_px = width;
  domain.height_px = height;
  domain.mm_per_px = 0.01;
  domain.texture_depth = FlatDomain::depthFor(width, height);
  Subject s;
  auto dense = buildPeriodicTexture(period, domain);
  EXPECT_TRUE(dense.ok());
  s.texture = std::make_shared<DenseTexture>(std::move(*dense));
  s.artwork.manifest.domain = domain;
  s.artwork.manifest.texture = period.format();
  s.artwork.source = densePages(s.texture, nullptr);
  return s;
}

}  // namespace relievo::test
