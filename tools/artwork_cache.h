// artwork_cache.h - opens the file that view and render show. It is a package, or a .ptm, an image or a scan, from
// which a package is built with the defaults of relievo build and kept in a cache folder. A cached package is found by
// content: the bytes of the file and of all that it names, and the program that built it. It takes its place whole or
// not at all; two processes that build the same one write the same bytes, and the later one replaces the earlier. What
// exceeds the folder's limit goes, the least recently used first, but nothing that is in use.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "src/base/result.h"
#include "texturing/package/package.h"

namespace CLI {
class App;
}

namespace relievo {

struct ArtworkCache {
  std::string folder;  // empty: $XDG_CACHE_HOME/relievo, or ~/.cache/relievo
  uint64_t limit_mib = 4096;

  void addTo(CLI::App& command);
};

struct OpenedArtwork {
  std::shared_ptr<const Package> package;
  std::vector<std::string> named_files;  // that the artwork's file names: inputs, too
  std::shared_ptr<void> in_use;          // keeps a cached package from being removed
};

// kIo where the cache's folder cannot be written, kInterrupted (with nothing left behind) where a build was.
Result<OpenedArtwork> openArtwork(const std::string& file, const ArtworkCache& cache);

}  // namespace relievo
