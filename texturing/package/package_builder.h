// package_builder.h - from raster sources to a package file, streamed: regions in, pages out, memory bounded.
// Written beside the target (TARGET.part-PID) and renamed when whole; on failure or interruption nothing is left
// behind. The same bytes with any number of workers.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <string>

#include "src/base/result.h"
#include "texturing/codec/page_encoding.h"
#include "texturing/package/raster_source.h"

namespace relievo {

struct BuildProgress {
  uint64_t pages_done = 0, pages_total = 0;
  uint64_t texels_done = 0, texels_total = 0;  // level-0 texels of the texture
  double seconds = 0;
};

// Of pages that have bytes: more would wait too long to be moved once the index is coded, and are large against their
// entries.
inline constexpr uint64_t kMostCodedPages = uint64_t{1} << 18;
inline constexpr double kCheckpointSeconds = 10;  // what a kill costs at most, beside the parts in work

struct BuildOptions {
  std::string output;
  double mm_per_px = 1.0;
  bool size_known = true;       // else mm_per_px is 1, heights are in pixels of the texture, and the package says so
  bool stretch_relief = false;  // a height map of other proportions than the texture is stretched over it, not refused
  int workers = 0;              // 0: one per core
  int zstd_level = 1;
  // Over a base mesh: a package of version 10, which takes far fewer bytes for the relief; else of version 2 or 3, for
  // older readers.
  bool compact = true;
  // Of compact packages: tails are coded (texturing/codec/tail_code.h), and with a texture_tolerance lossless pages may
  // be stored in fewer texels (texturing/codec/coarse_page.h); else the package is one of version 4, or 5 with texture
  // levels that patches do not have.
  bool coded_tails = true;
  // Of packages with coded tails: the base mesh is coded, too (base_code.h); else the package is one of version 6.
  bool coded_base = true;
  // Of packages with a coded base mesh: lossless pages may be stored within the texture_tolerance as a code
  // (texturing/codec/texel_code.h), too; else the package is one of version 7.
  bool coded_texels = true;
  // Of packages with coded texels, and at most so many pages: the index is coded, too (index_code.h), and relief pages
  // of level 0 are stored over their tails; else the package is one of version 8.
  bool coded_index = true;
  uint64_t most_coded_pages = kMostCodedPages;
  // Patches in few bytes, version 10; needs coded_index.
  bool light_patches = true;
  // Of packages with coded texels, as far as coded_index and light_patches are not turned off: the base mesh is coded
  // by its border (base_code.h); else the package is one of version 8, 10 or 11.
  bool base_by_border = true;
  // Of packages with cut patches, normals and a base mesh coded by its border: colours of tails end at edges
  // (crease_gutter.h); else the package is one of version 12 or 13.
  bool tail_edges = true;
  // Of packages with images that patches show: the tails of these are made of the images, and patches whose tail is all
  // that they need may show images, too; else the package is one of version 13 to 15.
  bool image_tails = true;
  // Of packages with such tails: in place of a copy of the base mesh there is what makes it good (base_parity.h), and
  // normals of images are predicted by it; else the package is one of version 16.
  bool base_parity = true;
  // Of packages with coded tails and a texture_tolerance: texels of tails are rounded within it to what takes fewer
  // bytes.
  bool rounded_tails = true;
  // Over a base mesh: texture levels of a patch are left out where every texel is within so many 8-bit steps of what
  // the coarser level or the tail shows, as channelTolerances() says (texture_depths.h). Negative: none are left out.
  // Of compact packages only.
  double texture_tolerance = -1;
  // Of the planes of either kind. Mip levels are computed from exact values whatever the encoding.
  PageEncoding coefficients, colour;
  uint64_t memory_budget_bytes = uint64_t{768} << 20;
  // How much of the budget holds data that wait for neighbouring patches; the rest of such data lies in files.
  // buildPatchPackage only.
  uint64_t kept_bytes = ~uint64_t{0};
  std::string tool_version;
  std::string manifest_extra;  // a JSON object whose members join the manifest, or empty; buildPatchPackage only
  std::function<void(const BuildProgress&)> progress;  // called from one thread, a few times a second
  const std::atomic<bool>* interrupted = nullptr;      // polled; set: stop, remove the part file, kInterrupted
  // Checkpoints: what a build that was killed leaves, to go on from (build_checkpoint.h). buildPackage only.
  double checkpoint_s = -1;  // seconds between them; 0: after each part; negative: none
  bool resume = false;       // go on from the last one, if there is one; and what stops this build leaves one
  std::function<void(const std::string&)> note;  // one sentence for the user, about checkpoints
};

struct BuildReport {
  uint64_t pages = 0, package_bytes = 0;
  double seconds = 0;
};

// relief may be null. Its range becomes the artwork's.
Result<BuildReport> buildPackage(const TextureSource& texture, const HeightSource* relief, const BuildOptions& options);

}  // namespace relievo
