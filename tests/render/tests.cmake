# relievo_test(...) lines of tests/render
