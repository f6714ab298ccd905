// shading_programs.h - the shader programs of one effect plan, linked together when the plan changes.
#pragma once

#include "src/base/result.h"
#include "src/engine/fault_injection.h"
#include "src/gl/context.h"
#include "src/gl/program.h"

namespace relievo {

// Programs that a plan does not need are empty (id 0). `root_cells` and `tails` need an artwork whose patches have
// tails (texturing/package/patch_tails.h).
class ShadingPrograms {
 public:
  gl::Program surface;                       // the geometry into the surface buffer
  gl::Program root_cells;                    // the same for patches that are drawn as one cell
  gl::Program shade;                         // the surface buffer into the picture
  gl::Program tails;                         // the same where no page is needed
  gl::Program roots;                         // the same where every look-up ends at a root; linkRoots()
  gl::Program normals, normals_tails;        // the surface buffer into its normals, as shade and tails
  gl::Program feedback;                      // the surface buffer into page requests
  gl::Program shadow_map, shadow_map_roots;  // the geometry into a map of depths, as surface and root_cells
  gl::Program shadow;                        // the map and the surface's depth into the share of light
  gl::Program shadow_sum, shadow_mean;       // the same into sums over directions, and their mean into the share
  gl::Program shadow_add;                    // the same of a near light into such sums
  gl::Program wire;                          // the triangles' edges
  gl::Program average;                       // the picture's samples into the picture
  gl::Program capture, capture_roots;        // vertices by transform feedback; linkCapture()

  struct Variant {
    gl::Defines defines;  // of the plan, the page pool and the tails
    bool tails = false, feedback = false, wireframe = false, shadows = false, average = false, normals = false;
    bool shadow_sums = false, shadow_adds = false;
    FaultInjection faults;
  };
  // Links all programs but roots, capture and capture_roots, which become empty. After a failure some programs are new,
  // some old.
  Result<void> link(gl::Api api, const Variant& variant);
  // For a plan without anisotropy and normals.
  Result<void> linkRoots(gl::Api api, const Variant& variant);
  Result<void> linkCapture(gl::Api api, const Variant& variant);
};

}  // namespace relievo
