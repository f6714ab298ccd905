// mesh_format_glb.h - glTF 2.0 as one binary file (Khronos glTF 2.0 specification, 4.4): the JSON chunk, padded with
// spaces to one length, then vertices (interleaved: position, normal, colour), then indices. Positions are floats from
// the origin, in mm; the node's scale and translation make metres of them, as glTF counts.
#pragma once

#include <memory>

#include "tools/export/mesh_format.h"

namespace relievo {

std::unique_ptr<MeshFormat> makeGlbFormat();

}  // namespace relievo
