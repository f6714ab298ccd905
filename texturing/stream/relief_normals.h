// relief_normals.h - the normals of a flat artwork's displaced surface, as pages of a texture plane beside its colour.
// They are made of relief pages when they are asked for and are never stored, so that every package with relief can be
// lit.
//
// A texel's normal is that of the bilinear surface through the four relief samples at its corners, at its middle: level
// L of the texture takes level L of the relief, whose cells are its texels. Where the relief is coarser than the
// texture, the slopes of the relief's finest cells are interpolated bilinearly. A normal is n = (-dh/dx, -dh/dy, 1)
// made of length 1 (x right, y up), a byte b for b / 127.5 - 1, as in the normals of scans (basis.h). The border holds
// the neighbours' normals, so a page is made of up to nine relief pages: the last ones are kept. The dense reference,
// in double precision: tests/render/dense_reference.h.
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

// The surface whose normals are meant.
struct ReliefSurface {
  FlatDomain domain;      // with relief
  double exaggerate = 1;  // heights times this
};

// Called from several threads at once.
class ReliefNormals {
 public:
  static constexpr size_t kKeptPages = 64;
  // Of the relief pages that are kept.
  static constexpr uint64_t kKeptBytes = kKeptPages * sizeof(uint16_t) * kReliefSamples * kReliefSamples;

  explicit ReliefNormals(const ReliefSurface& surface) : surface_(surface) {}
  // Reads the samples of a relief page (kReliefSamples^2, rows top first); false: it cannot be had.
  using ReadRelief = std::function<bool(const NodeId&, std::span<uint16_t>)>;
  // The normal page of a node of the texture, as slot texels (kSlotBytes). False: a relief page cannot be had.
  bool make(const NodeId& node, const ReadRelief& read, uint8_t* texels) const;

 private:
  using Samples = std::shared_ptr<const std::vector<uint16_t>>;
  Samples samplesOf(const NodeId& node, const ReadRelief& read) const;

  const ReliefSurface surface_;
  mutable std::mutex mutex_;
  mutable std::list<std::pair<NodeId, Samples>> kept_;  // most recently used first
  mutable std::unordered_map<NodeId, std::list<std::pair<NodeId, Samples>>::iterator> places_;
};

}  // namespace relievo
