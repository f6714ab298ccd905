#include "texturing/package/index_code.h"

#include <xxhash.h>

#include <algorithm>
#include <array>
#include <bit>
#include <numeric>
#include <type_traits>

#include "texturing/codec/range_coder.h"
#include "texturing/codec/relief_levels.h"

namespace relievo {
namespace {

using relief_levels::DecodingCoder;
using relief_levels::EncodingCoder;

constexpr int kPlanesApart = 2;  // planes from there on share models

// Numbers of which small ones are frequent: how many bits they have, then these.
struct IndexNumber {
  std::array<BitModel, 64> width;
  std::array<std::array<BitModel, 2>, 64> top;
};

// Heights are lattice points: multiples of a step above the least.
struct HeightLattice {
  uint32_t least = 0, step = 1;
};

struct IndexEntry {
  uint64_t offset = 0;
  uint32_t size = 0, hash = 0;
  uint16_t min = 0, max = 0, error = 0;
};

template <class Coder>
class IndexCode {
 public:
  IndexCode(Coder& coder, const IndexCodeOf& of)
      : coder_(coder), next_(of.pages_offset), empty_pages_(of.empty_pages) {}

  HeightLattice lattice(HeightLattice of) {
    of.least = coder_.plain(of.least, 16);
    of.step = coder_.plain(of.step, 16);
    return of;
  }
  // False: damaged.
  bool page(IndexEntry& e, int kind) {
    Kind& k = kinds_[static_cast<size_t>(kind)];
    if (coder_.bit(k.apart, e.offset != next_)) {
      const bool before = coder_.plain(e.offset < next_, 1) != 0;
      const uint64_t far = number(k.distance, before ? next_ - e.offset : e.offset - next_);
      e.offset = before ? next_ - far : next_ + far;
    } else {
      e.offset = next_;
    }
    const uint64_t size = number(k.size, e.size);
    e.size = static_cast<uint32_t>(size);
    if (size > 0 || !empty_pages_) e.hash = coder_.plain(e.hash >> 16, 16) << 16 | coder_.plain(e.hash & 0xFFFF, 16);
    else e.hash = static_cast<uint32_t>(XXH3_64bits("", 0));
    next_ = e.offset + e.size;
    return size <= ~uint32_t{0};
  }
  bool heights(IndexEntry& e, const HeightLattice& of) {
    const uint64_t least = of.least + of.step * number(least_, (e.min - of.least) / of.step);
    const uint64_t most = least + of.step * number(range_, static_cast<uint32_t>(e.max - e.min) / of.step);
    const uint64_t error = number(error_, e.error);
    e.min = static_cast<uint16_t>(least), e.max = static_cast<uint16_t>(most), e.error = static_cast<uint16_t>(error);
    return std::max(most, error) <= 0xFFFF;
  }

 private:
  uint64_t number(IndexNumber& m, uint64_t v) {
    const auto known = std::min<uint64_t>(std::bit_width(v), 63);
    uint32_t node = 1;
    for (int i = 5; i >= 0; --i) node = node << 1 | coder_.bit(m.width[node], known >> i & 1);
    const auto width = static_cast<size_t>(node - 64);
    if (width == 0) return 0;
    uint64_t value = 1;
    int left = static_cast<int>(width) - 1;
    for (size_t k = 0; k < 2 && left > 0; ++k) {
      --left;
      value = value << 1 | static_cast<uint64_t>(coder_.bit(m.top[width][k], v >> left & 1));
    }
    while (left > 0) {
      const int some = std::min(left, 16);
      left -= some;
      value = value << some | coder_.plain(static_cast<uint32_t>(v >> left) & ((1u << some) - 1), some);
    }
    return value;
  }

