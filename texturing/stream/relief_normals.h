// relief_normals.h - normals of a flat artwork's displaced surface, as pages of a texture plane beside its colour. They
// are computed from relief pages on request and never stored, so that every package with relief can be lit.
//
// A texel's normal is that of the bilinear surface through the four relief samples at its corners, at its centre: level
// L of the texture takes level L of the relief, whose cells are its texels. Where the relief is coarser than the
// texture, the slopes of the relief's finest cells are interpolated bilinearly. A normal is n = (-dh/dx, -dh/dy, 1),
// scaled to length 1 (x right, y up); byte b stands for b / 127.5 - 1, as in the normals of scans (basis.h). A page
// with its border needs up to nine relief pages, so that the last ones are cached. The reference in double precision is
// tests/render/dense_reference.h.
#pragma once

#include <cstdint>
#include <functional>
#include <list>
#include <memory>
#include <mutex>
#include <span>
#include <unordered_map>
#include <utility>
#include <vector>

#include "src/artwork/node_id.h"
#include "src/artwork/patch_domain.h"

namespace relievo {

// The displaced surface.
struct ReliefSurface {
  FlatDomain domain;      // must have relief
  double exaggerate = 1;  // factor of the heights
};

// Called from several threads at once.
class ReliefNormals {
 public:
  static constexpr size_t kCachedPages = 64;
  // Memory of the cached relief pages.
  static constexpr uint64_t kCachedBytes = kCachedPages * sizeof(uint16_t) * kReliefSamples * kReliefSamples;

  explicit ReliefNormals(const ReliefSurface& surface) : surface_(surface) {}
  // Reads the samples of a relief page (kReliefSamples^2, rows top first). False: it is not available.
  using ReadRelief = std::function<bool(const NodeId&, std::span<uint16_t>)>;
  // Computes the normal page of a texture node, as slot texels (kSlotBytes). False: a relief page is not available.
  bool make(const NodeId& node, const ReadRelief& read, uint8_t* texels) const;

 private:
  using Samples = std::shared_ptr<const std::vector<uint16_t>>;
  Samples samplesOf(const NodeId& node, const ReadRelief& read) const;

  const ReliefSurface surface_;
  mutable std::mutex mutex_;
  mutable std::list<std::pair<NodeId, Samples>> cached_;  // most recently used first
  mutable std::unordered_map<NodeId, std::list<std::pair<NodeId, Samples>>::iterator> index_;
};

}  // namespace relievo
