// dense_pages.h - the oracle's pyramid and relief cut into pages: what a package of the same artwork holds, without
// builder and file. For engine tests at sizes that no file has (2^24 texels a side, one texel). Thread-safe.
#pragma once

#include <memory>

#include "geometry/lod/planar_lod.h"
#include "tests/render/dense_reference.h"
#include "texturing/package/page_source.h"

namespace relievo {

// relief may be null.
std::shared_ptr<const PageSource> densePages(std::shared_ptr<const DenseTexture> texture,
                                             std::shared_ptr<const DenseRelief> relief);

// Bounds of every relief page by brute force over the finest samples: height range, and the largest distance of a
// finest sample from the page's own samples interpolated over its cells' two triangles, either diagonal; a parent's are
// never smaller.
std::shared_ptr<const ReliefOracle> denseReliefBounds(const DenseRelief& relief, const FlatDomain& domain);

}  // namespace relievo
