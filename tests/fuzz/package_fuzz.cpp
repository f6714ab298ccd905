// A package with all checksums right, so that what they would keep away gets as far as it can: into the manifest, the
// index, pages, tails and base mesh. An input names one of some packages that are built on start-up and lists changes
// to it:
//   byte 0     the package
//   then       region, offset (u16), count: `count` bytes that replace those of the region from the offset on
// Afterwards every checksum is computed anew from what it covers, for as far as the header's claims lie in the file.
#include <xxhash.h>

#include <array>
#include <cstring>
#include <vector>

#include "tests/fuzz/fuzz_file.h"
#include "tests/fuzz/fuzz_packages.h"
#include "texturing/codec/page_codec.h"
#include "texturing/package/base_code.h"
#include "texturing/package/index_code.h"
#include "texturing/package/package.h"
#include "texturing/package/package_layout.h"

namespace relievo::fuzz {
namespace {

constexpr int kBlocks = 32, kPages = 5;  // looked at, of each tree
constexpr uint64_t kFewPages = 24;       // that verifyPackage() is shown

struct Region {
  uint64_t offset = 0, bytes = 0;
};
// Where an unchanged package has it.
Region regionOf(std::span<const uint8_t> file, uint8_t region) {
  auto at = [&](size_t offset) { return loadLittle<uint64_t>(file.data() + offset); };
  switch (region % 9) {
    case 0:
      return {0, 320};
    case 1:
      return {at(24), at(32)};
    case 2:
      return {at(264), at(272)};
    case 3:
      return {at(48), at(56)};
    case 4:
      return {at(64), 4096};  // the first pages
    case 5:
      return {at(296), at(304)};
    case 7:
      return {at(2088), at(2096)};  // the directory of images
    case 8:
      return {at(296) + at(304), at(2096) > 0 ? at(2088) - at(296) - at(304) : 0};  // their tiles
    default:
      return {at(296) - std::min<uint64_t>(at(296), 512), 512};  // the last chunk of tails
  }
}

// Of the first chunks; pages' hashes lie within the code.
void sealIndexCode(const PackageHeader& header, std::vector<uint8_t>& file) {
  const uint64_t room = header.index_offset < file.size() ? file.size() - header.index_offset : 0,
                 bytes = std::min(room, header.index_bytes);
  if (bytes < kIndexHeadBytes) return;
  uint8_t* section = file.data() + header.index_offset;
  const uint64_t directory = indexDirectoryBytes({section, kIndexHeadBytes}, bytes);
  uint64_t chunk = directory;
  for (uint64_t k = kIndexHeadBytes; k + kIndexChunkBytes <= directory && k < kBlocks * kIndexChunkBytes;
       k += kIndexChunkBytes) {
    const uint64_t size = loadLittle<uint32_t>(section + k + 8);
    if (size > bytes - chunk) break;
    storeLittle<uint64_t>(section + k + 12, XXH3_64bits(section + chunk, size));
    chunk += size;
  }
  storeLittle<uint64_t>(section + 8, XXH3_64bits(section + kIndexHeadBytes, directory - kIndexHeadBytes));
}

void seal(std::vector<uint8_t>& file, bool both_headers) {
  if (file.size() < kHeaderBytes) return;
  uint8_t* h = file.data();
  auto at = [&](size_t offset) { return loadLittle<uint64_t>(h + offset); };
  auto inside = [&](uint64_t offset, uint64_t bytes) { return offset <= file.size() && bytes <= file.size() - offset; };
  auto hash = [&](uint64_t offset, uint64_t bytes) { return XXH3_64bits(h + offset, bytes); };
  auto section = [&](size_t offset_at, size_t bytes_at, size_t hash_at) {
    if (inside(at(offset_at), at(bytes_at))) storeLittle<uint64_t>(h + hash_at, hash(at(offset_at), at(bytes_at)));
  };
  if (const uint64_t offset = at(296), bytes = at(304); inside(offset, bytes)) {
    for (uint64_t k = 24; k + 20 <= bytes && k < 24 + 16 * 20; k += 20) {
      const uint64_t chunk = loadLittle<uint64_t>(h + offset + k),
                     chunk_bytes = loadLittle<uint32_t>(h + offset + k + 8);
      if (inside(chunk, chunk_bytes)) storeLittle<uint64_t>(h + offset + k + 12, hash(chunk, chunk_bytes));
    }
  }
  auto sealHeader = [&] {
    section(24, 32, 40);
    section(264, 272, 280);
    section(296, 304, 312);
    if (at(2096) > 0) section(2088, 2096, 2104);
    storeLittle<uint64_t>(h + kHeaderBytes - 8, hash(0, kHeaderBytes - 8));
  };
  sealHeader();
  if (auto header = decodeHeader(std::span(file).first(kHeaderBytes), "")) {
    if (header->texture_depths && inside(header->base_offset, header->base_bytes)) {
      auto base = readBaseSection(*header, {h + header->base_offset, header->base_bytes});
      if (base.ok() && textureDepthsProblem(*header, base->texture_depths).empty())
        header->domain.setTextureDepths(std::make_shared<const TextureDepths>(std::move(base->texture_depths)));
    }
    const PackageLayout layout = packageLayout(*header);
    auto tree = [&](const IndexLayout& index, uint32_t node_bytes, uint32_t entry_bytes) {
      int left = kBlocks;
      index.forEachBlock([&](const IndexLayout::Block& block) {
        if (!inside(block.offset, block.bytes)) return false;
        const uint64_t entries = block.bytes - 8;
        for (uint64_t e = 0; entry_bytes > 0 && e < entries; e += node_bytes)
          for (uint64_t k = e; k + entry_bytes <= e + node_bytes; k += entry_bytes) {
            const uint64_t page = loadLittle<uint64_t>(h + block.offset + k),
                           bytes = loadLittle<uint32_t>(h + block.offset + k + 8);
            if (bytes <= kMaxEncodedPageBytes && inside(page, bytes))
              storeLittle<uint64_t>(h + block.offset + k + 12, hash(page, bytes));
          }
        storeLittle<uint64_t>(h + block.offset + entries, hash(block.offset, entries));
        return --left > 0;
      });
    };
    const auto planes = static_cast<uint32_t>(header->texture.planes());
    if (header->coded_index) sealIndexCode(*header, file);
    else tree(layout.texture, planes * kTextureEntryBytes, kTextureEntryBytes);
    if (!header->coded_index && header->domain.relief_depth >= 0)
      tree(layout.relief, kReliefEntryBytes, kReliefEntryBytes);
    if (!header->coded_index && header->detailBytes() > 0) tree(layout.relief_detail, header->detailBytes(), 0);
    sealHeader();  // an index may lie where the header is
  }
  if (both_headers && file.size() >= 2 * kHeaderBytes) std::memcpy(h + file.size() - kHeaderBytes, h, kHeaderBytes);
}

void readAll(const Package& package) {
  const Manifest& m = package.manifest();
  PageDecoder decoder;
  std::vector<uint8_t> texels(kSlotBytes);
  const PackageLayout layout = packageLayout(m.domain, m.texture, 0, 0);
  // Walks every page that the header claims: of what the file can hold.
  const bool verified = m.page_count <= kFewPages;
  if (verified) (void)verifyPackage(package, 1, nullptr);
  auto tree = [&](const IndexLayout& index, bool relief) {
    int blocks = kBlocks, pages = verified ? 1 : kPages;
    index.forEachBlock([&](const IndexLayout::Block& block) {
      for (uint32_t k = 0; k < block.columns * block.rows && pages > 0; ++k) {
        NodeId node = block.first;
        node.x += k % block.columns, node.y += k / block.columns;
        for (int plane = 0; plane < (relief ? 1 : m.texture.planes()) && pages > 0; ++plane, --pages) {
          const PageId id(relief ? Plane::kRelief : texturePlane(plane), node);
          auto page = package.read(id);
          if (!page) requireExplained(page.error());
          else if (auto decoded = decoder.decodeToSlot(id.plane(), page->bytes, texels); !decoded)
            requireExplained(decoded.error());
          if (!relief) continue;
          std::array<float, kReliefDetailBytes> errors;
          std::array<DeviationShape, kReliefDetailBytes> shapes;
          (void)package.reliefErrors(node, errors);
          (void)package.reliefShapes(node, shapes);
          (void)package.checkReliefDetail(node);
        }
      }
      return --blocks > 0 && pages > 0;
    });
  };
  tree(layout.texture, false);
  if (m.domain.relief_depth >= 0) tree(layout.relief, true);
  if (package.hasTails()) {
    std::vector<std::string> problems;
    const PatchTails tails = package.wholeTails(1, &problems);
    require(tails.patches == m.domain.patchCount(), "tails of another number of patches");
    (void)package.tailProblems();
  }
}

}  // namespace
}  // namespace relievo::fuzz

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace relievo;
  static const std::vector<std::vector<uint8_t>> packages = fuzz::samplePackages();
  if (size == 0) return 0;
  const std::vector<uint8_t>& whole = packages[data[0] % packages.size()];
  std::vector<uint8_t> file = whole;
  bool both_headers = true;
  std::span<const uint8_t> rest(data + 1, size - 1);
  while (rest.size() >= 4) {
    const uint8_t region = rest[0];
    const uint64_t offset = loadLittle<uint16_t>(rest.data() + 1);
    const size_t count = std::min<size_t>(rest[3], rest.size() - 4);
    const std::span<const uint8_t> bytes = rest.subspan(4, count);
    rest = rest.subspan(4 + count);
    if (region >= 0xF0) {  // what is not a region: where the file ends, and which copy of the header is changed
      if (region & 1) file.resize(std::min<size_t>(file.size(), size_t{offset} * 16));
      if (region & 2) both_headers = false;
      continue;
    }
    const fuzz::Region r = fuzz::regionOf(whole, region);
    for (size_t k = 0; k < count && r.bytes > 0; ++k) {
      const uint64_t to = r.offset + (offset + k) % r.bytes;
      if (to < file.size()) file[to] = bytes[k];
    }
  }
  fuzz::seal(file, both_headers);
  auto package = Package::open(fuzz::folder().put("artwork.relievo", file));
  if (!package) fuzz::requireExplained(package.error());
  else fuzz::readAll(**package);
  return 0;
}
