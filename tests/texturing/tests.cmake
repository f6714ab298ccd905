# relievo_test(...) lines of tests/texturing
relievo_test(package_builder_test LIBS relievo_texturing SOURCES texturing/package_builder_test.cpp)
relievo_test(page_cache_test LIBS relievo_texturing SOURCES texturing/page_cache_test.cpp)
relievo_test(page_table_test LIBS relievo_texturing SOURCES texturing/page_table_test.cpp)
relievo_test(feedback_test LIBS relievo_texturing SOURCES texturing/feedback_test.cpp)
relievo_test(page_streamer_test LIBS relievo_texturing SOURCES texturing/page_streamer_test.cpp)
