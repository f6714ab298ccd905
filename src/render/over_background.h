// over_background.h - a picture without alpha, over a colour. Pure: no GL, any thread.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace relievo {

// rgba: sRGB, 4 bytes a pixel, colour not multiplied by alpha (Engine::readPixels()). Returns 3 bytes a pixel: the
// colour where alpha is 255, the background where it is 0, and between them both in linear light, in proportion to
// alpha.
std::vector<uint8_t> overBackground(std::span<const uint8_t> rgba, const std::array<uint8_t, 3>& background);

}  // namespace relievo
