// relief_code.h - a relief page's samples, without loss, level by level: each is predicted from those of coarser grids,
// and what it differs by is range coded (texturing/PACKAGE.md, "Hierarchical relief"). Small where heights are smooth,
// and next to nothing where they are what a coarser grid shows (src/artwork/relief_lattice.h). Safe for untrusted
// bytes.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "src/artwork/patch_domain.h"

namespace relievo {

// What an encoder or decoder of pages keeps from one page to the next, to spare memory: its content does not matter.
struct ReliefCodeScratch {
  static constexpr size_t kMargin = 3, kRow = kReliefSamples + 2 * kMargin;
  std::array<int32_t, kRow * kRow> heights;
  std::array<uint16_t, kRow * kRow> sizes;
};

// Appends to out.
void encodeReliefCode(std::span<const uint16_t> samples /* kReliefSamples^2 */, ReliefCodeScratch& scratch,
                      std::vector<uint8_t>& out);
// The same of a page whose tail is known: of its first kTailCodeCellsLog2 levels, which then are not coded.
void encodeReliefCodeOverTail(std::span<const uint16_t> samples, ReliefCodeScratch& scratch, std::vector<uint8_t>& out);
// Is nothing left to be coded then? All samples are those that the lattice says between its tail's.
bool isAsItsTailShows(std::span<const uint16_t> samples);
void showTail(ReliefCodeScratch& scratch, std::span<uint16_t> samples);  // the others from every 8th one
// samples: every 8th one, along rows and columns, is the tail's. False: as below.
bool decodeReliefCodeOverTail(std::span<const uint8_t> bytes, ReliefCodeScratch& scratch, std::span<uint16_t> samples);
// False: the bytes are not such a page. samples are then of any content.
bool decodeReliefCode(std::span<const uint8_t> bytes, ReliefCodeScratch& scratch, std::span<uint16_t> samples);

}  // namespace relievo
