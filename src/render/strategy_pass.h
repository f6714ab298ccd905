// strategy_pass.h - draws what a LOD strategy chose (geometry/strategies/lod_strategy.h) into a buffer that says which
// place of the artwork each pixel shows: RGBA32UI, u and v in the instance's node as float bits, the instance's index +
// 1 (0: nothing), how far u or v goes to the next pixel. base is null for a flat artwork. The context that it was
// made in must be current, and a relief page must be uploaded before anything is displaced from it.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <unordered_map>
#include <vector>

#include "geometry/strategies/lod_strategy.h"
#include "src/gl/context.h"
#include "src/gl/objects.h"
#include "src/gl/program.h"
#include "src/render/base_corners.h"
#include "src/render/camera.h"
#include "src/render/page_pool.h"
#include "src/render/patch_pass.h"
#include "src/render/surface_target.h"
#include "src/render/tessellated_pass.h"
#include "texturing/stream/page_table.h"

namespace relievo {

struct StrategyDraw {
  uint64_t triangles = 0;
  uint32_t draw_calls = 0;
};

class StrategyPass {
 public:
  // relief_pages: how many are uploaded.
  StrategyPass(gl::Api api, const PatchDomain& domain, std::shared_ptr<const BaseMesh> base, uint32_t relief_pages);
  void resize(int width_px, int height_px) { target_.resize(width_px, height_px, false); }
  void upload(const NodeId& relief_page, const uint8_t* texels /* kSlotBytes */);
  void share(const NodeId& relief_page, const NodeId& uploaded) { slots_[relief_page] = slotOf(uploaded); }  // alike

  // Clears, then draws; the driver may not have finished on return. Errors: kRuntime where a program does not link,
  // kUnsupported for tessellation without GL 4.
  Result<StrategyDraw> draw(const StrategyResult& chosen, const ViewTransform& view, double exaggerate);
  // Rows bottom first, as GL has them.
  void read(std::vector<std::array<uint32_t, 4>>& pixels) const { target_.read(pixels); }
  // Clip positions of every grid vertex, by transform feedback, instance by instance, rows of 2^n + 1; empty for
  // tessellated patches, where there are no grids, or above max_vertices.
  Result<std::vector<float>> capture(const StrategyResult& chosen, const ViewTransform& view, double exaggerate,
                                     uint32_t max_vertices);
  // Waits until everything that was drawn is finished.
  static void finish();
  static bool hasTessellation(gl::Api api);
  static uint64_t maxPages() { return PagePool::maxSlots(); }

 private:
  Result<const gl::Program*> program(GridRule rule, bool capture);
  struct KeptMesh {
    std::weak_ptr<const StrategyMesh> owner;
    gl::Buffer vertices, indices;
  };
  KeptMesh& kept(const std::shared_ptr<const StrategyMesh>& mesh, const EyeFrame& eye);
  static void pointAtVertices(GLuint buffer);
  void drawKept(const StrategyResult& chosen, const EyeFrame& eye);
  void drawTriangles(const StrategyResult& chosen, const EyeFrame& eye);
  Result<StrategyDraw> drawTessellated(const StrategyResult& chosen, const EyeFrame& eye);
  EyeFrame eyeFrameOf(const ViewTransform& view, double exaggerate);
  gl::Defines defines() const;
  // What every program in use reads.
  void bindAll(const gl::Program& program);
  // A grid program in use, with the pages and its own uniforms; the instances set.
  Result<const gl::Program*> prepare(const StrategyResult& chosen, const ViewTransform& view, const EyeFrame& eye,
                                     bool capture);
  SlotIndex slotOf(const NodeId& page) const;

  gl::Api api_;
  PatchDomain domain_;
  std::unique_ptr<BaseCorners> corners_;
  PagePool pool_;
  PageTable table_;
  uint32_t uploaded_ = 0;
  std::unordered_map<NodeId, SlotIndex> slots_;
  PatchPass patches_;
  std::array<gl::Program, 10> programs_;
  gl::Program triangle_program_;
  TessellatedPass tessellated_;
  gl::VertexArray vertex_array_;
  gl::Buffer vertices_, drawn_indices_;
  std::unordered_map<const StrategyMesh*, KeptMesh> kept_;
  SurfaceTarget target_;
};

}  // namespace relievo
