// fault_injection.h - breaks one thing of an engine on purpose: the negative controls of tests, and comparisons in
// benchmarks. Nothing of the product sets it.
#pragma once

#include "src/base/result.h"
#include "src/gl/program.h"

namespace relievo {

class Engine;

struct FaultInjection {
  bool no_borders = false;  // samples are clamped to the page's payload
  bool no_snapping = false;
  bool unordered_ends = false;         // over a base mesh: a side's points are interpolated in the patch's direction
  bool draw_backs = false;             // of closed bodies, too
  bool one_lookup = false;             // taps beyond a page's border are clamped to it
  bool one_sample_a_texel = false;     // relief is read as if a texel held one sample
  bool cells_without_heights = false;  // patches that a program of their own draws as one cell
  bool narrow_residuals = false,
       flat_blocks = false;   // of relief in compact form: a bit less than there is; slopes left out
  bool call_a_patch = false;  // each instance by a draw call of its own, for comparison
};

// What the programs that compute vertices are compiled with, and what those that look texels up are.
void addVertexFaults(const FaultInjection& faults, gl::Defines& defines);
void addLookupFaults(const FaultInjection& faults, gl::Defines& defines);

// Links the engine's programs anew; {} mends all.
Result<void> injectFaults(Engine& engine, const FaultInjection& what);

}  // namespace relievo
