# relievo_test(...) lines of tests/texturing
