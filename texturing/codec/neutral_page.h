// neutral_page.h - the replacement for a page that could not be read or decoded.
#pragma once

#include <cstdint>

#include "src/artwork/basis.h"
#include "texturing/codec/page_encoding.h"
#include "texturing/codec/page_id.h"

namespace relievo {

// Writes a page of 128 grey under every light, or of relief at the lower end of its range; it replaces a damaged root.
// With a block codec it is as near to that as the codec allows. texels: as many bytes as a slot has (cache_budget.h).
void neutralPage(Plane plane, const TextureFormat& format, PageCodec upload, uint8_t* texels);

}  // namespace relievo
