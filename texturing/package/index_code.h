// index_code.h - the index of texture and relief pages in few bytes: a third to a fifth of what its entries take
// (texturing/PACKAGE.md, "Coded index"). Some hundred entries a chunk, each by itself, so that a reader decodes those
// that it looks up. Pure. Internal to texturing/.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "texturing/package/package_layout.h"

namespace relievo {

inline constexpr uint64_t kIndexHeadBytes = 16, kIndexChunkBytes = 20;
inline constexpr uint32_t kIndexChunkEntries = 512;   // a chunk ends with the block that brings it there
inline constexpr uint64_t kLeastCodedEntryBytes = 4;  // the hash of a page

// Blocks that follow one another in a tree.
struct IndexChunk {
  uint64_t first = 0;   // of their entries, from the beginning of the index that the code stands for
  uint64_t offset = 0;  // of the code, from the section's beginning
  uint32_t size = 0;
  uint64_t hash = 0;  // xxh3-64 of the code
};

// What a package's entries are coded with.
struct IndexCodeOf {
  int planes = 1;             // of the texture
  uint64_t pages_offset = 0;  // entries are told from there
  bool empty_pages = false;   // version 10: pages may have no bytes; then no hash is coded
};

// The entries of blocks of one tree as IndexLayout has them, with or without their checksums, into a code; relief: of
// that tree. Nothing where an entry lies before the pages, or has a largest height below its least: no builder makes
// such.
std::optional<std::vector<uint8_t>> encodeIndexBlocks(const IndexCodeOf& of, bool relief,
                                                      std::span<const IndexLayout::Block> blocks,
                                                      std::span<const uint8_t> bytes);
// The other way; checksums of blocks are 0, those of pages their lowest 32 bits. Safe for untrusted bytes; false: they
// are no code of such blocks.
bool decodeIndexBlocks(std::span<const uint8_t> code, const IndexCodeOf& of, bool relief,
                       std::span<const IndexLayout::Block> blocks, std::span<uint8_t> bytes);

// What stands before the chunks.
std::vector<uint8_t> encodeIndexDirectory(std::span<const IndexChunk> chunks);
// bytes: of the section, but for errors by block behind the chunks; entries: of the index that it stands for. Safe for
// untrusted bytes: chunks tile both. Nothing: they are damaged.
std::optional<std::vector<IndexChunk>> decodeIndexDirectory(std::span<const uint8_t> directory, uint64_t section_bytes,
                                                            uint64_t entries_bytes);
// How many bytes the directory has by its first kIndexHeadBytes, at most section_bytes.
uint64_t indexDirectoryBytes(std::span<const uint8_t> head, uint64_t section_bytes);

}  // namespace relievo
