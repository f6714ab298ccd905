// source_options.h - the options with which render and view show a package on slow or damaged storage.
#pragma once

#include "src/engine/engine.h"
#include "texturing/stream/page_sources.h"

namespace CLI {
class App;
}

namespace relievo {

struct SourceOptions {
  SimulatedStorage storage;

  void addTo(CLI::App& command);
  Artwork artwork(std::shared_ptr<const Package> package) const;
};

}  // namespace relievo