  struct Kind {
    BitModel apart;
    IndexNumber distance, size;
  };
  Coder& coder_;
  uint64_t next_;  // where the page before ends
  const bool empty_pages_;
  std::array<Kind, kPlanesApart> kinds_;
  IndexNumber least_, range_, error_;
};

// Calls f(the entry's bytes, plane) for each entry, in their order, until it returns false; then false.
template <class Byte, class F>
bool overEntries(const IndexCodeOf& of, bool relief, std::span<const IndexLayout::Block> blocks, std::span<Byte> bytes,
                 F&& f) {
  const int planes = relief ? 1 : of.planes;
  const size_t entry = relief ? kReliefEntryBytes : kTextureEntryBytes;
  for (const IndexLayout::Block& block : blocks) {
    Byte* at = bytes.data() + (block.offset - blocks.front().offset);
    for (uint32_t node = 0; node < block.columns * block.rows; ++node)
      for (int plane = 0; plane < planes; ++plane, at += entry)
        if (!f(at, std::min(plane, kPlanesApart - 1))) return false;
  }
  return true;
}

IndexEntry entryFrom(const uint8_t* p, bool relief) {
  IndexEntry e{loadLittle<uint64_t>(p), loadLittle<uint32_t>(p + 8), loadLittle<uint32_t>(p + 12)};
  if (relief)
    e.min = loadLittle<uint16_t>(p + 20), e.max = loadLittle<uint16_t>(p + 22), e.error = loadLittle<uint16_t>(p + 24);
  return e;
}

uint64_t bytesOf(std::span<const IndexLayout::Block> blocks) {
  return blocks.empty() ? 0 : blocks.back().offset + blocks.back().bytes - blocks.front().offset;
}

}  // namespace

std::optional<std::vector<uint8_t>> encodeIndexBlocks(const IndexCodeOf& of, bool relief,
                                                      std::span<const IndexLayout::Block> blocks,
                                                      std::span<const uint8_t> bytes) {
  HeightLattice lattice;
  if (relief) {
    uint32_t least = 0xFFFF, step = 0;
    const bool sound = overEntries(of, relief, blocks, bytes, [&](const uint8_t* p, int) {
      const IndexEntry e = entryFrom(p, true);
      least = std::min<uint32_t>(least, e.min);
      return e.min <= e.max;
    });
    if (!sound) return std::nullopt;
    overEntries(of, relief, blocks, bytes, [&](const uint8_t* p, int) {
      const IndexEntry e = entryFrom(p, true);
      step = std::gcd(std::gcd(step, e.min - least), static_cast<uint32_t>(e.max - e.min));
      return true;
    });
    lattice = {least, std::max(step, 1u)};
  }
  std::vector<uint8_t> out;
  EncodingCoder coder{RangeEncoder(out)};
  IndexCode<EncodingCoder> code(coder, of);
  if (relief) code.lattice(lattice);
  const bool sound = overEntries(of, relief, blocks, bytes, [&](const uint8_t* p, int kind) {
    IndexEntry e = entryFrom(p, relief);
    if (e.offset < of.pages_offset || !code.page(e, kind)) return false;
    return !relief || code.heights(e, lattice);
  });
  coder.rc.finish();
  return sound ? std::optional(std::move(out)) : std::nullopt;
}

bool decodeIndexBlocks(std::span<const uint8_t> code_bytes, const IndexCodeOf& of, bool relief,
                       std::span<const IndexLayout::Block> blocks, std::span<uint8_t> bytes) {
  if (bytes.size() != bytesOf(blocks)) return false;
  std::fill(bytes.begin(), bytes.end(), uint8_t{0});
  DecodingCoder coder{RangeDecoder(code_bytes)};
  IndexCode<DecodingCoder> code(coder, of);
  HeightLattice lattice;
  if (relief) lattice = code.lattice(lattice);
  const bool sound = lattice.step > 0 && overEntries(of, relief, blocks, bytes, [&](uint8_t* p, int kind) {
                       IndexEntry e;
                       e.min = e.max = static_cast<uint16_t>(lattice.least);
                       if (coder.rc.exhausted() || !code.page(e, kind) || (relief && !code.heights(e, lattice)))
                         return false;
                       storeLittle(p, e.offset);
                       storeLittle(p + 8, e.size);
                       storeLittle(p + 12, uint64_t{e.hash});
                       if (relief) storeLittle(p + 20, e.min), storeLittle(p + 22, e.max), storeLittle(p + 24, e.error);
                       return true;
                     });
  return sound && coder.rc.whole();
}

std::vector<uint8_t> encodeIndexDirectory(std::span<const IndexChunk> chunks) {
  std::vector<uint8_t> out(kIndexHeadBytes + kIndexChunkBytes * chunks.size());
  uint8_t* p = out.data() + kIndexHeadBytes;
  for (const IndexChunk& c : chunks) {
    storeLittle(p, c.first);
    storeLittle(p + 8, c.size);
    storeLittle(p + 12, c.hash);
    p += kIndexChunkBytes;
  }
  storeLittle(out.data(), static_cast<uint64_t>(chunks.size()));
  storeLittle(out.data() + 8,
              static_cast<uint64_t>(XXH3_64bits(out.data() + kIndexHeadBytes, out.size() - kIndexHeadBytes)));
  return out;
}

uint64_t indexDirectoryBytes(std::span<const uint8_t> head, uint64_t section_bytes) {
  const auto chunks = loadLittle<uint64_t>(head.data());
  if (chunks > section_bytes / kIndexChunkBytes) return section_bytes;
  return std::min(section_bytes, kIndexHeadBytes + kIndexChunkBytes * chunks);
}

std::optional<std::vector<IndexChunk>> decodeIndexDirectory(std::span<const uint8_t> directory, uint64_t section_bytes,
                                                            uint64_t entries_bytes) {
  if (directory.size() < kIndexHeadBytes) return std::nullopt;
  const std::span<const uint8_t> entries = directory.subspan(kIndexHeadBytes);
  if (entries.size() % kIndexChunkBytes != 0 ||
      loadLittle<uint64_t>(directory.data()) != entries.size() / kIndexChunkBytes ||
      loadLittle<uint64_t>(directory.data() + 8) != XXH3_64bits(entries.data(), entries.size()))
    return std::nullopt;
  std::vector<IndexChunk> out(entries.size() / kIndexChunkBytes);
  uint64_t offset = directory.size();
  for (size_t i = 0; i < out.size(); ++i) {
    const uint8_t* p = entries.data() + kIndexChunkBytes * i;
    out[i] = {loadLittle<uint64_t>(p), offset, loadLittle<uint32_t>(p + 8), loadLittle<uint64_t>(p + 12)};
    offset += out[i].size;
    const bool follows = i == 0 ? out[i].first == 0 : out[i].first > out[i - 1].first;
    if (!follows || out[i].first >= entries_bytes) return std::nullopt;
  }
  return offset == section_bytes ? std::optional(std::move(out)) : std::nullopt;
}

}  // namespace relievo
