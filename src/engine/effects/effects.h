// effects.h - the effects that the program is built with, each defined in the file of this folder that has its name.
#pragma once

#include "src/engine/effects/pixel_effect.h"

namespace relievo {

extern const PixelEffect kExposureEffect;
extern const PixelEffect kPagesEffect, kLodEffect;

}  // namespace relievo
