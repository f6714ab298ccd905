// base_code.h - the section of a base mesh (package_base.h) in few bytes, without loss: corners on lattices are
// predicted from those of patches around, bounds from those beside them, and what they differ by is range coded in
// contexts (texturing/PACKAGE.md, "Coded base mesh", "Base mesh by sides", "Base mesh by its border"): about half of
// what zstd makes of the section's bytes, and for a scan's own triangles each of the later two a third less again.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "src/base/result.h"
#include "texturing/package/package_base.h"
#include "texturing/package/package_layout.h"

namespace relievo {

inline constexpr uint64_t kLeastCodedBaseBytes = 8;
// Of a section that does not get smaller.
constexpr uint64_t mostCodedBaseBytes(uint64_t section_bytes) { return 2 * section_bytes + 64; }

// section: with shapes, at least. step_mm: of the lattice that positions lie on (onLattice(), src/artwork/base_mesh.h),
// 0: none. Corners off the lattice take 24 bytes.
std::vector<uint8_t> encodeBaseCode(BaseSection section, double step_mm, BaseCodeKind kind, bool cut = false);
// As it was coded: baseSectionFault() says whether it is sound. Without blocks and shapes where no patch has an error.
// Safe for untrusted bytes: allocates no more than the largest section of so many patches has, and as much again for
// lists of their sides and corners. The error's file is empty.
Result<BaseSection> decodeBaseCode(std::span<const uint8_t> code, uint32_t patches, BaseSectionEnd end,
                                   BaseCodeKind kind, bool cut = false);

// A base mesh's section as the package that the header belongs to has it.
Result<BaseSection> readBaseSection(const PackageHeader& header, std::span<const uint8_t> stored);

}  // namespace relievo
