# relievo_test(...) lines of tests/base
