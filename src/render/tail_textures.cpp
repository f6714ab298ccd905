#include "src/render/tail_textures.h"

#include <algorithm>
#include <vector>

namespace relievo {
namespace {

// Words that a texel of the table has: shaders fetch two planes at once where they come in pairs (TAIL_WORDS of
// shaders/tails.glsl).
uint64_t wordsOf(uint64_t planes) { return planes % 2 == 0 ? 2 : 1; }
uint64_t texelsOf(uint64_t patches, uint64_t planes) {
  return patches * kTailBlockAt[kTailLevels] * (planes / wordsOf(planes));
}

}  // namespace

uint64_t TailTextures::maxPatches(int planes) {
  const uint64_t a_patch = texelsOf(1, static_cast<uint64_t>(std::max(planes, 1))),
                 rows = TexelTable::mostRowTexels() / a_patch, buffer = TexelTable::mostBufferTexels();
  return buffer == 0 ? rows : std::min(rows, buffer / kTailBlockHeights);
}

TailTextures::TailTextures(const PatchTails& tails)
    : patches_(tails.patches),
      rows_(TexelTable::mostBufferTexels() > 0 &&
            texelsOf(tails.patches, static_cast<uint64_t>(tails.channels) / 3) > TexelTable::mostBufferTexels()) {
  std::vector<uint16_t> heights;
  heights.reserve(patches_ * kTailBlockHeights);
  for (uint32_t p = 0; p < patches_; ++p)
    for (size_t corner : {size_t{0}, size_t{kTailSamples - 1}, kTailHeights - kTailSamples, kTailHeights - 1})
      heights.push_back(tails.heights[p * kTailHeights + corner]);
  heights.insert(heights.end(), tails.heights.begin(), tails.heights.end());
  heights_.resize(heights.size());
  heights_.write(0, heights.data(), heights.size());
}

void TailTextures::setTexels(const PatchTails& tails, const BaseMesh& base, GutterEnds ends) {
  const TailBlocks blocks(tails, base, ends);
  const uint64_t planes = static_cast<uint64_t>(tails.channels) / 3, words = wordsOf(planes);
  texels_ = TexelTable("tails: texels", words == 2 ? TexelTable::Texel::kUint32x2 : TexelTable::Texel::kUint32, rows_);
  texels_.resize(texelsOf(patches_, planes));
  // Level by level, patch by patch, written in pieces of a few MiB.
  constexpr size_t kPiece = 512 * TexelTable::kRow;
  std::vector<uint32_t> piece;
  size_t written = 0;
  auto flush = [&](size_t texels) {
    texels_.write(written, piece.data(), texels);
    written += texels;
    piece.erase(piece.begin(), piece.begin() + static_cast<ptrdiff_t>(texels * words));
  };
  for (int level = 0; level < kTailLevels; ++level)
    for (uint32_t patch = 0; patch < patches_; ++patch) {
      const size_t at = piece.size();
      piece.resize(at + tailBlockTexels(level) * planes);
      blocks.write(patch, level, piece.data() + at);
      if (piece.size() >= kPiece * words) flush(kPiece);
    }
  flush(piece.size() / words);
}

void TailTextures::bind(const gl::Program& program, double reach) const {
  heights_.bind(program, "u_tail_heights", kHeightUnit);
  texels_.bind(program, "u_tails", kTexelUnit);
  glUniform1ui(program.uniform("u_tail_patches"), patches_);
  glUniform1f(program.uniform("u_tail_reach"), static_cast<float>(reach));
}

}  // namespace relievo
