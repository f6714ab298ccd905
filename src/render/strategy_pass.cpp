#include "src/render/strategy_pass.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstddef>

#include "texturing/stream/relief_subslots.h"

namespace relievo {
namespace {

struct GpuTriangleVertex {
  int32_t place[2];
  float height, uv[2];
  uint32_t instance, patch;
};

static_assert(sizeof(GpuTriangleVertex) == StrategyMesh::kGpuVertexBytes);

constexpr int kCornersUnit = 6;  // and two more: behind the pool's

// Clamped to the artwork's border.
std::vector<GpuTriangleVertex> gpuVertices(const std::vector<StrategyVertex>& vertices,
                                           const std::vector<PatchInstance>& instances, const EyeFrame& eye) {
  const int64_t limit_x = eye.unit_x + eye.limit_x, limit_y = eye.unit_y + eye.limit_y;
  std::vector<GpuTriangleVertex> gpu;
  gpu.reserve(vertices.size());
  for (const StrategyVertex& v : vertices) {
    const PatchInstance& p = instances[v.instance];
    const int64_t x = std::min<int64_t>(v.x, limit_x), y = std::min<int64_t>(v.y, limit_y);
    const float size = std::ldexp(1.0f, p.step_log2 + p.grid_level);
    gpu.push_back({{static_cast<int32_t>(x), static_cast<int32_t>(y)},
                   v.height_steps,
                   {static_cast<float>(x - p.x0) / size, static_cast<float>(y - p.y0) / size},
                   v.instance + 1,
                   p.node.patch});
  }
  return gpu;
}

}  // namespace

StrategyPass::StrategyPass(gl::Api api, const PatchDomain& domain, std::shared_ptr<const BaseMesh> base,
                           uint32_t relief_pages)
    : api_(api),
      domain_(domain),
      corners_(base ? std::make_unique<BaseCorners>(std::move(base)) : nullptr),
      pool_((relief_pages + 1) / 2),
      table_(1, 1),
      vertex_array_(gl::VertexArray::create()),
      vertices_(gl::Buffer::create()),
      drawn_indices_(gl::Buffer::create()) {
  pool_.uploadTable(table_);
}

EyeFrame StrategyPass::eyeFrameOf(const ViewTransform& view, double exaggerate) {
  if (corners_) corners_->setEye(view.eye_mm);
  return eyeFrame(view, domain_, exaggerate, true, target_.depthMode());
}

gl::Defines StrategyPass::defines() const {
  gl::Defines defines = {{"RELIEF", "1"}};
  if (corners_) defines.emplace_back("MESH", "1");
  return defines;
}

void StrategyPass::bindAll(const gl::Program& program) {
  program.use();
  pool_.bind(program, table_);
  if (corners_) corners_->bind(program, kCornersUnit);
}

void StrategyPass::upload(const NodeId& relief_page, const uint8_t* texels) {
  const uint32_t half = uploaded_++;
  const SlotIndex slot = slotIndexOf({half / 2, kReliefPartLevel, half % 2});
  slots_[relief_page] = slot;
  const PageUpload upload{slot, PageId(Plane::kRelief, relief_page), texels};
  pool_.upload({&upload, 1});
}

Result<const gl::Program*> StrategyPass::program(GridRule rule, bool capture) {
  gl::Program& p = programs_[static_cast<size_t>(rule) * 2 + (capture ? 1 : 0)];
  if (p.id() != 0) return &p;
  gl::Defines variant = defines();
  if (rule == GridRule::kUnsnapped) variant.emplace_back("NO_SNAPPING", "1");
  if (rule == GridRule::kGeomorph) variant.emplace_back("MORPH", "1");
  if (capture) variant.emplace_back("CAPTURE", "1");
  std::vector<const char*> varyings;
  if (capture) varyings.push_back("v_clip");
  auto linked =
      gl::Program::link(api_, {rule == GridRule::kMorphed ? "compare_morph.vert" : "patch.vert",
                               capture ? "lines.frag" : "compare_place.frag", variant, patchAttributes(), varyings});
  if (!linked) return linked.error();
  p = std::move(*linked);
  return &p;
}

SlotIndex StrategyPass::slotOf(const NodeId& page) const {
  auto found = slots_.find(page);
  assert(found != slots_.end());
  return found->second;
}

Result<const gl::Program*> StrategyPass::prepare(const StrategyResult& chosen, const ViewTransform& view,
                                                 const EyeFrame& eye, bool capture) {
  auto in_use = program(chosen.rule, capture);
  if (!in_use) return in_use;
  const gl::Program& p = **in_use;
  bindAll(p);
  if (chosen.rule == GridRule::kMorphed && corners_) {
    glm::vec3 eye_mm(chosen.morph_eye_mm - view.eye_mm);
    glUniform3f(p.uniform("u_morph_eye"), eye_mm.x, eye_mm.y, eye_mm.z);
    glUniform2fv(p.uniform("u_morph"), kMorphLevels, &chosen.morph[0].start_mm);
  } else if (chosen.rule == GridRule::kMorphed) {
    // Vertices count from the eye's unit, which is not quite the eye.
    const FlatDomain d = domain_.flat();
    double mm_per_unit = d.mm_per_px / (1 << kUnitsPerTexelLog2);
    double half_w = 0.5 * static_cast<double>(d.width_px) * d.mm_per_px,
           half_h = 0.5 * static_cast<double>(d.height_px) * d.mm_per_px;
    glm::vec3 eye_mm(chosen.morph_eye_mm - glm::dvec3(static_cast<double>(eye.unit_x) * mm_per_unit - half_w,
                                                      half_h - static_cast<double>(eye.unit_y) * mm_per_unit,
                                                      view.eye_mm.z));
    glUniform3f(p.uniform("u_morph_eye"), eye_mm.x, eye_mm.y, eye_mm.z);
    glUniform2fv(p.uniform("u_morph"), kMorphLevels, &chosen.morph[0].start_mm);
  }
  patches_.setInstances(chosen.instances, eye, true, [this](const NodeId& page) { return slotOf(page); });
  return in_use;
}

Result<StrategyDraw> StrategyPass::drawTessellated(const StrategyResult& chosen, const EyeFrame& eye) {
  if (!hasTessellation(api_))
    return Error{ErrorKind::kUnsupported, "", "this context has no tessellation: it needs OpenGL 4", "", {}};
  if (!tessellated_.linked())
    if (auto done = tessellated_.link(api_, defines()); !done) return done.error();
  // The pool stays bound to texture unit 0, which is what a sampler's uniform says that nobody set.
  auto grids = program(GridRule::kSnapped, false);
  if (!grids) return grids.error();
  bindAll(**grids);
  tessellated_.use();
  if (corners_) {
    int unit = kCornersUnit;
    for (const char* name : {"u_corners", "u_normals", "u_base"}) glUniform1i(tessellated_.uniform(name), unit++);
  }
  uint64_t triangles = tessellated_.draw(chosen.instances, eye, [this](const NodeId& page) { return slotOf(page); });
  return StrategyDraw{triangles, tessellated_.drawCalls()};
}

Result<StrategyDraw> StrategyPass::draw(const StrategyResult& chosen, const ViewTransform& view, double exaggerate) {
  EyeFrame eye = eyeFrameOf(view, exaggerate);
  target_.beginCleared();
  StrategyDraw drawn;
  if (chosen.rule == GridRule::kTessellated) {
    auto done = drawTessellated(chosen, eye);
    if (!done) return done.error();
    drawn = *done;
  } else if (chosen.rule != GridRule::kTrianglesOnly) {
    auto in_use = prepare(chosen, view, eye, false);
    if (!in_use) return in_use.error();
    drawn.draw_calls = patches_.draw(**in_use, eye, PatchPass::Mesh::kFull);
    drawn.triangles = patches_.triangles();
  }
  if (chosen.triangleCount() == 0) return drawn;
  if (triangle_program_.id() == 0) {
    auto linked = gl::Program::link(api_, {"compare_triangles.vert",
                                           "compare_place.frag",
                                           defines(),
                                           {"a_place", "a_height", "a_uv", "a_instance", "a_patch"},
                                           {}});
    if (!linked) return linked.error();
    triangle_program_ = std::move(*linked);
  }
  bindAll(triangle_program_);
  glUniform2i(triangle_program_.uniform("u_limit"), eye.limit_x, eye.limit_y);
  glUniform2i(triangle_program_.uniform("u_eye_unit"), static_cast<int>(eye.unit_x), static_cast<int>(eye.unit_y));
  glUniformMatrix4fv(triangle_program_.uniform("u_clip_from_eye"), 1, GL_FALSE, eye.clip_from_eye.data());
  glUniform4f(triangle_program_.uniform("u_scale"), eye.mm_per_unit, eye.mm_per_height_step, eye.zero_height_mm, 0);
  if (!chosen.triangles.empty()) drawTriangles(chosen, eye), ++drawn.draw_calls;
  if (!chosen.ranges.empty()) drawKept(chosen, eye), ++drawn.draw_calls;
  drawn.triangles += chosen.triangleCount();
  return drawn;
}

void StrategyPass::pointAtVertices(GLuint buffer) {
  glBindBuffer(GL_ARRAY_BUFFER, buffer);
  constexpr GLsizei kStride = sizeof(GpuTriangleVertex);
  auto at = [](size_t member) { return reinterpret_cast<const void*>(member); };
  for (GLuint a = 0; a < 5; ++a) glEnableVertexAttribArray(a);
  glVertexAttribIPointer(0, 2, GL_INT, kStride, at(offsetof(GpuTriangleVertex, place)));
  glVertexAttribPointer(1, 1, GL_FLOAT, GL_FALSE, kStride, at(offsetof(GpuTriangleVertex, height)));
  glVertexAttribPointer(2, 2, GL_FLOAT, GL_FALSE, kStride, at(offsetof(GpuTriangleVertex, uv)));
  glVertexAttribIPointer(3, 1, GL_UNSIGNED_INT, kStride, at(offsetof(GpuTriangleVertex, instance)));
  glVertexAttribIPointer(4, 1, GL_UNSIGNED_INT, kStride, at(offsetof(GpuTriangleVertex, patch)));
}

// What was uploaded for meshes that nobody has any more goes.
StrategyPass::KeptMesh& StrategyPass::kept(const std::shared_ptr<const StrategyMesh>& mesh, const EyeFrame& eye) {
  std::erase_if(kept_, [](const auto& entry) { return entry.second.owner.expired(); });
  KeptMesh& k = kept_[mesh.get()];
  if (k.vertices.id() != 0) return k;
  k = {mesh, gl::Buffer::create(), gl::Buffer::create()};
  const auto gpu = gpuVertices(mesh->vertices, mesh->instances, eye);
  glBindVertexArray(vertex_array_.id());  // which the buffer of indices is part of
  glBindBuffer(GL_ARRAY_BUFFER, k.vertices.id());
  glBufferData(GL_ARRAY_BUFFER, static_cast<GLsizeiptr>(gpu.size() * sizeof(GpuTriangleVertex)), gpu.data(),
               GL_STATIC_DRAW);
  glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, k.indices.id());
  glBufferData(GL_ELEMENT_ARRAY_BUFFER, static_cast<GLsizeiptr>(mesh->indices.size() * sizeof(uint32_t)),
               mesh->indices.data(), GL_STATIC_DRAW);
  return k;
}

