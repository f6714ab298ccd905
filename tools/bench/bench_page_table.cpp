// bench_page_table.cpp - what a change of residency costs, and what a resident page costs beside its texels.
// Peer: the flat, mip-mapped indirection table of Andersson and Goeransson 2012 (section 3.7): an element for every
// virtual page, which names the page itself or the nearest resident ancestor, and goes to the GPU in one call a level.
#include <algorithm>
#include <array>
#include <cstdio>
#include <deque>
#include <memory>
#include <random>
#include <unordered_set>
#include <utility>

#include "src/render/page_pool.h"
#include "texturing/codec/page_codec.h"
#include "tools/bench/bench_groups.h"

namespace relievo {
namespace {

constexpr uint32_t kChanges = 100;  // nodes that come, and as many that leave

struct FrameOfChanges {
  std::vector<NodeId> leave, come;
};

// A full cache of `nodes` while the camera roams: each frame the nodes that came first leave, and others come: three of
// four of the finest level, three of four of the rest one level coarser, and so on; the coarsest levels never change.
std::vector<FrameOfChanges> changesAt(int depth, uint32_t nodes, int frames, std::vector<NodeId>* first) {
  std::mt19937_64 random(static_cast<uint64_t>(depth));
  std::deque<NodeId> resident;
  std::unordered_set<NodeId> known;
  uint32_t side = 1u << depth;
  double x = side / 2, y = side / 2;
  auto another = [&] {
    for (;;) {
      uint32_t up = 0;
      while (up < 4 && random() % 4 == 0) ++up;
      auto near = [&](double at) {
        auto jitter = static_cast<double>(random() % 4096) / 64 - 32;
        return static_cast<uint32_t>(std::clamp(at + jitter, 0.0, side - 1.0));
      };
      NodeId node =
          NodeId{0, static_cast<uint32_t>(depth), near(x), near(y)}.ancestor(static_cast<uint32_t>(depth) - up);
      if (known.insert(node).second) return node;
      x = std::clamp(x + 0.5, 0.0, side - 1.0);
    }
  };
  for (uint32_t i = 0; i < nodes; ++i) resident.push_back(another());
  first->assign(resident.begin(), resident.end());
  std::vector<FrameOfChanges> result(static_cast<size_t>(frames));
  for (FrameOfChanges& f : result) {
    x = std::clamp(x + 8, 0.0, side - 1.0);
    y = std::clamp(y + static_cast<double>(random() % 9) - 4, 0.0, side - 1.0);
    for (uint32_t i = 0; i < kChanges; ++i) {
      f.leave.push_back(resident.front());
      known.erase(resident.front());
      resident.pop_front();
      f.come.push_back(another());
      resident.push_back(f.come.back());
    }
  }
  return result;
}

PageTableEntry entryOf(uint32_t i) {
  PageTableEntry e;
  e.slots[0] = static_cast<uint16_t>(3 * i);
  e.slots[1] = static_cast<uint16_t>(3 * i + 1);
  e.slots[2] = static_cast<uint16_t>(3 * i + 2);
  return e;
}

std::vector<double> hashedTimes(int depth, uint32_t nodes, int frames) {
  std::vector<NodeId> first;
  auto changes = changesAt(depth, nodes, frames, &first);
  PageTable table(nodes, 3);
  PagePool pool(64);  // for the table's texture only
  for (uint32_t i = 0; i < nodes; ++i) table.insert(first[i], entryOf(i));
  pool.uploadTable(table);
  glFinish();
  std::vector<double> times_ms;
  for (const FrameOfChanges& f : changes) {
    double start = benchSeconds();
    for (const NodeId& node : f.leave) table.erase(node);
    for (uint32_t i = 0; i < f.come.size(); ++i) table.insert(f.come[i], entryOf(i));
    pool.uploadTable(table);
    glFinish();
    times_ms.push_back((benchSeconds() - start) * 1000);
  }
  return times_ms;
}

// Element: slot x, y, level, 255.
class FlatTable {
 public:
  using Element = std::array<uint8_t, 4>;

