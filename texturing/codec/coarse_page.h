// coarse_page.h - texture pages in fewer texels: a square of `factor` x `factor` texels is one, and a bilinear filter
// gives the page back (texturing/PACKAGE.md, "Fewer texels"). For pages that show little at their own resolution,
// between the patches' tails and pages in full. All in integers: the same texels on every machine.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "src/artwork/patch_domain.h"

namespace relievo {

// By how much a texel may differ, and the root mean square of a channel's differences; steps of 8 bits.
struct ChannelTolerance {
  double most = 0, rms = 0;
};

// At the last texels within a page's edge and the first ones beyond, between which the edge is filtered, so that two
// neighbours that are both stored so differ there by the tolerance at most.
inline constexpr double kEdgeShare = 0.5;
inline constexpr std::array<int, 2> kCoarseFactors{4, 2};  // the fewest texels first
constexpr int coarseSide(int factor) { return kPageFullPx / factor; }
static_assert(kPageFullPx % 4 == 0);

// Is what is shown of a channel within the tolerance, and at the page's edge within kEdgeShare of it? Of kPageFullPx^2.
bool isWithin(const uint8_t* channel, const uint8_t* shown, const ChannelTolerance& tolerance);
// coarse: three channels of coarseSide(factor)^2, channels: of kPageFullPx^2; rows top first.
void enlargePage(std::span<const uint8_t> coarse, int factor, std::span<uint8_t> channels);
// The texels from which enlargePage() gives `channels` within the tolerances, and at the page's edge within kEdgeShare
// of them. False: none were found.
bool reducePage(std::span<const uint8_t> channels, int factor, std::span<const ChannelTolerance> tolerances /* 3 */,
                std::span<uint8_t> coarse);

}  // namespace relievo
