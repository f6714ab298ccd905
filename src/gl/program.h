// program.h - linked shader programs from the files in shaders/, as one dialect: GL 3.3 core intersected with ES 3.0,
// and under OpenGL also buffer textures, behind the define TEXEL_BUFFERS (shaders/texel_table.glsl). A file has no
// #version; `#include "name"` is resolved among the embedded files, each once; `#include NAMES` includes
// the files whose quoted names are the value of the define NAMES, if there is one. Defines choose the variant;
// RELIEVO_VERTEX or RELIEVO_FRAGMENT is defined as well. `#include <...>` lines are for C++ and are left out.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include <epoxy/gl.h>

#include "src/base/result.h"
#include "src/gl/context.h"

namespace relievo::gl {

using Defines = std::vector<std::pair<std::string, std::string>>;

struct ShaderText {
  std::string name, text;  // the name stands for the file in error messages
};

class Program {
 public:
  Program() = default;
  Program(Program&& other) noexcept;
  Program& operator=(Program&& other) noexcept;
  ~Program();
  // feedback_varyings: for transform feedback (interleaved). attributes: name -> location is fixed by order.
  struct Source {
    std::string vertex, fragment;  // file names in shaders/; fragment may be empty: draws nothing
    Defines defines;
    std::vector<std::string> attributes;  // attribute i gets location i
    std::vector<const char*> feedback_varyings;
  };
  // Errors (kRuntime): the file, the driver's log with file names and line numbers, and the lines that it speaks of.
  static Result<Program> link(Api api, const Source& source);
  // The same from texts that are not in shaders/, such as those of tests; source.vertex and .fragment are not looked
  // at.
  static Result<Program> linkTexts(Api api, const ShaderText& vertex, const ShaderText& fragment, const Source& source);
  GLuint id() const { return id_; }
  void use() const { glUseProgram(id_); }
  GLint uniform(const char* name) const;  // -1 when absent or optimised away

 private:
  GLuint id_ = 0;
};

// The text that is handed to the driver; for tests and error messages. Errors name the file of a failed include.
Result<std::string> assembleShader(Api api, const std::string& file, const Defines& defines, bool fragment);

}  // namespace relievo::gl
