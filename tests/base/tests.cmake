# relievo_test(...) lines of tests/base
relievo_test(base_test MEMORY LIBS relievo_base nlohmann_json::nlohmann_json SOURCES base/base_test.cpp)
relievo_test(channel_test MEMORY THREADS LIBS relievo_base SOURCES base/channel_test.cpp)
relievo_test(hash_index_test MEMORY LIBS relievo_base SOURCES base/hash_index_test.cpp)
relievo_test(output_file_test MEMORY LIBS relievo_base SOURCES base/output_file_test.cpp)
relievo_test(one_writer_test MEMORY LIBS relievo_base SOURCES base/one_writer_test.cpp DEFINES RELIEVO_SOURCES="${CMAKE_SOURCE_DIR}")

# Takes pthread_create's place: linked with a test, or preloaded into the program.
add_library(relievo_thread_limit SHARED base/thread_limit.cpp)
target_link_libraries(relievo_thread_limit PRIVATE Threads::Threads ${CMAKE_DL_LIBS})
relievo_test(worker_threads_test MEMORY THREADS ALONE LIBS relievo_base relievo_thread_limit SOURCES base/worker_threads_test.cpp)
relievo_test(rooms_test LIBS relievo_base SOURCES base/rooms_test.cpp DEFINES RELIEVO_SOURCE_DIR="${CMAKE_SOURCE_DIR}")
if(TARGET relievo_large_blocks)
  relievo_test(large_blocks_test ALONE LIBS relievo_large_blocks SOURCES base/large_blocks_test.cpp)
endif()
