// gl_fixture.h - for tests that need a context: gl_main.cpp makes one for the whole program, current on the main thread.
// RELIEVO_GL=gl|es chooses the API. Without a driver the program ends with code 77 and the reason (ctest: skipped), or
// fails if RELIEVO_REQUIRE_GL=1. A test that leaves a GL error behind fails, unless it says expectGlErrors().
#pragma once

#include <cstdint>

#include "src/gl/context.h"

namespace relievo::gltest {

gl::Api api();
gl::HeadlessContext& context();
// Of n random views or comparisons, those of this run: all under OpenGL; under OpenGL ES, which the same driver draws with the same shaders, a
// quarter, and all with RELIEVO_LONG_TESTS=1 (tests/view_share.h).
uint64_t viewsHere(uint64_t n);
// GL errors since the test began are wanted: returns their number and forgets them.
int takeGlErrors();

}  // namespace relievo::gltest
