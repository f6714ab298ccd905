// package_base.h - the section of a package that holds its base mesh (texturing/PACKAGE.md, "Base mesh").
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "src/artwork/base_mesh.h"
#include "src/artwork/patch_domain.h"
#include "src/base/result.h"
#include "texturing/package/patch_source.h"

namespace relievo {

// What is to be written may have one of each kind that holds for all patches; what was read has those of each patch.
struct BaseSection {
  BaseMesh mesh;
  std::vector<CoarseErrors> coarse_errors;  // a patch
  std::vector<CoarseBlocks> coarse_blocks;  // a patch; empty, as shapes, where no patch has an error
  std::vector<HeightSlopes> slopes;         // a patch; empty: not known
  std::vector<CoarseShapes> shapes;         // a patch; empty: not known. Only where there are slopes
  double error_unit_mm = 0;
  TextureDepths texture_depths;  // a patch; empty: all levels. Only where there are shapes
};

inline constexpr uint64_t kBaseHeadBytes = 40, kBaseCornerBytes = 24, kBasePatchBytes = 16 + 28 + 84,
                          kBaseSlopesBytes = 16, kBaseShapesBytes = sizeof(CoarseShapes), kBaseTextureDepthBytes = 1;
// What a section ends with; each has what those before it have.
enum class BaseSectionEnd { kBlocks, kSlopes, kShapes, kTextureDepths };
constexpr uint64_t baseSectionBytes(uint64_t corners, uint64_t patches, BaseSectionEnd end = BaseSectionEnd::kShapes) {
  return kBaseHeadBytes + corners * kBaseCornerBytes +
         patches * (kBasePatchBytes + (end >= BaseSectionEnd::kSlopes ? kBaseSlopesBytes : 0) +
                    (end >= BaseSectionEnd::kShapes ? kBaseShapesBytes : 0) +
                    (end >= BaseSectionEnd::kTextureDepths ? kBaseTextureDepthBytes : 0));
}

// A packed section (from version 4 on) is one that ends with shapes, or with texture depths, its bytes in another order
// and behind a u32, the number of corners, in a zstd frame.
inline constexpr uint64_t kLeastPackedBaseBytes = 16;
// Of a section that does not get smaller: a block's head for every kPackedTogether bytes, and the frame's.
inline constexpr uint64_t kPackedTogether = 2048;
constexpr uint64_t mostPackedBaseBytes(uint64_t section_bytes) {
  return section_bytes + section_bytes / (kPackedTogether / 4) + 64;
}

// What is wrong with a section, its offset from the section's start; names no file.
Error damagedBaseMesh(const std::string& message, uint64_t offset = 0);
// Of packed and coded sections: more corners than patches can name? Checked before anything is allocated.
std::optional<Error> tooManyCorners(uint64_t corners, uint32_t patches);

// What is wrong with what a section says, at its first byte that says so; nothing: it is sound.
struct BaseSectionFault {
  std::string message;
  uint64_t offset;
};
std::optional<BaseSectionFault> baseSectionFault(const BaseSection& section);

std::vector<uint8_t> encodeBaseSection(const BaseSection& section);
// Safe for untrusted bytes: counts are compared with the length before anything is allocated. patches: how many there
// must be. The error names what is wrong, and its offset counts from the section's start; its file is empty.
Result<BaseSection> decodeBaseSection(std::span<const uint8_t> bytes, uint32_t patches);
std::vector<uint8_t> packBaseSection(std::span<const uint8_t> section, int zstd_level);
// Safe alike: allocates no more than the largest section of so many patches has. end: what the section ends with.
Result<std::vector<uint8_t>> unpackBaseSection(std::span<const uint8_t> packed, uint32_t patches,
                                               BaseSectionEnd end = BaseSectionEnd::kShapes);

}  // namespace relievo
