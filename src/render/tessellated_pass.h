// tessellated_pass.h - patches cut by the hardware tessellator (GL 4), for comparison with grids. See
// geometry/strategies/strategy_tessellation.cpp.
#pragma once

#include <cstdint>
#include <functional>
#include <span>

#include "src/base/result.h"
#include "src/gl/objects.h"
#include "src/gl/program.h"
#include "src/render/patch_pass.h"

namespace relievo {

class TessellatedPass {
 public:
  TessellatedPass();
  ~TessellatedPass();
  // The GL version of a program with tessellation stages. Errors: kRuntime, with the driver's log.
  Result<void> link(gl::Api api, const gl::Defines& defines);
  bool linked() const { return program_ != 0; }
  GLint uniform(const char* name) const { return glGetUniformLocation(program_, name); }
  void use() const { glUseProgram(program_); }
  // With the program in use and the pages bound. Returns the triangles that the tessellator made (waits for them).
  uint64_t draw(std::span<const PatchInstance> instances, const EyeFrame& eye,
                const std::function<SlotIndex(const NodeId&)>& slot_of);
  uint32_t drawCalls() const { return draw_calls_; }  // of the last draw

 private:
  uint32_t draw_calls_ = 0;
  GLuint program_ = 0;
  gl::VertexArray vertex_array_;
  gl::Buffer instances_;
  gl::Query made_;
};

}  // namespace relievo
