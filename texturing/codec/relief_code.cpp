#include "texturing/codec/relief_code.h"

#include <cassert>

#include "src/artwork/relief_lattice.h"
#include "texturing/codec/relief_levels.h"
#include "texturing/codec/tail_code.h"

namespace relievo {
namespace {

using relief_levels::DecodingCoder;
using relief_levels::EncodingCoder;
using relief_levels::Head;

template <class Coder>
class PageCode {
 public:
  PageCode(Coder& coder, ReliefCodeScratch& s) : coder_(coder), grid_(coder, models_, s) {}
  // known: levels that the samples have already.
  void run(Head& head, auto samples, int known) {
    codeHead(head, known);
    grid_.run(head, samples, known);
  }
  // Nothing is coded.
  void runNone(auto samples, int known) { grid_.run(Head{}, samples, known); }

 private:
  void codeHead(Head& head, int known) {
    head.step = coder_.plain(head.step, 16);
    head.levels = static_cast<int>(coder_.plain(static_cast<uint32_t>(head.levels), 3));
    if (known == 0) head.stepped_corners = coder_.plain(head.stepped_corners, 1);
    for (int l = known; l < head.levels; ++l)
      head.how[static_cast<size_t>(l)] = coder_.plain(head.how[static_cast<size_t>(l)], 2);
    for (int l = known; l < head.levels; ++l)
      head.times[static_cast<size_t>(l)] = coder_.plain(head.times[static_cast<size_t>(l)], 3);
    if (head.step == 0) head.step = 1;  // of damaged bytes
  }
  Coder& coder_;
  relief_levels::Models models_ = relief_levels::kFirstModels;
  relief_levels::GridCode<kPageCellsLog2, Coder> grid_;
};

void encodePage(std::span<const uint16_t> samples, int known, ReliefCodeScratch& scratch, std::vector<uint8_t>& out) {
  assert(samples.size() == size_t{kReliefSamples} * kReliefSamples);
  Head head = relief_levels::headOf<kPageCellsLog2>(samples, scratch);
  if (head.levels <= known) head.step = 1, head.levels = 0;  // nothing is left
  EncodingCoder coder{RangeEncoder(out)};
  PageCode<EncodingCoder>(coder, scratch).run(head, samples, known);
  coder.rc.finish();
}

bool decodePage(std::span<const uint8_t> bytes, int known, ReliefCodeScratch& scratch, std::span<uint16_t> samples) {
  assert(samples.size() == size_t{kReliefSamples} * kReliefSamples);
  DecodingCoder coder{RangeDecoder(bytes)};
  Head head;
  PageCode<DecodingCoder>(coder, scratch).run(head, samples, known);
  return coder.rc.whole();
}

}  // namespace

void encodeReliefCode(std::span<const uint16_t> samples, ReliefCodeScratch& scratch, std::vector<uint8_t>& out) {
  encodePage(samples, 0, scratch, out);
}
bool decodeReliefCode(std::span<const uint8_t> bytes, ReliefCodeScratch& scratch, std::span<uint16_t> samples) {
  return decodePage(bytes, 0, scratch, samples);
}
void encodeReliefCodeOverTail(std::span<const uint16_t> samples, ReliefCodeScratch& scratch,
                              std::vector<uint8_t>& out) {
  encodePage(samples, kTailCodeCellsLog2, scratch, out);
}
bool isAsItsTailShows(std::span<const uint16_t> samples) {
  constexpr size_t kSide = kReliefSamples;
  auto at = [&](size_t x, size_t y) { return static_cast<int>(samples[y * kSide + x]); };
  for (size_t apart = kPagePx >> kTailCodeCellsLog2; apart > 1; apart /= 2)
    for (size_t y = 0; y < kSide; y += apart / 2)
      for (size_t x = y % apart ? 0 : apart / 2; x < kSide; x += y % apart ? apart / 2 : apart) {
        const size_t dx = x % apart, dy = y % apart;
        if (at(x, y) != midHeight(at(x - dx, y - dy), at(x + dx, y + dy))) return false;
      }
  return true;
}
void showTail(ReliefCodeScratch& scratch, std::span<uint16_t> samples) {
  DecodingCoder none{RangeDecoder({})};
  PageCode<DecodingCoder>(none, scratch).runNone(samples, kTailCodeCellsLog2);
}
bool decodeReliefCodeOverTail(std::span<const uint8_t> bytes, ReliefCodeScratch& scratch, std::span<uint16_t> samples) {
  return decodePage(bytes, kTailCodeCellsLog2, scratch, samples);
}

}  // namespace relievo
