#include "texturing/codec/neutral_page.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "texturing/codec/page_block_codec.h"
#include "texturing/codec/page_codec.h"

namespace relievo {

void neutralPage(Plane plane, const TextureFormat& format, PageCodec upload, uint8_t* texels) {
  std::array<uint8_t, 4> texel{128, 128, 128, 255};
  auto raw = [&](int k, double value) {
    double scale = format.scale[k] != 0 ? format.scale[k] : 1;
    return static_cast<uint8_t>(std::clamp(std::round(value / scale + format.bias[k]), 0.0, 255.0));
  };
  int k = static_cast<int>(plane);
  if (plane == Plane::kRelief) {
    texel = {};
  } else if (isTexturePlane(plane) && format.basis == Basis::kPtmLrgb && k < 2) {
    for (int c = 0; c < 3; ++c) texel[c] = raw(3 * k + c, 3 * k + c == 5 ? 255 : 0);
  } else if (isTexturePlane(plane) && format.basis == Basis::kPtmRgb && k < 6) {
    for (int c = 0; c < 3; ++c) texel[c] = raw(k, k == 5 ? 128 : 0);
  } else if (isTexturePlane(plane) && format.basis == Basis::kAlbedoNormal && k == 1) {
    texel = {128, 128, 255,
             255};  // towards +z: nothing suits every side of a body, and no normal at all is nearly black
  }
  for (size_t i = 0; i < kSlotBytes; ++i) texels[i] = texel[i & 3];
  if (!isBlockCodec(upload) || !isTexturePlane(plane)) return;
  const std::vector<uint8_t> page(texels, texels + kSlotBytes);
  encodePageBlocks(upload, page.data(), {texels, pageBlockBytes(upload)});
}

}  // namespace relievo
