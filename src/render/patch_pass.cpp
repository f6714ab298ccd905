#include "src/render/patch_pass.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>

#include "src/base/base_mesh.h"
#include "src/render/page_pool.h"

namespace relievo {
namespace {

constexpr uint32_t kManyCells = 1024;  // grids of one cell, from which on they are drawn as one mesh
constexpr int kAttributes = 5;
constexpr int kNodesPerRow = 256;  // of the texture of nodes; known to texture_lookup.glsl

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
    for (size_t half = 0; half < 2; ++half) m.weights[half] |= static_cast<uint32_t>(p.edge_morph[side][half]) << (8 * side);
  return m;
}
constexpr GLuint kMorphAttribute = 5;

}  // namespace

std::vector<std::string> patchAttributes() { return {"a_grid", "a_origin", "a_relief", "a_node", "a_edges", "a_morph"}; }

EyeFrame eyeFrame(const ViewTransform& view, const PlanarDomain& domain, double exaggerate, bool relief, const DepthMode& depth) {
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
  eye.clip_from_eye = glClipFrom(view.clip_from_world, origin, depth);
  eye.limit_x = static_cast<int32_t>((static_cast<int64_t>(domain.width_px) << kUnitsPerTexelLog2) - eye.unit_x);
  eye.limit_y = static_cast<int32_t>((static_cast<int64_t>(domain.height_px) << kUnitsPerTexelLog2) - eye.unit_y);
  eye.mm_per_unit = static_cast<float>(mm_per_unit);
  eye.mm_per_height_step = static_cast<float>(domain.relief_scale_mm * exaggerate);
  eye.zero_height_mm = static_cast<float>((relief ? domain.relief_offset_mm * exaggerate : 0.0) - view.eye_mm.z);
  return eye;
}

EyeFrame meshEyeFrame(const ViewTransform& view, const PlanarDomain& domain, double exaggerate, bool relief, const DepthMode& depth) {
  EyeFrame eye;
  eye.depth = depth;
  eye.patch_units_log2 = std::countr_zero(unsigned{kPagePx}) + std::max(domain.relief_depth, 0);
  eye.clip_from_eye = glClipFrom(view.clip_from_world, view.eye_mm, depth);
  eye.limit_x = eye.limit_y = 1 << eye.patch_units_log2;
  eye.mm_per_unit = std::ldexp(1.0f, -eye.patch_units_log2);
  eye.mm_per_height_step = static_cast<float>(domain.relief_scale_mm * exaggerate);
  eye.zero_height_mm = relief ? static_cast<float>(domain.relief_offset_mm * exaggerate) : 0.0f;
  return eye;
}

