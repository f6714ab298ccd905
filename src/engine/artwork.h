// artwork.h - what the engine shows: a manifest, pages, bounds of heights. A package has all of it; tests may use a
// procedural source.
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "geometry/lod/lod.h"
#include "src/render/camera.h"
#include "texturing/package/package.h"
#include "texturing/package/patch_tails.h"

namespace relievo {

struct Artwork {
  Manifest manifest;
  std::shared_ptr<const PageSource> source;
  std::shared_ptr<const ReliefOracle> oracle;
  // Over a base mesh: what of each patch needs no page, if the source has it at hand (else it is made of the root
  // pages, all of them). What had to be made up is named in problems.
  std::function<PatchTails(int workers, std::vector<std::string>* problems)> tails;
};
// Once *stop is set (it may be null), its tails are no longer read and not to be used.
Artwork artworkFromPackage(std::shared_ptr<const Package> package, const std::atomic<bool>* stop = nullptr);
// Of what is drawn, with heights times exaggerate; of a flat artwork its plane (min and max of z are 0).
Extent artworkExtent(const Manifest& manifest, double exaggerate = 1);

}  // namespace relievo