  explicit FlatTable(int depth)
      : levels_(static_cast<size_t>(depth) + 1), changed_(levels_.size()), texture_(gl::Texture::create()) {
    glBindTexture(GL_TEXTURE_2D, texture_.id());
    for (int level = 0; level <= depth; ++level) {
      levels_[level].resize(size_t{1} << (2 * level));
      glTexImage2D(GL_TEXTURE_2D, depth - level, GL_RGBA8, 1 << level, 1 << level, 0, GL_RGBA, GL_UNSIGNED_BYTE,
                   levels_[level].data());
    }
  }
  size_t bytes() const {
    size_t sum = 0;
    for (const auto& level : levels_) sum += level.size() * sizeof(Element);
    return 2 * sum;  // here and in the texture
  }
  void come(const NodeId& n, uint32_t slot) {
    set(n, {static_cast<uint8_t>(slot), static_cast<uint8_t>(slot >> 8), static_cast<uint8_t>(n.level), 255});
  }
  void leave(const NodeId& n) {
    NodeId up = n.parent();
    set(n, at(up));
  }
  // Every level that changed, whole.
  void upload() {
    glBindTexture(GL_TEXTURE_2D, texture_.id());
    for (size_t level = 0; level < levels_.size(); ++level) {
      if (!std::exchange(changed_[level], uint8_t{0})) continue;
      glTexSubImage2D(GL_TEXTURE_2D, static_cast<GLint>(levels_.size() - 1 - level), 0, 0, 1 << level, 1 << level,
                      GL_RGBA, GL_UNSIGNED_BYTE, levels_[level].data());
    }
  }

 private:
  Element& at(const NodeId& n) { return levels_[n.level][(size_t{n.y} << n.level) + n.x]; }
  // The node's element and all below it that showed the same page as it, or a coarser one.
  void set(const NodeId& n, Element value) {
    uint8_t shown = std::max(at(n)[2], value[2]);
    for (size_t level = n.level; level < levels_.size(); ++level) {
      size_t s = level - n.level, side = size_t{1} << s;
      for (size_t y = 0; y < side; ++y) {
        for (size_t x = 0; x < side; ++x) {
          Element& e = levels_[level][(((size_t{n.y} << s) + y) << level) + (size_t{n.x} << s) + x];
          if (e[2] <= shown) e = value;
        }
      }
      changed_[level] = 1;
    }
  }

