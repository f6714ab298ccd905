# relievo_test(...) lines of tests/texturing
relievo_test(package_builder_test LIBS relievo_texturing SOURCES texturing/package_builder_test.cpp)
relievo_test(page_cache_test LIBS relievo_texturing SOURCES texturing/page_cache_test.cpp)
relievo_test(page_table_test LIBS relievo_texturing SOURCES texturing/page_table_test.cpp)
relievo_test(feedback_test LIBS relievo_texturing SOURCES texturing/feedback_test.cpp)
relievo_test(page_streamer_test LIBS relievo_texturing SOURCES texturing/page_streamer_test.cpp)
relievo_test(ptm_test LIBS relievo_texturing relievo_image SOURCES texturing/ptm_test.cpp)
relievo_test(image_io_test LIBS relievo_image PkgConfig::oiio SOURCES texturing/image_io_test.cpp)
relievo_test(resolve_test LIBS relievo_texturing SOURCES texturing/resolve_test.cpp)
