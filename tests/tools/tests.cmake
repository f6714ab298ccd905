# relievo_test(...) lines of tests/tools
