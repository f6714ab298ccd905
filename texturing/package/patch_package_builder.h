// patch_package_builder.h - from patches over a base mesh to a package file (PACKAGE.md).
// As package_builder.h has it: written beside the target and renamed when whole, nothing left behind on failure or
// interruption, the same bytes with any number of workers. Memory: some copies of a patch a worker, whatever their
// number; what is kept of all patches until their neighbours are known lies in files without a name beside the target
// once the budget is spent (a byte a channel and texel of all levels).
#pragma once

#include "src/base/result.h"
#include "texturing/package/package_builder.h"
#include "texturing/package/patch_source.h"

namespace relievo {

// options.mm_per_px is not used: the patches say how large they are. Samples that neighbours do not agree on are an
// Error that names both patches: they would be a crack.
Result<BuildReport> buildPatchPackage(const PatchSource& source, const BuildOptions& options);

}  // namespace relievo