  std::vector<std::vector<Element>> levels_;
  std::vector<uint8_t> changed_;
  gl::Texture texture_;
};

struct FlatCost {
  std::vector<double> times_ms;
  size_t bytes = 0;
};
FlatCost flatCost(int depth, uint32_t nodes, int frames) {
  FlatCost cost;
  std::vector<NodeId> first;
  auto changes = changesAt(depth, nodes, frames, &first);
  FlatTable table(depth);
  cost.bytes = table.bytes();
  for (uint32_t i = 0; i < nodes; ++i) table.come(first[i], i);
  table.upload();
  glFinish();
  for (const FrameOfChanges& f : changes) {
    double start = benchSeconds();
    for (const NodeId& node : f.leave) table.leave(node);
    for (uint32_t i = 0; i < f.come.size(); ++i) table.come(f.come[i], i);
    table.upload();
    glFinish();
    cost.times_ms.push_back((benchSeconds() - start) * 1000);
  }
  return cost;
}

std::string spread(const std::vector<double>& times) {
  char text[80];
  std::snprintf(text, sizeof text, "p99 %.3f ms, most %.3f ms, %zu frames", quantile(times, 0.99), quantile(times, 1),
                times.size());
  return text;
}

class NoBytes final : public PageSource {
 public:
  Result<EncodedPage> read(PageId) const override { return EncodedPage{}; }
};

struct Metadata {
  double bytes_a_page = 0, table_share = 0;
};
// A streamer's own memory for pages that are resident, all slots taken: cache, page table and its texture, marks.
Metadata metadataOf(uint32_t slots, int planes, bool fill) {
  StreamerOptions so;
  so.slot_count = slots;
  so.workers = 0;
  so.ready_limit = 256;
  for (int k = 0; k < planes; ++k) so.texture_planes.push_back(texturePlane(k));
  PageStreamer streamer(std::make_shared<NoBytes>(), so,
                        [](Plane, std::span<const uint8_t>, std::span<uint8_t>) { return Result<void>(); });
  uint32_t pages = slots / static_cast<uint32_t>(planes) * static_cast<uint32_t>(planes);
  std::vector<NodeRequest> requests;
  for (uint32_t i = 0; fill && i < pages / static_cast<uint32_t>(planes); ++i)
    requests.push_back({{0, 10, i & 1023, i >> 10}, 1, 0});
  for (uint64_t frame = 1; fill && frame < 1000 && streamer.cache().residentCount() < pages; ++frame) {
    streamer.beginFrame(frame, static_cast<double>(frame) / 60);
    streamer.requestTexture(requests);
    streamer.placeReady(256);
    while (auto job = streamer.takeJob()) streamer.finishJob(*job);
  }
  double resident = fill ? streamer.cache().residentCount() : pages;
  auto texture_bytes = static_cast<double>(streamer.table().texelBytes());
  return {(static_cast<double>(streamer.metadataBytes()) + texture_bytes) / resident,
          (static_cast<double>(streamer.table().metadataBytes()) + texture_bytes) / resident};
}

}  // namespace

Result<void> pageTableBench(BenchContext& context) {
  constexpr double kDefaultCacheMib = 256;
  auto slots = static_cast<uint32_t>(kDefaultCacheMib * 1024 * 1024 / kSlotBytes);
  uint32_t nodes = slots / 3;
  int frames = context.quick ? 200 : 1000;

  hashedTimes(13, nodes, 20);  // the driver's first uploads
  FlatCost at_20 = flatCost(13, nodes, context.quick ? 3 : 9);
  constexpr double kFlatGiBAt24 = 2 * 4.0 / 3 * (1ull << 34) * 4 / (1ull << 30);
  for (int depth : {13, 17}) {
    auto times = hashedTimes(depth, nodes, frames);
    BenchRow row;
    row.what = "update for 100 nodes that come and 100 that leave, 2^" + std::to_string(depth + 7) + " texels a side";
    row.measured = median(times);
    row.unit = "ms";
    row.goal = 0.2;
    row.note = spread(times);
    if (depth == 13) {
      row.baseline_name = "flat indirection table, changed levels uploaded whole";
      row.baseline = median(at_20.times_ms);
    } else {
      row.note +=
          "; a flat table would take " + std::to_string(static_cast<int>(kFlatGiBAt24)) + " GiB, half of it on the GPU";
    }
    context.row(row);
    if (context.stopped()) return {};
  }

  for (int planes : {3, 1}) {
    Metadata m = metadataOf(slots, planes, true);
    double worst = 0;
    for (uint32_t s = 512; s <= kMaxSlots; s += s / 16)
      worst = std::max(worst, metadataOf(s, planes, false).bytes_a_page);
    BenchRow row;
    row.what = std::string("page table + cache metadata a resident page, ") +
               (planes == 3 ? "LRGB PTM (3 planes)" : "colour (1 plane)");
    row.measured = m.bytes_a_page;
    row.unit = "B";
    if (planes == 3) row.goal = 64;
    row.baseline_name = "flat table at 2^20";
    row.baseline = static_cast<double>(at_20.bytes) / slots;
    char note[160];
    std::snprintf(note, sizeof note,
                  "cache of 256 MiB, full; table here and on the GPU %.1f B of it; at the worst budget from 36 MiB to "
                  "4.5 GiB %.1f B",
                  m.table_share, worst);
    row.note = note;
    context.row(row);
  }
  return {};
}

}  // namespace relievo
