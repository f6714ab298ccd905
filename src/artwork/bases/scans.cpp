// scans.cpp - the bases that are not linear: colour as it is, and albedo with the surface's normal.
#include "src/artwork/bases/bases.h"

namespace relievo {
namespace {

using enum BasisChannel::Holds;

constexpr BasisChannels kRgb{{{kColour, 0}, {kColour, 1}, {kColour, 2}}};
constexpr BasisChannels kRgbAndNormal{
    {{kColour, 0}, {kColour, 1}, {kColour, 2}, {kNormal, 0}, {kNormal, 1}, {kNormal, 2}}};

}  // namespace

constinit const BasisDescription kColourBasis{
    .name = "colour", .title = "an image", .shading = Shading::kColour, .planes = 1, .channels = kRgb};
constinit const BasisDescription kAlbedoNormalBasis{.name = "albedo-normal",
                                                    .title = "a scan",
                                                    .shading = Shading::kAlbedoNormal,
                                                    .planes = 2,
                                                    .channels = kRgbAndNormal};

}  // namespace relievo
