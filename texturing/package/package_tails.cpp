#include "texturing/package/package_tails.h"

#include <zstd.h>

namespace relievo {
namespace {

static_assert(kTailCodeCellsLog2 == kTailCellsLog2 && kTailCodeTexels == kTailTexels);

// Calls f(value, the one before it: to the left, or above at a row's beginning, or 0) over a square, in an order in
// which the one before comes first.
template <class T, class F>
void overSquare(T* values, int side, F&& f) {
  for (int y = 0; y < side; ++y)
    for (int x = 0; x < side; ++x) {
      T& v = values[y * side + x];
      f(v, x > 0 ? values[y * side + x - 1] : y > 0 ? values[(y - 1) * side] : T{0});
    }
}

// In the order in which the section has them.
template <class Heights, class Texels>
void overTails(PatchTails& tails, uint32_t first, uint32_t count, Heights&& heights, Texels&& texels) {
  for (uint32_t p = first; p < first + count; ++p) overSquare(tails.heightsOf(p).data(), kTailSamples, heights);
  for (uint32_t p = first; p < first + count; ++p) {
    uint8_t* at = tails.texelsOf(p).data();
    for (int level = 0; level < kTailLevels; ++level)
      for (int c = 0; c < tails.channels; ++c, at += PatchTails::side(level) * PatchTails::side(level))
        overSquare(at, PatchTails::side(level), texels);
  }
}

}  // namespace

TailsStorage tailsStorage(const PackageHeader& header) {
  return header.light_patches ? TailsStorage::kGrids : header.coded_tails ? TailsStorage::kCoded : TailsStorage::kZstd;
}

std::vector<uint8_t> encodeTailsDirectory(uint32_t patches, int channels, std::span<const TailsChunk> chunks) {
  std::vector<uint8_t> out(tailsDirectoryBytes(patches));
  uint8_t* p = out.data();
  auto put = [&](auto v) {
    storeLittle(p, v);
    p += sizeof v;
  };
  put(patches);
  put(uint32_t{1} << kTailCellsLog2);
  put(uint32_t{kTailTexels});
  put(static_cast<uint32_t>(channels));
  put(kTailsChunkPatches);
  put(uint32_t{0});
  for (const TailsChunk& c : chunks) {
    put(c.offset);
    put(c.size);
    put(c.hash);
  }
  return out;
}

Result<std::vector<TailsChunk>> decodeTailsDirectory(std::span<const uint8_t> bytes, uint32_t patches, int channels) {
  auto invalid = [](uint64_t offset, std::string message) {
    return Error{ErrorKind::kInvalidData, "", "the patches' tails are damaged: " + message,
                 "rebuild the package, or get a whole copy", offset};
  };
  if (bytes.size() != tailsDirectoryBytes(patches))
    return invalid(0, "expected a directory of " + std::to_string(tailsDirectoryBytes(patches)) + " bytes, found " +
                          std::to_string(bytes.size()));
  const struct {
    uint32_t expected;
    const char* what;
  } fields[] = {{patches, "patches"},
                {1u << kTailCellsLog2, "cells a side"},
                {kTailTexels, "texels a side"},
                {static_cast<uint32_t>(channels), "channels"},
                {kTailsChunkPatches, "patches a chunk"}};
  for (size_t i = 0; i < std::size(fields); ++i) {
    if (const auto found = loadLittle<uint32_t>(bytes.data() + 4 * i); found != fields[i].expected)
      return invalid(4 * i, "expected " + std::to_string(fields[i].expected) + " " + fields[i].what + ", found " +
                                std::to_string(found));
  }
  std::vector<TailsChunk> out(tailsChunks(patches));
  for (TailsChunk& c : out) {
    c = tailsChunkAt(bytes, static_cast<uint32_t>(&c - out.data()));
  }
  return out;
}

TailsChunk tailsChunkAt(std::span<const uint8_t> directory, uint32_t number) {
  const uint8_t* p = directory.data() + kTailsHeadBytes + number * kTailsEntryBytes;
  return {loadLittle<uint64_t>(p), loadLittle<uint32_t>(p + 8), loadLittle<uint64_t>(p + 12)};
}

std::vector<uint8_t> encodeTailsChunk(const PatchTails& tails, uint32_t first, uint32_t count, TailsStorage storage,
                                      PatchCorners corners, int zstd_level) {
  if (storage != TailsStorage::kZstd) {
    std::vector<uint8_t> out;
    encodeTailCode(std::span(tails.heights).subspan(first * kTailHeights, count * kTailHeights),
                   std::span(tails.texels).subspan(first * tails.patchTexels(), count * tails.patchTexels()),
                   tails.channels, storage == TailsStorage::kGrids ? corners : PatchCorners{}, out);
    return out;
  }
  std::vector<uint8_t> raw(count * (2 * kTailHeights + tails.patchTexels()));
  uint8_t *low = raw.data(), *high = low + count * kTailHeights, *texel = high + count * kTailHeights;
  // Only read.
  overTails(
      const_cast<PatchTails&>(tails), first, count,
      [&](uint16_t v, uint16_t before) {
        const auto step = static_cast<uint16_t>(v - before);
        const auto folded = static_cast<uint16_t>((step << 1) ^ (step & 0x8000 ? 0xFFFF : 0));
        *low++ = static_cast<uint8_t>(folded);
        *high++ = static_cast<uint8_t>(folded >> 8);
      },
      [&](uint8_t v, uint8_t before) { *texel++ = static_cast<uint8_t>(v - before); });
  std::vector<uint8_t> out(ZSTD_compressBound(raw.size()));
  const size_t size = ZSTD_compress(out.data(), out.size(), raw.data(), raw.size(), zstd_level);
  out.resize(ZSTD_isError(size) ? 0 : size);  // it cannot be: there is room
  return out;
}

Result<void> decodeTailsChunk(std::span<const uint8_t> bytes, uint32_t first, uint32_t count, TailsStorage storage,
                              PatchCorners corners, PatchTails& tails) {
  if (storage != TailsStorage::kZstd) {
    if (decodeTailCode(bytes, tails.channels, storage == TailsStorage::kGrids ? corners : PatchCorners{},
                       std::span(tails.heights).subspan(first * kTailHeights, count * kTailHeights),
                       std::span(tails.texels).subspan(first * tails.patchTexels(), count * tails.patchTexels())))
      return {};
    return Error{ErrorKind::kInvalidData, "",
                 "expected the codes of " + std::to_string(count) + " patches, found other bytes",
                 "rebuild the package, or get a whole copy", 0};
  }
  std::vector<uint8_t> raw(count * (2 * kTailHeights + tails.patchTexels()));
  const size_t size = ZSTD_decompress(raw.data(), raw.size(), bytes.data(), bytes.size());
  if (ZSTD_isError(size) || size != raw.size()) {
    return Error{ErrorKind::kInvalidData, "",
                 "expected " + std::to_string(raw.size()) + " bytes in a zstd frame, found others",
                 "rebuild the package, or get a whole copy", 0};
  }
  const uint8_t *low = raw.data(), *high = low + count * kTailHeights, *texel = high + count * kTailHeights;
  overTails(
      tails, first, count,
      [&](uint16_t& v, uint16_t before) {
        const auto folded = static_cast<uint16_t>(*low++ | *high++ << 8);
        v = static_cast<uint16_t>(before + ((folded >> 1) ^ (folded & 1 ? 0xFFFF : 0)));
      },
      [&](uint8_t& v, uint8_t before) { v = static_cast<uint8_t>(before + *texel++); });
  return {};
}

}  // namespace relievo
