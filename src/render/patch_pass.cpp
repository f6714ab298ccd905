#include "src/render/patch_pass.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cassert>
#include <cmath>
#include <cstddef>
#include <numeric>

#include "geometry/lod/planar_lod.h"
#include "src/artwork/base_mesh.h"
#include "src/render/page_pool.h"

namespace relievo {
namespace {

constexpr uint32_t kManyCells = 1024;  // grids of one cell, from which on they are drawn as one mesh
constexpr GLuint kGridAttribute = 0, kInstanceAttribute = 1, kMorphAttribute = 2;
constexpr int kInstanceUnit = 3;  // behind the pool's

uint32_t packEdges(const PatchInstance& p) {
  static_assert(std::endian::native == std::endian::little);
  auto bits = std::bit_cast<uint64_t>(p.edges);  // eight bytes below 16 to eight halves of bytes
  bits = (bits | bits >> 4) & 0x00FF00FF00FF00FF;
  bits = (bits | bits >> 8) & 0x0000FFFF0000FFFF;
  return static_cast<uint32_t>(bits | bits >> 16);
}

GpuPatchMorph packMorph(const PatchInstance& p) {
  GpuPatchMorph m{{0, 0, p.morph}};
  for (size_t side = 0; side < 4; ++side)
    for (size_t half = 0; half < 2; ++half)
      m.weights[half] |= static_cast<uint32_t>(p.edge_morph[side][half]) << (8 * side);
  return m;
}

EyeFrame flatEyeFrame(const ViewTransform& view, const FlatDomain& domain, double exaggerate, bool relief,
                      const DepthMode& depth) {
  EyeFrame eye;
  eye.depth = depth;
  eye.patch_units_log2 = std::countr_zero(domain.patchPx()) + kUnitsPerTexelLog2;
  double mm_per_unit = domain.mm_per_px / (1 << kUnitsPerTexelLog2);
  double half_w = 0.5 * static_cast<double>(domain.width_px) * domain.mm_per_px;
  double half_h = 0.5 * static_cast<double>(domain.height_px) * domain.mm_per_px;
  auto limit = static_cast<int64_t>(1) << 29;  // an eye far off the artwork: differences stay within 32 bits
  eye.unit_x = std::clamp<int64_t>(std::llround((view.eye_mm.x + half_w) / mm_per_unit), -limit, limit);
  eye.unit_y = std::clamp<int64_t>(std::llround((half_h - view.eye_mm.y) / mm_per_unit), -limit, limit);
  glm::dvec3 origin{static_cast<double>(eye.unit_x) * mm_per_unit - half_w,
                    half_h - static_cast<double>(eye.unit_y) * mm_per_unit, view.eye_mm.z};
  eye.origin_mm = origin;
  eye.clip_from_eye = glClipFrom(view.clip_from_world, origin, depth);
  eye.limit_x = static_cast<int32_t>((static_cast<int64_t>(domain.width_px) << kUnitsPerTexelLog2) - eye.unit_x);
  eye.limit_y = static_cast<int32_t>((static_cast<int64_t>(domain.height_px) << kUnitsPerTexelLog2) - eye.unit_y);
  eye.mm_per_unit = static_cast<float>(mm_per_unit);
  eye.mm_per_height_step = static_cast<float>(domain.relief_scale_mm * exaggerate);
  eye.zero_height_mm = static_cast<float>((relief ? domain.relief_offset_mm * exaggerate : 0.0) - view.eye_mm.z);
  return eye;
}

EyeFrame meshEyeFrame(const ViewTransform& view, const PatchMeasures& domain, double exaggerate, bool relief,
                      const DepthMode& depth) {
  EyeFrame eye;
  eye.depth = depth;
  eye.patch_units_log2 = std::countr_zero(unsigned{kPagePx}) + std::max(domain.relief_depth, 0);
  eye.origin_mm = view.eye_mm;
  eye.clip_from_eye = glClipFrom(view.clip_from_world, view.eye_mm, depth);
  eye.limit_x = eye.limit_y = 1 << eye.patch_units_log2;
  eye.mm_per_unit = std::ldexp(1.0f, -eye.patch_units_log2);
  eye.mm_per_height_step = static_cast<float>(domain.relief_scale_mm * exaggerate);
  eye.zero_height_mm = relief ? static_cast<float>(domain.relief_offset_mm * exaggerate) : 0.0f;
  return eye;
}

}  // namespace

std::vector<std::string> patchAttributes() { return {"a_grid", "a_instance", "a_morph"}; }

EyeFrame eyeFrame(const ViewTransform& view, const PatchDomain& domain, double exaggerate, bool relief,
                  const DepthMode& depth) {
  return domain.isFlat() ? flatEyeFrame(view, domain.flat(), exaggerate, relief, depth)
                         : meshEyeFrame(view, domain, exaggerate, relief, depth);
}

PatchPass::PatchPass(bool cells_as_mesh)
    : vertex_array_(gl::VertexArray::create()),
      vertices_(gl::Buffer::create()),
      indices_(gl::Buffer::create()),
      numbers_(gl::Buffer::create()),
      morphs_(gl::Buffer::create()),
      cells_as_mesh_(cells_as_mesh) {
  std::vector<uint8_t> vertices;
  std::vector<uint16_t> indices;
  for (int n = 0; n <= kMaxGridLevel; ++n) {
    Grid& grid = grids_[n];
    int side = (1 << n) + 1;
    grid.first_vertex = static_cast<uint32_t>(vertices.size() / 4);
    grid.vertices = static_cast<uint32_t>(side * side);
    for (int j = 0; j < side; ++j)
      for (int i = 0; i < side; ++i)
        for (int byte : {i, j, 0, 0}) vertices.push_back(static_cast<uint8_t>(byte));
    auto at = [side](int i, int j) { return static_cast<uint16_t>(j * side + i); };
    grid.first_index = static_cast<uint32_t>(indices.size());
    for (int j = 0; j + 1 < side; ++j) {
      for (int i = 0; i + 1 < side; ++i) {
        // Split along (i, j) - (i + 1, j + 1); counter-clockwise seen from the viewer (y points down in the grid).
        for (uint16_t v : {at(i, j), at(i + 1, j + 1), at(i + 1, j), at(i, j), at(i, j + 1), at(i + 1, j + 1)}) {
          indices.push_back(v);
        }
      }
    }
    grid.indices = static_cast<uint32_t>(indices.size()) - grid.first_index;
    grid.first_line = static_cast<uint32_t>(indices.size());
    for (int j = 0; j < side; ++j) {
      for (int i = 0; i < side; ++i) {
        if (i + 1 < side) indices.insert(indices.end(), {at(i, j), at(i + 1, j)});
        if (j + 1 < side) indices.insert(indices.end(), {at(i, j), at(i, j + 1)});
        if (i + 1 < side && j + 1 < side) indices.insert(indices.end(), {at(i, j), at(i + 1, j + 1)});
      }
    }
    grid.line_indices = static_cast<uint32_t>(indices.size()) - grid.first_line;
  }
  glBindVertexArray(vertex_array_.id());
  glBindBuffer(GL_ARRAY_BUFFER, vertices_.id());
  glBufferData(GL_ARRAY_BUFFER, static_cast<GLsizeiptr>(vertices.size()), vertices.data(), GL_STATIC_DRAW);
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, indices_.id());
  glBufferData(GL_ELEMENT_ARRAY_BUFFER, static_cast<GLsizeiptr>(indices.size() * sizeof(uint16_t)), indices.data(),
               GL_STATIC_DRAW);
  for (GLuint a : {kGridAttribute, kInstanceAttribute}) glEnableVertexAttribArray(a);
  for (GLuint a : {kInstanceAttribute, kMorphAttribute}) glVertexAttribDivisor(a, 1);
  glBindVertexArray(0);
}

