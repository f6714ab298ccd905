// bases.h - the descriptions that the program is built with, each defined in a file of this folder.
#pragma once

#include "src/artwork/basis.h"

namespace relievo {

extern const BasisDescription kColourBasis, kAlbedoNormalBasis;  // scans.cpp
extern const BasisDescription kPtmLrgbBasis, kPtmRgbBasis;       // ptm.cpp

}  // namespace relievo
