// patch_pass.h - draws a list of patch instances: one instanced draw call for each grid level in it, 0 to
// kMaxGridLevel.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <vector>

#include "geometry/lod/lod.h"
#include "src/gl/objects.h"
#include "src/gl/program.h"
#include "src/render/camera.h"
#include "src/render/depth.h"
#include "src/render/texel_table.h"
#include "texturing/stream/page_cache.h"

namespace relievo {

// An instance as shaders read it (shaders/instance.glsl): two texels of one table, for vertices and for the pixels that
// show it.
struct GpuPatchInstance {
  uint32_t patch;
  uint32_t levels;  // the node's level 5 bits | grid level 3 | log2 of the step 5 | log2 of the relief samples' spacing
                    // 5 | levels from the relief page to the node 5 | 0, or for relief in compact form 1 +
                    // ReliefPlace::coarser 2
  uint32_t x, y;    // the node's
  int32_t origin[2];  // units from the eye's unit (over a base mesh: from the patch's corner)
  uint32_t relief;    // ReliefPlace::texel; kReliefInTail: the patch's tail
  uint32_t edges;     // per side a byte
};
static_assert(sizeof(GpuPatchInstance) == 32);
inline constexpr uint32_t kReliefInTail = ~0u;

// With geomorph, the weights of geometry/lod/morph.h. weights[0]: a byte per side, of whole edges or first halves;
// weights[1]: of second halves; weights[2]: of the grid's inside.
struct GpuPatchMorph {
  uint32_t weights[3];
};

// Attribute order of every program that uses patch.vert.
std::vector<std::string> patchAttributes();

// The eye in whole units, and what turns unit differences from it into clip space.
struct EyeFrame {
  int64_t unit_x = 0, unit_y = 0;
  int patch_units_log2 = 0;  // units of a patch's side
  glm::dvec3 origin_mm{0};   // what positions count from
  std::array<float, 16> clip_from_eye{};
  DepthMode depth;
  int32_t limit_x = 0, limit_y = 0;
  float mm_per_unit = 1, mm_per_height_step = 0, zero_height_mm = 0;
};
// Over a base mesh instances' units count within their patch, and the eye is at unit 0.
EyeFrame eyeFrame(const ViewTransform& view, const PatchDomain& domain, double exaggerate, bool relief,
                  const DepthMode& depth);

class PatchPass {
 public:
  // cells_as_mesh: grids of one cell are drawn as one mesh where there are very many, since to software OpenGL each
  // instance costs as much as its vertices. Packing the mesh takes longer.
  explicit PatchPass(bool cells_as_mesh = false);
  // `slot_of` answers with the slot of a relief page in use.
  void setInstances(std::span<const PatchInstance> instances, const EyeFrame& eye, bool relief,
                    const std::function<SlotIndex(const NodeId&)>& slot_of);
  enum class Mesh { kFull, kFronts, kLines };  // kFronts: triangles that are seen from outside the body
  // Needs the program in use and its other uniforms set. Returns the number of draw calls.
  // root_cells: the program with ROOT_CELLS defined, set up alike; where drawsRootCells() it computes the same
  // vertices.
  uint32_t draw(const gl::Program& program, const EyeFrame& eye, Mesh mesh, float depth_bias = 0,
                const gl::Program* root_cells = nullptr) const;
  // Draws the full mesh by a draw call for each instance, with its uniforms: the baseline for instancing.
  uint32_t drawOneByOne(const gl::Program& program, const EyeFrame& eye) const;
  // Reads back v_clip of every vertex of the full mesh by transform feedback, instance by instance.
  std::vector<float> capture(const gl::Program& program, const EyeFrame& eye, uint32_t max_vertices,
                             const gl::Program* root_cells = nullptr) const;
  // Binds the list to texture unit `unit`, for passes that read the surface buffer. (draw() itself binds it, to
  // kInstanceUnit.)
  void bindInstances(const gl::Program& program, int unit) const;
  // Whether draw() has use for root_cells: single cells are drawn as one mesh, and all are whole patches with heights
  // from tails.
  bool drawsRootCells() const { return cell_count_ > 0 && cells_are_roots_; }
  uint32_t triangles() const { return triangles_; }
  uint32_t instanceCount() const { return instance_count_; }

 private:
  struct Grid {
    uint32_t first_vertex = 0, vertices = 0;
    uint32_t first_index = 0, indices = 0;  // triangles
    uint32_t first_line = 0, line_indices = 0;
  };
  void setMorphs(std::span<const PatchInstance> instances);
  void reserve(uint32_t count);
  void setCells(uint32_t count);
  uint32_t drawCells() const;
  void bindGroup(const Grid& grid, size_t first_instance) const;
  void setUniforms(const gl::Program& program, const EyeFrame& eye, float depth_bias) const;

  gl::VertexArray vertex_array_;
  gl::Buffer vertices_, indices_, numbers_, morphs_;  // numbers: 0, 1, 2.., by instance
  uint32_t numbers_room_ = 0;
  const bool cells_as_mesh_;
  gl::VertexArray cell_array_;
  gl::Buffer cells_, cell_indices_;          // by vertex: place in the grid, instance
  uint32_t cell_count_ = 0, cell_room_ = 0;  // 0: as instances
  bool cells_are_roots_ = false;             // all single cells are whole patches with heights from tails
  bool morphs_any_ = false;                  // one of the instances is not in place
  // Used in turn, so that a new list does not overwrite one that a frame in flight may still read.
  std::array<TexelTable, 2> lists_{TexelTable("patch instances", TexelTable::Texel::kUint32x4),
                                   TexelTable("patch instances", TexelTable::Texel::kUint32x4)};
  size_t list_ = 0;
  std::vector<GpuPatchInstance> packed_;  // where the list cannot be mapped; a member so that it keeps its capacity
  Grid grids_[kMaxGridLevel + 1];
  uint32_t group_first_[kMaxGridLevel + 2] = {};
  uint32_t instance_count_ = 0, triangles_ = 0;
};

}  // namespace relievo