// One call: of a single range from the mesh's own indices, of several from a copy of theirs.
void StrategyPass::drawKept(const StrategyResult& chosen, const EyeFrame& eye) {
  KeptMesh& mesh = kept(chosen.mesh, eye);
  glBindVertexArray(vertex_array_.id());
  pointAtVertices(mesh.vertices.id());
  if (chosen.ranges.size() == 1) {
    glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, mesh.indices.id());
    glDrawElements(GL_TRIANGLES, static_cast<GLsizei>(chosen.ranges[0].count), GL_UNSIGNED_INT,
                   reinterpret_cast<const void*>(size_t{chosen.ranges[0].first} * sizeof(uint32_t)));
  } else {
    std::vector<uint32_t> indices;
    indices.reserve(3 * chosen.triangleCount());
    for (const IndexRange& r : chosen.ranges)
      indices.insert(indices.end(), chosen.mesh->indices.begin() + r.first,
                     chosen.mesh->indices.begin() + r.first + r.count);
    glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, drawn_indices_.id());
    glBufferData(GL_ELEMENT_ARRAY_BUFFER, static_cast<GLsizeiptr>(indices.size() * sizeof(uint32_t)), indices.data(),
                 GL_STREAM_DRAW);
    glDrawElements(GL_TRIANGLES, static_cast<GLsizei>(indices.size()), GL_UNSIGNED_INT, nullptr);
  }
  glBindVertexArray(0);
}

