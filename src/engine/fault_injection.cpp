#include "src/engine/fault_injection.h"

namespace relievo {

void addVertexFaults(const FaultInjection& faults, gl::Defines& defines) {
  if (faults.no_snapping) defines.emplace_back("NO_SNAPPING", "1");
  if (faults.unordered_ends) defines.emplace_back("UNORDERED_ENDS", "1");
  if (faults.one_sample_a_texel) defines.emplace_back("ONE_SAMPLE_A_TEXEL", "1");
  if (faults.cells_without_heights) defines.emplace_back("CELLS_WITHOUT_HEIGHTS", "1");
  if (faults.narrow_residuals) defines.emplace_back("NARROW_RESIDUALS", "1");
  if (faults.flat_blocks) defines.emplace_back("FLAT_BLOCKS", "1");
}

void addLookupFaults(const FaultInjection& faults, gl::Defines& defines) {
  if (faults.no_borders) defines.emplace_back("NO_BORDERS", "1");
  if (faults.one_lookup) defines.emplace_back("ONE_LOOKUP", "1");
}

}  // namespace relievo
