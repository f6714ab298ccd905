// relief_normals.h - normals of a flat artwork's displaced surface, as pages of a texture plane beside its colour, or
// in its place one number of the surface (ReliefQuantity). They are computed from relief pages on request and never
// stored, so that every package with relief can be lit and measured.
//
// A texel's normal is that of the bilinear surface through the four relief samples at its corners, at its centre: level
// L of the texture takes level L of the relief, whose cells are its texels. Where the relief is coarser than the
// texture, the slopes of the relief's finest cells are interpolated bilinearly. A normal is n = (-dh/dx, -dh/dy, 1),
// scaled to length 1 (x right, y up); byte b stands for b / 127.5 - 1, as in the normals of scans (basis.h). A page
// with its border needs up to nine relief pages, so that the last ones are cached. The reference in double precision is
// tests/render/dense_reference.h.
//
// A number takes 16 bits of a texel, its high byte in red and its low byte in green; green's and red's filters are
// linear, so that 256 red + green of filtered channels is the filtered number (reliefNumber()). Slopes follow from the
// gradient above. Heights are the mean of a cell's four samples, interpolated as slopes are.
//
// Curvature at the scale of a radius r is the mean curvature H, in 1/mm, above 0 on ridges. Of cells whose middles lie
// within r of a place let h_r be the mean height and m_r the mean square of the distance. The height of a surface near
// a place is h + g.x + x'Mx/2, and of that mean h_r = h + m_r trace(M) / 4, for a set of cells that has a square's
// symmetry. So H = -trace(M) / 2 = -2 (h_r - h_s) / (m_r - m_s), with s = r / 2. It is exact where heights are
// quadratic. Both means leave out what is finer than s; a single height in the place of h_s would let each sample's
// noise through. That is the curvature of small slopes: where the relief is steep, it weighs heights, not normals. A
// radius below kLeastRadius cells counts as that many, and beyond kMostRadius cells a coarser level of the relief
// serves.
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

enum class ReliefQuantity {
  kNormal,
  kSlope,      // of the steepest way, 0 .. 90 degrees
  kCurvature,  // times radius_mm, -kMostCurvature .. kMostCurvature
  kHeight      // the relief's own 16 bits: mm = relief_offset_mm + number * relief_scale_mm
};

// The displaced surface.
struct ReliefSurface {
  FlatDomain domain;      // must have relief
  double exaggerate = 1;  // factor of the heights; those of kHeight stay as they are
  ReliefQuantity quantity = ReliefQuantity::kNormal;
  double radius_mm = 0;  // of kCurvature
};

inline constexpr double kMostCurvature = 2;
inline constexpr double kLeastRadius = 1.5, kMostRadius = 48;  // cells

// From the filtered channels red and green, 0..255, to degrees, curvature times the radius, or relief units.
double reliefNumber(ReliefQuantity quantity, double red, double green);

// Called from several threads at once.
class ReliefNormals {
 public:
  static constexpr size_t kCachedPages = 64;
  // Memory of the cached relief pages.
  static constexpr uint64_t kCachedBytes = kCachedPages * sizeof(uint16_t) * kReliefSamples * kReliefSamples;

  explicit ReliefNormals(const ReliefSurface& surface) : surface_(surface) {}
  // Reads the samples of a relief page (kReliefSamples^2, rows top first). False: it is not available.
  using ReadRelief = std::function<bool(const NodeId&, std::span<uint16_t>)>;
  // Computes the page of a texture node, as slot texels (kSlotBytes). False: a relief page is not available.
  bool make(const NodeId& node, const ReadRelief& read, uint8_t* texels) const;

 private:
  using Samples = std::shared_ptr<const std::vector<uint16_t>>;
  struct Cells;
  template <class Take>
  bool readCells(const Cells& cells, const ReadRelief& read, Take take) const;
  bool makeGradients(const NodeId& node, const ReadRelief& read, uint8_t* texels) const;
  bool makeHeights(const NodeId& node, const ReadRelief& read, uint8_t* texels) const;
  bool makeCurvatures(const NodeId& node, const ReadRelief& read, uint8_t* texels) const;
  Samples samplesOf(const NodeId& node, const ReadRelief& read) const;

  const ReliefSurface surface_;
  mutable std::mutex mutex_;
  mutable std::list<std::pair<NodeId, Samples>> cached_;  // most recently used first
  mutable std::unordered_map<NodeId, std::list<std::pair<NodeId, Samples>>::iterator> index_;
};

}  // namespace relievo
