// base_faces.h - a base mesh whose patches are the scan's own triangles: pairs of them, cut along the side that they
// share (BaseMesh::cut), and single ones with the middle of a side as their fourth corner. It is the scan, so that no
// heights are needed. For scans with sharp edges and thin parts, and coarse ones, whose triangles are about as large as
// patches.
// Units: those of the surface. Pure; the same input gives the same result.
#pragma once

#include <cstdint>
#include <span>

#include "geometry/remesh/base_topology.h"
#include "src/artwork/base_mesh.h"

namespace relievo {

// Of corners. kFaced: a direction that all triangles around it face as well as possible, for heights along it. kMean:
// where they all face it, the mean of their normals, weighted by their angles there, as a surface without heights is
// shaded; packages tell it from positions.
enum class FaceNormals : uint8_t { kFaced, kMean };

// Pairs fold by at most 40 degrees, as what shades smoothly does (geometry/bake/corner_normals.h), since texels across
// a crease are many, and by more only where there would be too many patches. look_of: of each triangle; two that look
// different are no pair, as its texels would mix them, but where there would be too many patches. Empty: all look
// alike. Has at most max_patches patches, or none if that is too few. workers: 0 is one for each core.
BaseMesh facesBase(const Surface& surface, uint32_t max_patches, FaceNormals normals = FaceNormals::kFaced,
                   std::span<const uint32_t> look_of = {}, int workers = 0);

}  // namespace relievo
