// sample_kinds.h - what an artwork's kind answers: layers over a block.
#pragma once

#include <memory>

#include "tools/sample/sample_artwork.h"
#include "tools/sample/sample_noise.h"

namespace relievo::sample {

// Layers of one block, and room to compute them in. One per thread.
struct Layers {
  Plane height;            // mm
  Plane red, green, blue;  // sRGB, 0..255 (may overshoot; the reader clamps)
  Plane cavity;            // 0.35..1: how much of the sky a place sees
  Plane gloss;             // 0..1
  Plane tmp[8];
  std::vector<int> found;
  std::shared_ptr<void> memo;  // a kind's own
};

class Kind {
 public:
  virtual ~Kind() = default;
  double short_mm = 1;  // the artwork's shorter side
  float min_mm = 0, max_mm = 0;
  // What the light does, beside Lambert: a broad highlight of this strength at gloss 1, in the albedo's colour (metal)
  // or white.
  float gloss_strength = 0;
  bool metal = false;
  // height always; the rest when colour is asked for.
  virtual void eval(const Block& b, bool colour, Layers& out) const = 0;
};

inline constexpr float kMinCavity = 0.35f;

std::unique_ptr<Kind> makeInscription(const SampleOptions& options);
std::unique_ptr<Kind> makeCoin(const SampleOptions& options);
std::unique_ptr<Kind> makePainting(const SampleOptions& options);

}  // namespace relievo::sample
