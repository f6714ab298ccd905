#include "src/engine/stream_switch.h"

#include <cassert>
#include <utility>

namespace relievo {

void StreamSwitch::start(std::shared_ptr<const PageSource> source, StreamerOptions options,
                         std::vector<NodeId> texture_roots, std::vector<NodeId> relief_roots) {
  assert(!busy());
  auto make = [source = std::move(source), options = std::move(options), texture_roots = std::move(texture_roots),
               relief_roots = std::move(relief_roots)] {
    auto streamer = std::make_unique<PageStreamer>(source, options);
    streamer->pinRoots(texture_roots, relief_roots);
    return streamer;
  };
  next_.emplace("relievo-roots", std::move(make));
}

std::unique_ptr<PageStreamer> StreamSwitch::tryTake() { return busy() && next_->ready() ? take() : nullptr; }
std::unique_ptr<PageStreamer> StreamSwitch::take() {
  std::unique_ptr<PageStreamer> streamer = std::move(next_->get());
  next_.reset();
  return streamer;
}

void StreamSwitch::retire(std::unique_ptr<PageStreamer> old) {
  std::erase_if(ending_, [](const auto& task) { return task.ready(); });
  ending_.emplace_back("relievo-ending", [streamer = std::move(old)]() mutable { streamer.reset(); });
  if (ending_.back().ready()) ending_.pop_back();  // no thread could be started: the streamer ends with the task
}

}  // namespace relievo
