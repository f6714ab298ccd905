// One encoded page: lossless, quantised, JPEG or blocks, texture or relief (the first byte's lowest bit). What decodes,
// decodes alike by every way.
#include <cstring>
#include <vector>

#include "tests/fuzz/fuzz_file.h"
#include "texturing/codec/page_block_codec.h"
#include "texturing/codec/page_codec.h"
#include "texturing/codec/relief_compact.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace relievo;
  if (size == 0) return 0;
  static PageDecoder decoder;
  const bool relief = data[0] & 1;
  // A copy of its own, so that reading beyond its end is seen.
  const std::vector<uint8_t> page(data + 1, data + size);
  std::vector<uint8_t> texels(kSlotBytes);
  auto to_slot = decoder.decodeToSlot(relief ? Plane::kRelief : Plane::kTexture0, page, texels);
  if (!to_slot) fuzz::requireExplained(to_slot.error());
  if (relief) {
    std::vector<uint16_t> samples(kReliefPageSamples);
    auto decoded = decoder.decodeRelief(page, samples);
    fuzz::require(static_cast<bool>(decoded) == static_cast<bool>(to_slot),
                  "relief decodes by one way and not by the other");
    if (!decoded) return 0;
    for (int j = 0; j < kReliefSamples; ++j)
      for (int i = 0; i < kReliefSamples; ++i) {
        const uint8_t* t = &texels[4 * (static_cast<size_t>(j) * kPageFullPx + static_cast<size_t>(i))];
        fuzz::require(samples[static_cast<size_t>(j) * kReliefSamples + static_cast<size_t>(i)] == (t[0] << 8 | t[1]),
                      "slot texels differ from samples");
      }
    for (const int cells : {128, 64, 32}) {
      const auto count = compactTexels(texels, cells);
      if (!count) continue;
      std::vector<uint8_t> packed(size_t{4} * *count);
      packCompact(texels, cells, packed);
      const int step = 128 / cells;
      for (int y = 0; y <= cells; y += 3)
        for (int x = 0; x <= cells; ++x)
          fuzz::require(
              compactSample(packed, cells, x, y) == samples[static_cast<size_t>(y * step * kReliefSamples + x * step)],
              "a compact sample differs");
    }
    return 0;
  }
  std::vector<uint8_t> channels(kTexturePageBytes);
  auto decoded = decoder.decodeTexture(page, channels);
  fuzz::require(static_cast<bool>(decoded) == static_cast<bool>(to_slot),
                "a texture page decodes by one way and not by the other");
  if (decoded) {
    constexpr size_t kTexels = size_t{kPageFullPx} * kPageFullPx;
    for (size_t i = 0; i < kTexels; ++i)
      for (size_t c = 0; c < 3; ++c)
        fuzz::require(channels[c * kTexels + i] == texels[4 * i + c], "slot texels differ from channels");
  }
  for (const PageCodec codec : {PageCodec::kBc1, PageCodec::kBc4, PageCodec::kBc5, PageCodec::kBc7}) {
    std::vector<uint8_t> blocks(pageBlockBytes(codec)), from_blocks(kSlotBytes);
    if (!decoder.decodeToBlocks(codec, page, blocks)) continue;
    fuzz::require(static_cast<bool>(to_slot), "blocks, and no texels");
    decodePageBlocks(codec, blocks, from_blocks.data());
    fuzz::require(from_blocks == texels, "blocks give other texels");
  }
  return 0;
}