void PatchPass::setInstances(std::span<const PatchInstance> instances, const EyeFrame& eye, bool relief,
                             const std::function<SlotIndex(const NodeId&)>& slot_of) {
  const size_t count = instances.size();
  list_ = (list_ + 1) % lists_.size();
  TexelTable& list = lists_[list_];
  static_assert(sizeof(GpuPatchInstance) == 2 * 16);
  if (list.size() < 2 * count || list.size() == 0) list.resize(2 * std::bit_ceil(std::max<size_t>(count, 1024)));
  auto* const mapped = static_cast<GpuPatchInstance*>(list.map(2 * count));
  if (!mapped && packed_.size() < count) packed_.resize(std::bit_ceil(count));
  GpuPatchInstance* const packed = mapped ? mapped : packed_.data();
  std::array<uint32_t, kMaxGridLevel + 1> of_level{};
  uint64_t in_place = ~uint64_t{0};
  cells_are_roots_ = true;
  NodeId last_page{PatchNeighbour::kNone, 0, 0, 0};
  ReliefPlace last_place;
  for (size_t i = 0; i < count; ++i) {
    const PatchInstance& p = instances[i];
    ++of_level[p.grid_level];
    in_place &= std::bit_cast<uint64_t>(p.edge_morph) & (p.morph | ~uint64_t{255});
    cells_are_roots_ &= p.grid_level > 0 || (p.node.level == 0 && (!relief || p.relief_page.level == kTailLevel));
    static_assert(kMaxGridLevel < 8);
    uint32_t levels = p.node.level | uint32_t{p.grid_level} << 5 | uint32_t{p.step_log2} << 8;
    uint32_t place = 0;
    if (relief && p.relief_page.level == kTailLevel) {
      place = kReliefInTail;
      levels |= static_cast<uint32_t>(eye.patch_units_log2 - kTailCellsLog2) << 13 | p.node.level << 18;
    } else if (relief) {
      assert(p.node.ancestor(p.relief_page.level) == p.relief_page &&
             eye.patch_units_log2 == static_cast<int>(p.node.level) + p.grid_level + p.step_log2);
      if (p.relief_page != last_page) last_page = p.relief_page, last_place = reliefPlace(slot_of(p.relief_page));
      place = last_place.texel;
      levels |=
          static_cast<uint32_t>(eye.patch_units_log2 - static_cast<int>(p.relief_page.level) - 7 + last_place.coarser)
          << 13;
      levels |= (p.node.level - p.relief_page.level) << 18;
      if (last_place.compact) levels |= static_cast<uint32_t>(1 + last_place.coarser) << 23;
    }
    packed[i] = {p.node.patch,
                 levels,
                 p.node.x,
                 p.node.y,
                 {static_cast<int32_t>(p.x0 - eye.unit_x), static_cast<int32_t>(p.y0 - eye.unit_y)},
                 place,
                 packEdges(p)};
  }
  group_first_[0] = triangles_ = 0;
  for (int n = 0; n <= kMaxGridLevel; ++n) {
    group_first_[n + 1] = group_first_[n] + of_level[static_cast<size_t>(n)];
    triangles_ += of_level[static_cast<size_t>(n)] * (2u << (2 * n));
  }
  instance_count_ = static_cast<uint32_t>(count);
  if (mapped) list.unmap();
  else list.write(0, packed, 2 * count);
  reserve(instance_count_);
  morphs_any_ = in_place != ~uint64_t{0};
  if (morphs_any_) setMorphs(instances);
  setCells(!cells_as_mesh_ || morphs_any_ || of_level[0] < kManyCells ? 0 : of_level[0]);
}

