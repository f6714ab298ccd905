#include "texturing/codec/neutral_page.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "texturing/codec/page_block_codec.h"
#include "texturing/codec/page_codec.h"

namespace relievo {

namespace {

constexpr uint8_t kGrey = 128;

// What a channel has where the pixel is grey under every light.
uint8_t neutralChannel(const BasisChannel& channel, const TextureFormat& format) {
  switch (channel.holds) {
    case BasisChannel::Holds::kNothing:
    case BasisChannel::Holds::kColour:
      break;
    case BasisChannel::Holds::kCoefficient: {
      const size_t k = channel.coefficient;
      const double whole = channel.of == BasisChannel::kLuminance ? 255 : kGrey;
      const double scale = format.scale[k] != 0 ? format.scale[k] : 1;
      const double value = whole * describe(format.basis).one[k];
      return static_cast<uint8_t>(std::clamp(std::round(value / scale + format.bias[k]), 0.0, 255.0));
    }
    case BasisChannel::Holds::kNormal:
      // Towards +z: nothing suits every side of a body, and no normal at all is nearly black.
      return channel.of == 2 ? 255 : 128;
  }
  return kGrey;
}

}  // namespace

void neutralPage(Plane plane, const TextureFormat& format, PageCodec upload, uint8_t* texels) {
  std::array<uint8_t, 4> texel{kGrey, kGrey, kGrey, 255};
  if (plane == Plane::kRelief) {
    texel = {};
  } else if (isTexturePlane(plane)) {
    const BasisChannel* channels = describe(format.basis).channels.data() + 3 * texturePlaneIndex(plane);
    for (size_t c = 0; c < 3; ++c) texel[c] = neutralChannel(channels[c], format);
  }
  for (size_t i = 0; i < kSlotBytes; ++i) texels[i] = texel[i & 3];
  if (!isBlockCodec(upload) || !isTexturePlane(plane)) return;
  const std::vector<uint8_t> page(texels, texels + kSlotBytes);
  encodePageBlocks(upload, page.data(), {texels, pageBlockBytes(upload)});
}

}  // namespace relievo
