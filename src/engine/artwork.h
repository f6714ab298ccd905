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
#include "texturing/package/kept_tails.h"
#include "texturing/package/package.h"

namespace relievo {

struct Artwork {
  Manifest manifest;
  std::shared_ptr<const PageSource> source;
  std::shared_ptr<const ReliefOracle> oracle;
  // Over a base mesh: the patches' tails (patch_tails.h), where the source stores them. Where this is empty they are
  // computed from all root pages. Tails that had to be replaced are named in problems.
  std::function<KeptTails(int workers, std::vector<std::string>* problems)> tails;
};
// Once *stop is set (it may be null), the artwork's tails are no longer read, and those returned must not be used.
Artwork artworkFromPackage(std::shared_ptr<const Package> package, const std::atomic<bool>* stop = nullptr);
// The box around what is drawn, with heights times exaggerate. For a flat artwork it is the plane z = 0.
Extent artworkExtent(const Manifest& manifest, double exaggerate = 1);
// The middle of that box without heights, mm.
glm::dvec3 artworkMiddle(const Manifest& manifest);

}  // namespace relievo
