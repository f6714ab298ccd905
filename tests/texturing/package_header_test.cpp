// What a header says of an artwork's patches: a flat artwork's size, or that of the strip which the patches over a base
// mesh count as. It is read as it was written, and refused where it contradicts itself.
#include <gtest/gtest.h>
#include <xxhash.h>

#include <array>
#include <string>
#include <utility>

#include "texturing/package/package_base.h"
#include "texturing/package/package_layout.h"

namespace relievo {
namespace package_header_test {

using HeaderBytes = std::array<uint8_t, kHeaderBytes>;

// Of a package whose sections lie one after the other.
PackageHeader headerOf(const PatchDomain& domain) {
  PackageHeader h;
  h.domain = domain;
  h.texture.basis = domain.isFlat() ? Basis::kPtmLrgb : Basis::kAlbedoNormal;
  h.relief_detail = h.relief_shapes = domain.relief_depth >= 0;
  uint64_t end = kHeaderBytes;
  if (!domain.isFlat()) {
    h.base_bytes = baseSectionBytes(4, domain.patchCount());
    h.base_offset = end;
    end += h.base_bytes;
  }
  const PackageLayout layout = packageLayout(domain, h.texture, end, h.detailBytes());
  h.index_offset = end;
  h.index_bytes = layout.index_bytes;
  h.page_count = h.pages_bytes = layout.page_count;
  h.pages_offset = h.index_offset + h.index_bytes;
  h.base_copy_offset = domain.isFlat() ? 0 : h.pages_offset + h.pages_bytes;
  h.file_bytes = h.pages_offset + h.pages_bytes + h.base_bytes + kHeaderBytes;
  return h;
}
HeaderBytes encoded(const PackageHeader& h) {
  HeaderBytes bytes;
  encodeHeader(h, bytes);
  return bytes;
}

FlatDomain flatDomain(uint64_t width_px, uint64_t height_px, int relief_depth) {
  FlatDomain d;
  d.width_px = width_px;
  d.height_px = height_px;
  d.mm_per_px = 0.25;
  d.texture_depth = FlatDomain::depthFor(width_px, height_px);
  d.relief_depth = relief_depth;
  d.relief_offset_mm = -1.5;
  d.relief_scale_mm = 3.0 / 65535;
  return d;
}
PatchDomain meshDomain(uint32_t patches, int texture_depth, int relief_depth) {
  PatchMeasures m = flatDomain(1, 1, relief_depth);
  m.texture_depth = texture_depth;
  return PatchDomain::overMesh(patches, m);
}

TEST(PackageHeader, BothKindsOfDomainsAreReadAsTheyWereWritten) {
  for (const PatchDomain& d :
       {PatchDomain(flatDomain(1, 1, -1)), PatchDomain(flatDomain(300, 700, 3)), PatchDomain(flatDomain(5000, 90, 0)),
        PatchDomain(flatDomain(128 * 6, 128, 0)), meshDomain(6, 0, 0), meshDomain(1, 3, 1), meshDomain(1000, 1, 5)}) {
    const PackageHeader h = headerOf(d);
    const HeaderBytes bytes = encoded(h);
    const auto read = decodeHeader(bytes, "a.relievo");
    ASSERT_TRUE(read.ok()) << read.error().text();
    EXPECT_EQ(read->domain, d);
    EXPECT_EQ(encoded(*read), bytes);
    const auto width_px = loadLittle<uint64_t>(&bytes[88]), height_px = loadLittle<uint64_t>(&bytes[96]);
    EXPECT_EQ(width_px, d.isFlat() ? d.flat().width_px : d.patchCount() * d.patchPx());
    EXPECT_EQ(height_px, d.isFlat() ? d.flat().height_px : d.patchPx());
  }
}

// The size alone does not tell a mesh's patches from a flat artwork: the base mesh does.
TEST(PackageHeader, AStripOfWholePatchesWithoutABaseMeshIsFlat) {
  const PatchDomain mesh = meshDomain(6, 0, 0), strip = flatDomain(128 * 6, 128, 0);
  const HeaderBytes of_mesh = encoded(headerOf(mesh)), of_strip = encoded(headerOf(strip));
  EXPECT_TRUE(std::equal(&of_mesh[88], &of_mesh[136], &of_strip[88]));
  EXPECT_FALSE(decodeHeader(of_mesh, "")->domain.isFlat());
  EXPECT_TRUE(decodeHeader(of_strip, "")->domain.isFlat());
}

TEST(PackageHeader, ASizeThatContradictsTheBaseMeshIsRefused) {
  const HeaderBytes sound = encoded(headerOf(meshDomain(6, 1, 0)));  // 256 texels a side
  auto refusal = [&](uint64_t width_px, uint64_t height_px, int32_t texture_depth = 1) {
    HeaderBytes bytes = sound;
    storeLittle(&bytes[88], width_px);
    storeLittle(&bytes[96], height_px);
    storeLittle(&bytes[128], texture_depth);
    storeLittle(&bytes[kHeaderBytes - 8], static_cast<uint64_t>(XXH3_64bits(bytes.data(), kHeaderBytes - 8)));
    const auto read = decodeHeader(bytes, "a.relievo");
    return read ? std::string() : read.error().message;
  };
  EXPECT_EQ(refusal(6 * 256, 256), "") << "control: the size is what it was";
  const std::string no_strip = "an artwork over a base mesh is a strip of whole patches along x";
  EXPECT_EQ(refusal(6 * 256 - 1, 256), no_strip);
  EXPECT_EQ(refusal(6 * 256, 255), no_strip);
  EXPECT_EQ(refusal(256, 6 * 256), no_strip);
  EXPECT_EQ(refusal(6 * 256, 256, 2), "the texture depth does not fit the size");
  EXPECT_EQ(refusal(0, 256), "the artwork is empty");
  for (uint64_t patches : {1u, 5u, 7u, 12u})
    EXPECT_NE(refusal(patches * 256, 256), "") << patches << " patches: neither base mesh nor index fit";
}

}  // namespace package_header_test
}  // namespace relievo
