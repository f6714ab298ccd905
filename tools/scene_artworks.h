// scene_artworks.h - the artworks of a command's input, one or several, opened.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "src/base/result.h"
#include "src/engine/stage.h"
#include "tools/artwork_cache.h"
#include "tools/output_files.h"
#include "tools/scene/scene_file.h"

namespace relievo {

struct SceneArtworks {
  std::vector<SceneArtwork> named;
  std::vector<OpenedArtwork> opened;

  bool several() const { return named.size() > 1; }
  const Package& package(size_t i) const { return *opened[i].package; }
  // What messages say of each: its file, and which it is of those of the same file.
  std::string nameOf(size_t i) const;
  std::vector<StagedArtwork> staged(const std::function<Artwork(std::shared_ptr<const Package>)>& artwork) const;
  // What is drawn of each, and where it stands.
  std::vector<PlacedExtent> placed(const Scene& scene) const;
};

Result<SceneArtworks> openArtworks(std::vector<SceneArtwork> named, const ArtworkCache& cache);
// The artworks' own files, as inputs that no output may replace.
std::vector<NamedFile> inputsOf(const std::vector<SceneArtwork>& named);
// Files that they name, inputs, too.
std::vector<NamedFile> namedInputsOf(const SceneArtworks& artworks);

}  // namespace relievo
