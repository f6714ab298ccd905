// fault_injection.h - breaks one thing of an engine on purpose, for the negative controls of tests and for comparisons
// in benchmarks. The program itself never sets it.
#pragma once

#include "src/base/result.h"
#include "src/gl/program.h"

namespace relievo {

class Engine;

struct FaultInjection {
  bool no_borders = false;  // samples are clamped to the page's payload
  bool no_snapping = false;
  bool unordered_ends = false;         // over a base mesh: a side's points are interpolated in the patch's direction
  bool draw_backs = false;             // back-facing triangles of closed bodies are drawn, too
  bool one_lookup = false;             // taps beyond a page's border are clamped to it
  bool one_sample_a_texel = false;     // relief is read as if a texel held one sample
  bool cells_without_heights = false;  // patches drawn as one cell (ROOT_CELLS) have no heights
  bool narrow_residuals = false;       // compact relief: residuals are read with a bit less than they have
  bool flat_blocks = false;            // compact relief: the slopes of blocks are left out
  bool call_a_patch = false;           // a draw call for each instance, for comparison
};

// The defines that bring the faults into programs that compute vertices, and into those that look up texels.
void addVertexFaults(const FaultInjection& faults, gl::Defines& defines);
void addLookupFaults(const FaultInjection& faults, gl::Defines& defines);

// Links the engine's programs again, with these faults; {} removes all faults.
Result<void> injectFaults(Engine& engine, const FaultInjection& what);

}  // namespace relievo