void StrategyPass::drawTriangles(const StrategyResult& chosen, const EyeFrame& eye) {
  const auto gpu = gpuVertices(chosen.triangles, chosen.instances, eye);
  glBindVertexArray(vertex_array_.id());
  glBindBuffer(GL_ARRAY_BUFFER, vertices_.id());
  glBufferData(GL_ARRAY_BUFFER, static_cast<GLsizeiptr>(gpu.size() * sizeof(GpuTriangleVertex)), gpu.data(),
               GL_STREAM_DRAW);
  pointAtVertices(vertices_.id());
  glDrawArrays(GL_TRIANGLES, 0, static_cast<GLsizei>(gpu.size()));
  glBindVertexArray(0);
}

Result<std::vector<float>> StrategyPass::capture(const StrategyResult& chosen, const ViewTransform& view,
                                                 double exaggerate, uint32_t max_vertices) {
  if (chosen.rule == GridRule::kTessellated || chosen.rule == GridRule::kTrianglesOnly) return std::vector<float>();
  EyeFrame eye = eyeFrameOf(view, exaggerate);
  target_.begin();  // transform feedback answers zeros without a framebuffer
  auto in_use = prepare(chosen, view, eye, true);
  if (!in_use) return in_use.error();
  return patches_.capture(**in_use, eye, max_vertices);
}

void StrategyPass::finish() { glFinish(); }

bool StrategyPass::hasTessellation(gl::Api api) { return api == gl::Api::kGl33 && epoxy_gl_version() >= 40; }

}  // namespace relievo