PatchPass::PatchPass(bool cells_as_mesh)
    : vertex_array_(gl::VertexArray::create()),
      vertices_(gl::Buffer::create()),
      indices_(gl::Buffer::create()),
      instances_(gl::Buffer::create()),
      morphs_(gl::Buffer::create()),
      cells_as_mesh_(cells_as_mesh),
      nodes_(gl::Texture::create()) {
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
  for (GLuint a = 0; a < kAttributes; ++a) glEnableVertexAttribArray(a);
  for (GLuint a = 1; a < kAttributes; ++a) glVertexAttribDivisor(a, 1);
  glVertexAttribDivisor(kMorphAttribute, 1);
  glBindBuffer(GL_ARRAY_BUFFER, instances_.id());
  gl::label(GL_BUFFER, instances_.id(), "patch instances");
  glBindVertexArray(0);
  glBindTexture(GL_TEXTURE_2D, nodes_.id());
  gl::label(GL_TEXTURE, nodes_.id(), "nodes");
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  glTexParameteri(GL_TEXTURE_2D, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
}

void PatchPass::setInstances(std::span<const PatchInstance> instances, const EyeFrame& eye, bool relief,
                             const std::function<SlotIndex(const NodeId&)>& slot_of) {
  const size_t count = instances.size(), rows = (count + kNodesPerRow) / kNodesPerRow;
  if (packed_.size() < count) packed_.resize(count);
  if (node_texels_.size() < rows * kNodesPerRow) node_texels_.resize(rows * kNodesPerRow);
  std::array<uint32_t, kMaxGridLevel + 1> of_level{};
  uint64_t in_place = ~uint64_t{0};
  NodeId last_page{PatchNeighbour::kNone, 0, 0, 0};
  ReliefPlace last_place;
  for (size_t i = 0; i < count; ++i) {
    const PatchInstance& p = instances[i];
    ++of_level[p.grid_level];
    in_place &= std::bit_cast<uint64_t>(p.edge_morph) & (p.morph | ~uint64_t{255});
    GpuPatchInstance& g = packed_[i];
    g.origin[0] = static_cast<int32_t>(p.x0 - eye.unit_x);
    g.origin[1] = static_cast<int32_t>(p.y0 - eye.unit_y);
    g.origin[2] = p.step_log2;
    g.origin[3] = p.grid_level;
    if (!relief) {
      g.relief[0] = g.relief[1] = g.relief[2] = g.relief[3] = 0;
    } else if (p.relief_page.level == kTailLevel) {
      const int node_log2 = eye.patch_units_log2 - static_cast<int>(p.node.level);
      g.relief[0] = static_cast<int32_t>(p.node.x << node_log2);
      g.relief[1] = static_cast<int32_t>(p.node.y << node_log2);
      g.relief[2] = -1;
      g.relief[3] = eye.patch_units_log2 - kTailCellsLog2;
    } else {
      // Both corners in units from the patch's corner.
      const int page_log2 = eye.patch_units_log2 - static_cast<int>(p.relief_page.level), node_log2 = eye.patch_units_log2 - static_cast<int>(p.node.level);
      auto offset = [&](uint32_t node, uint32_t page) { return static_cast<int32_t>((int64_t{node} << node_log2) - (int64_t{page} << page_log2)); };
      if (p.relief_page != last_page) last_page = p.relief_page, last_place = reliefPlace(slot_of(p.relief_page));
      g.relief[0] = offset(p.node.x, p.relief_page.x);
      g.relief[1] = offset(p.node.y, p.relief_page.y);
      g.relief[2] = static_cast<int32_t>(last_place.texel);
      g.relief[3] = page_log2 - 7 + last_place.coarser;
    }
    g.node[0] = static_cast<uint32_t>(i + 1);
    g.node[1] = p.node.level;
    g.node[2] = p.node.patch;
    g.edges = packEdges(p);
    node_texels_[i] = {p.node.patch, p.node.level, p.node.x, p.node.y};
  }
  group_first_[0] = triangles_ = 0;
  for (int n = 0; n <= kMaxGridLevel; ++n) {
    group_first_[n + 1] = group_first_[n] + of_level[static_cast<size_t>(n)];
    triangles_ += of_level[static_cast<size_t>(n)] * (2u << (2 * n));
  }
  instance_count_ = static_cast<uint32_t>(count);
  glBindTexture(GL_TEXTURE_2D, nodes_.id());
  glTexImage2D(GL_TEXTURE_2D, 0, GL_RGBA32UI, kNodesPerRow, static_cast<GLsizei>(rows), 0, GL_RGBA_INTEGER, GL_UNSIGNED_INT, node_texels_.data());
  glBindBuffer(GL_ARRAY_BUFFER, instances_.id());
  glBufferData(GL_ARRAY_BUFFER, static_cast<GLsizeiptr>(count * sizeof(GpuPatchInstance)), packed_.data(), GL_STREAM_DRAW);
  morphs_any_ = in_place != ~uint64_t{0};
  if (morphs_any_) setMorphs(instances);
  setCells(!cells_as_mesh_ || morphs_any_ || of_level[0] < kManyCells ? 0 : of_level[0]);
}

// Of the first `count` instances, which come first in the list.
void PatchPass::setCells(uint32_t count) {
  cell_count_ = count;
  if (count == 0) return;
  if (cell_array_.id() == 0) {
    cell_array_ = gl::VertexArray::create();
    cells_ = gl::Buffer::create();
    cell_grid_ = gl::Buffer::create();
    cell_indices_ = gl::Buffer::create();
  }
  cell_corners_.resize(4 * size_t{count});
  for (size_t i = 0; i < cell_corners_.size(); ++i) cell_corners_[i] = packed_[i / 4];
  glBindVertexArray(cell_array_.id());
  if (count > cell_room_) {
    cell_room_ = std::max(count, 2 * cell_room_);
    std::vector<uint8_t> grid;
    std::vector<uint32_t> indices;
    for (uint32_t i = 0; i < cell_room_; ++i) {
      for (uint8_t byte : {0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 1, 1, 0, 0}) grid.push_back(byte);
      for (uint32_t v : {0, 3, 1, 0, 2, 3}) indices.push_back(4 * i + v);
    }
    glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, cell_indices_.id());
    glBufferData(GL_ELEMENT_ARRAY_BUFFER, static_cast<GLsizeiptr>(indices.size() * 4), indices.data(), GL_STATIC_DRAW);
    glBindBuffer(GL_ARRAY_BUFFER, cell_grid_.id());
    glBufferData(GL_ARRAY_BUFFER, static_cast<GLsizeiptr>(grid.size()), grid.data(), GL_STATIC_DRAW);
    for (GLuint a = 0; a < kAttributes; ++a) glEnableVertexAttribArray(a);
    glVertexAttribIPointer(0, 2, GL_UNSIGNED_BYTE, 4, nullptr);
  }
  glBindBuffer(GL_ARRAY_BUFFER, cells_.id());
  glBufferData(GL_ARRAY_BUFFER, static_cast<GLsizeiptr>(cell_corners_.size() * sizeof(GpuPatchInstance)), cell_corners_.data(), GL_STREAM_DRAW);
  constexpr GLsizei kStride = sizeof(GpuPatchInstance);
  auto at = [](size_t member) { return reinterpret_cast<const void*>(member); };
  glVertexAttribIPointer(1, 4, GL_INT, kStride, at(offsetof(GpuPatchInstance, origin)));
  glVertexAttribIPointer(2, 4, GL_INT, kStride, at(offsetof(GpuPatchInstance, relief)));
  glVertexAttribIPointer(3, 3, GL_UNSIGNED_INT, kStride, at(offsetof(GpuPatchInstance, node)));
  glVertexAttribIPointer(4, 1, GL_UNSIGNED_INT, kStride, at(offsetof(GpuPatchInstance, edges)));
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
  glBufferData(GL_ARRAY_BUFFER, static_cast<GLsizeiptr>(morphs.size() * sizeof(GpuPatchMorph)), morphs.data(), GL_STREAM_DRAW);
}

