#include <atomic>
#include <map>
#include <mutex>
#include <thread>

#include "src/base/channel.h"
#include "texturing/package.h"
#include "texturing/package_layout.h"
#include "texturing/page_codec.h"

namespace relievo {
namespace {

struct Job {
  uint64_t serial = 0;
  bool relief = false;
  IndexLayout::Block block;
};
struct Outcome {
  uint64_t pages = 0, bytes = 0;
  std::vector<DamagedPage> damaged;
  std::vector<std::string> other;
};

Outcome verifyBlock(const Package& package, PageDecoder& decoder, std::vector<uint8_t>& texels, const Job& job) {
  Outcome out;
  const int planes = job.relief ? 1 : package.manifest().texture.planes();
  auto plane = [&](int k) { return job.relief ? Plane::kRelief : texturePlane(k); };
  out.pages = uint64_t{job.block.columns} * job.block.rows * planes;
  if (auto sound = package.checkIndex(PageId(plane(0), job.block.first)); !sound) {
    const NodeId& n = job.block.first;
    out.other.push_back(sound.error().text() + ": " + std::to_string(out.pages) + " pages lost, " +
                        (job.relief ? "relief" : "texture") + " patch " + std::to_string(n.patch) + " level " +
                        std::to_string(n.level) + " x " + std::to_string(n.x) + ".." +
                        std::to_string(n.x + job.block.columns - 1) + " y " + std::to_string(n.y) + ".." +
                        std::to_string(n.y + job.block.rows - 1));
    return out;
  }
  for (uint32_t y = 0; y < job.block.rows; ++y) {
    for (uint32_t x = 0; x < job.block.columns; ++x) {
      NodeId node = job.block.first;
      node.x += x;
      node.y += y;
      for (int k = 0; k < planes; ++k) {
        PageId id(plane(k), node);
        auto page = package.read(id);
        if (!page) {
          out.damaged.push_back({id, page.error().text()});
          continue;
        }
        out.bytes += page->bytes.size();
        if (auto decoded = decoder.decodeToSlot(plane(k), page->bytes, texels); !decoded) {
          auto record = package.record(id);
          out.damaged.push_back({id, "page " + describePage(id) + " at byte " +
                                         std::to_string(record ? record->offset : 0) + ": " + decoded.error().message});
        }
      }
    }
  }
  return out;
}

}  // namespace

Result<VerifyReport> verifyPackage(const Package& package, int workers, void (*progress)(uint64_t done, uint64_t total),
                                   const std::atomic<bool>* interrupted) {
  const Manifest& manifest = package.manifest();
  if (workers <= 0) workers = std::max(1u, std::thread::hardware_concurrency());
  VerifyReport report;
  report.other = package.warnings();

  Channel<Job> jobs(static_cast<size_t>(workers) * 4);
  std::mutex mutex;
  std::map<uint64_t, Outcome> bad;  // outcomes with damage, by their place in the index
  std::atomic<uint64_t> done{0};
  std::vector<std::thread> threads;
  for (int i = 0; i < workers; ++i) {
    threads.emplace_back([&] {
      PageDecoder decoder;
      std::vector<uint8_t> texels(kSlotBytes);
      while (auto job = jobs.pop()) {
        Outcome out = verifyBlock(package, decoder, texels, *job);
        done += out.pages;
        std::lock_guard lock(mutex);
        report.pages += out.pages;
        report.bytes += out.bytes;
        if (!out.damaged.empty() || !out.other.empty()) bad.emplace(job->serial, std::move(out));
      }
    });
  }
  auto stop = [&] { return interrupted && interrupted->load(); };
  PackageLayout layout = packageLayout(manifest.domain, manifest.texture, 0, 0);
  uint64_t serial = 0;
  for (bool relief : {false, true}) {
    (relief ? layout.relief : layout.texture).forEachBlock([&](const IndexLayout::Block& block) {
      jobs.push({serial++, relief, block});
      if (progress) progress(done, manifest.page_count);
      if (relief) {
        if (auto sound = package.checkReliefDetail(block.first); !sound) {
          std::lock_guard lock(mutex);
          report.other.push_back(sound.error().text() + ": errors by block, relief level " + std::to_string(block.first.level));
        }
      }
      return !stop();
    });
  }
  jobs.close();
  for (std::thread& t : threads) t.join();
  if (stop()) return Error{ErrorKind::kInterrupted, package.path(), "interrupted", "", {}};
  if (progress) progress(done, manifest.page_count);
  for (std::string& problem : package.tailProblems()) report.other.push_back(std::move(problem));
  for (auto& [place, out] : bad) {
    for (auto& d : out.damaged) report.damaged.push_back(std::move(d));
    for (auto& o : out.other) report.other.push_back(std::move(o));
  }
  return report;
}

}  // namespace relievo
