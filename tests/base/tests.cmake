# relievo_test(...) lines of tests/base
relievo_test(base_test LIBS relievo_base SOURCES base/base_test.cpp)
