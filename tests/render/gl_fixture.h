// gl_fixture.h - for tests that need a context: gl_main.cpp makes one for the whole program, current on the main
// thread. RELIEVO_GL=gl|es chooses the API. Without a driver the program ends with code 77 and the reason (ctest:
// skipped), or fails if RELIEVO_REQUIRE_GL=1. A test that leaves a GL error behind fails, unless it says
// expectGlErrors().
#pragma once

#include "src/gl/context.h"

namespace relievo::gltest {

gl::Api api();
gl::HeadlessContext& context();
// GL errors since the test began are wanted: returns their number and forgets them.
int takeGlErrors();

}  // namespace relievo::gltest