// Numbers for as many instances.
void PatchPass::reserve(uint32_t count) {
  if (count <= numbers_room_) return;
  numbers_room_ = std::bit_ceil(count);
  std::vector<uint32_t> numbers(numbers_room_);
  std::iota(numbers.begin(), numbers.end(), 0u);
  glBindBuffer(GL_ARRAY_BUFFER, numbers_.id());
  glBufferData(GL_ARRAY_BUFFER, static_cast<GLsizeiptr>(numbers.size() * 4), numbers.data(), GL_STATIC_DRAW);
  gl::label(GL_BUFFER, numbers_.id(), "instance numbers");
}

// Of the first `count` instances, which come first in the list.
void PatchPass::setCells(uint32_t count) {
  cell_count_ = count;
  if (count <= cell_room_) return;
  if (!cell_array_) {
    cell_array_ = gl::VertexArray::create();
    cells_ = gl::Buffer::create();
    cell_indices_ = gl::Buffer::create();
  }
  struct Corner {
    uint8_t grid[4];
    uint32_t instance;
  };
  cell_room_ = std::bit_ceil(count);
  std::vector<Corner> corners;
  std::vector<uint32_t> indices;
  for (uint32_t i = 0; i < cell_room_; ++i) {
    for (uint8_t y : {0, 1})
      for (uint8_t x : {0, 1}) corners.push_back({{x, y, 0, 0}, i});
    for (uint32_t v : {0, 3, 1, 0, 2, 3}) indices.push_back(4 * i + v);
  }
  glBindVertexArray(cell_array_.id());
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, cell_indices_.id());
  glBufferData(GL_ELEMENT_ARRAY_BUFFER, static_cast<GLsizeiptr>(indices.size() * 4), indices.data(), GL_STATIC_DRAW);
  glBindBuffer(GL_ARRAY_BUFFER, cells_.id());
  glBufferData(GL_ARRAY_BUFFER, static_cast<GLsizeiptr>(corners.size() * sizeof(Corner)), corners.data(),
               GL_STATIC_DRAW);
  for (GLuint a : {kGridAttribute, kInstanceAttribute}) glEnableVertexAttribArray(a);
  glVertexAttribIPointer(kGridAttribute, 2, GL_UNSIGNED_BYTE, sizeof(Corner), nullptr);
  glVertexAttribIPointer(kInstanceAttribute, 1, GL_UNSIGNED_INT, sizeof(Corner),
                         reinterpret_cast<const void*>(offsetof(Corner, instance)));
  glBindVertexArray(0);
}

