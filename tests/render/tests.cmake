# relievo_test(...) lines of tests/render

# relievo_add_gltest(NAME TEST FILTER [VARIABLE=VALUE...]): runs the test as NAME_gl under OpenGL 3.3 core and, unless
# apis says "gl" alone, as NAME_es under OpenGL ES 3.0, with these in its environment. FILTER: GoogleTest's, or empty for
# all of the test. Mesa promotes every request to the newest version it has, so its overrides keep it to what was asked for.
# Memory that Mesa's software frees stays in the program: giving it back at every frame takes up to half of a test's time.
function(relievo_add_gltest name test filter)
  get_property(program GLOBAL PROPERTY RELIEVO_PROGRAM_OF_${test})
  if(NOT filter)
    relievo_filter_of(filter ${test})
  endif()
  set(keep_memory MALLOC_MMAP_THRESHOLD_=4000000000 MALLOC_TRIM_THRESHOLD_=8000000000 MALLOC_TOP_PAD_=67108864)
  set(overrides_gl MESA_GL_VERSION_OVERRIDE=3.3 MESA_GLSL_VERSION_OVERRIDE=330)
  set(overrides_es MESA_GLES_VERSION_OVERRIDE=3.0)
  if(NOT apis)
    set(apis gl es)
  endif()
  foreach(api ${apis})
    add_test(NAME ${name}_${api} COMMAND ${program} ${filter})
    set_tests_properties(${name}_${api} PROPERTIES LABELS gl TIMEOUT 900 COST 100 SKIP_RETURN_CODE 77  # COST: the longest start first
      ENVIRONMENT "RELIEVO_GL=${api};${overrides_${api}};${keep_memory};${ARGN}")
  endforeach()
endfunction()

# relievo_gltest(NAME [GL_ONLY] LIBS lib... SOURCES file...): a GoogleTest program that needs a GL context (tests/render/gl_fixture.h).
# It runs as a whole, since making a context takes time. GL_ONLY: what it tests lies outside the shaders, or others test these shaders with OpenGL ES.
function(relievo_gltest name)
  if(NOT RELIEVO_GL_TESTS)
    return()
  endif()
  set(main ${CMAKE_SOURCE_DIR}/tests/render/gl_main.cpp)
  cmake_parse_arguments(T "GL_ONLY;RUNS" "" "LIBS;SOURCES;DEFINES" ${ARGN})
  relievo_test_program(program ${name} render_gltests 1 ${ARGN})
  get_target_property(sources ${program} SOURCES)
  if(NOT main IN_LIST sources)
    target_sources(${program} PRIVATE ${main})
  endif()
  target_link_libraries(${program} PRIVATE relievo_gl)
  if(T_GL_ONLY)
    set(apis gl)
  endif()
  relievo_add_gltest(${name} ${name} "")
endfunction()

relievo_gltest(gl_gltest LIBS relievo_gl relievo_shaders SOURCES render/gl_gltest.cpp DEFINES RELIEVO_SHADER_DIR="${CMAKE_SOURCE_DIR}/shaders")
# The oracle of "virtual equals dense": links nothing of the engine but plain types.
add_library(relievo_dense_reference STATIC render/dense_reference.cpp)
target_link_libraries(relievo_dense_reference PUBLIC relievo_artwork glm::glm)
relievo_test(dense_reference_test LIBS relievo_dense_reference SOURCES render/dense_reference_test.cpp)

relievo_gltest(bc_blocks_gltest LIBS relievo_gl relievo_stream relievo_import SOURCES render/bc_blocks_gltest.cpp)
relievo_gltest(watertight_gltest LIBS relievo_engine SOURCES render/watertight_gltest.cpp)
relievo_gltest(prefetch_gltest GL_ONLY LIBS relievo_flights SOURCES render/prefetch_gltest.cpp)
add_library(relievo_dense_pages STATIC render/dense_pages.cpp)
target_link_libraries(relievo_dense_pages PUBLIC relievo_dense_reference relievo_stream relievo_import)
relievo_test(dense_agrees_test LIBS relievo_dense_pages SOURCES render/dense_agrees_test.cpp)
relievo_test(package_agrees_test LIBS relievo_dense_pages SOURCES render/package_agrees_test.cpp)
relievo_gltest(virtual_equals_dense_gltest LIBS relievo_engine relievo_dense_pages
  SOURCES render/virtual_equals_dense_gltest.cpp)
relievo_gltest(other_bases_gltest LIBS relievo_engine relievo_dense_pages SOURCES render/other_bases_gltest.cpp)
relievo_gltest(filters_equal_dense_gltest LIBS relievo_engine relievo_dense_pages
  SOURCES render/filters_equal_dense_gltest.cpp)
