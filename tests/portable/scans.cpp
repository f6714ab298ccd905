// portable_scans A B - are two packages of one scan, made on different machines, the same but for rounding? Embree
// rounds single precision as the machine's instructions do: of triangles that meet in a line it may name another one,
// and just beyond the scan's border find none. Same base mesh and pages; no more than 1 height in 1,000 lies further
// apart than two steps, and none by more than 1e-4 of the base mesh's size; no texel by more than 2 of 255.
// Exit codes: 0 they are, 7 they are not (it says where), 1 usage or unreadable.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <vector>

#include "texturing/codec/page_codec.h"
#include "texturing/package/package.h"
#include "texturing/package/texture_pages.h"

using namespace relievo;

namespace {

[[noreturn]] void stop(const Error& error) {
  std::fprintf(stderr, "%s\n", error.text().c_str());
  std::exit(1);
}
template <class T>
T valueOf(Result<T> result) {
  if (!result) stop(result.error());
  return std::move(*result);
}

template <class Use>
void forEachNode(const PatchDomain& domain, int depth, Use use) {
  for (uint32_t patch = 0; patch < domain.patchCount(); ++patch)
    for (int level = 0; level <= depth; ++level)
      for (uint32_t y = 0; y < 1u << level; ++y)
        for (uint32_t x = 0; x < 1u << level; ++x)
          if (const NodeId node{patch, static_cast<uint8_t>(level), x, y}; domain.nodeExists(node)) use(node);
}

bool sameLayout(const Manifest& a, const Manifest& b) {
  return a.base && b.base && *a.base == *b.base && a.page_count == b.page_count &&
         a.domain.patchCount() == b.domain.patchCount() && a.domain.texture_depth == b.domain.texture_depth &&
         a.domain.relief_depth == b.domain.relief_depth && a.texture.basis == b.texture.basis;
}

bool sameHeights(const Package& a, const Package& b) {
  const PatchDomain &m = a.manifest().domain, &n = b.manifest().domain;
  glm::vec3 low(1e30f), high(-1e30f);
  for (const BaseCorner& c : a.manifest().base->corners)
    low = glm::min(low, c.position_mm), high = glm::max(high, c.position_mm);
  const double step_mm = std::max(m.relief_scale_mm, n.relief_scale_mm), most_mm = 1e-4 * glm::length(high - low);
  PageDecoder decoder;
  std::vector<uint16_t> p(kReliefPageSamples), q(kReliefPageSamples);
  uint64_t all = 0, far = 0;
  double furthest_mm = 0;
  forEachNode(m, m.relief_depth, [&](const NodeId& node) {
    const PageId id(Plane::kRelief, node);
    if (auto done = decoder.decodeRelief(valueOf(a.read(id)).bytes, p); !done) stop(done.error());
    if (auto done = decoder.decodeRelief(valueOf(b.read(id)).bytes, q); !done) stop(done.error());
    for (size_t i = 0; i < p.size(); ++i) {
      const double mm =
          std::abs(m.relief_offset_mm + p[i] * m.relief_scale_mm - n.relief_offset_mm - q[i] * n.relief_scale_mm);
      furthest_mm = std::max(furthest_mm, mm);
      ++all, far += mm > 2 * step_mm;
    }
  });
  std::printf("heights: %.3g mm apart at most, %llu of %llu further than two steps of %.3g mm\n", furthest_mm,
              static_cast<unsigned long long>(far), static_cast<unsigned long long>(all), step_mm);
  return furthest_mm <= most_mm && far * 1000 <= all;
}

bool sameTexels(const std::shared_ptr<const Package>& a, const std::shared_ptr<const Package>& b) {
  const Manifest& m = a->manifest();
  PageDecoder decoder;
  const TexturePages from_a(a), from_b(b);
  std::vector<uint8_t> p(kSlotBytes), q(kSlotBytes);
  int furthest = 0;
  for (int k = 0; k < m.texture.planes(); ++k) {
    forEachNode(m.domain, m.domain.texture_depth, [&](const NodeId& node) {
      const PageId id(texturePlane(k), node);
      if (auto done = from_a.read(id, decoder, p); !done) stop(done.error());
      if (auto done = from_b.read(id, decoder, q); !done) stop(done.error());
      for (size_t i = 0; i < p.size(); ++i) furthest = std::max(furthest, std::abs(p[i] - q[i]));
    });
  }
  std::printf("texels: %d of 255 apart at most\n", furthest);
  return furthest <= 2;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return std::fprintf(stderr, "usage: portable_scans A B\n"), 1;
  const auto a = valueOf(Package::open(argv[1])), b = valueOf(Package::open(argv[2]));
  if (!sameLayout(a->manifest(), b->manifest())) return std::printf("other base meshes or pages\n"), 7;
  const bool heights = sameHeights(*a, *b), texels = sameTexels(a, b);
  return heights && texels ? 0 : 7;
}
