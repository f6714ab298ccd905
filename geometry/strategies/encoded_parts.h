// encoded_parts.h - what a kept mesh takes on a disk or on a link, in parts that are read one by one. Places and
// heights, which are integers, and indices go through meshoptimizer's codecs for vertices and indices (those of glTF's
// EXT_meshopt_compression) and zstd: nothing is lost.
#pragma once

#include <compare>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "geometry/strategies/lod_strategy.h"

namespace relievo {

struct EncodedPart {
  std::vector<uint8_t> vertices, indices;
  size_t vertex_count = 0, index_count = 0;
};
struct PartVertex {
  uint32_t patch = 0;
  int32_t x = 0, y = 0;  // units
  uint16_t height_steps = 0;
  friend auto operator<=>(const PartVertex&, const PartVertex&) = default;
};
struct DecodedPart {
  std::vector<PartVertex> vertices;
  std::vector<uint32_t> indices;  // three a triangle
};
// The triangles of these ranges, in an order of its own. They have at most 65,536 patches.
EncodedPart encodePart(const StrategyMesh& mesh, std::span<const IndexRange> ranges);
std::optional<DecodedPart> decodePart(const EncodedPart& part);  // none: it is damaged

// Makes the mesh's parts, one of each list of ranges, and notes their bytes and how long they took to decode. No
// triangle is in two of them. workers: threads; 0: as many as there are cores.
void encodeParts(StrategyMesh& mesh, std::vector<std::vector<IndexRange>> parts, int workers);

// The parts that have a triangle of these ranges, each once, ascending. Ranges: ascending, without overlaps.
std::vector<uint32_t> partsOf(const StrategyMesh& mesh, std::span<const IndexRange> ranges);

}  // namespace relievo
