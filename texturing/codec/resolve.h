// resolve.h - one page under a fixed light: coefficient planes in, display colour out; once per page instead of once
// per pixel and frame. The single-precision counterpart of basis.h, per texel.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "src/artwork/basis.h"

namespace relievo {

// light: the unit vector towards the light, in the artwork's space.
// slots: the format's planes as slot texels (RGBA8, kSlotBytes each); out: kSlotBytes.
void resolvePage(const TextureFormat& format, const std::array<double, 3>& light, std::span<const uint8_t* const> slots,
                 uint8_t* out);

}  // namespace relievo
