# relievo_test(...) lines of tests/geometry
