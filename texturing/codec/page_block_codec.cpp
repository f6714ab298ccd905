#include "texturing/codec/page_block_codec.h"

#include <cassert>
#include <cstring>

#include "texturing/codec/bc_blocks.h"

namespace relievo {
namespace {

constexpr size_t kRowBytes = size_t{4} * kPageFullPx;

// f(block number, first texel's byte in the page), rows top first.
template <class F>
void forEachBlock(F&& f) {
  for (size_t y = 0, i = 0; y < kBlocksPerSide; ++y)
    for (size_t x = 0; x < kBlocksPerSide; ++x, ++i) f(i, y * 4 * kRowBytes + x * 16);
}

// Of a channel's BC4 blocks: in its own set, or with its neighbour's in one of BC5.
struct Channel {
  size_t first, stride;
};
Channel channelBlocks(PageCodec codec, size_t c) {
  if (codec == PageCodec::kBc4) return {c * kPageBlocks * 8, 8};
  return c < 2 ? Channel{c * 8, 16} : Channel{kPageBlocks * 16, 8};
}

}  // namespace

void encodePageBlocks(PageCodec codec, const uint8_t* texels, std::span<uint8_t> blocks) {
  assert(blocks.size() == pageBlockBytes(codec));
  forEachBlock([&](size_t i, size_t at) {
    uint8_t block[64];
    for (size_t y = 0; y < 4; ++y) std::memcpy(block + 16 * y, texels + at + y * kRowBytes, 16);
    if (codec == PageCodec::kBc1) return encodeBc1(block, blocks.data() + 8 * i);
    if (codec == PageCodec::kBc7) return encodeBc7(block, blocks.data() + 16 * i);
    for (size_t c = 0; c < 3; ++c) {
      uint8_t values[16];
      for (size_t k = 0; k < 16; ++k) values[k] = block[4 * k + c];
      const Channel channel = channelBlocks(codec, c);
      encodeBc4(values, blocks.data() + channel.first + channel.stride * i);
    }
  });
}

void decodePageBlocks(PageCodec codec, std::span<const uint8_t> blocks, uint8_t* texels) {
  assert(blocks.size() == pageBlockBytes(codec));
  if (codec == PageCodec::kBc1) {
    forEachBlock([&](size_t i, size_t at) { decodeBc1(blocks.data() + 8 * i, texels + at, kRowBytes); });
    return;  // opaque already
  }
  if (codec == PageCodec::kBc7) {
    forEachBlock([&](size_t i, size_t at) { decodeBc7(blocks.data() + 16 * i, texels + at, kRowBytes); });
  } else {
    for (size_t c = 0; c < 3; ++c) {
      const Channel channel = channelBlocks(codec, c);
      forEachBlock([&](size_t i, size_t at) {
        decodeBc4(blocks.data() + channel.first + channel.stride * i, texels + at + c, 4, kRowBytes);
      });
    }
  }
  for (size_t i = 0; i < kRowBytes * kPageFullPx; i += 4) texels[i + 3] = 255;
}

}  // namespace relievo
