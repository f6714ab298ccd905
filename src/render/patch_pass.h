// patch_pass.h - draws a list of patch instances: one instanced draw a grid level that occurs, 0 to kMaxGridLevel.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "geometry/planar_lod.h"
#include "src/camera.h"
#include "src/gl/objects.h"
#include "src/gl/program.h"
#include "src/render/depth.h"
#include "texturing/page_cache.h"

namespace relievo {

// What patch.vert reads of an instance.
struct GpuPatchInstance {
  int32_t origin[4];   // x, y from the eye's unit (over a base mesh: from the patch's corner); log2 of the step; grid level
  int32_t relief[4];   // x, y from the relief page's corner; ReliefPlace::texel (-1: the patch's tail); log2 of the sample spacing
  uint32_t node[3];    // index in the list + 1; level; patch
  uint32_t edges;      // per side a byte
};

// And with geomorph: weights of geometry/morph.h, per side a byte, of whole edges or first halves; of second halves; of the grid's inside.
struct GpuPatchMorph {
  uint32_t weights[3];
};

// Attribute order of every program that uses patch.vert.
std::vector<std::string> patchAttributes();

// The eye in whole units, and what turns unit differences from it into clip space.
struct EyeFrame {
  int64_t unit_x = 0, unit_y = 0;
  int patch_units_log2 = 0;  // units of a patch's side
  std::array<float, 16> clip_from_eye{};
  DepthMode depth;
  int32_t limit_x = 0, limit_y = 0;
  float mm_per_unit = 1, mm_per_height_step = 0, zero_height_mm = 0;
};
EyeFrame eyeFrame(const ViewTransform& view, const PlanarDomain& domain, double exaggerate, bool relief, const DepthMode& depth);
// Over a base mesh: instances' units count within their patch.
EyeFrame meshEyeFrame(const ViewTransform& view, const PlanarDomain& domain, double exaggerate, bool relief, const DepthMode& depth);

class PatchPass {
 public:
  // cells_as_mesh: very many grids of one cell are drawn as one mesh, not as instances, of which each costs a driver in software as much as its
  // vertices; packing them takes longer.
  explicit PatchPass(bool cells_as_mesh = false);
  // `slot_of` answers with the slot of a relief page in use.
  void setInstances(std::span<const PatchInstance> instances, const EyeFrame& eye, bool relief,
                    const std::function<SlotIndex(const NodeId&)>& slot_of);
  enum class Mesh { kFull, kFronts, kLines };  // kFronts: triangles that are seen from outside the body
  // With a program in use and its other uniforms set. Returns draw calls made.
  uint32_t draw(const gl::Program& program, const EyeFrame& eye, Mesh mesh, float depth_bias = 0) const;
  // The full mesh again, a draw call and its uniforms an instance: what instancing is compared with.
  uint32_t drawOneByOne(const gl::Program& program, const EyeFrame& eye) const;
  // Every vertex of the full mesh, instance by instance, as v_clip by transform feedback.
  std::vector<float> capture(const gl::Program& program, const EyeFrame& eye, uint32_t max_vertices) const;
  // The nodes of the list, as texture `unit`, for what reads the surface buffer.
  void bindNodes(const gl::Program& program, int unit) const;
  uint32_t triangles() const { return triangles_; }
  uint32_t instanceCount() const { return instance_count_; }

 private:
  struct Grid {
    uint32_t first_vertex = 0, vertices = 0;
    uint32_t first_index = 0, indices = 0;        // triangles
    uint32_t first_line = 0, line_indices = 0;
  };
  void setMorphs(std::span<const PatchInstance> instances);
  void setCells(uint32_t count);
  uint32_t drawCells() const;
  void bindInstances(size_t first_instance) const;
  void setUniforms(const gl::Program& program, const EyeFrame& eye, float depth_bias) const;

  gl::VertexArray vertex_array_;
  gl::Buffer vertices_, indices_, instances_, morphs_;
  const bool cells_as_mesh_;
  gl::VertexArray cell_array_;
  gl::Buffer cells_, cell_grid_, cell_indices_;  // by vertex: instances, place in the grid
  std::vector<GpuPatchInstance> cell_corners_;
  uint32_t cell_count_ = 0, cell_room_ = 0;      // 0: as instances
  bool morphs_any_ = false;  // one of the instances is not in place
  gl::Texture nodes_;
  std::vector<GpuPatchInstance> packed_;                 // kept for their memory
  std::vector<std::array<uint32_t, 4>> node_texels_;
  Grid grids_[kMaxGridLevel + 1];
  uint32_t group_first_[kMaxGridLevel + 2] = {};
  uint32_t instance_count_ = 0, triangles_ = 0;
};

}  // namespace relievo