uint32_t PatchPass::drawCells() const {
  glBindVertexArray(cell_array_.id());
  glVertexAttribI4ui(kMorphAttribute, ~0u, ~0u, ~0u, ~0u);
  glDrawElements(GL_TRIANGLES, static_cast<GLsizei>(6 * cell_count_), GL_UNSIGNED_INT, nullptr);
  glBindVertexArray(vertex_array_.id());
  return 1;
}

void PatchPass::setMorphs(std::span<const PatchInstance> instances) {
  std::vector<GpuPatchMorph> morphs;
  morphs.reserve(instances.size());
  for (const PatchInstance& p : instances) morphs.push_back(packMorph(p));
  glBindBuffer(GL_ARRAY_BUFFER, morphs_.id());
  glBufferData(GL_ARRAY_BUFFER, static_cast<GLsizeiptr>(morphs.size() * sizeof(GpuPatchMorph)), morphs.data(),
               GL_STREAM_DRAW);
}

void PatchPass::bindGroup(const Grid& grid, size_t first_instance) const {
  glBindBuffer(GL_ARRAY_BUFFER, vertices_.id());
  glVertexAttribIPointer(kGridAttribute, 2, GL_UNSIGNED_BYTE, 4,
                         reinterpret_cast<const void*>(size_t{grid.first_vertex} * 4));
  glBindBuffer(GL_ARRAY_BUFFER, numbers_.id());
  glVertexAttribIPointer(kInstanceAttribute, 1, GL_UNSIGNED_INT, 4, reinterpret_cast<const void*>(first_instance * 4));
  if (!morphs_any_) {
    glDisableVertexAttribArray(kMorphAttribute);
    glVertexAttribI4ui(kMorphAttribute, ~0u, ~0u, ~0u, ~0u);
    return;
  }
  glEnableVertexAttribArray(kMorphAttribute);
  glBindBuffer(GL_ARRAY_BUFFER, morphs_.id());
  glVertexAttribIPointer(kMorphAttribute, 3, GL_UNSIGNED_INT, sizeof(GpuPatchMorph),
                         reinterpret_cast<const void*>(first_instance * sizeof(GpuPatchMorph)));
}

void PatchPass::bindInstances(const gl::Program& program, int unit) const {
  lists_[list_].bind(program, "u_instances", unit);
}

void PatchPass::setUniforms(const gl::Program& program, const EyeFrame& eye, float depth_bias) const {
  glUniformMatrix4fv(program.uniform("u_clip_from_eye"), 1, GL_FALSE, eye.clip_from_eye.data());
  glUniform2i(program.uniform("u_limit"), eye.limit_x, eye.limit_y);
  glUniform4f(program.uniform("u_scale"), eye.mm_per_unit, eye.mm_per_height_step, eye.zero_height_mm,
              eye.depth.nearer(depth_bias));
}

uint32_t PatchPass::draw(const gl::Program& program, const EyeFrame& eye, Mesh mesh, float depth_bias,
                         const gl::Program* root_cells) const {
  auto begin = [&](const gl::Program& p) {
    p.use();
    bindInstances(p, kInstanceUnit);
    setUniforms(p, eye, depth_bias);
  };
  begin(program);
  glBindVertexArray(vertex_array_.id());
  if (mesh == Mesh::kFronts) glEnable(GL_CULL_FACE);  // GL's defaults: clockwise ones are culled
  if (mesh == Mesh::kLines) glDepthMask(GL_FALSE);    // depth tells where the surface is seen
  uint32_t calls = 0;
  auto drawGroup = [&](int n, uint32_t first, uint32_t count) {
    if (count == 0) return;
    const Grid& grid = grids_[n];
    bindGroup(grid, first);
    bool lines = mesh == Mesh::kLines;
    uint32_t first_index = lines ? grid.first_line : grid.first_index;
    glDrawElementsInstanced(lines ? GL_LINES : GL_TRIANGLES,
                            static_cast<GLsizei>(lines ? grid.line_indices : grid.indices), GL_UNSIGNED_SHORT,
                            reinterpret_cast<const void*>(size_t{first_index} * sizeof(uint16_t)),
                            static_cast<GLsizei>(count));
    ++calls;
  };
  const bool as_cells = cell_count_ > 0 && mesh != Mesh::kLines;
  const bool apart = as_cells && root_cells && cells_are_roots_;
  if (apart) begin(*root_cells);
  if (as_cells) calls += drawCells();
  if (apart) program.use();
  for (int n = as_cells ? 1 : 0; n <= kMaxGridLevel; ++n)
    drawGroup(n, group_first_[n], group_first_[n + 1] - group_first_[n]);
  glDisable(GL_CULL_FACE);
  glDepthMask(GL_TRUE);
  glBindVertexArray(0);
  return calls;
}

