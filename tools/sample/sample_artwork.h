// sample_artwork.h - procedural relief artworks with known truth: any rectangle of any layer, at any size, in any
// order. A kind is a height field in mm plus albedo (sRGB) and gloss, defined over [0, 1] of the shorter side and
// scaled to the size asked for: a larger size shows finer detail. Normals are analytic or central differences of the
// height field in mm.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include "src/base/result.h"
#include "texturing/package/raster_source.h"

namespace relievo {

enum class SampleKind { kInscription, kCoin, kPainting };

struct SampleOptions {
  SampleKind kind = SampleKind::kInscription;
  int64_t width = 2048, height = 2048;
  uint64_t seed = 1;
};

class SampleArtwork {
 public:
  explicit SampleArtwork(const SampleOptions& options);
  ~SampleArtwork();
  const SampleOptions& options() const;
  double mmPerPx() const;
  double minMm() const;  // bounds of every height
  double maxMm() const;
  // Rectangles inside the artwork; thread-safe. heights: mm. albedo: sRGB 8 bit, 3 channels interleaved.
  void heights(const Rect& rect, std::span<float> out) const;
  void albedo(const Rect& rect, std::span<uint8_t> out) const;
  void normals(const Rect& rect, std::span<float> out) const;  // xyz interleaved, unit, +y up: central differences
  // What the shading needs beside (sample_shading.h): share of the sky seen, (0, 1]; gloss 0..1 and how strongly it
  // counts.
  void material(const Rect& rect, std::span<float> cavity, std::span<float> gloss) const;
  double glossStrength() const;

  // PTM of the artwork: coefficients fitted to its shading (Lambert, ambient occlusion-like cavity term, broad gloss),
  // without cast shadows.
  std::unique_ptr<TextureSource> ptmSource(Basis basis) const;  // kPtmLrgb or kPtmRgb; refers to this artwork
  std::unique_ptr<TextureSource> colourSource() const;
  std::unique_ptr<HeightSource> heightSource() const;

 private:
  friend class SamplePtmSource;
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

Result<SampleKind> parseSampleKind(const std::string& name);
const char* sampleKindName(SampleKind kind);

}  // namespace relievo
