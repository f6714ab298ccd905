// stream_switch.h - a change of planes without a wait: the next streamer reads its root pages on a thread of its own
// while the old one is drawn; the old one is destroyed on another thread, which waits for its last reads. At most one
// streamer is being made ready, so that a source that never answers costs one thread, however often the scene changes.
#pragma once

#include <list>
#include <memory>
#include <optional>
#include <vector>

#include "src/base/worker_threads.h"
#include "texturing/stream/page_streamer.h"

namespace relievo {

// Owned by the render thread. The destructor waits for the reads under way.
class StreamSwitch {
 public:
  bool busy() const { return next_.has_value(); }  // a streamer is being made ready, or is ready and not yet taken
  // Must not be called while busy.
  void start(std::shared_ptr<const PageSource> source, StreamerOptions options, std::vector<NodeId> texture_roots,
             std::vector<NodeId> relief_roots);
  // tryTake() answers null where no streamer is ready. Both throw if the streamer could not be made (no thread, no
  // memory).
  std::unique_ptr<PageStreamer> tryTake();
  std::unique_ptr<PageStreamer> take();  // waits; busy only
  void retire(std::unique_ptr<PageStreamer> old);

 private:
  std::optional<BackgroundTask<std::unique_ptr<PageStreamer>>> next_;
  std::list<BackgroundTask<void>> ending_;
};

}  // namespace relievo
