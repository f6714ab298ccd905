#include "tools/compare/compare_scene.h"

#include <algorithm>
#include <chrono>
#include <vector>

#include "texturing/codec/page_codec.h"
#include "texturing/package/package_layout.h"
#include "texturing/stream/relief_subslots.h"

namespace relievo {

Result<CompareScene> loadCompareScene(std::shared_ptr<const Package> package, uint64_t budget_bytes, gl::Api api,
                                      std::unique_ptr<StrategyPass>* pass, const std::atomic<bool>* interrupted,
                                      const PageSource* source) {
  const PatchDomain& domain = package->manifest().domain;
  const std::string& path = package->path();
  if (domain.relief_depth < 0)
    return Error{ErrorKind::kUnsupported,
                 path,
                 "the artwork has no relief: there is no geometry to compare",
                 "build it with --relief",
                 {}};
  const std::shared_ptr<const BaseMesh>& base = package->manifest().base;
  const PageSource& read_from = source ? *source : *package;
  uint64_t pages = 0;
  for (int level = 0; level <= domain.relief_depth; ++level) pages += domain.nodeCount(level);
  uint64_t bytes = pages * partBytes(kReliefPartLevel);
  if (bytes > budget_bytes || pages > StrategyPass::maxPages()) {
    return Error{
        ErrorKind::kUnsupported,
        path,
        "its relief has " + std::to_string(pages) + " pages, " + std::to_string(bytes >> 20) +
            " MiB, all of which would be held in memory",
        bytes > budget_bytes ? "raise --memory-mib, or compare a part of the artwork" : "compare a part of the artwork",
        {}};
  }
  CompareScene scene;
  auto field = domain.isFlat() ? std::make_shared<ReliefField>(domain.flat()) : nullptr;
  auto body = domain.isFlat() ? nullptr : std::make_shared<BodyField>(base, domain);
  auto resident = std::make_shared<ReliefSet>();
  *pass = std::make_unique<StrategyPass>(api, domain, base, static_cast<uint32_t>(pages));
  PageDecoder decoder;
  std::vector<uint8_t> texels(kSlotBytes);
  std::vector<uint16_t> samples(kReliefPageSamples);
  for (uint32_t level = 0; static_cast<int>(level) <= domain.relief_depth; ++level)
    for (uint32_t patch = 0; patch < domain.patchCount(); ++patch)
      for (uint32_t y = 0; y < 1u << level; ++y)
        for (uint32_t x = 0; x < 1u << level; ++x) {
          NodeId node{patch, level, x, y};
          if (!domain.nodeExists(node)) continue;
          if (interrupted && *interrupted) return Error{ErrorKind::kInterrupted, "", "interrupted", "", {}};
          auto encoded = read_from.read(PageId(Plane::kRelief, node));
          if (!encoded) return encoded.error();
          auto undecoded = [&](const Error& error) {
            return Error{error.kind,
                         path,
                         "page " + describePage(PageId(Plane::kRelief, node)) + ": " + error.message,
                         "relievo verify names all damage",
                         {}};
          };
          const auto start = std::chrono::steady_clock::now();
          if (auto done = decoder.decodeToSlot(Plane::kRelief, encoded->bytes, texels); !done)
            return undecoded(done.error());
          const std::chrono::duration<float, std::milli> decoding = std::chrono::steady_clock::now() - start;
          (*pass)->upload(node, texels.data());
          if (static_cast<int>(level) == domain.relief_depth) {
            if (auto done = decoder.decodeRelief(encoded->bytes, samples); !done) return undecoded(done.error());
            if (body) body->setPage(node, samples);
            else field->setPage(node, samples);
          }
          resident->insert(node);
          scene.encoded[node] = {static_cast<uint32_t>(encoded->storedBytes()), decoding.count()};
          ++scene.pages;
        }
  scene.strategy = {domain, artworkFromPackage(package).oracle, resident, field,
                    body,   package->manifest().coarse_errors};
  return scene;
}

ReferenceGrid referenceGrid(ReliefBounds3d& bounds, const ViewBounds& screen, double exaggerate,
                            uint64_t triangles_at_most) {
  ReferenceGrid grid;
  for (int level = bounds.finestLevel(); level > 0; --level) {
    const int node_level = std::max(0, level - kMaxGridLevel);
    const auto nodes = bounds.nodesInView(screen, node_level, exaggerate);
    if ((nodes.size() << (2 * (level - node_level) + 1)) > triangles_at_most) {
      grid.whole = false;
      continue;
    }
    for (const NodeId& n : nodes) grid.drawn.instances.push_back(bounds.instance(n, level - node_level));
    break;
  }
  return grid;
}

}  // namespace relievo