void PatchPass::bindInstances(size_t first_instance) const {
  size_t base = first_instance * sizeof(GpuPatchInstance);
  auto at = [base](size_t member) { return reinterpret_cast<const void*>(base + member); };
  constexpr GLsizei kStride = sizeof(GpuPatchInstance);
  glBindBuffer(GL_ARRAY_BUFFER, instances_.id());
  glVertexAttribIPointer(1, 4, GL_INT, kStride, at(offsetof(GpuPatchInstance, origin)));
  glVertexAttribIPointer(2, 4, GL_INT, kStride, at(offsetof(GpuPatchInstance, relief)));
  glVertexAttribIPointer(3, 3, GL_UNSIGNED_INT, kStride, at(offsetof(GpuPatchInstance, node)));
  glVertexAttribIPointer(4, 1, GL_UNSIGNED_INT, kStride, at(offsetof(GpuPatchInstance, edges)));
  if (!morphs_any_) {
    glDisableVertexAttribArray(kMorphAttribute);
    glVertexAttribI4ui(kMorphAttribute, ~0u, ~0u, ~0u, ~0u);
    return;
  }
  glEnableVertexAttribArray(kMorphAttribute);
  glBindBuffer(GL_ARRAY_BUFFER, morphs_.id());
  glVertexAttribIPointer(kMorphAttribute, 3, GL_UNSIGNED_INT, sizeof(GpuPatchMorph), reinterpret_cast<const void*>(first_instance * sizeof(GpuPatchMorph)));
}

void PatchPass::bindNodes(const gl::Program& program, int unit) const {
  glActiveTexture(static_cast<GLenum>(GL_TEXTURE0 + unit));
  glBindTexture(GL_TEXTURE_2D, nodes_.id());
  glUniform1i(program.uniform("u_nodes"), unit);
  glActiveTexture(GL_TEXTURE0);
}

void PatchPass::setUniforms(const gl::Program& program, const EyeFrame& eye, float depth_bias) const {
  glUniformMatrix4fv(program.uniform("u_clip_from_eye"), 1, GL_FALSE, eye.clip_from_eye.data());
  glUniform2i(program.uniform("u_limit"), eye.limit_x, eye.limit_y);
  glUniform4f(program.uniform("u_scale"), eye.mm_per_unit, eye.mm_per_height_step, eye.zero_height_mm, eye.depth.nearer(depth_bias));
}

