#include "src/stream_switch.h"

#include <cassert>
#include <chrono>
#include <utility>

namespace relievo {

namespace {
template <class T>
bool isReady(const std::future<T>& f) {
  return f.wait_for(std::chrono::seconds(0)) == std::future_status::ready;
}
}  // namespace

void StreamSwitch::start(std::shared_ptr<const PageSource> source, StreamerOptions options, std::vector<NodeId> texture_roots,
                         std::vector<NodeId> relief_roots) {
  assert(!busy());
  auto make = [source = std::move(source), options = std::move(options), texture_roots = std::move(texture_roots),
               relief_roots = std::move(relief_roots)] {
    auto streamer = std::make_unique<PageStreamer>(source, options);
    streamer->pinRoots(texture_roots, relief_roots);
    return streamer;
  };
  next_ = std::async(std::launch::async, std::move(make));
}

std::unique_ptr<PageStreamer> StreamSwitch::tryTake() { return busy() && isReady(next_) ? next_.get() : nullptr; }
std::unique_ptr<PageStreamer> StreamSwitch::take() { return next_.get(); }

void StreamSwitch::retire(std::unique_ptr<PageStreamer> old) {
  std::erase_if(ending_, [](const auto& f) { return isReady(f); });
  ending_.push_back(std::async(std::launch::async, [streamer = std::move(old)]() mutable { streamer.reset(); }));
}

}  // namespace relievo
