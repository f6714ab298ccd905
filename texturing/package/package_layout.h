// package_layout.h - where things lie in a .relievo file; shared by the reader and the builder. Documented in
// PACKAGE.md. Pure arithmetic: no input or output. All numbers in the file are little-endian.
#pragma once

#include <array>
#include <cstdint>
#include <cstring>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "src/artwork/basis.h"
#include "src/artwork/patch_domain.h"
#include "src/base/result.h"
#include "texturing/codec/page_encoding.h"
#include "texturing/codec/page_id.h"
#include "texturing/package/base_parity.h"

namespace relievo {

inline constexpr std::array<uint8_t, 8> kPackageMagic{0x89, 'R', 'L', 'V', '\r', '\n', 0x1A, '\n'};
inline constexpr uint32_t kHeaderBytes = 4096;      // at the file's start, and once more at its end
inline constexpr uint32_t kIndexBlockNodes = 16;    // a block holds up to 16 x 16 nodes of one patch and level
inline constexpr uint32_t kTextureEntryBytes = 20;  // u64 offset, u32 size, u64 checksum
inline constexpr uint32_t kReliefEntryBytes = 26;   // the same, then u16 min, max, error
// What a relief page's surface leaves out of the finest one, by blocks of 8 x 8 cells: 16 x 16 bytes, rows top first.
// As a byte 16 e + m: m for e = 0, else (16 + m) << (e - 1) steps of the height's 16 bits, rounded up.
inline constexpr int kErrorBlocks = 16;
inline constexpr uint32_t kReliefDetailBytes = kErrorBlocks * kErrorBlocks;
inline constexpr uint32_t errorFromByte(uint8_t b) { return b < 32 ? b : (16u + (b & 15u)) << ((b >> 4) - 1); }
uint8_t byteFromError(uint32_t steps /* at most 65,535 */);
// Behind them their shapes (src/artwork/deviation.h), 5 bytes each, where PackageHeader::relief_shapes says so.
inline constexpr uint32_t kReliefShapesBytes = 5 * kReliefDetailBytes;
inline constexpr uint64_t kMaxManifestBytes = uint64_t{16} << 20;

// How patches' corners and errors are found in a coded base mesh (base_code.h): each corner by how long ago it was
// named, from version 7 on; from version 10 on by the sides where patches meet, and errors by what the corners say;
// from version 12 on by the border of the patches before, too, and normals by what the corners say.
enum class BaseCodeKind : uint8_t { kByCorners, kBySides, kByBorder };

struct PackageHeader {
  uint64_t file_bytes = 0;
  uint64_t manifest_offset = kHeaderBytes, manifest_bytes = 0, manifest_hash = 0;
  uint64_t index_offset = 0, index_bytes = 0;
  uint64_t pages_offset = 0, pages_bytes = 0, page_count = 0;
  PatchDomain domain;
  TextureFormat texture;
  PlaneEncodings encodings;
  bool size_known = true;      // else nobody said how large a pixel is: mm_per_px is 1 and heights count pixels
  bool relief_detail = false;  // the index ends with a tree of kReliefDetailBytes a relief page
  bool relief_shapes = false;  // and kReliefShapesBytes
  // Version 4, over a base mesh only: hierarchical relief pages, a packed base mesh, no errors by block of the finest
  // relief pages, which have none.
  bool compact = false;
  // Version 5 and later: a compact package whose base mesh says how many texture levels each patch has
  // (PatchDomain::textureDepths()). decodeHeader() does not know them yet: its domain has all levels.
  bool texture_depths = false;
  // Version 6 and later, a compact package whose tails are coded (texturing/codec/tail_code.h).
  bool coded_tails = false;
  // Version 7, one of version 6 whose base mesh is coded (base_code.h).
  bool coded_base = false;
  // Version 8, one of version 7 whose texture pages may be hierarchical (texturing/codec/texel_code.h).
  bool coded_texels = false;
  // Version 9, one of version 8 whose index is coded (index_code.h), and whose relief pages of level 0 are stored over
  // their tails (ReliefEncoding::kOverTail). index_bytes are then those that it takes in the file; IndexLayout tells
  // places in what it stands for.
  bool coded_index = false;
  // Version 10, one of version 9 whose patches take few bytes: tails are coded by grids (texturing/codec/tail_grid.h),
  // the base mesh by sides (BaseCodeKind::kBySides), and relief pages that their tails show have none.
  bool light_patches = false;
  // Version 11, one of version 10 or 8 whose base mesh is cut (BaseMesh::cut).
  bool cut_patches = false;
  // Version 12, one of version 8, 10 or 11 whose base mesh is coded by its border (BaseCodeKind::kByBorder).
  bool base_by_border = false;
  // Version 13, one of version 12 that has images which patches show (patch_images.h): the directory of these, behind
  // their tiles, which begin where the tails' directory ends.
  uint64_t images_offset = 0, images_bytes = 0, images_hash = 0;
  bool showsImages() const { return images_bytes > 0; }
  // Version 15, one of version 14 or 13 some of whose images are JPEGs.
  bool image_jpegs = false;
  // Version 16, one of version 15 where tails of patches that show images are made of these.
  bool image_tails = false;
  // Version 17, one of version 16 with a parity in place of the base mesh's copy (base_parity.h), and whose images'
  // normals are predicted by the base mesh.
  bool base_parity = false;
  // Version 18, one of version 17 where halves of patches have colours of corners instead of images.
  bool corner_colours = false;
  // Version 19, one of version 18, which needs no such colours here, some of whose images have maps of normals, or
  // whose images have more than kMostTexelsBefore19.
  bool richer_images = false;
  // Version 14, one of version 12 or 13 with cut patches whose tails' colours end at edges (isColourEdge()).
  bool tail_edges = false;
  uint64_t tilesOffset() const { return tails_offset + tails_bytes; }
  BaseCodeKind baseCodeKind() const {
    return base_by_border ? BaseCodeKind::kByBorder : light_patches ? BaseCodeKind::kBySides : BaseCodeKind::kByCorners;
  }
  uint32_t detailBytes() const {
    return relief_detail ? kReliefDetailBytes + (relief_shapes ? kReliefShapesBytes : 0) : 0;
  }
  // The base mesh (0 bytes: a flat artwork), package_base.h; and its copy, or its parity.
  uint64_t base_offset = 0, base_bytes = 0, base_hash = 0, base_copy_offset = 0;
  uint64_t baseCopyBytes() const { return base_parity ? parityBytes(base_bytes) : base_bytes; }
  // The directory of the patches' tails (0 bytes: there are none): package_tails.h.
  uint64_t tails_offset = 0, tails_bytes = 0, tails_hash = 0;
};
// 19 to 4 where it is compact; else 3 where the header describes the basis; else 1, or 2 with a base mesh: packages
// of those bases stay what they were.
inline uint32_t packageVersion(const PackageHeader& h) {
  if (h.compact)
    return h.richer_images    ? 19
           : h.corner_colours ? 18
           : h.base_parity    ? 17
           : h.image_tails    ? 16
           : h.image_jpegs    ? 15
           : h.tail_edges     ? 14
           : h.showsImages()  ? 13
           : h.base_by_border ? 12
           : h.cut_patches    ? 11
           : h.light_patches  ? 10
           : h.coded_index    ? 9
           : h.coded_texels   ? 8
           : h.coded_base     ? 7
           : h.coded_tails    ? 6
           : h.texture_depths ? 5
                              : 4;
  return h.texture.basis > Basis::kAlbedoNormal ? 3 : h.base_bytes == 0 ? 1 : 2;
}
void encodeHeader(const PackageHeader& header, std::span<uint8_t> out /* kHeaderBytes */);
// Checks magic, version, hash and every field; the error names the field. kUnsupported: what a newer program may know,
// such as another basis.
Result<PackageHeader> decodeHeader(std::span<const uint8_t> bytes /* kHeaderBytes */, const std::string& path);

// The size that a package states: that of a flat artwork. The patches over a base mesh count as a strip of whole ones
// along x.
FlatExtent statedExtent(const PatchDomain& domain);

// The index of one quadtree forest: the texture's (an entry a plane) or the relief's. Patch after patch, in a patch
// level after level (coarsest first), in a level blocks of 16 x 16 nodes in rows, clipped where the artwork ends; in a
// block nodes in rows; at a block's end the xxh3-64 of its entries.
class IndexLayout {
 public:
  IndexLayout() = default;  // an empty tree
  IndexLayout(const PatchDomain& domain, int depth, uint32_t node_bytes, uint64_t base);
  // Each patch over a base mesh has a depth of its own; kNoTexturePage: it has no nodes.
  IndexLayout(const PatchDomain& domain, std::shared_ptr<const TextureDepths> depths, uint32_t node_bytes,
              uint64_t base);
  uint64_t bytes() const { return bytes_; }
  uint64_t nodeCount() const { return nodes_; }

