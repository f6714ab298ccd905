// lod_worker.cpp - see the header. One request and one answer are ever waiting; older ones are replaced.
#include "geometry/lod/lod_worker.h"

#include <algorithm>
#include <cassert>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <utility>

#include "src/base/worker_threads.h"

namespace relievo {

struct LodWorker::Impl {
  using TextureStrategy = std::function<std::vector<TextureRequest>(const TextureView&)>;
  Impl(LodSelector select, TextureStrategy textures)
      : select_lod(std::move(select)), select_texture(std::move(textures)) {
    thread.startAtLeastOne(1, [this] {
      try {
        work();
      } catch (...) {
        answers.close();  // whoever waits is woken, and told
        throw;
      }
    });
  }
  ~Impl() {
    requests.close();
    thread.join();
  }

  void work() {
    static const ReliefSet kNothing;
    while (std::optional<LodRequest> request = requests.take()) {
      auto start = std::chrono::steady_clock::now();
      auto msSince = [](std::chrono::steady_clock::time_point t) {
        return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - t).count();
      };
      LodAnswer answer;
      answer.frame = request->frame;
      answer.view = request->view;
      answer.lod = select_lod(request->view, request->resident ? *request->resident : kNothing);
      if (request->texture && select_texture) {
        auto texture_start = std::chrono::steady_clock::now();
        answer.texture = select_texture(*request->texture);
        answer.determine_ms = msSince(texture_start);
      }
      answer.evaluate_ms = msSince(start);
      answers.post(std::move(answer));
    }
  }

  const LodSelector select_lod;
  const TextureStrategy select_texture;
  Mailbox<LodRequest> requests;
  Mailbox<LodAnswer> answers;
  // Of the owner's thread.
  std::optional<LodRequest> last_request;
  std::optional<uint64_t> last_taken;
  WorkerThreads thread{"relievo-lod"};  // last
};

LodWorker::LodWorker(FlatDomain domain, std::shared_ptr<const ReliefOracle> oracle)
    : impl_(std::make_unique<Impl>(
          [lod = std::make_shared<PlanarLod>(domain, oracle)](const LodView& view, const ReliefSet& resident) {
            return lod->select(view, resident);
          },
          [domain, oracle](const TextureView& view) { return selectTextureNodes(domain, *oracle, view); })) {
  assert(oracle);
}
LodWorker::LodWorker(LodSelector strategy) : impl_(std::make_unique<Impl>(std::move(strategy), nullptr)) {}
LodWorker::~LodWorker() = default;

void LodWorker::post(LodRequest request) {
  impl_->last_request = request;
  impl_->requests.post(std::move(request));
}

std::optional<LodAnswer> LodWorker::tryTake() {
  std::optional<LodAnswer> answer = impl_->answers.tryTake();
  if (!answer) impl_->thread.rethrow();
  if (answer) impl_->last_taken = answer->frame;
  return answer;
}

LodAnswer LodWorker::waitFor(uint64_t frame) {
  assert(impl_->last_request && frame <= impl_->last_request->frame);  // else nobody will ever answer
  if (!impl_->last_request) return {};
  frame = std::min(frame, impl_->last_request->frame);
  // Its answer was already taken: ask again, so that the caller never hangs.
  if (impl_->last_taken && *impl_->last_taken >= frame) impl_->requests.post(*impl_->last_request);
  for (;;) {
    std::optional<LodAnswer> answer = impl_->answers.take();
    if (!answer) {  // only a worker that ended by an exception closes them
      impl_->thread.join();
      impl_->thread.rethrow();
    }
    assert(answer);
    if (answer->frame < frame) continue;
    impl_->last_taken = answer->frame;
    return std::move(*answer);
  }
}

}  // namespace relievo
