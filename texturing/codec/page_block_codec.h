// page_block_codec.h - a texture page as blocks of 4 x 4 texels, in the order in which a GPU takes them.
// One set of kPageBlocks blocks, rows top first, for BC1 (8 bytes a block) and BC7 (16); three sets, one a channel, for
// BC4 (8); a set of BC5 for channels 0 and 1 (16), then one of BC4 for channel 2, for kBc5. A page's border of 4 is one
// row of blocks, so neighbouring pages hold the same blocks along their edge: no seams.
#pragma once

#include <cstdint>
#include <span>

#include "src/artwork/patch_domain.h"
#include "texturing/codec/page_encoding.h"

namespace relievo {

inline constexpr int kBlocksPerSide = kPageFullPx / 4;
inline constexpr size_t kPageBlocks = size_t{kBlocksPerSide} * kBlocksPerSide;  // 1156
static_assert(kPageFullPx % 4 == 0 && kPageBorderPx % 4 == 0);
inline constexpr size_t pageBlockBytes(PageCodec codec) { return kPageBlocks * static_cast<size_t>(blockBytes(codec)); }
inline constexpr size_t kMaxPageBlockBytes = pageBlockBytes(PageCodec::kBc5);

// texels: kPageFullPx^2 RGBA8, alpha ignored when encoding and 255 when decoded; blocks: pageBlockBytes(codec).
void encodePageBlocks(PageCodec codec, const uint8_t* texels, std::span<uint8_t> blocks);
void decodePageBlocks(PageCodec codec, std::span<const uint8_t> blocks, uint8_t* texels);

}  // namespace relievo
