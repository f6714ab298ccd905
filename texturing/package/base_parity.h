// base_parity.h - what a package of version 17 has in place of a second copy of its base mesh (texturing/PACKAGE.md,
// "Version 17"): the base mesh cut into 16 blocks, hashes of these, and the sums of the even and of the odd ones. A
// block of each kind that is damaged can be made good: whatever damages up to a block of bytes in a row.
// An eighth of the base mesh's bytes. Pure: any thread.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace relievo {

inline constexpr uint64_t kParityBlocks = 16;
constexpr uint64_t parityBlockBytes(uint64_t base_bytes) { return (base_bytes + kParityBlocks - 1) / kParityBlocks; }
// Hashes of all blocks and of these, and two sums.
constexpr uint64_t parityBytes(uint64_t base_bytes) {
  return 8 * (kParityBlocks + 1) + 2 * parityBlockBytes(base_bytes);
}
std::vector<uint8_t> parityOf(std::span<const uint8_t> base);
// Makes damaged blocks good where it can: whoever calls it compares the whole base's hash.
void mendByParity(std::span<const uint8_t> parity, std::span<uint8_t> base);

}  // namespace relievo