relievo_gltest(multisampling_gltest LIBS relievo_engine relievo_dense_pages SOURCES render/multisampling_gltest.cpp)
relievo_gltest(effects_gltest LIBS relievo_engine relievo_dense_pages SOURCES render/effects_gltest.cpp)
relievo_gltest(lights_gltest LIBS relievo_engine relievo_dense_pages relievo_lod SOURCES render/lights_gltest.cpp)
relievo_gltest(pose_gltest LIBS relievo_engine relievo_dense_pages relievo_lod SOURCES render/pose_gltest.cpp)
relievo_test(pose_test LIBS relievo_engine relievo_scan SOURCES render/pose_test.cpp)
relievo_gltest(relief_shading_gltest LIBS relievo_engine relievo_dense_pages relievo_lod SOURCES render/relief_shading_gltest.cpp)
relievo_gltest(fixed_light_gltest LIBS relievo_engine relievo_dense_pages relievo_lod SOURCES render/fixed_light_gltest.cpp)
relievo_gltest(lit_relief_gltest RUNS GL_ONLY LIBS relievo_viewer relievo_engine relievo_dense_pages SOURCES render/lit_relief_gltest.cpp)
relievo_gltest(page_fade_gltest LIBS relievo_engine relievo_dense_pages SOURCES render/page_fade_gltest.cpp)
relievo_gltest(sample_equals_dense_gltest GL_ONLY LIBS relievo_engine relievo_dense_pages relievo_sample
  SOURCES render/sample_equals_dense_gltest.cpp)
relievo_test(view_control_test LIBS relievo_viewer SOURCES render/view_control_test.cpp)
relievo_test(scene_animation_test LIBS relievo_engine SOURCES render/scene_animation_test.cpp)
relievo_test(frame_time_control_test LIBS relievo_viewer SOURCES render/frame_time_control_test.cpp)
relievo_gltest(eye_outside_gltest GL_ONLY LIBS relievo_viewer relievo_lod SOURCES render/eye_outside_gltest.cpp)
relievo_gltest(hud_gltest LIBS relievo_viewer SOURCES render/hud_gltest.cpp)

# The viewer in a window, under a virtual display.
foreach(api gl es)
  add_test(NAME view_window_test_${api}
    COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/render/view_window_test.sh $<TARGET_FILE:relievo> ${api})
  set_tests_properties(view_window_test_${api} PROPERTIES LABELS gl TIMEOUT 300 COST 100 SKIP_RETURN_CODE 77)
endforeach()
relievo_test(camera_test LIBS relievo_engine SOURCES render/camera_test.cpp)
relievo_gltest(engine_faults_gltest GL_ONLY LIBS relievo_engine SOURCES render/engine_faults_gltest.cpp)
relievo_gltest(feedback_gltest LIBS relievo_engine SOURCES render/feedback_gltest.cpp)
relievo_gltest(mesh_watertight_gltest LIBS relievo_engine SOURCES render/mesh_watertight_gltest.cpp)
relievo_gltest(compare_gltest GL_ONLY LIBS relievo_compare nlohmann_json::nlohmann_json SOURCES render/compare_gltest.cpp)
relievo_gltest(accuracy_truth_gltest GL_ONLY LIBS relievo_accuracy relievo_dense_pages relievo_sample relievo_import SOURCES render/accuracy_truth_gltest.cpp)
relievo_gltest(mesh_picture_gltest LIBS relievo_engine SOURCES render/mesh_picture_gltest.cpp)
relievo_gltest(hidden_backs_gltest GL_ONLY LIBS relievo_engine SOURCES render/hidden_backs_gltest.cpp)
relievo_gltest(orthographic_gltest GL_ONLY LIBS relievo_engine relievo_dense_pages relievo_lod SOURCES render/orthographic_gltest.cpp)
relievo_test(upload_choice_test LIBS relievo_engine SOURCES render/upload_choice_test.cpp)
relievo_gltest(block_upload_gltest LIBS relievo_engine SOURCES render/block_upload_gltest.cpp)
if(RELIEVO_GL_TESTS)  # once more without BC7, and without copies of compressed textures
  set(missing "-GL_ARB_texture_compression_bptc -GL_EXT_texture_compression_bptc -GL_ARB_copy_image -GL_EXT_copy_image -GL_OES_copy_image")
  relievo_add_gltest(block_upload_gltest_bare block_upload_gltest --gtest_filter=*AContextWithoutBc7IsNamed:*AGrowingPool*
    "MESA_EXTENSION_OVERRIDE=${missing}")
endif()
relievo_gltest(mesh_ptm_gltest RUNS GL_ONLY LIBS relievo_image relievo_stream relievo_import SOURCES render/mesh_ptm_gltest.cpp)
relievo_gltest(texture_depths_gltest LIBS relievo_engine relievo_stream relievo_import SOURCES render/texture_depths_gltest.cpp)
relievo_gltest(patch_tails_gltest LIBS relievo_engine relievo_lod SOURCES render/patch_tails_gltest.cpp)
relievo_gltest(depth_gltest LIBS relievo_engine relievo_lod SOURCES render/depth_gltest.cpp)
foreach(name depth_gltest mesh_picture_gltest)  # once more without clip control, where depth is conventional
  if(RELIEVO_GL_TESTS)
    relievo_add_gltest(${name}_bare ${name} "" "MESA_EXTENSION_OVERRIDE=-GL_ARB_clip_control -GL_EXT_clip_control")
  endif()
endforeach()
relievo_gltest(hard_scans_gltest RUNS GL_ONLY LIBS relievo_engine relievo_bake relievo_lod SOURCES render/hard_scans_gltest.cpp)
relievo_gltest(shadows_gltest LIBS relievo_engine relievo_dense_pages SOURCES render/shadows_gltest.cpp)
relievo_gltest(soft_light_gltest LIBS relievo_engine relievo_dense_pages relievo_lod SOURCES render/soft_light_gltest.cpp)
relievo_gltest(gloss_gltest LIBS relievo_engine relievo_dense_pages relievo_lod SOURCES render/gloss_gltest.cpp)