  struct Place {
    uint64_t block_offset = 0;  // in the file
    uint32_t block_bytes = 0;   // checksum included
    uint32_t node_offset = 0;   // in the block
  };
  bool contains(const NodeId& node) const;
  Place find(const NodeId& node) const;  // contained nodes only

  struct Block {
    uint64_t offset = 0;
    uint32_t bytes = 0;
    NodeId first;  // upper left node
    uint32_t columns = 0, rows = 0;
  };
  // Calls f(block) for every block, in the file's order, until it returns false.
  template <class F>
  void forEachBlock(F&& f) const;
  // The same from the block on that begins at this offset. False: none does.
  template <class F>
  bool forEachBlockFrom(uint64_t offset, F&& f) const;

 private:
  struct Level {
    uint64_t base = 0;  // from the patch's first byte
    uint32_t columns = 0, rows = 0;
  };
  struct Patch {
    std::vector<Level> levels;
    uint64_t bytes = 0, nodes = 0;
  };
  Patch layOut(const PatchDomain& domain, const std::array<uint64_t, 2>& covered_px, int depth) const;
  const Patch& patchOf(uint32_t patch) const {
    if (depths_) return kinds_[static_cast<size_t>((*depths_)[patch] + 1)];
    return kinds_[patch + 1 == patch_count_ ? 1 : 0];
  }
  uint64_t patchOffset(uint32_t patch) const { return depths_ ? offsets_[patch] : patch * kinds_[0].bytes; }
  uint32_t patchAt(uint64_t offset) const;  // the patch whose blocks this offset lies in, if any does
  // The blocks of a patch, until f(block) returns false; then false.
  template <class F>
  bool forEachBlockOf(uint32_t patch, F&& f) const;

