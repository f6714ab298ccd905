// base_sheet.h - a scan that is one four-sided sheet (a panel, a relief slab's face): a grid of near-square quads over
// it. Where one direction sees all of it from outside, that is every corner's normal: however steep its walls are,
// heights reach them.
#pragma once

#include <atomic>
#include <span>

#include "geometry/remesh/base_topology.h"
#include "geometry/remesh/feature_curves.h"

namespace relievo {

struct QuadMesh;    // coarse_mesh.h
struct ScanLookup;  // base_quads.h

// patches: about as many; 0: as few as are near-square, or so many times as many a side. Empty where the scan is no
// such sheet: other than one border with four sharp turns and nearly straight sides between them.
QuadMesh sheetQuads(std::span<const FeatureCurve> curves, size_t pieces, const ScanLookup& scan, uint32_t patches,
                    uint32_t times = 1);

// The direction that most of the surface faces along.
struct ViewDirection {
  glm::dvec3 direction{0};
  double hidden = 1;  // the part of the surface's area that faces away from it
  double flat = 0;    // what the direction sees of the area: 1: a plane across it
};
// The mean normal or the axis nearest to it, whichever hides less: scans that are height fields mostly are over an
// axis.
ViewDirection viewDirectionOf(std::span<const glm::vec3> points, std::span<const Triangle> triangles, int workers = 0,
                              const std::atomic<bool>* interrupted = nullptr);
// A relief over a plane, all of which is seen but for what noise hides. Heights may be steep, but not for the most
// part.
inline bool isRelief(const ViewDirection& o) { return o.hidden <= 1e-4 && o.flat >= 0.5; }

}  // namespace relievo
