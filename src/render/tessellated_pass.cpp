#include "src/render/tessellated_pass.h"

#include <cstddef>
#include <string>
#include <vector>

#include "src/gl/program.h"
#include "src/render/page_pool.h"

namespace relievo {
namespace {

// Mesa 22.3 (llvmpipe) mixes up the vertices of a draw whose tessellator makes many: at 64 x 64 cells a patch places
// were hundreds of pixels off, and a draw took a hundred times as long. It has 16-bit indices there.
constexpr size_t kMaxVerticesADraw = 16384;

struct GpuPatch {
  int32_t origin[4], relief[4];
  uint32_t instance, edges, patch;
};

std::string logOf(GLuint id, bool program) {
  char text[4096] = "";
  if (program) glGetProgramInfoLog(id, sizeof text, nullptr, text);
  else glGetShaderInfoLog(id, sizeof text, nullptr, text);
  return text;
}

}  // namespace

TessellatedPass::TessellatedPass()
    : vertex_array_(gl::VertexArray::create()), instances_(gl::Buffer::create()), made_(gl::Query::create()) {}
TessellatedPass::~TessellatedPass() {
  if (program_) glDeleteProgram(program_);
}

Result<void> TessellatedPass::link(gl::Api api, const gl::Defines& defines) {
  struct Stage {
    GLenum kind;
    const char* file;
    bool fragment;
  };
  GLuint program = glCreateProgram();
  Error error{ErrorKind::kRuntime, "", "", "", {}};
  for (const Stage& stage : {Stage{GL_VERTEX_SHADER, "compare_tessellated.vert", false},
                             Stage{GL_TESS_CONTROL_SHADER, "compare_tessellated.tesc", false},
                             Stage{GL_TESS_EVALUATION_SHADER, "compare_tessellated.tese", false},
                             Stage{GL_FRAGMENT_SHADER, "compare_place.frag", true}}) {
    auto text = gl::assembleShader(api, stage.file, defines, stage.fragment);
    if (!text) {
      glDeleteProgram(program);
      return text.error();
    }
    // The only stages that need more than the common dialect.
    std::string source = "#version 400 core\n" + text->substr(text->find('\n') + 1);
    GLuint shader = glCreateShader(stage.kind);
    const char* chars = source.c_str();
    glShaderSource(shader, 1, &chars, nullptr);
    glCompileShader(shader);
    GLint compiled = 0;
    glGetShaderiv(shader, GL_COMPILE_STATUS, &compiled);
    if (!compiled && error.message.empty()) {
      error.file = stage.file;
      error.message = "the shader does not compile: " + logOf(shader, false);
    }
    glAttachShader(program, shader);
    glDeleteShader(shader);
  }
  GLuint location = 0;
  for (const char* name : {"a_origin", "a_relief", "a_instance", "a_edges", "a_patch"})
    glBindAttribLocation(program, location++, name);
  glLinkProgram(program);
  GLint linked = 0;
  glGetProgramiv(program, GL_LINK_STATUS, &linked);
  if (!linked && error.message.empty())
    error.message = "the tessellation program does not link: " + logOf(program, true);
  if (!error.message.empty()) {
    glDeleteProgram(program);
    return error;
  }
  program_ = program;
  return {};
}

uint64_t TessellatedPass::draw(std::span<const PatchInstance> instances, const EyeFrame& eye,
                               const std::function<SlotIndex(const NodeId&)>& slot_of) {
  draw_calls_ = 0;
  std::vector<GpuPatch> gpu;
  gpu.reserve(instances.size());
  for (const PatchInstance& p : instances) {
    int page_log2 = eye.patch_units_log2 - static_cast<int>(p.relief_page.level),
        node_log2 = eye.patch_units_log2 - static_cast<int>(p.node.level);
    auto offset = [&](uint32_t node, uint32_t page) {
      return static_cast<int32_t>((int64_t{node} << node_log2) - (int64_t{page} << page_log2));
    };
    const ReliefPlace place = reliefPlace(slot_of(p.relief_page));
    GpuPatch g{
        {static_cast<int32_t>(p.x0 - eye.unit_x), static_cast<int32_t>(p.y0 - eye.unit_y), p.step_log2, p.grid_level},
        {offset(p.node.x, p.relief_page.x), offset(p.node.y, p.relief_page.y), static_cast<int32_t>(place.texel),
         page_log2 - 7 + place.coarser},
        static_cast<uint32_t>(gpu.size() + 1),
        0,
        p.node.patch};
    for (int side = 0; side < 4; ++side)
      g.edges |= static_cast<uint32_t>(p.edges[static_cast<size_t>(side)][0]) << (8 * side);
    gpu.push_back(g);
  }
  glUniformMatrix4fv(uniform("u_clip_from_eye"), 1, GL_FALSE, eye.clip_from_eye.data());
  glUniform2i(uniform("u_limit"), eye.limit_x, eye.limit_y);
  glUniform4f(uniform("u_scale"), eye.mm_per_unit, eye.mm_per_height_step, eye.zero_height_mm, 0);
  glBindVertexArray(vertex_array_.id());
  glBindBuffer(GL_ARRAY_BUFFER, instances_.id());
  glBufferData(GL_ARRAY_BUFFER, static_cast<GLsizeiptr>(gpu.size() * sizeof(GpuPatch)), gpu.data(), GL_STREAM_DRAW);
  auto at = [](size_t member) { return reinterpret_cast<const void*>(member); };
  for (GLuint a = 0; a < 5; ++a) glEnableVertexAttribArray(a);
  glVertexAttribIPointer(0, 4, GL_INT, sizeof(GpuPatch), at(offsetof(GpuPatch, origin)));
  glVertexAttribIPointer(1, 4, GL_INT, sizeof(GpuPatch), at(offsetof(GpuPatch, relief)));
  glVertexAttribIPointer(2, 1, GL_UNSIGNED_INT, sizeof(GpuPatch), at(offsetof(GpuPatch, instance)));
  glVertexAttribIPointer(3, 1, GL_UNSIGNED_INT, sizeof(GpuPatch), at(offsetof(GpuPatch, edges)));
  glVertexAttribIPointer(4, 1, GL_UNSIGNED_INT, sizeof(GpuPatch), at(offsetof(GpuPatch, patch)));
  glPatchParameteri(GL_PATCH_VERTICES, 1);
  glBeginQuery(GL_PRIMITIVES_GENERATED, made_.id());
  for (size_t first = 0; first < gpu.size();) {
    size_t end = first, vertices = 0;
    while (end < gpu.size()) {
      size_t side = (size_t{1} << gpu[end].origin[3]) + 1;
      if (end > first && vertices + side * side > kMaxVerticesADraw) break;
      vertices += side * side;
      ++end;
    }
    glDrawArrays(GL_PATCHES, static_cast<GLint>(first), static_cast<GLsizei>(end - first));
    ++draw_calls_;
    first = end;
  }
  glEndQuery(GL_PRIMITIVES_GENERATED);
  glBindVertexArray(0);
  GLuint made = 0;
  glGetQueryObjectuiv(made_.id(), GL_QUERY_RESULT, &made);
  return made;
}

}  // namespace relievo
