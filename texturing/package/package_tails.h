// package_tails.h - the section of a package that holds its patches' tails (texturing/PACKAGE.md, "Tails"): chunks of
// 256 patches, each by itself, and a directory of them.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "src/base/result.h"
#include "texturing/codec/tail_code.h"
#include "texturing/package/package_layout.h"
#include "texturing/package/patch_tails.h"

namespace relievo {

inline constexpr uint32_t kTailsChunkPatches = 256;
inline constexpr uint64_t kTailsHeadBytes = 24, kTailsEntryBytes = 20;
constexpr uint32_t tailsChunks(uint32_t patches) { return (patches + kTailsChunkPatches - 1) / kTailsChunkPatches; }
constexpr uint64_t tailsDirectoryBytes(uint32_t patches) {
  return kTailsHeadBytes + tailsChunks(patches) * kTailsEntryBytes;
}

struct TailsChunk {
  uint64_t offset = 0;  // in the file
  uint32_t size = 0;
  uint64_t hash = 0;  // xxh3-64
};
std::vector<uint8_t> encodeTailsDirectory(uint32_t patches, int channels, std::span<const TailsChunk> chunks);
// Safe for untrusted bytes. The error names what is wrong; its offset counts from the directory's start, its file is
// empty.
Result<std::vector<TailsChunk>> decodeTailsDirectory(std::span<const uint8_t> bytes, uint32_t patches, int channels);

// One of a sound directory's chunks.
TailsChunk tailsChunkAt(std::span<const uint8_t> directory, uint32_t number);

// How chunks are stored: differences in a zstd frame up to version 5; texturing/codec/tail_code.h from version 6 on, by
// grids from version 10 on.
enum class TailsStorage : uint8_t { kZstd, kCoded, kGrids };
TailsStorage tailsStorage(const PackageHeader& header);

// Of patches first .. first + count of `tails`. corners: theirs in the base mesh, of kGrids alone. zstd_level: of kZstd
// alone.
std::vector<uint8_t> encodeTailsChunk(const PatchTails& tails, uint32_t first, uint32_t count, TailsStorage storage,
                                      PatchCorners corners, int zstd_level);
// Safe for untrusted bytes: they decode to what that many patches take, or not at all.
Result<void> decodeTailsChunk(std::span<const uint8_t> bytes, uint32_t first, uint32_t count, TailsStorage storage,
                              PatchCorners corners, PatchTails& tails);

}  // namespace relievo
