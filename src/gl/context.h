// context.h - a current GL context without a window: EGL surfaceless. One path: GL 3.3 core, or ES 3.0, chosen at run
// time. A context is current on the thread that created it. There is no default framebuffer: bind your own before any
// draw, also one that only feeds a transform feedback. Environment: RELIEVO_GL=gl|es forces the API (then there is no
// falling back to the other one); RELIEVO_GL_DEBUG=1 asks for a debug context, for drivers that report errors through
// KHR_debug only there.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "src/base/result.h"

namespace relievo::gl {

enum class Api { kGl33, kEs30 };
const char* apiName(Api api);  // "OpenGL 3.3 core", "OpenGL ES 3.0"

struct ContextInfo {
  Api api = Api::kGl33;
  std::string renderer, version;
  bool software = false;  // llvmpipe, softpipe, swiftshader
};

class HeadlessContext {
 public:
  // Falls back to the other API when the wanted one is not to be had: ask info().api. Hardware is preferred to
  // software. RELIEVO_GL=gl|es in the environment overrides the choice. Errors are of kind kRuntime and name what is
  // missing.
  static Result<std::unique_ptr<HeadlessContext>> create(Api api = Api::kGl33);
  ~HeadlessContext();
  const ContextInfo& info() const;
  Result<void> makeCurrent();

 private:
  HeadlessContext();
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// Of the context that is current on this thread.
ContextInfo currentContextInfo();
// Errors of the GL so far, in every context of this process: counted through KHR_debug (and printed, each message
// once), and through glGetError of the current context where there is no KHR_debug. 0 when nothing went wrong.
int debugErrorCount();

// For the creators of contexts (here and window.cpp).
bool debugContextWanted();
void installDebugCallback();                  // on the current context; does nothing without KHR_debug
Result<std::vector<Api>> apisToTry(Api api);  // in order; honours RELIEVO_GL

}  // namespace relievo::gl
