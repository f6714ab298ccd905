// patch_build.h - what the passes of a build over patches share (patch_package_builder.cpp). Internal to texturing/.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "src/artwork/base_mesh.h"
#include "src/artwork/patch_domain.h"
#include "src/base/parallel_for.h"
#include "src/base/result.h"
#include "texturing/codec/mip.h"
#include "texturing/package/package_layout.h"
#include "texturing/package/package_writer.h"
#include "texturing/package/patch_images.h"
#include "texturing/package/patch_source.h"
#include "texturing/package/patch_tails.h"

namespace relievo::patch_build {

inline constexpr int kGutterPx = kPageBorderPx;

// Where a patch's levels, up to its own depth, and strips lie in what is kept of it, in bytes. Level kTail is the
// tail's finest.
inline constexpr int kTail = kNoTexturePage;
struct PatchStore {
  int channels, depth;
  static uint64_t side(int level) { return texelsASide(level); }
  uint64_t levelOffset(int level) const {
    uint64_t texels = 0;
    for (int l = kTail; l < level; ++l) texels += side(l) * side(l);
    return texels * static_cast<uint64_t>(channels);
  }
  uint64_t finestBytes() const { return levelBytes() - levelOffset(depth); }
  uint64_t levelBytes() const { return levelOffset(depth + 1); }
  uint64_t gutterBytes(int level) const { return static_cast<uint64_t>(channels) * kGutterPx * side(level); }
  uint64_t gutterOffset(int level, int s) const {
    uint64_t bytes = 0;
    for (int l = kTail; l < level; ++l) bytes += 4 * gutterBytes(l);
    return bytes + static_cast<uint64_t>(s) * gutterBytes(level);
  }
  uint64_t guttersBytes() const { return gutterOffset(depth + 1, 0); }
};

struct Context {
  const PatchSource& source;
  const PackageHeader& header;
  PackageLayout layout;
  MipFilter mip;
  PatchStore store;  // of patches of the largest depth
  std::vector<PatchNeighbours> neighbours;
  std::unique_ptr<SpillStore> levels, strips, tails;
  // Of each patch: the finest level that is kept, which those finer are interpolated from, and where all that is kept
  // begins.
  std::vector<int8_t> own_depth;
  std::vector<uint64_t> levels_at, strips_at;
  // Of each patch, written by whoever works on it; of even patches (PatchSource::patchesAreEven()) once for all.
  bool even_patches = false;
  std::array<uint16_t, kTailHeights> even_tail;  // their tails' heights
  std::vector<CoarseErrors> coarse_errors;
  std::vector<CoarseBlocks> coarse_blocks;
  std::vector<CoarseShapes> coarse_shapes;
  std::vector<HeightSlopes> slopes;
  std::vector<std::array<uint64_t, 4>> side_hash;  // of the heights along a side, from the corner of the lower index on
  std::vector<std::array<uint16_t, 4>> corner_height;
  // Of each patch.
  std::vector<uint8_t> corner_texels;  // by patch, level, corner and channel
  std::vector<uint8_t> even;  // 1: the level's channel is its corner's texel everywhere, and not kept otherwise
  TextureDepths texture_depths;
  // What patches show of images that the package has once (patch_images.h); empty: none does.
  std::vector<PatchImage> image_of_patch;
  std::vector<ShownImage> shown_images;
  std::vector<TangentFrame> frames;  // framesOfHalves()
  bool showsImage(uint32_t patch) const { return !image_of_patch.empty() && image_of_patch[patch].shows(); }
  bool showsPages(uint32_t patch) const { return showsImage(patch) && !image_of_patch[patch].in_tail; }
  std::array<const ShownImage*, 2> imagesOf(uint32_t patch) const {
    const PatchImage& shown = image_of_patch[patch];
    std::array<const ShownImage*, 2> images{};
    for (size_t half = 0; half < 2; ++half)
      if (!shown.hasColours(half)) images[half] = &shown_images[shown.image[half]];
    return images;
  }
  NormalsOfHalves normalsOf(uint32_t patch) const {
    NormalsOfHalves normals;
    for (size_t half = 0; half < 2 && !frames.empty(); ++half)
      if (const TangentFrame& frame = frames[2 * patch + half]; frame.isKnown())
        normals[half] = {&shown_images[image_of_patch[patch].image[half] + size_t{1}], frame};
    return normals;
  }
  // Whose tails are made by whoever reads the package.
  bool tailIsMade(uint32_t patch) const { return header.image_tails && showsImage(patch); }
  // Is the finest level of its tail asked for? By finer ones of its own, and by those of patches beside it.
  bool tailIsRead(uint32_t patch) const {
    auto isFiner = [&](uint32_t p) { return own_depth[p] != kTail; };
    return isFiner(patch) || std::any_of(neighbours[patch].begin(), neighbours[patch].end(), [&](const auto& n) {
             return n.patch != PatchNeighbour::kNone && isFiner(n.patch);
           });
  }
  // The corners of patches that meet at corner c of the mesh: at[first[c]] .. at[first[c + 1]], as patch * 4 + corner.
  std::vector<uint32_t> first, at;