uint32_t PatchPass::draw(const gl::Program& program, const EyeFrame& eye, Mesh mesh, float depth_bias) const {
  setUniforms(program, eye, depth_bias);
  glBindVertexArray(vertex_array_.id());
  if (mesh == Mesh::kFronts) glEnable(GL_CULL_FACE);  // GL's defaults: clockwise ones are culled
  uint32_t calls = 0;
  auto drawGroup = [&](int n, uint32_t first, uint32_t count) {
    if (count == 0) return;
    const Grid& grid = grids_[n];
    glBindBuffer(GL_ARRAY_BUFFER, vertices_.id());
    glVertexAttribIPointer(0, 2, GL_UNSIGNED_BYTE, 4, reinterpret_cast<const void*>(size_t{grid.first_vertex} * 4));
    bindInstances(first);
    bool lines = mesh == Mesh::kLines;
    uint32_t first_index = lines ? grid.first_line : grid.first_index;
    glDrawElementsInstanced(lines ? GL_LINES : GL_TRIANGLES, static_cast<GLsizei>(lines ? grid.line_indices : grid.indices),
                            GL_UNSIGNED_SHORT, reinterpret_cast<const void*>(size_t{first_index} * sizeof(uint16_t)),
                            static_cast<GLsizei>(count));
    ++calls;
  };
  const bool as_cells = cell_count_ > 0 && mesh != Mesh::kLines;
  if (as_cells) calls += drawCells();
  for (int n = as_cells ? 1 : 0; n <= kMaxGridLevel; ++n) drawGroup(n, group_first_[n], group_first_[n + 1] - group_first_[n]);
  glDisable(GL_CULL_FACE);
  glBindVertexArray(0);
  return calls;
}

uint32_t PatchPass::drawOneByOne(const gl::Program& program, const EyeFrame& eye) const {
  glBindVertexArray(vertex_array_.id());
  for (int n = 0; n <= kMaxGridLevel; ++n) {
    const Grid& grid = grids_[n];
    for (uint32_t i = group_first_[n]; i < group_first_[n + 1]; ++i) {
      setUniforms(program, eye, 0);
      glBindBuffer(GL_ARRAY_BUFFER, vertices_.id());
      glVertexAttribIPointer(0, 2, GL_UNSIGNED_BYTE, 4, reinterpret_cast<const void*>(size_t{grid.first_vertex} * 4));
      bindInstances(i);
      glDrawElementsInstanced(GL_TRIANGLES, static_cast<GLsizei>(grid.indices), GL_UNSIGNED_SHORT, reinterpret_cast<const void*>(size_t{grid.first_index} * sizeof(uint16_t)), 1);
    }
  }
  glBindVertexArray(0);
  return instance_count_;
}

std::vector<float> PatchPass::capture(const gl::Program& program, const EyeFrame& eye, uint32_t max_vertices) const {
  setUniforms(program, eye, 0);
  uint64_t total = 0;
  for (int n = 0; n <= kMaxGridLevel; ++n) total += uint64_t{group_first_[n + 1] - group_first_[n]} * grids_[n].vertices;
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
    glBindBuffer(GL_ARRAY_BUFFER, vertices_.id());
    glVertexAttribIPointer(0, 2, GL_UNSIGNED_BYTE, 4, reinterpret_cast<const void*>(size_t{grid.first_vertex} * 4));
    bindInstances(group_first_[n]);
    uint64_t bytes = uint64_t{count} * grid.vertices * 16;
    glBindBufferRange(GL_TRANSFORM_FEEDBACK_BUFFER, 0, buffer.id(), static_cast<GLintptr>(offset), static_cast<GLsizeiptr>(bytes));
    glBeginTransformFeedback(GL_POINTS);
    glDrawArraysInstanced(GL_POINTS, 0, static_cast<GLsizei>(grid.vertices), static_cast<GLsizei>(count));
    glEndTransformFeedback();
    offset += bytes;
  }
  glDisable(GL_RASTERIZER_DISCARD);
  glBindVertexArray(0);
  std::vector<float> out(total * 4);
  glBindBuffer(GL_TRANSFORM_FEEDBACK_BUFFER, buffer.id());
  if (void* mapped = glMapBufferRange(GL_TRANSFORM_FEEDBACK_BUFFER, 0, static_cast<GLsizeiptr>(total * 16), GL_MAP_READ_BIT)) {
    std::copy_n(static_cast<const float*>(mapped), out.size(), out.begin());
    glUnmapBuffer(GL_TRANSFORM_FEEDBACK_BUFFER);
  } else {
    out.clear();
  }
  glBindBuffer(GL_TRANSFORM_FEEDBACK_BUFFER, 0);
  return out;
}

}  // namespace relievo
