// neutral_page.h - what stands in for a page that could not be had.
#pragma once

#include <cstdint>

#include "src/artwork/basis.h"
#include "texturing/codec/page_encoding.h"
#include "texturing/codec/page_id.h"

namespace relievo {

// What shows in place of a damaged root: 128 grey under every light, or relief at the lower end of its range. As
// blocks: as near to that as the codec comes. texels: as many bytes as a slot has (cache_budget.h).
void neutralPage(Plane plane, const TextureFormat& format, PageCodec upload, uint8_t* texels);

}  // namespace relievo
