#include "texturing/codec/relief_code.h"

#include <cassert>

#include "texturing/codec/relief_levels.h"

namespace relievo {
namespace {

using relief_levels::DecodingCoder;
using relief_levels::EncodingCoder;
using relief_levels::Head;

template <class Coder>
class PageCode {
 public:
  PageCode(Coder& coder, ReliefCodeScratch& s) : coder_(coder), grid_(coder, models_, s) {}
  void run(Head& head, auto samples) {
    codeHead(head);
    grid_.run(head, samples);
  }

 private:
  void codeHead(Head& head) {
    head.step = coder_.plain(head.step, 16);
    head.levels = static_cast<int>(coder_.plain(static_cast<uint32_t>(head.levels), 3));
    head.stepped_corners = coder_.plain(head.stepped_corners, 1);
    for (int l = 0; l < head.levels; ++l)
      head.how[static_cast<size_t>(l)] = coder_.plain(head.how[static_cast<size_t>(l)], 2);
    for (int l = 0; l < head.levels; ++l)
      head.times[static_cast<size_t>(l)] = coder_.plain(head.times[static_cast<size_t>(l)], 3);
    if (head.step == 0) head.step = 1;  // of damaged bytes
  }
  Coder& coder_;
  relief_levels::Models models_ = relief_levels::kFirstModels;
  relief_levels::GridCode<kPageCellsLog2, Coder> grid_;
};

}  // namespace

void encodeReliefCode(std::span<const uint16_t> samples, ReliefCodeScratch& scratch, std::vector<uint8_t>& out) {
  assert(samples.size() == size_t{kReliefSamples} * kReliefSamples);
  Head head = relief_levels::headOf<kPageCellsLog2>(samples, scratch);
  EncodingCoder coder{RangeEncoder(out)};
  PageCode<EncodingCoder>(coder, scratch).run(head, samples);
  coder.rc.finish();
}

bool decodeReliefCode(std::span<const uint8_t> bytes, ReliefCodeScratch& scratch, std::span<uint16_t> samples) {
  assert(samples.size() == size_t{kReliefSamples} * kReliefSamples);
  DecodingCoder coder{RangeDecoder(bytes)};
  Head head;
  PageCode<DecodingCoder>(coder, scratch).run(head, samples);
  return coder.rc.whole();
}

}  // namespace relievo
