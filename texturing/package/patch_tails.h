// patch_tails.h - a tail is the coarse data of a patch that are always resident, 4 KiB at most. With tails, a scene of
// very many patches needs a page only where a patch is large on the screen, and pins no page.
//
//   heights   the grid of 2^kTailCellsLog2 cells a side: every 8th sample of the root page, the same 16 bits. A vertex
//             therefore has one place whether its height comes from a tail or from a page, and patches that meet need
//             not agree on which they use.
//   texels    the levels of 16, 8, 4 and 2 texels a side: the root page's bytes halved 3 to 6 times by mip.h's rules,
//             or 16 a side that are all that the patch was told in (PatchSource::textureDepthOf()), or that the images
//             show of it (tailOfImages()), halved up to 3.
//             The two levels between (64 and 32 texels) are not stored: shaders blend from the root's level to the
//             tail's over them. The finest also stands for pages that a patch does not have (texture_depths.h): it is
//             filtered bilinearly, whatever the scene's sampling.
//
// On the GPU a patch's tail is a block of texels a level (32 bits a plane), with a border of one texel from the patches
// that it meets, so that bilinear filters show no seam; and 17 x 17 heights (16 bits), of which the four at the corners
// lie together, too. tailGpuBytes() says what that takes at most: levels that a coarser one shows as well are left out
// (kept_tails.h).
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "src/artwork/basis.h"
#include "src/base/result.h"
#include "texturing/codec/mip.h"
#include "texturing/package/page_failures.h"
#include "texturing/package/page_source.h"

namespace relievo {

inline constexpr int kTailLevels = 4;
inline constexpr int kTailSamples = (1 << kTailCellsLog2) + 1;               // a side
inline constexpr size_t kTailHeights = size_t{kTailSamples} * kTailSamples;  // a patch: 289
inline constexpr std::array<size_t, kTailLevels + 1> kTailLevelAt{0, 256, 320, 336,
                                                                  340};  // texels of a channel before each level
inline constexpr size_t kTailPatchTexels = kTailLevelAt[kTailLevels];
static_assert(kTailTexels == 16);

struct PatchTails {
  uint32_t patches = 0;
  int channels = 0;
  std::vector<uint16_t> heights;  // patch by patch, rows of v from 0
  std::vector<uint8_t>
      texels;  // patch by patch; in it level by level, finest first; in it channel by channel, rows of v from 0
  PageFailures failures;  // root pages, and those whose images, some of them should have been made of

  PatchTails() = default;
  PatchTails(uint32_t patch_count, int channel_count)
      : patches(patch_count),
        channels(channel_count),
        heights(patches * kTailHeights),
        texels(patches * patchTexels()) {}
  size_t patchTexels() const { return static_cast<size_t>(channels) * kTailPatchTexels; }
  static int side(int level) { return kTailTexels >> level; }
  std::span<uint16_t> heightsOf(uint32_t patch) {
    return std::span(heights).subspan(patch * kTailHeights, kTailHeights);
  }
  std::span<uint8_t> texelsOf(uint32_t patch) {
    return std::span(texels).subspan(patch * patchTexels(), patchTexels());
  }
  const uint8_t* level(uint32_t patch, int level, int channel) const {
    return texels.data() + levelAt(patch, level, channel);
  }
  uint8_t* level(uint32_t patch, int level, int channel) { return texels.data() + levelAt(patch, level, channel); }
  size_t levelAt(uint32_t patch, int level, int channel) const {
    const size_t texels_a_channel = static_cast<size_t>(side(level)) * static_cast<size_t>(side(level));
    return patch * patchTexels() + static_cast<size_t>(channels) * kTailLevelAt[static_cast<size_t>(level)] +
           static_cast<size_t>(channel) * texels_a_channel;
  }
  friend bool operator==(const PatchTails&, const PatchTails&) = default;
};

// From a root page's samples (kReliefPageSamples), and from a patch's level of 128 x 128 or 16 x 16 texels,
// channel-major.
void tailHeights(std::span<const uint16_t> samples, std::span<uint16_t> out /* kTailHeights */);
void tailTexels(const MipFilter& mip, std::span<const uint8_t> texels,
                std::span<uint8_t> out /* kTailPatchTexels a channel */);

// Of a patch of which nothing is known, as neutral_page.h has pages.
void neutralTail(const TextureFormat& format, std::span<uint8_t> out /* kTailPatchTexels a channel */);

// Reads the root pages of patches first .. first + tails.patches and makes `tails` of them. A page that cannot be had
// counts as a neutral one and is named in `problems`, which may be null, and counted in tails.failures. Ends soon after
// *stop is set (it may be null).
void tailsFromPages(const PageSource& source, const TextureFormat& format, bool relief, uint32_t first, int workers,
                    PatchTails& tails, std::vector<std::string>* problems, const std::atomic<bool>* stop = nullptr);

// Coefficients evaluated for a fixed light, as resolve.h does it for pages: three channels. The heights are left out.
PatchTails resolvedTails(const PatchTails& tails, const TextureFormat& format, const std::array<double, 3>& light);

// A level's texels with its border; before each level, of a patch. Known to shaders/tails.glsl, compared by a test.
inline constexpr size_t tailBlockSide(int level) { return static_cast<size_t>((kTailTexels >> level) + 2); }
inline constexpr size_t tailBlockTexels(int level) { return tailBlockSide(level) * tailBlockSide(level); }
inline constexpr std::array<size_t, kTailLevels + 1> kTailBlockAt{0, 324, 424, 460, 476};
inline constexpr size_t kTailBlockHeights =
    4 + kTailHeights;  // those at the corners are there twice: they are all that a patch of one cell takes
inline constexpr uint64_t tailGpuBytes(uint64_t patches, uint64_t planes) {
  return patches * (planes * 4 * (1 + kTailBlockAt[kTailLevels]) + 2 * kTailBlockHeights);
}

// Of all planes one: three channels. The heights are left out.
PatchTails planeOfTails(const PatchTails& tails, int plane);

}  // namespace relievo
