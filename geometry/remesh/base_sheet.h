// base_sheet.h - base meshes of scans that are one four-sided sheet, such as a panel or the face of a relief slab: a
// grid of near-square quads. If one direction sees all of the sheet, it becomes every corner's normal, so that heights
// reach the steepest walls. Units: diagonals of the scan.
#pragma once

#include <atomic>
#include <span>

#include "geometry/remesh/base_topology.h"
#include "geometry/remesh/feature_curves.h"

namespace relievo {

struct QuadMesh;     // coarse_mesh.h
struct ScanSurface;  // base_quads.h

// patches: the approximate number. 0: as few near-square patches as possible, times `multiple` along each side. Empty
// if the scan is not a sheet, that is, not one border with four sharp turns and nearly straight sides between them.
QuadMesh sheetQuads(std::span<const FeatureCurve> curves, size_t pieces, const ScanSurface& scan, uint32_t patches,
                    uint32_t multiple = 1);

// A direction along which most of the surface faces.
struct ViewDirection {
  glm::dvec3 direction{0};
  double hidden = 1;  // share of the surface's area that faces away from it
  double flat = 0;    // projected over total area; 1: a plane across the direction
};
// The mean normal, or the coordinate axis nearest to it, whichever hides less: most scans that are height fields are so
// over an axis.
ViewDirection viewDirectionOf(std::span<const glm::vec3> points, std::span<const Triangle> triangles, int workers = 0,
                              const std::atomic<bool>* interrupted = nullptr);
// Is the surface a relief over a plane, visible along the direction but for noise? At least half of the area must be
// seen, so that heights may be steep, but not mostly.
inline bool isRelief(const ViewDirection& o) { return o.hidden <= 1e-4 && o.flat >= 0.5; }

}  // namespace relievo
