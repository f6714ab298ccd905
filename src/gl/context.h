// context.h - a current GL context without a window: EGL surfaceless. One path: GL 3.3 core, or ES 3.0, chosen at run time.
#pragma once

#include <memory>
#include <string>

#include "src/base/result.h"

namespace relievo::gl {

enum class Api { kGl33, kEs30 };

struct ContextInfo {
  Api api = Api::kGl33;
  std::string renderer, version;
  bool software = false;  // llvmpipe, softpipe, swiftshader
};

class HeadlessContext {
 public:
  // RELIEVO_GL=gl|es in the environment overrides the choice. Errors are of kind kRuntime and name what is missing.
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
// With KHR_debug: GL errors are counted (and printed once each). 0 when nothing went wrong.
int debugErrorCount();

}  // namespace relievo::gl
