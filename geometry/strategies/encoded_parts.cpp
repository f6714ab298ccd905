#include "geometry/strategies/encoded_parts.h"

#include <algorithm>
#include <cassert>
#include <chrono>
#include <unordered_map>

#include <meshoptimizer.h>
#include <zstd.h>

#include "src/base/parallel_for.h"

namespace relievo {
namespace {

constexpr int kZstdLevel = 12;  // above it these parts lose less than 1 % of their bytes

// Of a vertex: meshoptimizer takes multiples of four bytes, and codes each byte by its difference from the vertex
// before.
struct EncodedVertex {
  uint32_t x = 0, y = 0;
  uint16_t height = 0, patch_index = 0;  // in the part's list of patches
  uint32_t patch = 0;                    // of the first vertex of that index; else 0
};

struct PartMesh {
  std::vector<EncodedVertex> vertices;
  std::vector<uint32_t> indices;
};

PartMesh partMesh(const StrategyMesh& mesh, std::span<const IndexRange> ranges) {
  PartMesh out;
  std::unordered_map<uint32_t, uint32_t> known;
  std::vector<uint32_t> names;
  for (const IndexRange& r : ranges)
    for (uint32_t k = r.first; k < r.first + r.count; ++k) {
      const auto [at, fresh] = known.try_emplace(mesh.indices[k], static_cast<uint32_t>(names.size()));
      if (fresh) names.push_back(mesh.indices[k]);
      out.indices.push_back(at->second);
    }
  // In the order in which triangles that follow one another need them: then neighbours differ by little.
  meshopt_optimizeVertexCache(out.indices.data(), out.indices.data(), out.indices.size(), names.size());
  std::vector<uint32_t> place(names.size());
  meshopt_optimizeVertexFetchRemap(place.data(), out.indices.data(), out.indices.size(), names.size());
  meshopt_remapIndexBuffer(out.indices.data(), out.indices.data(), out.indices.size(), place.data());
  out.vertices.resize(names.size());
  std::unordered_map<uint32_t, uint16_t> patches;
  std::vector<uint32_t> at_place(names.size());
  for (size_t v = 0; v < names.size(); ++v) at_place[place[v]] = names[v];
  for (size_t v = 0; v < names.size(); ++v) {
    const StrategyVertex& from = mesh.vertices[at_place[v]];
    const uint32_t patch = mesh.instances[from.instance].node.patch;
    const auto [local, fresh] = patches.try_emplace(patch, static_cast<uint16_t>(patches.size()));
    out.vertices[v] = {static_cast<uint32_t>(from.x), static_cast<uint32_t>(from.y),
                       static_cast<uint16_t>(from.height_steps), local->second, fresh ? patch : 0};
  }
  return out;
}

std::vector<uint8_t> zstdOf(const std::vector<uint8_t>& bytes) {
  std::vector<uint8_t> out(ZSTD_compressBound(bytes.size()));
  const size_t size = ZSTD_compress(out.data(), out.size(), bytes.data(), bytes.size(), kZstdLevel);
  assert(!ZSTD_isError(size));
  out.resize(size);
  return out;
}
std::optional<std::vector<uint8_t>> fromZstd(const std::vector<uint8_t>& bytes) {
  const unsigned long long size = ZSTD_getFrameContentSize(bytes.data(), bytes.size());
  if (size == ZSTD_CONTENTSIZE_ERROR || size == ZSTD_CONTENTSIZE_UNKNOWN || size > (1u << 30)) return std::nullopt;
  std::vector<uint8_t> out(size);
  if (ZSTD_decompress(out.data(), out.size(), bytes.data(), bytes.size()) != out.size()) return std::nullopt;
  return out;
}

}  // namespace

EncodedPart encodePart(const StrategyMesh& mesh, std::span<const IndexRange> ranges) {
  const PartMesh part = partMesh(mesh, ranges);
  std::vector<uint8_t> vertices(meshopt_encodeVertexBufferBound(part.vertices.size(), sizeof(EncodedVertex)));
  vertices.resize(meshopt_encodeVertexBuffer(vertices.data(), vertices.size(), part.vertices.data(),
                                             part.vertices.size(), sizeof(EncodedVertex)));
  std::vector<uint8_t> indices(meshopt_encodeIndexBufferBound(part.indices.size(), part.vertices.size()));
  indices.resize(meshopt_encodeIndexBuffer(indices.data(), indices.size(), part.indices.data(), part.indices.size()));
  return {zstdOf(vertices), zstdOf(indices), part.vertices.size(), part.indices.size()};
}

std::optional<DecodedPart> decodePart(const EncodedPart& part) {
  const auto vertices = fromZstd(part.vertices), indices = fromZstd(part.indices);
  if (!vertices || !indices) return std::nullopt;
  std::vector<EncodedVertex> coded(part.vertex_count);
  DecodedPart out;
  out.indices.resize(part.index_count);
  if (meshopt_decodeVertexBuffer(coded.data(), coded.size(), sizeof(EncodedVertex), vertices->data(),
                                 vertices->size()) != 0 ||
      meshopt_decodeIndexBuffer(out.indices.data(), out.indices.size(), sizeof(uint32_t), indices->data(),
                                indices->size()) != 0)
    return std::nullopt;
  std::vector<uint32_t> patches;
  for (const EncodedVertex& v : coded) {
    if (v.patch_index == patches.size()) patches.push_back(v.patch);
    if (v.patch_index >= patches.size()) return std::nullopt;
    out.vertices.push_back({patches[v.patch_index], static_cast<int32_t>(v.x), static_cast<int32_t>(v.y), v.height});
  }
  for (const uint32_t i : out.indices)
    if (i >= out.vertices.size()) return std::nullopt;
  return out;
}

void encodeParts(StrategyMesh& mesh, std::vector<std::vector<IndexRange>> parts, int workers) {
  mesh.parts.resize(parts.size());
  parallelFor(parts.size(), workers, nullptr, [&](size_t p) {
    const EncodedPart encoded = encodePart(mesh, parts[p]);
    const auto start = std::chrono::steady_clock::now();
    const bool decoded = decodePart(encoded).has_value();
    assert(decoded);
    (void)decoded;
    const std::chrono::duration<float, std::milli> decoding = std::chrono::steady_clock::now() - start;
    mesh.parts[p] = {static_cast<uint32_t>(encoded.vertices.size() + encoded.indices.size()), decoding.count()};
  });
  mesh.part_ranges.clear();
  for (uint32_t p = 0; p < parts.size(); ++p)
    for (const IndexRange& r : parts[p]) mesh.part_ranges.push_back({r, p});
  std::sort(mesh.part_ranges.begin(), mesh.part_ranges.end(),
            [](const auto& a, const auto& b) { return a.range.first < b.range.first; });
}

std::vector<uint32_t> partsOf(const StrategyMesh& mesh, std::span<const IndexRange> ranges) {
  std::vector<uint32_t> out;
  auto at = mesh.part_ranges.begin();
  for (const IndexRange& r : ranges) {
    while (at != mesh.part_ranges.end() && at->range.first + at->range.count <= r.first) ++at;
    for (auto in = at; in != mesh.part_ranges.end() && in->range.first < r.first + r.count; ++in)
      out.push_back(in->part);
  }
  std::sort(out.begin(), out.end());
  out.erase(std::unique(out.begin(), out.end()), out.end());
  return out;
}

}  // namespace relievo
