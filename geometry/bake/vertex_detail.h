// vertex_detail.h - how much of a scan's surface only its own vertices tell. Pure.
#pragma once

#include "geometry/mesh/tri_mesh.h"

namespace relievo {

// How far vertices lie from the mean of their neighbours, along their normals: the root mean square, in the mesh's unit
// (the umbrella operator: Taubin 1995, "A signal processing approach to fair surface design"). Where it is far above
// the distance that is promised, no surface of fewer samples than vertices keeps that; where it is below, the scan has
// more triangles than its shape needs.
double vertexDetail(const TriMesh& mesh);

}  // namespace relievo
