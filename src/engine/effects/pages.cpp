#include "src/engine/effects/effects.h"

namespace relievo {

const PixelEffect kPagesEffect{.name = "pages",
                               .help = "texture levels, red lines where finer pages are still to come",
                               .stage = PixelEffect::Stage::kOverlay};

}  // namespace relievo
