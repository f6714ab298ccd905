// png_encoder.h - PNG files written by libpng, which is all that a picture takes: the module around OpenImageIO
// (image_io_module.h) needs longer to load than most pictures to draw.
#pragma once

#include <memory>

#include "src/base/result.h"
#include "texturing/import/image_io_module.h"

namespace relievo {

// Of 1 to 4 channels of 8 bits (marked as sRGB) or 16 bits (not marked); the same samples give the same bytes.
// bytes outlives the encoder. Errors: kUsage of sides that a PNG cannot have; what bytes reports; kIo where what was
// written does not decode to the same samples. Throws std::bad_alloc.
Result<std::unique_ptr<ImageEncoder>> createPngEncoder(const ImageEncoding& encoding, ImageBytes& bytes);

}  // namespace relievo
