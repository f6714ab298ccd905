#include "src/engine/shading_programs.h"

#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "src/render/patch_pass.h"

namespace relievo {
namespace {

Result<void> linkOne(gl::Program& program, gl::Api api, const char* vertex, const char* fragment,
                     const gl::Defines& defines) {
  const bool screen_wide = std::string_view(vertex) == "screen.vert";
  auto linked = gl::Program::link(
      api, {vertex, fragment, defines, screen_wide ? std::vector<std::string>{"a_corner"} : patchAttributes(), {}});
  if (!linked) return linked.error();
  program = std::move(*linked);
  return {};
}

gl::Defines with(gl::Defines defines, const char* name) {
  defines.emplace_back(name, "1");
  return defines;
}

}  // namespace

Result<void> ShadingPrograms::link(gl::Api api, const Variant& variant) {
  gl::Defines defines = variant.defines;
  addVertexFaults(variant.faults, defines);
  addLookupFaults(variant.faults, defines);
  for (gl::Program* left :
       {&root_cells, &wire, &average, &tails, &roots, &normals, &normals_tails, &shadow_map, &shadow_map_roots, &shadow,
        &shadow_sum, &shadow_add, &shadow_mean, &capture, &capture_roots})
    *left = {};
  if (auto r = linkOne(surface, api, "patch.vert", "surface.frag", defines); !r) return r;
  // What is shaded by normals that were drawn before looks up no page itself.
  const gl::Defines shading = variant.normals ? with(defines, "NO_PAGES") : defines;
  if (auto r = linkOne(shade, api, "screen.vert", "shade.frag", shading); !r) return r;
  if (variant.tails) {
    if (auto r = linkOne(root_cells, api, "patch.vert", "surface.frag", with(defines, "ROOT_CELLS")); !r) return r;
    if (auto r = linkOne(tails, api, "screen.vert", "shade.frag", with(shading, "TAILS_ONLY")); !r) return r;
  }
  if (variant.normals) {
    const gl::Defines out = with(defines, "NORMALS_OUT");
    if (auto r = linkOne(normals, api, "screen.vert", "shade.frag", out); !r) return r;
    if (variant.tails)
      if (auto r = linkOne(normals_tails, api, "screen.vert", "shade.frag", with(out, "TAILS_ONLY")); !r) return r;
  }
  if (variant.feedback)
    if (auto r = linkOne(feedback, api, "screen.vert", "feedback.frag", defines); !r) return r;
  if (variant.shadows)
    if (auto r = linkOne(shadow, api, "screen.vert", "shadow.frag", {}); !r) return r;
  if (variant.shadow_sums) {
    if (auto r = linkOne(shadow_sum, api, "screen.vert", "shadow_sum.frag", {}); !r) return r;
    if (auto r = linkOne(shadow_mean, api, "screen.vert", "shadow_mean.frag", {}); !r) return r;
  }
  if (variant.shadow_adds)
    if (auto r = linkOne(shadow_add, api, "screen.vert", "shadow.frag", with({}, "SHADOW_SUMS")); !r) return r;
  if (variant.shadows || variant.shadow_sums) {
    if (auto r = linkOne(shadow_map, api, "patch.vert", "depth_only.frag", defines); !r) return r;
    if (variant.tails)
      if (auto r = linkOne(shadow_map_roots, api, "patch.vert", "depth_only.frag", with(defines, "ROOT_CELLS")); !r)
        return r;
  }
  if (variant.wireframe)
    if (auto r = linkOne(wire, api, "patch.vert", "lines.frag", with(defines, "WIREFRAME")); !r) return r;
  return variant.average ? linkOne(average, api, "screen.vert", "average.frag", {}) : Result<void>();
}

// Two levels of one page are that page: none is blended with another one.
Result<void> ShadingPrograms::linkRoots(gl::Api api, const Variant& variant) {
  gl::Defines defines = variant.defines;
  addLookupFaults(variant.faults, defines);
  std::erase_if(defines, [](const auto& define) { return define.first == "TRILINEAR"; });
  return linkOne(roots, api, "screen.vert", "shade.frag", defines);
}

Result<void> ShadingPrograms::linkCapture(gl::Api api, const Variant& variant) {
  gl::Defines defines = variant.defines;
  addVertexFaults(variant.faults, defines);
  defines.emplace_back("CAPTURE", "1");
  auto link = [&](gl::Program& program, const gl::Defines& with_defines) -> Result<void> {
    auto linked = gl::Program::link(api, {"patch.vert", "lines.frag", with_defines, patchAttributes(), {"v_clip"}});
    if (!linked) return linked.error();
    program = std::move(*linked);
    return {};
  };
  if (auto r = link(capture, defines); !r) return r;
  return variant.tails ? link(capture_roots, with(defines, "ROOT_CELLS")) : Result<void>();
}

}  // namespace relievo
