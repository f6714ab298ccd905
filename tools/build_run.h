// build_run.h - a package build as a user sees it: progress on a terminal, Ctrl-C, and a line of figures at the end.
#pragma once

#include <string>

#include "texturing/package/package_builder.h"
#include "texturing/package/patch_source.h"

namespace relievo {

// options: output, mm_per_px, workers, compression and budget; the rest is filled in here.
Result<BuildReport> buildWithProgress(const TextureSource& texture, const HeightSource* relief, BuildOptions options);
Result<BuildReport> buildPatchesWithProgress(const PatchSource& source, BuildOptions options);
// "FILE: W x H px, N pages, MiB (bytes per pixel), s, MPix/s".
std::string buildSummary(const TextureSource& texture, const BuildOptions& options, const BuildReport& report);

// What is said of an image that has an alpha channel.
std::string alphaWarning(const std::string& image);

}  // namespace relievo
