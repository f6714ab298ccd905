// made_pages.h - artworks over a base mesh whose pages are made when they are asked for, from functions of the place in
// a patch.
#pragma once

#include <cmath>
#include <memory>
#include <vector>

#include "src/artwork/base_mesh.h"
#include "texturing/codec/page_codec.h"
#include "texturing/package/package.h"

namespace relievo::test {

// sample(u, v): 16 bits at a place of the node's patch, 0..1 in it.
template <class Sample>
EncodedPage madeReliefPage(const NodeId& n, Sample&& sample) {
  const double nodes = std::ldexp(1.0, static_cast<int>(n.level));
  std::vector<uint16_t> samples(kReliefPageSamples);
  for (size_t j = 0; j < kReliefSamples; ++j)
    for (size_t i = 0; i < kReliefSamples; ++i)
      samples[j * kReliefSamples + i] =
          sample((n.x + static_cast<double>(i) / kPagePx) / nodes, (n.y + static_cast<double>(j) / kPagePx) / nodes);
  PageEncoder encoder(1);
  const auto bytes = encoder.encodeRelief(samples);
  return {{bytes.begin(), bytes.end()}};
}
inline EncodedPage madeTexturePage(const std::vector<uint8_t>& channels /* kTexturePageBytes */) {
  PageEncoder encoder(1);
  const auto bytes = encoder.encodeTexture(channels);
  return {{bytes.begin(), bytes.end()}};
}

// Albedo and normals, 0.15 mm a texel, heights from 0 to relief_mm.
inline Manifest madeManifest(std::shared_ptr<const BaseMesh> base, int texture_depth, int relief_depth,
                             double relief_mm) {
  Manifest m;
  m.texture.basis = Basis::kAlbedoNormal;
  m.domain = PatchDomain::overMesh(static_cast<uint32_t>(base->patches.size()));
  m.domain.texture_depth = texture_depth;
  m.domain.relief_depth = relief_depth;
  m.domain.mm_per_px = 0.15;
  m.domain.relief_scale_mm = relief_mm / 65535;
  m.base = std::move(base);
  return m;
}

}  // namespace relievo::test
