#include "tools/scene_artworks.h"

#include <algorithm>
#include <utility>

namespace relievo {

std::string SceneArtworks::nameOf(size_t i) const {
  const auto same = [&](const SceneArtwork& other) { return other.file == named[i].file; };
  const auto here = named.begin() + static_cast<std::ptrdiff_t>(i);
  if (std::count_if(named.begin(), named.end(), same) == 1) return named[i].file;
  return named[i].file + " (" + std::to_string(std::count_if(named.begin(), here, same) + 1) + ")";
}

std::vector<StagedArtwork> SceneArtworks::staged(
    const std::function<Artwork(std::shared_ptr<const Package>)>& artwork) const {
  std::vector<StagedArtwork> all;
  for (size_t i = 0; i < named.size(); ++i) all.push_back({artwork(opened[i].package), named[i].pose, nameOf(i)});
  return all;
}

std::vector<PlacedExtent> SceneArtworks::placed(const Scene& scene) const {
  std::vector<PlacedExtent> all;
  for (size_t i = 0; i < named.size(); ++i) {
    all.push_back(placedExtent(scene, package(i).manifest()));
    all.back().pose = named[i].pose;
  }
  return all;
}

Result<SceneArtworks> openArtworks(std::vector<SceneArtwork> named, const ArtworkCache& cache) {
  SceneArtworks all;
  for (const SceneArtwork& one : named) {
    auto opened = openArtwork(one.file, cache);
    if (!opened) return opened.error();
    all.opened.push_back(std::move(*opened));
  }
  all.named = std::move(named);
  return all;
}

std::vector<NamedFile> inputsOf(const std::vector<SceneArtwork>& named) {
  std::vector<NamedFile> files;
  for (const SceneArtwork& one : named) files.push_back({named.size() == 1 ? "FILE" : "an artwork of FILE", one.file});
  return files;
}

std::vector<NamedFile> namedInputsOf(const SceneArtworks& artworks) {
  std::vector<NamedFile> files;
  for (const OpenedArtwork& opened : artworks.opened)
    for (const std::string& path : opened.named_files) files.push_back({path + ", which FILE names", path});
  return files;
}

}  // namespace relievo