uint32_t PatchPass::drawOneByOne(const gl::Program& program, const EyeFrame& eye) const {
  bindInstances(program, kInstanceUnit);
  glBindVertexArray(vertex_array_.id());
  for (int n = 0; n <= kMaxGridLevel; ++n) {
    const Grid& grid = grids_[n];
    for (uint32_t i = group_first_[n]; i < group_first_[n + 1]; ++i) {
      setUniforms(program, eye, 0);
      bindGroup(grid, i);
      glDrawElementsInstanced(GL_TRIANGLES, static_cast<GLsizei>(grid.indices), GL_UNSIGNED_SHORT,
                              reinterpret_cast<const void*>(size_t{grid.first_index} * sizeof(uint16_t)), 1);
    }
  }
  glBindVertexArray(0);
  return instance_count_;
}

std::vector<float> PatchPass::capture(const gl::Program& program, const EyeFrame& eye, uint32_t max_vertices,
                                      const gl::Program* root_cells) const {
  uint64_t total = 0;
  for (int n = 0; n <= kMaxGridLevel; ++n)
    total += uint64_t{group_first_[n + 1] - group_first_[n]} * grids_[n].vertices;
  if (total == 0 || total > max_vertices) return {};
  auto buffer = gl::Buffer::create();
  glBindBuffer(GL_TRANSFORM_FEEDBACK_BUFFER, buffer.id());
  glBufferData(GL_TRANSFORM_FEEDBACK_BUFFER, static_cast<GLsizeiptr>(total * 16), nullptr, GL_STATIC_READ);
  glBindVertexArray(vertex_array_.id());
  glEnable(GL_RASTERIZER_DISCARD);
  uint64_t offset = 0;
  for (int n = 0; n <= kMaxGridLevel; ++n) {
    uint32_t count = group_first_[n + 1] - group_first_[n];
    if (count == 0) continue;
    const Grid& grid = grids_[n];
    const gl::Program& in_use = n == 0 && root_cells && cells_are_roots_ ? *root_cells : program;
    in_use.use();
    bindInstances(in_use, kInstanceUnit);
    setUniforms(in_use, eye, 0);
    bindGroup(grid, group_first_[n]);
    uint64_t bytes = uint64_t{count} * grid.vertices * 16;
    glBindBufferRange(GL_TRANSFORM_FEEDBACK_BUFFER, 0, buffer.id(), static_cast<GLintptr>(offset),
                      static_cast<GLsizeiptr>(bytes));
    glBeginTransformFeedback(GL_POINTS);
    glDrawArraysInstanced(GL_POINTS, 0, static_cast<GLsizei>(grid.vertices), static_cast<GLsizei>(count));
    glEndTransformFeedback();
    offset += bytes;
  }
  glDisable(GL_RASTERIZER_DISCARD);
  glBindVertexArray(0);
  std::vector<float> out(total * 4);
  glBindBuffer(GL_TRANSFORM_FEEDBACK_BUFFER, buffer.id());
  if (void* mapped =
          glMapBufferRange(GL_TRANSFORM_FEEDBACK_BUFFER, 0, static_cast<GLsizeiptr>(total * 16), GL_MAP_READ_BIT)) {
    std::copy_n(static_cast<const float*>(mapped), out.size(), out.begin());
    glUnmapBuffer(GL_TRANSFORM_FEEDBACK_BUFFER);
  } else {
    out.clear();
  }
  glBindBuffer(GL_TRANSFORM_FEEDBACK_BUFFER, 0);
  return out;
}

}  // namespace relievo