  // A patch's tail: heights, then texels.
  size_t tailBytes() const { return 2 * kTailHeights + static_cast<size_t>(store.channels) * kTailPatchTexels; }
  size_t levelPlace(uint32_t patch, int level) const {
    const auto level_count = static_cast<size_t>(store.depth - kTail + 1);
    return (patch * level_count + static_cast<size_t>(level - kTail)) * static_cast<size_t>(store.channels);
  }
  size_t cornerPlace(uint32_t patch, int level, size_t corner) const {
    return 4 * levelPlace(patch, level) + corner * static_cast<size_t>(store.channels);
  }
  PatchStore storeOf(uint32_t patch) const { return {store.channels, own_depth[patch]}; }
  int keptLevel(uint32_t patch, int level) const { return std::min<int>(level, own_depth[patch]); }
  uint64_t levelAt(uint32_t patch, int level) const { return levels_at[patch] + store.levelOffset(level); }
  uint64_t stripAt(uint32_t patch, int level, int s) const { return strips_at[patch] + store.gutterOffset(level, s); }
  // What was kept of a patch's level at that place, channel after channel.
  Result<void> readKept(const SpillStore& from, uint64_t place, uint32_t patch, int level,
                        std::span<uint8_t> out) const {
    const auto channels = static_cast<size_t>(store.channels);
    const size_t plane = out.size() / channels;
    for (size_t c = 0; c < channels; ++c)
      if (even[levelPlace(patch, level) + c])
        std::memset(out.data() + c * plane, corner_texels[cornerPlace(patch, level, 0) + c], plane);
    return forKept(patch, level, [&](size_t begin, size_t end) {
      return from.read(place + begin * plane, out.data() + begin * plane, (end - begin) * plane);
    });
  }
  // Calls use(begin, end) for runs of a level's channels that are kept.
  template <class Use>
  Result<void> forKept(uint32_t patch, int level, Use&& use) const {
    const uint8_t* is_even = even.data() + levelPlace(patch, level);
    const auto channels = static_cast<size_t>(store.channels);
    for (size_t begin = 0, end = 0; begin < channels; begin = end + 1) {
      for (end = begin; end < channels && !is_even[end];) ++end;
      if (end > begin)
        if (auto used = use(begin, end); !used) return used;
    }
    return {};
  }
};

inline void listCorners(Context& c) {
  const BaseMesh& base = c.source.base();
  c.first.assign(base.corners.size() + 1, 0);
  c.at.resize(base.patches.size() * 4);
  for (const auto& patch : base.patches)
    for (uint32_t corner : patch) ++c.first[corner + 1];
  for (size_t i = 1; i < c.first.size(); ++i) c.first[i] += c.first[i - 1];
  std::vector<uint32_t> next(c.first.begin(), c.first.end() - 1);
  for (uint32_t i = 0; i < c.at.size(); ++i) c.at[next[base.patches[i / 4][i % 4]]++] = i;
}

inline Error invalid(uint32_t patch, const std::string& what) {
  return {ErrorKind::kInvalidData, "", "patch " + std::to_string(patch) + ": " + what, "", {}};
}

// Calls run(worker, patch) for each patch; each thread's worker is what makeWorker() gives. Calls between(patches taken
// so far) on the caller's thread.
template <class MakeWorker, class Run, class Between>
Result<void> forEachPatch(const Context& context, const BuildOptions& options, int workers, MakeWorker&& makeWorker,
                          Run&& run, Between&& between) {
  constexpr size_t kPatchesAJob = 16;
  const size_t patches = context.header.domain.patchCount();
  std::vector<std::optional<Error>> failed((patches + kPatchesAJob - 1) / kPatchesAJob);
  const bool whole = parallelForWith(
      failed.size(), workers, options.interrupted, makeWorker,
      [&](auto& worker, size_t job) {
        for (size_t p = job * kPatchesAJob; p < std::min(patches, (job + 1) * kPatchesAJob) && !failed[job]; ++p)
          if (auto done = run(worker, static_cast<uint32_t>(p)); !done) failed[job] = done.error();
      },
      [&](size_t jobs) { between(std::min(patches, jobs * kPatchesAJob)); });
  for (const std::optional<Error>& error : failed)
    if (error) return *error;
  if (!whole) return Error{ErrorKind::kInterrupted, options.output, "interrupted", "nothing was written", {}};
  return {};
}

}  // namespace relievo::patch_build
