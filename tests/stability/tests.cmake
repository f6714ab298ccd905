# relievo_test(...) lines of tests/stability

relievo_test(stability_test MEMORY OPTIMISED LIBS relievo_stability SOURCES stability/stability_test.cpp)
