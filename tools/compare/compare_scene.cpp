#include "tools/compare/compare_scene.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <string>
#include <unordered_map>
#include <vector>

#include "texturing/codec/page_codec.h"
#include "texturing/package/package_layout.h"
#include "texturing/stream/relief_subslots.h"

namespace relievo {
namespace {

Error interruptedError() { return {ErrorKind::kInterrupted, "", "interrupted", "", {}}; }

// use(node), which may end with an error, for every relief page, coarse before fine.
template <class Use>
Result<void> forEachPage(const PatchDomain& domain, Use&& use) {
  for (uint32_t level = 0; static_cast<int>(level) <= domain.relief_depth; ++level)
    for (uint32_t patch = 0; patch < domain.patchCount(); ++patch)
      for (uint32_t y = 0; y < 1u << level; ++y)
        for (uint32_t x = 0; x < 1u << level; ++x) {
          const NodeId node{patch, level, x, y};
          if (!domain.nodeExists(node)) continue;
          if (Result<void> done = use(node); !done) return done;
        }
  return {};
}

struct AlikePages {
  struct Page {
    NodeId first;  // of those with the same bytes
    uint32_t stored_bytes = 0;
  };
  std::unordered_map<NodeId, Page> all;
  uint64_t count = 0;  // with other bytes than all before
  const NodeId& first(const NodeId& node) const { return all.at(node).first; }
};
Result<AlikePages> alikePages(const PatchDomain& domain, const PageSource& source,
                              const std::atomic<bool>* interrupted) {
  AlikePages out;
  std::unordered_map<std::string, NodeId> by_bytes;
  auto done = forEachPage(domain, [&](const NodeId& node) -> Result<void> {
    if (interrupted && *interrupted) return interruptedError();
    auto encoded = source.read(PageId(Plane::kRelief, node));
    if (!encoded) return encoded.error();
    const auto [known, is_new] = by_bytes.try_emplace({encoded->bytes.begin(), encoded->bytes.end()}, node);
    out.all[node] = {known->second, static_cast<uint32_t>(encoded->storedBytes())};
    out.count += is_new;
    return {};
  });
  if (!done) return done.error();
  return out;
}

// BodyField::grid_of: patches share a grid whose finest pages are alike, if each has but one.
std::vector<uint32_t> alikePatches(const PatchDomain& domain, const AlikePages& alike) {
  std::vector<uint32_t> out;
  std::unordered_map<NodeId, uint32_t> grids;
  for (uint32_t patch = 0; domain.relief_depth == 0 && patch < domain.patchCount(); ++patch)
    out.push_back(grids.try_emplace(alike.first({patch, 0, 0, 0}), static_cast<uint32_t>(grids.size())).first->second);
  return out;
}

}  // namespace

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
  auto alike = alikePages(domain, read_from, interrupted);
  if (!alike) return alike.error();
  const uint64_t pages = alike->count, bytes = pages * partBytes(kReliefPartLevel);
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
  scene.pages = pages;
  auto field = domain.isFlat() ? std::make_shared<ReliefField>(domain.flat()) : nullptr;
  auto body = domain.isFlat() ? nullptr : std::make_shared<BodyField>(base, domain, alikePatches(domain, *alike));
  auto resident = std::make_shared<ReliefSet>();
  *pass = std::make_unique<StrategyPass>(api, domain, base, static_cast<uint32_t>(pages));
  PageDecoder decoder;
  std::vector<uint8_t> texels(kSlotBytes);
  std::vector<uint16_t> samples(kReliefPageSamples);
  auto take = [&](const NodeId& node) -> Result<void> {
    if (interrupted && *interrupted) return interruptedError();
    resident->insert(node);
    const NodeId& first = alike->first(node);
    const bool finest = static_cast<int>(node.level) == domain.relief_depth;
    if (first != node) {
      (*pass)->share(node, first);
      scene.encoded[node] = {alike->all.at(node).stored_bytes, scene.encoded[first].decode_ms};
      const bool shares_grid = body && domain.relief_depth == 0;
      if (!finest || shares_grid) return {};
    }
    auto encoded = read_from.read(PageId(Plane::kRelief, node));
    if (!encoded) return encoded.error();
    auto undecoded = [&](const Error& error) {
      return Error{error.kind,
                   path,
                   "page " + describePage(PageId(Plane::kRelief, node)) + ": " + error.message,
                   "relievo verify names all damage",
                   {}};
    };
    if (first == node) {
      const auto start = std::chrono::steady_clock::now();
      if (auto done = decoder.decodeToSlot(Plane::kRelief, encoded->bytes, texels); !done)
        return undecoded(done.error());
      const std::chrono::duration<float, std::milli> decoding = std::chrono::steady_clock::now() - start;
      (*pass)->upload(node, texels.data());
      scene.encoded[node] = {alike->all.at(node).stored_bytes, decoding.count()};
    }
    if (!finest) return {};
    if (auto done = decoder.decodeRelief(encoded->bytes, samples); !done) return undecoded(done.error());
    if (body) body->setPage(node, samples);
    else field->setPage(node, samples);
    return {};
  };
  if (auto done = forEachPage(domain, take); !done) return done.error();
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
