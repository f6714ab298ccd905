# relievo_test(...) lines of tests/tools

relievo_test(cli_test LIBS nlohmann_json::nlohmann_json SOURCES tools/cli_test.cpp)
target_compile_definitions(cli_test PRIVATE RELIEVO_PROGRAM="$<TARGET_FILE:relievo>")
add_dependencies(cli_test relievo)
relievo_test(mesh_report_test LIBS relievo_mesh_report SOURCES tools/mesh_report_test.cpp)
relievo_test(mesh_cli_test LIBS nlohmann_json::nlohmann_json SOURCES tools/mesh_cli_test.cpp)
target_compile_definitions(mesh_cli_test PRIVATE RELIEVO_PROGRAM="$<TARGET_FILE:relievo>")
add_dependencies(mesh_cli_test relievo)
relievo_test(sample_test LIBS relievo_sample relievo_image relievo_texturing nlohmann_json::nlohmann_json SOURCES tools/sample_test.cpp)
relievo_test(compare_test LIBS relievo_compare SOURCES tools/compare_test.cpp)
