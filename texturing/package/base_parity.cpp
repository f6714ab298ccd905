#include "texturing/package/base_parity.h"

#include <xxhash.h>

#include <algorithm>
#include <array>
#include <cassert>

#include "texturing/package/package_layout.h"

namespace relievo {
namespace {

template <class Byte>
std::span<Byte> blockOf(std::span<Byte> base, uint64_t i) {
  const uint64_t block = parityBlockBytes(base.size()), begin = std::min<uint64_t>(i * block, base.size());
  return base.subspan(begin, std::min<uint64_t>(block, base.size() - begin));
}

// Bit by bit, modulo 2.
void addTo(std::span<uint8_t> sum, std::span<const uint8_t> bytes) {
  for (size_t i = 0; i < std::min(sum.size(), bytes.size()); ++i) sum[i] ^= bytes[i];
}

uint64_t hashOf(std::span<const uint8_t> bytes) { return XXH3_64bits(bytes.data(), bytes.size()); }

constexpr uint64_t kHashesBytes = 8 * kParityBlocks;

}  // namespace

std::vector<uint8_t> parityOf(std::span<const uint8_t> base) {
  std::vector<uint8_t> out(parityBytes(base.size()));
  const std::span<uint8_t> parity(out);
  const uint64_t block = parityBlockBytes(base.size());
  for (uint64_t i = 0; i < kParityBlocks; ++i) {
    storeLittle(out.data() + 8 * i, hashOf(blockOf(base, i)));
    addTo(parity.subspan(kHashesBytes + 8 + i % 2 * block, block), blockOf(base, i));
  }
  storeLittle(out.data() + kHashesBytes, hashOf(parity.first(kHashesBytes)));
  return out;
}

void mendByParity(std::span<const uint8_t> parity, std::span<uint8_t> base) {
  assert(parity.size() == parityBytes(base.size()));
  if (hashOf(parity.first(kHashesBytes)) != loadLittle<uint64_t>(parity.data() + kHashesBytes)) return;
  const uint64_t block = parityBlockBytes(base.size());
  for (uint64_t kind = 0; kind < 2; ++kind) {
    std::vector<uint64_t> damaged;
    for (uint64_t i = kind; i < kParityBlocks; i += 2)
      if (hashOf(blockOf(base, i)) != loadLittle<uint64_t>(parity.data() + 8 * i)) damaged.push_back(i);
    if (damaged.size() != 1) continue;
    const std::span<uint8_t> broken = blockOf(base, damaged[0]);
    const auto sum = parity.subspan(kHashesBytes + 8 + kind * block, broken.size());
    std::copy(sum.begin(), sum.end(), broken.begin());
    for (uint64_t i = kind; i < kParityBlocks; i += 2)
      if (i != damaged[0]) addTo(broken, blockOf(base, i));
  }
}

}  // namespace relievo
