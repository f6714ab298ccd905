// base_sheet.h - a scan that is one four-sided sheet (a panel, a relief slab's face): a grid of near-square quads over it.
#pragma once

#include <span>

#include "geometry/base_quads.h"
#include "geometry/base_rails.h"

namespace relievo {

// patches: about as many; 0: as few as are near-square. Empty where the scan is no such sheet: other than one border with four sharp
// turns and nearly straight sides between them.
QuadMesh sheetQuads(std::span<const Rail> rails, size_t pieces, const ScanLookup& scan, uint32_t patches);

}  // namespace relievo
