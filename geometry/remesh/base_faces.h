// base_faces.h - a base mesh whose patches are the scan's own triangles: pairs of them, cut along the side that they
// share (BaseMesh::cut), and single ones with the middle of a side as their fourth corner. It is the scan, so that no
// heights are needed. For scans with sharp edges and thin parts, and coarse ones, whose triangles are about as large as
// patches.
// Units: those of the surface. Pure; the same input gives the same result.
#pragma once

#include <cstdint>

#include "geometry/remesh/base_topology.h"
#include "src/artwork/base_mesh.h"

namespace relievo {

// Of corners. kFaced: a direction that all triangles around it face as well as possible, for heights along it. kMean:
// where they all face it, the mean of their normals, weighted by their angles there, as a surface without heights is
// shaded; packages tell it from positions.
enum class FaceNormals : uint8_t { kFaced, kMean };

// Pairs fold by at most 20 degrees, since texels across a crease are many, and by more only where there would be too
// many patches. Has at most max_patches patches, or none if that is too few.
BaseMesh facesBase(const Surface& surface, uint32_t max_patches, FaceNormals normals = FaceNormals::kFaced);

}  // namespace relievo
