// image_oiio.h - what the two users of OpenImageIO share: image_io_oiio.cpp, which reads, and image_encode_oiio.cpp,
// which writes and reads back. Nothing from OpenImageIO escapes them.
#pragma once

#include <OpenImageIO/imageio.h>

#include <cstdint>
#include <memory>
#include <span>

#include "texturing/import/image_io_module.h"

namespace relievo {

inline constexpr uint64_t kBandBytes = uint64_t{4} << 20;  // as many rows as fit, at least one (or one row of tiles)

// Pixels as stored: no premultiplication, no palette or alpha magic.
inline OIIO::ImageSpec openConfig() {
  OIIO::ImageSpec config;
  config.attribute("oiio:UnassociatedAlpha", 1);
  return config;
}

// As ImageIoModule has them.
Result<std::unique_ptr<ImageEncoder>> createOiioEncoder(const ImageEncoding& encoding, ImageBytes& bytes);
void halvesFromFloatsByOiio(std::span<const float> floats, uint16_t* halves);

}  // namespace relievo
