#include "tools/source_options.h"

#include <CLI/CLI.hpp>

#include "src/base/progress.h"

namespace relievo {

void SourceOptions::addTo(CLI::App& c) {
  const char* group = "Simulated storage (advanced)";
  c.add_option("--source-rate", storage.rate_mb_per_s, "Read pages at this rate at most, MB/s; 0 is unlimited")
      ->check(CLI::Range(0.0, 1e6))
      ->capture_default_str()
      ->group(group);
  c.add_option("--source-latency", storage.latency_ms, "A read answers this much later, ms")
      ->check(CLI::Range(0.0, 60000.0))
      ->capture_default_str()
      ->group(group);
  c.add_option("--source-jitter", storage.jitter_ms, "And up to this much more, by page, ms")
      ->check(CLI::Range(0.0, 60000.0))
      ->capture_default_str()
      ->group(group);
  c.add_option("--source-fail", storage.fail_percent,
               "Reads that go wrong, %: a quarter each fails, ends early, comes changed, comes 5 s late")
      ->check(CLI::Range(0.0, 100.0))
      ->capture_default_str()
      ->group(group);
  c.add_option("--source-seed", storage.seed, "Which reads those are, and the jitter, follow from this number")
      ->capture_default_str()
      ->group(group);
  c.add_option("--source-memory", storage.memory_mib,
               "Keep encoded pages that were read in this much memory, MiB; 0 is none")
      ->check(CLI::Range(0.0, 1048576.0))
      ->capture_default_str()
      ->group(group);
}

Artwork SourceOptions::artwork(std::shared_ptr<const Package> package) const {
  Artwork artwork = artworkFromPackage(package, &interruptedFlag());
  artwork.source = withSimulatedStorage(package, storage, steadyClock(&interruptedFlag()));
  return artwork;
}

}  // namespace relievo
