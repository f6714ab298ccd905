#include "src/render/tail_textures.h"

#include <algorithm>
#include <vector>

#include "src/base/parallel_for.h"

namespace relievo {
namespace {

// How many planes' words a texel of the table has, as of shaders/tails.glsl: they are fetched at once, and their levels
// are the same.
size_t wordsOf(size_t planes, bool paired) { return paired && planes % 2 == 0 ? 2 : 1; }

// By patch, the finest level of each group of planes that is fetched at once; how many patches have each of a group's
// levels; and the texels of the table.
struct TailLevels {
  TailLevels(const KeptTails& tails, size_t words_a_texel);
  size_t words, groups;
  std::vector<uint8_t> finest;
  std::vector<std::array<uint32_t, kTailLevels>> held;
  uint64_t texels = 0;
};

TailLevels::TailLevels(const KeptTails& tails, size_t words_a_texel)
    : words(words_a_texel), groups(static_cast<size_t>(tails.planes()) / words), held(groups) {
  finest.reserve(tails.patches() * groups);
  for (uint32_t p = 0; p < tails.patches(); ++p)
    for (size_t group = 0; group < groups; ++group) {
      int of_all = kTailLevels - 1;
      for (size_t k = 0; k < words; ++k)
        of_all = std::min(of_all, tails.plane(p, static_cast<int>(group * words + k)).finest);
      finest.push_back(static_cast<uint8_t>(of_all));
      for (auto level = static_cast<size_t>(of_all); level < kTailLevels; ++level) ++held[group][level];
    }
  texels = finest.size();
  for (const auto& of_group : held)
    for (int level = 0; level < kTailLevels; ++level)
      texels += of_group[static_cast<size_t>(level)] * tailBlockTexels(level);
}

// Each patch has its corners' heights, and a grid of its own unless all patches share one.
uint64_t heightsOf(const KeptTails& tails) {
  return uint64_t{4} * tails.patches() + (tails.heightsAreEven() ? 1 : tails.patches()) * kTailHeights;
}

}  // namespace

bool TailTextures::fit(const KeptTails& tails, uint64_t most_row_texels, uint64_t most_buffer_texels) {
  return TailLevels(tails, 1).texels <= most_row_texels &&
         heightsOf(tails) <= (most_buffer_texels == 0 ? most_row_texels : most_buffer_texels);
}

TailTextures::TailTextures(const KeptTails& tails)
    : patches_(tails.patches()), heights_a_patch_(tails.heightsAreEven() ? 0 : static_cast<uint32_t>(kTailHeights)) {
  // Software drivers shade up to a fifth faster with pairs, which take up to twice the memory.
  constexpr uint64_t kMostPairedBytes = uint64_t{64} << 20;
  const auto planes = static_cast<size_t>(tails.planes());
  const TailLevels pairs(tails, wordsOf(planes, true));
  pairs_ = pairs.words == 2 && 8 * pairs.texels <= kMostPairedBytes;
  const uint64_t texels = pairs_ ? pairs.texels : TailLevels(tails, 1).texels;
  texel_bytes_ = texels * 4 * wordsOf(planes, pairs_);
  rows_ = TexelTable::mostBufferTexels() > 0 && texels > TexelTable::mostBufferTexels();
  std::vector<uint16_t> heights;
  const uint32_t grids = heights_a_patch_ > 0 ? patches_ : 1;
  heights.reserve(heightsOf(tails));
  for (uint32_t p = 0; p < patches_; ++p)
    for (size_t corner : {size_t{0}, size_t{kTailSamples - 1}, kTailHeights - kTailSamples, kTailHeights - 1})
      heights.push_back(tails.height(p, corner));
  for (uint32_t p = 0; p < grids; ++p)
    for (size_t i = 0; i < kTailHeights; ++i) heights.push_back(tails.height(p, i));
  heights_.resize(heights.size());
  heights_.write(0, heights.data(), heights.size());
}

void TailTextures::setTexels(const KeptTails& tails, const BaseMesh& base, GutterEnds ends, int workers) {
  const TailBlocks blocks(tails, base, ends);
  const TailLevels levels(tails, wordsOf(static_cast<size_t>(tails.planes()), pairs_));
  const size_t words = levels.words;
  held_ = levels.held;
  first_.resize(levels.groups);
  texels_ = TexelTable("tails: texels", words == 2 ? TexelTable::Texel::kUint32x2 : TexelTable::Texel::kUint32, rows_);
  texels_.resize(levels.texels);
  // By group the patches in the order of their ranks.
  std::vector<std::vector<uint32_t>> order(levels.groups, std::vector<uint32_t>(patches_));
  std::vector<uint32_t> piece(levels.finest.size() * words);  // the ranks first
  for (size_t group = 0; group < levels.groups; ++group) {
    std::array<uint32_t, kTailLevels> next{};
    for (size_t level = 1; level < kTailLevels; ++level) next[level] = held_[group][level - 1];
    for (uint32_t p = 0; p < patches_; ++p) {
      const size_t i = p * levels.groups + group;
      const uint32_t rank = next[levels.finest[i]]++;
      piece[i * words] = rank;
      order[group][rank] = p;
    }
  }
  // Written in pieces of a few MiB.
  constexpr size_t kPiece = 512 * TexelTable::kRow, kBlocks = 512;
  size_t written = 0;
  auto flush = [&] {
    const size_t count = std::min(piece.size() / words, kPiece);
    texels_.write(written, piece.data(), count);
    written += count;
    piece.erase(piece.begin(), piece.begin() + static_cast<ptrdiff_t>(count * words));
  };
  auto writeBlock = [&](size_t group, int level, uint32_t patch, uint32_t* out) {
    std::array<uint32_t, tailBlockTexels(0)> one;
    for (size_t k = 0; k < words; ++k) {
      blocks.write(patch, level, static_cast<int>(group * words + k), one.data());
      for (size_t i = 0; i < tailBlockTexels(level); ++i) out[i * words + k] = one[i];
    }
  };
  for (size_t group = 0; group < levels.groups; ++group)
    for (int level = 0; level < kTailLevels; ++level) {
      const size_t block = tailBlockTexels(level) * words;
      const uint32_t held = held_[group][static_cast<size_t>(level)];
      first_[group][static_cast<size_t>(level)] = static_cast<uint32_t>(written + piece.size() / words);
      for (uint32_t done = 0; done < held;) {
        while (piece.size() >= kPiece * words) flush();
        const auto count = static_cast<uint32_t>(std::min<size_t>(held - done, kPiece / block));
        const size_t at = piece.size();
        piece.resize(at + count * block);
        parallelFor((count + kBlocks - 1) / kBlocks, std::max(workers, 1), nullptr, [&](size_t part) {
          for (size_t i = part * kBlocks; i < std::min<size_t>(count, (part + 1) * kBlocks); ++i)
            writeBlock(group, level, order[group][done + i], piece.data() + at + i * block);
        });
        done += count;
      }
    }
  while (!piece.empty()) flush();
}

void TailTextures::bind(const gl::Program& program, double reach) const {
  heights_.bind(program, "u_tail_heights", kHeightUnit);
  texels_.bind(program, "u_tails", kTexelUnit);
  const auto groups = static_cast<GLsizei>(first_.size());
  if (groups > 0) {
    glUniform4uiv(program.uniform("u_tail_first"), groups, first_[0].data());
    glUniform4uiv(program.uniform("u_tail_held"), groups, held_[0].data());
  }
  glUniform1ui(program.uniform("u_tail_patches"), patches_);
  glUniform1ui(program.uniform("u_tail_grid"), heights_a_patch_);
  glUniform1f(program.uniform("u_tail_reach"), static_cast<float>(reach));
}

}  // namespace relievo
