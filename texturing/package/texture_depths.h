// texture_depths.h - does a coarser level of a patch's texture already show what a finer one has?
// A level that nothing finer differs from needs no pages (PatchDomain::textureDepths()): shaders show the coarser level
// there, or the patch's tail, by bilinear filtering. Pure: any thread.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "src/artwork/basis.h"
#include "texturing/codec/coarse_page.h"

namespace relievo {

// Steps of 8 bits by which a texel may differ from what is shown in its place. Two levels that are each rounded to
// bytes differ by up to one step even where both are exact.
inline constexpr double kTextureTolerance = 2;
// Single components of normals may differ by so many times as much: with the default by 8 steps of 1/127.5, or 3.6
// degrees. They differ most at creases, along a line.
inline constexpr double kNormalTolerance = 4;
// The root mean square of a channel's differences may be so many times the tolerance, for normals, too: with the
// default 1 step, or 0.45 degrees. Shallow relief that a light from the side shows differs everywhere, a crease along a
// line.
inline constexpr double kRmsTolerance = 0.5;

std::vector<ChannelTolerance> channelTolerances(const TextureFormat& format, double tolerance);

// Are all texels of a channel the same, as colours are of a scan that has none?
bool isEven(std::span<const uint8_t> texels);

// A patch's level with what lies around it, channel after channel, rows of v from 0.
struct BorderedLevel {
  std::span<const uint8_t> texels;  // channels * stride()^2
  size_t side = 0;                  // texels of the patch; a power of two
  size_t border = 0;                // on each side; at least 1
  size_t stride() const { return side + 2 * border; }
};

// Is each texel of `fine` within its channel's tolerance of what a bilinear filter of `coarse` gives at its centre, and
// so is the root mean square of these differences? The texels of its border next to the patch count as well: along a
// side, the patch then shows what its neighbour shows, be that from a page or from a coarser level. coarse.side <=
// fine.side. Exact: decides in integers.
bool showsTheSame(const BorderedLevel& fine, const BorderedLevel& coarse, std::span<const ChannelTolerance> tolerances);

}  // namespace relievo