  // By depth + 1 where patches have depths of their own. Else all patches but the last are of the first kind, the last
  // is of the second.
  std::vector<Patch> kinds_;
  std::shared_ptr<const TextureDepths> depths_;
  std::vector<uint64_t> offsets_;  // by patch, from base_; empty where all but the last have the same bytes
  uint32_t patch_count_ = 0, node_bytes_ = 0;
  uint64_t base_ = 0, bytes_ = 0, nodes_ = 0;
};

struct PackageLayout {
  IndexLayout texture, relief, relief_detail;
  uint64_t index_bytes = 0, page_count = 0;
};
// finest_detail: do the finest relief pages have errors by block, too?
PackageLayout packageLayout(const PatchDomain& domain, const TextureFormat& format, uint64_t index_offset,
                            uint32_t detail_bytes /* a relief page */, bool finest_detail = true);
// Of a header whose index_offset and domain are known.
inline PackageLayout packageLayout(const PackageHeader& h) {
  return packageLayout(h.domain, h.texture, h.index_offset, h.detailBytes(), !h.compact);
}
// Of a base mesh's section beside its header: are there as many texture levels a patch as the header's numbers of pages
// and of the index's bytes say? Says what is wrong, or nothing.
std::string textureDepthsProblem(const PackageHeader& header, const TextureDepths& depths);
// Are the sizes such that the arithmetic above holds? Says what is wrong, or nothing.
std::string domainProblem(const PatchDomain& domain);

// "plane 1 patch 0 level 3 x 4 y 5"
std::string describePage(PageId id);

template <class T>
T loadLittle(const uint8_t* p) {
  T v;
  std::memcpy(&v, p, sizeof v);
  return v;
}
template <class T>
void storeLittle(uint8_t* p, T v) {
  std::memcpy(p, &v, sizeof v);
}

template <class F>
bool IndexLayout::forEachBlockOf(uint32_t patch, F&& f) const {
  const Patch& p = patchOf(patch);
  for (size_t l = 0; l < p.levels.size(); ++l) {
    uint64_t offset = base_ + patchOffset(patch) + p.levels[l].base;
    for (uint32_t y = 0; y < p.levels[l].rows; y += kIndexBlockNodes) {
      for (uint32_t x = 0; x < p.levels[l].columns; x += kIndexBlockNodes) {
        Block block;
        block.offset = offset;
        block.first = {patch, static_cast<uint32_t>(l), x, y};
        block.columns = std::min(kIndexBlockNodes, p.levels[l].columns - x);
        block.rows = std::min(kIndexBlockNodes, p.levels[l].rows - y);
        block.bytes = block.columns * block.rows * node_bytes_ + 8;
        offset += block.bytes;
        if (!f(block)) return false;
      }
    }
  }
  return true;
}

template <class F>
void IndexLayout::forEachBlock(F&& f) const {
  for (uint32_t patch = 0; patch < patch_count_; ++patch)
    if (!forEachBlockOf(patch, f)) return;
}

template <class F>
bool IndexLayout::forEachBlockFrom(uint64_t offset, F&& f) const {
  if (offset < base_ || offset - base_ >= bytes_) return false;
  bool found = false;
  auto fromThere = [&](const Block& block) {
    found = found || block.offset == offset;
    return !found || f(block);
  };
  for (uint32_t patch = patchAt(offset); patch < patch_count_; ++patch)
    if (!forEachBlockOf(patch, fromThere) || !found) break;
  return found;
}

}  // namespace relievo
