#include "src/engine/effects/effects.h"

namespace relievo {

const PixelEffect kLodEffect{
    .name = "lod", .help = "levels of detail of the patches", .stage = PixelEffect::Stage::kOverlay};

}  // namespace relievo
